"""What proves that a quadratic program has no minimum, checked in rational arithmetic on the program's own numbers."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from ..checks import FloatVector
from ..exact.rational import ZERO, Row, Vector, products, rational_rows, rounded_down, transposed_product
from ..kernels.floats import EPSILON
from ..problem.linear_constraints import WIDE, is_rounding, radius_of_proof, within
from .constraints import Constraints, constraint_tolerance

if TYPE_CHECKING:
    from .program import QuadraticProgram

MET = 1e-8  # what is left of a row, in units of the data, that rounding alone keeps from being met


@dataclass(frozen=True, eq=False)
class QPInfeasibility:
    """Multipliers that prove, after Farkas, that no x satisfies G x ≤ h, A x = b, lower ≤ x ≤ upper.

    With the constraints as rows C x ≤ d: Cᵀ multipliers = 0 and dᵀ multipliers < 0, the multipliers of inequalities ≥ 0
    (0 where the limit is infinite). Where Cᵀ multipliers is rounding beside its terms, and not 0, the proof is of all x
    with ‖x‖∞ ≤ `radius`.

    Attributes
    ----------
    program : QuadraticProgram
    multipliers : tuple of Fraction
        One a row of `program.constraints`: of G, of A, of the lower and of the upper bounds.
    """

    program: QuadraticProgram = field(repr=False)
    verdict: ClassVar[str] = "infeasible"
    multipliers: tuple[Fraction, ...]

    def verify(self) -> bool:
        """Return whether the multipliers are a proof; exact."""
        rows, used = self.program.constraints, self._used
        if any((y < 0 and not rows.is_equality[i]) or rows.limit[i] == np.inf for i, y in used):
            return False
        if not self.contradiction > 0 or self.is_exact:
            return self.contradiction > 0
        terms = abs(rows.transposed) @ np.abs(numbers(self.multipliers))
        return self.radius >= WIDE * self.program.primal_size and is_rounding(self._left, terms)

    @cached_property
    def contradiction(self) -> Fraction:
        """−dᵀ multipliers, less what Cᵀ multipliers takes off within the radius."""
        return self._plain if self.is_exact else self._plain - Fraction(self.radius) * _sum_of_sizes(self._left)

    @cached_property
    def radius(self) -> float:
        """Of the ‖x‖∞ that it speaks of: ∞, or the one that leaves half the contradiction."""
        return radius_of_proof(self._plain, _sum_of_sizes(self._left))

    @property
    def is_exact(self) -> bool:
        """Whether it speaks of all x."""
        return self.radius == np.inf

    @cached_property
    def _plain(self) -> Fraction:
        limit = self.program.constraints.limit
        return -sum((y * Fraction(float(limit[i])) for i, y in self._used if limit[i] != np.inf), ZERO)

    @cached_property
    def _left(self) -> Vector:
        used = self._used
        return combination(self.program.constraints, [i for i, _ in used], [y for _, y in used])

    @cached_property
    def margin(self) -> float:
        """A lower bound of the primal residual of every x, in units of the data; 0 where the proof does not hold.

        The least shift of all limits, each in its unit, that could make the constraints consistent.
        """
        unit = self.program.constraints.unit
        return _quotient(self.contradiction, self.multipliers, unit) if self.verify() else 0.0

    @cached_property
    def least_violation(self) -> float:
        """By how much every x violates some constraint, each in its own unit; a lower bound, 0 without a proof."""
        return _quotient(self.contradiction, self.multipliers, np.ones(len(self.multipliers))) if self.verify() else 0.0

    def excludes(self, tolerance: float) -> bool:
        """Return whether no x at all is optimal at this tolerance."""
        return self.margin > constraint_tolerance(tolerance)

    @property
    def _used(self) -> list[tuple[int, Fraction]]:
        return [(i, y) for i, y in enumerate(self.multipliers) if y]

    def __str__(self) -> str:
        how = f"multipliers checked exactly{within(self.radius, 'x')}"
        return f"infeasible: {len(self._used)} of its constraints contradict one another ({how})"


@dataclass(frozen=True, eq=False)
class QPUnboundedness:
    """A feasible point and a direction along which the objective falls for ever.

    point satisfies all constraints; point + t direction does so for every t ≥ 0; and directionᵀP direction < 0, or
    P direction = 0 with cᵀ direction < 0.

    Where P direction, and what constraints lose along it, is rounding and not 0 – of P, n ε Σ_j √(p_ii p_jj) |d_j|, as
    a P that is positive semidefinite is so to rounding only – the proof is of all x and multipliers of a size up to
    `radius`: none of them are a minimum and what proves it. point may then miss constraints by rounding.

    Attributes
    ----------
    program : QuadraticProgram
    point, direction : tuple of Fraction, shape (n,)
    """

    program: QuadraticProgram = field(repr=False)
    verdict: ClassVar[str] = "unbounded"
    point: tuple[Fraction, ...]
    direction: tuple[Fraction, ...]

    def verify(self) -> bool:
        """Return whether point and direction are a proof; exact."""
        if self.is_exact:
            return True
        if not self._slope < 0 or not self._is_wide or not self.violation <= MET:
            return False
        terms = abs(self.program.constraints.matrix) @ np.abs(numbers(self.direction))
        return self._is_rounding and is_rounding(self._lost, terms)

    @cached_property
    def is_exact(self) -> bool:
        """Whether the objective falls for ever on the stored doubles, within all constraints."""
        if any(self._lost) or not is_feasible(self.program.constraints, self._exact_rows, self.point):
            return False
        square = sum((p * entry for p, entry in zip(self._curvature, self.direction, strict=True)), ZERO)
        return square < 0 or (self._slope < 0 and not any(self._curvature))

    @cached_property
    def violation(self) -> Fraction:
        """By how much the point violates some constraint, each in units of the data; exact."""
        rows = self.program.constraints
        excess = losses(rows, self._exact_rows, self.point, rows.limit)
        units = np.minimum(rows.unit, np.finfo(np.float64).max).tolist()
        return max((value / Fraction(unit) for value, unit in zip(excess, units, strict=True) if value), default=ZERO)

    @cached_property
    def radius(self) -> float:
        """Of the x and multipliers that it speaks of: ∞, or the one that leaves half the slope."""
        left = _sum_of_sizes(self._curvature) + _sum_of_sizes(self._lost)
        return radius_of_proof(-self._slope, left) if self._is_rounding else np.inf

    @property
    def _is_wide(self) -> bool:
        return self.radius >= WIDE * self.program.dual_size

    @cached_property
    def _lost(self) -> Vector:
        """What each constraint loses along the direction."""
        rows = self.program.constraints
        return losses(rows, self._exact_rows, self.direction, np.where(np.isfinite(rows.limit), 0.0, np.inf))

    @cached_property
    def _exact_rows(self) -> list[Row]:
        return rational_rows(self.program.constraints.matrix)

    @cached_property
    def margin(self) -> float:
        """A lower bound of the dual residual of every x and multipliers, in units of the data.

        The least shift of c, each component in its unit, that stops the descent. ∞ where the objective is curved
        downwards by more than the rounding of P; 0 where the proof does not hold.
        """
        if not self.verify():
            return 0.0
        if not self._is_rounding:
            return np.inf
        falls = max(-self._slope, ZERO) / (1 if self.radius == np.inf else 2)
        return _quotient(falls, self.direction, self.program.dual_unit) if self._is_wide else 0.0

    def excludes(self, tolerance: float) -> bool:
        """Return whether no x at all is optimal at this tolerance."""
        return self.margin > tolerance and self.violation <= constraint_tolerance(tolerance)

    @cached_property
    def _slope(self) -> Fraction:
        return sum((Fraction(c) * d for c, d in zip(self.program.c.tolist(), self.direction, strict=True) if d), ZERO)

    @cached_property
    def _curvature(self) -> Vector:
        return list(products(rational_rows(self.program.P), self.direction))

    @cached_property
    def _is_rounding(self) -> bool:
        """Whether P d is within n ε √p_ii Σ_j √p_jj |d_j|, the rounding of a P = F Fᵀ."""
        root = np.sqrt(np.maximum(self.program.P.diagonal(), 0.0))
        size = float(root @ np.abs(np.array([float(entry) for entry in self.direction])))
        margin = self.program.n * EPSILON * size * root
        return all(abs(float(p)) <= limit for p, limit in zip(self._curvature, margin.tolist(), strict=True))

    def __str__(self) -> str:
        how = f"checked exactly{within(self.radius, 'x and multipliers')}"
        return f"unbounded: the objective falls for ever along a direction from a feasible point ({how})"


def combination(rows: Constraints, used: Sequence[int], multipliers: Sequence[Fraction]) -> Vector:
    """Return Cᵀy from the rows whose multipliers are given."""
    return transposed_product(rational_rows(rows.matrix[np.asarray(used, dtype=np.intp)]), multipliers, rows.sizes[-1])


def is_feasible(rows: Constraints, exact_rows: list[Row], x: Sequence[Fraction]) -> bool:
    """Return whether x satisfies all constraints; exact."""
    return not any(losses(rows, exact_rows, x, rows.limit))


def losses(rows: Constraints, exact_rows: list[Row], x: Sequence[Fraction], limit: FloatVector) -> Vector:
    """Return by how much C x misses each limit, 0 where it does not; exact."""
    missed = [
        value - Fraction(most) if most != np.inf else ZERO
        for value, most in zip(products(exact_rows, x), limit.tolist(), strict=True)
    ]
    return [abs(by) if is_equality else max(by, ZERO)
            for by, is_equality in zip(missed, rows.is_equality.tolist(), strict=True)]


def _sum_of_sizes(values: Iterable[Fraction]) -> Fraction:
    return sum(map(abs, values), ZERO)


def _quotient(value: Fraction, factors: Sequence[Fraction], sizes: FloatVector) -> float:
    """Return value / Σ|factor| size, rounded down; 0 where a size has overflowed."""
    used = [(y, size) for y, size in zip(factors, sizes.tolist(), strict=True) if y]
    if not all(np.isfinite(size) for _, size in used):
        return 0.0
    return rounded_down(value / sum((abs(y) * Fraction(size) for y, size in used), ZERO))


def numbers(fractions: Any) -> FloatVector:
    """Return the doubles nearest to some fractions."""
    return np.array([float(value) for value in fractions], dtype=np.float64)
