"""LDLᵀ as in :mod:`.symmetric_factors`, but for the last rows, which are left to LAPACK as one dense block."""

from __future__ import annotations

import numpy as np

from ....core.kernels.compilation import kernel
from ....core.kernels.compiler import uintp


@kernel
def eliminate(  # type: ignore[no-untyped-def]
    order, starts, below, row_starts, columns, above_starts, above, at, entries, values, pivots, y, slot, block, left
):
    """Eliminate the first rows; return whether no pivot was 0.

    Fill their columns of L, and `pivots`, the diagonal in the order of the rows, with D in that of the pattern. `left`,
    shape (k, k), gets the lower triangle of what is left of the last k rows, but for the shares of the columns with a
    slot ≥ 0: `block`, shape (slots, k), gets these columns' last k entries of L |D|^½, and L D Lᵀ is not subtracted.
    """
    diagonal, place, one = pivots.copy(), starts.copy(), uintp(1)
    last = uintp(left.shape[0])
    first = uintp(order.size) - last
    for k in range(uintp(order.size)):
        y[k] = 0.0
    for k in range(uintp(order.size)):
        pivot, is_last = diagonal[order[k]], k >= first
        for p in range(above_starts[k], above_starts[k + one]):
            y[above[p]] = entries[at[p]]
        for p in range(row_starts[k], row_starts[k + one]):
            j = columns[p]
            if j >= first:  # and so are those that follow
                break
            value, end = y[j], place[j]
            y[j] = 0.0
            for q in range(starts[j], end):
                y[below[q]] -= values[q] * value
            if is_last and slot[j] >= 0:
                block[slot[j], k - first] = value / np.sqrt(abs(pivots[j]))
                continue
            share = value / pivots[j]
            pivot -= share * value
            values[end] = share
            place[j] = end + one
        if is_last:
            for i in range(first, k):
                left[k - first, i - first] = y[i]
                y[i] = 0.0
            left[k - first, k - first] = pivot
            continue
        pivots[k] = pivot
        if pivot == 0.0:
            return False
    return True


@kernel
def store(starts, values, pivots, slot, block, factor, positive):  # type: ignore[no-untyped-def]
    """Put into L and D what the dense block is: its first `positive` pivots are, and the others are negative.

    `factor`, shape (k, k), has by columns, row j column j of C, a lower triangle with C diag(±1) Cᵀ = what is left.
    """
    last, one = uintp(factor.shape[0]), uintp(1)
    first = uintp(starts.size) - one - last
    for j in range(first):
        if slot[j] >= 0:
            size = 1.0 / np.sqrt(abs(pivots[j]))
            size = size if pivots[j] > 0.0 else -size
            before = starts[j + one] - last
            for k in range(last):
                values[before + k] = block[slot[j], k] * size
    for j in range(last):
        pivot, start = factor[j, j], starts[first + j]
        pivots[first + j] = pivot * pivot if j < positive else -pivot * pivot
        for k in range(j + one, last):
            values[start + k - j - one] = factor[j, k] / pivot


@kernel
def rows_of_factor(above_starts, above, parent, seen, starts, columns):  # type: ignore[no-untyped-def]
    """Fill L by rows from what is above the diagonal, by columns; return how many entries it has, written as they fit.

    Row k has the places of column k and those on the way from them to k in the elimination tree (Liu 1986,
    doi:10.1145/6497.6499), `parent`. `seen`, shape (n,), is workspace.
    """
    count, capacity = 0, columns.size
    for k in range(seen.size):
        parent[k], seen[k] = -1, k
        for p in range(above_starts[k], above_starts[k + 1]):
            j = above[p]
            while seen[j] != k:
                if parent[j] < 0:
                    parent[j] = k
                seen[j] = k
                if count < capacity:
                    columns[count] = j
                count += 1
                j = parent[j]
        starts[k + 1] = count
    return count
