"""All extreme Nash equilibria of two-player games in fractions, by vertices and labels, independent of the library."""

from __future__ import annotations

from fractions import Fraction
from itertools import combinations
from typing import Any

from oracles.exact import solve_fractions

Strategy = tuple[Fraction, ...]


def extreme_equilibria(A: Any, B: Any) -> set[tuple[Strategy, Strategy]]:
    """Return all pairs (x, y) of vertices of the best-response polyhedra in which each action is unplayed or best.

    References
    ----------
    O. L. Mangasarian, *Equilibrium points of bimatrix games*, J. SIAM 12 (1964), doi:10.1137/0112064.
    """
    A, B = ([[Fraction(value) for value in row] for row in payoffs] for payoffs in (A, B))
    m, k = len(A), len(A[0])
    # the column player's payoffs for each x
    of_row = _vertices([[B[i][j] for i in range(m)] for j in range(k)])
    of_column = _vertices(A)
    found = set()
    for x, unplayed_rows, best_columns in of_row:
        for y, unplayed_columns, best_rows in of_column:
            if len(unplayed_rows | best_rows) == m and len(unplayed_columns | best_columns) == k:
                found.add((x, y))
    return found


def _vertices(
    payoffs: list[list[Fraction]],
) -> list[tuple[Strategy, frozenset[int], frozenset[int]]]:
    """Return the vertices of {(s, v): payoffs s ≤ v, s ≥ 0, Σ s = 1}: s, where s is 0, which payoffs are v."""
    n = len(payoffs[0])
    rows = [[*row, Fraction(-1)] for row in payoffs] + [
        [Fraction(int(i == j)) for j in range(n)] + [Fraction(0)] for i in range(n)
    ]
    found = {}
    for tight in combinations(range(len(rows)), n):
        system = [*(rows[i] for i in tight), [Fraction(1)] * n + [Fraction(0)]]
        point = solve_fractions(system, [Fraction(0)] * n + [Fraction(1)])
        if point is None or min(point[:n]) < 0:
            continue
        gains = [
            sum((a * s for a, s in zip(row, point[:n], strict=True)), Fraction(0))
            for row in payoffs
        ]
        if max(gains) == point[n]:
            unplayed = frozenset(i for i in range(n) if point[i] == 0)
            found[tuple(point[:n])] = (
                unplayed,
                frozenset(j for j, gain in enumerate(gains) if gain == point[n]),
            )
    return [(s, *labels) for s, labels in found.items()]
