"""Row data for sweeps and their theorems: scales, splits, sums over both triangles, the row scaling of NP methods."""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from .checks import Vector, read_only
from .entries import row_numbers, with_entries
from .matrix import Matrix, fact
from .structure import ROUNDED

BLOCK = 16_384  # rows whose temporary vectors stay in a processor's cache


@fact
def inverse_residual_scale(matrix: Matrix) -> Vector:
    """Return 1/d of the scaled residual, shape (n,), kept finite."""
    return read_only(np.minimum(1.0 / matrix.residual_scale, np.finfo(np.float64).max))


@fact
def has_positive_diagonal(matrix: Matrix) -> NDArray[np.bool_]:
    """Return the mask of diagonal entries that are positive and not too small to invert, shape (n,)."""
    return read_only((matrix.diagonal > 0.0) & np.isfinite(1.0 / matrix.diagonal))


@fact
def split_matrix(matrix: Matrix, backward: bool) -> Any:
    """Return M as a sweep in that direction takes it; see :func:`split_rows`."""
    return split_rows(matrix.csr, backward=backward)


def split_rows(M: sp.csr_array, *, backward: bool = False) -> tuple[Any, Any, Any, Vector]:
    """Return the arrays of M, the second the positions of the first column ≥ i of row i, or > i if backward."""
    rows = row_numbers(M)
    is_before = M.indices <= rows if backward else M.indices < rows
    before = np.bincount(rows[is_before], minlength=M.shape[0])
    split = read_only((M.indptr[:-1] + before).astype(M.indptr.dtype))
    return M.indptr, split, M.indices, M.data


def triangle_sums(matrix: Matrix, v: Vector, part: Any = None) -> tuple[Vector, Vector]:
    """Return (|L|v, |U|v), each row divided by the scale of its residual, shapes (n,).

    If `part`, a CSR array of shape (n, n), is not None, its triangles replace the triangles of M.
    """
    M = matrix.csr if part is None else part
    rows = row_numbers(M)
    size = np.abs(M.data) * inverse_residual_scale(matrix)[rows]
    triangle = with_entries(M, size * (M.indices < rows))
    lower = triangle @ v
    triangle.data = size * (M.indices > rows)
    return lower, triangle @ v


@fact
def unit_triangle_sums(matrix: Matrix) -> tuple[Vector, Vector]:
    """Return the triangle sums of v = 1."""
    return triangle_sums(matrix, np.ones(matrix.n))


def automatic_factors(matrix: Matrix, coupling: float, sweep: str) -> Vector:
    """Return θ, shape (n,): up to 2 if every row of M is diagonally dominant, else 1 on all rows; one pass over M.

    Parameters
    ----------
    matrix : Matrix
    coupling : float
        g = β/α.
    sweep : str
        "forward", "backward" or "symmetric".

    Notes
    -----
    NP with S = θ_i/d_i, α > 0 and the coupling g = β/α in [0, 2] converges where, for some v > 0 with ⟨M⟩v > 0,

        θ_i ≤ 2   and   g θ_i ℓ_i < 1,      ℓ_i = (|L|v)_i/(d_i v_i) with L the part of M that the sweep has updated

    (θ_i ≤ 1 needs g ≤ 1 and nothing else). If all rows are dominant, d_i ≥ Σ|m_ij|, v may be arbitrarily
    near to 1: with ⟨M⟩y > 0 also ⟨M⟩(1 + εy) > 0. There one pass over M decides, and θ balances the two parts of the
    answer. On z* > 0 an iteration contracts by about 1 − 2θ(1 − ℓ − u)/p, on w* > 0 by 1 − 2/p, p = θ/α + θ + 2: equal
    for θ = 1/(1 − ℓ − u). On the gallery larger θ than 2 lost again where the rows are far from equal.
    """
    lower, upper = unit_triangle_sums(matrix)
    updated = {"forward": lower, "backward": upper, "symmetric": np.maximum(lower, upper)}[sweep]
    return balanced_factors(matrix, abs(coupling), updated, (lower, upper))


def balanced_factors(
    matrix: Matrix, coupling: float, updated: Vector, sums: tuple[Vector, Vector]
) -> Vector:
    """Return θ of `automatic_factors`, from g, the sums ℓ over the updated columns, and the triangle sums of v = 1."""
    total = sums[0] + sums[1]
    is_scaled = np.array_equal(matrix.residual_scale, matrix.diagonal)
    if not (is_scaled and total.max(initial=0.0) <= 1.0 + ROUNDED):  # nor is a NaN
        return read_only(np.ones(matrix.n))
    quick = np.minimum(2.0, 1.0 / np.maximum(1.0 - total, 0.0))  # a factor is at most 2
    # g θ ℓ stays below 1.
    return read_only(np.minimum(quick, 0.9 / (coupling * updated)))
