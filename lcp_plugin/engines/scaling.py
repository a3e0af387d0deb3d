"""Scaling of a program for an engine: unknowns, rows and objective; very large right-hand sides become ∞.

Scaling is needed because the tolerances of engines are relative to sizes that they take from the data. All scaling is
by powers of two. It affects only the search: the point is tested on the unscaled program.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from ..core.checks import Array, Vector
from ..core.entries import largest_in_rows, scale_by
from .engine import EnginePoint, ProgramData

FORBIDDING = 1e14  # times the lower quartile of all costs: larger costs forbid x_j off its bound
MODEST = 2.0**-30  # costs between this and its inverse are left unchanged


class ScaledProgram(NamedTuple):
    """Scaled program and the scale factors that recover the unscaled point.

    Attributes
    ----------
    statement : ProgramData
    units : array, shape (n,)
        x = units · x of the statement.
    rows : array, shape (m + p,)
        Factors of the rows of G and A.
    objective : float
        Factor of the objective.
    """

    statement: ProgramData
    units: Vector
    rows: Vector
    objective: float

    @classmethod
    def from_units(
        cls, program: ProgramData, units: Vector, rows: Vector, objective: float = 1.0
    ) -> ScaledProgram:
        """Return the program scaled by these powers of two."""
        factors_G, factors_A = np.split(rows, [program.h.size])
        statement = ProgramData(
            scale_by(program.P, units * objective, units),
            program.c * units * objective,
            scale_by(program.G, factors_G, units),
            program.h * factors_G,
            scale_by(program.A, factors_A, units),
            program.b * factors_A,
            program.lower / units,
            program.upper / units,
        )
        return cls(statement, units, rows, objective)

    def with_modest_costs(self) -> ScaledProgram:
        """Return the program with its objective divided by a power of two if it is very large or very small."""
        P, c = self.statement.P, self.statement.c
        size = max(float(abs(c).max(initial=0.0)), float(abs(P).max()) if P.size else 0.0)
        if MODEST < size < 1.0 / MODEST:
            return self
        unit = float(_power_below(size))
        statement = self.statement._replace(P=P / unit, c=c / unit)
        return self._replace(statement=statement, objective=self.objective / unit)

    def outward(self, point: EnginePoint) -> EnginePoint:
        """Return the unscaled point."""
        return point._replace(x=point.x * self.units, y=point.y * (self.rows / self.objective))


def scale_program(program: ProgramData, units: Vector) -> ScaledProgram:
    """Return the scaled program: x in these units, largest coefficient of each row from 1 to 2, costs about 1."""
    scaled = [scale_by(A, np.ones(A.shape[0]), units) for A in (program.G, program.A)]
    rows = 1.0 / _power_below(np.concatenate([largest_in_rows(A) for A in scaled]))
    costs = np.append(np.abs(program.c * units), largest_in_rows(scale_by(program.P, units, units)))
    objective = float(1.0 / _power_below(costs.max(initial=0.0)))
    return ScaledProgram.from_units(program, units, rows, objective)


def _power_below(sizes: Array) -> Any:
    """Return the power of two below each size, 1 below 0."""
    return np.where(sizes > 0.0, np.ldexp(1.0, np.frexp(sizes)[1] - 1), 1.0)


def with_sides_about_one(fitted: ScaledProgram) -> ScaledProgram:
    """Return the program scaled so that most right-hand sides and most costs are at most about 1."""
    statement = fitted.statement
    t = _typical_size(statement.h, statement.b, statement.lower, statement.upper)
    units, rows, objective = fitted.units * t, fitted.rows / t, 1.0 / _typical_size(statement.c * t)
    scaled = ScaledProgram.from_units(
        statement, units / fitted.units, rows / fitted.rows, objective
    ).statement
    return ScaledProgram(scaled, units, rows, fitted.objective * objective)


def without_forbidden(program: ProgramData) -> ProgramData:
    """Return the program with x_j fixed at the bound to which an extreme cost pushes it; the same object if none is.

    People forbid x_j > 0 by a cost of 10²⁰ or more, next to which the other costs are rounding errors.

    Examples
    --------
    >>> none, bounds = (np.zeros((0, 2)), np.zeros(0)), (np.zeros(2), np.full(2, np.inf))
    >>> program = ProgramData(np.zeros((2, 2)), np.array([1.0, 1e36]), *none, *none, *bounds)
    >>> without_forbidden(program).upper
    array([inf,  0.])
    """
    costs = np.abs(program.c)
    known = costs[costs > 0.0]
    if not known.size or known.max() <= FORBIDDING * known.min():
        return program
    typical = float(np.quantile(known, 0.25, method="lower"))
    end = np.where(program.c > 0.0, program.lower, program.upper)
    far = (costs > FORBIDDING * typical) & np.isfinite(end)
    if not far.any():
        return program
    lower, upper = (np.where(far, end, bound) for bound in (program.lower, program.upper))
    return program._replace(c=np.where(far, 0.0, program.c), lower=lower, upper=upper)


def without_far_limits(program: ProgramData) -> ProgramData:
    """Return the program with ∞ for right-hand sides and bounds of extreme size; the same object if there are none.

    Examples
    --------
    >>> none = np.zeros((0, 1))
    >>> bounds = np.array([-1e19]), np.array([3.0])
    >>> without_far_limits(
    ...     ProgramData(np.eye(1), np.ones(1), none, np.zeros(0), np.ones((1, 1)), np.ones(1), *bounds)
    ... ).lower
    array([-inf])
    """
    known = np.abs(np.concatenate([program.h, program.b, program.lower, program.upper]))
    known = known[np.isfinite(known) & (known > 0.0)]
    # Right-hand sides larger than 10⁷ times the lower quartile are unlikely to be active
    far = 1e7 * max(1.0, float(np.quantile(known, 0.25))) if known.size else np.inf
    is_fixed = program.lower == program.upper
    h = np.where(program.h >= far, np.inf, program.h)
    lower = np.where((program.lower <= -far) & ~is_fixed, -np.inf, program.lower)
    upper = np.where((program.upper >= far) & ~is_fixed, np.inf, program.upper)
    if all(map(np.array_equal, (h, lower, upper), (program.h, program.lower, program.upper))):
        return program
    return program._replace(h=h, lower=lower, upper=upper)


def _typical_size(*values: Vector) -> float:
    """Return the power of two near the size that most of the values do not exceed; 1 if all are 0 or infinite."""
    sizes = np.abs(np.concatenate(values))
    sizes = sizes[np.isfinite(sizes) & (sizes > 0.0)]
    # Nine tenths of the sizes become at most about 1
    return float(np.exp2(np.round(np.log2(np.quantile(sizes, 0.9))))) if sizes.size else 1.0
