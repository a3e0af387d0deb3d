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
from ...core.crossovers import DENSE_OPERATIONS
from ...core.deadline import require_seconds
from ...core.matrix.structure import row_numbers
from ...systems.factors import Factor, cholesky, dense_lu, sparse_lu, sparse_work
from ...systems.refinement import REFINED, REFINEMENTS, ROUGH, STABLE, USEFUL

REGULARISATION = 1e-9  # of the equilibrated matrix, on rows without a barrier term of that size
SMALLEST_REGULARISATION, LARGEST_REGULARISATION = 1e-15, 1e-4
SMALLEST = 1e-300
LARGE = 500  # rows from which on a second correction is cheap beside the factorisation
WORSE = 100.0  # times as large an error, beside its right-hand side, as before a smaller regularisation
PIVOTS = (0.0, 0.1, 1.0)  # SuperLU's thresholds, tried in order where a factor turns out useless


class NewtonMatrix:
    """M + diag(diagonal), factorised once an iteration; M itself is given, equilibrated, and not modified.

    Attributes
    ----------
    work : float
        Multiplications so far.
    enough : float
        An error of a solve that is not refined any further.
    missed : float
        The largest error that a solve has left since the last factorisation.
    share : float
        The same beside the largest component of its right-hand side.
    signs : ndarray, shape (n,)
        −1 on the rows whose z is a multiplier of others, else 1.
    """

    def __init__(self, n: int, M: Any = None) -> None:
        self.n, self.M = n, M
        self.work = 0.0
        self.signs = read_only(np.ones(self.n))
        self.regularisation = self._least = REGULARISATION
        self.missed = self.enough = 0.0
        self.share, self._share_before = 0.0, np.inf
        self._may_sharpen = self._is_easy = True
        self._diagonal = np.zeros(self.n)

    @property
    def corrections(self) -> int:
        """How many corrections towards the centre are worth their solves, beside a factorisation."""
        return 2 if self.n >= LARGE else 1

    def product(self, z: FloatVector) -> FloatVector:
        """Return M z."""
        return np.asarray(self.M @ z)

    def factorise(self, diagonal: FloatVector) -> bool:
        """Factorise with this diagonal, shape (n,), ≥ 0; return False where no regularisation helps."""
        self._diagonal, self.missed, self.share = diagonal, 0.0, 0.0
        if self._is_easy:
            self.regularisation = max(self._least, 0.01 * self.regularisation)
        self._is_easy = True
        while not self._try(diagonal + self.regularisation):
            self._may_sharpen = self._is_easy = False
            self.regularisation *= 100.0
            self._least = min(self.regularisation, REGULARISATION)
            if self.regularisation > LARGEST_REGULARISATION:
                return False
        return True

    def sharpen(self) -> None:
        """Regularise less from the next factorisation on, unless that has failed, or made matters worse, before."""
        if not self._may_sharpen:
            return
        self._may_sharpen = self.share <= WORSE * self._share_before
        self._share_before = self.share
        if self._may_sharpen:
            self._least = max(0.01 * self._least, SMALLEST_REGULARISATION)
        else:
            self._least = min(100.0 * self._least, REGULARISATION)

    def steps(
        self, vectors: FloatVector, facts: FloatVector, is_active: BoolVector, small_gap: float, most: int, settled: int
    ) -> tuple[int, int] | None:
        """Make many steps in one call, where the factor allows it: return what its kernel does, else None."""
        return None

    def solve(self, right: FloatVector) -> FloatVector:
        """Return x with (M + diag(diagonal)) x = right, shape (n,), the regularisation refined away where possible."""
        x = self._apply(right)
        size = float(np.max(np.abs(right), initial=0.0))
        left, error = self._left(right, x)
        for _ in range(REFINEMENTS):
            if not max(REFINED * size, min(self.enough, ROUGH * size)) < error < np.inf:
                break
            better = x + self._apply(left)
            left, smaller = self._left(right, better)
            if not smaller < error:
                break
            x, error = better, smaller
        self.missed, self.share = max(self.missed, error), max(self.share, error / max(size, SMALLEST))
        return x

    def _left(self, right: FloatVector, x: FloatVector) -> tuple[FloatVector, float]:
        """Return what x leaves of the right-hand side, and its largest magnitude."""
        self.work += self._entries
        left = right - self.M @ x - self._diagonal * x
        return left, float(np.max(np.abs(left), initial=0.0))

    def is_useful(self, diagonal: FloatVector) -> bool:
        """Whether a solve leaves a residual of M + diag(diagonal) that refinement can reduce."""
        x = self._apply(np.ones(self.n))
        left = float(np.max(np.abs(1.0 - self.M @ x - diagonal * x), initial=0.0))
        return left <= max(USEFUL, STABLE * float(np.max(np.abs(x), initial=0.0)))

    @property
    def _entries(self) -> float:
        return float(self.M.nnz if sp.issparse(self.M) else self.M.size)

    def _try(self, diagonal: FloatVector) -> bool:
        """Factorise M + diag(diagonal); return whether that succeeded."""
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

    def _try(self, diagonal: FloatVector) -> bool:
        np.copyto(self._buffer, self.M)
        self._buffer.flat[:: self.n + 1] += diagonal
        self._factor = self._factorise(self._buffer, overwrite=True)
        self.work += self.n**3 / self._share
        if self._factor is None and self._factorise not in (cholesky, dense_lu):
            self._factorise, self._share = dense_lu, 3.0  # rounding left a block indefinite, which pivots mend
            return self._try(diagonal)
        return self._factor is not None

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

    def _try(self, diagonal: FloatVector) -> bool:
        for pivoting in range(self._pivoting, len(PIVOTS)):
            self._rows.data[self._places] = self._own_diagonal + diagonal[self._order]
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
            if (self._is_trusted and pivoting == len(PIVOTS) - 1) or self.is_useful(diagonal):
                self._pivoting = pivoting
                return True
        return False

    def _apply(self, right: FloatVector) -> FloatVector:
        self.work += float(self._factor.nnz)
        x = np.empty_like(right)
        x[self._factor_order] = self._factor.solve(right[self._factor_order], trans="T")
        return x
