"""Small integer problems with tiny diagonal entries, the truth by all cases in exact fractions.

A tiny m_ii makes the distance w_i / m_ii irrelevant for the rest of the problem, and the sign of an m_ii that cancels
is random. The script prints counts of statuses, also for problems with a known solution, 20 unknowns and one entry
1e-9, and each false SOLVED.

A z far from every solution is ill-conditioned, but not false, if it solves a problem with all numbers within the
tolerance, relatively. By Oettli and Prager this means that the violation of each row is at most the tolerance times
the sum of the sizes of its terms. M is then singular up to such a change.
"""

from __future__ import annotations

from collections.abc import Iterator
from fractions import Fraction
from itertools import chain, combinations

import numpy as np

from lcp_plugin import LCP, solve

Exact = list[Fraction]
FAR = 1e-3  # relative to the largest unknown: a z farther from every solution is wrong
ROUNDED, TOLERANCE = 1e-11, 1e-8  # relative to a row's terms: of the data, of the run
UNIT = Fraction(1e-16)  # of integers
SLIGHT = 1e-6  # tolerated violation of a sign by a point near z on a segment of solutions


def drawn(rng: np.random.Generator, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Return M and q with entries −3 … 3, and some of the diagonal 1e-6 … 1e-12, now and then negative."""
    M, q = rng.integers(-3, 4, (n, n)).astype(float), rng.integers(-3, 4, n).astype(float)
    if rng.random() < 0.5:  # more of them have solutions
        M = np.where(np.eye(n) > 0.0, abs(M) + rng.integers(0, 3), np.triu(M) - np.triu(M).T)
    some = rng.random(n) < rng.choice([0.3, 0.6])
    some[rng.integers(n)] = True
    tiny = 10.0 ** -rng.integers(6, 13, n) * np.where(rng.random(n) < 0.9, 1.0, -1.0)
    np.fill_diagonal(M, np.where(some, tiny, M.diagonal()))
    return M, q


def planted(rng: np.random.Generator, n: int = 20) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return a P-matrix with one diagonal entry 1e-9, q and the solution."""
    half = rng.uniform(-1.0, 1.0, (n, n))
    M = half - half.T + np.diag(rng.uniform(0.5, 2.0, n))  # xᵀMx > 0
    i = int(rng.integers(n))
    M[i, i] = 1e-9
    z = np.where(rng.random(n) < 0.5, rng.uniform(0.5, 2.0, n), 0.0)
    w = np.where(z > 0.0, 0.0, rng.uniform(0.5, 2.0, n))
    return M, w - M @ z, z


def beside(rows: list[Exact], right: Exact, x: Exact) -> Exact | None:
    """Return the solution of a linear system, with undetermined unknowns from x, or None."""
    system, pivots = (
        [[*row, value] for row, value in zip(rows, right, strict=True)],
        dict[int, int](),
    )
    for k, row in enumerate(system):
        for column, at in pivots.items():
            factor = row[column]
            row[:] = [a - factor * b for a, b in zip(row, system[at], strict=True)]
        column = max(range(len(x)), key=lambda j: abs(row[j]), default=0)
        if not x or not row[column]:
            if row[-1]:
                return None
            continue
        row[:] = [a / row[column] for a in row]
        for at in pivots.values():
            factor = system[at][column]
            system[at][:] = [a - factor * b for a, b in zip(system[at], row, strict=True)]
        pivots[column] = k
    found = list(x)
    for column, k in pivots.items():
        rest = sum((system[k][j] * x[j] for j in range(len(x)) if j not in pivots), Fraction(0))
        found[column] = system[k][-1] - rest
    return found


def solutions_near(M: np.ndarray, q: np.ndarray, z: np.ndarray) -> Iterator[Exact]:
    """Yield a solution per solvable active set, each near z, the active set of z first."""
    n = q.size
    exact, offset, point = ([Fraction(v) for v in array.ravel().tolist()] for array in (M, q, z))
    own = tuple(np.flatnonzero(z > M @ z + q).tolist())
    for free in chain(
        [own], (F for k in range(n + 1) for F in combinations(range(n), k) if own != F)
    ):
        rows = [[exact[i * n + j] for j in free] for i in free]
        found = beside(rows, [-offset[i] for i in free], [point[i] for i in free])
        if found is None:
            continue
        whole = [Fraction(0)] * n
        for i, value in zip(free, found, strict=True):
            whole[i] = value
        w = [sum((exact[i * n + j] * whole[j] for j in free), offset[i]) for i in range(n)]
        slight = Fraction(SLIGHT) * max([*map(abs, whole), Fraction(1)]) if is_singular(rows) else 0
        if all(w[i] >= -slight for i in range(n)) and all(value >= -slight for value in whole):
            yield whole


def is_singular(rows: list[Exact]) -> bool:
    """Return whether a square system leaves an unknown open."""
    zero = [Fraction(0)] * len(rows)
    one = [Fraction(1)] * len(rows)
    return beside(rows, zero, one) != zero


def kind_of_answer(M: np.ndarray, q: np.ndarray, z: np.ndarray) -> str:
    """Return '' if a solution is near z or all rows hold, else the type of failure."""
    wrong = largest_wrong_part(M, q, z)
    if wrong <= ROUNDED:
        return ""
    for whole in solutions_near(M, q, z):
        at = np.array([float(value) for value in whole])
        if abs(at - z).max() <= FAR * max(abs(at).max(), abs(z).max()):
            return ""
    return " of a problem within the tolerance" if wrong <= TOLERANCE else " falsely"


def largest_wrong_part(M: np.ndarray, q: np.ndarray, z: np.ndarray) -> float:
    """Return the largest exact violation of w relative to the terms of its row; ∞ unless z ≥ 0."""
    largest, point = Fraction(0), [Fraction(value) for value in z.tolist()]
    for row, offset, own in zip(M.tolist(), q.tolist(), point, strict=True):
        terms = [Fraction(offset), *(Fraction(a) * b for a, b in zip(row, point, strict=True))]
        w = sum(terms)
        wrong = abs(w) if own > 0 else -w
        if own < 0:
            return np.inf
        if wrong > UNIT:
            largest = max(largest, wrong / sum(map(abs, terms)))
    return float(largest)


def judged(case: tuple[np.ndarray, np.ndarray], algorithm: str = "auto") -> tuple[str, np.ndarray]:
    """Return the status, extended by the type of failure of a false SOLVED, and z."""
    result = solve(LCP(*case), algorithm, max_iterations=1000)
    return result.status.name + (
        kind_of_answer(*case, result.z) if result.is_solved else ""
    ), result.z
