"""The first point of a least squares problem: computed once, whatever limits, starts or describes the solve."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from lcp_plugin import BoundedLeastSquares, prepare, solve
from lcp_plugin.problems.least_squares import engines, solving

RNG = np.random.default_rng(0)
A, B = RNG.random((60, 30)), RNG.random(60)
ONE = BoundedLeastSquares(A, B)
BEST = solve(ONE).x
CALLS: dict[str, Any] = {
    "a time limit": lambda: solve(ONE, max_seconds=60.0),
    "a start": lambda: solve(ONE, x0=np.ones(30)),
    "a default": lambda: solve(ONE, verbose=False),
    "lists": lambda: solve(BoundedLeastSquares(A.tolist(), B.tolist())),
    "prepared, a time limit": lambda: prepare(ONE, max_seconds=60.0).solve(b=B),
    "prepared, a start": lambda: prepare(ONE).solve(b=B.tolist(), x0=np.ones(30)),
}


@pytest.mark.quick
@pytest.mark.parametrize("name", CALLS)
def test_a_small_problem_is_solved_without_a_run(name, monkeypatch):
    """Limits, starts and other forms of the data lead to the same bits without a run."""

    def refuse(*_: Any) -> None:
        raise AssertionError

    monkeypatch.setattr(solving, "LeastSquaresRun", refuse)
    result = CALLS[name]()
    assert result.is_solved
    assert np.array_equal(result.x, BEST)


@pytest.mark.quick
def test_a_start_that_passes_is_returned():
    """It takes no step; recorded or not, a start that fails leads to the solution by nnls."""
    near = BEST * (1.0 + 1e-12)
    again = solve(ONE, x0=near)
    assert (again.algorithm, again.iterations, again.is_solved) == ("start", 0, True)
    assert np.array_equal(again.x, near)
    for how in ({}, {"record": True}):
        assert np.array_equal(solve(ONE, x0=np.ones(30), **how).x, BEST)


@pytest.mark.quick
def test_nnls_is_called_once(monkeypatch):
    """A run takes the point that does not pass."""
    counts, solve_once = [], engines.nnls_point
    monkeypatch.setattr(engines, "nnls_point", lambda one: counts.append(1) or solve_once(one))
    A = np.c_[np.ones(30), np.arange(2000.0, 2030.0), np.arange(2000.0, 2030.0) ** 2]
    solve(BoundedLeastSquares(A, np.sin(A[:, 1]), lower=[0.0, 0.0, 0.0]), tolerance=0.0)
    assert len(counts) == 1
