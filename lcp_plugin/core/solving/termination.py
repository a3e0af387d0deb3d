"""Reasons why the steps of a run ended, and the stopping criterion of a run: residuals and their status."""

from __future__ import annotations

import math
from enum import Enum

import numpy as np

from ..certificates.criterion import (
    POWER,
    measured_residual,
    references_of_components,
    row_data,
    rows_solved_at_start,
    scaled_residual,
    snap_to_bounds,
)
from ..certificates.residuals import GAINED, Certificate, divide_nonnegative, ratio
from ..checks import BoolVector, FloatVector
from ..lcp import LCP
from ..settings import Settings


class TerminationReason(Enum):
    """Why the steps of a run ended; the run derives the status from it and from the best z."""

    CONVERGED = "a point passed both tests of the criterion"
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


class TerminationTest:
    """Residuals and certificates of the points of a run on an LCP; the test of the criterion.

    Attributes
    ----------
    problem : LCP
    goal : float
        The relative residual below which a point may pass.
    reference : float
        Divides the residuals of the algorithms; if it is 0, z° solves the problem.
    is_uniform : bool
        Whether all rows have that reference, so that the residual of an algorithm needs no other measurement.
    solved_rows : array of bool, shape (n,), or None
        Rows of components that z° solves.
    """

    solved_rows: BoolVector | None = None
    is_uniform = True
    _latest: tuple[FloatVector, Certificate] | None = None
    _failed_at, _next_test = math.inf, 0  # residual and iteration

    def __init__(self, problem: LCP, settings: Settings) -> None:
        self.problem, self.settings = problem, settings
        solved = rows_solved_at_start(problem)
        self.solved_rows = solved if solved.any() else None
        most = references_of_components(problem)[1]
        self._references = np.broadcast_to(most, (problem.n,))
        open_references = self._references[~solved]
        self.reference = float(open_references.max(initial=0.0))
        self.is_uniform = self.solved_rows is None and bool(
            (self.reference <= (1.0 + 1e-9) * open_references).all()
        )
        small = float(self._references.min(initial=math.inf, where=self._references > 0.0))
        self.goal = float(max(settings.tolerance, settings.absolute_tolerance / small))

    def certificate_of(self, z: FloatVector) -> Certificate:
        """Return the certificate of z after entries near bounds are projected; the latest certificate is cached."""
        if self._latest is None or not np.array_equal(self._latest[0], z):
            self._latest = z.copy(), Certificate.of(self.problem, snap_to_bounds(self.problem, z))
        return self._latest[1]

    def measure(self, z: FloatVector) -> float:
        """Return the relative residual of z in double precision."""
        if self.is_uniform:
            return ratio(measured_residual(self.problem, z), self.reference)
        residual = np.abs(scaled_residual(self.problem, z, self.problem.slack(z)))
        if self.solved_rows is not None:
            residual[self.solved_rows] = 0.0
        return float(divide_nonnegative(residual, self._references).max(initial=0.0))

    def certify(self, z: FloatVector) -> float:
        """Return an upper bound of the relative residual of z, without the components that z° solves."""
        least = self.settings.least_reference
        return self.certificate_of(z).relative_above(least, self.solved_rows, self.settings.goal)

    def is_passed(
        self, z: FloatVector, residual: float, iteration: int, power: float = POWER
    ) -> bool:
        """Return whether z with this certified residual passes; after a failure, only a fifth more steps are tested.

        `power` is the exponent of the tolerance next to the terms of a row.
        """
        is_early = residual > 0.5 * self._failed_at and iteration < self._next_test
        if not residual <= self.goal or is_early:
            return False
        meets = self.certificate_of(z).meets(self.settings, self.solved_rows, power=power)
        if not meets:
            self._failed_at, self._next_test = residual, iteration + 1 + iteration // 5
        return meets

    def is_at_floor(self, z: FloatVector | None) -> bool:
        """Return whether the residual of z is small and no larger than rounding explains: no step is worth its work."""
        if z is None:
            return False
        certificate = self.certificate_of(z)
        is_small = certificate.relative_residual <= GAINED and certificate.is_at_rounding_level
        return is_small and not self.is_rejected(certificate)

    def is_rejected(self, certificate: Certificate) -> bool:
        """Return whether the problem's origin rejects a point with a residual within the tolerance or its rounding."""
        is_small = certificate.relative_residual <= self.goal or certificate.is_at_rounding_level
        return is_small and row_data(self.problem).is_rejected(certificate.z, self.settings.goal)

    def better_of(self, certificate: Certificate, cleaned: Certificate) -> Certificate:
        """Return the cleaned point if only it passes, or if both or none pass and its residual is no larger."""
        both, least = (certificate, cleaned), self.settings.least_reference
        before, after = (one.relative_above(least, self.solved_rows) for one in both)
        meets = [one.meets(self.settings, self.solved_rows) for one in both]
        is_no_worse = after <= before < math.inf if meets[0] == meets[1] else meets[1]
        return cleaned if is_no_worse else certificate
