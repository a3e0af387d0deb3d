"""By how much a problem has no solution: a lower bound of the residual of every z, from what closes each case."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property

import numpy as np

from ..exact.rational import Rational, common_denominator, power_of_two, rounded_down
from ..kernels.floats import EPSILON, TINY
from ..problem.exactly import exact_slack, farkas_margin, integer_matrix, slack_bounds
from ..problem.lcp import LCP
from .residuals import reference_residual

LOWER, ZERO, UPPER, FIXED = "lower", "zero", "upper", "fixed"
ROOT_BITS = 160
SAFE_RANGE = (1e-290, 1e290)


def row_choices(lower: float, upper: float) -> tuple[str, ...]:
    """Return the cases of a row: z_i = lower with w_i ≥ 0, w_i = 0, z_i = upper with w_i ≤ 0.

    Examples
    --------
    >>> row_choices(0.0, np.inf), row_choices(-np.inf, np.inf), row_choices(1.0, 1.0)
    (('lower', 'zero'), ('zero',), ('fixed',))
    """
    if lower == upper:
        return (FIXED,)
    return (LOWER,) * (lower > -np.inf) + (ZERO,) + (UPPER,) * (upper < np.inf)


@dataclass(frozen=True)
class Closing:
    """What closes one case: every z in it has Σ weight_i |r_i(z)| ≥ contradiction.

    Attributes
    ----------
    contradiction : Fraction
        Positive, a lower bound.
    scaled : Fraction
        At least the sum of the weights, r the scaled residual.
    squares : Fraction
        At least the sum of their squares, r the natural residual.
    """

    contradiction: Fraction
    scaled: Fraction
    squares: Fraction


class Refutation:
    """A proof that no z solves a problem, and what it says of every z within the bounds.

    INFEASIBLE and NO_SOLUTION are said only where the margin exceeds the tolerance of the run: no z at all could then
    be SOLVED. A smaller contradiction is true of the stored doubles, and as good as none for every use of them.

    Notes
    -----
    |r_i(z)| ≤ t, r the scaled residual, leaves a row three cases: z_i − lower_i ≤ t and w_i ≥ 0, or |w_i| ≤ d_i t, or
    upper_i − z_i ≤ t and w_i ≤ 0; where the case is not chosen, w_i has a wrong sign by d_i t at most. The least t
    at which what closes a case no longer does so, the least over all cases, bounds ‖r(z)‖∞ from below.
    """

    problem: LCP

    def closings(self) -> Iterator[Closing | None]:
        """Yield what closes each case, verified; None for a case that is not closed."""
        raise NotImplementedError

    def verify(self) -> bool:
        """Return whether the proof holds, computed again from the problem's data alone."""
        return all(closing is not None for closing in self.closings())

    @cached_property
    def exact(self) -> bool:
        """Whether the stored doubles have no solution at all, by however little; what `verify` says."""
        return self.verify()

    @cached_property
    def margin(self) -> float:
        """A verified lower bound of ‖r(z)‖∞ / ‖r(z°)‖∞ for every z within the bounds; 0 where there is none."""
        return rounded_down(self._least[0])

    @cached_property
    def euclidean_margin(self) -> float:
        """A verified lower bound of ``Certificate.euclidean_residual`` for every z within the bounds."""
        return rounded_down(_root(self._least[1]))

    def measured(self, measure: str) -> float:
        """Return the margin in the measure of a run, "relative" or "euclidean"."""
        return self.margin if measure == "relative" else self.euclidean_margin

    def excludes(self, tolerance: float, measure: str = "relative", tolerance_on: str = "residual") -> bool:
        """Return whether no z within the bounds could be called SOLVED with these settings of a run.

        With ``tolerance_on="error"`` SOLVED would be the proof that there is a solution nearby, which every proof that
        there is none excludes.
        """
        if tolerance_on == "error":
            return self.exact
        return self.measured(measure) > tolerance

    @cached_property
    def _least(self) -> tuple[Fraction | None, Fraction | None]:
        """The least relative residual and the least square of the euclidean one; None for ∞."""
        reference = _reference(self.problem)
        relative: list[Fraction] = []
        squared: list[Fraction] = []
        for closing in self.closings():
            if closing is None or not reference:
                return Fraction(0), Fraction(0)
            if closing.scaled:
                relative.append(closing.contradiction / closing.scaled / reference)
            if closing.squares:
                squared.append(closing.contradiction**2 / closing.squares)
        return min(relative, default=None), min(squared, default=None)


