"""Many small dense LCPs, compiled: Lemke's path with both bounds, a linear solve on its active set, a sufficient test.

A loop solves one problem after another, in arrays that stay in the cache. The basic variables of a table T satisfy
x_B = v + T x_N + t T[:, n], with the numbers x_i = i, w_i = n + i and t = 2n.
"""

from __future__ import annotations

import math

import numpy as np

from .compilation import helper, kernel
from .floats import (
    EPSILON,
    FREE,
    HIGH,
    LOW,
    NEGLIGIBLE_DIAGONAL,
    PERTURBED,
    SMALLEST,
    SMALLEST_PIVOT,
)

ROUNDS = 12  # most active-set iterations from a start
SMALLEST_FREE_PIVOT = 1e-8  # of rows of free unknowns, which are eliminated first
SET_TO_BOUND = 2.0**-50  # of the largest z: a smaller distance from a bound is at rounding level
INF = math.inf


@kernel
def solve_problems(M, q, lower, upper, starts, tilts, tolerance, z, residual):  # type: ignore[no-untyped-def]
    """Write points into z, and upper bounds of their relative residuals: ∞ if the sufficient test does not hold.

    M is (B or 1, n, n); `starts` is (B, n), or has no columns; `tilts` has n perturbations of q. A start names an
    active set, from which active-set iterations begin; the path follows if they do not end at a solution.
    """
    n = q.shape[1]
    T, rows, side = np.empty((n, n + 1)), np.empty((9, n + 1)), np.empty(n, np.int64)
    basis, place = np.empty(n, np.int64), np.empty(2 * n + 1, np.int64)
    for k in range(q.shape[0]):
        A, x, problem = M[min(k, M.shape[0] - 1)], z[k], (q[k], lower[k], upper[k])
        residual[k] = INF
        for i in range(starts.shape[1]):
            x[i] = starts[k, i]
        for attempt in range(0 if starts.shape[1] else ROUNDS, ROUNDS + 1):
            if attempt < ROUNDS:
                has_end = name_active_set(A, *problem, x, side)
            else:
                has_end = follow_path(A, *problem, tilts, side, T, rows, basis, place)
            if has_end and solve_active_set(A, *problem, side, x, T, basis):
                residual[k] = measure(A, *problem, x, tolerance, rows, basis, place)
                if residual[k] < INF:
                    break
            else:
                x[0] = math.nan


@kernel
def solve_active_sets(M, q, lower, upper, sides, z):  # type: ignore[no-untyped-def]
    """Write z_i at the bound that `sides` names, w_i = 0 if FREE, of each problem; NaN for a singular system."""
    n = q.shape[1]
    T, free = np.empty((n, n + 1)), np.empty(n, np.int64)
    for k in range(q.shape[0]):
        A = M[min(k, M.shape[0] - 1)]
        if not solve_active_set(A, q[k], lower[k], upper[k], sides[k], z[k], T, free):
            z[k, 0] = math.nan


@helper
def name_active_set(M, q, lower, upper, z, side):  # type: ignore[no-untyped-def]
    """Write the active set of z − D⁻¹ w into `side`; return whether it differs from the one there."""
    has_changed = False
    for i in range(q.size):
        w, largest = q[i], 0.0
        for j in range(q.size):
            w += M[i, j] * z[j]
            largest = max(largest, abs(M[i, j]))
        step = w / scale_of(M[i, i], largest)
        at = LOW if step >= z[i] - lower[i] else HIGH if step <= z[i] - upper[i] else FREE
        has_changed |= at != side[i]
        side[i] = at
    return has_changed


@helper
def scale_of(diagonal, largest):  # type: ignore[no-untyped-def]
    """Return d_i, as `core.matrix.residual_scales`."""
    if largest == 0.0:
        return 1.0
    return diagonal if diagonal > 0.0 and diagonal >= NEGLIGIBLE_DIAGONAL * largest else largest


