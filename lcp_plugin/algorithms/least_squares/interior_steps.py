"""Interior points: they find the face where A is too ill-conditioned for other steps.

With multipliers y, v > 0 of the finite bounds and Θ = y/(x − lower) + v/(upper − x), a step solves
(AᵀA + ridge + Θ) d = c − gradient; predictor and corrector (Mehrotra) share the factor. A point is shown with the
columns at their bounds whose multipliers exceed their distances.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ...checks import FloatVector
from ...kernels.floats import EPSILON
from .faces import Faces, Solve
from .point import Point

START = 0.1  # first distances from the bounds and first multipliers, ÷ the largest x and gradient
TO_THE_BOUND = 0.995  # of the way
SMALLEST_STEP = 1e-8  # a shorter one leads nowhere
PRECISION = EPSILON**2  # complementarity, ÷ that of the start, from which on rounding decides
STEPS = 100
SIGNS = np.array([[1.0], [-1.0]])  # of a step of x in the distances from its lower and upper bound


def interior_steps(start: Point, faces: Faces) -> Iterator[Point]:
    """Yield points from the start on; ends where rounding decides which columns are free."""
    yield start
    state = _Interior(start, faces)
    first = state.complementarity()
    for _ in range(STEPS):
        if not state.step():
            return
        yield state.rounded()
        if not state.complementarity() > PRECISION * first:
            return


class _Interior:
    """x strictly within its bounds; the rows of what belongs to bounds are for the lower and the upper ones."""

    def __init__(self, point: Point, faces: Faces) -> None:
        problem = self.problem = point.problem
        self.faces, may_move = faces, problem.lower < problem.upper
        distance = START * max(float(np.abs(point.x).max(initial=0.0)), 1.0)
        room = np.minimum(0.25 * (problem.upper - problem.lower), distance)
        self.x = np.where(may_move, np.clip(point.x, problem.lower + room, problem.upper - room), problem.lower)
        self.columns = np.flatnonzero(may_move)
        self.has = np.isfinite([problem.lower, problem.upper]) & may_move
        multiplier = START * float(np.abs(point.gradient).max(initial=0.0)) + EPSILON
        slopes = np.maximum(SIGNS * point.gradient, 0.0) + multiplier * distance / self.distances
        self.multipliers = np.where(self.has, slopes, 0.0)

    @property
    def distances(self) -> FloatVector:
        """How far x is from its finite bounds, 1 where there is none, shape (2, n)."""
        return np.where(self.has, [self.x - self.problem.lower, self.problem.upper - self.x], 1.0)

    def complementarity(self, d: FloatVector | float = 0.0, slopes: FloatVector | float = 0.0) -> float:
        """Return the mean product of a distance and its multiplier, after a step where one is given."""
        products = (self.distances + SIGNS * d) * (self.multipliers + slopes)
        return float(products[self.has].sum()) / max(int(self.has.sum()), 1)

    def step(self) -> bool:
        """Move on; return whether that led anywhere."""
        factor = self._factor()
        if factor is None:
            return False
        self.gradient = Point(self.problem, self.x).gradient
        mean = self.complementarity()
        d, slopes = self._direction(factor, np.zeros_like(self.multipliers))
        length = min(1.0, self._farthest(d, slopes))
        centre = (self.complementarity(length * d, length * slopes) / mean) ** 3 * mean if mean > 0.0 else 0.0
        d, slopes = self._direction(factor, centre - SIGNS * d * slopes)
        length = min(1.0, TO_THE_BOUND * self._farthest(d, slopes))
        if not (np.isfinite(d).all() and length > SMALLEST_STEP):
            return False
        self.x, self.multipliers = self.x + length * d, self.multipliers + length * slopes
        return True

    def _factor(self) -> Solve | None:
        """Return the factor of AᵀA + ridge + Θ, or None where it overflows."""
        bend = (self.multipliers / self.distances).sum(axis=0)[self.columns]
        return self.faces.factor(self.columns, bend) if np.isfinite(bend).all() else None

    def _direction(self, solve: Solve, targets: FloatVector) -> tuple[FloatVector, FloatVector]:
        """Return the steps of x and of the multipliers that bring their products to the targets, to first order."""
        distances, d = self.distances, np.zeros(self.x.size)
        pull = np.where(self.has, SIGNS * targets / distances, 0.0).sum(axis=0)
        d[self.columns] = solve((pull - self.gradient)[self.columns])
        slopes = (targets - SIGNS * self.multipliers * d) / distances - self.multipliers
        return d, np.where(self.has, slopes, 0.0)

    def _farthest(self, d: FloatVector, slopes: FloatVector) -> float:
        """Return the largest step that leaves distances and multipliers ≥ 0."""
        far = np.inf
        for values, steps in ((self.distances, SIGNS * d), (self.multipliers, slopes)):
            falls = self.has & (steps < 0.0)
            far = min(far, float(np.min(-values[falls] / steps[falls], initial=np.inf)))
        return far

    def rounded(self) -> Point:
        """Return the point with the columns at a bound whose multipliers exceed their distances from it."""
        at_lower, at_upper = self.has & (self.multipliers > self.distances)
        problem = self.problem
        x = np.where(at_lower, problem.lower, np.where(at_upper, problem.upper, self.x))
        return Point(problem, np.clip(x, problem.lower, problem.upper))
