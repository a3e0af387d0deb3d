"""When the error of an iterate is bounded, and what the bound then proves."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from ...core.certificates.criterion import CommonUnits
from ...core.certificates.residuals import Certificate
from ...core.checks import FloatVector
from ...core.crossovers import SHARP_SAMPLES_UP_TO
from ...core.errors import UnsuitableMatrix
from ...core.lcp import LCP
from ...core.matrix.row_sums import unit_triangle_sums
from ...core.matrix.structure import parts
from ...core.settings import Settings, Status
from ...core.solving.judge import Judge
from ...core.solving.result import BoundOrReason

if TYPE_CHECKING:
    from .error_bounds import ErrorBound

CHEAP_AFTER = (0.01, 0.8)  # how far the residual has to fall until the next cheap bound
SHARP_EVERY = 0.1
SHARP_WORTH = 200  # sweeps that a sharp bound may cost
OUT_OF_STEP = 2.0
ADVICE = {
    Status.SOLVED: "the error is proved to be within the tolerance",
    Status.PRECISION_LIMIT: (
        "the error is not proved to be within the tolerance, and the residual is no larger than rounding in double "
        "precision explains: accept z with the bound it has, or rescale the data"
    ),
    Status.STALLED: (
        "the error is not proved to be within the tolerance, and the residual no longer falls enough to change that; "
        "raise the tolerance, or try another algorithm or a better start z0"
    ),
}


class ErrorWatch:
    """When to bound the error of an iterate: a sharp bound costs about a linear solve, a cheap one some sweeps.

    As long as the cheap bound falls in step with the residual, sweeping on is the way to a proof; where it does not,
    or after as many sweeps as a sharp bound may cost, a sharp one is tried.
    """

    def __init__(self, problem: LCP, settings: Settings) -> None:
        self.problem, self.settings = problem, settings
        self.next_cheap = self.last_residual = self.last_cheap = self.last_sharp = math.inf
        self.sharp_from = math.inf
        self.sampled: ErrorBound | None = None  # the last sharp one for a sample
        self.last_sampled, self.sample_from = math.inf, float(SHARP_WORTH)
        self.proof: tuple[FloatVector, ErrorBound] | None = None
        # ‖r‖∞ ≤ (1 + max Σ|m_ij|/d_i)‖z − z*‖∞: a larger residual belongs to a larger error.
        self.residual_per_error = 1.0
        if settings.is_on_error:
            sums = np.add(*unit_triangle_sums(problem.matrix))
            self.residual_per_error += problem.communicator.largest(float(sums.max(initial=0.0)))

    def require_rigorous(self) -> None:
        """Raise where the run stops on the error and M allows no rigorous bound of it."""
        if not self.settings.is_on_error:
            return
        n, nowhere = self.problem.n, np.full(self.problem.own, np.nan)
        try:  # nothing has to be measured to know the kind of the bounds to come
            kind = self._bound(nowhere, sharp=False).kind
        except UnsuitableMatrix as error:
            raise UnsuitableMatrix(f'tolerance_on="error" needs a rigorous bound; {error}') from error
        if kind != "rigorous":
            raise UnsuitableMatrix(
                'tolerance_on="error" needs a rigorous bound, but M is not proven to be an H₊-matrix, and a proof that '
                f"its symmetric part is positive definite needs a factorisation that n = {n} makes too large: "
                'there is only an estimate; ask for it by error_bound=True and stop on tolerance_on="residual"'
            )

    def proves(self, z: FloatVector, residual: float, iteration: int) -> bool:
        """Return whether a bound proves the tolerance for z, which has that scaled residual (its unit is that of z)."""
        tolerance = self.settings.tolerance
        largest = self.problem.communicator.largest(float(np.max(np.abs(z), initial=0.0)))
        is_far = not residual <= self.residual_per_error * tolerance * largest
        if is_far and parts(self.problem.matrix) is None:  # others have units of their own
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
        """Return a bound of ‖z − z*‖∞ where M allows it, after so much work.

        Where the cheap one is far above the residual, a sharp one is computed as often as the run can afford it. The
        point near z* that it knows bounds the error of the iterates that follow, too.
        """
        try:
            bound = self._bound(z, sharp=False)
        except UnsuitableMatrix:
            return None
        if bound.kind != "rigorous":
            return None
        from .error_bounds import LOOSE

        least = bound.infinity
        if self.sampled is not None:
            least = min(least, float(self.sampled.carried_to(z).max(initial=0.0)))
        is_affordable = self.problem.n <= SHARP_SAMPLES_UP_TO or work >= self.sample_from
        is_affordable = is_affordable and not self.problem.is_distributed  # no sharper one is known there
        if least > LOOSE * bound.residual and bound.residual <= SHARP_EVERY * self.last_sampled and is_affordable:
            self.last_sampled, self.sample_from = bound.residual, work + max(SHARP_WORTH, work / 2.0)
            self.sampled = self._bound(z, sharp=True)
            least = min(least, self.sampled.infinity)
        return least

    def is_proved(self, z: FloatVector) -> bool:
        """Return whether the tolerance on the error is proved for z, by a cheap bound or a sharp one."""
        if self._proof_of(z) is not None:
            return True
        bound = self._bound(z, sharp=False)
        if not bound.proves(self.settings.tolerance):
            bound = self._bound(z, sharp=True)
        self.proof = z, bound
        return bound.proves(self.settings.tolerance)

    def final(self, z: FloatVector) -> BoundOrReason | Callable[[], BoundOrReason]:
        """Return the bound of z, or how it is computed once somebody looks at it."""
        known = self._proof_of(z)
        if known is not None and (not known.is_loose or self.problem.is_distributed):
            return BoundOrReason(known)
        # One rank alone could not compute it later.
        return _sharpest(self.problem, z) if self.problem.is_distributed else partial(_sharpest, self.problem, z)

    def _proof_of(self, z: FloatVector) -> ErrorBound | None:
        is_known = self.proof is not None and self.problem.communicator.everywhere(np.array_equal(self.proof[0], z))
        return self.proof[1] if is_known and self.proof is not None else None

    def _bound(self, z: FloatVector, *, sharp: bool) -> ErrorBound:
        from .error_bounds import error_bound

        return error_bound(self.problem, z, sharp=sharp)


class ErrorJudge(Judge):
    """Judges an LCP whose error is to be bounded: SOLVED speaks of it where the tolerance does."""

    def __init__(self, units: CommonUnits, settings: Settings) -> None:
        super().__init__(units, settings)
        self.watch = ErrorWatch(self.problem, settings)
        self.advice = ADVICE if settings.is_on_error else {}

    def require_rigorous_bounds(self) -> None:
        """Raise where the run stops on the error and M allows no rigorous bound of it."""
        self.watch.require_rigorous()

    def passes(self, z: FloatVector, residual: float, iteration: int) -> bool:
        """Return whether z, of that certified residual, is what was asked for."""
        if not self.settings.is_on_error:
            return super().passes(z, residual, iteration)
        return self.watch.proves(self.units.outward(z), residual * self.reference, iteration)

    def is_solved_by(self, certificate: Certificate) -> bool:
        """Return whether the error is proved, where that was asked for."""
        if not self.settings.is_on_error:
            return super().is_solved_by(certificate)
        return self.watch.is_proved(certificate.z)

    def bound_along_the_run(self, z: FloatVector, work: float) -> float | None:
        """Return a bound of ‖z − z*‖∞ where M allows it."""
        return self.watch.along_the_run(self.units.outward(z), work)

    def bound_at_the_end(self, certificate: Certificate) -> BoundOrReason | Callable[[], BoundOrReason]:
        """Return the bound of the answer's error, or how it is computed once looked at."""
        return self.watch.final(certificate.z)


def _sharpest(problem: LCP, z: FloatVector) -> BoundOrReason:
    from .error_bounds import error_bound

    try:
        return BoundOrReason(error_bound(problem, z))
    except UnsuitableMatrix as error:
        return BoundOrReason(None, str(error))
