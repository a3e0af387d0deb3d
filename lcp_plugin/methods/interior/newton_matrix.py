"""Newton matrices of interior points, M + diag: regularised, factorised, and the regularisation refined away.

M is given, equilibrated, and not modified. Dense: Cholesky, twice of quadratic programs, or LU. Sparse: LU by SuperLU;
LDLᵀ of quadratic programs is in :mod:`.quasidefinite`.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
import scipy.sparse as sp

from ...core.checks import BoolVector, FloatVector, read_only
from ...core.deadline import require_seconds
from ...core.matrix.structure import row_numbers
from ...core.tuning import DENSE_OPERATIONS
from ...systems.factors import Factor, cholesky, dense_lu, sparse_lu, sparse_work
from ...systems.refinement import REFINED, REFINEMENTS, ROUGH, STABLE, USEFUL

LARGE = 500  # rows from which on a second correction is cheap beside the factorisation
PIVOTS = (0.0, 0.1, 1.0)  # SuperLU's thresholds, tried in order where a factor turns out useless


class NewtonMatrix:
    """M + diag(diagonal), factorised once an iteration; M itself is given, equilibrated, and not modified.

    Attributes
    ----------
    work : float
        Multiplications so far.
    state : ndarray
        How much is regularised, and what solves have left: as :mod:`.kernels.interior_steps` has it.
    signs : ndarray, shape (n,)
        −1 on the rows whose z is a multiplier of others, else 1.
    """

    def __init__(self, n: int, M: Any = None) -> None:
        from .kernels import interior_steps as kernels

        self.n, self.M, self._kernels = n, M, kernels
        self.work = 0.0
        self.signs = read_only(np.ones(self.n))
        self.state = np.array([kernels.REGULARISATION, kernels.REGULARISATION, 1.0, 1.0, 0.0, 0.0, np.inf])
        self._ones = self._diagonal = np.ones(self.n)

    @property
    def corrections(self) -> int:
        """How many corrections towards the centre are worth their solves, beside a factorisation."""
        return 2 if self.n >= LARGE else 1

    @property
    def missed(self) -> float:
        """The largest error that a solve has left since the last factorisation."""
        return float(self.state[self._kernels.MISSED])

    def steps(self, vectors: FloatVector, facts: FloatVector, is_active: BoolVector, most: int) -> None:
        """Make so many predictor–corrector steps, or fewer, and answer what they ask for."""
        kernels, asked = self._kernels, self._kernels.PRODUCT
        while asked >= 0 and facts[kernels.MADE] < most:
            error = size = 0.0
            if asked == kernels.PRODUCT:
                vectors[kernels.LEFT] = self.product(vectors[kernels.Z])
            elif asked == kernels.FACTOR:
                x = self._try(vectors[kernels.SHIFTED], vectors[kernels.RIGHT])
                vectors[kernels.FOUND], error = (0.0, np.inf) if x is None else (x, 0.0)
            else:
                enough = kernels.ENOUGH * float(facts[kernels.INFEASIBILITY])
                vectors[kernels.FOUND], error, size = self._refined(
                    vectors[kernels.RIGHT], vectors[kernels.DIAGONAL], enough
                )
            asked = kernels.go_on(vectors, facts, self.state, is_active, asked, error, size)

    def product(self, z: FloatVector) -> FloatVector:
        """Return M z."""
        return np.asarray(self.M @ z)

    def factorise(self, diagonal: FloatVector) -> bool:
        """Factorise with this diagonal, shape (n,), ≥ 0; return False where no regularisation helps."""
        kernels, self._diagonal = self._kernels, diagonal
        kernels.relax(self.state)
        while self._try(diagonal + self.state[kernels.NOW], self._ones) is None:
            if not kernels.regularise(self.state):
                return False
        return True

    def solve(self, right: FloatVector) -> FloatVector:
        """Return x with (M + diag(diagonal)) x = right, shape (n,), the regularisation refined away where possible."""
        return self._refined(right, self._diagonal, 0.0)[0]

    def _refined(self, right: FloatVector, diagonal: FloatVector, enough: float) -> tuple[FloatVector, float, float]:
        """Return x, refined until the error is enough, its largest error, and the largest component of `right`."""
        x = self._apply(right)
        size = float(np.max(np.abs(right), initial=0.0))
        left, error = self._left(right, diagonal, x)
        for _ in range(REFINEMENTS):
            if not max(REFINED * size, min(enough, ROUGH * size)) < error < np.inf:
                break
            better = x + self._apply(left)
            left, smaller = self._left(right, diagonal, better)
            if not smaller < error:
                break
            x, error = better, smaller
        return x, error, size

    def _left(self, right: FloatVector, diagonal: FloatVector, x: FloatVector) -> tuple[FloatVector, float]:
        """Return what x leaves of the right-hand side, and its largest magnitude."""
        self.work += float(self.M.nnz if sp.issparse(self.M) else self.M.size)
        left = right - self.M @ x - diagonal * x
        return left, float(np.max(np.abs(left), initial=0.0))

    def _try(self, shifted: FloatVector, right: FloatVector) -> FloatVector | None:
        """Factorise M + diag(shifted); return its answer to one right-hand side, None where it is useless."""
        raise NotImplementedError

    def _apply(self, right: FloatVector) -> FloatVector:
        """Return the factor's answer to one right-hand side."""
        raise NotImplementedError


