"""Random programs with complementarity constraints, the truth by all their pieces, solved by HiGHS and Clarabel.

The problems have two to twelve pairs with boxes, one bound or none, further bounds, equations and inequalities. Their
objectives are linear, convex or semidefinite, and some problems are infeasible or unbounded. Every nonempty piece is
solved; empty pieces are cut off by linear programs. The campaign counts

- wrong: a status or a value that disagrees with the pieces, a bound above the value, a result whose
  verify() is False, or a modified result whose verify() is True.
- open: STALLED, or a limit.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import linprog

from lcp_plugin import EquilibriumProgram, QuadraticProgram, Status
from lcp_plugin.problems.equilibria.equilibrium_program import CASES, FREE_CASE, LOW_CASE

from .outliers import by_clarabel

INF = np.inf
ACCURACY = 1e-6
MOST_PIECES = 4096
Generator = np.random.Generator


# --- The problems ---


def small(rng: Generator, *shape: int, most: int = 3, density: float = 0.6) -> np.ndarray:
    """Small integers, many of them zero."""
    return rng.integers(-most, most + 1, shape) * (rng.random(shape) < density).astype(float)


def matrix_of_pairs(rng: Generator, k: int) -> np.ndarray:
    """A matrix M of w = M z + …: semidefinite, definite, skew, diagonally dominant, or any."""
    kind, half = rng.integers(5), small(rng, k, max(k // 2, 1), most=2)
    if kind == 0:
        return half @ half.T
    if kind == 1:
        return half @ half.T + np.eye(k)
    if kind == 2:
        upper = np.triu(small(rng, k, k), 1)
        return upper - upper.T
    M = small(rng, k, k, density=0.3)
    return M + np.diag(np.abs(M).sum(axis=1) + 1.0) if kind == 3 else M


def bounds_of_pairs(rng: Generator, k: int) -> tuple[np.ndarray, np.ndarray]:
    """0 ≤ z mostly; boxes as long as there are few pieces, upper bounds alone, none."""
    lower, upper = np.zeros(k), np.full(k, INF)
    kinds = rng.choice(4, k, p=[0.7, 0.15, 0.075, 0.075])
    for i, kind in enumerate(kinds):
        if (
            kind == 1
            and 3.0 ** (kinds[: i + 1] == 1).sum() * 2.0 ** (k - (kinds[: i + 1] == 1).sum())
            <= MOST_PIECES
        ):
            lower[i], upper[i] = -rng.integers(0, 3), rng.integers(1, 4)
        elif kind == 2:
            lower[i], upper[i] = -INF, rng.integers(-1, 3)
        elif kind == 3:
            lower[i] = -INF
    return lower, upper


def objective(rng: Generator, n: int, k: int) -> tuple[np.ndarray, np.ndarray]:
    """P and c: linear, definite, or semidefinite; now and then with the other sides in it."""
    P, c, reach = np.zeros((n, n)), np.zeros(n), n if rng.random() < 0.2 else n - k
    c[:reach] = small(rng, reach, most=4, density=0.8)
    kind = rng.integers(3)
    if kind:
        half = small(rng, reach, reach if kind == 1 else max(reach // 2, 1), most=2)
        P[:reach, :reach] = half @ half.T + (np.eye(reach) if kind == 1 else 0.0)
    return P, c


def random_problem(rng: Generator, most: int = 12) -> EquilibriumProgram:
    """Return variables x, z and w = N x + M z + q with pairs z ⟂ w, and mostly a known solution."""
    k, free = 2 + int((most - 1) * rng.random() ** 2), int(rng.integers(0, 4))
    own_lower, own_upper = bounds_of_pairs(rng, k)
    n, N, M = free + 2 * k, small(rng, k, free), matrix_of_pairs(rng, k)
    z = np.where(
        np.isfinite(own_lower),
        own_lower,
        np.where(np.isfinite(own_upper), own_upper, rng.integers(-2, 3)),
    )
    is_between = rng.random(k) < 0.5
    z = np.where(is_between, np.clip(z + rng.integers(-1, 3, k), own_lower, own_upper), z)
    sign = np.where(z == own_lower, 1.0, np.where(z == own_upper, -1.0, 0.0))
    x, w = rng.integers(-2, 3, free).astype(float), sign * rng.integers(0, 4, k)
    q = w - N @ x - M @ z if rng.random() < 0.75 else small(rng, k, most=4)
    point = np.concatenate([x, z, w])
    G, h = small(rng, int(rng.integers(0, 4)), n), np.zeros(0)
    G[:, n - k :] *= rng.random() < 0.2
    h = G @ point + rng.integers(0, 3, G.shape[0]) - (rng.random() < 0.1)
    more = small(rng, int(rng.random() < 0.3), n)
    A, b = np.vstack([np.hstack([N, M, -np.eye(k)]), more]), np.concatenate([-q, more @ point])
    lower, upper = np.full(n, -INF), np.full(n, INF)
    limited = rng.random(free) < 0.8
    lower[:free][limited], upper[:free][limited] = -3.0, 3.0
    if rng.random() < 0.3:  # plain bounds, in addition to the bounds of the pairs
        lower[free:][rng.random(2 * k) < 0.1] = -1.0
        upper[free:][rng.random(2 * k) < 0.2] = 2.0
    P, c = objective(rng, n, k)
    program = QuadraticProgram(P, c, G, h, A, b, lower, upper)
    first = np.arange(free, free + k)
    return EquilibriumProgram(program, first, first + k, own_lower, own_upper)


# --- The truth ---


class Truth(NamedTuple):
    """Status and value."""

    status: Status  # NO_SOLUTION if all pieces are empty, for any reason
    value: float


def bounds(problem: EquilibriumProgram, cases: list[int]) -> tuple[np.ndarray, np.ndarray]:
    """Return bounds for the given branches of the first pairs, and all other branches."""
    lower, upper = np.array(problem.program.lower), np.array(problem.program.upper)
    for i, (z, w) in enumerate(zip(problem.first, problem.second, strict=True)):
        own_lower, own_upper = problem.lower[i], problem.upper[i]
        lower[z], upper[z] = max(lower[z], own_lower), min(upper[z], own_upper)
        case = cases[i] if i < len(cases) else 0
        if case == LOW_CASE:
            upper[z], lower[w] = min(upper[z], own_lower), max(lower[w], 0.0)
        elif case == FREE_CASE:
            lower[w], upper[w] = max(lower[w], 0.0), min(upper[w], 0.0)
        elif case:
            lower[z], upper[w] = max(lower[z], own_upper), min(upper[w], 0.0)
    return lower, upper


def by_highs(problem: EquilibriumProgram, cases: list[int], cost: np.ndarray) -> Any:
    """Return the result of the linear program on a piece, None if it is empty."""
    program, (lower, upper) = problem.program, bounds(problem, cases)
    if (lower > upper).any():
        return None
    ends = np.column_stack([lower, upper])
    found = linprog(cost, program.G, program.h, program.A, program.b, ends)
    if found.status not in (0, 2, 3):
        raise ArithmeticError(f"HiGHS says {found.message}")
    return None if found.status == 2 else found


def not_empty(problem: EquilibriumProgram, cases: list[int]) -> Iterator[list[int]]:
    """Yield every piece that holds a point."""
    if by_highs(problem, cases, np.zeros(problem.program.n)) is None:
        return
    if (i := len(cases)) == problem.pairs:
        yield cases
        return
    has = (np.isfinite(problem.lower[i]), True, np.isfinite(problem.upper[i]))
    for case, is_there in zip(CASES, has, strict=True):
        if is_there:
            yield from not_empty(problem, [*cases, case])


def least(problem: EquilibriumProgram, cases: list[int]) -> np.ndarray | None:
    """Return the best point of a nonempty piece; None if its objective is unbounded."""
    program, (lower, upper) = problem.program, bounds(problem, cases)
    if not np.any(program.P):
        found = by_highs(problem, cases, program.c)
        return None if found.status == 3 else np.array(found.x)
    data = [program.P, program.c, program.G, program.h, program.A, program.b, lower, upper]
    status, x = by_clarabel(data)
    if "DualInfeasible" in status:
        return None
    if status not in ("Solved", "AlmostSolved"):
        raise ArithmeticError(f"Clarabel says {status}")
    return x


def truth(problem: EquilibriumProgram) -> Truth:
    """Return the least of all pieces."""
    best = INF
    for cases in not_empty(problem, []):
        x = least(problem, cases)
        if x is None:
            return Truth(Status.UNBOUNDED, -INF)
        best = min(best, problem.objective(x))
    return Truth(Status.NO_SOLUTION if best == INF else Status.SOLVED, best)


# --- The judgement ---


def is_solution(problem: EquilibriumProgram, x: np.ndarray) -> bool:
    """Return whether x satisfies all constraints to the accuracy, and every pair exactly."""
    program, z, w = problem.program, x[problem.first], x[problem.second]
    allowed = ACCURACY * (1.0 + np.abs(x).max())
    kept = [
        program.G @ x <= program.h + allowed,
        np.abs(program.A @ x - program.b) <= allowed,
        program.lower <= x + allowed,
        x <= program.upper + allowed,
        problem.lower <= z,
        z <= problem.upper,
        ((z == problem.lower) & (w >= 0)) | (w == 0) | ((z == problem.upper) & (w <= 0)),
    ]
    return all(bool(np.all(one)) for one in kept)


def complaints(result: Any, known: Truth) -> list[str]:
    """Return the errors of a result compared with the truth."""
    messages = []
    if (result.is_solved or result.has_no_solution) and known.status is not (
        Status.NO_SOLUTION if result.status is Status.INFEASIBLE else result.status
    ):
        messages.append(f"says {result.status}, is {known.status}")
    allowed = ACCURACY * max(1.0, abs(known.value)) if math.isfinite(known.value) else 0.0
    if result.x is not None and result.value < known.value - 2.0 * allowed:
        messages.append(f"value {result.value} below {known.value}")
    if (
        result.is_solved
        and known.status is Status.SOLVED
        and result.value > known.value + 2.0 * allowed
    ):
        messages.append(f"value {result.value} above {known.value}")
    if result.lower_bound > known.value + allowed:
        messages.append(f"bound {result.lower_bound} above {known.value}")
    has_point = result.x is not None and not result.has_no_solution
    if has_point and not is_solution(result.problem, result.x):
        messages.append("x is no solution")
    if result.verify() == (result.bound_by == "SCIP"):  # whose bound nothing proves
        messages.append(f"verify() is {result.verify()}")
    return messages


def damaged(result: Any) -> Iterator[tuple[str, Any]]:
    """The result with what is false in it."""
    if math.isfinite(result.lower_bound):
        step = 1e-3 * max(1.0, abs(result.lower_bound))
        yield "bound raised", replace(result, lower_bound=result.lower_bound + step)
        if result.x is not None:
            yield "value lowered", replace(result, value=result.value - step)
    if result.x is not None and not result.has_no_solution:  # then x is NaN
        problem = result.problem
        moves = (
            ("x", np.arange(problem.program.n), 0.5),
            ("z", problem.first, 0.5),
            ("z", problem.first, -5.0),
            ("w", problem.second, 0.5),
            ("w", problem.second, -5.0),
        )
        for name, entries, step in moves:
            moved = np.array(result.x)
            moved[entries] += step
            if not is_solution(problem, moved) or problem.objective(moved) > result.value:
                yield f"{name} moved", replace(result, x=moved)
    leaves = [node for node in result.tree if node.pair < 0]
    if len(result.tree) > 1 and result.status is not Status.UNBOUNDED:
        yield (
            "leaf removed",
            replace(result, tree=tuple(node for node in result.tree if node is not leaves[-1])),
        )
    if result.status in (Status.INFEASIBLE, Status.NO_SOLUTION):
        yield (
            "unproved",
            replace(result, tree=tuple(replace(node, proof=None) for node in result.tree)),
        )
    else:
        yield (
            "called infeasible",
            replace(result, status=Status.NO_SOLUTION, x=None, value=INF, lower_bound=INF),
        )
    if result.status is not Status.UNBOUNDED:
        yield (
            "called unbounded",
            replace(result, status=Status.UNBOUNDED, x=None, value=-INF, lower_bound=-INF),
        )


def undetected(result: Any) -> list[str]:
    """Return the modifications that verify() does not detect."""
    return [f"not seen: {name}" for name, other in damaged(result) if other.verify()]
