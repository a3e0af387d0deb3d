"""Small least squares within bounds, solved whole in one kernel.

A problem is solved by an active set that changes by one column at a time, as Lawson and Hanson do, between two
bounds as Stark and Parker do. The columns are kept as rows of `work`, of about unit length, with reflections applied
so that the free ones form a triangle; right-hand sides are kept with them. No square of A is formed. A column with a
penalty l1 |x| is on one side of 0 at a time, where that is linear; at 0 it may enter on either side.

References
----------
C. L. Lawson, R. J. Hanson, *Solving least squares problems*, Prentice-Hall 1974, chapter 23. P. B. Stark, R. L. Parker,
*Bounded-variable least-squares: an algorithm and applications*, Comput. Stat. 10 (1995).
"""

from __future__ import annotations

import math
from functools import partial

import numpy as np

from ...core.kernels.compilation import (
    LONGEST_IN_ORDER,
    compiled_in_any_order,
    compiled_into_others,
    compiled_part,
    interpreted_while_small,
)
from ...core.kernels.floats import EPSILON
from .sums import (
    part_of_columns,
    part_of_gap,
    part_of_largest,
    part_of_radii,
    part_of_ridge,
    part_of_rows,
    part_of_squares,
    power_above,
)

PULL = 16.0 * EPSILON  # of the lengths of a column and the right-hand side: less is rounding
DEPENDENT = 64.0 * EPSILON  # of its length, left of a column beside the free ones: less is rounding


@partial(interpreted_while_small, longest=LONGEST_IN_ORDER)
def solve_small(A, b, weights, ridge, l1, lower, upper, most, tolerance):  # type: ignore[no-untyped-def]
    """Return (x, A x − b, how optimal, faces solved) for the minimum; A by rows.

    How optimal is as in `problems.least_squares.certificate`, 1 at the most, for three y: the residual; that made
    orthogonal to the free columns; or that without the rows in which it is rounding.
    """
    m, n = A.shape
    x, residual, y, of_rows, of_columns = np.empty(n), np.empty(m), np.empty(m), np.empty((7, m)), np.empty((14, n))
    work, sets = np.empty((n + 2, m + n if ridge > 0.0 else m)), np.empty((3, n), np.int64)
    root, scales = of_rows[4], of_columns[4]
    _find_scales(A, weights, ridge, root, scales, of_columns)
    rounds = _minimum(A, b, root, ridge, l1, lower, upper, scales, most, x, work, of_columns, sets)
    nothing, optimality = x[:0], 1.0
    slip, right = of_rows[5], of_rows[6]
    part_of_rows(A, x, nothing, of_rows[:4])
    for i in range(m):
        of_rows[1, i] += abs(b[i])
        y[i] = residual[i] = of_rows[0, i] - b[i]
    part_of_radii(of_rows[:4], n, slip)
    sums, radius = of_columns[:4], of_columns[5]
    for attempt in range(3):
        for i in range(m):
            right[i] = weights[i] * y[i]
        part_of_columns(A, right, nothing, sums)
        part_of_radii(sums, m, radius)
        part_of_ridge(sums[0], radius, ridge, x)
        gap, cost, _ = part_of_gap(
            residual, slip, y, sums[0], radius, x, lower, upper, l1, root, scales, ridge, nothing, -1.0
        )
        optimality = 0.0 if gap == 0.0 else min(gap / cost, 1.0) if cost > 0.0 and gap < np.inf else 1.0
        if attempt == 2 or optimality <= tolerance:
            break
        if attempt == 0:
            for j in range(n):
                sums[0, j] += math.copysign(l1[j], x[j])  # of the free columns, which are not at 0
            _orthogonalise(A, y, sums[0], scales, work, sets, of_columns[6])
        for i in range(m if attempt == 1 else 0):
            y[i] = residual[i] if abs(residual[i]) > slip[i] else 0.0
    return x, residual, optimality, rounds


@compiled_part
def _orthogonalise(A, y, slope, scales, work, sets, v):  # type: ignore[no-untyped-def]
    """Take A v from y, v of the free columns, so that AᵀWy, which is the slope, becomes 0 there, but for a ridge."""
    free, count = sets[0], 0
    for j in range(scales.size):
        count += sets[1, j]
    for p in range(count):
        column = work[free[p]]
        v[p] = slope[free[p]] / scales[free[p]]
        for q in range(p):
            v[p] -= column[q] * v[q]
        v[p] /= column[p]
    for p in range(count - 1, -1, -1):
        column = work[free[p]]
        v[p] /= column[p]
        for q in range(p):
            v[q] -= column[q] * v[p]
    for p in range(count):
        for i in range(y.size):
            y[i] -= A[i, free[p]] * (v[p] / scales[free[p]])


