"""The binomial tree of Cox, Ross and Rubinstein: option prices without a differential equation."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from ...checks import FloatVector
from ...errors import InvalidOption


def binomial_put(
    spot: ArrayLike, *, strike: float, rate: float, volatility: float, maturity: float, steps: int = 1000
) -> FloatVector:
    """Return American put prices from a binomial tree.

    Parameters
    ----------
    spot
        Spot prices, any shape, currency.
    strike, rate, volatility, maturity
        As in `american_put`.
    steps
        Levels of the tree, at least 1; the error falls like 1/steps.

    Returns
    -------
    ndarray, shape of `spot`
        Prices, currency.

    Raises
    ------
    InvalidOption
        Where volatility, maturity or steps is not positive, or the steps are so long that the tree's
        probabilities leave (0, 1).

    Notes
    -----
    Up by u = e^{σ√Δ}, down by 1/u, risk-neutral probability (e^{rΔ} − 1/u)/(u − 1/u); on the way back each
    value is the larger of exercise and discounted expectation. O(steps²) for each spot price.

    References
    ----------
    Cox, Ross, Rubinstein, *Option pricing: a simplified approach*, J. Financial Economics 7, 1979,
    doi:10.1016/0304-405X(79)90015-1.

    Examples
    --------
    >>> price = binomial_put(100.0, strike=100.0, rate=0.05, volatility=0.2, maturity=1.0)
    >>> round(float(price), 2)
    6.09
    """
    up, growth, probability = _tree(rate, volatility, maturity, steps)
    price = np.asarray(spot, dtype=np.float64)[..., None]
    exercise = np.maximum(strike - price * up ** np.arange(-steps, steps + 1), 0.0)
    values = exercise[..., ::2]
    for level in range(steps - 1, -1, -1):
        expected = (probability * values[..., 1:] + (1.0 - probability) * values[..., :-1]) / growth
        first = steps - level
        values = np.maximum(expected, exercise[..., first : first + 2 * level + 1 : 2])
    return values[..., 0]


def _tree(rate: float, volatility: float, maturity: float, steps: int) -> tuple[float, float, float]:
    """Return factor up, growth of money per step, probability of going up."""
    for name, value in (("volatility", volatility), ("maturity", maturity), ("steps", steps)):
        if not value > 0:
            raise InvalidOption(f"binomial_put: {name} must be positive, got {value}")
    time_step = maturity / steps
    up = math.exp(volatility * math.sqrt(time_step))
    growth = math.exp(rate * time_step)
    probability = (growth - 1.0 / up) / (up - 1.0 / up)
    if not 0.0 < probability < 1.0:
        needed = math.floor(maturity * (rate / volatility) ** 2) + 1
        raise InvalidOption(
            f"binomial_put: steps must be at least {needed} at this rate and volatility, got {steps}"
        )
    return up, growth, probability
