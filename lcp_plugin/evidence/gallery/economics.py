"""Games and markets: the answers are Nash equilibria, or prices that clear."""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from ...checks import FloatVector
from ...conversions.bimatrix_game import lcp_from_bimatrix_game
from ...problem.lcp import LCP
from .parameters import Count, Seed, Share, at_least, one_of
from .scene import Scene, scene_builder

_CYCLE = np.array([[0, -1, 1], [1, 0, -1], [-1, 1, 0]])

# Payoffs of the row and of the column player; the equilibrium where there is only one.
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
def bimatrix_game(*, game: Annotated[str, one_of(*_GAMES)] = "battle_of_the_sexes") -> Scene:
    """Nash equilibria of a classical two-player game: M = [[0, K], [Lᵀ, 0]], zero diagonal, often several answers.

    Parameters
    ----------
    game
        Which one. Pure and mixed, unique and several equilibria; "indifferent" is degenerate through and through.

    Notes
    -----
    ``scene.problem.origin.recover(result)`` gives the mixed strategies. `exact` is declared where the equilibrium is
    unique. In Shapley's game the players' best answers chase each other round a cycle.

    References
    ----------
    Luce, Raiffa, *Games and Decisions*, Wiley 1957. Lemke, Howson, *Equilibrium points of bimatrix games*, J. SIAM 12,
    1964, doi:10.1137/0112033.
    """
    row_payoffs, column_payoffs, unique = _GAMES[game]
    problem = lcp_from_bimatrix_game(row_payoffs, column_payoffs)
    exact = None if unique is None else _scaled(problem.csr.toarray(), *unique)
    return Scene(
        problem=problem,
        exact=exact,
        is_symmetric=bool(np.array_equal(problem.csr.toarray(), problem.csr.toarray().T)),
    )


def _scaled(M: NDArray[np.float64], row: list[float], column: list[float]) -> FloatVector:
    """Return (x, y) with the smallest cost of either player scaled to 1."""
    m = len(row)
    x, y = np.array(row, dtype=np.float64), np.array(column, dtype=np.float64)
    answer: FloatVector = np.concatenate([x / np.min(M[m:, :m] @ x), y / np.min(M[:m, m:] @ y)])
    return answer


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
    )
