"""Small problems of every kind on the compiled road and on the long one: the same verdicts, and no lie.

Run ``python tests/campaigns/small_problems.py --cases 100000 --seed 0``. Prints for each family how often the compiled
road converged, what became of the rest, and where the roads differ. Exit code 1 on a lie, an exception, a problem that
only the long road solves, or verdicts that contradict each other. Every `--long-every`-th problem goes both ways; each
goes the compiled one alone, and every answer is judged by exact arithmetic.
"""

from __future__ import annotations

import argparse
import sys
import time
import warnings
from collections import Counter
from multiprocessing import Pool
from pathlib import Path
from unittest import mock

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))
from collection.truth import ExactData
from small_families import FAMILIES, problem

from lcp_plugin import LCP, Result, Status, solve

SOLVED = (Status.SOLVED, Status.PRECISION_LIMIT)
INFEASIBLE = (Status.INFEASIBLE, Status.NO_SOLUTION)
TOLERANCE = 1e-8
SECONDS = 20.0


def long_road(drawn: LCP, algorithm: str) -> Result:
    """Solve without the compiled road."""
    limits = dict.fromkeys(("COMPILED_UP_TO", "COMPILED_SPARSE_UP_TO"), 0)
    with mock.patch.multiple("lcp_plugin.methods.small.small_dense", **limits):
        return solve(drawn, algorithm, max_seconds=SECONDS)


def verdict(result: Result) -> str:
    """Return solved, infeasible or open."""
    return (
        "solved"
        if result.status in SOLVED
        else "infeasible"
        if result.status in INFEASIBLE
        else "open"
    )


def judge(arguments: tuple[int, int, int, int]) -> list[tuple[str, str, str]]:
    """Return (family, what happened, where) of problem k."""
    seed, k, largest, long_every = arguments
    warnings.simplefilter("error")
    rng = np.random.default_rng((seed, k))
    family = list(FAMILIES)[k % len(FAMILIES)]
    algorithm = ("auto", "auto", "newton", "lemke")[k // len(FAMILIES) % 4]
    drawn, where = problem(family, largest, rng), f"{family} {algorithm} --only {k}"
    try:
        short = solve(drawn, algorithm, max_seconds=SECONDS)
        found = [
            (
                family,
                f"{algorithm} {verdict(short)}"
                + (" at once" if short.setup_seconds == 0.0 else ""),
                "",
            )
        ]
        if short.status is Status.SOLVED and ExactData(drawn).is_lie(short.z, TOLERANCE):
            found.append((family, "LIE", where))
        if k % long_every == 0:
            long = long_road(LCP(drawn.M, drawn.q, lower=drawn.lower, upper=drawn.upper), algorithm)
            pair = verdict(short), verdict(long)
            if "solved" in pair and "infeasible" in pair:
                found.append((family, "CONTRADICTION", where))
            elif pair == ("open", "solved") or pair == ("open", "infeasible"):
                found.append((family, f"ONLY THE LONG ROAD: {pair[1]}", where))
            else:
                found.append((family, f"{algorithm} both: {pair[0]}, long {pair[1]}", ""))
    except Exception as error:  # a campaign counts what a caller would see
        return [(family, f"EXCEPTION {type(error).__name__}: {error}", where)]
    return found


def main() -> int:
    """Run the campaign."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cases", type=int, default=20_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--largest", type=int, default=24)
    parser.add_argument("--long-every", type=int, default=10)
    parser.add_argument("--only", type=int)
    parser.add_argument("--processes", type=int, default=2)
    given = parser.parse_args()
    began, counts, wrong = time.perf_counter(), Counter[tuple[str, str]](), []
    cases = range(given.cases) if given.only is None else [given.only]
    with Pool(given.processes) as pool:
        work = ((given.seed, k, given.largest, given.long_every) for k in cases)
        for found in pool.imap_unordered(judge, work, chunksize=50):
            for family, what, where in found:
                counts[family, what.partition(":")[0] if "EXCEPTION" in what else what] += 1
                if where:
                    wrong.append(f"{what} in {where}")
    for (family, what), count in sorted(counts.items()):
        print(f"{family:<14} {what:<40} {count}")
    print(*wrong[:40], sep="\n")
    print(f"{len(cases)} cases, {len(wrong)} wrong, {time.perf_counter() - began:.0f} s")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
