"""Small convex programs with exact answers: what `certify` says of right and of planted wrong ones.

Data are multiples of 1/8, x* and multipliers come
first, so that the optimal value is a fraction; every bound is compared with it in fractions, without any allowance.
"proved" is a statement on the value and the constraints: of those off by 1e-4 some are proved.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np
from oracles.exact_program import ExactProgram, exact

from lcp_plugin import QuadraticProgram
from lcp_plugin.problems.programs.certification import Certification, ProgramProofs
from lcp_plugin.problems.programs.no_minimum import known_proof
from lcp_plugin.problems.programs.solution import QPSolution

MULTIPLIERS = ("a sign", "both bounds")  # planted in the multipliers of a right x
KINDS = ("definite", "definite, equations", "semidefinite", "linear", "free", "degenerate")
TOLERANCE = 1e-6


@dataclass(frozen=True)
class Case:
    """A program, an optimal x with multipliers (inequality, equality, lower, upper), and the optimal value."""

    program: QuadraticProgram
    x: Any
    multipliers: tuple[Any, ...]
    value: Fraction

    @property
    def solution(self) -> QPSolution:
        """The optimal x with its multipliers."""
        return QPSolution(self.program, self.x, *self.multipliers)


def eighths(rng: np.random.Generator, shape: Any, low: int = -16, high: int = 17) -> Any:
    return rng.integers(low, high, shape) / 8.0


def case(kind: str, rng: np.random.Generator, largest: int) -> Case:
    """Return a program of that kind and its answer."""
    n = int(rng.integers(1, largest + 1))
    p = (
        int(rng.integers(1, max(2, n // 2 + 1)))
        if "equations" in kind
        else int(rng.integers(0, n // 3 + 1))
    )
    m = int(rng.integers(0, n + 3))
    rank = 0 if kind == "linear" else n if kind.startswith("definite") else max(1, n // 2)
    F = eighths(rng, (n, rank), -8, 9)
    P = F @ F.T + (np.eye(n) / 4.0 if kind.startswith("definite") else 0.0)
    G, A, x = eighths(rng, (m, n)), eighths(rng, (p, n)), eighths(rng, n)
    state = rng.integers(0, 5, n)  # 0 at lower, 1 at upper, 2 inside, 3 open below, 4 free
    if kind == "free":
        state[:] = 4
    lower = np.where(state == 0, x, np.where(state <= 2, x - eighths(rng, n, 1), -np.inf))
    upper = np.where(state == 1, x, np.where(state != 4, x + eighths(rng, n, 1), np.inf))
    is_active = rng.random(m) < 0.5
    held = rng.random(m) < (0.4 if kind == "degenerate" else 1.0)
    inequality = np.where(is_active & held, eighths(rng, m, 1), 0.0)
    equality = eighths(rng, p)
    at_lower = np.where(state == 0, eighths(rng, n, 0 if kind == "degenerate" else 1), 0.0)
    at_upper = np.where(state == 1, eighths(rng, n, 0 if kind == "degenerate" else 1), 0.0)
    h = G @ x + np.where(is_active, 0.0, eighths(rng, m, 1))
    c = -(P @ x + G.T @ inequality + A.T @ equality - at_lower + at_upper)
    program = QuadraticProgram(P, c, G, h, A, A @ x, lower, upper)
    return Case(program, x, (inequality, equality, at_lower, at_upper), objective(program, x))


def objective(program: QuadraticProgram, x: Any) -> Fraction:
    """Return ½ xᵀP x + cᵀx without rounding."""
    return ExactProgram.of(program).value(exact(x))


def excesses(program: QuadraticProgram, x: Any) -> Iterator[tuple[Fraction, Fraction]]:
    """Yield the violation of each constraint and the size of its largest term, without rounding."""
    rows, at = program.constraints, exact(x)
    for row, limit, is_equality in zip(
        rows.matrix.toarray().tolist(), rows.limit.tolist(), rows.is_equality, strict=True
    ):
        if np.isfinite(limit):
            terms = [Fraction(e) * a for e, a in zip(row, at, strict=True)]
            excess = sum(terms, -Fraction(limit))
            largest = max(abs(Fraction(limit)), *map(abs, terms))
            yield abs(excess) if is_equality else excess, largest


def violation(program: QuadraticProgram, x: Any) -> Fraction:
    """Return the largest violation of a constraint."""
    return max((excess for excess, _ in excesses(program, x)), default=Fraction(0))


def is_near_optimal(given: Case, x: Any) -> bool:
    """Return whether x is feasible and optimal to the tolerance, relative to the terms."""
    program, tolerance = ExactProgram.of(given.program), Fraction(TOLERANCE)
    at, rows = exact(x), excesses(given.program, x)
    is_met = all(excess <= tolerance * size for excess, size in rows)
    return is_met and abs(program.value(at) - given.value) <= tolerance * program.size(at)


def faults(given: Case, x: Any, said: Certification) -> list[str]:
    """Return what is false in what was said about x; exact."""
    program, found = given.program, []
    value = objective(program, x)
    missed = violation(program, x)
    is_optimal = is_near_optimal(given, x)
    if said.lower is not None and Fraction(said.lower) > given.value:
        found.append("lower")
    if said.upper is not None and Fraction(said.upper) < given.value:
        found.append("upper")
    if said.violation is not None and Fraction(said.violation) < missed:
        found.append("violation")
    if said.gap is not None and Fraction(said.gap) < abs(value - Fraction(said.lower)):
        found.append("gap")
    if said.verdict == "disproved" and is_optimal:
        found.append("wrong disproof")
    if said.verdict == "proved" and not is_optimal:
        found.append("wrong proof")
    return found


def planted(given: Case, rng: np.random.Generator) -> dict[str, tuple[Any, Any]]:
    """Return wrong answers by name: x, and multipliers or None."""
    program, x, multipliers = given.program, given.x, given.multipliers
    wrong = {}
    y = np.concatenate(multipliers)
    acts = np.concatenate(
        [*(abs(rows) @ np.ones(x.size) for rows in (program.G, program.A)), np.ones(2 * x.size)]
    )
    if (used := np.flatnonzero(y * acts)).size:
        k = int(rng.choice(used))
        y[k] = -y[k]
        ends = np.cumsum([len(part) for part in multipliers])[:3]
        wrong["a sign"] = (x, QPSolution(program, x, *np.split(y, ends)))
    apart = np.flatnonzero(program.lower < program.upper)
    if apart.size:
        both = [part.copy() for part in multipliers]
        for part in both[2:]:
            part[apart[0]] += 1.0
        wrong["both bounds"] = (x, QPSolution(program, x, *both))
    step = rng.normal(size=x.size)
    step /= np.abs(step).max()
    wrong["off by 1e-4"], wrong["off by 1e-2"] = (x + 1e-4 * step, None), (x + 1e-2 * step, None)
    active = np.flatnonzero(multipliers[0] > 0.0)
    if active.size:
        k = int(rng.choice(active))
        kept = np.delete(np.arange(program.h.size), k)
        G, h = program.G[kept], program.h[kept]
        rest = (program.A, program.b, program.lower, program.upper)
        other = QuadraticProgram(program.P, program.c, G, h, *rest)
        if known_proof(other) is None and (own := ProgramProofs(other).own_solution) is not None:
            wrong["a constraint dropped"] = (own.x, None)
    return wrong
