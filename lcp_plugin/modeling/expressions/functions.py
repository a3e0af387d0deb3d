"""What is known of each elementary function: value and derivative, of numbers and of intervals by one formula.

All work entry by entry. Outside its domain a function is NaN or infinite, never an exception.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from functools import cache
from typing import Any

import numpy as np

from . import intervals as iv
from .intervals import Enclosure


@dataclass(frozen=True)
class Function:
    """A function of one or two vectors, entry by entry.

    Attributes
    ----------
    name : str
    arguments : int
        1 or 2.
    value, derivatives : callable
        Of the arguments, arrays or enclosures; `derivatives` returns one an argument.
    """

    name: str
    arguments: int
    value: Callable[..., Any]
    derivatives: Callable[..., tuple[Any, ...]]

    def interval(self, *u: Any) -> iv.Interval:
        """Return an interval that contains all values."""
        ends: iv.Interval = self.value(*map(Enclosure, u)).ends
        return ends

    def interval_derivatives(self, *u: Any) -> tuple[iv.Interval, ...]:
        """Return an interval an argument that contains all derivatives by it."""
        return tuple(one.ends for one in self.derivatives(*map(Enclosure, u)))

    def __reduce__(self) -> tuple[Callable[[str], Function], tuple[str]]:
        """Return the name: functions without one, as here, cannot be pickled."""
        return _named, (self.name,)


def _log_of_quotient(u: Any, v: Any) -> Any:
    """Return log(u/v), also where the quotient is no normal double."""
    if isinstance(u, Enclosure):
        return Enclosure(iv.logarithm_of_quotient(u.ends, v.ends))
    quotient = u / v
    is_normal = (quotient >= iv.NORMAL) & np.isfinite(quotient) & (v > 0.0)
    return np.where(is_normal, np.log(quotient), np.log(u) - np.log(v))


def _relative_entropy(u: Any, v: Any) -> Any:
    entropy = u * _log_of_quotient(u, v)
    return entropy if isinstance(u, Enclosure) else np.where((u == 0.0) & (v >= 0.0), 0.0, entropy)


def _log_add_exp_slopes(u: Any, v: Any) -> tuple[Any, Any]:
    from scipy.special import expit  # slow to import, and seldom needed

    return expit(u - v), expit(v - u)


def _log10_slope(u: Any) -> tuple[Any]:
    ten = Enclosure((np.array(10.0), np.array(10.0))) if isinstance(u, Enclosure) else 10.0
    return (1.0 / (np.log(ten) * u),)


def _power_slopes(u: Any, v: Any) -> tuple[Any, Any]:
    by_exponent = np.power(u, v) * np.log(u)
    if not isinstance(u, Enclosure):
        by_exponent = np.where((u == 0.0) & (v > 0.0), 0.0, by_exponent)
    return v * np.power(u, v - 1.0), by_exponent


EXP = Function("exp", 1, np.exp, lambda u: (np.exp(u),))
LOG = Function("log", 1, np.log, lambda u: (1.0 / u,))
LOG1P = Function("log1p", 1, np.log1p, lambda u: (1.0 / (1.0 + u),))
RELATIVE_ENTROPY = Function(
    "relative entropy", 2, _relative_entropy, lambda u, v: (1.0 + _log_of_quotient(u, v), -(u / v))
)
LOG_ADD_EXP = Function("log add exp", 2, np.logaddexp, _log_add_exp_slopes)
PRODUCT = Function("product", 2, lambda u, v: u * v, lambda u, v: (v, u))
QUOTIENT = Function("quotient", 2, lambda u, v: u / v, lambda u, v: (1.0 / v, -(u / v) / v))
LOG10 = Function("log10", 1, np.log10, _log10_slope)
POWER = Function("power of", 2, np.power, _power_slopes)
SIN = Function("sin", 1, np.sin, lambda u: (np.cos(u),))
COS = Function("cos", 1, np.cos, lambda u: (-np.sin(u),))
TAN = Function("tan", 1, np.tan, lambda u: (1.0 + np.tan(u) ** 2,))
SINH = Function("sinh", 1, np.sinh, lambda u: (np.cosh(u),))
COSH = Function("cosh", 1, np.cosh, lambda u: (np.sinh(u),))
TANH = Function("tanh", 1, np.tanh, lambda u: (1.0 / np.cosh(u) ** 2,))
# (1 − u)(1 + u) cancels nowhere; u² of an interval is nowhere negative, u · u may be.
ASIN = Function("asin", 1, np.arcsin, lambda u: (1.0 / np.sqrt((1.0 - u) * (1.0 + u)),))
ACOS = Function("acos", 1, np.arccos, lambda u: (-1.0 / np.sqrt((1.0 - u) * (1.0 + u)),))
ATAN = Function("atan", 1, np.arctan, lambda u: (1.0 / (1.0 + u**2),))
ASINH = Function("asinh", 1, np.arcsinh, lambda u: (1.0 / np.hypot(1.0, u),))
ACOSH = Function("acosh", 1, np.arccosh, lambda u: (1.0 / np.sqrt((u - 1.0) * (u + 1.0)),))
ATANH = Function("atanh", 1, np.arctanh, lambda u: (1.0 / ((1.0 - u) * (1.0 + u)),))
_FUNCTIONS = {
    function.name: function
    for function in (
        EXP,
        LOG,
        LOG1P,
        RELATIVE_ENTROPY,
        LOG_ADD_EXP,
        PRODUCT,
        QUOTIENT,
        LOG10,
        POWER,
        SIN,
        COS,
        TAN,
        SINH,
        COSH,
        TANH,
        ASIN,
        ACOS,
        ATAN,
        ASINH,
        ACOSH,
        ATANH,
    )
}


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

    def slope(u: Any) -> tuple[Any]:
        if isinstance(u, Enclosure):
            return (Enclosure(_power_slope(u.ends, exponent)),)
        return (exponent * u ** (exponent - 1.0),)

    # numpy takes u, u² and √u for the power where it is one.
    return Function(f"power {exponent!r}", 1, lambda u: u**exponent, slope)


def _power_slope(u: iv.Interval, exponent: float) -> iv.Interval:
    """Return exponent · u**(exponent − 1), also where exponent − 1 is no double: between those of its neighbours."""
    rounded = exponent - 1.0
    if rounded == 0.0:
        return np.ones_like(u[0]), np.ones_like(u[0])
    if Fraction(rounded) == Fraction(exponent) - 1:
        return iv.scaled(iv.power(u, rounded), exponent)
    ends = [iv.power(u, float(np.nextafter(rounded, end))) for end in (-np.inf, np.inf)]
    hull = np.minimum(ends[0][0], ends[1][0]), np.maximum(ends[0][1], ends[1][1])
    # Where the neighbours are even numbers, exponent − 1 is odd, and the sign is that of u.
    return iv.scaled(iv.nothing_known(hull, ~(u[0] >= 0.0)), exponent)


SAME, SQUARE = power(1.0), power(2.0)
