"""A point and how good it is: the result of the measure of each problem class."""

from __future__ import annotations

from typing import Any, NamedTuple


class RowResiduals(NamedTuple):
    """Residuals of the rows at a point, arrays of shape (…, n).

    Attributes
    ----------
    low, high : array
        Bounds of |r_i|.
    reference : array
        A lower bound of ref_P, of the component of each row; it may have the shape (…, 1).
    relative : array
        The quotients of `high` and `reference`, 0 for 0/0 and within an absolute tolerance.
    terms : array
        The least tolerance at which the row passes the componentwise test, 0 within an absolute tolerance.
    worst : float, or array of shape (…)
        The largest of `relative`.
    """

    low: Any
    high: Any
    reference: Any
    relative: Any
    terms: Any
    worst: Any

    def fails(self, tolerance: float) -> Any:
        """Return the rows that do not pass the criterion at a tolerance, bool."""
        return ~((self.relative <= tolerance) & (self.terms <= tolerance))


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
    rows : RowsAtPoint or None
        The values of the rows at z.
    by_row : RowResiduals or None
    is_rejected : bool
        Whether both tests pass, but the problem's origin rejects the point.
    """

    z: Any
    residual: Any
    passes: Any
    is_limited: Any = False
    rows: Any = None
    by_row: Any = None
    is_rejected: bool = False
