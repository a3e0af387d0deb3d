"""The rows of a problem that fail the stopping criterion at a point, the worst first, with their names and values."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from ..core.names import Names
from .lcp import Measured

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

    @property
    def quotient(self) -> float:
        """The violation divided by the terms; 0 for 0/0."""
        return self.violation / self.terms if self.violation else 0.0


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
    data: Any, measured: Measured, names: Names, tolerance: float, count: int
) -> WorstRows:
    """Return the rows of a measured point that fail the criterion at a tolerance, the worst first.

    Parameters
    ----------
    data : RowData
        Data of the criterion of one problem.
    measured : Measured
        With its rows.
    names : Names
    tolerance : float
    count : int
    """
    n, at, by_row = data.q.size, measured.rows, measured.by_row
    measured = measured._replace(z=np.reshape(measured.z, data.q.shape))
    # a sum that cancels is printed exactly
    if (sharp := data.sharp_product(measured.z)) is not None:
        at = data.rows(measured.z, sharp[0])
    is_cone = getattr(data, "is_cone", False)  # such rows have no bounds
    lower, upper = (np.ravel(np.where(is_cone, np.nan, x)) for x in (data.lower, data.upper))
    parts = measured.z, at.w, at.terms, at.violation, by_row.relative, by_row.componentwise
    z, w, terms, violation, relative, term_residual = (
        np.broadcast_to(np.ravel(values), (n,)) for values in parts
    )
    least = np.maximum(np.where(violation == 0.0, 0.0, relative), term_residual)
    least = np.where(np.isnan(least), math.inf, least)
    order = np.lexsort((-violation, -least))[:count]
    columns = [x[order].tolist() for x in (least, violation, terms, z, w, lower, upper)]
    return WorstRows(
        WorstRow(names.row(i), residual, missed, size, pair_text(names, i, *pair))
        for i, residual, missed, size, *pair in zip(order.tolist(), *columns, strict=True)
        if residual > tolerance
    )


def pair_text(names: Names, i: int, z: float, w: float, lower: float, upper: float) -> str:
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
