"""Arithmetic with intervals (lower ends, upper ends) of doubles, rounded outwards.

An interval contains every real value that its operation takes on the operands. ±∞ stands for no bound; where a function
is undefined somewhere in its argument, nothing is known and the interval is (−∞, ∞).

Sums, products, quotients and square roots are rounded correctly (IEEE 754), so that the next double outwards is a
bound. exp, log, powers, trigonometric and hyperbolic functions are not: of their values in doubles numpy's own accuracy
test (``numpy/_core/tests/test_umath_accuracy.py`` and its data) accepts 2 ULP for tanh, 1 ULP for the others, and the
libraries that numpy calls, glibc's among them, state at most 2 ULP for pow. `ULPS` is several times that, for all.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeAlias

import numpy as np
from numpy.lib.mixins import NDArrayOperatorsMixin

from ...core.checks import FloatVector
from ...core.kernels.floats import EPSILON, UNIT

Interval: TypeAlias = tuple[FloatVector, FloatVector]

ULPS = 8
NORMAL = 2.0**-1022  # the smallest normal double: below it results may be flushed to zero


def outward(lower: Any, upper: Any) -> Interval:
    """Return the interval one double wider at both ends; no bound where there is no number."""
    lower, upper = np.nextafter(lower, -np.inf), np.nextafter(upper, np.inf)
    return np.where(np.isnan(lower), -np.inf, lower), np.where(np.isnan(upper), np.inf, upper)


def widened(lower: Any, upper: Any) -> Interval:
    """Return the interval from values of elementary functions, each wrong by a few units in the last place."""
    margins = (ULPS * EPSILON * np.abs(end) + NORMAL for end in (lower, upper))
    return outward(lower - next(margins), upper + next(margins))


def nothing_known(interval: Interval, is_undefined: Any) -> Interval:
    """Return the interval, (−∞, ∞) where the mask says so."""
    return np.where(is_undefined, -np.inf, interval[0]), np.where(is_undefined, np.inf, interval[1])


def added(a: Interval, b: Interval) -> Interval:
    """Return a + b."""
    return outward(a[0] + b[0], a[1] + b[1])


def negated(a: Interval) -> Interval:
    """Return −a, exactly."""
    return -a[1], -a[0]


def scaled(a: Interval, factor: float) -> Interval:
    """Return factor · a."""
    ends = (factor * a[0], factor * a[1])
    return outward(*(ends if factor >= 0.0 else ends[::-1]))


def multiplied(a: Interval, b: Interval) -> Interval:
    """Return a · b."""
    products = [x * y for x in a for y in b]
    return outward(np.minimum.reduce(products), np.maximum.reduce(products))


def divided(a: Interval, b: Interval) -> Interval:
    """Return a / b; nothing is known where b contains zero."""
    quotients = [x / y for x in a for y in b]
    whole = outward(np.minimum.reduce(quotients), np.maximum.reduce(quotients))
    return nothing_known(whole, (b[0] <= 0.0) & (b[1] >= 0.0))


def reciprocal(a: Interval) -> Interval:
    """Return 1 / a."""
    one = np.ones_like(a[0])
    return divided((one, one), a)


def squared(a: Interval) -> Interval:
    """Return a², which is nowhere negative."""
    least, most = _magnitudes(a)
    lower, upper = outward(least * least, most * most)
    return np.maximum(lower, 0.0), upper


def exponential(a: Interval) -> Interval:
    """Return exp(a)."""
    lower, upper = widened(np.exp(a[0]), np.exp(a[1]))
    return np.maximum(lower, 0.0), upper


def logarithm(a: Interval) -> Interval:
    """Return log(a); nothing is known where a reaches zero."""
    return nothing_known(widened(np.log(a[0]), np.log(a[1])), ~(a[0] > 0.0))


def logarithm_of_quotient(a: Interval, b: Interval) -> Interval:
    """Return log(a/b); nothing is known where a or b reaches zero."""
    of_quotient, of_difference = (
        logarithm(divided(a, b)),
        added(logarithm(a), negated(logarithm(b))),
    )
    known = (
        np.maximum(of_quotient[0], of_difference[0]),
        np.minimum(of_quotient[1], of_difference[1]),
    )
    return nothing_known(known, ~(a[0] > 0.0) | ~(b[0] > 0.0))


def logarithm_of_one_more(a: Interval) -> Interval:
    """Return log(1 + a); nothing is known where a reaches −1."""
    return nothing_known(widened(np.log1p(a[0]), np.log1p(a[1])), ~(a[0] > -1.0))


def increasing(
    f: Callable[..., Any], a: Interval, least: float = -np.inf, most: float = np.inf
) -> Interval:
    """Return f(a) for an elementary f that grows between least and most; nothing is known where a reaches beyond."""
    return nothing_known(widened(f(a[0]), f(a[1])), ~((a[0] >= least) & (a[1] <= most)))


def hyperbolic_cosine(a: Interval) -> Interval:
    """Return cosh(a), which is nowhere below 1."""
    lower, upper = increasing(np.cosh, _magnitudes(a))
    return np.maximum(lower, 1.0), upper


def wave(f: Callable[..., Any], a: Interval, crest: float) -> Interval:
    """Return f(a) for sin or cos, which falls from 1 at the crest to −1 half a turn later and rises again."""
    ends = f(a[0]), f(a[1])
    lower, upper = widened(np.minimum(*ends), np.maximum(*ends))
    lower = np.where(_may_hold(a, crest + np.pi, 2.0 * np.pi), -1.0, np.maximum(lower, -1.0))
    return lower, np.where(_may_hold(a, crest, 2.0 * np.pi), 1.0, np.minimum(upper, 1.0))


def tangent(a: Interval) -> Interval:
    """Return tan(a), which grows between its poles; nothing is known where a may hold one."""
    return nothing_known(widened(np.tan(a[0]), np.tan(a[1])), _may_hold(a, 0.5 * np.pi, np.pi))


def _may_hold(a: Interval, place: float, period: float) -> Any:
    """Return whether a holds place + k · period for a whole k; true where rounding leaves it open, or a is unbounded.

    Multiples of π are rounded with an error below 4 ε |a| + 4 ε: a is widened by several times that.
    """
    margin = 64.0 * EPSILON * (1.0 + np.maximum(np.abs(a[0]), np.abs(a[1])))
    first = place + period * np.ceil((a[0] - margin - place) / period)
    return ~(first > a[1] + margin)


def power_of(a: Interval, b: Interval) -> Interval:
    """Return a to the power b, monotone in both; nothing is known where a reaches zero."""
    corners = [np.power(x, y) for x in a for y in b]
    lower, upper = widened(np.minimum.reduce(corners), np.maximum.reduce(corners))
    return nothing_known((np.maximum(lower, 0.0), upper), ~(a[0] > 0.0))


def softplus(a: Interval) -> Interval:
    """Return log(1 + exp(a)): of logaddexp, which is an exp, a log1p and a sum, three errors at most."""
    lower, upper = widened(*widened(*(np.logaddexp(0.0, end) for end in a)))
    return np.maximum(lower, 0.0), upper


def sigmoid(a: Interval) -> Interval:
    """Return 1/(1 + exp(−a)), which grows with a; of a negative end as exp(a)/(1 + exp(a)), which does not overflow."""
    (lower, _), (_, upper) = (_sigmoid_at(end) for end in a)
    return np.maximum(lower, 0.0), np.minimum(upper, 1.0)


def _sigmoid_at(x: FloatVector) -> Interval:
    one, size = np.ones_like(x), -np.abs(x)
    decay = exponential((size, size))
    rest = reciprocal(added((one, one), decay))
    both = rest, multiplied(decay, rest)
    return np.where(x >= 0.0, both[0][0], both[1][0]), np.where(x >= 0.0, both[0][1], both[1][1])


def log_add_exp(a: Interval, b: Interval) -> Interval:
    """Return log(exp(a) + exp(b)), which grows with both: the larger plus log(1 + exp(−|a − b|))."""
    (lower, _), (_, upper) = (_log_add_exp_at(x, y) for x, y in zip(a, b, strict=True))
    return lower, upper


def _log_add_exp_at(x: FloatVector, y: FloatVector) -> Interval:
    most, least = np.maximum(x, y), np.minimum(x, y)
    return added((most, most), softplus(added((least, least), (-most, -most))))


def root(a: Interval) -> Interval:
    """Return √a; nothing is known where a is negative somewhere."""
    lower, upper = outward(np.sqrt(a[0]), np.sqrt(a[1]))
    return nothing_known((np.maximum(lower, 0.0), upper), ~(a[0] >= 0.0))


def power(a: Interval, exponent: float) -> Interval:
    """Return a to a fixed exponent, which must not be zero."""
    if exponent < 0.0:
        return reciprocal(power(a, -exponent))
    if exponent == 1.0:
        return a
    if exponent == 0.5:
        return root(a)
    if exponent == 2.0:
        return squared(a)
    if exponent % 2.0 == 0.0:
        a = _magnitudes(a)
    lower, upper = widened(np.power(a[0], exponent), np.power(a[1], exponent))
    lower = np.where(a[0] >= 0.0, np.maximum(lower, 0.0), lower)
    return (
        (lower, upper) if exponent % 1.0 == 0.0 else nothing_known((lower, upper), ~(a[0] >= 0.0))
    )


def _magnitudes(a: Interval) -> Interval:
    """Return the least and the largest absolute value, exactly."""
    first, last = np.abs(a[0]), np.abs(a[1])
    holds_zero = (a[0] <= 0.0) & (a[1] >= 0.0)
    return np.where(holds_zero, 0.0, np.minimum(first, last)), np.maximum(first, last)


class Enclosure(NDArrayOperatorsMixin):
    """An interval in formulas that are written for arrays: operators and numpy's functions are those of `ENCLOSED`."""

    def __init__(self, ends: Any) -> None:
        self.ends: Interval = (ends[0], ends[1])

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: Any) -> Enclosure:
        """Return the interval of a function; a number is an interval of one point."""
        return Enclosure(
            ENCLOSED[ufunc.__name__](
                *(one.ends if isinstance(one, Enclosure) else (one, one) for one in inputs)
            )
        )


