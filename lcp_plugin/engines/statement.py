"""What an engine is given of a program: rows of one size, if need be in other units, without limits that are far away.

Engines stop by tolerances of their own, beside sizes that they take from the data. So each row is divided by the power
of two below its largest coefficient, if that is not from ½ to 2; where that does not lead to an answer, unknowns are
measured in other units, and limits far beyond the others, which mostly stand for "none", are left out. All are ways to
a point and nothing else: it is judged on the program as it was given, and a limit that it breaks is put back.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp

from ..core.checks import BoolVector, FloatVector, assembled
from ..core.matrix.matrix import largest_entry, largest_in_rows
from .engine import Multipliers, Point, Statement

FAR = 1e3  # times the largest of all smaller limits


class Prepared(NamedTuple):
    """A statement made ready, and the way back to the one that was given.

    Attributes
    ----------
    statement : Statement
    rows : array of int or slice
        The rows of the given G that are among its own.
    of_inequalities, of_equations : array
        What each given row was divided by.
    unit : array or None, shape (n,)
        What x is measured in; None for the given unit.
    objective : float
        What the objective was divided by. All are powers of two.
    """

    statement: Statement
    rows: Any
    of_inequalities: FloatVector
    of_equations: FloatVector
    unit: FloatVector | None
    objective: float

    @classmethod
    def of(
        cls,
        given: Statement,
        is_left_out: BoolVector | None = None,
        unit: FloatVector | None = None,
    ) -> Prepared:
        """Return that of a statement in these units, without these of its limits, of rows and bounds, (m + 2n,).

        Of what overflows, which the caller lets pass, an engine makes nothing.
        """
        m, n, objective = given.h.size, given.c.size, 1.0
        P, c, G, A, lower, upper = given.P, given.c, given.G, given.A, given.lower, given.upper
        is_row = np.isfinite(given.h)
        if is_left_out is not None:
            is_row &= ~is_left_out[:m]
            lower = np.where(is_left_out[m : m + n], -np.inf, lower)
            upper = np.where(is_left_out[m + n :], np.inf, upper)
        if unit is not None:
            G, A, c, lower, upper = (
                _columns(G, unit),
                _columns(A, unit),
                c * unit,
                lower / unit,
                upper / unit,
            )
            P = _columns(_divided(P, 1.0 / unit), unit)
            objective = _power_below(np.array([max(largest_entry(c), largest_entry(P))]))[0]
            P, c = P / objective, c / objective
        of_inequalities, of_equations = (
            _power_below(largest_in_rows(one)) if one.shape[0] else np.zeros(0) for one in (G, A)
        )
        rows = slice(None) if is_row.all() else np.flatnonzero(is_row)
        size = of_inequalities[rows]
        statement = Statement(
            P,
            c,
            _divided(G[rows] if isinstance(rows, np.ndarray) else G, size),
            given.h[rows] / size,
            _divided(A, of_equations),
            given.b / of_equations,
            lower,
            upper,
        )
        return cls(statement, rows, of_inequalities, of_equations, unit, objective)

    def outward(self, point: Point) -> Point:
        """Return the point in the given units, with multipliers of the given rows."""
        (of_G, of_A, lower, upper), x = point.multipliers, point.x
        if self.unit is not None:
            x, of_G, of_A = x * self.unit, of_G * self.objective, of_A * self.objective
            lower, upper = lower * self.objective / self.unit, upper * self.objective / self.unit
        inequality = np.zeros(self.of_inequalities.size)
        inequality[self.rows] = of_G / self.of_inequalities[self.rows]
        multipliers = Multipliers(
            inequality, of_A / self.of_equations if of_A.size else of_A, lower, upper
        )
        return Point(x, multipliers, point.iterations, point.says)

    def inward(self, point: Point) -> Point:
        """Return a point of the given statement as one of this, in its units: the way back of `outward`."""
        inequality, equality, *of_bounds = point.multipliers
        inequality = (inequality * self.of_inequalities)[self.rows]
        return point._replace(
            multipliers=Multipliers(inequality, equality * self.of_equations, *of_bounds)
        )


def far_limits(given: Statement) -> BoolVector:
    """Return which limits of rows, lower and upper bounds are far beyond all others, shape (m + 2n,).

    Those above the last gap of a factor `FAR`, in units of each row's largest coefficient.

    Examples
    --------
    >>> none = np.zeros((0, 1))
    >>> bounds = np.array([-1e19]), np.array([3.0])
    >>> far_limits(Statement(np.eye(1), np.ones(1), none, np.zeros(0), np.ones((1, 1)), np.ones(1), *bounds)).tolist()
    [True, False]
    """
    of_rows = np.abs(given.h) / _power_below(largest_in_rows(given.G))
    limits = np.concatenate([of_rows, np.abs(given.lower), np.abs(given.upper)])
    known = np.concatenate([limits, np.abs(given.b) / _power_below(largest_in_rows(given.A))])
    sizes = np.sort(known[np.isfinite(known) & (known > 0.0)])
    gaps = np.flatnonzero(sizes[1:] > FAR * sizes[:-1])
    is_far: BoolVector = np.isfinite(limits) & (limits > (sizes[gaps[-1]] if gaps.size else np.inf))
    return is_far


def _power_below(sizes: FloatVector) -> FloatVector:
    """Return the power of two below each size; 1 from ½ to 2, and for 0, which leaves an array as it is."""
    return np.where(
        (sizes >= 0.5) & (sizes <= 2.0) | (sizes == 0.0), 1.0, np.ldexp(1.0, np.frexp(sizes)[1] - 1)
    )


def _divided(A: Any, sizes: FloatVector) -> Any:
    """Return A with its rows divided by these."""
    if (sizes == 1.0).all():
        return A
    if isinstance(A, np.ndarray):
        return A / sizes[:, np.newaxis]
    return assembled(A.data / np.repeat(sizes, np.diff(A.indptr)), A.indices, A.indptr, A.shape)


def _columns(A: Any, sizes: FloatVector) -> Any:
    """Return A with its columns multiplied by these."""
    if not sp.issparse(A):
        return A * sizes
    return assembled(A.data * sizes[A.indices], A.indices, A.indptr, A.shape)


__all__ = ["FAR", "Prepared", "far_limits"]