@helper
def solve_active_set(M, q, lower, upper, side, z, T, free):  # type: ignore[no-untyped-def]
    """Write z with this active set, not clipped; return whether the linear system is regular."""
    n, m = q.size, 0
    for i in range(n):
        z[i] = upper[i] if side[i] == HIGH else lower[i]
        if side[i] == FREE:
            z[i], free[m] = 0.0, i
            m += 1
    for a in range(m):
        i = free[a]
        right = q[i]
        for j in range(n):
            right += M[i, j] * z[j]
        for b in range(m):
            T[a, b] = M[i, free[b]]
        T[a, m] = -right
    for k in range(m):
        best, at = 0.0, k
        for i in range(k, m):
            if abs(T[i, k]) > best:
                best, at = abs(T[i, k]), i
        if not 0.0 < best < INF:
            return False
        if at != k:
            for j in range(k, m + 1):
                T[at, j], T[k, j] = T[k, j], T[at, j]
        for i in range(k + 1, m):
            factor = T[i, k] / T[k, k]
            if factor != 0.0:
                for j in range(k + 1, m + 1):
                    T[i, j] -= factor * T[k, j]
    for k in range(m - 1, -1, -1):
        total = T[k, m]
        for j in range(k + 1, m):
            total -= T[k, j] * z[free[j]]
        z[free[k]] = total / T[k, k]
        if not math.isfinite(z[free[k]]):
            return False
    return True


@helper
def exchange(T, row, column, factor, held):  # type: ignore[no-untyped-def]
    """Exchange the basic variable of a row and the nonbasic one of a column with the entries `factor`."""
    n = T.shape[0]
    inverse = 1.0 / factor[row]
    for j in range(n + 1):
        held[j] = -T[row, j] * inverse
    held[column] = inverse
    for i in range(n):
        rate = factor[i]
        T[i, column] = 0.0
        if rate != 0.0:
            for j in range(n + 1):
                T[i, j] += rate * held[j]
    for j in range(n + 1):
        T[row, j] = held[j]


@helper
def eliminate_free(free, side, T, v, factor, held, basis, place):  # type: ignore[no-untyped-def]
    """Make the free unknowns basic in their rows, the largest pivot first; return whether no pivot is small."""
    n = T.shape[0]
    for _ in range(n):
        best, row, column, is_done = SMALLEST_FREE_PIVOT, n, n, True
        for i in range(n):
            if free[i] == 0.0 or basis[i] < n:
                continue
            is_done = False
            for j in range(n):
                if free[j] != 0.0 and side[j] != FREE and abs(T[i, j]) > best:
                    best, row, column = abs(T[i, j]), i, j
        if is_done:
            break
        if row == n:
            return False
        for i in range(n):
            factor[i] = T[i, column]
        x = -v[row] / factor[row]
        for i in range(n):
            v[i] += factor[i] * x
        v[row] = x
        exchange(T, row, column, factor, held)
        side[column], basis[row], place[column], place[n + row] = FREE, column, row, column
    return True


