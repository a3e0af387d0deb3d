"""SOLVED where doubles measure nothing: near-singular matrices, bounds one ulp apart, references that vanish.

    python tests/campaigns/near_singular.py --cases 20000 --seed 0 --jobs 2

Every problem is solved by auto and by every registered algorithm, and judged in rational arithmetic:
a lie is a SOLVED whose exact residual exceeds the tolerance times the exact reference, a PRECISION_LIMIT that rounding
does not explain, or an INFEASIBLE or NO_SOLUTION where a solution was planted. Printed besides: how many SOLVED are off
by more than half of the exact solution, and how many of these `explain()` warns of. Exit code 1 on a lie or an
exception.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import sys
import time
import warnings
from collections import Counter
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))
from collection.judgement import false_claim
from collection.truth import SOLVABLE
from exact import exact_solution

from lcp_plugin import LCP, Status, solve
from lcp_plugin.algorithms import REGISTRY
from lcp_plugin.core.errors import UnsuitableMatrix, UnsuitableProblem

Generator = np.random.Generator
ALGORITHMS = ("auto", *REGISTRY)
TOLERANCE = 1e-8
STEPS = 120  # of a named algorithm
CHUNK = 50


# --- The problems ---------------------------------------------------------------------------------------------------


def near(value: float, rng: Generator) -> float:
    """A double some units of the last place, or some bits more, below a positive one."""
    return value - value * 2.0 ** -int(rng.integers(20, 53)) * int(rng.integers(0, 4))


def pair(rng: Generator) -> LCP:
    """Two rows that are nearly each other's negative."""
    a = float(rng.integers(1, 9))
    M = np.array([[a, -near(a, rng)], [-near(a, rng), a]])
    return LCP(M, rng.integers(-4, 5, 2).astype(float))


def cyclic(rng: Generator) -> LCP:
    """A cyclic Z-matrix whose determinant nearly vanishes."""
    n = int(rng.integers(2, 9))
    d = rng.integers(1, 6, n).astype(float)
    M = np.diag(d)
    for i in range(n):
        M[i, (i + 1) % n] = -near(d[i], rng)
    return LCP(M, rng.integers(-4, 5, n).astype(float))


def balanced(rng: Generator) -> LCP:
    """Two rows that are nearly each other's negative, and so is q: a short z leaves a small residual."""
    M, k = pair(rng).csr.toarray(), float(rng.integers(1, 9))
    return LCP(M, [-k, k * (1.0 - 2.0 ** -int(rng.integers(20, 45)))])


