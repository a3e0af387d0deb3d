"""Residuals of a point z, functions of only the user's (M, q, lower, upper) and z, and its worst rows by name."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ..checks import Vector, checked_vector, derived_property, read_only, restore_state
from ..errors import InvalidProblem
from ..lcp import LCP
from ..names import Names
from ..problem_classes import refusal
from ..rounding import gamma
from .criterion import (
    Measured,
    RowData,
    RowResiduals,
    RowsAtPoint,
    VectorEnds,
    find_rounding_rows,
    row_data,
    scaled_residual,
)

PRECISE = 1e-12  # tolerance at which rounding errors of the relative residual count


@dataclass(frozen=True, eq=False)
class Certificate:
    """Residuals of z as a solution of the problem, computed only from the problem's data and z.

    The relative, natural and euclidean residuals are upper bounds of the exact ones: rounding errors are included. The
    other numbers are measured in double precision. A slack at the rounding level of its row may count as 0.

    Attributes
    ----------
    problem : LCP
        The problem on which z was measured.
    z : ndarray, shape (n,)

    Examples
    --------
    >>> problem = LCP([[2, 1], [1, 2]], [-5, 1])
    >>> Certificate.of(problem, [2.5, 0]).relative_residual < 1e-14
    True
    >>> Certificate.of(problem, [2.5, 0.5]).worst_index
    1
    """

    problem: LCP = field(repr=False)
    z: Vector = field(repr=False)

    __setstate__ = restore_state

    @classmethod
    def of(cls, problem: LCP, z: ArrayLike) -> Certificate:
        """Return the certificate of z, shape (n,), for the problem.

        Raises
        ------
        InvalidProblem
            If z is not a real vector of length n. NaN and infinities are accepted.
        """
        if not isinstance(problem, LCP):
            raise InvalidProblem(refusal("Certificate.of", problem))
        if type(z) is not np.ndarray or z.dtype != np.float64 or z.shape != (problem.n,):
            z = checked_vector(z, "z", problem.n, is_finite=False)
        else:
            z = read_only(z.copy())
        return cls(problem, z)

    @classmethod
    def at(cls, problem: LCP, z: Vector, **known: Any) -> Certificate:
        """Return the certificate of z, read-only; `known` are its properties `criterion` and `rows`, or None."""
        certificate = cls(problem, z)
        vars(certificate).update({name: one for name, one in known.items() if one is not None})
        return certificate

    @derived_property
    def criterion(self) -> RowData:
        """The data of the criterion."""
        return row_data(self.problem)

    @derived_property
    def rows(self) -> RowsAtPoint:
        """Values of all rows at z."""
        return self.criterion.rows(self.z)

    @derived_property
    def by_row(self) -> RowResiduals:
        """Residuals of all rows, by sums in twice the precision if rounding makes the largest one uncertain."""
        return self.criterion.residuals_at(self.z, self.rows, PRECISE)

    @derived_property
    def w(self) -> Vector:
        """The slack M z + q in double precision, shape (n,), read-only."""
        return read_only(self.rows.w)

    @derived_property
    def worst_index(self) -> int:
        """The row of the largest residual relative to the reference of its component; −1 for an empty problem."""
        residual = relative = np.abs(scaled_residual(self.problem, self.z, self.w))
        if self.by_row.reference.size > 1:  # the component with the largest relative residual
            relative = np.where(np.isfinite(residual), self.by_row.relative, np.nan)
        return int(np.argmax(relative)) if relative.size else -1  # argmax stops at the first NaN

    @derived_property
    def scaled_residual(self) -> float:
        """‖r(z)‖∞ of the worst component, in the unit of z, as measured in double precision."""
        residual = np.abs(scaled_residual(self.problem, self.z, self.w))
        return float(residual[self.worst_index]) if residual.size else 0.0

    @property
    def relative_residual(self) -> float:
        """The largest ‖r_P(z)‖∞ / ref_P of all components, rounded upwards; 0 for 0/0."""
        return float(self.by_row.relative.max(initial=0.0))

    @derived_property
    def term_residuals(self) -> Vector:
        """The least tolerance at which each row passes the componentwise test, shape (n,)."""
        return self.criterion.term_residuals(self.rows)

    @property
    def term_residual(self) -> float:
        """The least tolerance at which every row passes the componentwise test."""
        return float(self.term_residuals.max(initial=0.0))

    @derived_property
    def _natural(self) -> Vector:
        """An upper bound of every |z − mid(lower, upper, z − w)|."""
        at = self.rows
        return self.criterion.residual_ends(self.z, at.w, at.rounding, np.ones(self.z.size))[1]

    @derived_property
    def natural_residual(self) -> float:
        """‖z − mid(lower, upper, z − w)‖∞."""
        return float(self._natural.max(initial=0.0))

    @derived_property
    def euclidean_residual(self) -> float:
        """‖z − mid(lower, upper, z − w)‖₂, rounded upwards, without overflow."""
        largest = self.natural_residual
        if not 0.0 < largest < np.inf:
            return largest
        norm = largest * float(np.linalg.norm(self._natural / largest))
        return float(np.nextafter(norm * (1.0 + gamma(self.problem.n + 8)), np.inf))

    @derived_property
    def bound_violation(self) -> float:
        """max_i of lower_i − z_i, z_i − upper_i and 0."""
        problem = self.problem
        outside = np.maximum(problem.lower - self.z, self.z - problem.upper)
        return float(outside.max(initial=0.0))

    @derived_property
    def products(self) -> VectorEnds:
        """The (z_i − lower_i) w_i⁺ and the (upper_i − z_i) w_i⁻, 0 for an infinite bound, shape (n,) each."""
        problem = self.problem
        above = np.where(np.isfinite(problem.lower), self.z - problem.lower, 0.0)
        below = np.where(np.isfinite(problem.upper), problem.upper - self.z, 0.0)
        return above * np.maximum(self.w, 0.0), below * np.maximum(-self.w, 0.0)

    @derived_property
    def complementarity(self) -> float:
        """max_i of (z_i − lower_i) w_i⁺ and (upper_i − z_i) w_i⁻ over the finite bounds."""
        return float(np.abs(np.maximum(*self.products)).max(initial=0.0))

    @derived_property
    def rounding_floor(self) -> Vector:
        """Rounding bound of each residual: k_i ε (|M||z| + |q|)_i / d_i, shape (n,).

        k_i = nonzeros of row i + 2; a residual in double precision below this level is meaningless.
        """
        return self.criterion.rounding_floor(self.rows.terms)

    @derived_property
    def is_at_rounding_level(self) -> bool:
        """True if no row's residual exceeds four times its rounding floor."""
        return bool(find_rounding_rows(self.by_row[:2], self.rounding_floor).all())

    def __str__(self) -> str:
        lines = [
            ("relative residual", self.relative_residual),
            ("natural residual", self.natural_residual),
            ("bound violation", self.bound_violation),
            ("complementarity", self.complementarity),
            ("term residual", self.term_residual),
        ]
        return "\n".join(f"{name:<18} {value:.3e}" for name, value in lines)