@helper
def follow_path(M, q, lower, upper, tilts, side, T, rows, basis, place):  # type: ignore[no-untyped-def]
    """Write the active set at the end of Lemke's path from r = 1 into `side`; return whether the path has an end."""
    n = q.size
    v, width, low, high = rows[0], rows[1], rows[2], rows[3]
    factor, distance, free, base, held = rows[4], rows[5], rows[6], rows[7], rows[8]
    t, has_free = 2 * n, False
    for i in range(n):
        is_flipped = lower[i] == -INF
        free[i] = 1.0 if is_flipped and upper[i] == INF else 0.0
        has_free |= free[i] != 0.0
        base[i] = 0.0 if free[i] != 0.0 else upper[i] if is_flipped else lower[i]
        width[i] = upper[i] - lower[i]
        basis[i], side[i], place[i], place[n + i] = n + i, LOW, i, i
    place[t] = n
    for i in range(n):
        value, largest, sign = q[i], 0.0, -1.0 if lower[i] == -INF else 1.0
        for j in range(n):
            value += M[i, j] * base[j]
            largest = max(largest, abs(M[i, j]))
        sign /= largest if largest > 0.0 else 1.0
        for j in range(n):
            T[i, j] = M[i, j] * (-sign if lower[j] == -INF else sign)
        v[i], T[i, n] = value * sign, 1.0 - free[i]
    if has_free:
        if not eliminate_free(free, side, T, v, factor, held, basis, place):
            return False
        for i in range(n):
            largest = 0.0
            for j in range(n):
                largest = max(largest, (1.0 - free[j]) * abs(T[i, j]))
            if free[i] == 0.0 and largest > 0.0:
                for j in range(n):
                    T[i, j] /= largest
                v[i] /= largest
    largest, value = 0.0, 0.0
    for i in range(n):
        low[i] = -INF if width[i] == 0.0 or free[i] != 0.0 else 0.0
        high[i] = INF
        largest = max(largest, (1.0 - free[i]) * abs(v[i]))
    for i in range(n):
        v[i] += PERTURBED * largest * tilts[i]
        if low[i] == 0.0:
            value = max(value, -v[i])
    for i in range(n):
        v[i] += value * T[i, n]
    driven, direction, t_row = t, -1.0, -1
    for _ in range(10 * (n + 10)):
        column = place[driven]
        row, step = 0, INF
        for i in range(n):
            factor[i], distance[i] = T[i, column], INF
            rate = direction * factor[i]
            if abs(rate) > SMALLEST_PIVOT:
                distance[i] = ((low[i] if rate < 0.0 else high[i]) - v[i]) / rate
                if distance[i] < step:
                    row, step = i, distance[i]
        step = max(step, 0.0)
        if t_row >= 0 and distance[t_row] <= step * (1.0 + 1e-12):
            row = t_row
        own = value if driven == t else width[driven] if driven < n else INF
        if own <= step and own < INF:  # the driven variable reaches its other bound
            for i in range(n):
                v[i] += direction * own * factor[i]
            leaving, falls = driven, direction < 0.0
        elif not step < INF:
            return False
        else:
            leaving, falls = basis[row], direction * factor[row] < 0.0
            for i in range(n):
                v[i] += direction * step * factor[i]
            v[row] = value + direction * step
            low[row], high[row] = 0.0, INF
            if driven < n:
                side[driven], high[row] = FREE, width[driven]
            elif driven == t:
                t_row = row
            elif side[driven - n] == HIGH:
                low[row], high[row] = -INF, 0.0
            elif width[driven - n] == 0.0:
                low[row] = -INF
            if row == t_row and driven != t:
                t_row = -1
            basis[row], place[driven], place[leaving] = driven, row, column
            if leaving != t:
                exchange(T, row, column, factor, held)
        if leaving == t:
            break
        if leaving < n:
            side[leaving] = LOW if falls else HIGH
            driven, value, direction = n + leaving, 0.0, 1.0 if falls else -1.0
        else:
            driven = leaving - n
            value, direction = 0.0, 1.0
            if side[driven] == HIGH:
                value, direction = width[driven], -1.0
    else:
        return False
    for i in range(n):
        if lower[i] == -INF:
            side[i] = HIGH - side[i]
    return True


@helper
def measure(M, q, lower, upper, z, tolerance, rows, seen, queue):  # type: ignore[no-untyped-def]
    """Return :func:`bound_residual` of z moved into the bounds; noise near a bound is set to it if that helps."""
    n, size = q.size, 0.0
    for i in range(n):
        size = max(size, abs(z[i]))
    for i in range(n):
        x = z[i] if abs(z[i]) > SMALLEST * min(size, 1.0) else 0.0
        z[i] = min(max(x, lower[i]), upper[i])
    moved, found = rows[6], INF
    for attempt in range(2):
        has_moved = attempt == 0
        for i in range(n):
            moved[i] = z[i]
            if attempt and abs(z[i] - lower[i]) <= SET_TO_BOUND * size:
                moved[i] = lower[i]
            elif attempt and abs(upper[i] - z[i]) <= SET_TO_BOUND * size:
                moved[i] = upper[i]
            has_moved |= moved[i] != z[i]
        if has_moved:
            found = bound_residual(M, q, lower, upper, moved, tolerance, rows, seen, queue)
        if found < INF:
            for i in range(n):
                z[i] = moved[i]
            break
    return found


