"""Exact solutions of small problems in rational arithmetic; shared by tests and campaigns.

A guess of the active set comes from floating point, its linear system is solved in fractions, and every inequality is
verified in fractions. Only where no guess passes an exact search decides.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from fractions import Fraction
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp

from lcp_plugin import LCP

from .truth import ExactData, decide

LOWER, FREE, UPPER = -1, 0, 1
States = tuple[int, ...]
NEWTON_STEPS = 30


class Exact(NamedTuple):
    """z* and w* = M z* + q, one fraction a row."""

    z: tuple[Fraction, ...]
    w: tuple[Fraction, ...]


def exact_solution(problem: LCP) -> Exact:
    """Return the exact solution of a small problem whose matrix is a P-matrix; ValueError where none is found."""
    M, q = exact_rows(problem.csr), [Fraction(entry) for entry in problem.q.tolist()]
    cases = (_solution_of(problem, M, q, states) for states in _guesses(problem))
    z = next((z for z in cases if z is not None), None) or decide(problem).z
    if z is None:
        raise ValueError(f"no active set of {problem!r} gives a solution")
    return Exact(z, tuple(ExactData(problem).slack(z)))


def exact_rows(matrix: Any) -> list[list[Fraction]]:
    """Return the entries of an array or a sparse array as exact numbers."""
    dense = matrix.toarray() if sp.issparse(matrix) else matrix
    return [[Fraction(entry) for entry in row] for row in dense.tolist()]


def echelon(A: Sequence[Sequence[Fraction]]) -> tuple[list[list[Fraction]], list[int]]:
    """Return the rows after Gaussian elimination and the columns of its pivots; exchanges keep the determinant."""
    rows, columns = [list(row) for row in A], list[int]()
    for column in range(len(rows[0]) if rows else 0):
        k = len(columns)
        pivot = next((i for i in range(k, len(rows)) if rows[i][column]), None)
        if pivot is None:
            continue
        if pivot != k:
            rows[k], rows[pivot] = rows[pivot], [-entry for entry in rows[k]]
        columns.append(column)
        for i in range(k + 1, len(rows)):
            if rows[i][column]:
                factor = rows[i][column] / rows[k][column]
                rows[i] = [a - factor * b for a, b in zip(rows[i], rows[k], strict=True)]
    return rows, columns


def solve_fractions(
    A: Sequence[Sequence[Fraction]], b: Sequence[Fraction]
) -> list[Fraction] | None:
    """Return A⁻¹b in fractions, None where A is singular."""
    n = len(b)
    rows, columns = echelon([[*row, right] for row, right in zip(A, b, strict=True)])
    if columns != [*range(n)]:
        return None
    x = [Fraction(0)] * n
    for k in reversed(range(n)):
        x[k] = (rows[k][n] - sum(rows[k][j] * x[j] for j in range(k + 1, n))) / rows[k][k]
    return x


def rank(A: Sequence[Sequence[Fraction]]) -> int:
    """Return the rank."""
    return len(echelon(A)[1])


def has_positive_pivots(A: Sequence[Sequence[Fraction]]) -> bool:
    """Return whether all leading minors are positive: a symmetric A is positive definite."""
    return all(determinant([row[:k] for row in A[:k]]) > 0 for k in range(1, len(A) + 1))


def determinant(A: Sequence[Sequence[Fraction]]) -> Fraction:
    """Return the determinant, the product of the diagonal of the echelon form."""
    rows, _ = echelon(A)
    return math.prod((row[k] for k, row in enumerate(rows)), start=Fraction(1))


def principal_minors(A: Sequence[Sequence[Fraction]]) -> list[Fraction]:
    """Return the determinants of all principal submatrices, the smallest first."""
    sets = (rows for k in range(1, len(A) + 1) for rows in itertools.combinations(range(len(A)), k))
    return [determinant([[A[i][j] for j in rows] for i in rows]) for rows in sets]


def _guesses(problem: LCP) -> Iterator[States]:
    """Yield the active sets that a semismooth Newton method in floating point runs through, the last first."""
    M, scale = problem.csr.toarray(), problem.residual_scale
    z, seen = np.array(problem.nearest_to_zero), []
    for _ in range(NEWTON_STEPS):
        # finite, so that it is beyond no infinite bound
        target = np.nan_to_num(z - (M @ z + problem.q) / scale)
        states = np.where(
            target <= problem.lower, LOWER, np.where(target >= problem.upper, UPPER, FREE)
        )
        states[problem.lower == problem.upper] = LOWER
        key = tuple(int(state) for state in states)
        if key in seen:
            break
        seen.append(key)
        free = states == FREE
        z = np.where(states == LOWER, problem.lower, np.where(states == UPPER, problem.upper, 0.0))
        try:
            z[free] = np.linalg.solve(M[np.ix_(free, free)], -(M @ z + problem.q)[free])
        except np.linalg.LinAlgError:
            break
    yield from reversed(seen)


def _solution_of(
    problem: LCP, M: list[list[Fraction]], q: list[Fraction], states: States
) -> tuple[Fraction, ...] | None:
    """Return z of a case in which the equations determine z, if all rows are complementary."""
    n, ends = problem.n, {LOWER: problem.lower, UPPER: problem.upper}
    z = [Fraction(0) if states[i] == FREE else Fraction(ends[states[i]][i]) for i in range(n)]
    free = [i for i in range(n) if states[i] == FREE]
    rhs = [-q[i] - sum(M[i][j] * z[j] for j in range(n) if states[j] != FREE) for i in free]
    inner = solve_fractions([[M[i][j] for j in free] for i in free], rhs)
    for i, value in zip(free, inner or (), strict=False):
        z[i] = value
    return None if inner is None or not ExactData(problem).is_solution(z) else tuple(z)


def bound_violations(z: np.ndarray, exact: Exact, bound: Any) -> int:
    """Return the number of rows that violate the bound."""
    outside = 0
    for i, truth in enumerate(exact.z):
        limit = bound.componentwise[i]
        outside += bool(np.isfinite(limit)) and abs(Fraction(float(z[i])) - truth) > Fraction(
            float(limit)
        )
    with np.errstate(over="ignore"):  # of a z near the largest double
        others = (z, np.zeros_like(z), 1.0 - 3.0 * z)
    for other in others:
        limits = zip(other, exact.z, bound.carried_to(other), strict=True)
        outside += sum(
            bool(np.isfinite(y)) and abs(Fraction(float(a)) - b) > Fraction(float(y))
            for a, b, y in limits
        )
    error = max(abs(Fraction(float(a)) - b) for a, b in zip(z, exact.z, strict=True))
    size = Fraction(float(np.abs(z).max()))
    if np.isfinite(bound.relative):
        outside += error > Fraction(bound.relative) * size
    return outside + (np.isfinite(bound.infinity) and error > Fraction(bound.infinity))
