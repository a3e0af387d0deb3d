"""The run of an LCP: its steps, the residuals that are due, the last clean-up, the result."""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import cached_property
from itertools import chain, islice

import numpy as np

from ..core.algorithm import Algorithm, Step
from ..core.checks import Vector, read_only
from ..core.deadline import Clock
from ..core.entries import max_norm
from ..core.errors import InvalidOption, UnsuitableMatrix, UnsuitableProblem
from ..core.kernels.floats import DATA_ROUNDING
from ..core.kernels.threads import threads_for
from ..core.lcp import LCP
from ..core.names import format_count
from ..core.settings import LIMITS, Settings, Status
from ..judges.certificate import Certificate
from ..judges.lcp import (
    GAINED,
    Measured,
    divide_nonnegative,
    measured_residual,
    rounding_of_data,
    row_data,
)
from ..methods.newton import polish_active_set
from ..methods.small import Rounds
from ..proofs.guarantees import guarantee_of
from .plan import plan
from .result import NEXT, Callback, Result, end_at_once, name_of_run
from .run import FAILED, NO_STEP, Progress, Run, Stage, with_samples


class LCPRun(Run):
    """Run of an LCP.

    It is one class because it specializes the methods of `Run` for one problem class.

    Parameters
    ----------
    problem : LCP
    chosen : Algorithm or None
        The algorithm of the call; None for "auto".
    settings : Settings
    callback : callable or None
    clock : Clock
        Running.
    start : ndarray, shape (n,)
        Within the bounds.

    Attributes
    ----------
    goal : float
        The relative residual below which a point may pass.
    reference : float
        Divides the residuals of the algorithms.
    is_uniform : bool
        Whether all rows have that reference, so that the residual of an algorithm needs no other measurement.
    """

    def __init__(
        self,
        problem: LCP,
        chosen: Algorithm | None,
        settings: Settings,
        callback: Callback | None,
        clock: Clock,
        start: Vector,
    ) -> None:
        self.problem, self.chosen = problem, chosen
        super().__init__(Progress(problem, settings, callback, clock))
        self.data = data = row_data(problem)
        references = np.broadcast_to(data.references[1], (problem.n,))
        is_open = np.broadcast_to(~data.is_solved_at_origin, (problem.n,))
        self.reference = float(references.max(initial=0.0, where=is_open))
        self.is_uniform = bool(
            is_open.all() and (self.reference <= (1.0 + 1e-9) * references).all()
        )
        smallest = float(references.min(initial=math.inf, where=references > 0.0))
        self.goal = float(max(settings.goal, settings.absolute_tolerance / smallest))
        # At a start far beyond the data every residual is at rounding level; a start nearer than z° is used
        if start is not data.origin and (data.rows(start).terms > data.sizes).any():
            start = start if self.measured(start).residual < 1.0 else data.origin
        # No point but z° can be measured in components that z° solves.
        self.start, self.start_residual = np.where(is_open, start, data.origin), math.inf
        self.unmeasured: Vector | None = None  # the latest iterate
        self.is_polished = False
        self._failed_at, self._next_test = math.inf, 0  # residual and iteration

    @cached_property
    def is_guaranteed(self) -> bool:
        """Whether a theorem proves that the iteration of the named method converges on M."""
        if self.chosen is None:
            return False
        guarantee = guarantee_of(self.problem, self.chosen)
        return guarantee.is_guaranteed and guarantee.facts is not None

    @property
    def z(self) -> Vector:
        """The best point so far, or the start."""
        return self.start if self.best is None else self.best.z

    def steps_of(self, stage: Stage) -> Iterator[Step]:
        """Yield the start, the first points, and further steps; none if a method of auto does not take this problem."""
        try:
            algorithm: Algorithm = stage.algorithm
            inputs = self.problem, self.z.copy()
            steps, first = algorithm.iterates(*inputs), stage.steps
            yield from islice(steps, 1)
            if not first and (algorithm is self.chosen or isinstance(algorithm, Rounds)):
                first = algorithm.first_points(*inputs, self.settings.tolerance) or ()
            yield from first
            yield from steps
        except (UnsuitableMatrix, UnsuitableProblem):
            if stage.algorithm is self.chosen or stage.iterations > 0:
                raise

    def measure(self, stage: Stage, step: Step) -> Measured | None:
        """Return the residual of a step if it is known or due; by the criterion if it may be small enough.

        After a failure, only a fifth more steps are tested.
        """
        progress, self.unmeasured = self.progress, step.z
        if step.measured is not None:
            stage.trend.record(stage.iterations, step.measured.residual)
            return step.measured if step.measured.passes else step.measured._replace(z=step.z)
        if np.shape(step.z) != (self.problem.n,):
            raise InvalidOption(
                f"{stage.algorithm.name}.iterates must yield Step(z), z of shape ({self.problem.n},), got shape "
                f"{np.shape(step.z)}"
            )
        is_known = self.is_uniform and step.residual is not None
        change = step.residual if is_known or step.increment is None else step.increment
        residual, increment = math.inf, None
        if change is not None:
            residual = float(divide_nonnegative(np.float64(change), self.reference))
        if not is_known:
            increment = None if change is None else residual
            if not stage.trend.is_due(stage.iterations, increment, self.goal):
                return None
            residual = self.data.estimate(step.z)
        point, iteration = Measured(step.z, residual, passes=False), progress.iteration
        is_early = residual > 0.5 * self._failed_at and iteration < self._next_test
        if residual <= self.goal and not is_early:
            point = self.measured(step.z)
            if not point.passes:  # the run continues from the iterate itself
                self._failed_at, self._next_test = point.residual, iteration + 1 + iteration // 5
                point = point._replace(z=step.z)
        stage.trend.record(stage.iterations, point.residual, increment)
        if progress.iteration == 0:
            self.start_residual = point.residual
        return point

    def measured(self, z: Vector) -> Measured:
        """Return the measure of z, moved to near bounds."""
        settings = self.settings
        point = self.data.measure(z, settings.goal, settings.absolute_tolerance)
        return point._replace(residual=float(point.residual))

    def keep(self, point: Measured) -> None:
        """Keep a copy of a point that passes, or whose residual is the smallest."""
        self.unmeasured = None
        super().keep(point._replace(z=point.z.copy()))

    def residual_of(self, step: Step) -> float:
        """Return the residual of a step that was not measured."""
        return self.data.estimate(step.z)

    def _measure_last(self) -> None:
        if (z := self.unmeasured) is not None:
            self.keep(Measured(z, self.data.estimate(z), passes=False))

    def end_of(self, stage: Stage, step: Step, point: Measured | None) -> Status | None:
        """Return the reason that the stage ends with this step, or None."""
        algorithm, progress = stage.algorithm, self.progress
        if point is None:
            is_lost = step.increment is not None and not math.isfinite(step.increment)
            return Status.DIVERGED if is_lost else None
        # A method that is not monotone may rise, but not to ∞.
        is_lost = algorithm.is_monotone and stage.trend.rises >= 10
        is_lost = is_lost or not math.isfinite(point.residual)
        is_lost = is_lost and not point.residual <= 1e8 * max(1.0, self.start_residual)
        # A contraction in a weighted norm may multiply the residual before it falls.
        if is_lost and not (math.isfinite(point.residual) and self.is_guaranteed):
            return Status.DIVERGED
        left = self.settings.max_iterations - progress.iteration
        if left <= 0 or progress.clock.is_over:
            return None  # because a limit is reached
        # z° solves what is left, up to rounding
        if point.is_limited and point.residual <= self.goal:
            return Status.PRECISION_LIMIT
        if stage.trend.is_flat() and self._is_at_floor():
            return Status.PRECISION_LIMIT
        is_watched = algorithm.is_monotone or algorithm.is_watched
        if is_watched and stage.trend.is_stalled(self.problem.n, self.goal, left):
            return Status.MAX_ITERATIONS if self.is_guaranteed else Status.STALLED
        return None

    def end_of_stage(self, stage: Stage, end: Status) -> Status:
        """Return the reason, or PRECISION_LIMIT if rounding explains the residual of the best point."""
        self._measure_last()
        is_at_floor = end in FAILED and self.best is not None and self._is_at_floor()
        return Status.PRECISION_LIMIT if is_at_floor else end

    def _is_at_floor(self) -> bool:
        """Return whether the best residual is small and no larger than rounding explains: no step is worth its work."""
        point = self.measured(self.z)
        return bool(point.passes or point.is_limited) and point.residual <= GAINED

    def end_of_proof(self, proof: object) -> Status | None:
        """Keep a proof; the run ends if it excludes the tolerance, or if only the rounding of the data is left."""
        end = super().end_of_proof(proof)
        if end is None and self.best is not None and self._is_within_rounding_of_data(self.z):
            return Status.PRECISION_LIMIT
        return end

    # --- the end ----------------------------------------------------------------------------------------

    def result(self, end: Status) -> Result:
        """Return the result: the best iterate, cleaned and polished, with the status of its certificate."""
        self._measure_last()
        point = self._final(self.z, end)
        is_limited = point.is_limited or self._is_within_rounding_of_data(point.z)
        self.best = point._replace(is_limited=is_limited)
        # If one of several algorithms diverged, the best z need not have.
        is_chain = end is Status.DIVERGED and len(self.progress.stages) > 1
        status = self.status(Status.STALLED if is_chain else end)
        return self.result_at(
            Certificate.at(self.problem, read_only(point.z), rows=point.rows),
            status,
            algorithm=name_of_run(self.progress.records(), self.chosen),
            infeasibility=self.proof,
            is_polished=self.is_polished,
            _asked=self.chosen,
            _advice={status: self._advice(end, status)},
        )

    def _advice(self, reason: Status, status: Status) -> str:
        """Return the advice of the status."""
        advice = advice_of_run(self.problem, self.chosen, self.settings, status)
        happened, begins, next_step = advice.partition("; ")
        is_stalled = status is reason is Status.STALLED and self.chosen is not None
        if is_stalled and self.progress.stages[-1].ending == NO_STEP:
            steps = format_count(max(self.progress.iteration, 0), "step")
            happened = f"iterates ended after {steps}"
        if status is Status.MAX_ITERATIONS and self.progress.end is None:  # it is not reached
            happened = "a theorem proves convergence, but the rate of the run is too small for max_iterations"
        return happened + begins + next_step

    def _final(self, z: Vector, end: Status) -> Measured:
        """Return the measure of z, or of z after a last step of the method or on its active set if no worse."""
        settings, stages = self.settings, self.progress.stages
        point = self.best if self.best is not None and self.best.passes else self.measured(z)
        if not point.passes:  # the best iterate itself; SOLVED refers to the projected point
            plain = self.data.measure_at(z, None, settings.goal, settings.absolute_tolerance)
            is_limited = self.data.are_limited(plain, settings.goal)
            point = point if plain.passes else plain._replace(is_limited=is_limited)
        if not (stages and settings.polish):
            return point
        last = stages[-1]
        is_cut_short = end in (Status.INTERRUPTED, Status.MAX_SECONDS)
        if not is_cut_short and np.isfinite(z).all():
            finished = last.algorithm.finish(self.problem, z)
            if finished is not z:
                point = better_of(point, self.measured(finished))
        return point if last.algorithm.ends_on_active_set else self._polish(point, last, end)

    def _polish(self, point: Measured, last: Stage, end: Status) -> Measured:
        """Return the measure of the solution of the linear system on the active set of z, if it is no worse.

        A residual is not an error: if M is ill-conditioned, as of heavy bodies on light bodies, a small residual
        allows any z, and the solution of that system is off by rounding errors. The polish may take a tenth of the work
        of the run, or all of that if auto has not solved the problem. Twenty passes pay for the calls around it.
        """
        most = math.inf if self.chosen is None else 0.0
        if point.passes:
            most = 0.1 * self.progress.work - 20.0
        elif end not in (Status.SOLVED, Status.PRECISION_LIMIT, *FAILED):
            return point
        if most <= 0.0:
            return point
        polish = polish_active_set(self.problem, point.z, min(most, self.progress.work + 20.0))
        if polish is None:
            return point
        self.progress.count(last, Step(polish.z, work=polish.work, iterations=0))
        polished = np.clip(polish.z, self.problem.lower, self.problem.upper)
        better = better_of(point, self.measured(polished))
        self.is_polished = better is not point
        return better

    def _is_within_rounding_of_data(self, z: Vector) -> bool:
        """Return whether no z is a solution, but the violation at this z is at most the rounding of the data."""
        if self.proof is None or not self.proof.is_rounding:
            return False
        point, problem = self.measured(z), self.problem
        certificate = Certificate.at(problem, point.z, rows=point.rows)
        rounding = DATA_ROUNDING * max_norm(problem.q)
        is_large = certificate.natural_residual > rounding
        if is_large and certificate.term_residual > self.settings.goal:
            return False  # small relative to a coefficient that may be inactive
        return measured_residual(problem, certificate.z) <= rounding_of_data(problem)


