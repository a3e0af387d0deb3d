"""What Krylov steps do to whole vectors, as few passes as may be; sums are cut where no number of threads matters."""

from __future__ import annotations

from functools import partial

import numpy as np

from ...checks import FloatVector
from ...crossovers import SHARED_FROM
from ...kernels.compilation import compiled
from ...kernels.threads import share

TERMS = 32768  # that are summed in one piece


def dot(one: FloatVector, other: FloatVector) -> float:
    """Return Σ one_i other_i."""
    sums = np.zeros(-(-one.size // TERMS))
    share(partial(_dots, one, other, sums), sums.size, 1)
    return float(sums.sum())


def add_both(
    factor: float, vector: FloatVector, to: FloatVector, other_factor: float, other: FloatVector, to_other: FloatVector
) -> None:
    """Add factor · vector to one vector, and other_factor · other to another one."""
    operands = factor, vector, to, other_factor, other, to_other
    share(partial(_add_both, *operands), vector.size, SHARED_FROM)


def add_within(
    origin: FloatVector, factor: float, vector: FloatVector, lower: FloatVector, upper: FloatVector, z: FloatVector
) -> None:
    """Overwrite z by mid(lower, upper, origin + factor · vector)."""
    share(partial(_add_within, origin, factor, vector, lower, upper, z), vector.size, SHARED_FROM)


def largest_product(one: FloatVector, other: FloatVector) -> float:
    """Return the largest |one_i other_i|, NaN where one is; 0 of none."""
    return float(np.max(share(partial(_largest_product, one, other), one.size, SHARED_FROM)))


def span(vector: FloatVector) -> float:
    """Return the largest entry in absolute value; 0 of no entry."""
    return float(max(vector.max(initial=0.0), -vector.min(initial=0.0)))


def power_of_two(largest: float) -> float:
    """Return the power of two just above a number ≥ 0, whose inverse is finite; 1 where that is 0 or not finite."""
    if not 0.0 < largest < np.inf:
        return 1.0
    return float(np.ldexp(1.0, max(min(int(np.frexp(largest)[1]), 1023), -1022)))


@compiled
def _dots(one, other, sums, first, end):  # type: ignore[no-untyped-def]
    for piece in range(first, end):
        a = b = c = d = 0.0  # one sum alone would wait for itself
        begin, last = piece * TERMS, min((piece + 1) * TERMS, one.size)
        for i in range(begin, last - 3, 4):
            a += one[i] * other[i]
            b += one[i + 1] * other[i + 1]
            c += one[i + 2] * other[i + 2]
            d += one[i + 3] * other[i + 3]
        for i in range(last - (last - begin) % 4, last):
            a += one[i] * other[i]
        sums[piece] = (a + b) + (c + d)


@compiled
def _add_both(factor, vector, to, other_factor, other, to_other, first, end):  # type: ignore[no-untyped-def]
    for i in range(first, end):
        to[i] += factor * vector[i]
        to_other[i] += other_factor * other[i]


@compiled
def _add_within(origin, factor, vector, lower, upper, z, first, end):  # type: ignore[no-untyped-def]
    for i in range(first, end):
        value = origin[i] + factor * vector[i]
        value = lower[i] if lower[i] > value else value
        z[i] = upper[i] if upper[i] < value else value


@compiled
def _largest_product(one, other, first, end):  # type: ignore[no-untyped-def]
    largest = 0.0
    for i in range(first, end):
        size = abs(one[i] * other[i])
        if size > largest or np.isnan(size):
            largest = size
    return largest
