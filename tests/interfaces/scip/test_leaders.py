"""Followers that are hard to solve keep nobody waiting: SCIP begins at once, looks for points are short."""

from __future__ import annotations

import numpy as np
import pytest

from lcp_plugin import EquilibriumProgram, QuadraticProgram, Status
from lcp_plugin.problems.equilibria.branch_and_bound import minimize_over_solutions


def hard_followers(seed: int, pairs: int = 42) -> EquilibriumProgram:
    """Leaders x within [−1, 1]⁴, followers 0 ≤ z ⟂ M z + C x + q ≥ 0 with a planted solution, M of no class."""
    rng = np.random.default_rng(seed)
    M, C, leaders = (
        rng.standard_normal((pairs, pairs)),
        rng.standard_normal((pairs, 4)),
        rng.uniform(-1.0, 1.0, 4),
    )
    is_active = rng.random(pairs) < 0.5
    z, w = (rng.uniform(0.1, 2.0, pairs) * side for side in (~is_active, is_active))
    q, n = w - M @ z - C @ leaders, 4 + 2 * pairs
    program = QuadraticProgram(
        np.zeros((n, n)),
        np.concatenate([np.zeros(4), rng.uniform(0.0, 1.0, pairs), np.zeros(pairs)]),
        A=np.hstack([C, M, -np.eye(pairs)]),
        b=-q,
        lower=np.append(-np.ones(4), np.zeros(2 * pairs)),
        upper=np.append(np.ones(4), np.full(2 * pairs, np.inf)),
    )
    return EquilibriumProgram(program, 4 + np.arange(pairs), 4 + pairs + np.arange(pairs))


@pytest.mark.full
def test_followers_that_take_long_do_not_keep_scip_waiting() -> None:
    """A leader over 42 pairs, whose followers no method solves quickly: a point, and its proof, within the limit."""
    result = minimize_over_solutions(hard_followers(0), max_seconds=20.0)
    assert result.status is Status.SOLVED
    assert result.value == pytest.approx(6.260972762935, rel=1e-6)
