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
def mismatch(M: Any, size: FloatVector, tolerance: float) -> tuple[float, tuple[int, int] | None]:
    """Return max |m_ij − m_ji|, and the i, j where it exceeds tolerance √(size_i size_j) by most, if it does.

    With this measure, a block in a small unit is not compared with a block in a large unit.

    Parameters
    ----------
    M : ndarray or CSR array, shape (n, n)
    size : array, shape (n,)
        Not negative.
    tolerance : float

    Examples
    --------
    >>> M = np.array([[2.0, 1e-20], [0.0, 2.0]])
    >>> mismatch(M, M.diagonal(), ROUNDED)
    (1e-20, None)
    """
    if _is_its_mirror(M):
        return 0.0, None
    difference, root = sp.coo_array(M - M.T), np.sqrt(size)
    if not difference.nnz:
        return 0.0, None
    i, j, distance = difference.row, difference.col, np.abs(difference.data)
    excess = distance - tolerance * root[i] * root[j]
    worst = int(np.argmax(excess))
    return float(distance.max()), (int(i[worst]), int(j[worst])) if excess[worst] > 0.0 else None


def _is_its_mirror(M: Any) -> bool:
    """Return whether a square ndarray or CSR array is its transpose, a faster test than their difference."""
    if isinstance(M, np.ndarray):
        return bool((M == M.T).all())
    if M.format != "csr":
        return False
    mirror = M.tocsc()
    pairs = ((M.indptr, mirror.indptr), (M.indices, mirror.indices), (M.data, mirror.data))
    return all(np.array_equal(first, second) for first, second in pairs)


@fact
def is_nearly_symmetric(matrix: Matrix) -> bool:
    """Return whether M = Mᵀ up to rounding, relative to the size of its rows and columns.

    An incorrect result would cost speed, not correctness: every z is tested by its residual.
    """
    return mismatch(matrix.array, matrix.residual_scale, ROUNDED)[1] is None
