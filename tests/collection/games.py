"""Two-player games: z = (x, y), M = [[0, K], [Lᵀ, 0]], positive costs K, L, q = −1; there is always an equilibrium."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .entry import Entry, solvable

NASH = "Nash 1950: every finite game has an equilibrium"
LEMKE_HOWSON = (
    "Lemke, Howson, Equilibrium points of bimatrix games, J. SIAM 12 (1964), doi:10.1137/0112033"
)
CLASSIC = (
    "von Neumann, Morgenstern, Theory of Games and Economic Behavior, Princeton 1944; Luce, Raiffa, Games and "
    "Decisions, Wiley 1957"
)
SAVANI = (
    "Savani, von Stengel, Hard-to-solve bimatrix games, Econometrica 74 (2006), "
    "doi:10.1111/j.1468-0262.2006.00667.x"
)
SHAPLEY = "Shapley, Some topics in two-person games, 1964"

Matrix = NDArray[np.float64]


def entries() -> Iterator[Entry]:
    """Yield the named games and the hard ones."""
    yield from _named()
    for d in (2, 4, 6, 8):
        A, B = cyclic_polytope_game(d)
        yield game(f"cyclic_polytope_{d}x{d}", f"after {SAVANI}", A, B)


def game(name: str, source: str, A: Any, B: Any, *, solution: Any = None) -> Entry:
    """Return the complementarity problem of a game with payoffs A, B; costs are (largest payoff + 1) − payoff."""
    A, B = np.asarray(A, dtype=float), np.asarray(B, dtype=float)
    m, k = A.shape
    M = np.zeros((m + k, m + k))
    M[:m, m:], M[m:, :m] = A.max() + 1.0 - A, (B.max() + 1.0 - B).T
    return solvable(name, source, M, -np.ones(m + k), solution=solution, theorem=NASH)


def _named() -> Iterator[Entry]:
    yield game("battle_of_the_sexes", CLASSIC, [[2, 0], [0, 1]], [[1, 0], [0, 2]])
    yield game(
        "prisoners_dilemma",
        CLASSIC,
        [[-1, -3], [0, -2]],
        [[-1, 0], [-3, -2]],
        solution=[0, "1/3", 0, "1/3"],
    )
    yield game(
        "matching_pennies", CLASSIC, [[1, -1], [-1, 1]], [[-1, 1], [1, -1]], solution=["1/4"] * 4
    )
    yield game("chicken", CLASSIC, [[0, -1], [1, -9]], [[0, 1], [-1, -9]])
    yield game("stag_hunt", CLASSIC, [[4, 1], [3, 2]], [[4, 3], [1, 2]])
    yield game("inspection", CLASSIC, [[0, 10], [1, 5]], [[0, -10], [0, -90]])
    turn = [[0, -1, 1], [1, 0, -1], [-1, 1, 0]]
    yield game("rock_paper_scissors", CLASSIC, turn, -np.array(turn), solution=["1/6"] * 6)
    five = [
        [0, -1, 1, 1, -1],
        [1, 0, -1, -1, 1],
        [-1, 1, 0, 1, -1],
        [-1, 1, -1, 0, 1],
        [1, -1, 1, -1, 0],
    ]
    yield game(
        "rock_paper_scissors_lizard_spock", CLASSIC, five, -np.array(five), solution=["1/10"] * 10
    )
    A = [[0, 1, 0], [0, 0, 1], [1, 0, 0]]
    yield game("shapley_cycle", SHAPLEY, A, [[0, 0, 1], [1, 0, 0], [0, 1, 0]], solution=["1/5"] * 6)
    yield game("lemke_howson_3x2", LEMKE_HOWSON, [[3, 3], [2, 5], [0, 6]], [[3, 2], [2, 6], [3, 1]])
    blotto = [[int(np.sign(i - j)) + int(np.sign(j - i + 1)) for j in range(4)] for i in range(4)]
    yield game("colonel_blotto_small", CLASSIC, blotto, -np.array(blotto))
    guess = [
        [float(min(i, j)) + (2.0 if i < j else -2.0 if i > j else 0.0) for j in range(2, 8)]
        for i in range(2, 8)
    ]
    yield game(
        "travellers_dilemma_6x6",
        "Basu, The traveler's dilemma, American Economic Review 84 (1994)",
        guess,
        np.array(guess).T,
    )


def cyclic_polytope_game(d: int) -> tuple[Matrix, Matrix]:
    """Return a d × d game whose best-response polytopes are dual to cyclic ones (many pivots along every path).

    The dual of the 2d points (t, t², …, t^d) around their centre is cut out by as many inequalities c_k·y ≤ 1; the
    vertex where the first d of them are tight becomes the origin, their slacks the coordinates.
    """
    t = np.linspace(-1.0, 1.0, 2 * d)
    points = t[:, None] ** np.arange(1, d + 1)
    points = points - points.mean(axis=0)
    first, rest = points[:d], points[d:]
    T = np.linalg.solve(first.T, rest.T).T
    payoff = -T / (1.0 - T.sum(axis=1))[:, None]
    payoff /= np.abs(payoff).max()
    swapped = np.arange(d) ^ 1
    return payoff[::-1, swapped].T.copy(), payoff.T.copy()
