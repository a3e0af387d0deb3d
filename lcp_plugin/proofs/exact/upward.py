"""Sums, products and quotients rounded upwards, element by element.

An exact result stays exact, so that a bound of 0 can be had. Nothing is lost to overflow: a sum or quotient of −∞
becomes the least double, which is above whatever it stands for. NaN stays NaN.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ...core.checks import FloatVector
from ...core.kernels.floats import EPSILON, LARGEST, TINY

LEAST = -LARGEST


def sum_above(a: Any, b: Any) -> FloatVector:
    """Return a double ≥ a + b, equal to it where a + b is a double."""
    with np.errstate(all="ignore"):
        total = np.add(a, b)
        part = total - a
        error = (a - (total - part)) + (b - part)  # NaN if something overflowed or was infinite
        return _choice(error <= 0.0, total, _above(total))


def product_above(a: Any, b: Any) -> FloatVector:
    """Return a double ≥ a b, and 0 where a factor is 0."""
    with np.errstate(all="ignore"):
        return _choice(np.equal(a, 0.0) | np.equal(b, 0.0), 0.0, _above(np.multiply(a, b)))


def quotient_above(a: Any, b: Any) -> FloatVector:
    """Return a double ≥ a/b for b > 0, and 0 where a is 0."""
    with np.errstate(all="ignore"):
        return _choice(np.equal(a, 0.0), 0.0, _above(np.divide(a, b)))


def _above(value: Any) -> FloatVector:
    """Return a double above the value: the next one or the one after; the least one for −∞."""
    # In [1, 2) units in the last place; the product underflows only if TINY is one unit.
    return _choice(value < LEAST, LEAST, value + np.maximum(np.abs(value) * EPSILON, TINY))


def _choice(which: Any, one: Any, other: Any) -> FloatVector:
    """Return ``numpy.where(which, one, other)``, a number of numbers."""
    chosen: FloatVector = np.where(which, one, other)[()]
    return chosen