def better_of(point: Measured, cleaned: Measured) -> Measured:
    """Return the cleaned point if only it passes, or if both or none pass and its residual is no larger."""
    is_no_worse = cleaned.residual <= point.residual < math.inf
    if bool(point.passes) != bool(cleaned.passes):
        is_no_worse = bool(cleaned.passes)
    return cleaned if is_no_worse else point


def advice_of_run(
    problem: LCP, chosen: Algorithm | None, settings: Settings, status: Status
) -> str:
    """Return the advice of a termination status of the run.

    Parameters
    ----------
    problem : LCP
    chosen : Algorithm or None
        The algorithm of the call; None for "auto".
    settings : Settings
    status : Status

    Examples
    --------
    >>> advice_of_run(LCP([[2.0]], [1.0]), None, Settings(), Status.MAX_ITERATIONS)
    'iteration limit reached; next: raise max_iterations, or continue from z0=result.z'
    """
    if status in LIMITS:
        begin = NEXT if chosen is None else f'{NEXT}try algorithm="auto", or '
        return status.value.replace(NEXT, begin) + ", or continue from z0=result.z"
    if status not in FAILED:
        return status.value
    tried = "auto has tried all methods that suit this matrix; next: try another start z0"
    end = tried if chosen is None else 'next: try algorithm="auto"'
    if (negative := (problem.diagonal < 0.0)).all() and negative.size:
        end = f"every m_ii is negative: is −M meant, as for a Laplacian with the other sign? {end}"
    elif negative.any():
        end = f"M is not monotone (m_ii < 0 in {problem.names.row(int(negative.argmax()))}); {end}"
    if status is Status.STALLED and not settings.prove_infeasibility:
        end += "; not proved infeasible, because prove_infeasibility=False"
    return f"{status.value}; {end}"


