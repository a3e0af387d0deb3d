"""A least squares run: what is tried in turn, and what is certified of it on the caller's own data."""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import islice
from typing import cast

import numpy as np

from ...core.checks import FloatVector
from ...core.deadline import AT_LEAST, Clock, OutOfTimeError, time_limit
from ...core.policy.stages import Progress
from ...core.settings import Settings, Status
from .certificate import Optimality, duality_gap
from .data import BoundedLeastSquares
from .enclosures import NOTHING, Enclosures
from .engine_points import engine_points
from .refined_steps import refined_steps
from .steps import FacePoint, Take, projected_steps, through_orthants

DENSE_PATIENCE = 0.05  # steps that a factor costs, ÷ the smaller dimension of A
SPARSE_PATIENCE = 300  # steps that an interior point with sparse factors costs
NARROWER = 0.05  # what is aimed at, ÷ what was reached where that was not enough
MOST_STEPS_FOR_GAP = 300
JUDGED = 2e-7  # seconds an entry, row and column, of the cheapest certificate: it is not made after the limit, if long


@np.errstate(all="ignore")
def run_stages(
    problem: BoundedLeastSquares, settings: Settings, start: FloatVector | None, clock: Clock
) -> tuple[Optimality, Status, int]:
    """Return the best point with its optimality, why the run ended, and after how many steps."""
    scaled, limit = (
        problem.scaled,
        math.inf if settings.max_seconds is None else settings.max_seconds,
    )
    begin = (
        scaled.nearest_to_zero
        if start is None
        else np.clip(scaled.from_caller(start), scaled.lower, scaled.upper)
    )
    run = Run(problem, settings, clock, FacePoint(scaled, begin), is_given=start is not None)
    try:
        with time_limit(limit - clock.read(), is_enforced=True):
            status = run.status()
    except OutOfTimeError:
        status = Status.MAX_SECONDS
    except KeyboardInterrupt:
        status = Status.INTERRUPTED
    if status in (Status.MAX_SECONDS, Status.INTERRUPTED):
        x = scaled.to_caller(run.nearest.x)
        entries = (
            problem.A.nnz
            if problem.is_sparse
            else problem.shape[0] * problem.shape[1] * problem.is_dense
        )
        if JUDGED * (entries + sum(problem.shape)) <= AT_LEAST:
            at_end = Optimality.of(run.enclosures, x, tolerance=np.inf)  # nothing more costly
            if run.best is None or at_end.is_better(run.best):
                run.best = at_end
        elif run.best is None:
            run.best = Optimality.unjudged(run.enclosures, x)
    return cast(Optimality, run.best), status, run.steps


