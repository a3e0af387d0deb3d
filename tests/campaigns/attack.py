"""Hill climbing against the judge of each kind: answers that are wrong by more than 1 %, and pass.

    python tests/campaigns/attack.py --kind program --count 2000 --seed 0

Problems come with their answers. The climber changes an answer and its multipliers, one or two numbers at a time, so
that the tolerance at which the judge passes it falls while the error stays above 1 %: log-scaled steps, steps to a
bound, pairs that cancel in a row or a column, systems of other cases, unknowns of other components at 1e12, rows of
1e-9, multipliers that absorb a gradient. The judge is asked through public objects alone, `Certificate` and
`QPSolution`, at one tolerance after another; the error is known from the planted answer.

A fall passes at the judge's tolerance; "polished" ones at a thousandth of it, as a last linear solve leaves answers.
Falls of LCPs whose rows are right to 1e-7 of their own terms, exactly, are ill-conditioned: no residual tells. Exit
code 1 where more than 1 in 1 000 falls after a polish.
"""

from __future__ import annotations

import argparse
import collections
import importlib
import math
import sys
import time
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import block_diag

sys.path.insert(0, str(Path(__file__).parents[1]))
sys.path.insert(0, str(Path(__file__).parent))
from outliers import ExactLCP, integers, limits, value_of, violation

import lcp_plugin as lp
from lcp_plugin.core.settings import Settings
from lcp_plugin.problems.programs.solution import QPSolution

Generator = np.random.Generator
ERROR, POLISH = 0.01, 1e-3
LEAST, MOST, HALVINGS = (
    -13.0,
    -0.01,
    9,
)  # decimal exponents of tolerances, and how finely they are found
JUDGES = {"lcp": 1e-8, "program": 1e-6, "linear": 1e-6}
OTHERS = {  # the climbers of other kinds: functions of (rng, count) that yield or return falls
    "cones": ("attack_cones", "attack_cones"), "nonlinear": ("attack_nonlinear", "attack_nonlinear"),
    "certify": ("attack_programs", "attack_certify"), "least_squares": ("attack_programs", "attack_least_squares"),
}  # fmt: skip


class Target(NamedTuple):
    """A problem with its answer: what the judge says of another one, and how wrong that is."""

    right: np.ndarray  # of all numbers that the climber moves
    passes: Callable[[np.ndarray, float], bool]  # at a tolerance
    error: Callable[[np.ndarray], float]
    moves: Callable[[Generator, np.ndarray], np.ndarray]
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


def climb(rng: Generator, target: Target, steps: int) -> tuple[np.ndarray | None, float]:
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


def stepped(rng: Generator, value: float) -> float:
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


def along_a_row(rng: Generator, rows: np.ndarray, point: np.ndarray) -> np.ndarray:
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


# --- Complementarity ----------------------------------------------------------------------------------------------


