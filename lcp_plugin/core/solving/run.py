"""The loop of a run: methods propose points, each is measured, and the first reason to end ends it."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from contextlib import nullcontext
from dataclasses import replace
from typing import Any

import numpy as np

from ..algorithm import Algorithm, Step
from ..certificates.criterion import POWER, measured_residual, rounding_of_data
from ..certificates.residuals import Certificate, ratio
from ..checks import FloatVector, read_only
from ..deadline import Clock, OutOfTimeError, time_limit
from ..errors import InvalidOption, UnsuitableMatrix, UnsuitableProblem
from ..kernels.floats import DATA_ROUNDING
from ..lcp import LCP
from ..settings import Settings, Status
from .advice import NOTHING_TO_DO, advice_of_run
from .result import Result, Sample
from .run_log import Header, RunLog
from .stage import Stage
from .termination import FAILED, TerminationReason, TerminationTest

Callback = Callable[[Sample, FloatVector], Any]

Polish = Callable[[LCP, FloatVector, float], Any]

STATUS_OF = {
    TerminationReason.STEP_LIMIT: Status.MAX_ITERATIONS,
    TerminationReason.TIME_LIMIT: Status.MAX_SECONDS,
    TerminationReason.INTERRUPTED: Status.INTERRUPTED,
    TerminationReason.DIVERGED: Status.DIVERGED,
}  # of a z that nothing is shown of; of any other end it is STALLED


class Run:
    """Run: stages, best point, status.

    Parameters
    ----------
    problem : LCP
    chosen : str or Algorithm
        The algorithm of the call.
    settings : Settings
    callback : callable or None
    clock : Clock
        Running.
    test : TerminationTest, optional
        Stopping test of the user's problem if it differs from the problem of the methods: a nonlinear problem, for
        which the methods take the linearization at the start.
    header : callable, optional
        The lines on M that ``verbose=True`` prints.
    polish : callable, optional
        Returns the solution of the linear system on the active set of z, and its work, from (problem, z, most work).
    """

    def __init__(
        self,
        problem: LCP,
        chosen: str | Algorithm,
        settings: Settings,
        callback: Callback | None,
        clock: Clock,
        test: TerminationTest | None = None,
        header: Header | None = None,
        polish: Polish | None = None,
    ) -> None:
        self.problem, self.chosen, self.settings = problem, chosen, settings
        self.callback, self.clock = callback, clock
        self.test, self.polish = test or TerminationTest(problem, settings), polish
        self.stages: list[Stage] = []
        self.samples: list[Sample] = []
        self.iteration, self.work, self.seconds, self.setup_seconds = -1, 0.0, 0.0, 0.0
        self.best: FloatVector | None = None
        self.residual = self.start_residual = math.inf
        self.unmeasured: FloatVector | None = None  # the latest iterate
        self.proof: Any = None  # of the largest margin, that the problem has no solution
        with clock.pause():
            self.log = RunLog(self.test.user_problem, header) if settings.verbose else None
        self._next_sample = 0

    def follow_all(self, plan: Iterable[Stage], start: FloatVector) -> TerminationReason:
        """Follow the stages until a stage ends the run, within the remaining time; return the reason for the end."""
        left, end = self.settings.max_seconds - self.clock.read(), TerminationReason.NOTHING_LEFT
        if self.test.solved_rows is not None:  # no point but z° can be measured there
            start = np.where(self.test.solved_rows, self.problem.nearest_to_zero, start)
        try:
            with nullcontext() if left == math.inf else time_limit(left, is_enforced=True):
                for stage in plan:
                    end = self.follow(stage, start if self.best is None else self.best)
                    if end not in FAILED:
                        break
        except OutOfTimeError:
            return TerminationReason.TIME_LIMIT
        return end

    def follow(self, stage: Stage, start: FloatVector) -> TerminationReason:
        """Take the steps of a method until the run, the budget of the stage or the method ends."""
        if self.log is not None:
            self.log.begin(stage)
        if self.stages:
            self.stages[-1].z = None
        self.stages.append(stage)
        for step in self._steps_of(stage, start):
            if (end := self._take(stage, step)) is not None:
                break
            if stage.is_over is not None and stage.is_over(stage):
                return TerminationReason.OVER_BUDGET
        else:
            self.clock.read()  # a method may end by itself because time is over
            is_late = self.clock.elapsed >= self.settings.max_seconds
            end = TerminationReason.TIME_LIMIT if is_late else TerminationReason.NOTHING_LEFT
        self._measure_last()
        is_at_floor = end in FAILED and self.test.is_at_floor(self.best)
        return TerminationReason.AT_FLOOR if is_at_floor else end

    def _steps_of(self, stage: Stage, start: FloatVector) -> Iterator[Step]:
        """Yield the steps; none if a method of auto does not take this problem."""
        try:
            yield from stage.algorithm.iterates(self.problem, start.copy())
        except (UnsuitableMatrix, UnsuitableProblem):
            if len(self.stages) == 1 or stage.iterations > 0:
                raise

    def _take(self, stage: Stage, step: Any) -> TerminationReason | None:
        """Count, measure and report one step; return why the run ends with it, or None."""
        if not isinstance(step, Step):  # of an algorithm from outside
            raise InvalidOption(
                f"{stage.algorithm.name}.iterates must yield Step(z), got {type(step).__name__}; write `yield Step(z)`"
            )
        self.seconds = self.clock.read()
        is_first = stage.z is None  # the start, no iteration
        stage.count(step, iterations=0 if is_first else 1)
        self.work += step.work
        self.iteration = max(self.iteration + (not is_first), 0)
        if is_first and self.iteration == 0:
            self.setup_seconds = self.seconds
        residual = self._measure(stage, step, is_first)
        end = self._end_of(stage, step, residual)
        is_watched = self.settings.record or self.log is not None or self.callback is not None
        if is_watched and self._report(stage, step, residual, is_last=end is not None):
            end = end or TerminationReason.INTERRUPTED
        if end is not None or step.proof is None:
            return end
        if step.proof.verify():
            tolerances = self.settings.tolerance, self.settings.absolute_tolerance
            excludes = step.proof.excludes(*tolerances)
            if excludes or self.proof is None or step.proof.margin > self.proof.margin:
                self.proof = step.proof
            if excludes:
                return TerminationReason.NO_SOLUTION
        is_limited = self.best is not None and self._is_within_rounding_of_data(self.best)
        return TerminationReason.AT_FLOOR if is_limited else None

    def _measure(self, stage: Stage, step: Step, is_first: bool) -> float | None:
        """Return the residual of a step if it is known or due, proved if it may be small enough; keep the best z."""
        test, self.unmeasured = self.test, step.z
        change = step.residual if step.increment is None else step.increment
        increment = None if change is None else ratio(change, test.reference)
        known = step.residual if test.is_uniform else None
        if known is not None:
            residual = ratio(known, test.reference)
        elif is_first or stage.is_due(increment, test.goal):
            residual = test.measure(step.z)
            self.work += 1.0 if self.iteration > 0 else 0.0  # the start is always measured
        else:
            return None
        if residual <= test.goal:
            residual = test.certify(step.z)
        stage.record(residual, increment if known is None else None)
        self._keep(step.z, residual)
        if self.iteration == 0:
            self.start_residual = residual
        return residual

    def _keep(self, z: FloatVector, residual: float, *, is_final: bool = False) -> None:
        """Keep a copy of z if its residual is smaller than the best, or if it is final; NaN counts as ∞."""
        self.unmeasured = None
        if self.best is None or residual < self.residual or is_final:
            if self.best is None:
                self.best = z.copy()
            np.copyto(self.best, z)
            self.residual = math.inf if math.isnan(residual) else residual

    def _measure_last(self) -> None:
        if self.unmeasured is not None:
            self._keep(self.unmeasured, self.test.measure(self.unmeasured))

    def _end_of(self, stage: Stage, step: Step, residual: float | None) -> TerminationReason | None:
        """Return the reason that the run ends with this step, or None."""
        algorithm, settings, test = stage.algorithm, self.settings, self.test
        if residual is not None:
            power = 1.0 if algorithm.ends_on_active_set else POWER
            if test.is_passed(step.z, residual, self.iteration, power):
                self._keep(step.z, residual, is_final=True)
                return TerminationReason.CONVERGED
            # A method that is not monotone may rise, but not to ∞.
            is_lost = algorithm.is_monotone and stage.rises >= 10
            is_lost = is_lost or not math.isfinite(residual)
            if is_lost and not residual <= 1e8 * max(1.0, self.start_residual):
                return TerminationReason.DIVERGED
        elif step.increment is not None and not math.isfinite(step.increment):
            return TerminationReason.DIVERGED
        if self.iteration >= settings.max_iterations:
            return TerminationReason.STEP_LIMIT
        if self.clock.elapsed >= settings.max_seconds:
            return TerminationReason.TIME_LIMIT
        if residual is None:
            return None
        if stage.is_flat() and test.is_at_floor(self.best):
            return TerminationReason.AT_FLOOR
        left = settings.max_iterations - self.iteration
        is_watched = algorithm.is_monotone or algorithm.is_watched
        if is_watched and stage.is_stalled(self.problem.n, test.goal, left):
            return TerminationReason.STALLED
        return None

    def _report(self, stage: Stage, step: Step, residual: float | None, *, is_last: bool) -> bool:
        """Record, print and call back, with the clock paused; return whether the callback returned True."""
        settings, log, callback = self.settings, self.log, self.callback
        with self.clock.pause():
            sample = Sample(self.iteration, self.work, self.seconds, residual, stage.algorithm.name)
            wants_to_stop = callback is not None and bool(callback(sample, read_only(step.z)))
            is_due = self.iteration >= self._next_sample or is_last or wants_to_stop
            is_recorded, is_printed = (
                settings.record and is_due,
                log is not None and log.is_due(stage),
            )
            if residual is None and (is_recorded or is_printed):
                sample = replace(sample, residual=self.test.measure(step.z))
            if log is not None and is_printed:
                log.step(stage, sample)
            if is_recorded:  # at geometric intervals
                self._next_sample = max(self.iteration + 1, math.ceil(self.iteration * 1.05))
                self.samples.append(sample)
        return wants_to_stop

    # --- the end ----------------------------------------------------------------------------------------

    def result(self, start: FloatVector, end: TerminationReason) -> Result:
        """Return the result: the best iterate, cleaned and polished, with the status of its certificate."""
        settings = self.settings
        self._measure_last()
        certificate = self._final(start if self.best is None else self.best, end)
        status = self._status(certificate, end)
        stages = tuple(record for stage in self.stages for record in stage.records())
        if status is Status.SOLVED and self.iteration <= 0 and self.best is not None:
            stages = tuple(stage._replace(because=NOTHING_TO_DO) for stage in stages)
        name = self.chosen if isinstance(self.chosen, str) else self.chosen.name
        chain = [stage.name for stage in stages]
        is_linear = not certificate.is_linearised
        result = Result(
            z=certificate.z,
            w=certificate.w,
            status=status,
            certificate=certificate,
            tolerance=settings.tolerance,
            absolute_tolerance=settings.absolute_tolerance,
            algorithm=name if chain in ([], [name]) else f"{name}: {', '.join(chain)}",
            iterations=max(self.iteration, 0),
            work=self.work,
            seconds=self.clock.read(),
            setup_seconds=self.setup_seconds,
            history=tuple(self.samples),
            stages=stages,
            infeasibility=self.proof,
            _asked=self.chosen,
            _wants_bound=settings.error_bound and bool(self.stages),
            _advice=advice_of_run(self.problem, self.chosen, settings)
            if is_linear and status is not Status.SOLVED
            else dict(self.test.words),
        )
        if self.log is not None:
            self.log.end(result)
        return result

    def _final(self, z: FloatVector, end: TerminationReason) -> Certificate:
        """Return the certificate of z, or of z after a last step of the method or on its active set if no worse."""
        test, settings = self.test, self.settings
        certificate = test.certificate_of(z)
        if not (certificate.is_linearised or certificate.meets(settings)):
            # The best iterate itself; SOLVED refers to the projected point.
            plain = Certificate.of(self.problem, z)
            certificate = certificate if plain.meets(settings) else plain
        last = self.stages[-1] if self.stages else None
        if last is None:
            return certificate
        is_cut_short = end in (TerminationReason.INTERRUPTED, TerminationReason.TIME_LIMIT)
        if not is_cut_short and np.isfinite(z).all():
            finished = last.algorithm.finish(self.problem, z)
            if finished is not z:
                certificate = test.better_of(certificate, test.certificate_of(finished))
        may_polish = not (certificate.is_linearised or last.algorithm.ends_on_active_set)
        return self._polish(certificate, last, end) if may_polish else certificate

    def _polish(self, certificate: Certificate, last: Stage, end: TerminationReason) -> Certificate:
        """Return the certificate of the solution of the linear system on the active set of z, if it is no worse.

        A residual is not an error: if M is ill-conditioned, as of heavy bodies on light ones, a small one allows any z,
        and the solution of that system is off by rounding errors. It may take a tenth of the work of the run, or all of
        that if auto has not solved the problem. Twenty passes pay for the calls around it.
        """
        most = math.inf if self.chosen == "auto" else 0.0
        if certificate.meets(self.settings):
            most = 0.1 * self.work - 20.0
        elif end not in (TerminationReason.CONVERGED, TerminationReason.AT_FLOOR, *FAILED):
            return certificate
        if self.polish is None or most <= 0.0:
            return certificate
        found = self.polish(self.problem, certificate.z, min(most, self.work + 20.0))
        if found is None:
            return certificate
        self.work += found.work
        last.count(Step(found.z, work=found.work), iterations=0)
        polished = np.clip(found.z, self.problem.lower, self.problem.upper)
        return self.test.better_of(certificate, self.test.certificate_of(polished))

    def _status(self, certificate: Certificate, end: TerminationReason) -> Status:
        """Return the status from the certificate or a proof, or else from the reason for the end of the run."""
        if certificate.meets(self.settings):
            return Status.SOLVED
        if end is TerminationReason.NO_SOLUTION:
            return self.proof.status  # type: ignore[no-any-return]
        if certificate.is_limited_by_rounding or self._is_within_rounding_of_data(certificate.z):
            return Status.PRECISION_LIMIT
        # If one of several algorithms diverged, the best z need not have.
        is_chain = end is TerminationReason.DIVERGED and len(self.stages) > 1
        return Status.STALLED if is_chain else STATUS_OF.get(end, Status.STALLED)

    def _is_within_rounding_of_data(self, z: FloatVector) -> bool:
        """Return whether no z is a solution, but the violation at this z is at most the rounding of the data."""
        if self.proof is None or not self.proof.is_rounding:
            return False
        certificate, problem = self.test.certificate_of(z), self.problem
        rounding = DATA_ROUNDING * float(np.abs(problem.q).max(initial=0.0))
        is_large = certificate.natural_residual > rounding
        if is_large and certificate.term_residual > self.settings.goal:
            return False  # small relative to a coefficient that may be inactive
        return measured_residual(problem, certificate.z) <= rounding_of_data(problem)
