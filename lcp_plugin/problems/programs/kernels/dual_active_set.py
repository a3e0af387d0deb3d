"""Small dense quadratic programs by the dual active-set method, from data to measured answer in one compiled loop.

x begins where the objective alone is least. The constraint that is violated most joins the active ones, A x = a, while
those whose multipliers reach 0 leave them, until none is violated; the inverse W of [[P, Aᵀ], [A, 0]] is kept by
:mod:`.working_set`, whose arrays these are. Newton steps with W take off at the end what rounding has left of the
conditions. Where P is merely semidefinite, the same steps are those of the proximal point method.

References
----------
D. Goldfarb, A. Idnani, *A numerically stable dual method for solving strictly convex quadratic programs*, Mathematical
Programming 27 (1983), doi:10.1007/BF02591962.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from ....core.kernels.compilation import LONGEST_IN_ORDER, compiled_into_others, compiled_part, interpreted_while_small
from .program_residuals import measure
from .row_operations import add_row, copy_row
from .working_set import (
    ACTIVE,
    CENTER,
    DEFINITE,
    LEFT,
    LIMIT,
    NONE,
    ROW,
    ROWS,
    SIZE,
    STEP,
    X,
    Y,
    add_normals,
    direction,
    gradient,
    invert,
    is_equation,
    join,
    leave,
    left_hand_side,
    look_at,
    move,
    multiply,
)

VIOLATED = 1e-10  # of the unit of a constraint
CONSISTENT = 1e-5  # the same of a constraint that depends on active ones: the measures will tell
STEPS = 5  # for each constraint and variable
SHORT, LONGER = 80, 3  # unknowns beyond which others take over sooner: steps for each of them
CENTERS, AFRESH = 8, 4  # proximal points; of so many the first begins with a factor of its own
REFINEMENTS, SURE, SLOW = 20, 3, 0.7  # at the most; those that are made in any case; a share that is worth another
NUMBERS = 2**17  # in the arrays of a call that may be interpreted: its loops are on rows
REFINED = 1e-11  # a measure that needs no refinement
PASSED_OVER = 2  # of a constraint that the active ones imply
LOST, CONTRADICTION = -1, -2  # in the place of a size


@compiled_part
def _contradict(C, at_C, new, sign, is_equality, real, whole, workspace, size):  # type: ignore[no-untyped-def]
    """Write to Y the multipliers with which the normals of `new` and of the active constraints cancel (Farkas)."""
    m, n = C.shape[1], C.shape[2]
    for i in range(m + 2 * n):
        real[Y, i] = 0.0
    real[Y, new] = sign
    for _twice in range(2):  # the second takes off what the first has rounded
        whole[ROW, size] = new
        for j in range(n):
            real[LEFT, j] = 0.0
        add_normals(C, at_C, real, whole, n, size + 1)
        multiply(real, workspace, n, size)
        move(real, whole, n, size, 1.0, False)
    for a in range(n, size):
        i = whole[ROW, a]
        if not (real[Y, i] > 0.0 or is_equation(i, is_equality, n, real)):
            real[Y, i] = 0.0


@compiled_part
def _begin(P, at_P, C, at_C, c, k, is_equality, real, whole, workspace, inverse):  # type: ignore[no-untyped-def]
    """Put x at the minimum subject to the equations, from CENTER; return the size of W or CONTRADICTION."""
    m, n = C.shape[1], C.shape[2]
    for i in range(m + 2 * n):
        real[Y, i], whole[ACTIVE, i] = 0.0, 0
    for j in range(n):
        real[X, j] = real[CENTER, j]
    gradient(P, at_P, c, k, real, n)
    for i in range(n):
        copy_row(inverse, i, 0, n, workspace, i)
        add_row(inverse, i, 0, n, -real[LEFT, i], real, X)
    size = n
    for i in range(m + 2 * n):
        if is_equation(i, is_equality, n, real):
            violation = left_hand_side(C, at_C, i, real) - real[LIMIT, i]
            steepness = direction(C, at_C, i, real, workspace, size)
            whole[ACTIVE, i] = whole[ACTIVE, i if i < m else i - n] = 1  # nor is the other bound to be looked at
            if steepness > 0.0:
                move(real, whole, n, size, violation / steepness, True)
                real[Y, i] = violation / steepness
                join(real, whole, workspace, i, size, steepness)
                size += 1
            elif not abs(violation) <= CONSISTENT * (real[SIZE, i] + abs(real[LIMIT, i])):
                _contradict(C, at_C, i, np.sign(violation), is_equality, real, whole, workspace, size)
                return CONTRADICTION
    return size


@compiled_part
def _begin_again(P, at_P, C, at_C, c, k, is_equality, real, whole, workspace, size):  # type: ignore[no-untyped-def]
    """Put x at the minimum subject to the active constraints, from CENTER; return the size of W, less those that leave.

    With u = (x − CENTER, y) and w the row of one that leaves, u − w u_at ÷ w_at is what the others make of it.
    """
    n = C.shape[2]
    for i in range(whole.shape[1] - 1):
        if whole[ACTIVE, i] == PASSED_OVER:
            whole[ACTIVE, i] = 0
    for j in range(n):
        real[X, j] = real[CENTER, j]
    gradient(P, at_P, c, k, real, n)
    for a in range(n, size):
        i = whole[ROW, a]
        real[LEFT, a], real[Y, i] = left_hand_side(C, at_C, i, real) - real[LIMIT, i], 0.0
    multiply(real, workspace, size, size)
    move(real, whole, n, size, 1.0, True)
    while True:
        least, at = 0.0, -1
        for a in range(n, size):
            i = whole[ROW, a]
            if real[Y, i] < least and not is_equation(i, is_equality, n, real):
                least, at = real[Y, i], a
        if at < 0:
            return size
        share = least / workspace[at, at]
        copy_row(workspace, at, 0, size, real, STEP)
        move(real, whole, n, size, share, True)
        real[Y, whole[ROW, at]] = 0.0
        size -= 1
        leave(real, whole, workspace, at, size)


@compiled_into_others
def _most_violated(C, at_C, real, whole):  # type: ignore[no-untyped-def]
    """Return the inequality that is violated most beside its unit, −1 where none is."""
    worst, found = VIOLATED, -1
    for i in range(C.shape[1] + 2 * C.shape[2]):
        if real[LIMIT, i] < np.inf and whole[ACTIVE, i] == 0:
            violation, unit = left_hand_side(C, at_C, i, real) - real[LIMIT, i], real[SIZE, i] + abs(real[LIMIT, i])
            if violation > worst * unit:
                worst, found = violation / unit, i
    return found


@compiled_part
def _proceed(C, at_C, is_equality, real, whole, workspace, size, most):  # type: ignore[no-untyped-def]
    """Let constraints join and leave until none is violated; return the size of W, LOST or CONTRADICTION, and steps.

    LOST after so many at the most.
    """
    n, made = C.shape[2], 0
    while True:
        new = _most_violated(C, at_C, real, whole)
        if new < 0:
            return size, made
        violation, is_active = left_hand_side(C, at_C, new, real) - real[LIMIT, new], False
        while not is_active:
            if made >= most:
                return LOST, made
            made += 1
            steepness = direction(C, at_C, new, real, workspace, size)
            step, at = violation / steepness if steepness > 0.0 else np.inf, -1
            for a in range(n, size):
                i = whole[ROW, a]
                blocks = real[STEP, a] > 0.0 and real[Y, i] < step * real[STEP, a]
                if blocks and not is_equation(i, is_equality, n, real):
                    step, at = max(real[Y, i], 0.0) / real[STEP, a], a
            if not step < np.inf:
                if not violation <= CONSISTENT * (real[SIZE, new] + abs(real[LIMIT, new])):
                    _contradict(C, at_C, new, 1.0, is_equality, real, whole, workspace, size)
                    return CONTRADICTION, made
                real[Y, new], whole[ACTIVE, new] = 0.0, PASSED_OVER  # what depends on others misses by rounding
                break
            move(real, whole, n, size, step, steepness > 0.0)
            real[Y, new] += step
            violation -= step * steepness
            is_active = at < 0
            if is_active:
                join(real, whole, workspace, new, size, steepness)
                size += 1
            else:
                real[Y, whole[ROW, at]] = 0.0
                size -= 1
                leave(real, whole, workspace, at, size)


@compiled_part
def _refine(P, at_P, c, k, C, at_C, is_equality, real, whole, workspace, size):  # type: ignore[no-untyped-def]
    """Take off what is left of the conditions with the active constraints, and put x on those of its bounds."""
    m, n = C.shape[1], C.shape[2]
    gradient(P, at_P, c, k, real, n)
    for a in range(n, size):
        i = whole[ROW, a]
        real[LEFT, a] = left_hand_side(C, at_C, i, real) - real[LIMIT, i]
    add_normals(C, at_C, real, whole, n, size)
    multiply(real, workspace, size, size)
    move(real, whole, n, size, 1.0, True)
    for a in range(n, size):
        i = whole[ROW, a]
        if i >= m:
            real[X, (i - m) % n] = real[LIMIT, i] if i >= m + n else 0.0 - real[LIMIT, i]
        if not (real[Y, i] > 0.0 or is_equation(i, is_equality, n, real)):
            real[Y, i] = 0.0


@partial(interpreted_while_small, longest=LONGEST_IN_ORDER, numbers=NUMBERS)
def run(  # type: ignore[no-untyped-def]
    P, c, C, d, is_equality, lower, upper, objective, tolerance, first, end, x, y, reduced, measures, steps,
    has_converged, contradicts,
):
    """Write x, y, reduced, measures, steps and has_converged of the programs first ≤ k < end.

    P and C, shapes (1 or count, n, n) and (1 or count, m, n), may be shared. Rows of C with d = ∞ say nothing. Where
    constraints contradict each other by all that doubles tell, y and reduced are multipliers that should prove it.
    """
    m, n = C.shape[1], C.shape[2]
    real, whole = np.empty((ROWS, m + 2 * n)), np.empty((2, m + 2 * n + 1), np.int64)
    workspace, inverse, sums = np.empty((2 * n, 2 * n)), np.empty((n, n)), np.empty((4, n))
    kind, most = NONE, STEPS * (m + 3 * n) if n <= SHORT else LONGER * (n + SHORT)
    for k in range(first, end):
        at_P, at_C = min(k, P.shape[0] - 1), min(k, C.shape[0] - 1)
        if k == first or at_P > 0:
            kind = invert(P, at_P, real, workspace, inverse)
        if (k == first or at_P > 0 or at_C > 0) and not look_at(P, at_P, C, at_C, real):
            kind = NONE
        for i in range(m):
            real[LIMIT, i] = d[k, i]
        for j in range(n):
            real[LIMIT, m + j], real[LIMIT, m + n + j], real[CENTER, j] = -lower[k, j], upper[k, j], 0.0
        steps[k], has_converged[k], contradicts[k] = 0, False, False
        for center in range(0 if kind == NONE else 1 if kind == DEFINITE else CENTERS):
            if center % AFRESH == 0:
                size = _begin(P, at_P, C, at_C, c, k, is_equality, real, whole, workspace, inverse)
            else:
                size = _begin_again(P, at_P, C, at_C, c, k, is_equality, real, whole, workspace, size)
            if size >= 0:
                size, made = _proceed(C, at_C, is_equality, real, whole, workspace, size, most - steps[k])
                steps[k] += made
            contradicts[k] = size == CONTRADICTION
            if size < 0:
                for i in range(m):
                    y[k, i] = real[Y, i]
                for j in range(n):
                    reduced[k, j] = real[Y, m + j] - real[Y, m + n + j]
                break
            for j in range(n):
                real[CENTER, j] = real[X, j]
            before = np.inf
            for refinement in range(REFINEMENTS):
                _refine(P, at_P, c, k, C, at_C, is_equality, real, whole, workspace, size)
                for j in range(n):
                    x[k, j] = min(max(real[X, j], lower[k, j]), upper[k, j])
                for i in range(m):
                    y[k, i] = real[Y, i]
                largest = measure(
                    P, c, C, d, is_equality, lower, upper, objective, k, at_P, at_C, sums, x, y, reduced, measures
                )
                has_converged[k] = largest <= tolerance
                if largest <= REFINED or (refinement >= SURE and not largest < SLOW * before):
                    break
                before = largest
            if has_converged[k]:
                break
