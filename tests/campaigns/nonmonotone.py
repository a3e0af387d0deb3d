"""Random nonmonotone problems of 12 to 50 rows: how long auto takes, and whether a time limit is kept.

Run ``python tests/campaigns/nonmonotone.py --cases 1000 --seed 0``. M is standard normal; some rows are free, some have
two bounds; every second problem is of the kind that keeps an exhaustive search busy longest (17 free rows, some 20 that
leave a choice). Each is solved by auto as it is, and with ``max_seconds=1``. Prints the longest times, and exits with 1
where auto took more than 10 s (of the wall, or of the processors where that is less: a machine may be shared), where
the limit was missed by more than a second, where a status is false (the proof is verified, a SOLVED measured again in
integers), or where anything is raised.
"""

from __future__ import annotations

import argparse
import sys
import time
import warnings
from collections import Counter
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))
from collection.truth import ExactData

from lcp_plugin import LCP, Result, Status, solve

LONGEST = 10.0  # seconds of auto
LIMIT, TOO_LATE = 1.0, 2.0  # seconds asked for, and those that are too many
TOLERANCE = 1e-8


def problem(rng: np.random.Generator, *, is_hard: bool) -> LCP:
    """A nonmonotone problem with or without free rows and boxes."""
    n = int(rng.integers(33, 38)) if is_hard else int(rng.integers(12, 51))
    M, q = rng.standard_normal((n, n)), rng.standard_normal(n)
    lower, upper = np.zeros(n), np.full(n, np.inf)
    order = rng.permutation(n)
    free = 17 if is_hard else int(rng.choice([0, n // 4, n // 2, 3 * n // 4]))
    boxed = (
        int(rng.choice([0, 3])) if is_hard else int(rng.choice([0, 0, (n - free) // 3, n - free]))
    )
    lower[order[:free]] = -np.inf
    upper[order[free : free + boxed]] = rng.uniform(0.1, 3.0, boxed)
    if not is_hard and rng.random() < 0.3:
        M *= 10.0 ** rng.integers(-12, 12, (n, 1))
    return LCP(M, q, lower=lower, upper=upper)


def complaint(lcp: LCP, result: Result) -> str:
    """What is false about a result, or nothing."""
    if result.status is Status.SOLVED and ExactData(lcp).is_lie(result.z, TOLERANCE):
        return "SOLVED, which is not true"
    if (
        result.status in (Status.INFEASIBLE, Status.NO_SOLUTION)
        and not result.infeasibility.verify()
    ):
        return f"{result.status.name} by a proof that does not verify"
    return ""


def main(cases: int, seed: int) -> int:
    statuses: Counter[str] = Counter()
    times: dict[str, list[tuple[float, str]]] = {"auto": [], f"max_seconds={LIMIT:g}": []}
    failed = 0
    for case in range(cases):
        lcp = problem(np.random.default_rng([seed, case]), is_hard=case % 2 == 1)
        for (name, taken), limit, longest in zip(
            times.items(), (None, LIMIT), (LONGEST, TOO_LATE), strict=True
        ):
            began, worked = time.perf_counter(), time.process_time()
            result = solve(lcp, max_seconds=limit)
            seconds = time.perf_counter() - began
            if limit is None:
                seconds = min(seconds, time.process_time() - worked)
            taken.append(
                (seconds, f"case {case} (n = {lcp.n}): {result.status.name}, {result.algorithm}")
            )
            statuses[f"{name}: {result.status.name}"] += 1
            wrong = complaint(lcp, result) or ("too long" if seconds > longest else "")
            if wrong:
                failed += 1
                print(f"{name}, {seconds:.1f} s, {taken[-1][1]}: {wrong}", flush=True)
    for name, taken in times.items():
        print(f"{name}: {sum(seconds for seconds, _ in taken):.0f} s in all; the longest:")
        for seconds, words in sorted(taken, reverse=True)[:5]:
            print(f"  {seconds:6.2f} s  {words}")
    print("\n".join(f"{count:>6} × {status}" for status, count in sorted(statuses.items())))
    print(f"{cases} cases, {failed} complaints")
    return int(failed > 0)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cases", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    warnings.simplefilter("error")
    sys.exit(main(given.cases, given.seed))
