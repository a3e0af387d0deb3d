"""When the driver measures a residual or bounds the error, and when it concludes that nothing falls any more."""

from __future__ import annotations

import math
from typing import Protocol

from ..algorithms.base import Step
from ..checks import FloatVector
from ..settings import Settings, Status

FIRST_CHECK = 10
CHECK_GROWTH = 1.5
FIRST_FLOOR_CHECK = 25
PROGRESS = 0.99
LONGEST_FRONT = 2000
RISING = 10
DIVERGED_BEYOND = 1e8


class CheckSchedule:
    """When to measure the residual of an in-place method: at geometric intervals, and when it looks small enough."""

    def __init__(self, residual_per_increment: float, tolerance: float) -> None:
        self.next_check = FIRST_CHECK
        self.residual_per_increment = residual_per_increment
        self.tolerance = tolerance

    def is_due(self, iteration: int, increment: float | None) -> bool:
        """Return whether this step's residual is worth measuring."""
        if iteration >= self.next_check or increment is None:
            return True
        return increment * self.residual_per_increment <= self.tolerance

    def learn(self, iteration: int, increment: float, residual: float) -> None:
        """Take note of a measured residual: the next is due half as far again."""
        self.next_check = max(iteration + 1, math.ceil(max(iteration, FIRST_CHECK) * CHECK_GROWTH))
        if increment > 0.0:
            self.residual_per_increment = residual / increment


class Progress:
    """Whether the best residual still falls."""

    def __init__(self, n: int, max_iterations: int) -> None:
        # A front that crosses the unknowns one a sweep leaves the largest residual as it is until it arrives.
        self.shortest_window = max(200, 5 * math.ceil(math.log2(max(n, 2))), min(n, LONGEST_FRONT))
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
        return self.rises >= RISING or not math.isfinite(residual)

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

    def is_stalled(self, iteration: int, best: float, tolerance: float) -> bool:
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
        needed = math.log(best / tolerance) if 0.0 < tolerance < best else math.inf
        return needed > fall * (self.max_iterations - iteration)


class Running(Protocol):
    """What a run tells about itself; on many processes all of it is the same on each."""

    settings: Settings
    progress: Progress

    @property
    def iteration(self) -> int:
        """The present iteration."""

    @property
    def best(self) -> float:
        """The best residual so far."""

    @property
    def start_residual(self) -> float:
        """The residual of the start."""

    @property
    def elapsed(self) -> float:
        """Seconds that count against the limit."""

    @property
    def unit(self) -> float:
        """The size of a residual that is nothing to worry about: that of z°."""

    def passes(self, z: FloatVector, residual: float) -> bool:
        """Return whether z is what was asked for."""

    def is_at_floor(self) -> bool:
        """Return whether the best residual is no larger than rounding explains."""


def reason_to_end(run: Running, step: Step, residual: float | None, *, is_monotone: bool) -> Status | None:
    """Return why a run ends with this step, or None: one decision for one process and for many."""
    settings, progress = run.settings, run.progress
    if residual is not None:
        if run.passes(step.z, residual):
            return Status.SOLVED
        is_lost = (is_monotone and progress.is_rising(residual)) or not math.isfinite(residual)
        is_beyond = is_lost and not residual <= DIVERGED_BEYOND * run.start_residual
        if is_beyond and not residual <= DIVERGED_BEYOND * run.unit:
            return Status.DIVERGED
    elif step.increment is not None and not math.isfinite(step.increment):
        return Status.DIVERGED
    if run.iteration >= settings.max_iterations:
        return Status.MAX_ITERATIONS
    if run.elapsed >= settings.max_seconds:
        return Status.MAX_SECONDS
    if step.is_settling:
        progress.restart(run.iteration, run.best)
    if residual is None:
        return None
    if progress.is_flat(run.iteration, run.best) and run.is_at_floor():
        return Status.PRECISION_LIMIT
    if is_monotone and progress.is_stalled(run.iteration, run.best, settings.tolerance):
        return Status.STALLED
    return None
