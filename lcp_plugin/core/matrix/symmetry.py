"""How far a matrix is from its transpose, by three measures.

Entry by entry exactly, for verdicts; entry by entry to rounding, for conjugate gradients; and beside the size of the
rows, for factors and energies, which do not see a small entry in a row of large ones.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
import scipy.sparse as sp

from ..checks import FloatVector, read_only
from ..kernels.threads import share
from .matrix import Matrix, fact

UNLIKELY = 1e-10  # relative difference of xᵀM y and yᵀM x, x and y arbitrary, beyond which M is not symmetric
UNNOTICED = 1e-12  # relative asymmetry of an entry that conjugate gradients do not notice
DENSE_FROM, LARGEST_DENSE = 0.05, 2000  # share of the entries, and rows: a difference of sparse matrices takes longer
ROUNDED = 1e-13  # asymmetry beside the size of the rows that rounding explains
TILE = 256
SHARED_ROWS = 16_384  # rows that are worth a hand-over
NO_DATA = np.zeros(0)


@fact
def asymmetry(matrix: Matrix) -> float:
    """Largest |m_ij − m_ji|/max(|m_ij|, |m_ji|): 0 where M is exactly symmetric."""
    M = matrix.csr
    transposed = M.T.tocsr()
    if np.array_equal(M.indptr, transposed.indptr) and np.array_equal(M.indices, transposed.indices):
        ours, theirs = M.data, transposed.data
    else:
        difference = sp.coo_array(M - transposed)
        if difference.nnz == 0:
            return 0.0
        ours = np.asarray(M[difference.row, difference.col]).ravel()
        theirs = np.asarray(M[difference.col, difference.row]).ravel()
    unequal = ours != theirs
    if not unequal.any():
        return 0.0
    ours, theirs = ours[unequal], theirs[unequal]
    larger = np.maximum(np.abs(ours), np.abs(theirs))
    return float(np.abs(ours / larger - theirs / larger).max())


def is_symmetric_entrywise(M: Any) -> bool:
    """Return whether a CSR array with sorted rows has the pattern of its transpose, and its entries to 1e-12.

    Examples
    --------
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
def has_symmetric_entries(matrix: Matrix) -> bool:
    """Return whether M is symmetric up to rounding: entry by entry, or on several ranks by two products.

    For x and y of arbitrary entries xᵀM y = yᵀM x happens by chance with probability 0. A wrong answer would cost
    speed, not correctness: every z is judged by its residual.
    """
    return _has_symmetric_products(matrix) if matrix.communicator.size > 1 else is_symmetric_entrywise(matrix.csr_rows)


@np.errstate(all="ignore")
def _has_symmetric_products(matrix: Matrix) -> bool:
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
