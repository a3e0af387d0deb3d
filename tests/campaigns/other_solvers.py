"""Points of other solvers that `certify` proves, and wrong points that it must not prove.

    python tests/campaigns/other_solvers.py [--cases 60] [--seed 0]

The solution is chosen first: z* and w* with q = w* − M z*, or x* and multipliers with the costs and sides that they
need. A point of pairs is right if it is within 1e-6 of the planted one, in units of the data; a point of a program if
its rows hold and its value is the planted one to 1e-6. Wrong points are right ones moved by 1e-3, with two entries
swapped, along a null direction, stopped early, and outside of friction cones; they count if the outside measure is
beyond 1e-5.
"""

from __future__ import annotations

import argparse
import sys
import warnings
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import qpsolvers
import scipy.sparse as sp

sys.path[:0] = [str(Path(__file__).parents[2])]

from lcp_plugin import LCP, FrictionalContact, NonlinearProblem, QuadraticProgram, certify, solve  # noqa: E402

SOLVERS = {
    "clarabel": {}, "piqp": {}, "daqp": {}, "highs": {},
    "osqp": {"eps_abs": 1e-9, "eps_rel": 1e-9, "max_iter": 100_000},
}  # fmt: skip
SPARSE = ("clarabel", "osqp", "highs")


def answer(solver: str, P: Any, c: Any, G: Any, h: Any, lower: Any, **options: Any) -> Any:
    """Return the solution of a program by a solver, or None."""
    kind = sp.csc_matrix if solver in SPARSE else np.asarray
    G = None if G is None else kind(G)
    with warnings.catch_warnings(action="ignore"):
        problem = qpsolvers.Problem(kind(P), c, G, h, lb=lower)
        try:
            found = qpsolvers.solve_problem(problem, solver, **{**SOLVERS[solver], **options})
        except Exception:
            return None
    return found if found.x is not None and np.isfinite(found.x).all() else None


def pairs(rng: np.random.Generator) -> tuple[Any, ...]:
    """Return M, q and the planted z* of a complementarity problem with a symmetric M."""
    n = int(rng.integers(2, 12))
    A, size = rng.normal(size=(n, n)), np.abs(rng.normal(size=n)) + 0.1
    M, is_active = A @ A.T + 0.3 * np.eye(n), rng.random(n) < rng.choice([0.3, 0.7])
    z = np.where(is_active, size, 0.0)
    return M, np.where(is_active, 0.0, size) - M @ z, z


