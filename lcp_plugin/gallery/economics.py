"""Games, markets and options: Nash equilibria, prices that clear, the American put and the tree that checks it."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..core.checks import FloatVector
from ..core.lcp import LCP
from ..problems.reformulations.bimatrix_game import lcp_from_bimatrix_game
from .scene import Scene, require, scene_builder
from .stencil import dirichlet_terms, nodes, stencil_matrix

_CYCLE = np.array([[0, -1, 1], [1, 0, -1], [-1, 1, 0]])

# Payoffs of the row and of the column player; the equilibrium if there is only one.
_GAMES: dict[str, tuple[Any, Any, tuple[list[float], list[float]] | None]] = {
    "battle_of_the_sexes": ([[2, 0], [0, 1]], [[1, 0], [0, 2]], None),
    "prisoners_dilemma": ([[-1, -3], [0, -2]], [[-1, 0], [-3, -2]], ([0, 1], [0, 1])),
    "matching_pennies": ([[1, -1], [-1, 1]], [[-1, 1], [1, -1]], ([1, 1], [1, 1])),
    "chicken": ([[0, -1], [1, -9]], [[0, 1], [-1, -9]], None),
    "stag_hunt": ([[4, 1], [3, 2]], [[4, 3], [1, 2]], None),
    "rock_paper_scissors": (_CYCLE, -_CYCLE, ([1, 1, 1], [1, 1, 1])),
    "shapley": (np.eye(3), np.roll(np.eye(3), 1, axis=1), ([1, 1, 1], [1, 1, 1])),
    "indifferent": (np.ones((3, 4)), np.ones((3, 4)), None),
}


@scene_builder
def bimatrix_game(*, game: str = "battle_of_the_sexes") -> Scene:
    """Nash equilibria of a classical two-player game: M = [[0, K], [Lᵀ, 0]], zero diagonal, often several answers.

    Parameters
    ----------
    game
        Name of the game. Pure and mixed, unique and several equilibria; "indifferent" is degenerate everywhere.

    Notes
    -----
    ``scene.problem.origin.recover(result)`` gives the mixed strategies. `exact` is declared if the equilibrium is
    unique. In Shapley's game the players' best answers chase each other round a cycle.

    References
    ----------
    Luce, Raiffa, *Games and Decisions*, Wiley 1957. Lemke, Howson, *Equilibrium points of bimatrix games*, J. SIAM 12,
    1964, doi:10.1137/0112033.
    """
    require(game in _GAMES, f"game must be one of {', '.join(_GAMES)}, got {game!r}")
    row_payoffs, column_payoffs, unique = _GAMES[game]
    problem = lcp_from_bimatrix_game(row_payoffs, column_payoffs)
    M = problem.csr.toarray()
    exact = None if unique is None else _scaled(M, *unique)
    return Scene(problem=problem, exact=exact, is_symmetric=np.array_equal(M, M.T))


def _scaled(M: NDArray[np.float64], row: list[float], column: list[float]) -> FloatVector:
    """Return (x, y) with the smallest cost of either player scaled to 1."""
    m = len(row)
    x, y = np.array(row, dtype=np.float64), np.array(column, dtype=np.float64)
    answer: FloatVector = np.concatenate([x / np.min(M[m:, :m] @ x), y / np.min(M[:m, m:] @ y)])
    return answer


@scene_builder
def market_equilibrium(
    *,
    goods: int = 30,
    activities: int = 60,
    running: float = 0.5,
    seed: int = 0,
) -> Scene:
    """Market equilibrium with linear demand and constant returns: M = [[D, A], [−Aᵀ, 0]], planted integers.

    Parameters
    ----------
    goods
        Number of markets; the first unknowns are their prices.
    activities
        Number of activities; the last unknowns are their levels.
    running
        Share of the goods that a running activity of their own produces, in [0, 1], as far as there are activities.
    seed
        Seed of the generator that draws all data.

    Notes
    -----
    Prices p ≥ 0 against excess supply A y + D p − b ≥ 0, levels y ≥ 0 against losses c − Aᵀp ≥ 0. The symmetric part
    of D is diagonal and positive, so that the prices are unique. Running activities have positive prices and linearly
    independent columns, all others make strict losses, so that the levels are also unique. Some goods are free. M is
    positive semidefinite with a zero diagonal block, and demand is not integrable (D is not symmetric), so no
    quadratic program has this answer.

    References
    ----------
    Cottle, Pang, Stone, *The Linear Complementarity Problem*, SIAM 2009, doi:10.1137/1.9780898719000, §1.2.
    """
    require(0.0 <= running <= 1.0, f"running must lie in [0, 1], got {running}")
    generator = np.random.default_rng(seed)
    count = min(round(running * goods), activities)
    D = np.triu(generator.integers(-2, 3, (goods, goods)), 1).astype(np.float64)
    D = D - D.T + np.diag(generator.integers(1, 9, goods))
    A = generator.integers(-1, 4, (goods, activities)).astype(np.float64)
    A[:count, :count] = np.tril(A[:count, :count], -1) + np.eye(count)

    price = generator.integers(0, 10, goods).astype(np.float64)
    price[:count] += 1.0
    level = np.where(np.arange(activities) < count, generator.integers(1, 10, activities), 0.0)
    excess = np.where(price == 0.0, generator.integers(0, 5, goods), 0.0)
    loss = np.where(level == 0.0, generator.integers(1, 5, activities), 0.0)
    M = np.block([[D, A], [-A.T, np.zeros((activities, activities))]])
    exact = np.concatenate([price, level])
    problem = LCP(M, np.concatenate([excess, loss]) - M @ exact)
    is_diagonal = activities == 0 and not np.triu(D, 1).any()
    return Scene(problem=problem, exact=exact, is_symmetric=is_diagonal, is_h_plus=is_diagonal)


# --- Options ----------------------------------------------------------------------------------------------------


@scene_builder
def american_put(
    *,
    size: int = 1001,
    strike: float = 100.0,
    rate: float = 0.05,
    volatility: float = 0.2,
    maturity: float = 1.0,
    log_range: float = 1.5,
    steps: int = 100,
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
        Number of steps that `maturity` is divided into; this problem is the first of them.

    Notes
    -----
    With x = log(S/K), time to maturity τ and 𝓐V = −½σ² V_xx − (r − ½σ²) V_x + r V the value solves
    V_τ + 𝓐V ≥ 0, V ≥ K(1 − eˣ)₊, complementary. One step: M = I + Δτ 𝓐ₕ, q = −V_old, lower = payoff, and
    the payoff on both endpoints of the grid folded into q. The drift is differenced centrally if that keeps the
    off-diagonal entries ≤ 0, which is h |r − ½σ²| ≤ σ², and upwind otherwise: M is always a strictly dominant
    M-matrix. The contact set is one interval of low prices.

    References
    ----------
    Brennan, Schwartz, *The valuation of American put options*, J. Finance 32, 1977, doi:10.2307/2326779.
    Jaillet, Lamberton, Lapeyre, *Variational inequalities and the pricing of American options*, Acta Appl.
    Math. 21, 1990, doi:10.1007/BF00047211.
    """
    return replace(american_put_march(**locals()), steps=1, advance=None)


