"""Small dense quadratic programs from data to answer in one compiled loop: min ½ xᵀP x + cᵀx, C x ≤ d, bounds.

The steps are those of :mod:`.interior_steps` on the optimality conditions, z = (x, y) and M = [[P, Cᵀ], [−C, 0]], their
linear systems those of :mod:`.condensed_systems`. As soon as the active set stays what it was, its linear system is
solved. What does not come to an end here is left to others.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from ....core.kernels.compilation import compiled_part, interpreted_while_small
from ....core.kernels.floats import EPSILON
from ....methods.interior.kernels.interior_steps import (
    ABOVE,
    BEGUN,
    BELOW,
    CHOSEN,
    CORRECTIONS,
    DIAGONAL,
    DONE,
    FOUND,
    GAP,
    HAS_LOWER,
    HAS_UPPER,
    IS_PROGRAM,
    LEFT,
    LOWER,
    PAIRS,
    RIGHT,
    TRIAL,
    UPPER,
    W_LOWER,
    W_UPPER,
    Q,
    Z,
    advance,
    begin,
    move,
)
from .condensed_systems import (
    LARGEST,
    PINNED,
    SPARE,
    SYSTEM_FACTS,
    SYSTEM_ROWS,
    UNIT,
    equilibrate,
    factorise,
    product,
    solve,
)
from .program_residuals import PRODUCT_SIZE, beside_sizes, judge_column, judge_row

SIDE, WIDTH = SYSTEM_ROWS, SYSTEM_ROWS + 1  # a row of `vectors`: the active side
AT_LOWER, BETWEEN, AT_UPPER = -1.0, 0.0, 1.0

STEPS = 60
ROUGH, SHARP = 1e-8, 1e-15  # beside the right-hand side: what a direction, and an active set, may leave
SETTLED_GAP, CLOSED_GAP = 1e-3, 1e-18  # of the first gap: an active set is tried; nothing more is gained
ROUNDS = 5  # corrections of an active set
INSIDE = 1.5  # times the worst violation is what the start is shifted by
NUMBERS = 2**17  # in the arrays of a call that may be interpreted: its loops are on rows


@partial(interpreted_while_small, numbers=NUMBERS)
def run(  # type: ignore[no-untyped-def]
    P, c, C, d, is_equality, lower, upper, tolerance, first, end, vectors, matrix, P_scaled, C_scaled, x, y,
    reduced, measures, steps, has_converged,
):
    """Write x, y, reduced, measures, steps and has_converged of the programs first ≤ k < end.

    P and C, shapes (1 or count, n, n) and (1 or count, m, n), may be shared. `vectors`, shape (WIDTH, n + m), `matrix`,
    shape (n + m, n + m), and the two scaled matrices are room to work in.
    """
    facts, room = np.zeros(SYSTEM_FACTS), np.zeros((4, vectors.shape[1]))
    for k in range(first, end):
        at_P, at_C = min(k, P.shape[0] - 1), min(k, C.shape[0] - 1)
        equilibrate(P, C, at_P, at_C, vectors, P_scaled, C_scaled)
        _fill(c, d, is_equality, lower, upper, k, vectors, facts)
        steps[k], has_converged[k] = 0, False
        if not _start(vectors, facts, matrix, room, P_scaled, C_scaled):
            continue
        first_gap, settled = facts[GAP], 0
        while steps[k] < STEPS and not has_converged[k]:
            product(P_scaled, C_scaled, vectors, Z, LEFT)
            if not begin(vectors, facts):
                break
            kept = factorise(P_scaled, C_scaled, vectors, facts, matrix, room)
            if kept < 0:
                break
            phase = advance(vectors, facts, BEGUN)
            while phase != DONE:
                solve(P_scaled, C_scaled, vectors, facts, matrix, kept, ROUGH)
                phase = advance(vectors, facts, phase)
            if not move(vectors, facts):
                break
            steps[k] += 1
            settled = 0 if _guess(vectors) else settled + 1
            is_closed = facts[GAP] <= CLOSED_GAP * first_gap
            if is_closed or (settled in (1, 3, 6, 10) and facts[GAP] <= SETTLED_GAP * first_gap):
                has_converged[k] = _has_active_set(
                    P, c, C, d, is_equality, lower, upper, k, at_P, at_C, tolerance, vectors, facts, matrix, room,
                    P_scaled, C_scaled, x, y, reduced, measures,
                )
                if is_closed:
                    break


@compiled_part
def _fill(c, d, is_equality, lower, upper, k, vectors, facts):  # type: ignore[no-untyped-def]
    """Fill in what the steps take: q, the bounds of x and of multipliers, how many pairs there are."""
    n, m = c.shape[1], d.shape[1]
    pairs = 0.0
    for i in range(n + m):
        if i < n:
            unit, low, high = vectors[UNIT, i], lower[k, i], upper[k, i]
            vectors[Q, i] = c[k, i] * unit
        else:
            unit, high = vectors[UNIT, i], np.inf
            low = -np.inf if is_equality[i - n] else 0.0
            vectors[Q, i] = d[k, i - n] * unit
        has_lower, has_upper = 1.0 if abs(low) < np.inf else 0.0, 1.0 if abs(high) < np.inf else 0.0
        vectors[HAS_LOWER, i], vectors[HAS_UPPER, i] = has_lower, has_upper
        vectors[LOWER, i] = low / unit if has_lower > 0.0 else 0.0
        vectors[UPPER, i] = high / unit if has_upper > 0.0 else 0.0
        vectors[SIDE, i] = BETWEEN
        pairs += has_lower + has_upper
    for i in range(facts.size):
        facts[i] = 0.0
    facts[PAIRS], facts[CORRECTIONS], facts[IS_PROGRAM] = pairs, 1.0, 1.0


@compiled_part
def _start(vectors, facts, matrix, room, P, C):  # type: ignore[no-untyped-def]
    """Begin where M z + q = anchor − z on the bounded rows, shifted inwards as Mehrotra does."""
    m, n = C.shape
    for i in range(n + m):
        sides = vectors[HAS_LOWER, i] + vectors[HAS_UPPER, i]
        vectors[DIAGONAL, i] = min(sides, 1.0)
        vectors[RIGHT, i] = (vectors[LOWER, i] + vectors[UPPER, i]) / max(sides, 1.0) - vectors[Q, i]
    kept = factorise(P, C, vectors, facts, matrix, room)
    if kept < 0:
        return False
    solve(P, C, vectors, facts, matrix, kept, ROUGH)
    for i in range(n + m):
        z, sides = vectors[FOUND, i], vectors[HAS_LOWER, i] + vectors[HAS_UPPER, i]
        w = (vectors[LOWER, i] + vectors[UPPER, i]) / max(sides, 1.0) - z
        if not abs(z) < LARGEST:
            return False
        vectors[Z, i] = z
        vectors[BELOW, i] = z - vectors[LOWER, i] if vectors[HAS_LOWER, i] > 0.0 else 1.0
        vectors[ABOVE, i] = vectors[UPPER, i] - z if vectors[HAS_UPPER, i] > 0.0 else 1.0
        vectors[W_LOWER, i], vectors[W_UPPER, i] = w * vectors[HAS_LOWER, i], -w * vectors[HAS_UPPER, i]
    for is_dual in (False, True):
        least = 0.0
        for part in range(4):
            for i in range(n + m):
                if vectors[HAS_LOWER + part % 2, i] > 0.0 and ((i < n) == (part < 2)) != is_dual:
                    least = min(least, vectors[BELOW + part, i])
        for part in range(4):
            for i in range(n + m):
                if vectors[HAS_LOWER + part % 2, i] > 0.0 and ((i < n) == (part < 2)) != is_dual:
                    vectors[BELOW + part, i] -= INSIDE * least
    _shift(vectors, n, m)
    total = 0.0
    for i in range(n + m):
        if vectors[HAS_LOWER, i] * vectors[HAS_UPPER, i] > 0.0:
            half = 0.5 * (vectors[UPPER, i] - vectors[LOWER, i])
            vectors[BELOW, i], vectors[ABOVE, i] = min(vectors[BELOW, i], half), min(vectors[ABOVE, i], half)
        if vectors[HAS_LOWER, i] > 0.0:
            vectors[Z, i] = vectors[LOWER, i] + vectors[BELOW, i]
        elif vectors[HAS_UPPER, i] > 0.0:
            vectors[Z, i] = vectors[UPPER, i] - vectors[ABOVE, i]
        total += vectors[BELOW, i] * vectors[W_LOWER, i] + vectors[ABOVE, i] * vectors[W_UPPER, i]
    facts[GAP] = total / max(facts[PAIRS], 1.0)
    return True


@compiled_part
def _shift(vectors, n, m):  # type: ignore[no-untyped-def]
    """Add to all that is primal, and to all that is dual, half of the products beside the sum of the others."""
    product, primal, dual = 0.0, 0.0, 0.0
    for side in range(2):
        for i in range(n + m):
            if vectors[HAS_LOWER + side, i] > 0.0:
                distance, multiplier = vectors[BELOW + side, i], vectors[W_LOWER + side, i]
                product += distance * multiplier
                primal += distance if i < n else multiplier
                dual += multiplier if i < n else distance
    is_usable = (product > 0.0) & (product < np.inf)
    to_primal = 0.5 * product / dual if is_usable and dual > 0.0 else 1.0
    to_dual = 0.5 * product / primal if is_usable and primal > 0.0 else 1.0
    for side in range(2):
        for i in range(n + m):
            if vectors[HAS_LOWER + side, i] > 0.0:
                vectors[BELOW + side, i] += to_primal if i < n else to_dual
                vectors[W_LOWER + side, i] += to_dual if i < n else to_primal


@compiled_part
def _guess(vectors):  # type: ignore[no-untyped-def]
    """Fill SIDE with the bounds that are nearer than their multipliers are large; return whether it has changed."""
    has_changed = False
    for i in range(vectors.shape[1]):
        side = BETWEEN
        if vectors[BELOW, i] < vectors[W_LOWER, i]:
            side = AT_LOWER
        elif vectors[ABOVE, i] < vectors[W_UPPER, i]:
            side = AT_UPPER
        has_changed |= side != vectors[SIDE, i]
        vectors[SIDE, i] = side
    return has_changed


@compiled_part
def _has_active_set(  # type: ignore[no-untyped-def]
    P, c, C, d, is_equality, lower, upper, k, at_P, at_C, tolerance, vectors, facts, matrix, room, P_scaled, C_scaled,
    x, y, reduced, measures,
):
    """Solve for the active set and correct it; return whether its point is an answer, which x, y and measures are."""
    m, n = C_scaled.shape
    point, side_now = CHOSEN, CHOSEN + 1  # rows that are free between steps
    for i in range(n + m):
        vectors[point, i], vectors[side_now, i] = vectors[Z, i], vectors[SIDE, i]
    for _round in range(ROUNDS):
        for i in range(n + m):
            side = vectors[side_now, i]
            if side != BETWEEN:
                vectors[point, i] = vectors[LOWER, i] if side == AT_LOWER else vectors[UPPER, i]
            vectors[DIAGONAL, i] = 0.0 if side == BETWEEN else PINNED
        kept = factorise(P_scaled, C_scaled, vectors, facts, matrix, room)
        if kept < 0:
            return False
        for _twice in range(2):
            product(P_scaled, C_scaled, vectors, point, RIGHT)
            for i in range(n + m):
                is_free = vectors[side_now, i] == BETWEEN
                vectors[RIGHT, i] = vectors[RIGHT, i] + vectors[Q, i] if is_free else 0.0
            solve(P_scaled, C_scaled, vectors, facts, matrix, kept, SHARP)
            for i in range(n + m):
                if vectors[side_now, i] == BETWEEN:
                    vectors[point, i] -= vectors[FOUND, i]
        _unscale(lower, upper, is_equality, k, vectors, point, n, m, x, y)
        if measure(
            P, c, C, d, is_equality, lower, upper, k, at_P, at_C, vectors, x, y, reduced, measures
        ) <= tolerance:
            return True
        if not _correct(P_scaled, C_scaled, vectors, point, side_now):
            return False
    return False


@compiled_part
def _correct(P, C, vectors, point, side_now):  # type: ignore[no-untyped-def]
    """Put what is beyond a bound onto it, let go what is pushed inwards; return whether anything was changed."""
    has_changed = False
    product(P, C, vectors, point, TRIAL)
    for i in range(vectors.shape[1]):
        w, z, side = vectors[TRIAL, i] + vectors[Q, i], vectors[point, i], vectors[side_now, i]
        if side == BETWEEN:
            if vectors[HAS_LOWER, i] > 0.0 and z < vectors[LOWER, i]:
                vectors[side_now, i], has_changed = AT_LOWER, True
            elif vectors[HAS_UPPER, i] > 0.0 and z > vectors[UPPER, i]:
                vectors[side_now, i], has_changed = AT_UPPER, True
        elif (w < 0.0 if side == AT_LOWER else w > 0.0) and vectors[LOWER, i] != vectors[UPPER, i]:
            vectors[side_now, i], has_changed = BETWEEN, True
    return has_changed


@compiled_part
def _unscale(lower, upper, is_equality, k, vectors, point, n, m, x, y):  # type: ignore[no-untyped-def]
    for i in range(n):
        x[k, i] = min(max(vectors[point, i] * vectors[UNIT, i], lower[k, i]), upper[k, i])
    for i in range(m):
        multiplier = vectors[point, n + i] * vectors[UNIT, n + i]
        y[k, i] = multiplier if is_equality[i] else max(multiplier, 0.0)


@compiled_part
def measure(  # type: ignore[no-untyped-def]
    P, c, C, d, is_equality, lower, upper, k, at_P, at_C, vectors, x, y, reduced, measures
):
    """Write upper bounds of what :class:`~lcp_plugin.problems.programs.qp_solution.QPSolution` measures.

    Return the largest.

    Of a bound that x is at the multiplier is what stationarity leaves; `reduced` is that of the lower one less that of
    the upper one.
    """
    m, n = C.shape[1], C.shape[2]
    margin, worst = 2.0 * (n + m + 8) * EPSILON, measures[k]
    worst[:] = 0.0
    slope, right, violated, has_P = 0.0, 0.0, 0.0, False
    for j in range(n):
        vectors[SPARE, j] = 0.0  # the largest entry of each column
        for i in range(n):
            vectors[SPARE, j] = max(vectors[SPARE, j], abs(P[at_P, i, j]))
        has_P |= vectors[SPARE, j] > 0.0
        vectors[TRIAL, j], vectors[TRIAL + 1, j], vectors[TRIAL + 2, j] = c[k, j], abs(c[k, j]), abs(c[k, j])
    for i in range(m):
        value, size, largest, coefficient = 0.0, 0.0, 0.0, 0.0
        multiplier, limit = y[k, i], d[k, i]
        for j in range(n):
            entry = C[at_C, i, j]
            summand = entry * x[k, j]
            value += summand
            size += abs(summand)
            largest = max(largest, abs(summand))
            coefficient = max(coefficient, abs(entry))
            vectors[SPARE, j] = max(vectors[SPARE, j], abs(entry))
            pull = entry * multiplier
            vectors[TRIAL, j] += pull
            vectors[TRIAL + 1, j] += abs(pull)
            vectors[TRIAL + 2, j] = max(vectors[TRIAL + 2, j], abs(pull))
        coefficient = coefficient if coefficient > 0.0 else 1.0
        unit, error = coefficient * (1.0 + abs(limit) / coefficient), margin * (size + abs(limit))
        judge_row(worst, value - limit, error, limit, largest, multiplier, unit, is_equality[i])
        if is_equality[i]:
            right = max(right, abs(limit) / coefficient)
        else:
            violated = max(violated, -limit / coefficient)
    for j in range(n):
        column = vectors[SPARE, j] if vectors[SPARE, j] > 0.0 else 1.0
        vectors[SPARE, j] = column
        slope = max(slope, abs(c[k, j]) / column)
    unit = 1.0 + (max(slope, right, violated) if has_P else slope)
    for j in range(n):
        value, size, largest = 0.0, 0.0, vectors[TRIAL + 2, j]
        for i in range(n):
            summand = P[at_P, j, i] * x[k, i]
            value += summand
            size += abs(summand)
            largest = max(largest, abs(summand))
        left, error = vectors[TRIAL, j] + value, margin * (size + vectors[TRIAL + 1, j])
        reduced[k, j] = 0.0
        if x[k, j] == (lower[k, j] if left > 0.0 else upper[k, j]):  # what is left is the multiplier of that bound
            worst[PRODUCT_SIZE] = max(worst[PRODUCT_SIZE], abs(left * x[k, j]))
            reduced[k, j], left = left, 0.0
        judge_column(
            worst, left, error, x[k, j], c[k, j], value, P[at_P, j, j], lower[k, j], upper[k, j], largest,
            vectors[SPARE, j] * unit,
        )
    return beside_sizes(worst)