class DenseNewtonMatrix(NewtonMatrix):
    """Cholesky where M is symmetric, two of them where signs make it so, else LU; in one array that is used again."""

    def __init__(self, M: FloatVector, is_symmetric: bool, signs: FloatVector | None = None) -> None:
        super().__init__(M.shape[0], M)
        self._factorise, self._share = (cholesky, 6.0) if is_symmetric else (dense_lu, 3.0)
        if signs is not None:
            self.signs = read_only(signs)
            positive = int(np.count_nonzero(signs > 0.0))
            if (signs[:positive] > 0.0).all():
                self._factorise, self._share = partial(quasidefinite, positive=positive), 6.0
        self._buffer = np.empty_like(M)
        self._factor: Any = None

    def _try(self, shifted: FloatVector, right: FloatVector) -> FloatVector | None:
        np.copyto(self._buffer, self.M)
        self._buffer.flat[:: self.n + 1] += shifted
        self._factor = self._factorise(self._buffer, overwrite=True)
        self.work += self.n**3 / self._share
        if self._factor is None and self._factorise not in (cholesky, dense_lu):
            self._factorise, self._share = dense_lu, 3.0  # rounding left a block indefinite, which pivots mend
            return self._try(shifted, right)
        return None if self._factor is None else self._apply(right)

    def _apply(self, right: FloatVector) -> FloatVector:
        self.work += self._factor.solve_work
        x: FloatVector = self._factor.solve(right)
        return x


