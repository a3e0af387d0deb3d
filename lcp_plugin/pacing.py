"""When the driver measures a residual or bounds the error, and when it concludes that nothing falls any more."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from .checks import FloatVector
from .errors import UnsuitableMatrix
from .problem import LCP
from .settings import Settings

if TYPE_CHECKING:
    from .certificates.error_bounds import ErrorBound

FIRST_CHECK = 10
CHECK_GROWTH = 1.5
FIRST_FLOOR_CHECK = 25
PROGRESS = 0.99
LONGEST_FRONT = 2000
WORTH_BOUNDING = 100.0  # times the tolerance: a larger residual belongs to a larger error
CHEAP_EVERY = 0.5
SHARP_EVERY = 0.1


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
        self.last_fall: tuple[int, float] = (0, math.inf)
        self.next_floor_check = FIRST_FLOOR_CHECK

    def restart(self, iteration: int, best: float) -> None:
        """Begin to watch for a standstill afresh at this iteration."""
        self.window_start = (iteration, best) if math.isfinite(best) else None

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


class ErrorWatch:
    """When to bound the error of an iterate: seldom, since a sharp bound costs about a linear solve."""

    def __init__(self, problem: LCP, settings: Settings) -> None:
        self.problem, self.settings = problem, settings
        self.last_cheap = self.last_sharp = math.inf
        if settings.is_on_error:
            self._bound(problem.nearest_to_zero, sharp=False)  # refuses what can never be proved before the first step

    def proves(self, z: FloatVector, residual: float) -> bool:
        """Return whether a bound proves the tolerance for z, which has that scaled residual (its unit is that of z)."""
        largest = float(np.max(np.abs(z), initial=0.0))
        if residual > WORTH_BOUNDING * self.settings.tolerance * largest or residual > CHEAP_EVERY * self.last_cheap:
            return False
        self.last_cheap = residual
        if self._bound(z, sharp=False).proves(self.settings.tolerance):
            return True
        if residual > SHARP_EVERY * self.last_sharp:
            return False
        self.last_sharp = residual
        return self._bound(z, sharp=True).proves(self.settings.tolerance)

    def along_the_run(self, z: FloatVector) -> float | None:
        """Return the cheap bound of ‖z − z*‖∞ where the caller wants one and M allows it."""
        if not (self.settings.error_bound or self.settings.is_on_error):
            return None
        try:
            return self._bound(z, sharp=False).infinity
        except UnsuitableMatrix:
            return None

    def final(self, z: FloatVector) -> tuple[ErrorBound | None, str]:
        """Return the sharp bound, or None and the reason, where the caller wants one."""
        if not (self.settings.error_bound or self.settings.is_on_error):
            return None, ""
        try:
            return self._bound(z, sharp=True), ""
        except UnsuitableMatrix as error:
            return None, str(error)

    def _bound(self, z: FloatVector, *, sharp: bool) -> ErrorBound:
        from .certificates.error_bounds import error_bound

        return error_bound(self.problem, z, sharp=sharp)
