"""Random monotone and P₀ nonlinear problems with a planted solution: how many are solved, and whether SOLVED is true.

Run ``python tests/campaigns/nonlinear.py --cases 2000 --seed 0``. The kinds stand in ``nonlinear_families``: polynomial
and exponential, with bounds of every kind and free rows, n = 2 … 200, started at the point nearest to 0 or at random. A
SOLVED is judged again with F in sixty digits, beside ‖r(z°)‖ or the most that an affine F could have there. Prints what
was not solved and how many steps were taken; exits with 1 where a SOLVED is false, less than 99 % are solved, or
anything is raised.

``--membrane 32 100 316 1000`` solves the semilinear obstacle problem of ``nonlinear_models`` on grids of these sizes
instead, and prints Newton steps and seconds.
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
from nonlinear_families import KINDS, planted
from nonlinear_models import membrane

from lcp_plugin import Status, solve_nonlinear

TOLERANCE = 1e-8
ENOUGH = 0.99


def main(cases: int, seed: int, first: int) -> int:
    statuses: Counter[str] = Counter()
    steps, times, false = [], [], 0
    for case in range(first, first + cases):
        rng = np.random.default_rng([seed, case])
        kind, n = KINDS[case % len(KINDS)], round(2 * 100 ** rng.random())
        one = planted(rng, kind, n)
        x0 = np.zeros(n) if rng.random() < 0.5 else rng.standard_normal(n)
        began = time.perf_counter()
        result = solve_nonlinear(one.problem, x0, tolerance=TOLERANCE)
        times.append((time.perf_counter() - began, case, n))
        statuses[f"{kind}: {result.status.name}"] += 1
        steps.append(result.iterations)
        name = f"case {case}, {kind}, n = {n}: {result.status.name}, {result.residual:.1e} after {result.iterations}"
        if result.status is Status.SOLVED:
            residual = one.sharp_relative_residual(result.z, result.certificate.problem.residual_scale)
            if residual > TOLERANCE:
                false += 1
                print(f"FALSE: {name}, and {residual:.3e} in sixty digits", flush=True)
        else:
            print(f"{name}; the distance from the planted one is {np.abs(result.z - one.x).max():.1e}", flush=True)
    print("\n".join(f"{count:>6} × {status}" for status, count in sorted(statuses.items())))
    solved = sum(count for status, count in statuses.items() if status.endswith(" SOLVED"))
    print(f"steps: median {np.median(steps):.0f}, 99 % at most {np.quantile(steps, 0.99):.0f}, the most {max(steps)}")
    print(f"{sum(t for t, *_ in times):.0f} s; the longest: " + ", ".join(
        f"{t:.1f} s (case {case}, n = {n})" for t, case, n in sorted(times, reverse=True)[:3]))
    print(f"{cases} cases: {solved} solved ({solved / cases:.2%}), {false} false")
    return int(false > 0 or solved < ENOUGH * cases)


def membranes(sizes: list[int]) -> int:
    solve_nonlinear(membrane(40)[0], np.zeros(1600))  # compiles
    for size in sizes:
        problem, _ = membrane(size)
        began, worked = time.perf_counter(), time.process_time()
        result = solve_nonlinear(problem, np.zeros(size * size))
        seconds = f"{time.perf_counter() - began:.2f} s, {time.process_time() - worked:.2f} s of one processor"
        print(f"n = {size * size:>8}: {result.status.name}, {result.iterations} Newton steps, {seconds}", flush=True)
    return 0


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cases", type=int, default=2000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--first", type=int, default=0, help="the number of the first case")
    parser.add_argument("--membrane", type=int, nargs="+")
    given = parser.parse_args()
    warnings.simplefilter("error")
    sys.exit(membranes(given.membrane) if given.membrane else main(given.cases, given.seed, given.first))
