"""The loop of a run: methods propose points, the judge measures them, and the first reason to end ends it."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from contextlib import nullcontext
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from ..algorithm import Algorithm, Step
from ..certificates.criterion import POWER
from ..certificates.residuals import Certificate
from ..certificates.row_residuals import ratio
from ..checks import FloatVector, read_only
from ..deadline import Clock, OutOfTimeError, time_limit
from ..errors import InvalidOption, UnsuitableMatrix, UnsuitableProblem
from ..lcp import LCP
from ..settings import Settings, Status
from .advice import NOTHING_TO_DO, advice_of_run
from .result import ErrorBoundOutcome, Result, Sample, bound_or_reason
from .run_log import Header, RunLog
from .stage import Stage
from .termination import FAILED, TerminationReason, TerminationTest

Callback = Callable[[Sample, FloatVector], Any]

Polish = Callable[[LCP, FloatVector, float], Any]

ENDS_ON_ACTIVE_SET = (TerminationReason.CONVERGED, TerminationReason.AT_FLOOR, *FAILED)
DIVERGED_BEYOND = 1e8  # relative to the residual of the start and of z°
SHARE_OF_POLISH, CALLS = 0.1, 20.0  # of the work of a solved run; passes for the calls around it


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
    judge : TerminationTest, optional
        Stopping test of the original problem if it differs from the problem of the methods: a nonlinear problem, for
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
        judge: TerminationTest | None = None,
        header: Header | None = None,
        polish: Polish | None = None,
    ) -> None:
        self.problem, self.chosen, self.settings = problem, chosen, settings
        self.callback, self.clock = callback, clock
        self.judge, self.polish = judge or TerminationTest(problem, settings), polish
        self.stages: list[Stage] = []
        self.samples: list[Sample] = []
        self.iteration, self.work, self.seconds, self.setup_seconds = -1, 0.0, 0.0, 0.0
        self.best: FloatVector | None = None
        self.residual = self.start_residual = math.inf
        self.unmeasured: FloatVector | None = None  # the latest iterate
        with clock.pause():
            self.log = RunLog(self.judge.asked, header) if settings.verbose else None
        self._next_sample = 0

    def follow_all(self, plan: Iterable[Stage], start: FloatVector) -> TerminationReason:
        """Follow the stages until a stage ends the run, within the remaining time; return the reason for the end."""
        left = self.settings.max_seconds - self.clock.read()
        start, end = self.judge.snap_start(start), TerminationReason.NOTHING_LEFT
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
        end: TerminationReason | None = None
        for step in self._steps_of(stage, start):
            end = self._observe(stage, step)
            if end is None and stage.is_over is not None and stage.is_over(stage):
                end = TerminationReason.OVER_BUDGET
            if end is not None:
                break
        self.clock.read()  # a method may end by itself because time is over
        is_late = self.clock.elapsed >= self.settings.max_seconds
        end = end or (TerminationReason.TIME_LIMIT if is_late else TerminationReason.NOTHING_LEFT)
        if end is TerminationReason.OVER_BUDGET:
            return end
        self._measure_last()
        return (
            TerminationReason.AT_FLOOR
            if end in FAILED and self.judge.is_at_floor(self.best)
            else end
        )

    def _steps_of(self, stage: Stage, start: FloatVector) -> Iterator[Step]:
        """Yield the steps; none if a method of auto does not take this problem."""
        try:
            yield from stage.algorithm.iterates(self.problem, start.copy())
        except (UnsuitableMatrix, UnsuitableProblem):
            if len(self.stages) == 1 or stage.iterations > 0:
                raise

    def _observe(self, stage: Stage, step: Any) -> TerminationReason | None:
        """Record one step; return why the run ends with it, or None."""
        if not isinstance(step, Step):  # of an algorithm from outside
            raise InvalidOption(
                f"{stage.algorithm.name}.iterates must yield Step(z), got {type(step).__name__}; write `yield Step(z)`"
            )
        self.seconds = self.clock.read()
        is_first = stage.count(step)
        self.work += step.work
        self.iteration = max(self.iteration + (not is_first), 0)
        if is_first and self.iteration == 0:
            self.setup_seconds = self.seconds
        residual = self._measure(stage, step, is_first)
        end = self._end_of(stage, step, residual)
        if self._report(stage, step, residual, is_last=end is not None):
            end = end or TerminationReason.INTERRUPTED
        if end is not None or step.proof is None:
            return end
        if self.judge.accept_proof(step.proof):
            return TerminationReason.NO_SOLUTION
        return TerminationReason.AT_FLOOR if self.judge.misses_by_rounding(self.best) else None

    def _measure(self, stage: Stage, step: Step, is_first: bool) -> float | None:
        """Return the residual of a step if it is known or due, proved if it may be small enough; keep the best z."""
        judge, self.unmeasured = self.judge, step.z
        change = step.residual if step.increment is None else step.increment
        increment = None if change is None else ratio(change, judge.reference)
        residual = known = judge.residual_of(step)
        if residual is None:
            if not (is_first or stage.is_due(increment, judge.goal)):
                return None
            residual = judge.measure(step.z)
            self.work += 1.0 if self.iteration > 0 else 0.0  # the start is always measured
        if residual <= judge.goal:
            residual = judge.certify(step.z)
        if known is None and increment is not None:
            stage.learn(increment, residual)
        self._offer(step.z, residual)
        stage.note(residual)
        if self.iteration == 0:
            self.start_residual = residual
        return residual

    def _offer(self, z: FloatVector, residual: float, *, is_taken: bool = False) -> None:
        """Keep a copy of z if its residual is smaller than the best, or if it is taken; NaN counts as ∞."""
        self.unmeasured = None
        if self.best is None or residual < self.residual or is_taken:
            if self.best is None:
                self.best = z.copy()
            np.copyto(self.best, z)
            self.residual = math.inf if math.isnan(residual) else residual

    def _measure_last(self) -> None:
        if self.unmeasured is not None:
            self._offer(self.unmeasured, self.judge.measure(self.unmeasured))

    def _end_of(self, stage: Stage, step: Step, residual: float | None) -> TerminationReason | None:
        """Return the reason that the run ends with this step, or None."""
        algorithm, settings, judge = stage.algorithm, self.settings, self.judge
        if residual is not None:
            power = 1.0 if algorithm.ends_on_active_set else POWER
            if judge.meets_tolerance(step.z, residual, self.iteration, power):
                self._offer(step.z, residual, is_taken=True)
                return TerminationReason.CONVERGED
            is_lost = algorithm.is_monotone and stage.is_rising()
            if is_lost or not math.isfinite(residual):
                beyond = DIVERGED_BEYOND * max(1.0, self.start_residual)
                if not residual <= beyond:
                    return TerminationReason.DIVERGED
        elif step.increment is not None and not math.isfinite(step.increment):
            return TerminationReason.DIVERGED
        if self.iteration >= settings.max_iterations:
            return TerminationReason.STEP_LIMIT
        if self.clock.elapsed >= settings.max_seconds:
            return TerminationReason.TIME_LIMIT
        if residual is None:
            return None
        if stage.is_flat() and judge.is_at_floor(self.best):
            return TerminationReason.AT_FLOOR
        left = settings.max_iterations - self.iteration
        is_watched = algorithm.is_monotone or algorithm.is_watched
        if is_watched and stage.is_stalled(self.problem.n, judge.goal, left):
            return TerminationReason.STALLED
        return None

    def _report(self, stage: Stage, step: Step, residual: float | None, *, is_last: bool) -> bool:
        """Record, print and call back, with the clock paused; return whether the callback returned True."""
        settings, log, callback = self.settings, self.log, self.callback
        if not (settings.record or log is not None or callback is not None):
            return False
        with self.clock.pause():
            sample = Sample(self.iteration, self.work, self.seconds, residual, stage.algorithm.name)
            wants_to_stop = callback is not None and bool(callback(sample, read_only(step.z)))
            is_due = self.iteration >= self._next_sample or is_last or wants_to_stop
            is_recorded, is_printed = (
                settings.record and is_due,
                log is not None and log.is_due(stage),
            )
            if residual is None and (is_recorded or is_printed):
                sample = replace(sample, residual=self.judge.measure(step.z))
            if log is not None and is_printed:
                log.step(stage, sample)
            if is_recorded:  # at geometric intervals
                self._next_sample = max(self.iteration + 1, math.ceil(self.iteration * 1.05))
                self.samples.append(sample)
        return wants_to_stop

    # --- the end ----------------------------------------------------------------------------------------

    def conclude(self, start: FloatVector, end: TerminationReason) -> tuple[Certificate, Status]:
        """Return the certificate of the best iterate, polished, and the status."""
        judge = self.judge
        self._measure_last()
        last = self.stages[-1] if self.stages else None
        best = start if self.best is None else self.best
        certificate = judge.final(best, end, None if last is None else last.algorithm)
        has_active_set = end in ENDS_ON_ACTIVE_SET or judge.is_solved_by(certificate)
        if (
            last is not None
            and not last.algorithm.ends_on_active_set
            and has_active_set
            and isinstance(judge.asked, LCP)
        ):
            certificate = self._polish(certificate, last)
        return certificate, judge.verdict(certificate, end, is_chain=len(self.stages) > 1)

    def _polish(self, certificate: Certificate, last: Stage) -> Certificate:
        """Return the certificate of the solution of the linear system on the active set of z, if it is no worse.

        A residual is not an error: if M is ill-conditioned, as of heavy bodies on light ones, a small one allows any z,
        and the solution of that system is off by rounding errors. It may take a tenth of the work of the run, or all of
        that if auto has not solved the problem.
        """
        judge, z, problem = self.judge, certificate.z, self.problem
        most = math.inf if self.chosen == "auto" else 0.0
        if judge.is_solved_by(certificate):
            most = SHARE_OF_POLISH * self.work - CALLS
        if self.polish is None or most <= 0.0:
            return certificate
        found = self.polish(problem, z, min(most, self.work + CALLS))
        if found is None:
            return certificate
        self.work += found.work
        last.add(0, found.work)
        polished = np.clip(found.z, problem.lower, problem.upper)
        return judge.better_of(certificate, judge.certificate_of(polished))

    def result(self, start: FloatVector, end: TerminationReason) -> Result:
        """Return the result, whose status the certificate names."""
        settings = self.settings
        certificate, status = self.conclude(start, end)
        stages = tuple(record for stage in self.stages for record in stage.records())
        if status is Status.SOLVED and self.iteration <= 0 and self.best is not None:
            stages = tuple(stage._replace(because=NOTHING_TO_DO) for stage in stages)
        name = self.chosen if isinstance(self.chosen, str) else self.chosen.name
        chain = [stage.name for stage in stages]
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
            infeasibility=self.judge.proof,
            _asked=self.chosen,
            _bound=partial(bound_or_reason, self.problem, certificate.z)
            if settings.error_bound and self.stages
            else ErrorBoundOutcome(),
            _advice=self._advice(status),
        )
        if self.log is not None:
            self.log.end(result)
        return result

    def _advice(self, status: Status) -> dict[Status, str]:
        """Return the advice for each status."""
        words = dict(self.judge.words)
        if isinstance(self.judge.asked, LCP) and status is not Status.SOLVED:
            words = advice_of_run(self.problem, self.chosen, words)
        if not self.settings.prove_infeasibility:
            stalled = words.get(Status.STALLED, Status.STALLED.value)
            words[Status.STALLED] = (
                f"{stalled}; not proved infeasible, because prove_infeasibility=False"
            )
        return words
