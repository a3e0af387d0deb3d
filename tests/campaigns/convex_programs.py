"""Convex quadratic programs of every kind, solved and judged by their own conditions.

Run as ``python tests/campaigns/convex_programs.py --cases 200 --seed 0``. Answers are planted: x and multipliers come
first. Exit code 1 where a kind falls below 98 % or anything false is claimed.
"""

from __future__ import annotations

import argparse
import sys
import time
from typing import Any

import numpy as np
import scipy.sparse as sp

from lcp_plugin.conversions.qp_certificates import proof_of_no_minimum
from lcp_plugin.conversions.qp_proofs import QPInfeasibility, QPUnboundedness
from lcp_plugin.conversions.quadratic_program import QuadraticProgram
from lcp_plugin.modeling.qp_solver import solve_quadratic_program

SOLVABLE = (
    "strictly convex", "rank-deficient", "linear", "condition 1e8", "equations, free", "redundant", "degenerate",
    "badly scaled", "ranges",
)
KINDS = (*SOLVABLE, "infeasible", "unbounded")
TOLERANCE = 1e-6


def program(kind: str, rng: np.random.Generator, largest: int) -> QuadraticProgram:
    """Return a program of that kind with a planted optimal x (or none, for the last two kinds)."""
    n = int(rng.integers(2, max(3, largest)))
    p = int(rng.integers(0, n // 3 + 1)) if kind != "equations, free" else n // 2
    m = int(rng.integers(1, n + 1))
    P = hessian(kind, n, rng)
    integers = kind in ("degenerate", "infeasible", "unbounded")
    A, G = (sparse_rows(k, n, rng, integers) for k in (p, m))
    x = rng.integers(-2, 3, n).astype(float) if integers else rng.normal(size=n)
    state = np.full(n, 1) if kind == "equations, free" else rng.integers(0, 4, n)  # 0 at lower, 2 at upper, 3 free
    lower = np.where(state == 0, x, np.where(state == 3, -np.inf, x - 1.0))
    upper = np.where(state == 2, x, np.where(state == 3, np.inf, x + 1.0))
    if kind == "equations, free":
        lower, upper = np.full(n, -np.inf), np.full(n, np.inf)
    if kind == "redundant":
        A, G = repeated(A, rng), repeated(G, rng)
    active = rng.random(G.shape[0]) < (0.9 if kind == "degenerate" else 0.4)
    y = np.where(active & (rng.random(G.shape[0]) < (0.3 if kind == "degenerate" else 0.9)), 1.0, 0.0)
    y = y * rng.uniform(0.1, 2.0, y.size)
    v = rng.normal(size=A.shape[0])
    h = G @ x + np.where(active, 0.0, rng.uniform(0.1, 2.0, y.size))
    b = A @ x
    at_lower, at_upper = (np.where(state == s, rng.uniform(0.0, 2.0, n), 0.0) for s in (0, 2))
    if kind == "equations, free":
        at_lower = at_upper = np.zeros(n)
    c = -(P @ x + G.T @ y + A.T @ v - at_lower + at_upper)
    return finished(kind, (P, c, G, h, A, b, lower, upper), rng)


def hessian(kind: str, n: int, rng: np.random.Generator) -> Any:
    """Return P: dense or sparse, of the rank and condition number that the kind asks for."""
    if kind == "linear":
        return sp.csr_array((n, n))
    if kind == "condition 1e8":
        Q = np.linalg.qr(rng.normal(size=(n, n)))[0]
        P = Q * np.geomspace(1.0, 1e-8, n) @ Q.T
        return (P + P.T) / 2
    rank = n + 2 if kind in ("strictly convex", "badly scaled") else int(rng.integers(0, n // 2 + 1))
    factor = sp.random_array((n, rank), density=min(1.0, 4.0 / n + 0.02), rng=rng, format="csr") * 2.0
    if kind in ("infeasible", "unbounded"):
        factor = sp.csr_array(np.round(factor.toarray()))
    P = factor @ factor.T
    return sp.csr_array(P + (0.1 * sp.eye_array(n) if kind in ("strictly convex", "badly scaled") else 0.0 * P))


def sparse_rows(m: int, n: int, rng: np.random.Generator, integers: bool) -> sp.csr_array:
    """Return m rows with a few entries each."""
    rows = sp.random_array((m, n), density=min(1.0, 4.0 / n + 0.02), rng=rng, format="csr")
    rows.data = rng.integers(1, 4, rows.nnz) * rng.choice([-1.0, 1.0], rows.nnz) if integers else rng.normal(
        size=rows.nnz
    )
    return sp.csr_array(rows)


def repeated(rows: sp.csr_array, rng: np.random.Generator) -> sp.csr_array:
    """Return the rows with multiples and sums of them below."""
    if not rows.shape[0]:
        return rows
    mix = sp.csr_array(rng.integers(0, 2, (rows.shape[0] // 2 + 1, rows.shape[0])).astype(float))
    return sp.csr_array(sp.vstack([rows, mix @ rows, 3.0 * rows[:1]]))


def finished(kind: str, data: tuple[Any, ...], rng: np.random.Generator) -> QuadraticProgram:
    """Return the program, bent to its kind."""
    P, c, G, h, A, b, lower, upper = data
    n = c.size
    if kind == "badly scaled":
        rows, equations, columns = (10.0 ** rng.uniform(-3, 3, k) for k in (h.size, b.size, n))
        C = sp.diags_array(columns)
        P, c = C @ P @ C, columns * c
        G, h = sp.diags_array(rows) @ G @ C, rows * h
        A, b = sp.diags_array(equations) @ A @ C, equations * b
        lower, upper = lower / columns, upper / columns
    if kind == "ranges":
        low = np.concatenate([np.where(rng.random(h.size) < 0.5, h - 5.0, -1e20), b])
        high = np.concatenate([h, b])
        return QuadraticProgram.from_ranges(P, c, sp.vstack([G, A]), low, high, lower, upper)
    if kind == "infeasible":
        G, h = sp.vstack([G, -G.sum(axis=0)[None, :]]), np.append(h, -h.sum() - rng.uniform(1e-3, 2.0))
    if kind == "unbounded":
        # One more variable in both directions of a pair, which only the objective tells apart.
        P = sp.block_diag([P, np.zeros((2, 2))])
        c, lower, upper = np.append(c, [-1.0, 0.5]), np.append(lower, [0.0, 0.0]), np.append(upper, [np.inf] * 2)
        G, A = (sp.hstack([rows, rows[:, [0]], -rows[:, [0]]]) for rows in (G, A))
    return QuadraticProgram(P, c, G, h, A, b, lower, upper)


def error(program: QuadraticProgram, answer: Any) -> float:
    """Return the largest of the primal, dual and complementarity residuals, each relative to 1 + its largest term."""
    x, y, v = answer.x, answer.inequality, answer.equality
    G, A, P = (sp.csr_array(matrix) for matrix in (program.G, program.A, program.P))
    finite = np.isfinite(program.h)
    gap, below, above = (program.h - G @ x)[finite], x - program.lower, program.upper - x
    primal = max(np.max(np.maximum(-side, 0.0), initial=0.0) for side in (gap, below, above))
    primal = max(primal, np.abs(A @ x - program.b).max(initial=0.0))
    size = max(np.abs(part).max(initial=0.0) for part in (x, G @ x, program.b))
    terms = (P @ x, program.c, G.T @ y, A.T @ v, answer.lower, answer.upper)
    dual = np.abs(terms[0] + terms[1] + terms[2] + terms[3] - terms[4] + terms[5]).max(initial=0.0)
    products = [np.abs(y[finite] * gap)]
    for multiplier, side in ((answer.lower, below), (answer.upper, above)):
        products.append(np.abs(multiplier * np.where(np.isfinite(side), side, 0.0)))
    slack = max(product.max(initial=0.0) for product in products)
    signs = max(np.maximum(-part, 0.0).max(initial=0.0) for part in (y, answer.lower, answer.upper))
    largest = max(np.abs(term).max(initial=0.0) for term in terms)
    return float(max(primal / (1 + size), dual / (1 + largest), slack / (1 + size * largest), signs / (1 + largest)))


def judged(kind: str, case: QuadraticProgram, algorithm: Any) -> tuple[bool, bool]:
    """Return whether the case was settled, and whether something false was said."""
    _, answer = solve_quadratic_program(case, algorithm)
    if kind in SOLVABLE:
        right = error(case, answer) <= TOLERANCE
        return right and answer.is_optimal(TOLERANCE), answer.is_optimal(TOLERANCE) and not right
    if answer.is_optimal(TOLERANCE):
        return False, True
    proof = proof_of_no_minimum(case)
    expected = QPInfeasibility if kind == "infeasible" else QPUnboundedness
    return isinstance(proof, expected), proof is not None and not isinstance(proof, expected)


def main() -> int:
    """Run the campaign and print one line a kind."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--cases", type=int, default=200, help="of all kinds together")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--largest", type=int, default=60, help="variables")
    parser.add_argument("--algorithm", default="auto")
    parser.add_argument("--kind", default=None)
    options = parser.parse_args()
    failed = False
    print(f"{'kind':<18}{'settled':>12}{'false':>7}{'seconds':>9}{'slowest':>9}")
    for kind in (options.kind,) if options.kind else KINDS:
        count = max(1, options.cases // len(KINDS))
        settled = false = 0
        seconds = []
        for k in range(count):
            case = program(kind, np.random.default_rng([options.seed, k, KINDS.index(kind)]), options.largest)
            start = time.perf_counter()
            is_settled, is_false = judged(kind, case, options.algorithm)
            seconds.append(time.perf_counter() - start)
            settled, false = settled + is_settled, false + is_false
            if not is_settled:
                print(f"  {kind} seed {options.seed} case {k}: {case}")
        failed |= false > 0 or settled < 0.98 * count
        print(f"{kind:<18}{settled:>6}/{count:<5}{false:>7}{sum(seconds):>9.2f}{max(seconds):>9.2f}")
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
