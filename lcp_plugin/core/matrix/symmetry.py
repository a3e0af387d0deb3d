"""Symmetry of a matrix up to rounding, relative to the size of its rows.

Sweeps, factors and energies do not see a small entry in a row of large ones, and an assembly leaves rounding of these
where an entry ought to be 0.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse as sp

from ..checks import FloatVector
from .matrix import Matrix, fact

ROUNDED = 1e-13  # asymmetry relative to the size of the rows that rounding explains


@np.errstate(over="ignore", invalid="ignore")  # a difference that overflows is large
def is_symmetric_to_rounding(M: Any, size: FloatVector | None = None) -> bool:
    """Return whether |m_ij − m_ji| ≤ 1e-13 √(size_i size_j) everywhere.

    Parameters
    ----------
    M : ndarray or CSR array, shape (n, n)
    size : array, shape (n,), optional
        Not negative; the magnitudes of the diagonal by default.

    Examples
    --------
    >>> is_symmetric_to_rounding(np.array([[2.0, 1e-20], [0.0, 2.0]]))
    True
    """
    size = np.abs(M.diagonal()) if size is None else size
    if sp.issparse(M):
        return mismatch(M, size, ROUNDED)[1] is None
    root = np.sqrt(size)
    return bool((np.abs(M - M.T) <= ROUNDED * np.multiply.outer(root, root)).all())


@np.errstate(over="ignore", invalid="ignore")
def mismatch(M: Any, size: FloatVector, tolerance: float) -> tuple[float, tuple[int, int] | None]:
    """Return max |m_ij − m_ji|, and the i, j where it exceeds tolerance √(size_i size_j) by most, if it does.

    With this measure, a block in a small unit is not compared with a block in a large unit.
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
    """Return whether a CSR array and its transpose have equal arrays, a faster test than their difference."""
    if M.format != "csr" or M.shape[0] != M.shape[1]:
        return False
    mirror = M.tocsc()
    pairs = ((M.indptr, mirror.indptr), (M.indices, mirror.indices), (M.data, mirror.data))
    return all(np.array_equal(first, second) for first, second in pairs)


@fact
def is_nearly_symmetric(matrix: Matrix) -> bool:
    """Return whether M = Mᵀ up to rounding, relative to the size of its rows and columns.

    An incorrect result would cost speed, not correctness: every z is tested by its residual.
    """
    M = matrix.array
    return is_symmetric_to_rounding(M, matrix.residual_scale if sp.issparse(M) else None)
