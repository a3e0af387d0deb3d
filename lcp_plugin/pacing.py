"""When the driver measures a residual or bounds the error, and when it concludes that nothing falls any more."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from .algorithms.base import Step
from .certificates.contraction import unit_triangle_sums
from .checks import FloatVector
from .errors import UnsuitableMatrix
from .problem import LCP
from .result import Bounded, Status
from .settings import Settings

if TYPE_CHECKING:
    from .certificates.error_bounds import ErrorBound

FIRST_CHECK = 10
CHECK_GROWTH = 1.5
FIRST_FLOOR_CHECK = 25
PROGRESS = 0.99
LONGEST_FRONT = 2000
CHEAP_AFTER = (0.01, 0.8)  # how far the residual has to fall until the next cheap bound
SHARP_EVERY = 0.1
SHARP_WORTH = 200  # sweeps that a sharp bound may cost
SAMPLED_UP_TO = 100_000  # unknowns with which a sharp bound takes half a second
OUT_OF_STEP = 2.0
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


class Paused:
    """Stop a run's clock while something is measured that the algorithm did not need; `run.stopped` grows by it."""

    def __init__(self, run: Any) -> None:
        self.run = run

    def __enter__(self) -> Paused:
        self.began = time.perf_counter()
        return self

    def __exit__(self, *_: object) -> None:
        self.seconds = time.perf_counter() - self.began
        self.run.stopped += self.seconds


class Ending:
    """When a run is over: one decision, whether its rows lie on one process or on many.

    A run gives what is asked here; on many processes all of it is the same on each.
    """

    settings: Settings
    progress: Progress
    iteration: int
    best: float
    start_residual: float

    @property
    def elapsed(self) -> float:
        """Seconds that count against the limit."""
        raise NotImplementedError

    @property
    def unit(self) -> float:
        """The size of a residual that is nothing to worry about: that of z°."""
        raise NotImplementedError

    def passes(self, z: FloatVector, residual: float) -> bool:
        """Return whether z is what was asked for."""
        raise NotImplementedError

    def is_at_floor(self) -> bool:
        """Return whether the best residual is no larger than rounding explains."""
        raise NotImplementedError

    def reason_to_end(self, step: Step, residual: float | None, *, is_monotone: bool) -> Status | None:
        """Return why the run ends with this step, or None."""
        if residual is not None:
            if self.passes(step.z, residual):
                return Status.SOLVED
            is_lost = (is_monotone and self.progress.is_rising(residual)) or not math.isfinite(residual)
            is_beyond = is_lost and not residual <= DIVERGED_BEYOND * self.start_residual
            if is_beyond and not residual <= DIVERGED_BEYOND * self.unit:
                return Status.DIVERGED
        elif step.increment is not None and not math.isfinite(step.increment):
            return Status.DIVERGED
        if self.iteration >= self.settings.max_iterations:
            return Status.MAX_ITERATIONS
        if self.elapsed >= self.settings.max_seconds:
            return Status.MAX_SECONDS
        if step.is_settling:
            self.progress.restart(self.iteration, self.best)
        if residual is None:
            return None
        if self.progress.is_flat(self.iteration, self.best) and self.is_at_floor():
            return Status.PRECISION_LIMIT
        if not is_monotone:
            return None
        return Status.STALLED if self.progress.is_stalled(self.iteration, self.best, self.settings.tolerance) else None


