"""What is known of each elementary function: value, derivative, and intervals of both.

All work entry by entry. Outside its domain a function is NaN or infinite, never an exception.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from functools import cache
from typing import Any

import numpy as np

from ...core.checks import FloatVector
from . import intervals as iv

#: By each argument.
Derivatives = tuple[Any, ...]


@dataclass(frozen=True)
class Function:
    """A function of one or two vectors, entry by entry.

    Attributes
    ----------
    name : str
    arguments : int
        1 or 2.
    value, derivatives : callable
        Of the arguments; `derivatives` returns one vector an argument.
    interval, interval_derivatives : callable
        The same of intervals: what they return contains all that the others take on.
    """

    name: str
    arguments: int
    value: Callable[..., FloatVector]
    derivatives: Callable[..., Derivatives]
    interval: Callable[..., iv.Interval]
    interval_derivatives: Callable[..., tuple[iv.Interval, ...]]

    def __reduce__(self) -> tuple[Callable[[str], Function], tuple[str]]:
        """Return the name: functions without one, as here, cannot be pickled."""
        return _named, (self.name,)


def _ones(u: iv.Interval) -> iv.Interval:
    return np.ones_like(u[0]), np.ones_like(u[0])


def _quotient_slopes(u: iv.Interval, v: iv.Interval) -> tuple[iv.Interval, iv.Interval]:
    return iv.reciprocal(v), iv.negated(iv.divided(iv.divided(u, v), v))


def _log_of_quotient(u: FloatVector, v: FloatVector) -> FloatVector:
    """Return log(u/v), also where the quotient is no normal double."""
    quotient = u / v
    is_normal = (quotient >= iv.NORMAL) & np.isfinite(quotient) & (v > 0.0)
    logarithm: FloatVector = np.where(is_normal, np.log(quotient), np.log(u) - np.log(v))
    return logarithm


def _relative_entropy(u: FloatVector, v: FloatVector) -> FloatVector:
    is_zero = (u == 0.0) & (v >= 0.0)
    entropy: FloatVector = np.where(is_zero, 0.0, u * _log_of_quotient(u, v))
    return entropy


def _relative_entropy_interval(u: iv.Interval, v: iv.Interval) -> iv.Interval:
    return iv.multiplied(u, iv.logarithm_of_quotient(u, v))


def _relative_entropy_slopes(u: iv.Interval, v: iv.Interval) -> tuple[iv.Interval, iv.Interval]:
    return iv.added(iv.logarithm_of_quotient(u, v), _ones(u)), iv.negated(iv.divided(u, v))


def _log_add_exp_derivatives(u: FloatVector, v: FloatVector) -> tuple[FloatVector, FloatVector]:
    from scipy.special import expit  # slow to import, and seldom needed

    return expit(u - v), expit(v - u)


def _log_add_exp_slopes(u: iv.Interval, v: iv.Interval) -> tuple[iv.Interval, iv.Interval]:
    return iv.sigmoid(iv.added(u, iv.negated(v))), iv.sigmoid(iv.added(v, iv.negated(u)))


def _power_slopes(u: FloatVector, v: FloatVector) -> tuple[FloatVector, FloatVector]:
    by_exponent = np.where((u == 0.0) & (v > 0.0), 0.0, np.power(u, v) * np.log(u))
    return v * np.power(u, v - 1.0), by_exponent


def _one_less_square(u: iv.Interval) -> iv.Interval:
    """Return (1 − u)(1 + u), which cancels nowhere."""
    return iv.multiplied(iv.added(_ones(u), iv.negated(u)), iv.added(_ones(u), u))


def _root_slope(u: iv.Interval) -> iv.Interval:
    return iv.reciprocal(iv.root(u))


EXP = Function("exp", 1, np.exp, lambda u: (np.exp(u),), iv.exponential, lambda u: (iv.exponential(u),))
LOG = Function("log", 1, np.log, lambda u: (1.0 / u,), iv.logarithm, lambda u: (iv.reciprocal(u),))
LOG1P = Function(
    "log1p", 1, np.log1p, lambda u: (1.0 / (1.0 + u),),
    iv.logarithm_of_one_more, lambda u: (iv.reciprocal(iv.added(_ones(u), u)),),
)
RELATIVE_ENTROPY = Function(
    "relative entropy", 2, _relative_entropy, lambda u, v: (1.0 + _log_of_quotient(u, v), -(u / v)),
    _relative_entropy_interval, _relative_entropy_slopes,
)
LOG_ADD_EXP = Function(
    "log add exp", 2, np.logaddexp, _log_add_exp_derivatives, iv.log_add_exp, _log_add_exp_slopes
)
PRODUCT = Function(
    "product", 2, lambda u, v: u * v, lambda u, v: (v, u), iv.multiplied, lambda u, v: (v, u)
)
QUOTIENT = Function(
    "quotient", 2, lambda u, v: u / v, lambda u, v: (1.0 / v, -(u / v) / v), iv.divided, _quotient_slopes
)

LOG10 = Function(
    "log10", 1, np.log10, lambda u: (1.0 / (np.log(10.0) * u),),
    lambda u: iv.increasing(np.log10, u, 0.0),
    lambda u: (iv.reciprocal(iv.multiplied(u, iv.logarithm((np.array(10.0), np.array(10.0))))),),
)
POWER = Function(
    "power of", 2, np.power, _power_slopes, iv.power_of,
    lambda u, v: (iv.multiplied(v, iv.power_of(u, iv.added(v, iv.negated(_ones(v))))),
                  iv.multiplied(iv.power_of(u, v), iv.logarithm(u))),
)
SIN = Function(
    "sin", 1, np.sin, lambda u: (np.cos(u),),
    lambda u: iv.wave(np.sin, u, 0.5 * np.pi), lambda u: (iv.wave(np.cos, u, 0.0),),
)
COS = Function(
    "cos", 1, np.cos, lambda u: (-np.sin(u),),
    lambda u: iv.wave(np.cos, u, 0.0), lambda u: (iv.negated(iv.wave(np.sin, u, 0.5 * np.pi)),),
)
TAN = Function(
    "tan", 1, np.tan, lambda u: (1.0 + np.tan(u) ** 2,),
    iv.tangent, lambda u: (iv.added(_ones(u), iv.squared(iv.tangent(u))),),
)
SINH = Function(
    "sinh", 1, np.sinh, lambda u: (np.cosh(u),),
    lambda u: iv.increasing(np.sinh, u), lambda u: (iv.hyperbolic_cosine(u),),
)
COSH = Function(
    "cosh", 1, np.cosh, lambda u: (np.sinh(u),),
    iv.hyperbolic_cosine, lambda u: (iv.increasing(np.sinh, u),),
)
TANH = Function(
    "tanh", 1, np.tanh, lambda u: (1.0 / np.cosh(u) ** 2,),
    lambda u: iv.increasing(np.tanh, u), lambda u: (iv.reciprocal(iv.squared(iv.hyperbolic_cosine(u))),),
)
ASIN = Function(
    "asin", 1, np.arcsin, lambda u: (1.0 / np.sqrt((1.0 - u) * (1.0 + u)),),
    lambda u: iv.increasing(np.arcsin, u, -1.0, 1.0), lambda u: (_root_slope(_one_less_square(u)),),
)
ACOS = Function(
    "acos", 1, np.arccos, lambda u: (-1.0 / np.sqrt((1.0 - u) * (1.0 + u)),),
    lambda u: iv.negated(iv.increasing(lambda v: -np.arccos(v), u, -1.0, 1.0)),
    lambda u: (iv.negated(_root_slope(_one_less_square(u))),),
)
ATAN = Function(
    "atan", 1, np.arctan, lambda u: (1.0 / (1.0 + u * u),),
    lambda u: iv.increasing(np.arctan, u), lambda u: (iv.reciprocal(iv.added(_ones(u), iv.squared(u))),),
)
ASINH = Function(
    "asinh", 1, np.arcsinh, lambda u: (1.0 / np.hypot(1.0, u),),
    lambda u: iv.increasing(np.arcsinh, u), lambda u: (_root_slope(iv.added(_ones(u), iv.squared(u))),),
)
ACOSH = Function(
    "acosh", 1, np.arccosh, lambda u: (1.0 / np.sqrt((u - 1.0) * (u + 1.0)),),
    lambda u: iv.increasing(np.arccosh, u, 1.0), lambda u: (_root_slope(iv.negated(_one_less_square(u))),),
)
ATANH = Function(
    "atanh", 1, np.arctanh, lambda u: (1.0 / ((1.0 - u) * (1.0 + u)),),
    lambda u: iv.increasing(np.arctanh, u, -1.0, 1.0), lambda u: (iv.reciprocal(_one_less_square(u)),),
)

_FUNCTIONS = {function.name: function for function in (
    EXP, LOG, LOG1P, RELATIVE_ENTROPY, LOG_ADD_EXP, PRODUCT, QUOTIENT, LOG10, POWER,
    SIN, COS, TAN, SINH, COSH, TANH, ASIN, ACOS, ATAN, ASINH, ACOSH, ATANH,
)}


def _named(name: str) -> Function:
    """Return the function of that name."""
    return _FUNCTIONS[name] if name in _FUNCTIONS else power(float(name.removeprefix("power ")))


@cache
def power(exponent: float) -> Function:
    """Return the function u ↦ u**exponent; the exponent is not zero.

    Examples
    --------
    >>> power(3.0).value(np.array([-2.0])), power(3.0).derivatives(np.array([-2.0]))
    (array([-8.]), (array([12.]),))
    """
    return Function(
        f"power {exponent!r}", 1,
        lambda u: u**exponent,  # which numpy takes for u, u² and √u where it is
        lambda u: (exponent * u ** (exponent - 1.0),),
        lambda u: iv.power(u, exponent),
        lambda u: (_power_slope(u, exponent),),
    )


def _power_slope(u: iv.Interval, exponent: float) -> iv.Interval:
    """Return exponent · u**(exponent − 1), also where exponent − 1 is no double: between those of its neighbours."""
    rounded = exponent - 1.0
    if rounded == 0.0:
        return _ones(u)
    if Fraction(rounded) == Fraction(exponent) - 1:
        return iv.scaled(iv.power(u, rounded), exponent)
    ends = [iv.power(u, float(np.nextafter(rounded, end))) for end in (-np.inf, np.inf)]
    hull = np.minimum(ends[0][0], ends[1][0]), np.maximum(ends[0][1], ends[1][1])
    # Where the neighbours are even numbers, exponent − 1 is odd, and the sign is that of u.
    return iv.scaled(iv.nothing_known(hull, ~(u[0] >= 0.0)), exponent)


SAME, SQUARE = power(1.0), power(2.0)
