"""Quotients of numbers ≥ 0 that are rounded upwards, and rows at rounding level."""

from __future__ import annotations

import math

import numpy as np

from ..checks import BoolVector, FloatVector
from ..kernels.floats import EPSILON
from ..lcp import LCP


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
