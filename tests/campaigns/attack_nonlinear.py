"""Hill climbing against the judge of nonlinear problems: points that are wrong by more than 1 %, and pass.

    python tests/campaigns/attack_nonlinear.py --count 2000 --seed 0

F(x) = s (M x + g(x) + q) by rows, M positive definite or a P-matrix of integers, some diagonals of 1e-6 … 1e-12, g of
increasing functions t³, exp t, −1/(t+1) or none, s units of rows, the unknowns in units, sometimes a group at 1e12
beside, and x* planted: its only solution. The climber is that of `attack`, the judge the certificate with F and its
derivative. A fall passes at 1e-8, a polished one at 1e-11; where the sums of a row are right to 1e-7 of their terms no
residual tells, and the point is told apart.
"""

from __future__ import annotations

import argparse
import collections
import sys
import warnings
from collections.abc import Iterator
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))
sys.path.insert(0, str(Path(__file__).parent))
from attack import POLISH, Target, along_a_row, climb, stepped
from outliers import integers

from lcp_plugin import NonlinearProblem
from lcp_plugin.core.settings import Settings
from lcp_plugin.problems.nonlinear.certificate import NonlinearCertificate, Reference
from lcp_plugin.problems.nonlinear.data import Linearisation

JUDGE, ILL_CONDITIONED, STEPS = 1e-8, 1e-7, 240


def planted(rng: np.random.Generator) -> Target:
    """Return a problem with its answer, x ≥ 0."""
    n = int(rng.integers(1, 5))
    A, kind = integers(rng, n, n), str(rng.choice(["dominant", "definite", "skew", "triangular"]))
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

    def curve(t: np.ndarray) -> np.ndarray:
        return np.choose(shapes, [0.0 * t, t**3, np.exp(t), -1.0 / (t + 1.0)])

    def slope(t: np.ndarray) -> np.ndarray:
        return np.choose(shapes, [0.0 * t, 3 * t**2, np.exp(t), (t + 1.0) ** -2.0])

    q = w - M @ right - curve(right)

    def F(x: np.ndarray) -> np.ndarray:
        t = x * units
        return rows * (M @ t + curve(t) + q)

    def jacobian(x: np.ndarray) -> np.ndarray:
        return rows[:, None] * (M + np.diag(slope(x * units))) * units

    problem = NonlinearProblem(F, jacobian, lower=np.zeros(n))
    reference, answer = Reference.of(problem, np.zeros(n)), right / units

    def passes(x: np.ndarray, tolerance: float) -> bool:
        at = Linearisation(problem, x)
        return at.is_defined and NonlinearCertificate.at(at, reference).meets(
            Settings(tolerance=tolerance)
        )

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

    return Target(answer, passes, error, moves, is_hopeless, text)


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


def main() -> int:
    """Attack."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--count", type=int, default=2000)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    warnings.simplefilter("ignore")
    np.seterr(all="ignore")
    counts = collections.Counter[str]()
    for what, text in attacks(np.random.default_rng(given.seed), given.count):
        counts[what] += 1
        if what not in ("holds", "ill-conditioned"):
            print(f"  {what}: {text}", flush=True)
    print(dict(counts))
    return int(counts["falls polished"] > given.count / 1000)


if __name__ == "__main__":
    sys.exit(main())
