"""Scaled versions of a program: one status, one objective, no result that a proof excludes.

A third of the programs has a known minimum, a third inconsistent constraints, and a third a known recession
direction. They are dense, sparse, degenerate, rank deficient and linear. Each is solved unscaled, and then with its
objective, its rows, its unknowns, and all of these multiplied by 10^±6, ±9 or ±12, each row and each unknown
separately. The campaign checks

- the known status at every scale; PRECISION_LIMIT if a recession direction leaves the rows beyond a radius.
- the known objective, to 1e-6 of its terms.
- SOLVED, if an exact proof excludes a minimum, only within a thousandth of the tolerance.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp

from lcp_plugin import QuadraticProgram, Status, solve

KINDS = ("dense", "sparse", "degenerate", "rank deficient", "linear")
OUTCOMES = (Status.SOLVED, Status.INFEASIBLE, Status.UNBOUNDED)
WHAT = ("as drawn", "objective", "rows", "unknowns", "together")
EXPONENTS = (6, 9, 12)
CLOSE = 1e-6  # of the objective's terms
SURE = 1e-9  # a thousandth of the tolerance of residuals
INF = np.inf


class Planted(NamedTuple):
    """A program with known status, and its minimum, or None."""

    program: QuadraticProgram
    status: Status
    value: float | None


def planted(case: int, rng: np.random.Generator, largest: int = 24) -> Planted:
    """Draw the program of this number."""
    kind, outcome = KINDS[case % len(KINDS)], OUTCOMES[case // len(KINDS) % len(OUTCOMES)]
    n = int(rng.integers(2, largest))
    m, p = int(rng.integers(1, n + 2)), int(rng.integers(0, (n + 1) // 2))
    share = 0.2 if kind == "sparse" else 0.9
    C = _entries(rng, (m + p, n), share)
    B = _entries(
        rng, (0 if kind == "linear" else n // 2 if kind == "rank deficient" else n, n), share
    )
    x, is_low = rng.normal(size=n), rng.random(n) < 0.4
    d = None
    if outcome is Status.UNBOUNDED:
        d = np.where(is_low, np.abs(rng.normal(size=n)), rng.normal(size=n)).round(1)
        d[int(rng.integers(n))] += 1.0
        d = np.where(is_low, np.abs(d), d)
        C[m:], B = _across(C[m:], d), _across(B, d)
        B[np.abs(B) < 1e-12] = 0.0  # rounding errors would dominate a small P
        C[:m] *= np.where(C[:m] @ d > 0.0, -1.0, 1.0)[:, None]
    meets = rng.random(m) < 0.5
    y = np.where(
        meets & ((rng.random(m) < 0.5) | (kind != "degenerate")), rng.uniform(0.5, 2.0, m), 0.0
    )
    v = rng.normal(size=p)
    low = np.where(is_low, rng.uniform(0.5, 2.0, n) * (rng.random(n) < 0.7), 0.0)
    if kind in ("degenerate", "rank deficient") and p:  # rows twice
        C, v, p = np.vstack([C, 2.0 * C[m:]]), np.append(v, 0.0 * v), 2 * p
    G, A, P = C[:m], C[m:], B.T @ B
    h, b = G @ x + np.where(meets, 0.0, rng.uniform(0.1, 1.0, m)), A @ x
    lower = np.where(is_low, x, -INF)
    c, value = -P @ x - G.T @ y - A.T @ v + low, None
    if outcome is Status.SOLVED:
        value = float(0.5 * x @ P @ x + c @ x)
    elif outcome is Status.INFEASIBLE:
        y = rng.uniform(0.5, 2.0, m)
        G, h = np.vstack([G, -y @ G]), np.append(h, -y @ h - rng.uniform(0.5, 2.0))
    elif d is not None:
        c = rng.normal(size=n)
        c -= d * (c @ d + rng.uniform(0.5, 2.0)) / (d @ d)
    matrices = [sp.csr_array(one) if kind == "sparse" else one for one in (P, G, A)]
    program = QuadraticProgram(matrices[0], c, matrices[1], h, matrices[2], b, lower)
    return Planted(program, outcome, value)


def _entries(rng: np.random.Generator, shape: tuple[int, int], share: float) -> Any:
    """Draw rows of which none is empty."""
    drawn = rng.normal(size=shape) * (rng.random(shape) < share)
    if shape[0]:
        drawn[np.arange(shape[0]), rng.integers(0, shape[1], shape[0])] += 1.0
    return drawn


def _across(rows: Any, d: Any) -> Any:
    """Return the rows, projected orthogonally to d."""
    return rows - np.outer(rows @ d, d) / (d @ d)


def rescaled(
    program: QuadraticProgram, what: str, rng: np.random.Generator
) -> tuple[QuadraticProgram, float]:
    """Return the scaled program, and the factor of its objective."""
    size = int(rng.choice(EXPONENTS))
    m, p, n = program.h.size, program.b.size, program.n

    def drawn(count: int, asked: str) -> Any:
        return (
            10.0 ** (size * rng.choice([-1, 1], count))
            if what in (asked, "together")
            else np.ones(count)
        )

    objective = float(drawn(1, "objective")[0])
    rows = drawn(m + p, "rows")
    unknowns = drawn(n, "unknowns")

    def scaled(matrix: Any, of_rows: Any) -> Any:
        made = sp.diags_array(of_rows) @ sp.csr_array(matrix) @ sp.diags_array(unknowns)
        return made if sp.issparse(matrix) else made.toarray()

    P = objective * scaled(program.P, unknowns)
    return QuadraticProgram(
        (P + P.T) * 0.5,
        objective * unknowns * program.c,
        scaled(program.G, rows[:m]),
        rows[:m] * program.h,
        scaled(program.A, rows[m:]),
        rows[m:] * program.b,
        program.lower / unknowns,
        program.upper / unknowns,
    ), objective


def failures(case: Planted, program: QuadraticProgram, size: float) -> tuple[str, list[str]]:
    """Return the status of the scaled program, and its errors."""
    result = solve(program)
    is_right = result.status is case.status
    if case.status is Status.UNBOUNDED and result.doubtful is not None:
        is_right |= result.status is Status.PRECISION_LIMIT and result.doubtful.verify()
    bad = [] if is_right else [f"{result.status.name} for {case.status.name}"]
    if result.status is Status.SOLVED:
        x, c = result.x, program.c
        terms = float(np.abs(c) @ np.abs(x) + 0.5 * np.abs(x) @ (abs(program.P) @ np.abs(x)))
        if (
            case.value is not None
            and not abs(result.objective - size * case.value) <= CLOSE * terms
        ):
            bad.append(f"objective {result.objective / size:.9g} for {case.value:.9g}")
        solution = result.solution
        if solution.error > SURE:
            proof = program.facts.proof_of_no_minimum
            bad += ["SOLVED, and an exact proof against it"] * (
                proof is not None and proof.is_exact
            )
    elif result.proof is not None and not result.proof.verify():
        bad.append("a proof that does not verify")
    return result.status.name, bad


def one(seed: int, case: int) -> list[str]:
    """Return false results for a program at all scales."""
    rng = np.random.default_rng([seed, case])
    drawn, bad = planted(case, rng), list[str]()
    for what in WHAT:
        program, size = (
            (drawn.program, 1.0) if what == "as drawn" else rescaled(drawn.program, what, rng)
        )
        _, wrong = failures(drawn, program, size)
        bad += [f"{KINDS[case % len(KINDS)]}, {what}: {word}" for word in wrong]
    return bad