def reducible(rng: Generator) -> LCP:
    """Blocks that are nearly singular, each fed by the one before."""
    blocks = [pair(rng).csr.toarray() for _ in range(int(rng.integers(1, 5)))]
    n = 2 * len(blocks)
    M = np.zeros((n, n))
    for k, block in enumerate(blocks):
        M[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = block
        M[2 * k : 2 * k + 2, : 2 * k] = -rng.integers(0, 3, (2, 2 * k))
    return LCP(M, rng.integers(-4, 5, n).astype(float))


def one_ulp(rng: Generator) -> LCP:
    """Rows held between bounds that are equal, or next to each other, and so large that sums of them cancel."""
    n = int(rng.integers(2, 7))
    M = np.diag(rng.integers(1, 5, n)).astype(float)
    M[0, 1:] = rng.integers(-3, 4, n - 1)
    lower, upper = np.zeros(n), np.full(n, np.inf)
    lower[1:] = np.ldexp(rng.integers(1, 2**20, n - 1).astype(float), rng.integers(20, 45, n - 1))
    upper[1:] = np.where(rng.random(n - 1) < 0.5, lower[1:], np.nextafter(lower[1:], np.inf))
    if n > 2 and rng.random() < 0.7:  # the last is nearly what cancels the others
        lower[-1] = upper[-1] = abs(M[0, 1:-1] @ lower[1:-1]) + float(rng.integers(-2, 3)) * 8.0
        M[0, -1] = -np.sign(M[0, 1:-1] @ lower[1:-1] or 1.0)
    return LCP(M, rng.integers(-3, 4, n).astype(float), lower=np.minimum(lower, upper), upper=upper)


def vanishing(rng: Generator) -> LCP:
    """The nearest point to 0 solves the problem but for some rounding: nothing is left to be relative to."""
    n = int(rng.integers(2, 7))
    M = rng.integers(-3, 4, (n, n)).astype(float) + np.diag(rng.integers(2, 9, n))
    M *= rng.choice([1.0, 0.1, 1.0 / 3.0])
    lower = rng.integers(1, 99, n) * rng.choice([1.0, 0.1, 1e15])
    q = -(M @ lower)
    q *= 1.0 + rng.integers(-1, 2, n) * 2.0**-52
    return LCP(M, q, lower=lower)


def graded(rng: Generator) -> LCP:
    """A near-singular problem in other units of its rows and of z."""
    problem = (pair, cyclic, reducible)[int(rng.integers(3))](rng)
    rows = np.exp2(rng.integers(-30, 31, problem.n))
    unit = 2.0 ** int(rng.integers(-60, 61))
    return LCP(problem.csr.toarray() * rows[:, None] * unit, problem.q * rows)


KINDS: dict[str, Callable[[Generator], LCP]] = {
    each.__name__: each for each in (pair, cyclic, balanced, reducible, one_ulp, vanishing, graded)
}


# --- The judgement ----------------------------------------------------------------------------------------------------


def truth_of(problem: LCP) -> tuple[str, tuple[Fraction, ...] | None]:
    """SOLVABLE with a solution where one is found by active sets, else that nothing is known."""
    if problem.n > 6:
        return "", None
    try:
        return SOLVABLE, exact_solution(problem).z
    except ValueError:
        return "", None


def judged(kind: str, number: int) -> tuple[Counter[str], list[str]]:
    """Solve one problem by everything; return counts, and lines that tell what is wrong."""
    rng = np.random.default_rng(number)
    problem = KINDS[kind](rng)
    truth, exact = truth_of(problem)
    counts: Counter[str] = Counter({"problems": 1})
    lines = []
    for name in ALGORITHMS:
        limit = {} if name == "auto" else {"max_iterations": STEPS}
        try:
            result = solve(problem, name, tolerance=TOLERANCE, **limit)
        except (UnsuitableMatrix, UnsuitableProblem):
            counts["refused"] += 1
            continue
        except Exception as error:  # a finding, and the campaign goes on
            counts["exceptions"] += 1
            lines.append(f"{kind}:{number} {name}: {type(error).__name__}: {error}")
            continue
        counts[result.status.name] += 1
        wrong = false_claim(problem, truth or result_truth(result.status.name), result, TOLERANCE)
        if wrong:
            counts["lies"] += 1
            lines.append(f"{kind}:{number} {name}: {wrong}")
        if result.status is Status.SOLVED and exact is not None:
            error = max(abs(Fraction(a) - b) for a, b in zip(result.z.tolist(), exact, strict=True))
            if error > Fraction(1, 2) * max(map(abs, exact)):
                told = result.explain()
                counts["far"] += 1
                counts["far, warned of"] += "near-singular" in told or "stiff" in told
        if result.status is Status.SOLVED and exact is not None and rng.random() < 0.05:
            error = max(abs(Fraction(a) - b) for a, b in zip(result.z.tolist(), exact, strict=True))
            if error <= Fraction(1, 10**4) * max(map(abs, exact)):
                counts["near, asked"] += 1
                counts["near, warned of"] += "near-singular" in result.explain()
    return counts, lines


def result_truth(status: str) -> str:
    """A truth that contradicts no status, where none is known."""
    return {"INFEASIBLE": "infeasible", "NO_SOLUTION": "no solution"}.get(status, SOLVABLE)


def stretch(task: tuple[int, int, int]) -> tuple[Counter[str], list[str]]:
    first, last, seed = task
    warnings.simplefilter("error")
    counts: Counter[str] = Counter()
    lines: list[str] = []
    kinds = list(KINDS)
    for case in range(first, last):
        found, told = judged(kinds[case % len(kinds)], seed * 10**9 + case)
        counts.update(found)
        lines += told
    return counts, lines


def campaign(cases: int, seed: int, jobs: int) -> int:
    """Run all cases; print counts; return 1 where anything is wrong."""
    began = time.perf_counter()
    total: Counter[str] = Counter()
    os.environ["OMP_NUM_THREADS"] = "1"
    tasks = [(first, min(first + CHUNK, cases), seed) for first in range(0, cases, CHUNK)]
    with multiprocessing.get_context("spawn").Pool(jobs) as pool:
        for k, (counts, lines) in enumerate(pool.imap_unordered(stretch, tasks)):
            total.update(counts)
            print(*lines, sep="\n", end="\n" if lines else "", flush=True)
            if k % 20 == 19:
                seconds = time.perf_counter() - began
                print(
                    f"{total['problems']} problems, {total['lies']} lies, {seconds:.0f} s",
                    flush=True,
                )
    for name, count in sorted(total.items()):
        print(f"{count:>9}  {name}")
    return int(total["lies"] + total["exceptions"] > 0)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--cases", type=int, default=600)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=2)
    options = parser.parse_args()
    sys.exit(campaign(options.cases, options.seed, options.jobs))
