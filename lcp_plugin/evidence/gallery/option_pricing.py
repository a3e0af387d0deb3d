"""The American put option: one linear complementarity problem per implicit step in time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...checks import FloatVector
from ...problem.lcp import LCP
from .parameters import Count, NonNegative, Positive
from .registry import scene_builder
from .scene import Scene
from .stencil import dirichlet_terms, nodes, stencil_matrix


@scene_builder
def american_put(
    *,
    size: Count = 1001,
    strike: Positive = 100.0,
    rate: NonNegative = 0.05,
    volatility: Positive = 0.2,
    maturity: Positive = 1.0,
    log_range: Positive = 1.5,
    steps: Count = 100,
) -> Scene:
    """American put, one implicit Euler step of length maturity/steps back from the payoff.

    Parameters
    ----------
    size
        Interior nodes in the logarithm of the spot price; odd numbers put one on the strike.
    strike
        Strike price K, currency; the unit of z.
    rate
        Riskless rate r ≥ 0, 1/year.
    volatility
        σ > 0, 1/√year.
    maturity
        T > 0, years.
    log_range
        The grid covers spot prices K e^±log_range.
    steps
        Number of steps that `maturity` is divided into; this scene is the first of them.

    Notes
    -----
    With x = log(S/K), time to maturity τ and 𝓐V = −½σ² V_xx − (r − ½σ²) V_x + r V the value solves
    V_τ + 𝓐V ≥ 0, V ≥ K(1 − eˣ)₊, complementary. One step: M = I + Δτ 𝓐ₕ, q = −V_old, lower = payoff, and
    the payoff on both ends of the grid folded into q. The drift is differenced centrally where that keeps the
    off-diagonal entries ≤ 0, which is h |r − ½σ²| ≤ σ², and upwind otherwise: M is always a strictly dominant
    M-matrix. The contact set is one interval of low prices.

    References
    ----------
    Brennan, Schwartz, *The valuation of American put options*, J. Finance 32, 1977, doi:10.2307/2326779.
    Jaillet, Lamberton, Lapeyre, *Variational inequalities and the pricing of American options*, Acta Appl.
    Math. 21, 1990, doi:10.1007/BF00047211.
    """
    return _put_scene(size, strike, rate, volatility, maturity / steps, log_range, steps=1)


@scene_builder
def american_put_march(
    *,
    size: Count = 1001,
    strike: Positive = 100.0,
    rate: NonNegative = 0.05,
    volatility: Positive = 0.2,
    maturity: Positive = 1.0,
    log_range: Positive = 1.5,
    steps: Count = 100,
) -> Scene:
    """American put, the whole march of implicit Euler steps from the payoff back to today.

    Parameters
    ----------
    size, strike, rate, volatility, maturity, log_range
        As in `american_put`.
    steps
        Number of equal steps in time; the solution of the last is today's price.

    Notes
    -----
    The matrix is the same in every step, only q changes: ``problem = problem.with_q(scene.advance(z))``.
    """
    return _put_scene(size, strike, rate, volatility, maturity / steps, log_range, steps)


@dataclass(frozen=True)
class NextStep:
    """From the values at the end of one step, the q of the next.

    A class and not a closure, so that scenes can be sent to other processes.

    Parameters
    ----------
    boundary : shape (n,)
        What the values on the ends of the grid add to q.
    """

    boundary: FloatVector

    def __call__(self, values: FloatVector) -> FloatVector:
        """Return q = boundary − values, shape (n,)."""
        return self.boundary - values


def _put_scene(
    size: int, strike: float, rate: float, volatility: float, time_step: float, log_range: float, steps: int
) -> Scene:
    log_price = nodes(-log_range, log_range, size)
    payoff = strike * np.maximum(1.0 - np.exp(log_price), 0.0)
    below, above = _log_price_legs(rate, volatility, time_step, 2.0 * log_range / (size + 1))
    centre = 1.0 + time_step * rate - below - above
    advance = NextStep(dirichlet_terms(payoff, [below], [above]))
    inside = payoff[1:-1]
    return Scene(
        problem=LCP(stencil_matrix((size,), centre, [below], [above]), advance(inside), lower=inside),
        is_symmetric=below == above,
        is_h_plus=True,
        grid=(size,),
        coordinates=(strike * np.exp(log_price[1:-1]),),
        axis_labels=("spot price",),
        unknown="option price",
        active_means="exercise at once",
        steps=steps,
        advance=advance if steps > 1 else None,
    )


def _log_price_legs(rate: float, volatility: float, time_step: float, h: float) -> tuple[float, float]:
    """Return the entries of Δτ 𝓐ₕ below and above the diagonal, neither of them positive."""
    diffusion = 0.5 * volatility**2 / h**2
    drift = (rate - 0.5 * volatility**2) / h
    below, above = 0.5 * drift - diffusion, -0.5 * drift - diffusion
    if max(below, above) > 0.0:
        below, above = min(drift, 0.0) - diffusion, min(-drift, 0.0) - diffusion
    return time_step * below, time_step * above