@compiled_part
def _find_scales(A, weights, ridge, root, scales, workspace):  # type: ignore[no-untyped-def]
    """Write the roots of the weights, and the powers of two just above the lengths of the columns."""
    squares = workspace[0]
    for i in range(weights.size):
        root[i] = math.sqrt(weights[i])
    for j in range(scales.size):
        scales[j] = squares[j] = 0.0
    part_of_largest(scales, A, root)
    for j in range(scales.size):
        scales[j] = power_above(scales[j])
    part_of_squares(squares, A, root, scales, workspace[1])
    for j in range(scales.size):
        scales[j] = power_above(np.hypot(scales[j] * math.sqrt(squares[j]), math.sqrt(ridge)))


@compiled_part
def _minimum(  # type: ignore[no-untyped-def]
    A, b, root, ridge, l1, lower, upper, scales, most, x, work, workspace, sets
):
    """Write x, each column free or exactly at its bound; return the faces solved."""
    m, n = A.shape
    rows, right, low, high = work.shape[1], work[n], workspace[6], workspace[7]
    penalty, least, greatest = workspace[9], workspace[12], workspace[13]
    size = 0.0
    for i in range(m):
        size = max(size, abs(root[i] * b[i]))
    for j in range(n):
        x[j] = min(max(0.0, lower[j]), upper[j])
        size = max(size, abs(scales[j] * x[j]))
    size = power_above(size)
    for i in range(m):
        right[i] = root[i] * b[i] / size
        for j in range(n):
            work[j, i] = A[i, j] * root[i] / scales[j]
    for i in range(m, rows):
        right[i] = 0.0
        for j in range(n):
            work[j, i] = 0.0
    for j in range(n):
        low[j], high[j] = lower[j] * (scales[j] / size), upper[j] * (scales[j] / size)
        x[j] = min(max(x[j] * (scales[j] / size), low[j]), high[j])
        least[j], greatest[j], penalty[j] = low[j], high[j], l1[j] / scales[j] / size
        if ridge > 0.0:
            work[j, m + j] = math.sqrt(ridge) / scales[j]
    rounds = _exchange(work, right, low, high, x, most, work[n + 1], workspace[8:], sets)
    for j in range(n):
        there = min(max(x[j] * (size / scales[j]), lower[j]), upper[j])
        x[j] = lower[j] if x[j] <= least[j] else upper[j] if x[j] >= greatest[j] else there
    return rounds


@compiled_part
def _exchange(work, right, low, high, x, most, mirror, workspace, sets):  # type: ignore[no-untyped-def]
    """Move x to the minimum, a column at a time; return the faces solved, −1 − those where that takes too many.

    The workspace is for what is solved for on a face, the penalties, the slopes ±penalty of the sides on which columns
    are, what they are as right-hand sides of the triangle, and the bounds, of which low and high are those of a side.
    """
    n = x.size
    z, penalty, linear, turned, least, greatest = workspace
    has_penalty = False
    free, is_free, is_rejected = sets[0], sets[1], sets[2]
    count = rounds = 0
    noise = PULL * (1.0 + math.sqrt(_dot(right, right, 0)))
    for j in range(n):
        is_free[j] = is_rejected[j] = 0
        has_penalty |= penalty[j] > 0.0
        linear[j] = -penalty[j] if high[j] <= 0.0 else penalty[j]
        if x[j] != 0.0:
            _add(right, work[j], -x[j], 0)
    while rounds < most:
        leaning = turned[: count * has_penalty]
        j, falls = _hardest_pulled(
            work, right, x, is_free, is_rejected, count, noise, penalty, linear, leaning, least, greatest
        )
        if j < 0:
            return rounds
        if penalty[j] > 0.0 and x[j] == 0.0:
            linear[j] = -penalty[j] if falls else penalty[j]
            low[j], high[j] = (least[j], 0.0) if falls else (0.0, greatest[j])
        if not _enter(work, right, x, is_free, j, count, mirror):
            is_rejected[j] = 1
            continue
        free[count], is_free[j] = j, 1
        count += 1
        while count > 0:
            rounds += 1
            for p in range(count if has_penalty else 0):
                column, turned[p] = work[free[p]], linear[free[p]]
                for q in range(p):
                    turned[p] -= column[q] * turned[q]
                turned[p] /= column[p]
            hit, share = _triangle_solved(work, right, low, high, x, free, count, z, turned[: count * has_penalty])
            for p in range(count):
                i = free[p]
                x[i] = z[p] if hit < 0 else min(max(x[i] + share * (z[p] - x[i]), low[i]), high[i])
            if hit < 0:
                break
            x[free[hit]] = low[free[hit]] if z[hit] < low[free[hit]] else high[free[hit]]
            for p in range(count - 1, -1, -1):
                i = free[p]
                if x[i] == low[i] or x[i] == high[i]:
                    _leave(work, right, x, free, p, count)
                    is_free[i] = 0
                    count -= 1
        for i in range(n):
            is_rejected[i] = 0
        is_rejected[j] = not is_free[j]
    return -1 - rounds