def run_on(
    problem: LCP,
    method: Algorithm | None,
    settings: Settings,
    start: Vector,
    clock: Clock,
    callback: Callback | None,
    first: Stage | Iterator[Step] | None,
    known: tuple[Result, float] | None = None,
) -> Result:
    """Return the result of a run with a method, or with auto for None; of first steps if it is known.

    Parameters
    ----------
    start : ndarray, shape (n,)
        Within the bounds.
    clock : Clock
        Running.
    first : Stage or iterator of Step, or None
        Stage before the stages of the plan, or the steps of `Algorithm.first_points` of its first stage.
    known : Result and float, optional
        With its residual; reported here; a callback that ends it at the start ends the run there.
    """
    if known is not None:
        is_cold = start is problem.nearest_to_zero  # whose residual is the reference
        begun = start, 1.0 if is_cold else row_data(problem).estimate(start)
        result = with_samples(problem, known[0], settings, callback, begun, known[1])
        if result is not None:
            return result
        callback = end_at_once
    with threads_for(settings.threads):
        run = LCPRun(problem, method, settings, callback, clock, start)
        stages = plan(problem, method, run.goal, prove_infeasibility=settings.prove_infeasibility)
        if isinstance(first, Iterator):
            steps, first = first, next(stages)
            first.steps = steps
        return run.solve(stages if first is None else chain([first], stages))
