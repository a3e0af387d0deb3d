"""The run of problems of several kinds: small ones over cones in a compiled loop, others one by one."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ...api import solve
from ...core.errors import LCPError
from ...core.settings import Status
from ...core.solving.answer import Answer
from ..cones.small import LoopAnswers, groups_of, solve_small
from ..cones.solving import result_of as result_of_small
from .batch_run import BatchAnswers, BatchLoop


class MixedRun(BatchLoop):
    """The answers as they come.

    Parameters
    ----------
    problems : sequence
    wishes, errors, threads, limit
        As in `BatchLoop`; an algorithm is one of the problems' own.
    """

    def __init__(
        self,
        problems: Sequence[Any],
        wishes: dict[str, Any],
        errors: dict[int, LCPError] | None = None,
        *,
        threads: int,
        limit: float,
    ) -> None:
        self.named = {name: wish for name, wish in wishes.items() if name == "algorithm"}
        others = {name: wish for name, wish in wishes.items() if name != "algorithm"}
        super().__init__(len(problems), "auto", others, errors or {}, threads=threads, limit=limit)
        self.problems = problems
        self.results: dict[int, Answer] = {}
        self.compiled: dict[
            int, tuple[LoopAnswers, int]
        ] = {}  # what was found of its group, and its place

    def _answers(self) -> Any:
        return AnswerList(self, self.result_of)

    def _solve_compiled(self) -> None:
        if self.named or self.wishes.keys() - {"tolerance", "prove_infeasibility"}:
            return  # a start or an algorithm of the caller's
        for group, found in self._loops():
            places = np.flatnonzero(found.is_proved & self.is_open[group])
            items = group[places]
            self.compiled.update(
                (k, (found, place))
                for k, place in zip(items.tolist(), places.tolist(), strict=True)
            )
            self.status[items], self.is_open[items] = Status.SOLVED, False

    def _loops(self) -> Iterator[tuple[Any, LoopAnswers]]:
        """Yield what the compiled loop makes of the items of each group."""
        for group in groups_of(self.problems):
            yield (
                group,
                solve_small(
                    [self.problems[k] for k in group.tolist()], self.settings, self._in_chunks
                ),
            )

    def _start(self, k: int) -> dict[str, Any]:
        """Return z0=, where there is one."""
        return {}

    def _solve(self, k: int, wishes: dict[str, Any]) -> None:
        found = solve(self.problems[k], **self._start(k), **self.named, **wishes)
        self.results[k], self.status[k], self.is_open[k] = found, found.status, False
        self.is_interrupted |= found.status is Status.INTERRUPTED

    def result_of(self, k: int) -> Any:
        """Return the answer to problem k, which has no error; one that was not begun has what its start has."""
        if k in self.compiled:
            problem, (found, place), share = (
                self.problems[k],
                self.compiled[k],
                self.seconds / len(self.problems),
            )
            return result_of_small(
                problem, found._replace(z=found.z[:, : problem.n]), place, self.settings, share
            )
        if k not in self.results:
            found = solve(
                self.problems[k], **self._start(k), **self.named, **self.wishes, max_seconds=0.0
            )
            self.results[k] = replace(found, status=self.status[k])
        return self.results[k]


class AnswerList(BatchAnswers[Answer]):
    """The answers to problems of several kinds, in order.

    Parameters
    ----------
    run : MixedRun
        At its end.

    Attributes
    ----------
    status : array of Status, shape (B,)
        None where the data are no problem that can be solved, as a program that is not convex.
    seconds : float
        Wall-clock seconds of the whole batch.
    errors : dict
        What is wrong with problem k, where something is; ``answers[k]`` raises it.
    """
