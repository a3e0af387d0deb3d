"""One link of a chain of algorithms: what was chosen and why, what it has done, whether it still gets nearer."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import pairwise

from ..algorithm import Algorithm, Step
from ..checks import BoolVector, FloatVector
from ..lcp import LCP

KEPT_RESIDUALS = 512
FIRST_CHECK = 10
FIRST_FLOOR_CHECK = 25
PROGRESS = 0.99


@dataclass(frozen=True)
class Choice:
    """An algorithm and the reason for it.

    `turn` says after how many steps, or of lemke pivots divided by n, another one may have its turn before this one has
    come to its end; `from_start`, that it does not go on from the best point so far but begins where the run began.
    """

    algorithm: Algorithm
    because: str = ""
    turn: float = math.inf
    from_start: bool = False

    def iterates(self, problem: LCP, z0: FloatVector) -> Iterator[Step]:
        """Yield the steps of the algorithm."""
        return self.algorithm.iterates(problem, z0)


@dataclass
class Stage:
    """What one algorithm of a chain has done so far.

    `residuals` holds (iteration of this stage, residual), `parts` (label, iterations, work) of an algorithm that has
    several; `least_residual` is that of its steps; `settles`, that steps have said their residuals may rise for a
    while; `z` is the latest iterate, as long as the stage lasts; `moves` counts the unknowns that came to a bound or
    left it, window by window, where the policy watches them.
    """

    algorithm: Algorithm
    because: str = ""
    iterations: int = 0
    work: float = 0.0
    remark: str = ""
    least_residual: float = 0.0
    settles: bool = False
    z: FloatVector | None = None
    residuals: list[tuple[int, float]] = field(default_factory=list)
    parts: list[tuple[str, int, float]] = field(default_factory=list)
    moves: list[int] = field(default_factory=list)
    _at_bounds: BoolVector | None = None

    def take(self, label: str, iterations: int, work: float) -> None:
        """Count iterations and work, for the part of that label where there is one."""
        self.iterations += iterations
        self.work += work
        label = label or (self.algorithm.name if self.parts else "")
        if label and self.parts and self.parts[-1][0] == label:
            _, before, spent = self.parts.pop()
            self.parts.append((label, before + iterations, spent + work))
        elif label:
            self.parts.append((label, iterations, work))

    def note(self, residual: float) -> None:
        """Keep the residual of the present iteration: of the first 512 measured all, then the latest."""
        if len(self.residuals) >= KEPT_RESIDUALS:
            self.residuals.pop()
        self.residuals.append((self.iterations, residual))

    def watch_bounds(self, problem: LCP, window: int) -> None:
        """Count the unknowns that have come to a bound, or left it, with this step; a window is so many steps."""
        if self.z is None:
            return
        at_bounds = (self.z <= problem.lower) | (self.z >= problem.upper)
        if self._at_bounds is not None:
            if (self.iterations - 1) % window == 0 or not self.moves:
                self.moves.append(0)
            self.moves[-1] += int((at_bounds != self._at_bounds).sum())
        self._at_bounds = at_bounds

    def is_unsettled(self) -> bool:
        """Return whether in each of the last two windows at least half as many came and left as in the one before.

        What gets nearer settles: after a front has moved, each window has far fewer than the one before.
        """
        last = self.moves[-3:]
        return len(last) == 3 and all(2 * after > before > 0 for before, after in pairwise(last))

    def rate(self) -> float:
        """Return the contraction of the residual a sweep, over the second half of the stage.

        Over all of it where steps settle, as those of psor do: each trial of a relaxation raises the residual.
        """
        if len(self.residuals) < 2:
            return 1.0
        last_step, last = self.residuals[-1]
        since = 0 if self.settles else last_step // 2
        first_step, first = next(
            (entry for entry in self.residuals if entry[0] >= since), self.residuals[0]
        )
        if last_step == first_step or not first > 0.0 or not math.isfinite(last):
            return 1.0
        return float((last / first) ** (1.0 / (last_step - first_step)))

    def is_steady(self) -> bool:
        """Return whether the last two contractions of the residual agree."""
        if len(self.residuals) < 3:
            return False
        (_, first), (_, second), (_, third) = self.residuals[-3:]
        if not min(first, second, third) > 0.0:
            return False
        return abs(third / second - second / first) <= 0.05 * second / first  # two rates agree

    def steps_to_go(self, goal: float) -> float:
        """Return how many more steps reach that residual, at the stage's own rate."""
        if not self.residuals:
            return math.inf
        residual, rate = self.residuals[-1][1], self.rate()
        if residual <= goal:
            return 0.0
        return (
            math.log(goal / residual) / math.log(rate)
            if 0.0 < rate < 1.0 and goal > 0.0
            else math.inf
        )


