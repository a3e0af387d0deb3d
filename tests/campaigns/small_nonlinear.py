"""Small nonlinear problems whose solutions an LCP of integers and powers of two defines, checked in fractions.

F is M x + q, or curved without another solution: g(M x + q) with g(t) = t + t³/s², rows times 1 + x_i²/s², or
the unknown y with x = y + y³/s². A run begins at z°, or at a wrong vertex. SOLVED is false if no exact solution of the
LCP is near the point.
"""

from __future__ import annotations

from collections.abc import Iterator
from fractions import Fraction
from itertools import product
from typing import Any, NamedTuple

import numpy as np
from oracles.truth import Search

from lcp_plugin import LCP, NonlinearProblem, solve

SHAPES = ("affine", "bent rows", "weighted rows", "bent unknowns")
NEAR, PERTURBATION = Fraction(1, 1000), Fraction(1, 10**7)
KINDS = ("integers", "P", "powers of two", "chain", "idle row", "cancelling", "near-parallel rows")


class Drawn(NamedTuple):
    """An LCP, the same problem as F, a start, and the map from the unknown of F to z."""

    name: str
    linear: LCP
    problem: NonlinearProblem
    start: np.ndarray | None
    z_of: Any


def drawn_lcp(rng: np.random.Generator, kind: str) -> LCP:
    """Return an LCP of one to four rows."""
    n = int(rng.integers(2, 5)) if kind not in ("integers", "P") else int(rng.integers(1, 5))
    M = rng.integers(-3, 4, (n, n)).astype(float)
    q = rng.integers(-3, 4, n).astype(float)
    if kind == "P":
        M = (
            np.tril(M, -1) + np.diag(rng.integers(1, 4, n))
            if rng.random() < 0.5
            else M @ M.T + np.eye(n)
        )
    elif kind == "powers of two":
        q *= 2.0 ** rng.integers(-10, 45, n)
    elif kind == "chain":  # small rows that share unknowns, next to a large one
        M = np.eye(n) + np.diag(rng.integers(-2, 3, n - 1).astype(float), 1)
        q = np.where(rng.random(n) < 0.5, 0.0, q)
        q[0] = -(2.0 ** rng.integers(20, 60))
    elif kind == "idle row":
        M[0, 1:] *= 2.0 ** rng.integers(5, 20, n - 1)
        M[-1] = M[-2]
        M[-1, -1] += 2.0 ** -int(rng.integers(5, 20))
        q[0] = 2.0 ** rng.integers(5, 20) * rng.choice([-1, 1])
    elif kind == "cancelling":
        M[1] = -M[0]
        q[-1] = -(2.0 ** rng.integers(10, 42))
    elif kind == "near-parallel rows":
        M[-1] = M[0] * (1.0 + 2.0 ** -int(rng.integers(5, 20)))
        M[-1, -1] += 1.0
    lower, upper = np.zeros(n), np.full(n, np.inf)
    if rng.random() < 0.25:
        lower = np.where(rng.random(n) < 0.5, lower, rng.integers(-2, 3, n).astype(float))
        upper = np.where(rng.random(n) < 0.7, upper, lower + rng.integers(1, 5, n))
    return LCP(M, q, lower=lower, upper=upper)


def curved(linear: LCP, shape: str, size: float) -> tuple[NonlinearProblem, Any, Any]:
    """Return F with the solutions of the LCP, the map from its unknown to z, and its inverse."""
    M, q, s = linear.csr.toarray(), linear.q, size
    bend, slope = (lambda t: t * (1 + (t / s) ** 2)), (lambda t: 1 + 3 * (t / s) ** 2)
    lower, upper = linear.lower, linear.upper
    if shape == "affine":
        return NonlinearProblem(lambda x: M @ x + q, lambda x: M, lower, upper), np.array, np.array
    if shape == "bent rows":
        return (
            NonlinearProblem(
                lambda x: bend(M @ x + q), lambda x: slope(M @ x + q)[:, None] * M, lower, upper
            ),
            np.array,
            np.array,
        )
    if shape == "weighted rows":
        return NonlinearProblem(
            lambda x: (1 + (x / s) ** 2) * (M @ x + q),
            lambda x: (1 + (x / s) ** 2)[:, None] * M + np.diag(2 * x / s**2 * (M @ x + q)),
            lower, upper,
        ), np.array, np.array  # fmt: skip

    def y_of(z: np.ndarray) -> np.ndarray:
        return np.array([_unbend(value, s) for value in z])

    bounds = y_of(lower), y_of(upper)

    def z_of(y: np.ndarray) -> np.ndarray:
        z = np.where(y == bounds[0], lower, np.where(y == bounds[1], upper, bend(y)))
        return np.clip(z, lower, upper)

    return NonlinearProblem(lambda y: M @ z_of(y) + q, lambda y: M * slope(y), *bounds), z_of, y_of


