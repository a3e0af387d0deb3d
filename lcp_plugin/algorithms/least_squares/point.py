"""A point of a least squares problem within bounds, with what every method wants to know of it."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from ...checks import BoolVector, FloatVector
from ...kernels.floats import EPSILON
from ...problem.least_squares import UnitLeastSquares

ROUNDING = 4.0 * EPSILON  # of the largest gradient there could be


class Point:
    """A point within the bounds.

    Parameters
    ----------
    problem : UnitLeastSquares
    x : array, shape (n,)
        Within the bounds.
    residual : array, shape (m,), optional
        A x − b where it is known.

    Attributes
    ----------
    gradient : ndarray, shape (n,)
        Aᵀ(A x − b) + ridge x.
    """

    def __init__(self, problem: UnitLeastSquares, x: FloatVector, residual: FloatVector | None = None) -> None:
        self.problem, self.x = problem, x
        self.residual = problem.product(x) - problem.b if residual is None else residual
        self.gradient = problem.transposed(self.residual) + problem.ridge * x

    @cached_property
    def cost(self) -> float:
        """What is minimised."""
        return float(0.5 * (self.residual @ self.residual + (self.problem.ridge * self.x) @ self.x))

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
        return np.clip(self.gradient, self.x - self.problem.upper, self.x - self.problem.lower)

    @property
    def noise(self) -> float:
        """Up to where a gradient may be nothing but rounding."""
        sizes = np.linalg.norm(self.residual) + np.linalg.norm(self.x) + np.linalg.norm(self.problem.b)
        return ROUNDING * float(sizes)

    def curvature(self, direction: FloatVector, product: FloatVector) -> float:
        """Return dᵀ(AᵀA + ridge)d for a direction d and A d."""
        return float(product @ product + (self.problem.ridge * direction) @ direction)

    def moved(self, direction: FloatVector, product: FloatVector, length: float) -> Point:
        """Return the point at x + length · direction, which is within the bounds but for rounding."""
        x = np.clip(self.x + length * direction, self.problem.lower, self.problem.upper)
        return Point(self.problem, x, self.residual + length * product)

    def farthest(self, direction: FloatVector) -> float:
        """Return how far one may go along the direction before a bound stops it."""
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            room = np.where(direction > 0.0, self.problem.upper - self.x, self.problem.lower - self.x) / direction
        return float(np.min(room, initial=np.inf, where=direction != 0.0))

    def rise(self, direction: FloatVector, product: FloatVector) -> float:
        """Return by how much the cost rises at x + d, of d and A d; costs themselves would cancel."""
        return float(self.gradient @ direction) + 0.5 * self.curvature(direction, product)

    def projected(self, direction: FloatVector, product: FloatVector) -> Point:
        """Return the better of x + direction, projected onto the bounds, and the first bound on the way there."""
        length = min(self.farthest(direction), 1.0)
        bent = np.clip(self.x + direction, self.problem.lower, self.problem.upper) - self.x
        bent_product = self.problem.product(bent)
        if self.rise(bent, bent_product) < self.rise(length * direction, length * product):
            return self.moved(bent, bent_product, 1.0)
        return self.moved(direction, product, length)
