"""Nonlinear complementarity problems of the literature, with their published starts and solutions, and a membrane."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import scipy.sparse as sp

from lcp_plugin import NonlinearProblem
from lcp_plugin.gallery.problems import five_point_matrix

Function = Callable[[np.ndarray], np.ndarray]


def kojima_shindo(x: np.ndarray, c_of_b: float = 10, d_of_c: float = 9, q: float = 9) -> np.ndarray:
    """M. Kojima, S. Shindo, J. Oper. Res. Soc. Japan 29 (1986) 352–374; solutions (√6/2, 0, 0, 1/2), (1, 0, 3, 0)."""
    a, b, c, d = x
    first = 3 * a * a + 2 * a * b + 2 * b * b + c + 3 * d - 6
    second = 2 * a * a + a + b * b + c_of_b * c + 2 * d - 2
    third = 3 * a * a + a * b + 2 * b * b + 2 * c + d_of_c * d - q
    return np.array([first, second, third, a * a + 3 * b * b + 2 * c + 3 * d - 3])


def josephy(x: np.ndarray) -> np.ndarray:
    """N. H. Josephy, MRC report 1965, Wisconsin 1979: Kojima and Shindo's but for three numbers; (√6/2, 0, 0, 1/2)."""
    return kojima_shindo(x, 3, 3, 1)


def mathiesen(x: np.ndarray) -> np.ndarray:
    """A Walrasian equilibrium, L. Mathiesen, Math. Program. 37 (1987) 1–18; every (λ, 0, 0, 0), 0 ≤ λ ≤ 3, solves."""
    a, b, c, d = x
    return np.array(
        [
            -b + c + d,
            a - (4.5 * c + 2.7 * d) / (b + 1),
            5 - a - (0.5 * c + 0.3 * d) / (c + 1),
            3 - a,
        ]
    )


def nash_cournot(cost: list[float], scale: float, beta: list[float], gamma: float) -> Function:
    """An oligopoly with the demand (5000/Q)^{1/γ} and the marginal costs cost + (x/scale)^{1/β}.

    F. H. Murphy, H. D. Sherali, A. L. Soyster, Math. Programming 24 (1982) 92–106; P. T. Harker, Management Science 30
    (1984) 105–111.
    """
    c, exponents = np.array(cost), 1.0 / np.array(beta)

    def F(x: np.ndarray) -> np.ndarray:
        total = x.sum()
        price = (5000.0 / total) ** (1.0 / gamma)
        return c + (x / scale) ** exponents - price + x * price / (gamma * total)

    return F


NASH_5 = nash_cournot([10, 8, 6, 4, 2], 5.0, [1.2, 1.1, 1.0, 0.9, 0.8], 1.1)
NASH_5_SOLUTION = [36.9325, 41.8181, 43.7066, 42.6592, 39.1790]
NASH_10 = nash_cournot(
    [5, 3, 8, 5, 1, 3, 7, 4, 6, 3], 0.1, [1.2, 1.0, 0.9, 0.6, 1.5, 1.0, 0.7, 1.1, 0.95, 0.75], 1.2
)
NASH_10_SOLUTION = [7.4415, 4.0978, 2.5906, 0.9354, 17.9490, 4.0978, 1.3047, 5.5901, 3.2222, 1.6771]


def billups(x: np.ndarray) -> np.ndarray:
    """S. C. Billups, PhD thesis, Wisconsin 1995: a line search from 0 meets a local minimum; solution 1 + √1.01."""
    return (x - 1.0) ** 2 - 1.01