def program(rng: np.random.Generator) -> tuple[Any, ...]:
    """Return P, c, G, h, the planted x* and its value; a third of the programs is linear at a vertex."""
    n, m = int(rng.integers(2, 9)), int(rng.integers(2, 9))
    is_linear = rng.random() < 1 / 3
    m = max(m, n) if is_linear else m
    A, G, x = rng.normal(size=(n, n)), rng.normal(size=(m, n)), rng.normal(size=n)
    P = np.zeros((n, n)) if is_linear else A @ A.T + 0.1 * np.eye(n)
    is_active = np.arange(m) < (n if is_linear else min(m, n) // 2)
    size = np.abs(rng.normal(size=m)) + 0.1
    y, h = np.where(is_active, size, 0.0), G @ x + np.where(is_active, 0.0, size)
    c = -(P @ x) - G.T @ y
    return P, c, G, h, x, 0.5 * x @ P @ x + c @ x


def value_off(P: Any, c: Any, x: Any, best: Any) -> float:
    """Return the error of the value at x ≥ 0, or the violation of x ≥ 0, next to the terms at the planted x*."""
    size = np.abs(c) @ best + best @ P @ best
    gap = abs(0.5 * x @ P @ x + c @ x - 0.5 * best @ P @ best - c @ best)
    return float(max(gap / size, -x.min() / best.max())) if size else float(np.abs(x).max())


def moved(rng: np.random.Generator, z: Any) -> Any:
    """Yield wrong points near a right one."""
    yield z + 1e-3 * np.abs(z).max() * rng.choice([-1.0, 1.0], z.size)
    yield z + 1e-2 * np.abs(z).max() * (np.arange(z.size) == rng.integers(z.size))
    yield np.roll(z, 1)


def campaign(cases: int, seed: int) -> Counter[tuple[str, str, str]]:
    """Return the numbers of verdicts by class, solver and whether the point is right."""
    count: Counter[tuple[str, str, str]] = Counter()
    for number in range(cases):
        rng = np.random.default_rng([seed, number])
        M, q, z = pairs(rng)
        unit = max(np.abs(z).max(), np.abs(q / M.diagonal()).max())
        classes = {
            "lcp": LCP(M, q),
            "nonlinear": NonlinearProblem(
                lambda x, M=M, q=q: M @ x + q, lambda x, M=M: M, lower=0 * q
            ),
            "program with bounds": QuadraticProgram(M, q, lower=0),
        }
        P, c, G, h, x, value = program(rng)
        stated = QuadraticProgram(P, c, G, h)
        W, b = rng.normal(size=(6, 9)), rng.normal(size=6)
        contact = FrictionalContact(W @ W.T, b, [0.5, 0.3], dimension=3)
        impulse = np.array(solve(contact).z)
        for solver in SOLVERS:
            for early in (False, True):
                less = {"max_iter": 3} if early and solver in ("piqp", "clarabel", "osqp") else {}
                if early and not less:
                    continue
                if (found := answer(solver, M, q, None, None, 0 * q, **less)) is not None:
                    off = np.abs(found.x - z).max() / unit
                    for name, problem in classes.items():
                        is_program = name.startswith("program")
                        at = value_off(M, q, found.x, z) if is_program else off
                        tell(count, name, solver, at, certify(problem, found.x))
                if (found := answer(solver, P, c, G, h, None, **less)) is not None:
                    rows = np.maximum(G @ found.x - h, 0.0) / (
                        np.abs(G) @ np.abs(found.x) + np.abs(h)
                    )
                    gap = abs(0.5 * found.x @ P @ found.x + c @ found.x - value)
                    off = max(rows.max(), gap / (np.abs(c) @ np.abs(x) + x @ P @ x))
                    multipliers = found.z if found.z is not None and found.z.size else None
                    given = (
                        {} if multipliers is None else {"multipliers": (multipliers, np.zeros(0))}
                    )
                    tell(count, "program", solver, off, certify(stated, found.x, **given))
        for name, problem in classes.items():
            for wrong in moved(rng, z):
                is_program = name.startswith("program")
                off = value_off(M, q, wrong, z) if is_program else np.abs(wrong - z).max() / unit
                tell(count, name, "moved", off, certify(problem, wrong))
        for wrong in moved(rng, x):
            gap = abs(0.5 * wrong @ P @ wrong + c @ wrong - value) / (
                np.abs(c) @ np.abs(x) + x @ P @ x
            )
            rows = np.maximum(G @ wrong - h, 0.0) / (np.abs(G) @ np.abs(wrong) + np.abs(h))
            tell(count, "program", "moved", max(gap, rows.max()), certify(stated, wrong))
        tell(
            count,
            "contact",
            "ours, rounded",
            0.0,
            certify(contact, impulse * (1.0 + 1e-9 * rng.normal(size=6))),
        )
        if np.abs(impulse[1:3]).max() > 1e-3:
            outside = impulse * np.array([1, 1.01, 1.01, 1, 1, 1])
            tell(count, "contact", "outside", 1e-2, certify(contact, outside))
    return count


def tell(count: Any, name: str, solver: str, off: float, found: Any) -> None:
    """Count a verdict on a point that is off by so much."""
    kind = "right" if off <= 1e-6 else "wrong" if off > 1e-5 else "between"
    count[name, solver, f"{kind}, {found.verdict}"] += 1


def main() -> int:
    """Print the table; return 1 if a wrong point is proved."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--cases", type=int, default=60)
    parser.add_argument("--seed", type=int, default=0)
    asked = parser.parse_args()
    count = campaign(asked.cases, asked.seed)
    for name in sorted({key[0] for key in count}):
        right = sum(n for key, n in count.items() if key[0] == name and key[2].startswith("right"))
        proved = sum(n for key, n in count.items() if key[0] == name and key[2] == "right, proved")
        wrong = sum(n for key, n in count.items() if key[0] == name and key[2].startswith("wrong"))
        false = sum(n for key, n in count.items() if key[0] == name and key[2] == "wrong, proved")
        print(f"{name:<20} right {right:>5}, proved {proved / max(right, 1):.1%}", end="; ")
        print(f"wrong {wrong:>5}, proved {false}")
    refused = {
        key: n
        for key, n in count.items()
        if key[2].startswith("right") and key[2] != "right, proved"
    }
    print("right, not proved:", refused)
    return int(any(n for key, n in count.items() if key[2] == "wrong, proved"))


if __name__ == "__main__":
    sys.exit(main())
