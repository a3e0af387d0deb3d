"""Small games with ties against their exact equilibria: all of them by all_solutions, one by solve.

Payoffs are integers from 0
to 6, in one of five games beside one number that users write: ±1e19, 1e-9, 1e-17, 1e10. The truth comes from
`exact_equilibria`.
"""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction

import numpy as np

from lcp_plugin import LCP, all_solutions, solve

from .exact_equilibria import Strategy, extreme_equilibria

ODD = (1e19, -1e19, 1e-9, 1e-17, 1e10)
LITTLE, MISSED = Fraction(1, 10**7), Fraction(1, 10**6)  # of a strategy; of what is gained


def game(rng: np.random.Generator, odd: float | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Return payoffs from 0 to 6 of both players, one of them the odd number."""
    shape = tuple(rng.integers(2, 5, 2))
    A, B = (rng.integers(0, 7, shape).astype(float) for _ in range(2))
    if odd is not None:
        (A, B)[rng.integers(2)].flat[rng.integers(A.size)] = odd
    return A, B


def shifted(
    A: np.ndarray, B: np.ndarray, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Return the payoffs in another unit, with differences of 1e-9, or with an offset."""
    unit, size = float(rng.choice([1.0, 1e-9, 1e10, 1e19])), float(rng.choice([0.0, 1e-9]))
    return unit * (A + rng.choice([0.0, size], A.shape)), B + float(rng.choice([0.0, 1e10]))


def wrong_equilibria(A: np.ndarray, B: np.ndarray) -> str:
    """Return which extreme equilibria are missing or additional, or nothing."""
    problem, expected = LCP.from_game(A, B), extreme_equilibria(A, B)
    found = {
        strategies(vertex, len(A))
        for face in all_solutions(problem)
        for vertex in face.exact_vertices
    }
    additional, missing = (
        sum(not is_among(one, others) for one in these)
        for these, others in ((found, expected), (expected, found))
    )
    return (
        f"{additional} additional and {missing} missing equilibria" if additional or missing else ""
    )


def missed(A: np.ndarray, B: np.ndarray) -> str:
    """Return by how much an action that the answer of `solve` plays is worse than the best one, or nothing."""
    problem = LCP.from_game(A, B)
    result = solve(problem)
    if not result.is_solved:
        return f"solve: {result.status.name}"
    equilibrium = problem.origin.recover(result)
    x, y = (
        [Fraction(value) for value in s.tolist()]
        for s in (equilibrium.row_strategy, equilibrium.column_strategy)
    )
    for name, payoffs, own, other in (("row", A, x, y), ("column", B.T, y, x)):
        terms = [
            [Fraction(a) * t for a, t in zip(row, other, strict=True)] for row in payoffs.tolist()
        ]
        gains, size = [sum(row) for row in terms], max(abs(term) for row in terms for term in row)
        worst = max(
            max(gains) - gain for gain, played in zip(gains, own, strict=True) if played > LITTLE
        )
        if worst > MISSED * size:
            return f"solve: the {name} player plays an action that is worse by {float(worst):.3g}"
    return ""


def is_among(pair: tuple[Strategy, Strategy], others: set[tuple[Strategy, Strategy]]) -> bool:
    """Return whether a pair is one of the others, to what costs beside 1e19 or 1e-17 round in doubles."""
    return pair in others or any(
        all(
            abs(a - b) <= Fraction(1, 10**9)
            for one, two in zip(pair, other, strict=True)
            for a, b in zip(one, two, strict=True)
        )
        for other in others
    )


def strategies(z: Sequence[Fraction], m: int) -> tuple[Strategy, Strategy]:
    """Return both parts of a solution, each of sum 1."""
    x, y = z[:m], z[m:]
    return tuple(value / sum(x) for value in x), tuple(value / sum(y) for value in y)