def _reference(problem: LCP) -> Fraction:
    """Return an upper bound of ‖r(z°)‖∞; in fractions where it is out of the range of doubles."""
    bound = reference_residual(problem)
    if SAFE_RANGE[0] < bound < SAFE_RANGE[1]:
        return Fraction(bound)
    z = problem.nearest_to_zero.tolist()
    rows = zip(
        map(Fraction, z), exact_slack(problem, z), problem.residual_scale.tolist(),
        problem.lower.tolist(), problem.upper.tolist(), strict=True,
    )
    largest = Fraction(0)
    for value, w, d, low, high in rows:
        step = value - w / Fraction(d)
        step = max(step, Fraction(low)) if low > -np.inf else step
        step = min(step, Fraction(high)) if high < np.inf else step
        largest = max(largest, abs(value - step))
    return largest


def closed_exactly(problem: LCP, y: Sequence[Rational], path: Mapping[int, str]) -> Closing | None:
    """Return what the Farkas vector y closes the case with, exactly, or None where it does not.

    Parameters
    ----------
    y : sequence of numbers, shape (n,)
    path : mapping of int to str
        The choice of each row that has one in this case; the other rows have w of the signs that their bounds permit.
    """
    z_bounds = (problem.lower.tolist(), problem.upper.tolist())
    w_bounds = tuple(side.tolist() for side in slack_bounds(problem))
    for i, choice in path.items():
        if choice == ZERO:
            w_bounds[0][i] = w_bounds[1][i] = 0.0
        elif choice == LOWER:
            z_bounds[1][i], w_bounds[0][i], w_bounds[1][i] = z_bounds[0][i], 0.0, np.inf
        elif choice == UPPER:
            z_bounds[0][i], w_bounds[0][i], w_bounds[1][i] = z_bounds[1][i], -np.inf, 0.0
    margin = farkas_margin(problem, y, z_bounds, (w_bounds[0], w_bounds[1]))
    if margin is None or margin >= 0:
        return None
    at_bound = {i for i, choice in path.items() if choice in (LOWER, UPPER)}
    natural = {i: abs(Fraction(value)) for i, value in enumerate(y) if value and i not in at_bound}
    scale = problem.residual_scale
    total = sum((weight * Fraction(float(scale[i])) for i, weight in natural.items()), Fraction(0))
    squares = sum((weight * weight for weight in natural.values()), Fraction(0))
    if at_bound:
        numerators, denominator = common_denominator(y)
        matrix = integer_matrix(problem.matrix)
        unit, product = power_of_two(matrix.exponent) / denominator, matrix.transposed_product(numerators)
        for i in at_bound:
            weight = unit * max(product[i] if path[i] == LOWER else -product[i], 0)
            total += weight
            squares += weight * weight
    return Closing(-margin, total, squares)


def sum_bound(terms: np.ndarray) -> Fraction | None:
    """Return an upper bound of a sum of products ≥ 0 that were rounded once; None where it overflows."""
    try:
        total = math.fsum(terms.tolist())
    except OverflowError:
        return None
    if not math.isfinite(total):
        return None
    return Fraction(total) * (1 + Fraction(4 * EPSILON)) + terms.size * Fraction(TINY)


def _root(square: Fraction | None) -> Fraction | None:
    """Return a lower bound of the square root, right to far more digits than a double has."""
    if not square:
        return square
    shift = ROOT_BITS - (square.numerator.bit_length() - square.denominator.bit_length()) // 2
    scaled = square * Fraction(2) ** (2 * shift)
    return Fraction(math.isqrt(int(scaled))) / Fraction(2) ** shift
