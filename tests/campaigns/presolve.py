"""Presolve on thousands of tiny problems with every kind of row, against all solutions in exact fractions.

Run as ``python tests/campaigns/presolve.py --cases 3000 --seed 0``. Exit code 1 where a solution does not come back
exactly, or one is lost.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

from exact_assignments import solutions, solves

from lcp_plugin import LCP
from lcp_plugin.methods.presolve import presolve

BOUNDS = [(0.0, np.inf), (0.0, np.inf), (-np.inf, np.inf), (-1.0, 1.0), (0.1, 0.1), (0.0, 0.0), (-np.inf, 2.0)]


def problem(rng: np.random.Generator) -> LCP:
    """Return a problem of up to four rows with many zeros and numbers that sometimes round."""
    n = int(rng.integers(1, 5))
    M = rng.choice([0.0, 0.0, 0.0, 1.0, -1.0, 2.0, -3.0, 0.1, 5e-17], (n, n))
    if rng.random() < 0.6:
        M[np.arange(n), np.arange(n)] = rng.choice([1.0, 2.0, 0.1, -1.0], n)
    low, high = np.array([BOUNDS[k] for k in rng.integers(0, len(BOUNDS), n)]).T
    return LCP(M, rng.choice([0.0, 1.0, -1.0, 3.0, 0.3, -2.0], n), lower=low, upper=high)



class Outcome(NamedTuple):
    """Rows before and after, whether there is a solution, how many came back wrongly and how many were lost."""

    rows: int
    left: int
    solvable: bool
    wrong: int
    lost: int


def check(rng: np.random.Generator) -> Outcome:
    """Draw a problem, presolve it and compare all its solutions with all those of what is left."""
    case = problem(rng)
    smaller = presolve(case)
    found = solutions(case)
    return Outcome(
        case.n,
        smaller.problem.n,
        bool(found),
        sum(not solves(case, smaller.restore(z)) for z in solutions(smaller.problem)),
        sum(not solves(smaller.problem, z[smaller.kept]) for z in found),
    )


def main() -> int:
    """Run the campaign and print what was found."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--cases", type=int, default=3000)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    rng = np.random.default_rng(options.seed)
    outcomes = [check(rng) for _ in range(options.cases)]
    rows, left, solvable, wrong, lost = (sum(column) for column in zip(*outcomes, strict=True))
    print(f"{options.cases} problems, {solvable} with solutions; {left} of {rows} rows left;"
          f" {wrong} wrong, {lost} lost")
    return int(wrong + lost > 0)


if __name__ == "__main__":
    sys.exit(main())
