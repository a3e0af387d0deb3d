"""Random monotone and P₀ nonlinear problems with a planted solution: how many are solved, and whether SOLVED is true.

Run ``python tests/campaigns/nonlinear.py --cases 2000 --seed 0``. The kinds stand in ``nonlinear_families``: polynomial
and exponential, with bounds of every kind and free rows, n = 2 … 200, started at the point nearest to 0 or at random. A
SOLVED is judged again with F in sixty digits, beside ‖r(z°)‖ or the most that an affine F could have there. Prints what
was not solved and how many steps were taken; exits with 1 where a SOLVED is false, less than 99 % are solved, or
anything is raised.

``--membrane 32 100 316 1000`` solves the semilinear obstacle problem of ``nonlinear_models`` on grids of these sizes
instead, and prints Newton steps and seconds.

``--vanishing 5000`` solves problems whose derivatives vanish or blow up (``vanishing_families``): t^−a, exp(−t),
logistic, log and rational, one unknown, a few coupled or two in units of their own, with and without a solution, from
starts over ten decades. A SOLVED is false where a row that must vanish, F_i in sixty digits, exceeds 1e-6 of its own
terms Σ_j |F′_ij x_j| + |F_i − Σ_j F′_ij x_j|, F′ exact. Nothing else is allowed but what rounding in F explains: 16
ulps of the terms that F adds up and of what they change where x/u changes by itself, and underflow, 5e-324. Prints how
many problems with a planted solution are solved, by shape and decade of the start; exits with 1 where a SOLVED is
false, a run takes longer than 20 s of one processor, or anything is raised.
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
from vanishing_families import SHAPES, STRUCTURES, decade_of, vanishing

from lcp_plugin import Status
from lcp_plugin.problems.nonlinear.solving import solve_nonlinear

TOLERANCE = 1e-8
ENOUGH = 0.99
TOO_LONG = 20.0  # seconds of one processor


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
            residual = one.sharp_relative_residual(
                result.z, result.certificate.problem.residual_scale
            )
            if residual > TOLERANCE:
                false += 1
                print(f"FALSE: {name}, and {residual:.3e} in sixty digits", flush=True)
        else:
            print(
                f"{name}; the distance from the planted one is {np.abs(result.z - one.x).max():.1e}",
                flush=True,
            )
    print("\n".join(f"{count:>6} × {status}" for status, count in sorted(statuses.items())))
    solved = sum(count for status, count in statuses.items() if status.endswith(" SOLVED"))
    print(
        f"steps: median {np.median(steps):.0f}, 99 % at most {np.quantile(steps, 0.99):.0f}, the most {max(steps)}"
    )
    print(
        f"{sum(t for t, *_ in times):.0f} s; the longest: "
        + ", ".join(
            f"{t:.1f} s (case {case}, n = {n})" for t, case, n in sorted(times, reverse=True)[:3]
        )
    )
    print(f"{cases} cases: {solved} solved ({solved / cases:.2%}), {false} false")
    return int(false > 0 or solved < ENOUGH * cases)


def vanishings(cases: int, seed: int, first: int) -> int:
    counts: Counter[str] = Counter()
    tally: dict[str, list[bool]] = {}
    times, bad = [], 0
    for case in range(first, first + cases):
        shape, structure = (
            list(SHAPES)[case % len(SHAPES)],
            STRUCTURES[case // len(SHAPES) % len(STRUCTURES)],
        )
        one = vanishing(np.random.default_rng([seed, case]), shape, structure)
        how = "exact" if one.has_jacobian else "differences"
        name = f"case {case}, {structure} {', '.join(one.shapes)}, {how}"
        began = time.process_time()
        try:
            result = solve_nonlinear(one.problem, one.start, tolerance=TOLERANCE)
        except Exception as error:
            bad += 1
            print(f"RAISED: {name}: {type(error).__name__}: {error}", flush=True)
            continue
        times.append((time.process_time() - began, case))
        if times[-1][0] > TOO_LONG:
            bad += 1
            print(f"LONG: {name}: {times[-1][0]:.0f} s, {result.iterations} steps", flush=True)
        counts[
            f"{'with' if one.t is not None else 'without'} a solution: {result.status.name}"
        ] += 1
        if one.t is not None:
            for key in (f"shape {shape}", f"{structure}, {how}", f"start 1e{decade_of(one):+03d}"):
                tally.setdefault(key, []).append(result.is_solved)
        if result.is_solved and (wrong := one.wrong_rows(result.z)):
            bad += 1
            print(f"FALSE: {name}: x = {result.z}, (row, |F|, terms) = {wrong}", flush=True)
    print("\n".join(f"{count:>6} × {status}" for status, count in sorted(counts.items())))
    print(
        "\n".join(
            f"{key:>24}: {sum(solved):>5} of {len(solved):>5} solved"
            for key, solved in sorted(tally.items())
        )
    )
    seconds, longest = [t for t, _ in times], sorted(times, reverse=True)[:3]
    print(
        f"{sum(seconds):.0f} s of one processor, median {np.median(seconds):.2f} s, 99 % at most "
        f"{np.quantile(seconds, 0.99):.1f} s; the longest: "
        + ", ".join(f"{t:.1f} s (case {k})" for t, k in longest)
    )
    print(f"{cases} cases: {bad} false, raised or too long")
    return int(bad > 0)


def membranes(sizes: list[int]) -> int:
    solve_nonlinear(membrane(40)[0], np.zeros(1600))  # compiles
    for size in sizes:
        problem, _ = membrane(size)
        began, worked = time.perf_counter(), time.process_time()
        result = solve_nonlinear(problem, np.zeros(size * size))
        seconds = f"{time.perf_counter() - began:.2f} s, {time.process_time() - worked:.2f} s of one processor"
        print(
            f"n = {size * size:>8}: {result.status.name}, {result.iterations} Newton steps, {seconds}",
            flush=True,
        )
    return 0


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cases", type=int, default=2000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--first", type=int, default=0, help="the number of the first case")
    parser.add_argument("--membrane", type=int, nargs="+")
    parser.add_argument("--vanishing", type=int, metavar="CASES")
    given = parser.parse_args()
    warnings.simplefilter("error")
    if given.membrane:
        sys.exit(membranes(given.membrane))
    if given.vanishing:
        sys.exit(vanishings(given.vanishing, given.seed, given.first))
    sys.exit(main(given.cases, given.seed, given.first))
