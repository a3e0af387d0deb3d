"""Small problems over boxes, second-order cones and friction cones against all their modes, solved in fractions.

In the plane a cone has four modes: the apex, its interior and two edges. All modes of all blocks are enumerated, the
linear system of each is solved in fractions, and every inequality is verified. Problems in space are problems in the
plane with one more tangent, which nothing couples to the others.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from fractions import Fraction
from itertools import pairwise, product
from operator import mul
from typing import Any

import numpy as np
from oracles.exact import exact_rows, rank, solve_fractions

from lcp_plugin import ConeProblem, FrictionalContact, solve

Problem = Any
Point = list[Fraction]
CLOSE = 1e-3  # relative error of a point that counts as a solution
CONDITION = 1e4  # of M, as for LCPs: a residual of 1e-8 is not an error beyond
DOCUMENTED = 1e-8  # of the largest |q_i|: inconsistencies below the tolerance are not noticed


def modes(problem: Problem, block: tuple[int, int]) -> str:
    """Return the modes of a block: in a box z = lower, w = 0, z = upper; of a cone apex, interior, two edges."""
    first, end = block
    if end - first > 1:
        return "ai+-"
    bounds = problem.lower[first], problem.upper[first]
    return "f" + "".join(np.array(["l", "u"])[np.isfinite(bounds)])


def equations(problem: Problem, M: Any, k: int, mode: str) -> Iterator[tuple[Point, Fraction]]:
    """Yield rows and right-hand sides of the linear system of a mode."""
    first, end = problem.starts[k : k + 2].tolist()
    q, mu = problem.q.tolist(), Fraction(float(problem.slope[k]))
    unit = [[Fraction(i == j) for j in range(problem.n)] for i in range(first, end)]
    if mode in "fi":
        yield from ((M[i], -Fraction(q[i])) for i in range(first, end))
    elif mode in "lu":
        yield unit[0], Fraction(float((problem.lower if mode == "l" else problem.upper)[first]))
    elif mode == "a":
        yield from ((row, Fraction(0)) for row in unit)
    else:  # w_T has the sign of the mode, z_T the other one
        sign = 1 if mode == "+" else -1
        edge = mu if problem.has_friction else 1
        yield [b + sign * edge * a for a, b in zip(*unit, strict=True)], Fraction(0)
        normal, tangent = M[first], M[first + 1]
        if problem.has_friction:
            yield normal, -Fraction(q[first])
        else:
            row = [b - sign * a for a, b in zip(normal, tangent, strict=True)]
            yield row, sign * Fraction(q[first]) - Fraction(q[first + 1])


def is_right(problem: Problem, k: int, z: Point, w: Point) -> bool:
    """Return whether a block satisfies its law exactly; the equations of its mode hold."""
    first, end = problem.starts[k : k + 2].tolist()
    z, w = z[first:end], w[first:end]
    if len(z) == 1:
        low, high = problem.lower[first], problem.upper[first]
        is_inside = low <= z[0] <= high
        return bool(is_inside and not (w[0] > 0 and z[0] > low) and not (w[0] < 0 and z[0] < high))
    if not problem.has_friction:
        return z[0] >= abs(z[1]) and w[0] >= abs(w[1]) and sum(map(mul, z, w)) == 0
    mu = Fraction(float(problem.slope[k]))
    is_signorini = z[0] >= 0 and w[0] >= 0 and z[0] * w[0] == 0
    is_sliding = z[1] * w[1] <= 0 and abs(z[1]) == mu * z[0]
    return is_signorini and abs(z[1]) <= mu * z[0] and (w[1] == 0 or is_sliding)


def slack(problem: Problem, z: Any) -> Point:
    """Return M z + q in fractions."""
    rows, q = exact_rows(problem.rows.csr), problem.q.tolist()
    return [
        sum(map(mul, row, map(Fraction, z))) + Fraction(c) for row, c in zip(rows, q, strict=True)
    ]


def solutions(problem: Problem) -> tuple[list[Point], bool]:
    """Return the solutions of all regular modes, and whether a singular mode is consistent: it may have others."""
    M, found, is_vague = exact_rows(problem.rows.csr), [], False
    blocks = list(pairwise(problem.starts.tolist()))
    for chosen in product(*(modes(problem, block) for block in blocks)):
        system = [row for k, mode in enumerate(chosen) for row in equations(problem, M, k, mode)]
        A, b = [list(part) for part in zip(*system, strict=True)]
        z = solve_fractions(A, b)
        if z is None:
            is_vague |= rank(A) == rank([[*row, right] for row, right in system])
            continue
        w = slack(problem, z)
        if all(is_right(problem, k, z, w) for k in range(len(blocks))):
            found.append(z)
    return found, is_vague


def violation(problem: Problem, z: Any) -> float:
    """Return the largest violation of a block, exact up to its last rounding, in the unit of w."""
    w, worst = slack(problem, z), 0.0
    for k, (first, end) in enumerate(pairwise(problem.starts.tolist())):
        at, own = np.array(z[first:end], float), np.array([float(x) for x in w[first:end]])
        if end - first == 1:
            low, high = problem.lower[first], problem.upper[first]
            size = max(own[0] * (at[0] > low), -own[0] * (at[0] < high))
        elif problem.has_friction:
            size = max(-own[0], own[0] * (at[0] > 0))
            is_at_end = abs(at[1]) >= problem.slope[k] * at[0] * (1 - 1e-12)
            size = max(size, abs(own[1]) * (not is_at_end or at[1] * own[1] > 0))
        else:
            size = np.abs(at @ own) / max(at[0], 1e-300) + max(abs(own[1]) - own[0], 0.0)
        worst = max(worst, float(size))
    return worst


def numbers(rng: np.random.Generator, size: Any, low: int, high: int, zeros: float = 0.25) -> Any:
    """Return integers, powers of two, or a mixture of both."""
    sign = rng.choice([-1.0, 1.0], size) * (rng.random(size) > zeros)
    kind = rng.integers(4)
    if kind == 0:
        return sign * rng.integers(1, 5, size)
    if kind == 1:
        return sign * 2.0 ** rng.integers(low, high, size)
    exponents = rng.integers(low, high, size) * (rng.random(size) < 0.3)
    return sign * rng.integers(1, 4, size) * 2.0 ** (exponents if kind == 2 else 0.0)


def box(rng: np.random.Generator) -> ConeProblem:
    """Return a problem over bounds: odd diagonals, rows of 0 and 1, near-parallel rows, idle rows."""
    n = int(rng.integers(1, 5))
    M, q = numbers(rng, (n, n), -20, 21), numbers(rng, n, -30, 48, 0.3)
    free = np.where(rng.random(n) < 0.5, -np.inf, numbers(rng, n, -10, 34))
    lower = np.where(rng.random(n) < 0.7, 0.0, free)
    width = 2.0 ** rng.integers(-3, 20, n) * rng.integers(0, 3, n)
    upper = np.where(rng.random(n) < 0.7, np.inf, np.maximum(lower, 0.0) + width)
    if rng.random() < 0.3:
        np.fill_diagonal(M, np.abs(M.diagonal()))
    if rng.random() < 0.25 and n > 1:
        M[-1] = M[0] * rng.choice([-1.0, 1.0, 1.0 + 2.0**-17])
    return ConeProblem(M, q, [("box", lower, upper)])


def cones(rng: np.random.Generator) -> ConeProblem:
    """Return a problem over one or two cones in the plane, and perhaps a number ≥ 0."""
    shapes = [("second_order", 2)] * int(rng.integers(1, 3))
    shapes += [("nonnegative", 1)] * int(rng.integers(0, 2))
    n = sum(rows for _, rows in shapes)
    M, q = numbers(rng, (n, n), -20, 21), numbers(rng, n, -30, 48, 0.3)
    if rng.random() < 0.5:
        half = rng.integers(-2, 3, (n, n)).astype(float)
        M = half @ half.T * 2.0 ** rng.integers(-10, 10)
        M += np.diag(2.0 ** rng.integers(-8, 9, n)) * rng.integers(0, 2)
    if rng.random() < 0.2:
        M[-1] = -M[0]
    return ConeProblem(M, q, shapes)


def contacts(rng: np.random.Generator) -> FrictionalContact:
    """Return one or two contacts in the plane: bodies, chains of weak links, fast slides."""
    k = int(rng.integers(1, 3))
    n, units = 2 * k, 2.0 ** (rng.integers(-14, 15, (2 * k, 1)) * rng.integers(0, 2))
    J = rng.integers(-2, 3, (n, n)) * units
    W = J @ J.T + np.diag(2.0 ** rng.integers(-4, 6, n)) * (rng.random() < 0.4)
    if rng.random() < 0.3:
        W, i, j = np.eye(n), rng.integers(0, 2), n - 1 - rng.integers(0, 2)
        W[i, j] = W[j, i] = 1.0 if i == j else 2.0 ** -rng.integers(2, 45)
    mu = rng.choice([0.0, 0.25, 0.5, 0.75, 1.0, 2.0], k)
    return FrictionalContact(W, numbers(rng, n, -20, 34, 0.2), mu, dimension=2)


def in_space(problem: Problem, rng: np.random.Generator) -> tuple[Problem, Any]:
    """Return the problem with one more tangent in each cone, and the rows of the problem in the plane."""
    sizes = problem.sizes + (problem.sizes > 1)
    starts = np.concatenate([[0], np.cumsum(sizes)])
    other = starts[:-1][sizes > 1] + rng.integers(1, 3, int((sizes > 1).sum()))
    kept = np.setdiff1d(np.arange(starts[-1]), other)
    M, q = np.zeros((starts[-1], starts[-1])), np.zeros(starts[-1])
    M[np.ix_(kept, kept)], q[kept] = problem.rows.csr.toarray(), problem.q
    M[other, other] = 2.0 ** rng.integers(-6, 7, other.size)
    if problem.has_friction:
        return FrictionalContact(M, q, problem.slope, dimension=3), kept
    names = ["nonnegative" if rows == 1 else "second_order" for rows in sizes]
    return ConeProblem(M, q, list(zip(names, sizes.tolist(), strict=True))), kept


FAMILIES = (box, cones, contacts)


def drawn(seed: int) -> tuple[str, Problem, Problem, Any]:
    """Return the family, a problem in the plane, the same or its form in space, and the rows of the former."""
    rng = np.random.default_rng([92, seed])
    family = FAMILIES[seed % 3]
    problem = family(rng)
    if family is box or rng.random() < 0.6:
        return family.__name__, problem, problem, np.arange(problem.n)
    return f"{family.__name__} in space", problem, *in_space(problem, rng)


def starts_of(
    problem: Problem, run: Problem, kept: Any, right: list[Point], seed: int
) -> list[Any]:
    """Return starts: none, an arbitrary point, and a point close to a solution with another mode."""
    rng, n = np.random.default_rng([93, seed]), problem.n
    found: list[Any] = [None, np.zeros(run.n)]
    found[1][kept] = numbers(rng, n, -10, 48)
    if right:
        z = np.array([float(x) for x in right[rng.integers(len(right))]])
        z[rng.integers(n)] *= 1.0 + 2.0 ** -rng.integers(1, 20)
        found.append(np.zeros(run.n))
        found[2][kept] = z + (rng.random(n) < 0.3) * numbers(rng, n, -4, 30)
    return found


def verdict(problem: Problem, z: Any, right: list[Point], is_vague: bool) -> str:
    """Return "right", "false", or the reason why a point may be SOLVED that is none of the solutions."""
    size = max(float(np.abs(z).max(initial=0.0)), 1e-300)
    errors = [max(abs(float(a - Fraction(b))) for a, b in zip(x, z, strict=True)) for x in right]
    if min(errors, default=np.inf) <= CLOSE * size:
        return "right"
    if violation(problem, z) <= DOCUMENTED * np.abs(problem.q).max():
        return "inconsistent by less than the tolerance"
    if is_vague:
        return "one of a continuum"
    is_regular = np.linalg.cond(problem.rows.csr.toarray()) <= CONDITION
    return "false" if is_regular else "another point, M ill-conditioned"


def check(seed: int, **options: Any) -> Counter[str]:
    """Return the verdicts on the results of one problem from all starts."""
    name, problem, run, kept = drawn(seed)
    right, is_vague = solutions(problem)
    found: Counter[str] = Counter()
    for z0 in starts_of(problem, run, kept, right, seed):
        result = solve(run, z0=z0, **options)
        if result.is_solved:
            found[f"{name}: {verdict(problem, result.z[kept], right, is_vague)}"] += 1
        else:
            found[f"{name}: {'missed' if right else 'not solved'}"] += 1
    return found
