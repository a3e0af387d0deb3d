"""Newton on random small problems of all kinds against exact enumeration: ``python tests/campaigns/newton.py``.

Prints, for each kind of matrix, how many problems are solvable and how many of these Newton solves; exit code 1 on a
false SOLVED, or where less than everything is solved on the kinds with a proof.
"""

from __future__ import annotations

import argparse
import itertools
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import linprog

sys.path.insert(0, str(Path(__file__).parents[1]))

from collection.truth import ExactData

from lcp_plugin import LCP, Status, solve
from lcp_plugin.methods.newton.semismooth_newton import Newton

TOLERANCE = 1e-9
PROVEN = ("P", "H+", "PSD", "PSD singular, q in range")
KINDS = (*PROVEN, "PSD singular", "skew + PSD", "indefinite", "bimatrix", "nonnegative", "zeros")


def matrix(kind: str, n: int, rng: np.random.Generator) -> np.ndarray:
    """A matrix of integers of the kind; P by rejection."""
    draw = rng.integers(-3, 4, size=(n, n)).astype(float)
    low = rng.integers(-2, 3, size=(n, max(1, n // 2))).astype(float)
    if kind == "P":
        while not is_p(draw):
            draw = rng.integers(-3, 4, size=(n, n)) + np.diag(rng.integers(1, 5, size=n)).astype(float)
        return draw
    if kind == "H+":
        np.fill_diagonal(draw, 0.0)
        return draw + np.diag(abs(draw).sum(axis=1) + rng.integers(1, 3, size=n))
    if kind == "PSD":
        return draw @ draw.T + np.eye(n)
    if kind.startswith("PSD singular"):
        return low @ low.T
    if kind == "skew + PSD":
        return np.triu(draw, 1) - np.triu(draw, 1).T + low @ low.T
    if kind == "bimatrix":
        half = n // 2
        M = np.zeros((n, n))
        M[:half, half:] = rng.integers(1, 5, size=(half, n - half))
        M[half:, :half] = rng.integers(1, 5, size=(n - half, half))
        return M
    if kind == "nonnegative":
        return abs(draw)
    if kind == "zeros":
        return draw * (rng.random((n, n)) < 0.4)
    return draw


def is_p(M: np.ndarray) -> bool:
    """Whether all principal minors are positive (integers, so that the determinants round correctly)."""
    n = M.shape[0]
    sets = (list(s) for k in range(1, n + 1) for s in itertools.combinations(range(n), k))
    return all(round(np.linalg.det(M[np.ix_(s, s)])) > 0 for s in sets)


def random_problem(kind: str, rng: np.random.Generator) -> LCP:
    """A problem with integer data: plain, one-sided, boxed, free and fixed rows."""
    n = int(rng.integers(1, 5))
    M = matrix(kind, n, rng)
    q = -M @ rng.integers(-2, 3, size=n) if kind.endswith("in range") else rng.integers(-5, 6, size=n).astype(float)
    lower, upper = np.zeros(n), np.full(n, np.inf)
    if kind == "bimatrix":
        q = -np.ones(n)
    elif rng.random() < 0.5 and not kind.endswith("in range"):
        shape = rng.integers(0, 5, size=n)
        width = rng.integers(1, 4, size=n)
        lower = np.where((shape == 1) | (shape == 3), -np.inf, -1.0)
        upper = np.where(shape == 2, lower + width, np.where(shape == 3, 1.0, np.where(shape == 4, lower, np.inf)))
    return LCP(M, q, lower=lower, upper=upper)


def active_sets(problem: LCP) -> Iterator[tuple[str, ...]]:
    """All combinations of "l", "u" and "f" that the bounds allow."""
    choices = [
        "f" + "l" * bool(np.isfinite(lower)) + "u" * bool(np.isfinite(upper))
        for lower, upper in zip(problem.lower, problem.upper, strict=True)
    ]
    return itertools.product(*choices)


def is_solvable(problem: LCP) -> bool:
    """Whether some active set has a feasible point: one linear program each, shared with nobody."""
    M, n = problem.csr.toarray(), problem.n
    for sides in active_sets(problem):
        bounds: list[tuple[Any, Any]] = []
        above, below, equal = [], [], []
        for i, side in enumerate(sides):
            lower, upper = problem.lower[i], problem.upper[i]
            bounds.append({"l": (lower, lower), "u": (upper, upper)}.get(side, (lower, upper)))
            if lower != upper:
                {"l": above, "u": below, "f": equal}[side].append(i)
        inequality = np.vstack([-M[above], M[below]])
        limit = np.concatenate([problem.q[above], -problem.q[below]])
        found = linprog(
            np.zeros(n), inequality if limit.size else None, limit if limit.size else None,
            M[equal] if equal else None, -problem.q[equal] if equal else None, bounds, method="highs",
        )
        if found.status == 0:
            return True
    return False


def main() -> int:
    """Run the campaign and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cases", type=int, default=2000)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    rng = np.random.default_rng(options.seed)
    table = {kind: {"cases": 0, "solvable": 0, "solved": 0, "false": 0} for kind in KINDS}
    for case in range(options.cases):
        kind = KINDS[case % len(KINDS)]
        problem = random_problem(kind, rng)
        z0 = rng.integers(-9, 10, size=problem.n).astype(float) if case % 3 else None
        result = solve(problem, Newton(), z0=z0, tolerance=TOLERANCE)
        row = table[kind]
        row["cases"] += 1
        is_solved = result.status is Status.SOLVED
        row["false"] += is_solved and ExactData(problem).is_lie(result.z, TOLERANCE)
        row["solved"] += is_solved
        row["solvable"] += is_solved or is_solvable(problem)
    print(f"{'kind':<26}{'cases':>7}{'solvable':>10}{'solved':>8}{'false':>7}")
    for kind, row in table.items():
        print(f"{kind:<26}{row['cases']:>7}{row['solvable']:>10}{row['solved']:>8}{row['false']:>7}")
    is_missed = any(table[kind]["solved"] < table[kind]["solvable"] for kind in PROVEN)
    return 1 if is_missed or any(row["false"] for row in table.values()) else 0


if __name__ == "__main__":
    sys.exit(main())
