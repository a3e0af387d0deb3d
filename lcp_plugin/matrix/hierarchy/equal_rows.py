"""Runs of equal rows: neighbours in a grid have the same entries at the same distance from the diagonal.

Over a run a product with M is a sum of shifted vectors, each times a number: no index and no entry of M is read
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

EqualRows = NDArray[np.int64]

SHORTEST = 16  # rows; fewer are taken one by one
LONGEST_REACH = 1024  # rows, whose sums stay in the fastest cache


def runs_of_equal_rows(inverse: FloatVector, matrix: Arrays) -> EqualRows:
    """Return the runs of the own rows, shape (count, 3): first row, row behind the last, and reach.

    Rows that are equal have the same `inverse` pivot, shape (own rows,), too. The reach is the number of rows that a
    sweep may take at once, 0 where they are unlike and taken one by one.
    """
    indptr, indices, _ = matrix
    rows = inverse.size
    is_same = np.zeros(rows, np.uint8)
    mark_equal(1, *matrix, is_same)
    is_same[1:] &= inverse[1:] == inverse[:-1]
    begins = np.append(np.flatnonzero(is_same == 0), rows)
    is_long = begins[1:] - begins[:-1] >= SHORTEST
    first, end = begins[:-1][is_long], begins[1:][is_long]
    if first.size == 0:
        return _with_gaps(rows, first, end, end)
    reach = _reaches(indptr, indices, first)
    return _with_gaps(rows, *(column[reach >= SHORTEST] for column in (first, end, reach)))


def _reaches(indptr: NDArray[Any], indices: NDArray[Any], first: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return how near to the diagonal the nearest entry of these rows stands that is no neighbour's."""
    size = indptr[first + 1] - indptr[first]
    begin = np.cumsum(size) - size
    entries = np.arange(size.sum()) + np.repeat(indptr[first] - begin, size)
    distance = np.abs(indices[entries].astype(np.int64) - np.repeat(first, size))
    distance[(distance <= 1) | (distance > LONGEST_REACH)] = LONGEST_REACH
    return np.minimum.reduceat(distance, begin)


def _with_gaps(
    rows: int, first: NDArray[np.int64], end: NDArray[np.int64], reach: NDArray[np.int64]
) -> EqualRows:
    """Return the runs with one of unlike rows wherever rows are left before, between and behind them."""
    found = np.zeros((2 * first.size + 1, 3), np.int64)
    found[1::2, 0], found[1::2, 1], found[1::2, 2] = first, end, reach
    found[2::2, 0], found[:-1:2, 1], found[-1, 1] = end, first, rows
    found = found[found[:, 0] < found[:, 1]]
    found.flags.writeable = False
    return found


def without(runs: EqualRows, changed: BoolVector) -> EqualRows:
    """Return the runs that are left when the rows marked in `changed`, shape (rows,), are like no other."""
    found = np.empty((changed.size // (SHORTEST // 2) + 2, 3), np.int64)
    left = found[: _cut(runs, changed, found)].copy()
    left.flags.writeable = False
    return left


@njit(inline="always")
def run_at(row, runs):  # type: ignore[no-untyped-def]
    """Return which run that row belongs to."""
    low, high = 0, runs.shape[0] - 1
    while low < high:
        middle = (low + high + 1) // 2
        if runs[middle, 0] <= row:
            low = middle
        else:
            high = middle - 1
    return low


@compiled
def mark_equal(step, indptr, indices, data, is_same):  # type: ignore[no-untyped-def]
    """Mark the rows i that are those of i − step with each column one further; the flags are bytes."""
    one, step = uintp(1), uintp(step)
    for i in range(step, uintp(is_same.size)):
        k, end = uintp(indptr[i]), uintp(indptr[i + one])
        before = uintp(indptr[i - step])
        same = end - k == uintp(indptr[i - step + one]) - before
        while same and k < end:
            same = data[k] == data[before] and indices[k] == indices[before] + 1
            k += one
            before += one
        is_same[i] = same


@compiled
def _cut(runs, changed, found):  # type: ignore[no-untyped-def]
    """Write what is left of the runs into `found`; return how many there are."""
    count = 0
    for s in range(runs.shape[0]):
        first, end, reach = runs[s, 0], runs[s, 1], runs[s, 2]
        while first < end:
            is_changed, last = reach == 0 or changed[uintp(first)], first + 1
            if reach == 0:
                last = end
            while last < end and changed[uintp(last)] == is_changed:
                last += 1
            is_unlike = is_changed or last - first < SHORTEST
            if is_unlike and count > 0 and found[count - 1, 2] == 0:
                found[count - 1, 1] = last
            else:
                found[count, 0], found[count, 1], found[count, 2] = first, last, 0 if is_unlike else reach
                count += 1
            first = last
    return count
