"""How wrong an x is for a nonlinear problem: the residuals of its linearization at x, with F(x) for w.

The scale d of the residual r_i(x) = x_i − mid(lower_i, upper_i, x_i − F_i(x)/d_i) comes from F′(x) as it does from M
(the diagonal, or where that is negligible the row's largest entry), and so does that of the reference r(x°), F(x°) for
w, x° the point of the bounds nearest to 0: both change alike with the units of F and of x. On an affine F these are
the residuals of the LCP. A row with an infinite slope (√x at 0) counts with d = 1. The components of the problem are
those of F′(x), and each is judged by its own reference.

No affine F with the derivative F′(x) has a larger ‖r_P(x°)‖∞ than

    ‖r_P(x)‖∞ + max_i (|x − x°|_i + (|F′(x)| |x − x°|)_i / d_i),  i in P,

and so none is taken for the reference. If F(x°) is undefined or solves the component, it is ‖x − x°‖∞: x° is an
answer, but not of a run that does not go there.

A reference in the unit of x says little where F flattens as x runs away. So every row is judged in its own terms as
well, T_i = |q_i| + Σ_j |m_ij x_j| with M = F′(x), q = F(x) − F′(x) x (:func:`term_residuals`); the relative residual is
the largest of all.

F(x) is taken as F returns it. What rounding does in there is estimated where progress stops: F is asked at a few points
so near x that its curvature does not show, and what is left of F(x + δ) − F(x) − F′(x) δ is rounding.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import ClassVar

import numpy as np

from ...core.certificates.criterion import (
    VectorEnds,
    largest_of_components,
    row_data,
    spread_to_rows,
)
from ...core.certificates.residuals import GAINED, Certificate
from ...core.certificates.row_residuals import (
    largest_ratio,
    magnitude,
    scaled_residual,
)
from ...core.checks import FloatVector, read_only
from ...core.errors import InvalidProblem
from ...core.kernels.floats import EPSILON
from ...core.lcp import LCP
from ...core.matrix.matrix import largest_in_rows
from ...core.matrix.structure import connected_components
from .data import Linearization, NonlinearProblem

NEARBY = (
    2.0**-6
)  # of the step to the projected point: a derivative that is wrong by a half explains no residual
ASKED = 4  # points
NEARLY_THERE = 1e-4  # of the way from the start to x°
VANISHING = 1e-3  # of its terms: more is no row that vanishes
FAINT = 1e-2  # of the terms of every row: what an unknown adds, where rows that are right tell little of it
ROUNDED = 1.0 + 2.0**-40  # of sums of nonnegative terms: below it an affine F may not come


@dataclass(frozen=True)
class Reference:
    """What residuals are compared with: x°, the point of the bounds nearest to 0, and F there.

    Attributes
    ----------
    x, value : ndarray, shape (n,)
        x° and F(x°), which need not be defined.
    start : ndarray, shape (n,)
        Where the run begins, within the bounds.
    """

    x: FloatVector
    value: FloatVector
    start: FloatVector

    @classmethod
    def of(cls, problem: NonlinearProblem, start: FloatVector) -> Reference:
        """Return that of a problem.

        Raises
        ------
        InvalidProblem
            Where F is not defined at the start.
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
        """Return bounds of each component's reference, where `problem` is the linearization at x and `value` F(x)."""
        least, most = self._ends_of_f(problem)
        limit = self._limit(problem, x, value)
        distance = largest_of_components(problem, np.abs(x - self.x))
        is_none = (most == 0.0) | np.isinf(most)
        least, most = (np.where(is_none, distance, np.minimum(end, limit)) for end in (least, most))
        return least, most

    def kinds(self, problem: LCP, x: FloatVector, value: FloatVector) -> list[str]:
        """Return what each component's reference is, in words."""
        most, where = self._ends_of_f(problem)[1], "the point of the bounds nearest to 0"
        limited = most > self._limit(problem, x, value)
        return [
            f"the distance from {where}"
            if size in (0.0, np.inf)
            else f"what an affine F with this derivative has at most at {where}"
            if is_limited
            else f"F at {where}"
            for size, is_limited in zip(most.tolist(), limited.tolist(), strict=True)
        ]

    def snap_to_start(self, problem: LCP, x: FloatVector) -> FloatVector:
        """Return x with x° in the components that x° solves, and that x has come near on its way from the start."""
        most = self._ends_of_f(problem)[1]
        left, way = (
            largest_of_components(problem, np.abs(point - self.x)) for point in (x, self.start)
        )
        is_reached = (most == 0.0) & (left <= NEARLY_THERE * way)
        return np.where(spread_to_rows(problem, is_reached), self.x, x)

    def _ends_of_f(self, problem: LCP) -> VectorEnds:
        """Return bounds of ‖r_P(x°)‖∞ of each component; ∞ where F is not defined there."""
        ends = _ends(problem, self.x, self.value, problem.residual_scale)
        smallest, largest = (largest_of_components(problem, end) for end in ends)
        return np.where(np.isinf(largest), np.inf, smallest), largest

    def _limit(self, problem: LCP, x: FloatVector, value: FloatVector) -> FloatVector:
        """Return what ‖r_P(x°)‖∞ is at most for an affine F that has the value and the derivative of this one at x."""
        with np.errstate(all="ignore"):
            distance = np.abs(x - self.x)
            reached = distance + abs(problem.M) @ distance / problem.residual_scale
            here = np.abs(scaled_residual(problem, x, value))
            return ROUNDED * (
                largest_of_components(problem, here) + largest_of_components(problem, reached)
            )


