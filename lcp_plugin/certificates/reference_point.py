"""A point so near the solution that its own bound is small: then |z − z*| ≤ |z − ẑ| + bound(ẑ) is sharp.

A bound by ⟨M⟩⁻¹|r| forgets all signs, and where ρ(D⁻¹|B|) is near 1 it exceeds |M⁻¹r| a thousand times. One step of
the active-set method keeps them: ẑ = z + δ with δ to the bound on the rows that seem active, and M_FF δ_F = −(w +
M δ)_F on the rest. Nothing has to be known about ẑ; a poor solve or a wrong guess only makes the bound larger. ẑ is
kept as a sum of two doubles, so that it can be nearer to z* than any double is.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..checks import BoolVector, FloatVector
from ..exact.upward import sum_above
from ..matrix.free_systems import KRYLOV_GOAL, FreeSystem
from ..problem.lcp import LCP
from .row_inequality import RowInequality, distance_above


class NearPoint(NamedTuple):
    """A point ẑ = high + low near the solution, and a bound y of its own error; each of shape (n,)."""

    high: FloatVector
    low: FloatVector
    y: FloatVector

    def bound(self, z: FloatVector) -> FloatVector:
        """Return |z − ẑ| + y ≥ |z − z*|; ∞ where z is not finite."""
        with np.errstate(all="ignore"):
            bound = sum_above(distance_above(self.high, self.low, z), self.y)
        return np.where(np.isnan(bound), np.inf, bound)


class ActiveSetSteps:
    """Steps of the active-set method on one problem; a factorisation serves as long as the free set stays.

    Attributes
    ----------
    system : FreeSystem
        That of the last step.
    """

    def __init__(self, problem: LCP, scale: FloatVector, *, goal: float = KRYLOV_GOAL) -> None:
        self.problem, self.scale, self.goal = problem, scale, goal
        self.system = FreeSystem(problem.matrix, np.zeros(problem.n, np.bool_))

    def next_point(self, at: RowInequality) -> RowInequality | None:
        """Return the inequality at the next point, or None where the step is not finite."""
        problem = self.problem
        w, on_lower, free = self._sides(at)
        bound = np.where(on_lower, problem.lower, problem.upper)
        delta = np.where(free, 0.0, (bound - at.high) - at.low)
        if not np.array_equal(free, self.system.free):
            self.system = FreeSystem(problem.matrix, free)
        solution = self.system.solve(-(w + problem.csr @ delta), goal=self.goal)
        if solution is None:
            return None
        delta += solution
        if not np.isfinite(delta).all():
            return None
        high = at.high + delta
        part = high - at.high
        low = (at.high - (high - part)) + (delta - part) + at.low
        return RowInequality.at(problem, np.where(free, high, bound), np.where(free, low, 0.0))

    def is_settled(self, at: RowInequality) -> bool:
        """Return whether the point, that of the last step, has the free rows of that step."""
        return np.array_equal(self._sides(at)[2], self.system.free)

    def _sides(self, at: RowInequality) -> tuple[FloatVector, BoolVector, BoolVector]:
        """Return w, the rows that it holds at their lower bounds, and those that are free."""
        w = 0.5 * (at.slack - at.negative_slack)
        step = self.scale * w  # beside a large z its own digits would be lost
        on_lower = (at.above <= step) | (self.problem.lower == self.problem.upper)
        return w, on_lower, ~(on_lower | (at.below <= -step))
