"""The first sweeps of a contact problem: made once, whatever limits, starts or describes the solve."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from lcp_plugin import FrictionalContact, prepare, solve
from lcp_plugin.problems.cones import solving

RNG = np.random.default_rng(0)
J, B = RNG.normal(size=(15, 6)), RNG.normal(size=15)
W = J @ J.T + np.eye(15)
ONE = FrictionalContact(W, B, 0.5, dimension=3)
NEAR = solve(ONE).z
CALLS: dict[str, Any] = {
    "a time limit": lambda: solve(ONE, max_seconds=60.0),
    "a start": lambda: solve(ONE, z0=np.ones(15)),
    "a start in the cones": lambda: solve(ONE, z0=NEAR),
    "a default": lambda: solve(ONE, verbose=False),
    "an absolute tolerance": lambda: solve(ONE, absolute_tolerance=1e-12),
    "lists": lambda: solve(FrictionalContact(W.tolist(), B.tolist(), 0.5, dimension=3)),
    "prepared, a time limit": lambda: prepare(ONE, max_seconds=60.0).solve(b=B),
    "prepared, a start": lambda: prepare(ONE).solve(b=B.tolist(), z0=NEAR),
}


@pytest.mark.quick
@pytest.mark.parametrize("name", CALLS)
def test_a_small_contact_problem_is_solved_without_a_run(name, monkeypatch):
    """Limits, starts and other forms of the data lead to no run."""

    def refuse(*_: Any) -> None:
        raise AssertionError

    monkeypatch.setattr(solving, "ConeRun", refuse)
    result = CALLS[name]()
    assert result.is_solved
    assert result.residual <= 1e-8


@pytest.mark.quick
@pytest.mark.parametrize("is_prepared", [False, True])
def test_first_sweeps_are_made_once(is_prepared, monkeypatch):
    """A run takes the sweeps that find no solution of a problem with one component."""
    counts, sweep = [], solving.sweep_contacts
    monkeypatch.setattr(solving, "sweep_contacts", lambda *_: counts.append(1) or sweep(*_))
    rng = np.random.default_rng(1)
    for _ in range(20):
        J, mu = rng.normal(size=(12, 6)), 2.0 * rng.random(4)
        problem = FrictionalContact(J @ J.T, rng.normal(size=12), mu, dimension=3)
        counts.clear()
        prepare(problem).solve() if is_prepared else solve(problem)
        assert len(counts) == 1
