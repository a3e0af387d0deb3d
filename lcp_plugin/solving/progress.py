"""Progress of a run over all its parts: counters, samples, printed lines, callback and limits."""

from __future__ import annotations

import math
import sys
from typing import Any

from ..core.algorithm import Step
from ..core.deadline import Clock
from ..core.lcp import LCP
from ..core.settings import Settings, checked_callback
from ..proofs.verdicts import classes_in_words, sign_remark
from .result import Callback, Result, Sample, StageRecord
from .stage import Stage, TerminationReason


class Progress:
    """Counters, samples and limits of one call, shared by the runs on parts of its problem.

    Parameters
    ----------
    problem : object
    settings : Settings
    callback : callable or None
    clock : Clock, optional
        Running.

    Attributes
    ----------
    stages : list of Stage
        The stages that began, in order.
    samples : list of Sample
    iteration : int
        Number of iterations; −1 before the first step.
    work, seconds, setup_seconds : float
    end : TerminationReason or None
        The limit, the callback or Ctrl-C that ended the call.
    """

    def __init__(
        self,
        problem: Any,
        settings: Settings,
        callback: Callback | None = None,
        clock: Clock | None = None,
    ) -> None:
        self.settings, self.callback = settings, checked_callback(callback)
        self.clock = Clock() if clock is None else clock
        self.is_watched = settings.record or settings.verbose or callback is not None
        self.stages: list[Stage] = []
        self.samples: list[Sample] = []
        self.iteration, self.work, self.seconds, self.setup_seconds = -1, 0.0, 0.0, 0.0
        self.end: TerminationReason | None = None
        self._next_sample = self._next_line = 0
        if settings.verbose:
            with self.clock.pause():
                is_lcp = isinstance(problem, LCP)
                classes = f"; M {classes_in_words(problem.matrix)}" if is_lcp else ""
                say(f"{problem}{classes}")
                if is_lcp and (remark := sign_remark(problem.matrix)):
                    say(remark)
                say(f"{'iteration':>12} {'work':>10} {'relative residual':>19} {'seconds':>9}")

    def begin(self, stage: Stage) -> None:
        """Record that a stage begins, or continues if it is in the list."""
        self._next_line = 0
        if self.settings.verbose:
            say(stage.algorithm.name + (stage.because and f": {stage.because}"))
        if self.stages:
            self.stages[-1].z = None
        if stage not in self.stages:
            self.stages.append(stage)

    def count(self, stage: Stage, step: Step) -> None:
        """Count a step, its iterations and its work."""
        self.seconds = self.clock.read()
        is_start = stage.z is None
        iterations = step.iterations
        if iterations is None:
            iterations = 0 if is_start else 1
        stage.count(step, iterations)
        self.work += step.work
        self.iteration = max(self.iteration, 0) + iterations
        if is_start and self.iteration == 0:
            self.setup_seconds = self.seconds

    def limit(self) -> TerminationReason | None:
        """Return the limit that is reached, or None; the clock was read at the last step."""
        if self.iteration >= self.settings.max_iterations:
            self.end = TerminationReason.STEP_LIMIT
        elif self.clock.elapsed >= self.settings.max_seconds:
            self.end = TerminationReason.TIME_LIMIT
        return self.end

    def report(self, run: Any, stage: Stage, step: Step, found: Any, *, is_last: bool) -> bool:
        """Record, print and call back, with the clock paused; return whether the callback returned True.

        Parameters
        ----------
        run : Run
            Has the methods `shown` and `residual_of`.
        stage, step : Stage, Step
        found : Measured or None
            None if the step was not measured.
        is_last : bool
            The run ends with this step.
        """
        callback, iterations = self.callback, stage.iterations
        residual = None if found is None else found.residual
        with self.clock.pause():
            seconds, name = self.seconds, stage.algorithm.name
            sample = Sample(self.iteration, self.work, seconds, residual, name)
            wants_to_stop = callback is not None and bool(callback(sample, run.shown(step)))
            is_recorded = self.settings.record and (
                self.iteration >= self._next_sample or is_last or wants_to_stop
            )
            is_printed = self.settings.verbose and iterations >= self._next_line
            if residual is None and (is_recorded or is_printed):
                sample = Sample(self.iteration, self.work, seconds, run.residual_of(step), name)
            if is_printed:
                self._next_line = max(iterations + 1, math.ceil(iterations * 1.5))
                shown = "–" if sample.residual is None else f"{sample.residual:.2e}"
                say(f"{sample.iteration:>12} {sample.work:>10.1f} {shown:>19} {seconds:>9.3f}")
            if is_recorded:  # at geometric intervals
                self._next_sample = max(self.iteration + 1, math.ceil(self.iteration * 1.05))
                self.samples.append(sample)
        return wants_to_stop

    def records(self) -> tuple[StageRecord, ...]:
        """Return the stages as a result shows them."""
        return tuple(record for stage in self.stages for record in stage.records())

    def conclude(self, result: Result) -> None:
        """Print the status, the residual and the advice."""
        if self.settings.verbose:
            say(
                f"{result.status.name}: relative residual {result.residual:.2e} after {result.iterations} "
                f"iterations, the work of {result.work:.1f} products of M with a vector, {result.seconds:.3g} s; "
                f"{result.advice}"
            )


def say(line: str) -> None:
    """Print a line; characters that the terminal cannot show are replaced."""
    encoding = getattr(sys.stdout, "encoding", None) or "utf-8"
    print(line.encode(encoding, "replace").decode(encoding), flush=True)
