"""Nash equilibria of bimatrix and polymatrix games as linear complementarity problems."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from ..core.checks import AnyMatrix, FloatMatrix, Vector, checked_answer, rectangular_matrix
from ..core.errors import InvalidProblem, NotConverged
from ..core.lcp import LCP
from .programs.program_matrices import as_array

Game = Mapping[tuple[int, int], FloatMatrix]  # payoffs of player i by the actions of i and j


@dataclass(frozen=True, eq=False)
class Equilibrium:
    """Mixed strategies of all players, and how far they are from an equilibrium.

    Attributes
    ----------
    game : dict
        Payoffs of player i against player j by the pair (i, j), shape (actions of i, actions of j).
    strategies : tuple of ndarray
        Probabilities of the actions of each player, shape (actions,).
    """

    game: Game = field(repr=False)
    strategies: tuple[Vector, ...]

    @property
    def A(self) -> FloatMatrix:
        """Payoffs of the row player of two, shape (m, k)."""
        return self.game[0, 1]

    @property
    def B(self) -> FloatMatrix:
        """Payoffs of the column player of two, shape (m, k)."""
        return self.game[1, 0].T

    @property
    def row_strategy(self) -> Vector:
        """Probabilities of the first player's actions."""
        return self.strategies[0]

    @property
    def column_strategy(self) -> Vector:
        """Probabilities of the second player's actions."""
        return self.strategies[1]

    @cached_property
    def _by_action(self) -> list[Vector]:
        """The expected payoff of each action of each player."""
        sums = [np.zeros(x.size) for x in self.strategies]
        for (i, j), payoffs in self.game.items():
            sums[i] = sums[i] + payoffs @ self.strategies[j]
        return sums

    @cached_property
    def payoffs(self) -> tuple[float, ...]:
        """Expected payoff of each player, xᵀA y and xᵀB y of two."""
        pairs = zip(self.strategies, self._by_action, strict=True)
        return tuple(float(x @ by_action) for x, by_action in pairs)

    @cached_property
    def regret(self) -> float:
        """The most that a player gains by a change of mind, in the unit of the payoffs; 0 in an equilibrium."""
        pairs = zip(self._by_action, self.payoffs, strict=True)
        return max(0.0, *(float(by_action.max() - payoff) for by_action, payoff in pairs))


@dataclass(frozen=True, eq=False)
class GameOrigin:
    """Origin of a converted game: payoffs of each player against each other player, as of :class:`Equilibrium`."""

    game: Game
    sizes: tuple[int, ...]

    def recover(self, answer: object) -> Equilibrium:
        """Return the mixed strategies that an answer of the complementarity problem stands for.

        Parameters
        ----------
        answer : Result or array
            The parts of the players' actions, negative numbers dropped, are scaled to sum 1.

        Raises
        ------
        NotConverged
            If a part has no positive entry: then z is not a solution, and the part is not a strategy.
        InvalidProblem
            If it is not a finite vector of the length of the problem.
        """
        ends = np.cumsum(self.sizes)
        values = 0 if len(ends) == 2 else len(ends)  # of the players, behind their actions
        *parts, _ = np.split(np.maximum(checked_answer(answer, ends[-1] + values), 0.0), ends)
        for k, part in enumerate(parts):
            if not part.any():
                player = f"the {('row', 'column')[k]} player" if not values else f"player {k}"
                raise NotConverged(f"{player} has no action in z; solve the problem")
        parts = [part / part.max() for part in parts]  # a sum of huge numbers would overflow
        return Equilibrium(self.game, tuple(part / part.sum() for part in parts))


def lcp_from_bimatrix_game(A: AnyMatrix, B: AnyMatrix = None) -> LCP:
    """Return the complementarity problem whose solutions are the Nash equilibria of a game.

    For two players, with costs K_ij = s_j − a_ij > 0 and L_ij = t_i − b_ij > 0 in the place of payoffs, in units that
    are powers of two: z = (x, y) ≥ 0, M = [[0, K], [Lᵀ, 0]], q = −1. For integer payoffs costs and ties are exact.

    Parameters
    ----------
    A, B : array, shape (m, k)
        Payoffs of the row and the column player for row i and column j, each in any unit; both maximize. Or, in place
        of A, a ``NormalFormGame`` of QuantEcon with two players. For more players, a polymatrix game: a dict, or a
        ``PolymatrixGame`` of QuantEcon. Its entry (i, j) has the payoffs of player i = 0, 1, … against player j, shape
        (actions of i, actions of j); the payoffs against several players add up, and a missing pair has none.

    Returns
    -------
    LCP
        Its ``origin.recover(result)`` gives an :class:`Equilibrium`. Not monotone in general, and with zeros on its
        diagonal: a problem for pivoting (Lemke–Howson), not for relaxation. For more than two players the value of each
        player is an unknown behind the actions, and M is copositive-plus: Lemke's path ends in an equilibrium.

    Raises
    ------
    InvalidProblem
        If A and B are not real, finite matrices of the same shape with at least one row and column, a
        ``NormalFormGame`` does not have two players, or the pairs of a dict do not fit together.

    References
    ----------
    C. E. Lemke, J. T. Howson, *Equilibrium points of bimatrix games*, J. SIAM 12 (1964), doi:10.1137/0112033. J. T.
    Howson, *Equilibria of polymatrix games*, Management Science 18 (1972), doi:10.1287/mnsc.18.5.312. D. A. Miller, S.
    W. Zucker, *Copositive-plus Lemke algorithm solves polymatrix games*, Oper. Res. Lett. 10 (1991),
    doi:10.1016/0167-6377(91)90015-H.

    Examples
    --------
    Matching pennies, where both toss a coin:

    >>> problem = lcp_from_bimatrix_game([[1, -1], [-1, 1]], [[-1, 1], [1, -1]])
    >>> equilibrium = problem.origin.recover([0.25, 0.25, 0.25, 0.25])
    >>> equilibrium.row_strategy, equilibrium.payoffs, equilibrium.regret
    (array([0.5, 0.5]), (0.0, 0.0), 0.0)
    """
    if isinstance(game := getattr(A, "polymatrix", A), Mapping) and B is None:
        return _lcp_from_pairs(game)
    if hasattr(A, "players"):
        A, B = _payoffs_of(A, B)
    elif B is None:
        got = type(A).__name__
        raise InvalidProblem(
            f"B is missing: a game is A and B, or has players, or is {{(0, 1): …, (1, 0): …}}, got {got} alone"
        )
    row_payoffs = as_array(rectangular_matrix(A, "A", None, None))
    m, k = row_payoffs.shape
    if not m or not k:
        raise InvalidProblem(
            f"A must have at least one row and one column, got shape {row_payoffs.shape}"
        )
    column_payoffs = as_array(rectangular_matrix(B, "B", m, k))
    M = np.zeros((m + k, m + k))
    M[:m, m:] = _costs(row_payoffs, axis=0)
    M[m:, :m] = _costs(column_payoffs, axis=1).T
    origin = GameOrigin({(0, 1): row_payoffs, (1, 0): column_payoffs.T}, (m, k))
    return LCP(M, np.full(m + k, -1.0)).with_origin(origin)


