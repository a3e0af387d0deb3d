"""Agents whose functions have a domain: no condition holds outside of it, and gap() is infinite there."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import Any

import cvxpy as cp
import numpy as np
import pytest

from lcp_plugin import ModelWarning, optimal

#: Convex functions of a vector whose conditions have solutions outside of their domain, or no limit to it.
FUNCTIONS: dict[str, Callable[[Any], Any]] = {
    "log": lambda u: -cp.sum(cp.log(u)),
    "log1p": lambda u: -cp.sum(cp.log1p(u - 1)),
    "entr": lambda u: -cp.sum(cp.entr(u)),
    "kl_div": lambda u: cp.sum(cp.kl_div(u, 2)) + cp.sum(cp.kl_div(1, u)),
    "rel_entr": lambda u: cp.sum(cp.rel_entr(1, u)),
    "inv_pos": lambda u: cp.sum(cp.inv_pos(u)),
    "negative even power": lambda u: cp.sum(cp.power(u, -2)),
    "negative odd power": lambda u: cp.sum(cp.power(u, -3)),
    "cube": lambda u: cp.sum(cp.power(u, 3)) - cp.sum(u),
    "fifth power": lambda u: cp.sum(cp.power(u, 5)) - cp.sum(u),
    "power of 1.5": lambda u: cp.sum(cp.power(u, 1.5)) - cp.sum(u),
    "sqrt": lambda u: -cp.sum(cp.sqrt(u)),
    "geo_mean": lambda u: -cp.geo_mean(u),
    "quad_over_lin": lambda u: cp.quad_over_lin(1, u[0]) + cp.quad_over_lin(2, u[1]),
}


def gap_of(agent: Any) -> float | None:
    """Return the gap, and raise an error for any warning."""
    with warnings.catch_warnings():
        warnings.simplefilter("error", ModelWarning)
        gap: float | None = agent.gap()
    return gap


@pytest.mark.quick(1)
@pytest.mark.parametrize("start", [None, -1.0, 0.3])
@pytest.mark.parametrize("form", ["entries", "sums"])
@pytest.mark.parametrize("name", FUNCTIONS)
def test_an_agent_stays_in_the_domain_of_its_functions(name, form, start):
    """From any start, the agent has the value of Clarabel for f(u) + |u − 1|² / 9 − y sum(u) / 4, y = 1 outside."""
    z, y = cp.Variable(2, bounds=[-3, 3]), cp.Variable()
    y.value = 1.0
    z.value = None if start is None else np.full(2, start)
    u = z if form == "entries" else np.array([[1.0, 0.5], [-0.25, 1.0]]) @ z

    def program(other):
        goal = FUNCTIONS[name](u) + cp.sum_squares(u - 1) / 9 - other * cp.sum(u) / 4
        return cp.Problem(cp.Minimize(goal), [cp.sum(z) >= -1])

    agent = optimal(program(y), over=[z])
    problem = cp.Problem(cp.Minimize(0), [agent, y == 1])
    problem.solve(method="LCP")
    assert problem.status == "optimal"
    assert (u.value >= -1e-9).all()
    value, gap = float(agent.program.objective.value), gap_of(agent)
    assert gap is not None
    assert gap <= 1e-5
    reference = program(1.0)
    reference.solve(solver=cp.CLARABEL)
    assert value == pytest.approx(reference.value, abs=1e-5)


def test_a_portfolio_of_logarithms_has_the_value_of_clarabel():
    """The sum of log(R w), whose gradient is finite beyond the domain: once the default start led outside."""
    returns = 1.05 + 0.3 * np.random.default_rng(0).standard_normal((20, 3))
    w = cp.Variable(3, bounds=[-5, 5])
    program = cp.Problem(cp.Maximize(cp.sum(cp.log(returns @ w)) / 20), [cp.sum(w) == 1])
    agent = optimal(program, over=[w])
    cp.Problem(cp.Minimize(0), [agent]).solve(method="LCP")
    np.testing.assert_allclose(w.value, [-0.1208, -0.1265, 1.2473], atol=1e-4)
    gap = gap_of(agent)
    assert gap is not None
    assert gap <= 1e-6


def test_a_leader_gets_no_answer_outside_of_the_domain():
    """The follower max log(y) − (1 + t) y answers 1 / (1 + t); the leader's least y is 1/3."""
    y, t = cp.Variable(bounds=[-5, 5]), cp.Variable(bounds=[0, 2])
    agent = optimal(cp.Problem(cp.Maximize(cp.log(y) - cp.multiply(1 + t, y))), over=[y])
    cp.Problem(cp.Minimize(y), [agent]).solve(method="LCP")
    assert (float(y.value), float(t.value)) == pytest.approx((1 / 3, 2.0), abs=1e-5)
    assert (agent.gap() or 0.0) <= 1e-5


