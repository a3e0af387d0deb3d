"""A least squares run: its stages, and its judge on the caller's own data."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from typing import Any, cast

import numpy as np

from ...core.algorithm import Algorithm, Step
from ...core.certificates.criterion import CommonScaling
from ...core.checks import FloatVector
from ...core.deadline import Clock
from ...core.policy.policy import Policy
from ...core.policy.stages import Choice, Stage
from ...core.settings import Settings, Status
from ...core.solving.judge import STATUS_OF, End, Judge
from ...core.solving.run import Run
from .certificate import Optimality, duality_gap
from .data import BoundedLeastSquares
from .enclosures import Enclosures
from .face_steps import active_set_steps, block_pivot_steps, interior_steps, projected_steps, through_orthants
from .faces import FacePoint, Faces
from .refined_steps import refined_steps

DENSE_PATIENCE = 0.05  # steps that AᵀA and its factors cost, ÷ the smaller dimension of A
SPARSE_PATIENCE = 300  # steps: an interior point takes ten sparse factors and more, of 20 – 40 steps each
ROUNDS = 20  # of active sets to refine an answer
NARROWER = 0.05  # what is aimed at, ÷ what was reached where that was not enough
MOST_STEPS_FOR_GAP = 300


@np.errstate(all="ignore")
def run_stages(
    problem: BoundedLeastSquares, settings: Settings, start: FloatVector | None, clock: Clock, *, is_hard: bool
) -> tuple[Optimality, Status, int]:
    """Return the best point with its optimality, why the run ended, and after how many steps.

    A problem is hard that the kernel of small ones did not solve.
    """
    scaled = problem.scaled
    stages = Stages(problem, is_hard=is_hard)
    judge = LeastSquaresJudge(problem, settings, stages)
    run = Run(judge.scaling, stages, settings, None, clock, judge)
    begin = scaled.nearest_to_zero if start is None else np.clip(scaled.from_caller(start), scaled.lower, scaled.upper)
    try:
        end = run.drive(begin, stages.first(scaled))
    except KeyboardInterrupt:
        end = End.INTERRUPTED
    judged, status = run.ended(begin, end)
    return cast(Any, judged), status, max(run.state.iteration, 0)


@np.errstate(all="ignore")
def gap_of(problem: BoundedLeastSquares, x: FloatVector, dual: FloatVector, steps: int) -> float:
    """Return an upper bound of what x costs more than the minimum, sharpened by about as many steps as led to x."""
    nearer = point_nearer(problem, x, steps)
    return duality_gap(problem, x, problem.product(nearer) - problem.b, dual)


def point_nearer(problem: BoundedLeastSquares, x: FloatVector, steps: int) -> FloatVector:
    """Return a point nearer to the answer than x, which about as many steps led to."""
    scaled = problem.scaled
    start = FacePoint(scaled, np.clip(scaled.from_caller(x), scaled.lower, scaled.upper))
    points = islice(through_orthants(projected_steps)(start), min(2 * steps + 1, MOST_STEPS_FOR_GAP))
    return scaled.to_caller(min(points, key=lambda point: point.size_of_residual).x)


@dataclass(slots=True)
class PointStep(Step):
    """A step with what is known of its point."""

    point: Any = None


@dataclass(frozen=True, kw_only=True)
class Steps(Algorithm):
    """Steps from point to point, with the factors that they take or others took before, if any."""

    take: Callable[[FacePoint], Iterator[FacePoint]]
    faces: Faces | None = None
    name = "least squares"

    def iterates(self, problem: Any, z0: FloatVector) -> Iterator[Step]:
        """Yield the start, then a step a point."""
        points = through_orthants(self.take)(FacePoint(problem, z0))
        return (PointStep(point.x, point=point, is_settling=point.dual is not None) for point in points)

    def finish(self, problem: Any, z: FloatVector) -> FloatVector:
        """Go on to the end of the active sets where there is a factor: a small gradient may leave much of the cost."""
        if self.faces is None:
            return z
        rounds = through_orthants(lambda start: active_set_steps(start, cast(Faces, self.faces)))
        *_, refined = islice(rounds(FacePoint(problem, z)), ROUNDS)
        return refined.x


class Stages(Policy):
    """What is tried in turn, each from the best point so far.

    Attributes
    ----------
    ends_refined : bool
        Whether steps are still to come that go beyond what rounding leaves others.
    """

    name = chosen = "least squares"

    def __init__(self, problem: BoundedLeastSquares, *, is_hard: bool) -> None:
        self.ends_refined = problem.is_cheap_to_copy
        self._left = self._stages(problem, is_hard)

    def first(self, problem: Any) -> Choice:
        """Return the first stage."""
        return next(self._left)

    def next_step(self, problem: Any, stages: Sequence[Stage], goal: float, failed: bool) -> Choice | None:
        """Return the next stage where one has come to its end."""
        return next(self._left, None) if failed else None

    def _stages(self, problem: BoundedLeastSquares, is_hard: bool) -> Iterator[Choice]:
        faces = None
        if problem.has_entries:
            if not problem.is_cheap_to_copy:
                patience = SPARSE_PATIENCE if problem.is_sparse else math.ceil(DENSE_PATIENCE * min(problem.shape))
                yield Choice(Steps(take=lambda start: islice(projected_steps(start), patience)))
            if is_hard:
                yield self._refined()
            if (faces := Faces.of(problem.scaled)) is not None:
                yield Choice(Steps(take=lambda start: block_pivot_steps(start, faces), faces=faces))
                yield Choice(Steps(take=lambda start: interior_steps(start, faces), faces=faces))
            if self.ends_refined:
                yield self._refined()
        yield Choice(Steps(take=projected_steps, faces=faces))

    def _refined(self) -> Choice:
        self.ends_refined = False
        return Choice(Steps(take=refined_steps))


class LeastSquaresJudge(Judge):
    """Measures by the points' own products, and certifies by :mod:`lcp_plugin.problems.least_squares.certificate`.

    Attributes
    ----------
    best : Optimality or None
        The best of those that were certified.
    is_solved : bool
        Whether it is what was asked for.
    """

    def __init__(self, problem: BoundedLeastSquares, settings: Settings, stages: Stages) -> None:
        self.asked: Any = problem
        self.stages = stages
        self.settings, self.scaling = settings, CommonScaling(cast(Any, problem), cast(Any, problem.scaled))
        self.enclosures = Enclosures(problem)
        self.reference = max(self.enclosures.reference)
        self.proof = None
        self.best: Optimality | None = None
        self.is_solved, self._size, self._aim, self._iteration = False, np.inf, settings.tolerance, 0
        self._dual: FloatVector | None = None

    def residual_of(self, step: Any) -> float:
        """Return how steep the cost is at a step as its own residual says; 0 where it brings a dual point to show."""
        self._dual = step.point.dual
        self._size = 0.0 if self._dual is not None else step.point.steepness(self.enclosures.reference)
        return self._size

    def measure(self, z: FloatVector) -> float:
        """Return the same of any z."""
        return FacePoint(self.asked.scaled, z).steepness(self.enclosures.reference)

    def certified(self, z: FloatVector) -> float:
        """Return how steep it is; certify z but where a step before had not enough and this one has not clearly less.

        That is an upper bound where z is not what was asked for, too.
        """
        if self._dual is not None:
            return self._kept(z).steepness
        if self._size > self._aim:
            return self._size
        self._aim = NARROWER * self._size
        return self._kept(z).steepness

    def meets_tolerance(self, z: FloatVector, residual: float, iteration: int) -> bool:
        """Return whether z, certified just now, is what was asked for."""
        self._iteration = iteration
        return self.is_solved

    def is_at_floor(self, z: FloatVector | None) -> bool:
        """Return whether z is as good as rounding allows what is still to come."""
        if z is None or self._dual is not None or self.stages.ends_refined:
            return False
        return Optimality.of(self.enclosures, self.asked.scaled.to_caller(z)).is_at_rounding_level

    def is_limited_by_size(self, z: FloatVector | None) -> bool:
        """Return False."""
        return False

    def final(self, z: FloatVector, end: End, last: Algorithm | None) -> Any:
        """Return what is certified of the answer: z, the best before, or that one refined."""
        scaled, best = self.asked.scaled, self.best
        if not self.is_solved:
            return self._kept(z) and self.best
        if best is None or last is None or end is not End.CONVERGED or best.is_at_rounding_level:
            return best
        z = np.clip(scaled.from_caller(best.x), scaled.lower, scaled.upper)
        refined = last.finish(scaled, z)
        judged = best if refined is z else self._judged(scaled.to_caller(refined), None)
        return judged if judged.meets(self.settings.tolerance) else best

    def verdict(self, certificate: Any, end: End, *, is_chain: bool) -> Status:
        """Return the status: what is certified, or else why the run ended."""
        if self.is_solved:
            return Status.SOLVED
        if certificate.is_at_rounding_level or end is End.AT_FLOOR:
            return Status.PRECISION_LIMIT
        return Status.STALLED if end is End.DIVERGED else STATUS_OF.get(end, Status.STALLED)

    def _kept(self, z: FloatVector) -> Optimality:
        """Return how optimal z is, the best so far kept; take note of whether it is what was asked for."""
        judged, before = self._judged(self.asked.scaled.to_caller(z), self._dual), self.best
        if before is None or (judged.value, judged.steepness) < (before.value, before.steepness):
            self.best = judged
        is_small = judged.meets(self.settings.tolerance)
        self.is_solved = is_small and (self.asked.has_entries or self._has_small_gap(judged))
        return judged

    def _judged(self, x: FloatVector, dual: FloatVector | None) -> Optimality:
        return Optimality.of(self.enclosures, x, dual, tolerance=self.settings.tolerance)

    def _has_small_gap(self, judged: Optimality) -> bool:
        """Return whether the gap of an operator's x, of which the gradient alone says little, is small as well."""
        problem, nearest = self.asked, self.asked.nearest_to_zero
        most = math.sqrt(self.settings.tolerance) * problem.cost(nearest, problem.product(nearest) - problem.b)
        if duality_gap(problem, judged.x) <= most:
            return True
        nearer = point_nearer(problem, judged.x, self._iteration)
        residual = problem.product(nearer) - problem.b
        if duality_gap(problem, judged.x, residual) <= most:
            return True
        is_unbounded = (problem.lower == -np.inf) & (problem.upper == np.inf)
        fall = problem.cost(judged.x, judged.residual) - problem.cost(nearer, residual)
        return bool(is_unbounded.any() and problem.ridge == 0.0 and fall <= most)