@helper
def bound_residual(M, q, lower, upper, z, tolerance, rows, seen, queue):  # type: ignore[no-untyped-def]
    """Return an upper bound of the relative residual of a z that the stopping criterion accepts; ∞ if in doubt.

    The graph of M is connected; the criterion does not move z; each violation is at rounding level, also relative to
    |q_i| or to the demand a_i; and ‖r(z)‖∞ with rounding is at most half the tolerance.
    """
    n = q.size
    violation, d, start, demand = rows[0], rows[1], rows[2], rows[3]
    if not is_connected(M, seen, queue):
        return INF
    has_start, is_start = False, True
    for i in range(n):
        start[i] = min(max(0.0, lower[i]), upper[i])
        has_start |= start[i] != 0.0
        is_start &= start[i] == z[i]
    first, counts, high = 0.0, 0.0, 0.0
    for i in range(n):
        w, products, largest = q[i], 0.0, 0.0
        for j in range(n):
            product = M[i, j] * z[j]
            w += product
            products += abs(product)
            largest = max(largest, abs(M[i, j]))
        w0, terms0 = q[i], abs(q[i])
        if has_start:
            for j in range(n):
                product = M[i, j] * start[j]
                w0 += product
                terms0 += abs(product)
        terms = products + abs(q[i])
        d[i] = scale_of(M[i, i], largest)
        rounding = 4.0 * (n + 8) * (EPSILON * terms + 2.0**-1000) if products > 0.0 else 0.0
        rounding0 = 4.0 * (n + 8) * (EPSILON * terms0 + 2.0**-1000) if has_start else 0.0
        is_above, is_below = z[i] > lower[i], z[i] < upper[i]
        wrong = max(w if is_above else 0.0, -w if is_below else 0.0)
        violation[i] = max(w + rounding if is_above else 0.0, rounding - w if is_below else 0.0)
        if not (wrong <= 2.0**-43 * terms and math.isfinite(terms)):
            return INF
        if (is_below and rounding - w >= d[i] * (upper[i] - z[i]) * (1.0 - 1e-9)) or (
            is_above and w + rounding >= d[i] * (z[i] - lower[i]) * (1.0 - 1e-9)
        ):
            return INF
        r = abs(min(max(w / d[i], z[i] - upper[i]), z[i] - lower[i]))
        high = max(high, r + rounding / d[i])
        if wrong > 0.0 or (is_above and is_below):
            counts = max(counts, terms / d[i])
        r0 = abs(min(max(w0 / d[i], start[i] - upper[i]), start[i] - lower[i]))
        first = max(first, r0 - rounding0 / d[i])
        demand[i] = abs(w0) if abs(w0) > 2.0**-41 * terms0 else 0.0
    limit = min(first, counts) * (1.0 - 4.0 * (n + 8) * EPSILON)
    if not (high <= 0.5 * tolerance * limit and (first > 0.0 or is_start)):
        return INF
    least = 0.5 * tolerance**0.25
    for i in range(n):
        if violation[i] > 2.0**-43 * abs(q[i]) or (has_start and violation[i] > 0.0):
            a = demand[i]
            for j in range(n):
                a = max(a, abs(M[i, j]) * demand[j] / d[j])
            if not violation[i] <= least * a:
                return INF
    return high / limit if high > 0.0 else 0.0


@helper
def is_connected(M, seen, queue):  # type: ignore[no-untyped-def]
    """Return whether the graph of M is connected; `seen` and `queue` are overwritten."""
    n = M.shape[0]
    for i in range(n):
        seen[i] = 0
    seen[0], queue[0], at, reached = 1, 0, 0, 1
    while at < reached < n:
        i = queue[at]
        at += 1
        for j in range(n):
            if seen[j] == 0 and (M[i, j] != 0.0 or M[j, i] != 0.0):
                seen[j], queue[reached] = 1, j
                reached += 1
    return reached == n
