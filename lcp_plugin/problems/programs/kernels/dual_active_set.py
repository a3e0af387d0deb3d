"""Small dense quadratic programs by the dual active-set method, from data to measured answer in one compiled loop.

x begins where the objective alone is least. The constraint that is violated most joins the active ones, A x = a, while
those whose multipliers reach 0 leave them, until none is violated. The inverse W of [[P, Aᵀ], [A, 0]] is kept in
`room`: whatever joins or leaves is one symmetric update of rank 1, and Newton steps with W take off at the end what
rounding has left of the conditions. Where P is merely semidefinite, W is that of P with a little on its diagonal, and
the same steps are those of the proximal point method.

Constraints are numbered: the rows C x ≤ d or C x = d, then lower ≤ x, then x ≤ upper. Vectors lie in one array `real`,
shape (ROWS, m + 2n); `whole`, of the same width, says which constraints are active.

References
----------
D. Goldfarb, A. Idnani, *A numerically stable dual method for solving strictly convex quadratic programs*, Mathematical
Programming 27 (1983), doi:10.1007/BF02591962.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from ....core.kernels.compilation import LONGEST_IN_ORDER, compiled_into_others, compiled_part, interpreted_while_small
from ....core.kernels.floats import EPSILON
from ....methods.small.kernels.small_problems import USUAL, row_times
from .program_residuals import measure
from .row_operations import add_row, add_row_of_batch, copy_row

# Rows of `real`: the point, its multipliers and limits; a step, what is left of the conditions; units.
X, Y, LIMIT, STEP, LEFT, SIZE, ROOT, SPREAD, CENTER, ROWS = 0, 1, 2, 3, 4, 5, 6, 7, 8, 9
ROW, ACTIVE = 0, 1  # of `whole`: the active constraints, from place n on; whether a constraint is one, or passed over

SINGULAR = 1e-8  # a pivot of P at unit diagonal: up to here it gets the proximal term
PROXIMAL = 1e-5  # beside a unit diagonal
DEPENDENT = 1e-13  # of gᵀ P⁻¹ g: what a normal g has outside of the active ones is rounding
VIOLATED = 1e-10  # of the unit of a constraint
CONSISTENT = 1e-5  # the same of a constraint that depends on active ones: the measures will tell
STEPS = 5  # for each constraint and variable
SHORT, LONGER = 80, 3  # unknowns beyond which others take over sooner: steps for each of them
CENTERS, AFRESH = 8, 4  # proximal points; of so many the first begins with a factor of its own
REFINEMENTS, SURE, SLOW = 20, 3, 0.7  # at the most; those that are made in any case; a share that is worth another
NUMBERS = 2**17  # in the arrays of a call that may be interpreted: its loops are on rows
REFINED = 1e-11  # a measure that needs no refinement
NONE, DEFINITE, SEMIDEFINITE = 0, 1, 2
PASSED_OVER = 2  # of a constraint that the active ones imply
LOST, CONTRADICTION = -1, -2  # in the place of a size


@compiled_part
def _sweep(P, k, shift, least, real, room):  # type: ignore[no-untyped-def]
    """Write (P + shift)⁻¹, both at the units ROOT; return whether all pivots of P so were above `least`."""
    n = P.shape[1]
    for i in range(n):
        for j in range(n):
            room[i, j] = P[k, i, j] / (real[ROOT, i] * real[ROOT, j])
        room[i, i] += shift
    for p in range(n):
        pivot = room[p, p]
        if not pivot > least:
            return False
        for j in range(n):
            real[STEP, j] = room[p, j] / pivot
        for i in range(n):
            factor = room[i, p]
            if i != p and factor != 0.0:
                add_row(real, STEP, 0, n, -factor, room, i)
                room[i, p] = -factor / pivot
        copy_row(real, STEP, 0, n, room, p)
        room[p, p] = 1.0 / pivot
    return True


@compiled_part
def _invert(P, k, real, room, inverse):  # type: ignore[no-untyped-def]
    """Write P⁻¹, or that of P with a proximal term, and its diagonal SPREAD; return what P is.

    It is SEMIDEFINITE where P at unit diagonal has no eigenvalue below 0 by more than rounding.
    """
    n = P.shape[1]
    for i in range(n):
        d = P[k, i, i]
        for j in range(n):
            if not d > 0.0 and P[k, i, j] != 0.0:
                return NONE
        real[ROOT, i] = np.sqrt(d) if d > 0.0 else 1.0
    kind = DEFINITE
    if not _sweep(P, k, 0.0, SINGULAR, real, room):
        kind = SEMIDEFINITE
        if not _sweep(P, k, n * (n + 4) * EPSILON, 0.0, real, room) or not _sweep(P, k, PROXIMAL, 0.0, real, room):
            return NONE
    for i in range(n):
        for j in range(n):
            inverse[i, j] = room[i, j] / (real[ROOT, i] * real[ROOT, j])
        real[SPREAD, i] = inverse[i, i]
    return kind


@compiled_into_others
def _is_equation(i, is_equality, n, real):  # type: ignore[no-untyped-def]
    """Return whether constraint i is one; of a fixed variable its upper bound is."""
    m = is_equality.size
    return is_equality[i] if i < m else i >= m + n and real[LIMIT, i] == -real[LIMIT, i - n]


@compiled_into_others
def _value(C, k, i, real):  # type: ignore[no-untyped-def]
    """Return the left-hand side of constraint i at X."""
    m, n = C.shape[1], C.shape[2]
    if i < m:
        return row_times(C, k, i, n, real, X)
    return -real[X, i - m] if i < m + n else real[X, i - m - n]


@compiled_part
def _direction(C, k, i, real, room, size):  # type: ignore[no-untyped-def]
    """Write STEP = W (g, 0), g the normal of constraint i; return gᵀ H g, H the first n rows and columns of W.

    0 where g depends on the active normals.
    """
    m, n = C.shape[1], C.shape[2]
    if i >= m:
        j, sign = (i - m, -1.0) if i < m + n else (i - m - n, 1.0)
        for a in range(size):
            real[STEP, a] = sign * room[j, a]
        steepness, scale = sign * real[STEP, j], real[SPREAD, j]
    else:
        for a in range(size):
            real[STEP, a] = 0.0
        scale = 0.0
        for j in range(n):
            g = C[k, i, j]
            scale += g * g * real[SPREAD, j]
            if g != 0.0:
                add_row(room, j, 0, size, g, real, STEP)
        steepness = row_times(C, k, i, n, real, STEP)
    return steepness if steepness > DEPENDENT * scale and size < 2 * n else 0.0


@compiled_into_others
def _join(real, whole, room, i, size, steepness):  # type: ignore[no-untyped-def]
    """Let constraint i join the active ones, STEP being its direction."""
    for a in range(size):
        factor = real[STEP, a] / steepness
        add_row(real, STEP, 0, size, -factor, room, a)
        room[a, size] = room[size, a] = factor
    room[size, size] = -1.0 / steepness
    whole[ROW, size], whole[ACTIVE, i] = i, 1


@compiled_into_others
def _leave(real, whole, room, at, last):  # type: ignore[no-untyped-def]
    """Let the constraint in row `at` of W leave the active ones; the last one takes its place."""
    pivot = room[at, at]
    copy_row(room, at, 0, last + 1, real, STEP)
    for a in range(last + 1):
        add_row(real, STEP, 0, last + 1, -real[STEP, a] / pivot, room, a)
    copy_row(room, last, 0, last + 1, room, at)
    for a in range(last):
        room[a, at] = room[a, last]
    whole[ACTIVE, whole[ROW, at]] = 0
    whole[ROW, at] = whole[ROW, last]


@compiled_into_others
def _move(real, whole, n, size, step, is_primal):  # type: ignore[no-untyped-def]
    """Go that far against STEP: the active multipliers, and x where it can."""
    if is_primal:
        for j in range(n):
            real[X, j] -= step * real[STEP, j]
    for a in range(n, size):
        real[Y, whole[ROW, a]] -= step * real[STEP, a]


@compiled_part
def _gradient(P, at_P, c, k, real, n):  # type: ignore[no-untyped-def]
    """Write LEFT = P x + c."""
    for j in range(n):
        real[LEFT, j] = c[k, j]
    for i in range(n):
        add_row_of_batch(P, at_P, i, n, real[X, i], real, LEFT)


@compiled_part
def _add_normals(C, at_C, real, whole, n, size):  # type: ignore[no-untyped-def]
    """Add the normals of active constraints, times their multipliers, to LEFT."""
    m = C.shape[1]
    for a in range(n, size):
        i = whole[ROW, a]
        if i < m:
            add_row_of_batch(C, at_C, i, n, real[Y, i], real, LEFT)
        else:
            real[LEFT, (i - m) % n] += real[Y, i] if i >= m + n else -real[Y, i]


@compiled_part
def _multiply(real, room, count, size):  # type: ignore[no-untyped-def]
    """Write STEP = W times the first so many entries of LEFT."""
    for a in range(size):
        real[STEP, a] = 0.0
    for a in range(count):
        add_row(room, a, 0, size, real[LEFT, a], real, STEP)


@compiled_part
def _contradict(C, at_C, new, sign, is_equality, real, whole, room, size):  # type: ignore[no-untyped-def]
    """Write to Y the multipliers with which the normals of `new` and of the active constraints cancel (Farkas)."""
    m, n = C.shape[1], C.shape[2]
    for i in range(m + 2 * n):
        real[Y, i] = 0.0
    real[Y, new] = sign
    for _twice in range(2):  # the second takes off what the first has rounded
        whole[ROW, size] = new
        for j in range(n):
            real[LEFT, j] = 0.0
        _add_normals(C, at_C, real, whole, n, size + 1)
        _multiply(real, room, n, size)
        _move(real, whole, n, size, 1.0, False)
    for a in range(n, size):
        i = whole[ROW, a]
        if not (real[Y, i] > 0.0 or _is_equation(i, is_equality, n, real)):
            real[Y, i] = 0.0


@compiled_part
def _begin(P, at_P, C, at_C, c, k, is_equality, real, whole, room, inverse):  # type: ignore[no-untyped-def]
    """Put x at the minimum subject to the equations, from CENTER; return the size of W or CONTRADICTION."""
    m, n = C.shape[1], C.shape[2]
    for i in range(m + 2 * n):
        real[Y, i], whole[ACTIVE, i] = 0.0, 0
    for j in range(n):
        real[X, j] = real[CENTER, j]
    _gradient(P, at_P, c, k, real, n)
    for i in range(n):
        copy_row(inverse, i, 0, n, room, i)
        add_row(inverse, i, 0, n, -real[LEFT, i], real, X)
    size = n
    for i in range(m + 2 * n):
        if _is_equation(i, is_equality, n, real):
            violation = _value(C, at_C, i, real) - real[LIMIT, i]
            steepness = _direction(C, at_C, i, real, room, size)
            whole[ACTIVE, i] = whole[ACTIVE, i if i < m else i - n] = 1  # nor is the other bound to be looked at
            if steepness > 0.0:
                _move(real, whole, n, size, violation / steepness, True)
                real[Y, i] = violation / steepness
                _join(real, whole, room, i, size, steepness)
                size += 1
            elif not abs(violation) <= CONSISTENT * (real[SIZE, i] + abs(real[LIMIT, i])):
                _contradict(C, at_C, i, np.sign(violation), is_equality, real, whole, room, size)
                return CONTRADICTION
    return size


@compiled_part
def _begin_again(P, at_P, C, at_C, c, k, is_equality, real, whole, room, size):  # type: ignore[no-untyped-def]
    """Put x at the minimum subject to the active constraints, from CENTER; return the size of W, less those that leave.

    With u = (x − CENTER, y) and w the row of one that leaves, u − w u_at ÷ w_at is what the others make of it.
    """
    n = C.shape[2]
    for i in range(whole.shape[1] - 1):
        if whole[ACTIVE, i] == PASSED_OVER:
            whole[ACTIVE, i] = 0
    for j in range(n):
        real[X, j] = real[CENTER, j]
    _gradient(P, at_P, c, k, real, n)
    for a in range(n, size):
        i = whole[ROW, a]
        real[LEFT, a], real[Y, i] = _value(C, at_C, i, real) - real[LIMIT, i], 0.0
    _multiply(real, room, size, size)
    _move(real, whole, n, size, 1.0, True)
    while True:
        least, at = 0.0, -1
        for a in range(n, size):
            i = whole[ROW, a]
            if real[Y, i] < least and not _is_equation(i, is_equality, n, real):
                least, at = real[Y, i], a
        if at < 0:
            return size
        share = least / room[at, at]
        copy_row(room, at, 0, size, real, STEP)
        _move(real, whole, n, size, share, True)
        real[Y, whole[ROW, at]] = 0.0
        size -= 1
        _leave(real, whole, room, at, size)


@compiled_into_others
def _most_violated(C, at_C, real, whole):  # type: ignore[no-untyped-def]
    """Return the inequality that is violated most beside its unit, −1 where none is."""
    worst, found = VIOLATED, -1
    for i in range(C.shape[1] + 2 * C.shape[2]):
        if real[LIMIT, i] < np.inf and whole[ACTIVE, i] == 0:
            violation, unit = _value(C, at_C, i, real) - real[LIMIT, i], real[SIZE, i] + abs(real[LIMIT, i])
            if violation > worst * unit:
                worst, found = violation / unit, i
    return found


@compiled_part
def _proceed(C, at_C, is_equality, real, whole, room, size, most):  # type: ignore[no-untyped-def]
    """Let constraints join and leave until none is violated; return the size of W, LOST or CONTRADICTION, and steps.

    LOST after so many at the most.
    """
    n, made = C.shape[2], 0
    while True:
        new = _most_violated(C, at_C, real, whole)
        if new < 0:
            return size, made
        violation, is_active = _value(C, at_C, new, real) - real[LIMIT, new], False
        while not is_active:
            if made >= most:
                return LOST, made
            made += 1
            steepness = _direction(C, at_C, new, real, room, size)
            step, at = violation / steepness if steepness > 0.0 else np.inf, -1
            for a in range(n, size):
                i = whole[ROW, a]
                blocks = real[STEP, a] > 0.0 and real[Y, i] < step * real[STEP, a]
                if blocks and not _is_equation(i, is_equality, n, real):
                    step, at = max(real[Y, i], 0.0) / real[STEP, a], a
            if not step < np.inf:
                if not violation <= CONSISTENT * (real[SIZE, new] + abs(real[LIMIT, new])):
                    _contradict(C, at_C, new, 1.0, is_equality, real, whole, room, size)
                    return CONTRADICTION, made
                real[Y, new], whole[ACTIVE, new] = 0.0, PASSED_OVER  # what depends on others misses by rounding
                break
            _move(real, whole, n, size, step, steepness > 0.0)
            real[Y, new] += step
            violation -= step * steepness
            is_active = at < 0
            if is_active:
                _join(real, whole, room, new, size, steepness)
                size += 1
            else:
                real[Y, whole[ROW, at]] = 0.0
                size -= 1
                _leave(real, whole, room, at, size)


@compiled_part
def _refine(P, at_P, c, k, C, at_C, is_equality, real, whole, room, size):  # type: ignore[no-untyped-def]
    """Take off what is left of the conditions with the active constraints, and put x on those of its bounds."""
    m, n = C.shape[1], C.shape[2]
    _gradient(P, at_P, c, k, real, n)
    for a in range(n, size):
        i = whole[ROW, a]
        real[LEFT, a] = _value(C, at_C, i, real) - real[LIMIT, i]
    _add_normals(C, at_C, real, whole, n, size)
    _multiply(real, room, size, size)
    _move(real, whole, n, size, 1.0, True)
    for a in range(n, size):
        i = whole[ROW, a]
        if i >= m:
            real[X, (i - m) % n] = real[LIMIT, i] if i >= m + n else 0.0 - real[LIMIT, i]
        if not (real[Y, i] > 0.0 or _is_equation(i, is_equality, n, real)):
            real[Y, i] = 0.0


@compiled_part
def _look_at(P, at_P, C, at_C, real):  # type: ignore[no-untyped-def]
    """Fill SIZE with the largest entries of rows, 1 where there is none; return whether all numbers are usual."""
    m, n, is_usual = C.shape[1], C.shape[2], True
    for i in range(n + m):
        largest = 0.0
        for j in range(n):
            size = abs(P[at_P, i, j] if i < n else C[at_C, i - n, j])
            largest = size if size > largest else largest
        is_usual &= largest == 0.0 or USUAL[0] < largest < USUAL[1]
        if i >= n:
            real[SIZE, i - n] = largest if largest > 0.0 else 1.0
    for i in range(m, m + 2 * n):
        real[SIZE, i] = 1.0
    return is_usual


@partial(interpreted_while_small, longest=LONGEST_IN_ORDER, numbers=NUMBERS)
def run(  # type: ignore[no-untyped-def]
    P, c, C, d, is_equality, lower, upper, tolerance, first, end, x, y, reduced, measures, steps, has_converged,
    contradicts,
):
    """Write x, y, reduced, measures, steps and has_converged of the programs first ≤ k < end.

    P and C, shapes (1 or count, n, n) and (1 or count, m, n), may be shared. Rows of C with d = ∞ say nothing. Where
    constraints contradict each other by all that doubles tell, y and reduced are multipliers that should prove it.
    """
    m, n = C.shape[1], C.shape[2]
    real, whole = np.empty((ROWS, m + 2 * n)), np.empty((2, m + 2 * n + 1), np.int64)
    room, inverse, sums = np.empty((2 * n, 2 * n)), np.empty((n, n)), np.empty((4, n))
    kind, most = NONE, STEPS * (m + 3 * n) if n <= SHORT else LONGER * (n + SHORT)
    for k in range(first, end):
        at_P, at_C = min(k, P.shape[0] - 1), min(k, C.shape[0] - 1)
        if k == first or at_P > 0:
            kind = _invert(P, at_P, real, room, inverse)
        if (k == first or at_P > 0 or at_C > 0) and not _look_at(P, at_P, C, at_C, real):
            kind = NONE
        for i in range(m):
            real[LIMIT, i] = d[k, i]
        for j in range(n):
            real[LIMIT, m + j], real[LIMIT, m + n + j], real[CENTER, j] = -lower[k, j], upper[k, j], 0.0
        steps[k], has_converged[k], contradicts[k] = 0, False, False
        for center in range(0 if kind == NONE else 1 if kind == DEFINITE else CENTERS):
            if center % AFRESH == 0:
                size = _begin(P, at_P, C, at_C, c, k, is_equality, real, whole, room, inverse)
            else:
                size = _begin_again(P, at_P, C, at_C, c, k, is_equality, real, whole, room, size)
            if size >= 0:
                size, made = _proceed(C, at_C, is_equality, real, whole, room, size, most - steps[k])
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
                _refine(P, at_P, c, k, C, at_C, is_equality, real, whole, room, size)
                for j in range(n):
                    x[k, j] = min(max(real[X, j], lower[k, j]), upper[k, j])
                for i in range(m):
                    y[k, i] = real[Y, i]
                largest = measure(
                    P, c, C, d, is_equality, lower, upper, k, at_P, at_C, sums, x, y, reduced, measures
                )
                has_converged[k] = largest <= tolerance
                if largest <= REFINED or (refinement >= SURE and not largest < SLOW * before):
                    break
                before = largest
            if has_converged[k]:
                break
