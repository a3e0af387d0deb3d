"""Stretches of equal rows: neighbours in a grid have the same entries at the same distance from the diagonal.

Over a stretch a product with M is a sum of shifted vectors, each times a number: no index and no entry of M is read
again, and a processor takes several rows at once. A Gauss–Seidel sweep does so in blocks, which reach no further than
to the nearest unknown that the sweep has to have done before; only the neighbour just before waits for its turn.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit, uintp
from numpy.typing import NDArray

from ...checks import BoolVector, FloatVector
from ...kernels.compilation import compiled
from ...peers.alone import Arrays

Stretches = NDArray[np.int64]

SHORTEST = 16  # rows; fewer are taken one by one
LONGEST_REACH = 1024  # rows, whose sums stay in the fastest cache


def stretches_of(inverse: FloatVector, matrix: Arrays) -> Stretches:
    """Return the stretches of the own rows, shape (count, 3): first row, row behind the last, and reach.

    Rows that are equal have the same `inverse` pivot, shape (own rows,), too. The reach is the number of rows that a
    sweep may take at once, 0 where they are unlike and taken one by one.
    """
    return _noted(inverse.size, lambda found: _find(*matrix, inverse, found))


def without(stretches: Stretches, changed: BoolVector) -> Stretches:
    """Return the stretches that are left when the rows marked in `changed`, shape (rows,), are like no other."""
    return _noted(changed.size, lambda found: _cut(stretches, changed, found))


def _noted(rows: int, note: Any) -> Stretches:
    found = np.empty((rows // (SHORTEST // 2) + 2, 3), np.int64)
    noted = found[: note(found)].copy()
    noted.flags.writeable = False
    return noted


@njit(inline="always")
def stretch_at(row, stretches):  # type: ignore[no-untyped-def]
    """Return which stretch that row belongs to."""
    low, high = 0, stretches.shape[0] - 1
    while low < high:
        middle = (low + high + 1) // 2
        if stretches[middle, 0] <= row:
            low = middle
        else:
            high = middle - 1
    return low


@compiled
def _append(found, count, first, end, reach):  # type: ignore[no-untyped-def]
    """Write one more stretch; what is taken row by row goes on where the one before is."""
    if end - first < SHORTEST or reach < SHORTEST:
        reach = 0
    if reach == 0 and count > 0 and found[count - 1, 2] == 0:
        found[count - 1, 1] = end
        return count
    found[count, 0], found[count, 1], found[count, 2] = first, end, reach
    return count + 1


@compiled
def _find(indptr, indices, data, inverse, found):  # type: ignore[no-untyped-def]
    one, rows = uintp(1), inverse.size
    count, first = 0, 0
    for i in range(1, rows + 1):
        is_same = False
        if i < rows:
            k, end = uintp(indptr[i]), uintp(indptr[i + 1])
            before = uintp(indptr[i - 1])
            is_same = k - before == end - k and inverse[i] == inverse[i - 1]
            while is_same and k < end:
                is_same = data[k] == data[before] and indices[k] == indices[before] + 1
                k += one
                before += one
        if not is_same:
            reach = LONGEST_REACH
            for k in range(uintp(indptr[first]), uintp(indptr[first + 1])):
                distance = abs(indices[k] - first)
                if distance > 1 and distance < reach:
                    reach = distance
            count = _append(found, count, first, i, reach)
            first = i
    return count


@compiled
def _cut(stretches, changed, found):  # type: ignore[no-untyped-def]
    count = 0
    for s in range(stretches.shape[0]):
        first, end, reach = stretches[s, 0], stretches[s, 1], stretches[s, 2]
        i = first
        while reach > 0 and i < end:
            if changed[uintp(i)]:
                count = _append(found, count, first, i, reach) if i > first else count
                first = i
                while i < end and changed[uintp(i)]:
                    i += 1
                count = _append(found, count, first, i, 0)
                first = i
            else:
                i += 1
        if first < end:
            count = _append(found, count, first, end, reach)
    return count
