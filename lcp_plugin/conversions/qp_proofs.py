"""What proves that a quadratic program has no minimum, checked in rational arithmetic on the program's own numbers."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from fractions import Fraction
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
import scipy.sparse as sp

from ..checks import FloatVector
from ..exact.rational import ZERO, Row, Vector, products, rational_rows, rounded_down, transposed_product
from ..kernels.floats import EPSILON
from .qp_units import constraint_tolerance
from .quadratic_program import QuadraticProgram


@dataclass(frozen=True, eq=False)
class QPInfeasibility:
    """Multipliers that prove, after Farkas, that no x satisfies G x ≤ h, A x = b, lower ≤ x ≤ upper.

    Gᵀ inequality + Aᵀ equality − lower + upper = 0 with inequality, lower, upper ≥ 0 (0 where the limit is infinite)
    and hᵀ inequality + bᵀ equality − (program.lower)ᵀ lower + (program.upper)ᵀ upper < 0.

    Attributes
    ----------
    program : QuadraticProgram
    inequality, equality, lower, upper : tuple of Fraction
    """

    program: QuadraticProgram = field(repr=False)
    verdict: ClassVar[str] = "infeasible"
    inequality: tuple[Fraction, ...]
    equality: tuple[Fraction, ...]
    lower: tuple[Fraction, ...]
    upper: tuple[Fraction, ...]

    def verify(self) -> bool:
        """Return whether the multipliers are a proof; exact."""
        program = self.program
        if min([*self.inequality, *self.lower, *self.upper], default=ZERO) < 0:
            return False
        total = _combination(program.G, self.inequality)
        equations = _combination(program.A, self.equality)
        sums = zip(total, equations, self.lower, self.upper, strict=True)
        if any(g + a - low + high for g, a, low, high in sums):
            return False
        parts = [(self.inequality, program.h), (self.equality, program.b), (self.upper, program.upper)]
        value = ZERO
        for multipliers, limits in [*parts, (self.lower, -program.lower)]:
            for multiplier, limit in zip(multipliers, limits.tolist(), strict=True):
                if multiplier:
                    if not np.isfinite(limit):
                        return False
                    value += multiplier * Fraction(limit)
        return value < 0

    @cached_property
    def margin(self) -> float:
        """A lower bound of the primal residual of every x, in units of the data; 0 where the proof does not hold.

        The least shift of all limits, each in its unit, that could make the constraints consistent.
        """
        program, units = self.program, self.program.units
        if not self.verify():
            return 0.0
        rows = [(self.inequality, program.h), (self.equality, program.b), (self.upper, program.upper)]
        limits = _products([*rows, (self.lower, -program.lower)])
        contradiction = sum((y * Fraction(limit) for y, limit in limits), ZERO)
        sizes = [
            (self.inequality, units.inequality), (self.equality, units.equality),
            (self.lower, units.lower), (self.upper, units.upper),
        ]
        return _quotient(-contradiction, sizes)

    def excludes(self, tolerance: float) -> bool:
        """Return whether no x at all is optimal at this tolerance."""
        return self.margin > constraint_tolerance(tolerance)

    def __str__(self) -> str:
        used = sum(1 for part in (self.inequality, self.equality, self.lower, self.upper) for y in part if y)
        return f"infeasible: {used} of its constraints contradict one another (multipliers checked exactly)"


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
        program, d = self.program, self.direction
        G, A = rational_rows(program.G), rational_rows(program.A)
        if not is_feasible(program, G, A, self.point) or not is_recession(program, G, A, d):
            return False
        slope = sum((Fraction(c) * entry for c, entry in zip(program.c.tolist(), d, strict=True)), ZERO)
        curvature = list(products(rational_rows(program.P), d))
        square = sum((p * entry for p, entry in zip(curvature, d, strict=True)), ZERO)
        if square < 0 or not any(curvature):
            return square < 0 or slope < 0
        return not self.is_exact and slope < 0 and is_rounding(program, curvature, d)

    @cached_property
    def margin(self) -> float:
        """A lower bound of the dual residual of every x and multipliers, in units of the data.

        The least shift of c, each component in its unit, that stops the descent. ∞ where the objective is curved
        downwards by more than the rounding of P; 0 where the proof does not hold.
        """
        program = self.program
        if not self.verify():
            return 0.0
        if not is_rounding(program, list(products(rational_rows(program.P), self.direction)), self.direction):
            return np.inf
        slope = sum((d * Fraction(c) for d, c in _products([(self.direction, program.c)])), ZERO)
        return _quotient(max(-slope, ZERO), [(self.direction, program.units.dual)])

    def excludes(self, tolerance: float) -> bool:
        """Return whether no x at all is optimal at this tolerance."""
        return self.margin > tolerance

    def __str__(self) -> str:
        how = "checked exactly" if self.is_exact else "P d = 0 to the rounding errors of P"
        return f"unbounded: the objective falls for ever along a direction from a feasible point ({how})"


def _products(parts: list[tuple[tuple[Fraction, ...], FloatVector]]) -> Iterator[tuple[Fraction, float]]:
    """Yield each factor that is not zero with its number."""
    for factors, numbers in parts:
        yield from ((y, number) for y, number in zip(factors, numbers.tolist(), strict=True) if y)


def _quotient(value: Fraction, sizes: list[tuple[tuple[Fraction, ...], FloatVector]]) -> float:
    """Return value / Σ|factor| size, rounded down; 0 where a size has overflowed."""
    used = list(_products(sizes))
    if not all(np.isfinite(size) for _, size in used):
        return 0.0
    return rounded_down(value / sum((abs(y) * Fraction(size) for y, size in used), ZERO))


def _combination(matrix: Any, multipliers: tuple[Fraction, ...]) -> Vector:
    """Return matrixᵀ multipliers, of which most may be zero."""
    used = np.flatnonzero([bool(y) for y in multipliers])
    rows = rational_rows(sp.csr_array(matrix)[used])
    return transposed_product(rows, [multipliers[i] for i in used.tolist()], matrix.shape[1])


def is_feasible(program: QuadraticProgram, G: list[Row], A: list[Row], x: Any) -> bool:
    """Return whether x satisfies all constraints; exact."""
    limits = zip(products(G, x), program.h.tolist(), strict=True)
    return (
        all(value == Fraction(b) for value, b in zip(products(A, x), program.b.tolist(), strict=True))
        and all(value <= Fraction(h) for value, h in limits if h != np.inf)
        and all(entry >= Fraction(low) for entry, low in zip(x, program.lower.tolist(), strict=True) if low != -np.inf)
        and all(entry <= Fraction(top) for entry, top in zip(x, program.upper.tolist(), strict=True) if top != np.inf)
    )


def is_recession(program: QuadraticProgram, G: list[Row], A: list[Row], d: Any) -> bool:
    """Return whether x + t d satisfies all constraints for t ≥ 0 where x does; exact."""
    return (
        not any(products(A, d))
        and all(value <= 0 for value, h in zip(products(G, d), program.h.tolist(), strict=True) if h != np.inf)
        and all(entry >= 0 for entry, low in zip(d, program.lower.tolist(), strict=True) if low != -np.inf)
        and all(entry <= 0 for entry, top in zip(d, program.upper.tolist(), strict=True) if top != np.inf)
    )


def is_rounding(program: QuadraticProgram, curvature: Vector, d: Any) -> bool:
    """Return whether P d is within n ε √p_ii Σ_j √p_jj |d_j|, the rounding of a P = F Fᵀ."""
    root = np.sqrt(np.maximum(program.P.diagonal(), 0.0))
    size = float(root @ np.abs(np.array([float(entry) for entry in d])))
    margin = program.n * EPSILON * size * root
    return all(abs(float(p)) <= limit for p, limit in zip(curvature, margin.tolist(), strict=True))
