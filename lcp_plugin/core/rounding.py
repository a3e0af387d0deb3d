"""Sums of products with rigorous bounds of their rounding errors.

Each row is summed by the method of Ogita, Rump and Oishi. Every product and every sum is split without error into a
rounded value and its rounding error (for a product, one fused multiply–add), and the errors are summed separately. A
second layer treats the sum of errors in the same way, so that the loss is computed, not estimated: it is zero if the
sum is exact, and of third order otherwise.

References
----------
T. Ogita, S. M. Rump, S. Oishi, *Accurate sum and dot product*, SIAM J. Sci. Comput. 26 (2005),
doi:10.1137/030601818.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from .checks import FloatVector
from .errors import InvalidProblem
from .kernels.floats import UNIT

Sums = tuple[FloatVector, FloatVector, FloatVector]


def gamma(terms: int) -> float:
    """Return an upper bound of k u/(1 − k u), u = 2⁻⁵³: the relative error of k rounded operations in a row.

    Examples
    --------
    >>> gamma(4) > 4 * UNIT
    True
    """
    if terms >= 2**52:
        return np.inf
    return float(np.nextafter(terms * UNIT / (1.0 - terms * UNIT), np.inf)) * (1.0 + 4.0 * UNIT)


def compensated_product(
    M: Any, x: FloatVector, q: FloatVector | None = None
) -> tuple[FloatVector, FloatVector]:
    """Return (value, radius) with |M x + q − value| ≤ radius, each of shape (m,).

    Parameters
    ----------
    M : CSR array, shape (m, n)
    x : array, shape (n,)
    q : array, shape (m,), optional

    Returns
    -------
    value, radius : arrays, shape (m,)
        `value` is M x + q rounded once or nearly so; `radius` is 0 if the value is exact, ∞ if the row overflows or is
        not finite.

    Raises
    ------
    InvalidProblem
        If the shapes do not fit.

    Examples
    --------
    >>> import scipy.sparse as sp
    >>> M = sp.csr_array(np.array([[1e16, 1.0, -1e16], [0.1, 0.2, 0.3]]))
    >>> value, radius = compensated_product(M, np.ones(3))
    >>> float(value[0]), float(radius[0])
    (1.0, 0.0)
    >>> bool(0.0 < radius[1] < 1e-16)
    True
    """
    return round_sums(*compensated_pair(M, x, q))


def compensated_pair(
    M: Any, x: FloatVector, q: FloatVector | None = None, *, kernel: Any = None
) -> Sums:
    """Return (high, low, radius) with |M x + q − (high + low)| ≤ radius, the sum not evaluated.

    `high` is the rounded value and `low` its rounding error; the radius is of order u² |M||x| at most. Parameters and
    errors as for :func:`compensated_product`. Pass another `kernel` to sum other rows than the rows of M.

    Examples
    --------
    >>> import scipy.sparse as sp
    >>> high, low, radius = compensated_pair(sp.csr_array(np.array([[1.0, 1.0]])), np.array([1.0, 1e-20]))
    >>> float(high[0]), float(low[0]), float(radius[0])
    (1.0, 1e-20, 0.0)
    """
    from .kernels.enclosures import row_sums  # numba, which not every run needs

    rows, columns = M.shape
    x = np.ascontiguousarray(x, dtype=np.float64)
    offset = np.zeros(rows) if q is None else np.ascontiguousarray(q, dtype=np.float64)
    if x.shape != (columns,) or offset.shape != (rows,):
        raise InvalidProblem(
            f"a product with a {rows}×{columns} matrix needs x of shape ({columns},) and q of shape ({rows},); "
            f"got {x.shape} and {offset.shape}"
        )
    high, low, radius = np.empty(rows), np.empty(rows), np.empty(rows)
    (kernel or row_sums)(
        *read_only_views(M.indptr, M.indices, M.data, x, offset), high, low, radius
    )
    return high, low, radius


def lower_end(value: FloatVector, radius: FloatVector) -> FloatVector:
    """Return a lower bound of value − radius, exact where the radius is 0, and −∞ where either is not finite."""
    return -upper_end(-value, radius)


def upper_end(value: FloatVector, radius: FloatVector) -> FloatVector:
    """Return an upper bound of value + radius, exact where the radius is 0, and ∞ where either is not finite."""
    end = np.where(radius == 0.0, value, np.nextafter(value + radius, np.inf))
    return np.where(np.isfinite(radius) & np.isfinite(value), end, np.inf)


def round_sums(
    high: FloatVector, low: FloatVector, radius: FloatVector
) -> tuple[FloatVector, FloatVector]:
    """Return (value, radius) of sums (high, low, radius): the value is `high`, and `low` counts as an error."""
    low = np.abs(low)
    return high, np.where(radius == 0.0, low, np.nextafter(low + radius, np.inf))


def read_only_views(*arrays: Any) -> list[Any]:
    """Return a view of each array that is read-only: one compiled signature for both kinds."""
    views = [array.view() for array in arrays]
    for view in views:
        view.flags.writeable = False
    return views
