"""Multipliers of degenerate programs beside those of HiGHS: never more than 1e3 times as large.

The programs have
more active rows than variables, redundant rows, rows of decimals that are redundant but for rounding, or variables that
equal bounds fix beside rows that hold them too. Compared is the largest multiplier, of bounds as well.
"""

from __future__ import annotations

import cvxpy as cp
import numpy as np
import scipy.sparse as sp

from lcp_plugin import QuadraticProgram, solve

from . import convex_programs

KINDS = ("degenerate", "redundant", "linear", "fixed", "decimal")
MOST = 1e3  # times the multipliers of HiGHS
HIGHS_SECONDS = 2.0  # some semidefinite programs it goes on with for ever


def program(kind: str, rng: np.random.Generator, largest: int = 25) -> QuadraticProgram:
    """Return a program of that kind with a minimum."""
    if kind == "decimal":
        n = int(rng.integers(3, 12))
        m = int(rng.integers(2, n + 1))
        A = np.round(rng.uniform(-1, 1, (m - 1, n)), 1)
        A = np.vstack([A, A.sum(axis=0)])
        x = np.round(rng.uniform(0, 1, n), 1)
        P = np.diag(1.0 * (rng.random(n) < 0.5 * rng.integers(0, 2)))
        c = A.T @ np.round(rng.normal(size=m), 1) + (rng.random(n) < 0.3) * (x == 0.0) - P @ x
        return QuadraticProgram(P, c, A=A, b=A @ x, lower=np.where(x == 0.0, 0.0, -np.inf))
    if kind != "fixed":
        return convex_programs.planted(kind, rng, largest)[0]
    free, _ = convex_programs.planted(str(rng.choice(["linear", "degenerate"])), rng, largest)
    x = solve(free).solution.x
    is_fixed = rng.random(free.n) < 0.5
    A, b = sp.csr_array(free.A), free.b
    if b.size:  # once more, summed up
        A, b = sp.vstack([A, A.sum(axis=0)[None, :]]), np.append(b, b.sum())
    lower, upper = np.where(is_fixed, x, free.lower), np.where(is_fixed, x, free.upper)
    return QuadraticProgram(free.P, free.c, free.G, free.h, A, b, lower, upper)


def largest_of_highs(case: QuadraticProgram) -> float | None:
    """Return the largest multiplier of HiGHS; None where it finds no minimum."""
    x, constraints = cp.Variable(case.n), []
    if case.h.size:
        constraints.append(sp.csr_array(case.G) @ x <= np.minimum(case.h, 1e20))
    if case.b.size:
        constraints.append(sp.csr_array(case.A) @ x == case.b)
    for bound, sign in ((case.lower, -1.0), (case.upper, 1.0)):
        if (listed := np.flatnonzero(np.isfinite(bound))).size:
            constraints.append(sign * x[listed] <= sign * bound[listed])
    P = case.P.toarray() if sp.issparse(case.P) else case.P
    curved = 0.5 * cp.quad_form(x, cp.psd_wrap(P)) if np.any(P) else 0.0
    problem = cp.Problem(cp.Minimize(case.c @ x + curved), constraints)
    try:
        problem.solve(solver=cp.HIGHS, time_limit=HIGHS_SECONDS)
    except cp.SolverError:
        return None
    if problem.status != cp.OPTIMAL:
        return None
    return max((float(np.abs(one.dual_value).max(initial=0.0)) for one in constraints), default=0.0)
