"""The run of problems of several kinds: small ones over the same cones as a stack, others one by one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ...api import solve
from ...core.errors import LCPError
from ...core.settings import Status
from ...core.solving.answer import Answer
from ..cones.data import Blocks
from ..cones.solving import result_of, solve_stack
from ..cones.stack import ConeStack, Pattern
from .batch_run import BatchAnswers, BatchLoop

DENSE_UP_TO = 400  # rows of a problem in a stack


def groups_of(problems: Sequence[object]) -> list[Any]:
    """Return which problems may form a stack: small ones, over the same blocks."""
    alike: dict[tuple[object, ...], list[int]] = {}
    for k, problem in enumerate(problems):
        if isinstance(problem, Blocks) and 0 < problem.n <= DENSE_UP_TO:
            alike.setdefault((problem.has_friction, problem.starts.tobytes()), []).append(k)
    return [np.array(members) for members in alike.values()]


def stacked(problems: Sequence[Blocks]) -> ConeStack:
    """Return problems over the same blocks as a stack."""
    matrices = [one.rows.M for one in problems]
    M = np.stack([one if isinstance(one, np.ndarray) else one.toarray() for one in matrices])
    names = ("q", "slope", "lower", "upper")
    arrays = (np.stack([getattr(one, name) for one in problems]) for name in names)
    with np.errstate(all="ignore"):
        pattern = Pattern(M, problems[0].starts)
        return ConeStack(pattern, *arrays, has_friction=problems[0].has_friction)


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
        self.together: dict[int, tuple[Any, int]] = {}  # points and iterations

    def _answers(self) -> Any:
        return AnswerList(self, self.result_of)

    @property
    def is_plain(self) -> bool:
        """Whether the user leaves algorithm, start and limits to a stack."""
        return not (self.named or self.wishes.keys() - {"tolerance", "prove_infeasibility"})

    def _solve_compiled(self) -> None:
        for group in groups_of(self.problems) if self.is_plain else ():
            if self.has_time:
                stack = stacked([self.problems[k] for k in group.tolist()])
                self._take(group, stack, stack.origin)
        self.is_open &= self.status != Status.SOLVED

    def _take(self, items: Any, stack: ConeStack, start: Any, *, is_warm: bool = False) -> None:
        """Write what a stack makes of these items, if it solves them."""
        found = solve_stack(
            stack, start, self.settings.tolerance, lambda: self.has_time, is_warm=is_warm
        )
        z, residual, iterations, is_solved = found
        is_solved &= self.is_open[items]
        self._keep(items[is_solved], stack.pattern.flat(z)[is_solved], iterations[is_solved])
        self.residual[items[is_solved]] = residual[is_solved]
        self.status[items[is_solved]] = Status.SOLVED

    def _keep(self, items: Any, z: Any, iterations: Any) -> None:
        """Keep points and iterations of items that a stack has solved."""
        self.together.update(
            zip(items.tolist(), zip(z, iterations.tolist(), strict=True), strict=True)
        )

    def _kept(self, k: int) -> tuple[Any, int] | None:
        """Return the point and the iterations of an item that a stack has solved."""
        return self.together.get(k)

    def _start(self, k: int) -> dict[str, Any]:
        """Return z0=, where there is one."""
        return {}

    def _solve(self, k: int, wishes: dict[str, Any]) -> None:
        found = solve(self.problems[k], **self._start(k), **self.named, **wishes)
        self.results[k], self.status[k], self.is_open[k] = found, found.status, False
        self.is_interrupted |= found.status is Status.INTERRUPTED

    def result_of(self, k: int) -> Any:
        """Return the answer to problem k, which has no error; one that was not begun has what its start has."""
        if k not in self.results and (kept := self._kept(k)) is not None:
            share = self.seconds / len(self.problems)
            return result_of(self.problems[k], *kept, self.settings, share)
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
