"""The derivatives of many small solutions in one compiled loop; arrays as in ``methods.small.kernels.workspace``.

First each z is solved for once more on its free rows, unless that would change it by rounding alone, and its rows are
told apart. Rows at a kink are held if that leaves a regular block, or freed, if that makes the block regular. What is
near one, has a singular block, or loses half of its digits in the elimination is left to others.

An array with one row in front stands for all problems.
"""

from __future__ import annotations

import numpy as np

from ...core.kernels.compilation import IN_ANY_ORDER, helper, inlined, kernel
from ...core.kernels.floats import EPSILON
from ...methods.small.kernels.small_problems import classify, look_at, slack, take
from ...methods.small.kernels.small_systems import solve_free
from ...methods.small.kernels.workspace import (
    AT_LOWER,
    AT_UPPER,
    BETWEEN,
    CANDIDATE,
    FOUND,
    FREE,
    KEPT,
    LOWER,
    SCALE,
    SIDE,
    UPPER,
    Q,
    W,
    Z,
    sizes,
)

STEPS = 6  # of the active-set method; from a solved problem one or two settle all rows
NOT_SMALL = 2.0**-10  # of a diagonal entry beside its row
HALF = 2.0**-26  # of the digits of a double
KINK = 4  # added to the side of a row that is at a bound with w = 0: to this bound's, or to BETWEEN where it is freed


@kernel
def settle_all(M, q, lower, upper, first, end, z, side, is_plain):  # type: ignore[no-untyped-def]
    """Make z exact to rounding and find the sides of its rows, first ≤ k < end; `is_plain` says where that succeeded.

    Only rows of z with `is_plain` are looked at.
    """
    n = M.shape[1]
    of_real, of_whole, of_matrix = sizes(n)
    real, whole, matrix = np.empty(of_real), np.empty(of_whole, np.int64), np.empty(of_matrix)
    for k in range(first, end):
        if not is_plain[k]:
            continue
        take(q, lower, upper, k, real, n)
        for i in range(n):
            real[Z, i] = z[k, i]
        is_plain[k] = _settled(M, k if M.shape[0] > 1 else 0, real, whole, matrix)
        if is_plain[k]:
            for i in range(n):
                z[k, i], side[k, i] = real[FOUND, i], whole[SIDE, i]


@inlined
def _settled(M, k, real, whole, matrix):  # type: ignore[no-untyped-def]
    """Write FOUND and SIDE, from Z; return whether every row is clearly on one."""
    n = M.shape[1]
    _, is_usual, _, is_symmetric = look_at(M, k, real)
    if not is_usual:
        return False
    for i in range(n):
        real[FOUND, i] = real[Z, i]
    for step in range(STEPS):
        slack(M, k, real, FOUND)
        classify(real, whole, n, FOUND)
        beside = 0.0
        for i in range(n):
            beside = max(beside, abs(real[FOUND, i])) if step == STEPS - 1 else 0.0
        is_exact, is_clear = _judged(M, k, real, whole, beside)
        if is_exact:
            _choose(M, k, real, whole, matrix, is_symmetric)
            return is_clear
        if solve_free(M, k, real, whole, matrix, is_symmetric) < 0:
            _hold(real, whole, n)
    return False


@inlined
def _hold(real, whole, n):  # type: ignore[no-untyped-def]
    """Put the rows of FOUND that are held at their bound."""
    for i in range(n):
        if whole[SIDE, i] != BETWEEN:
            real[FOUND, i] = real[UPPER if whole[SIDE, i] == AT_UPPER else LOWER, i]


