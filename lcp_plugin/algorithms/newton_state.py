"""What a Newton run remembers: where it is, the best iterate, and the active sets it has solved."""

from __future__ import annotations

import math

import numpy as np

from ..certificates.residuals import scaled_residual
from ..problem import LCP, FloatVector
from .active_set import ActiveSetSolution, BoolVector, FactorCache, signature, solve_active_set
from .base import Step

WORTH_PROJECTING = 2.0  # times the best residual within the bounds


class NewtonState:
    """The iterate z with w = M z + q, the best z so far, and the work since the last step.

    Attributes
    ----------
    best : float
        ‖r(best_z)‖∞, the numerator of the relative residual; best_z may lie outside the bounds.
    inside, inside_z
        The same of the best iterate that was projected onto the bounds: what the driver sees.
    """

    def __init__(self, problem: LCP, z: FloatVector) -> None:
        self.problem = problem
        self.scale = problem.residual_scale
        self.entries = max(problem.nonzeros, 1)
        self.work = 0.0
        self.best = math.inf
        self.best_z = z
        self.inside, self.inside_z = math.inf, z
        self._solved: set[bytes] = set()
        self._cache = FactorCache()
        self.move(z)

    def move(self, z: FloatVector) -> None:
        """Go to z, and keep it where it is the best so far."""
        self.z, self.w = z, self.slack(z)
        self.residual = self._residual(z, self.w)
        size = float(np.max(self.residual, initial=0.0))
        if size < WORTH_PROJECTING * self.inside or not self._solved:
            self._keep_inside(z, size)
        if size < self.best or not self._solved:
            self.best, self.best_z = size, z

    def _keep_inside(self, z: FloatVector, size: float) -> None:
        """Keep z, projected, where that is the best so far: neither linear systems nor line searches know of bounds."""
        inside = np.clip(z, self.problem.lower, self.problem.upper)
        if not np.array_equal(inside, z):
            size = float(np.max(self._residual(inside, self.slack(inside)), initial=0.0))
        if size < self.inside or not self._solved:
            self.inside, self.inside_z = size, inside

    def _residual(self, z: FloatVector, w: FloatVector) -> FloatVector:
        with np.errstate(all="ignore"):
            residual: FloatVector = np.abs(scaled_residual(self.problem, z, w))
        return residual

    def slack(self, z: FloatVector) -> FloatVector:
        """Return M z + q, counted as work."""
        self.work += 1.0
        with np.errstate(all="ignore"):
            return self.problem.slack(z)

    def step(self) -> Step:
        """Return the best iterate within the bounds as a step, with the work since the last one."""
        work, self.work = self.work, 0.0
        return Step(self.inside_z, self.inside, work=work)

    def is_known(self, at_lower: BoolVector, at_upper: BoolVector) -> bool:
        """Return whether this active set has been solved before."""
        return signature(at_lower, at_upper) in self._solved

    def solve(self, at_lower: BoolVector, at_upper: BoolVector) -> ActiveSetSolution | None:
        """Return the solution that belongs to an active set; z says which one where its block is singular."""
        self._solved.add(signature(at_lower, at_upper))
        solution = solve_active_set(self.problem, at_lower, at_upper, near=self.z, factor_cache=self._cache)
        self.work += 0.0 if solution is None else solution.work
        return solution
