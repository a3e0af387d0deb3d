"""The run of a batch: stacks for small problems, :func:`lcp_plugin.solve` for others."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import replace
from functools import cached_property
from threading import Lock
from typing import Any

import numpy as np

from ...api import solve
from ...core.checks import read_only
from ...core.deadline import Clock
from ...core.errors import InvalidOption, LCPError, UnknownAlgorithm, WorkerLost
from ...core.executors import run_on
from ...core.lcp import LCP
from ...core.settings import Settings, Status, checked_callback, checked_threads
from ...core.solving.base_result import BaseResult
from ...core.solving.result import Result, StageRecord
from ..least_squares.certificate import Optimality
from ..least_squares.data import BoundedLeastSquares, Enclosures
from ..least_squares.solving import LeastSquaresResult
from ..many.answers import AnswerSequence
from ..many.chunks import run_in_chunks
from .stated import Listed

MOST_ITERATIONS = 200  # of a stack
# Jobs per batch on an executor: 4 for each of 16 workers level out unequal times. More jobs cost memory, because each
# has its copy of a shared M, and all are in memory at once; of more than 64 workers, some have no job.
MAX_JOBS = 64
GRACE = 0.9  # seconds after the limit in which results arrive from workers
REPORTING = Lock()  # threads call the callback one after another


class BatchRun:
    """The results in tables with a row per problem.

    Parameters
    ----------
    problems : Listed, Stacked, RightSides, Worlds or QuadraticProgramBatch
        ``problems[k]``, ``problems.start(k)``, ``problems.points``: a table of z at the start,
        ``problems.errors``: the error of problem k, if its data are invalid,
        ``problems.stacks(tolerance, has_time)``: pairs of item numbers and a function that returns z, residual,
        iterations and is_solved of these.
    algorithm : str or Algorithm
    options : dict
        Options of solve_batch other than defaults.
    """

    def __init__(self, problems: Any, algorithm: Any, options: dict[str, Any]) -> None:
        self.problems, self.algorithm, count = problems, algorithm, len(problems)
        self.item = getattr(problems, "item", "problem")
        self.settings, self.threads = Settings(**options), checked_threads(options.get("threads"))
        self.given = options
        self.options = {name: options[name] for name in options.keys() - {"max_seconds", "threads"}}
        self.errors, self.z = {**getattr(problems, "errors", {})}, problems.points
        for k in self.errors if isinstance(self.z, np.ndarray) else ():
            self.z[k] = np.nan
        self.status, self.residual = np.full(count, None), np.full(count, np.nan)
        self.iterations, self.is_open = np.zeros(count, np.int64), np.ones(count, np.bool_)
        self.is_open[[*self.errors]] = False
        self.results: dict[int, Any] = {}  # of problems outside of stacks
        self.is_interrupted, self.seconds, self.clock = False, 0.0, Clock()
        self.callback: Any = None
        self.numbers = np.arange(count)  # of the problems, in errors

    @property
    def has_time(self) -> bool:
        """True until the time limit of the batch is reached, or it is interrupted."""
        return not self.is_interrupted and self.clock.read() < self.settings.max_seconds

    def report(self) -> None:
        """Call the callback with the number of finished problems; a truthy return value ends the batch."""
        if self.callback is not None:
            with REPORTING:
                count = len(self.status)
                self.is_interrupted |= bool(self.callback(count - int(self.is_open.sum()), count))

    @np.errstate(all="ignore")
    def run(self, callback: Any = None, executor: Any = None) -> BatchAnswers:
        """Solve all problems, until the clock runs out, Ctrl-C, or the callback ends the batch."""
        self.callback = checked_callback(callback)
        lost: WorkerLost | None = None
        try:
            if executor is not None:
                self._solve_on(executor)
            else:
                self.solve_at_once()
            for k in np.flatnonzero(self.is_open).tolist():
                if not self.has_time:
                    break
                self._solve_or_keep_error(k)
                self.report()
        except KeyboardInterrupt:
            self.is_interrupted = True
        except WorkerLost as error:
            lost = error
            self.is_interrupted = True
        self.callback = None  # which need not be picklable
        end = Status.INTERRUPTED if self.is_interrupted else Status.MAX_SECONDS
        self.status[self.is_open] = end
        self.seconds = self.clock.read()
        answers = BatchAnswers(self)
        if lost is not None:
            lost.finished = answers
            raise lost
        return answers

    def _solve_on(self, executor: Any) -> None:
        """Solve chunks of the problems on an executor, with one thread each."""
        options: dict[str, Any] = {"threads": 1, **self.given}
        limit = self.settings.max_seconds
        end = time.time() + limit - self.clock.read()  # of the day: chunks may begin late
        problems = {}
        for k in np.flatnonzero(self.is_open).tolist():
            try:
                problems[k] = self.problems[k]
            except LCPError as error:
                self._keep_error(k, error)
        jobs, count = [], min(MAX_JOBS, len(problems))
        for part in np.array_split([*problems], count) if count else []:
            chosen = [problems[k] for k in part.tolist()]
            starts = [self.problems.start(k) for k in part.tolist()]
            jobs.append((part, end, type(self), chosen, starts, self.algorithm, options))
        patience = limit + GRACE
        for _, (part, run) in run_on(
            executor, _run_part, jobs, lambda: patience - self.clock.read()
        ):
            self.take(part, run)
            self.report()
            if self.is_interrupted:
                return

    @classmethod
    def of(cls, problems: list[Any], starts: list[Any], *given: Any) -> BatchRun:
        """Return the run of a list of problems with their starts, or None without a start."""
        has_starts = any(start is not None for start in starts)
        return cls(Listed(problems, starts if has_starts else None), *given)

    def take(self, items: Any, run: BatchRun) -> None:
        """Take the results of the run of these problems; the others stay open."""
        for i, k in enumerate(items.tolist()):
            self._set_point(k, run.z[i])
        for name in ("status", "residual", "iterations", "is_open"):
            getattr(self, name)[items] = getattr(run, name)
        for i, found in run.results.items():
            self.keep(items[i], found)
        self.errors |= {int(items[i]): error for i, error in run.errors.items()}

    def solve_at_once(self) -> None:
        """Solve small problems in stacks, on the threads, while there is time; a stack replaces only `auto`."""
        few = self.settings.max_iterations < MOST_ITERATIONS
        if self.algorithm != "auto" or self.settings.absolute_tolerance or few:
            return
        stacks = [*self.problems.stacks(self.settings.tolerance, lambda: self.has_time)]

        def take(first: int, end: int) -> None:
            for items, solve_stack in stacks[first:end]:
                if not self.has_time:
                    return
                z, residual, iterations, is_solved = solve_stack()
                good = np.flatnonzero(is_solved & self.is_open[items])
                at = items[good]
                if isinstance(self.z, np.ndarray):
                    self.z[at] = z[good]
                else:
                    for k, i in zip(at.tolist(), good.tolist(), strict=True):
                        self._set_point(k, z[i])
                self.residual[at], self.iterations[at] = residual[good], iterations[good]
                self.status[at], self.is_open[at] = Status.SOLVED, False
                self.report()

        run_in_chunks(take, len(stacks), self.threads)

    def _solve_or_keep_error(self, k: int) -> None:
        options = dict(self.options)
        if self.settings.max_seconds < np.inf:
            options["max_seconds"] = max(self.settings.max_seconds - self.clock.read(), 0.0)
        try:
            self.solve_alone(k, options)
        except Exception as error:
            is_of_call = isinstance(error, (InvalidOption, UnknownAlgorithm))
            if is_of_call or not isinstance(error, LCPError):
                error.add_note(f"in problem {self.numbers[k]} of the batch")
                raise
            self._keep_error(k, error)

    def _keep_error(self, k: int, error: LCPError) -> None:
        self.errors[k], self.is_open[k] = error, False
        if isinstance(self.z, np.ndarray):
            self.z[k] = np.nan

    def solve_alone(self, k: int, options: dict[str, Any]) -> None:
        """Solve problem k by itself."""
        self.keep(k, self._solved(k, self.problems.start(k), options))

    def keep(self, k: int, found: Any) -> None:
        """Keep the result of problem k."""
        self.results[k] = found
        self._set_point(k, np.empty(0) if found.x is None else found.x)
        if isinstance(found, Result):
            self.residual[k] = found.certificate.relative_residual
        self.status[k], self.iterations[k], self.is_open[k] = found.status, found.iterations, False
        self.is_interrupted |= found.status is Status.INTERRUPTED

    def _set_point(self, k: int, x: Any) -> None:
        if isinstance(self.z, np.ndarray):
            self.z[k], self.z[k, : x.size] = 0.0, x
        else:
            self.z[k] = read_only(x)

    def _solved(self, k: int, start: Any, options: dict[str, Any]) -> Any:
        given = {} if start is None else {"z0": start}
        named = {} if self.algorithm == "auto" else {"algorithm": self.algorithm}
        return solve(self.problems[k], **given, **named, **options)

    def result_of(self, k: int) -> Any:
        """Return the result of problem k, which has no error; its start if it never ran."""
        if k not in self.results:
            self.results[k] = self._result_at(k, self.problems[k])
        return self.results[k]

    def _result_at(self, k: int, problem: Any) -> Any:
        if self.status[k] is not Status.SOLVED:
            options = {**self.options, "max_seconds": 0.0}
            found = self._solved(k, self.problems.start(k), options)
            return replace(found, status=self.status[k])
        share, iterations = self.seconds / len(self.status), int(self.iterations[k])
        if isinstance(problem, BoundedLeastSquares):
            tolerance = self.settings.tolerance
            with np.errstate(all="ignore"):
                point = Optimality.of(Enclosures(problem), self.z[k], tolerance=tolerance)
                found = (Status.SOLVED, iterations, "normal equations", share, tolerance)
                return LeastSquaresResult.at(point, *found)
        z = self.z[k][: problem.n]
        if isinstance(problem, LCP):
            stage = StageRecord("rounds", "one of a stack of small problems", iterations, 0.0)
            return Result.at(problem, read_only(z), stage, self.settings, share)
        found = self._solved(k, z, self.options)
        stage = StageRecord("nsgs", "one of a stack over the same cones", iterations, iterations)
        named = {"iterations": iterations, "work": iterations + 1.0, "stages": (stage,)}
        return replace(found, seconds=share, **named)

    def tables(self) -> dict[str, Any]:
        """Return the arrays of the results by name."""
        z = self.z
        if not isinstance(z, np.ndarray) and len(sizes := {len(row) for row in z if len(row)}) <= 1:
            z = np.full((len(z), *(sizes or {0})), np.nan)
            for k, row in enumerate(self.z):
                z[k, : len(row)] = row
        z = read_only(z) if isinstance(z, np.ndarray) else z
        return {"x": z, "z": z, "relative_residual": self.residual, "iterations": self.iterations}

    def objectives(self) -> Any:
        """Return the objective of each problem, NaN if it has none."""
        values = np.full(len(self.status), np.nan)
        if hasattr(self.problems, "objectives"):
            values = self.problems.objectives(self.z)
        for k, found in self.results.items():
            values[k] = np.nan if found.objective is None else found.objective
        return values


def _run_part(job: Any) -> tuple[Any, BatchRun]:
    """Return the numbers of some problems and their finished run, without the problems, which the caller has."""
    part, end, kind, *given, options = job
    if end < math.inf:
        options = {**options, "max_seconds": max(end - time.time(), 0.0)}
    run: BatchRun = kind.of(*given, options)
    run.numbers = part
    run.run()
    del run.problems
    return part, run


class BatchAnswers(AnswerSequence[Any]):
    """The results of a batch of problems; ``answers[k]`` is the result of :func:`lcp_plugin.solve`.

    Parameters
    ----------
    run : BatchRun
        The finished run.

    Attributes
    ----------
    x, z : array, shape (B, n), or a list of arrays if the sizes differ
        NaN if the data are invalid; 0 for absent contacts of an instance.
    status : array of Status, shape (B,)
        None if the data are invalid.
    relative_residual : array, shape (B,)
        Upper bound of the residual of the stopping criterion; NaN if it was not measured.
    inequality, equality, lower, upper, residual : array
        Programs of one shape only: multipliers as in QPSolution, and an upper bound of the largest error measure.
    iterations : array of int, shape (B,)
    seconds : float
        Seconds of the entire batch, compilation excluded. Results from a stack have a share of it.
    errors : dict
        The error of each problem k with invalid data; ``answers[k]`` raises it.
    problems : Listed, Stacked, FrictionalContactBatch or QuadraticProgramBatch
    threads : int
        Number of threads that took part.
    """

    status: Any
    x: Any
    z: Any
    relative_residual: Any
    iterations: Any
    inequality: Any
    equality: Any
    lower: Any
    upper: Any
    residual: Any

    def __init__(self, run: BatchRun) -> None:
        self._run, self.item = run, run.item
        self.status, self.seconds = run.status, run.seconds
        self.errors, self.problems, self.threads = run.errors, run.problems, run.threads
        vars(self).update(run.tables())
        for table in vars(self).values():
            if isinstance(table, np.ndarray):
                table.flags.writeable = False

    def __len__(self) -> int:
        return len(self.status)

    def at(self, k: int) -> BaseResult:
        """Return result k, or raise the error of its problem."""
        if k in self.errors:
            raise self.errors[k]
        found: BaseResult = self._run.result_of(k)
        return found

    @cached_property
    def objective(self) -> Any:
        """Objective of each problem, shape (B,); NaN if it has none."""
        return self._run.objectives()

    @cached_property
    def w(self) -> Any:
        """M z + q of each problem, like z; velocities of contacts, 1 for absent contacts."""
        return self._compute("w", lambda problems: problems.slacks(self.z))

    @property
    def motion(self) -> Any:
        """Impulses and velocities per contact, a ContactMotion with a batch axis in front."""
        return self._compute("motion", lambda problems: problems.motion(self.z, self.w))

    def _compute(self, name: str, function: Callable[[Any], Any]) -> Any:
        try:
            return function(self.problems)
        except AttributeError as error:
            tables = ", ".join(one for one in BatchAnswers.__annotations__ if one in vars(self))
            raise AttributeError(
                f"BatchAnswers of these problems has no {name}; its arrays include {tables}"
            ) from error
