"""Simplex method in exact arithmetic: a point within bounds with w = M z + q, or a proof that none exists."""

from __future__ import annotations

import math
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from ...core import deadline
from ...core.checks import Vector
from ...proofs.exact import IntegerMatrix, exact_power_of_two, integers

Bound = int | None  # None: no bound
Sides = tuple[Vector, Vector]  # lower, upper

QUANTUM = 5_000_000  # products of digits between two looks at the clock: tens of milliseconds


@dataclass
class Effort:
    """Operation counts of a search, which are equal on every machine.

    Attributes
    ----------
    cases : int
        Number of visited complementarity pieces.
    entries : int
        Number of computed entries of the tableau.
    products : int
        Approximate number of products of two digits of 30 bits, and equally expensive operations.
    """

    cases: int = 0
    entries: int = 0
    products: int = 0
    due: int = 0

    def add(self, entries: int, bits: int) -> None:
        """Count new entries of so many bits; raise OutOfTimeError if the time of a run is over."""
        self.entries += entries
        # A digit has 30 bits; the access to an entry takes as long as 100 products of digits.
        self.products += entries * (100 + (bits // 30) ** 2)
        if self.products >= self.due:
            self.due = self.products + QUANTUM
            deadline.require_seconds(0.0)


class ExactSimplex:
    """Bounds on the variables x = (z, w) of w = M z + q, and a basic point that is within them.

    Variable i < n is z_i, variable n + i is w_i times a positive `row_scale`; all values are integers (nonbasic) or
    integers over one common `denominator` (basic), in one `unit`. Bounds can be narrowed and put back at any
    time; :meth:`infeasibility_proof` then repairs the point or proves that there is none.

    Equations of free rows are solved at the beginning: their z stay in the basis, and their w outside of it.

    It is one class because all methods read or pivot one table.

    Notes
    -----
    Integer-preserving pivots (Edmonds, Bareiss): each entry is a minor of the scaled matrix, so that numbers stay as
    short as they can without common factors being looked for.

    References
    ----------
    B. Dutertre, L. de Moura, *A fast linear-arithmetic solver for DPLL(T)*, CAV 2006, doi:10.1007/11817963_11 (bounds
    that come and go); R. G. Bland, *New finite pivoting rules*, Math. Oper. Res. 2 (1977), doi:10.1287/moor.2.2.103.
    """

    def __init__(
        self, matrix: IntegerMatrix, q: Vector, bounds: Sides, slack_bounds: Sides, effort: Effort
    ) -> None:
        n = self.n = q.size
        self.effort = effort
        self.unit, bounds_of_z = _integer_bounds(bounds)
        slack = [[None if math.isinf(value) else 0 for value in side] for side in slack_bounds]
        self.lower: list[Bound] = bounds_of_z[0] + slack[0]
        self.upper: list[Bound] = bounds_of_z[1] + slack[1]
        self.rows, self.row_scale = _integer_rows(matrix, q, self.unit)
        self.denominator = 1
        self.basic = list(range(n, 2 * n))
        self.nonbasic = list(range(n))
        self.value = [_clipped(0, *self.bounds(x)) for x in range(2 * n)]  # of nonbasic ones
        self.numerator: list[int] = []  # of basic ones, over the denominator
        self._evaluate()

    def solve_equations(self) -> None:
        """Solve the equations of free rows for as many free z as they determine."""
        for w in [w for w in self.basic if self._is_fixed(w)]:
            row = self.basic.index(w)
            for column, (z, entry) in enumerate(zip(self.nonbasic, self.rows[row], strict=False)):
                if entry and z < self.n and self.bounds(z) == (None, None):
                    self._pivot(row, column, 0)
                    break

    def bounds(self, x: int) -> tuple[Bound, Bound]:
        """Return both bounds of a variable."""
        return self.lower[x], self.upper[x]

    def set_bounds(self, x: int, lower: Bound, upper: Bound) -> None:
        """Give a variable new bounds; call `infeasibility_proof` before you use the point."""
        self.lower[x], self.upper[x] = lower, upper
        self.value[x] = _clipped(self.value[x], lower, upper)

    def infeasibility_proof(self) -> list[Fraction] | None:
        """Move to a point within all bounds and return None, or return a Farkas vector y that there is none.

        sup (Mᵀy)ᵀz − yᵀw + qᵀy over the bounds is negative; shape (n,).
        """
        self._evaluate()
        tries = 0
        while (leaving := self._violated(tries)) is not None:
            row, target, direction = leaving
            column = self._entering(row, direction)
            if column is None:
                return self.farkas(row, direction)
            self._pivot(row, column, target)
            tries += 1
        return None

    def implied_range(self, row: int) -> tuple[int | None, int | None]:
        """Return bounds of a basic variable, times the denominator, that its row and the other bounds imply."""
        low: int | None = self.numerator[row]
        high = low
        for entry, x in zip(self.rows[row], self.nonbasic, strict=False):
            if not entry:
                continue
            value = self.value[x]
            ends = [None if end is None else entry * (end - value) for end in self.bounds(x)]
            down, up = ends if entry > 0 else ends[::-1]
            low = None if low is None or down is None else low + down
            high = None if high is None or up is None else high + up
            if low is None and high is None:
                break
        return low, high

    def farkas(self, row: int, direction: int) -> list[Fraction]:
        """Return the multipliers y of the equations that combine to a row; +1: the row cannot rise to its bound."""
        multipliers = [0] * self.n
        if self.basic[row] >= self.n:
            multipliers[self.basic[row] - self.n] = direction * self.denominator
        for entry, x in zip(self.rows[row], self.nonbasic, strict=False):
            if x >= self.n and entry:
                multipliers[x - self.n] = -direction * entry
        return [Fraction(y * scale) for y, scale in zip(multipliers, self.row_scale, strict=True)]

    def can_leave(self, x: int, direction: int) -> bool:
        """Return whether a variable can rise (+1) or fall (−1) within the bounds; the test may move the point."""
        start = self.position(x)
        while (self.position(x) - start) * direction <= 0:
            step = self._improving(x, direction)
            if step is None:
                return False
            if not self._move(*step):
                return True
        return True

    def go_to_vertex(self) -> None:
        """Move every nonbasic variable to a bound, as far as such points exist."""
        for column in range(len(self.nonbasic)):
            low, high = self.bounds(x := self.nonbasic[column])
            if self.value[x] not in (low, high) and not self._move(column, -1):
                self._move(column, 1)

    def release_fixed(self) -> int:
        """Pivot variables with equal bounds out of the basis; return the dimension that is left."""
        for row in range(len(self.basic)):
            if self._is_fixed(self.basic[row]):
                for column, x in enumerate(self.nonbasic):
                    if self.rows[row][column] and not self._is_fixed(x):
                        self._pivot(row, column, self.lower[self.basic[row]] or 0)
                        break
        return sum(not self._is_fixed(x) for x in self.nonbasic)

    def position(self, x: int) -> Fraction:
        """Return the value of a variable at the present point, in the unit."""
        if x in self.nonbasic:
            return Fraction(self.value[x])
        return Fraction(self.numerator[self.basic.index(x)], self.denominator)

    def numerators(self) -> list[int]:
        """Return the values of all variables at the present point, in the unit over the denominator, shape (2n,)."""
        values = [value * self.denominator for value in self.value]
        for x, numerator in zip(self.basic, self.numerator, strict=True):
            values[x] = numerator
        return values

    def point(self) -> list[Fraction]:
        """Return z of the present point, shape (n,)."""
        values = self.numerators()[: self.n]
        return [Fraction(value, self.denominator) * self.unit for value in values]

    def _is_fixed(self, x: int) -> bool:
        return self.lower[x] is not None and self.lower[x] == self.upper[x]

    def _evaluate(self) -> None:
        moved = [(k, self.value[x]) for k, x in enumerate(self.nonbasic) if self.value[x]]
        self.numerator = [row[-1] + sum(row[k] * value for k, value in moved) for row in self.rows]

    def _violated(self, tries: int) -> tuple[int, int, int] | None:
        """Return row, bound and direction of a basic variable out of bounds: the farthest, later Bland's."""
        farthest, worst = None, 0
        for row, x in enumerate(self.basic):
            numerator, (low, high) = self.numerator[row], self.bounds(x)
            if low is not None and (gap := low * self.denominator - numerator) > 0:
                candidate = (row, low, 1)
            elif high is not None and (gap := numerator - high * self.denominator) > 0:
                candidate = (row, high, -1)
            else:
                continue
            size = -x - 1 if tries > 2 * self.n else gap
            if farthest is None or size > worst:
                farthest, worst = candidate, size
        return farthest

    def _entering(self, row: int, direction: int) -> int | None:
        """Return the column of the first nonbasic variable that can push the row's variable in that direction."""
        entries = zip(self.nonbasic, self.rows[row], strict=False)
        movable = (
            (x, column)
            for column, (x, entry) in enumerate(entries)
            if entry and self._can_move(x, direction if entry > 0 else -direction)
        )
        return min(movable, default=(0, None))[1]

    def _can_move(self, x: int, direction: int) -> bool:
        bound = self.upper[x] if direction > 0 else self.lower[x]
        return bound is None or self.value[x] != bound

    def _improving(self, x: int, direction: int) -> tuple[int, int] | None:
        """Return column and direction of a nonbasic variable whose move moves x in the direction, Bland's first."""
        if x in self.nonbasic:
            return (self.nonbasic.index(x), direction) if self._can_move(x, direction) else None
        row = self.basic.index(x)
        if (column := self._entering(row, direction)) is None:
            return None
        return column, direction if self.rows[row][column] > 0 else -direction

    def _move(self, column: int, direction: int) -> bool:
        """Move a nonbasic variable as far as all bounds allow; return False, without a move, if no bound blocks it."""
        entering = self.nonbasic[column]
        best: tuple[Fraction, int, int, int] | None = None
        end = self.upper[entering] if direction > 0 else self.lower[entering]
        if end is not None:
            best = (Fraction(abs(end - self.value[entering])), entering, -1, end)
        for row, x in enumerate(self.basic):
            speed = self.rows[row][column] * direction
            bound = self.upper[x] if speed > 0 else self.lower[x]
            if speed and bound is not None:
                distance = Fraction(bound * self.denominator - self.numerator[row], speed)
                limit = distance, x, row, bound
                best = limit if best is None or limit[:2] < best[:2] else best
        if best is None:
            return False
        if best[1] == entering:
            self.value[entering] = best[3]
            self._evaluate()
        else:
            self._pivot(best[2], column, best[3])
        return True

    def _pivot(self, row: int, column: int, target: int) -> None:
        """Exchange the row's basic variable, which moves to the target, with the column's variable."""
        pivot, old = self.rows[row][column], self.denominator
        sign = 1 if pivot > 0 else -1
        pivot_row, bits = self.rows[row], max(pivot.bit_length(), old.bit_length())
        for i, other in enumerate(self.rows):
            self.effort.add(len(other), bits)
            if i != row:
                factor = other[column]
                if factor:
                    pairs = zip(other, pivot_row, strict=True)
                    self.rows[i] = [sign * ((a * pivot - factor * b) // old) for a, b in pairs]
                    self.rows[i][column] = sign * factor
                elif pivot != old * sign or sign < 0:
                    self.rows[i] = [sign * (a * pivot // old) if a else 0 for a in other]
        self.rows[row] = [-sign * a for a in pivot_row]
        self.rows[row][column] = sign * old
        self.denominator = sign * pivot
        leaving, entering = self.basic[row], self.nonbasic[column]
        self.basic[row], self.nonbasic[column] = entering, leaving
        self.value[leaving] = target
        self._evaluate()


def _integer_bounds(sides: Sides) -> tuple[Fraction, list[list[Bound]]]:
    """Return a unit and the bounds of z as multiples of it."""
    both = np.concatenate(sides)
    is_finite = np.isfinite(both)
    whole, exponent = integers(np.where(is_finite, both, 0.0))
    bounds = [k if finite else None for k, finite in zip(whole, is_finite.tolist(), strict=True)]
    n = sides[0].size
    return exact_power_of_two(exponent), [bounds[:n], bounds[n:]]


def _integer_rows(
    matrix: IntegerMatrix, offset: Vector, unit: Fraction
) -> tuple[list[list[int]], list[int]]:
    """Return the rows of (M, q/unit) as integers without a common factor, and the integer multiplier of each row.

    These multipliers have a common unit.
    """
    rows, scales = [], []
    for i, q in enumerate(offset.tolist()):
        constant = Fraction(q) / unit
        step = min(exact_power_of_two(matrix.exponent), Fraction(1, constant.denominator))
        factor = int(exact_power_of_two(matrix.exponent) / step)
        row = [0] * offset.size + [int(constant / step)]
        for j, entry in matrix.rows[i]:
            row[j] = entry * factor
        divisor = math.gcd(*row) or 1
        rows.append([entry // divisor for entry in row])
        scales.append(1 / (step * divisor))
    common = math.lcm(*(scale.denominator for scale in scales))
    return rows, [scale.numerator * (common // scale.denominator) for scale in scales]


def _clipped(value: int, lower: Bound, upper: Bound) -> int:
    if lower is not None and value < lower:
        return lower
    return upper if upper is not None and value > upper else value
