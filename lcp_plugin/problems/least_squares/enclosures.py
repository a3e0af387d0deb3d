"""Residuals and gradients of a least squares problem, with bounds of their rounding errors."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np

from ...core.checks import FloatVector
from ...core.kernels.floats import EPSILON, TINY
from ...core.matrix.matrix import Matrix
from ...core.rounding import gamma
from .data import BoundedLeastSquares

Ball = tuple[FloatVector, FloatVector]
"""Values and radii: the exact values lie within."""

OUTWARD = (
    1.0 + 2.0**-30
)  # more than the rounding of a sum of 2²⁰ terms of one sign, or of a few operations
NOTHING = np.empty(0)
GRAM_UP_TO = 3000  # columns; AᵀWA is factorized


class Enclosures:
    """Residuals and gradients of a problem with bounds of their rounding errors; estimates for a LinearOperator.

    Vectors of a stack (`BoundedLeastSquares.stack`) have an axis in front, shape (B, m) or (B, n).

    Parameters
    ----------
    problem : BoundedLeastSquares

    Attributes
    ----------
    reference : float
        A lower bound of ‖AᵀWb‖∞ in units in which columns have about unit length. If AᵀWb is 0, of the gradient at the
        point of [lower, upper] nearest to 0; if that is 0 as well, that point is a solution.
    known : list of ndarray, shape (n,)
        Points within the bounds whose cost no solution exceeds.
    """

    def __init__(self, problem: BoundedLeastSquares) -> None:
        self.problem, self.known = problem, [problem.nearest_to_zero]

    def cost_above(self, x: FloatVector) -> Any:
        """Return an upper bound of the cost of x."""
        value, radius = self.residual(x)
        return self.problem.cost(x, np.abs(value) + radius)

    @cached_property
    def unbounded_solution(self) -> FloatVector:
        """Shortest solution without bounds and l1, projected onto the bounds; A must have entries."""
        scaled = self.problem.scaled
        x = shortest_solution(*scaled.rows(is_dense=True))
        return scaled.to_caller(clip(x, scaled.lower, scaled.upper))

    def residual(self, x: FloatVector) -> Ball:
        """Return A x − b."""
        problem = self.problem
        if not problem.has_entries:
            return problem.product(x) - problem.b, np.zeros(problem.shape[0])
        return self._product(problem.A, self._sizes, x, NOTHING, problem.b, self._terms[0])

    def gradient(self, x: FloatVector, residual: Ball) -> Ball:
        """Return AᵀW(A x − b) + ridge x."""
        value, radius = self.apply_transpose(*residual)
        if not self.problem.ridge > 0.0:
            return value, radius
        added = self.problem.ridge * x
        value = value + added
        rounding = 4.0 * EPSILON * (np.abs(value) + np.abs(added))
        return value, OUTWARD * (radius + rounding + TINY * (x != 0.0))

    def gradient_at(self, x: FloatVector, y: FloatVector) -> Ball:
        """Return AᵀWy + ridge x."""
        return self.gradient(x, (y, NOTHING))

    def apply_transpose(self, y: FloatVector, slip: FloatVector) -> Ball:
        """Return AᵀWy for a y known up to slip; an empty slip means that y is exact."""
        problem = self.problem
        weighted, slip = (
            problem.apply_weights(y),
            problem.apply_weights(slip) if slip.size else slip,
        )
        if not problem.has_entries:
            return problem.apply_transpose(weighted), np.zeros(problem.shape[1])
        return self._product(problem.A.T, self._sizes.T, weighted, slip, 0.0, self._terms[1])

    def _product(
        self, B: Any, sizes: Any, v: FloatVector, slip: FloatVector, less: Any, terms: int
    ) -> Ball:
        """Return B v − less for a v known up to slip, with |B| = sizes and so many terms in a row of B."""
        size = times(sizes, np.abs(v)) + np.abs(less)
        unsure = times(sizes, slip) if slip.size else 0.0
        rounding = gamma(2 * terms + 8) * OUTWARD * (size + unsure)
        underflow = (2 * terms + 8) * TINY * (size + unsure > 0.0)
        return times(B, v) - less, rounding + OUTWARD * unsure + underflow

    @cached_property
    def reference(self) -> float:
        """The unit of residuals; see the class."""
        problem, start = self.problem, self.problem.nearest_to_zero
        value, radius = self.apply_transpose(problem.b, np.zeros(problem.shape[0]))
        if not value.any():
            value, radius = self.gradient(start, self.residual(start))
        least = np.maximum(np.abs(value) - radius, 0.0) / problem.column_scales
        return float(least.max(initial=0.0))

    @cached_property
    def convexity(self) -> FloatVector | None:
        """A d > 0, shape (n,), with AᵀWA + ridge − diag(d) proved positive semidefinite, or None."""
        from ...proofs.bounds.solution_bounds import smallest_eigenvalue_bound

        problem, n = self.problem, self.problem.shape[1]
        if not problem.has_entries or not 0 < n <= min(GRAM_UP_TO, problem.shape[0]):
            return None
        scaled = problem.scaled
        A = scaled.matrix(is_dense=problem.is_small)
        gram = A.T @ A
        dense: Any = gram if problem.is_dense or problem.is_small else gram.toarray()
        dense.flat[:: n + 1] += scaled.ridge
        if not np.isfinite(dense).all():
            return None
        terms = problem.shape[0] + 16
        # Columns are shorter than 2: no entry is wrong by more than 4 γ, nor an eigenvalue by more than n times that.
        slip = 8.0 * n * (gamma(2 * terms) + EPSILON)
        bound = smallest_eigenvalue_bound(Matrix(0.5 * (dense + dense.T)))
        if bound is None:
            return None
        least = bound.value - slip * float(bound.scale.max()) ** 2
        return (
            least * (1.0 - 2.0**-40) * (problem.column_scales / bound.scale) ** 2
            if least > 0.0
            else None
        )

    @cached_property
    def _sizes(self) -> Any:
        return abs(self.problem.A)

    @cached_property
    def _terms(self) -> tuple[int, int]:
        """Largest number of terms in a row sum, and in a column sum."""
        A, (m, n) = self.problem.A, self.problem.shape
        if not self.problem.is_sparse:
            return n, m
        of_columns = np.bincount(A.indices, minlength=1)
        return int(np.diff(A.indptr).max(initial=0)), int(of_columns.max())


def shortest_solution(A: FloatVector, b: FloatVector) -> FloatVector:
    """Return the shortest x of least ‖A x − b‖; singular values below max(m, n) ε of the largest are 0."""
    from scipy.linalg import lstsq

    x: FloatVector = lstsq(A, b, max(A.shape) * EPSILON, check_finite=False, lapack_driver="gelsy")[
        0
    ]
    return x


def times(B: Any, v: FloatVector) -> FloatVector:
    """Return B v, for each row of v if v has two axes."""
    product: FloatVector = B @ v if v.ndim == 1 else v @ B.T
    return product


def clip(x: FloatVector, lower: FloatVector, upper: FloatVector) -> FloatVector:
    """Return mid(lower, upper, x), sooner than numpy does for short vectors."""
    return np.minimum(np.maximum(x, lower), upper)
