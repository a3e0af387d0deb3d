"""A point and how good it is: the result of the measure of each problem class."""

from __future__ import annotations

from typing import Any, NamedTuple


class Measured(NamedTuple):
    """Point, or stack of points, and its measure by the stopping criterion.

    Attributes
    ----------
    z : array
        The measured point, of the shape that its problem class uses.
    residual : float, or array with a number per point
        Number that a run compares, the smaller the better: the relative residual.
    passes : bool, or array of bool
        Whether the point is SOLVED.
    is_limited : bool, or array of bool
        Whether the point does not pass because of rounding only: PRECISION_LIMIT.
    terms : float or array
        The least tolerance at which every row passes the componentwise test.
    rows : RowsAtPoint or None
        The values of the rows at z.
    """

    z: Any
    residual: Any
    passes: Any
    is_limited: Any = False
    terms: Any = 0.0
    rows: Any = None
