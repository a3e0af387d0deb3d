"""What a Newton run remembers: where it is, the best iterate, and the active sets it has solved."""

from __future__ import annotations

import math

import numpy as np

from ...certificates.row_residuals import scaled_residual
from ...checks import BoolVector, FloatVector
from ...matrix.free_systems import FreeSystem
from ...problem.lcp import LCP
from ..base import Step
from .active_set import ActiveSetSolution, signature, solve_active_set

LARGE = 3000  # on more rows than this, steps that gain little are given up early: each costs a factorisation
LARGE_PATIENCE = 20


class NewtonState:
    """The iterate z with w = M z + q, the best z so far, and the work since the last step.

    Attributes
    ----------
    best_z : ndarray, shape (n,)
        The best so far; it may be outside the bounds.
    best : float
        ‖r(best_z)‖∞, the numerator of the relative residual.
    inside_z, inside : ndarray, shape (n,), and float
        The best so far of the iterates projected onto the bounds, and its ‖r‖∞: what a step tells.
    """

    def __init__(self, problem: LCP, z: FloatVector) -> None:
        self.problem = problem
        self.scale = problem.residual_scale
        self.entries = max(problem.nonzeros, 1)
        self.work = 0.0
        self.best = self.inside = math.inf
        self.best_z = self.inside_z = z
        self._solved: set[bytes] = set()
        self._system: FreeSystem | None = None
        self.move(z)

    def move(self, z: FloatVector) -> None:
        """Go to z, and keep it, and its projection, where it is the best so far."""
        self.z, self.w = z, self.slack(z)
        residual = self.residual = self._residual(z, self.w)
        size = float(np.max(residual, initial=0.0))
        if size < self.best or not self._solved:
            self.best, self.best_z = size, z
        inside = np.clip(z, self.problem.lower, self.problem.upper)
        if not np.array_equal(inside, z):
            size = float(np.max(self._residual(inside, self.slack(inside)), initial=0.0))
        if size < self.inside or not self._solved:
            self.inside, self.inside_z = size, inside

    @property
    def is_large(self) -> bool:
        """Whether steps without clear gain are given up after LARGE_PATIENCE."""
        return self.problem.n > LARGE

    def _residual(self, z: FloatVector, w: FloatVector) -> FloatVector:
        with np.errstate(all="ignore"):
            size: FloatVector = np.abs(scaled_residual(self.problem, z, w))
        return size

    def slack(self, z: FloatVector) -> FloatVector:
        """Return M z + q, counted as work."""
        self.work += 1.0
        with np.errstate(all="ignore"):
            return self.problem.slack(z)

    def step(self) -> Step:
        """Return the best iterate as a step, with the work since the last one."""
        work, self.work = self.work, 0.0
        return Step(self.inside_z, self.inside, work=work)

    def is_known(self, at_lower: BoolVector, at_upper: BoolVector) -> bool:
        """Return whether this active set has been solved before."""
        return signature(at_lower, at_upper) in self._solved

    def solve(self, at_lower: BoolVector, at_upper: BoolVector) -> ActiveSetSolution | None:
        """Return the solution that belongs to an active set; z says which one where its block is singular."""
        self._solved.add(signature(at_lower, at_upper))
        solution = solve_active_set(self.problem, at_lower, at_upper, near=self.z, system=self._system)
        if solution is not None:
            self._system = solution.system
            self.work += solution.work
        return solution
