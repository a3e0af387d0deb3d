"""The run of a batch: stacks for small problems, :func:`lcp_plugin.solve` for others."""

from __future__ import annotations

import math
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from functools import cached_property
from threading import Lock
from typing import Any

import numpy as np

from ...core.checks import Array, read_only
from ...core.deadline import Clock
from ...core.errors import InvalidOption, LCPError, UnknownAlgorithm
from ...core.lcp import LCP
from ...core.settings import DEFAULT, Settings, Status, checked_callback, checked_threads
from ...judges.lcp import Measured
from ...methods.small import LOOP_UP_TO
from ...solving.dispatch import method_of, solve
from ...solving.result import BaseResult, Result, StageRecord
from ..least_squares.certificate import Optimality
from ..least_squares.data import BoundedLeastSquares, Enclosures
from ..least_squares.solving import LeastSquaresResult
from ..many import AnswerSequence, run_in_chunks
from ..programs.result import QuadraticProgramResult
from ..programs.solution import QPSolution
from .program_batch import ENGINE, ProgramBatch

REPORTING = Lock()  # at most one thread is in the callback
UNREAD = -1  # iterations of a problem outside of stacks: its result has them


class BatchRun:
    """The results in tables with a row per problem.

    It is one class because stacks, single solves and limits fill the same tables.

    Parameters
    ----------
    problems : Listed, Stacked, RightSides, contacts in arrays or ProgramBatch
        ``problems[k]``, ``problems.start(k)``, ``problems.points``: a table of z at the start,
        ``problems.errors``: the error of problem k, if its data are invalid,
        ``problems.stacks(tolerance, has_time, threads)``: pairs of item numbers and a function that returns z,
        residual, iterations and is_solved of these.
    algorithm : str or Algorithm
    options : dict
        Options of solve_batch other than defaults.
    """

    def __init__(self, problems: Any, algorithm: Any, options: dict[str, Any]) -> None:
        self.problems, self.algorithm, count = problems, algorithm, len(problems)
        self.settings = Settings(**options) if options else DEFAULT
        self.threads = checked_threads(options.get("threads"))
        self.options = {name: options[name] for name in options.keys() - {"max_seconds", "threads"}}
        self.errors, self.z = {**problems.errors}, problems.points
        if self.errors and isinstance(self.z, np.ndarray):
            self.z[[*self.errors]] = np.nan
        self.status, self.residual = np.full(count, None), np.full(count, np.nan)
        self.iterations, self.is_open = np.zeros(count, np.int64), np.ones(count, np.bool_)
        self.is_open[[*self.errors]] = False
        self.results: dict[int, Any] = {}  # of problems outside of stacks
        self.is_interrupted, self.seconds, self.clock = False, 0.0, Clock(self.settings.max_seconds)
        self.callback: Any = None

    def has_time(self) -> bool:
        """Return whether the limit is not reached and nothing interrupted the batch."""
        return not self.is_interrupted and self.clock.left > 0.0

    def report(self) -> None:
        """Call the callback with the number of finished problems; a truthy return value ends the batch."""
        if self.callback is not None:
            with REPORTING:
                count = len(self.status)
                self.is_interrupted |= bool(self.callback(count - int(self.is_open.sum()), count))

    @np.errstate(all="ignore")
    def run(self, callback: object = None) -> BatchAnswers:
        """Solve all problems, until the clock runs out, Ctrl-C, or the callback ends the batch."""
        self.callback = checked_callback(callback)
        try:
            self._solve_stacks()
            self._solve_others()
        except KeyboardInterrupt:
            self.is_interrupted = True
        except Exception as error:
            self.is_interrupted = True
            error.finished = self._answers()  # type: ignore[attr-defined]
            raise
        return self._answers()

    def _answers(self) -> BatchAnswers:
        self.callback = None  # which need not be picklable
        ended = Status.INTERRUPTED if self.is_interrupted else Status.MAX_SECONDS
        self.status[self.is_open], self.seconds = ended, self.clock.read()
        return BatchAnswers(self)

    def _solve_stacks(self) -> None:
        """Solve small problems in stacks, while there is time; a stack replaces only `auto`."""
        problems, settings = self.problems, self.settings
        if self.algorithm not in problems.stacked_by or settings.absolute_tolerance:
            return
        is_path = self.algorithm == "lemke"
        if settings.max_iterations < (1 if is_path else problems.fewest_iterations):
            return
        stacks_of = problems.path_stacks if is_path else problems.stacks
        stacks = [*stacks_of(settings.tolerance, self.has_time, self.threads)]

        def solve_some(first: int, end: int) -> None:
            for items, solve_stack in stacks[first:end]:
                if self.has_time():
                    self._take(items, *solve_stack())
                    self.report()

        sizes = (problems[int(items[0])].n for items, _ in stacks)
        n = self.z.shape[1] if isinstance(self.z, np.ndarray) else max(sizes, default=0)
        with one_blas_thread() if stacks and n > LOOP_UP_TO else nullcontext():
            run_in_chunks(solve_some, len(stacks), self.threads)

    def _take(self, items: Any, z: Array, residual: Array, iterations: Any, is_solved: Any) -> None:
        """Keep the solved problems of a stack."""
        at = items[good := np.flatnonzero(is_solved & self.is_open[items])]
        if isinstance(self.z, np.ndarray):
            self.z[at] = z[good]
        else:
            for k, i in zip(at.tolist(), good.tolist(), strict=True):
                self._set_point(k, z[i])
        self.residual[at], self.iterations[at] = residual[good], iterations[good]
        self.status[at], self.is_open[at] = Status.SOLVED, False

    def _solve_others(self) -> None:
        """Solve the other problems by themselves, while there is time."""
        for k in np.flatnonzero(self.is_open).tolist():
            if self.has_time():
                self._keep(k, self._solve(k))
                self.report()

    def _solve(self, k: int) -> Any:
        """Return the result of problem k, or its error."""
        options = {**self.options, "max_seconds": self.clock.left}
        try:
            return solve_one(self.problems[k], self.problems.start(k), self.algorithm, options)
        except Exception as error:
            is_of_call = isinstance(error, (InvalidOption, UnknownAlgorithm))
            if is_of_call or not isinstance(error, LCPError):
                error.add_note(f"in problem {k} of the batch")
                raise
            return error

    def _keep(self, k: int, result: Any) -> None:
        """Keep the result, or the error, of problem k."""
        self.is_open[k] = False
        if isinstance(result, LCPError):
            self.errors[k] = result
            if isinstance(self.z, np.ndarray):
                self.z[k] = np.nan
            return
        self.results[k], self.status[k], self.iterations[k] = result, result.status, UNREAD
        self._set_point(k, self.problems.row(result))
        self.is_interrupted |= result.status is Status.INTERRUPTED

    def _set_point(self, k: int, x: Array) -> None:
        if isinstance(self.z, np.ndarray):
            self.z[k], self.z[k, : x.size] = 0.0, x
        else:
            self.z[k] = read_only(x)

    def result_of(self, k: int) -> Any:
        """Return the result of problem k, which has no error; its start if it never ran."""
        if k not in self.results:
            self.results[k] = self._result_at(k, self.problems[k])
        return self.results[k]

    def _result_at(self, k: int, problem: Any) -> Any:
        share, iterations = self.seconds / len(self.status), int(self.iterations[k])
        settings, z = self.settings, self.z[k]
        run = {"iterations": iterations, "seconds": share, "tolerance": settings.tolerance}
        if isinstance(self.problems, ProgramBatch):
            by = f"auto: {ENGINE}" if self.algorithm == "auto" else ENGINE
            solution = QPSolution.of_rows(problem, z[: problem.n], z[problem.n :])
            return QuadraticProgramResult(solution, status=self.status[k], algorithm=by, **run)
        if self.status[k] is not Status.SOLVED:
            options = {**self.options, "max_seconds": 0.0}
            result = solve_one(problem, self.problems.start(k), self.algorithm, options)
            return replace(result, status=self.status[k])
        if isinstance(problem, BoundedLeastSquares):
            with np.errstate(all="ignore"):
                point = Optimality.of(Enclosures(problem), z, tolerance=settings.tolerance)
                by = "normal equations"
                return LeastSquaresResult.at(point, status=Status.SOLVED, algorithm=by, **run)
        if isinstance(problem, LCP):
            chosen = method_of(self.algorithm, {})
            name = "rounds" if chosen is None else chosen.name
            stage = StageRecord(name, "one of a stack of small problems", iterations, 0.0)
            measured = Measured(z[: problem.n], self.residual[k], passes=True)
            return Result.of(problem, measured, [stage], settings, share, chosen)
        result = solve_one(problem, z[: problem.n], self.algorithm, self.options)
        stage = StageRecord("nsgs", "one of a stack over the same cones", iterations, iterations)
        named = {"iterations": iterations, "work": iterations + 1.0, "stages": (stage,)}
        return replace(result, seconds=share, **named)

    def tables(self) -> dict[str, Any]:
        """Return the arrays of the results by name; a result that ran by itself computes its numbers here."""
        z, residual, iterations = self.z, self.residual.copy(), self.iterations.copy()
        for k in np.flatnonzero(iterations == UNREAD).tolist():
            iterations[k], residual[k] = self.results[k].iterations, error_of(self.results[k])
        if isinstance(self.problems, ProgramBatch):
            rows = self.problems.tables(z)
            return {**rows, "residual": residual, "iterations": iterations}
        if not isinstance(z, np.ndarray) and len(sizes := {len(row) for row in z if len(row)}) <= 1:
            z = np.full((len(z), *(sizes or {0})), np.nan)
            for k, row in enumerate(self.z):
                z[k, : len(row)] = row
        return {"x": z, "z": z, "relative_residual": residual, "iterations": iterations}

    def objectives(self) -> Any:
        """Return the objective of each problem, NaN if it has none."""
        values = np.full(len(self.status), np.nan)
        if hasattr(self.problems, "objectives"):
            values = self.problems.objectives(self.z)
        for k, result in self.results.items():
            values[k] = np.nan if result.objective is None else result.objective
        return values


