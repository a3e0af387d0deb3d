"""Residuals of rows with bounds of their rounding errors; quotients that are rounded upwards."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ..checks import BoolVector, FloatVector
from ..kernels.floats import EPSILON, TINY
from ..lcp import LCP
from ..matrix.matrix import Matrix, fact
from ..matrix.row_sums import row_blocks


def scaled_residual(
    problem: LCP, z: FloatVector, w: FloatVector, scale: FloatVector | None = None
) -> FloatVector:
    """Return r_i = z_i − mid(lower_i, upper_i, z_i − w_i/d_i), shape (n,); ∞ where w_i is not finite.

    The formula mid(z − upper, z − lower, w/d) gives the same number without the loss of a small step relative to a
    large z. If w overflows, its sign is unknown, and the residual is ∞.
    """
    residual, scale = np.empty(z.size), problem.residual_scale if scale is None else scale
    for rows in row_blocks(z.size):  # intermediate arrays stay in the cache
        step = w[rows] / scale[rows]
        block = np.subtract(z[rows], problem.upper[rows], out=residual[rows])
        np.maximum(step, block, out=block)
        np.minimum(block, z[rows] - problem.lower[rows], out=block)
    if not np.isfinite(w.sum()):
        residual[np.isinf(w)] = np.inf
    return residual


@fact
def row_counts(matrix: Matrix) -> Any:
    """Return the number of entries of each row, shape (n,), or n of a dense M."""
    return matrix.n if matrix.is_dense else np.diff(matrix.csr.indptr)


def magnitude(problem: LCP, z: FloatVector) -> FloatVector:
    """Return |M||z| + |q|, shape (n,)."""
    with np.errstate(all="ignore"):
        sizes: FloatVector = abs(problem.matrix.array) @ np.abs(z) + np.abs(problem.q)
    return sizes


def measured_residual(problem: LCP, z: FloatVector) -> float:
    """Return ‖r(z)‖∞ as computed in double precision, without a bound of its rounding error."""
    with np.errstate(all="ignore"):
        residual = scaled_residual(problem, z, problem.slack(z))
        return float(np.abs(residual, out=residual).max(initial=0.0))


def rounding_floor(problem: LCP, magnitude: FloatVector, scale: FloatVector) -> FloatVector:
    """Return the rounding level of each residual: k_i ε (|M||z| + |q|)_i / d_i with k_i = nonzeros of row i + 2.

    Parameters
    ----------
    magnitude : array, shape (own,)
        |M||z| + |q|.
    scale : array, shape (own,)
        d.
    """
    terms = row_counts(problem.matrix) + 2
    with np.errstate(all="ignore"):
        floor: FloatVector = terms * (EPSILON * magnitude + TINY) / scale
    return floor


def find_rounding_rows(residual: FloatVector, floor: FloatVector) -> BoolVector:
    """Return the rows whose residual is at most four times its rounding level."""
    with np.errstate(over="ignore"):
        return (residual <= 4.0 * floor) & np.isfinite(floor)


def is_at_bound(problem: LCP, z: FloatVector) -> BoolVector:
    """Return the rows whose z_i is at a bound or beyond it, bool, shape (n,).

    Examples
    --------
    >>> is_at_bound(LCP([[2, 0], [0, 1]], [-2, 1], upper=[5, 0]), np.array([1.0, 0.0]))
    array([False,  True])
    """
    return (z <= problem.lower) | (z >= problem.upper)


def ratio_upwards(numerator: float, denominator: float) -> float:
    """Return the quotient of two numbers ≥ 0, rounded upwards; 0 for 0/0.

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
    """Return the largest quotient of numbers ≥ 0, rounded upwards; 0 for 0/0, and for empty arrays.

    Examples
    --------
    >>> largest_ratio(np.array([1.0, 0.0]), np.array([4.0, 0.0]))
    0.25
    """
    if numerators.size == 1:
        return ratio_upwards(float(numerators[0]), float(denominators[0]))
    quotients = divide_nonnegative(numerators, denominators)
    largest = float(quotients.max(initial=0.0))
    if not 0.0 < largest < np.inf:
        return largest
    near = np.flatnonzero(
        quotients >= largest * (1.0 - 4.0 * EPSILON)
    )  # quotients whose order is uncertain by rounding
    return max(ratio_upwards(float(numerators[k]), float(denominators[k])) for k in near)


def divide_nonnegative(numerators: FloatVector, denominators: FloatVector) -> FloatVector:
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
