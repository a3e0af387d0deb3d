"""Compiled sweeps and descents of a dense semidefinite P; they know arrays only."""

from __future__ import annotations

import numpy as np

from ...core.kernels.compilation import IN_ANY_ORDER, helper, kernel
from ...core.kernels.floats import EPSILON


@kernel
def sweep(P, inverse_diagonal, lower, upper, x, slope, count):  # type: ignore[no-untyped-def]
    """Overwrite x by `count` sweeps x_i ← mid(l_i, u_i, x_i − slope_i/p_ii), and slope = P x + c with it.

    A row that stays where it is costs nothing. `inverse_diagonal` is 0 on the rows to leave alone.
    """
    for _ in range(count):
        for i in range(x.size):
            new = min(max(x[i] - slope[i] * inverse_diagonal[i], lower[i]), upper[i])
            change = new - x[i]
            if change != 0.0:
                x[i], row = new, P[i]
                for j in range(x.size):
                    slope[j] += change * row[j]


@helper(**IN_ANY_ORDER)
def product(row, x, size):  # type: ignore[no-untyped-def]
    """Return the product of the first entries of two vectors."""
    total = 0.0
    for j in range(size):
        total += row[j] * x[j]
    return total


@kernel
def descend(L, order, least, lower, upper, x, slope, is_free):  # type: ignore[no-untyped-def]
    """Go towards slope = 0 on the free rows, those of `order`; where a bound is met, fix that row and go on.

    Return how many rows are still free: more than `least` after a whole step, which leaves `slope` behind; −1 where a
    step is not finite. L, lower triangular, is the Cholesky factor of the free rows of P, and follows them.
    """
    size, step, cosines, sines = (
        order.size,
        np.empty(order.size),
        np.empty(order.size),
        np.empty(order.size),
    )
    while size > least:
        for a in range(size):
            step[a] = (-slope[order[a]] - product(L[a], step, a)) / L[a, a]
        for a in range(size - 1, -1, -1):
            step[a] /= L[a, a]
            value, row = step[a], L[a]
            for b in range(a):
                step[b] -= value * row[b]
        length, met = 1.0, -1
        for a in range(size):
            i = order[a]
            if not np.isfinite(step[a]):
                return -1
            if x[i] + step[a] < lower[i] or x[i] + step[a] > upper[i]:
                ratio = ((upper[i] if step[a] > 0.0 else lower[i]) - x[i]) / step[a]
                if met < 0 or ratio < length:
                    length, met = ratio, a
        length = 1.0 if met < 0 else min(max(length, 0.0), 1.0 - EPSILON)
        for a in range(size):
            x[order[a]] += length * step[a]
            slope[order[a]] *= 1.0 - length
        if met < 0:
            return size
        i = order[met]
        x[i], is_free[i] = upper[i] if step[met] > 0.0 else lower[i], False
        for a in range(
            met, size - 1
        ):  # the rows below move up; rotations make them triangular again
            order[a], row, below = order[a + 1], L[a], L[a + 1]
            for b in range(met):
                row[b] = below[b]
            carried = below[met]
            for b in range(met, a):
                row[b], carried = (
                    cosines[b] * carried + sines[b] * below[b + 1],
                    (cosines[b] * below[b + 1] - sines[b] * carried),
                )
            row[a] = np.hypot(carried, below[a + 1])
            cosines[a], sines[a] = carried / row[a], below[a + 1] / row[a]
        size -= 1
    return size
