"""The judge of a run: what a residual is, when it is small enough, and what the certificate makes of the end."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from ..algorithms import Algorithm, Step
from ..certificates.residuals import GAINED, Certificate, ratio, reference_residual
from ..certificates.row_residuals import measured_residual
from ..checks import FloatVector
from ..problem.lcp import LCP
from ..settings import PROVEN, Settings, Status
from .error_watch import BoundOrReason, ErrorWatch

SAFE_TO_SQUARE = (1e-140, 1e140)  # beyond, a sum of squares has lost digits or overflowed


class Judge:
    """Measures, certifies and names the end of a run on the caller's own data.

    Attributes
    ----------
    reference : float
        ‖r(z°)‖∞; where it is 0, z° solves the problem and no other point can be measured against it.
    proof : object or None
        Of the proofs that the problem has no solution, the one with the largest margin.
    words : mapping from Status to str
        The advice of a status where another than its own is right.
    """

    words: ClassVar[Mapping[Status, str]] = {}

    def __init__(self, problem: LCP, settings: Settings) -> None:
        self.problem, self.settings = problem, settings
        self.reference = reference_residual(problem)
        self.errors = ErrorWatch(problem, settings) if settings.error_bound or settings.is_on_error else None
        self.proof: Any = None
        self._certificate: Certificate | None = None

    def certificate_of(self, z: FloatVector) -> Certificate:
        """Return the certificate of z on the caller's own data."""
        return Certificate.of(self.problem, z)

    @property
    def per_increment(self) -> float:
        """How large a residual is beside the increment that goes with it near the answer, about."""
        return ratio(1.0, self.reference) if self.settings.measure == "relative" else 1.0

    def residual_of(self, step: Step) -> float | None:
        """Return the residual of a step in the measure of the run where the algorithm knows it."""
        if self.settings.measure == "relative":
            return None if step.residual is None else ratio(step.residual, self.reference)
        if step.euclidean is not None and SAFE_TO_SQUARE[0] < step.euclidean < SAFE_TO_SQUARE[1]:
            return step.euclidean
        return None

    def measure(self, z: FloatVector) -> float:
        """Return the residual of z in the measure of the run, as double precision gives it."""
        if self.settings.measure == "euclidean":
            return self.certificate_of(z).euclidean_residual
        return ratio(measured_residual(self.problem, z), self.reference)

    def certified(self, z: FloatVector) -> float:
        """Return an upper bound of the residual of z in the measure of the run."""
        self._certificate = self.certificate_of(z)
        return self._certificate.measured(self.settings.measure)

    @cached_property
    def unit(self) -> float:
        """The size of a residual that is nothing to worry about: that of z°."""
        return 1.0 if self.settings.measure == "relative" else self.measure(self.problem.nearest_to_zero)

    def passes(self, z: FloatVector, residual: float, iteration: int) -> bool:
        """Return whether z, of that certified residual, is what was asked for."""
        if self.errors is None or not self.settings.is_on_error:
            return bool(residual <= self.settings.tolerance)
        if self.settings.measure == "euclidean":  # another norm, in another unit
            residual = self.certificate_of(z).relative_residual
        return self.errors.proves(z, residual * self.reference, iteration)

    def require_rigorous_bounds(self) -> None:
        """Raise where the run stops on the error and M allows no rigorous bound of it."""
        if self.errors is not None:
            self.errors.require_rigorous()

    def bound_along_the_run(self, z: FloatVector, work: float) -> float | None:
        """Return a bound of ‖z − z*‖∞ where the caller wants one and M allows it."""
        return None if self.errors is None else self.errors.along_the_run(z, work)

    def bound_at_the_end(self, certificate: Certificate) -> BoundOrReason | Callable[[], BoundOrReason]:
        """Return the bound of the answer's error where the caller wants one, or how it is computed once looked at."""
        return BoundOrReason() if self.errors is None else self.errors.final(certificate.z)

    def is_at_floor(self, z: FloatVector | None) -> bool:
        """Return whether the residual of z is no larger than rounding explains."""
        return z is not None and _is_at_floor(self.certificate_of(z))

    def counts(self, proof: Any) -> bool:
        """Keep the proof of the largest margin; return whether no z at all could be called solved beside this one.

        Where the problem is made from a program, that has to be refuted in its own units as well.
        """
        settings = self.settings
        if not proof.verify():
            return False
        if self.proof is None or proof.measured(settings.measure) > self.proof.measured(settings.measure):
            self.proof = proof
        if not proof.excludes(settings.tolerance, settings.measure, settings.tolerance_on):
            return False
        is_refuted = getattr(self.problem.origin, "is_refuted", None)
        return is_refuted is None or is_refuted(settings.tolerance)

    def final(self, z: FloatVector, reason: Status, last: Algorithm | None) -> Certificate:
        """Return the certificate of the answer: z, or z cleaned up by the last algorithm where that is no worse."""
        if self.errors is not None and self.errors.proof is not None:  # in another measure it need not be the best
            z = self.errors.proof[0]
        everywhere, certificate = self.problem.peers.everywhere, self._certificate
        if certificate is None or not everywhere(np.array_equal(certificate.z, z)):
            certificate = self.certificate_of(z)
        may_finish = reason not in (Status.INTERRUPTED, Status.MAX_SECONDS) and self.settings.measure == "relative"
        if last is None or not may_finish or not everywhere(bool(np.isfinite(z).all())):
            return certificate
        finished = last.finish(self.problem, z)
        cleaned = certificate if finished is z else self.certificate_of(finished)
        return cleaned if cleaned.relative_residual <= certificate.relative_residual < math.inf else certificate

    def verdict(self, certificate: Certificate, reason: Status, *, is_chain: bool) -> Status:
        """Return the status: what the certificate proves, or else why the run ended."""
        if self.errors is not None and self.settings.is_on_error:
            is_solved = self.errors.is_proved(certificate.z)
        else:
            is_solved = certificate.measured(self.settings.measure) <= self.settings.tolerance
        if is_solved:
            return Status.SOLVED
        if reason in PROVEN:
            return reason
        if _is_at_floor(certificate):
            return Status.PRECISION_LIMIT
        is_unfounded = reason in (Status.SOLVED, Status.PRECISION_LIMIT)
        return Status.STALLED if is_unfounded or (reason is Status.DIVERGED and is_chain) else reason


def _is_at_floor(certificate: Certificate) -> bool:
    return certificate.relative_residual <= GAINED and certificate.is_at_rounding_level
