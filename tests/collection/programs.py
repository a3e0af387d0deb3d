"""Linear and convex quadratic programs by their optimality conditions: [[P, −Aᵀ], [A, 0]] for A x ≥ b, x ≥ 0."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from .entry import COTTLE_PANG_STONE, OWN, Entry, infeasible, solvable

BEALE = "Beale, Cycling in the dual simplex algorithm, Naval Research Logistics Quarterly 2 (1955)"
KLEE_MINTY = (
    "Klee, Minty, How good is the simplex algorithm?, Inequalities III, Academic Press 1972"
)
DANTZIG = "Dantzig, Linear Programming and Extensions, Princeton 1963"
KUHN = "Kuhn, The Hungarian method for the assignment problem, Naval Research Logistics Quarterly 2 (1955)"
MONOTONE = "M positive semidefinite and linearly feasible: Cottle 1968"


def entries() -> Iterator[Entry]:
    """Yield linear programs, quadratic programs, and those without an optimum."""
    yield from _linear()
    yield from _quadratic()
    yield from _without_optimum()


def conditions(P: Any, c: Any, A: Any, b: Any) -> tuple[Any, Any]:
    """Return M, q of min ½ xᵀP x + cᵀx, A x ≥ b, x ≥ 0."""
    A = np.asarray(A, dtype=float)
    m, n = A.shape
    P = np.zeros((n, n)) if P is None else np.asarray(P, dtype=float)
    return np.block([[P, -A.T], [A, np.zeros((m, m))]]), np.concatenate(
        [c, -np.asarray(b, dtype=float)]
    )


def _linear() -> Iterator[Entry]:
    A = [[-1, -240, 4, -36], [-1, -180, 2, -12], [0, 0, -1, 0]]
    yield solvable(
        "beale_cycling",
        f"{BEALE}; rows and columns scaled to integers",
        *conditions(None, [-3, 600, -2, 24], A, [0, 0, -1]),
    )
    A = [[-3, -2, 1, -6], [-3, 11, 2, -4], [0, 0, -1, 0]]
    yield solvable(
        "linear_program_degenerate", OWN, *conditions(None, [-2, 1, -3, 2], np.array(A), [0, 0, -1])
    )
    for n in (3, 5, 10):
        A = -np.array(
            [[2.0 * 10 ** (i - j) if j < i else float(i == j) for j in range(n)] for i in range(n)]
        )
        c = [-(10.0 ** (n - 1 - j)) for j in range(n)]
        b = [-(100.0**i) for i in range(n)]
        answer = [0] * (n - 1) + [100 ** (n - 1)] + [0] * (n - 1) + [1]
        yield solvable(f"klee_minty_{n}", KLEE_MINTY, *conditions(None, c, A, b), solution=answer)
    supply, demand = [10, 20], [5, 15, 10]
    A = np.vstack([np.kron(np.eye(2), -np.ones(3)), np.kron(np.ones(2), np.eye(3))])
    yield solvable(
        "transport_2x3",
        f"{DANTZIG}, chapter 14; own numbers",
        *conditions(None, [2, 4, 5, 3, 1, 7], A, [-x for x in supply] + demand),
        theorem=MONOTONE,
    )
    A = np.vstack([np.kron(np.eye(4), np.ones(4)), np.kron(np.ones(4), np.eye(4))])
    cost = [[4, 1, 3, 2], [2, 0, 5, 3], [3, 2, 2, 3], [1, 2, 3, 4]]
    yield solvable(
        "assignment_4x4",
        f"{KUHN}; own numbers",
        *conditions(None, np.ravel(cost), A, np.ones(8)),
        theorem=MONOTONE,
    )


def _quadratic() -> Iterator[Entry]:
    P, A = [[4, 1], [1, 2]], [[1, 1], [-1, 0], [0, -1]]
    yield solvable("quadratic_program_small", OWN, *conditions(P, [1, 1], A, [1, -0.75, -0.75]))
    yield solvable(
        "quadratic_program_flat_direction",
        OWN,
        *conditions([[1, -1], [-1, 1]], [-1, 1], [[-1, -1]], [-4]),
    )
    P = np.diag([2.0, 0.0, 0.0])
    yield solvable(
        "quadratic_and_linear",
        COTTLE_PANG_STONE,
        *conditions(P, [-2, -1, -3], [[-1, -1, -2], [0, 1, -1]], [-4, 0]),
    )
    P = np.array([[2.0, -1.0, 0.0], [-1.0, 2.0, -1.0], [0.0, -1.0, 2.0]])
    yield solvable(
        "portfolio_3", OWN, *conditions(P, [0, 0, 0], [[3, 5, 8], [-1, -1, -1]], [6, -1.5])
    )
    yield solvable(
        "nonconvex_stationary_point",
        OWN,
        *conditions([[-2, 0], [0, 1]], [1, -1], [[-1, 0], [0, -1]], [-2, -2]),
    )


def _without_optimum() -> Iterator[Entry]:
    yield infeasible(
        "linear_program_infeasible", OWN, *conditions(None, [1, 1], [[1, 1], [-1, -1]], [3, -2])
    )
    yield infeasible("linear_program_unbounded", OWN, *conditions(None, [-1, 0], [[1, -1]], [0]))
    yield infeasible(
        "linear_program_neither", OWN, *conditions(None, [-1, -1], [[1, -1], [-1, 1]], [1, 1])
    )
    yield infeasible(
        "quadratic_program_infeasible", OWN, *conditions(np.eye(2), [0, 0], [[-1, -1]], [1])
    )
    yield infeasible(
        "quadratic_program_unbounded", OWN, *conditions([[1, 0], [0, 0]], [0, -1], [[1, 1]], [1])
    )
    A = -np.kron(np.ones(3), np.eye(2))
    yield infeasible(
        "transport_too_much_demand",
        OWN,
        *conditions(
            None, np.ones(6), np.vstack([A, np.kron(np.eye(3), np.ones(2))]), [-2, -2, 2, 2, 1]
        ),
    )
