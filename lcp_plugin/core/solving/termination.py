"""Reasons why the steps of a run ended, and the stopping criterion of a run: residuals and their status."""

from __future__ import annotations

import math
from collections.abc import Mapping
from enum import Enum
from functools import cached_property
from types import MappingProxyType
from typing import Any

import numpy as np

from ..algorithm import Algorithm, Step
from ..certificates.criterion import (
    POWER,
    measured_residual,
    references_of_components,
    rounding_of_data,
    rows_solved_at_start,
    scaled_residual,
    snap_to_bounds,
)
from ..certificates.residuals import GAINED, Certificate
from ..certificates.row_residuals import (
    divide_nonnegative,
    ratio,
)
from ..checks import BoolVector, FloatVector
from ..kernels.floats import DATA_ROUNDING
from ..lcp import LCP
from ..settings import Settings, Status

ASKED_AGAIN = 5  # after a fifth of the steps up to now
ALIKE = 1.0 + 1e-9  # references so near are one


class TerminationReason(Enum):
    """Why the steps of a run ended; :meth:`TerminationTest.verdict` derives the status from it and from the best z."""

    CONVERGED = "the judge was content with a step"
    NO_SOLUTION = "a step proved that there is no solution"
    AT_FLOOR = "the residual is no larger than rounding explains"
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
STATUS_OF = {
    TerminationReason.STEP_LIMIT: Status.MAX_ITERATIONS,
    TerminationReason.TIME_LIMIT: Status.MAX_SECONDS,
    TerminationReason.INTERRUPTED: Status.INTERRUPTED,
    TerminationReason.DIVERGED: Status.DIVERGED,
}  # of a z that nothing is shown of; of any other end it is STALLED


