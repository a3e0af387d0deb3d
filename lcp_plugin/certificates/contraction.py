"""Row bounds of one sweep in a weighted maximum norm, evaluated so that rounding cannot flatter them.

A sweep that updates row after row multiplies the error e = z − z* by something nonnegative, row by row:

    p_i |e⁺_i|  ≤  A_i |e_i| + b_i (|L||e|)_i + u_i (|U||e|)_i + f_i (|L||e⁺|)_i

with L what the sweep has already updated. Where this holds with |e| ≤ v and the right-hand side, f_i (|L|v)_i counted
in full, is below p_i v_i, the sweep contracts in ‖x‖_v = max |x_i|/v_i, by

    c = max_i (A v + b |L|v + u |U|v)_i / (p v − f |L|v)_i  <  1:

if |e⁺_j| ≤ c v_j for all rows j before i, then |e⁺_i| ≤ c v_i. All |L|v and |U|v here are rows of M divided by the
scale of the residual, so that no unit of a row can overflow them.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from ..checks import FloatVector, read_only
from ..exact.rounding import TINY
from ..matrix.matrix import Matrix, fact

EPSILON = 2.0**-52
BLOCK = 16_384
NEGLIGIBLE = 1e-280  # below, products may have underflowed
Weights = FloatVector | float


class Case(NamedTuple):
    """One row bound: free = p − A, and the weights b + f of |L|v and u of |U|v."""

    free: Weights
    lower: Weights
    upper: Weights


@dataclass(frozen=True)
class RowBound:
    """What one sweep does to an error; every case must hold, since a row may be in any of them.

    Attributes
    ----------
    pivot, feedback : array, shape (n,), or float
        p and f.
    cases : tuple of Case
    """

    pivot: Weights
    feedback: Weights
    cases: tuple[Case, ...]


@fact
def inverse_residual_scale(matrix: Matrix) -> FloatVector:
    """Return 1/d of the scaled residual, shape (n,), kept finite."""
    with np.errstate(over="ignore"):
        return read_only(np.minimum(1.0 / matrix.residual_scale, np.finfo(np.float64).max))


def triangle_sums(matrix: Matrix, v: FloatVector, part: Any = None) -> tuple[FloatVector, FloatVector]:
    """Return (|L|v, |U|v), each row divided by the scale of its residual, shapes (own,); one pass over M.

    On several ranks v has shape (width,), and what others hold is part of U: no sweep has updated it. With a CSR array
    `part`, shape (n, n), of its triangles instead of those of M.
    """
    lower, upper = np.empty(matrix.own), np.empty(matrix.own)
    M = matrix.csr_rows if part is None else part
    # One compiled signature for writable and read-only arrays.
    arrays = [array.view() for array in (M.indptr, M.indices, M.data, inverse_residual_scale(matrix), np.asarray(v))]
    for array in arrays:
        array.flags.writeable = False
    _compiled_triangle_sums()(*arrays, lower, upper)
    return lower, upper


def underflow(v: FloatVector, terms: int) -> float:
    """Return what a difference of two triangle sums of v may have lost by underflow, `terms` entries a row."""
    return 4.0 * terms * (1.0 + float(v.max(initial=0.0))) * TINY


@fact
def unit_triangle_sums(matrix: Matrix) -> tuple[FloatVector, FloatVector]:
    """Return the triangle sums of v = 1."""
    return triangle_sums(matrix, np.ones(matrix.width))


def row_blocks(n: int) -> Iterator[slice]:
    """Yield blocks of rows whose temporary vectors stay in a processor's cache."""
    for first in range(0, n, BLOCK):
        yield slice(first, min(first + BLOCK, n))


@fact
def longest_row(matrix: Matrix) -> int:
    """Return the largest number of entries in a row."""
    return int(np.diff(matrix.csr.indptr).max(initial=0))


def gaps(bound: RowBound, v: FloatVector, sums: tuple[FloatVector, FloatVector], terms: int) -> FloatVector:
    """Return lower bounds of 1 − c_i, shape (n,), −∞ where nothing can be said.

    Parameters
    ----------
    bound : RowBound
    v : array, shape (n,)
        Positive.
    sums : pair of arrays, shape (n,)
        Upper bounds of |L|v of what is already updated and |U|v of the rest but for the rounding of `terms`
        additions; see :func:`underflow`.

    Notes
    -----
    free = p − A is a difference of numbers no larger than p, and the sweep divides by a pivot that is rounded itself:
    what rounding may take from it is counted relative to p.
    """
    updated, rest = sums
    slop = (terms + 32) * EPSILON
    smallest = np.full(v.size, np.inf)
    with np.errstate(all="ignore"):  # what overflows proves nothing
        size = bound.pivot * v
        scale = (size - bound.feedback * updated) * (1.0 + slop) + 2.0 * slop * bound.feedback * updated
        for case in bound.cases:
            load = case.lower * updated + case.upper * rest
            surplus = (case.free * v - load) - slop * (size + load) - NEGLIGIBLE
            np.minimum(smallest, surplus / scale, out=smallest)
        usable = (scale > 0.0) & np.isfinite(scale) & (v > 0.0) & np.isfinite(v)
        smallest = smallest - 4.0 * EPSILON * np.abs(smallest)
    return np.where(usable & ~np.isnan(smallest), np.minimum(smallest, 1.0), -np.inf)


def growth(bound: RowBound, v: FloatVector, sums: tuple[FloatVector, FloatVector]) -> FloatVector:
    """Return the bound of |e⁺| for |e| ≤ v with |e⁺| ≤ v counted in full, shape (n,): monotone and homogeneous in v.

    Where it is at least v in every row, no other v gives a contraction.
    """
    updated, rest = sums
    with np.errstate(all="ignore"):
        worst = np.full(v.size, np.inf)
        for case in bound.cases:
            np.minimum(worst, case.free * v - case.lower * updated - case.upper * rest, out=worst)
        grown: FloatVector = v - worst / bound.pivot
    return grown


def rate_of(smallest: float) -> float | None:
    """Return an upper bound c < 1 of the contraction from the smallest gap, or None where that rounds to 1.

    Examples
    --------
    >>> rate_of(0.5)
    0.5000000000000001
    """
    rate = 1.0 - smallest
    rate = float(np.nextafter(rate, 2.0)) if smallest < 1.0 else 0.0
    return rate if rate < 1.0 else None


def _triangle_sums(indptr, indices, data, scale, v, lower, upper):  # type: ignore[no-untyped-def]
    """Fill lower[i] and upper[i] with scale_i Σ |m_ij| v_j over j < i and j > i; compiled before it is called."""
    for i in range(lower.size):
        below = above = 0.0
        weight = scale[i]
        for k in range(indptr[i], indptr[i + 1]):
            j = indices[k]
            if j < i:
                below += (abs(data[k]) * weight) * v[j]
            elif j > i:
                above += (abs(data[k]) * weight) * v[j]
        lower[i] = below
        upper[i] = above


@cache
def _compiled_triangle_sums() -> Any:
    from ..kernels.compilation import compiled

    return compiled(_triangle_sums)
