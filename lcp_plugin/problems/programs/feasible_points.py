"""Points that are proved to satisfy all constraints of a program, near a point that nearly does.

Least squares move a point to the equalities and away from tight inequalities. Then every row is evaluated with a
rounding bound, and an approximate inverse proves that the equalities have a solution close by. If this proves no point
of a small program, a linear program finds an interior point, which is checked in rational arithmetic.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import scipy.sparse as sp

from ...core.checks import FloatVector
from ...core.matrix.matrix import largest_in_rows
from ...core.rounding import compensated_pair, compensated_product, gamma, upper_end
from ...proofs.exact.rational import Vector
from ...proofs.exact.upward import product_above, sum_above
from .dual_bounds import SLACKS, half_above, least_squares
from .no_minimum import feasible_point
from .program import QuadraticProgram

EXACT_UP_TO = 100  # rows that are solved for in .4 s; 1.7 s are needed for 200
SMALL = 2000  # variables and rows of a program whose points are checked in fractions: a second
NEAR = 1e-9  # of a row's size: rows that a point is moved off
DENSE_UP_TO = 4_000_000  # entries of equality rows that are treated as one dense matrix
MOST_BITS, TINY = 400, 1e-290  # of the unit of a row; above the underflow of a sum
OUTWARD = 1.0 + 2.0**-30  # above the rounding of a sum of nonnegative terms


@dataclass(frozen=True, eq=False)
class FeasiblePoint:
    """Point that satisfies all constraints, as an enclosure: doubles and their error bounds.

    Attributes
    ----------
    near : ndarray, shape (n,)
    radius : ndarray, shape (n,)
        Error bounds of `near`; 0 if the doubles are feasible.
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
    """Search for points of a program that are proved feasible."""

    program: QuadraticProgram = field(repr=False)

    def find_near(self, x: FloatVector) -> FeasiblePoint | None:
        """Return a feasible point near x (x itself if feasible); None if floating point proves no point."""
        if not (self.program.constraints.excess(x) > 0.0).any():
            return FeasiblePoint.of(self.program, x, x)
        points = (self._enclose(self._move_off(x, slack)) for slack in SLACKS)
        return next((point for point in points if point is not None), None)

    @cached_property
    def inside(self) -> Vector | None:
        """Feasible point in rational numbers, as far inside as a linear program finds; None for a large program."""
        program = self.program
        if program.b.size > EXACT_UP_TO or program.n + program.constraints.rows > SMALL:
            return None
        return feasible_point(program)

    def _move_off(self, x: FloatVector, slack: float) -> FloatVector:
        """Return the nearest point that satisfies the equalities to rounding, with some slack in tight inequalities."""
        rows, x = self.program.constraints, np.clip(x, self.program.lower, self.program.upper)
        is_row = np.arange(rows.limit.size) < rows.rows
        value, size = rows.matrix @ x - rows.limit, _sizes(self.program, x)
        tight = np.flatnonzero(is_row & (rows.is_equality | (value >= -NEAR * size)))
        at_bound = (x <= self.program.lower) | (x >= self.program.upper)
        free = np.flatnonzero(~at_bound)
        right = np.where(rows.is_equality, -value, np.minimum(-value - slack * size, 0.0))[tight]
        moved = x.copy()
        moved[free] += least_squares(rows.matrix[tight][:, free], right)
        return np.clip(moved, self.program.lower, self.program.upper)

    def _enclose(self, x: FloatVector) -> FeasiblePoint | None:
        """Return the point near x that satisfies the equalities; None if inequalities at x have too little slack."""
        program, rows = self.program, self.program.constraints
        excess = rows.excess(x)
        if not (excess > 0.0).any():
            return FeasiblePoint.of(program, x, x)
        m, is_equality = program.h.size, rows.is_equality
        radius = distance_of_equations(program, x, excess[m : m + program.b.size])
        if radius is None or (excess[~is_equality] > 0.0).any():
            return None
        others = abs(rows.matrix[np.flatnonzero(~is_equality)])
        spread = (
            others @ radius + np.where(others.astype(bool) @ (radius > 0.0), TINY, 0.0)
        ) * OUTWARD
        if not (sum_above(excess[~is_equality], spread) <= 0.0).all():
            return None
        return FeasiblePoint(x, radius, objective_bounds(program, x, radius)[1])


