"""The run of a batch: a compiled loop over what is small, in chunks on several threads; one by one the rest."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from functools import cache, cached_property
from typing import Any

import numpy as np

from ..algorithms import Algorithm
from ..algorithms.base import Phases
from ..algorithms.small_dense import Answers, run
from ..certificates.residuals import Certificate
from ..checks import read_only
from ..communicator.alone import ALONE
from ..deadline import Clock
from ..errors import InvalidOption, LCPError, UnknownAlgorithm
from ..kernels.threads import in_chunks
from ..policy.direct_methods import may_be_searched
from ..problem.lcp import LCP
from ..settings import CallersOwn, Status
from .batch_groups import Group, answers_in_common_units, by_parts, excluded
from .batch_items import Items, Stacked, put
from .driver import asked_of_solve, fused_result, solve
from .result import Result, Results


@cache
def _tiny() -> LCP:
    """Return a problem for which auto takes one compiled call; to state it costs as much as to solve a small one."""
    return LCP([[1.0]], [-1.0])


class BatchRun:
    """The answers as they come, in tables with a row a problem.

    Parameters
    ----------
    items : Items
    algorithm : str or Algorithm
    wishes : dict
        Whatever else :func:`lcp_plugin.solve` takes, for each problem.
    threads : int
    limit : float
        Seconds for all problems together.
    """

    def __init__(
        self, items: Items, algorithm: str | Algorithm, wishes: dict[str, Any], *, threads: int = 1,
        limit: float = np.inf,
    ) -> None:
        self.items, self.algorithm, self.wishes, self.threads, self.limit = items, algorithm, wishes, threads, limit
        self.policy, self.settings = asked_of_solve(algorithm, wishes)
        self.first = self.policy.first(_tiny())
        count, sizes = items.count, items.sizes
        self.z: Any = np.full((count, *sizes), np.nan) if len(sizes) <= 1 else [np.empty(0)] * count
        self.status, self.residual = np.full(count, None), np.full(count, np.nan)
        self.iterations, self.is_open = np.zeros(count, np.int64), np.ones(count, np.bool_)
        self.is_open[[*items.errors]] = False
        self.results: dict[int, Result] = {}  # of those that were solved one by one
        self.compiled: list[Answers] = []
        self.place = np.full((2, count), -1)  # which of these has an answer, and where
        self.is_interrupted, self.seconds, self.clock = False, 0.0, Clock(ALONE)

    def run(self) -> BatchResult:
        """Solve all, and gather what was found."""
        try:
            phases = self._phases()
            for group in () if phases is None else self.items.groups():
                if not phases or (group.starts.shape[1] and not phases[1]):  # pivots alone begin at z°
                    continue
                whole, in_parts = by_parts(group)
                if whole.items.size:
                    self._leave_out_excluded(whole, self._run_compiled(whole, phases))
                if in_parts.items.size and self.clock.read() < self.limit:
                    self._keep(in_parts, answers_in_common_units(in_parts, phases, self.settings))
            for k in np.flatnonzero(self.is_open).tolist():
                if self.is_interrupted or self.clock.read() >= self.limit:
                    break
                self._solve(k)
        except KeyboardInterrupt:
            self.is_interrupted = True
        for k in np.flatnonzero(self.is_open).tolist():
            self.z[k] = self.items.projected_start(k)
            self.status[k] = Status.INTERRUPTED if self.is_interrupted else Status.MAX_SECONDS
        self.seconds = self.clock.read()
        return BatchResult(self)

    def _phases(self) -> Phases | None:
        """Return the phases of the compiled loop that the caller's choice takes; None where it takes none."""
        is_watched = not self.settings.is_unobserved or self.wishes.get("callback") is not None
        return None if is_watched else self.first.algorithm.phases_of_small()

    def _run_compiled(self, group: Group, phases: Phases) -> Answers:
        answers = Answers(*group.shape)

        def solve_chunk(first: int, end: int) -> None:
            if self.clock.read() < self.limit:
                run(group[1:], phases, self.settings.tolerance, self.settings.max_iterations, first, end, answers)

        try:
            in_chunks(solve_chunk, group.items.size, self.threads)
        finally:
            self._keep(group, answers)
        return answers

    def _keep(self, group: Group, answers: Answers) -> None:
        converged = np.flatnonzero(answers.has_converged)
        items = group.items[converged]
        self.place[0, items], self.place[1, items] = len(self.compiled), converged
        answers.z.flags.writeable = False  # they are judged
        self.compiled.append(answers)
        residual, steps = answers.residual[converged], answers.made[converged].sum(1)
        self._write(items, answers.z[converged], Status.SOLVED, residual, steps)

    def _write(self, items: Any, z: Any, status: Status, residual: Any, iterations: Any) -> None:
        put(self.z, items, z if isinstance(z, list) else read_only(z))
        self.status[items], self.residual[items], self.iterations[items] = status, residual, iterations
        self.is_open[items] = False

    def _leave_out_excluded(self, group: Group, answers: Answers) -> None:
        """Note what a pass over all cases excludes, one iteration after those that were made; no proof is wanted."""
        made = answers.made.sum(1) + 1
        left = np.flatnonzero(self.is_open[group.items] & (made < self.settings.max_iterations))
        is_asked = self.settings.refute or self.settings.absolute_tolerance or self.policy.chosen != "auto"
        if is_asked or not left.size or self.clock.read() >= self.limit:
            return
        if not isinstance(self.items, Stacked):
            left = left[[may_be_searched(self.items.problem(k)) for k in group.items[left].tolist()]]
        rows, starts, residual = excluded(group.chosen(left), self.settings.tolerance, self.threads)
        self._write(group.items[left[rows]], starts, Status.STALLED, residual, made[left[rows]])

    def _solve(self, k: int) -> None:
        callback, wishes = self.wishes.get("callback"), dict(self.wishes)
        if self.limit < np.inf:
            wishes["max_seconds"] = max(self.limit - self.clock.read(), 0.0)
        try:
            found = solve(self.items.problem(k), self.algorithm, z0=self.items.start(k), **wishes)
        except (InvalidOption, UnknownAlgorithm):
            raise
        except LCPError as error:
            if isinstance(callback, CallersOwn) and error is callback.raised:
                raise
            self.items.errors[k], self.is_open[k] = error, False
        else:
            self.results[k] = found
            self.is_interrupted |= found.status is Status.INTERRUPTED
            self._write([k], [found.z], found.status, found.certificate.relative_residual, found.iterations)

    def result_of(self, k: int) -> Result:
        """Return the result of problem k, which has no error."""
        if k in self.results:
            return self.results[k]
        which, at = self.place[:, k].tolist()
        if which < 0:  # excluded, or not begun
            is_begun = self.status[k] is Status.STALLED
            wishes = self.wishes if is_begun else self.wishes | {"max_iterations": 0}
            found = solve(self.items.problem(k), self.algorithm, z0=self.items.start(k), **wishes)
            return found if is_begun or found.is_solved else replace(found, status=self.status[k])
        answer = self.compiled[which].solve_fused(at)
        assert answer is not None
        certificate = Certificate.enclosed(self.items.problem(k), answer.z, answer.residual)
        share = self.seconds / self.items.count
        return fused_result(certificate, self.policy, self.first, answer, self.settings, share)


