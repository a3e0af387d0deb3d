"""Proofs of solutions of polynomial problems whose rational solution is known: how many succeed, and whether they hold.

Run ``python tests/campaigns/krawczyk.py --cases 1000 --seed 0``. Every case is proved from the answer of a solve, and
from points at a distance of 1e-12 … 1 from the solution, where a proof may also fail. Half of the problems have no
other solution than the planted one: every bound must hold it. Of the others only answers within 1e-6 of it are judged.
Exits with 1 where a bound is violated, or where less than 80 % of the answers are proved.
"""

from __future__ import annotations

import argparse
import sys
import warnings
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))
from polynomial_families import is_violated, polynomial

from lcp_plugin.problems.nonlinear.krawczyk import krawczyk_bound
from lcp_plugin.problems.nonlinear.solving import solve_nonlinear

ENOUGH = 0.8
NEAR = 1e-6


def main(cases: int, seed: int) -> int:
    proved = judged = violated = nearby = proved_nearby = refused = 0
    ratios = []
    for case in range(cases):
        rng = np.random.default_rng([seed, case])
        is_dominant = case % 2 == 0
        one = polynomial(rng, is_dominant=is_dominant)
        n, scatter = one.x.size, 10.0 ** rng.uniform(-12, 0)
        result = solve_nonlinear(
            one.problem, one.x + 0.01 * rng.standard_normal(n), error_bound=True
        )
        bound = result.error_bound
        if result.is_solved and (is_dominant or np.abs(result.z - one.x).max() < NEAR):
            judged += 1
            proved += bound is not None
            if bound is not None:
                violated += is_violated(one, result.z, bound.componentwise)
                ratios.append(bound.infinity / max(float(np.abs(result.z - one.x).max()), 1e-16))
        elif not result.is_solved:
            print(f"case {case}: {result.status.name}")
        if is_dominant:
            x = one.x + scatter * rng.standard_normal(n)
            bound = krawczyk_bound(one.problem.linearised(x), x, one)
            nearby += 1
            proved_nearby += bound is not None
            violated += bound is not None and is_violated(one, x, bound.componentwise)
            free = np.flatnonzero((one.lower < one.x) & np.isfinite(one.lower))
            if free.size:  # the trap: its own bound cuts the solution off
                lower = one.lower.copy()
                lower[free[0]] = np.nextafter(one.x[free[0]], np.inf) + 2.0**-30
                upper = np.maximum(one.upper, lower)
                cut = type(one)(one.a, one.b, one.d, one.e, one.c, lower, upper, one.x)
                bound = krawczyk_bound(cut.problem.linearised(one.x), one.x, cut)
                is_false = bound is not None and bool(
                    bound.componentwise[free[0]] < lower[free[0]] - one.x[free[0]]
                )
                violated += is_false
                refused += not is_false
    print(
        f"{cases} cases: {proved} of {judged} answers proved ({proved / max(judged, 1):.1%}), {violated} violated; "
        f"at a distance {proved_nearby} of {nearby}; {refused} cut off and not claimed"
    )
    print(f"bound ÷ error (at least 1e-16): median {np.median(ratios):.2g}")
    return int(violated > 0 or proved < ENOUGH * judged)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cases", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    warnings.simplefilter("error")
    sys.exit(main(given.cases, given.seed))
