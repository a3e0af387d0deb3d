"""Facts of a matrix whose rows are spread over ranks, which all of them find together."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from ..core.checks import FloatVector, read_only
from ..core.communicator import Communicator
from ..core.matrix.matrix import Matrix
from ..core.matrix.structure import Parts, local_parts

UNLIKELY = 1e-10  # relative difference of xᵀM y and yᵀM x, x and y arbitrary, beyond which M is not symmetric


@np.errstate(all="ignore")
def pivot_weight(rows: Any, communicator: Communicator, relaxation: float) -> FloatVector:
    """Return what is added to the pivots d_i of a sweep on all processes at once, shape (own,).

    Parameters
    ----------
    rows : CSR array, shape (own, width)
        Of a symmetric matrix; the columns behind the own ones are those of other processes.
    communicator : Communicator
        Whoever has those; all of them call.
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
    communicator.fetch(whole)
    coupling = np.sqrt(np.abs(diagonal)) * (abs(rows[:, own:]) @ (1.0 / np.sqrt(np.abs(whole[own:]))))
    weight: FloatVector = np.maximum(0.0, 0.5 * relaxation * coupling - 0.25 * (2.0 - relaxation) * diagonal)
    return np.where(np.isfinite(weight), weight, 0.0)




@np.errstate(all="ignore")
def has_symmetric_products(matrix: Matrix) -> bool:
    """Return whether xᵀM y = yᵀM x for x and y of arbitrary entries, up to rounding."""
    unit = 1.0 / np.sqrt(matrix.diagonal)
    x, y = (unit * _arbitrary(matrix.communicator.first, matrix.own, seed) for seed in (1, 2))
    x_product, y_product = (matrix.rows @ matrix.whole(vector) for vector in (x, y))
    sums = float(y @ x_product), float(x @ y_product), float(np.sum((unit * x_product) ** 2))
    forward, backward, size = map(matrix.communicator.total, sums)
    return bool(abs(forward - backward) <= UNLIKELY * np.sqrt(size * matrix.n)) and bool(np.isfinite(size))


def _arbitrary(first: int, count: int, seed: int) -> FloatVector:
    """Return numbers in (−1, 1) that depend on the index, from `first` on, and the seed only, shape (count,)."""
    bits = np.arange(first, first + count, dtype=np.uint64) * np.uint64(0x9E3779B97F4A7C15) + np.uint64(seed << 32)
    for shift, factor in ((30, 0xBF58476D1CE4E5B9), (27, 0x94D049BB133111EB)):  # the mixing steps of SplitMix64
        bits = (bits ^ (bits >> np.uint64(shift))) * np.uint64(factor)
    return (bits >> np.uint64(11)).astype(np.float64) * 2.0**-52 - 1.0


def joined_parts(matrix: Matrix) -> Parts | None:
    """Return the parts of rows over several ranks: those of each rank, joined where one of its unknowns is another's.

    What a rank calls a part is told to the others by the values of its unknowns there; the parts that meet are few.
    """
    communicator, own = matrix.communicator, matrix.own
    local, count = local_parts(matrix)
    before, total = communicator.places(count)
    theirs = matrix.whole((local[:own] + before).astype(np.float64))[own:].astype(np.int64)
    met = np.unique(np.stack([local[own:] + before, theirs], axis=1), axis=0)
    pairs = communicator.everybodys(met)
    pattern = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(total, total))
    joined_count, joined = connected_components(pattern, directed=False)
    if joined_count <= 1:
        return None
    shared = np.unique(joined[pairs[pairs[:, 0] != pairs[:, 1]].ravel()])
    mine = joined[local[:own] + before]
    order = np.concatenate([shared, np.setdiff1d(mine, shared)])
    number = np.full(joined_count, -1)
    number[order] = np.arange(order.size)
    return Parts(read_only(number[mine]), order.size, int(joined_count), shared.size, communicator)
