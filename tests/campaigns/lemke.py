"""Lemke on random small integer problems of all kinds, against exhaustive enumeration in exact arithmetic.

Usage: ``python tests/campaigns/lemke.py --cases 3000 --seed 0``; the exit code is 1 on a false success, on
an unsolved problem of a class with a guarantee (P, PSD, copositive), or where less than 99.5 % of all solvable
problems are solved. Pivoting alone is not complete: what it misses (mostly rows that vanish identically) is left to the
exhaustive search.
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from fractions import Fraction
from itertools import product
from pathlib import Path

import numpy as np
from scipy.optimize import linprog

sys.path.insert(0, str(Path(__file__).parents[1]))

from exact import solve_fractions

from lcp_plugin import LCP, Certificate
from lcp_plugin.methods.lemke import Lemke

CLASSES = ("P", "PSD", "copositive", "indefinite", "nonnegative", "skew", "sparse", "degenerate")
GUARANTEED = ("P,", "PSD,", "copositive,")
BOUNDS = ("plain", "boxes", "free rows")


def matrix(kind: str, n: int, rng: np.random.Generator) -> np.ndarray:
    def integers(low: int, high: int) -> np.ndarray:
        return rng.integers(low, high + 1, size=(n, n))

    if kind == "P":
        M = integers(-2, 2)
        return M + np.diag(1 + np.abs(M).sum(axis=1)) if rng.random() < 0.5 else M @ M.T + np.eye(n)
    if kind == "PSD":
        J, S = rng.integers(-2, 3, size=(n, max(1, n // 2))), integers(-2, 2)
        return J @ J.T + (S - S.T if rng.random() < 0.5 else 0)
    if kind == "copositive":
        S = integers(-3, 3)
        return integers(0, 3) + np.eye(n) + S - S.T
    if kind == "nonnegative":
        return integers(0, 2)
    if kind == "skew":
        S = integers(-2, 2)
        return S - S.T
    if kind == "sparse":
        return integers(-3, 3) * (rng.random((n, n)) < 0.4)
    return integers(-1, 1) if kind == "degenerate" else integers(-4, 4)


def problem(kind: str, bounds: str, n: int, rng: np.random.Generator) -> LCP:
    q = rng.integers(-2, 2, size=n) if kind == "degenerate" else rng.integers(-6, 5, size=n)
    lower, upper = np.zeros(n), np.full(n, np.inf)
    if bounds == "boxes":
        lower = rng.integers(-3, 1, size=n).astype(float)
        upper = lower + rng.integers(0, 4, size=n)
        lower[rng.random(n) < 0.2] = -np.inf
        upper[rng.random(n) < 0.4] = np.inf
    if bounds == "free rows":
        lower[rng.random(n) < 0.4] = -np.inf
    return LCP(matrix(kind, n, rng).astype(float), q, lower=lower, upper=upper)


def is_solvable(lcp: LCP) -> bool:
    """Whether any cell holds a solution: regular cells in fractions, singular ones by a linear program."""
    n, M = lcp.n, lcp.csr.toarray()
    choices = [
        [side for side, bound in (("l", lcp.lower[i]), ("u", lcp.upper[i]), ("b", 0.0)) if np.isfinite(bound)]
        for i in range(n)
    ]
    F = [[Fraction(v) for v in row] for row in M]
    singular = []
    for cell in product(*choices):
        inner = [i for i in range(n) if cell[i] == "b"]
        z = [Fraction(0) if s == "b" else Fraction(lcp.lower[i] if s == "l" else lcp.upper[i])
             for i, s in enumerate(cell)]
        w = [Fraction(lcp.q[i]) + sum(F[i][j] * z[j] for j in range(n)) for i in range(n)]
        solved = solve_fractions([[F[i][j] for j in inner] for i in inner], [-w[i] for i in inner])
        if solved is None:
            singular.append(cell)
            continue
        for i, value in zip(inner, solved, strict=True):
            z[i] = value
        w = [Fraction(lcp.q[i]) + sum(F[i][j] * z[j] for j in range(n)) for i in range(n)]
        if all(lcp.lower[i] <= z[i] <= lcp.upper[i] for i in inner) and all(
            cell[i] == "b" or (w[i] >= 0 if cell[i] == "l" else w[i] <= 0) or lcp.lower[i] == lcp.upper[i]
            for i in range(n)
        ):
            return True
    return any(has_point(lcp, M, cell) for cell in singular)


def has_point(lcp: LCP, M: np.ndarray, cell: tuple[str, ...]) -> bool:
    at_lower, at_upper = np.array([s == "l" for s in cell]), np.array([s == "u" for s in cell])
    inner = ~at_lower & ~at_upper
    is_fixed = lcp.lower == lcp.upper
    z_low = np.where(at_upper, lcp.upper, lcp.lower)
    z_high = np.where(at_lower, lcp.lower, lcp.upper)
    signs = np.where(at_upper, 1.0, -1.0)[(at_lower | at_upper) & ~is_fixed]
    signed = (at_lower | at_upper) & ~is_fixed
    answer = linprog(
        np.zeros(lcp.n), A_ub=signs[:, None] * M[signed] if signed.any() else None,
        b_ub=-signs * lcp.q[signed] if signed.any() else None, A_eq=M[inner], b_eq=-lcp.q[inner],
        bounds=np.column_stack([z_low, z_high]),
    )
    return bool(answer.status == 0)


def residual(lcp: LCP) -> float:
    """The smallest relative residual on the way."""
    return min(
        Certificate.of(lcp, step.z).relative_residual for step in Lemke().iterates(lcp, lcp.nearest_to_zero.copy())
    )


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cases", type=int, default=3000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--largest", type=int, default=5)
    given = parser.parse_args()
    rng = np.random.default_rng(given.seed)
    solvable, solved, false = Counter[str](), Counter[str](), 0
    for case in range(given.cases):
        kind, bounds = CLASSES[case % len(CLASSES)], BOUNDS[case // len(CLASSES) % len(BOUNDS)]
        lcp = problem(kind, bounds, int(rng.integers(1, given.largest + 1)), rng)
        found = residual(lcp) <= 1e-9
        if found:
            solvable[f"{kind}, {bounds}"] += 1
            solved[f"{kind}, {bounds}"] += 1
            if not is_solvable(lcp):
                false += 1
                print(f"case {case}: false success")
        elif is_solvable(lcp):
            solvable[f"{kind}, {bounds}"] += 1
            print(f"case {case} ({kind}, {bounds}): not solved {lcp.csr.toarray().tolist()} {lcp.q.tolist()} "
                  f"{lcp.lower.tolist()} {lcp.upper.tolist()}")
    for name in sorted(solvable):
        print(f"{name:<28} {solved[name]:>5} of {solvable[name]:>5} solvable")
    total = solvable.total()
    print(f"{'all':<28} {solved.total():>5} of {total:>5} solvable, {given.cases} cases, {false} false")
    broken = [name for name in solvable if name.startswith(GUARANTEED) and solved[name] < solvable[name]]
    return int(false > 0 or bool(broken) or solved.total() < 0.995 * total)


if __name__ == "__main__":
    sys.exit(main())
