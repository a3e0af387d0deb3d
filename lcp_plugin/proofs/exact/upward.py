"""Sums, products and quotients rounded upwards, element by element.

An exact result stays exact, so that a bound can be 0. Overflow is safe: a sum or quotient of −∞
becomes the least float64, which is above the true value. NaN stays NaN.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ...core.checks import FloatVector
from ...core.kernels.floats import EPSILON, LARGEST, TINY

LEAST = -LARGEST


def sum_above(a: Any, b: Any) -> FloatVector:
    """Return a float64 ≥ a + b, equal to it if a + b is a float64."""
    total = np.add(a, b)
    part = total - a
    error = (a - (total - part)) + (b - part)  # NaN if something overflowed or was infinite
    return _choice(error <= 0.0, total, _above(total))


def product_above(a: Any, b: Any) -> FloatVector:
    """Return a float64 ≥ a b, and 0 if a or b is 0."""
    return _choice(np.equal(a, 0.0) | np.equal(b, 0.0), 0.0, _above(np.multiply(a, b)))


def quotient_above(a: Any, b: Any) -> FloatVector:
    """Return a float64 ≥ a/b for b > 0, and 0 if a is 0."""
    return _choice(np.equal(a, 0.0), 0.0, _above(np.divide(a, b)))


def _above(value: Any) -> FloatVector:
    """Return a float64 above the value, by one or two steps; the least finite number for −∞."""
    # In [1, 2) ulps; the product underflows only if TINY is the ulp.
    return _choice(value < LEAST, LEAST, value + np.maximum(np.abs(value) * EPSILON, TINY))


def _choice(which: Any, one: Any, other: Any) -> FloatVector:
    """Return ``numpy.where(which, one, other)``, a number of numbers."""
    chosen: FloatVector = np.where(which, one, other)[()]
    return chosen
