"""Elementary functions with their values and derivatives.

All work entry by entry. Outside its domain a function is NaN or infinite, never an exception.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from ..core.checks import Array
from ..core.kernels.floats import NORMAL


@dataclass(frozen=True)
class Function:
    """A function of one or two vectors, entry by entry.

    Attributes
    ----------
    name : str
    arguments : int
        1 or 2.
    value, derivatives : callable
        Functions of the arguments; `derivatives` returns one array per argument.
    """

    name: str
    arguments: int
    value: Callable[..., Any]
    derivatives: Callable[..., tuple[Any, ...]]

    def __reduce__(self) -> tuple[Callable[[str], Function], tuple[str]]:
        """Return the name, because lambdas cannot be pickled."""
        return _named, (self.name,)


def _log_of_quotient(u: Array, v: Array) -> Any:
    """Return log(u/v), also where the quotient is not a normal double."""
    quotient = u / v
    is_normal = (quotient >= NORMAL) & np.isfinite(quotient) & (v > 0.0)
    return np.where(is_normal, np.log(quotient), np.log(u) - np.log(v))


def _entropy(u: Array, v: Array) -> Any:
    return np.where((u == 0.0) & (v >= 0.0), 0.0, u * _log_of_quotient(u, v))


def _log_add_exp_slopes(u: Array, v: Array) -> tuple[Any, Any]:
    from scipy.special import expit  # slow to import, and seldom needed

    return expit(u - v), expit(v - u)


def _power_slopes(u: Array, v: Array) -> tuple[Any, Any]:
    by_exponent = np.where((u == 0.0) & (v > 0.0), 0.0, np.power(u, v) * np.log(u))
    return v * np.power(u, v - 1.0), by_exponent


EXP = Function("exp", 1, np.exp, lambda u: (np.exp(u),))
LOG = Function("log", 1, np.log, lambda u: (1.0 / u,))
LOG1P = Function("log1p", 1, np.log1p, lambda u: (1.0 / (1.0 + u),))
RELATIVE_ENTROPY = Function(
    "relative entropy", 2, _entropy, lambda u, v: (1.0 + _log_of_quotient(u, v), -(u / v))
)
LOG_ADD_EXP = Function("log add exp", 2, np.logaddexp, _log_add_exp_slopes)
PRODUCT = Function("product", 2, lambda u, v: u * v, lambda u, v: (v, u))
QUOTIENT = Function("quotient", 2, lambda u, v: u / v, lambda u, v: (1.0 / v, -(u / v) / v))
LOG10 = Function("log10", 1, np.log10, lambda u: (1.0 / (np.log(10.0) * u),))
POWER = Function("power of", 2, np.power, _power_slopes)
SIN = Function("sin", 1, np.sin, lambda u: (np.cos(u),))
COS = Function("cos", 1, np.cos, lambda u: (-np.sin(u),))
TAN = Function("tan", 1, np.tan, lambda u: (1.0 + np.tan(u) ** 2,))
SINH = Function("sinh", 1, np.sinh, lambda u: (np.cosh(u),))
COSH = Function("cosh", 1, np.cosh, lambda u: (np.sinh(u),))
TANH = Function("tanh", 1, np.tanh, lambda u: (1.0 / np.cosh(u) ** 2,))
# (1 − u)(1 + u) cancels nowhere.
ASIN = Function("asin", 1, np.arcsin, lambda u: (1.0 / np.sqrt((1.0 - u) * (1.0 + u)),))
ACOS = Function("acos", 1, np.arccos, lambda u: (-1.0 / np.sqrt((1.0 - u) * (1.0 + u)),))
ATAN = Function("atan", 1, np.arctan, lambda u: (1.0 / (1.0 + u**2),))
ASINH = Function("asinh", 1, np.arcsinh, lambda u: (1.0 / np.hypot(1.0, u),))
ACOSH = Function("acosh", 1, np.arccosh, lambda u: (1.0 / np.sqrt((u - 1.0) * (u + 1.0)),))
ATANH = Function("atanh", 1, np.arctanh, lambda u: (1.0 / ((1.0 - u) * (1.0 + u)),))
FUNCTIONS = {item.name: item for item in [*globals().values()] if isinstance(item, Function)}


def _named(name: str) -> Function:
    """Return the function of that name."""
    return FUNCTIONS[name] if name in FUNCTIONS else power(float(name.removeprefix("power ")))


@cache
def power(exponent: float) -> Function:
    """Return the function u ↦ u**exponent; the exponent is not zero.

    Examples
    --------
    >>> power(3.0).value(np.array([-2.0])), power(3.0).derivatives(np.array([-2.0]))
    (array([-8.]), (array([12.]),))
    """

    def slopes(u: Array) -> tuple[Any]:
        return (exponent * u ** (exponent - 1.0),)

    # numpy computes the powers 1, 2 and 1/2 as u, u² and √u.
    return Function(f"power {exponent!r}", 1, lambda u: u**exponent, slopes)


SAME, SQUARE = power(1.0), power(2.0)
