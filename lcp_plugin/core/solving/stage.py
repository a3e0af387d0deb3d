"""Stage of a run: one method, its steps so far, and a test of progress."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

from ..algorithm import Algorithm, Step
from ..checks import FloatVector
from .result import StageRecord

KEPT_RESIDUALS = 512
FIRST_CHECK, CHECK_GROWTH = 10, 1.5  # iterations between measured residuals
FIRST_FLOOR_CHECK = 25
RISES = 10  # in a row
PROGRESS = 0.99
WINDOW, LARGEST_WINDOW = 200, 2000  # iterations


@dataclass(eq=False)
class Stage:
    """Method of a run, with its budget and progress.

    Attributes
    ----------
    algorithm : Algorithm
    because : str
        The reason for it, for readers.
    is_over : callable or None
        Budget, checked after each step: if it returns True, the next method takes over. None means no budget.
    iterations, work : int, float
        Work in passes over M.
    z : ndarray, shape (n,), or None
        The latest iterate, as long as the stage lasts.
    residuals : list of (int, float)
        Iteration and relative residual: the first measured ones and the latest, at most 512.
    parts : list of (str, int, float)
        Label, iterations and work, if the algorithm labels its steps.
    remark : str
        A clause for the advice.
    """

    algorithm: Algorithm
    because: str = ""
    is_over: Callable[[Stage], bool] | None = None
    iterations: int = 0
    work: float = 0.0
    z: FloatVector | None = None
    residuals: list[tuple[int, float]] = field(default_factory=list)
    parts: list[tuple[str, int, float]] = field(default_factory=list)
    remark: str = ""
    _settles: bool = False
    _best: float = math.inf
    _rises: int = 0
    _fall: tuple[int, float] = (0, math.inf)
    _floor_check: int = FIRST_FLOOR_CHECK
    _window: tuple[int, float] | None = None
    _next_check: int = FIRST_CHECK
    _residual_per_increment: float = 1.0

    def count(self, step: Step) -> bool:
        """Record a step; return whether it is the first one, which is the start and no iteration."""
        is_first = self.z is None
        self.z = step.z
        self.add(0 if is_first else 1, step.work, step.label)
        self.remark = step.remark or self.remark
        self._settles |= step.is_settling
        if step.is_settling:
            self._window = None
        return is_first

    def add(self, iterations: int, work: float, label: str = "") -> None:
        """Count iterations and work, for the part of that label if there is one."""
        self.iterations += iterations
        self.work += work
        label = label or (self.algorithm.name if self.parts else "")
        if label and self.parts and self.parts[-1][0] == label:
            _, before, spent = self.parts.pop()
            self.parts.append((label, before + iterations, spent + work))
        elif label:
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

    def learn(self, increment: float, residual: float) -> None:
        """Record the residual of a step with this increment; the next one is due at 1.5 times the iterations."""
        latest = max(self.iterations, FIRST_CHECK)
        self._next_check = max(self.iterations + 1, math.ceil(latest * CHECK_GROWTH))
        if increment > 0.0:
            self._residual_per_increment = residual / increment

    def note(self, residual: float) -> None:
        """Keep the relative residual of the present iteration."""
        before = self.residuals[-1][1] if self.residuals else math.inf
        self._rises = self._rises + 1 if residual > before else 0
        self._best = min(self._best, residual)
        if len(self.residuals) >= KEPT_RESIDUALS:
            self.residuals.pop()
        self.residuals.append((self.iterations, residual))

    def is_rising(self) -> bool:
        """Return whether the residual has risen ten times in a row."""
        return self._rises >= RISES

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
        a window has up to 2000 iterations, and half as many as the stage had before it.
        """
        if self._window is None:
            self._window = (self.iterations, self._best)
        since, value = self._window
        shortest = max(WINDOW, min(n, LARGEST_WINDOW))
        if self.iterations - since < max(shortest, since // 2):
            return False
        self._window = (self.iterations, self._best)
        if self._best < PROGRESS * value:
            return False
        best = self._best
        fall = math.log(value / best) / (self.iterations - since) if 0.0 < best < value else 0.0
        needed = math.log(best / goal) if 0.0 < goal < best else math.inf
        return needed > fall * iterations_left

    def rate(self) -> float:
        """Return the contraction of the residual in an iteration, over the second half of the stage.

        Over all of it if steps settle, as psor's do: each trial of a relaxation raises the residual.
        """
        if len(self.residuals) < 2:
            return 1.0
        last_step, last = self.residuals[-1]
        since = 0 if self._settles else last_step // 2
        first_step, first = next(
            (entry for entry in self.residuals if entry[0] >= since), self.residuals[0]
        )
        if last_step == first_step or not first > 0.0 or not math.isfinite(last):
            return 1.0
        return float((last / first) ** (1.0 / (last_step - first_step)))

    def steps_to_go(self, goal: float) -> float:
        """Return the number of further iterations to that residual, at the stage's own rate."""
        if not self.residuals:
            return math.inf
        residual, rate = self.residuals[-1][1], self.rate()
        if residual <= goal:
            return 0.0
        falls = 0.0 < rate < 1.0 and goal > 0.0
        return math.log(goal / residual) / math.log(rate) if falls else math.inf
