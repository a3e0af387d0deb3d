"""Which rows of a solution are held at a bound, which are free, and which are both at a bound and without slack."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from ..checks import BoolVector, FloatVector
from ..kernels.floats import EPSILON
from ..matrix.free_systems import FreeSystem
from ..problem.lcp import LCP
from .error_bounds import ErrorBound
from .residuals import Certificate
from .row_inequality import ActiveSetSteps, RowInequality

STEPS = 8  # of the active-set method; from a solved problem one settles all rows, or two
GOAL = 1e-6  # of a linear solve in such a step, where it is iterative
EXACT = 1e-14  # relative: what a step may leave of the error
ROUNDING = 4.0  # times the rounding floor: what PRECISION_LIMIT grants a residual


class ActiveRows(NamedTuple):
    """What each row of a solution does; every row is in one of the first four sets.

    Attributes
    ----------
    free, at_lower, at_upper, degenerate : ndarray of bool, shape (n,)
        Strictly between its bounds; at a bound with w ≠ 0, or where both are equal; at a bound with w = 0, as far as
        rounding of the data can tell.
    is_upper : ndarray of bool, shape (n,)
        Of the rows that are not free, those at their upper bound.
    z : ndarray, shape (n,)
        The solution, solved for once more on its free rows.
    system : FreeSystem or None
        That which was solved, its rows those of `free` and perhaps of `degenerate`.
    """

    free: BoolVector
    at_lower: BoolVector
    at_upper: BoolVector
    degenerate: BoolVector
    is_upper: BoolVector
    z: FloatVector
    system: FreeSystem | None


def settled_rows(problem: LCP, z: FloatVector, w: FloatVector) -> ActiveRows:
    """Return what each row of a solution does, after steps of the active-set method in twice the working precision.

    Where those settle nothing (the block of the free rows is singular, the rows are spread over ranks) the rows are
    judged by z and w as they are.

    Parameters
    ----------
    z, w : array, shape (n,)
        A solution within some tolerance, and its slack.

    Examples
    --------
    >>> problem = LCP([[2, 1], [1, 2]], [-5, 1])
    >>> rows = settled_rows(problem, np.array([2.5 + 1e-9, 0.0]), np.array([2e-9, 3.5 + 1e-9]))
    >>> rows.free, rows.at_lower, rows.z
    (array([ True, False]), array([False,  True]), array([2.5, 0. ]))
    """
    settled = _settled(problem, z) if problem.peers.is_alone else None
    if settled is None:
        return _judged(problem, z, w, z - problem.lower, problem.upper - z, None)
    at, system, left = settled
    return _judged(problem, at.high, 0.5 * (at.slack - at.negative_slack), at.above, at.below, system, left)


@np.errstate(all="ignore")
def proven_rows(problem: LCP, bound: ErrorBound) -> tuple[BoolVector, BoolVector]:
    """Return which rows a rigorous bound proves to be held (at a bound with w ≠ 0, or with equal bounds), and free.

    Parameters
    ----------
    bound : ErrorBound
        Of a point near the solution.
    """
    if bound.near is None:
        return bound.proven_active & False, bound.proven_inactive
    at = RowInequality.at(problem, bound.near.high, bound.near.low)
    return at.held(bound.near.y), at.classified(bound.near.y)[1]


@np.errstate(all="ignore")
def _settled(problem: LCP, z: FloatVector) -> tuple[RowInequality, FreeSystem, FloatVector] | None:
    """Return a point whose rows solve their own equations, with that system and about how far the solution may be.

    None where steps do not get there. Rows that are exactly degenerate may change sides for ever, by the rounding of
    others; the point stands still then, whichever side they are on.
    """
    steps = ActiveSetSteps(problem, 1.0 / problem.residual_scale, goal=GOAL)
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


@np.errstate(all="ignore")
def _judged(
    problem: LCP, z: FloatVector, w: FloatVector, above: FloatVector, below: FloatVector, system: FreeSystem | None,
    left: FloatVector | None = None,
) -> ActiveRows:
    """Return what each row does by z and w, where z may be as far from the solution as `left` says."""
    scale, floor = problem.residual_scale, Certificate.of(problem, z).rounding_floor
    near, slight = floor, floor
    if left is not None:
        size = abs(problem.matrix.array)
        floor = _with_neighbours(size, floor, scale)
        near, slight = floor + left, floor + size @ left / scale
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


def _with_neighbours(size: Any, floor: FloatVector, scale: FloatVector) -> FloatVector:
    """Return the rounding floor, where a row has no data of its own that of its neighbours; size is |M|.

    A row with q_i = 0, whose unknown and whose neighbours' are 0, has the floor 0. But what rounding makes of the data
    of a row next door moves its unknown, too.
    """
    for _ in range(STEPS):
        spread = size @ floor / scale
        is_bare = floor < EPSILON * spread
        if not is_bare.any():
            break
        floor = np.where(is_bare, spread, floor)
    return floor
