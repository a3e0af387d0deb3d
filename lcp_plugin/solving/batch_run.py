"""The run of a batch: a compiled loop over what is small, in chunks on several threads; the long road for the rest."""

from __future__ import annotations

from dataclasses import fields, replace
from functools import cache
from typing import Any

import numpy as np

from ..algorithms import Algorithm
from ..algorithms.base import Plan
from ..algorithms.short_road import Answers, run
from ..certificates.residuals import Certificate
from ..deadline import Clock
from ..errors import InvalidOption, LCPError, UnknownAlgorithm
from ..kernels.threads import in_chunks
from ..peers.alone import ALONE
from ..policy.choice import policy_for
from ..policy.direct_methods import may_be_searched
from ..problem.lcp import LCP
from ..settings import CallersOwn, Settings, Status
from .all_cases import Excluded, excluded
from .batch_items import Group, Items, Stacked
from .batch_result import BatchResult
from .batch_units import GroupInCommonUnits, by_parts
from .driver import fused_result, solve
from .result import Result


@cache
def _tiny() -> LCP:
    """Return a problem for which auto takes the compiled road; to state it costs as much as to solve a small one."""
    return LCP([[1.0]], [-1.0])


class BatchRun:
    """The answers as they come: of the compiled loop in arrays, of the long road as results.

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
        known = {field.name for field in fields(Settings)}
        self.settings = Settings(**{name: wish for name, wish in wishes.items() if name in known})
        options = {name: wish for name, wish in wishes.items() if name not in {*known, "callback"}}
        self.policy = policy_for(algorithm, options, refutes=self.settings.refute)
        self.results: dict[int, Result] = {}
        self.compiled: list[Answers] = []
        self.excluded: list[Excluded] = []
        self.is_excluded = np.zeros(items.count, np.bool_)
        self.place = np.full((2, items.count), -1)  # which of those has an answer, and where
        self.is_interrupted = False
        self.seconds = 0.0
        self.clock = Clock(ALONE)

    def run(self) -> BatchResult:
        """Solve all, and gather what was found."""
        try:
            plan = self._plan()
            for group in () if plan is None else self.items.groups():
                if plan and (group.starts.shape[1] == 0 or plan[1]):  # pivots alone begin at z°
                    whole, in_parts = by_parts(group)
                    if whole is not None:
                        self._leave_out_excluded(whole, self._run_compiled(whole, plan))
                    if in_parts is not None and self.clock.read() < self.limit:
                        self._keep(in_parts, GroupInCommonUnits(in_parts).run(plan, self.settings))
            for k in np.flatnonzero((self.place[0] < 0) & ~self.is_excluded).tolist():
                if self.is_interrupted or self.clock.read() >= self.limit:
                    break
                if k not in self.items.errors:
                    self._take_the_long_road(k)
        except KeyboardInterrupt:
            self.is_interrupted = True
        self.seconds = self.clock.read()
        return self._gathered()

    def _plan(self) -> Plan | None:
        """Return the phases of the compiled road that the caller's choice takes, compiled; None where it takes none."""
        tiny = _tiny()
        self.first = self.policy.first(tiny)
        plan = self.first.algorithm.short_plan()
        if plan is None or not self.settings.is_unobserved or self.wishes.get("callback") is not None:
            return None
        return plan

    def _run_compiled(self, group: Group, plan: Plan) -> Answers:
        answers = Answers(group.items.size, group.M.shape[1])
        arrays = group.M, group.q, group.lower, group.upper, group.starts
        limits = self.settings.tolerance, self.settings.max_iterations

        def solve_chunk(first: int, end: int) -> None:
            if self.clock.read() < self.limit:
                run(arrays, plan, *limits, first, end, answers)

        try:
            in_chunks(solve_chunk, group.items.size, self.threads)
        finally:
            self._keep(group, answers)
        return answers

    def _keep(self, group: Group, answers: Answers) -> None:
        arrived = np.flatnonzero(answers.has_arrived)
        self.place[0, group.items[arrived]], self.place[1, group.items[arrived]] = len(self.compiled), arrived
        answers.z.flags.writeable = False  # they are judged
        self.compiled.append(answers)

    def _leave_out_excluded(self, group: Group, answers: Answers) -> None:
        """Note what a pass over all cases excludes, one iteration after those that were made; no proof is wanted."""
        made = answers.made.sum(1) + 1
        left = np.flatnonzero((self.place[0, group.items] < 0) & (made < self.settings.max_iterations))
        is_asked = self.settings.refute or self.settings.absolute_tolerance or self.policy.chosen != "auto"
        if is_asked or not left.size or self.clock.read() >= self.limit:
            return
        if not isinstance(self.items, Stacked):
            left = left[[may_be_searched(self.items.problem(k)) for k in group.items[left].tolist()]]
        found = excluded(group, left, made[left], self.settings.tolerance, self.threads)
        self.excluded.append(found)
        self.is_excluded[found.items] = True

    def _take_the_long_road(self, k: int) -> None:
        callback, wishes = self.wishes.get("callback"), dict(self.wishes)
        if self.limit < np.inf:
            wishes["max_seconds"] = max(self.limit - self.clock.read(), 0.0)
        try:
            self.results[k] = solve(self.items.problem(k), self.algorithm, z0=self.items.start(k), **wishes)
        except (InvalidOption, UnknownAlgorithm):
            raise
        except LCPError as error:
            if isinstance(callback, CallersOwn) and error is callback.raised:
                raise
            self.items.errors[k] = error
        else:
            self.is_interrupted |= self.results[k].status is Status.INTERRUPTED

    # --- telling ----------------------------------------------------------------------------------------

    def result_of(self, k: int) -> Result:
        """Return the result of problem k, which has no error."""
        if k in self.results:
            return self.results[k]
        if self.is_excluded[k]:
            return solve(self.items.problem(k), self.algorithm, z0=self.items.start(k), **self.wishes)
        which, at = self.place[:, k].tolist()
        if which < 0:
            return self._not_begun(k)
        sprint = self.compiled[which].sprint(at)
        assert sprint is not None
        share = self.seconds / self.items.count
        certificate = Certificate.enclosed(self.items.problem(k), sprint.z, sprint.residual)
        return fused_result(certificate, self.policy, self.first, sprint, self.settings, share)

    @property
    def _reason(self) -> Status:
        return Status.INTERRUPTED if self.is_interrupted else Status.MAX_SECONDS

    def _not_begun(self, k: int) -> Result:
        wishes = self.wishes | {"max_iterations": 0}
        start = solve(self.items.problem(k), self.algorithm, z0=self.items.start(k), **wishes)
        return start if start.is_solved else replace(start, status=self._reason)

    def _gathered(self) -> BatchResult:
        count, sizes = self.items.count, self.items.sizes
        is_even = len(sizes) <= 1
        z: Any = np.full((count, *sizes), np.nan) if is_even else [np.empty(0)] * count
        status, residual, iterations = np.full(count, None), np.full(count, np.nan), np.zeros(count, np.int64)
        for which, answers in enumerate(self.compiled):
            items = np.flatnonzero(self.place[0] == which)
            at = self.place[1, items]
            status[items], residual[items] = Status.SOLVED, answers.residual[at]
            iterations[items] = answers.made[at].sum(1)
            if is_even:
                z[items] = answers.z[at]
            for k, row in zip(items.tolist(), at.tolist(), strict=True) if not is_even else ():
                z[k] = answers.z[row]
        for left_out in self.excluded:
            status[left_out.items], residual[left_out.items] = Status.STALLED, left_out.residual
            iterations[left_out.items] = left_out.iterations
            for k, row in zip(left_out.items.tolist(), left_out.z, strict=True):
                z[k] = row
        for k, result in self.results.items():
            z[k], status[k], iterations[k] = result.z, result.status, result.iterations
            residual[k] = result.certificate.relative_residual
        for k in np.flatnonzero((self.place[0] < 0) & (status == None)).tolist():  # noqa: E711 - elementwise
            if k not in self.items.errors:
                z[k], status[k] = self.items.projected_start(k), self._reason
        for array in (z, status, residual, iterations) if is_even else (status, residual, iterations):
            array.flags.writeable = False
        return BatchResult(z, status, residual, iterations, self.seconds, self.items, self.result_of, self.threads)
