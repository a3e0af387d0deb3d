"""Two-player games: the answers are the Nash equilibria."""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from ...checks import FloatVector
from ...conversions.bimatrix_game import lcp_from_bimatrix_game
from .parameters import one_of
from .registry import scene_builder
from .scene import Scene

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
        active_share=None if exact is None else float(np.mean(exact == 0.0)),
    )


def _scaled(M: NDArray[np.float64], row: list[float], column: list[float]) -> FloatVector:
    """Return (x, y) with the smallest cost of either player scaled to 1."""
    m = len(row)
    x, y = np.array(row, dtype=np.float64), np.array(column, dtype=np.float64)
    answer: FloatVector = np.concatenate([x / np.min(M[m:, :m] @ x), y / np.min(M[:m, m:] @ y)])
    return answer
