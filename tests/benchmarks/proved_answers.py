"""What is proved of solvers' answers to convex programs, each solver at its own settings."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator

import cvxpy as cp
import numpy as np
import scipy.sparse as sp

from lcp_plugin import QPSolver, certify
from lcp_plugin.problems.programs.program import QuadraticProgram

SOLVERS = ("LCP", "CLARABEL", "PIQP", "HIGHS", "OSQP", "SCS")
LEVELS = (1e-6, 1e-3)
LIMIT, QUICK_LIMIT = 20.0, 3.0  # seconds of each proof


def run(*, quick: bool = False) -> Iterator[str]:
    """Yield a line an answer, and how many answers of each solver are proved, unproved or disproved."""
    ranks: dict[str, Counter[str]] = {}
    for name, build in SAMPLES.items():
        yield f"{name}: {build()!r}"
        for solver in SOLVERS:
            if solver not in {"LCP", *cp.installed_solvers()}:
                continue
            status, verdict = judged(build(), solver, QUICK_LIMIT if quick else LIMIT)
            yield f"{solver:<10}{status[:24]:<26}{verdict}"
            ranks.setdefault(solver, Counter())[verdict] += 1
    for solver, found in ranks.items():
        yield f"{solver}: {', '.join(f'{count} × {rank}' for rank, count in found.most_common())}"


def judged(program: QuadraticProgram, solver: str, seconds: float) -> tuple[str, str]:
    """Return cvxpy's status, and what is proved of the solver's answer: "proved to 1e-06", "unproved" …."""
    x = cp.Variable(program.n, bounds=[program.lower, program.upper])
    curved = 0.5 * cp.quad_form(x, program.P, assume_PSD=True) if abs(program.P).sum() else 0.0
    rows = {"inequality": program.G @ x <= program.h} if program.h.size else {}
    rows |= {"equality": program.A @ x == program.b} if program.b.size else {}
    problem = cp.Problem(cp.Minimize(curved + program.c @ x), [*rows.values()])
    try:
        problem.solve(solver=QPSolver if solver == "LCP" else solver)
    except (cp.SolverError, ValueError) as error:
        return str(error), "no answer"
    claim = problem.status.removesuffix("_inaccurate")
    claim = claim if claim in ("infeasible", "unbounded") else None
    multipliers = {"inequality": np.zeros(0), "equality": np.zeros(0)}
    multipliers |= {name: row.dual_value for name, row in rows.items()}
    point = (None, None) if claim else (x.value, multipliers)
    for level in LEVELS:
        said = certify(program, *point, claim=claim, tolerance=level, max_seconds=seconds)
        if said.verdict == "proved":
            return str(problem.status), f"proved to {level:.0e}"
    return str(problem.status), said.verdict


def portfolio() -> QuadraticProgram:
    """Return the risk of 60 assets in five factors, less their return; weights ≥ 0 of sum 1."""
    rng = np.random.default_rng(1)
    factors = rng.normal(size=(60, 5))
    P = factors @ factors.T + np.diag(rng.uniform(0.1, 1.0, 60))
    return QuadraticProgram(P, -rng.uniform(0.0, 1.0, 60), A=np.ones((1, 60)), b=[1.0], lower=0.0)


def support_vectors() -> QuadraticProgram:
    """Return the dual of a support vector machine: 60 points in four dimensions, so that P is singular."""
    rng = np.random.default_rng(2)
    label = np.where(np.arange(60) % 2, 1.0, -1.0)
    points = np.round(64.0 * (rng.normal(size=(60, 4)) + 0.5 * label[:, None])) / 64.0
    signed = label[:, None] * points
    return QuadraticProgram(
        signed @ signed.T, -np.ones(60), A=label[None, :], b=[0.0], lower=0.0, upper=1.0
    )


def convex_fit() -> QuadraticProgram:
    """Return the least squares fit of a convex sequence to 60 values: a chain of second differences."""
    rng, n = np.random.default_rng(3), 60
    values = np.linspace(-1.0, 1.0, n) ** 2 + 0.1 * rng.normal(size=n)
    bend = sp.diags_array(
        [-np.ones(n), 2.0 * np.ones(n), -np.ones(n)], offsets=[0, 1, 2], shape=(n - 2, n)
    )
    return QuadraticProgram(
        sp.eye_array(n, format="csr"), -values, G=bend.tocsr(), h=np.zeros(n - 2)
    )


def unstable_control() -> QuadraticProgram:
    """Return twenty steps of a state that grows by a fifth a step, held by bounded forces."""
    steps = 20
    grow = sp.diags_array([np.ones(steps), np.full(steps - 1, -1.2)], offsets=[0, -1])
    start = np.zeros(steps)
    start[0] = 1.2 * 0.9
    return QuadraticProgram(
        sp.diags_array(np.repeat([1.0, 0.1], steps)),
        np.zeros(2 * steps),
        A=sp.hstack([grow, -sp.eye_array(steps)], format="csr"),
        b=start,
        lower=np.repeat([-np.inf, -0.25], steps),
        upper=np.repeat([np.inf, 0.25], steps),
    )


def transport() -> QuadraticProgram:
    """Return the cheapest transport from six places to eight: a linear program with many bases."""
    rng = np.random.default_rng(4)
    rows = sp.vstack(
        [
            sp.kron(sp.eye_array(6), np.ones((1, 8))),
            sp.kron(np.ones((1, 6)), sp.eye_array(8)),
        ],
        format="csr",
    )
    amounts = np.concatenate([np.full(6, 8.0), np.full(8, 6.0)])
    return QuadraticProgram(
        sp.csr_array((48, 48)), rng.integers(1, 10, 48).astype(float), A=rows, b=amounts, lower=0.0
    )


def badly_scaled() -> QuadraticProgram:
    """Return a program whose rows and columns are in units from 1e-4 to 1e4."""
    rng = np.random.default_rng(5)
    columns, rows = 10.0 ** rng.uniform(-4.0, 4.0, 20), 10.0 ** rng.uniform(-4.0, 4.0, 12)
    factor, x = rng.normal(size=(20, 20)), rng.normal(size=20)
    G = rng.normal(size=(12, 20))
    return QuadraticProgram(
        columns[:, None] * (factor @ factor.T) * columns,
        columns * rng.normal(size=20),
        G=rows[:, None] * G * columns,
        h=rows * (G @ x + rng.uniform(0.0, 1.0, 12)),
    )


def contradiction() -> QuadraticProgram:
    """Return a program whose constraints contradict by a thousandth."""
    rng = np.random.default_rng(6)
    G = np.round(8.0 * rng.normal(size=(3, 6)))
    return QuadraticProgram(
        np.eye(6), np.ones(6), G=np.vstack([G, -G.sum(axis=0)]), h=[1.0, 2.0, 3.0, -6.001]
    )


def endless_descent() -> QuadraticProgram:
    """Return a program whose objective falls without end where two variables grow together."""
    return QuadraticProgram(
        np.diag([0.0, 0.0, 1.0]), [1.0, -2.0, 0.0], A=[[1.0, -1.0, 0.0]], b=[0.0], lower=0.0
    )


SAMPLES: dict[str, Callable[[], QuadraticProgram]] = {
    "portfolio": portfolio,
    "support vectors": support_vectors,
    "convex fit": convex_fit,
    "unstable control": unstable_control,
    "transport": transport,
    "badly scaled": badly_scaled,
    "contradiction": contradiction,
    "endless descent": endless_descent,
}