class TerminationTest:
    """Measures and certifies the points of a run on the user's data, and determines its status; this class is for LCPs.

    Every other problem class has its own judge with the methods that :class:`~lcp_plugin.core.solving.run.Run` calls:
    at each step `residual_of` (the residual that the algorithm reports), `measure`, `certify` and `meets_tolerance`, if
    the residual no longer falls `is_at_floor`, for a proof `accept_proof` and `misses_by_rounding`, and at the end
    `final`, whose certificate determines the status by `verdict`. ``Run.conclude`` returns the certificate and the
    status, from which ``Run.result`` builds the Result of an LCP.

    Attributes
    ----------
    problem : LCP
        The user's.
    asked : LCP or NonlinearProblem
        The problem to be solved; for a nonlinear problem, `problem` is the linearization at the start.
    reference : float
        Divides the residuals of the algorithms; if it is 0, z° solves the problem.
    answered : array of bool, shape (n,), or None
        Rows of components that z° solves.
    proof : object or None
        Proof with the largest margin that the problem has no solution.
    words : mapping from Status to str
        Meaning of a status if it differs from the default text; the run adds the advice.
    """

    words: Mapping[Status, str] = MappingProxyType({})
    answered: BoolVector | None = None
    _is_uniform = True  # all rows have one reference
    _asked_at, _ask_again = math.inf, 0  # residual and iteration

    def __init__(self, problem: LCP, settings: Settings) -> None:
        self.asked: Any = problem
        self.problem, self.settings = problem, settings
        answered = rows_solved_at_start(problem)
        self.answered = answered if answered.any() else None
        most = references_of_components(problem)[1]
        self._references = np.broadcast_to(most, (problem.n,))
        open_references = self._references[~answered]
        self.reference = float(open_references.max(initial=0.0))
        self._is_uniform = self.answered is None and bool(
            (self.reference <= ALIKE * open_references).all()
        )
        self.proof: Any = None
        self._certificate: Any = None

    def certificate_of(self, z: FloatVector) -> Certificate:
        """Return the certificate of z after entries near bounds are projected; the latest certificate is cached."""
        if self._certificate is None or not np.array_equal(self._certificate[0], z):
            self._certificate = (
                z.copy(),
                Certificate.of(self.problem, snap_to_bounds(self.problem, z)),
            )
        latest: Certificate = self._certificate[1]
        return latest

    def snap_start(self, start: FloatVector) -> FloatVector:
        """Return the start with z° in components that it solves: no other point can be measured there."""
        if self.reference == 0.0:
            return self.problem.nearest_to_zero
        if self.answered is None:
            return start
        return np.where(self.answered, self.problem.nearest_to_zero, start)

    def residual_of(self, step: Step) -> float | None:
        """Return the relative residual of a step if the algorithm reports it."""
        if step.residual is None or not self._is_uniform:
            return None
        return ratio(step.residual, self.reference)

    def measure(self, z: FloatVector) -> float:
        """Return the relative residual of z in double precision."""
        if self._is_uniform:
            return ratio(measured_residual(self.problem, z), self.reference)
        with np.errstate(all="ignore"):
            residual = np.abs(scaled_residual(self.problem, z, self.problem.slack(z)))
        if self.answered is not None:
            residual[self.answered] = 0.0
        return float(divide_nonnegative(residual, self._references).max(initial=0.0))

    def certify(self, z: FloatVector) -> float:
        """Return an upper bound of the relative residual of z, without the components that z° solves."""
        return self.certificate_of(z).relative_above(self.settings.least_reference, self.answered)

    @cached_property
    def goal(self) -> float:
        """The relative residual below which a point may pass."""
        small = float(self._references.min(initial=math.inf, where=self._references > 0.0))
        return float(max(self.settings.tolerance, self.settings.absolute_tolerance / small))

    def meets_tolerance(
        self, z: FloatVector, residual: float, iteration: int, power: float = POWER
    ) -> bool:
        """Return whether z with this certified residual passes; not every step is tested.

        `power` is the exponent of the tolerance next to the terms of a row.
        """
        is_asked_in_vain = residual > 0.5 * self._asked_at and iteration < self._ask_again
        if not residual <= self.goal or is_asked_in_vain:
            return False
        meets = self.certificate_of(z).meets(self.settings, self.answered, power=power)
        if not meets:
            self._asked_at, self._ask_again = residual, iteration + 1 + iteration // ASKED_AGAIN
        return meets

    def is_at_floor(self, z: FloatVector | None) -> bool:
        """Return whether the residual of z is small and no larger than rounding explains: no step is worth its work."""
        if z is None:
            return False
        certificate = self.certificate_of(z)
        return certificate.relative_residual <= GAINED and certificate.is_at_rounding_level

    def misses_by_rounding(self, z: FloatVector | None) -> bool:
        """Return whether no z is a solution, but the violation at this z is at most the rounding of the data."""
        if z is None or self.proof is None or not self.proof.is_rounding:
            return False
        certificate, problem = self.certificate_of(z), self.problem
        in_its_unit = DATA_ROUNDING * float(np.abs(problem.q).max(initial=0.0))
        if (
            certificate.natural_residual > in_its_unit
            and certificate.term_residual > self.settings.goal
        ):
            return False  # small relative to a coefficient that may be inactive
        return measured_residual(problem, certificate.z) <= rounding_of_data(problem)

    def accept_proof(self, proof: Any) -> bool:
        """Return whether the proof excludes that any z is SOLVED; store the proof if decisive or of largest margin."""
        if not proof.verify():
            return False
        excludes = proof.excludes(self.settings.tolerance, self.settings.absolute_tolerance)
        if excludes or self.proof is None or proof.margin > self.proof.margin:
            self.proof = proof
        return bool(excludes)

    def final(self, z: FloatVector, end: TerminationReason, last: Algorithm | None) -> Certificate:
        """Return the certificate of the result: z, or z finished by the last algorithm if that is not worse."""
        certificate = self.certificate_of(z)
        if not (certificate.is_linearised or self.is_solved_by(certificate)):
            plain = Certificate.of(
                self.problem, z
            )  # the best iterate; SOLVED refers to the projected point
            certificate = certificate if self.is_solved_by(plain) else plain
        is_cut_short = end in (TerminationReason.INTERRUPTED, TerminationReason.TIME_LIMIT)
        if last is None or is_cut_short or not np.isfinite(z).all():
            return certificate
        finished = last.finish(self.problem, z)
        return (
            certificate
            if finished is z
            else self.better_of(certificate, self.certificate_of(finished))
        )

    def better_of(self, certificate: Certificate, cleaned: Certificate) -> Certificate:
        """Return the cleaned point if only it passes, or if both or none pass and its residual is no larger."""
        both, least = (certificate, cleaned), self.settings.least_reference
        before, after = (one.relative_above(least, self.answered) for one in both)
        meets = [one.meets(self.settings, self.answered) for one in both]
        is_no_worse = after <= before < math.inf if meets[0] == meets[1] else meets[1]
        return cleaned if is_no_worse else certificate

    def is_solved_by(self, certificate: Certificate) -> bool:
        """Return whether the certificate passes the criterion."""
        return certificate.meets(self.settings)

    def verdict(
        self, certificate: Certificate, end: TerminationReason, *, is_chain: bool
    ) -> Status:
        """Return the status from the certificate or a proof, or else from the reason for the end of the run.

        If one step of several algorithms diverged, the best z need not have: that is STALLED.
        """
        if self.is_solved_by(certificate):
            return Status.SOLVED
        if end is TerminationReason.NO_SOLUTION:
            return self.proof.status  # type: ignore[no-any-return]
        if certificate.is_limited_by_rounding or self.misses_by_rounding(certificate.z):
            return Status.PRECISION_LIMIT
        return (
            Status.STALLED
            if end is TerminationReason.DIVERGED and is_chain
            else STATUS_OF.get(end, Status.STALLED)
        )