@scene_builder
def american_put_march(
    *,
    size: int = 1001,
    strike: float = 100.0,
    rate: float = 0.05,
    volatility: float = 0.2,
    maturity: float = 1.0,
    log_range: float = 1.5,
    steps: int = 100,
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
    values = {
        "strike": strike,
        "volatility": volatility,
        "maturity": maturity,
        "log_range": log_range,
    }
    for name, value in values.items():
        require(value > 0.0, f"{name} must be a number > 0, got {value}")
    time_step = maturity / steps
    log_price = nodes(-log_range, log_range, size)
    payoff = strike * np.maximum(1.0 - np.exp(log_price), 0.0)
    below, above = _log_price_legs(rate, volatility, time_step, 2.0 * log_range / (size + 1))
    M = stencil_matrix((size,), 1.0 + time_step * rate - below - above, [below], [above])
    # boundary − values, as a partial function that can be sent to other processes
    advance = partial(np.subtract, dirichlet_terms(payoff, [below], [above]))
    inside = payoff[1:-1]
    return Scene(
        problem=LCP(M, advance(inside), lower=inside),
        is_symmetric=below == above,
        is_h_plus=True,
        coordinates=(strike * np.exp(log_price[1:-1]),),
        axis_labels=("spot price",),
        unknown="option price",
        active_means="exercise at once",
        steps=steps,
        advance=advance,
    )


def _log_price_legs(
    rate: float, volatility: float, time_step: float, h: float
) -> tuple[float, float]:
    """Return the entries of Δτ 𝓐ₕ below and above the diagonal, neither of them positive."""
    diffusion = 0.5 * volatility**2 / h**2
    drift = (rate - 0.5 * volatility**2) / h
    below, above = 0.5 * drift - diffusion, -0.5 * drift - diffusion
    if max(below, above) > 0.0:
        below, above = min(drift, 0.0) - diffusion, min(-drift, 0.0) - diffusion
    return time_step * below, time_step * above


def binomial_put(
    spot: ArrayLike,
    *,
    strike: float,
    rate: float,
    volatility: float,
    maturity: float,
    steps: int = 1000,
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
        If volatility, maturity or steps is not positive, if steps is not an integer, or if the steps are so long that
        the tree's probabilities leave (0, 1).

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
    for name, value in (("volatility", volatility), ("maturity", maturity), ("steps", steps)):
        require(value > 0, f"binomial_put: {name} must be positive, got {value}")
    is_whole = isinstance(steps, (int, np.integer))
    require(is_whole, f"binomial_put: steps must be an integer ≥ 1, as 1000, got {steps!r}")
    time_step = maturity / steps
    up, growth = math.exp(volatility * math.sqrt(time_step)), math.exp(rate * time_step)
    probability = (growth - 1.0 / up) / (up - 1.0 / up)
    least = math.floor(maturity * (rate / volatility) ** 2) + 1
    words = f"steps must be at least {least} at this rate and volatility, got {steps}"
    require(0.0 < probability < 1.0, f"binomial_put: {words}")
    price = np.asarray(spot, dtype=np.float64)[..., None]
    exercise = np.maximum(strike - price * up ** np.arange(-steps, steps + 1), 0.0)
    values = exercise[..., ::2]
    for level in range(steps - 1, -1, -1):
        expected = (probability * values[..., 1:] + (1.0 - probability) * values[..., :-1]) / growth
        first = steps - level
        values = np.maximum(expected, exercise[..., first : first + 2 * level + 1 : 2])
    return values[..., 0]
