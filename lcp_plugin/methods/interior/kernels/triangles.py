"""Cholesky factors of a set of rows that changes: rows leave and join, and each change costs O(n²).

The factor L, lower and C-contiguous, belongs to the rows order[:size] of a symmetric M, in that order.
"""

from __future__ import annotations

import numpy as np

from ....core.kernels.compilation import helper, kernel
from ....core.kernels.floats import EPSILON

SMALLEST_PIVOT = 1e-14  # of the diagonal entry, squared; below, a factor says nothing
MET_A_BOUND, FREE, SINGULAR = 0, 1, 2


@helper
def product(row, x, size):  # type: ignore[no-untyped-def]
    """Return the product of the first entries of two vectors; four sums, so that none waits for the other."""
    first = second = third = fourth = 0.0
    whole = size - size % 4
    for j in range(0, whole, 4):
        first += row[j] * x[j]
        second += row[j + 1] * x[j + 1]
        third += row[j + 2] * x[j + 2]
        fourth += row[j + 3] * x[j + 3]
    for j in range(whole, size):
        first += row[j] * x[j]
    return (first + second) + (third + fourth)


@helper
def forward(L, size, x):  # type: ignore[no-untyped-def]
    """Overwrite x by L⁻¹ x."""
    for i in range(size):
        x[i] = (x[i] - product(L[i], x, i)) / L[i, i]


@helper
def backward(L, size, x):  # type: ignore[no-untyped-def]
    """Overwrite x by L⁻ᵀ x."""
    for i in range(size - 1, -1, -1):
        x[i] /= L[i, i]
        value, row = x[i], L[i]
        for j in range(i):
            x[j] -= value * row[j]


@helper
def leave(L, order, size, at, cosines, sines):  # type: ignore[no-untyped-def]
    """Take the row in that place out of the factor; rotations, `size` numbers each, make the rest triangular again."""
    for i in range(at, size - 1):
        order[i] = order[i + 1]
        row, below = L[i], L[i + 1]
        for j in range(at):
            row[j] = below[j]
        carried = below[at]
        for j in range(at, i):
            following = below[j + 1]
            row[j] = cosines[j] * carried + sines[j] * following
            carried = cosines[j] * following - sines[j] * carried
        last = below[i + 1]
        size_of_both = np.hypot(carried, last)
        cosines[i], sines[i] = carried / size_of_both, last / size_of_both
        row[i] = size_of_both


@kernel
def join(M, shift, L, order, size, rows):  # type: ignore[no-untyped-def]
    """Add the rows at the end; return the new size, or −1 where the block is singular to working precision."""
    for j in rows:
        new = L[size]
        for a in range(size):
            new[a] = M[j, order[a]]
        for a in range(size):
            new[a] = (new[a] - product(L[a], new, a)) / L[a, a]
        pivot = M[j, j] + shift - product(new, new, size)
        if not pivot > SMALLEST_PIVOT * M[j, j]:
            return -1
        new[size], order[size] = np.sqrt(pivot), j
        size += 1
    return size


@kernel
def minimise(L, order, size, lower, upper, z, w, is_free, limit):  # type: ignore[no-untyped-def]
    """Go towards w = 0 on the free rows; where a bound is met, fix that row and go on.

    Return (outcome, size, rows fixed): FREE after a whole step, z moved and w no longer that of z; MET_A_BOUND where
    `limit` rows were fixed before; SINGULAR where the direction is not finite.
    """
    x, cosines, sines = np.empty(order.size), np.empty(order.size), np.empty(order.size)
    for fixed in range(limit):
        for a in range(size):
            x[a] = -w[order[a]]
        forward(L, size, x)
        backward(L, size, x)
        length, first = 1.0, -1
        for a in range(size):
            i = order[a]
            if not np.isfinite(x[a]):
                return SINGULAR, size, fixed
            after = z[i] + x[a]
            if after < lower[i] or after > upper[i]:
                ratio = ((upper[i] if x[a] > 0.0 else lower[i]) - z[i]) / x[a]
                if first < 0 or ratio < length:
                    length, first = ratio, a
        if first < 0:
            for a in range(size):
                z[order[a]] += x[a]
            return FREE, size, fixed
        length = min(max(length, 0.0), 1.0 - EPSILON)
        for a in range(size):
            z[order[a]] += length * x[a]
            w[order[a]] *= 1.0 - length
        row = order[first]
        z[row] = upper[row] if x[first] > 0.0 else lower[row]
        is_free[row] = False
        leave(L, order, size, first, cosines, sines)
        size -= 1
    return MET_A_BOUND, size, limit
