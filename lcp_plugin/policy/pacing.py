"""When the driver measures a residual or bounds the error, and when it concludes that nothing falls any more."""

from __future__ import annotations

import math

FIRST_CHECK = 10
CHECK_GROWTH = 1.5
FIRST_FLOOR_CHECK = 25
PROGRESS = 0.99
LONGEST_FRONT = 2000
RISING = 10


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
