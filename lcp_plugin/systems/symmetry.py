"""Distance of a matrix from its transpose, for verdicts: exactly per entry, and relative to the size of the rows."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

from ..core.matrix.matrix import Matrix, fact


@fact
def asymmetry(matrix: Matrix) -> float:
    """Largest |m_ij − m_ji|/max(|m_ij|, |m_ji|): 0 if M is exactly symmetric."""
    M = matrix.csr
    transposed = M.T.tocsr()
    if np.array_equal(M.indptr, transposed.indptr) and np.array_equal(
        M.indices, transposed.indices
    ):
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
    difference = sp.coo_array(M - M.T)
    beside = np.abs(difference.data) / root[difference.row] / root[difference.col]
    return float(beside.max(initial=0.0))
