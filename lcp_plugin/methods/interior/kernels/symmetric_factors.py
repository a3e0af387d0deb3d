"""LDLᵀ of sparse quasi-definite matrices S (M + diag), S = diag(signs), their order and pattern known.

Row by row: row k of L solves with the rows before it (Davis 2005, doi:10.1145/1114268.1114277). `order`, `starts` …
`at` are the pattern of a :class:`lcp_plugin.methods.interior.quasidefinite.Symbolic`, `values` L in that pattern,
`pivots` D.
"""

from __future__ import annotations

import numpy as np

from ....core.kernels.compilation import compiled, interpreted_while_small
from ....core.kernels.compiler import uintp
from ....systems.refinement import REFINED, ROUGH


@compiled
def factorise(order, starts, below, row_starts, columns, above_starts, above, at, entries, values, pivots, y):  # type: ignore[no-untyped-def]
    """Fill L; pivots, the diagonal in the order of the rows, become D in that of the pattern. Return whether D ≠ 0.

    `entries` are those of S M, in the order of M's own; y, shape (n,), is room to work in.
    """
    diagonal, place, one = pivots.copy(), starts.copy(), uintp(1)
    for k in range(uintp(order.size)):
        y[k] = 0.0
    for k in range(uintp(order.size)):  # an index without a sign needs no look at whether it is negative
        pivot = diagonal[order[k]]
        for p in range(above_starts[k], above_starts[k + one]):
            y[above[p]] = entries[at[p]]
        for p in range(row_starts[k], row_starts[k + one]):
            j = columns[p]
            value, end = y[j], place[j]
            y[j] = 0.0
            for q in range(starts[j], end):
                y[below[q]] -= values[q] * value
            share = value / pivots[j]
            pivot -= share * value
            values[end] = share
            place[j] = end + one
        pivots[k] = pivot
        if pivot == 0.0:
            return False
    return True


@compiled
def solve(  # type: ignore[no-untyped-def]
    order, starts, below, values, pivots, signs, indptr, indices, data, diagonal, right, x, spare, refinements, enough
):
    """Fill x with (M + diag(diagonal))⁻¹ right, refined as long as that gains anything, or until the error is enough.

    Return the largest error left, NaN where one is NaN, the largest component of `right`, and how often was solved.
    """
    y, left, better = spare[0], spare[1], spare[2]
    n, one = uintp(order.size), uintp(1)
    size, error, passes = 0.0, np.inf, 0
    for i in range(n):
        x[i], left[i], size = 0.0, right[i], max(size, abs(right[i]))
    while passes <= refinements and (passes == 0 or max(REFINED * size, min(enough, ROUGH * size)) < error < np.inf):
        for k in range(n):
            i = order[k]
            y[k] = signs[i] * left[i]
        for k in range(n):
            value = y[k]
            for q in range(starts[k], starts[k + one]):
                y[below[q]] -= values[q] * value
        for before in range(n):
            k = n - one - before
            value = y[k] / pivots[k]
            for q in range(starts[k], starts[k + one]):
                value -= values[q] * y[below[q]]
            y[k] = value
            better[order[k]] = x[order[k]] + value
        passes += 1
        smaller = 0.0
        for i in range(n):
            value = right[i] - diagonal[i] * better[i]
            for p in range(uintp(indptr[i]), uintp(indptr[i + one])):
                value -= data[p] * better[indices[p]]
            left[i] = value
            if not abs(value) <= smaller:
                smaller = abs(value) if smaller == smaller else smaller
        if passes > 1 and not smaller < error:
            break
        for i in range(n):
            x[i] = better[i]
        error = smaller
    return error, size, passes


@interpreted_while_small
def pattern_of(indptr, indices, order):  # type: ignore[no-untyped-def]
    """Return the pattern of L in that order, and of what is above the diagonal in it, for a symmetric pattern.

    Each by columns or rows as (starts, indices): L by columns and by rows, then the entries above the diagonal, by
    columns, and where those below it are in `indices`. Row k of L has the places of column k and those on the way from
    them to k in the elimination tree (Liu 1986, doi:10.1145/6497.6499).
    """
    n = order.size
    position, above_starts = np.empty(n, np.int64), np.zeros(n + 1, np.int64)
    for k in range(n):
        position[order[k]] = k
    for i in range(n):
        for p in range(indptr[i], indptr[i + 1]):
            if indices[p] < i:
                above_starts[max(position[i], position[indices[p]]) + 1] += 1
    for k in range(n):
        above_starts[k + 1] += above_starts[k]
    above, at = np.empty(above_starts[n], np.uint32), np.empty(above_starts[n], np.uint32)
    free = above_starts.copy()
    for i in range(n):
        for p in range(indptr[i], indptr[i + 1]):
            if indices[p] < i:
                j, k = min(position[indices[p]], position[i]), max(position[indices[p]], position[i])
                above[free[k]], at[free[k]] = j, p
                free[k] += 1
    starts, row_starts = np.zeros(n + 1, np.int64), np.zeros(n + 1, np.int64)
    parent, seen = np.empty(n, np.int64), np.empty(n, np.int64)
    for k in range(n):
        parent[k], seen[k] = -1, k
        for p in range(above_starts[k], above_starts[k + 1]):
            j = np.int64(above[p])
            while seen[j] != k:
                if parent[j] < 0:
                    parent[j] = k
                seen[j] = k
                starts[j + 1] += 1
                row_starts[k + 1] += 1
                j = parent[j]
    for k in range(n):
        starts[k + 1] += starts[k]
        row_starts[k + 1] += row_starts[k]
    below, columns = np.empty(starts[n], np.uint32), np.empty(starts[n], np.uint32)
    for k in range(n):
        free[k], seen[k] = starts[k], -1
    for k in range(n):
        seen[k] = k
        for p in range(above_starts[k], above_starts[k + 1]):
            j = np.int64(above[p])
            while seen[j] != k:
                seen[j] = k
                below[free[j]] = k
                free[j] += 1
                j = parent[j]
    for k in range(n):
        free[k] = row_starts[k]
    for j in range(n):
        for p in range(starts[j], starts[j + 1]):
            i = below[p]
            columns[free[i]] = j
            free[i] += 1
    return starts, below, row_starts, columns, above_starts, above, at
