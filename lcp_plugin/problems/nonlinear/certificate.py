"""The criterion of a nonlinear problem: the one of the LCP that F′(x) defines at x.

x is SOLVED if it passes the criterion of LCPs (:mod:`lcp_plugin.core.certificates.criterion`) for M = F′(x), q = F(x) −
F′(x) x and the bounds, with F(x) for w. As for an LCP, each x_i is first moved to a bound whose distance is at most the
step −F_i/d_i; F and F′ are evaluated again there, and the better of the two points is returned. A row with an infinite
slope (√x at 0) counts with the slope 1. For an affine F these are the tests of the LCP.

Two clauses are added, because the linearization is not F, and because F(x) is not summed more accurately:

- The reference is also at most the residual of F(z°), if that is defined and not 0: otherwise the reference grows
  without limit as x diverges. If z° solves a component of the linearization, ‖x − z°‖∞ takes the place of the residual
  at z°: F = x (x − 1) (x + 2) has the solution 1, where z° = 0 solves the linearization.
- The rounding error of F_i/d_i is at most max(tolerance, 10⁻⁸) times the reference. Otherwise two contradictory rows
  become zero by rounding as x diverges.

A point whose multiplier diverges, as at a cusp of the constraints, passes if all rows are zero up to rounding there.

2⁻⁵² T_i bounds the rounding error of F_i. If this bound is too large, the error is measured: F is evaluated at a few
points so close to x that its curvature is negligible, and F(x + δ) − F(x) − F′(x) δ is then rounding error.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from ...core.certificates.criterion import (
    POWER,
    RowsAtPoint,
    VectorEnds,
    row_data,
    rows_near_start,
    scaled_residual,
)
from ...core.certificates.residuals import Certificate
from ...core.checks import BoolVector, FloatVector, derived_property, read_only
from ...core.kernels.floats import EPSILON
from ...core.lcp import LCP
from ...core.settings import Settings
from .data import NonlinearProblem, UndefinedDerivativeError

# Shares of the step to the projected point: a derivative that is wrong by a half explains no residual.
NEARBY = 2.0**-6 / np.arange(1, 5)
ASIDE = 2.0**-30  # of x_i: the least distance; 1 − e⁻ˣ must round differently there, for small x
PRECISION = 1e-8  # of the reference: smaller rounding errors of F do not count, for any tolerance


@dataclass(frozen=True, eq=False)
class NonlinearCertificate(Certificate):
    """Residuals of x as a solution of its linearization.

    Attributes
    ----------
    problem : LCP
        The linearization at x; ``derivative`` and ``explain`` use it.
    z : ndarray, shape (n,)
        The point x.
    nonlinear : NonlinearProblem
        The problem.
    value : ndarray, shape (n,)
        F(x), which is w.
    origin_value : ndarray, shape (n,)
        F(z°).

    Examples
    --------
    >>> problem = NonlinearProblem(lambda x: x**2 - 4.0, lambda x: np.diag(2.0 * x), lower=[0.0])
    >>> certificate = Linearizations(problem).at(np.array([2.001])).certificate
    >>> certificate.w.round(4), float(round(certificate.relative_residual, 4))
    (array([0.004]), 0.001)
    """

    is_linearised: ClassVar[bool] = True

    nonlinear: NonlinearProblem = field(kw_only=True, repr=False)
    value: FloatVector = field(kw_only=True, repr=False)
    origin_value: FloatVector = field(kw_only=True, repr=False)

    @derived_property
    def _rows(self) -> RowsAtPoint:
        at = row_data(self.problem).rows(self.z, self.value)
        return at._replace(rounding=np.zeros(self.z.size))

    @property
    def violation(self) -> FloatVector:
        """The part of each F_i(x) with the wrong sign, |F_i(x)| off the bounds, shape (n,)."""
        return self._rows.violation

    def _start_references(self) -> VectorEnds:
        data, origin = row_data(self.problem), self.problem.nearest_to_zero
        ends, is_solved = super()._start_references(), rows_near_start(self.problem)
        distance = data.largest(np.abs(self.z - origin))
        residual = data.residual(origin, self.origin_value)
        of_value = data.largest(np.where(np.isfinite(self.origin_value), np.abs(residual), np.inf))
        of_value = np.where(of_value > 0.0, of_value, np.inf)
        least, most = (np.minimum(np.where(is_solved, distance, end), of_value) for end in ends)
        return least, most

    def meets(
        self, settings: Settings, solved: BoolVector | None = None, *, power: float = POWER
    ) -> bool:
        """Return whether x passes the criterion, and rounding errors of F are small."""
        if not super().meets(settings, solved, power=power):
            return False
        limit = max(settings.goal, PRECISION) * self.references[0]
        scale, at = self.problem.residual_scale, self._rows
        is_doubtful = at.is_active & (EPSILON * at.terms > limit * scale)
        return not (is_doubtful.any() and (is_doubtful & (self.noise > limit)).any())

    @derived_property
    def noise(self) -> FloatVector:
        """Estimate of the rounding error inside each F_i/d_i, shape (n,); NaN if F is not defined near x.

        The estimate is the largest |F(x + δ) − F(x) − F′(x) δ|_i / d_i, for δ a few fractions of 1/64 of the step to
        the projected point, or of 2⁻³⁰ x if that is larger.
        """
        problem, x = self.problem, self.z
        step = -scaled_residual(problem, x, self.value)
        step = np.copysign(np.maximum(np.abs(step), ASIDE * np.abs(x)), step)
        errors = []
        for share in NEARBY:
            near = np.clip(x + share * step, problem.lower, problem.upper)
            value = self.nonlinear.value(near)
            errors.append(np.abs(value - self.value - problem.M @ (near - x)))
        return np.asarray(np.max(errors, 0) / problem.residual_scale)

    @derived_property
    def rounding_floor(self) -> FloatVector:
        """Rounding bound of each residual, shape (n,), with the rounding error inside F."""
        floor: FloatVector = super().rounding_floor + self.noise
        return floor


class Linearization:
    """The problem near a point x: F(x), and the LCP of F′(x), computed on first use.

    Parameters
    ----------
    points : Linearizations
        The linearizations of the problem.
    x : array, shape (n,)
        A copy is kept.
    """

    def __init__(self, points: Linearizations, x: FloatVector) -> None:
        self.points, self.problem, self.x = points, points.problem, read_only(x.copy())
        self.value = self.problem.value(self.x)

    @derived_property
    def lcp(self) -> LCP:
        """The problem with M = F′(x), q = F(x) − F′(x) x; errors as of :meth:`NonlinearProblem.linearize`."""
        return self.problem.linearize(self.x, self.value)

    @derived_property
    def is_defined(self) -> bool:
        """True if F and its derivative are finite here."""
        if not np.isfinite(self.value).all():
            return False
        try:
            self.lcp  # noqa: B018
        except UndefinedDerivativeError:
            return False
        return True

    @derived_property
    def certificate(self) -> NonlinearCertificate:
        """The certificate of x."""
        return NonlinearCertificate(
            self.lcp,
            self.x,
            nonlinear=self.problem,
            value=self.value,
            origin_value=self.points.origin.value,
        )

    @derived_property
    def residual(self) -> float:
        """The relative residual of x."""
        return self.certificate.relative_residual


class Linearizations:
    """The latest linearizations of a problem, each of which is computed once.

    Parameters
    ----------
    problem : NonlinearProblem
    """

    REMEMBERED = 3

    def __init__(self, problem: NonlinearProblem) -> None:
        self.problem = problem
        self._latest: list[Linearization] = []

    @derived_property
    def origin(self) -> Linearization:
        """The linearization at z°, the point of the bounds nearest to 0; F need not be defined there."""
        return self.at(np.clip(0.0, self.problem.lower, self.problem.upper))

    def at(self, x: FloatVector) -> Linearization:
        """Return the linearization at x, shape (n,)."""
        for known in self._latest:
            if np.array_equal(known.x, x):
                return known
        self.keep(found := Linearization(self, x))
        return found

    def keep(self, linearisation: Linearization) -> None:
        """Store a linearization that was computed elsewhere."""
        self._latest = [linearisation, *self._latest[: self.REMEMBERED - 1]]
