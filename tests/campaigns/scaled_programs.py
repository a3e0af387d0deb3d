"""Scaled versions of a program: one status, one objective, no result that a proof excludes.

The programs are small ones of `convex_programs`, with a known minimum, inconsistent constraints or a known recession
direction. Each is solved unscaled, and then with its objective, its rows, its unknowns, and all of these multiplied by
10^±6, ±9 or ±12, each row and each unknown separately. The campaign checks

- the known status at every scale; PRECISION_LIMIT if a recession direction leaves the rows beyond a radius.
- the known objective, to 1e-6 of its terms.
- SOLVED, if an exact proof excludes a minimum, only within a thousandth of the tolerance.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp

from lcp_plugin import QuadraticProgram, Status, solve
from lcp_plugin.problems.programs.no_minimum import known_proof

from . import convex_programs

FAMILIES = (
    "plain", "linear", "degenerate", "redundant", "low rank", "network",
    "infeasible", "infeasible, graded", "unbounded", "unbounded, graded",
)  # fmt: skip
STATUS = {"": Status.SOLVED, "infeasible": Status.INFEASIBLE, "unbounded": Status.UNBOUNDED}
LARGEST = 24
WHAT = ("as drawn", "objective", "rows", "unknowns", "together")
EXPONENTS = (6, 9, 12)
CLOSE = 1e-6  # of the objective's terms
SURE = 1e-9  # a thousandth of the tolerance of residuals


class Planted(NamedTuple):
    """A program with known status, and its minimum, if it has one."""

    program: QuadraticProgram
    status: Status
    value: float


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
        if not abs(result.objective - size * case.value) <= CLOSE * terms:
            bad.append(f"objective {result.objective / size:.9g} for {case.value:.9g}")
        solution = result.solution
        if solution.error > SURE:
            proof = known_proof(program)
            bad += ["SOLVED, and an exact proof against it"] * (
                proof is not None and proof.is_exact
            )
    elif result.proof is not None and not result.proof.verify():
        bad.append("a proof that does not verify")
    return result.status.name, bad


def one(family: str, seed: int) -> list[str]:
    """Return false results for a program at all scales."""
    rng, bad = np.random.default_rng([seed, FAMILIES.index(family)]), list[str]()
    program, value = convex_programs.planted(family, rng, LARGEST)
    case = Planted(program, STATUS[convex_programs.FAMILIES[family].spoilt], value)
    for what in WHAT:
        other, size = (program, 1.0) if what == "as drawn" else rescaled(program, what, rng)
        _, wrong = failures(case, other, size)
        bad += [f"{family}, {what}: {word}" for word in wrong]
    return bad
