"""Stage of a run: one method, its steps so far, a test of progress, and the reasons why steps end."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from enum import Enum
from typing import Any, NamedTuple

from ..core.algorithm import Step
from ..core.checks import Vector
from .result import StageRecord

FIRST_CHECK = 10  # iteration of the first residual that the method does not report
FIRST_FLOOR_CHECK = 25  # iterations without a fall
PROGRESS = 0.99  # a residual that has not fallen below this share of an earlier one has not fallen


class TerminationReason(Enum):
    """Why the steps of a run ended; the run derives the status from it and from the best z."""

    CONVERGED = "a point passed both tests of the criterion"
    NO_SOLUTION = "a step proved that no solution exists"
    AT_FLOOR = "rounding explains the residual"
    STALLED = "the residual has stopped falling, or falls too slowly"
    DIVERGED = "the residual left every reasonable range"
    OVER_BUDGET = "another method takes over"
    NOTHING_LEFT = "the last algorithm had no further step"
    STEP_LIMIT = "max_iterations came first"
    TIME_LIMIT = "max_seconds came first"
    INTERRUPTED = "Ctrl-C or the callback came first"


FAILED = (
    TerminationReason.STALLED,
    TerminationReason.DIVERGED,
    TerminationReason.OVER_BUDGET,
    TerminationReason.NOTHING_LEFT,
)  # another algorithm may do better


class Named(NamedTuple):
    """Name of a stage that runs no algorithm of this package."""

    name: str


@dataclass(eq=False)
class Stage:
    """Method of a run, with its budget and progress.

    Attributes
    ----------
    algorithm : Algorithm, or another object with a `name`
    because : str
        The reason for it, for readers.
    is_over : callable or None
        Budget, checked after each step: if it returns True, the next method takes over. None means no budget.
    steps : iterable of Step
        The proposed points, unless the run takes them from the algorithm.
    iterations, work : int, float
        Work in passes over M.
    z : ndarray, shape (n,), or None
        The latest iterate, as long as the stage lasts.
    residuals : list of (int, float)
        Iteration and relative residual: the first measured ones and the latest, at most 512.
    rises : int
        Number of latest residuals that exceed the one before each.
    parts : list of (str, int, float)
        Label, iterations and work, if the algorithm labels its steps.
    remark : str
        A clause for the advice.
    """

    algorithm: Any
    because: str = ""
    is_over: Callable[[Stage], bool] | None = None
    steps: Iterable[Step] = ()
    iterations: int = 0
    work: float = 0.0
    z: Vector | None = None
    residuals: list[tuple[int, float]] = field(default_factory=list)
    rises: int = 0
    parts: list[tuple[str, int, float]] = field(default_factory=list)
    remark: str = ""
    _settles: bool = False
    _best: float = math.inf
    _fall: tuple[int, float] = (0, math.inf)
    _floor_check: int = FIRST_FLOOR_CHECK
    _window: tuple[int, float] | None = None
    _next_check: int = FIRST_CHECK
    _residual_per_increment: float = 1.0

    def count(self, step: Step, iterations: int = 1) -> None:
        """Record a step, which may be no iteration, and its work, for the part of its label if there is one."""
        self.z = step.z
        self.iterations += iterations
        self.work += step.work
        self.remark = step.remark or self.remark
        if step.is_settling:
            self._settles, self._window = True, None
        label, work = step.label or (self.algorithm.name if self.parts else ""), step.work
        if label and self.parts and self.parts[-1][0] == label:
            _, before, spent = self.parts.pop()
            iterations, work = before + iterations, spent + work
        if label:
            self.parts.append((label, iterations, work))

    def records(self) -> list[StageRecord]:
        """Return the parts as a result shows them."""
        parts = self.parts or [(self.algorithm.name, self.iterations, self.work)]
        records = [
            StageRecord(name, "" if k else self.because, iterations, work)
            for k, (name, iterations, work) in enumerate(parts)
        ]
        return [*records[:-1], records[-1]._replace(remark=self.remark)]

    # --- residuals --------------------------------------------------------------------------------------

    def is_due(self, increment: float | None, goal: float) -> bool:
        """Return whether the run must measure the residual: at geometric intervals, and if it may be small enough.

        Parameters
        ----------
        increment : float or None
            Increment of the step, relative to the reference; it estimates the residual.
        goal : float
        """
        if increment is None or self.iterations >= self._next_check:
            return True
        return increment * self._residual_per_increment <= goal

    def record(self, residual: float, increment: float | None = None) -> None:
        """Record the relative residual of the present iteration.

        With the increment of a step whose residual had to be measured, the next one is due at 1.5 times the iterations.
        """
        if increment is not None:
            latest = max(self.iterations, FIRST_CHECK)
            self._next_check = max(self.iterations + 1, math.ceil(latest * 1.5))
            if increment > 0.0:
                self._residual_per_increment = residual / increment
        before = self.residuals[-1][1] if self.residuals else math.inf
        self.rises = self.rises + 1 if residual > before else 0
        self._best = min(self._best, residual)
        if len(self.residuals) >= 512:
            self.residuals.pop()
        self.residuals.append((self.iterations, residual))

    def is_flat(self) -> bool:
        """Return whether it is time to compare with rounding: no fall for 25, 50, 100, … iterations."""
        since, value = self._fall
        if self._best < PROGRESS * value:
            self._fall, self._floor_check = (self.iterations, self._best), FIRST_FLOOR_CHECK
        elif self.iterations - since >= self._floor_check:
            self._floor_check *= 2
            return True
        return False

    def is_stalled(self, n: int, goal: float, iterations_left: int) -> bool:
        """Return whether the residual fell by less than 1 % in a window, and the rest will not reach the goal.

        A front that crosses the unknowns, one in a sweep, does not change the largest residual until it has passed. So
        a window has 200 to 2000 iterations, n if that is between, and half as many as the stage had before it.
        """
        if self._window is None:
            self._window = (self.iterations, self._best)
        since, value = self._window
        if self.iterations - since < max(200, min(n, 2000), since // 2):
            return False
        self._window = (self.iterations, self._best)
        if self._best < PROGRESS * value:
            return False
        best = self._best
        fall = math.log(value / best) / (self.iterations - since) if 0.0 < best < value else 0.0
        needed = math.log(best / goal) if 0.0 < goal < best else math.inf
        return needed > fall * iterations_left

    def steps_to_go(self, goal: float) -> float:
        """Return the number of further iterations to that residual, at the rate of the second half of the stage.

        At the rate of all of it if steps settle, as psor's do: each trial of a relaxation raises the residual.
        """
        if not self.residuals:
            return math.inf
        last_step, last = self.residuals[-1]
        if last <= goal:
            return 0.0
        since = 0 if self._settles else last_step // 2
        first_step, first = next(entry for entry in self.residuals if entry[0] >= since)
        if last_step == first_step or not (goal > 0.0 and 0.0 < last < first):
            return math.inf
        rate = (last / first) ** (1.0 / (last_step - first_step))
        return math.log(goal / last) / math.log(rate) if 0.0 < rate < 1.0 else math.inf
