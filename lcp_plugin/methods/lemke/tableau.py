"""Lemke's path on a dense tableau: complementary pivoting along w = M z + q + t r, 0 ≤ z ≤ u, from t = ∞ to t = 0.

The tableau expresses the n basic variables by the n + 1 others, so a pivot touches n (n + 1) numbers. Exactly one of
z_i, w_i is basic for every row i but the *driven* row; SIDE is the place of z_i: AT_LOWER (w_i ≥ 0 basic), BETWEEN (z_i
basic), AT_UPPER (w_i ≤ 0 basic). Bounds belong to variables. The caller perturbs q, so that no two rows block at once.
Variables are numbered z_i = i, w_i = n + i, t = 2n. Vectors are rows of `real`, index vectors rows of `whole`.

A few pivots are made at a time, and the caller renews the tableau (:func:`make_pivots`). Rows are divided by their
largest entry.
"""

from __future__ import annotations

import numpy as np

from ...core.kernels.compilation import inline, kernel
from ...core.rounding import ROUNDING

KEPT, WIDTH, LOW, HIGH, DISTANCE = np.arange(5)  # rows of `real`
SIDE, BASIC, PLACE, OTHER, START = range(5)  # rows of `whole`
AT_LOWER, BETWEEN, AT_UPPER, NOT_STARTED = 0, 1, 2, 3
OWN_BOUND, UNBLOCKED = -1, -2
GOING_ON, SOLVED, RAY, SMALL_PIVOT, RETURNED = 0, 1, 2, 3, 4


@kernel
def make_pivots(real, whole, matrix, n, driven, value, direction, is_fresh, limit):  # type: ignore[no-untyped-def]
    """Make up to `limit` pivots; return (outcome, driven variable, its value and direction, pivots made).

    Parameters
    ----------
    real, whole, matrix : arrays
        Rows KEPT, LOW, HIGH, WIDTH; rows BASIC, OTHER, PLACE, SIDE, START. `matrix` is the tableau, and behind it one
        row of workspace. All but WIDTH and START are updated.
    is_fresh : bool
        True if the tableau has just been computed: a first pivot of any size is then accepted.
    """
    made, outcome = 0, GOING_ON
    while made < limit and outcome == GOING_ON:
        column, largest = whole[PLACE, driven] - n, 0.0
        for i in range(n):
            largest = max(largest, abs(matrix[i, column]))
        row, step = _blocking(real, whole, matrix, n, column, direction, value, driven)
        if row == UNBLOCKED:
            outcome = RAY
            break
        # A pivot so small is taken in a new tableau only.
        if row >= 0 and not (is_fresh and made == 0) and abs(matrix[row, column]) < 1e-9 * largest:
            outcome = SMALL_PIVOT
            break
        left, driven, value, direction = _move(
            real, whole, matrix, n, driven, value, direction, row, column, step
        )
        made += 1
        if row >= 0:
            _exchange(matrix, n, matrix[n], row, column)
        entered = BETWEEN if driven < n else AT_LOWER if direction > 0.0 else AT_UPPER
        is_back = True
        for i in range(n):
            is_back &= whole[START, i] == (entered if i == driven % n else whole[SIDE, i])
        if left == 2 * n:
            outcome = SOLVED
        elif is_back:  # a path from an arbitrary active set may be a loop
            outcome = RETURNED
    return outcome, driven, value, direction, made


@inline
def _exchange(matrix, n, pivot_row, row, column):  # type: ignore[no-untyped-def]
    """Exchange the variables of `row` and `column` in the tableau; `pivot_row` is workspace."""
    p = matrix[row, column]
    for j in range(n + 1):
        pivot_row[j] = matrix[row, j] / -p
        matrix[row, j] = 0.0
    pivot_row[column], matrix[row, column] = 1.0 / p, 1.0
    for i in range(n):
        factor = matrix[i, column]
        matrix[i, column] = 0.0
        if factor != 0.0:
            for j in range(n + 1):
                matrix[i, j] += factor * pivot_row[j]


@inline
def _move(real, whole, matrix, n, driven, value, direction, row, column, step):  # type: ignore[no-untyped-def]
    """Move the driven variable by a step, at whose end `row` blocks it; return the leaving and the driven variable.

    The leaving variable is 2n at the end of the path, and OWN_BOUND if the driven variable has reached its other bound.
    The driven variable is returned with its value and direction.
    """
    is_falling = row >= 0 and direction * matrix[row, column] < 0.0
    for i in range(n):
        real[KEPT, i] += direction * step * matrix[i, column]
    if row == OWN_BOUND and driven == 2 * n:
        return driven, driven, 0.0, direction
    if row == OWN_BOUND:
        whole[SIDE, driven] = AT_UPPER if direction > 0.0 else AT_LOWER
        return row, n + driven, 0.0, -direction
    real[KEPT, row] = value + direction * step
    leaving, entering = whole[BASIC, row], whole[OTHER, column]
    whole[BASIC, row], whole[OTHER, column] = entering, leaving
    whole[PLACE, entering], whole[PLACE, leaving] = row, n + column
    if entering < n:
        whole[SIDE, entering] = BETWEEN
        real[LOW, row], real[HIGH, row] = 0.0, real[WIDTH, entering]
    else:
        is_above = entering == 2 * n or whole[SIDE, entering - n] == AT_LOWER
        real[LOW, row], real[HIGH, row] = 0.0 if is_above else -np.inf, np.inf if is_above else 0.0
    if leaving == 2 * n:
        return leaving, driven, value, direction
    if leaving < n:
        whole[SIDE, leaving] = AT_LOWER if is_falling else AT_UPPER
        return leaving, n + leaving, 0.0, 1.0 if is_falling else -1.0
    i = leaving - n  # w_i reached 0: z_i leaves its bound
    is_low = whole[SIDE, i] == AT_LOWER
    return leaving, i, 0.0 if is_low else real[WIDTH, i], 1.0 if is_low else -1.0


@inline
def _blocking(real, whole, matrix, n, column, direction, value, driven):  # type: ignore[no-untyped-def]
    """Return the row that blocks the driven variable (or OWN_BOUND, NOTHING) and the distance; t blocks first."""
    reach = real[WIDTH, driven] if driven < n else value if driven == 2 * n else np.inf
    nearest, row = reach, OWN_BOUND if reach < np.inf else UNBLOCKED
    for i in range(n):
        rate = direction * matrix[i, column]
        to_bound = (real[LOW, i] if rate < 0.0 else real[HIGH, i]) - real[KEPT, i]
        distance = max(to_bound / rate, 0.0) if abs(rate) > 1e-11 else np.inf
        real[DISTANCE, i] = distance
        if distance < nearest:
            row, nearest = i, distance
    if not nearest < np.inf:
        return UNBLOCKED, nearest
    if whole[PLACE, 2 * n] < n and real[DISTANCE, whole[PLACE, 2 * n]] <= nearest * (
        1.0 + ROUNDING
    ):
        row = whole[PLACE, 2 * n]
    return row, nearest