class ErrorWatch:
    """When to bound the error of an iterate: a sharp bound costs about a linear solve, a cheap one some sweeps.

    As long as the cheap bound falls in step with the residual, sweeping on is the way to a proof; where it does not,
    or after as many sweeps as a sharp bound may cost, a sharp one is tried.
    """

    def __init__(self, problem: LCP, settings: Settings) -> None:
        self.problem, self.settings = problem, settings
        self.next_cheap = self.last_residual = self.last_cheap = self.last_sharp = math.inf
        self.sharp_from = math.inf
        self.is_wanted = bool(settings.error_bound or settings.is_on_error)
        self.sampled: ErrorBound | None = None  # the last sharp one for a sample
        self.last_sampled, self.sample_from = math.inf, float(SHARP_WORTH)
        self.proof: tuple[FloatVector, ErrorBound] | None = None
        # ‖r‖∞ ≤ (1 + max Σ|m_ij|/d_i)‖z − z*‖∞: a larger residual belongs to a larger error.
        self.residual_per_error = 1.0
        if settings.is_on_error:
            self.residual_per_error += float(np.add(*unit_triangle_sums(problem)).max(initial=0.0))

    def require_rigorous(self) -> None:
        """Raise where the run stops on the error and M allows no rigorous bound of it."""
        n = self.problem.n
        # Nothing has to be measured to know the kind of the bounds to come.
        if self.settings.is_on_error and self._bound(np.full(n, np.nan), sharp=False).kind != "rigorous":
            raise UnsuitableMatrix(
                'tolerance_on="error" needs a rigorous bound, but M is not proven to be an H₊-matrix, and a proof that '
                f"its symmetric part is positive definite needs a factorisation that n = {n} makes too large: "
                'there is only an estimate; ask for it by error_bound=True and stop on tolerance_on="residual"'
            )

    def proves(self, z: FloatVector, residual: float, iteration: int) -> bool:
        """Return whether a bound proves the tolerance for z, which has that scaled residual (its unit is that of z)."""
        tolerance = self.settings.tolerance
        largest = float(np.max(np.abs(z), initial=0.0))
        if not residual <= self.residual_per_error * tolerance * largest:
            return False
        if residual > self.next_cheap and not (iteration >= self.sharp_from and residual < self.last_sharp):
            return False
        bound = self._bound(z, sharp=False)
        if not bound.proves(tolerance) and self._is_sharp_due(bound, residual, iteration):
            self.last_sharp, self.sharp_from = residual, iteration + max(SHARP_WORTH, iteration // 2)
            sharp = self._bound(z, sharp=True)
            bound = sharp if sharp.proves(tolerance) else bound
        if bound.proves(tolerance):
            self.proof = z.copy(), bound
            return True
        self.next_cheap = residual * min(max(tolerance / bound.relative, CHEAP_AFTER[0]), CHEAP_AFTER[1])
        self.last_residual, self.last_cheap = residual, bound.infinity
        return False

    def _is_sharp_due(self, cheap: ErrorBound, residual: float, iteration: int) -> bool:
        self.sharp_from = min(self.sharp_from, iteration + SHARP_WORTH)
        if cheap.infinity * self.last_residual <= OUT_OF_STEP * self.last_cheap * residual:
            return iteration >= self.sharp_from
        return residual <= SHARP_EVERY * self.last_sharp

    def along_the_run(self, z: FloatVector, work: float) -> float | None:
        """Return a bound of ‖z − z*‖∞ where the caller wants one and M allows it, after so much work.

        Where the cheap one is far above the residual, a sharp one is computed as often as the run can afford it. The
        point near z* that it knows bounds the error of the iterates that follow, too.
        """
        if not self.is_wanted:
            return None
        try:
            bound = self._bound(z, sharp=False)
        except UnsuitableMatrix:
            return None
        if bound.kind != "rigorous":
            return None
        from .certificates.error_bounds import LOOSE

        least = bound.infinity
        if self.sampled is not None:
            least = min(least, float(self.sampled.carried_to(z).max(initial=0.0)))
        is_affordable = self.problem.n <= SAMPLED_UP_TO or work >= self.sample_from
        if least > LOOSE * bound.residual and bound.residual <= SHARP_EVERY * self.last_sampled and is_affordable:
            self.last_sampled, self.sample_from = bound.residual, work + max(SHARP_WORTH, work / 2.0)
            self.sampled = self._bound(z, sharp=True)
            least = min(least, self.sampled.infinity)
        return least

    def is_proved(self, z: FloatVector) -> bool:
        """Return whether the tolerance on the error is proved for z, by a cheap bound or a sharp one."""
        if self.proof is not None and np.array_equal(self.proof[0], z):
            return True
        bound = self._bound(z, sharp=False)
        if not bound.proves(self.settings.tolerance):
            bound = self._bound(z, sharp=True)
        self.proof = z, bound
        return bound.proves(self.settings.tolerance)

    def final(self, z: FloatVector) -> Bounded | Callable[[], Bounded]:
        """Return how the bound of z is computed once somebody looks at it; nothing where none is wanted."""
        if not self.is_wanted:
            return Bounded()
        known = self.proof[1] if self.proof is not None and np.array_equal(self.proof[0], z) else None
        return Bounded(known) if known is not None and not known.is_loose else partial(_sharpest, self.problem, z)

    def _bound(self, z: FloatVector, *, sharp: bool) -> ErrorBound:
        from .certificates.error_bounds import error_bound

        return error_bound(self.problem, z, sharp=sharp)


def _sharpest(problem: LCP, z: FloatVector) -> Bounded:
    from .certificates.error_bounds import error_bound

    try:
        return Bounded(error_bound(problem, z))
    except UnsuitableMatrix as error:
        return Bounded(None, str(error))
