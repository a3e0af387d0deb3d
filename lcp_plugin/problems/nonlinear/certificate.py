"""Certificate of a nonlinear problem: the residuals of its linearization at x, with F(x) for w.

The residual of row i is r_i(x) = x_i − mid(lower_i, upper_i, x_i − F_i(x)/d_i). Its scale d is computed from F′(x)
as an LCP computes it from M: the diagonal, or the row's largest entry if the diagonal is negligible. The reference
r(x°) has F(x°) for w, with x° the point of the bounds nearest to 0. Its scale is also computed from F′(x), because
residual and reference then change alike with the units of F and of x. For an affine F these are the residuals of
the LCP. A row with an infinite slope (√x at 0) counts with d = 1. The components of the problem are the components
of F′(x), and each component has a reference of its own.

No affine F with the derivative F′(x) has a larger ‖r_P(x°)‖∞ than

    ‖r_P(x)‖∞ + max_i (|x − x°|_i + (|F′(x)| |x − x°|)_i / d_i),  i in P,

so the reference is limited to this value. If F(x°) is undefined or solves the component, the reference is ‖x −
x°‖∞: x° is a solution, but not the solution of a run that does not approach x°.

A reference in the unit of x is weak if F flattens as x diverges. Each row is therefore also compared with its
terms, T_i = |q_i| + Σ_j |m_ij x_j| with M = F′(x), q = F(x) − F′(x) x (:func:`term_residuals`). The relative
residual is the largest of all.

F(x) is used as F returns it. The rounding error inside F is estimated when progress stops: F is evaluated at a few
points so close to x that its curvature is negligible, and F(x + δ) − F(x) − F′(x) δ is then rounding error.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from ...core.certificates.criterion import VectorEnds, row_data, scaled_residual
from ...core.certificates.residuals import GAINED, Certificate
from ...core.checks import BoolVector, FloatVector, read_only
from ...core.errors import InvalidProblem
from ...core.kernels.floats import EPSILON
from ...core.lcp import LCP
from ...core.matrix.matrix import largest_in_rows
from .data import Linearization, NonlinearProblem

# of the step to the projected point: a derivative that is wrong by a half explains no residual
NEARBY = 2.0**-6
ASKED = 4  # points
NEARLY_THERE = 1e-4  # of the way from the start to x°
VANISHING = 1e-3  # of its terms: a row with a larger value does not vanish
FAINT = 1e-2  # of the terms of every row: rows that are satisfied barely determine such an unknown
ROUNDED = 1.0 + 2.0**-40  # of sums of nonnegative terms: below it an affine F may not come


@dataclass(frozen=True)
class Reference:
    """Reference of the residuals: x°, the point of the bounds nearest to 0, and F(x°).

    Attributes
    ----------
    x, value : ndarray, shape (n,)
        x° and F(x°), which need not be defined.
    start : ndarray, shape (n,)
        Start of the run, within the bounds.
    """

    x: FloatVector
    value: FloatVector
    start: FloatVector

    @classmethod
    def of(cls, problem: NonlinearProblem, start: FloatVector) -> Reference:
        """Return the reference of a problem.

        Raises
        ------
        InvalidProblem
            If F is not defined at the start.
        """
        value = problem.value(start)
        if not np.isfinite(value).all():
            i = int(np.flatnonzero(~np.isfinite(value))[0])
            raise InvalidProblem(
                f"F must be finite at the start, but F(x0)[{i}] = {value[i]} with x0[{i}] = {start[i]} after "
                "projection onto the bounds; start where F is defined, or tighten the bounds"
            )
        origin = read_only(np.clip(0.0, problem.lower, problem.upper))
        return cls(origin, value if np.array_equal(origin, start) else problem.value(origin), start)

    def ends(self, problem: LCP, x: FloatVector, value: FloatVector) -> VectorEnds:
        """Return bounds of the reference of each row's component, shape (n,), or (1,) if there is one component.

        `problem` is the linearization at x, and `value` is F(x).
        """
        least, most = self._ends_of_f(problem)
        limit = self._limit(problem, x, value)
        distance = row_data(problem).largest(np.abs(x - self.x))
        is_none = (most == 0.0) | np.isinf(most)
        least, most = (np.where(is_none, distance, np.minimum(end, limit)) for end in (least, most))
        return least, most

    def snap_to_start(self, problem: LCP, x: FloatVector) -> FloatVector:
        """Return x with x° in the components that x° solves, and that x has come near on its way from the start."""
        most = self._ends_of_f(problem)[1]
        left, way = (row_data(problem).largest(np.abs(point - self.x)) for point in (x, self.start))
        is_reached = (most == 0.0) & (left <= NEARLY_THERE * way)
        return np.where(is_reached, self.x, x)

    def _ends_of_f(self, problem: LCP) -> VectorEnds:
        """Return bounds of ‖r_P(x°)‖∞ of each row's component; ∞ if F is not defined at x°."""
        ends = _ends(problem, self.x, self.value, problem.residual_scale)
        with np.errstate(invalid="ignore"):
            smallest, largest = map(row_data(problem).largest, ends)
        return np.where(np.isinf(largest), np.inf, smallest), largest

    def _limit(self, problem: LCP, x: FloatVector, value: FloatVector) -> Any:
        """Return the bound of ‖r_P(x°)‖∞ for affine F with the same value and slope at x."""
        with np.errstate(all="ignore"):
            distance = np.abs(x - self.x)
            reached = distance + abs(problem.M) @ distance / problem.residual_scale
            here = np.abs(scaled_residual(problem, x, value))
            largest = row_data(problem).largest
            return ROUNDED * (largest(here) + largest(reached))


