"""Exact arithmetic on what is stored in double precision.

Integers with an exponent, fractions, products of sparse rows, slack and complementarity.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import pairwise
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike

from ...core.checks import FloatVector
from ...core.errors import InvalidProblem
from ...core.lcp import LCP
from ...core.matrix.matrix import Matrix, fact

Rational = int | float | Fraction
Row = dict[int, Fraction]
Vector = list[Fraction]

ZERO = Fraction(0)


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
    """M, or some of its rows, as integers times 2^exponent; the span of a row's entries by its number."""

    spans: Sequence[tuple[int, int]] | Mapping[int, tuple[int, int]]
    columns: list[int]
    entries: list[int]
    exponent: int

    def row(self, i: int) -> list[tuple[int, int]]:
        """Return the (column, integer) pairs of row i."""
        span = slice(*self.spans[i])
        return list(zip(self.columns[span], self.entries[span], strict=True))

    @classmethod
    def of(cls, csr: Any, rows: Sequence[int] | None = None) -> IntegerMatrix:
        """Return a CSR array of finite doubles as integers, or only some of its rows."""
        kept = csr if rows is None else csr[rows]
        ends = list(pairwise(kept.indptr.tolist()))
        entries, exponent = integers(np.asarray(kept.data))
        spans = ends if rows is None else dict(zip(rows, ends, strict=True))
        return cls(spans, kept.indices.tolist(), entries, exponent)

    def combination(self, y: Mapping[int, int]) -> dict[int, int]:
        """Return the entries of Mᵀy / 2^exponent that are not 0, of integers y_i by row."""
        product: dict[int, int] = {}
        for i, factor in y.items():
            for k in range(*self.spans[i]):
                column = self.columns[k]
                product[column] = product.get(column, 0) + self.entries[k] * factor
        return {column: value for column, value in product.items() if value}


