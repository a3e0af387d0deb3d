"""The loop of a run: methods propose points, each point is measured, and the run ends at the first reason to do so.

One loop serves every problem class. A class derives its run from :class:`Run`, defines `measure` and `result`, and
yields the stages of its plan.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from contextlib import nullcontext
from typing import Any

from ..core.algorithm import Step
from ..core.checks import read_only
from ..core.deadline import OutOfTimeError, time_limit
from ..core.errors import InvalidOption
from ..core.settings import Status
from .progress import Progress
from .result import NOTHING_TO_DO, Callback, Result
from .stage import FAILED, Stage, TerminationReason

__all__ = ["Callback", "Run"]

STATUS_OF = {
    TerminationReason.STEP_LIMIT: Status.MAX_ITERATIONS,
    TerminationReason.TIME_LIMIT: Status.MAX_SECONDS,
    TerminationReason.INTERRUPTED: Status.INTERRUPTED,
    TerminationReason.DIVERGED: Status.DIVERGED,
}  # of a point that does not pass; of any other end it is STALLED


class Run:
    """Loop of a run: limits, Ctrl-C, the best point, its status.

    A problem class derives its own run, and defines `measure`, perhaps `end_of`, `steps_of`, `shown`, and `result`.

    Parameters
    ----------
    progress : Progress
        Settings, limits, callback and counters; runs on parts of a problem share it.

    Attributes
    ----------
    best : Measured or None
        The point that the run would return now: the first point that satisfies the stopping criterion, or else the
        measured point with the smallest residual. None before the first measurement.
    proof : object or None
        A verified proof that the problem has no solution. If several were found, the one with the largest margin.
    """

    def __init__(self, progress: Progress) -> None:
        self.progress, self.settings = progress, progress.settings
        self.best: Any = None
        self.latest: Any = None  # measured point of the last step, or None
        self.residual = math.inf  # of the best point
        self.proof: Any = None

    # --- a problem class defines --------------------------------------------------------------------------

    def measure(self, stage: Stage, step: Step) -> Any:
        """Return the point of a step as :class:`Measured`; None if no measurement is due."""
        return step.measured

    def end_of(self, stage: Stage, step: Step, found: Any) -> TerminationReason | None:
        """Return a reason of this problem class to end the stage with this step, or None."""
        return None

    def end_of_stage(self, stage: Stage, end: TerminationReason) -> TerminationReason:
        """Return why a stage ended; the run continues with the next stage if this reason is one of FAILED.

        A class that measures its best point only here replaces this function.
        """
        if end not in FAILED or self.best is None:
            return end
        if self.best.passes:
            return TerminationReason.CONVERGED
        return TerminationReason.AT_FLOOR if self.best.is_limited else end

    def steps_of(self, stage: Stage) -> Iterator[Step]:
        """Return the steps of a stage."""
        return iter(stage.steps)

    def shown(self, step: Step) -> Any:
        """Return the point z of a step that is passed to the user's callback; it cannot be modified."""
        return read_only(step.z)

    def result(self, end: TerminationReason) -> Any:
        """Return the result of the run."""
        raise NotImplementedError

    def common_fields(self, status: Status) -> dict[str, Any]:
        """Return the fields of the result of every problem class, except `algorithm`."""
        progress = self.progress
        return {
            "status": status,
            "iterations": max(progress.iteration, 0),
            "seconds": progress.clock.read(),
            "tolerance": self.settings.tolerance,
            "history": tuple(progress.samples),
            "stages": progress.records(),
        }

    def result_at(
        self, certificate: Any, status: Status, kind: type[Result] = Result, **others: Any
    ) -> Result:
        """Return the result of a run that ends with this certificate; `others` are further fields of its class."""
        progress, common = self.progress, self.common_fields(status)
        if status is Status.SOLVED and progress.iteration <= 0 and self.best is not None:
            stages = (stage._replace(because=NOTHING_TO_DO) for stage in common["stages"])
            common["stages"] = tuple(stages)
        result = kind(
            z=certificate.z,
            w=certificate.w,
            certificate=certificate,
            absolute_tolerance=self.settings.absolute_tolerance,
            work=progress.work,
            setup_seconds=progress.setup_seconds,
            **common,
            **others,
        )
        progress.conclude(result)
        return result

    # --- the loop -----------------------------------------------------------------------------------------

    def solve(self, plan: Iterable[Stage]) -> Any:
        """Follow the stages of a plan, and return the result, also after Ctrl-C.

        Raises
        ------
        KeyboardInterrupt
            If no step is made yet.
        """
        try:
            return self.result(self.follow_all(plan))
        except KeyboardInterrupt:
            if self.progress.iteration < 0:
                raise
            self.progress.end = TerminationReason.INTERRUPTED
            return self.result(TerminationReason.INTERRUPTED)

    def follow_all(self, plan: Iterable[Stage]) -> TerminationReason:
        """Run the stages one after the other, until one of them ends the run or the time is over; return the reason.

        Ctrl-C ends it with KeyboardInterrupt, because it also ends the runs around this one.
        """
        progress, end = self.progress, TerminationReason.NOTHING_LEFT
        left = self.settings.max_seconds - progress.clock.read()
        try:
            with nullcontext() if left == math.inf else time_limit(left, is_enforced=True):
                for stage in plan:
                    end = self.follow(stage)
                    if end not in FAILED or progress.end is not None:
                        break
        except OutOfTimeError:
            progress.end = TerminationReason.TIME_LIMIT
        return progress.end or end

    def follow(self, stage: Stage) -> TerminationReason:
        """Take the steps of a stage until the run, the budget of the stage or its steps end."""
        progress = self.progress
        progress.begin(stage)
        for step in self.steps_of(stage):
            if (end := self._take(stage, step)) is not None:
                break
            if stage.is_over is not None and stage.is_over(stage):
                return TerminationReason.OVER_BUDGET
        else:
            progress.clock.read()  # steps may end by themselves because time is over
            end = TerminationReason.NOTHING_LEFT
            if progress.clock.elapsed >= self.settings.max_seconds:
                end = progress.end = TerminationReason.TIME_LIMIT
        return self.end_of_stage(stage, end)

    def _take(self, stage: Stage, step: Any) -> TerminationReason | None:
        """Count, measure and report one step; return why the run ends with it, or None."""
        progress = self.progress
        if not isinstance(step, Step):  # of an algorithm from outside
            raise InvalidOption(
                f"{stage.algorithm.name}.iterates must yield Step(z), got {type(step).__name__}; write `yield Step(z)`"
            )
        progress.count(stage, step)
        found = self.latest = self.measure(stage, step)
        if found is not None:
            self.keep(found)
        end: TerminationReason | None
        if found is not None and found.passes:
            end = TerminationReason.CONVERGED
        else:
            end = self.end_of(stage, step, found) or progress.limit()
        if progress.is_watched and progress.report(
            self, stage, step, found, is_last=end is not None
        ):
            progress.end = progress.end or TerminationReason.INTERRUPTED
            end = end or TerminationReason.INTERRUPTED
        if end is None and step.proof is not None:
            end = self.end_of_proof(step.proof)
        return end

    def residual_of(self, step: Step) -> float | None:
        """Return the residual that a method reports with its step, for the history; the step was not measured."""
        return step.residual

    def keep(self, found: Any) -> None:
        """Keep a measured point that passes, or whose residual is smaller than the best one; NaN counts as ∞."""
        if self.best is None or found.passes or found.residual < self.residual:
            self.best = found
            self.residual = math.inf if math.isnan(found.residual) else float(found.residual)

    def end_of_proof(self, proof: Any) -> TerminationReason | None:
        """Store a verified proof; return NO_SOLUTION if it shows that no point can satisfy the tolerance, else None."""
        if not proof.verify():
            return None
        excludes = proof.excludes(self.settings.tolerance, self.settings.absolute_tolerance)
        is_best = excludes or self.proof is None or proof.margin > self.proof.margin
        if is_best and self.settings.prove_infeasibility:
            self.proof = proof
        return TerminationReason.NO_SOLUTION if excludes else None

    def status(self, end: TerminationReason) -> Status:
        """Return the status of the best point or of a proof, or else of the reason for the end of the run."""
        if self.best is not None and self.best.passes:
            return Status.SOLVED
        if end is TerminationReason.NO_SOLUTION and self.proof is not None:
            return self.proof.status
        if self.best is not None and self.best.is_limited:
            return Status.PRECISION_LIMIT
        return STATUS_OF.get(end, Status.STALLED)