@dataclass(frozen=True, eq=False)
class NonlinearCertificate(Certificate):
    """Every measure of how far x is from solving a nonlinear problem.

    Attributes
    ----------
    problem : LCP
        The linearization at x; ``derivative`` and ``explain`` look at it.
    z : ndarray, shape (n,)
        The point x.
    nonlinear : NonlinearProblem
        The problem.
    value : ndarray, shape (n,)
        F(x), which is w.
    reference : Reference
        F at z°.
    relative_to : str
        What the relative residual of the worst component is relative to: that, the limit, or the distance above.

    Examples
    --------
    >>> problem = NonlinearProblem(lambda x: x**2 - 4.0, lambda x: np.diag(2.0 * x), lower=[0.0])
    >>> reference = Reference.of(problem, np.array([1.0]))
    >>> certificate = NonlinearCertificate.at(Linearization(problem, np.array([2.001])), reference)
    >>> certificate.w.round(4), float(round(certificate.relative_residual, 4)), certificate.relative_to
    (array([0.004]), 0.001, 'F at the point of the bounds nearest to 0')
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
            Where F or its derivative is not finite there.
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
        """Bounds of the reference of each component, shape (components,) each."""
        return self.reference.ends(self.problem, self.z, self.value)

    @cached_property
    def term_residuals(self) -> FloatVector:
        """How wrong each row is in its own terms, shape (n,); beside an unknown that they hardly show, in what it adds.

        A multiplier that runs away as its column flattens is such an unknown, and so is one that is negligible: without
        that one the rows are right as well, F taken there.
        """
        at = self.problem, self.z, self.value
        own, shares = term_residuals(*at), shares_of_unknowns(*at)
        is_faint = shares < FAINT
        if not is_faint.any() or not own.any():
            return own
        strict = term_residuals(
            *at, spread_to_rows(self.problem, -largest_of_components(self.problem, -shares))
        )
        without = Linearization(self.nonlinear, np.where(is_faint, self.reference.x, self.z))
        if not without.is_defined:
            return strict
        there = largest_of_components(
            self.problem, term_residuals(without.lcp, without.x, without.value)
        )
        errors: FloatVector = np.fmin(strict, np.fmax(own, spread_to_rows(self.problem, there)))
        return errors

    @cached_property
    def relative_residual(self) -> float:
        """The largest ‖r_P(x)‖∞ beside the reference of a component, rounded upwards, or term residual of a row."""
        return max(largest_ratio(*self.residuals_of_components), self.term_residual)

    @cached_property
    def is_limited_by_rounding(self) -> bool:
        """True if no row's residual exceeds four times its rounding floor, and the residual is small."""
        return self.relative_residual <= GAINED and self.is_at_rounding_level

    @property
    def relative_to(self) -> str:
        """What the relative residual of the worst component is relative to, in words."""
        several = connected_components(self.problem.matrix)
        kinds = self.reference.kinds(self.problem, self.z, self.value)
        return kinds[
            0 if several is None or self.worst_index < 0 else int(several.labels[self.worst_index])
        ]

    def _sharp_ends(self) -> FloatVector:
        return self._scaled_ends[1]  # of the numbers that F returns, nothing is summed here

    def _ends(self, scale: FloatVector) -> tuple[FloatVector, FloatVector]:
        return _ends(self.problem, self.z, self.value, scale)

    @cached_property
    def rounding_floor(self) -> FloatVector:
        """What rounding alone can make of each residual, estimated, shape (n,).

        k_i ε (|F′(x)||x| + |F(x)|)_i / d_i, k_i = entries of row i of F′ + 2, and what F adds to that on its way: the
        largest |F(x + δ) − F(x) − F′(x) δ|_i / d_i, δ a few fractions of 1/64 of the step that the residual asks for.
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

    def __str__(self) -> str:
        return (
            f"{super().__str__()}\nrelative to         {self.relative_to}"
            f"\nterm residual      {self.term_residual:.3e}"
        )


def _ends(
    problem: LCP, x: FloatVector, value: FloatVector, scale: FloatVector
) -> tuple[FloatVector, FloatVector]:
    """Return bounds of every |x_i − mid(lower_i, upper_i, x_i − value_i/scale_i)|."""
    with np.errstate(all="ignore"):
        return row_data(problem).residual_ends(x, value, np.zeros(x.size), scale)


def term_residuals(
    problem: LCP, x: FloatVector, value: FloatVector, share: FloatVector | float = 1.0
) -> FloatVector:
    """Return how wrong each row is in its own terms, shape (n,): the least s² to which it is right, 0 where it is.

    If F flattens as x runs away, d → 0 or is the noise of differences, and beside a pole d is anything. So only rows
    that have to vanish, and nearly do, tell the size U = max T_i / d_i of the component, no larger than ‖x_P‖∞. With
    v_i the part of F_i that has the wrong sign (|F_i| where x_i is off its bounds), row i is right to s if

    - v_i ≤ s^(3/2) T_i, 1e-6 T_i at a tolerance of 1e-8, and v_i ≤ s share_i T_i, or
    - |x_j| ≤ s² U for all unknowns of the row, and |q_i| ≪ T_i: it vanishes near 0, as it does not beside a pole, or
    - x_i is no farther than s max(|x_i|, s U) from a bound where its sign is right, and the step there keeps that sign.

    Parameters
    ----------
    problem : LCP
        The linearization at x.
    x, value : array, shape (n,)
        The point, and F there.
    share : float or array, shape (n,)
        What an unknown that must be told adds to the terms.
    """
    with np.errstate(all="ignore"):
        distance = np.where(
            value > 0.0, x - problem.lower, problem.upper - x
        )  # to where this sign is right
        wrong = np.where(distance > 0.0, np.abs(value), 0.0)
        terms = magnitude(problem, x)
        tells = (distance > 0.0) & (wrong <= VANISHING * terms)
        unit = largest_of_components(problem, np.where(tells, terms / problem.residual_scale, 0.0))
        unit = spread_to_rows(problem, np.minimum(unit, largest_of_components(problem, np.abs(x))))
        rows = problem.matrix.csr
        unknowns = largest_in_rows(
            rows, np.where(rows.data != 0.0, np.abs(x)[rows.indices], 0.0)
        )  # of each row
        vanishes = np.abs(problem.q) <= VANISHING * (terms - np.abs(problem.q))
        own = np.fmax((wrong / terms) ** (4.0 / 3.0), np.fmin((wrong / (share * terms)) ** 2, 1.0))
        own = np.fmin(own, np.where(vanishes, unknowns / unit, np.inf))
        stays_right = ~(
            np.abs(value) - problem.diagonal * distance < 0.0
        )  # as far as the diagonal entry tells
        of_bound = np.where(
            stays_right, np.fmin((distance / np.abs(x)) ** 2, distance / unit), np.inf
        )
        squares: FloatVector = np.fmin(own, of_bound)
    return np.where(wrong == 0.0, 0.0, np.where(np.isfinite(squares), squares, np.inf))


def shares_of_unknowns(problem: LCP, x: FloatVector, value: FloatVector) -> FloatVector:
    """Return the largest |m_ij x_j| / T_i over the rows that have to vanish, shape (n,).

    ∞ at a bound, and for an unknown that no such row depends on.

    At a bound is x_i also where it is nearer to it than F_i asks for.

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
        terms = np.where(is_between, magnitude(problem, x), np.inf)
        parts = np.abs(rows.data * x[rows.indices]) / np.repeat(terms, np.diff(rows.indptr))
    shares = np.zeros(x.size)
    np.maximum.at(shares, rows.indices, np.nan_to_num(parts))
    return np.where(is_between & (shares > 0.0), shares, np.inf)
