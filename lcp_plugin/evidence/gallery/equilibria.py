"""Markets that clear: prices against excess supply, activities against losses."""

from __future__ import annotations

from typing import Annotated

import numpy as np

from ...problem.lcp import LCP
from .parameters import Count, Seed, Share, at_least
from .registry import scene_builder
from .scene import Scene


@scene_builder
def market_equilibrium(
    *, goods: Count = 30, activities: Annotated[int, at_least(0)] = 60, running: Share = 0.5, seed: Seed = 0
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
        Of the generator that draws everything.

    Notes
    -----
    Prices p ≥ 0 against excess supply A y + D p − b ≥ 0, levels y ≥ 0 against losses c − Aᵀp ≥ 0. The symmetric part
    of D is diagonal and positive, so that the prices are unique; running activities have positive prices and linearly
    independent columns, the others make strict losses, so that the levels are unique too. Some goods are free. M is
    positive semidefinite with a zero diagonal block, and demand is not integrable (D is not symmetric), so no
    quadratic program has this answer.

    References
    ----------
    Cottle, Pang, Stone, *The Linear Complementarity Problem*, SIAM 2009, doi:10.1137/1.9780898719000, §1.2.
    """
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
    return Scene(
        problem=LCP(M, np.concatenate([excess, loss]) - M @ exact),
        exact=exact,
        is_symmetric=activities == 0 and not np.triu(D, 1).any(),
        is_h_plus=activities == 0 and not np.triu(D, 1).any(),
        active_share=float(np.mean(exact == 0.0)),
    )
