"""Near-singular matrices, bounds one ulp apart, references that vanish: false SOLVED at the rounding level.

A false claim is a SOLVED whose exact residual exceeds the tolerance times the exact reference, a PRECISION_LIMIT that
rounding does not explain, or an INFEASIBLE or NO_SOLUTION of a problem with a solution.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
from collection.judgement import false_claim
from collection.truth import SOLVABLE
from oracles.exact import exact_solution

from lcp_plugin import LCP, solve
from lcp_plugin.algorithms import REGISTRY
from lcp_plugin.core.errors import UnsuitableMatrix, UnsuitableProblem

Generator = np.random.Generator
ALGORITHMS = ("auto", *REGISTRY)
TOLERANCE = 1e-8
STEPS = 120  # of a named algorithm


# --- The problems ---------------------------------------------------------------------------------------------------


def near(value: float, rng: Generator) -> float:
    """A double some units of the last place, or some bits more, below a positive one."""
    return value - value * 2.0 ** -int(rng.integers(20, 53)) * int(rng.integers(0, 4))


def pair(rng: Generator) -> LCP:
    """Two rows that are nearly each other's negative."""
    a = float(rng.integers(1, 9))
    M = np.array([[a, -near(a, rng)], [-near(a, rng), a]])
    return LCP(M, rng.integers(-4, 5, 2).astype(float))


def cyclic(rng: Generator) -> LCP:
    """A cyclic Z-matrix whose determinant nearly vanishes."""
    n = int(rng.integers(2, 9))
    d = rng.integers(1, 6, n).astype(float)
    M = np.diag(d)
    for i in range(n):
        M[i, (i + 1) % n] = -near(d[i], rng)
    return LCP(M, rng.integers(-4, 5, n).astype(float))


def balanced(rng: Generator) -> LCP:
    """Two rows that are nearly each other's negative, and so is q: a short z leaves a small residual."""
    M, k = pair(rng).csr.toarray(), float(rng.integers(1, 9))
    return LCP(M, [-k, k * (1.0 - 2.0 ** -int(rng.integers(20, 45)))])


def reducible(rng: Generator) -> LCP:
    """Blocks that are nearly singular, each fed by the one before."""
    blocks = [pair(rng).csr.toarray() for _ in range(int(rng.integers(1, 5)))]
    n = 2 * len(blocks)
    M = np.zeros((n, n))
    for k, block in enumerate(blocks):
        M[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = block
        M[2 * k : 2 * k + 2, : 2 * k] = -rng.integers(0, 3, (2, 2 * k))
    return LCP(M, rng.integers(-4, 5, n).astype(float))


def one_ulp(rng: Generator) -> LCP:
    """Rows held between bounds that are equal, or next to each other, and so large that sums of them cancel."""
    n = int(rng.integers(2, 7))
    M = np.diag(rng.integers(1, 5, n)).astype(float)
    M[0, 1:] = rng.integers(-3, 4, n - 1)
    lower, upper = np.zeros(n), np.full(n, np.inf)
    lower[1:] = np.ldexp(rng.integers(1, 2**20, n - 1).astype(float), rng.integers(20, 45, n - 1))
    upper[1:] = np.where(rng.random(n - 1) < 0.5, lower[1:], np.nextafter(lower[1:], np.inf))
    if n > 2 and rng.random() < 0.7:  # the last is nearly what cancels the others
        lower[-1] = upper[-1] = abs(M[0, 1:-1] @ lower[1:-1]) + float(rng.integers(-2, 3)) * 8.0
        M[0, -1] = -np.sign(M[0, 1:-1] @ lower[1:-1] or 1.0)
    return LCP(M, rng.integers(-3, 4, n).astype(float), lower=np.minimum(lower, upper), upper=upper)


def vanishing(rng: Generator) -> LCP:
    """The nearest point to 0 solves the problem but for some rounding: nothing is left to be relative to."""
    n = int(rng.integers(2, 7))
    M = rng.integers(-3, 4, (n, n)).astype(float) + np.diag(rng.integers(2, 9, n))
    M *= rng.choice([1.0, 0.1, 1.0 / 3.0])
    lower = rng.integers(1, 99, n) * rng.choice([1.0, 0.1, 1e15])
    q = -(M @ lower)
    q *= 1.0 + rng.integers(-1, 2, n) * 2.0**-52
    return LCP(M, q, lower=lower)


def graded(rng: Generator) -> LCP:
    """A near-singular problem in other units of its rows and of z."""
    problem = (pair, cyclic, reducible)[int(rng.integers(3))](rng)
    rows = np.exp2(rng.integers(-30, 31, problem.n))
    unit = 2.0 ** int(rng.integers(-60, 61))
    return LCP(problem.csr.toarray() * rows[:, None] * unit, problem.q * rows)


KINDS: dict[str, Callable[[Generator], LCP]] = {
    each.__name__: each for each in (pair, cyclic, balanced, reducible, one_ulp, vanishing, graded)
}


# --- The judgement ----------------------------------------------------------------------------------------------------


def judged(kind: str, rng: Generator) -> Iterator[str]:
    """Solve one problem by each algorithm; yield false claims."""
    problem = KINDS[kind](rng)
    for name in ALGORITHMS:
        limit = {} if name == "auto" else {"max_iterations": STEPS}
        try:
            result = solve(problem, name, tolerance=TOLERANCE, **limit)
        except (UnsuitableMatrix, UnsuitableProblem):
            continue
        truth = _solvable(problem) or result_truth(result.status.name)
        if wrong := false_claim(problem, truth, result, TOLERANCE):
            yield f"{name}: {wrong}"


def _solvable(problem: LCP) -> str:
    """SOLVABLE if active sets in rational arithmetic find a solution."""
    try:
        return SOLVABLE if problem.n <= 6 and exact_solution(problem).z else ""
    except ValueError:
        return ""


def result_truth(status: str) -> str:
    """A truth that contradicts no status, where none is known."""
    return {"INFEASIBLE": "infeasible", "NO_SOLUTION": "no solution"}.get(status, SOLVABLE)
