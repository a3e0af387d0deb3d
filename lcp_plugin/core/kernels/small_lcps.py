"""Many small dense LCPs, compiled: Lemke's paths with both bounds, linear solves on active sets, a sufficient test.

A loop solves one problem after another, in arrays that stay in the cache: `table` and `numbers`, scratch of shape
(n + 9, n + 1) and (2, 2n + 1). M is (B or 1, n, n). Compilation takes seconds, in proportion to the number of loops,
branches and constants of another type, so each kernel is one function; vectors are prepared by numpy.
"""

from __future__ import annotations

import math

from .compilation import kernel
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

SET_TO_BOUND = 2.0**-50  # of the largest z: a smaller distance from a bound is at rounding level
LOST = -1  # first side of a path without end
INF = math.inf


@kernel
def follow_paths(M, q, lower, upper, tilts, T, numbers, sides):  # type: ignore[no-untyped-def]
    """Write the active set at the end of Lemke's path from r = 1 into `sides`; each unknown has a finite bound.

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
            size = max(size, abs(v[i]))
        for i in range(n):
            v[i] += PERTURBED * size * tilts[i]
            if width[i] > 0.0:
                value = max(value, -v[i])
            else:
                low[i] = -INF
        for i in range(n):
            v[i] += value
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
            own, leaving, rate = INF, driven, direction
            if driven < n:
                own = width[driven]
            elif driven == t:
                own = value
            is_exchange = own > step or own == INF  # else it reaches its other bound
            if is_exchange:
                if step == INF:
                    leaving = n
                    break
                own, leaving, rate = step, basis[row], direction * factor[row]
            for i in range(n):
                v[i] += direction * own * factor[i]
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
        at, m, least = k % M.shape[0], n - n, INF
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


@kernel
def bound_residuals(M, q, lower, upper, start, tolerance, rows, z, residual):  # type: ignore[no-untyped-def]
    """Write upper bounds of the relative residuals of points that the stopping criterion accepts; ∞ if in doubt.

    z is moved into the bounds; noise near a bound is set to it if that helps. `start` is z°. The test implies the
    criterion (:mod:`lcp_plugin.core.certificates.criterion`) at exponent 1, because

    - all rows are in one component, so that the maxima over all rows are its ‖r‖∞ and its reference;
    - the computed w, T and w(z°) are within `rounding`, which is at least twice the criterion's own bound, so that
      their values by another order of summation stay within the limits here;
    - −w_i/d_i does not reach a bound, rounding included, so that the criterion does not move z;
    - ‖r‖∞ with rounding is at most half of the tolerance times `limit`, and `limit` is below the reference;
    - each violation is at most 2⁻⁴³ T_i, half of what the componentwise test allows at any tolerance.
    """
    n = q.shape[1]
    moved, seen = rows[0], rows[1]
    margin, reached = 4.0 * (n + 8), 0.0
    for k in range(q.shape[0]):
        m, residual[k], size, shift = k % M.shape[0], INF, 0.0, 0.0
        for i in range(n):
            seen[i] = 0.0
            size = max(size, abs(z[k, i]))
            shift = max(shift, abs(start[k, i]))
        if k < M.shape[0]:
            seen[0], reached, before = 1.0, 1.0, 0.0
            while before < reached < n:
                before = reached
                for i in range(n):
                    if seen[i] == 1.0:
                        seen[i] = 2.0
                        for j in range(n):
                            if seen[j] == 0.0 and (M[m, i, j] != 0.0 or M[m, j, i] != 0.0):
                                seen[j] = 1.0
                                reached += 1.0
        for attempt in range(2):
            for i in range(n):
                x = z[k, i] if abs(z[k, i]) > SMALLEST * min(size, 1.0) else 0.0
                if x - lower[k, i] <= attempt * SET_TO_BOUND * size:
                    x = lower[k, i]
                elif upper[k, i] - x <= attempt * SET_TO_BOUND * size:
                    x = upper[k, i]
                moved[i] = x
            first, counts, high, away, is_right = 0.0, 0.0, 0.0, 0.0, reached == n
            for i in range(n):
                w, w0, largest = q[k, i], q[k, i], 0.0
                terms, terms0 = abs(w), abs(w)
                for j in range(n):
                    product = M[m, i, j] * moved[j]
                    w += product
                    terms += abs(product)
                    largest = max(largest, abs(M[m, i, j]))
                if shift > 0.0:
                    for j in range(n):
                        product = M[m, i, j] * start[k, j]
                        w0 += product
                        terms0 += abs(product)
                d = M[m, i, i]
                if d < NEGLIGIBLE_DIAGONAL * largest or not d > 0.0:
                    d = largest if largest > 0.0 else 1.0
                rounding = margin * (EPSILON * terms + 2.0**-1000) if terms > abs(q[k, i]) else 0.0
                rounding0 = margin * (EPSILON * terms0 + 2.0**-1000) if shift > 0.0 else 0.0
                above, below = moved[i] - lower[k, i], upper[k, i] - moved[i]
                up, down = w if above > 0.0 else -INF, -w if below > 0.0 else -INF
                wrong = max(up, down, 0.0)
                r = max(min(up, d * above), min(down, d * below), 0.0)
                high = max(high, (r + rounding) / d)
                if wrong > 0.0 or min(above, below) > 0.0:
                    counts = max(counts, terms / d)
                is_right &= (
                    wrong <= 2.0**-43 * terms < INF
                    and (down + rounding < d * below * (1.0 - 1e-9) or below == 0.0)
                    and (up + rounding < d * above * (1.0 - 1e-9) or above == 0.0)
                )
                below, above = upper[k, i] - start[k, i], start[k, i] - lower[k, i]
                first = max(first, abs(min(max(w0 / d, -below), above)) - rounding0 / d)
                away = max(away, abs(start[k, i] - moved[i]))
            limit = min(first, counts) * (1.0 - margin * EPSILON)
            is_right &= high <= 0.5 * tolerance * limit and (first > 0.0 or away == 0.0)
            if is_right or attempt == 0:
                for i in range(n):
                    z[k, i] = moved[i]
            if is_right:
                residual[k] = high / limit if high > 0.0 else 0.0
                break