def planted_lcp(rng: Generator) -> Target:
    """A P-matrix of integers in units, with tiny rows and diagonals, beside a component of unknowns at 1e12."""
    n = int(rng.integers(2, 5))
    kind = str(rng.choice(["dominant", "definite", "skew", "triangular"]))
    A = integers(rng, n, n)
    M = A + np.diag(abs(A).sum(axis=1) + 1 - A.diagonal())
    if kind == "definite":
        M = A @ A.T + np.eye(n) * rng.choice([1.0, 1e-3])
    elif kind == "skew":
        M = A - A.T + np.diag(rng.choice([1.0, 1e-6, 1e-9, 1e-12], n))
    elif kind == "triangular":
        M = np.tril(A, -1) + np.diag(rng.choice([1.0, 1e-6, 1e-9], n))
    state = rng.integers(0, 3, n)
    z = np.where(state == 0, rng.integers(1, 5, n), 0) * rng.choice(
        [1.0, 1e-6, 1e6], n, p=[0.7, 0.15, 0.15]
    )
    w = np.where(state == 1, rng.integers(1, 5, n), 0) * rng.choice(
        [1.0, 1e-6, 1e6], n, p=[0.7, 0.15, 0.15]
    )
    rows, columns = (
        rng.choice([1.0, 1e-9, 1e-4, 1e6], n, p=[0.6, 0.15, 0.15, 0.1]) for _ in range(2)
    )
    if rng.random() < 0.5:
        M, w, z = rows[:, None] * M * columns, rows * w, z / columns
    if rng.random() < 0.4:
        M = block_diag(M, [[1.0, 0.5], [0.0, 1.0]])
        z, w = np.append(z, [1e12, 1e12]), np.append(w, [0.0, 0.0])
    q = w - M @ z
    judge, exact = lp.LCP(M, q), ExactLCP(M, q)
    solution = next(exact.solutions(), None)
    if solution is None:
        return planted_lcp(rng)
    right, part = np.array([float(value) for value in solution]), exact.parts()

    def passes(point: np.ndarray, tolerance: float) -> bool:
        return lp.Certificate.of(judge, point).is_solved(Settings(tolerance=tolerance))

    def error(point: np.ndarray) -> float:
        worst = 0.0
        for k in range(part.max() + 1):
            wrong, size = abs(point - right)[part == k].max(), abs(right)[part == k].max()
            worst = max(worst, wrong / size if size else float(wrong > 1e-12 * abs(right).max()))
        return worst

    def moves(rng: Generator, point: np.ndarray) -> np.ndarray:
        moved, kind = point.copy(), rng.random()
        if kind < 0.2:
            moved = along_a_row(rng, M, moved)
        elif kind < 0.4:  # the system of another case
            free = np.flatnonzero(rng.random(len(q)) < 0.5)
            moved = np.zeros(len(q)) if rng.random() < 0.5 else moved
            others = np.setdiff1d(np.arange(len(q)), free)
            with np.errstate(all="ignore"):
                right_hand = -(q[free] + M[np.ix_(free, others)] @ moved[others])
                if free.size and np.linalg.matrix_rank(M[np.ix_(free, free)]) == free.size:
                    moved[free] = np.linalg.solve(M[np.ix_(free, free)], right_hand)
        else:
            i = rng.integers(0, len(q))
            moved[i] = stepped(rng, moved[i])
        return np.maximum(moved, 0.0)

    def text(point: np.ndarray) -> str:
        return (
            f"{kind}: LCP({M.tolist()}, {q.tolist()}) at {point.tolist()}, right {right.tolist()}"
        )

    return Target(right, passes, error, moves, lambda point: exact.wrong(point) <= 1e-7, text)


# --- Programs -----------------------------------------------------------------------------------------------------