@dataclass(frozen=True, eq=False)
class NonlinearCertificate(Certificate):
    """Every measure of how far x is from solving a nonlinear problem.

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
    reference : Reference
        F at z°.

    Examples
    --------
    >>> problem = NonlinearProblem(lambda x: x**2 - 4.0, lambda x: np.diag(2.0 * x), lower=[0.0])
    >>> reference = Reference.of(problem, np.array([1.0]))
    >>> certificate = NonlinearCertificate.at(Linearization(problem, np.array([2.001])), reference)
    >>> certificate.w.round(4), float(round(certificate.relative_residual, 4))
    (array([0.004]), 0.001)
    """

    is_linearised: ClassVar[bool] = True

    nonlinear: NonlinearProblem = field(kw_only=True, repr=False)
    value: FloatVector = field(kw_only=True, repr=False)
    reference: Reference = field(kw_only=True, repr=False)

    @classmethod
    def at(cls, point: Linearization, reference: Reference) -> NonlinearCertificate:
        """Return the certificate of the x of a linearization.

        Raises
        ------
        InvalidProblem
            If F or its derivative is not finite at x.
        """
        return cls(
            point.lcp, point.x, nonlinear=point.problem, value=point.value, reference=reference
        )

    @property
    def w(self) -> FloatVector:
        """F(x), shape (n,), read-only."""
        return self.value

    @property
    def references(self) -> VectorEnds:
        """Bounds of the reference of each row's component, shape (n,), or (1,) if there is one component."""
        return self.reference.ends(self.problem, self.z, self.value)

    @cached_property
    def term_residuals(self) -> FloatVector:
        """Residual of each row relative to its terms, shape (n,).

        An unknown that adds less than a hundredth to the terms of every row (a multiplier that diverges as its
        column flattens, or a negligible unknown) requires more: each row is compared with the smallest share of
        such an unknown, or the rows must be satisfied also with the faint unknowns at x°.
        """
        at = self.problem, self.z, self.value
        own, shares = term_residuals(*at), shares_of_unknowns(*at)
        is_faint = shares < FAINT
        if not is_faint.any() or not own.any():
            return own
        data = row_data(self.problem)
        strict = term_residuals(*at, float(shares.min()) if data.labels is None else 0.0)
        without = Linearization(self.nonlinear, np.where(is_faint, self.reference.x, self.z))
        if not without.is_defined:
            return strict
        with np.errstate(invalid="ignore"):
            there = data.largest(term_residuals(without.lcp, without.x, without.value))
        errors: FloatVector = np.fmin(strict, np.fmax(own, there))
        return errors

    def relative_above(
        self, least: float, solved: BoolVector | None = None, goal: float = np.inf
    ) -> float:
        """Return the largest ‖r_P(x)‖∞ / reference, rounded upwards; without `least`, at least the term residual."""
        relative = super().relative_above(least, solved)
        return relative if least else max(relative, self.term_residual)

    @cached_property
    def is_limited_by_rounding(self) -> bool:
        """True if no row's residual exceeds four times its rounding floor, and the residual is small."""
        return self.relative_residual <= GAINED and self.is_at_rounding_level

    def _ends(self, scale: FloatVector) -> tuple[FloatVector, FloatVector]:
        return _ends(self.problem, self.z, self.value, scale)

    @cached_property
    def rounding_floor(self) -> FloatVector:
        """Estimate of the rounding error in each residual, shape (n,).

        k_i ε (|F′(x)||x| + |F(x)|)_i / d_i, k_i = entries of row i of F′ + 2, plus an estimate of the rounding
        error inside F: the largest |F(x + δ) − F(x) − F′(x) δ|_i / d_i, for δ a few fractions of 1/64 of the step
        to the projected point.
        """
        problem, x = self.problem, self.z
        scale = problem.residual_scale
        terms = np.diff(problem.matrix.csr.indptr) + 2
        with np.errstate(all="ignore"):
            size = abs(problem.matrix.array) @ np.abs(x) + np.abs(self.value)
            left = np.zeros(x.size)
            step = -scaled_residual(problem, x, self.value)
            for k in range(ASKED):
                near = x + NEARBY / (k + 1) * step
                left = np.maximum(
                    left, np.abs(self.nonlinear.value(near) - self.value - problem.M @ (near - x))
                )
            floor: FloatVector = (terms * EPSILON * size + left) / scale
        return floor


