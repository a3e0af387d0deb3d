"""LDLᵀ of sparse quasi-definite matrices S (M + diag), S = diag(signs), their order and pattern known.

Row by row: row k of L solves with the rows before it, as in qdldl. `order`, `starts` … `at` are the pattern of a
:class:`lcp_plugin.methods.interior.quasidefinite.Symbolic`, `values` L in that pattern, `pivots` D.
"""

from __future__ import annotations

import numpy as np

from ....core.kernels.compilation import kernel
from ....core.kernels.compiler import uintp
from ....systems.refinement import REFINED, ROUGH, STABLE, USEFUL


@kernel
def factorise(order, starts, below, row_starts, columns, above_starts, above, at, entries, values, pivots, y):  # type: ignore[no-untyped-def]
    """Fill L; pivots, the diagonal in the order of the rows, become D in that of the pattern. Return whether D ≠ 0.

    `entries` are those of S M, in the order of M's own; y, shape (n,), is workspace.
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


@kernel
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


@kernel
def is_useful(order, starts, below, values, pivots, signs, indptr, indices, data, shifted, right, x, spare):  # type: ignore[no-untyped-def]
    """Fill x with what the factor of S (M + diag(shifted)) answers to `right`; return whether it is of any use."""
    error, size, _ = solve(
        order, starts, below, values, pivots, signs, indptr, indices, data, shifted, right, x, spare, 0, 0.0
    )
    largest = 0.0
    for i in range(x.size):
        largest = max(largest, abs(x[i]))
    return error <= max(USEFUL * size, STABLE * largest)
