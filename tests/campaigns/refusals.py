"""Right points that are refused, and false results of small integer problems in units of 2^±60.

A right point is a planted solution with ordinary data: exact, one ulp off, or with noise in q. A class refuses it if a
run that begins there is not SOLVED. A SOLVED point of an integer problem is false if no exact solution is near it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from fractions import Fraction
from typing import Any

import numpy as np
import scipy.sparse as sp
from oracles.truth import ExactData

from lcp_plugin import (
    LCP,
    ConeProblem,
    NonlinearProblem,
    QuadraticProgram,
    Status,
    solve,
    solve_batch,
)

from .small_nonlinear import has_solution_near

Generator = np.random.Generator
LIMIT = 2.0**-42  # of the terms of a row, below which a demand is noise: solved.md
CHANGES = ("exact", "one ulp", "noise 1e-17", "noise 1e-15")


def redundant(n: int, rng: Generator) -> Any:
    """Return J Jᵀ of rank about n/2 with a column that lets every row grow, as gravity does."""
    J = np.round(rng.normal(size=(n, n // 2 + 1)), 1)
    J[:, 0] = 1.0 + 0.1 * rng.integers(0, 9, n)
    return J @ J.T


def network(n: int, rng: Generator) -> Any:
    """Return a Laplacian with decimal weights and a leak of 0.1."""
    W = np.triu(rng.integers(0, 10, (n, n)) / 10, 1)
    W += W.T
    return np.diag(W.sum(axis=1) + 0.1) - W


def definite(n: int, rng: Generator) -> Any:
    """Return a positive definite matrix of condition about 100."""
    B = rng.normal(size=(n, n))
    return B @ B.T / n + 0.1 * np.eye(n)


FAMILIES = (redundant, network, definite)
CLASSES: dict[str, Callable[[LCP, Any], Any]] = {
    "dense": lambda p, z: solve(p, z0=z),
    "sparse": lambda p, z: solve(LCP(sp.csr_array(p.M), p.q), z0=z),
    "stack": lambda p, z: solve_batch(p.M, [p.q, p.q], z0=[z, z])[1],
    "cones": lambda p, z: solve(ConeProblem(p.M, p.q, [("nonnegative", p.n)]), z0=z),
    "nonlinear": lambda p, z: solve(
        NonlinearProblem(lambda x: p.M @ x + p.q, lambda x: p.M, 0.0), x0=z
    ),
    "program": lambda p, z: solve(QuadraticProgram(p.M, p.q, lower=0.0)),
}


def right_point(rng: Generator) -> tuple[str, LCP, np.ndarray]:
    """Return the name of family and change, a problem and a point that is right to its rounding."""
    family, change = FAMILIES[rng.integers(len(FAMILIES))], CHANGES[rng.integers(len(CHANGES))]
    n = int(rng.integers(2, 13))
    M = family(n, rng)
    M = 0.5 * (M + M.T)
    z = np.where(rng.random(n) < 0.5, rng.integers(1, 100, n) / 10, 0.0)
    w = np.where((z == 0.0) & (rng.random(n) < 0.7), rng.integers(1, 100, n) / 10, 0.0)
    q = w - M @ z
    if change == "one ulp":
        z = np.where(z > 0.0, np.nextafter(z, np.inf), 0.0)
    elif change.startswith("noise"):
        q = q + float(change.split()[1]) * abs(q).max() * rng.normal(size=n)
    return f"{family.__name__}, {change}", LCP(M, q), z


def refused(rng: Generator, problem_class: str) -> Iterator[str]:
    """Yield a line if the class refuses a drawn right point."""
    name, problem, z = right_point(rng)
    status = CLASSES[problem_class](problem, z).status
    if status is not Status.SOLVED:
        yield f"{problem_class}, {name}: {status.name}"


def false_in_units(rng: Generator) -> Iterator[str]:
    """Yield "SOLVED" for a solved integer problem, and a line with its data if no exact solution is near."""
    n = int(rng.integers(1, 5))
    M, q = rng.integers(-3, 4, (n, n)).astype(float), rng.integers(-3, 4, n).astype(float)
    rows, columns = 2.0 ** rng.integers(-60, 61, (2, n))
    result = solve(LCP(rows[:, None] * M * columns, rows * q), max_seconds=5.0)
    if result.is_solved:
        yield "SOLVED"
        problem, z = LCP(M, q), result.z * columns
        simple = [Fraction(x).limit_denominator(3**n * 24) for x in z]
        is_near = abs(z - np.array(simple, float)).max() <= 1e-6 * abs(z).max()
        if not (
            (is_near and ExactData(problem).is_solution(simple)) or has_solution_near(problem, z)
        ):
            w, terms = M @ z + q, abs(M) @ z + abs(q)
            violation = np.where(z > 0.0, abs(w), np.maximum(-w, 0.0))
            if (violation <= LIMIT * terms).all():
                return  # rounding, by the documented limit
            yield f"false: {M.tolist()}, {q.tolist()}, units {rows.tolist()}, {columns.tolist()}"