def planted_program(rng: Generator, *, linear: bool = False) -> Target:
    """Answers and multipliers come first; rows in units, tiny ones, doubled ones, idle unknowns, far costs."""
    n, m = int(rng.integers(1, 5)), int(rng.integers(1, 5))
    G, x = (
        integers(rng, m, n),
        integers(rng, n) * rng.choice([1.0, 1e-6, 1e6], n, p=[0.7, 0.15, 0.15]),
    )
    A = integers(rng, int(rng.random() < 0.4), n)
    L = integers(rng, n, int(rng.integers(1, n + 1)))
    P = (
        np.zeros((n, n))
        if linear
        else L @ L.T
        if rng.random() < 0.6
        else np.diag(rng.integers(0, 3, n).astype(float))
    )
    rows, columns = (
        rng.choice([1.0, 1e-9, 1e-4, 1e6], size, p=[0.7, 0.1, 0.1, 0.1]) for size in (m, n)
    )
    if rng.random() < 0.5:
        G = rows[:, None] * G
    if rng.random() < 0.3:
        G, A, P, x = G * columns, A * columns, columns[:, None] * P * columns, x / columns
    else:
        columns = np.ones(n)
    if rng.random() < 0.3:
        G = np.vstack([G, G[:1] * rng.choice([1.0, -1.0, 1e-9])])
    if rng.random() < 0.2:
        G = np.where((G == 0) & (rng.random(G.shape) < 0.5), 6e-17, G)
    if rng.random() < 0.3:  # an unknown that stands alone
        G, A, P = (
            np.hstack([G, np.zeros((len(G), 1))]),
            np.hstack([A, np.zeros((len(A), 1))]),
            np.pad(P, ((0, 1), (0, 1))),
        )
        x, columns = np.append(x, rng.choice([0.0, 1e12])), np.append(columns, 1.0)
    n, m, p = len(x), len(G), len(A)
    is_active = rng.random(m) < 0.5
    y, e = np.where(is_active, rng.integers(0, 4, m), 0) * 1.0, integers(rng, p)
    h, b = G @ x + np.where(is_active, 0, rng.integers(1, 5, m)), A @ x
    low, high = rng.random(n) < 0.3, rng.random(n) < 0.15
    has_low, has_high = low | (rng.random(n) < 0.3), high | (rng.random(n) < 0.2)
    lower = np.where(has_low, np.where(low, x, x - rng.integers(1, 9, n)), -np.inf)
    upper = np.where(has_high, np.where(high, x, x + rng.integers(1, 9, n)), np.inf)
    below, above = (
        np.where(low, rng.integers(0, 4, n), 0) * 1.0,
        np.where(high, rng.integers(0, 4, n), 0) * 1.0,
    )
    c = -(P @ x + G.T @ y + A.T @ e - below + above)
    data = [P, c, G, h, A, b, lower, upper]
    program = lp.QuadraticProgram(*data[:6], lower=lower, upper=upper)
    best, own = value_of(data, x)
    ends = np.cumsum([n, m, p, n, n])

    def split(point: np.ndarray) -> list[np.ndarray]:
        return np.split(point, ends[:-1])

    def passes(point: np.ndarray, tolerance: float) -> bool:
        return QPSolution(program, *split(point)).is_optimal(tolerance)

    def error(point: np.ndarray) -> float:
        at = point[:n]
        if (abs(at - x) <= 1e-9 * np.maximum(abs(x), 1 / columns)).all():
            return 0.0  # rounding of a zero has no size to be beside
        value, size = value_of(data, at)
        size = max(size, own)
        return max(abs(value - best) / size if size else 0.0, violation(data, at))

    def moves(rng: Generator, point: np.ndarray) -> np.ndarray:
        at, y, e, below, above = (part.copy() for part in split(point))
        kind = rng.random()
        if kind < 0.3:
            i = rng.integers(0, n)
            at[i] = stepped(rng, at[i])
        elif kind < 0.45:
            at = along_a_row(rng, np.vstack([G, A, P]), at)
        elif kind < 0.55 and m + p:
            stacked = along_a_row(rng, np.hstack([G.T, A.T]), np.concatenate([y, e]))
            y, e = stacked[:m], stacked[m:]
        elif kind < 0.65 and m:
            i = rng.integers(0, m)
            y[i] = stepped(rng, y[i])
        elif kind < 0.85:  # the gradient is absorbed by bounds, or by a row
            left = P @ at + c + G.T @ y + A.T @ e
            if rng.random() < 0.5 or not m + p:
                below, above = (
                    np.where(np.isfinite(lower), np.maximum(left, 0), 0),
                    np.where(np.isfinite(upper), np.maximum(-left, 0), 0),
                )
            else:
                stacked, row = np.vstack([G, A]), rng.integers(0, m + p)
                places = np.flatnonzero(stacked[row])
                if places.size:
                    j = rng.choice(places)
                    change = -(left[j] - below[j] + above[j]) / stacked[row, j]
                    if row < m:
                        y[row] += change
                    else:
                        e[row - m] += change
        elif kind < 0.93:  # a row is met exactly
            stacked, right = np.vstack([G, A]), np.concatenate([h, b])
            if len(right):
                row = rng.integers(0, len(right))
                places = np.flatnonzero(stacked[row])
                if places.size:
                    j = rng.choice(places)
                    at[j] += (right[row] - stacked[row] @ at) / stacked[row, j]
        else:
            j = rng.integers(0, n)
            size = 10.0 ** rng.uniform(-3, 12)
            if np.isfinite(lower[j]) and np.isfinite(upper[j]):
                below[j] += size
                above[j] += size
            elif np.isfinite(lower[j]) and p and A[0, j]:
                below[j] += size
                e[0] += size / A[0, j]
        at = np.minimum(np.maximum(at, limits(lower)), limits(upper))
        below, above = (
            np.where(np.isfinite(lower), below, 0),
            np.where(np.isfinite(upper), above, 0),
        )
        return np.concatenate([at, np.maximum(y, 0), e, np.maximum(below, 0), np.maximum(above, 0)])

    def text(point: np.ndarray) -> str:
        names = ("P", "c", "G", "h", "A", "b", "lower", "upper")
        stated = ", ".join(
            f"{name}={np.asarray(part).tolist()}" for name, part in zip(names, data, strict=True)
        )
        parts = zip(("x", "y", "e", "zl", "zu"), split(point), strict=True)
        at = ", ".join(f"{name}={part.tolist()}" for name, part in parts)
        here = value_of(data, point[:n])[0]
        return (
            f"QuadraticProgram({stated}) at {at}; right {x.tolist()}: {best:.6g}, here {here:.6g}"
        )

    right = np.concatenate([x, y, e, below, above])
    return Target(right, passes, error, moves, lambda _: False, text)


