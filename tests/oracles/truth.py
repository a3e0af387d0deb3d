"""What is true of a linear complementarity problem, decided in fractions and without any code of the package.

A simplex method with bounds on all of z and M z (no objective, Bland's rule, exact) decides whether the linear
constraints hold together; depth-first search splits the rows that are not complementary at the point found. Fit for
n ≤ 12 or so; nothing is assumed of M.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import pairwise
from typing import Any

import numpy as np
import scipy.sparse as sp
from scipy.sparse.csgraph import connected_components

Bound = Fraction | None
Point = tuple[Fraction, ...]

SOLVABLE, INFEASIBLE, NO_SOLUTION = "solvable", "infeasible", "no solution"
MACHINE_EPSILON = Fraction(1, 2**52)
LEAST = Fraction(1, 2**1074)  # η, what a product that underflows loses


@dataclass(frozen=True)
class Truth:
    """The verdict and, where there is a solution, one of them."""

    verdict: str
    z: Point | None = None


def decide(problem: Any) -> Truth:
    """Return whether the problem has a solution, only linear feasibility, or not even that."""
    M = problem.csr.toarray().tolist()
    return Search(M, problem.q.tolist(), problem.lower.tolist(), problem.upper.tolist()).run()


def is_farkas(problem: Any, y: Sequence[Fraction]) -> bool:
    """Whether yᵀ(M z + q) < 0 for all z within the bounds, though every w permitted there has yᵀw ≥ 0."""
    lower, upper = ([fraction(x) for x in side.tolist()] for side in (problem.lower, problem.upper))
    for weight, low, high in zip(y, lower, upper, strict=True):
        is_unsigned = low is not None and high is not None
        if (
            (is_unsigned and weight)
            or (high is None and low is not None and weight < 0)
            or (low is None and high is not None and weight > 0)
        ):
            return False
    csr = problem.csr
    total = sum(
        (Fraction(q) * weight for q, weight in zip(problem.q.tolist(), y, strict=True)), Fraction(0)
    )
    columns = [Fraction(0)] * len(y)
    for i, weight in enumerate(y):
        if weight:
            for k in range(csr.indptr[i], csr.indptr[i + 1]):
                columns[csr.indices[k]] += weight * Fraction(float(csr.data[k]))
    for column, low, high in zip(columns, lower, upper, strict=True):
        bound = high if column > 0 else low
        if column and bound is None:
            return False
        total += column * bound if column else 0
    return total < 0


def fraction(value: float) -> Bound:
    """Return the number without rounding, None for ±∞."""
    return None if math.isinf(value) else Fraction(value)


class Simplex:
    """Values of z and then of v = M z, within bounds that may be tightened and restored."""

    def __init__(self, M: Sequence[Sequence[float | Fraction]]) -> None:
        m, n = len(M), len(M[0]) if M else 0
        self.rows = [[Fraction(x) for x in row] for row in M]  # basic = row · nonbasic
        self.basic, self.nonbasic = list(range(n, n + m)), list(range(n))
        self.low: list[Bound] = [None] * (n + m)
        self.high: list[Bound] = [None] * (n + m)
        self.value = [Fraction(0)] * (n + m)

    def settle(self) -> bool:
        """Move every variable within its bounds; return whether that is possible."""
        if any(
            a is not None and b is not None and a > b
            for a, b in zip(self.low, self.high, strict=True)
        ):
            return False
        for column, j in enumerate(self.nonbasic):
            self._shift(column, self._excess(j))
        while True:
            violated = [(k, r) for r, k in enumerate(self.basic) if self._excess(k)]
            if not violated:
                return True
            k, r = min(violated)
            excess = self._excess(k)
            column = self._entering(r, -excess)
            if column is None:
                return False
            self._shift(column, excess / self.rows[r][column])
            self._pivot(r, column)

    def _excess(self, k: int) -> Fraction:
        """How far variable k lies above its upper (positive) or below its lower bound (negative)."""
        x, low, high = self.value[k], self.low[k], self.high[k]
        if low is not None and x < low:
            return x - low
        return x - high if high is not None and x > high else Fraction(0)

    def _entering(self, r: int, direction: Fraction) -> int | None:
        """Return the column of the first variable that can move the basic variable of row r that way."""
        best = None
        for column, coefficient in enumerate(self.rows[r]):
            if not coefficient:
                continue
            j = self.nonbasic[column]
            rises = (coefficient > 0) == (direction > 0)
            limit = self.high[j] if rises else self.low[j]
            if (limit is None or self.value[j] != limit) and (
                best is None or j < self.nonbasic[best]
            ):
                best = column
        return best

    def _shift(self, column: int, amount: Fraction) -> None:
        """Lower the nonbasic variable by the amount."""
        if amount:
            self.value[self.nonbasic[column]] -= amount
            for row, k in zip(self.rows, self.basic, strict=True):
                if row[column]:
                    self.value[k] -= row[column] * amount

    def _pivot(self, r: int, column: int) -> None:
        row = self.rows[r]
        pivot = row[column]
        row = [-x / pivot if x else x for x in row]
        row[column] = 1 / pivot
        self.rows[r] = row
        for other, entries in enumerate(self.rows):
            factor = entries[column]
            if other != r and factor:
                self.rows[other] = [
                    (factor * y if c == column else x + factor * y)
                    if y
                    else (x if c != column else y)
                    for c, (x, y) in enumerate(zip(entries, row, strict=True))
                ]
        self.basic[r], self.nonbasic[column] = self.nonbasic[column], self.basic[r]


class Search:
    def __init__(
        self, M: list[list[float]], q: list[float], lower: list[float], upper: list[float]
    ) -> None:
        self.n = len(q)
        self.simplex = Simplex(M)
        self.zero = [-Fraction(x) for x in q]  # the value of (M z)_i where w_i = 0
        self.lower, self.upper = [fraction(x) for x in lower], [fraction(x) for x in upper]
        for i in range(self.n):
            self.simplex.low[i], self.simplex.high[i] = self.lower[i], self.upper[i]
            is_fixed = self.lower[i] is not None and self.lower[i] == self.upper[i]
            if not is_fixed and self.upper[i] is None:
                self.simplex.low[self.n + i] = self.zero[i]
            if not is_fixed and self.lower[i] is None:
                self.simplex.high[self.n + i] = self.zero[i]

    def run(self) -> Truth:
        if not self.simplex.settle():
            return Truth(INFEASIBLE)
        return Truth(SOLVABLE, self.point()) if self.descend() else Truth(NO_SOLUTION)

    def point(self) -> Point:
        return tuple(self.simplex.value[: self.n])

    def descend(self) -> bool:
        """Search below the present bounds, which settle has satisfied."""
        row = next((i for i in range(self.n) if not self.is_complementary(i)), None)
        if row is None:
            return True
        z, w = self.simplex, self.n + row
        kept = z.low[row], z.high[row], z.low[w], z.high[w]
        for change in self.cases(row):
            z.low[row], z.high[row], z.low[w], z.high[w] = change(*kept)
            if z.settle() and self.descend():
                return True
        z.low[row], z.high[row], z.low[w], z.high[w] = kept
        return False

    def is_complementary(self, i: int) -> bool:
        z, w = self.simplex.value[i], self.simplex.value[self.n + i] - self.zero[i]
        at_lower, at_upper = z == self.lower[i], z == self.upper[i]
        return w == 0 or (at_lower and (w > 0 or at_upper)) or (at_upper and w < 0)

    def cases(self, i: int) -> list[Any]:
        """The alternatives of row i, as changes of (low z, high z, low v, high v)."""
        low, high, zero = self.lower[i], self.upper[i], self.zero[i]
        cases = [lambda a, b, c, d: (a, b, zero, zero)]
        if low is not None:
            cases.append(lambda a, b, c, d: (a, low, zero if c is None else max(c, zero), d))
        if high is not None:
            cases.append(lambda a, b, c, d: (high, b, c, zero if d is None else min(d, zero)))
        return cases


# --- Measuring a given z exactly -------------------------------------------------------------------------------------


def component_of_rows(M: Any) -> list[int]:
    """Which connected component of the graph of a CSR array each row belongs to, by scipy."""
    labels: list[int] = connected_components(abs(M) > 0, directed=True, connection="weak")[
        1
    ].tolist()
    return labels


def references_of_rows(at_zero: Sequence[Fraction], labels: Sequence[int]) -> list[Fraction]:
    """The reference of each row's component, from the residuals of z°."""
    largest: dict[int, Fraction] = {}
    for label, value in zip(labels, at_zero, strict=True):
        largest[label] = max(abs(value), largest.get(label, Fraction(0)))
    return [largest[label] for label in labels]


