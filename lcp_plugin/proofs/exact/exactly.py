"""Slack and complementarity without rounding on the stored doubles."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction

import numpy as np
from numpy.typing import ArrayLike

from ...core.checks import FloatVector
from ...core.lcp import LCP
from ...core.matrix.matrix import Matrix, fact
from .rational import IntegerMatrix, Rational, common_denominator, exact_vector, power_of_two


@fact
def integer_matrix(matrix: Matrix) -> IntegerMatrix:
    """Return M in integers."""
    return IntegerMatrix.of(matrix.csr)


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
    matrix = integer_matrix(problem.matrix)
    unit = power_of_two(matrix.exponent) / denominator
    sums = (sum(entry * numerators[j] for j, entry in matrix.row(i)) for i in range(problem.n))
    return [Fraction(q) + unit * total for q, total in zip(problem.q.tolist(), sums, strict=True)]


def exact_residuals(problem: LCP, z: FloatVector, scale: FloatVector | None = None) -> list[Fraction]:
    """Return |z − mid(lower, upper, z − w/d)| of every row without any rounding, for a finite z; d is the scale."""
    scale = problem.residual_scale if scale is None else scale
    rows = zip(
        map(Fraction, z.tolist()), exact_slack(problem, z), scale.tolist(), problem.lower.tolist(),
        problem.upper.tolist(), strict=True,
    )
    # The comparison of a fraction with ±∞ is exact as well.
    return [abs(x - Fraction(min(max(x - w / Fraction(d), lower), upper))) for x, w, d, lower, upper in rows]


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
