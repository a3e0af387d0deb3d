"""Constraints that contradict, seen in doubles: multipliers that a proof is made of before linear programs are asked.

Rows C x ≤ d, the last ones equations, and bounds have no common point if and only if some y, y_i ≥ 0 for inequalities,
has Cᵀy = 0 and dᵀy = −1, bounds counted as rows. The least ‖Cᵀy‖² + (dᵀy + 1)² over these y is 0 then; otherwise
its residual (r, ρ) gives a point −r/ρ (Lawson, Hanson, *Solving Least Squares Problems*, 1974, chapter 23). Engines
that find such y hand it back.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ...core.checks import FloatVector

ROUNDING = 1e-12  # of the terms of a sum that should be 0
NEGLIGIBLE = 1e-10  # of the largest multiplier, each times its row's length
NEAR = 1e-3  # of an integer: what an interior point leaves of a multiplier; what is made of it is checked
DENOMINATORS = 1, 2, 3, 4, 6, 12
STEPS = 3  # of nonnegative least squares, times the number of rows


@np.errstate(all="ignore")  # what overflows contradicts nothing
def contradicting_multipliers(
    C: Any, d: FloatVector, m: int, lower: FloatVector, upper: FloatVector, tolerance: float
) -> FloatVector | None:
    """Return multipliers of the rows, shape of d, that contradict by more than a tolerance; None where none are seen.

    Parameters
    ----------
    C : array, shape (m + p, n)
        Dense: one nonnegative least squares problem of n + 1 rows.
    m : int
        How many rows are inequalities.

    Examples
    --------
    >>> C, free = np.array([[1.0, 1.0], [-1.0, -1.0]]), np.full(2, np.inf)
    >>> y = contradicting_multipliers(C, np.array([1.0, -2.0]), 2, -free, free, 1e-6)
    >>> y
    array([1., 1.])
    """
    from scipy.optimize import nnls

    n = lower.size
    said = np.flatnonzero(np.isfinite(d))
    below, above = np.flatnonzero(np.isfinite(lower)), np.flatnonzero(np.isfinite(upper))
    equal, unit = said[said >= m], np.eye(n)
    rows = np.concatenate([C[said], -C[equal], -unit[below], unit[above]])
    right = np.concatenate([d[said], -d[equal], -lower[below], upper[above]])
    lengths = np.sqrt(np.square(rows).sum(axis=1))
    lengths[lengths == 0.0] = 1.0
    right = right / lengths
    size = np.abs(right).max(initial=0.0) or 1.0
    matrix, target = np.vstack([(rows / lengths[:, np.newaxis]).T, right / size]), np.zeros(n + 1)
    target[-1] = -1.0
    if not np.isfinite(matrix).all() or not right.size:
        return None
    try:
        found = nnls(matrix, target, maxiter=STEPS * right.size)[0]
    except (
        RuntimeError,
        np.linalg.LinAlgError,
    ):  # too many steps; singular, in releases of scipy before 1.15
        return None
    found = np.where(found > NEGLIGIBLE * found.max(), found, 0.0) / lengths
    y = np.zeros(d.size)
    y[said] = found[: said.size]
    y[equal] -= found[said.size : said.size + equal.size]
    near = (
        one
        for one in (with_few_digits(y), y)
        if margin_in_doubles(C, d, lower, upper, one) > tolerance
    )
    return next(near, None)


@np.errstate(all="ignore")
def margin_in_doubles(
    C: Any, d: FloatVector, lower: FloatVector, upper: FloatVector, y: FloatVector
) -> float:
    """Return by how much multipliers of the rows contradict beside their terms; 0 where they do not."""
    used = np.flatnonzero(y)
    y, d, C = y[used], d[used], C[used]
    left, terms = C.T @ y, abs(C).T @ np.abs(y)
    bounds = np.where(left > 0.0, lower, upper)
    is_open = np.isinf(bounds)
    if not (np.abs(left[is_open]) <= ROUNDING * terms[is_open]).all():
        return 0.0
    ends = left[~is_open] * bounds[~is_open]
    margin = float((ends.sum() - y @ d) / (np.abs(ends).sum() + np.abs(y) @ np.abs(d)))
    return margin if margin > 0.0 else 0.0


def with_few_digits(y: FloatVector) -> FloatVector:
    """Return y as small integers where it is near some, up to a factor; otherwise as it is, without what is negligible.

    Examples
    --------
    >>> with_few_digits(np.array([0.5, -0.25 + 1e-9, 1e-13]))
    array([ 2., -1.,  0.])
    """
    kept = np.abs(y) > NEAR * np.abs(y).max(initial=0.0)
    if not kept.any():
        return y
    ratios = np.where(kept, y, 0.0) / np.abs(y[kept]).min()
    for denominator in DENOMINATORS:
        whole: FloatVector = np.round(denominator * ratios)
        if (np.abs(whole - denominator * ratios) <= NEAR * np.abs(whole)).all():
            return whole
    clean: FloatVector = np.where(np.abs(y) > NEGLIGIBLE * np.abs(y).max(), y, 0.0)
    return clean
