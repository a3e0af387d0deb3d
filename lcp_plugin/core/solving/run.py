"""One run: its loop, its incumbent, its state."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import nullcontext
from dataclasses import replace
from typing import Any

import numpy as np

from ..algorithm import Step
from ..certificates.criterion import POWER
from ..certificates.residuals import Certificate
from ..certificates.row_residuals import ratio
from ..checks import FloatVector, read_only
from ..deadline import Clock, OutOfTimeError, time_limit
from ..errors import InvalidOption, UnsuitableMatrix, UnsuitableProblem
from ..lcp import LCP
from ..policy.policy import Policy, name_of, with_reasons
from ..policy.stages import CheckSchedule, Choice, Progress, Stage
from ..settings import Settings, Status
from .advice import NOTHING_TO_DO, advice_of_run
from .judge import FAILED, End, Judge
from .result import BoundOrReason, Result, Sample, StageRecord
from .run_log import Header, RunLog

Callback = Callable[[Sample, FloatVector], Any]

NO_STEP = object()  # an algorithm has no further one
WITH_A_CASE = (End.CONVERGED, End.AT_FLOOR, *FAILED)
DIVERGED_BEYOND = 1e8  # times the residual of the start and of z°


class Run:
    """One run: algorithms yield steps, the judge measures them, and the first reason to end ends it.

    A judge of another problem than the one that the algorithms take may be given (see
    :class:`~lcp_plugin.core.solving.judge.Judge`): of a nonlinear problem, of which that one is the linearization at
    the start. `header` is what ``verbose=True`` prints of M.
    """

    def __init__(
        self,
        problem: LCP,
        policy: Policy,
        settings: Settings,
        callback: Callback | None,
        clock: Clock,
        judge: Judge | None = None,
        header: Header | None = None,
    ) -> None:
        self.problem, self.policy, self.settings = problem, policy, settings
        self.callback, self.clock = callback, clock
        self.judge = judge or Judge(problem, settings)
        self.incumbent, self.state = Incumbent(), RunState()
        self.progress = Progress(problem.n, settings.max_iterations)
        self.checks = CheckSchedule(ratio(1.0, self.judge.reference), self.judge.goal)
        self.start_residual = math.inf
        with clock.paused():
            self.log = RunLog(self.judge.asked, header) if settings.verbose else None
        self._is_watched = settings.record or settings.verbose or callback is not None
        self._next_sample = 0

    def drive(self, start: FloatVector, first: Choice) -> End:
        """Run the chain of algorithms within the time that is left; return why it ended."""
        following: Choice | None = first
        left = self.settings.max_seconds - self.clock.read()
        start = self.judge.started(start)
        try:
            with nullcontext() if left == math.inf else time_limit(left, is_enforced=True):
                while following is not None:
                    if self.log is not None:
                        self.log.begin(following)
                    self.state.open(Stage(following.algorithm, following.because))
                    z = (
                        start
                        if following.from_start or self.incumbent.z is None
                        else self.incumbent.z
                    ).copy()
                    end, following = self._follow(following.iterates(self.problem, z))
        except OutOfTimeError:
            return End.TIME_LIMIT
        return end

    def _follow(self, steps: Iterator[Step]) -> tuple[End, Choice | None]:
        """Take the steps of one algorithm until the run or the policy wants an end; return why, and what comes next."""
        self.progress.restart(max(self.state.iteration, 0), self.incumbent.residual)
        end: End | None = None
        while end is None and (step := self._step_of(steps)) is not NO_STEP:
            end = self._observe(step)
            if end is None and (following := self._next(has_failed=False)) is not None:
                return End.STALLED, following
        self.clock.read()  # what ends by itself may have done so because time is over
        is_late = self.clock.elapsed >= self.settings.max_seconds
        end = end or (End.TIME_LIMIT if is_late else End.NOTHING_LEFT)
        self._measure_last()
        if end in FAILED and self.judge.is_at_floor(self.incumbent.z):
            end = End.AT_FLOOR
        return end, self._next(has_failed=True) if end in FAILED else None

    def _measure_last(self) -> None:
        """Measure the latest iterate if that has not been done, and keep the better one."""
        last = self.incumbent.unmeasured
        if last is not None:
            self.incumbent.offer(last, self.judge.measure(last))

    def _step_of(self, steps: Iterator[Step]) -> Any:
        """Return the next step, NO_STEP where there is none, or where auto tried what does not take this problem."""
        stages = self.state.stages
        try:
            return next(steps, NO_STEP)
        except (UnsuitableMatrix, UnsuitableProblem):
            if len(stages) == 1 or stages[-1].iterations > 0:
                raise
            return NO_STEP

    def _next(self, *, has_failed: bool) -> Choice | None:
        return self.policy.next_step(self.problem, self.state.stages, self.judge.goal, has_failed)

    def _observe(self, step: Any) -> End | None:
        """Take note of one step; return why the run ends with it, if it does."""
        if not isinstance(step, Step):  # as an algorithm of somebody else's may yield
            name = self.state.stages[-1].algorithm.name
            raise InvalidOption(
                f"{name}.iterates must yield Step(z), got {type(step).__name__}; write `yield Step(z)`"
            )
        is_first = self.state.enter(step, self.clock.read())
        if self.settings.absolute_tolerance:
            self.state.stages[-1].least_residual = 0.0  # it speaks of the relative one alone
        residual = self._residual_of(step, is_first)
        end = self._end_with(step, residual)
        if self._is_watched and self._report(step, residual, end is not None):
            end = end or End.INTERRUPTED
        return self._end_with_proof(step.proof) if end is None and step.proof is not None else end

    def _residual_of(self, step: Step, is_first: bool) -> float | None:
        """Return the residual of a step where it is known or due, proved where it may be small enough; keep the best z.

        An algorithm knows it, or it is measured at the first step of a stage and at intervals.
        """
        state, judge = self.state, self.judge
        self.incumbent.unmeasured = step.z
        known = residual = judge.residual_of(step)
        if residual is None:
            change = step.residual if step.increment is None else step.increment
            if not (is_first or self.checks.is_due(state.iteration, change)):
                return None
            residual = judge.measure(step.z)
            state.work += (
                1.0 if state.iteration > 0 else 0.0
            )  # the start is measured for every problem
        if judge.may_meet_tolerance(residual):
            residual = judge.certified(step.z)
        if known is None and change is not None:
            self.checks.learn(state.iteration, change, residual)
        self.incumbent.offer(step.z, residual)
        state.stages[-1].note(residual)
        if state.iteration == 0:
            self.start_residual = residual
        return residual

    def _end_with_proof(self, proof: Any) -> End | None:
        """Return why the run ends with a proof that there is no solution, or none nearby, if it does."""
        if self.judge.accept_proof(proof):
            return End.NO_SOLUTION
        return End.AT_FLOOR if self.judge.misses_by_rounding(self.incumbent.z) else None

    def _end_with(self, step: Step, residual: float | None) -> End | None:
        """Return why the run ends with this step, or None."""
        iteration, best = self.state.iteration, self.incumbent.residual
        progress, settings = self.progress, self.settings
        algorithm = self.state.stages[-1].algorithm
        is_monotone = algorithm.is_monotone
        if residual is not None:
            power = 1.0 if algorithm.ends_with_a_case else POWER
            if self.judge.meets_tolerance(step.z, residual, iteration, power):
                self.incumbent.take(step.z, residual)
                return End.CONVERGED
            is_lost = (is_monotone and progress.is_rising(residual)) or not math.isfinite(residual)
            is_beyond = is_lost and not residual <= DIVERGED_BEYOND * self.start_residual
            if is_beyond and not residual <= DIVERGED_BEYOND:
                return End.DIVERGED
        elif step.increment is not None and not math.isfinite(step.increment):
            return End.DIVERGED
        if iteration >= settings.max_iterations:
            return End.STEP_LIMIT
        if self.clock.elapsed >= settings.max_seconds:
            return End.TIME_LIMIT
        if step.is_settling:
            progress.restart(iteration, best)
        if residual is None:
            return None
        if progress.is_flat(iteration, best) and self.judge.is_at_floor(self.incumbent.z):
            return End.AT_FLOOR
        is_stalled = (is_monotone or algorithm.is_watched) and progress.is_stalled(
            iteration, best, self.judge.goal
        )
        return End.STALLED if is_stalled else None

    # --- telling ----------------------------------------------------------------------------------------

    def _report(self, step: Step, residual: float | None, is_last: bool) -> bool:
        """Record and call back, the clock stopped; return whether the caller wants to stop."""
        state, stage, log = self.state, self.state.stages[-1], self.log
        is_due = self.settings.record and (is_last or state.iteration >= self._next_sample)
        with self.clock.paused():
            sample = Sample(
                state.iteration, state.work, state.seconds, residual, stage.algorithm.name
            )
            wants_to_stop = self._called_back(sample, step.z)
            is_due |= self.settings.record and wants_to_stop
            is_printed = log is not None and log.is_due(stage)
            if is_due or is_printed:
                sample = replace(
                    sample, residual=self.judge.measure(step.z) if residual is None else residual
                )
            if log is not None and is_printed:
                log.step(stage, sample)
            if is_due:
                self._next_sample = max(
                    state.iteration + 1, math.ceil(state.iteration * 1.05)
                )  # geometric
                state.samples.append(sample)
        return wants_to_stop

    def _called_back(self, sample: Sample, z: FloatVector) -> bool:
        """Return whether a callback wants to stop."""
        callback = self.callback
        return callback is not None and bool(callback(sample, read_only(z)))

    def ended(self, start: FloatVector, end: End) -> tuple[Certificate, Status]:
        """Return what the judge makes of the best iterate, cleaned up, and of why the run ended."""
        incumbent, state = self.incumbent, self.state
        self._measure_last()
        last = state.stages[-1] if state.stages else None
        # Where no z is near a solution, what is given back is the start, as in a batch.
        is_excluded = (
            last is not None and last.least_residual > self.judge.goal and end is not End.CONVERGED
        )
        best = start if incumbent.z is None or is_excluded else incumbent.z
        certificate = self.judge.final(best, end, None if last is None else last.algorithm)
        is_open = not is_excluded and isinstance(self.judge.asked, LCP)
        has_case = is_open and (
            end in WITH_A_CASE or self.judge.is_solved_by(certificate)
        )  # or a limit came first
        if last is not None and has_case and not last.algorithm.ends_with_a_case:
            certificate = self._with_last_system(certificate, last)
        return certificate, self.judge.verdict(certificate, end, is_chain=len(state.stages) > 1)

    def _with_last_system(self, certificate: Certificate, last: Stage) -> Certificate:
        """Return the certificate of the solution of the linear system of the case that was found, if it is no worse."""
        judge, state, z = self.judge, self.state, certificate.z
        found = self.policy.last_system(
            self.problem, z, state.work, judge.is_solved_by(certificate)
        )
        if found is None:
            return certificate
        z, work = found
        state.work += work
        last.take("", 0, work)
        return judge.better_of(
            certificate, judge.certificate_of(np.clip(z, self.problem.lower, self.problem.upper))
        )

    def judged(self, start: FloatVector, end: End) -> Result:
        """Return the result, whose status the certificate names."""
        state, settings = self.state, self.settings
        certificate, status = self.ended(start, end)
        stages = state.records()
        if status is Status.SOLVED and state.iteration <= 0 and self.incumbent.z is not None:
            stages = tuple(stage._replace(because=NOTHING_TO_DO) for stage in stages)
        result = Result(
            z=certificate.z,
            w=certificate.w,
            status=status,
            certificate=certificate,
            tolerance=settings.tolerance,
            absolute_tolerance=settings.absolute_tolerance,
            algorithm=name_of(self.policy, stages),
            iterations=max(state.iteration, 0),
            work=state.work,
            seconds=self.clock.read(),
            setup_seconds=state.setup_seconds,
            history=tuple(state.samples),
            stages=stages,
            infeasibility=self.judge.proof,
            _asked=self.policy.chosen,
            _bound=self.judge.bound_at_the_end(certificate) if state.stages else BoundOrReason(),
            _advice=self._advice(certificate, status),
        )
        if self.log is not None:
            self.log.end(result)
        return result

    def _advice(self, certificate: Certificate, status: Status) -> dict[Status, str]:
        """Return what to do next, by the status."""
        words, policy, settings = dict(self.judge.words), self.policy, self.settings
        if isinstance(self.judge.asked, LCP) and status is not Status.SOLVED:
            words = advice_of_run(
                self.problem, policy.chosen, self.state.stages, words, policy.left_out
            )
        if not settings.prove_infeasibility:
            stalled = words.get(Status.STALLED, Status.STALLED.value)
            words[Status.STALLED] = (
                f"{stalled}; not proved infeasible, because prove_infeasibility=False"
            )
        return words


class Incumbent:
    """The best iterate whose residual was measured, and the latest one that was not."""

    def __init__(self) -> None:
        self.z: FloatVector | None = None
        self.residual = math.inf
        self.unmeasured: FloatVector | None = None

    def offer(self, z: FloatVector, residual: float) -> None:
        """Keep a copy of z where its residual is smaller than the best; NaN counts as ∞."""
        self.unmeasured = None
        if self.z is None or residual < self.residual:
            self.take(z, math.inf if math.isnan(residual) else residual)

    def take(self, z: FloatVector, residual: float) -> None:
        """Keep a copy of z, whatever was there."""
        if self.z is None:
            self.z = z.copy()
        np.copyto(self.z, z)
        self.residual = residual


class RunState:
    """What was done so far: stages, iterations, work, seconds, samples."""

    def __init__(self) -> None:
        self.stages: list[Stage] = []
        self.samples: list[Sample] = []
        self.iteration, self.work = -1, 0.0
        self.seconds = self.setup_seconds = 0.0

    def open(self, stage: Stage) -> None:
        """Begin a stage."""
        if self.stages:
            self.stages[-1].z = None
        self.stages.append(stage)

    def enter(self, step: Step, seconds: float) -> bool:
        """Count a step; return whether it is its stage's first, which a later stage begins where the last one ended."""
        stage = self.stages[-1]
        is_first = stage.z is None
        self.seconds, stage.z = seconds, step.z
        self.work += step.work
        stage.take(step.label, 0 if is_first else 1, step.work)
        stage.remark = step.remark or stage.remark
        stage.least_residual = max(stage.least_residual, step.least_residual)
        stage.settles = stage.settles or step.is_settling
        self.iteration = max(self.iteration + (not is_first), 0)
        if is_first and self.iteration == 0:
            self.setup_seconds = seconds
        return is_first

    def records(self) -> tuple[StageRecord, ...]:
        """Return the stages, and their parts, as a result shows them."""
        return tuple(record for stage in self.stages for record in _records(stage))


def _records(stage: Stage) -> list[StageRecord]:
    parts = stage.parts or [(stage.algorithm.name, stage.iterations, stage.work)]
    records = [StageRecord(*part) for part in with_reasons(parts, stage.algorithm, stage.because)]
    return [*records[:-1], records[-1]._replace(remark=stage.remark)]