def _lcp_from_pairs(pairs: Mapping[Any, Any]) -> LCP:
    """Return the problem of a polymatrix game: actions x_i ≥ 0 and values v_i ≥ 0 of the costs of each player i.

    M = [[C, −S], [Sᵀ, 0]] and q = (t, −s), S the sums over the actions of each player, times s. Costs are at least 1,
    and t is taken from the diagonal block of C, where it changes nothing because the x of a player sum to 1. So C is
    positive; t and s, different dyadic numbers, only break ties of pivots.
    """
    game, sizes = {}, dict[int, int]()
    for pair, values in pairs.items():
        if not (isinstance(pair, tuple) and len(set(pair)) == 2 == len(pair)):
            raise InvalidProblem(
                f"the keys of a game are pairs of players (i, j), i ≠ j, got {pair!r}; write {{(0, 1): …, (1, 0): …}}"
            )
        game[pair] = as_array(rectangular_matrix(values, f"game[{pair}]", None, None))
        for player, size in zip(pair, game[pair].shape, strict=True):
            if not size or sizes.setdefault(player, size) != size:
                raise InvalidProblem(
                    f"game[{pair}] has shape {game[pair].shape}, and player {player} has "
                    f"{sizes.get(player, 'no')} actions elsewhere; rows are actions of the first of the pair"
                )
    if not game or set(sizes) != set(range(len(sizes))):
        raise InvalidProblem(
            f"the players of a game are numbered from 0, got {sorted(map(str, sizes))}; number them in the keys"
        )
    count, ends = len(sizes), np.cumsum([sizes[i] for i in range(len(sizes))])
    if count == 2:
        none = np.zeros((sizes[0], sizes[1]))
        return lcp_from_bimatrix_game(game.get((0, 1), none), game.get((1, 0), none.T).T)
    n, sums = int(ends[-1]), 1.0 + np.arange(count)
    ties = np.arange(1.0, n + 1.0) / 2.0 ** math.frexp(n + 1)[1]
    C, S = np.empty((n, n)), np.zeros((n, count))
    for i, end in enumerate(ends.tolist()):
        mine, others = slice(end - sizes[i], end), [j for j in range(count) if j != i]
        rows = [game.get((i, j), np.zeros((sizes[i], sizes[j]))) for j in others]
        C[mine, np.r_[: mine.start, end:n]] = _costs(np.hstack(rows), axis=0)
        C[mine, mine], S[mine, i] = 2.0 - ties[mine, np.newaxis], sums[i]
    M = np.block([[C, -S], [S.T, np.zeros((count, count))]])
    origin = GameOrigin(game, tuple(sizes[i] for i in range(count)))
    return LCP(M, np.append(ties, -sums)).with_origin(origin)


def _payoffs_of(game: Any, B: AnyMatrix) -> tuple[Any, Any]:
    """Return (A, B) of a game whose players have each a `payoff_array`, its action first."""
    if B is not None:
        raise InvalidProblem(f"{type(game).__name__} has the payoffs of both players; leave B out")
    if len(game.players) != 2:
        raise InvalidProblem(f"a bimatrix game has two players, got a game of {len(game.players)}")
    row, column = (np.asarray(player.payoff_array) for player in game.players)
    return row, column.T


def _costs(payoffs: FloatMatrix, axis: int) -> FloatMatrix:
    """Return positive costs, at least 1: the loss of each action, along its `axis`, relative to the best reply.

    Terms that the other player's action adds to all costs have no influence, so the best reply to each costs one unit.
    The unit is a power of two, small enough to keep the digits of every difference next to one huge payoff: integer
    payoffs are exact.
    """
    # differences do not overflow
    payoffs = np.ldexp(payoffs, -int(np.frexp(np.abs(payoffs).max())[1]))
    missed = payoffs.max(axis=axis, keepdims=True) - payoffs
    if not missed.any():
        return np.ones_like(payoffs)
    ends = missed[missed > 0.0].min(), missed.max()
    least, most = (2.0 ** (math.frexp(size)[1] - 1) for size in ends)
    # Costs do not overflow
    unit = max(min(most, 2.0**3 * least), 2.0**-900)  # no difference is lost
    return 1.0 + missed / unit