def _sizes(program: QuadraticProgram, x: FloatVector) -> FloatVector:
    """Return estimates of the largest term of each row near x; they only guide the search for a point."""
    rows = program.constraints
    limit = np.where(np.isfinite(rows.limit), np.abs(rows.limit), 0.0)
    return np.asarray(limit + largest_in_rows(rows.matrix) * np.abs(x).max(initial=0.0))


def distance_of_equations(
    program: QuadraticProgram, x: FloatVector, excess: FloatVector
) -> FloatVector | None:
    """Return a componentwise bound of the distance from x to a solution of A x = b; None if none is proved.

    Only variables between their bounds move.

    Parameters
    ----------
    excess : array, shape (rows of A,)
        Upper bounds of |A x − b|.

    Notes
    -----
    With B the free columns of A, rows scaled by powers of two, x + Bᵀu is a solution if B Bᵀu = r, r = b − A x. If
    ‖I − R B Bᵀ‖∞ ≤ α < 1 for an approximate inverse R, rounding included, there is one with ‖u‖∞ ≤ ‖|R||r|‖∞/(1 − α).
    """
    free = np.flatnonzero((program.lower < x) & (x < program.upper))
    B, radius = sp.csr_array(program.A)[:, free], np.zeros(x.size)
    p, n = B.shape
    if max(p * n, p * p) > DENSE_UP_TO:
        return None
    B = B.toarray()
    _, exponent = np.frexp(np.abs(B).max(axis=1, initial=0.0))
    if (np.abs(exponent) > MOST_BITS).any() or not np.isfinite(excess).all():
        return None
    B, r = np.ldexp(B, -exponent[:, None]), np.ldexp(excess, -exponent)
    product, sizes = B @ B.T, np.abs(B) @ np.abs(B).T
    try:
        R = np.linalg.inv(product)
    except np.linalg.LinAlgError:
        return None
    left = np.abs(np.eye(p) - R @ product) + gamma(p + 3) * (np.abs(R) @ np.abs(product) + 1.0)
    left += gamma(n + 3) * (np.abs(R) @ sizes) + TINY * (1.0 + np.abs(R).sum())
    alpha = float(left.sum(axis=1).max(initial=0.0)) * OUTWARD
    if not alpha <= 0.5:
        return None
    largest = float((np.abs(R) @ r).max(initial=0.0)) * OUTWARD / (1.0 - alpha) + TINY
    radius[free] = (np.abs(B).sum(axis=0) * largest + TINY) * OUTWARD
    return radius


def objective_bounds(
    program: QuadraticProgram,
    x: FloatVector,
    radius: FloatVector | None = None,
    *,
    linear: float = 1.0,
) -> tuple[float, float]:
    """Return doubles below and above ½ xᵀP x + linear · cᵀx, and above it for all points within the radius of x."""
    high, low, blur = compensated_pair(program.matrices.sparse_P, x)
    row = sp.csr_array(np.concatenate([x, x, 2.0 * linear * program.c])[None, :])
    twice, error = compensated_product(row, np.concatenate([high, low, x]))
    error = sum_above(error, product_above(np.abs(x), blur).sum() * (1.0 + 2.0**-30))
    lowest, highest = (
        -half_above(upper_end(-twice, error)[0]),
        half_above(upper_end(twice, error)[0]),
    )
    if radius is not None and radius.any():
        # |∇f| r + ½ rᵀ|P| r, where r is some units in the last place.
        slope = sum_above(sum_above(np.abs(high + program.c), np.abs(low)), blur)
        bent = 0.5 * (abs(program.matrices.sparse_P) @ radius)
        spread = product_above(sum_above(slope, bent), radius).sum() * (1.0 + 2.0**-30)
        highest = float(sum_above(highest, spread))
    return lowest, highest
