"""All complementary assignments of a tiny problem, in Fractions."""

from __future__ import annotations

from fractions import Fraction
from itertools import product
from typing import Any

import numpy as np
from collection.truth import ExactData

from lcp_plugin import LCP


def eliminated(rows: list[list[Fraction]]) -> list[Fraction] | None:
    """One solution of [A | b], unknowns that are left open at 0; None where there is none."""
    n = len(rows[0]) - 1 if rows else 0
    rows, pivots = [list(row) for row in rows], []
    for column in range(n):
        at = next((k for k in range(len(pivots), len(rows)) if rows[k][column]), None)
        if at is None:
            continue
        rows[len(pivots)], rows[at] = rows[at], rows[len(pivots)]
        top = rows[len(pivots)] = [entry / rows[len(pivots)][column] for entry in rows[len(pivots)]]
        for k in range(len(rows)):
            if k != len(pivots) and rows[k][column]:
                factor = rows[k][column]
                rows[k] = [a - factor * b for a, b in zip(rows[k], top, strict=True)]
        pivots.append(column)
    if any(row[n] and not any(row[:n]) for row in rows):
        return None
    solution = [Fraction(0)] * n
    for k, column in enumerate(pivots):
        solution[column] = rows[k][n]
    return solution


def solves(problem: LCP, z: Any) -> bool:
    """Whether z is a solution, exactly."""
    return ExactData(problem).is_solution(z)


def solutions(problem: LCP) -> list[Any]:
    """A solution of each complementary assignment that has one; a singular assignment may be missed."""
    M, found = problem.csr.toarray(), []
    for states in product(("low", "free", "high"), repeat=problem.n):
        z: list[Any] = [None] * problem.n
        for i, state in enumerate(states):
            bound = {"low": problem.lower[i], "high": problem.upper[i]}.get(state)
            if bound is not None:
                z[i] = Fraction(bound) if np.isfinite(bound) else None
        free = [i for i, state in enumerate(states) if state == "free"]
        if any(z[i] is None and state != "free" for i, state in enumerate(states)):
            continue
        rows = [
            [Fraction(M[i, j]) for j in free]
            + [-Fraction(problem.q[i]) - sum(Fraction(M[i, j]) * z[j] for j in range(problem.n) if j not in free)]
            for i in free
        ]
        values = eliminated(rows) if free else []
        if values is None:
            continue
        for i, value in zip(free, values, strict=True):
            z[i] = value
        if solves(problem, z):
            found.append(np.array([*z, None], dtype=object)[:-1])
    return found
