"""The policy of a march in time under algorithm="auto": what one step teaches reaches the next.

Steps of one M and nearby q resemble each other. The first one begins anywhere, the second one near its answer, as all
that follow do: both ask as `auto` does, and from then on a step begins with what finished the one before, and with what
it learned (psor: its relaxation). Where that fails, or has cost three times as much as when it was chosen, `auto` asks
from the best iterate, and once more in the step after; where that has happened twice, in every step. Every sixteenth
step asks as well: what was best once need not be so for ever.

Where few rows have a bound, as in contact, the others are eliminated once for all steps (`condensed`), if that is
predicted to take less than the steps to come would at the cost of the last.

All that is remembered is one :class:`Lesson`: a step is the same bit for bit from the same state with the same lesson.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from ...core.algorithms import Algorithm
from ...core.lcp import LCP
from ...core.policy.choice import Auto, Policy
from ...core.policy.stages import Choice, Stage
from ...methods.newton.condensed import Condensed, condensing_passes

ASKING_STEPS = 2  # one from anywhere, one from nearby
ASKED_EVERY = 16  # steps: tens of sweeps, where an answer takes a hundred passes
AS_BEFORE = "it finished the step before"
MOST_LEFT = 2  # times; then the steps do not resemble each other
SLOW = 3.0  # times the work of the run in which it was chosen
LEAST_WORK = 20.0  # passes over M that are slow for nobody
ITERATIVE = ("npsor", "psor", "multigrid")


@dataclass(frozen=True)
class Lesson:
    """What the steps up to now have taught.

    Attributes
    ----------
    steps : int
        How many there were.
    algorithm : Algorithm or None
        What the next one begins with; None where `auto` asks.
    work : float
        In passes over M, what it took in the step in which it was chosen.
    may_condense : bool
        Whether nothing speaks against the elimination of rows without bounds.
    left : int
        How often what a step began with did not finish it.
    because : str
        Why that algorithm.
    """

    steps: int = 0
    algorithm: Algorithm | None = None
    work: float = 0.0
    may_condense: bool = True
    left: int = 0
    because: str = AS_BEFORE


class StepPolicy(Policy):
    """What solves one step of a march.

    Parameters
    ----------
    lesson : Lesson
    refutes : bool
        Whether anybody looks for proofs, where there is no solution.
    """

    name = chosen = "auto"

    def __init__(self, lesson: Lesson, *, refutes: bool) -> None:
        self._lesson, self._auto = lesson, Auto(refutes=refutes)
        self._stages: Sequence[Stage] = ()

    def first(self, problem: LCP) -> Choice:
        """Return what finished the step before, or what `auto` begins with."""
        if self._lesson.algorithm is None:
            return self._auto.first(problem)
        return Choice(self._lesson.algorithm, self._lesson.because)

    def next_step(self, problem: LCP, stages: Sequence[Stage], goal: float, failed: bool) -> Choice | None:
        """Return what `auto` chooses; None as long as what finished the step before is no slower than then."""
        self._stages = stages
        if self._lesson.algorithm is None:
            return self._auto.next_step(problem, stages, goal, failed)
        if len(stages) > 1:
            return self._auto.next_step(problem, stages[1:], goal, failed)
        is_slow = stages[0].work > SLOW * max(self._lesson.work, LEAST_WORK)
        return self._auto.first(problem) if failed or is_slow else None

    def another_start(self, problem: LCP, stages: Sequence[Stage]) -> Choice | None:
        """Return what `auto` does."""
        return self._auto.another_start(problem, stages)

    def lesson(self, problem: LCP, left: int) -> Lesson:
        """Return what is known after this step, which is solved, when so many steps are left."""
        before, steps = self._lesson, self._lesson.steps + 1
        if not self._stages:  # solved at once
            return replace(before, steps=steps)
        last = self._stages[-1]
        algorithm, is_condensed = last.successor or last.algorithm, isinstance(before.algorithm, Condensed)
        asks = Lesson(steps, may_condense=before.may_condense, left=before.left)
        if before.algorithm is not None and len(self._stages) > 1:
            return replace(asks, left=before.left + 1, may_condense=before.may_condense and not is_condensed)
        if not is_condensed and steps % ASKED_EVERY == 0:
            return asks
        if before.algorithm is not None:
            return replace(before, steps=steps, algorithm=algorithm, because=AS_BEFORE)
        if before.may_condense and condensing_passes(problem) <= left * sum(stage.work for stage in self._stages):
            why = "few rows have a bound: the others are eliminated, once for all steps"
            return replace(asks, algorithm=Condensed(), work=math.inf, because=why)
        if steps < ASKING_STEPS or before.left >= MOST_LEFT or algorithm.name not in ITERATIVE:
            return asks
        return replace(asks, algorithm=algorithm, work=last.work)
