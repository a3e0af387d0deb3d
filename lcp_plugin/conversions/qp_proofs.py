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
from .constraints import Constraints, constraint_tolerance

if TYPE_CHECKING:
    from .program import QuadraticProgram


@dataclass(frozen=True, eq=False)
class QPInfeasibility:
    """Multipliers that prove, after Farkas, that no x satisfies G x ≤ h, A x = b, lower ≤ x ≤ upper.

    With the constraints as rows C x ≤ d: Cᵀ multipliers = 0 and dᵀ multipliers < 0, the multipliers of inequalities ≥ 0
    (0 where the limit is infinite).

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
        return self.contradiction > 0 and not any(combination(rows, [i for i, _ in used], [y for _, y in used]))

    @cached_property
    def contradiction(self) -> Fraction:
        """−dᵀ multipliers."""
        limit = self.program.constraints.limit
        return -sum((y * Fraction(float(limit[i])) for i, y in self._used), ZERO)

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
        return f"infeasible: {len(self._used)} of its constraints contradict one another (multipliers checked exactly)"


@dataclass(frozen=True, eq=False)
class QPUnboundedness:
    """A feasible point and a direction along which the objective falls for ever.

    point satisfies all constraints; point + t direction does so for every t ≥ 0; and directionᵀP direction < 0, or
    P direction = 0 with cᵀ direction < 0.

    Attributes
    ----------
    program : QuadraticProgram
    point, direction : tuple of Fraction, shape (n,)
    is_exact : bool
        False where P direction is zero only to within the rounding errors that P itself carries,
        n ε Σ_j √(p_ii p_jj) |direction_j|: the program is then as good as unbounded, as a P that is positive
        semidefinite is so to rounding only. Everything else is always exact.
    """

    program: QuadraticProgram = field(repr=False)
    verdict: ClassVar[str] = "unbounded"
    point: tuple[Fraction, ...]
    direction: tuple[Fraction, ...]
    is_exact: bool

    def verify(self) -> bool:
        """Return whether point and direction are a proof; exact but for what `is_exact` admits."""
        rows, d = self.program.constraints, self.direction
        exact_rows = rational_rows(rows.matrix)
        if not is_feasible(rows, exact_rows, self.point) or not is_recession(rows, exact_rows, d):
            return False
        square = sum((p * entry for p, entry in zip(self._curvature, d, strict=True)), ZERO)
        if square < 0 or not any(self._curvature):
            return square < 0 or self._slope < 0
        return not self.is_exact and self._slope < 0 and self._is_rounding

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
        return _quotient(max(-self._slope, ZERO), self.direction, self.program.dual_unit)

    def excludes(self, tolerance: float) -> bool:
        """Return whether no x at all is optimal at this tolerance."""
        return self.margin > tolerance

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
        how = "checked exactly" if self.is_exact else "P d = 0 to the rounding errors of P"
        return f"unbounded: the objective falls for ever along a direction from a feasible point ({how})"


def combination(rows: Constraints, used: Sequence[int], multipliers: Sequence[Fraction]) -> Vector:
    """Return Cᵀy from the rows whose multipliers are given."""
    return transposed_product(rational_rows(rows.matrix[np.asarray(used, dtype=np.intp)]), multipliers, rows.sizes[-1])


def is_feasible(rows: Constraints, exact_rows: list[Row], x: Sequence[Fraction]) -> bool:
    """Return whether x satisfies all constraints; exact."""
    return _holds(rows, products(exact_rows, x), rows.limit)


def is_recession(rows: Constraints, exact_rows: list[Row], d: Sequence[Fraction]) -> bool:
    """Return whether x + t d satisfies all constraints for t ≥ 0 where x does; exact."""
    return _holds(rows, products(exact_rows, d), np.where(np.isfinite(rows.limit), 0.0, np.inf))


def _holds(rows: Constraints, values: Iterable[Fraction], limit: FloatVector) -> bool:
    return all(
        value == Fraction(most) if is_equality else value <= Fraction(most)
        for value, most, is_equality in zip(values, limit.tolist(), rows.is_equality.tolist(), strict=True)
        if most != np.inf
    )


def _quotient(value: Fraction, factors: Sequence[Fraction], sizes: FloatVector) -> float:
    """Return value / Σ|factor| size, rounded down; 0 where a size has overflowed."""
    used = [(y, size) for y, size in zip(factors, sizes.tolist(), strict=True) if y]
    if not all(np.isfinite(size) for _, size in used):
        return 0.0
    return rounded_down(value / sum((abs(y) * Fraction(size) for y, size in used), ZERO))


def numbers(fractions: Any) -> FloatVector:
    """Return the doubles nearest to some fractions."""
    return np.array([float(value) for value in fractions], dtype=np.float64)
