"""Why the steps of a run ended, and the judge: what a residual is, when it is small enough, what Status an end gets."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from enum import Enum
from types import MappingProxyType
from typing import Any

import numpy as np

from ..algorithm import Algorithm, Step
from ..certificates.criterion import CommonScaling, measured_scaled_residual, rounding_of_data
from ..certificates.residuals import GAINED, Certificate
from ..certificates.row_residuals import measured_residual, ratio
from ..checks import FloatVector
from ..kernels.floats import DATA_ROUNDING
from ..settings import Settings, Status
from .result import BoundOrReason

ASKED_AGAIN = 5  # after a fifth of the steps up to now


class End(Enum):
    """Why the steps of a run ended; what that makes of its best z only :meth:`Judge.verdict` says."""

    CONVERGED = "the judge was content with a step"
    NO_SOLUTION = "a step proved that there is no solution"
    AT_FLOOR = "the residual is no larger than rounding explains"
    STALLED = "the residual has stopped falling, or falls too slowly"
    DIVERGED = "the residual left every reasonable range"
    NOTHING_LEFT = "the last algorithm had no further step"
    STEP_LIMIT = "max_iterations came first"
    TIME_LIMIT = "max_seconds came first"
    INTERRUPTED = "Ctrl-C or the callback came first"


FAILED = (End.STALLED, End.DIVERGED, End.NOTHING_LEFT)  # another algorithm may do better
STATUS_OF = {
    End.STEP_LIMIT: Status.MAX_ITERATIONS,
    End.TIME_LIMIT: Status.MAX_SECONDS,
    End.INTERRUPTED: Status.INTERRUPTED,
    End.DIVERGED: Status.DIVERGED,
}  # of a z that nothing is shown of; of any other end it is STALLED


class Judge:
    """Measures, certifies and names the end of a run on the caller's own data; this one judges an LCP.

    Every z that it is given is in the scaling of the run; what it gives back is the caller's. A problem of another
    kind brings a judge of its own, which answers what :class:`~lcp_plugin.core.solving.run.Run` asks: at each step
    `residual_of` (what the algorithm says), `measure`, `certified` and `meets_tolerance`; where nothing falls
    `is_at_floor`; of a proof `accept_proof` and `misses_by_rounding`; at the end `final`,
    whose certificate `verdict` names the status of. ``Run.ended`` returns both, ``Run.judged`` makes the Result of an
    LCP of them.

    Attributes
    ----------
    problem : LCP
        The caller's.
    asked : LCP or NonlinearProblem
        What the caller wants to have solved; of a nonlinear problem, `problem` is the linearisation at the start.
    reference : float
        What the residuals of the run are relative to, in its units; where it is 0, z° solves the problem.
    proof : object or None
        Of the proofs that the problem has no solution, the one with the largest margin.
    words : mapping from Status to str
        What a status means, where another meaning than its own is right; the run says in addition what to do.
    advice : mapping from Status to str
        The whole of what is said of a status.
    """

    words: Mapping[Status, str] = MappingProxyType({})
    advice: Mapping[Status, str] = MappingProxyType({})
    _asked_at, _ask_again = math.inf, 0  # residual and iteration

    def __init__(self, scaling: CommonScaling, settings: Settings) -> None:
        self.scaling, self.problem, self.settings = scaling, scaling.stated, settings
        self.asked: Any = self.problem
        self.reference = scaling.reference
        self.proof: Any = None
        self._certificate: Certificate | None = None

    def certificate_of(self, z: FloatVector) -> Certificate:
        """Return the certificate of z on the caller's own data; the latest one is kept."""
        answer, latest = self.scaling.outward(z), self._certificate
        if latest is None or not np.array_equal(latest.z, answer):
            self._certificate = latest = Certificate.of(self.problem, answer)
        return latest

    def residual_of(self, step: Step) -> float | None:
        """Return the relative residual of a step where the algorithm knows it."""
        return None if step.residual is None else self._relative(step.residual)

    def measure(self, z: FloatVector) -> float:
        """Return the relative residual of z as double precision gives it."""
        return self._relative(measured_residual(self.scaling.problem, z))

    def _relative(self, residual: float) -> float:
        """Return a residual of the run beside the reference; 0 where z° answers all of them: no step changes that."""
        if self.reference == 0.0 and self.scaling.answered is not None:
            return 0.0
        return ratio(residual, self.reference)

    def certified(self, z: FloatVector) -> float:
        """Return an upper bound of the relative residual of z; no step changes what z° answers."""
        return self._relative_in_open_components(self.certificate_of(z))

    def _relative_in_open_components(self, certificate: Certificate) -> float:
        return certificate.relative_above(self.settings.least_reference, self.scaling.answered)

    def may_meet_tolerance(self, residual: float) -> bool:
        """Return whether a relative residual is so small that a certificate is worth its work."""
        return residual <= self.settings.goal

    def meets_tolerance(self, z: FloatVector, residual: float, iteration: int) -> bool:
        """Return whether z, of that certified residual, is what was asked for.

        Whether every row is right in its own terms, and whether it answers the program, if there is one, takes longer
        to tell, and is not asked at every step.
        """
        is_asked_in_vain = residual > 0.5 * self._asked_at and iteration < self._ask_again
        if not self.may_meet_tolerance(residual) or is_asked_in_vain:
            return False
        meets = self.certificate_of(z).ends_a_run(self.settings, self.scaling.answered)
        if not meets:
            self._asked_at, self._ask_again = residual, iteration + 1 + iteration // ASKED_AGAIN
        return meets

    def require_rigorous_bounds(self) -> None:
        """Raise where the run stops on the error and M allows no rigorous bound of it."""

    def bound_along_the_run(self, z: FloatVector, work: float) -> float | None:
        """Return a bound of ‖z − z*‖∞ where the caller wants one and M allows it."""
        return None

    def bound_at_the_end(
        self, certificate: Certificate
    ) -> BoundOrReason | Callable[[], BoundOrReason]:
        """Return the bound of the answer's error where the caller wants one, or how it is computed once looked at."""
        return BoundOrReason()

    def is_at_floor(self, z: FloatVector | None) -> bool:
        """Return whether the residual of z is small and no larger than rounding explains: no step is worth its work."""
        if z is None:
            return False
        certificate = self.certificate_of(z)
        return certificate.relative_residual <= GAINED and certificate.is_at_rounding_level

    def misses_by_rounding(self, z: FloatVector | None) -> bool:
        """Return whether no z is a solution, but this one misses by no more than rounding of the data."""
        if z is None or self.proof is None or not self.proof.is_rounding:
            return False
        certificate, problem = self.certificate_of(z), self.problem
        in_its_unit = DATA_ROUNDING * float(np.abs(problem.q).max(initial=0.0))
        if (
            certificate.natural_residual > in_its_unit
            and certificate.term_residual > self.settings.goal
        ):
            return False  # small beside a coefficient that need not act
        return measured_scaled_residual(problem, certificate.z) <= rounding_of_data(problem)

    def accept_proof(self, proof: Any) -> bool:
        """Keep the proof of the largest margin; return whether no z at all could be called solved beside this one.

        It is one in the units of the run; kept is what it says in the caller's. Where the problem is made from a
        program, that has to be proved infeasible in its own units as well.
        """
        settings, scaling = self.settings, self.scaling
        if (factors := scaling.row_factors) is not None:
            proof = proof.rescaled(scaling.stated, factors)
        if not proof.verify():
            return False
        if self.proof is None or proof.margin > self.proof.margin:
            self.proof = proof
        criterion = self.problem.criterion
        if not proof.excludes(
            settings.tolerance, settings.tolerance_on, settings.absolute_tolerance
        ):
            return False
        return criterion is None or criterion.has_no_solution(settings.tolerance)

    def final(self, z: FloatVector, end: End, last: Algorithm | None) -> Certificate:
        """Return the certificate of the answer: z, or z cleaned up by the last algorithm where that is no worse."""
        certificate = self.certificate_of(z)
        is_cut_short = end in (End.INTERRUPTED, End.TIME_LIMIT)
        if last is None or is_cut_short or not np.isfinite(z).all():
            return certificate
        finished = last.finish(self.scaling.problem, z)
        return (
            certificate
            if finished is z
            else self.better_of(certificate, self.certificate_of(finished))
        )

    def better_of(self, certificate: Certificate, cleaned: Certificate) -> Certificate:
        """Return the cleaned one unless its residual is larger or a row wrong, or it answers the program no more."""
        before, after = (self._relative_in_open_components(one) for one in (certificate, cleaned))
        meets = [one.meets(self.settings, self.scaling.answered) for one in (certificate, cleaned)]
        is_no_worse = after <= before < math.inf if meets[0] == meets[1] else meets[1]
        return (
            cleaned
            if is_no_worse and cleaned.answers_program(self.settings) is not False
            else certificate
        )

    def is_solved_by(self, certificate: Certificate) -> bool:
        """Return whether the certificate shows what was asked for; a program, if there is one, is answered as well."""
        return certificate.is_solved(self.settings)

    def verdict(self, certificate: Certificate, end: End, *, is_chain: bool) -> Status:
        """Return the status: what the certificate or a proof shows, or else why the run ended.

        Where one step of several algorithms diverged, the best z need not have: that is STALLED.
        """
        if end is End.INTERRUPTED and (ended_by := getattr(self.problem.origin, "ended_by", None)):
            self.proof = ended_by
            self.words = {**self.words, ended_by.status: f"the program is {ended_by}"}
            return ended_by.status  # type: ignore[no-any-return]
        if self.is_solved_by(certificate):
            return Status.SOLVED
        if end is End.NO_SOLUTION:
            return self.proof.status  # type: ignore[no-any-return]
        if certificate.is_limited_by_rounding or self.misses_by_rounding(
            self.scaling.inward(certificate.z)
        ):
            return Status.PRECISION_LIMIT
        return (
            Status.STALLED
            if end is End.DIVERGED and is_chain
            else STATUS_OF.get(end, Status.STALLED)
        )
