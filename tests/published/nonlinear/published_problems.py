"""Nonlinear complementarity problems of the literature: F, bounds, starts, and derivatives by complex steps."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from inputs import nonlinear_models as models

from lcp_plugin import NonlinearProblem

INF = np.inf
TINY = 1e-200  # a complex step: no difference is formed


@dataclass
class Published:
    """A problem with its source and its starts; `F` takes complex numbers unless a derivative is given."""

    F: Callable[..., Any]
    lower: Any
    upper: Any
    starts: Sequence[Any]
    source: str
    jacobian: Callable[..., Any] | None = None
    is_solvable: bool = True

    @property
    def problem(self) -> NonlinearProblem:
        n = len(self.starts[0])
        lower, upper = (np.broadcast_to(one, n).astype(float) for one in (self.lower, self.upper))
        return NonlinearProblem(self.F, self.jacobian or self.by_complex_steps, lower, upper)

    def by_complex_steps(self, x: np.ndarray) -> np.ndarray:
        columns = [np.imag(self.F(x + 1j * TINY * e)) for e in np.eye(x.size)]
        return np.array(columns).T / TINY


def outsiders_residual(problem: NonlinearProblem, x: np.ndarray) -> float:
    """How far x or F must move, relative to 1 + |x| and to the terms |F′||x| + |F − F′x|, the worst row."""
    with np.errstate(all="ignore"):
        F, M = problem.value(x), problem.derivative(x)
        terms = np.maximum(abs(M) @ np.abs(x) + np.abs(F - M @ x), 1e-300)
    unit, lower, upper = 1.0 + np.abs(x), problem.lower, problem.upper
    below = np.where(lower > -INF, np.maximum(np.abs(x - lower) / unit, -F / terms), INF)
    above = np.where(upper < INF, np.maximum(np.abs(x - upper) / unit, F / terms), INF)
    outside = np.maximum(np.maximum(lower - x, x - upper), 0.0) / unit
    inside = np.maximum(np.abs(F) / terms, outside)
    fixed = np.where(lower == upper, np.abs(x - lower), INF)
    return float(np.minimum(np.minimum(below, above), np.minimum(inside, fixed)).max())


def economy(share: float, second: float, third: float) -> Callable[..., Any]:
    """Mathiesen's consumer with Cobb–Douglas demand, an activity y, prices p."""

    def F(x: Any) -> Any:
        y, p = x[0], x[1:]
        income = second * p[1] + third * p[2]
        rows = [p[1] + p[2] - p[0], y - share * income / p[0]]
        return np.array([*rows, second - y - (1 - share) * income / p[1], third - y])

    return F


def watson(x: Any) -> Any:
    d = x - np.arange(-1.0, 4.0)
    return 2 * np.exp(np.sum(d * d)) * d


FUKUSHIMA = np.array([
    [0.726, -0.949, 0.266, -1.193, -0.504],
    [1.645, 0.678, 0.333, -0.217, -1.443],
    [-1.016, -0.225, 0.769, 0.934, 1.007],
    [1.063, 0.587, -1.144, 0.550, -0.548],
    [-0.259, 1.453, -1.073, 0.509, 1.026],
])  # fmt: skip


def fukushima(weight: float) -> Callable[..., Any]:
    q = np.array([5.308, 0.008, -0.938, 1.024, -1.312])

    def F(z: Any) -> Any:
        x, price = z[:5], z[5]
        return np.append(FUKUSHIMA @ x + weight * np.arctan(x - 2) + q - price, np.sum(x) - 10)

    return F


def shapley_shubik(p: Any) -> Any:
    r = 2 ** (8 / 9) - 2 ** (1 / 9)
    return -(p ** (-1 / 9) - p ** (-8 / 9) + r * (1 / p - 1))


def kehoe(z: Any) -> Any:
    shares = [[0.52, 0.86, 0.5, 0.06], [0.4, 0.1, 0.2, 0.25], [0.04, 0.02, 0.2975, 0.0025]]
    shares = np.array([*shares, [0.04, 0.02, 0.0025, 0.6875]])
    own, a = np.array([50, 50, 400, 400]), np.array([[6, -1], [-1, 3], [-4, -1], [-1, -1]])
    p, y = z[:4], z[4:]
    return np.concatenate([own + a @ y - shares @ (p * own) / p, -(a.T @ p)])


