"""The whole stability atlas, and random problems in random units: ``python tests/campaigns/stability_atlas.py``.

Prints the atlas, then for each algorithm how often it solved problems whose rows and columns were multiplied by random
powers of two; exit code 1 on a false status, an exception, or less than 80 % of the cells SOLVED.
"""

from __future__ import annotations

import argparse
import sys
import warnings
from collections import Counter
from pathlib import Path

import numpy as np

from lcp_plugin import LCP
from lcp_plugin.algorithms import REGISTRY
from lcp_plugin.core.errors import UnsuitableMatrix, UnsuitableProblem
from lcp_plugin.evidence.stability import stability_atlas
from lcp_plugin.evidence.stresses import StressCase, planted, rescaled

sys.path[:0] = [str(Path(__file__).parents[1]), str(Path(__file__).parents[1] / "evidence")]
from test_stability import assert_honest  # noqa: E402

SPREADS = (0, 3, 30, 100, 300)


def random_case(rng: np.random.Generator) -> StressCase:
    """An H₊ or positive definite matrix of integers with a planted answer, in random units."""
    n = int(rng.integers(1, 9))
    A = rng.integers(-9, 10, size=(n, n)) * (rng.random((n, n)) < rng.uniform(0.2, 1.0))
    if rng.random() < 0.5:
        np.fill_diagonal(A, 0)
        M = A + np.diag(abs(A).sum(axis=1) + 2.0 ** -rng.integers(0, 30, size=n))
    else:
        M = A @ A.T + np.diag(2.0 ** -rng.integers(0, 30, size=n))
    z, w = rng.integers(1, 10, size=(2, n)).astype(float)
    z[rng.random(n) < 0.5] = 0.0
    w[(z > 0.0) | (rng.random(n) < 0.2)] = 0.0
    row, column = (
        np.exp2(rng.integers(-spread, spread + 1, size=n)) for spread in rng.choice(SPREADS, size=2)
    )
    return rescaled("random units", planted("", M.astype(float), z, w), row, column)


def untrue(case: StressCase, name: str, counts: Counter[tuple[str, str]]) -> str:
    """Count the status of a run; return what is untrue in it, or an empty text."""
    from lcp_plugin import solve

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", RuntimeWarning)
            result = solve(case.problem, name, max_iterations=2000)
    except (UnsuitableMatrix, UnsuitableProblem):
        counts[name, "REFUSED"] += 1
        return ""
    except Exception as error:
        return f"{type(error).__name__}: {error}"
    counts[name, result.status.name] += 1
    if case.exact is not None and result.has_no_solution:
        return f"{result.status.name}, but there is a solution"
    try:
        assert_honest(result)
    except AssertionError as error:
        return f"{result.status.name} is false: {error}"
    return ""


def told(problem: LCP) -> str:
    """The data of a problem, to repeat it with."""
    return f"M={problem.csr.toarray().tolist()}, q={problem.q.tolist()}"


def main() -> int:
    """Run the campaign; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cases", type=int, default=300)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    warnings.simplefilter("ignore")

    atlas = stability_atlas()
    print(atlas)
    is_bad = len(atlas.unsolved) > 0.2 * len(atlas.cells)

    rng = np.random.default_rng(options.seed)
    counts: Counter[tuple[str, str]] = Counter()
    for number in range(options.cases):
        case = random_case(rng)
        for name in ("auto", *REGISTRY):
            lie = untrue(case, name, counts)
            if lie:
                is_bad = True
                print(f"case {number}, {name}: {lie}; {told(case.problem)}")
    for name in ("auto", *REGISTRY):
        found = {
            status: count
            for (algorithm, status), count in sorted(counts.items())
            if algorithm == name
        }
        print(f"{name:<15} " + ", ".join(f"{count} {status}" for status, count in found.items()))
    return int(is_bad)


if __name__ == "__main__":
    sys.exit(main())
