"""Methods for complementarity over cones: block Gauss–Seidel, semismooth Newton, a central path, convex programs."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice
from typing import Any, ClassVar

import numpy as np

from ...core.algorithm import Step
from ...core.checks import Vector
from ...core.cone_stack import ConeStack
from ...core.errors import UnsuitableProblem
from ...core.settings import whole_number
from .central_path import central_path
from .data import Blocks, minimizers
from .newton import NEWTON_GAIN, newton_steps
from .sweeps import SWEEPS_PER_STEP, sweep_blocks

Points = Iterator[Step]  # z of shape (1, k, m), its relative residual without rounding, work

STOP = 1e-2  # of the goal: smaller changes end the sweeps
STANDSTILL, SLOW = 100, 0.2  # steps of sweeps without a gain, and their share of all
NEWTON_STEPS = 300  # of one call
PATH_STEPS, NO_GAIN = 40, 8  # of the central path, and steps without a new best
# residual below which Newton's steps are tried, and its later reduction
NEAR_END, NEARER = 1e-3, 1e-2
PROGRAMS, PROGRAM_WORK = 5, 20.0  # convex programs without a gain, and the work of one
# times the mean of |z_i|, or of the references, by which starts are moved at random
SPREADS = 1.0, 8.0


def sweep_points(
    stack: ConeStack, z: Vector, count: float, goal: float, each: int = SWEEPS_PER_STEP
) -> Points:
    """Yield the points after every `each` of `count` sweeps; if `count` is ∞, until the residual no longer falls."""
    least, since, steps = np.inf, 0, 0
    patience = STANDSTILL if count == np.inf else np.inf
    while steps * each < count and since <= max(patience, SLOW * steps) and least > goal:
        z, _ = sweep_blocks(stack, z, each, STOP * goal)
        residual = stack.relative_residual(z)
        if not np.isfinite(residual):
            return
        least, since = (residual, 0) if residual < NEWTON_GAIN * least else (least, since + 1)
        steps += 1
        yield Step(z, residual=residual, work=each + 1.0, iterations=1)


def newton_points(stack: ConeStack, z: Vector, steps: int, goal: float) -> Points:
    """Yield a point of Newton's method per linear system of one problem."""
    for _, at, residual, work in islice(newton_steps(stack, z, steps, goal), 1, None):
        yield Step(at, residual=float(residual[0]), work=work, iterations=1)


def path_points(stack: ConeStack, z: Vector, share: float, goal: float) -> Points:
    """Yield points of the central path from near z, and of Newton's method close to its end."""
    best, least, near, since = z, np.inf, NEAR_END, 0
    for new, work in islice(central_path(stack, z, share), PATH_STEPS):
        size = stack.relative_residual(new)
        yield Step(new, residual=size, work=work, iterations=1)
        best, least, since = (new, size, 0) if size < least else (best, least, since + 1)
        if size <= near:
            for point in newton_points(stack, new, 10, goal):
                yield point
                if point.residual is not None and point.residual <= goal:
                    return
            near = NEARER * min(near, size)
        if since > NO_GAIN:
            break
    yield from newton_points(stack, best, 40, goal)


def move_at_random(stack: ConeStack, z: Vector, seed: int) -> Any:
    """Return a point of the cones near z, the same for the same seed."""
    size = max(float(np.abs(z).mean()), float(stack.reference.mean()))
    way = np.random.default_rng(seed).standard_normal(z.shape)
    return stack.project(z + SPREADS[seed % 2] * size * way)


@dataclass(frozen=True, kw_only=True)
class ConeAlgorithm:
    """A method over cones: a frozen dataclass of its options."""

    name: ClassVar[str]
    needs: ClassVar[str]
    solves: ClassVar[str]
    cost: ClassVar[str]
    reference: ClassVar[str]

    def points(self, problem: Blocks, stack: ConeStack, z: Vector, goal: float) -> Points:
        """Yield a point per step from z, until the residual is at most `goal` or no longer falls."""
        raise NotImplementedError


