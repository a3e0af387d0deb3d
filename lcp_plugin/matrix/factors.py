"""Factors of square matrices, chosen by structure: Cholesky, LU, banded LU (LAPACK) and sparse LU (SuperLU)."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any

import numpy as np
import scipy.sparse as sp

from ..checks import FloatVector
from .factorisation import sparse_lu

DENSE_UP_TO = 64  # a sparse block this small is factorised as a dense one
DENSE_ABOVE_DENSITY = 0.25
LARGEST_DENSE = 3000
BANDED_UP_TO = 64  # sub- plus superdiagonals up to which LAPACK's band is faster than SuperLU
SYMMETRIC_PIVOT = 0.01  # SuperLU keeps the diagonal pivot where it is at least this share of the column's largest


class Factor(ABC):
    """A factorised matrix A.

    Attributes
    ----------
    work : float
        Multiplications that the factorisation took.
    solve_work : float
        Multiplications that one solve takes.
    """

    work: float
    solve_work: float

    @abstractmethod
    def solve(self, right: FloatVector) -> FloatVector:
        """Return x with A x = right, shape (n,); not finite where A is singular."""


def factorise(matrix: Any, *, is_symmetric: bool = False, bandwidth: tuple[int, int] | None = None) -> Factor | None:
    """Return a factor of a square matrix, or None where a pivot is exactly zero or the entries overflow.

    Parameters
    ----------
    matrix : ndarray or CSR array, shape (n, n)
        Not modified.
    is_symmetric : bool
        The matrix is symmetric up to rounding: Cholesky is tried first where it is dense, and a sparse one is
        ordered by the pattern of A + Aᵀ.
    bandwidth : (int, int), optional
        Numbers of sub- and superdiagonals of a sparse matrix, where they are known.
    """
    if not sp.issparse(matrix):
        return _dense(matrix, is_symmetric)
    n = matrix.shape[0]
    is_dense = matrix.nnz > DENSE_ABOVE_DENSITY * n * n and n <= LARGEST_DENSE
    if n <= DENSE_UP_TO or is_dense:
        return _dense(matrix.toarray(), is_symmetric)
    if bandwidth is not None and sum(bandwidth) <= BANDED_UP_TO:
        return _checked(BandedLU, matrix, *bandwidth)
    return _checked(SparseLU, matrix, is_symmetric)


def _dense(matrix: Any, is_symmetric: bool) -> Factor | None:
    if is_symmetric and matrix.shape[0] and matrix.diagonal().min() > 0.0:
        factor = _checked(Cholesky, matrix)
        if factor is not None:
            return factor
    return _checked(DenseLU, matrix)


def _checked(kind: type[Any], *arguments: Any) -> Factor | None:
    try:
        factor: Factor = kind(*arguments)
    except (ArithmeticError, RuntimeError, ValueError):  # what SuperLU and _Singular call a zero pivot
        return None
    return factor


class _Singular(ArithmeticError):
    """A pivot is zero, or not positive where it has to be."""


class Cholesky(Factor):
    """A = UᵀU of a dense symmetric positive definite matrix; its upper triangle is read."""

    def __init__(self, matrix: FloatVector) -> None:
        from scipy.linalg import lapack

        self._lapack = lapack
        n = matrix.shape[0]
        # A row-major upper triangle is LAPACK's lower one: no copy is transposed.
        self._factor, info = lapack.dpotrf(matrix.T, lower=1, clean=0)
        if info != 0:
            raise _Singular
        self.work, self.solve_work = n**3 / 6.0, float(n * n)

    def solve(self, right: FloatVector) -> FloatVector:
        """Return x with A x = right, shape (n,)."""
        x: FloatVector = self._lapack.dpotrs(self._factor, right, lower=1)[0]
        return x


class DenseLU(Factor):
    """P A = L U of a dense matrix with partial pivoting."""

    def __init__(self, matrix: FloatVector) -> None:
        from scipy.linalg import lapack

        self._lapack = lapack
        n = matrix.shape[0]
        self._factor, self._pivots, info = lapack.dgetrf(matrix.T)
        if info != 0:
            raise _Singular
        self.work, self.solve_work = n**3 / 3.0, float(n * n)

    def solve(self, right: FloatVector) -> FloatVector:
        """Return x with A x = right, shape (n,)."""
        x: FloatVector = self._lapack.dgetrs(self._factor, self._pivots, right, trans=1)[0]
        return x


class BandedLU(Factor):
    """P A = L U of a sparse matrix with few diagonals, by LAPACK's band routines."""

    def __init__(self, matrix: sp.csr_array, below: int, above: int) -> None:
        from scipy.linalg import lapack

        self._lapack, self._band = lapack, (below, above)
        n = matrix.shape[0]
        rows = np.repeat(np.arange(n), np.diff(matrix.indptr))
        band = np.zeros((2 * below + above + 1, n), order="F")
        band[below + above + rows - matrix.indices, matrix.indices] = matrix.data
        self._factor, self._pivots, info = lapack.dgbtrf(band, below, above, overwrite_ab=1)
        if info != 0:
            raise _Singular
        self.work, self.solve_work = float(n * below * (below + above + 1)), float(n * (2 * below + above + 1))

    def solve(self, right: FloatVector) -> FloatVector:
        """Return x with A x = right, shape (n,)."""
        x: FloatVector = self._lapack.dgbtrs(self._factor, *self._band, right, self._pivots)[0]
        return x


class SparseLU(Factor):
    """P A Q = L U of a sparse matrix, by SuperLU."""

    def __init__(self, matrix: sp.csr_array, is_symmetric: bool) -> None:
        if not np.isfinite(matrix.data).all():
            raise _Singular
        # CSR of A is CSC of Aᵀ: its factor serves, solved with the transpose.
        transpose = matrix.T
        if is_symmetric:
            self._factor = sparse_lu(
                transpose, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=SYMMETRIC_PIVOT,
                options={"SymmetricMode": True},
            )
        else:
            self._factor = sparse_lu(transpose, permc_spec="COLAMD")
        lower, upper = self._factor.L, self._factor.U
        columns_of_lower = np.diff(lower.indptr).astype(np.float64)
        rows_of_upper = np.bincount(upper.indices, minlength=matrix.shape[0])
        self.work, self.solve_work = float(columns_of_lower @ rows_of_upper), float(self._factor.nnz)

    def solve(self, right: FloatVector) -> FloatVector:
        """Return x with A x = right, shape (n,)."""
        x: FloatVector = self._factor.solve(right, trans="T")
        return x
