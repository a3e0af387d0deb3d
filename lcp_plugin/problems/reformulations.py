"""Nash equilibria of two-player games as linear complementarity problems.

Bimatrix games as linear complementarity problems, and back.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..core.checks import Vector, checked_answer, rectangular_matrix
from ..core.errors import InvalidProblem, NotConverged
from ..core.lcp import LCP

FloatMatrix = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Equilibrium:
    """Mixed strategies of both players, and how far they are from an equilibrium.

    Attributes
    ----------
    A, B : ndarray, shape (m, k)
        Payoffs of the row and of the column player.
    row_strategy : ndarray, shape (m,)
        Probabilities of the row player's actions.
    column_strategy : ndarray, shape (k,)
        Probabilities of the column player's actions.
    """

    A: FloatMatrix = field(repr=False)
    B: FloatMatrix = field(repr=False)
    row_strategy: Vector
    column_strategy: Vector

    @cached_property
    def payoffs(self) -> tuple[float, float]:
        """Expected payoff of the row and of the column player, xᵀA y and xᵀB y."""
        x, y = self.row_strategy, self.column_strategy
        return float(x @ self.A @ y), float(x @ self.B @ y)

    @cached_property
    def regret(self) -> float:
        """The most that a player gains by a change of mind, in the unit of the payoffs; 0 in an equilibrium."""
        x, y = self.row_strategy, self.column_strategy
        row, column = self.payoffs
        return float(max(np.max(self.A @ y) - row, np.max(self.B.T @ x) - column, 0.0))


@dataclass(frozen=True, eq=False)
class GameOrigin:
    """Origin of a converted game: payoffs A of the row player and B of the column player, shape (m, k)."""

    A: FloatMatrix
    B: FloatMatrix

    def recover(self, answer: Any) -> Equilibrium:
        """Return the mixed strategies that an answer of the complementarity problem stands for.

        Parameters
        ----------
        answer : Result or array, shape (m + k,)
            Its two parts, negative numbers dropped, are scaled to sum 1.

        Raises
        ------
        NotConverged
            If a part has no positive entry: then z is not a solution, and the part is not a strategy.
        InvalidProblem
            If it is not a finite vector of that length.
        """
        m, k = self.A.shape
        parts = np.split(np.maximum(checked_answer(answer, m + k), 0.0), [m])
        for part, player in zip(parts, ("row", "column"), strict=True):
            if not part.any():
                raise NotConverged(f"the {player} player has no action in z; solve the problem")
        x, y = (part / part.max() for part in parts)  # a sum of huge numbers would overflow
        return Equilibrium(self.A, self.B, x / x.sum(), y / y.sum())


def lcp_from_bimatrix_game(A: Any, B: Any = None) -> LCP:
    """Return the complementarity problem whose solutions are the Nash equilibria of a two-player game.

    With costs K_ij = s_j − a_ij > 0 and L_ij = t_i − b_ij > 0 in the place of payoffs, in units that are powers of two:
    z = (x, y) ≥ 0, M = [[0, K], [Lᵀ, 0]], q = −1. For integer payoffs costs and ties are exact.

    Parameters
    ----------
    A, B : array, shape (m, k)
        Payoffs of the row and the column player for row i and column j, each in any unit; both maximize. Or, in place
        of A, a ``NormalFormGame`` of QuantEcon with two players.

    Returns
    -------
    LCP
        Its ``origin.recover(result)`` gives an :class:`Equilibrium`. Not monotone in general, and with zeros on its
        diagonal: a problem for pivoting (Lemke–Howson), not for relaxation.

    Raises
    ------
    InvalidProblem
        If A and B are not real, finite matrices of the same shape with at least one row and column, or the game does
        not have two players.

    References
    ----------
    C. E. Lemke, J. T. Howson, *Equilibrium points of bimatrix games*, J. SIAM 12 (1964), doi:10.1137/0112033.

    Examples
    --------
    Matching pennies, where both toss a coin:

    >>> problem = lcp_from_bimatrix_game([[1, -1], [-1, 1]], [[-1, 1], [1, -1]])
    >>> equilibrium = problem.origin.recover([0.25, 0.25, 0.25, 0.25])
    >>> equilibrium.row_strategy, equilibrium.payoffs, equilibrium.regret
    (array([0.5, 0.5]), (0.0, 0.0), 0.0)
    """
    if hasattr(A, "players"):
        A, B = _payoffs_of(A, B)
    elif B is None:
        given = type(A).__name__
        raise InvalidProblem(f"B is missing: a game is A and B, or has players, got {given} alone")
    row_payoffs = _dense(rectangular_matrix(A, "A", None, None))
    m, k = row_payoffs.shape
    if not m or not k:
        raise InvalidProblem(f"A must have a row and a column, got shape {row_payoffs.shape}")
    column_payoffs = _dense(rectangular_matrix(B, "B", m, k))
    M = np.zeros((m + k, m + k))
    M[:m, m:] = _costs(row_payoffs, own=0)
    M[m:, :m] = _costs(column_payoffs, own=1).T
    return LCP(M, np.full(m + k, -1.0)).with_origin(GameOrigin(row_payoffs, column_payoffs))


def _payoffs_of(game: Any, B: Any) -> tuple[Any, Any]:
    """Return (A, B) of a game whose players have each a `payoff_array`, the own action first."""
    if B is not None:
        raise InvalidProblem(f"{type(game).__name__} has the payoffs of both players; leave B out")
    if len(game.players) != 2:
        raise InvalidProblem(f"a bimatrix game has two players, got a game of {len(game.players)}")
    row, column = (np.asarray(player.payoff_array) for player in game.players)
    return row, column.T


def _costs(payoffs: FloatMatrix, own: int) -> FloatMatrix:
    """Return positive costs, at least 1: the loss of each action relative to the best reply, `own` the axis of actions.

    Terms that the other player's action adds to all costs have no influence, so the best reply to each costs one unit.
    The unit is a power of two, small enough to keep the digits of every difference next to one huge payoff: integer
    payoffs are exact.
    """
    # differences do not overflow
    payoffs = np.ldexp(payoffs, -int(np.frexp(np.abs(payoffs).max())[1]))
    missed = payoffs.max(axis=own, keepdims=True) - payoffs
    if not missed.any():
        return np.ones_like(payoffs)
    ends = missed[missed > 0.0].min(), missed.max()
    least, most = (2.0 ** (math.frexp(size)[1] - 1) for size in ends)
    # Costs do not overflow
    unit = max(min(most, 2.0**3 * least), 2.0**-900)  # no difference is lost
    return 1.0 + missed / unit


def _dense(matrix: Any) -> FloatMatrix:
    return matrix if isinstance(matrix, np.ndarray) else np.asarray(matrix.toarray())
