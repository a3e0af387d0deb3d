"""The loop of a run: methods propose points, each point is measured, and a stage ends at the first reason to do so.

One loop serves every problem class. A class derives its run from :class:`Run`, defines `measure` and `result`, and
yields the stages of its plan. The reason to end is a status. After STALLED or DIVERGED the next stage begins, after any
other the run ends. STALLED also means that a method has no further step, or has used its budget.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import nullcontext
from dataclasses import dataclass, field
from typing import Any, NamedTuple, TypeVar

from ..core import deadline
from ..core.algorithm import Step
from ..core.checks import Vector, fill, read_only
from ..core.errors import InvalidOption
from ..core.lcp import LCP
from ..core.settings import LIMITS, PROVEN, Settings, Status, checked_callback
from ..proofs.verdicts import classes_in_words, sign_remark
from .result import NOTHING_TO_DO, BaseResult, Callback, Result, Sample, StageRecord

FIRST_CHECK = 10  # iteration of the first residual that the method does not report
FIRST_FLOOR_CHECK = 25  # iterations without a fall
# a residual that has not fallen below this share of an earlier residual has not fallen
PROGRESS = 0.99
FAILED = (Status.STALLED, Status.DIVERGED)  # another algorithm may do better
R = TypeVar("R", bound=BaseResult)
SPENT, NO_STEP = "budget spent", "steps ended"  # endings of a stage
# the status of a point that does not pass
CUT_SHORT = (*LIMITS, Status.INTERRUPTED, Status.DIVERGED)


class Named(NamedTuple):
    """Name of a stage that runs no algorithm of this package."""

    name: str


class Budget(NamedTuple):
    """When a stage ends in favour of the next: for readers, and as a function that is called after each step."""

    until: str = ""
    is_over: Callable[[Any], bool] = lambda stage: False


@dataclass
class Trend:
    """Residuals of a stage, and whether they still fall.

    Attributes
    ----------
    residuals : list of (int, float)
        Iteration and relative residual: the first measurements and the latest, at most 512.
    best : float
        The least residual.
    rises : int
        Number of latest residuals that exceed the residual before each.
    has_changed_parameter : bool
        Whether the method has changed a parameter.
    next_check, floor_check : int
        Iteration of the next measurement; iterations without a fall until the next comparison with rounding.
    fall, window : (int, float)
        Iteration and best residual at the last fall, and at the start of the present test of progress.
    """

    residuals: list[tuple[int, float]] = field(default_factory=list)
    best: float = math.inf
    rises: int = 0
    has_changed_parameter: bool = False
    next_check: int = FIRST_CHECK
    residual_per_increment: float = 1.0
    fall: tuple[int, float] = (0, math.inf)
    window: tuple[int, float] | None = None
    floor_check: int = FIRST_FLOOR_CHECK

    def is_due(self, iteration: int, increment: float | None, goal: float) -> bool:
        """Return whether the run must measure the residual: at geometric intervals, and if it may be small enough.

        The increment of the step, relative to the reference, estimates it.
        """
        if not self.residuals or increment is None or iteration >= self.next_check:
            return True
        return increment * self.residual_per_increment <= goal

    def record(self, iteration: int, residual: float, increment: float | None = None) -> None:
        """Record the relative residual of an iteration.

        With the increment of a step whose residual had to be measured, the next measurement is due at 1.5 times the
        iterations.
        """
        if increment is not None:
            self.next_check = math.ceil(max(iteration, FIRST_CHECK) * 1.5)
            if increment > 0.0:
                self.residual_per_increment = residual / increment
        before = self.residuals[-1][1] if self.residuals else math.inf
        self.rises = self.rises + 1 if residual > before else 0
        self.best = min(self.best, residual)
        if len(self.residuals) >= 512:
            self.residuals.pop()
        self.residuals.append((iteration, residual))

    def change_parameter(self) -> None:
        """Begin the test of progress again."""
        self.has_changed_parameter, self.window = True, None

    def is_flat(self) -> bool:
        """Return whether it is time to compare with rounding: no fall for 25, 50, 100, … iterations."""
        iteration, (since, value) = self.residuals[-1][0], self.fall
        if self.best < PROGRESS * value:
            self.fall, self.floor_check = (iteration, self.best), FIRST_FLOOR_CHECK
        elif iteration - since >= self.floor_check:
            self.floor_check *= 2
            return True
        return False

    def is_stalled(self, n: int, goal: float, iterations_left: int) -> bool:
        """Return whether the residual fell by less than 1 % in a window, and the rest will not reach the goal.

        A front that crosses the unknowns, one in a sweep, does not change the largest residual until it has passed. So
        a window has 200 to 2000 iterations, n if that is between, and half as many as the stage had before it.
        """
        best, now = self.best, (self.residuals[-1][0], self.best)
        self.window = since, value = self.window or now
        if (steps := now[0] - since) < max(200, min(n, 2000), since // 2):
            return False
        self.window = now
        fall = math.log(value / best) / steps if 0.0 < best < value else 0.0
        needed = math.log(best / goal) if 0.0 < goal < best else math.inf
        return best >= PROGRESS * value and needed > fall * iterations_left

    def steps_to_go(self, goal: float) -> float:
        """Return the number of further iterations to that residual, at the rate of the second half of the stage.

        At the rate of all of it if steps settle, as psor's do: each trial of a relaxation raises the residual.
        """
        if not self.residuals:
            return math.inf
        last_step, last = self.residuals[-1]
        if last <= goal:
            return 0.0
        since = 0 if self.has_changed_parameter else last_step // 2
        first_step, first = next(entry for entry in self.residuals if entry[0] >= since)
        if last_step == first_step or not (goal > 0.0 and 0.0 < last < first):
            return math.inf
        rate = (last / first) ** (1.0 / (last_step - first_step))
        return math.log(goal / last) / math.log(rate) if 0.0 < rate < 1.0 else math.inf


@dataclass(eq=False)
class Stage:
    """Method of a run, with its budget, its counts and its residuals.

    Attributes
    ----------
    algorithm : Algorithm, or another object with a `name`
    because : str
        The reason for it, for readers.
    budget : Budget
        When the next method takes over.
    steps : iterable of Step
        The proposed points, unless the run takes them from the algorithm.
    is_reported : bool
        True for a run that reports its steps itself.
    iterations, work : int, float
        Work in passes over M.
    z : ndarray, shape (n,), or None
        The latest iterate, as long as the stage lasts.
    trend : Trend
        Of its residuals.
    parts : list of (str, int, float)
        Label, iterations and work, if the algorithm labels its steps.
    remark : str
        A clause for the advice.
    ending : str
        Why it failed: SPENT, NO_STEP or "no progress".
    """

    algorithm: Any
    because: str = ""
    budget: Budget = Budget()  # noqa: RUF009 - immutable
    steps: Iterable[Step] = ()
    is_reported: bool = False
    iterations: int = 0
    work: float = 0.0
    z: Vector | None = None
    trend: Trend = field(default_factory=Trend)
    parts: list[tuple[str, int, float]] = field(default_factory=list)
    remark: str = ""
    ending: str = ""


class Progress:
    """Counters, samples and limits of one call, shared by the runs on parts of its problem.

    Parameters
    ----------
    problem : object
    settings : Settings
    callback : callable or None
    clock : deadline.Clock, optional
        Running.

    Attributes
    ----------
    stages : list of Stage
        The stages that began, in order.
    samples : list of Sample
    iteration : int
        Number of iterations; −1 before the first step.
    work, seconds, setup_seconds : float
    end : Status or None
        The limit, the callback or Ctrl-C that ended the call.
    """

    def __init__(
        self,
        problem: Any,
        settings: Settings,
        callback: Callback | None = None,
        clock: deadline.Clock | None = None,
    ) -> None:
        self.settings, self.callback = settings, checked_callback(callback)
        self.clock = deadline.Clock(settings.max_seconds) if clock is None else clock
        self.is_watched = settings.record or settings.verbose or callback is not None
        self.stages: list[Stage] = []
        self.samples: list[Sample] = []
        self.iteration, self.work, self.seconds, self.setup_seconds = -1, 0.0, 0.0, 0.0
        self.end: Status | None = None
        self._next_sample = self.next_line = 0
        if settings.verbose:
            with self.clock.pause():
                say_problem(problem)

    def count(self, stage: Stage, step: Step) -> None:
        """Count a step, which may be no iteration, and its work, for the part of its label if it has a label."""
        self.seconds = self.clock.read()
        is_start, iterations = stage.z is None, step.iterations
        if iterations is None:
            iterations = int(not is_start)
        stage.z, stage.remark = step.z, step.remark or stage.remark
        stage.iterations, stage.work = stage.iterations + iterations, stage.work + step.work
        if step.is_settling:
            stage.trend.change_parameter()
        if label := step.label or (stage.algorithm.name if stage.parts else ""):
            is_same = bool(stage.parts) and stage.parts[-1][0] == label
            _, before, spent = stage.parts.pop() if is_same else ("", 0, 0.0)
            stage.parts.append((label, before + iterations, spent + step.work))
        self.iteration, self.work = max(self.iteration, 0) + iterations, self.work + step.work
        if is_start and self.iteration == 0:
            self.setup_seconds = self.seconds

    def limit(self) -> Status | None:
        """Return the limit that is reached, or None; the clock was read at the last step."""
        if self.iteration >= self.settings.max_iterations:
            self.end = Status.MAX_ITERATIONS
        elif self.clock.is_over:
            self.end = Status.MAX_SECONDS
        return self.end

    def report(self, run: Run, stage: Stage, step: Step, point: Any, *, is_last: bool) -> bool:
        """Record, print and call back, with the clock paused; return whether the callback returned True.

        Parameters
        ----------
        run : Run
            Has the methods `shown` and `residual_of`.
        stage, step : Stage, Step
        point : Measured or None
            None if the step was not measured.
        is_last : bool
            The run ends with this step.
        """
        callback, iterations = self.callback, stage.iterations
        residual = None if point is None else point.residual
        with self.clock.pause():
            seconds, name = self.seconds, stage.algorithm.name
            sample = Sample(self.iteration, self.work, seconds, residual, name)
            wants_to_stop = callback is not None and bool(callback(sample, run.shown(step)))
            is_recorded = self.settings.record and (
                self.iteration >= self._next_sample or is_last or wants_to_stop
            )
            is_due = bool(step.note) or iterations >= self.next_line
            is_printed = self.settings.verbose and is_due
            if residual is None and (is_recorded or is_printed):
                sample = Sample(self.iteration, self.work, seconds, run.residual_of(step), name)
            if is_printed:
                self.next_line = max(iterations + 1, math.ceil(iterations * 1.5))
                say_sample(sample, step.note)
            if is_recorded:  # at geometric intervals
                self._next_sample = max(self.iteration + 1, math.ceil(self.iteration * 1.05))
                self.samples.append(sample)
        return wants_to_stop

    def records(self) -> tuple[StageRecord, ...]:
        """Return the stages as a result shows them."""
        records: list[StageRecord] = []
        for stage in self.stages:
            parts = stage.parts or [(stage.algorithm.name, stage.iterations, stage.work)]
            first = len(records)
            records += [StageRecord(name, "", steps, work) for name, steps, work in parts]
            records[first] = records[first]._replace(because=stage.because)
            records[-1] = records[-1]._replace(remark=stage.remark, ending=stage.ending)
        return tuple(records)


def say(line: str) -> None:
    """Print a line; characters that the terminal cannot show are replaced."""
    encoding = getattr(sys.stdout, "encoding", None) or "utf-8"
    print(line.encode(encoding, "replace").decode(encoding), flush=True)


def say_problem(problem: object) -> None:
    """Print the first lines of a log: the problem, the classes of M that its entries show, and the columns."""
    matrix = problem.matrix if isinstance(problem, LCP) else None
    say(str(problem) if matrix is None else f"{problem}; M {classes_in_words(matrix)}")
    if matrix is not None and (remark := sign_remark(matrix)):
        say(remark)
    say(f"{'iteration':>12} {'work':>10} {'relative residual':>19} {'seconds':>9}")


def say_sample(sample: Sample, note: str = "") -> None:
    """Print the line of a sample in a log."""
    shown = "–" if sample.residual is None else f"{sample.residual:.2e}"
    say(f"{sample.iteration:>12} {sample.work:>10.1f} {shown:>19} {sample.seconds:>9.3f}{note}")


def with_samples(
    problem: object,
    result: R,
    settings: Settings,
    callback: Callback | None,
    start: tuple[Vector, float | None],
    residual: float,
) -> R | None:
    """Return the result of a solve without a run, recorded, printed and reported; None if the callback ends it at once.

    Parameters
    ----------
    problem : object
    start : array, float or None
        With its residual.
    residual : float
        Of the result.
    """
    if checked_callback(callback) is None and not settings.is_watched:
        return result
    name = result.stages[-1].name if result.stages else result.algorithm
    last = Sample(result.iterations, getattr(result, "work", 0.0), result.seconds, residual, name)
    first = Sample(0, 0.0, result.seconds, start[1], name)
    samples = (first, last) if last.iteration else (last,)
    for sample, z in zip(samples, (start[0], result.x)[-len(samples) :], strict=True):
        try:
            is_over = callback is not None and callback(sample, read_only(z))
        except KeyboardInterrupt:  # Ctrl-C, as in a run
            is_over = True
        if is_over and sample is not last:
            return None
    if settings.verbose:
        say_problem(problem)
        for stage in result.stages:
            say(stage.name + (stage.because and f": {stage.because}"))
        say_sample(last)
        say(f"{result.status.name}: {result.describe_accuracy()}; {result.advice}")
    return fill(result, history=samples if settings.record else ())


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
        A verified proof that the problem has no solution: of several proofs, the proof with the largest margin.
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

    def end_of(self, stage: Stage, step: Step, point: Any) -> Status | None:
        """Return a reason of this problem class to end the stage with this step, or None."""
        return None

    def end_of_stage(self, stage: Stage, end: Status) -> Status:
        """Return why a stage ended; the run continues with the next stage if this reason is one of FAILED.

        A class that measures its best point only here replaces this function.
        """
        if end not in FAILED or self.best is None:
            return end
        if self.best.passes:
            return Status.SOLVED
        return Status.PRECISION_LIMIT if self.best.is_limited else end

    def steps_of(self, stage: Stage) -> Iterator[Step]:
        """Return the steps of a stage."""
        return iter(stage.steps)

    def shown(self, step: Step) -> Any:
        """Return the point z of a step that is passed to the user's callback; it cannot be modified."""
        return read_only(step.z)

    def result(self, end: Status) -> Any:
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

    def fields_at(self, z: Vector, status: Status) -> dict[str, Any]:
        """Return the fields of a result at z, except `algorithm` and `certificate`."""
        progress, common = self.progress, self.common_fields(status)
        if status is Status.SOLVED and progress.iteration <= 0 and self.best is not None:
            stages = (stage._replace(because=NOTHING_TO_DO) for stage in common["stages"])
            common["stages"] = tuple(stages)
        return common | {
            "z": read_only(z + math.nan) if status in PROVEN else z,
            "absolute_tolerance": self.settings.absolute_tolerance,
            "work": progress.work,
            "setup_seconds": progress.setup_seconds,
        }

    def result_at(
        self, certificate: Any, status: Status, result_class: type[Result] = Result, **others: Any
    ) -> Result:
        """Return the result of a run that ends with this certificate; `others` are further fields of its class."""
        fields = self.fields_at(certificate.z, status)
        result = result_class(certificate=certificate, **fields, **others)
        if self.settings.verbose:
            say(
                f"{status.name}: relative residual {result.residual:.2e} after {result.iterations} iterations, "
                f"the work of {result.work:.1f} products of M with a vector, {result.seconds:.3g} s; {result.advice}"
            )
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
            self.progress.end = Status.INTERRUPTED
            return self.result(Status.INTERRUPTED)

    def follow_all(self, plan: Iterable[Stage]) -> Status:
        """Run the stages one after the other, until one of them ends the run or the time is over; return the reason.

        Ctrl-C ends it with KeyboardInterrupt, because it also ends the runs around this one.
        """
        progress, end = self.progress, Status.STALLED
        left = progress.clock.left
        try:
            with nullcontext() if left == math.inf else deadline.limit(left, is_enforced=True):
                for stage in plan:
                    end = self.follow(stage)
                    if end not in FAILED or progress.end is not None:
                        break
        except deadline.OutOfTimeError:
            progress.end = Status.MAX_SECONDS
        return progress.end or end

    def follow(self, stage: Stage) -> Status:
        """Take the steps of a stage until the run, the budget of the stage or its steps end."""
        progress = self.progress
        progress.next_line = 0
        if self.settings.verbose:
            say(stage.algorithm.name + (stage.because and f": {stage.because}"))
        if progress.stages:
            progress.stages[-1].z = None
        if stage not in progress.stages:  # otherwise it continues
            progress.stages.append(stage)
        for step in self.steps_of(stage):
            if (end := self._take(stage, step)) is not None:
                stage.ending = "no progress" if end is Status.STALLED else ""
                break
            if stage.budget.is_over(stage):
                stage.ending = SPENT
                return Status.STALLED
        else:
            progress.clock.read()  # steps may end by themselves because time is over
            stage.ending, end = NO_STEP, Status.STALLED
            if progress.clock.is_over:
                end = progress.end = Status.MAX_SECONDS
        end = self.end_of_stage(stage, end)
        if end not in FAILED:
            stage.ending = ""
        return end

    def _take(self, stage: Stage, step: Step) -> Status | None:
        """Count, measure and report one step; return why the stage ends with it, or None."""
        progress = self.progress
        if not isinstance(step, Step):  # of an algorithm from outside
            raise InvalidOption(
                f"{stage.algorithm.name}.iterates must yield Step(z), got {type(step).__name__}; write `yield Step(z)`"
            )
        progress.count(stage, step)
        point = self.latest = self.measure(stage, step)
        if point is not None:
            self.keep(point)
        passes = point is not None and point.passes
        end = Status.SOLVED if passes else self.end_of(stage, step, point) or progress.limit()
        is_watched = progress.is_watched and not stage.is_reported
        if is_watched and progress.report(self, stage, step, point, is_last=end is not None):
            progress.end = progress.end or Status.INTERRUPTED
            end = end or Status.INTERRUPTED
        if end is None and step.proof is not None:
            end = self.end_of_proof(step.proof)
        return end

    def residual_of(self, step: Step) -> float | None:
        """Return the residual that a method reports with its step, for the history; the step was not measured."""
        return step.residual

    def keep(self, point: Any) -> None:
        """Keep a measured point that passes, or whose residual is smaller than the best residual; NaN counts as ∞."""
        if self.best is None or point.passes or point.residual < self.residual:
            self.best = point
            self.residual = math.inf if math.isnan(point.residual) else float(point.residual)

    def end_of_proof(self, proof: Any) -> Status | None:
        """Store a verified proof; return NO_SOLUTION if it shows that no point can satisfy the tolerance, else None."""
        if not proof.verify():
            return None
        excludes = proof.excludes(self.settings.tolerance, self.settings.absolute_tolerance)
        is_best = excludes or self.proof is None or proof.margin > self.proof.margin
        if is_best and self.settings.prove_infeasibility:
            self.proof = proof
        return Status.NO_SOLUTION if excludes else None

    def status(self, end: Status) -> Status:
        """Return the status of the best point or of a proof, or else of the reason for the end of the run."""
        if self.best is not None and self.best.passes:
            return Status.SOLVED
        if end is Status.NO_SOLUTION and self.proof is not None:
            return self.proof.status
        if self.best is not None and self.best.is_limited:
            return Status.PRECISION_LIMIT
        return end if end in CUT_SHORT else Status.STALLED
