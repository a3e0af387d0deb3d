"""The inequality of each row for the error of a point, with outward rounding.

Let e = z − z*. If e_i > 0, then either z*_i is the upper bound and e_i = z_i − upper_i, or w*_i ≥ 0, so that
(M e)_i ≤ w_i; and e_i ≤ z_i − lower_i in any case. With m_ii = d_i > 0 and B the rest of M,

    e_i ≤ max(z_i − upper_i, min(z_i − lower_i, (w_i + (|B||e|)_i)/d_i)),

and the mirror image holds if e_i < 0. Together |e| ≤ Φ(|e|) with an isotone Φ. Two things follow.

1. |e| ≤ y gives |e| ≤ Φ(y), for any B.
2. If ⟨M⟩v > 0 for some v > 0, every y ≥ 0 with Φ(y) ≤ y bounds |e|: Φ(y + σv) < y + σv for σ > 0, so the smallest σ
   with |e| ≤ y + σv cannot be positive. And t v is such a y once t is large enough, which is read off row by row: the
   v-certificate.

If ẑ is so close to the solution that the error bound of ẑ is small, |z − ẑ| + bound(ẑ) is tight. A bound by ⟨M⟩⁻¹|r|
ignores all signs, and if ρ(D⁻¹|B|) is close to 1 it exceeds |M⁻¹r| a thousand times. One step of the active-set
method uses the signs: ẑ = z + δ with δ to the bound on the rows that seem active, and M_FF δ_F = −(w + M δ)_F on all
other rows. ẑ may be any point: a poor solve or a wrong guess only makes the bound larger. ẑ is stored as a sum of two
float64 numbers, so that its error can be less than the spacing of float64.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ...core.certificates.criterion import row_data
from ...core.checks import BoolVector, FloatVector
from ...core.lcp import LCP
from ...core.rounding import compensated_pair, compensated_product
from ...systems.comparison_sums import comparison_product
from ...systems.free_systems import KRYLOV_GOAL, FreeSystem
from ..exact.upward import product_above, quotient_above, sum_above
from ..verdicts import HCertificate


@dataclass(frozen=True, eq=False)
class RowInequality:
    """Φ of one point, the sum `high` + `low`; every number is an upper bound of the exact value.

    Attributes
    ----------
    above, below : ndarray, shape (n,)
        z − lower and upper − z.
    over, under : ndarray, shape (n,)
        z − upper and lower − z.
    slack, negative_slack : ndarray, shape (n,)
        w and −w.
    """

    problem: LCP
    high: FloatVector
    low: FloatVector
    above: FloatVector
    below: FloatVector
    over: FloatVector
    under: FloatVector
    slack: FloatVector
    negative_slack: FloatVector

    @classmethod
    def at(cls, problem: LCP, high: FloatVector, low: FloatVector | None = None) -> RowInequality:
        """Return the inequality at the finite point high + low, each of shape (n,)."""
        if low is None:
            matrix = problem.matrix
            value, radius = compensated_product(matrix.csr, high, problem.q)
            slack, negative = sum_above(value, radius), sum_above(-value, radius)
            low = np.zeros(problem.q.size)
        else:
            slack, negative = _slack_of_pair(problem, high, low)
        return cls(
            problem,
            high,
            low,
            above=_pair_above(high, low, -problem.lower),
            below=_pair_above(-high, -low, problem.upper),
            over=_pair_above(high, low, -problem.upper),
            under=_pair_above(-high, -low, problem.lower),
            slack=slack,
            negative_slack=negative,
        )

    def inflation(self, certificate: HCertificate) -> FloatVector:
        """Return t ≥ 0, one number per component, with Φ(t v) ≤ t v.

        The result has one entry per row, shape (n,), or (1,) if there is a single component.
        """

        def side(outside: FloatVector, direct: FloatVector, w: FloatVector) -> FloatVector:
            within = np.minimum(
                quotient_above(direct, certificate.v), quotient_above(w, certificate.margin)
            )
            largest: FloatVector = np.maximum(quotient_above(outside, certificate.v), within)
            return largest

        sides = (
            side(self.over, self.above, self.slack),
            side(self.under, self.below, self.negative_slack),
        )
        largest = row_data(self.problem).largest(np.maximum(np.maximum(*sides), 0.0))
        return np.where(np.isnan(largest), np.inf, largest)

    def image(self, y: FloatVector) -> FloatVector:
        """Return Φ(y), shape (n,)."""
        minus_product = _minus_comparison(self.problem, y)

        def side(outside: FloatVector, direct: FloatVector, w: FloatVector) -> FloatVector:
            """Return Φ(y) for one sign of e; (w + |B|y)/d as y + (w − ⟨M⟩y)/d."""
            solved = sum_above(
                y, quotient_above(sum_above(w, minus_product), self.problem.diagonal)
            )
            return np.asarray(np.maximum(outside, np.minimum(direct, solved)))

        image = np.maximum(
            side(self.over, self.above, self.slack),
            side(self.under, self.below, self.negative_slack),
        )
        return np.where(np.isnan(image), np.inf, np.maximum(image, 0.0))

    def classified(self, y: FloatVector) -> tuple[BoolVector, BoolVector]:
        """Return the rows proved by |e| ≤ y to be active (z*_i at a bound), and to be inactive.

        Were z*_i > lower_i, then w*_i ≤ 0 and e_i < z_i − lower_i, so w_i ≤ d_i min(y_i, z_i − lower_i) + (|B|y)_i.
        """
        inactive = (sum_above(self.under, y) < 0.0) & (sum_above(self.over, y) < 0.0)
        is_exact = (y == 0.0) & (self.low == 0.0)
        at_bound = is_exact & (
            (self.high == self.problem.lower) | (self.high == self.problem.upper)
        )
        return self.held(y) | at_bound, inactive

    def held(self, y: FloatVector) -> BoolVector:
        """Return the rows at a bound: |e| ≤ y proves that w*_i ≠ 0, or both bounds are equal."""
        problem = self.problem
        coupling = sum_above(product_above(problem.diagonal, y), _minus_comparison(problem, y))

        def forced(direct: FloatVector, negative_slack: FloatVector) -> BoolVector:
            direct_part = product_above(problem.diagonal, np.maximum(np.minimum(y, direct), 0.0))
            return sum_above(negative_slack, sum_above(direct_part, coupling)) < 0.0

        is_forced = forced(self.above, self.negative_slack) | forced(self.below, self.slack)
        held: BoolVector = is_forced | (problem.lower == problem.upper)
        return held


def distance_above(high: FloatVector, low: FloatVector, z: FloatVector) -> FloatVector:
    """Return an upper bound of |z − (high + low)|, shape (n,)."""
    forward = sum_above(sum_above(z, -high), -low)
    return np.maximum(forward, sum_above(sum_above(-z, high), low))


def _minus_comparison(problem: LCP, y: FloatVector) -> FloatVector:
    """Return an upper bound of −⟨M⟩y."""
    value, radius = comparison_product(problem.matrix.csr, y)
    return sum_above(-value, radius)


def _pair_above(high: FloatVector, low: FloatVector, bound: FloatVector) -> FloatVector:
    return sum_above(sum_above(high, bound), low)


def _slack_of_pair(
    problem: LCP, high: FloatVector, low: FloatVector
) -> tuple[FloatVector, FloatVector]:
    """Return upper bounds of w and −w at high + low; w is small relative to its terms."""
    matrix = problem.matrix
    first, rest, radius = compensated_pair(matrix.csr, high, problem.q)
    second, second_radius = compensated_product(matrix.csr, low)
    total_radius = sum_above(radius, second_radius)

    def end(sign: float) -> FloatVector:
        return sum_above(
            sum_above(sum_above(sign * first, sign * second), sign * rest), total_radius
        )

    return end(1.0), end(-1.0)


class NearPoint(NamedTuple):
    """A point ẑ = high + low near the solution, and a bound y of its own error; each of shape (n,)."""

    high: FloatVector
    low: FloatVector
    y: FloatVector

    def bound(self, z: FloatVector) -> FloatVector:
        """Return |z − ẑ| + y ≥ |z − z*|; ∞ if z is not finite."""
        bound = sum_above(distance_above(self.high, self.low, z), self.y)
        return np.where(np.isnan(bound), np.inf, bound)


class ActiveSetSteps:
    """Steps of the active-set method on one problem; a factorization serves as long as the free set stays.

    Attributes
    ----------
    system : FreeSystem
        The system of the last step; initially the system of another problem with the same M, if passed.
    """

    def __init__(
        self,
        problem: LCP,
        scale: FloatVector,
        *,
        goal: float = KRYLOV_GOAL,
        system: FreeSystem | None = None,
    ) -> None:
        self.problem, self.scale, self.goal = problem, scale, goal
        self.system = system or FreeSystem(problem.matrix, np.zeros(problem.n, np.bool_))

    def next_point(self, at: RowInequality) -> RowInequality | None:
        """Return the inequality at the next point, or None if the step is not finite."""
        problem = self.problem
        w, on_lower, free = self._sides(at)
        bound = np.where(on_lower, problem.lower, problem.upper)
        delta = np.where(free, 0.0, (bound - at.high) - at.low)
        if not np.array_equal(free, self.system.free):
            self.system = FreeSystem(problem.matrix, free)
        solution = self.system.solve(-(w + problem.csr @ delta), goal=self.goal)
        if solution is None:
            return None
        delta += solution
        if not np.isfinite(delta).all():
            return None
        high = at.high + delta
        part = high - at.high
        low = (at.high - (high - part)) + (delta - part) + at.low
        return RowInequality.at(problem, np.where(free, high, bound), np.where(free, low, 0.0))

    def is_settled(self, at: RowInequality) -> bool:
        """Return whether the point of the last step has the free rows of this step."""
        return np.array_equal(self._sides(at)[2], self.system.free)

    def _sides(self, at: RowInequality) -> tuple[FloatVector, BoolVector, BoolVector]:
        """Return w, the rows at their lower bounds by the sign of w, and the free rows."""
        w = 0.5 * (at.slack - at.negative_slack)
        step = self.scale * w  # next to a large z its digits would be lost
        on_lower = (at.above <= step) | (self.problem.lower == self.problem.upper)
        return w, on_lower, ~(on_lower | (at.below <= -step))
