"""Whether a matrix is its transpose, but for rounding, and how strong couplings are both ways together.

Entry by entry, or beside the size of the rows: sweeps, factors and energies do not see a small entry in a row of large
ones, and of an assembled matrix what ought to be 0 is rounding of these.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
import scipy.sparse as sp

from ..checks import FloatVector, read_only
from ..kernels.threads import share
from .matrix import Matrix, fact

UNNOTICED = 1e-12  # relative asymmetry of an entry that conjugate gradients do not notice
DENSE_FROM, LARGEST_DENSE = (
    0.05,
    2000,
)  # share of the entries, and rows: a difference of sparse matrices takes longer
ROUNDED = 1e-13  # asymmetry beside the size of the rows that rounding explains
TILE = 256
SHARED_ROWS = 16_384  # rows that are worth a hand-over
NO_DATA = np.zeros(0)


def is_symmetric_entrywise(M: Any) -> bool:
    """Return whether a CSR array with sorted rows has the pattern of its transpose, and its entries to 1e-12.

    Examples
    --------
    >>> import scipy.sparse as sp
    >>> is_symmetric_entrywise(sp.csr_array([[2.0, 1e-9], [1e-9, 2.0]]))
    True
    >>> is_symmetric_entrywise(sp.csr_array([[2.0, 1e-20], [0.0, 2.0]]))
    False
    """
    return is_mirrored(M.indptr[:-1], M.indptr[1:], M.indices, M.data)


def is_mirrored(begin: Any, last: Any, indices: Any, data: FloatVector = NO_DATA) -> bool:
    """Return whether row i has column j wherever j has i, with the same entry to 1e-12 where there are data.

    Row i holds the columns indices[begin[i]:last[i]], sorted. Where each entry right of the diagonal has its mirror,
    and there are no more on the left, all have.
    """
    from ..kernels.rows import unmirrored

    operands = *map(read_only, (begin, last, indices, data)), UNNOTICED
    return bool(sum(share(partial(unmirrored, *operands), last.size, SHARED_ROWS)) == 0)


@fact
def has_symmetric_entries(matrix: Matrix) -> bool:
    """Return whether M is symmetric up to rounding: by entries, or beside its rows.

    A wrong answer would cost speed, not correctness: every z is judged by its residual.
    """
    return is_symmetric_entrywise(matrix.csr) or is_nearly_symmetric(matrix)


@np.errstate(over="ignore", invalid="ignore")  # a difference that overflows is no small one
def is_symmetric_to_rounding(M: Any, size: FloatVector | None = None) -> bool:
    """Return whether |m_ij − m_ji| ≤ 1e-13 √(size_i size_j) everywhere.

    Parameters
    ----------
    M : ndarray or sparse array, shape (n, n)
    size : array, shape (n,), optional
        Not negative; the magnitudes of the diagonal by default.

    Examples
    --------
    >>> is_symmetric_to_rounding(np.array([[2.0, 1e-20], [0.0, 2.0]]))
    True
    """
    size = np.abs(M.diagonal()) if size is None else size
    if sp.issparse(M):
        if M.nnz < DENSE_FROM * M.shape[0] ** 2 or M.shape[0] > LARGEST_DENSE:
            return mismatch(M, size, ROUNDED)[1] is None
        M = M.toarray()
    return _is_symmetric_by_tiles(M, np.sqrt(size))


@np.errstate(over="ignore", invalid="ignore")
def mismatch(M: Any, size: FloatVector, tolerance: float) -> tuple[float, tuple[int, int] | None]:
    """Return max |m_ij − m_ji|, and the i, j where it exceeds tolerance √(size_i size_j) by most, if it does.

    Measured so, a block in a small unit is not judged by one in a large unit.
    """
    if sp.issparse(M) and is_its_mirror(M):
        return 0.0, None
    difference = sp.coo_array(M - M.T)
    if difference.nnz == 0:
        return 0.0, None
    i, j, distance, root = difference.row, difference.col, np.abs(difference.data), np.sqrt(size)
    excess = distance - tolerance * root[i] * root[j]
    worst = int(np.argmax(excess))
    return float(distance.max()), (int(i[worst]), int(j[worst])) if excess[worst] > 0.0 else None


def is_its_mirror(M: Any) -> bool:
    """Return whether a CSR array and its transpose are the same arrays, which is quicker seen than their difference."""
    if M.format != "csr" or M.shape[0] != M.shape[1]:
        return False
    mirror = M.tocsc()
    pairs = ((M.indptr, mirror.indptr), (M.indices, mirror.indices), (M.data, mirror.data))
    return all(np.array_equal(first, second) for first, second in pairs)


def _is_symmetric_by_tiles(M: FloatVector, root: FloatVector) -> bool:
    """Return the answer for a dense matrix: no transposed copy, and no products where the least root suffices."""
    n, least = M.shape[0], float(root.min(initial=np.inf)) ** 2
    for i in range(0, n, TILE):
        for j in range(i, n, TILE):
            block, mirror = M[i : i + TILE, j : j + TILE], M[j : j + TILE, i : i + TILE].T
            difference = np.abs(block - mirror)
            if difference.max() <= ROUNDED * least:
                continue
            allowed = ROUNDED * np.multiply.outer(root[i : i + TILE], root[j : j + TILE])
            if np.any(difference > allowed):
                return False
    return True


@fact
def is_nearly_symmetric(matrix: Matrix) -> bool:
    """Return whether M = Mᵀ up to rounding, relative to the size of its rows and columns."""
    M = matrix.array
    return is_symmetric_to_rounding(M, matrix.residual_scale if sp.issparse(M) else None)


@fact
def mean_coupling(matrix: Matrix) -> float:
    """Return max_i Σ_{j≠i} √(|m_ij m_ji| / (m_ii m_jj)); ∞ without a positive diagonal.

    No scaling of rows or columns changes it. Of a tridiagonal M, and of any whose |m_ij / m_ji| are those of a scaling
    D, it is the largest row sum of D⁻¹J D for some D, J = |I − diag(M)⁻¹M|: no less than the spectral radius of J,
    however strong a flow makes m_ij beside m_ji.

    Examples
    --------
    >>> flow = np.array([[20.0, -1.0, 0.0], [-19.0, 20.0, -1.0], [0.0, -19.0, 20.0]])
    >>> round(mean_coupling(Matrix(flow)), 3)
    0.436
    """
    diagonal = matrix.diagonal
    if not (diagonal > 0.0).all():
        return np.inf
    with np.errstate(all="ignore"):
        M, root = abs(matrix.csr), np.sqrt(diagonal)
        both = M if has_symmetric_entries(matrix) else np.sqrt(M).multiply(np.sqrt(M).T)
        return float(((both @ (1.0 / root)) / root).max(initial=1.0)) - 1.0
