"""Hill climbing against the judge of cones and contacts: points in K that are wrong by more than 1 %, and pass.

    python tests/campaigns/attack.py --kind cones --count 2000

Answers are planted: definite M with a skew part, tiny entries, blocks in units of their own, a component of unknowns
at 1e12, so that there is one answer. A climber lowers the largest of the relative and the term residual over points
whose error stays above 1 %. What passes at a thousandth of the tolerance is a fall, unless every block is right to
1e-7 of its own terms in 50 digits: then M is ill-conditioned, and no residual tells.
"""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))
from attack import stepped
from cone_families import violation

from lcp_plugin import ConeProblem, FrictionalContact
from lcp_plugin.problems.cones.certificate import ConeCertificate

Generator = np.random.Generator
ERROR, TOLERANCE, POLISH, HOPELESS = 0.01, 1e-8, 1e-3, 1e-7
SIZES, UNITS = (
    ([3], [3, 3], [3, 3, 3], [2, 2], [1, 3], [3, 1, 1], [1, 2, 2]),
    [1.0, 1e-9, 1e-4, 1e6],
)
seen = Counter[str]()


def planted(rng: Generator) -> tuple[Any, Any]:
    """A problem over cones, or of contacts, and its one answer."""
    has_friction = rng.random() < 0.3
    sizes = [3] * int(rng.integers(1, 4)) if has_friction else SIZES[rng.integers(len(SIZES))]
    n, starts = sum(sizes), np.concatenate([[0], np.cumsum(sizes)])
    A = rng.integers(-3, 4, (n, n)).astype(float)
    M = A @ A.T + np.diag(rng.choice([1.0, 1e-3, 1e-6, 1e-9], n))
    mu = (
        rng.choice([0.0, 0.1, 0.3], len(sizes))
        if has_friction
        else np.where(np.array(sizes) > 1, 1.0, 0.0)
    )
    if has_friction:
        M = M + 10.0 * np.eye(n)
    elif rng.random() < 0.5:
        M = rng.choice([1.0, 1e-3, 0.0]) * M + A - A.T + np.diag(rng.choice([1.0, 1e-6, 1e-9], n))
    z, w = np.zeros(n), np.zeros(n)
    for k, m in enumerate(sizes):
        own, way = slice(starts[k], starts[k + 1]), rng.standard_normal(m)
        way[1:] /= np.linalg.norm(way[1:]) if m > 1 else 1.0
        edge = np.array([1.0, *(mu[k] * way[1:])])
        case = rng.integers(0, 4)
        if case == 0:
            w[own] = [rng.uniform(0.5, 3.0), *(0.1 * way[1:])]
        elif case == 1 or m == 1 or (has_friction and mu[k] == 0.0):
            z[own] = rng.integers(1, 4) * np.array([1.0, *(0.5 * mu[k] * way[1:])])
        elif case == 2:
            z[own] = rng.integers(1, 4) * edge
            w[own] = rng.uniform(0.1, 2.0) * np.array([0.0 if has_friction else 1.0, *-way[1:]])
    if rng.random() < 0.5 and not has_friction:
        rows, columns = (
            np.repeat(rng.choice(UNITS, len(sizes), p=[0.6, 0.15, 0.15, 0.1]), sizes)
            for _ in range(2)
        )
        M, w, z = rows[:, None] * M * columns, rows * w, z / columns
    if rng.random() < 0.4 and not has_friction:
        M, sizes = np.pad(M, ((0, 3), (0, 3))), [*sizes, 3]
        M[-3:, -3:] = [[1.0, 0.5, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
        z, w = np.append(z, [1e12, 1e11, 0.0]), np.append(w, np.zeros(3))
    q = w - M @ z
    if has_friction:
        return FrictionalContact(M, q, mu), z
    return ConeProblem(M, q, [("second_order", size) for size in sizes]), z


def error(problem: Any, right: Any, point: Any) -> float:
    """The largest error of a component, beside its answer; the component at 1e12 is the last block."""
    parts = (
        [slice(0, problem.n)]
        if not right.max(initial=0.0) >= 1e11
        else [slice(0, problem.n - 3), slice(-3, None)]
    )
    return max(
        float(abs(point - right)[own].max() / (abs(right)[own].max() or 1e-9)) for own in parts
    )


def moved(rng: Generator, problem: Any, point: Any) -> Any:
    """Another point of K: one number, a block, two numbers that cancel in a row, or the system of other cases."""
    M, new, kind = problem.rows.csr.toarray(), point.copy(), rng.random()
    if kind < 0.2:
        places = np.flatnonzero(M[rng.integers(problem.n)])
        if places.size > 1:
            row = M[rng.integers(problem.n)]
            i, j = rng.choice(places, 2, replace=False)
            size = rng.choice([-1, 1]) * 10.0 ** rng.uniform(-9, 12)
            new[i] += size / (row[i] or 1.0)
            new[j] -= size / (row[j] or 1.0)
    elif kind < 0.4:
        free = (rng.random(problem.slope.size) < 0.5)[problem.block_of_row]
        new = np.zeros(problem.n) if rng.random() < 0.5 else new
        new[free] = np.linalg.lstsq(
            M[np.ix_(free, free)], -(problem.q + M @ np.where(free, 0.0, new))[free]
        )[0]
    elif kind < 0.6:
        k = rng.integers(problem.slope.size)
        new[problem.starts[k] : problem.starts[k + 1]] *= rng.choice(
            [0.0, 10.0 ** rng.uniform(-3, 3)]
        )
    else:
        i = rng.integers(problem.n)
        new[i] = stepped(rng, new[i])
    return problem.projected(new)


def measure(problem: Any, point: Any) -> tuple[float, Any]:
    """The least tolerance at which the criterion passes a point, and the snapped point, which a result has."""
    found = ConeCertificate.at(problem, point)
    return max(found.relative_residual, found.term_residual), found.point


def attack_cones(rng: Generator, count: int, steps: int = 400) -> Iterator[str]:
    """Yield the falls of so many problems."""
    for _ in range(count):
        problem, right = planted(rng)
        seen["problems"] += 1
        if measure(problem, problem.projected(right))[0] > TOLERANCE:
            seen["right ones refused"] += 1
            continue
        best, least = right, np.inf
        for _attempt in range(4):
            point, value = problem.projected(right), np.inf
            for _ in range(steps // 4):
                new = moved(rng, problem, point)
                if not np.isfinite(new).all():
                    continue
                found, new = measure(problem, new)
                if not error(problem, right, new) > ERROR:
                    continue
                if found <= value:
                    point, value = new, found
            best, least = (point, value) if value < least else (best, least)
        if least > TOLERANCE:
            continue
        is_hopeless = violation(problem, best) <= HOPELESS
        is_polished = least <= POLISH * TOLERANCE
        seen[
            "ill-conditioned" if is_hopeless else "falls polished" if is_polished else "falls"
        ] += 1
        if is_polished and not is_hopeless:
            yield (
                f"{problem!r} M {problem.rows.csr.toarray().tolist()}, q {problem.q.tolist()}, at {best.tolist()}, "
                f"right {right.tolist()}: passes at {least:.0e}"
            )


if __name__ == "__main__":
    for fall in attack_cones(
        np.random.default_rng(int(sys.argv[2]) if sys.argv[2:] else 0), int(sys.argv[1])
    ):
        print(fall)
    print(dict(seen))
