"""Branch and bound over the cases of a small problem in doubles: a solution, or what an exact proof needs to know.

As :class:`~lcp_plugin.methods.search.explorer.Explorer`, with rounding: each case is a set of bounds on z and
w = M z + q, a simplex method on the tableau that expresses the basic variables by the others moves to a point within
them, or a row of the tableau says why there is none. Variables are numbered z_i = i, w_i = n + i. Nothing here proves:
a Farkas vector counts only where exact arithmetic confirms it.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ...core.kernels.compilation import helper, kernel
from ...core.kernels.floats import NEGLIGIBLE_DIAGONAL
from ...core.kernels.rows import residual_of_row

AT_LOWER, AT_ZERO, AT_UPPER = 0, 1, 2  # the choices of a row
ROW, PARENT, CHOICE, IS_CLOSED = 0, 1, 2, 3  # columns of the tree
FOUND, EXCLUDED, GAVE_UP = 0, 1, 2
NONE: Any = np.int64(-1)  # numba compiles what a plain −1 is passed to once more for that number

FEASIBLE = 1e-10  # a bound missed by less, beside the largest w at the start
SMALLEST_PIVOT = 1e-10  # rows of M have a largest entry of 1
RENEWED_AFTER = 64  # pivots
MARGIN_GIVEN = 0.0625  # of a contradiction, for signs that survive rounding
FARTHEST = 2.0**-16  # moved for that, beside the largest multiplier


@kernel
def look_at(M, q, lower, upper, limit, first, tree, y, z):  # type: ignore[no-untyped-def]
    """Look at the cases; return FOUND, EXCLUDED or GAVE_UP, how many, the tableau entries computed, and `least`.

    Not only for the first solution, it splits cases with a solution until all rows have made their choice, and leaves
    these open, as it does with what it does not come to.

    Where they are all excluded, no z has a smaller relative residual than `least`, as doubles say.

    Parameters
    ----------
    M : array, shape (n, n)
    q, lower, upper : arrays, shape (n,)
    limit : float
        Entries of the tableau after which no case is begun.
    first : bool
        Whether to end with the first solution.
    tree : array of int, shape (cases, 4), to be filled
        The row that splits a case, −1 in a leaf; its parent; the choice of the parent's row; whether it is closed.
    y : array, shape (cases, n + 1), to be filled
        The multipliers of the equations that close it, and by how much they contradict then.
    z : array, shape (n,), to be filled
        The solution, where one is found.
    """
    n = q.size
    unit, scale, table, origin = np.ones(n), np.ones(n), np.empty((n, n + 1)), np.empty((n, n + 1))
    basic, other, stack = (
        np.empty(n, np.int64),
        np.empty(n, np.int64),
        np.empty(2 * n + 2, np.int64),
    )
    root, bounds, reach = np.empty((2, 2 * n)), np.empty((2, 2 * n)), np.empty((2, 2 * n))
    value, is_decided = np.zeros(2 * n), np.empty(n, np.bool_)
    size, reference = _begin(
        M, q, lower, upper, unit, scale, table, origin, basic, other, root, value
    )
    allowed, least = FEASIBLE * size, np.inf
    tree[0, ROW] = tree[0, PARENT] = tree[0, CHOICE] = -1
    tree[0, IS_CLOSED] = stack[0] = 0
    top, count, seen, pivots, spent = 1, 1, 0, np.int64(0), 0.0
    while top > 0:
        top -= 1
        case = stack[top]
        seen += 1
        if spent > limit:
            return GAVE_UP, seen, spent, 0.0
        _narrow(case, tree, lower, upper, root, bounds, is_decided)
        outcome, row, sign, pivots, more = _move_within(
            table, origin, basic, other, bounds, value, allowed, pivots
        )
        spent += more
        if outcome == GAVE_UP:
            return GAVE_UP, seen, spent, 0.0
        if outcome == EXCLUDED:
            _close(M, table, basic, other, bounds, value, row, sign, unit, y[case])
            tree[case, IS_CLOSED] = 1
            least = min(
                least, y[case, n] / (reference * _weight(M, lower, upper, bounds, scale, y[case]))
            )
            continue
        i = _row_to_split(
            table, basic, other, bounds, root, value, reach, is_decided, allowed, first
        )
        spent += n * n
        if i < 0 and not first:
            continue
        if i < 0:
            for j in range(n):
                z[j] = min(max(value[j], lower[j]), upper[j])
            return FOUND, seen, spent, 0.0
        if count + 3 > tree.shape[0] and not first:
            continue
        if count + 3 > tree.shape[0]:
            return GAVE_UP, seen, spent, 0.0
        tree[case, ROW] = i
        for choice in (AT_UPPER, AT_ZERO, AT_LOWER):  # the last is looked at first
            if (choice == AT_UPPER and upper[i] == np.inf) or (
                choice == AT_LOWER and lower[i] == -np.inf
            ):
                continue
            tree[count, ROW], tree[count, PARENT], tree[count, CHOICE], tree[count, IS_CLOSED] = (
                -1,
                case,
                choice,
                0,
            )
            stack[top] = count
            top, count = top + 1, count + 1
    return EXCLUDED, seen, spent, least


@helper
def _begin(M, q, lower, upper, unit, scale, table, origin, basic, other, root, value):  # type: ignore[no-untyped-def]
    """Write the first tableau, its rows' units and scales, the bounds without a choice, and z nearest to 0.

    Return the largest w there, in the tableau's units, and the largest relative residual.
    """
    n, size, reference = q.size, 0.0, 0.0
    for i in range(n):
        root[0, i], root[1, i] = lower[i], upper[i]
        root[0, n + i] = 0.0 if upper[i] == np.inf else -np.inf
        root[1, n + i] = 0.0 if lower[i] == -np.inf else np.inf
        value[i] = min(max(0.0, lower[i]), upper[i])
        basic[i], other[i] = n + i, i
    for i in range(n):
        largest = 0.0
        for j in range(n):
            largest = max(largest, abs(M[i, j]))
        if largest > 0.0:
            unit[i] = 1.0 / largest
            scale[i] = M[i, i] if M[i, i] >= NEGLIGIBLE_DIAGONAL * largest else largest
        total = table[i, n] = origin[i, n] = unit[i] * q[i]
        for j in range(n):
            table[i, j] = origin[i, j] = unit[i] * M[i, j]
            total += origin[i, j] * value[j]
        size = max(size, abs(total))
        total /= unit[i] * scale[i]
        reference = max(reference, abs(residual_of_row(total, value[i], lower[i], upper[i])))
    return size, reference


@helper
def _narrow(case, tree, lower, upper, root, bounds, is_decided):  # type: ignore[no-untyped-def]
    """Write the bounds that the choices of a case and of those above it leave, and which rows have made theirs."""
    n = lower.size
    for x in range(2 * n):
        bounds[0, x], bounds[1, x] = root[0, x], root[1, x]
    for i in range(n):
        is_decided[i] = lower[i] == upper[i] or (lower[i] == -np.inf and upper[i] == np.inf)
    child = case
    while tree[child, PARENT] >= 0:
        i = tree[tree[child, PARENT], ROW]
        _choose(bounds, i, n, tree[child, CHOICE])
        is_decided[i] = True
        child = tree[child, PARENT]


@helper
def _move_within(table, origin, basic, other, bounds, value, allowed, pivots):  # type: ignore[no-untyped-def]
    """Pivot until the basic variables lie within their bounds, up to `allowed`; after 3 n pivots by Bland's rule.

    Return FOUND; or EXCLUDED with the row of the tableau that contradicts, and +1 where its variable cannot reach the
    lower bound, −1 for the upper one; or GAVE_UP. Then the pivots since the tableau was computed afresh, and how many
    of its entries were.
    """
    n, spent, tries = basic.size, 0.0, 0
    for k in range(n):
        x = other[k]
        value[x] = min(max(value[x], bounds[0, x]), bounds[1, x])
    while True:
        if pivots >= RENEWED_AFTER:
            pivots = 0
            spent += n * n * (n + 1.0)
            if not _renewed(table, origin, basic, other, n):
                return GAVE_UP, NONE, 1.0, pivots, spent
        spent += n * (n + 1.0)
        row, sign, worst, is_last = NONE, 1.0, allowed, tries > 3 * n
        for k in range(n):
            x, total = basic[k], table[k, n]
            for j in range(n):
                total += table[k, j] * value[other[j]]
            value[x] = total
            gap = max(bounds[0, x] - total, total - bounds[1, x])
            if gap > worst and (not is_last or row < 0 or x < basic[row]):
                row, sign = k, 1.0 if total < bounds[0, x] else -1.0
                worst = allowed if is_last else gap
        if row < 0:
            return FOUND, row, sign, pivots, spent
        column, best = NONE, SMALLEST_PIVOT
        for j in range(n):
            x, entry = other[j], table[row, j]
            end = bounds[1, x] if entry * sign > 0.0 else bounds[0, x]
            if (
                abs(entry) > best
                and value[x] != end
                and (not is_last or column < 0 or x < other[column])
            ):
                column, best = j, SMALLEST_PIVOT if is_last else abs(entry)
        if column < 0:
            return EXCLUDED, row, sign, pivots, spent
        x = basic[row]
        value[x] = bounds[0, x] if sign > 0.0 else bounds[1, x]
        _exchange(table, basic, other, n, row, column)
        tries, pivots = tries + 1, pivots + 1
        spent += n * (n + 1.0)
        if tries > 20 * n + 20:
            return GAVE_UP, NONE, 1.0, pivots, spent


@helper
def _choose(bounds, i, n, choice):  # type: ignore[no-untyped-def]
    """Narrow the bounds of z_i and w_i to one choice of the row."""
    if choice == AT_ZERO:
        bounds[0, n + i] = bounds[1, n + i] = 0.0
    elif choice == AT_LOWER:
        bounds[1, i], bounds[0, n + i], bounds[1, n + i] = bounds[0, i], 0.0, np.inf
    else:
        bounds[0, i], bounds[0, n + i], bounds[1, n + i] = bounds[1, i], -np.inf, 0.0


@helper
def _exchange(table, basic, other, n, row, column):  # type: ignore[no-untyped-def]
    """Let the basic variable of `row` and the other one of `column` change places."""
    p = table[row, column]
    for j in range(n + 1):
        table[row, j] /= -p
    table[row, column] = 1.0 / p
    for i in range(n):
        factor = table[i, column]
        if i != row and factor != 0.0:
            table[i, column] = 0.0
            for j in range(n + 1):
                table[i, j] += factor * table[row, j]
    basic[row], other[column] = other[column], basic[row]


@helper
def _renewed(table, origin, basic, other, n):  # type: ignore[no-untyped-def]
    """Compute the tableau of the present basis afresh; return False where it is singular."""
    is_basic = np.zeros(2 * n, np.bool_)
    for k in range(n):
        is_basic[basic[k]] = True
    for k in range(n):
        basic[k], other[k] = n + k, k
        for j in range(n + 1):
            table[k, j] = origin[k, j]
    for column in range(n):
        if not is_basic[column]:
            continue
        row, best = NONE, SMALLEST_PIVOT
        for k in range(n):
            if not is_basic[basic[k]] and abs(table[k, column]) > best:
                row, best = k, abs(table[k, column])
        if row < 0:
            return False
        _exchange(table, basic, other, n, row, column)
    return True


@helper
def _close(M, table, basic, other, bounds, value, row, sign, unit, y):  # type: ignore[no-untyped-def]
    """Write the multipliers of the row whose basic variable cannot reach its bound; sign +1: the lower one.

    Their products with the columns of other basic z_j are zero, in doubles about zero, and need a sign: a little of
    the rows of these z_j is added, as little as leaves all other signs and most of the contradiction. Where all terms
    of the product are zero it is none, and to add would take a sign from a row that has no part in the contradiction.
    """
    n = basic.size
    added = np.zeros(n)
    x, cost = basic[row], 0.0
    contradiction = sign * ((bounds[0, x] if sign > 0.0 else bounds[1, x]) - value[x])
    largest = 1.0 if x >= n else 0.0
    for j in range(n):
        if other[j] >= n:
            largest = max(largest, abs(table[row, j]))
    for i in range(n):
        y[i] = 0.0
    if x >= n:
        y[x - n] = sign
    for j in range(n):
        if other[j] >= n and abs(table[row, j]) > SMALLEST_PIVOT * largest:
            y[other[j] - n] = -sign * table[row, j]
    for k in range(n):
        x, is_rounded = basic[k], False
        for i in range(n):
            is_rounded |= x < n and y[i] != 0.0 and M[i, x] != 0.0
        if is_rounded and k != row and (bounds[0, x] == -np.inf) != (bounds[1, x] == np.inf):
            way = 1.0 if bounds[1, x] == np.inf else -1.0
            cost += way * (value[x] - (bounds[0, x] if way > 0.0 else bounds[1, x]))
            for j in range(n):
                added[j] += way * table[k, j]
    step = FARTHEST * largest
    if cost > 0.0:
        step = min(step, MARGIN_GIVEN * contradiction / cost)
    for j in range(n):
        x, entry = other[j], sign * table[row, j]
        has_sign = bounds[0, x] == -np.inf or bounds[1, x] == np.inf
        if has_sign and abs(entry) > SMALLEST_PIVOT * largest and entry * added[j] < 0.0:
            step = min(step, 0.5 * abs(entry / added[j]))
    y[n] = contradiction - step * cost
    for j in range(n):
        if other[j] >= n:
            y[other[j] - n] -= step * added[j]
    for i in range(n):
        y[i] *= unit[i]


@helper
def _weight(M, lower, upper, bounds, scale, y):  # type: ignore[no-untyped-def]
    """Return what a residual of 1 on every row takes from the contradiction of the multipliers."""
    n, weight = scale.size, 0.0
    for i in range(n):
        if lower[i] < upper[i] and bounds[0, i] == bounds[1, i]:
            total = 0.0
            for k in range(n):
                total += y[k] * M[k, i]
            weight += abs(total)
        else:
            weight += abs(y[i]) * scale[i]
    return weight


@helper
def _row_to_split(table, basic, other, bounds, root, value, reach, is_decided, allowed, first):  # type: ignore[no-untyped-def]
    """Return a row that the point violates, one with the fewest choices left first; −1 where it solves the problem.

    Not only for the first solution, some row that is not decided; −1 where there is none.
    """
    n = basic.size
    for j in range(n):
        x = other[j]
        reach[0, x], reach[1, x] = bounds[0, x], bounds[1, x]
    for k in range(n):
        low = high = table[k, n]
        for j in range(n):
            entry, x = table[k, j], other[j]
            if abs(entry) > SMALLEST_PIVOT:
                low += entry * (bounds[0, x] if entry > 0.0 else bounds[1, x])
                high += entry * (bounds[1, x] if entry > 0.0 else bounds[0, x])
        reach[0, basic[k]], reach[1, basic[k]] = low, high
    found, worst, single, some = -1, 0.0, -1, -1
    for i in range(n):
        if is_decided[i]:
            continue
        w, bottom, top = value[n + i], root[0, i], root[1, i]
        is_up, is_down = reach[1, n + i] >= -allowed, reach[0, n + i] <= allowed
        left = 1 if is_up and is_down else 0
        left += 1 if bottom > -np.inf and reach[0, i] <= bottom + allowed and is_up else 0
        left += 1 if top < np.inf and reach[1, i] >= top - allowed and is_down else 0
        gap = abs(value[i] - (bottom if w > 0.0 else top)) if abs(w) > allowed else 0.0
        if gap > allowed and gap * abs(w) > worst:
            found, worst = i, gap * abs(w)
        if left <= 1 and single < 0:
            single = i
        some = i if some < 0 else some
    if not first:
        return single if single >= 0 else found if found >= 0 else some
    return single if found >= 0 and single >= 0 else found