def quasidefinite(matrix: FloatVector, positive: int, *, overwrite: bool = False) -> Factor | None:
    """Return a factor of [[P, Aᵀ], [−A, Q]], P and Q positive definite and P of so many rows; None where one is not.

    Of P and Q the upper triangle is read, and Aᵀ.

    Examples
    --------
    >>> quasidefinite(np.array([[2.0, 1.0], [-1.0, 1.0]]), 1).solve(np.array([3.0, 0.0]))
    array([1., 1.])
    """
    from scipy.linalg import lapack

    n = matrix.shape[0]
    mirrored = matrix.T if overwrite else matrix.T.copy(order="F")
    mirrored[positive:, positive:] *= -1.0
    require_seconds(n**3 / 3.0 / DENSE_OPERATIONS)
    C = signed_cholesky(mirrored, positive)
    if C is None:
        return None

    def solve(right: Any) -> Any:
        y = np.array(right)
        y[positive:] *= -1.0
        y = lapack.dtrtrs(C, y, lower=1, overwrite_b=1)[0]
        y[positive:] *= -1.0
        return lapack.dtrtrs(C, y, lower=1, trans=1, overwrite_b=1)[0]

    def solve_transposed(right: Any) -> Any:
        signs = np.where(np.arange(n) < positive, 1.0, -1.0)
        return signs * solve(signs * right)

    return Factor("Cholesky", solve, solve_transposed, n**3 / 6.0, float(n * n))


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
    from scipy.linalg import blas, lapack

    rest, info = -matrix[positive:, positive:], 0
    if positive:
        above, info = lapack.dpotrf(matrix[:positive, :positive], lower=1, clean=0)
        matrix[:positive, :positive] = above
    if positive and rest.size and not info:
        across = blas.dtrsm(1.0, above, matrix[positive:, :positive], side=1, lower=1, trans_a=1)
        matrix[positive:, :positive] = across
        rest = blas.dsyrk(1.0, across, 1.0, rest, lower=1)
    if rest.size and not info:
        matrix[positive:, positive:], info = lapack.dpotrf(rest, lower=1, clean=0)
    return None if info else matrix


class SparseNewtonMatrix(NewtonMatrix):
    """LU by SuperLU, ordered once by the pattern of M + Mᵀ, pivots from the diagonal.

    The symmetric part of M + diag is positive definite, so every pivot on the diagonal is positive. Where a solve shows
    a factor to be useless, pivoting is allowed. With signs it is from the start, and with full pivoting no factor is
    called useless: what rounding leaves in rows of huge diagonals, which are at their bounds, hides the others.
    """

    def __init__(self, M: sp.csr_array, signs: FloatVector | None = None) -> None:
        super().__init__(M.shape[0], M)
        self._is_trusted = signs is not None
        if signs is not None:
            self.signs = read_only(signs)
        self._arrange(np.arange(self.n))
        self._factor: Any = None
        self._factor_order = self._order
        self._factor_work = 0.0
        self._pivoting = 1 if self._is_trusted else 0

    def _arrange(self, order: Any) -> None:
        """Put rows and columns in this order, every entry of the diagonal stored."""
        self._order, self._own_diagonal = order, self.M.diagonal()[order]
        stored = sp.diags_array(1.0 + np.abs(self._own_diagonal))
        self._rows = sp.csr_array(self.M[order][:, order] + stored)
        self._rows.sort_indices()
        self._places = np.flatnonzero(row_numbers(self._rows) == self._rows.indices)

    def _try(self, shifted: FloatVector, right: FloatVector) -> FloatVector | None:
        for pivoting in range(self._pivoting, len(PIVOTS)):
            self._rows.data[self._places] = self._own_diagonal + shifted[self._order]
            is_first = not self._factor_work
            try:  # CSR of the matrix is CSC of its transpose
                self._factor = sparse_lu(
                    self._rows.T, permc_spec="MMD_AT_PLUS_A" if is_first else "NATURAL",
                    diag_pivot_thresh=PIVOTS[pivoting], options={"SymmetricMode": PIVOTS[pivoting] < 1.0},
                )
            except RuntimeError:
                continue
            self._factor_order = self._order
            if is_first:  # rows and columns stay in the order that was found
                self._factor_work = sparse_work(self._factor)
                self._arrange(np.argsort(self._factor.perm_c))
            self.work += self._factor_work
            x = self._apply(right)
            sizes = [float(np.max(np.abs(values), initial=0.0)) for values in (right, x)]
            is_useful = self._left(right, shifted, x)[1] <= max(USEFUL * sizes[0], STABLE * sizes[1])
            if is_useful or (self._is_trusted and pivoting == len(PIVOTS) - 1):
                self._pivoting = pivoting
                return x
        return None

    def _apply(self, right: FloatVector) -> FloatVector:
        self.work += float(self._factor.nnz)
        x = np.empty_like(right)
        x[self._factor_order] = self._factor.solve(right[self._factor_order], trans="T")
        return x