class Run:
    """One run: its steps are counted, and the points that look good enough are certified.

    Attributes
    ----------
    nearest : FacePoint
        That of the smallest residual, from which each stage begins.
    best : Optimality or None
        The best of those that were certified.
    is_solved : bool
        Whether it is what was asked for.
    """

    def __init__(
        self,
        problem: BoundedLeastSquares,
        settings: Settings,
        clock: Clock,
        start: FacePoint,
        *,
        is_given: bool,
    ) -> None:
        self.problem, self.settings, self.clock = problem, settings, clock
        self.nearest = start
        # Engines begin nowhere: who goes to them at once need not judge where the others would begin.
        self._is_seen_first = (
            is_given or not problem.is_cheap_to_copy or not start.natural_residual.any()
        )
        self.enclosures = Enclosures(problem)
        self.best: Optimality | None = None
        self.is_solved, self.steps = False, 0
        self._smallest, self._aim = np.inf, settings.tolerance

    def status(self) -> Status:
        """Take steps until the problem is solved, a limit comes, or nothing is left to try; return why it ended."""
        most = self.settings.max_iterations
        if self._is_seen_first and self._is_seen(self.nearest):
            return Status.SOLVED
        for take in self._stages():
            points, progress = take(self.nearest), Progress(self.problem.shape[1], most)
            while self.steps < most and (point := next(points, None)) is not None:
                self.steps += 1
                if self._is_seen(point):
                    return Status.SOLVED
                if point.dual is None and progress.is_stalled(
                    self.steps, self._smallest, self.settings.tolerance
                ):
                    break
            if self.steps >= most:
                break
        if self._is_certified(self.nearest, None):
            return Status.SOLVED
        if self.steps >= most:
            return Status.MAX_ITERATIONS
        return (
            Status.PRECISION_LIMIT
            if cast(Optimality, self.best).is_at_rounding_level
            else Status.STALLED
        )

    def _require_time(self) -> None:
        limit = self.settings.max_seconds
        if limit is not None and self.clock.read() > limit:
            raise OutOfTimeError

    def _stages(self) -> Iterator[Take]:
        problem = self.problem
        if problem.has_entries:
            if not problem.is_cheap_to_copy:
                patience = (
                    SPARSE_PATIENCE
                    if problem.is_sparse
                    else math.ceil(DENSE_PATIENCE * min(problem.shape))
                )
                yield lambda start: islice(through_orthants(projected_steps)(start), 1, patience)
            yield lambda start: engine_points(start.problem.whole)
            if problem.is_cheap_to_copy:
                yield lambda start: islice(
                    through_orthants(refined_steps)(self._within_rounding(start)), 1, None
                )
        yield lambda start: islice(through_orthants(projected_steps)(start), 1, None)

    def _within_rounding(self, start: FacePoint) -> FacePoint:
        """Return where to begin: near 0 where a point was so far out that its rounding hides costs."""
        if self.enclosures.near_answer is None:
            return start
        return FacePoint(start.problem, self.problem.scaled.nearest_to_zero)

    def _is_seen(self, point: FacePoint) -> bool:
        """Take note of a point; return whether it is what was asked for."""
        self._require_time()
        if point.dual is not None:
            if self._is_certified(point, point.dual):
                return True
            x = self.problem.scaled.to_caller(point.x)
            residual = self.enclosures.residual(x)
            if Optimality(
                self.enclosures, x, residual, 1.0, NOTHING
            ).hides_costs:  # steps from there would stay there
                return False
        scaled, size = point.steepness(self.enclosures.reference)
        if not self._smallest <= scaled:
            self.nearest, self._smallest = point, scaled
        if size > self._aim or (point.dual is not None and point.dual.size):
            return False
        self._aim = NARROWER * size
        return self._is_certified(point, None)

    def _is_certified(self, point: FacePoint, dual: FloatVector | None) -> bool:
        """Certify a point, and keep it where it is the best; return whether it is what was asked for."""
        judged = Optimality.of(
            self.enclosures,
            self.problem.scaled.to_caller(point.x),
            dual,
            tolerance=self.settings.tolerance,
        )
        self.is_solved = judged.meets(self.settings.tolerance) and (
            self.problem.has_entries or self._has_small_gap(judged)
        )
        if self.best is None or self.is_solved or judged.is_better(self.best):
            self.best = judged
        return self.is_solved

    def _has_small_gap(self, judged: Optimality) -> bool:
        """Return whether the gap of an operator's x, of which the gradient alone says little, is small as well."""
        problem, nearest = self.problem, self.problem.nearest_to_zero
        most = math.sqrt(self.settings.tolerance) * problem.cost(
            nearest, problem.product(nearest) - problem.b
        )
        if duality_gap(problem, judged.x) <= most:
            return True
        nearer = point_nearer(problem, judged.x, self.steps)
        residual = problem.product(nearer) - problem.b
        if duality_gap(problem, judged.x, residual) <= most:
            return True
        is_unbounded = (problem.lower == -np.inf) & (problem.upper == np.inf)
        fall = problem.cost(judged.x, judged.residual[0]) - problem.cost(nearer, residual)
        return bool(is_unbounded.any() and problem.ridge == 0.0 and fall <= most)


@np.errstate(all="ignore")
def gap_of(problem: BoundedLeastSquares, x: FloatVector, dual: FloatVector, steps: int) -> float:
    """Return an upper bound of what x costs more than the minimum, sharpened by about as many steps as led to x."""
    nearer = point_nearer(problem, x, steps)
    return duality_gap(problem, x, problem.product(nearer) - problem.b, dual)


def point_nearer(problem: BoundedLeastSquares, x: FloatVector, steps: int) -> FloatVector:
    """Return a point nearer to the answer than x, which about as many steps led to."""
    scaled = problem.scaled
    start = FacePoint(scaled, np.clip(scaled.from_caller(x), scaled.lower, scaled.upper))
    points = islice(
        through_orthants(projected_steps)(start), min(2 * steps + 1, MOST_STEPS_FOR_GAP)
    )
    return scaled.to_caller(min(points, key=lambda point: point.size_of_residual).x)