class CheckSchedule:
    """When to measure the residual of an in-place method: at geometric intervals, and when it looks small enough."""

    def __init__(self, residual_per_increment: float, goal: float) -> None:
        self.next_check = FIRST_CHECK
        self.residual_per_increment = residual_per_increment
        self.goal = goal

    def is_due(self, iteration: int, increment: float | None) -> bool:
        """Return whether this step's residual is worth measuring."""
        if iteration >= self.next_check or increment is None:
            return True
        return increment * self.residual_per_increment <= self.goal

    def learn(self, iteration: int, increment: float, residual: float) -> None:
        """Take note of a measured residual: the next is due half as far again."""
        self.next_check = max(iteration + 1, math.ceil(max(iteration, FIRST_CHECK) * 1.5))
        if increment > 0.0:
            self.residual_per_increment = residual / increment


class Progress:
    """Whether the best residual still falls."""

    def __init__(self, n: int, max_iterations: int) -> None:
        # A front that crosses the unknowns one a sweep leaves the largest residual as it is until it has passed.
        self.shortest_window = max(
            200, 5 * math.ceil(math.log2(max(n, 2))), min(n, 2000)
        )  # no longer
        self.max_iterations = max_iterations
        self.window_start: tuple[int, float] | None = None
        self.last_residual, self.rises = math.inf, 0
        self.last_fall: tuple[int, float] = (0, math.inf)
        self.next_floor_check = FIRST_FLOOR_CHECK

    def restart(self, iteration: int, best: float) -> None:
        """Begin to watch for a standstill afresh at this iteration."""
        self.window_start = (iteration, best) if math.isfinite(best) else None

    def is_rising(self, residual: float) -> bool:
        """Return whether a measured residual is not finite, or higher than the one before for ten times in a row."""
        self.rises = self.rises + 1 if residual > self.last_residual else 0
        self.last_residual = residual
        return self.rises >= 10 or not math.isfinite(residual)

    def is_flat(self, iteration: int, best: float) -> bool:
        """Return whether it is time to ask for the rounding floor: no fall for 25, 50, 100, … steps."""
        since, value = self.last_fall
        if best < PROGRESS * value:
            self.last_fall = (iteration, best)
            self.next_floor_check = FIRST_FLOOR_CHECK
        elif iteration - since >= self.next_floor_check:
            self.next_floor_check *= 2
            return True
        return False

    def is_stalled(self, iteration: int, best: float, goal: float) -> bool:
        """Return whether a window passed with less than 1 % and extrapolation misses max_iterations.

        A window is at least half as long as the run was before it.
        """
        if self.window_start is None:
            self.window_start = (iteration, best)
        since, value = self.window_start
        if iteration - since < max(self.shortest_window, since // 2):
            return False
        self.window_start = (iteration, best)
        if best < PROGRESS * value:
            return False
        fall = math.log(value / best) / (iteration - since) if 0.0 < best < value else 0.0
        needed = math.log(best / goal) if 0.0 < goal < best else math.inf
        return needed > fall * (self.max_iterations - iteration)
