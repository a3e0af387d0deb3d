"""The run of a batch: a compiled loop over what is small, in chunks on several threads; one by one the rest."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np

from ...auto import asked_of_solve, solve_lcp
from ...core.algorithm import Algorithm
from ...core.certificates.residuals import Certificate
from ...core.checks import read_only
from ...core.deadline import Clock
from ...core.errors import InvalidOption, LCPError, UnknownAlgorithm
from ...core.settings import Status
from ...core.solving.result import Result, StageRecord
from ...methods.small.rounds import CHUNK, solve_stack
from ..many.answers import AnswerSequence, T
from ..many.chunks import in_chunks
from .batch_groups import Group
from .batch_items import Items, put


class BatchLoop:
    """Tables with a row an item: a compiled loop fills some at once, and what it leaves open is solved one by one.

    Parameters
    ----------
    count : int
    algorithm : str or Algorithm
    wishes : dict
        Whatever else :func:`lcp_plugin.solve` takes, for each item.
    errors : dict
        What is wrong with item k, where something is.
    threads : int
    limit : float
        Seconds for all items together.
    """

    def __init__(
        self,
        count: int,
        algorithm: str | Algorithm,
        wishes: dict[str, Any],
        errors: dict[int, LCPError],
        *,
        threads: int,
        limit: float,
    ) -> None:
        self.algorithm, self.wishes, self.errors, self.threads, self.limit = (
            algorithm,
            wishes,
            errors,
            threads,
            limit,
        )
        self.policy, self.settings = asked_of_solve(algorithm, wishes)
        self.status, self.residual = np.full(count, None), np.full(count, np.nan)
        self.is_open = np.ones(count, np.bool_)
        self.is_open[[*errors]] = False
        self.is_interrupted, self.seconds, self.clock = False, 0.0, Clock()

    @property
    def has_time(self) -> bool:
        """Whether the clock of all has not run out."""
        return self.clock.read() < self.limit

    def _in_chunks(self, solve_chunk: Callable[[int, int], None], count: int) -> None:
        """Call ``solve_chunk(first, end)`` for all items of a compiled loop, on the threads, while there is time."""
        in_chunks(
            lambda first, end: solve_chunk(first, end) if self.has_time else None,
            count,
            self.threads,
        )

    def run(self) -> Any:
        """Solve all, and gather what was found."""
        self._solve_all()
        left = np.flatnonzero(self.is_open)
        self._leave(left)
        self.status[left] = Status.INTERRUPTED if self.is_interrupted else Status.MAX_SECONDS
        self.seconds = self.clock.read()
        return self._answers()

    def _answers(self) -> Any:
        """Return what was found."""
        raise NotImplementedError

    def _leave(self, items: Any) -> None:
        """Write where those begin that were not begun."""

    def _solve_compiled(self) -> None:
        """Solve what compiled loops can."""
        raise NotImplementedError

    def _solve(self, k: int, wishes: dict[str, Any]) -> None:
        """Solve item k by itself."""
        raise NotImplementedError

    @np.errstate(under="ignore")
    def _solve_all(self) -> None:
        """Solve until all are done, the clock runs out, or Ctrl-C comes; what an item itself raises is kept."""
        try:
            self._solve_compiled()
            for k in np.flatnonzero(self.is_open).tolist():
                if self.is_interrupted or not self.has_time:
                    break
                self._solve_or_keep_error(k)
        except KeyboardInterrupt:
            self.is_interrupted = True

    def _solve_or_keep_error(self, k: int) -> None:
        wishes = dict(self.wishes)
        if self.limit < np.inf:
            wishes["max_seconds"] = max(self.limit - self.clock.read(), 0.0)
        try:
            self._solve(k, wishes)
        except (InvalidOption, UnknownAlgorithm):
            raise
        except LCPError as error:
            self.errors[k], self.is_open[k] = error, False


class BatchAnswers(AnswerSequence[T]):
    """The answers of a batch, each put together when it is looked at.

    Parameters
    ----------
    run : BatchLoop
        At its end.
    answer_of : callable
        The answer to item k, which has no error.
    tables : arrays
        What nobody may change any more.
    """

    status: Any

    def __init__(self, run: BatchLoop, answer_of: Callable[[int], T], *tables: Any) -> None:
        self.status, self.seconds, self.errors, self._answer_of = (
            run.status,
            run.seconds,
            run.errors,
            answer_of,
        )
        for table in (run.status, run.residual, *tables):
            if isinstance(table, np.ndarray):
                table.flags.writeable = False

    def __len__(self) -> int:
        return len(self.status)

    @cached_property
    def x(self) -> Any:
        """The unknowns of each, shape (B, n), NaN where there are none; a list of arrays where sizes differ."""
        rows = [np.empty(0) if one is None or one.x is None else one.x for one in self._each]
        sizes = {row.size for row in rows if row.size} or {0}
        if len(sizes) > 1:
            return rows
        x = np.full((len(rows), *sizes), np.nan)
        for k, row in enumerate(rows):
            x[k, : row.size] = row
        return x

    @cached_property
    def objective(self) -> Any:
        """What was minimised of each, shape (B,); NaN where nothing is."""
        values = [None if one is None else one.objective for one in self._each]
        return np.array([np.nan if value is None else value for value in values], dtype=np.float64)

    @cached_property
    def iterations(self) -> Any:
        """How many steps each took, shape (B,)."""
        return np.array(
            [0 if one is None else one.iterations for one in self._each], dtype=np.int64
        )

    @property
    def _each(self) -> list[Any]:
        """Every answer, None where the item is no problem."""
        return [None if k in self.errors else self._answer_of(k) for k in range(len(self))]

    def at(self, k: int) -> T:
        """Return answer k, or raise what is wrong with its item."""
        if k in self.errors:
            raise self.errors[k]
        return self._answer_of(k)


class ComplementarityAnswers(BatchAnswers[T]):
    """The answers to complementarity problems, in tables.

    Parameters
    ----------
    run : BatchRun or ContactBatchRun
        At its end.
    """

    def __init__(self, run: Any) -> None:
        super().__init__(run, run.result_of, run.z, run.iterations)
        self.z, self.relative_residual, self.iterations = run.z, run.residual, run.iterations
        self.threads = run.threads

    @property
    def x(self) -> Any:
        """The same as z."""
        return self.z

    @property
    def objective(self) -> Any:
        """NaN for each, shape (B,): nothing is minimised."""
        return np.full(len(self), np.nan)


class BatchRun(BatchLoop):
    """The answers as they come, in tables with a row a problem.

    Parameters
    ----------
    items : Items
    algorithm, wishes, threads, limit
        As in `BatchLoop`.
    """

    def __init__(
        self,
        items: Items,
        algorithm: str | Algorithm,
        wishes: dict[str, Any],
        *,
        threads: int,
        limit: float,
    ) -> None:
        super().__init__(items.count, algorithm, wishes, items.errors, threads=threads, limit=limit)
        self.items = items
        count, sizes = items.count, items.sizes
        self.z: Any = np.full((count, *sizes), np.nan) if len(sizes) <= 1 else [np.empty(0)] * count
        self.iterations = np.zeros(count, np.int64)
        self.results: dict[int, Result] = {}  # of those that were solved one by one

    def _answers(self) -> BatchResult:
        return BatchResult(self)

    def _leave(self, items: Any) -> None:
        for k in items.tolist():
            self.z[k] = self.items.projected_start(k)

    def _solve_compiled(self) -> None:
        if self.algorithm != "auto" or not self.settings.is_unobserved:
            return
        if self.settings.absolute_tolerance or not self.settings.max_iterations:
            return
        for group in self.items.groups():
            size = max(1, CHUNK // group.shape[1] ** 2)
            for first in range(0, group.items.size, size):
                if not self.has_time:
                    return
                rows = np.arange(first, min(first + size, group.items.size))
                self._solve_together(group.chosen(rows))

    def _solve_together(self, group: Group) -> None:
        starts = group.starts if group.starts.shape[1] else None
        found = solve_stack(
            group.M, group.q, group.lower, group.upper, starts, self.settings.tolerance
        )
        good = np.flatnonzero(found.is_solved)
        residual = np.broadcast_to(found.residual, group.items.shape)[good]
        z = np.broadcast_to(found.z, group.shape)[good]
        starts = np.clip(0.0, group.lower, group.upper) if starts is None else starts
        moved = (z != np.broadcast_to(starts, group.shape)[good]).any(1)
        self._write(group.items[good], z, Status.SOLVED, residual, moved.astype(np.int64))

    def _write(self, items: Any, z: Any, status: Status, residual: Any, iterations: Any) -> None:
        put(self.z, items, z if isinstance(z, list) else read_only(z))
        self.status[items], self.residual[items], self.iterations[items] = (
            status,
            residual,
            iterations,
        )
        self.is_open[items] = False

    def _solve(self, k: int, wishes: dict[str, Any]) -> None:
        found = solve_lcp(self.items.problem(k), self.algorithm, z0=self.items.start(k), **wishes)
        self.results[k] = found
        self.is_interrupted |= found.status is Status.INTERRUPTED
        self._write(
            [k], [found.z], found.status, found.certificate.relative_residual, found.iterations
        )

    def result_of(self, k: int) -> Result:
        """Return the result of problem k, which has no error."""
        if k in self.results:
            return self.results[k]
        if self.status[k] is not Status.SOLVED:  # not begun
            wishes = self.wishes | {"max_iterations": 0}
            found = solve_lcp(
                self.items.problem(k), self.algorithm, z0=self.items.start(k), **wishes
            )
            return found if found.is_solved else replace(found, status=self.status[k])
        certificate = Certificate.of(self.items.problem(k), self.z[k])
        return Result(
            z=certificate.z,
            w=certificate.w,
            status=Status.SOLVED,
            certificate=certificate,
            algorithm="auto: rounds",
            iterations=int(self.iterations[k]),
            work=float(certificate.problem.n),
            seconds=self.seconds / self.items.count,
            setup_seconds=0.0,
            tolerance=self.settings.tolerance,
            stages=(StageRecord("rounds", "", 1, float(certificate.problem.n)),),
        )


class BatchResult(ComplementarityAnswers[Result]):
    """The answers to a batch of problems.

    Parameters
    ----------
    run : BatchRun
        At its end.

    Attributes
    ----------
    z : array, shape (B, n), or a list of arrays where the sizes differ
        NaN where the problem is none.
    status : array of Status, shape (B,)
        None where the problem is none.
    relative_residual : array, shape (B,)
        As in :class:`lcp_plugin.Certificate`; NaN where the problem is none, or was not begun.
    iterations : array of int, shape (B,)
    seconds : float
        Seconds of the whole batch, compilation excluded.
    errors : dict
        What is wrong with problem k, an InvalidProblem, where something is; ``batch[k]`` raises it.
    items : Items
        The problems.
    threads : int
        How many took part.

    Notes
    -----
    ``batch[k]`` is the :class:`~lcp_plugin.Result` that :func:`lcp_plugin.solve` gives for problem k, its `seconds`
    a share of the batch's.
    """

    def __init__(self, run: BatchRun) -> None:
        super().__init__(run)
        self.items = run.items

    @cached_property
    def w(self) -> Any:
        """M z + q of each problem, like z; computed when it is looked at."""
        rows = [
            np.full(len(z), np.nan) if k in self.errors else self.items.slack(k, z)
            for k, z in enumerate(self.z)
        ]
        return np.array(rows).reshape(self.z.shape) if isinstance(self.z, np.ndarray) else rows
