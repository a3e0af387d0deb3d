"""Small problems are decided: a solution, a proof that there is none, or neither (prove_infeasibility=False)."""

from __future__ import annotations

import numpy as np
import pytest
from oracles.truth import SOLVABLE, decide

from lcp_plugin import LCP, Status, solve

PROVEN = (Status.INFEASIBLE, Status.NO_SOLUTION)


def drawn(seed: int, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Standard normal M and q."""
    rng = np.random.default_rng([31, seed, n])
    return rng.standard_normal((n, n)), rng.standard_normal(n)


@pytest.mark.parametrize(
    ("n", "is_boxed"), [(4, True), (1, False), (2, False), (3, False), (4, False), (5, False)]
)
def test_the_status_is_true(n, is_boxed, draws):
    """SOLVED where there is a solution in exact arithmetic, else a proof that verifies, by rounds and the search."""
    for seed in draws(60 if n < 5 else 25):
        M, q = drawn(seed, n)
        upper = np.random.default_rng(seed).uniform(0.1, 2.0, n) if is_boxed else np.inf
        problem = LCP(M, q, upper=upper)
        result = solve(problem)
        assert {stage.name for stage in result.stages} <= {"rounds", "path", "search"}
        if decide(problem).verdict == SOLVABLE:
            assert result.is_solved
        else:
            assert result.status in PROVEN
            assert result.infeasibility.verify()
        assert solve(problem, prove_infeasibility=False).is_solved is result.is_solved


@pytest.mark.quick(1)
@pytest.mark.parametrize("n", [3, 6, 8, 12])
def test_planted_problems_are_never_infeasible(n, draws):
    """Integer data, a solution with active, inactive and degenerate rows: solved, with a look for proofs or without."""
    for seed in draws(80):
        rng = np.random.default_rng([32, seed, n])
        M = rng.integers(-4, 5, (n, n)).astype(float)
        z = np.where(rng.random(n) < 0.5, rng.integers(1, 4, n), 0).astype(float)
        w = np.where((z == 0) & (rng.random(n) < 0.7), rng.integers(1, 4, n), 0).astype(float)
        problem = LCP(M, w - M @ z)
        for prove_infeasibility in (True, False):
            result = solve(problem, prove_infeasibility=prove_infeasibility)
            assert result.is_solved
            assert result.infeasibility is None


@pytest.mark.quick(1)
@pytest.mark.parametrize("name", ["auto", "newton", "lemke", "interior_point"])
def test_without_prove_infeasibility_nothing_is_proved(name):
    """STALLED with words that say why, and no proof, where prove_infeasibility=True ends INFEASIBLE."""
    problem = LCP([[1.0, -1.0], [-1.0, 1.0]], [-1.0, -1.0])
    assert solve(problem, name).status is Status.INFEASIBLE
    result = solve(problem, name, prove_infeasibility=False)
    assert result.status is Status.STALLED
    assert result.infeasibility is None
    assert "not proved infeasible, because prove_infeasibility=False" in result.advice


def test_an_inconsistency_within_the_tolerance_does_not_end_a_run_after_the_search():
    """Exact data without a solution, M monotone and not: SOLVED at the tolerance that a point satisfies."""
    M = np.zeros((4, 4))
    M[:2, :2], M[2:, 2:] = [[1.0, -1.0], [-1.0, 1.0]], [[-1.0, 2.0], [2.0, -1.0]]
    q = np.array([-1.0, 1.0 - 1e-6, 1.0, 1.0])
    assert solve(LCP(M[:2, :2], q[:2]), prove_infeasibility=False).status is Status.STALLED
    for problem in (LCP(M[:2, :2], q[:2]), LCP(M, q)):
        for how in ({}, {"prove_infeasibility": False}):
            assert not solve(problem, **how).is_solved
            assert solve(problem, **how, tolerance=1e-5).is_solved