def scarf() -> tuple[
    NonlinearProblem, np.ndarray, Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]
]:
    """Activity analysis, H. Scarf, T. Hansen, *The Computation of Economic Equilibria*, Yale 1973.

    Six prices, eight activities, five incomes, of which the first is the unit. Returns the problem, its start, and a
    function x → (prices, excess supply).
    """
    from general_equilibrium import ELASTICITY, OWNED, TECHNIQUE, WANTED

    elasticity, endowment, activity, demand = ELASTICITY, OWNED, TECHNIQUE, WANTED
    share = demand / demand.sum(axis=0)

    def excess_supply(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        p, y, income = x[:6], x[6:14], x[14:]
        index = (share * p[:, None] ** (1 - elasticity)).sum(axis=0)
        demanded = (income / index * share * p[:, None] ** -elasticity).sum(axis=1)
        return p, activity @ y + endowment.sum(axis=1) - demanded

    def F(x: np.ndarray) -> np.ndarray:
        p, income = x[:6], x[14:]
        return np.concatenate([excess_supply(x)[1], -activity.T @ p, income - endowment.T @ p])

    start = np.concatenate([np.ones(6), np.ones(8), endowment.sum(axis=0)])
    lower, upper = np.zeros(19), np.full(19, np.inf)
    lower[:6] = np.where(share.max(axis=1) > 0.0, 1e-5, 0.0)
    lower[14] = upper[14] = start[14]
    return NonlinearProblem(F, lower=lower, upper=upper), start, excess_supply


def membrane(size: int) -> tuple[NonlinearProblem, Any]:
    """−Δu + 5 eᵘ + 10 u³ ≥ f on the unit square, u ≥ a paraboloid, five points; n = size²."""
    h, A = 1.0 / (size + 1), five_point_matrix(size, 4.0)
    x, y = np.meshgrid(*2 * (np.linspace(h, 1.0 - h, size),))
    obstacle = (0.3 - 2.0 * ((x - 0.5) ** 2 + (y - 0.5) ** 2)).ravel()
    force = (10.0 * np.sin(2 * np.pi * x)).ravel()

    def F(u: np.ndarray) -> np.ndarray:
        return A @ u + h * h * (5.0 * np.exp(u) + 10.0 * u**3 - force)

    def jacobian(u: np.ndarray) -> Any:
        return A + sp.diags_array(h * h * (5.0 * np.exp(u) + 30.0 * u**2))

    return NonlinearProblem(F, jacobian, lower=obstacle), A


def bratu(size: int, strength: float, ceiling: float) -> NonlinearProblem:
    """Bratu's problem −Δu = λ eᵘ under a ceiling: −Δu ≤ λ eᵘ where u reaches it; λ beyond the turning point 6.8 too."""
    _, A = membrane(size)
    h2 = 1.0 / (size + 1) ** 2
    return NonlinearProblem(
        lambda u: A @ u - strength * h2 * np.exp(u),
        lambda u: A - sp.diags_array(strength * h2 * np.exp(u)),
        lower=-np.inf,
        upper=np.full(size * size, ceiling),
    )


def minimal_surface(size: int) -> NonlinearProblem:
    """∫ √(1 + |∇u|²) on a square, linear triangles, u = 1 − (2x − 1)² on its edge, u ≥ 1 in the middle square.

    The obstacle of E. D. Dolan, J. J. Moré, T. S. Munson, *Benchmarking optimization software with COPS 3.0*, 2004.
    """
    h, nodes = 1.0 / (size + 1), size + 2
    grid = np.linspace(0.0, 1.0, nodes)
    first, second = np.meshgrid(grid, grid, indexing="ij")
    inside = np.zeros((nodes, nodes), dtype=bool)
    inside[1:-1, 1:-1] = True
    number = np.arange(nodes * nodes).reshape(nodes, nodes)
    corners = number[:-1, :-1], number[1:, :-1], number[:-1, 1:], number[1:, 1:]
    triangles = np.concatenate(
        [
            np.stack([corner.ravel() for corner in (corners[i] for i in of)], 1)
            for of in ((0, 1, 2), (3, 2, 1))
        ]
    )
    slopes = np.array([[-1.0, -1.0], [1.0, 0.0], [0.0, 1.0]]) / h
    signs = np.repeat([1.0, -1.0], len(triangles) // 2)
    at = inside.ravel()

    def surface(u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        full = (1.0 - (2.0 * first - 1.0) ** 2).ravel()
        full[at] = u
        gradient = signs[:, None] * (full[triangles] @ slopes)
        return gradient, 1.0 / np.sqrt(1.0 + (gradient**2).sum(1))

    def F(u: np.ndarray) -> np.ndarray:
        gradient, weight = surface(u)
        found = np.zeros(nodes * nodes)
        np.add.at(found, triangles, h * h / 2 * (signs * weight)[:, None] * (gradient @ slopes.T))
        return found[at]

    def jacobian(u: np.ndarray) -> sp.csr_array:
        gradient, weight = surface(u)
        along = signs[:, None] * (gradient @ slopes.T)
        blocks = weight[:, None, None] * (slopes @ slopes.T)
        blocks = blocks - (weight**3)[:, None, None] * along[:, :, None] * along[:, None, :]
        rows, columns = np.repeat(triangles, 3, axis=1).ravel(), np.tile(triangles, (1, 3)).ravel()
        M = sp.csr_array((h * h / 2 * blocks.ravel(), (rows, columns)), shape=(nodes * nodes,) * 2)
        return sp.csr_array(M[at][:, at])

    middle = (np.abs(first - 0.5) < 0.25) & (np.abs(second - 0.5) < 0.25)
    return NonlinearProblem(F, jacobian, np.where(middle, 1.0, -np.inf).ravel()[at])
