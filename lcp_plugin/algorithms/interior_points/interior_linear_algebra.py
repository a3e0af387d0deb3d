"""The Newton matrix of an interior point, M + diag: equilibrated, regularised, factorised as its structure allows."""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from ...checks import FloatVector, read_only
from ...matrix.factors import cholesky, dense_lu, sparse_lu, sparse_work
from ...matrix.structure import compressed_rows
from .newton_matrix import NewtonMatrix
from .quasidefinite import QuasidefiniteNewtonMatrix
from .symbolic import Symbolic

DENSE_UP_TO = 150  # rows up to which a sparse M is factorised by LAPACK, with pivoting
EVEN = 1e3  # diagonals that differ by less are not worth a scaled copy of a dense M
RUIZ_PASSES = 8
PIVOTS = (0.0, 0.1, 1.0)  # SuperLU's thresholds, tried in order where a factor turns out useless


class DenseNewtonMatrix(NewtonMatrix):
    """Cholesky where M is symmetric, else LU with partial pivoting, in one array that is used again."""

    def __init__(self, M: FloatVector, is_symmetric: bool, signs: FloatVector | None = None) -> None:
        super().__init__(M.shape[0], M)
        self.signs = self.signs if signs is None else read_only(signs)
        self._factorise = cholesky if is_symmetric else dense_lu
        self._buffer = np.empty_like(M)
        self._factor: Any = None

    def _try(self, diagonal: FloatVector) -> bool:
        np.copyto(self._buffer, self.M)
        self._buffer.flat[:: self.n + 1] += diagonal
        self._factor = self._factorise(self._buffer, overwrite=True)
        self.work += self.n**3 / (6.0 if self._factorise is cholesky else 3.0)
        return self._factor is not None

    def _apply(self, right: FloatVector) -> FloatVector:
        self.work += self._factor.solve_work
        x: FloatVector = self._factor.solve(right)
        return x


class SparseNewtonMatrix(NewtonMatrix):
    """LU by SuperLU, ordered once by the pattern of M + Mᵀ, pivots from the diagonal.

    The symmetric part of M + diag is positive definite, so every pivot on the diagonal is positive: on the matrix of
    a quadratic program, [P, Aᵀ; −A, 0], this is the factorisation of the quasi-definite matrix with the signs of the
    last rows turned. Where a solve shows a factor to be useless, pivoting is allowed.
    """

    def __init__(self, M: sp.csr_array) -> None:
        super().__init__(M.shape[0], M)
        # Entries as CSR of M + diag, which is CSC of its transpose; the diagonal is always stored.
        union = sp.csr_array(abs(M) + sp.eye_array(self.n, format="csr"))
        keys = self._keys(union)
        data = np.zeros(union.nnz)
        data[np.searchsorted(keys, self._keys(M))] = M.data
        self._diagonal_at = np.searchsorted(keys, np.arange(self.n, dtype=np.int64) * (self.n + 1))
        self._own_diagonal = data[self._diagonal_at]
        self._matrix = sp.csc_array((data, union.indices, union.indptr), shape=union.shape)
        self._order: NDArray[np.intp] | None = None
        self._factor: Any = None
        self._factor_order: NDArray[np.intp] | None = None
        self._factor_work = 0.0
        self._pivoting = 0

    def _keys(self, matrix: sp.csr_array) -> NDArray[np.int64]:
        rows = np.repeat(np.arange(self.n, dtype=np.int64), np.diff(matrix.indptr))
        keys: NDArray[np.int64] = rows * self.n + matrix.indices
        return keys

    def _try(self, diagonal: FloatVector) -> bool:
        self._matrix.data[self._diagonal_at] = self._own_diagonal + (
            diagonal if self._order is None else diagonal[self._order]
        )
        for pivoting in range(self._pivoting, len(PIVOTS)):
            try:
                self._factor = sparse_lu(
                    self._matrix, permc_spec="MMD_AT_PLUS_A" if self._order is None else "NATURAL",
                    diag_pivot_thresh=PIVOTS[pivoting], options={"SymmetricMode": PIVOTS[pivoting] < 1.0},
                )
            except RuntimeError:
                continue
            self._factor_order = self._order
            if self._order is None:
                self._factor_work = sparse_work(self._factor)
                self._keep_order(np.argsort(self._factor.perm_c))
            self.work += self._factor_work
            if self.is_useful(diagonal):
                self._pivoting = pivoting
                return True
        return False

    def _keep_order(self, order: NDArray[np.intp]) -> None:
        """Put rows and columns in the order that was found, so that nobody looks for it again."""
        matrix = self._matrix
        numbered = sp.csc_array((np.arange(matrix.nnz), matrix.indices, matrix.indptr), shape=matrix.shape)
        moved = sp.csc_array(numbered[order][:, order])
        moved.sort_indices()
        came_from = moved.data
        goes_to = np.empty_like(came_from)
        goes_to[came_from] = np.arange(came_from.size)
        self._matrix = sp.csc_array((matrix.data[came_from], moved.indices, moved.indptr), shape=matrix.shape)
        self._diagonal_at, self._own_diagonal = goes_to[self._diagonal_at[order]], self._own_diagonal[order]
        self._order = order

    def _apply(self, right: FloatVector) -> FloatVector:
        self.work += float(self._factor.nnz)
        x: FloatVector
        if self._factor_order is None:
            x = self._factor.solve(right, trans="T")
        else:
            x = np.empty_like(right)
            x[self._factor_order] = self._factor.solve(right[self._factor_order], trans="T")
        return x


def newton_matrix(
    M: Any, is_symmetric: bool, signs: FloatVector | None = None, symbolic: Symbolic | None = None
) -> NewtonMatrix:
    """Return the Newton matrix that suits M: dense or small, of a quadratic program with these signs, or sparse."""
    if not sp.issparse(M):
        return DenseNewtonMatrix(M, is_symmetric, signs)
    if signs is not None:
        return QuasidefiniteNewtonMatrix(M, signs, symbolic)
    if M.shape[0] <= DENSE_UP_TO:
        return DenseNewtonMatrix(M.toarray(), is_symmetric)
    return SparseNewtonMatrix(M)


def equilibration(M: Any) -> FloatVector | None:
    """Return c, powers of two, shape (n,), such that c_i m_ij c_j has rows and columns of even size; None for c = 1.

    The same factors on both sides keep a monotone matrix monotone and a symmetric one symmetric.
    """
    n = M.shape[0]
    c = np.ones(n)
    if not n:
        return None
    if not sp.issparse(M):
        diagonal = M.diagonal()
        if diagonal.min() > 0.0:
            if diagonal.max() <= EVEN * diagonal.min():
                return None
            return _power_of_two(1.0 / np.sqrt(diagonal))
    from ...kernels.rows import even

    even(*compressed_rows(M), RUIZ_PASSES, c)
    return _power_of_two(c)


def scaled_by(M: Any, c: FloatVector) -> Any:
    """Return c_i m_ij c_j."""
    scaled = rows_scaled_by(M, c)
    if sp.issparse(M):
        scaled.data *= c[M.indices]
    else:
        scaled *= c
    return scaled


def rows_scaled_by(M: Any, r: FloatVector) -> Any:
    """Return r_i m_ij."""
    if not sp.issparse(M):
        return r[:, None] * M
    return sp.csr_array((np.repeat(r, np.diff(M.indptr)) * M.data, M.indices, M.indptr), shape=M.shape)


def _power_of_two(c: FloatVector) -> FloatVector:
    rounded: FloatVector = np.ldexp(1.0, np.clip(np.rint(np.log2(c)), -500, 500).astype(np.int64))
    return rounded
