"""Active sets: their identification, their linear system, and the state of a run."""

from __future__ import annotations

import math
from hashlib import blake2b
from typing import NamedTuple

import numpy as np

from ...core.algorithm import Step
from ...core.certificates.criterion import measured_residual, scaled_residual
from ...core.checks import BoolVector, FloatVector
from ...core.lcp import LCP
from ...systems.factors import factor_operations
from ...systems.free_systems import FreeSystem

LARGE_PATIENCE = 20


class ActiveSetSolution(NamedTuple):
    """Solution for an active set.

    Attributes
    ----------
    z : ndarray, shape (n,)
        At its bound on the active rows; w = 0 on the free rows, as well as can be.
    system : FreeSystem
        The system of the free rows, for another call with the same M.
    work : float
        Matrix entries touched, including the factorization, divided by the nonzeros of M.
    """

    z: FloatVector
    system: FreeSystem
    work: float

    @property
    def is_singular(self) -> bool:
        """True if the free block is singular to working precision: z is one of many solutions, or not a solution."""
        return self.system.is_singular


def classify(problem: LCP, z: FloatVector, w: FloatVector) -> tuple[BoolVector, BoolVector]:
    """Return (at_lower, at_upper), the bounds that z − w/d reaches or passes, d the residual scale, shape (n,) each.

    Parameters
    ----------
    z, w : ndarray, shape (n,)
        A row with equal bounds is at its lower one.

    Examples
    --------
    >>> problem = LCP([[2, 1], [1, 2]], [-5, 1])
    >>> at_lower, at_upper = classify(problem, np.array([2.5, 0.0]), np.array([0.0, 3.5]))
    >>> at_lower
    array([False,  True])
    """
    step = w / problem.residual_scale
    # z − step ≤ lower, written so that a small step is not lost next to a large z.
    at_lower = z - problem.lower <= step
    at_upper = (problem.upper - z <= -step) & ~at_lower
    is_fixed = problem.lower == problem.upper
    return at_lower | is_fixed, at_upper & ~is_fixed


def is_near(problem: LCP, z: FloatVector) -> bool:
    """Return whether the residual of z is at most a tenth of the residual of the default start."""
    # The active set of such a near start is likely the active set of the solution.
    return bool(
        measured_residual(problem, z) <= 0.1 * measured_residual(problem, problem.nearest_to_zero)
    )


def signature(at_lower: BoolVector, at_upper: BoolVector) -> bytes:
    """Return a short key of an active set, for the detection of cycles."""
    packed = np.packbits(at_lower).tobytes() + np.packbits(at_upper).tobytes()
    return blake2b(packed, digest_size=16).digest()


def solve_active_set(
    problem: LCP,
    at_lower: BoolVector,
    at_upper: BoolVector,
    *,
    near: FloatVector | None = None,
    system: FreeSystem | None = None,
) -> ActiveSetSolution | None:
    """Return z with z at its bounds on the active rows and w = 0 on the free rows; None if the solve overflows.

    Parameters
    ----------
    at_lower, at_upper : ndarray of bool, shape (n,)
        The active rows; the bounds there are finite.
    near : ndarray, shape (n,), optional
        Target if the free block is singular: a solution close to this z is computed; 0 by default.
    system : FreeSystem, optional
        System of an earlier call with the same M, used if its rows are the free rows.

    Notes
    -----
    One factorization of the free block, see :meth:`.FreeSystem.solve_near`. The result is not tested: measure the
    residual of z.

    Examples
    --------
    >>> problem = LCP([[2, 1], [1, 2]], [-5, 1])
    >>> solve_active_set(problem, np.array([False, True]), np.array([False, False])).z
    array([2.5, 0. ])
    """
    z = np.where(at_lower, problem.lower, np.where(at_upper, problem.upper, 0.0))
    free = ~(at_lower | at_upper)
    if system is None or not np.array_equal(free, system.free):
        system = FreeSystem(problem.matrix, free, by_factor=True)
    before = system.work
    x = system.solve_near(-problem.slack(z), np.zeros(problem.n) if near is None else near)
    if x is None or not np.isfinite(z).all():
        return None
    return ActiveSetSolution(z + x, system, 1.0 + (system.work - before) / max(problem.nonzeros, 1))


def polish_active_set(problem: LCP, z: FloatVector, most_work: float) -> ActiveSetSolution | None:
    """Return the solution of the linear system of the active set of z.

    The result is None if the block is singular, so that z is not unique, or if a factorization would take more passes
    over M than `most_work`.

    Examples
    --------
    >>> polish_active_set(LCP([[2, 1], [1, 2]], [-5, 1]), np.array([2.4, 0.1]), 100.0).z
    array([2.5, 0. ])
    """
    at_lower, at_upper = classify(problem, z, problem.slack(z))
    system = FreeSystem(problem.matrix, ~(at_lower | at_upper), by_factor=True)
    most = most_work * max(problem.nonzeros, 1)
    if factor_operations(system.principal, most) > most or system.is_singular:
        return None
    return solve_active_set(problem, at_lower, at_upper, near=z, system=system)


class NewtonState:
    """The iterate z with w = M z + q, the best z so far, and the work since the last step.

    Attributes
    ----------
    best_z : ndarray, shape (n,)
        The best so far; it may be outside the bounds.
    best : float
        ‖r(best_z)‖∞, the numerator of the relative residual.
    inside_z, inside : ndarray, shape (n,), and float
        The best of the iterates projected onto the bounds, and its ‖r‖∞: the data of a step.
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
        """Move to z; store z or its projection if the residual is the best so far."""
        self.z, self.w = z, self.slack(z)
        self.residual: FloatVector = np.abs(scaled_residual(self.problem, z, self.w))
        size = float(np.max(self.residual, initial=0.0))
        if size < self.best or not self._solved:
            self.best, self.best_z = size, z
        inside = np.clip(z, self.problem.lower, self.problem.upper)
        if not np.array_equal(inside, z):
            residual = np.abs(scaled_residual(self.problem, inside, self.slack(inside)))
            size = float(np.max(residual, initial=0.0))
        if size < self.inside or not self._solved:
            self.inside, self.inside_z = size, inside

    @property
    def is_large(self) -> bool:
        """True if steps without clear gain end after LARGE_PATIENCE."""
        # Steps that gain little are given up early: each costs a factorization.
        return self.problem.n > 3000

    def slack(self, z: FloatVector) -> FloatVector:
        """Return M z + q, counted as work."""
        self.work += 1.0
        return self.problem.slack(z)

    def step(self) -> Step:
        """Return the best iterate as a step, with the work since the last step."""
        work, self.work = self.work, 0.0
        return Step(self.inside_z, self.inside, work=work)

    def is_known(self, at_lower: BoolVector, at_upper: BoolVector) -> bool:
        """Return whether this active set has been solved before."""
        return signature(at_lower, at_upper) in self._solved

    def solve(self, at_lower: BoolVector, at_upper: BoolVector) -> ActiveSetSolution | None:
        """Return the solution for an active set; if its block is singular, the solution nearest to the current z."""
        self._solved.add(signature(at_lower, at_upper))
        solution = solve_active_set(
            self.problem, at_lower, at_upper, near=self.z, system=self._system
        )
        if solution is not None:
            self._system = solution.system
            self.work += solution.work
        return solution
