"""LAPACK's factorisations that scipy calls with the interpreter's lock held: the same ones with the lock let go.

Arrays go in as addresses, taken before the call: ctypes turns whatever is raised while it asks an array for its
address, Ctrl-C included, into an ``ArgumentError``.
"""

from __future__ import annotations

import ctypes
from functools import cache
from typing import Any

import numpy as np

from ..core.checks import FloatVector


def dpotrf(matrix: FloatVector, *, overwrite: bool = False) -> tuple[FloatVector, int]:
    """Return (L, info) of A = L Lᵀ, of which the lower triangle is read; the upper one is left as it is.

    Parameters
    ----------
    matrix : ndarray, shape (n, n), by columns
    overwrite : bool
        L may take the place of A.
    """
    factor = _by_columns(matrix, overwrite)
    n, rows, info = ctypes.c_int(matrix.shape[0]), _rows(factor), ctypes.c_int()
    arguments = b"L", ctypes.byref(n), factor.ctypes.data, ctypes.byref(rows), ctypes.byref(info)
    _function("dpotrf", 5)(*arguments)
    return factor, info.value


def signed_cholesky(matrix: FloatVector, positive: int) -> FloatVector | None:
    """Return lower C with C diag(±1) Cᵀ = A, +1 in the first rows and −1 in the others; None where there is none.

    Parameters
    ----------
    matrix : ndarray, shape (n, n), by columns
        Its lower triangle is read; it may be overwritten.
    positive : int
        How many of the signs are +1.

    Examples
    --------
    >>> np.tril(signed_cholesky(np.array([[4.0, 2.0], [2.0, -8.0]], order="F"), 1))
    array([[2., 0.],
           [1., 3.]])
    """
    from scipy.linalg import blas

    rest, info = -matrix[positive:, positive:], 0
    if positive:
        above, info = dpotrf(matrix[:positive, :positive], overwrite=True)
    if positive and rest.size and not info:
        across = blas.dtrsm(1.0, above, matrix[positive:, :positive], side=1, lower=1, trans_a=1)
        matrix[positive:, :positive] = across
        rest = blas.dsyrk(1.0, across, 1.0, rest, lower=1)
    if rest.size and not info:
        matrix[positive:, positive:], info = dpotrf(rest)
    return None if info else matrix


def dgbtrf(band: FloatVector, below: int, above: int) -> tuple[FloatVector, Any, int]:
    """Return (LU, pivots from 0, info) of a band matrix; LU takes the place of the band.

    Parameters
    ----------
    band : ndarray, shape (2 below + above + 1, n), by columns
        As LAPACK wants it.
    """
    factor = _by_columns(band, True)
    n, kl, ku = (ctypes.c_int(number) for number in (band.shape[1], below, above))
    rows, info = _rows(factor), ctypes.c_int()
    pivots = np.empty(band.shape[1], dtype=np.intc)
    arguments = (
        ctypes.byref(n), ctypes.byref(n), ctypes.byref(kl), ctypes.byref(ku),
        factor.ctypes.data, ctypes.byref(rows), pivots.ctypes.data, ctypes.byref(info),
    )
    _function("dgbtrf", 8)(*arguments)
    pivots -= 1
    return factor, pivots, info.value


def _by_columns(matrix: FloatVector, overwrite: bool) -> FloatVector:
    if not overwrite:
        return np.require(matrix.copy(order="F"), np.float64, ["F", "A", "W"])
    is_block = matrix.strides[0] == matrix.itemsize < matrix.strides[1]  # of a larger array by columns
    return np.require(matrix, np.float64, ["A", "W"] if is_block else ["F", "A", "W"])


def _rows(matrix: FloatVector) -> ctypes.c_int:
    return ctypes.c_int(max(matrix.strides[1] // matrix.itemsize, 1))


@cache
def _function(name: str, arguments: int) -> Any:
    """Return the function that scipy offers to Cython, as ctypes calls it: without the interpreter's lock."""
    from scipy.linalg import cython_lapack

    capsule = cython_lapack.__pyx_capi__[name]
    name_of, pointer_of = ctypes.pythonapi.PyCapsule_GetName, ctypes.pythonapi.PyCapsule_GetPointer
    name_of.restype, name_of.argtypes = ctypes.c_char_p, [ctypes.py_object]
    pointer_of.restype, pointer_of.argtypes = ctypes.c_void_p, [ctypes.py_object, ctypes.c_char_p]
    address = pointer_of(capsule, name_of(capsule))
    return ctypes.CFUNCTYPE(None, *[ctypes.c_void_p] * arguments)(address)
