"""The best of all solutions: time and nodes until the gap is proved, on random leaders with a monotone follower."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from lcp_plugin.problems.equilibria.branch_and_bound import minimize_over_solutions
from lcp_plugin.problems.equilibria.equilibrium_program import EquilibriumProgram
from lcp_plugin.problems.programs.program import QuadraticProgram

SMALL, LARGE = (10, 20), (10, 20, 40)  # pairs
LEADERS = 5  # pairs for each variable of the leader
LIMIT = 30.0  # seconds of a search


def run(*, quick: bool = False) -> Iterator[str]:
    """Yield a line a problem: how the search ended, and whether its bound holds when checked again from the data."""
    for pairs in SMALL if quick else LARGE:
        for is_linear in (True, False):
            result = minimize_over_solutions(random_leader(pairs, is_linear), max_seconds=LIMIT)
            checked = "holds" if result.verify() else "DOES NOT HOLD"
            yield (
                f"{pairs} pairs, {'linear' if is_linear else 'quadratic':<10} {result.status.name:<12} "
                f"in {result.seconds:.3f} s and {result.nodes} nodes: value {result.value:.6g}, gap {result.gap:.1e}; "
                f"its bound {checked}"
            )


def random_leader(pairs: int, is_linear: bool, seed: int = 0) -> EquilibriumProgram:
    """Return a leader in a box whose followers solve a complementarity problem with a positive definite matrix.

    Parameters
    ----------
    pairs : int
    is_linear : bool
        Whether the objective is.
    seed : int
    """
    random, leaders = np.random.default_rng([36, seed, pairs]), max(2, pairs // LEADERS)
    n = leaders + 2 * pairs
    square, skew = random.standard_normal((2, pairs, pairs))
    M = square @ square.T / pairs + 0.1 * np.eye(pairs) + 0.5 * (skew - skew.T) / np.sqrt(pairs)
    P, c = np.zeros((n, n)), np.zeros(n)
    root = random.standard_normal((n - pairs, n - pairs))
    if not is_linear:
        P[: n - pairs, : n - pairs] = root @ root.T / (n - pairs)
    c[: n - pairs] = random.standard_normal(n - pairs)
    A = np.hstack([random.standard_normal((pairs, leaders)), M, -np.eye(pairs)])
    lower, upper = np.zeros(n), np.full(n, np.inf)
    lower[:leaders], upper[:leaders] = -1.0, 1.0
    program = QuadraticProgram(
        P, c, A=A, b=-random.standard_normal(pairs), lower=lower, upper=upper
    )
    followers = np.arange(leaders, leaders + pairs)
    return EquilibriumProgram(program, followers, followers + pairs)
