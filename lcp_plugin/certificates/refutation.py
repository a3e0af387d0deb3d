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
from ..matrix.parts import IntVector
from ..problem.exactly import farkas_margin, integer_matrix, slack_bounds
from ..problem.lcp import LCP
from .references import exact_references, rounding_of_data

LOWER, ZERO, UPPER, FIXED = "lower", "zero", "upper", "fixed"
ROOT_BITS = 160


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
    relative : Fraction
        At least Σ weight_i ‖r_P(z°)‖∞, r the scaled residual and P the part of row i.
    absolute : Fraction
        At least Σ weight_i.
    squares : Fraction
        At least the sum of their squares, r the natural residual.
    """

    contradiction: Fraction
    relative: Fraction
    absolute: Fraction
    squares: Fraction


class Refutation:
    """A proof that no z solves a problem, and what it says of every z within the bounds.

    INFEASIBLE and NO_SOLUTION are said only where the margin exceeds the tolerance of the run: no z at all could then
    be SOLVED. A smaller contradiction is true of the stored doubles, and as good as none for every use of them. So is
    one below the rounding of the largest number in q: nothing in a row tells rounding from data, but beside that it is
    none.

    Notes
    -----
    |r_i(z)| ≤ t_i, r the scaled residual, leaves a row three cases: z_i − lower_i ≤ t_i and w_i ≥ 0, or
    |w_i| ≤ d_i t_i, or upper_i − z_i ≤ t_i and w_i ≤ 0; where the case is not chosen, w_i has a wrong sign by d_i t_i
    at most. With t_i = t ‖r_P(z°)‖∞, P the part of row i, the least t at which what closes a case no longer does so,
    the least over all cases, bounds the relative residual from below.
    """

    problem: LCP

    def closings(self) -> Iterator[Closing | None]:
        """Yield what closes each case, verified; None for a case that is not closed."""
        raise NotImplementedError

    def in_units(self, problem: LCP, exponents: IntVector) -> Refutation:
        """Return what this proves of the problem in other units of z: q and bounds of row i times 2^exponents_i.

        Parameters
        ----------
        problem : LCP
            In these units.
        exponents : array of int, shape (n,)
        """
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
        """A verified lower bound of the relative residual of every z within the bounds; 0 where there is none."""
        return rounded_down(self._least[0])

    @cached_property
    def euclidean_margin(self) -> float:
        """A verified lower bound of ``Certificate.euclidean_residual`` for every z within the bounds."""
        return rounded_down(_root(self._least[2]))

    @cached_property
    def absolute_margin(self) -> float:
        """A verified lower bound of ‖r(z)‖∞, in the unit of z, for every z within the bounds."""
        return rounded_down(self._least[1])

    @property
    def is_rounding(self) -> bool:
        """Whether what contradicts is no more than rounding of the largest number in q: of max_i |q_i|/d_i."""
        return self.absolute_margin <= rounding_of_data(self.problem)

    def measured(self, measure: str) -> float:
        """Return the margin in the measure of a run, "relative" or "euclidean"."""
        return self.margin if measure == "relative" else self.euclidean_margin

    def excludes(
        self, tolerance: float, measure: str = "relative", tolerance_on: str = "residual",
        absolute_tolerance: float = 0.0,
    ) -> bool:
        """Return whether no z within the bounds could be called SOLVED with these settings of a run.

        With ``tolerance_on="error"`` SOLVED would be the proof that there is a solution nearby, which every proof that
        there is none excludes.
        """
        if tolerance_on == "error":
            return self.exact
        if self.is_rounding or not self.measured(measure) > tolerance:
            return False
        # Rows may use up one tolerance in one part, and the other in another.
        return not absolute_tolerance or (
            tolerance / self.measured(measure) + absolute_tolerance / self.absolute_margin < 1.0 - EPSILON
        )

    @cached_property
    def _least(self) -> tuple[Fraction | None, Fraction | None, Fraction | None]:
        """The least relative residual, the least one, and the least square of the euclidean one; None for ∞."""
        relative: list[Fraction] = []
        absolute: list[Fraction] = []
        squared: list[Fraction] = []
        for closing in self.closings():
            if closing is None:
                return Fraction(0), Fraction(0), Fraction(0)
            if closing.relative:
                relative.append(closing.contradiction / closing.relative)
            if closing.absolute:
                absolute.append(closing.contradiction / closing.absolute)
            if closing.squares:
                squared.append(closing.contradiction**2 / closing.squares)
        return min(relative, default=None), min(absolute, default=None), min(squared, default=None)


def closed_exactly(
    problem: LCP, y: Sequence[Rational], path: Mapping[int, str], radius: float = math.inf
) -> Closing | None:
    """Return what the Farkas vector y closes the case with, exactly, or None where it does not.

    Parameters
    ----------
    y : sequence of numbers, shape (n,)
    path : mapping of int to str
        The choice of each row that has one in this case; the other rows have w of the signs that their bounds permit.
    radius : float
        What bounds |z_i| where nothing else does.
    """
    z_bounds = bounds_within(problem, radius)
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
    scale, references = problem.residual_scale, exact_references(problem)
    scaled = {i: weight * Fraction(float(scale[i])) for i, weight in natural.items()}
    relative = sum((weight * references[i] for i, weight in scaled.items()), Fraction(0))
    absolute = sum(scaled.values(), Fraction(0))
    squares = sum((weight * weight for weight in natural.values()), Fraction(0))
    if at_bound:
        numerators, denominator = common_denominator(y)
        matrix = integer_matrix(problem.matrix)
        unit, product = power_of_two(matrix.exponent) / denominator, matrix.transposed_product(numerators)
        for i in at_bound:
            weight = unit * max(product[i] if path[i] == LOWER else -product[i], 0)
            relative += weight * references[i]
            absolute += weight
            squares += weight * weight
    return Closing(-margin, relative, absolute, squares)


def bounds_within(problem: LCP, radius: float) -> tuple[list[float], list[float]]:
    """Return the bounds of z, finite ones where there are none."""
    lower, upper = problem.lower, problem.upper
    return (np.where(lower == -np.inf, -radius, lower).tolist(), np.where(upper == np.inf, radius, upper).tolist())


def in_other_units(y: Sequence[Fraction], exponents: IntVector) -> list[Fraction]:
    """Return the Farkas vector of the problem whose q and bounds are those of row i times 2^exponents_i: D⁻¹ y."""
    return [value / Fraction(2) ** k for value, k in zip(y, exponents.tolist(), strict=True)]


def sum_bound(terms: np.ndarray) -> Fraction | None:
    """Return an upper bound of a sum of products ≥ 0 that were rounded at most twice; None where it overflows."""
    try:
        total = math.fsum(terms.tolist())
    except OverflowError:
        return None
    if not math.isfinite(total):
        return None
    return Fraction(total) * (1 + Fraction(4 * EPSILON)) + 2 * terms.size * Fraction(TINY)


def _root(square: Fraction | None) -> Fraction | None:
    """Return a lower bound of the square root, right to far more digits than a double has."""
    if not square:
        return square
    shift = ROOT_BITS - (square.numerator.bit_length() - square.denominator.bit_length()) // 2
    scaled = square * Fraction(2) ** (2 * shift)
    return Fraction(math.isqrt(int(scaled))) / Fraction(2) ** shift