class BatchResult(Results[Result]):
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
    items : Items
        The problems.
    threads : int
        How many took part, and will in its derivative.

    Notes
    -----
    ``batch[k]`` is the :class:`~lcp_plugin.Result` that :func:`lcp_plugin.solve` gives for problem k, its `seconds`
    a share of the batch's.
    """

    def __init__(self, run: BatchRun) -> None:
        self.z, self.status, self.relative_residual, self.iterations = run.z, run.status, run.residual, run.iterations
        self.seconds, self.items, self.threads, self._result_of = run.seconds, run.items, run.threads, run.result_of
        for array in (self.z, self.status, self.relative_residual, self.iterations):
            if isinstance(array, np.ndarray):
                array.flags.writeable = False

    @property
    def errors(self) -> dict[int, LCPError]:
        """What is wrong with problem k, an InvalidProblem, where something is; ``batch[k]`` raises it."""
        return self.items.errors

    @cached_property
    def w(self) -> Any:
        """M z + q of each problem, like z; computed when it is looked at."""
        rows = [np.full(len(z), np.nan) if k in self.errors else self.items.slack(k, z) for k, z in enumerate(self.z)]
        return np.array(rows).reshape(self.z.shape) if isinstance(self.z, np.ndarray) else rows

    @property
    def all_solved(self) -> bool:
        """Whether every status is SOLVED."""
        return all(status is Status.SOLVED for status in self.status)

    def __len__(self) -> int:
        return len(self.status)

    def at(self, k: int) -> Result:
        """Return result k, or raise what is wrong with its problem."""
        if k in self.errors:
            raise self.errors[k]
        return self._result_of(k)

    def __repr__(self) -> str:
        counts = Counter("no problem" if one is None else one.name for one in self.status)
        told = ", ".join(f"{count} {name}" for name, count in counts.most_common())
        return f"BatchResult({len(self)} problems: {told or 'none'}; {self.seconds:.3g} s)"
