"""Hill climbing against the judge of nonlinear problems: points that are wrong by more than 1 %, and pass.

F(x) = s (M x + g(x) + q) by rows, M positive definite or a P-matrix of integers, some diagonals of 1e-6 … 1e-12, g of
increasing functions t³, exp t, −1/(t+1) or none, s units of rows, the unknowns in units, and x* planted: its only
solution. The climber lowers the least tolerance at which the certificate passes a point. A point falls if it passes at
1e-11; if the sums of a row are right to 1e-7 of their terms, no residual distinguishes the point from a solution.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np

from lcp_plugin import NonlinearProblem
from lcp_plugin.core.settings import Settings
from lcp_plugin.problems.nonlinear.certificate import Linearizations

JUDGE, ILL_CONDITIONED, STEPS = 1e-8, 1e-7, 240

ERROR, POLISH = 0.01, 1e-3
# decimal exponents of tolerances, and how finely they are found
LEAST, MOST, HALVINGS = -13.0, -0.01, 9


class Target(NamedTuple):
    """A problem with its answer: what the judge says of another one, and how wrong that is."""

    problem: NonlinearProblem
    right: np.ndarray  # of all numbers that the climber moves
    passes: Callable[[np.ndarray, float], bool]  # at a tolerance
    error: Callable[[np.ndarray], float]
    moves: Callable[[np.random.Generator, np.ndarray], np.ndarray]
    is_hopeless: Callable[[np.ndarray], bool]  # whether no residual could tell
    text: Callable[[np.ndarray], str]


def least_tolerance(target: Target, point: np.ndarray, below: float) -> float:
    """The decimal exponent of the least tolerance at which the judge passes a point; ∞ where it is above `below`."""
    if not target.passes(point, 10.0**below):
        return math.inf
    low, high = LEAST, below
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if target.passes(point, 10.0**middle) else (middle, high)
    return high


def climb(rng: np.random.Generator, target: Target, steps: int) -> tuple[np.ndarray | None, float]:
    """The point with the least tolerance that was found with an error above 1 %, and that tolerance."""
    best, least = None, MOST
    for _attempt in range(4):
        point = target.right.copy()
        for _ in range(30):
            point = target.moves(rng, point)
            if target.error(point) > ERROR:
                break
        else:
            continue
        value = least_tolerance(target, point, MOST)
        for _ in range(steps // 4):
            moved = target.moves(rng, point)
            if rng.random() < 0.3:
                moved = target.moves(rng, moved)
            if not np.isfinite(moved).all() or not target.error(moved) > ERROR:
                continue
            found = least_tolerance(target, moved, min(value, MOST))
            if found <= value:
                point, value = moved, found
        if best is None or value < least:
            best, least = point, value
        if least <= LEAST + 0.1:
            break
    return best, 10.0**least


def stepped(rng: np.random.Generator, value: float) -> float:
    """A number at another scale, of another sign, or 0."""
    kind = rng.integers(0, 6)
    if kind == 0:
        return 0.0
    if kind == 1:
        return -value
    if kind == 2:
        return value + float(rng.choice([-1, 1]) * 10.0 ** rng.uniform(-12, 12))
    if kind == 3:
        return float(
            rng.choice([-1, 1]) * 10.0 ** rng.choice([-15, -12, -9, -6, -3, 0, 3, 6, 9, 12])
        )
    return (
        value * 10.0 ** rng.uniform(-3, 3)
        if kind == 4
        else value * (1 + rng.choice([-1, 1]) * 10.0 ** rng.uniform(-4, 0))
    )


def along_a_row(rng: np.random.Generator, rows: np.ndarray, point: np.ndarray) -> np.ndarray:
    """Two numbers moved so that a row of theirs stays as it is."""
    moved, row = point.copy(), rows[rng.integers(0, len(rows))]
    places = np.flatnonzero(row)
    if places.size < 2:
        return moved
    i, j = rng.choice(places, 2, replace=False)
    size = rng.choice([-1, 1]) * 10.0 ** rng.uniform(-9, 12)
    moved[i] += size / row[i]
    moved[j] -= size / row[j]
    return moved


def planted(rng: np.random.Generator) -> Target:
    """Return a problem with its answer, x ≥ 0."""
    n = int(rng.integers(1, 5))
    A, kind = (
        rng.integers(-3, 4, (n, n)).astype(float),
        str(rng.choice(["dominant", "definite", "skew", "triangular"])),
    )
    M = {
        "dominant": A + np.diag(abs(A).sum(axis=1) + 1 - A.diagonal()),
        "definite": A @ A.T + np.eye(n),
        "skew": A - A.T + np.diag(rng.choice([1.0, 1e-6, 1e-9, 1e-12], n)),
        "triangular": np.tril(A, -1) + np.diag(rng.choice([1.0, 1e-6, 1e-9], n)),
    }[kind]
    shapes = rng.integers(0, 4, n)
    state, rows, units = (
        rng.integers(0, 3, n),
        *(rng.choice([1.0, 1e-9, 1e-4, 1e6], n, p=[0.6, 0.15, 0.15, 0.1]) for _ in range(2)),
    )
    if rng.random() < 0.5:
        units = np.ones(n)
    far = np.where(rng.random(n) < 0.15, 1e6, 1.0) * (shapes != 2) + (shapes == 2)
    right = np.where(state == 0, rng.integers(1, 5, n), 0) * far
    w = np.where(state == 1, rng.integers(1, 5, n), 0.0)

    @np.errstate(all="ignore")
    def curve(t: np.ndarray) -> np.ndarray:
        return np.choose(shapes, [0.0 * t, t**3, np.exp(t), -1.0 / (t + 1.0)])

    @np.errstate(all="ignore")
    def slope(t: np.ndarray) -> np.ndarray:
        return np.choose(shapes, [0.0 * t, 3 * t**2, np.exp(t), (t + 1.0) ** -2.0])

    q = w - M @ right - curve(right)

    def F(x: np.ndarray) -> np.ndarray:
        t = x * units
        return rows * (M @ t + curve(t) + q)

    def jacobian(x: np.ndarray) -> np.ndarray:
        return rows[:, None] * (M + np.diag(slope(x * units))) * units

    problem = NonlinearProblem(F, jacobian, lower=np.zeros(n))
    points, answer = Linearizations(problem), right / units

    def passes(x: np.ndarray, tolerance: float) -> bool:
        at = points.at(x)
        return at.is_defined and at.certificate.meets(Settings(tolerance=tolerance))

    def error(x: np.ndarray) -> float:
        wrong, size = abs(x * units - right).max(), abs(right).max()
        return float(wrong / size if size else wrong)

    def moves(rng: np.random.Generator, x: np.ndarray) -> np.ndarray:
        moved, i = x.copy(), rng.integers(0, n)
        if rng.random() < 0.3:
            moved = along_a_row(rng, jacobian(x), moved)
        else:
            moved[i] = stepped(rng, moved[i])
        return np.maximum(np.nan_to_num(moved), 0.0)

    def is_hopeless(x: np.ndarray) -> bool:
        t = x * units
        value, terms = M @ t + curve(t) + q, abs(M) @ t + abs(curve(t)) + abs(q)
        wrong = np.where(t > 0, abs(value), np.maximum(-value, 0.0))
        return bool((wrong <= ILL_CONDITIONED * terms).all())

    def text(x: np.ndarray) -> str:
        return (
            f"{kind}: M={M.tolist()}, q={q.tolist()}, shapes={shapes.tolist()}, rows={rows.tolist()}, "
            f"units={units.tolist()} at {x.tolist()}, right {answer.tolist()}"
        )

    return Target(problem, answer, passes, error, moves, is_hopeless, text)


def attacks(rng: np.random.Generator, count: int, steps: int = STEPS) -> Iterator[tuple[str, str]]:
    """Yield what became of each problem, and in words."""
    for _ in range(count):
        target = planted(rng)
        if not target.passes(target.right, JUDGE):
            yield "right refused", target.text(target.right)
            continue
        point, least = climb(rng, target, steps)
        what = "holds"
        if point is not None and least <= JUDGE:
            what = "ill-conditioned" if target.is_hopeless(point) else "falls"
            what += " polished" if what == "falls" and least <= JUDGE * POLISH else ""
        yield what, "" if point is None or what == "holds" else f"{least:.1e}: {target.text(point)}"


def attack_nonlinear(rng: np.random.Generator, count: int) -> Iterator[str]:
    """Yield the points that fall after a polish's tolerance."""
    yield from (text for what, text in attacks(rng, count) if what == "falls polished")
