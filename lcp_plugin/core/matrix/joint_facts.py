"""Facts of a matrix whose rows are spread over ranks, which all of them find together."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from ..checks import FloatVector
from .matrix import Matrix

UNLIKELY = 1e-10  # relative difference of xᵀM y and yᵀM x, x and y arbitrary, beyond which M is not symmetric


@np.errstate(all="ignore")
def pivot_weight(rows: Any, fetch: Callable[[FloatVector], None], relaxation: float) -> FloatVector:
    """Return what is added to the pivots d_i of a sweep on all processes at once, shape (own,).

    Parameters
    ----------
    rows : CSR array, shape (own, width)
        Of a symmetric matrix; the columns behind the own ones are those of other processes.
    fetch : callable
        Writes the values of those processes behind the own ones of a vector, shape (width,); all of them call.
    relaxation : float
        r in (0, 2).

    Notes
    -----
    With σ_i = Σ |m_ij| √(d_i/d_j) over the foreign columns j the weight is ω_i = max(0, (r σ_i − (1 − r/2) d_i)/2).
    No scaling of rows and columns alike changes it. For M symmetric positive definite the splitting 𝓜 has
    𝓜 + 𝓜ᵀ − M = (2/r − 1) D + (2/r) Ω − (the foreign part of M), and that is positive definite, because
    2 |m_ij x_i x_j| ≤ |m_ij| (s x_i² + x_j²/s) with s = √(d_i/d_j). For an H₊-matrix and r ≤ 1 any ω ≥ 0 does.
    """
    own, width = rows.shape
    whole = np.ones(width)
    whole[:own] = diagonal = rows.diagonal()
    fetch(whole)
    coupling = np.sqrt(np.abs(diagonal)) * (
        abs(rows[:, own:]) @ (1.0 / np.sqrt(np.abs(whole[own:])))
    )
    weight: FloatVector = np.maximum(
        0.0, 0.5 * relaxation * coupling - 0.25 * (2.0 - relaxation) * diagonal
    )
    return np.where(np.isfinite(weight), weight, 0.0)


@np.errstate(all="ignore")
def has_symmetric_products(matrix: Matrix) -> bool:
    """Return whether xᵀM y = yᵀM x for x and y of arbitrary entries, up to rounding."""
    unit = 1.0 / np.sqrt(matrix.diagonal)
    x, y = (unit * _arbitrary(matrix.first, matrix.own, seed) for seed in (1, 2))
    x_product, y_product = (matrix.rows @ matrix.whole(vector) for vector in (x, y))
    sums = float(y @ x_product), float(x @ y_product), float(np.sum((unit * x_product) ** 2))
    forward, backward, size = map(matrix.total_of, sums)
    return bool(abs(forward - backward) <= UNLIKELY * np.sqrt(size * matrix.n)) and bool(
        np.isfinite(size)
    )


def _arbitrary(first: int, count: int, seed: int) -> FloatVector:
    """Return numbers in (−1, 1) that depend on the index, from `first` on, and the seed only, shape (count,)."""
    bits = np.arange(first, first + count, dtype=np.uint64) * np.uint64(
        0x9E3779B97F4A7C15
    ) + np.uint64(seed << 32)
    for shift, factor in (
        (30, 0xBF58476D1CE4E5B9),
        (27, 0x94D049BB133111EB),
    ):  # the mixing steps of SplitMix64
        bits = (bits ^ (bits >> np.uint64(shift))) * np.uint64(factor)
    return (bits >> np.uint64(11)).astype(np.float64) * 2.0**-52 - 1.0