@dataclass(frozen=True, kw_only=True)
class ConeNSGS(ConeAlgorithm):
    """Nonsmooth Gauss–Seidel: blocks are solved in order.

    A contact in space is solved exactly (open, stick, or the angle of sliding), any other cone by projections.

    Parameters
    ----------
    sweeps : int
        Number of sweeps per step.
    """

    name = "nsgs"
    needs = "blocks on the diagonal that are positive definite"
    solves = "cones without friction, M symmetric positive definite (by descent); else observed"
    cost = "one product with M a sweep"
    reference = "Jourdan, Alart, Jean 1998, doi:10.1016/S0045-7825(97)00137-1"

    sweeps: int = SWEEPS_PER_STEP

    def __post_init__(self) -> None:
        whole_number(self.sweeps, "nsgs: sweeps", 1)

    def points(self, problem: Blocks, stack: ConeStack, z: Vector, goal: float) -> Points:
        """Yield a point every few sweeps."""
        return sweep_points(stack, z, np.inf, goal, self.sweeps)


@dataclass(frozen=True, kw_only=True)
class ConeNewton(ConeAlgorithm):
    """Semismooth Newton on the natural map R(z) = z − P(z − ŵ/d), with a nonmonotone line search on ‖R‖₂."""

    name = "newton"
    needs = "enough memory for a factorization"
    solves = "locally, where the generalized derivatives are regular"
    cost = "one factor of the blocks that are not open"
    reference = "Alart, Curnier 1991, doi:10.1016/0045-7825(91)90022-X"

    def points(self, problem: Blocks, stack: ConeStack, z: Vector, goal: float) -> Points:
        """Yield a point per linear system, until no step reduces the residual."""
        return newton_points(stack, z, NEWTON_STEPS, goal)


@dataclass(frozen=True, kw_only=True)
class ConeInteriorPoint(ConeAlgorithm):
    """Primal–dual interior point on De Saxcé's cones, Nesterov–Todd scaling, then Newton."""

    name = "interior_point"
    needs = "contacts with friction, and enough memory for a factorization"
    solves = "observed: also where many contacts make the same motion"
    cost = "one factor of all blocks a step, about 15 to 40 of them"
    reference = "Acary, Armand, Nguyen, Shpakovych 2024, doi:10.1080/10556788.2023.2296438"

    def points(self, problem: Blocks, stack: ConeStack, z: Vector, goal: float) -> Points:
        """Yield a point per factorization."""
        if not problem.has_friction:
            raise UnsuitableProblem(f'{self.name} needs friction; try algorithm="fixed_point"')
        return path_points(stack, np.zeros_like(z), 1.0, goal)


@dataclass(frozen=True, kw_only=True)
class FixedPoint(ConeAlgorithm):
    """Fixed point over convex programs: min ½ zᵀM z + (q + s e_N)ᵀz over K, with fixed s = μ‖w_T‖.

    Each program is solved by Clarabel, an interior-point method on cones. If M is not symmetric, the program uses
    its symmetric part, and the remainder of M z is fixed as s is. Without friction, and for symmetric M, one
    program yields the solution.
    """

    name = "fixed_point"
    needs = "a symmetric part of M that is positive semidefinite"
    solves = "cones without friction, M symmetric positive semidefinite"
    cost = "one conic program, about ten to thirty factors"
    reference = "Acary, Cadoux, Lemaréchal, Malick 2011, doi:10.1002/zamm.201000073"

    def points(self, problem: Blocks, stack: ConeStack, z: Vector, goal: float) -> Points:
        """Yield a point per program until five gain nothing, and Newton's points."""
        best, least, since = z, stack.relative_residual(z), 0
        for z_program in minimizers(problem, stack.pattern.flat(z)[0]):
            z = stack.pattern.wide(z_program[None])
            residual = stack.relative_residual(z)
            is_gain = residual < NEWTON_GAIN * least
            best, least, since = (z, residual, 0) if is_gain else (best, least, since + 1)
            yield Step(z, residual=residual, work=PROGRAM_WORK, iterations=1)
            if least <= goal or since >= PROGRAMS:
                break
        yield from newton_points(stack, best, 30, goal)


OVER_CONES = ConeNSGS, ConeNewton, ConeInteriorPoint, FixedPoint
CONE_METHODS: dict[str, type[ConeAlgorithm]] = {method.name: method for method in OVER_CONES}