def test_a_cube_has_the_domain_of_the_rules_of_cvxpy():
    """y³ is convex for y ≥ 0: min y³ − y on [−1, 1] is at 1/√3, not at the maximum −1/√3."""
    y = cp.Variable(bounds=[-1, 1], value=-0.5)
    agent = optimal(cp.Problem(cp.Minimize(y**3 - y)), over=[y])
    cp.Problem(cp.Minimize(0), [agent]).solve(method="LCP")
    assert float(y.value) == pytest.approx(1 / np.sqrt(3))


def test_the_boundary_of_a_domain_may_be_the_optimum():
    """Min (z₀ + z₁)³ + z₀ with z ≥ −1 − k is where z₀ + z₁ = 0, a condition with a multiplier."""
    z = cp.Variable(2, bounds=[-3, 3], value=np.ones(2))
    agent = optimal(
        cp.Problem(cp.Minimize(cp.power(cp.sum(z), 3) + z[0] + cp.square(z[1] - 1))), over=[z]
    )
    cp.Problem(cp.Minimize(0), [agent]).solve(method="LCP")
    reference = cp.Problem(agent.program.objective, [z >= -3, z <= 3])
    value = float(agent.program.objective.value)
    reference.solve(solver=cp.CLARABEL)
    assert value == pytest.approx(reference.value, abs=1e-6)


@pytest.mark.parametrize("name", FUNCTIONS)
def test_the_gap_outside_of_a_domain_is_infinite_and_says_so(name):
    """At u = −1 the function is not defined; a warning names the condition."""
    z = cp.Variable(2, bounds=[-3, 3])
    agent = optimal(cp.Problem(cp.Minimize(FUNCTIONS[name](z) + cp.sum(z))), over=[z])
    z.value = np.full(2, -1.0)
    with pytest.warns(ModelWarning, match="gap is infinite"):
        assert agent.gap() == np.inf


def test_rounding_at_the_boundary_is_not_outside():
    """At −1e-18 the powers have the values of 0, and the logarithm has none."""
    y = cp.Variable(bounds=[-1, 1], value=-1e-18)
    root = optimal(cp.Problem(cp.Minimize(cp.power(y, 1.5) + y)), over=[y])
    assert gap_of(root) == pytest.approx(0.0, abs=1e-8)
    with pytest.warns(ModelWarning, match="not finite"):
        assert optimal(cp.Problem(cp.Maximize(cp.log(y) - y)), over=[y]).gap() == np.inf


def test_functions_of_other_agents_have_the_values_that_they_have():
    """q³ of another variable is a number for the agent: min y² − q³ y at q = −1 is y = −1/2."""
    y, q = cp.Variable(), cp.Variable()
    agent = optimal(cp.Problem(cp.Minimize(cp.square(y) - cp.multiply(q**3, y))), over=[y])
    cp.Problem(cp.Minimize(0), [agent, q == -1]).solve(method="LCP")
    assert float(y.value) == pytest.approx(-0.5)
    assert gap_of(agent) == pytest.approx(0.0, abs=1e-8)