@compiled_into_others
def _hardest_pulled(  # type: ignore[no-untyped-def]
    work, right, x, is_free, is_rejected, first, noise, penalty, linear, turned, low, high
):
    """Return the column at a bound, or 0, that is pulled away from there hardest, and if downwards; −1 for none."""
    best, hardest, falls = -1, noise, False
    for j in range(x.size):
        if not (is_free[j] or is_rejected[j]) and low[j] < high[j]:
            pull = _dot(work[j], right, first)
            up = down = linear[j]
            for p in range(turned.size):
                pull += work[j, p] * turned[p]
            if x[j] == 0.0:
                up, down = penalty[j], -penalty[j]
            if pull - up > hardest and x[j] < high[j]:
                best, hardest, falls = j, pull - up, False
            if down - pull > hardest and x[j] > low[j]:
                best, hardest, falls = j, down - pull, True
    return best, falls


@compiled_into_others
def _enter(work, right, x, is_free, j, p, mirror):  # type: ignore[no-untyped-def]
    """Reflect so that column j ends at row p; return False where it depends on the free ones."""
    column, rows = work[j], right.size
    length = math.sqrt(_dot(column, column, p))
    if p >= rows or length <= DEPENDENT * math.sqrt(_dot(column, column, 0)):
        return False
    _add(right, column, x[j], 0)
    end = -length if column[p] > 0.0 else length
    for i in range(rows):
        mirror[i] = column[i]
    mirror[p] -= end
    factor = -1.0 / (length * (length + abs(column[p])))
    _add(right, mirror, factor * _dot(mirror, right, p), p)
    for i in range(x.size):
        if not is_free[i] and i != j:
            _add(work[i], mirror, factor * _dot(mirror, work[i], p), p)
    column[p] = end
    for i in range(p + 1, rows):
        column[i] = 0.0
    return True


@compiled_into_others
def _leave(work, right, x, free, p, count):  # type: ignore[no-untyped-def]
    """Take column free[p] out, rotating those behind it back into a triangle."""
    n, gone = x.size, free[p]
    for q in range(p, count - 1):
        free[q] = free[q + 1]
        column = work[free[q]]
        length = np.hypot(column[q], column[q + 1])
        c, s = column[q] / length, column[q + 1] / length
        for i in range(n):
            above, below = work[i, q], work[i, q + 1]
            work[i, q], work[i, q + 1] = c * above + s * below, c * below - s * above
        above, below = right[q], right[q + 1]
        right[q], right[q + 1] = c * above + s * below, c * below - s * above
        column[q + 1] = 0.0
    _add(right, work[gone], -x[gone], 0)


@compiled_into_others
def _triangle_solved(work, right, low, high, x, free, count, z, turned):  # type: ignore[no-untyped-def]
    """Write the minimum on the face to z; return the first column that leaves its bounds on the way, and the share."""
    for p in range(count):
        z[p] = right[p] - turned[p] if turned.size else right[p]
    hit, share = -1, 1.0
    for p in range(count - 1, -1, -1):
        column = work[free[p]]
        z[p] /= column[p]
        for q in range(p):
            z[q] -= column[q] * z[p]
    for p in range(count):
        i = free[p]
        if not low[i] <= z[p] <= high[i]:
            part = ((low[i] if z[p] < low[i] else high[i]) - x[i]) / (z[p] - x[i])
            if part <= share:
                hit, share = p, part
    return hit, share


@compiled_into_others
def _dot(v, w, first):  # type: ignore[no-untyped-def]
    v, w = v[first:], w[first:]  # an index from 0 on is known not to be negative
    if v.size + first > 2 * LONGEST_IN_ORDER:  # A has as many rows, and a ridge
        return _long_dot(v, w)
    a = b = c = d = 0.0
    fours = v.size - v.size % 4
    for i in range(0, fours, 4):
        a += v[i] * w[i]
        b += v[i + 1] * w[i + 1]
        c += v[i + 2] * w[i + 2]
        d += v[i + 3] * w[i + 3]
    for i in range(fours, v.size):
        a += v[i] * w[i]
    return (a + b) + (c + d)


@compiled_in_any_order
def _long_dot(v, w):  # type: ignore[no-untyped-def]
    total = 0.0
    for i in range(v.size):
        total += v[i] * w[i]
    return total


@compiled_into_others
def _add(v, w, factor, first):  # type: ignore[no-untyped-def]
    v, w = v[first:], w[first:]
    for i in range(v.size):
        v[i] += factor * w[i]
