"""A point of a least squares problem within bounds, and factors that solve it on the free columns of a point.

Factors are those of AᵀA, the normal equations. Its condition is that of A squared: what it solves is a *correction*,
and where A has the last word the factor is only a preconditioner of conjugate gradients with A itself.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sp

from ...core.checks import BoolVector, FloatVector
from ...core.kernels.floats import EPSILON
from ...systems.factors import LARGEST_DENSE, cholesky, factor_fits, factorise
from .data import ROWS, ScaledLeastSquares

Solve = Callable[[FloatVector], FloatVector]

LOOKED_AT = 100  # columns of AᵀA, which tell how many entries it has
LARGER = 3.0  # entries of AᵀA by those of A: one that is symmetric could be kept in half of them
SHIFT = 8.0 * EPSILON  # of columns of unit length, so that the factor of a singular AᵀA is one
GROWTH = 16.0  # of the shift where rounding left no factor
LARGEST_SHIFT = 1e-3
DUAL_SHIFT = 1e-12  # for more columns than rows, where the formula of the inverse divides rounding by it
MOST_STEPS = 30
RANK = 4.0 * EPSILON  # times the larger dimension: singular values below this share of the largest are 0
ROUNDING = 4.0 * EPSILON  # of the largest gradient there could be


def clipped(x: FloatVector, lower: FloatVector, upper: FloatVector) -> FloatVector:
    """Return mid(lower, upper, x), sooner than numpy does for short vectors."""
    return np.minimum(np.maximum(x, lower), upper)


class FacePoint:
    """A point within the bounds.

    Parameters
    ----------
    problem : ScaledLeastSquares
    x : array, shape (n,)
        Within the bounds.
    residual : array, shape (m,), optional
        A x − b where it is known.

    Attributes
    ----------
    slope : ndarray, shape (n,)
        Aᵀ(A x − b) + ridge x.
    gradient : ndarray, shape (n,)
        That and what the penalty l1 adds in the problem's orthant.
    dual : ndarray, shape (m,), or None
        What stands for A x − b in the caller's units where rounding of x leaves that too little, if somebody has it.
    """

    def __init__(
        self, problem: ScaledLeastSquares, x: FloatVector, residual: FloatVector | None = None,
        dual: FloatVector | None = None,
    ) -> None:
        self.problem, self.x, self.dual = problem, x, dual
        self.residual = problem.product(x) - problem.b if residual is None else residual
        self.slope = problem.transposed(self.residual) + problem.ridge * x
        self.gradient = self.slope + problem.linear

    @cached_property
    def cost(self) -> float:
        """What is minimised."""
        quadratic = self.residual @ self.residual + (self.problem.ridge * self.x) @ self.x
        return float(0.5 * quadratic + self.problem.l1 @ np.abs(self.x))

    @cached_property
    def is_free(self) -> BoolVector:
        """Which columns are strictly between their bounds."""
        return (self.x > self.problem.lower) & (self.x < self.problem.upper)

    @cached_property
    def free_gradient(self) -> FloatVector:
        """The gradient on the free columns, 0 elsewhere."""
        return np.where(self.is_free, self.gradient, 0.0)

    @cached_property
    def pull(self) -> FloatVector:
        """The gradient where it pulls a column away from its bound into the box, 0 elsewhere."""
        may_rise, may_fall = self.x < self.problem.upper, self.x > self.problem.lower
        rising, falling = np.minimum(self.gradient, 0.0), np.maximum(self.gradient, 0.0)
        inward = np.where(may_rise, rising, np.where(may_fall, falling, 0.0))
        return np.where(self.is_free, 0.0, inward)

    @cached_property
    def natural_residual(self) -> FloatVector:
        """What is left of x less mid(lower, upper, x − gradient): 0 exactly at the minimum."""
        return clipped(self.gradient, self.x - self.problem.upper, self.x - self.problem.lower)

    @cached_property
    def pull_across(self) -> float:
        """How hard a column at 0 is pulled to the side of it that is not in the problem's orthant, 0 where none is."""
        problem = self.problem
        at_kink = problem.has_kink & (self.x == 0.0)
        across = np.where(problem.upper == 0.0, -self.slope, self.slope) - problem.l1
        return float(np.max(across, initial=0.0, where=at_kink))

    @property
    def size_of_residual(self) -> float:
        """The largest natural residual, beyond the orthant as well."""
        return max(float(np.abs(self.natural_residual).max(initial=0.0)), self.pull_across)

    def steepness(self, reference: tuple[float, float]) -> float:
        """Return the larger natural residual, in the caller's units and in these, beside the reference of each."""
        from .sums import largest_residuals

        unit, slope = self.problem.whole, self.slope
        scaled, plain, _ = largest_residuals(
            slope, slope, self.x, unit.lower, unit.upper, unit.l1, unit.inverse_columns, False
        )
        sizes = plain * unit.size, scaled * unit.size
        return max(size / least if least > 0.0 else np.inf if size else 0.0
                   for size, least in zip(sizes, reference, strict=True))

    @property
    def noise(self) -> float:
        """Up to where a gradient may be nothing but rounding."""
        sizes = np.linalg.norm(self.residual) + np.linalg.norm(self.x) + np.linalg.norm(self.problem.b)
        return ROUNDING * float(sizes)

    def curvature(self, direction: FloatVector, product: FloatVector) -> float:
        """Return dᵀ(AᵀA + ridge)d for a direction d and A d."""
        return float(product @ product + (self.problem.ridge * direction) @ direction)

    def moved(self, direction: FloatVector, product: FloatVector, length: float) -> FacePoint:
        """Return the point at x + length · direction, which is within the bounds but for rounding."""
        x = clipped(self.x + length * direction, self.problem.lower, self.problem.upper)
        return FacePoint(self.problem, x, self.residual + length * product)

    def farthest(self, direction: FloatVector) -> float:
        """Return how far one may go along the direction before a bound stops it."""
        slack = np.where(direction > 0.0, self.problem.upper - self.x, self.problem.lower - self.x) / direction
        return float(np.min(slack, initial=np.inf, where=direction != 0.0))

    def rise(self, direction: FloatVector, product: FloatVector) -> float:
        """Return by how much the cost rises at x + d, of d and A d; costs themselves would cancel."""
        return float(self.gradient @ direction) + 0.5 * self.curvature(direction, product)

    def projected(self, direction: FloatVector, product: FloatVector) -> FacePoint:
        """Return the better of x + direction, projected onto the bounds, and the first bound on the way there."""
        length = min(self.farthest(direction), 1.0)
        bent = clipped(self.x + direction, self.problem.lower, self.problem.upper) - self.x
        bent_product = self.problem.product(bent)
        if self.rise(bent, bent_product) < self.rise(length * direction, length * product):
            return self.moved(bent, bent_product, 1.0)
        return self.moved(direction, product, length)


