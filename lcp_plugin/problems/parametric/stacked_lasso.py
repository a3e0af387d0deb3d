"""Which of many lassos over one A are optimal beyond doubt: the gap of least squares, all in a few products.

The gap is that of :mod:`lcp_plugin.problems.least_squares.certificate`, with y = θ r shrunk until no column without a
bound can fall, and with all rounding counted against x, where that certificate excuses what the data are known to. What
is sure here is SOLVED there; of the others nothing is said.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...core.checks import FloatVector
from ...core.rounding import gamma
from ..least_squares.data import BoundedLeastSquares

MARGIN = 1e-10  # for the sums of sums


@np.errstate(all="ignore")
def surely_optimal(
    problem: BoundedLeastSquares,
    x: FloatVector,
    b: FloatVector,
    l1: FloatVector,
    lower: FloatVector,
    upper: FloatVector,
    tolerance: float,
) -> NDArray[np.bool_]:
    """Return which rows of x are optimal to the tolerance, shape (k,).

    Parameters
    ----------
    problem : BoundedLeastSquares
        A, weights and ridge.
    x, l1, lower, upper : ndarray, shape (k, n)
        x within the bounds.
    b : ndarray, shape (k, m)
    tolerance : float
    """
    A, root, ridge = problem.A, problem.root_weights, problem.ridge
    m, n = problem.shape
    rows, columns = _lengths(A, root)
    of_products = 4.0 * gamma(m + n + 8)
    size = np.sqrt((x * x).sum(axis=1, keepdims=True))
    r = (A @ x.T).T - b
    radius = of_products * (rows * size + np.abs(b))

    def slope(y: FloatVector) -> tuple[FloatVector, FloatVector]:
        """Return AᵀWy + ridge x, and how far it is known."""
        weighted = y * (root * root)
        length = np.sqrt((weighted * y).sum(axis=1, keepdims=True))
        own = ridge * np.abs(x)
        return (A.T @ weighted.T).T + ridge * x, of_products * (columns * length + own)

    below, above = lower == -np.inf, upper == np.inf
    s, error = slope(r)
    fixed = ridge * x
    pull = s - fixed
    # Where a column has no bound, s must not exceed its penalty: y is shrunk.
    most = np.where(pull > 0.0, l1 - fixed, l1 + fixed) - 2.0 * error
    binds = ((pull > 0.0) & below) | ((pull < 0.0) & above)
    share = np.where(binds, most / np.abs(pull), 1.0).min(axis=1, initial=1.0, keepdims=True) * (
        1.0 - MARGIN
    )
    y = np.maximum(share, 0.0) * r
    s, error = slope(y)
    is_held = (~below | (s + error <= l1)) & (~above | (s - error >= -l1))
    nearest = np.clip(0.0, lower, upper)
    best, reach = -s * nearest - l1 * np.abs(nearest), np.abs(nearest)
    for bound, is_far in ((lower, below), (upper, above)):
        end = np.where(is_far, nearest, bound)
        best, reach = np.maximum(best, -s * end - l1 * np.abs(end)), np.maximum(reach, np.abs(end))
    linear = s * x + l1 * np.abs(x) + best
    terms = (np.abs(s) + l1) * (np.abs(x) + reach)
    linear = np.maximum(linear, 0.0) + error * (np.abs(x) + reach) + of_products * terms
    off = root * (np.abs(r - y) + radius)
    gap = 0.5 * (off * off).sum(axis=1) + linear.sum(axis=1)
    cost = (
        0.5 * (root * y * root * y).sum(axis=1)
        + 0.5 * ridge * (x * x).sum(axis=1)
        + (l1 * np.abs(x)).sum(axis=1)
    )
    sure: NDArray[np.bool_] = is_held.all(axis=1) & (
        gap * (1.0 + MARGIN) <= tolerance * cost * (1.0 - MARGIN)
    )
    return sure


def _lengths(A: Any, root: FloatVector) -> tuple[FloatVector, FloatVector]:
    """Return the lengths of the rows of A, and of the columns of √weights A, a little too long."""
    squares = A * A if isinstance(A, np.ndarray) else A.multiply(A).tocsr()
    rows = np.sqrt(np.asarray(squares.sum(axis=1)).ravel())
    columns = np.sqrt(np.asarray(squares.T @ (root * root)).ravel())
    return rows * (1.0 + MARGIN), columns * (1.0 + MARGIN)
