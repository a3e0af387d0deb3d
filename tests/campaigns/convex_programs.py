"""Convex quadratic programs of every kind, solved and judged by their own conditions.

Run as ``python tests/campaigns/convex_programs.py --cases 200 --seed 0``. Answers are planted: x and multipliers come
first, and the value at x has to be met; but for the two kinds of duals, which are judged by their conditions alone.
False is an "optimal" that is none, or a refutation of a program that has a minimum, looked for in every case. Exit code
1 where fewer than 99.5 % of all or 98 % of a kind are settled, or anything false is claimed.
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
from lcp_plugin.solving.quadratic_program import solve_quadratic_program

PLANTED = (
    "strictly convex", "rank-deficient", "linear", "condition 1e8", "condition 1e10", "equations, free", "redundant",
    "degenerate", "badly scaled", "ranges", "dense", "chain", "stable MPC", "unstable MPC",
)
DUALS = ("SVM dual", "portfolio dual")
SOLVABLE = (*PLANTED, *DUALS)
KINDS = (*SOLVABLE, "infeasible", "unbounded")
INTEGERS = ("degenerate", "infeasible", "unbounded")
TOLERANCE = 1e-6
STATES, INPUTS = 4, 2  # of a system that is controlled


def program(kind: str, rng: np.random.Generator, largest: int) -> QuadraticProgram:
    """Return a program of that kind."""
    return planted(kind, rng, largest)[0]


def planted(kind: str, rng: np.random.Generator, largest: int) -> tuple[QuadraticProgram, float]:
    """Return a program of that kind and its minimum, NaN where it has none or nobody knows it."""
    if kind in DUALS:
        return dual(kind, int(rng.integers(2, max(3, largest))), rng), np.nan
    P, A, G = matrices(kind, int(rng.integers(2, max(3, largest))), rng)
    n, integers = P.shape[0], kind in INTEGERS
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
    value = 0.5 * x @ (P @ x) + c @ x if kind in PLANTED else np.nan
    return finished(kind, (P, c, G, h, A, b, lower, upper), rng), float(value)


def matrices(kind: str, n: int, rng: np.random.Generator) -> tuple[Any, Any, Any]:
    """Return P, A and G."""
    if kind == "dense":
        factor = rng.normal(size=(n, n + 2))
        return factor @ factor.T / n, rng.normal(size=(n // 4, n)), rng.normal(size=(n, n))
    if kind == "chain":  # convex functions on n points
        return sp.eye_array(n), sp.csr_array((0, n)), sp.diags_array([-1.0, 2.0, -1.0], offsets=[0, 1, 2], shape=(n, n))
    if kind.endswith("MPC"):
        return predictive_control(max(2, n // 4), 0.95 if kind == "stable MPC" else 1.5, rng)
    p = int(rng.integers(0, n // 3 + 1)) if kind != "equations, free" else n // 2
    m = int(rng.integers(1, n + 1))
    P = hessian(kind, n, rng)
    A, G = (sparse_rows(k, n, rng, kind in INTEGERS) for k in (p, m))
    return P, A, G


def predictive_control(steps: int, radius: float, rng: np.random.Generator) -> tuple[Any, Any, Any]:
    """Return P, A and G of a linear system with that spectral radius; unknowns are its states, then its inputs."""
    move, push = rng.normal(size=(STATES, STATES)), rng.normal(size=(STATES, INPUTS))
    move *= radius / np.abs(np.linalg.eigvals(move)).max()
    here, before = sp.eye_array(steps), sp.eye_array(steps, k=-1)
    A = sp.hstack([
        sp.kron(here, sp.eye_array(STATES)) - sp.kron(before, sp.csr_array(move)), -sp.kron(here, sp.csr_array(push))
    ])
    weights = np.repeat([1.0, 0.1], [steps * STATES, steps * INPUTS])
    return sp.diags_array(weights).tocsr(), sp.csr_array(A), sp.csr_array((0, weights.size))


def dual(kind: str, n: int, rng: np.random.Generator) -> QuadraticProgram:
    """Return the dual of a support vector machine, or that of a portfolio with factors: no planted answer."""
    if kind == "SVM dual":
        label = rng.choice([-1.0, 1.0], n)
        label[:2] = 1.0, -1.0
        points = label[:, None] * (rng.normal(size=(n, 3)) + label[:, None])
        return QuadraticProgram(
            points @ points.T, -np.ones(n), A=label[None, :], b=[0.0], lower=0.0, upper=10.0 ** rng.uniform(-2, 2)
        )
    # max ν − ½ vᵀΣ⁻¹v, v = μ + ν 1 + λ, λ ≥ 0, of min ½ xᵀΣ x − μᵀx, x ≥ 0, Σ x = 1.
    factors = rng.normal(size=(n, 3))
    inverse = np.linalg.inv(factors @ factors.T + np.diag(rng.uniform(0.01, 1.0, n)))
    E, mean = np.column_stack([np.eye(n), np.ones(n)]), rng.normal(size=n)
    P = E.T @ inverse @ E
    c = E.T @ inverse @ mean - np.append(np.zeros(n), 1.0)
    return QuadraticProgram((P + P.T) / 2, c, lower=np.append(np.zeros(n), -np.inf))


def hessian(kind: str, n: int, rng: np.random.Generator) -> Any:
    """Return P: dense or sparse, of the rank and condition number that the kind asks for."""
    if kind == "linear":
        return sp.csr_array((n, n))
    if kind.startswith("condition"):
        Q = np.linalg.qr(rng.normal(size=(n, n)))[0]
        P = Q * np.geomspace(1.0, 1.0 / float(kind.split()[1]), n) @ Q.T
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


def judged(kind: str, case: QuadraticProgram, value: float, algorithm: Any) -> tuple[bool, bool]:
    """Return whether the case was settled, and whether something false was said."""
    _, answer = solve_quadratic_program(case, algorithm)
    if kind in SOLVABLE:
        misses = abs(answer.objective - value) > TOLERANCE * (1.0 + abs(value))  # never of a value that is NaN
        right = error(case, answer) <= TOLERANCE and not misses
        is_false = (answer.is_optimal(TOLERANCE) and not right) or case.refutation(TOLERANCE) is not None
        return right and answer.is_optimal(TOLERANCE), is_false
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
    failed, settled_of_all, all_cases = False, 0, 0
    print(f"{'kind':<18}{'settled':>12}{'false':>7}{'seconds':>9}{'slowest':>9}")
    for kind in (options.kind,) if options.kind else KINDS:
        count = max(1, options.cases // len(KINDS))
        settled = false = 0
        seconds = []
        for k in range(count):
            case, value = planted(kind, np.random.default_rng([options.seed, k, KINDS.index(kind)]), options.largest)
            start = time.perf_counter()
            is_settled, is_false = judged(kind, case, value, options.algorithm)
            seconds.append(time.perf_counter() - start)
            settled, false = settled + is_settled, false + is_false
            if not is_settled or is_false:
                print(f"  {kind} seed {options.seed} case {k}: {case}{', false' if is_false else ''}")
        failed |= false > 0 or settled < 0.98 * count
        settled_of_all, all_cases = settled_of_all + settled, all_cases + count
        print(f"{kind:<18}{settled:>6}/{count:<5}{false:>7}{sum(seconds):>9.2f}{max(seconds):>9.2f}", flush=True)
    print(f"{'all':<18}{settled_of_all:>6}/{all_cases}")
    return int(failed or settled_of_all < 0.995 * all_cases)


if __name__ == "__main__":
    sys.exit(main())
