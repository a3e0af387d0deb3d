"""The residual of every row, measured and between bounds that rounding cannot leave; quotients of such numbers."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import scipy.sparse as sp

from ..checks import BoolVector, FloatVector
from ..kernels.floats import EPSILON, TINY
from ..kernels.threads import share
from ..lcp import LCP
from ..matrix.row_sums import row_blocks
from ..rounding import compensated_product, lower_end, read_only_views, upper_end

FEWEST = (
    2**13
)  # rows a thread: on five-point rows some 0.15 ms, several times what a hand-over takes


def scaled_residual(
    problem: LCP, z: FloatVector, w: FloatVector, scale: FloatVector | None = None
) -> FloatVector:
    """Return r_i = z_i − mid(lower_i, upper_i, z_i − w_i/d_i), shape (n,); ∞ where w_i is not finite.

    It is computed as mid(z − upper, z − lower, w/d), the same number, but a small step is not lost beside a large z. A
    w that overflowed on the way could have either sign, and says nothing.
    """
    residual, scale = np.empty(z.size), problem.residual_scale if scale is None else scale
    for rows in row_blocks(z.size):  # what stands between w and the residual stays in the cache
        step = w[rows] / scale[rows]
        block = np.subtract(z[rows], problem.upper[rows], out=residual[rows])
        np.maximum(step, block, out=block)
        np.minimum(block, z[rows] - problem.lower[rows], out=block)
    if not np.isfinite(w.sum()):
        residual[np.isinf(w)] = np.inf
    return residual


def measured_residual(problem: LCP, z: FloatVector) -> float:
    """Return ‖r(z)‖∞ as double precision gives it."""
    with np.errstate(all="ignore"):
        residual = scaled_residual(problem, z, problem.slack(z))
        return float(np.abs(residual, out=residual).max(initial=0.0))


def residual_ends_of(
    M: Any,
    x: FloatVector,
    rows: LCP,
    z: FloatVector,
    scale: FloatVector,
    *,
    q: FloatVector | None = None,
) -> tuple[FloatVector, FloatVector]:
    """Return bounds of every |z_i − mid(lower_i, upper_i, z_i − w_i/scale_i)|, w = M x + q: 0 and ∞ for no number.

    Parameters
    ----------
    M : array or CSR array, shape (m, n)
        Not looked at where x is 0.
    x : array, shape (n,)
        z, and whatever else the rows need.
    rows : LCP
        Its q, lower and upper, each of shape (m,).
    z, scale : arrays, shape (m,)
    q : array, shape (m,), optional
        Instead of that of the rows.

    Returns
    -------
    smallest, largest : arrays, shape (m,)
    """
    from ..kernels.enclosures import residual_ends  # numba, which `import lcp_plugin` must not load

    smallest, largest = np.empty(z.size), np.empty(z.size)
    if not x.any():  # as z° is, most often
        indptr, indices, data, stride = (
            np.zeros(z.size + 1, np.int32),
            np.empty(0, np.int32),
            np.empty(0),
            0,
        )
    elif sp.issparse(M):
        indptr, indices, data, stride = M.indptr, M.indices, M.data, 0
    else:
        m, stride = M.shape
        indptr, indices = (
            np.arange(m + 1, dtype=np.int32) * np.int32(stride),
            np.arange(stride, dtype=np.int32),
        )
        data = np.ascontiguousarray(M).reshape(-1)
    vectors = rows.q if q is None else q, z, rows.lower, rows.upper, scale

    def enclose(first: int, end: int) -> None:
        begin = (
            first * stride
        )  # in a dense M, whose columns stand there once; places in a sparse one stay
        starts, entries = (
            (indptr[: end - first + 1], data[begin:]) if stride else (indptr[first : end + 1], data)
        )
        arrays = read_only_views(
            starts, indices, entries, x, *(vector[first:end] for vector in vectors)
        )
        residual_ends(*arrays[:3], stride, *arrays[3:], smallest[first:end], largest[first:end])

    share(enclose, z.size, FEWEST)
    return smallest, largest


def sharp_residual_ends(
    problem: LCP, z: FloatVector, scale: FloatVector
) -> tuple[FloatVector, FloatVector]:
    """Return bounds of every |r_i(z)| for a few times the price: both 0 where w is known to be exactly 0."""
    matrix = problem.matrix
    value, radius = compensated_product(matrix.csr, z, problem.q)
    low, high = lower_end(value, radius), upper_end(value, radius)
    below, above = (
        residual_ends_of(None, np.zeros(1), problem, z, scale, q=w) for w in (low, high)
    )
    smallest = np.where((low < 0.0) & (high > 0.0), 0.0, np.minimum(below[0], above[0]))
    return smallest, np.maximum(below[1], above[1])


def magnitude(problem: LCP, whole: FloatVector) -> FloatVector:
    """Return |M||z| + |q|, shape (n,), at z."""
    absolute: Any = abs(problem.matrix.array)
    with np.errstate(all="ignore"):
        sizes: FloatVector = absolute @ np.abs(whole) + np.abs(problem.q)
    return sizes


def rounding_floor(problem: LCP, magnitude: FloatVector, scale: FloatVector) -> FloatVector:
    """Return what rounding alone can make of each residual, k_i ε (|M||z| + |q|)_i / d_i, k_i = nonzeros of row i + 2.

    Parameters
    ----------
    magnitude : array, shape (n,)
        |M||z| + |q|.
    scale : array, shape (n,)
        d.
    """
    terms = np.diff(problem.matrix.csr.indptr) + 2
    with np.errstate(all="ignore"):
        floor: FloatVector = terms * (EPSILON * magnitude + TINY) / scale
    return floor


def at_rounding_level(residual: FloatVector, floor: FloatVector) -> BoolVector:
    """Return where a residual is no more than four times that."""
    with np.errstate(over="ignore"):
        return (residual <= 4.0 * floor) & np.isfinite(floor)


def is_at_bound(problem: LCP, z: FloatVector) -> BoolVector:
    """Return where z has reached a bound, shape (n,), by its own value; what a step would do is not asked.

    Examples
    --------
    >>> is_at_bound(LCP([[2, 0], [0, 1]], [-2, 1], upper=[5, 0]), np.array([1.0, 0.0]))
    array([False,  True])
    """
    return (z <= problem.lower) | (z >= problem.upper)


def ratio_upwards(numerator: float, denominator: float) -> float:
    """Return a double that is no smaller than the quotient of two that are ≥ 0; 0 for 0/0.

    Examples
    --------
    >>> ratio_upwards(1.0, 4.0), ratio_upwards(1e-320, 1e10), ratio_upwards(1.0, 0.0)
    (0.25, 5e-324, inf)
    """
    quotient = ratio(numerator, denominator)
    if not quotient < np.inf:
        return quotient
    (a, b), (c, d), (e, f) = (
        x.as_integer_ratio() for x in (quotient, float(denominator), float(numerator))
    )
    return quotient if a * c * f >= e * b * d else math.nextafter(quotient, math.inf)


def largest_ratio(numerators: FloatVector, denominators: FloatVector) -> float:
    """Return a double that is no smaller than any of the quotients of numbers that are ≥ 0; 0 for 0/0, and for none.

    Examples
    --------
    >>> largest_ratio(np.array([1.0, 0.0]), np.array([4.0, 0.0]))
    0.25
    """
    if numerators.size == 1:
        return ratio_upwards(float(numerators[0]), float(denominators[0]))
    quotients = over(numerators, denominators)
    largest = float(quotients.max(initial=0.0))
    if not 0.0 < largest < np.inf:
        return largest
    near = np.flatnonzero(
        quotients >= largest * (1.0 - 4.0 * EPSILON)
    )  # what rounding may have put in another order
    return max(ratio_upwards(float(numerators[k]), float(denominators[k])) for k in near)


def over(numerators: FloatVector, denominators: FloatVector) -> FloatVector:
    """Return the quotients of numbers that are ≥ 0, with 0/0 = 0; NaN stays NaN."""
    with np.errstate(all="ignore"):
        quotients: FloatVector = np.where(numerators == 0.0, 0.0, numerators / denominators)
    return quotients


def ratio(numerator: float, denominator: float) -> float:
    """Return numerator/denominator with 0/0 = 0; NaN stays NaN, and nothing can be measured against ∞."""
    if denominator == np.inf:
        return np.nan
    if numerator == 0.0:
        return 0.0
    return numerator / denominator if denominator else np.inf if numerator > 0.0 else np.nan


def euclidean_norm(vector: FloatVector) -> float:
    """Return ‖vector‖₂ without overflow or underflow on the way."""
    largest = float(np.abs(vector).max(initial=0.0))
    if largest == 0.0 or not np.isfinite(largest):
        return largest
    scaled = vector / largest
    return largest * math.sqrt(float(scaled @ scaled))
