"""LCPs with outliers in their data, and a campaign of such programs, checked externally; cones are in ``cones.py``.

``run(kind, seed, k)`` returns the outcome of one problem; ``python tests/campaign.py --only outlier`` runs all kinds.

The problems are small, have integer data, and contain one or two outliers. Outliers are right-hand sides and bounds
of 1e10 … 1e19, 1e20 and ∞ for "none", cos(π/2) for a zero, a regularization of 1e-9, ties, zeros, a distant origin,
or two groups of different sizes. The campaign does not use the certificates of the package. It counts these
outcomes:

- right: the conditions hold to 1e-9. A solution is also right if its value is close to the one from the conditions
  in rational numbers, or from Clarabel.
- refused: a solution exists, and the run ended without it, or raised an exception.
- false: a wrong SOLVED, a wrong INFEASIBLE or UNBOUNDED although a solution exists within the radius
  of the proof, a wrong "proved", or an exception that is not an LCPError.
- open: no reference solution is available, an optimum lies beyond the radius of the proof, or an x that satisfies
  rows and bounds to 1e-9 is better than the reference.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp
from oracles.exact_program import ExactProgram, limits
from scipy.linalg import block_diag

import lcp_plugin as lp

Generator = np.random.Generator
RIGHT, REFUSED, FALSE, OPEN = "right", "refused", "FALSE", "open"
ODD = (1e10, 1e15, 1e19)
NONE = (1e10, 1e15, 1e19, 1e20, np.inf)
COSINE = float(np.cos(np.pi / 2))
HOLDS = 1e-9
SECONDS = 60.0  # of one solve, on a busy machine also


class Outcome(NamedTuple):
    """Outcome of one problem, with a message."""

    what: str
    text: str = ""


# --- Numbers ------------------------------------------------------------------------------------------------------


def integers(rng: Generator, *shape: int, largest: int = 3) -> np.ndarray:
    return rng.integers(-largest, largest + 1, shape).astype(float)


def some(
    rng: Generator, values: Any, shape: Any, share: float = 0.3
) -> tuple[np.ndarray, np.ndarray]:
    """Return the mask of the outliers, and their values."""
    return rng.random(shape) < share, np.asarray(rng.choice(values, shape), float)


def matrix(rng: Generator, n: int) -> tuple[np.ndarray, str]:
    """Return a square matrix of integers, of one of several classes."""
    kind = rng.choice(["any", "definite", "semidefinite", "dominant", "saddle"])
    A = integers(rng, n, n)
    if kind == "definite":
        A = A @ A.T + np.eye(n)
    elif kind == "semidefinite":
        A = A[:, : max(1, n - 1)] @ A[:, : max(1, n - 1)].T
    elif kind == "dominant":
        np.fill_diagonal(A, abs(A).sum(axis=1) + 1)
    elif kind == "saddle":
        k = n // 2
        A = np.block([[np.eye(n - k), -A[: n - k, :k]], [A[: n - k, :k].T, np.zeros((k, k))]])
    return A, str(kind)


def odd_lcp(rng: Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, str]:
    """M, q, lower, upper of an LCP with odd numbers, and which."""
    n = int(rng.integers(1, 6))
    M, kind = matrix(rng, n)
    q, lower, upper = integers(rng, n), np.zeros(n), np.full(n, np.inf)
    words = [kind]
    for _ in range(int(rng.integers(1, 3))):
        word = str(rng.choice([
            "diagonal", "q", "entry", "row", "column", "noise", "upper", "free", "origin", "groups", "tower", "ridge",
        ]))  # fmt: skip
        words.append(word)
        i, j = rng.integers(0, len(q), 2)
        if word == "diagonal":
            here, small = some(rng, (1e-6, 1e-9, 1e-12), len(q), 0.5)
            M[np.diag_indices(len(q))] = np.where(here, small, M.diagonal())
        elif word == "q":
            q[i] = rng.choice([-1, 1]) * rng.choice(ODD)
        elif word == "entry":
            M[i, j] = rng.choice([-1, 1]) * rng.choice((*ODD, 1e-9)) if i != j else M[i, j]
        elif word == "row":
            scale = rng.choice((1e-9, 1e6, 1e10))
            M[i] *= scale
            q[i] *= scale
        elif word == "column":
            M[:, i] *= rng.choice((1e-9, 1e6, 1e10))
        elif word == "noise":
            M = np.where(
                (M == 0) & (rng.random(M.shape) < 0.5), rng.choice([-1, 1], M.shape) * COSINE, M
            )
        elif word == "upper":
            here, far = some(rng, (*NONE, 1.0, 2.0), len(q), 0.6)
            upper = np.where(here, far, upper)
        elif word == "free":
            here, far = some(rng, (*NONE, 1.0), len(q), 0.6)
            lower = np.where(here, -far, lower)
        elif word == "origin":
            q = q - M @ np.full(len(q), 1e6)
            lower = lower + 1e6 * (rng.random() < 0.5)
            upper = np.maximum(upper, lower)
        elif word == "groups" and len(q) <= 3:
            N, other = matrix(rng, 2)
            words.append(other)
            scale = rng.choice((1e-7, 1e-3, 1e7))
            M = block_diag(M, N)
            q = np.append(q, scale * integers(rng, 2))
            lower, upper = np.append(lower, [0.0, 0.0]), np.append(upper, [np.inf, np.inf])
        elif word == "tower":
            mass = rng.choice((1.0, 1e4, 1e8), len(q))
            J = np.eye(len(q)) - np.eye(len(q), k=-1)
            M, q = J @ np.diag(1 / mass) @ J.T, np.where(np.arange(len(q)) == 0, -0.04905, 0.0)
        elif word == "ridge":
            M = M + 1e-9 * np.eye(len(q))
    return M, q, lower, upper, " ".join(words)


def odd_program(rng: Generator, *, linear: bool) -> tuple[list[Any], str]:
    """P, c, G, h, A, b, lower, upper of a convex program with odd numbers, and which."""
    is_small = rng.random() < 0.6
    n, m = (int(rng.integers(1, top)) for top in ((4, 4) if is_small else (16, 20)))
    p = int(rng.integers(0, max(1, n // 2) + 1)) * (rng.random() < 0.4)
    real = not is_small and rng.random() < 0.5
    draw = (
        (lambda *shape: rng.standard_normal(shape))
        if real
        else (lambda *shape: integers(rng, *shape))
    )
    x0 = draw(n)
    G, A, c = draw(m, n), draw(p, n), draw(n)
    G = G * (rng.random(G.shape) < rng.choice([0.4, 1.0]))
    h = G @ x0 + (rng.integers(0, 3, m) if not real else rng.random(m) * (rng.random(m) < 0.5))
    b = A @ x0
    L = draw(n, max(1, n - int(rng.integers(0, 2))))
    P = (
        None
        if linear
        else L @ L.T
        if rng.random() < 0.5
        else np.diag(rng.integers(0, 3, n).astype(float))
    )
    lower, upper = np.full(n, -np.inf), np.full(n, np.inf)
    bounded = str(
        rng.choice(["none", "box", "positive"], p=[0.1, 0.6, 0.3] if linear else [0.5, 0.3, 0.2])
    )
    if bounded == "box":
        lower, upper = x0 - 5, x0 + 5
    elif bounded == "positive":
        lower = np.minimum(x0, 0.0)
    words = [bounded]
    for _ in range(int(rng.integers(1, 3))):
        word = str(rng.choice([
            "far rows", "far bounds", "noise", "powers", "costs", "origin", "ridge", "groups", "row", "column", "zeros",
            "ties",
        ]))  # fmt: skip
        words.append(word)
        i = int(rng.integers(0, n))
        if word == "far rows":
            k = int(rng.integers(1, 3))
            G, h = np.vstack([G, draw(k, n)]), np.append(h, rng.choice(NONE, k))
        elif word == "far bounds":
            here, far = some(rng, NONE, n, 0.5)
            upper = np.where(here, far, upper)
            here, far = some(rng, NONE, n, 0.3)
            lower = np.where(here & (upper > -far), -far, lower)
        elif word == "noise":
            hit = rng.random(G.shape) < 0.3
            size = rng.choice((COSINE, 1e-12, 1e-9, 1e-5), G.shape) * rng.choice([-1, 1], G.shape)
            G = np.where(hit, size, G)
            h = np.where(hit.any(axis=1), np.where(abs(h) < 1e9, np.round(G @ x0) + 1, h), h)
        elif word == "powers":
            G[:m] = -(rng.random(m)[:, None] ** np.arange(n)[None])
            h[:m] = G[:m] @ x0 + (rng.random(m) < 0.5)
        elif word == "costs":
            c = c * np.where(rng.random(n) < 0.3, rng.choice((1e-9, 1e5, 1e9), n), 1)
        elif word == "origin":
            far = np.where(rng.random(n) < 0.5, 1e6, 0.0)
            h, b, lower, upper = h + G @ far, b + A @ far, lower + far, upper + far
        elif word == "ridge":
            P = None if linear else (np.zeros((n, n)) if P is None else P) + 1e-9 * np.eye(n)
        elif word == "row" and len(h):
            k, scale = int(rng.integers(0, len(h))), rng.choice((1e-9, 1e6))
            G[k] *= scale
            h[k] *= scale
        elif word == "column":
            scale = rng.choice((1e-6, 1e6))
            G[:, i] *= scale
            A[:, i] *= scale
            c[i] *= scale
            lower[i], upper[i] = lower[i] / scale, upper[i] / scale
            if P is not None:
                units = np.where(np.arange(n) == i, scale, 1)
                P = P * units * units[:, None]
        elif word == "zeros":
            c = c * (rng.random(n) < 0.3)
            if len(h):
                G[int(rng.integers(0, len(h)))] = 0.0
                h = np.where((abs(G).sum(axis=1) == 0) & (h < 0), 0.0, h)
        elif word == "ties" and m:
            G, h = np.vstack([G, 2 * G[:1]]), np.append(h, 2 * h[0])
        elif word == "groups" and n <= 4:
            scale, k = rng.choice((1e-7, 1e7)), 2
            extra = integers(rng, k)
            G = block_diag(G, integers(rng, 1, k))
            h, c = np.append(h, scale), np.append(c, extra)
            A = np.hstack([A, np.zeros((p, k))])
            lower, upper = np.append(lower, [-scale] * k), np.append(upper, [scale] * k)
            P = None if P is None else block_diag(P, np.eye(k))
            n, x0 = n + k, np.append(x0, [0.0, 0.0])
    lower, upper = np.minimum(lower, upper), np.maximum(lower, upper)
    return [P, c, G, h, A, b, lower, upper], " ".join(words)


# --- Programs -----------------------------------------------------------------------------------------------------


def without_far(data: list[Any]) -> list[Any]:
    """Return the program without right-hand sides and bounds beyond 1e9."""
    P, c, G, h, A, b, lower, upper = data
    keep = abs(h) < 1e9
    lower, upper = np.where(lower < -1e9, -np.inf, lower), np.where(upper > 1e9, np.inf, upper)
    return [P, c, G[keep], h[keep], A, b, lower, upper]


def by_clarabel(data: list[Any]) -> tuple[str, np.ndarray]:
    """Return the status and x of Clarabel."""
    import clarabel

    P, c, G, h, A, b, lower, upper = data
    eye, fixed = np.eye(len(c)), lower == upper
    below, above = np.isfinite(lower) & ~fixed, np.isfinite(upper) & ~fixed
    rows = np.vstack([A, eye[fixed], G, -eye[below], eye[above]])
    limit = np.concatenate([b, lower[fixed], h, -lower[below], upper[above]])
    equations = len(b) + int(fixed.sum())
    cones = [clarabel.ZeroConeT(equations), clarabel.NonnegativeConeT(len(limit) - equations)]
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = 1e-11
    P, C = sp.csc_matrix(np.triu(np.zeros_like(eye) if P is None else P)), sp.csc_matrix(rows)
    found = clarabel.DefaultSolver(P, c, C, limit, cones, settings).solve()
    return str(found.status), np.array(found.x)


def by_others(data: list[Any]) -> np.ndarray | None:
    """Return the solution of Clarabel without bounds beyond 1e9, if it satisfies them and is no larger.

    Clarabel also calls points Solved that are far along a direction of unbounded descent.
    """
    status, x = by_clarabel(without_far(data))
    is_one = status == "Solved" and abs(x).max() <= 1e9 and violation(data, x) <= 1e-8
    return x if is_one else None


@np.errstate(all="ignore")  # ratios to 1e-300
def violation(data: list[Any], x: np.ndarray) -> float:
    """Return the largest violation of a row relative to its terms.

    The reference is at least 1e-6 of the row's largest coefficient times the largest unknown.
    """
    _, _, G, h, A, b, lower, upper = data
    largest, worst = abs(x).max(initial=0.0), 0.0
    lower, upper = limits(lower), limits(upper)
    for rows, right, wrong in ((G, limits(h), G @ x - limits(h)), (A, b, abs(A @ x - b))):
        if len(right):
            own = np.maximum(abs(rows * x).max(axis=1), np.where(np.isfinite(right), abs(right), 0))
            size = np.maximum(own, 1e-6 * abs(rows).max(axis=1) * largest)
            worst = max(
                worst, float(np.where(wrong > 0, wrong / np.maximum(size, 1e-300), 0).max())
            )
    outside = np.maximum(lower - x, x - upper)
    return max(
        worst,
        float(
            np.where(outside > 0, outside / np.maximum(abs(x), 1e-6 * largest), 0).max(initial=0)
        ),
    )


@np.errstate(all="ignore")
def conditions(data: list[Any], x: np.ndarray, duals: dict[str, np.ndarray]) -> float:
    """Return the largest violation of an optimality condition, relative to the terms of its row."""
    P, c, G, h, A, b, lower, upper = data
    y, e, below, above = (duals[name] for name in ("inequality", "equality", "lower", "upper"))
    Q = np.zeros((len(c), len(c))) if P is None else P
    lower, upper, h = limits(lower), limits(upper), limits(h)

    def ratio(wrong: np.ndarray, size: np.ndarray) -> float:
        return float(np.where(wrong > 0, wrong / np.maximum(size, 1e-300), 0).max(initial=0))

    def own(rows: np.ndarray, by: np.ndarray) -> np.ndarray:
        return abs(rows * by).max(axis=1, initial=0)

    slope = Q @ x + c + G.T @ y + A.T @ e - below + above
    terms = np.maximum.reduce([abs(c), own(Q, x), own(G.T, y), own(A.T, e), below, above])
    gap = abs(y * np.where(np.isfinite(h), h - G @ x, 0)).sum()
    for limit, dual in ((lower, below), (upper, above)):
        gap += abs(dual * np.where(np.isfinite(limit), x - limit, 0)).sum()
        if (dual[~np.isfinite(limit)] != 0).any():
            return np.inf
    rounding = 1e-14 * (abs(y) @ (abs(G) @ abs(x) + np.where(np.isfinite(h), abs(h), 0)))
    size = abs(c * x).sum() + abs(x @ Q @ x)
    return max(
        ratio(G @ x - h, np.maximum(own(G, x), np.where(np.isfinite(h), abs(h), 0))),
        ratio(abs(A @ x - b), np.maximum(own(A, x), abs(b))), ratio(abs(slope), terms),
        ratio(lower - x, abs(x)), ratio(x - upper, abs(x)), ratio(-y, abs(y) * 0),
        (gap - rounding) / size if gap > rounding else 0.0,
    )  # fmt: skip


def value_of(data: list[Any], x: np.ndarray) -> tuple[float, float]:
    """The objective and the sum of the sizes of its terms."""
    P, c = data[:2]
    curved = 0.0 if P is None else x @ P @ x
    return float(c @ x + curved / 2), float(abs(c * x).sum() + abs(curved))


def best_of(data: list[Any], rows: int = 8) -> tuple[float, float, float] | str | None:
    """Return the optimal value, its size and the largest unknown, or "none", or None if unknown."""
    program = ExactProgram(*data)
    if len(program.c) + len(program.h) + len(program.b) <= rows:
        found = program.optimum()
        if found is None:
            return "none"
        x = np.array([float(value) for value in found])
        size = float(program.size(found)) + value_of(data, x)[1]
        return float(program.value(found)), size, abs(x).max()
    x = by_others(data)
    return None if x is None else (*value_of(data, x), abs(x).max())


def judged_program(
    data: list[Any], status: str, x: np.ndarray, duals: Any, radius: float, text: str
) -> Outcome:
    """The verdict on a status, an x and its multipliers."""
    if status == "SOLVED":
        if not np.isfinite(x).all():
            return Outcome(FALSE, f"SOLVED {x}: {text}")
        # the rounding error of a zero has no reference size
        rounded = np.where(abs(x) <= 1e-15 * abs(x).max(), 0.0, x)
        if min(conditions(data, x, duals), conditions(data, rounded, duals)) <= HOLDS:
            return Outcome(RIGHT)
        best, violated, (value, size) = best_of(data), violation(data, x), value_of(data, x)
        if violated > 1e-5:
            return Outcome(FALSE, f"SOLVED {x.tolist()} violates by {violated:.1e}: {text}")
        if best is None:
            return Outcome(OPEN)
        if best == "none":
            return Outcome(OPEN, f"SOLVED {x.tolist()} where there is no optimum: {text}")
        rounding = 0.0 if data[0] is None else 2.0**-50 * (abs(x) @ abs(data[0]) @ abs(x))
        is_off = abs(value - best[0]) > 1e-4 * (abs(best[0]) + max(size, best[1])) + rounding
        what = RIGHT if not is_off else OPEN if value < best[0] and violated <= HOLDS else FALSE
        return Outcome(what, f"SOLVED {x.tolist()}: {value:.9g}, right {best[0]:.9g}: {text}")
    best = best_of(data, 12 if status == "UNBOUNDED" else 8)
    if best is None or best == "none":
        return Outcome(RIGHT if best == "none" and status in ("INFEASIBLE", "UNBOUNDED") else OPEN)
    if status in ("INFEASIBLE", "UNBOUNDED"):
        what = FALSE if best[2] <= min(radius, 1e20) else OPEN
        return Outcome(what, f"{status}, right {best[0]:.9g}, radius {radius:.1e}: {text}")
    return Outcome(REFUSED, f"{status}: {text}")


def shown(data: list[Any], words: str) -> str:
    names = ("P", "c", "G", "h", "A", "b", "lower", "upper")
    parts = [
        f"{name}={np.asarray(value).tolist()}"
        for name, value in zip(names, data, strict=True)
        if value is not None
    ]
    return f"{words}: {', '.join(parts)}"[:1500]


def program_case(rng: Generator, *, linear: bool = False) -> Outcome:
    data, words = odd_program(rng, linear=linear)
    P, c, G, h, A, b, lower, upper = data
    program = lp.QuadraticProgram(P, c, G, h, A, b, lower=lower, upper=upper)
    result = lp.solve(program, max_seconds=SECONDS)
    text = shown(data, words)
    radius = float(getattr(result.proof, "radius", np.inf) or np.inf)
    outcome = judged_program(data, result.status.name, result.x, result.duals, radius, text)
    if outcome.what == RIGHT and result.status.name == "SOLVED" and rng.random() < 0.1:
        size = np.maximum(abs(result.x), abs(result.x).max())
        x = result.x + rng.choice([0.01, 0.1, 0.5]) * size * rng.standard_normal(len(c))
        (value, terms), right = value_of(data, x), value_of(data, result.x)[0]
        is_wrong = abs(value - right) > 1e-3 * (abs(right) + terms) or violation(data, x) > 1e-3
        if is_wrong and lp.certify(program, x, max_seconds=SECONDS).verdict == "proved":
            return Outcome(FALSE, f"proved {x.tolist()}: {value:.9g}, right {right:.9g}: {text}")
    return outcome


def linear_case(rng: Generator) -> Outcome:
    return program_case(rng, linear=True)


def noisy_rows(rng: Generator, least: float = -9.0) -> list[Any]:
    """Return a linear program with 10⁻¹⁷ … 10^least in 60 % of the places of its rows."""
    n, m = int(rng.integers(3, 10)), int(rng.integers(1, 4))
    G, c = rng.normal(size=(m, n)), rng.normal(size=n)
    noise = rng.choice([-1, 1], G.shape) * 10.0 ** rng.uniform(-17, least, G.shape)
    G = np.where(rng.random(G.shape) < 0.6, noise, G)
    h = G @ rng.normal(size=n) + rng.random(m) * (rng.random(m) < 0.5)
    none, far = np.zeros((0, n)), np.full(n, 10.0)
    return [None, c, G, h, none, np.zeros(0), -far, far]


def noisy_case(rng: Generator) -> Outcome:
    data = noisy_rows(rng)
    result = lp.solve(lp.QuadraticProgram(*data), max_seconds=SECONDS)
    return judged_program(
        data, result.status.name, result.x, result.duals, np.inf, shown(data, "noise")
    )


def units_case(rng: Generator) -> Outcome:
    """Noisy rows with one unknown in units of 1e-6 … 1e-15; the judge takes all unknowns in units of 1."""
    data = noisy_rows(rng, -11.0)
    _, c, G, h, A, b, lower, upper = data
    units = np.ones(len(c))
    units[rng.integers(0, len(c))] = 10.0 ** rng.uniform(-15, -6)
    stated = lp.QuadraticProgram(None, c / units, G / units, h, A, b, lower * units, upper * units)
    result = lp.solve(stated, max_seconds=SECONDS)
    duals = {name: np.array(value) for name, value in result.duals.items()}
    duals["lower"], duals["upper"] = duals["lower"] * units, duals["upper"] * units
    text = shown(data, f"units {units.tolist()}")
    return judged_program(data, result.status.name, result.x / units, duals, np.inf, text)


KINDS: dict[str, Callable[[Generator], Outcome]] = {
    "program": program_case,
    "linear": linear_case,
    "noisy rows": noisy_case,
    "units": units_case,
}


def run(kind: str, seed: int, k: int) -> Outcome:
    """Problem k of a kind."""
    rng = np.random.default_rng((seed, 1 + list(KINDS).index(kind), k))
    try:
        return KINDS[kind](rng)
    except lp.LCPError as error:
        return Outcome(REFUSED, f"{type(error).__name__}: {error}")
    except Exception as error:  # a campaign counts all exceptions that a user would see
        return Outcome(FALSE, f"{type(error).__name__}: {error}")