def relative_residual(
    residuals: Sequence[Fraction], at_zero: Sequence[Fraction], labels: Sequence[int]
) -> Any:
    """The largest ‖r_P(z)‖∞ / ‖r_P(z°)‖∞ of all components; 0 for 0/0, ∞ for others over 0."""
    worst: Any = Fraction(0)
    for value, reference in zip(residuals, references_of_rows(at_zero, labels), strict=True):
        if value:
            worst = max(worst, abs(value) / reference if reference else math.inf)
    return worst


class ExactData:
    """M, q and the bounds of a problem as integers over common denominators; measures any z without rounding."""

    def __init__(self, problem: Any) -> None:
        csr: sp.csr_array = problem.csr
        entries, self.scale = _integers(csr.data.tolist())
        starts, columns = csr.indptr.tolist(), csr.indices.tolist()
        self.rows = [
            list(zip(columns[a:b], entries[a:b], strict=True)) for a, b in pairwise(starts)
        ]
        self.q = [Fraction(x) for x in problem.q.tolist()]
        self.lower = [fraction(x) for x in problem.lower.tolist()]
        self.upper = [fraction(x) for x in problem.upper.tolist()]
        self.divisor = [self._divisor(i, row) for i, row in enumerate(self.rows)]
        self.components = component_of_rows(csr)

    def _divisor(self, i: int, row: list[tuple[int, int]]) -> Fraction:
        """d_i of the scaled residual: the diagonal, or the row's largest entry where that is negligible, or 1."""
        largest = max((abs(x) for _, x in row), default=0)
        diagonal = next((x for j, x in row if j == i), 0)
        usable = diagonal > 0 and diagonal * 2**20 >= largest
        return Fraction(diagonal if usable else largest, self.scale) if row else Fraction(1)

    def slack(self, z: Sequence[Any]) -> list[Fraction]:
        """Return M z + q."""
        values, scale = _integers(z)
        denominator = self.scale * scale
        return [
            Fraction(sum(x * values[j] for j, x in row), denominator) + q
            for row, q in zip(self.rows, self.q, strict=True)
        ]

    def steps(self, z: Sequence[Any], divisors: Sequence[Fraction]) -> list[Fraction]:
        """Return z_i − mid(lower_i, upper_i, z_i − w_i/d_i)."""
        steps = []
        for i, (x, w, d) in enumerate(zip(z, self.slack(z), divisors, strict=True)):
            x, step = Fraction(x), w / d
            step = step if self.upper[i] is None else max(step, x - self.upper[i])
            steps.append(step if self.lower[i] is None else min(step, x - self.lower[i]))
        return steps

    def residual(self, z: Sequence[Any]) -> list[Fraction]:
        """Return the steps in absolute value."""
        return [abs(step) for step in self.steps(z, self.divisor)]

    @property
    def nearest(self) -> list[Fraction]:
        """The point of the bounds nearest to zero."""
        zero = Fraction(0)
        return [
            high if high is not None and high < 0 else low if low is not None and low > 0 else zero
            for low, high in zip(self.lower, self.upper, strict=True)
        ]

    def at_zero(self) -> list[Fraction]:
        """Return the residuals there."""
        return self.residual(self.nearest)

    def terms(self, z: Sequence[Any]) -> list[Fraction]:
        """Return |M||z| + |q|."""
        values, scale = _integers(z)
        sums = [sum(abs(x * values[j]) for j, x in row) for row in self.rows]
        return [Fraction(s, self.scale * scale) + abs(q) for s, q in zip(sums, self.q, strict=True)]

    def floor(self, z: Sequence[Any], least: Fraction = LEAST) -> list[Fraction]:
        """Return the rounding bound of each residual: (nonzeros + 2) (ε (|M||z| + |q|)_i + η) / d_i + η."""
        return [
            (len(row) + 2) * (MACHINE_EPSILON * terms + least) / d + least
            for row, terms, d in zip(self.rows, self.terms(z), self.divisor, strict=True)
        ]

    def is_solution(self, z: Sequence[Any]) -> bool:
        """Whether z is within the bounds and complementary, without any tolerance."""
        return not any(self.residual(z))

    def counted(self, z: Sequence[Any]) -> list[Fraction]:
        """Return the residuals, 0 where |w_i| is at most 8 ε min(T_i, S_i), and 6 ε per entry for the sum of doubles.

        S_i = T_i(z°) + 2²⁰ d_i ‖r_P(z°)‖; at z° itself T_i(z°).
        """
        nearest = self.nearest
        references = [Fraction(0)] * len(self.q)
        if list(map(Fraction, z)) != nearest:
            references = references_of_rows(self.counted(nearest), self.components)
        found = []
        zips = (self.residual(z), self.slack(z), self.terms(z), self.terms(nearest), references)
        for i, (r, w, terms, begun, reference) in enumerate(zip(*zips, strict=True)):
            size = min(terms, begun + 2**20 * self.divisor[i] * reference)
            is_rounding = abs(w) <= (len(self.rows[i]) + 14) * MACHINE_EPSILON * size
            found.append(Fraction(0) if is_rounding else r)
        return found

    def is_lie(self, z: Sequence[Any], tolerance: float) -> bool:
        """Whether calling z solved is a lie: ‖r_P(z)‖ > tolerance · ‖r_P(z°)‖ in a component P, of counted rows."""
        if not np.isfinite(np.array([float(x) for x in z])).all():
            return True
        relative = relative_residual(self.counted(z), self.counted(self.nearest), self.components)
        return bool(relative > Fraction(tolerance))

    def misses_by_rounding_of_q(self, z: Sequence[Any]) -> bool:
        """Whether every residual is at most 2⁻⁴⁴ of the largest |q̂_i|/d̂_i, which is what may contradict in q."""
        rows = zip(self.q, self.divisor, strict=True)
        largest = max((abs(q) / d for q, d in rows), default=Fraction(0))
        return max(self.residual(z), default=Fraction(0)) <= largest * (1 + MACHINE_EPSILON) / 2**44

    def is_at_rounding_level(self, z: Sequence[Any]) -> bool:
        """Whether every residual is at most 5 times its floor: 4 as claimed, and 1 for the rounding of the claim."""
        return all(r <= 5 * f for r, f in zip(self.residual(z), self.floor(z), strict=True))


def _integers(values: Sequence[Any]) -> tuple[list[int], int]:
    """Return integers and their common denominator."""
    pairs = [x.as_integer_ratio() for x in values]
    common = math.lcm(*{d for _, d in pairs}) if pairs else 1
    return [p * (common // d) for p, d in pairs], common
