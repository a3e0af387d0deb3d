"""Classification of the rows of a solution: at a bound, free, or degenerate (at a bound with w = 0); hidden errors.

To first order z − z* = (S M_FF)⁻¹ r_F on the rows F strictly between their bounds, S = D⁻¹: an error as large as
‖(S M_FF)⁻¹‖∞ ‖r‖∞ may hide behind a residual r. LAPACK estimates the norm up to 500 rows; this proves nothing (see
`error_bounds` for what does).
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp

from ...core.certificates.criterion import row_data
from ...core.checks import BoolVector, FloatVector
from ...core.lcp import LCP
from ...systems.free_systems import FreeSystem
from .row_inequality import ActiveSetSteps, RowInequality

DENSE_UP_TO = 500  # free rows: a few milliseconds
STEPS = 8  # of the active-set method; from a solved problem one settles all rows, or two
GOAL = 1e-6  # of a linear solve in such a step, if it is iterative
EXACT = 1e-14  # relative error after a step
ROUNDING = 4.0  # times the rounding floor: the residual accepted by PRECISION_LIMIT


class ActiveRows(NamedTuple):
    """Classification of the rows of a solution; every row is in one of the first four sets.

    Attributes
    ----------
    free, at_lower, at_upper, degenerate : ndarray of bool, shape (n,)
        Free rows are strictly between their bounds. Rows at a bound have w ≠ 0, or equal bounds. Degenerate rows are
        at a bound with w = 0, up to rounding of the data.
    is_upper : ndarray of bool, shape (n,)
        True if a row that is not free is at its upper bound.
    z : ndarray, shape (n,)
        The solution, solved again on the free rows.
    system : FreeSystem or None
        The solved system, its rows `free` and perhaps `degenerate`.
    """

    free: BoolVector
    at_lower: BoolVector
    at_upper: BoolVector
    degenerate: BoolVector
    is_upper: BoolVector
    z: FloatVector
    system: FreeSystem | None


@np.errstate(all="ignore")
def settled_rows(
    problem: LCP, z: FloatVector, w: FloatVector, system: FreeSystem | None = None
) -> ActiveRows:
    """Return the classification of the rows, after steps of the active-set method in twice the working precision.

    If the steps fail (the block of the free rows is singular) the rows are classified by the given z and w.

    Parameters
    ----------
    z, w : array, shape (n,)
        A solution within some tolerance, and its slack.
    system : FreeSystem, optional
        System of a problem with the same M, which is reused if the free rows are the same.

    Examples
    --------
    >>> problem = LCP([[2, 1], [1, 2]], [-5, 1])
    >>> rows = settled_rows(problem, np.array([2.5 + 1e-9, 0.0]), np.array([2e-9, 3.5 + 1e-9]))
    >>> rows.free, rows.at_lower, rows.z
    (array([ True, False]), array([False,  True]), array([2.5, 0. ]))
    """
    settled = _settled(problem, z, system)
    if settled is None:
        return _judged(problem, z, w, z - problem.lower, problem.upper - z, None)
    at, system, left = settled
    return _judged(
        problem, at.high, 0.5 * (at.slack - at.negative_slack), at.above, at.below, system, left
    )


def _settled(
    problem: LCP, z: FloatVector, system: FreeSystem | None
) -> tuple[RowInequality, FreeSystem, FloatVector] | None:
    """Return a point whose rows solve their equations, the system, and an error estimate.

    The result is None if the steps do not converge. Rows that are exactly degenerate may change sides indefinitely,
    by the rounding of other rows; the point then does not change with their side.
    """
    steps = ActiveSetSteps(problem, 1.0 / problem.residual_scale, goal=GOAL, system=system)
    at, change, allowed = RowInequality.at(problem, z), np.zeros(0), 0.0
    for _ in range(STEPS):
        following = steps.next_point(at)
        if following is None:
            return None
        change, at = np.abs((following.high - at.high) + (following.low - at.low)), following
        allowed = EXACT * np.abs(at.high).max(initial=0.0)
        if steps.is_settled(at) and GOAL * change.max(initial=0.0) <= allowed:
            return at, steps.system, GOAL * change
    return (at, steps.system, GOAL * change) if change.max(initial=0.0) <= allowed else None


def _judged(
    problem: LCP,
    z: FloatVector,
    w: FloatVector,
    above: FloatVector,
    below: FloatVector,
    system: FreeSystem | None,
    left: FloatVector | None = None,
) -> ActiveRows:
    """Return the classification of the rows by z and w, if `left` bounds the distance of z from the solution."""
    scale, data = problem.residual_scale, row_data(problem)
    floor = data.rounding_floor(data.rows(z).terms)
    beside_largest = np.minimum(
        scale / problem.matrix.row_largest, 1.0
    )  # by a tiny diagonal entry no row moves z_i
    near, slight = floor * beside_largest, floor
    if left is not None:
        size = abs(problem.matrix.array)
        near, slight = floor * beside_largest + left, floor + size @ left / scale
    is_fixed = problem.lower == problem.upper
    step = w / scale
    is_small = (np.minimum(above, below) <= ROUNDING * near) & (np.abs(step) <= ROUNDING * slight)
    degenerate = is_small & ~is_fixed
    is_upper = np.where(is_fixed, w < 0.0, below < above)
    reaches = np.where(is_upper, below <= -step, above <= step)
    held = is_fixed | (reaches & ~degenerate)
    return ActiveRows(
        ~(held | degenerate), held & ~is_upper, held & is_upper, degenerate, is_upper, z, system
    )


def free_rows(problem: LCP, z: FloatVector, w: FloatVector) -> BoolVector:
    """Return the mask of rows between their bounds according to z and its slack w, shape (n,)."""
    target = z - w / problem.residual_scale
    return (target > problem.lower) & (target < problem.upper)


def estimated_error(problem: LCP, z: FloatVector, w: FloatVector, residual: float) -> float | None:
    """Return an estimate of the largest ‖z − z*‖∞ that goes with a scaled residual, or None if it is too costly.

    Parameters
    ----------
    problem : LCP
    z, w : arrays, shape (n,)
        A point and its slack.
    residual : float
        ‖r(z)‖∞, in the unit of z.

    Examples
    --------
    >>> problem = LCP([[1, -1 + 2**-30], [-1 + 2**-30, 1]], [-1, -1])
    >>> z = np.full(2, 2.0**30)
    >>> round(estimated_error(problem, z, problem.slack(z), 1e-8), 6)
    10.737418
    """
    free = np.flatnonzero(free_rows(problem, z, w))
    if not free.size or not residual > 0.0 or not np.isfinite(residual):
        return 0.0 if residual == 0.0 or not free.size else None
    norm = _norm_of_inverse(problem, free)
    return None if norm is None else residual * norm


def _norm_of_inverse(problem: LCP, free: Any) -> float | None:
    """Return LAPACK's estimate of ‖(S M_FF)⁻¹‖∞, ∞ if that is singular, None beyond 500 rows."""
    from scipy.linalg import lapack

    if free.size > DENSE_UP_TO:
        return None
    block = problem.M[free][:, free]
    block = (block.toarray() if sp.issparse(block) else block) / problem.residual_scale[free, None]
    if not np.isfinite(block).all():
        return None
    norm = float(np.abs(block).sum(axis=1).max())
    reciprocal = norm * lapack.dgecon(lapack.dgetrf(block)[0], norm, norm="I")[0]
    return 1.0 / reciprocal if reciprocal > 0.0 else np.inf