def lubrication(count: int, viscosity: float, load: float) -> Published:
    """Kostreva's elastohydrodynamic line contact: pressures p ≥ 0 on [−3, 2], the film's offset k is free."""
    dx, nodes = 5.0 / count, np.arange(count + 1)
    weight = np.where((nodes == 0) | (nodes == count), 0.5, 1.0)
    distance = (nodes[None, :] - nodes[:, None] - 0.5) * dx
    kernel = weight * distance * np.log(np.abs(distance)) / np.pi
    P = np.zeros((count + 1, count))
    P += kernel[:, :count]
    P[:, : count - 1] -= kernel[:, 2:]
    rest = (-3.0 + (nodes + 0.5) * dx) ** 2 + 1

    def F(z: Any) -> Any:
        k, p = z[0], z[1:]
        h = rest + k + P @ p
        after, before = np.append(p[1:], 0.0), np.append(0.0, p[:-1])
        out = h[1:] ** 3 * (after - p) / np.exp(viscosity * 0.5 * (after + p))
        into = h[:-1] ** 3 * (p - before) / np.exp(viscosity * 0.5 * (p + before))
        rows = load / dx * (h[1:] - h[:-1]) - (out - into) / dx**2
        return np.append(1 - dx * 2 / np.pi * np.sum(p * weight[1:]), rows)

    p = np.maximum(0.0, 1.0 - np.abs((-2.0 + np.arange(1, count + 1) * dx) / 2))
    source = "M. M. Kostreva 1984, elastohydrodynamic lubrication"
    return Published(F, np.append(-INF, np.zeros(count)), INF, [np.append(1.6, p)], source)


def stationary_points(z: Any) -> Any:
    """The conditions of Hock and Schittkowski's problem 78: min Π x_i under three equations."""
    x, a, b, c = z[:5], z[5], z[6], z[7]
    slopes = np.array([np.prod(np.delete(x, i)) for i in range(5)]) - 2 * a * x
    slopes = slopes - b * np.array([0, x[2], x[1], -5 * x[4], -5 * x[3]])
    slopes = slopes - 3 * c * np.array([x[0] ** 2, x[1] ** 2, 0, 0, 0])
    rows = [np.sum(x * x) - 10, x[1] * x[2] - 5 * x[3] * x[4], x[0] ** 3 + x[1] ** 3 + 1]
    return np.concatenate([slopes, rows])


def rational_agents(count: int, seed: int) -> Published:
    """Harker and Pang's test matrix with arctangents, as Taji, Fukushima and Ibaraki use it."""
    rng = np.random.default_rng(seed)
    A, B = rng.uniform(-5, 5, (2, count, count))
    M, a = (A.T @ A + (B - B.T)) / count, 100 * rng.uniform(0, 1, count)
    q = rng.uniform(-500, 500, count) / np.sqrt(count)
    starts = [np.zeros(count), np.ones(count)]
    return Published(lambda x: M @ x + a * np.arctan(x) + q, 0.0, INF, starts, "Harker, Pang 1990")


def mixed_strategies(players: int, actions: int, seed: int) -> Published:
    """A game with random payoffs: shares x ≥ 0 of the actions, values v."""
    rng, n = np.random.default_rng(seed), players * actions
    payoffs = [np.round(rng.uniform(0, 10, (actions,) * players), 2) for _ in range(players)]

    def F(z: Any) -> Any:
        x, rows = z[:n].reshape(players, actions), []
        for p, payoff in enumerate(payoffs):
            gains = np.moveaxis(payoff, p, 0)
            for share in np.delete(x, p, axis=0)[::-1]:
                gains = gains @ share
            rows.append(z[n + p] - gains)
        return np.concatenate([*rows, x.sum(1) - 1])

    start = np.append(np.full(n, 1 / actions), np.full(players, 5.0))
    lower = np.append(np.zeros(n), np.full(players, -INF))
    return Published(
        F, lower, INF, [start, np.zeros(n + players)], "mixed strategies, MCPLIB games"
    )


def on_a_grid(problem: NonlinearProblem, starts: Sequence[Any], source: str) -> Published:
    return Published(problem.F, problem.lower, problem.upper, starts, source, problem.jacobian)


