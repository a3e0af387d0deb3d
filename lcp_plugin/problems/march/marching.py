"""The policy of a march in time under algorithm="auto": a step begins with what ended the one before.

Steps of one M and nearby q resemble each other. The first one begins anywhere, the second one near its answer, as all
that follow do: both ask as `auto` does. From then on a step begins with the iteration that ended the one before;
whether another one takes over is for `auto` to say.
"""

from __future__ import annotations

from collections.abc import Sequence

from ...auto import Auto
from ...core.algorithm import Algorithm
from ...core.lcp import LCP
from ...core.policy.stages import Choice, Stage

AS_BEFORE = "it finished the step before"
ITERATIVE = ("npsor", "psor", "multigrid")


class StepPolicy(Auto):
    """What solves one step of a march.

    Parameters
    ----------
    begin : Algorithm or None
        What the step begins with; None where `auto` asks.
    prove_infeasibility : bool
        Whether anybody looks for proofs, where there is no solution.
    """

    def __init__(self, begin: Algorithm | None, *, prove_infeasibility: bool) -> None:
        super().__init__(prove_infeasibility=prove_infeasibility)
        self._begin = begin
        self._stages: Sequence[Stage] = ()

    def first(self, problem: LCP) -> Choice:
        """Return what the step before leaves, or what `auto` begins with."""
        if self._begin is None:
            return super().first(problem)
        return Choice(self._begin, AS_BEFORE)

    def next_step(
        self, problem: LCP, stages: Sequence[Stage], goal: float, failed: bool
    ) -> Choice | None:
        """Return what `auto` chooses."""
        self._stages = stages
        return super().next_step(problem, stages, goal, failed)

    def following(self, problem: LCP, step: int) -> Algorithm | None:
        """Return the method with which the step after this one begins; None: `auto` chooses."""
        if not self._stages:  # solved at once
            return self._begin
        algorithm = self._stages[-1].algorithm
        return algorithm if step > 0 and algorithm.name in ITERATIVE else None
