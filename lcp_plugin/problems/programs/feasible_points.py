"""Points that are proved to satisfy all constraints of a program, near a point that nearly does.

Without equations a point is moved off the rows that are tight, by least squares, and every row evaluated with its
rounding. In small programs the equations and the rows that are tight are solved in rational arithmetic; where that
leaves a row violated, the point is moved towards one that a linear program finds inside, and checked again.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from fractions import Fraction
from functools import cached_property

import numpy as np
import scipy.sparse as sp

from ...core.checks import FloatVector
from ...core.deadline import is_over
from ...core.rounding import compensated_pair, compensated_product, upper_end
from ...proofs.exact.linear_systems import solved_nearby
from ...proofs.exact.rational import Vector, enclosures, product_above, products, rational, sum_above
from .dual_bounds import ROOMS, least_squares
from .program import QuadraticProgram
from .qp_certificates import feasible_point
from .qp_proofs import losses

TIGHT = (0.0, 1e-9, 1e-6, -np.inf)  # of a row's unit: rows that are solved for as if they were equations; then none
EXACT_UP_TO = 100  # rows that are solved for in .4 s; 1.7 s are needed for 200
SMALL = 2000  # variables and rows of a program whose points are checked in fractions: a second
NEAR = 1e-9  # of a row's unit: rows that a point is moved off


@dataclass(frozen=True, eq=False)
class FeasiblePoint:
    """A point that satisfies all constraints, in doubles and how far these may be from it.

    Attributes
    ----------
    near : ndarray, shape (n,)
    radius : ndarray, shape (n,)
        0 where the point is `near` itself.
    value : float
        A double above its objective.
    """

    near: FloatVector
    radius: FloatVector
    value: float

    @classmethod
    def of(cls, program: QuadraticProgram, low: FloatVector, high: FloatVector) -> FeasiblePoint:
        """Return the point that lies between two vectors of doubles."""
        radius = np.maximum(sum_above(high, -low), 0.0)
        return cls(low, radius, objective_bounds(program, low, radius)[1])


@dataclass(frozen=True, eq=False)
class FeasiblePoints:
    """A program, and the search for points that are proved to be feasible."""

    program: QuadraticProgram = field(repr=False)

    def near(self, x: FloatVector) -> FeasiblePoint | None:
        """Return a feasible point near x, x itself where it is one; None where none could be proved."""
        constraints = self.program.constraints
        if not (constraints.excess(x) > 0.0).any():
            return FeasiblePoint.of(self.program, x, x)
        for room in ROOMS if not constraints.is_equality.any() else ():
            moved = self._moved_off(x, room)
            if not (constraints.excess(moved) > 0.0).any():
                return FeasiblePoint.of(self.program, moved, moved)
        if not self.is_small:
            return None
        for tight in TIGHT:
            if is_over():
                break
            exact = self._solved(x, tight)
            if exact is not None:
                return FeasiblePoint.of(self.program, *enclosures(exact))
        return None

    @cached_property
    def inside(self) -> Vector | None:
        """A feasible point in fractions, as far inside as a linear program finds one."""
        return feasible_point(self.program) if self.is_small else None

    @property
    def is_small(self) -> bool:
        """Whether rational arithmetic is tried."""
        return self.program.b.size <= EXACT_UP_TO and self.program.n + self.program.constraints.rows <= SMALL

    def _moved_off(self, x: FloatVector, room: float) -> FloatVector:
        """Return the nearest point that leaves some room in the rows and bounds that x nearly meets, to rounding."""
        rows, x = self.program.constraints, np.clip(x, self.program.lower, self.program.upper)
        is_row = np.arange(rows.limit.size) < rows.rows
        with np.errstate(invalid="ignore"):
            value = rows.matrix @ x - rows.limit
        tight = np.flatnonzero(is_row & (value > -NEAR * rows.unit))
        at_bound = (x <= self.program.lower) | (x >= self.program.upper)
        free = np.flatnonzero(~at_bound)
        right = np.minimum(-value - room * rows.unit, 0.0)[tight]
        moved = x.copy()
        moved[free] += least_squares(rows.matrix[tight][:, free], right)
        return np.clip(moved, self.program.lower, self.program.upper)

    def _solved(self, x: FloatVector, tight: float) -> Vector | None:
        """Return a feasible point at which the rows that x nearly meets hold with equality, or one beside it."""
        program, rows = self.program, self.program.constraints
        value = (rows.matrix @ x - rows.limit) / rows.unit
        is_row = np.arange(rows.limit.size) < rows.rows
        x = np.clip(x, program.lower, program.upper)
        low, high = rows.split(rows.unit)[2:]
        near_bound = max(tight, 0.0)
        is_low = x - program.lower <= near_bound * low
        is_fixed = is_low | (program.upper - x <= near_bound * high)
        near = np.where(is_low, program.lower, np.where(is_fixed, program.upper, x))
        system = np.flatnonzero(is_row & np.isfinite(rows.limit) & (rows.is_equality | (value >= -tight)))
        if system.size > EXACT_UP_TO:
            return None
        guess = rational(near)
        exact = solved_nearby(
            [rows.exactly[i] for i in system.tolist()], rational(rows.limit[system]), guess, (~is_fixed).tolist()
        )
        if exact is None:
            return None
        return exact if not any(losses(rows, exact)) else self._moved_inside(exact)

    def _moved_inside(self, x: Vector) -> Vector | None:
        """Return the nearest feasible point between x, which satisfies the equations, and the one inside."""
        rows, inside = self.program.constraints, self.inside
        if inside is None:
            return None
        share = Fraction(0)
        values = zip(
            products(rows.exactly, x), products(rows.exactly, inside), rows.limit.tolist(), rows.is_equality.tolist(),
            strict=True,
        )
        for here, there, limit, is_equality in values:
            if is_equality or limit == math.inf or here <= Fraction(limit):
                continue
            if there >= Fraction(limit):
                return None
            share = max(share, (here - Fraction(limit)) / (here - there))
        # Few digits more, so that the numbers stay short.
        share = min(Fraction(math.nextafter(float(share) * (1.0 + 2.0**-40), 2.0)), Fraction(1))
        moved = [a + share * (b - a) for a, b in zip(x, inside, strict=True)]
        return moved if not any(losses(rows, moved)) else None


def objective_bounds(
    program: QuadraticProgram, x: FloatVector, radius: FloatVector | None = None
) -> tuple[float, float]:
    """Return doubles below and above ½ xᵀP x + cᵀx, and above it for all points within the radius of x."""
    with np.errstate(all="ignore"):
        high, low, blur = compensated_pair(sp.csr_array(program.P), x)
        row = sp.csr_array(np.concatenate([x, x, 2.0 * program.c])[None, :])
        twice, error = compensated_product(row, np.concatenate([high, low, x]))
        error = sum_above(error, product_above(np.abs(x), blur).sum() * (1.0 + 2.0**-30))
        lowest, highest = -0.5 * float(upper_end(-twice, error)[0]), 0.5 * float(upper_end(twice, error)[0])
        if radius is not None and radius.any():
            # |∇f| r + ½ rᵀ|P| r, where r is some units in the last place.
            slope = sum_above(sum_above(np.abs(high + program.c), np.abs(low)), blur)
            bent = 0.5 * (abs(sp.csr_array(program.P)) @ radius)
            spread = product_above(sum_above(slope, bent), radius).sum() * (1.0 + 2.0**-30)
            highest = float(sum_above(highest, spread))
    return math.nextafter(lowest, -math.inf), math.nextafter(highest, math.inf)
