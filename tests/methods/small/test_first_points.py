"""The first points of a small LCP: taken once, whatever limits, starts or describes the solve."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from inputs.small_families import spectrum

from lcp_plugin import LCP, prepare, solve
from lcp_plugin.methods import small
from lcp_plugin.solving import lcp_run

ONE = spectrum(8, 1e2, 0.4, 0)
M, Q = np.array(ONE.M), np.array(ONE.q)
BLOCKS = np.kron(np.eye(2), M)
NEAR = solve(ONE).z
CALLS: dict[str, Any] = {
    "a time limit": lambda: solve(ONE, max_seconds=60.0),
    "a start": lambda: solve(ONE, z0=np.ones(8)),
    "a solution as start": lambda: solve(ONE, z0=NEAR),
    "a default": lambda: solve(ONE, verbose=False),
    "an absolute tolerance": lambda: solve(ONE, absolute_tolerance=1e-12),
    "lists": lambda: solve(LCP(M.tolist(), Q.tolist())),
    "single precision": lambda: solve(LCP(M.astype(np.float32), Q.astype(np.float32))),
    "two components": lambda: solve(LCP(BLOCKS, np.r_[Q, -Q])),
    "a component that 0 solves": lambda: solve(LCP(BLOCKS, np.r_[Q, np.abs(Q)])),
    "0 as solution": lambda: solve(LCP(M, np.abs(Q))),
    "lemke, a time limit": lambda: solve(ONE, "lemke", max_seconds=60.0),
    "lemke, a start": lambda: solve(ONE, "lemke", z0=np.ones(8)),
    "lemke, two components": lambda: solve(LCP(BLOCKS, np.r_[Q, -Q]), "lemke"),
    "prepared, a time limit": lambda: prepare(ONE, max_seconds=60.0).solve(q=Q),
    "prepared, a start": lambda: prepare(ONE).solve(q=Q, z0=[1.0] * 8),
    "prepared, lists": lambda: prepare(ONE).solve(q=Q.tolist(), M=M.tolist(), lower=0),
    "prepared, two components": lambda: prepare(LCP(BLOCKS, np.r_[Q, -Q])).solve(),
}


@pytest.mark.quick
@pytest.mark.parametrize("name", CALLS)
def test_a_small_lcp_is_solved_without_a_run(name, monkeypatch):
    """Limits, starts, components and other forms of the data lead to no run."""

    def refuse(*_: Any) -> None:
        raise AssertionError

    monkeypatch.setattr(lcp_run.LCPRun, "__init__", refuse)
    result = CALLS[name]()
    assert result.is_solved
    assert result.residual <= 1e-8


@pytest.mark.quick
@pytest.mark.parametrize("how", [{}, {"record": True}, {"callback": lambda *_: None}])
def test_sweeps_guess_once(how, monkeypatch):
    """A run takes the first points of an LCP that they do not solve; what watches a run changes no bits."""
    counts, guess = [], small.guess
    monkeypatch.setattr(small, "guess", lambda data: counts.append(1) or guess(data))
    rng = np.random.default_rng(0)
    for _ in range(8):
        problem = LCP(rng.normal(size=(8, 8)), rng.normal(size=8))
        plain = solve(problem, prove_infeasibility=False, max_iterations=20)
        counts.clear()
        found = solve(problem, prove_infeasibility=False, max_iterations=20, **how)
        assert len(counts) == 1
        assert found.status is plain.status
        assert np.array_equal(found.z, plain.z)


def test_a_start_that_passes_is_returned():
    """It takes no iteration."""
    for algorithm in ("auto", "lemke"):
        again = solve(ONE, algorithm, z0=NEAR)
        assert again.iterations == 0
        assert np.array_equal(again.z, NEAR)
    assert prepare(ONE).solve(z0=NEAR).iterations == 0
