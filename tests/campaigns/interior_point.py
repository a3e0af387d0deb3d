"""Interior point on random monotone problems and convex programs with known answers; exit code 1 on any violation.

Run as ``python tests/campaigns/interior_point.py --cases 2000 --seed 0``. A linear complementarity problem must end
SOLVED at 1e-9 (or PRECISION_LIMIT, or with a residual at rounding level); a program must have KKT residual ≤ 1e-6.
"""

from __future__ import annotations

import argparse
import collections
import sys
from typing import Any

import numpy as np
import scipy.sparse as sp

from lcp_plugin import LCP, solve
from lcp_plugin.core.settings import Status
from lcp_plugin.methods.interior_point import InteriorPoint
from lcp_plugin.problems.programs.conversion import QuadraticProgram, lcp_from_qp

MATRICES = ("definite", "rank-deficient", "integer", "nonsymmetric", "skew", "zero")
PROGRAMS = (
    "strictly convex",
    "rank-deficient P",
    "P = 0",
    "κ(P) = 1e8",
    "equations, free",
    "redundant",
    "degenerate",
)


def monotone_matrix(kind: str, n: int, rng: np.random.Generator) -> Any:
    """A monotone matrix of the kind, with a random share of zeros."""
    B = rng.standard_normal((n, n)) * (rng.random((n, n)) < rng.choice([0.2, 1.0]))
    half = B[:, : max(1, n // 2)]
    if kind == "definite":
        return B @ B.T + 0.1 * np.eye(n)
    if kind == "rank-deficient":
        return half @ half.T
    if kind == "integer":
        return np.rint(half) @ np.rint(half).T
    if kind == "nonsymmetric":
        return half @ half.T + B - B.T
    return B - B.T if kind == "skew" else np.zeros((n, n))


def problem_with_answer(kind: str, rng: np.random.Generator) -> LCP:
    """An LCP with chosen z and w: bounds of all sorts, degenerate rows, scales over four decades."""
    n = int(rng.choice([0, 1, 2, 3, 5, 10, 30, 80]))
    M = monotone_matrix(kind, n, rng)
    lower, upper = np.zeros(n), np.full(n, np.inf)
    if rng.random() < 0.6:
        row = rng.integers(0, 5, n)
        lower = np.where(row <= 1, -np.inf, rng.integers(-3, 3, n).astype(float))
        upper = np.where(
            (row == 1) | (row == 2), np.inf, np.where(row == 0, 1.0, lower + rng.integers(0, 4, n))
        )
        upper = np.where(row == 4, lower, upper)
    bound = np.where(rng.random(n) < 0.5, lower, upper)
    z = np.where(
        (rng.random(n) < 0.5) & np.isfinite(bound),
        bound,
        np.clip(2.0 * rng.random(n), lower, upper),
    )
    size = np.where(rng.random(n) < rng.choice([0.0, 0.3]), 0.0, rng.random(n))
    w = np.where(z == lower, size, 0.0) - np.where((z == upper) & (z != lower), size, 0.0)
    q = w - M @ z
    c = 10.0 ** (rng.choice([0.0, 0.0, 2.0]) * rng.uniform(-1.0, 1.0, n))
    M = M * c[:, None] * c
    return LCP(
        sp.csr_array(M) if rng.random() < 0.5 else M, q * c, lower=lower / c, upper=upper / c
    )


def quadratic_part(kind: str, n: int, density: float, rng: np.random.Generator) -> Any:
    """P of the kind of program."""
    if kind == "P = 0":
        return sp.csr_array((n, n))
    if kind == "κ(P) = 1e8":
        vectors, _ = np.linalg.qr(rng.standard_normal((n, n)))
        P = (vectors * np.geomspace(1.0, 1e-8, n)) @ vectors.T
        return 0.5 * (P + P.T)
    rows = max(1, n // 3) if kind == "rank-deficient P" else n
    B = sp.csr_array(sp.random_array((rows, n), density=density, rng=rng))
    return sp.csr_array(B.T @ B) if rows < n else sp.csr_array(B.T @ B + 0.1 * sp.eye_array(n))


def program_with_answer(kind: str, largest: int, rng: np.random.Generator) -> QuadraticProgram:
    """A convex program whose solution and multipliers were chosen first."""
    n = int(rng.integers(2, largest))
    density = float(rng.choice([1.0, 0.3, 0.1])) if n < 200 else 10.0 / n
    has_equations = kind not in ("strictly convex", "κ(P) = 1e8")
    m, p = int(rng.integers(1, n + 1)), int(rng.integers(0, n // 3 + 1)) if has_equations else 0
    P = quadratic_part(kind, n, density, rng) * 10.0 ** rng.integers(-3, 4)
    normal = {"density": density, "rng": rng, "data_sampler": lambda size: rng.normal(size=size)}
    G, A = (sp.csr_array(sp.random_array((rows, n), **normal)) for rows in (m, p))
    if kind == "redundant":
        A = sp.csr_array(sp.vstack([A, 2.0 * A[: p // 2], A[: p // 3]]))
        G = sp.csr_array(sp.vstack([G, G[:1], 2.0 * G[: m // 2]]))
    is_bounded = kind != "equations, free"
    lower = np.where((rng.random(n) < 0.6) & is_bounded, 0.0, -np.inf)
    upper = np.where((rng.random(n) < 0.3) & is_bounded, 2.0 * rng.random(n), np.inf)
    x = np.where(
        (rng.random(n) < 0.4) & np.isfinite(lower),
        lower,
        np.clip(rng.standard_normal(n), lower, upper),
    )
    held = rng.random(G.shape[0]) < 0.5
    multiplier, gap = (
        np.where(held, rng.random(held.size), 0.0),
        np.where(held, 0.0, rng.random(held.size)),
    )
    if kind == "degenerate":
        multiplier, gap = (
            multiplier * (rng.random(held.size) < 0.5),
            gap * (rng.random(held.size) < 0.5),
        )
    pull = np.where(x == lower, rng.random(n), 0.0) - np.where(
        (x == upper) & (x != lower), rng.random(n), 0.0
    )
    c = pull - P @ x - G.T @ multiplier - A.T @ rng.standard_normal(A.shape[0])
    return QuadraticProgram(P, c, G, G @ x + gap, A, A @ x, lower, upper)


def main() -> int:
    """Run both campaigns and print a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cases", type=int, default=2000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--largest", type=int, default=60, help="variables of a program")
    options = parser.parse_args()
    count: collections.Counter[str] = collections.Counter()
    failed: dict[str, list[int]] = collections.defaultdict(list)
    for case in range(options.cases):
        rng = np.random.default_rng([options.seed, case])
        kind = f"LCP, {MATRICES[case % len(MATRICES)]}"
        result = solve(
            problem_with_answer(MATRICES[case % len(MATRICES)], rng),
            InteriorPoint(),
            tolerance=1e-9,
        )
        count[kind] += 1
        is_solved = result.status in (Status.SOLVED, Status.PRECISION_LIMIT)
        if not is_solved and not result.certificate.is_at_rounding_level:
            failed[kind].append(case)
        kind = f"QP, {PROGRAMS[case % len(PROGRAMS)]}"
        problem = lcp_from_qp(
            program_with_answer(PROGRAMS[case % len(PROGRAMS)], options.largest, rng), "kkt"
        )
        solution = problem.origin.recover(solve(problem, InteriorPoint(), tolerance=1e-9))
        count[kind] += 1
        if not solution.is_optimal(1e-6):
            failed[kind].append(case)
    for kind in sorted(count):
        good = count[kind] - len(failed[kind])
        print(f"{kind:<24} {good:6d} of {count[kind]:6d}   failed cases: {failed[kind][:10]}")
    return 1 if any(failed.values()) else 0


if __name__ == "__main__":
    sys.exit(main())