def planted_linear(rng: Generator) -> Target:
    return planted_program(rng, linear=True)


KINDS: dict[str, Callable[[Generator], Target]] = {
    "lcp": planted_lcp, "program": planted_program, "linear": planted_linear,
}  # fmt: skip


def attacked(kind: str, seed: int, k: int, steps: int) -> tuple[str, str]:
    """What became of problem k: "holds", "falls", "falls polished", "ill-conditioned" or "refuses"; and in words."""
    rng = np.random.default_rng((seed, list(KINDS).index(kind), k))
    target, tolerance = KINDS[kind](rng), JUDGES[kind]
    if not target.passes(target.right, tolerance):
        return "refuses", target.text(target.right)
    point, reached = climb(rng, target, steps)
    if point is None or reached > tolerance:
        return "holds", ""
    text = f"passes at {reached:.0e}, error {target.error(point):.1e}: {target.text(point)}"
    if target.is_hopeless(point):
        return "ill-conditioned", text
    return "falls polished" if reached <= POLISH * tolerance else "falls", text


def main() -> int:
    """Attack."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--kind", choices=[*KINDS, *OTHERS, "all"], default="all")
    parser.add_argument("--count", type=int, default=2000)
    parser.add_argument("--steps", type=int, default=400)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", type=int)
    parser.add_argument("--show", type=int, default=5)
    given = parser.parse_args()
    warnings.simplefilter("ignore")
    np.seterr(all="ignore")
    is_bad = False
    for kind in [*KINDS, *OTHERS] if given.kind == "all" else [given.kind]:
        began, counts, told = (
            time.perf_counter(),
            collections.Counter[str](),
            collections.Counter[str](),
        )
        for k, (what, text) in enumerate(_of_kind(kind, given)):
            counts[what] += 1
            told[what] += 1
            if text and told[what] <= given.show:
                print(
                    f"  {kind} {k if given.only is None else given.only}: {what}: {text}",
                    flush=True,
                )
        words = ", ".join(f"{count} {what}" for what, count in sorted(counts.items()))
        print(f"{kind:14s} {words}, {time.perf_counter() - began:.0f} s", flush=True)
        is_bad |= counts["falls polished"] > max(counts.total() / 1000, 0)
    return int(is_bad)


def _of_kind(kind: str, given: Any) -> Iterator[tuple[str, str]]:
    if kind in KINDS:
        for k in range(given.count) if given.only is None else [given.only]:
            yield attacked(kind, given.seed, k, given.steps)
        return
    module, name = OTHERS[kind]
    falls = getattr(importlib.import_module(module), name)(
        np.random.default_rng(given.seed), given.count
    )
    yield from (("falls polished", str(fall)) for fall in falls)


if __name__ == "__main__":
    sys.exit(main())