def error_of(result: Any) -> Any:
    """Return the error measure of a result in a batch, NaN if it has none."""
    if isinstance(result, QuadraticProgramResult):
        return result.solution.error
    return result.certificate.relative_residual if isinstance(result, Result) else math.nan


def one_blas_thread() -> AbstractContextManager[Any]:
    """Return a context in which BLAS has one thread, as far as threadpoolctl is installed."""
    try:
        from threadpoolctl import threadpool_limits
    except ImportError:
        return nullcontext()
    return threadpool_limits(1)


def solve_one(problem: object, start: Array, algorithm: object, options: dict[str, Any]) -> Any:
    """Return the result of `solve`; None stands for the default start."""
    starts = {} if start is None else {"z0": start}
    named = {} if algorithm == "auto" else {"algorithm": algorithm}
    return solve(problem, **starts, **named, **options)


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
    problems : Listed, Stacked, RightSides, contacts in arrays or ProgramBatch
    threads : int
        Number of threads that took part.
    """

    x: Array
    z: Array
    relative_residual: Array
    iterations: Array
    inequality: Array
    equality: Array
    lower: Array
    upper: Array
    residual: Array

    def __init__(self, run: BatchRun) -> None:
        self._run, self.item = run, run.problems.item
        self.errors, self.problems, self.threads = run.errors, run.problems, run.threads
        self.status, self.seconds = read_only(run.status), run.seconds

    def __dir__(self) -> list[str]:
        """Return the names that an editor completes, those of the tables included."""
        return [*super().__dir__(), *self._run.tables()]

    def __getattr__(self, name: str) -> Any:
        """Return a table; the first access to one of them makes all."""
        tables = {} if name.startswith("_") else self._run.tables()
        if name not in tables:
            words = f"BatchAnswers of these problems has no {name}; its arrays include status, "
            raise AttributeError(words + ", ".join(tables))
        for key, table in tables.items():
            if isinstance(table, np.ndarray):
                table.flags.writeable = False
            setattr(self, key, table)
        return tables[name]

    def __len__(self) -> int:
        return len(self.status)

    def at(self, k: int) -> BaseResult:
        """Return result k, or raise the error of its problem."""
        if k in self.errors:
            raise self.errors[k]
        return self._run.result_of(k)

    @cached_property
    def objective(self) -> Any:
        """Objective of each problem, shape (B,); NaN if it has none."""
        return self._run.objectives()

    @cached_property
    def w(self) -> Any:
        """M z + q of each problem, like z; velocities of contacts, 1 for absent contacts."""
        w = self.problems.slacks(self.z)
        for k, result in self._run.results.items():
            if result.has_no_solution:
                w[k] = math.nan * w[k]
        return w

    @property
    def motion(self) -> Any:
        """Impulses and velocities per contact, a ContactMotion with a batch axis in front."""
        return self.problems.motion(self.z, self.w)