KOJIMA = [
    [0, 0, 0, 0],
    [1, 1, 1, 1],
    [100] * 4,
    [1, 0, 1, 0],
    [1, 0, 0, 0],
    [0, 1, 1, 0],
    [0, 1, 0, 1],
]
PRICES = [[1, 1, 1, 1], [0.5] * 4, [1, 0.1, 0.1, 0.1], [2, 5, 1, 1]]
NO_SOLUTION = "no x ≥ 0 solves it"
PUBLISHED: dict[str, Published] = {
    "kojima_shindo": Published(models.kojima_shindo, 0, INF, KOJIMA, "Kojima, Shindo 1986"),
    "josephy": Published(models.josephy, 0, INF, KOJIMA, "Josephy 1979"),
    "billups": Published(models.billups, 0, INF, [[0.0], [0.01], [1.0]], "Billups 1995"),
    "mathiesen": Published(models.mathiesen, 0, INF, [[0.0] * 4, [1.0] * 4], "Mathiesen 1987"),
    "economy": Published(economy(0.75, 1.0, 0.5), 0, INF, PRICES, "Mathiesen 1987"),
    "economy_2": Published(economy(0.75, 1.0, 2.0), 0, INF, PRICES, "Mathiesen 1987"),
    "economy_3": Published(economy(0.9, 5.0, 3.0), 0, INF, PRICES, "Mathiesen 1987"),
    "oligopoly_5": Published(
        models.NASH_5, 0, INF, [[1.0] * 5, [10.0] * 5, [50.0] * 5], "Murphy, Sherali, Soyster 1982"
    ),
    "oligopoly_10": Published(models.NASH_10, 0, INF, [[1.0] * 10, [10.0] * 10], "Harker 1984"),
    "watson": Published(watson, 0, INF, [[0] * 5, [1] * 5, [3] * 5], "Watson 1979, no. 3"),
    "fukushima_10": Published(
        fukushima(10.0),
        0,
        INF,
        [[25, 0, 0, 0, 0, 0], [10, 0, 10, 0, 10, 0], [0] * 6],
        "Fukushima 1992",
    ),
    "fukushima_20": Published(
        fukushima(20.0),
        0,
        INF,
        [[25, 0, 0, 0, 0, 0], [10, 0, 10, 0, 10, 0], [0] * 6],
        "Fukushima 1992",
    ),
    "shapley_shubik": Published(
        shapley_shubik, 0, INF, [[1.5], [0.1], [5.0]], "Shapley, Shubik 1977"
    ),
    "kehoe": Published(
        kehoe,
        [1e-6, 1e-6, 1e-6, 1, 0, 0],
        [INF, INF, INF, 1, INF, INF],
        [
            [1, 1, 1, 1, 10, 10],
            [6, 1.5, 1, 1, 40, 70],
            [0.1, 0.1, 0.1, 1, 0, 0],
            [10, 10, 10, 1, 0, 0],
        ],
        "Kehoe 1985",
    ),
    "lubrication_40": lubrication(40, 2.832, 6.057),
    "lubrication_100": lubrication(100, 2.832, 6.057),
    "hs78": Published(
        stationary_points,
        -INF,
        INF,
        [
            [-2, 1.5, 2, -1, -1, 0, 0, 0],
            [-2, 1.5, 2, -1, -1, 1, 1, 1],
            [-1, 1.5, 2, -1, -2, 1, 1, 1],
        ],
        "Hock, Schittkowski 1981, no. 78",
    ),
    "harker_pang_20": rational_agents(20, 1),
    "harker_pang_100": rational_agents(100, 2),
    "game_3x3": mixed_strategies(3, 3, 1),
    "game_3x5": mixed_strategies(3, 5, 2),
    "game_4x4": mixed_strategies(4, 4, 3),
    "game_5x3": mixed_strategies(5, 3, 4),
    "bratu_20": on_a_grid(
        models.bratu(20, 6.7, 1.0), [np.zeros(400), np.ones(400)], "Bratu, MCPLIB"
    ),
    "bratu_70": on_a_grid(models.bratu(70, 6.8, 4.0), [np.zeros(4900)], "Bratu, MCPLIB"),
    "minimal_surface_10": on_a_grid(models.minimal_surface(10), [np.full(100, 0.5)], "COPS 3.0"),
    "minimal_surface_30": on_a_grid(models.minimal_surface(30), [np.full(900, 0.5)], "COPS 3.0"),
    "none_exp": Published(lambda x: -np.exp(-x), 0, INF, [[0.0], [5.0]], NO_SOLUTION, None, False),
    "none_pole": Published(
        lambda x: -1 / (1 + x), 0, INF, [[0.0], [5.0]], NO_SOLUTION, None, False
    ),
    "none_atan": Published(
        lambda x: np.arctan(x) - 2, 0, INF, [[0.0], [5.0]], NO_SOLUTION, None, False
    ),
    "none_pit": Published(
        lambda x: x * x + 1e-4, -INF, INF, [[1.0], [-3.0]], NO_SOLUTION, None, False
    ),
    "none_two": Published(
        lambda x: np.array([x[0] * x[1] - 1, -x[0]]),
        0,
        INF,
        [[1.0, 1.0], [0.0, 0.0]],
        NO_SOLUTION,
        None,
        False,
    ),
}
