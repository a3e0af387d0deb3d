"""Many small dense LCPs, compiled: Lemke's paths with both bounds, linear solves on active sets.

A loop solves one problem after another, in arrays that stay in the cache: `table` and `numbers`, scratch of shape
(n + 9, n + 1) and (2, 2n + 1). M is (B or 1, n, n). Compilation takes seconds, in proportion to the number of loops,
branches and constants of another type, so each kernel is one function; vectors are prepared by numpy.
"""

from __future__ import annotations

import math

from .compilation import kernel
from .floats import FREE, HIGH, INF, LOW, PERTURBED, SMALLEST_PIVOT

LOST = -1  # first side of a path without end


@kernel
def follow_paths(M, q, lower, upper, tilts, label, T, numbers, sides):  # type: ignore[no-untyped-def]
    """Write the active set at the end of Lemke's path into `sides`; each unknown has a finite bound.

    The path begins along r = 1, or along the column of M that `label` names, ≥ 0 where w may be negative, if not −1.

    In x = sign (z − base), 0 ≤ x ≤ width, the basic variables of the table T satisfy x_B = v + T x_N + t T[:, n], with
    the numbers x_i = i, w_i = n + i and t = 2n. `tilts` has n perturbations of q.
    """
    n = q.shape[1]
    v, low, high, factor, distance, held = T[n], T[n + 1], T[n + 2], T[n + 3], T[n + 4], T[n + 5]
    base, sign, width, basis, place = T[n + 6], T[n + 7], T[n + 8], numbers[0], numbers[1]
    t = 2 * n
    for k in range(q.shape[0]):
        m, size, value = k % M.shape[0], 0.0, 0.0
        for i in range(n):
            base[i], sign[i], width[i] = lower[k, i], 1.0, upper[k, i] - lower[k, i]
            if base[i] == -INF:
                base[i], sign[i] = upper[k, i], -1.0
        for i in range(n):
            basis[i], place[i], place[n + i], sides[k, i] = n + i, i, i, LOW
            low[i], high[i], T[i, n] = 0.0, INF, 1.0
            total, largest = q[k, i], 0.0
            for j in range(n):
                entry = M[m, i, j]
                total += entry * base[j]
                largest = max(largest, abs(entry))
                T[i, j] = entry * sign[j]
            scale = sign[i] / largest if largest > 0.0 else sign[i]
            for j in range(n):
                T[i, j] *= scale
            v[i] = total * scale
            if label >= 0:
                T[i, n] = T[i, label]
            size = max(size, abs(v[i]))
        for i in range(n):
            v[i] += PERTURBED * size * tilts[i]
            if width[i] == 0.0:
                low[i] = -INF
            elif T[i, n] > 0.0:
                value = max(value, -v[i] / T[i, n])
        for i in range(n):
            v[i] += value * T[i, n]
        place[t] = n
        driven, direction, t_row, leaving, row = t, -1.0, t, n, n
        for _ in range(10 * (n + 10)):
            column, step = place[driven], INF
            for i in range(n):
                factor[i], distance[i] = T[i, column], INF
                rate = direction * factor[i]
                if abs(rate) > SMALLEST_PIVOT:
                    distance[i] = ((low[i] if rate < 0.0 else high[i]) - v[i]) / rate
                    if distance[i] < step:
                        row, step = i, distance[i]
            step = max(step, 0.0)
            if t_row < n and distance[t_row] <= step * (1.0 + 1e-12):
                row = t_row
            reach, leaving, rate = INF, driven, direction
            if driven < n:
                reach = width[driven]
            elif driven == t:
                reach = value
            is_exchange = reach > step or reach == INF  # else it reaches its other bound
            if is_exchange:
                if step == INF:
                    leaving = n
                    break
                reach, leaving, rate = step, basis[row], direction * factor[row]
            for i in range(n):
                v[i] += direction * reach * factor[i]
            if is_exchange:
                v[row], low[row], high[row] = value + direction * step, 0.0, INF
                if driven < n:
                    sides[k, driven], high[row] = FREE, width[driven]
                elif driven == t:
                    t_row = row
                elif sides[k, driven - n] == HIGH:
                    low[row], high[row] = -INF, 0.0
                elif width[driven - n] == 0.0:
                    low[row] = -INF
                if row == t_row and driven != t:
                    t_row = t
                basis[row], place[driven], place[leaving] = driven, row, column
                inverse = -1.0 / factor[row]
                for j in range(n + 1):
                    held[j], T[row, j] = T[row, j] * inverse, 0.0
                held[column], factor[row] = -inverse, 1.0
                for i in range(n):
                    rate_of_row = factor[i]
                    T[i, column] = 0.0
                    if rate_of_row != 0.0:
                        for j in range(n + 1):
                            T[i, j] += rate_of_row * held[j]
            if leaving == t:
                break
            if leaving < n:
                sides[k, leaving] = HIGH if rate > 0.0 else LOW
                driven, value, direction = n + leaving, 0.0, math.copysign(1.0, -rate)
            else:
                driven, value, direction = leaving - n, 0.0, 1.0
                if sides[k, driven] == HIGH:
                    value, direction = width[driven], -1.0
        for i in range(n):
            if sign[i] < 0.0:
                sides[k, i] = HIGH - sides[k, i]
        if leaving != t:
            sides[k, 0] = LOST


@kernel
def solve_active_sets(M, q, lower, upper, sides, table, free, z):  # type: ignore[no-untyped-def]
    """Write z_i at the bound that `sides` names, w_i = 0 if FREE, not clipped; NaN for a singular system."""
    n = q.shape[1]
    T = table
    for k in range(q.shape[0]):
        at, m, least = k % M.shape[0], 0, INF
        for i in range(n):
            z[k, i] = upper[k, i] if sides[k, i] == HIGH else lower[k, i]
            if sides[k, i] == FREE:
                z[k, i], free[m] = 0.0, i
                m += 1
        for a in range(m):
            right = q[k, free[a]]
            for j in range(n):
                right += M[at, free[a], j] * z[k, j]
            for b in range(m):
                T[a, b] = M[at, free[a], free[b]]
            T[a, m] = -right
        for c in range(m):
            best, row = 0.0, c
            for i in range(c, m):
                if abs(T[i, c]) > best:
                    best, row = abs(T[i, c]), i
            least = min(least, best)
            for j in range(c, m + 1):
                held = T[row, j]
                T[row, j] = T[c, j]
                T[c, j] = held
            for i in range(c + 1, m):
                factor = T[i, c] / T[c, c]
                if factor != 0.0:
                    for j in range(c + 1, m + 1):
                        T[i, j] -= factor * T[c, j]
        for c in range(m - 1, -1, -1):
            total = T[c, m]
            for j in range(c + 1, m):
                total -= T[c, j] * z[k, free[j]]
            z[k, free[c]] = total / T[c, c]
        if not least > 0.0 or sides[k, 0] == LOST:
            z[k, 0] = math.nan
