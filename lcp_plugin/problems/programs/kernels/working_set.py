"""The inverse W of [[P, Aᵀ], [A, 0]], A the normals of active constraints, as constraints join and leave.

Whatever joins or leaves is one symmetric update of rank 1. Constraints are numbered: the rows C x ≤ d or C x = d, then
lower ≤ x, then x ≤ upper. W lies in `workspace`, vectors in one array `real`, shape (ROWS, m + 2n); `whole`, of the
same width, says which constraints are active. Where P is merely semidefinite, W is that of P with a little on its
diagonal.
"""

from __future__ import annotations

import numpy as np

from ....core.kernels.compilation import compiled_into_others, compiled_part
from ....core.kernels.floats import EPSILON
from ....methods.small.kernels.small_problems import USUAL, row_times
from .row_operations import add_row, add_row_of_batch, copy_row

# Rows of `real`: the point, its multipliers and limits; a step, what is left of the conditions; units.
X, Y, LIMIT, STEP, LEFT, SIZE, ROOT, SPREAD, CENTER, ROWS = 0, 1, 2, 3, 4, 5, 6, 7, 8, 9
ROW, ACTIVE = 0, 1  # of `whole`: the active constraints, from place n on; whether a constraint is one, or passed over

SINGULAR = 1e-8  # a pivot of P at unit diagonal: up to here it gets the proximal term
PROXIMAL = 1e-5  # beside a unit diagonal
DEPENDENT = 1e-13  # of gᵀ P⁻¹ g: what a normal g has outside of the active ones is rounding
NONE, DEFINITE, SEMIDEFINITE = 0, 1, 2


@compiled_part
def sweep(P, k, shift, least, real, workspace):  # type: ignore[no-untyped-def]
    """Write (P + shift)⁻¹, both at the units ROOT; return whether all pivots of P so were above `least`."""
    n = P.shape[1]
    for i in range(n):
        for j in range(n):
            workspace[i, j] = P[k, i, j] / (real[ROOT, i] * real[ROOT, j])
        workspace[i, i] += shift
    for p in range(n):
        pivot = workspace[p, p]
        if not pivot > least:
            return False
        for j in range(n):
            real[STEP, j] = workspace[p, j] / pivot
        for i in range(n):
            factor = workspace[i, p]
            if i != p and factor != 0.0:
                add_row(real, STEP, 0, n, -factor, workspace, i)
                workspace[i, p] = -factor / pivot
        copy_row(real, STEP, 0, n, workspace, p)
        workspace[p, p] = 1.0 / pivot
    return True


@compiled_part
def invert(P, k, real, workspace, inverse):  # type: ignore[no-untyped-def]
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
    if not sweep(P, k, 0.0, SINGULAR, real, workspace):
        kind = SEMIDEFINITE
        least = n * (n + 4) * EPSILON
        if not sweep(P, k, least, 0.0, real, workspace) or not sweep(P, k, PROXIMAL, 0.0, real, workspace):
            return NONE
    for i in range(n):
        for j in range(n):
            inverse[i, j] = workspace[i, j] / (real[ROOT, i] * real[ROOT, j])
        real[SPREAD, i] = inverse[i, i]
    return kind


@compiled_into_others
def is_equation(i, is_equality, n, real):  # type: ignore[no-untyped-def]
    """Return whether constraint i is one; of a fixed variable its upper bound is."""
    m = is_equality.size
    return is_equality[i] if i < m else i >= m + n and real[LIMIT, i] == -real[LIMIT, i - n]


@compiled_into_others
def left_hand_side(C, k, i, real):  # type: ignore[no-untyped-def]
    """Return the left-hand side of constraint i at X."""
    m, n = C.shape[1], C.shape[2]
    if i < m:
        return row_times(C, k, i, n, real, X)
    return -real[X, i - m] if i < m + n else real[X, i - m - n]


@compiled_part
def direction(C, k, i, real, workspace, size):  # type: ignore[no-untyped-def]
    """Write STEP = W (g, 0), g the normal of constraint i; return gᵀ H g, H the first n rows and columns of W.

    0 where g depends on the active normals.
    """
    m, n = C.shape[1], C.shape[2]
    if i >= m:
        j, sign = (i - m, -1.0) if i < m + n else (i - m - n, 1.0)
        for a in range(size):
            real[STEP, a] = sign * workspace[j, a]
        steepness, scale = sign * real[STEP, j], real[SPREAD, j]
    else:
        for a in range(size):
            real[STEP, a] = 0.0
        scale = 0.0
        for j in range(n):
            g = C[k, i, j]
            scale += g * g * real[SPREAD, j]
            if g != 0.0:
                add_row(workspace, j, 0, size, g, real, STEP)
        steepness = row_times(C, k, i, n, real, STEP)
    return steepness if steepness > DEPENDENT * scale and size < 2 * n else 0.0


@compiled_into_others
def join(real, whole, workspace, i, size, steepness):  # type: ignore[no-untyped-def]
    """Let constraint i join the active ones, STEP being its direction."""
    for a in range(size):
        factor = real[STEP, a] / steepness
        if factor != 0.0:
            add_row(real, STEP, 0, size, -factor, workspace, a)
        workspace[a, size] = workspace[size, a] = factor
    workspace[size, size] = -1.0 / steepness
    whole[ROW, size], whole[ACTIVE, i] = i, 1


@compiled_into_others
def leave(real, whole, workspace, at, last):  # type: ignore[no-untyped-def]
    """Let the constraint in row `at` of W leave the active ones; the last one takes its place."""
    pivot = workspace[at, at]
    copy_row(workspace, at, 0, last + 1, real, STEP)
    for a in range(last + 1):
        if real[STEP, a] != 0.0:
            add_row(real, STEP, 0, last + 1, -real[STEP, a] / pivot, workspace, a)
    copy_row(workspace, last, 0, last + 1, workspace, at)
    for a in range(last):
        workspace[a, at] = workspace[a, last]
    whole[ACTIVE, whole[ROW, at]] = 0
    whole[ROW, at] = whole[ROW, last]


@compiled_into_others
def move(real, whole, n, size, step, is_primal):  # type: ignore[no-untyped-def]
    """Go that far against STEP: the active multipliers, and x where it can."""
    if is_primal:
        for j in range(n):
            real[X, j] -= step * real[STEP, j]
    for a in range(n, size):
        real[Y, whole[ROW, a]] -= step * real[STEP, a]


@compiled_part
def gradient(P, at_P, c, k, real, n):  # type: ignore[no-untyped-def]
    """Write LEFT = P x + c."""
    for j in range(n):
        real[LEFT, j] = c[k, j]
    for i in range(n):
        add_row_of_batch(P, at_P, i, n, real[X, i], real, LEFT)


@compiled_part
def add_normals(C, at_C, real, whole, n, size):  # type: ignore[no-untyped-def]
    """Add the normals of active constraints, times their multipliers, to LEFT."""
    m = C.shape[1]
    for a in range(n, size):
        i = whole[ROW, a]
        if i < m:
            add_row_of_batch(C, at_C, i, n, real[Y, i], real, LEFT)
        else:
            real[LEFT, (i - m) % n] += real[Y, i] if i >= m + n else -real[Y, i]


@compiled_part
def multiply(real, workspace, count, size):  # type: ignore[no-untyped-def]
    """Write STEP = W times the first so many entries of LEFT."""
    for a in range(size):
        real[STEP, a] = 0.0
    for a in range(count):
        add_row(workspace, a, 0, size, real[LEFT, a], real, STEP)


@compiled_part
def look_at(P, at_P, C, at_C, real):  # type: ignore[no-untyped-def]
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
