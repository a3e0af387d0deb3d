"""How far a matrix is from its transpose, by two measures.

Entry by entry exactly, for verdicts; and beside the size of the rows, for factors and energies, which do not see a
small entry in a row of large ones.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse as sp

from ..core.checks import FloatVector
from ..core.matrix.matrix import Matrix, fact

DENSE_FROM, LARGEST_DENSE = 0.05, 2000  # share of the entries, and rows: a difference of sparse matrices takes longer
ROUNDED = 1e-13  # asymmetry beside the size of the rows that rounding explains
TILE = 256


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


@fact
def asymmetry_of_rows(matrix: Matrix) -> float:
    """Largest |m_ij − m_ji|/√(s_i s_j), s_i the largest magnitude in row and column i: noise of an assembly is small.

    Examples
    --------
    >>> asymmetry_of_rows(Matrix(sp.csr_array([[1e11, 1e-7], [0.0, 1e11]])))
    1e-18
    """
    M = matrix.csr
    entries = sp.coo_array(M)
    i, j = entries.row, entries.col
    size = np.zeros(M.shape[0])
    for at in (i, j):
        np.maximum.at(size, at, np.abs(entries.data))
    root = np.sqrt(size)
    with np.errstate(over="ignore", invalid="ignore"):
        difference = sp.coo_array(M - M.T)
        beside = np.abs(difference.data) / root[difference.row] / root[difference.col]
    return float(beside.max(initial=0.0))


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