class Faces:
    """Factors of A_FᵀA_F + D for free columns F and a diagonal D ≥ 0.

    Parameters
    ----------
    problem : ScaledLeastSquares
    matrix : array, shape (n, n) or (m, n)
        AᵀA, sparse or not; or A itself where it is dense and has fewer rows than columns.
    is_wide : bool
        Whether it is A.
    """

    def __init__(self, problem: ScaledLeastSquares, matrix: Any, *, is_wide: bool = False) -> None:
        self.problem, self.matrix, self.is_wide = problem, matrix, is_wide

    @classmethod
    def of(cls, problem: ScaledLeastSquares) -> Faces | None:
        """Return the faces; None where a factor would be too large, overflows, or time ended before."""
        m, n = problem.problem.shape
        is_sparse = problem.problem.is_sparse and not problem.problem.is_cheap_to_copy
        if _is_filling(problem.entries()) if is_sparse else n > LARGEST_DENSE:
            return None
        if m < n and not is_sparse:
            return cls(problem, problem.dense(), is_wide=True)
        gram = problem.gram()
        has_factor = np.isfinite(gram.data if is_sparse else gram).all() and (not is_sparse or factor_fits(gram))
        return cls(problem, gram) if has_factor else None

    def product(self, d: FloatVector) -> FloatVector:
        """Return (AᵀA + ridge) d."""
        product: FloatVector = self.matrix.T @ (self.matrix @ d) if self.is_wide else self.matrix @ d
        return product + self.problem.ridge * d

    def factor(self, columns: Any, diagonal: FloatVector) -> Solve | None:
        """Return r ↦ (A_FᵀA_F + ridge + D)⁻¹ r for F = `columns`, D no less than a shift that leaves a factor."""
        if not columns.size:
            return np.copy
        shift = DUAL_SHIFT if self.is_wide and columns.size > self.matrix.shape[0] else SHIFT
        while shift <= LARGEST_SHIFT:
            solve = self._factor(columns, np.maximum(diagonal + self.problem.ridge[columns], shift))
            if solve is not None:
                return solve
            shift *= GROWTH
        return None

    def _factor(self, columns: Any, diagonal: FloatVector) -> Solve | None:
        if sp.issparse(self.matrix):
            block = sp.csr_array(self.matrix[columns][:, columns] + sp.diags_array(diagonal))
            factor = factorise(block, is_symmetric=True)
        elif not self.is_wide:
            is_all = columns.size == self.matrix.shape[0]
            block = self.matrix.copy() if is_all else self.matrix.take(columns, 0).take(columns, 1)
            factor = _positive(block, diagonal)
        elif columns.size <= self.matrix.shape[0]:
            free = self.matrix[:, columns]
            factor = _positive(free.T @ free, diagonal)
        else:
            return self._dual_factor(self.matrix[:, columns], diagonal)
        return None if factor is None else factor.solve

    def _dual_factor(self, free: FloatVector, diagonal: FloatVector) -> Solve | None:
        """Return the same by the smaller I + A_F D⁻¹ A_Fᵀ (Sherman, Morrison, Woodbury)."""
        scaled = free / diagonal
        factor = _positive(scaled @ free.T, np.ones(free.shape[0]))
        if factor is None:
            return None
        return lambda right: right / diagonal - scaled.T @ factor.solve(scaled @ right)

    def correction(self, point: FacePoint, free: BoolVector) -> FloatVector | None:
        """Return d, 0 but on the free columns, that minimises the cost at x + d; None where that cannot be had.

        Conjugate gradients with A converge in a few steps, as the factor is one of AᵀA up to rounding.
        """
        columns, correction = np.flatnonzero(free), np.zeros(free.size)
        solve = self.factor(columns, np.zeros(columns.size))
        if solve is None:
            return None
        left, direction, size = -point.gradient[columns], np.zeros(free.size), 0.0
        for _ in range(MOST_STEPS):
            solved = solve(left)
            before, size = size, float(left @ solved)
            if size == 0.0:
                return correction
            if not 0.0 < size < np.inf:
                break
            direction[columns] = solved + (size / before if before > 0.0 else 0.0) * direction[columns]
            product = self.problem.product(direction)
            curvature = point.curvature(direction, product)
            if not curvature > 0.0:
                break
            correction += (size / curvature) * direction
            gradient = self.problem.transposed(product) + self.problem.ridge * direction
            left = left - (size / curvature) * gradient[columns]
            if not np.abs(left).max() > point.noise:
                return correction
        m, n = self.problem.problem.shape
        if not sp.issparse(self.matrix) and m <= ROWS * n:
            correction[columns] = self._orthogonal(point, columns)
        return correction if np.isfinite(correction).all() else None

    def _orthogonal(self, point: FacePoint, columns: Any) -> FloatVector | float:
        """Return the shortest correction by an orthogonal factor, for an A of which AᵀA says too little."""
        from scipy.linalg import LinAlgError, lstsq

        problem = self.problem
        block, right, root = problem.dense()[:, columns], -point.residual, np.sqrt(problem.ridge[columns])
        if root.any():
            block, right = np.vstack([block, np.diag(root)]), np.concatenate([right, -root * point.x[columns]])
        try:
            rank_below = RANK * max(block.shape)
            shortest: FloatVector = lstsq(block, right, rank_below, lapack_driver="gelsy", check_finite=False)[0]
        except (LinAlgError, ValueError):
            return np.nan
        return shortest


def _positive(matrix: FloatVector, diagonal: FloatVector) -> Any:
    matrix.flat[:: matrix.shape[0] + 1] += diagonal
    return cholesky(matrix, overwrite=True)


def _is_filling(entries: Any) -> bool:
    """Return whether AᵀA has too many more entries than A, about."""
    n = entries.shape[1]
    looked_at = np.unique(np.linspace(0, n - 1, min(n, LOOKED_AT)).astype(np.intp))
    size = (entries.T @ entries[:, looked_at]).nnz * n / max(looked_at.size, 1)
    return bool(size > LARGER * entries.nnz + n)