ENCLOSED: dict[str, Callable[..., Interval]] = {
    "add": added,
    "subtract": lambda a, b: added(a, negated(b)),
    "multiply": multiplied,
    "divide": divided,
    "negative": negated,
    "power": lambda a, b: power_of(a, b) if np.ndim(b[0]) else power(a, b[0]),
    "sqrt": root,
    "hypot": lambda a, b: root(added(squared(a), squared(b))),
    "exp": exponential,
    "log": logarithm,
    "log1p": logarithm_of_one_more,
    "logaddexp": log_add_exp,
    "expit": sigmoid,
    "log10": lambda a: increasing(np.log10, a, 0.0),
    "sin": lambda a: wave(np.sin, a, 0.5 * np.pi),
    "cos": lambda a: wave(np.cos, a, 0.0),
    "tan": tangent,
    "sinh": lambda a: increasing(np.sinh, a),
    "cosh": hyperbolic_cosine,
    "tanh": lambda a: increasing(np.tanh, a),
    "arcsin": lambda a: increasing(np.arcsin, a, -1.0, 1.0),
    "arctan": lambda a: increasing(np.arctan, a),
    "arccos": lambda a: negated(increasing(lambda v: -np.arccos(v), a, -1.0, 1.0)),
    "arcsinh": lambda a: increasing(np.arcsinh, a),
    "arccosh": lambda a: increasing(np.arccosh, a, 1.0),
    "arctanh": lambda a: increasing(np.arctanh, a, -1.0, 1.0),
}