@helper
def _choose(M, k, real, whole, matrix, is_symmetric):  # type: ignore[no-untyped-def]
    """Free the rows at a kink where the block is singular without them and regular with them."""
    n, kinks = M.shape[1], 0
    for i in range(n):
        kinks += whole[SIDE, i] >= KINK
        real[KEPT, i], whole[CANDIDATE, i] = real[FOUND, i], whole[SIDE, i]
    if kinks == 0:
        return
    for freed in range(2):
        for i in range(n):
            if whole[CANDIDATE, i] >= KINK:
                whole[SIDE, i] = BETWEEN if freed else whole[CANDIDATE, i] % KINK
        is_regular = _solved(M, k, real, whole, matrix, is_symmetric)
        if is_regular:
            break
    for i in range(n):
        real[FOUND, i], side = real[KEPT, i], whole[CANDIDATE, i]
        whole[SIDE, i] = BETWEEN + KINK if side >= KINK and is_regular and freed else side


@helper(**IN_ANY_ORDER)
def _judged(M, k, real, whole, beside):  # type: ignore[no-untyped-def]
    """Return whether another solve would change FOUND by rounding alone, and whether each row is clear; mark kinks.

    A row is at a kink where both its slack and its distance from the bounds are rounding, and clear where one of them
    has half of its digits. What lies between takes more digits to judge, and so do rows that hardly depend on their own
    variable: a slack of rounding may stand for a large one. With equal bounds the side is that which the sign of w
    asks for. Elimination leaves rows of small unknowns the rounding of larger ones: where no solve makes it less, it is
    allowed `beside` those.
    """
    n = M.shape[1]
    is_exact = is_clear = True
    for i in range(n):
        size, terms, largest = abs(real[Q, i]), 2, 0.0
        for j in range(n):
            largest = max(largest, abs(M[k, i, j]))
            size += abs(M[k, i, j] * real[FOUND, j])
            terms += M[k, i, j] != 0.0
        z, w, lower, upper, side = (
            real[FOUND, i],
            abs(real[W, i]),
            real[LOWER, i],
            real[UPPER, i],
            whole[SIDE, i],
        )
        distance, floor = (
            min(z - lower, upper - z) * real[SCALE, i],
            terms * EPSILON * (size + largest * beside),
        )
        if side == BETWEEN:
            is_exact &= w <= floor
        else:
            is_exact &= z == (upper if side == AT_UPPER else lower)
        if lower == upper:
            whole[SIDE, i] = AT_UPPER if real[W, i] < 0.0 else AT_LOWER
        elif w <= floor and distance <= floor and M[k, i, i] >= NOT_SMALL * largest:
            whole[SIDE, i] = (AT_UPPER if upper - z < z - lower else AT_LOWER) + KINK
        else:
            is_clear &= (distance if side == BETWEEN else w) > HALF * size
    return is_exact, is_clear


@inlined
def _solved(M, k, real, whole, matrix, is_symmetric):  # type: ignore[no-untyped-def]
    """Write FOUND by one linear solve; return whether no pivot is half rounding.

    Pivots of a block that is not symmetric are in units of their rows.
    """
    free = solve_free(M, k, real, whole, matrix, is_symmetric)
    keeps_digits = free >= 0
    for p in range(free):
        unit = real[SCALE, whole[FREE, p]] if is_symmetric else 1.0
        keeps_digits &= abs(matrix[p, p]) > HALF * unit
    return keeps_digits


@kernel
def solve_all(M, side, right, first, end, x, is_plain):  # type: ignore[no-untyped-def]
    """Write the solutions of M_FF x = right_F, 0 in held rows; NaN where there is none."""
    n = M.shape[1]
    of_real, of_whole, of_matrix = sizes(n)
    real, whole, matrix = np.empty(of_real), np.empty(of_whole, np.int64), np.empty(of_matrix)
    for k in range(first, end):
        for i in range(n):
            real[Q, i], real[LOWER, i], real[UPPER, i] = -right[k, i], 0.0, 0.0
            whole[SIDE, i], x[k, i] = side[k, i] % KINK, np.nan
        if not is_plain[k]:
            continue
        of = k if M.shape[0] > 1 else 0
        is_solved = _solved(M, of, real, whole, matrix, look_at(M, of, real)[3])
        for i in range(n if is_solved else 0):
            x[k, i] = real[FOUND, i]
