"""Quotients of residuals and their references, and norms, without overflow on the way."""

from __future__ import annotations

import math

import numpy as np

from ..checks import FloatVector
from ..kernels.floats import EPSILON
from ..peers.alone import ALONE, Peers


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
    (a, b), (c, d), (e, f) = (x.as_integer_ratio() for x in (quotient, float(denominator), float(numerator)))
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
    with np.errstate(all="ignore"):
        quotients = over(numerators, denominators)
    largest = float(quotients.max(initial=0.0))
    if not 0.0 < largest < np.inf:
        return largest
    near = np.flatnonzero(quotients >= largest * (1.0 - 4.0 * EPSILON))  # what rounding may have put in another order
    return max(ratio_upwards(float(numerators[k]), float(denominators[k])) for k in near)


def over(numerators: FloatVector, denominators: FloatVector) -> FloatVector:
    """Return the quotients of numbers that are ≥ 0, with 0/0 = 0; NaN stays NaN."""
    quotients: FloatVector = np.where(numerators == 0.0, 0.0, numerators / denominators)
    return quotients


def ratio(numerator: float, denominator: float) -> float:
    """Return numerator/denominator with 0/0 = 0; NaN stays NaN, and nothing can be measured against ∞."""
    if denominator == np.inf:
        return np.nan
    if numerator == 0.0:
        return 0.0
    return numerator / denominator if denominator else np.inf if numerator > 0.0 else np.nan


def euclidean_norm(vector: FloatVector, peers: Peers = ALONE) -> float:
    """Return ‖vector‖₂, of everybody's parts, without overflow or underflow on the way."""
    largest = peers.largest(float(np.abs(vector).max(initial=0.0)))
    if largest == 0.0 or not np.isfinite(largest):
        return largest
    scaled = vector / largest
    return largest * math.sqrt(peers.total(float(scaled @ scaled)))
