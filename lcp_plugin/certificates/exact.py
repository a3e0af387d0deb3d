"""Exact arithmetic on the stored doubles: slack, complementarity, and what a Farkas vector proves."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..errors import InvalidProblem
from ..problem import LCP, FloatVector

Rational = int | float | Fraction
Bounds = tuple[Sequence[float], Sequence[float]]


def integers(values: FloatVector) -> tuple[list[int], int]:
    """Return integers and one exponent e with values_i = integer_i · 2^e, exactly; the values are finite.

    Examples
    --------
    >>> integers(np.array([0.75, -2.0, 0.0]))
    ([3, -8, 0], -2)
    """
    mantissa, exponent = np.frexp(values)
    whole = (mantissa * 2.0**53).astype(np.int64)
    lowest_bit = np.frexp((whole & -whole).astype(np.float64))[1] - 1
    nonzero = whole != 0
    if not nonzero.any():
        return [0] * values.size, 0
    # Trailing zeros go to the exponent, which keeps the integers short.
    whole = np.where(nonzero, whole >> np.where(nonzero, lowest_bit, 0), 0)
    exponent = exponent - 53 + lowest_bit
    smallest = int(exponent[nonzero].min())
    shifts = np.where(nonzero, exponent - smallest, 0)
    return [m << s for m, s in zip(whole.tolist(), shifts.tolist(), strict=True)], smallest


def power_of_two(exponent: int) -> Fraction:
    """Return 2^exponent, exactly."""
    return Fraction(1 << exponent) if exponent >= 0 else Fraction(1, 1 << -exponent)


@dataclass(frozen=True)
class IntegerMatrix:
    """M as integers times 2^exponent, in rows."""

    starts: list[int]
    columns: list[int]
    entries: list[int]
    exponent: int

    def row(self, i: int) -> list[tuple[int, int]]:
        """Return the (column, integer) pairs of row i."""
        span = slice(self.starts[i], self.starts[i + 1])
        return list(zip(self.columns[span], self.entries[span], strict=True))

    def transposed_product(self, y: Sequence[int]) -> list[int]:
        """Return Mᵀy / 2^exponent for integers y, shape (n,)."""
        product = [0] * len(y)
        for i, factor in enumerate(y):
            if factor:
                for k in range(self.starts[i], self.starts[i + 1]):
                    product[self.columns[k]] += self.entries[k] * factor
        return product


def integer_matrix(problem: LCP) -> IntegerMatrix:
    """Return M of the problem in integers, made once a matrix."""

    def compute() -> IntegerMatrix:
        csr = problem.csr
        entries, exponent = integers(np.asarray(csr.data))
        return IntegerMatrix(csr.indptr.tolist(), csr.indices.tolist(), entries, exponent)

    return problem.shared("integer_matrix", compute)


def common_denominator(values: Sequence[Rational]) -> tuple[list[int], int]:
    """Return integers and one positive denominator with values_i = integer_i / denominator."""
    fractions = [Fraction(value) for value in values]
    denominator = math.lcm(*(value.denominator for value in fractions))
    return [value.numerator * (denominator // value.denominator) for value in fractions], denominator


def exact_vector(z: ArrayLike | Sequence[Rational], n: int) -> list[Fraction]:
    """Return the vector in fractions, shape (n,).

    Raises
    ------
    InvalidProblem
        Where it has another length, or a number in it is not finite.
    """
    values: list[Any] = list(z)  # type: ignore[arg-type]
    if len(values) != n:
        raise InvalidProblem(f"z must have length {n}, got length {len(values)}; give one number a row")
    try:
        return [Fraction(value) for value in values]
    except (TypeError, ValueError, OverflowError) as error:
        raise InvalidProblem(f"z must consist of finite real numbers, got one that is none: {error}") from error


def exact_slack(problem: LCP, z: ArrayLike | Sequence[Rational]) -> list[Fraction]:
    """Return w = M z + q without rounding, shape (n,).

    Raises
    ------
    InvalidProblem
        Where z is no vector of n finite numbers.

    Examples
    --------
    >>> exact_slack(LCP([[3, 0], [0, 1]], [-1, 0]), [Fraction(1, 3), 0])
    [Fraction(0, 1), Fraction(0, 1)]
    """
    numerators, denominator = common_denominator(exact_vector(z, problem.n))
    matrix = integer_matrix(problem)
    unit = power_of_two(matrix.exponent) / denominator
    sums = (sum(entry * numerators[j] for j, entry in matrix.row(i)) for i in range(problem.n))
    return [Fraction(q) + unit * total for q, total in zip(problem.q.tolist(), sums, strict=True)]


def is_exact_solution(problem: LCP, z: ArrayLike | Sequence[Rational]) -> bool:
    """Return whether z solves the problem without any rounding.

    Raises
    ------
    InvalidProblem
        Where z is no vector of n finite numbers.

    Examples
    --------
    >>> is_exact_solution(LCP([[3]], [-1]), [Fraction(1, 3)]), is_exact_solution(LCP([[3]], [-1]), [1 / 3])
    (True, False)
    """
    exact = exact_vector(z, problem.n)
    rows = zip(exact, exact_slack(problem, exact), problem.lower.tolist(), problem.upper.tolist(), strict=True)
    return all(_is_complementary(*row) for row in rows)


def _is_complementary(z: Fraction, w: Fraction, lower: float, upper: float) -> bool:
    if not lower <= z <= upper:
        return False
    return (w >= 0 or z == upper) and (w <= 0 or z == lower)


def slack_bounds(problem: LCP) -> tuple[FloatVector, FloatVector]:
    """Return the signs of w that the bounds of z permit, as bounds of w, each of shape (n,).

    0 ≤ w_i where z_i has no upper bound, w_i ≤ 0 where it has no lower bound; a box permits both signs.
    """
    return (
        np.where(problem.upper == np.inf, 0.0, -np.inf),
        np.where(problem.lower == -np.inf, 0.0, np.inf),
    )


def farkas_margin(problem: LCP, y: Sequence[Rational], z_bounds: Bounds, w_bounds: Bounds) -> Fraction | None:
    """Return sup (Mᵀy)ᵀz − yᵀw + qᵀy over all z and w within their bounds, exactly; None for ∞.

    Every z with w = M z + q gives 0, so a negative margin proves that none lies within the bounds.

    Parameters
    ----------
    y : sequence of numbers, shape (n,)
    z_bounds, w_bounds : pair of sequences, shape (n,)
        Lower and upper bounds, ±∞ included.
    """
    numerators, denominator = common_denominator(y)
    matrix = integer_matrix(problem)
    of_z = _support(matrix.transposed_product(numerators), *z_bounds)
    of_w = _support([-value for value in numerators], *w_bounds)
    if of_z is None or of_w is None:
        return None
    q, exponent = integers(problem.q)
    of_q = power_of_two(exponent) * sum(a * b for a, b in zip(numerators, q, strict=True))
    return (power_of_two(matrix.exponent) * of_z + of_w + of_q) / denominator


def _support(direction: Sequence[int], lower: Sequence[float], upper: Sequence[float]) -> Fraction | None:
    """Return the largest directionᵀx over lower ≤ x ≤ upper; None for ∞."""
    total = Fraction(0)
    for d, low, high in zip(direction, lower, upper, strict=True):
        if d:
            bound = high if d > 0 else low
            if math.isinf(bound):
                return None
            if bound:
                total += d * Fraction(bound)
    return total
