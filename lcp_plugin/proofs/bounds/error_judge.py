"""The judge of a run whose error is bounded: when that is done, and what the bound then proves."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from ...core.certificates.criterion import CommonScaling
from ...core.certificates.residuals import Certificate
from ...core.checks import FloatVector
from ...core.errors import UnsuitableMatrix
from ...core.lcp import LCP
from ...core.matrix.row_sums import unit_triangle_sums
from ...core.matrix.structure import connected_components
from ...core.settings import Settings, Status
from ...core.solving.judge import Judge
from ...core.solving.result import BoundOrReason
from ...core.tuning import SHARP_SAMPLES_UP_TO

if TYPE_CHECKING:
    from .error_bounds import ErrorBound

CHEAP_AFTER = (0.01, 0.8)  # how far the residual has to fall until the next cheap bound
SHARP_EVERY = 0.1
SHARP_WORTH = 200  # sweeps that a sharp bound may cost
ADVICE = {
    Status.SOLVED: "the error is proved to be within the tolerance",
    Status.PRECISION_LIMIT: (
        "the error is not proved to be within the tolerance, and the residual is no larger than rounding in double "
        "precision explains; next: accept z with the bound it has, or rescale the data"
    ),
    Status.STALLED: (
        "the error is not proved to be within the tolerance, and the residual no longer falls enough to change that; "
        "next: raise the tolerance, or try another algorithm or a better start z0"
    ),
}


class ErrorJudge(Judge):
    """Judges an LCP whose error is to be bounded: SOLVED speaks of it where the tolerance does.

    A sharp bound costs about a linear solve, a cheap one some sweeps. As long as the cheap bound falls in step with the
    residual, sweeping on is the way to a proof; where it does not, or after as many sweeps as a sharp bound may cost,
    a sharp one is tried.
    """

    def __init__(self, scaling: CommonScaling, settings: Settings) -> None:
        super().__init__(scaling, settings)
        self.advice = ADVICE if settings.is_on_error else {}
        self._next_cheap = self._last_residual = self._last_cheap = self._last_sharp = (
            self._sharp_from
        ) = math.inf
        self._sampled: ErrorBound | None = None  # the last sharp one for a sample
        self._last_sampled, self._sample_from = math.inf, float(SHARP_WORTH)
        self._bounded: tuple[FloatVector, ErrorBound] | None = (
            None  # the z of which the tolerance was last asked
        )
        # ‖r‖∞ ≤ (1 + max Σ|m_ij|/d_i)‖z − z*‖∞: a larger residual belongs to a larger error.
        self._residual_per_error = 1.0
        if settings.is_on_error:
            sums = np.add(*unit_triangle_sums(self.problem.matrix))
            self._residual_per_error += float(sums.max(initial=0.0))

    def require_rigorous_bounds(self) -> None:
        """Raise where the run stops on the error and M allows no rigorous bound of it."""
        if not self.settings.is_on_error:
            return
        nowhere = np.full(self.problem.q.size, np.nan)
        try:  # nothing has to be measured to know the kind of the bounds to come
            self._bound(nowhere, sharp=False)
        except UnsuitableMatrix as error:
            raise UnsuitableMatrix(
                f'tolerance_on="error" needs a rigorous bound; {error}'
            ) from error

    def meets_tolerance(self, z: FloatVector, residual: float, iteration: int) -> bool:
        """Return whether z, of that certified residual, is what was asked for: a bound proves the tolerance."""
        if not self.settings.is_on_error:
            return super().meets_tolerance(z, residual, iteration)
        z, residual, tolerance = (
            self.scaling.outward(z),
            residual * self.reference,
            self.settings.tolerance,
        )
        largest = float(np.abs(z).max(initial=0.0))
        is_far = not residual <= self._residual_per_error * tolerance * largest
        if (
            is_far and connected_components(self.problem.matrix) is None
        ):  # others have units of their own
            return False
        if residual > self._next_cheap and not (
            iteration >= self._sharp_from and residual < self._last_sharp
        ):
            return False
        bound = self._bound(z, sharp=False)
        if not bound.proves(tolerance) and self._is_sharp_due(bound, residual, iteration):
            self._last_sharp, self._sharp_from = (
                residual,
                iteration + max(SHARP_WORTH, iteration // 2),
            )
            sharp = self._bound(z, sharp=True)
            bound = sharp if sharp.proves(tolerance) else bound
        if bound.proves(tolerance):
            self._bounded = z.copy(), bound
            return True
        self._next_cheap = residual * min(
            max(tolerance / bound.relative, CHEAP_AFTER[0]), CHEAP_AFTER[1]
        )
        self._last_residual, self._last_cheap = residual, bound.infinity
        return False

    def _is_sharp_due(self, cheap: ErrorBound, residual: float, iteration: int) -> bool:
        self._sharp_from = min(self._sharp_from, iteration + SHARP_WORTH)
        if (
            cheap.infinity * self._last_residual <= 2.0 * self._last_cheap * residual
        ):  # it fell alike
            return iteration >= self._sharp_from
        return residual <= SHARP_EVERY * self._last_sharp

    def bound_along_the_run(self, z: FloatVector, work: float) -> float | None:
        """Return a bound of ‖z − z*‖∞ where M allows it, after so much work.

        Where the cheap one is far above the residual, a sharp one is computed as often as the run can afford it. The
        point near z* that it knows bounds the error of the iterates that follow, too.
        """
        from .error_bounds import LOOSE

        z = self.scaling.outward(z)
        try:
            bound = self._bound(z, sharp=False)
        except UnsuitableMatrix:
            return None
        least = bound.infinity
        if self._sampled is not None:
            least = min(least, float(self._sampled.carried_to(z).max(initial=0.0)))
        is_affordable = self.problem.n <= SHARP_SAMPLES_UP_TO or work >= self._sample_from
        if (
            least > LOOSE * bound.residual
            and bound.residual <= SHARP_EVERY * self._last_sampled
            and is_affordable
        ):
            self._last_sampled, self._sample_from = (
                bound.residual,
                work + max(SHARP_WORTH, work / 2.0),
            )
            self._sampled = self._bound(z, sharp=True)
            least = min(least, self._sampled.infinity)
        return least

    def is_solved_by(self, certificate: Certificate) -> bool:
        """Return whether the error is proved, by a cheap bound or a sharp one, where that was asked for."""
        if not self.settings.is_on_error:
            return super().is_solved_by(certificate)
        bound = self._known(certificate.z) or self._bound(certificate.z, sharp=False)
        if not bound.proves(self.settings.tolerance):
            bound = self._bound(certificate.z, sharp=True)
        self._bounded = certificate.z, bound
        return bound.proves(self.settings.tolerance)

    def bound_at_the_end(
        self, certificate: Certificate
    ) -> BoundOrReason | Callable[[], BoundOrReason]:
        """Return the bound of the answer's error, or how it is computed once looked at."""
        z = certificate.z
        known = self._known(z)
        if known is not None and not known.is_loose:
            return BoundOrReason(known)
        return partial(_sharpest, self.problem, z)

    def _known(self, z: FloatVector) -> ErrorBound | None:
        is_known = self._bounded is not None and np.array_equal(self._bounded[0], z)
        return self._bounded[1] if is_known and self._bounded is not None else None

    def _bound(self, z: FloatVector, *, sharp: bool) -> ErrorBound:
        from .error_bounds import error_bound

        return error_bound(self.problem, z, sharp=sharp)


def _sharpest(problem: LCP, z: FloatVector) -> BoundOrReason:
    from .error_bounds import error_bound

    try:
        return BoundOrReason(error_bound(problem, z))
    except UnsuitableMatrix as error:
        return BoundOrReason(None, str(error))
