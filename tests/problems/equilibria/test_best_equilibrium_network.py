"""A leader on a network: by SCIP, without it, from values, with little time, and what is said of each."""

from __future__ import annotations

import cvxpy as cp
import numpy as np
import pytest
from network import network

from lcp_plugin import EquilibriumProgram, QuadraticProgram, Status, complements, minimize_over_solutions
from lcp_plugin.core.errors import LCPError, UnsupportedModel
from lcp_plugin.problems.equilibria import branch_and_bound


@pytest.fixture
def without_scip(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let nobody find pyscipopt."""
    monkeypatch.setattr(branch_and_bound, "ask_or_none", lambda what, name: None)


def test_the_optimum_on_a_network_is_believed_with_scip_and_found_without(monkeypatch: pytest.MonkeyPatch) -> None:
    """SCIP closes the gap, which is said; without it the same point comes from followers at fixed leaders."""
    problem, invested = network()
    problem.solve(method="LCP", max_seconds=60)
    result = problem.solver_stats.extra_stats
    assert (problem.status, result.problem.pairs) == (cp.OPTIMAL, 42)
    assert result.bound_by == "proof" or "bound by SCIP, in floating point" in result.explain()
    assert result.problem.excess(result.x) <= 1e-7
    monkeypatch.setattr(branch_and_bound, "ask_or_none", lambda what, name: None)
    alone, own = network()
    alone.solve(method="LCP", max_seconds=5)
    assert alone.value == pytest.approx(problem.value, rel=1e-6)
    np.testing.assert_allclose(own.value, invested.value, atol=1e-4)


def test_where_an_equilibrium_is_known_one_is_returned(without_scip: None) -> None:
    """The variables hold an equilibrium: with no time at all the answer is no worse."""
    problem, _ = network()
    problem.solve(method="LCP", max_seconds=5)
    value = problem.value
    problem.solve(method="LCP", max_seconds=0)
    assert problem.status in (cp.OPTIMAL, cp.settings.USER_LIMIT)
    assert problem.value >= value - 1e-6 * abs(value)


def monopolist() -> tuple[cp.Problem, cp.Variable]:
    """Price × quantity beside a fringe that sells where the price exceeds 2 + y."""
    x, y, price = cp.Variable(bounds=[0, 10]), cp.Variable(), cp.Variable()
    fringe = complements(y >= 0, 2 + y - price >= 0)
    return cp.Problem(cp.Maximize(cp.multiply(price, x) - x), [fringe, price == 10 - x - y]), x


def test_a_bilinear_leader_without_scip_gets_a_point_and_advice(without_scip: None) -> None:
    """The followed advice, the extra, solves it: 12.5 at x = 5."""
    problem, _ = monopolist()
    problem.solve(method="LCP")
    result = problem.solver_stats.extra_stats
    assert (result.status, result.bound_by, result.x is None) == (Status.STALLED, None, False)
    assert "pip install 'lcp_plugin[global]'" in result.advice
    assert "requires_grad=True" in result.advice


def test_a_bilinear_leader_is_solved_by_scip() -> None:
    """Income (p − 1) x with y = (8 − x)/2 for x ≤ 6 and p = (12 − x)/2: x = 5, 12.5."""
    problem, x = monopolist()
    assert problem.solve(method="LCP") == pytest.approx(12.5, abs=1e-6)
    assert float(x.value) == pytest.approx(5.0, abs=1e-3)
    assert problem.solver_stats.extra_stats.proof is None


def test_what_cannot_be_is_said() -> None:
    """NaN data, a proof of what is not convex, an unbounded leader, smooth rows that contradict each other."""
    problem, x = monopolist()
    with pytest.raises(UnsupportedModel, match="not convex"):
        problem.solve(method="LCP", prove=True)
    with pytest.raises(LCPError, match="must be finite"):
        cp.Problem(cp.Maximize(np.nan * x), problem.constraints).solve(method="LCP")
    y, b = cp.Variable(), cp.Variable(boolean=True)
    never = cp.Problem(cp.Minimize(y), [complements(y >= 0, y - 1 >= 0), cp.exp(y) <= b])
    never.solve(method="LCP")
    assert (never.status, y.value) == (cp.settings.USER_LIMIT, None)
    assert "SCIP, in floating point, finds no solution" in never.solver_stats.extra_stats.advice
    falls = EquilibriumProgram(QuadraticProgram(None, [-1, 0], lower=0), [0], [1])
    assert minimize_over_solutions(falls).status is Status.UNBOUNDED