def common_denominator(values: Sequence[Rational]) -> tuple[list[int], int]:
    """Return integers and one positive denominator with values_i = integer_i / denominator."""
    fractions = [value if type(value) is Fraction else Fraction(value) for value in values]
    denominator = math.lcm(*(value.denominator for value in fractions))
    return [
        value.numerator * (denominator // value.denominator) for value in fractions
    ], denominator


def like(values: FloatVector, z: Any) -> Any:
    """Return floats unchanged, or as Fractions if z has Fractions."""
    return (
        np.array([Fraction(value) for value in values.tolist()], dtype=object)
        if z.dtype == object
        else values
    )


def exact_vector(z: ArrayLike | Sequence[Rational], n: int) -> list[Fraction]:
    """Return the vector in fractions, shape (n,).

    Raises
    ------
    InvalidProblem
        If it has another length, or a number in it is not finite.
    """
    values: list[Any] = list(z)  # type: ignore[arg-type]
    if len(values) != n:
        raise InvalidProblem(
            f"z must have length {n}, got length {len(values)}; give one number a row"
        )
    try:
        return [Fraction(value) for value in values]
    except (TypeError, ValueError, OverflowError) as error:
        raise InvalidProblem(
            f"z must consist of finite real numbers, got a value that is not finite: {error}"
        ) from error


def rounded_down(value: Fraction | None) -> float:
    """Return a double not above a value ≥ 0; ∞ for None."""
    return math.inf if value is None else _ends(value)[0]


def enclosures(values: Sequence[Fraction]) -> tuple[FloatVector, FloatVector]:
    """Return the nearest float64 numbers not above and not below the values, ∞ beyond the range.

    Examples
    --------
    >>> low, high = enclosures([Fraction(1, 2), Fraction(1, 3)])
    >>> (high - low).tolist()
    [0.0, 5.551115123125783e-17]
    """
    ends = [_ends(value) for value in values]
    low, high = (np.array([end[k] for end in ends], dtype=np.float64) for k in (0, 1))
    return low, high


def _ends(value: Fraction) -> tuple[float, float]:
    try:
        near = float(value)
    except OverflowError:
        return (sys.float_info.max, math.inf) if value > 0 else (-math.inf, -sys.float_info.max)
    exact = Fraction(near)
    return (
        near if exact <= value else math.nextafter(near, -math.inf),
        near if exact >= value else math.nextafter(near, math.inf),
    )


def rational(values: Iterable[float]) -> Vector:
    """Return finite doubles as the rationals that they are."""
    return [Fraction(float(value)) for value in values]


def rational_rows(matrix: Any) -> list[Row]:
    """Return the rows of an array or sparse array as dictionaries column → entry."""
    rows = sp.csr_array(matrix)
    columns, entries, pointer = rows.indices.tolist(), rows.data.tolist(), rows.indptr.tolist()
    return [
        {columns[k]: Fraction(entries[k]) for k in range(pointer[i], pointer[i + 1]) if entries[k]}
        for i in range(rows.shape[0])
    ]


def products(rows: Sequence[Row], vector: Sequence[Fraction]) -> Iterator[Fraction]:
    """Yield Σ_j row_j vector_j of each row; in integers, as fractions would look for common divisors at every term."""
    numerators, denominator = common_denominator(vector)
    for row in rows:
        used = [(entry, numerators[j]) for j, entry in row.items() if numerators[j]]
        common = math.lcm(*(entry.denominator for entry, _ in used))
        total = sum(
            entry.numerator * (common // entry.denominator) * factor for entry, factor in used
        )
        yield Fraction(total, common * denominator) if total else ZERO


def short(values: FloatVector, denominator: int = 1 << 30) -> Vector:
    """Return values near the given ones, exact and with few digits; zeros stay zeros."""
    largest = float(np.abs(values).max(initial=0.0))
    if largest == 0.0 or not np.isfinite(largest):
        return [ZERO] * values.size
    unit = Fraction(2) ** int(np.floor(np.log2(largest))) / denominator
    return [round(Fraction(value) / unit) * unit for value in values.tolist()]


@fact
def integer_matrix(matrix: Matrix) -> IntegerMatrix:
    """Return M in integers."""
    return IntegerMatrix.of(matrix.csr)


def exact_slack(problem: LCP, z: ArrayLike | Sequence[Rational]) -> list[Fraction]:
    """Return w = M z + q without rounding, shape (n,).

    Raises
    ------
    InvalidProblem
        If z is not a vector of n finite numbers.

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


def exact_residuals(
    problem: LCP, z: FloatVector, scale: FloatVector | None = None
) -> list[Fraction]:
    """Return |z − mid(lower, upper, z − w/d)| of every row without any rounding, for a finite z; d is the scale."""
    scale = problem.residual_scale if scale is None else scale
    rows = zip(
        map(Fraction, z.tolist()),
        exact_slack(problem, z),
        scale.tolist(),
        problem.lower.tolist(),
        problem.upper.tolist(),
        strict=True,
    )
    # The comparison of a fraction with ±∞ is exact as well.
    return [
        abs(x - Fraction(min(max(x - w / Fraction(d), lower), upper)))
        for x, w, d, lower, upper in rows
    ]


def is_exact_solution(problem: LCP, z: ArrayLike | Sequence[Rational]) -> bool:
    """Return whether z solves the problem without any rounding.

    Raises
    ------
    InvalidProblem
        If z is not a vector of n finite numbers.

    Examples
    --------
    >>> is_exact_solution(LCP([[3]], [-1]), [Fraction(1, 3)]), is_exact_solution(LCP([[3]], [-1]), [1 / 3])
    (True, False)
    """
    exact = exact_vector(z, problem.n)
    rows = zip(
        exact,
        exact_slack(problem, exact),
        problem.lower.tolist(),
        problem.upper.tolist(),
        strict=True,
    )
    return all(
        lower <= z <= upper and (w >= 0 or z == upper) and (w <= 0 or z == lower)
        for z, w, lower, upper in rows
    )


def slack_bounds(problem: LCP) -> tuple[FloatVector, FloatVector]:
    """Return the signs of w that the bounds of z permit, as bounds of w, each of shape (n,).

    0 ≤ w_i if z_i has no upper bound, w_i ≤ 0 if z_i has no lower bound; a box permits both signs.
    """
    return (
        np.where(problem.upper == np.inf, 0.0, -np.inf),
        np.where(problem.lower == -np.inf, 0.0, np.inf),
    )
