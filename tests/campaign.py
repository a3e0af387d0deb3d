"""The campaign: random problems, tested by exact arithmetic, planted solutions and other solvers.

    python tests/campaign.py --cases 14000 --seed 0 --jobs 2
    python tests/campaign.py --only "small indefinite:17"

The number of a case determines the case: ``--only KIND:NUMBER`` repeats it, ``--only KIND`` runs that kind. Counted per
kind: false SOLVED, violated bounds, wrong verdicts on matrices, other false claims, crashes (an exception that is
not an LCPError, or more than five minutes) and modified inputs. The exit code is 1 if a count is not zero. The last
two columns are not violations: "near" counts points that are within the tolerance of a problem without a solution;
"open" counts undecided cases.
"""

from __future__ import annotations

import argparse
import importlib
import multiprocessing
import os
import signal
import sys
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(1, str(Path(__file__).parents[1]))
from campaigns.kinds import CRASH, MODIFIED, ROUND, SCHEDULE, TOLD, VIOLATIONS, Finding, Found
from oracles.relations import bits, surroundings

from lcp_plugin import LCP

MAX_SECONDS = 300.0  # of one case


class Watch:
    """Every array that a problem is stated with, and a copy."""

    def __init__(self) -> None:
        self.given: list[tuple[tuple[Any, ...], tuple[bytes, ...]]] = []

    def changes(self) -> Found:
        for arrays, before in self.given:
            if bits(*arrays) != before:
                yield Finding(MODIFIED, "an array that a problem was stated with")


@contextmanager
def watching() -> Iterator[Watch]:
    """Keep a copy of the arrays of each LCP, the package's included."""
    watch, original = Watch(), LCP.__init__

    def watched(
        self: LCP, M: Any, q: Any, *, lower: Any = 0.0, upper: Any = np.inf, **names: Any
    ) -> None:
        watch.given.append(((M, q, lower, upper), bits(M, q, lower, upper)))
        original(self, M, q, lower=lower, upper=upper, **names)

    LCP.__init__ = watched  # type: ignore[method-assign]
    try:
        yield watch
    finally:
        LCP.__init__ = original  # type: ignore[method-assign]


def too_long(*_: object) -> None:
    raise TimeoutError(f"more than {MAX_SECONDS:.0f} s")


def run(name: str, kind: Any, number: int) -> list[Finding]:
    """Run one case under watch; an exception is a finding."""
    found: list[Finding] = []
    before = surroundings()
    signal.setitimer(signal.ITIMER_REAL, MAX_SECONDS)
    try:
        with watching() as watch:
            found += ROUND[name][0](np.random.default_rng(number), kind)
    except Exception as error:
        where = traceback.extract_tb(error.__traceback__)[-1]
        place = f"{Path(where.filename).name}:{where.lineno}"
        found.append(Finding(CRASH, f"{type(error).__name__}: {error} ({place})"))
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
    found += watch.changes()
    after = surroundings()
    return found + [Finding(MODIFIED, what) for what in before if before[what] != after[what]]


def prepare_process() -> None:
    """Turn warnings into errors, and let a clock end a case that hangs."""
    warnings.simplefilter("error")
    signal.signal(signal.SIGALRM, too_long)
    load_others()


def load_others() -> None:
    """Load packages that set states of the process when they are loaded."""
    for name in ("pyamg", "cvxpy", "scipy.optimize", "pyomo.environ", "highspy"):
        with suppress(ImportError), warnings.catch_warnings(action="ignore"):
            importlib.import_module(name)


def counted(task: tuple[str, Any, int]) -> tuple[str, float, list[Finding], str]:
    """Return the name of the kind, the seconds and the findings of a case, and how to repeat it."""
    name, kind, number = task
    began = time.process_time()
    found = run(name, kind, number)
    return name, time.process_time() - began, found, f"--only '{name} {kind}:{number}'"


def campaign(tasks: list[tuple[str, Any, int]], jobs: int) -> int:
    """Run the cases in processes, print the violations and the table; return the exit code."""
    context = multiprocessing.get_context("spawn")
    os.environ["OMP_NUM_THREADS"] = "1"  # as many processes as processors
    cases, seconds, counts = Counter[str](), Counter[str](), Counter[tuple[str, str]]()
    longest = (0.0, "")
    with ProcessPoolExecutor(jobs, context, prepare_process) as pool:
        for name, spent, found, how in pool.map(counted, tasks, chunksize=20):
            cases[name] += 1
            seconds[name] += spent
            longest = max(longest, (spent, how))
            for what, text in found:
                counts[name, what] += 1
                if what in VIOLATIONS:
                    print(f"{how}   {what}: {text}", flush=True)
    columns = (*VIOLATIONS, *TOLD)
    print(
        f"{'kind':<14}{'cases':>8}" + "".join(f"{column:>14}" for column in columns) + "   ms each"
    )
    for name in cases:
        cells = "".join(f"{counts[name, column]:>14}" for column in columns)
        print(f"{name:<14}{cases[name]:>8}{cells}{1000.0 * seconds[name] / cases[name]:>10.1f}")
    print(f"the longest took {longest[0]:.1f} s: {longest[1]}")
    return int(any(counts[name, what] for name in cases for what in VIOLATIONS))


def repeat(target: str) -> int:
    """Run the one case of that name and print its findings."""
    title, _, number = target.rpartition(":")
    named = {f"{name} {kind}": (name, kind) for name, kind in SCHEDULE}
    if title not in named or not number.isdigit():
        print(f"--only wants KIND:NUMBER with one of these kinds: {', '.join(sorted(named))}")
        return 2
    prepare_process()
    found = run(*named[title], int(number))
    print("\n".join(f"{what}: {text}" for what, text in found) or "nothing found")
    return int(any(what in VIOLATIONS for what, _ in found))


def main() -> int:
    """Run the cases of the command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--cases", type=int, default=2000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--only", default="", metavar="KIND[:NUMBER]", help="one kind, or one case")
    given = parser.parse_args()
    if given.only and given.only not in ROUND:
        return repeat(given.only)
    chosen = [one for one in SCHEDULE if given.only in ("", one[0])]
    tasks = [(*chosen[k % len(chosen)], given.seed * 10**9 + k) for k in range(given.cases)]
    return campaign(tasks, given.jobs)


if __name__ == "__main__":
    sys.exit(main())
