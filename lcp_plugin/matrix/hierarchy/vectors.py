"""What Krylov steps do to whole vectors, and the units of the unknowns.

Sums are cut into pieces at the same places whatever the number of threads. The units are those in which an error that
sweeps leave over is locally constant: interpolation reproduces constants, which is right where rows of M sum to about
zero. Of D M D, or of M with scaled columns, others do: those v > 0 with M v about zero. A few sweeps on M v = 0 find
one, if they begin in units not too far from it. Where they begin is tried: in the given ones, and in those that bring
the diagonal of V M V, or of M V, to 1.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from numba import uintp

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


LACKING = 0.1  # of the diagonal entry: how far a row may sum below zero before it contradicts the units
NOTEWORTHY_LACKING = 0.02  # share of such rows from which on other units are tried
GAINED = 0.5  # and kept, if they leave at most so many times as many
TRIAL_SWEEPS, SWEEPS = 3, 12  # there and back: to choose where to begin, and from there


def units_of(matrix: Any, lacking: float) -> tuple[FloatVector | None, float]:
    """Return v > 0, shape (n,), and the matrix entries touched; None where the given units are as good as any tried.

    Parameters
    ----------
    matrix : csr_array, shape (n, n)
        With a positive diagonal.
    lacking : float
        How many rows sum to less than zero.
    """
    n = matrix.indptr.size - 1
    if not lacking > NOTEWORTHY_LACKING * n:
        return None, 0.0
    arrays, diagonal = (matrix.indptr, matrix.indices, matrix.data), matrix.diagonal()
    best, least, touched = None, GAINED * lacking, 0.0
    with np.errstate(all="ignore"):
        for v in (np.ones(n), 1.0 / np.sqrt(diagonal), 1.0 / diagonal):
            left = smooth_units(*arrays, v, TRIAL_SWEEPS)
            touched += (2.0 * TRIAL_SWEEPS + 1.0) * matrix.data.size
            if left <= least and _are_units(v):
                best, least = v, left
        if best is not None:
            smooth_units(*arrays, best, SWEEPS)
            touched += (2.0 * SWEEPS + 1.0) * matrix.data.size
    return best if best is not None and _are_units(best) else None, touched


def _are_units(v: FloatVector) -> bool:
    return bool(v.min() > 0.0 and np.isfinite(1.0 / v).all() and np.isfinite(v).all())


@compiled
def smooth_units(indptr, indices, data, v, sweeps):  # type: ignore[no-untyped-def]
    """Overwrite v by symmetric Gauss–Seidel sweeps for M v = 0; return how many rows sum to less than zero.

    Positive couplings are lumped, so that v stays positive.
    """
    one, n = uintp(1), uintp(v.size)
    for sweep in range(2 * sweeps + 1):
        lacking = 0.0
        for step in range(n):
            i = n - one - step if sweep % 2 == 1 else step
            diagonal, negative = 0.0, 0.0
            for k in range(uintp(indptr[i]), uintp(indptr[i + one])):
                j = uintp(indices[k])
                if j == i or data[k] > 0.0:
                    diagonal += data[k] * v[j]
                else:
                    negative -= data[k] * v[j]
            if diagonal < (1.0 - LACKING) * negative:
                lacking += 1.0
            if negative > 0.0 and sweep < 2 * sweeps:
                v[i] *= negative / diagonal
    return lacking