class EnclosedProduct:
    """A sparse matrix as a map of intervals: encloses A v + b for every v in an interval.

    Parameters
    ----------
    matrix : CSR array, shape (m, k)
        Its entries count as exact.

    Notes
    -----
    A row of k entries is computed with a relative error of at most (k + 2) u/(1 − (k + 2) u) in the sum of absolute
    values, however it is summed up.
    """

    def __init__(self, matrix: Any) -> None:
        self._positive, self._negative = matrix.copy(), matrix.copy()
        self._positive.data, self._negative.data = (
            np.maximum(matrix.data, 0.0),
            np.minimum(matrix.data, 0.0),
        )
        for part in (self._positive, self._negative):
            part.eliminate_zeros()
        self._size = abs(matrix)
        terms = np.diff(matrix.indptr) + 4.0
        self._is_constant = np.diff(matrix.indptr) == 0
        self._error, self._underflow = 1.1 * UNIT * terms, terms * NORMAL

    def __call__(self, v: Interval, offset: FloatVector) -> Interval:
        """Return the interval of A v + offset."""
        lower = self._positive @ v[0] + self._negative @ v[1] + offset
        upper = self._positive @ v[1] + self._negative @ v[0] + offset
        size = self._size @ np.maximum(np.abs(v[0]), np.abs(v[1])) + np.abs(offset)
        margin = self._error * size + self._underflow
        lower, upper = outward(lower - margin, upper + margin)
        return np.where(self._is_constant, offset, lower), np.where(
            self._is_constant, offset, upper
        )
