"""Ordinary problems: does the default solve them at the first try?

LCPs with a planted solution, and programs stated in cvxpy, whose values Clarabel confirms. A problem with a solution
that auto leaves unsolved is given to each named method with ten times auto's time.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import cvxpy as cp
import numpy as np
import scipy.sparse as sp

import lcp_plugin
from lcp_plugin import LCP, Result, Status, solve
from lcp_plugin.problems.reformulations.bimatrix_game import lcp_from_bimatrix_game

NAMED = ("newton", "lemke", "interior_point", "psor", "npsor")
TIMES, MIN_SECONDS = 10.0, 0.05  # of auto's time a named method gets; seconds
VALUE = 1e-5  # relative difference of two values of an objective
RNG = np.random.Generator


# --- complementarity problems with a planted solution ---------------------------------------------------------


def planted(rng: RNG, M: Any, *, degenerate: float = 0.2, bounds: bool = True) -> LCP:
    """The problem of M that has a random answer; some rows have neither distance nor slack."""
    n = M.shape[0]
    kind = rng.choice(["zero", "box", "free"], n, p=[0.7, 0.2, 0.1] if bounds else [1.0, 0.0, 0.0])
    z, at = np.abs(rng.standard_normal(n)), rng.random(n)
    lower = np.select([kind == "zero", kind == "free"], [0.0, -np.inf], -1.0)
    upper = np.where(kind == "box", 2.0, np.inf)
    z = np.where(at < 0.4, lower, np.where((at > 0.8) & (kind == "box"), upper, np.minimum(z, 1.9)))
    z = np.where(kind == "free", rng.standard_normal(n), z)
    slack = np.where(rng.random(n) < degenerate, 0.0, np.abs(rng.standard_normal(n)))
    w = np.where(
        kind == "free", 0.0, np.where(z == lower, slack, np.where(z == upper, -slack, 0.0))
    )
    return LCP(M, w - M @ z, lower=lower, upper=upper)


def size(rng: RNG, most: int = 60) -> int:
    return int(2 * (most / 2) ** rng.random())


def definite(rng: RNG) -> LCP:
    n = size(rng)
    A = rng.standard_normal((n, n))
    return planted(rng, A @ A.T + 10.0 ** rng.uniform(-3, 0) * np.eye(n))


def semidefinite(rng: RNG) -> LCP:
    n = size(rng)
    A = rng.standard_normal((n, max(n // 2, 1)))
    return planted(rng, A @ A.T)


def monotone(rng: RNG) -> LCP:
    n = size(rng)
    A, K = rng.standard_normal((n, max(n // 2, 1))), rng.standard_normal((n, n))
    return planted(rng, A @ A.T + K - K.T)


def h_plus(rng: RNG) -> LCP:
    n = size(rng, 300)
    M = sp.random_array(
        (n, n), density=min(1.0, 4.0 / n), rng=rng, format="csr", data_sampler=rng.normal
    )
    return planted(
        rng, sp.csr_array(M + sp.diags_array(0.1 + np.asarray(abs(M).sum(axis=1)).ravel()))
    )


def p_matrix(rng: RNG) -> LCP:
    n = size(rng, 30)
    M = np.triu(rng.standard_normal((n, n)), 1) + np.diag(rng.uniform(0.1, 2.0, n))
    order = rng.permutation(n)
    return planted(rng, M[np.ix_(order, order)])


def triangular(rng: RNG) -> LCP:
    n = size(rng, 30)
    diagonal = np.abs(rng.standard_normal(n)) * (rng.random(n) < 0.7)
    return planted(
        rng,
        np.tril(rng.standard_normal((n, n)), -1) + np.diag(diagonal),
        bounds=False,
        degenerate=0.5,
    )


def block_triangular(rng: RNG) -> LCP:
    n, cut = size(rng, 30) + 2, 0
    M = np.tril(rng.standard_normal((n, n)), -1)
    while cut < n:
        k = min(int(rng.integers(1, 5)), n - cut)
        A = rng.standard_normal((k, k)) * (rng.random() < 0.8)
        M[cut : cut + k, cut : cut + k] = A @ A.T
        cut += k
    return planted(rng, M, bounds=False)


def contact(rng: RNG) -> LCP:
    """Bodies on the ground and on each other, without friction: J M⁻¹ Jᵀ, with more contacts than freedoms."""
    bodies = int(rng.integers(1, 6))
    contacts = int(rng.integers(bodies, 4 * bodies + 1))
    J = rng.standard_normal((contacts, 3 * bodies)) * (rng.random((contacts, 3 * bodies)) < 0.7)
    J = J[np.abs(J).sum(axis=1) > 0.0]
    return planted(
        rng,
        J @ np.diag(1.0 / rng.uniform(0.1, 10.0, 3 * bodies)) @ J.T,
        bounds=False,
        degenerate=0.5,
    )


def game(rng: RNG) -> LCP:
    m, k = int(rng.integers(2, 9)), int(rng.integers(2, 9))
    A, B = (rng.integers(0, 10, (m, k)).astype(float) for _ in range(2))
    return lcp_from_bimatrix_game(A, B)


def obstacle(rng: RNG) -> LCP:
    n = int(rng.integers(3, 25))
    one = sp.diags_array([-np.ones(n - 1), np.full(n, 2.0), -np.ones(n - 1)], offsets=[-1, 0, 1])
    M = sp.csr_array(sp.kron(one, sp.eye_array(n)) + sp.kron(sp.eye_array(n), one))
    return planted(rng, M, bounds=bool(rng.random() < 0.3))


def units(rng: RNG) -> LCP:
    """Rows and columns in units of their own, by powers of ten."""
    problem = definite(rng)
    r, c = (10.0 ** rng.integers(-3, 4, problem.n) for _ in range(2))
    M = r[:, None] * problem.M * c
    return LCP(M, r * problem.q, lower=problem.lower / c, upper=problem.upper / c)


# --- programs ----------------------------------------------------------------------------------------------------


def lasso(rng: RNG) -> cp.Problem:
    m, n = int(rng.integers(5, 60)), int(rng.integers(5, 120))
    A = rng.standard_normal((m, n))
    b = A @ (rng.standard_normal(n) * (rng.random(n) < 0.2)) + 0.1 * rng.standard_normal(m)
    x = cp.Variable(n)
    penalty = 10.0 ** rng.uniform(-3, 0) * np.abs(A.T @ b).max() * cp.norm1(x)
    ridge = rng.uniform(0, 1) * cp.sum_squares(x) if rng.random() < 0.5 else 0  # elastic net
    return cp.Problem(cp.Minimize(0.5 * cp.sum_squares(A @ x - b) + penalty + ridge))


def support_vectors(rng: RNG) -> cp.Problem:
    m, n = int(rng.integers(10, 80)), int(rng.integers(2, 8))
    X = rng.standard_normal((m, n))
    y = np.sign(X @ rng.standard_normal(n) + 0.3 * rng.standard_normal(m))
    w, b = cp.Variable(n), cp.Variable()
    hinge = cp.sum(cp.pos(1 - cp.multiply(y, X @ w + b)))
    return cp.Problem(cp.Minimize(0.5 * cp.sum_squares(w) + 10.0 ** rng.uniform(-2, 2) * hinge))


def group_sums(rng: RNG) -> cp.Problem:
    n = int(rng.integers(6, 40))
    groups = rng.integers(0, 4, n)
    G = np.array([(groups == k).astype(float) for k in range(4) if (groups == k).any()])
    x, t = cp.Variable(n), rng.standard_normal(n)
    limits = [x >= 0, G @ x == rng.uniform(0.5, 2.0, len(G)), cp.sum(x[: n // 2]) <= 5]
    return cp.Problem(cp.Minimize(cp.sum_squares(x - t)), limits)


def portfolio(rng: RNG) -> cp.Problem:
    n, k = int(rng.integers(5, 60)), int(rng.integers(1, 6))
    F, mu, x = rng.standard_normal((n, k)), 0.1 * rng.standard_normal(n), cp.Variable(n)
    risk = cp.sum_squares(F.T @ x) + cp.sum_squares(cp.multiply(rng.uniform(0.1, 0.5, n), x))
    limits = [cp.sum(x) == 1, x >= 0] + ([x <= 3.0 / n] if rng.random() < 0.5 else [])
    return cp.Problem(cp.Minimize(10.0 ** rng.uniform(-1, 2) * risk - mu @ x), limits)


def transport(rng: RNG) -> cp.Problem:
    m, n = int(rng.integers(2, 8)), int(rng.integers(2, 8))
    supply, cost, x = (
        rng.integers(1, 10, m).astype(float),
        rng.integers(1, 20, (m, n)),
        cp.Variable((m, n)),
    )
    demand = rng.dirichlet(np.ones(n)) * supply.sum()
    limits = [
        cp.sum(x, axis=1) <= supply * (1.0 + rng.choice([0.0, 0.1])),
        cp.sum(x, axis=0) >= demand * 0.999,
        x >= 0,
    ]
    return cp.Problem(cp.Minimize(cp.sum(cp.multiply(cost, x))), limits)


def simplex(rng: RNG) -> cp.Problem:
    n = int(rng.integers(2, 60))
    x = cp.Variable(n)
    return cp.Problem(
        cp.Minimize(cp.sum_squares(x - rng.standard_normal(n))), [cp.sum(x) == 1, x >= 0]
    )


def linear_program(rng: RNG) -> cp.Problem:
    m, n = int(rng.integers(2, 20)), int(rng.integers(2, 20))
    A, x0, x = rng.standard_normal((m, n)), np.abs(rng.standard_normal(n)), cp.Variable(n)
    y = np.abs(rng.standard_normal(m)) * (rng.random(m) < 0.5)
    slack = np.abs(rng.standard_normal(m)) * (y == 0)
    s = np.abs(rng.standard_normal(n)) * (rng.random(n) < 0.5)
    x0 = x0 * (s == 0)
    return cp.Problem(cp.Minimize((s - A.T @ y) @ x), [A @ x <= A @ x0 + slack, x >= 0])


def fixed_variables(rng: RNG) -> cp.Problem:
    n = int(rng.integers(3, 20))
    x, at = cp.Variable(n), rng.standard_normal(n).round(2)
    k = int(rng.integers(1, n))
    limits = [x[:k] == at[:k], x >= at - 1.0, x <= at + 1.0, cp.sum(x) <= at.sum() + 0.5]
    return cp.Problem(cp.Minimize(cp.sum_squares(rng.standard_normal((n, n)) @ x)), limits)


def equations_fix_all(rng: RNG) -> cp.Problem:
    n = int(rng.integers(2, 8))
    A, x = rng.standard_normal((n, n)), cp.Variable(n)
    x0 = np.abs(rng.standard_normal(n))
    return cp.Problem(
        cp.Minimize(cp.sum_squares(x) + rng.standard_normal(n) @ x), [A @ x == A @ x0, x >= 0]
    )


def redundant_rows(rng: RNG) -> cp.Problem:
    """Decimal rows of which one is the sum of two others, and right-hand sides that say so."""
    n, k = int(rng.integers(3, 8)), int(rng.integers(2, 3))
    E, x0 = rng.integers(1, 10, (k, n)) / 10.0, rng.integers(0, 10, n) / 10.0
    E = np.vstack([E, E[0] + E[1]])
    x = cp.Variable(n)
    return cp.Problem(cp.Minimize(cp.sum_squares(x - 1)), [E @ x == (E @ x0).round(10), x >= -5])


def infeasible(rng: RNG) -> cp.Problem:
    n = int(rng.integers(2, 10))
    A, x = rng.standard_normal((n + 1, n)).round(2), cp.Variable(n)
    y = np.abs(rng.standard_normal(n + 1)) + 0.1
    A[-1] = -(y[:-1] @ A[:-1]) / y[-1]
    b = rng.standard_normal(n + 1)
    b[-1] = -(y[:-1] @ b[:-1] + rng.uniform(0.1, 1.0)) / y[-1]
    return cp.Problem(
        cp.Minimize(cp.sum_squares(x) if rng.random() < 0.5 else cp.sum(x)), [A @ x <= b]
    )


def redundant_infeasible(rng: RNG) -> cp.Problem:
    problem = redundant_rows(rng)
    n, k = int(rng.integers(3, 8)), 2
    E = rng.integers(1, 10, (k, n)) / 10.0
    E, b = np.vstack([E, E[0] + E[1]]), rng.integers(1, 10, 2).astype(float)
    x = cp.Variable(n)
    return cp.Problem(
        problem.objective.__class__(cp.sum_squares(x)), [E @ x == np.append(b, b.sum() + 0.1)]
    )


def unbounded(rng: RNG) -> cp.Problem:
    n = int(rng.integers(2, 10))
    A, d, x = rng.standard_normal((n, n)), np.abs(rng.standard_normal(n)) + 0.1, cp.Variable(n)
    A -= np.outer((A @ d + np.abs(rng.standard_normal(n))) / (d @ d), d)  # A d ≤ 0
    c = rng.standard_normal(n)
    c -= (c @ d + 1.0) / (d @ d) * d  # cᵀd = −1
    return cp.Problem(cp.Minimize(c @ x), [A @ x <= np.abs(rng.standard_normal(n)), x >= 0])


LCPS: tuple[Callable[[RNG], LCP], ...] = (
    definite,
    semidefinite,
    monotone,
    h_plus,
    p_matrix,
    triangular,
    block_triangular,
    contact,
    game,
    obstacle,
    units,
)
PROGRAMS: tuple[Callable[[RNG], cp.Problem], ...] = (
    lasso,
    support_vectors,
    group_sums,
    portfolio,
    transport,
    simplex,
    linear_program,
    fixed_variables,
    equations_fix_all,
    redundant_rows,
    infeasible,
    redundant_infeasible,
    unbounded,
)
EXPECTED = {
    "infeasible": cp.INFEASIBLE,
    "redundant_infeasible": cp.INFEASIBLE,
    "unbounded": cp.UNBOUNDED,
}
BUILDS = {build.__name__: build for build in (*LCPS, *PROGRAMS)}


def judged(name: str, rng: RNG) -> Iterator[tuple[str, str]]:
    """Yield (verdict, text): WRONG for a false claim, LEFT where a named method solves what auto does not, or OPEN."""
    build = BUILDS[name]
    yield from (of_lcp if build in LCPS else of_program)(build(rng), name)


def of_lcp(problem: LCP, name: str) -> Iterator[tuple[str, str]]:
    result = solve(problem)
    if result.has_no_solution:
        yield "WRONG", f"{result.status.name} although a solution was planted"
    elif not result.is_solved:
        yield _left(result.status.name, result.seconds, partial(_is_solved, problem))


def of_program(problem: cp.Problem, name: str) -> Iterator[tuple[str, str]]:
    began = time.perf_counter()
    problem.solve(solver=lcp_plugin.QPSolver)
    seconds, expected = time.perf_counter() - began, EXPECTED.get(name, cp.OPTIMAL)
    if problem.status == expected == cp.OPTIMAL:
        value = problem.value
        other = problem.solve(solver=cp.CLARABEL)
        if problem.status == cp.OPTIMAL and abs(value - other) > VALUE * (1.0 + abs(other)):
            yield "WRONG", f"{value:.9g}, Clarabel {other:.9g}"
    elif expected != problem.status in (cp.OPTIMAL, cp.INFEASIBLE, cp.UNBOUNDED):
        yield "WRONG", f"{problem.status}, expected {expected}"
    elif problem.status != expected == cp.OPTIMAL:
        yield _left(problem.status, seconds, partial(_is_optimal, problem))
    elif problem.status != expected:
        yield "OPEN", f"{problem.status}, expected {expected}"


def _left(status: str, seconds: float, solves: Callable[[str, float], bool]) -> tuple[str, str]:
    limit = max(TIMES * seconds, MIN_SECONDS)
    by = [method for method in NAMED if solves(method, limit)]
    return ("LEFT", f"{status}, solved by {', '.join(by)}") if by else ("OPEN", status)


def _is_solved(problem: LCP, method: str, limit: float) -> bool:
    try:
        result: Result = solve(problem, method, max_seconds=limit)
    except lcp_plugin.LCPError:
        return False
    return result.status is Status.SOLVED


def _is_optimal(problem: cp.Problem, method: str, limit: float) -> bool:
    try:
        problem.solve(solver=lcp_plugin.QPSolver, algorithm=method, max_seconds=limit)
    except (lcp_plugin.LCPError, cp.SolverError):
        return False
    return problem.status == cp.OPTIMAL