SHOWN = 3  # rows that the explanation of a run shows


class WorstRow(NamedTuple):
    """Row of a problem at a point.

    Attributes
    ----------
    name : str
    residual : float
        Least tolerance at which the row passes the criterion; ∞ if none.
    violation : float
        Part of the row with the wrong sign, in the unit of the row.
    terms : float
        Sum of the sizes of the terms of the row.
    text : str
        Both sides of the pair, or the constraint, with their values.
    """

    name: str
    residual: float
    violation: float
    terms: float
    text: str


class WorstRows(tuple[WorstRow, ...]):
    """Rows that fail at a point, the worst first; ``print`` shows a line for each."""

    __slots__ = ()

    def __str__(self) -> str:
        lines = [f"{row.text} (terms {row.terms:.3g})" for row in self]
        return "\n".join(lines) or "no row fails"


def outside_row(name: str, value: float, bound: float) -> WorstRow:
    """Return the row of a value that violates its bound."""
    distance, terms = abs(value - bound), abs(value) + abs(bound)
    text = f"{name} = {value:.6g} is beyond its bound {bound:.6g}"
    return WorstRow(name, distance / terms, distance, terms, text)


def worst_pairs(
    data: Any, found: Measured, names: Names, tolerance: float, count: int
) -> WorstRows:
    """Return the rows of a measured point that fail the criterion at a tolerance, the worst first.

    Parameters
    ----------
    data : RowData
        Data of the criterion of one problem.
    found : Measured
        With its rows.
    names : Names
    tolerance : float
    count : int
    """
    n, at, by_row = data.q.size, found.rows, found.by_row
    found = found._replace(z=np.reshape(found.z, data.q.shape))
    if (sharp := data.sharp_product(found.z)) is not None:  # a sum that cancels is printed exactly
        at = data.rows(found.z, sharp[0])
    is_cone = getattr(data, "is_cone", False)  # such rows have no bounds of their own
    lower, upper = (
        np.ravel(np.where(is_cone, math.nan, bound)) for bound in (data.lower, data.upper)
    )
    z, w, terms, violation, relative, own = (
        np.broadcast_to(np.ravel(one), (n,))
        for one in (found.z, at.w, at.terms, at.violation, by_row.relative, by_row.terms)
    )
    least = np.maximum(np.where(violation == 0.0, 0.0, relative), own)
    least = np.where(np.isnan(least), math.inf, least)
    order = np.lexsort((-violation, -least))[:count].tolist()
    return WorstRows(
        WorstRow(
            names.row(i),
            float(least[i]),
            float(violation[i]),
            float(terms[i]),
            _sides(names, i, float(z[i]), float(w[i]), float(lower[i]), float(upper[i])),
        )
        for i in order
        if least[i] > tolerance
    )


def _sides(names: Names, i: int, z: float, w: float, lower: float, upper: float) -> str:
    """Return both sides of a pair with their values: the row, and the unknown next to the bound that it is off."""
    row, unknown = names.pair(i)
    if not math.isfinite(w):
        return f"{row} is {w} while {unknown} = {z:.6g}"
    if math.isnan(lower):
        return f"{row} = {w:.6g} while {unknown} = {z:.6g}, in a cone"
    if not lower <= z <= upper:
        return outside_row(names.unknown(i), z, lower if z < lower else upper).text
    if lower == -math.inf and upper == math.inf:
        return f"{names.row(i)} = {w:.6g}, and must be 0"
    bound, sign = (lower, ">") if w > 0.0 else (upper, "<")
    if math.isinf(bound):
        return f"{row} = {w:.6g} {sign} 0 while {unknown} = {z:.6g}"
    return f"{row} = {w:.6g} while {unknown} = {z:.6g} {sign} {bound:.6g}"