def _unbend(value: float, s: float) -> float:
    """Return y with y + y³/s² = value, by bisection."""
    if not np.isfinite(value) or value == 0.0:
        return value
    low, high = 0.0, abs(value)
    for _ in range(200):
        middle = 0.5 * (low + high)
        low, high = (
            (middle, high) if middle * (1 + (middle / s) ** 2) < abs(value) else (low, middle)
        )
    return float(np.copysign(high, value))


def drawn(rng: np.random.Generator, shape: str) -> Drawn:
    """Return a problem of a random kind and start."""
    kind = str(rng.choice(KINDS))
    linear = drawn_lcp(rng, kind)
    size = float(max(1.0, np.abs(linear.q).max()) * 2.0 ** rng.integers(-3, 4))
    problem, z_of, y_of = curved(linear, shape, size)
    start = wrong_vertex(rng, linear) if rng.random() < 0.5 else None
    start = None if start is None else y_of(start)
    return Drawn(f"{kind}, {shape}", linear, problem, start, z_of)


def wrong_vertex(rng: np.random.Generator, linear: LCP) -> np.ndarray | None:
    """Return the solution of the equations of a random active set, or None."""
    free = rng.random(linear.n) < 0.6
    z = np.where(
        np.isfinite(linear.upper) & (rng.random(linear.n) < 0.5), linear.upper, linear.lower
    )
    M = linear.csr.toarray()
    try:
        z[free] = np.linalg.solve(
            M[np.ix_(free, free)], -(M[np.ix_(free, ~free)] @ z[~free] + linear.q[free])
        )
    except np.linalg.LinAlgError:
        return None
    return z


def has_solution_near(linear: LCP, z: np.ndarray) -> bool:
    """Return whether an exact solution is near z, if each q_i may change by PERTURBATION of the q of related rows.

    Near: each z_i changes by at most NEAR of the unknowns of its row.
    """
    rows = linear.csr.toarray()
    is_shared = (rows != 0.0) | np.eye(linear.n, dtype=bool)
    sizes = [np.where(is_shared, np.abs(of), 0.0).max(1).tolist() for of in (linear.q, z)]
    slack, reach = (
        [s * Fraction(x) for x in size] for s, size in zip((PERTURBATION, NEAR), sizes, strict=True)
    )
    search = Search(rows.tolist(), linear.q.tolist(), linear.lower.tolist(), linear.upper.tolist())
    n, simplex, zero = linear.n, search.simplex, search.zero
    near = [(Fraction(x) - r, Fraction(x) + r) for x, r in zip(z.tolist(), reach, strict=True)]
    for states in product((-1, 0, 1), repeat=n):
        ends = [
            (None, high, low)[state]
            for state, low, high in zip(states, search.lower, search.upper, strict=True)
        ]
        if any(state and end is None for state, end in zip(states, ends, strict=True)):
            continue
        for i, (state, end, (low, high)) in enumerate(zip(states, ends, near, strict=True)):
            low = max(x for x in (low, search.lower[i], end) if x is not None)
            high = min(x for x in (high, search.upper[i], end) if x is not None)
            simplex.low[i], simplex.high[i] = low, high
            simplex.low[n + i] = None if state > 0 else zero[i] - slack[i]
            simplex.high[n + i] = None if state < 0 else zero[i] + slack[i]
        if simplex.settle():
            return True
    return False


def attacks(
    rng: np.random.Generator, count: int, shape: str | None = None
) -> Iterator[tuple[str, str]]:
    """Yield the verdict on each problem, or its status, and its text."""
    for _ in range(count):
        one = drawn(rng, shape or str(rng.choice(SHAPES)))
        result = solve(one.problem, x0=one.start, max_seconds=1.0)
        what = result.status.name
        if result.is_solved:
            what = "right" if has_solution_near(one.linear, one.z_of(result.z)) else "false"
        yield (
            what,
            f"{one.name}: {one.linear.csr.toarray().tolist()}, {one.linear.q.tolist()}, "
            + (
                f"{one.linear.lower.tolist()}, {one.linear.upper.tolist()}, x0={one.start} → {result.z}"
            ),
        )