def _ends(
    problem: LCP, x: FloatVector, value: FloatVector, scale: FloatVector
) -> tuple[FloatVector, FloatVector]:
    """Return bounds of every |x_i − mid(lower_i, upper_i, x_i − value_i/scale_i)|."""
    with np.errstate(all="ignore"):
        return row_data(problem).residual_ends(x, value, np.zeros(x.size), scale)


def term_residuals(
    problem: LCP, x: FloatVector, value: FloatVector, share: FloatVector | float = 1.0
) -> FloatVector:
    """Return the residual of each row relative to its terms, the least s², shape (n,).

    If F flattens as x diverges, d → 0 or d is the rounding error of differences, and d is arbitrary close to a
    pole. So the size U = max T_i / d_i of the component, at most ‖x_P‖∞, is computed only from rows that must
    vanish and nearly do. Let v_i be the part of F_i that has the wrong sign (|F_i| if x_i is off its bounds). Row i
    is satisfied to s if

    - v_i ≤ s^(3/2) T_i, 1e-6 T_i at a tolerance of 1e-8, and v_i ≤ s share_i T_i, or
    - |x_j| ≤ s² U for all unknowns of the row, and |q_i| ≪ T_i: the row vanishes near 0, which it does not near a
      pole, or
    - the distance of x_i from a bound at which the sign of F_i is correct is at most s max(|x_i|, s U), and the
      step to the bound keeps that sign.

    Parameters
    ----------
    problem : LCP
        The linearization at x.
    x, value : array, shape (n,)
        The point, and F there.
    share : float or array, shape (n,)
        Smallest share of a faint unknown in the terms, which the row has to determine.
    """
    with np.errstate(all="ignore"):
        # to the bound at which this sign is right
        distance = np.where(value > 0.0, x - problem.lower, problem.upper - x)
        wrong = np.where(distance > 0.0, np.abs(value), 0.0)
        terms = row_data(problem).rows(x).terms
        tells = (distance > 0.0) & (wrong <= VANISHING * terms)
        largest = row_data(problem).largest
        unit = largest(np.where(tells, terms / problem.residual_scale, 0.0))
        unit = np.minimum(unit, largest(np.abs(x)))
        rows = problem.matrix.csr
        sizes = np.where(rows.data != 0.0, np.abs(x)[rows.indices], 0.0)
        unknowns = largest_in_rows(rows, sizes)  # of each row
        vanishes = np.abs(problem.q) <= VANISHING * (terms - np.abs(problem.q))
        own = np.fmax((wrong / terms) ** (4.0 / 3.0), np.fmin((wrong / (share * terms)) ** 2, 1.0))
        own = np.fmin(own, np.where(vanishes, unknowns / unit, np.inf))
        # as predicted by the diagonal entry
        stays_right = ~(np.abs(value) - problem.diagonal * distance < 0.0)
        of_bound = np.where(
            stays_right, np.fmin((distance / np.abs(x)) ** 2, distance / unit), np.inf
        )
        squares: FloatVector = np.fmin(own, of_bound)
    return np.where(wrong == 0.0, 0.0, np.where(np.isfinite(squares), squares, np.inf))


def shares_of_unknowns(problem: LCP, x: FloatVector, value: FloatVector) -> FloatVector:
    """Return the largest |m_ij x_j| / T_i over the rows that have to vanish, shape (n,).

    ∞ at a bound, and for an unknown that no such row depends on. x_i also counts as at a bound if its distance from
    the bound is less than the step |F_i| / d_i.

    Parameters
    ----------
    problem : LCP
        The linearization at x.
    x, value : array, shape (n,)
        The point, and F there.
    """
    rows = problem.matrix.csr
    with np.errstate(all="ignore"):
        distance = np.where(value > 0.0, x - problem.lower, problem.upper - x)
        is_between = (
            (problem.lower < x)
            & (x < problem.upper)
            & ~(problem.residual_scale * distance < np.abs(value))
        )
        terms = np.where(is_between, row_data(problem).rows(x).terms, np.inf)
        parts = np.abs(rows.data * x[rows.indices]) / np.repeat(terms, np.diff(rows.indptr))
    shares = np.zeros(x.size)
    np.maximum.at(shares, rows.indices, np.nan_to_num(parts))
    return np.where(is_between & (shares > 0.0), shares, np.inf)
