"""variational(F, over=[x], constraints=[…]) in cvxpy: values, multipliers, gaps, derivatives, messages."""

from __future__ import annotations

import pickle
from typing import Any

import cvxpy as cp
import numpy as np
import pytest
from tools.refusals import assert_refused, refusals

from lcp_plugin import box, complements, derivative, optimal, variational

M, Q = np.array([[2.0, 1.0], [-1.0, 2.0]]), np.array([-8.0, -6.0])


def solved(*constraints: Any, goal: Any = None, **options: Any) -> Any:
    problem = cp.Problem(goal or cp.Minimize(0), list(constraints))
    problem.solve(method="LCP", **options)
    assert problem.status == "optimal"
    return problem


def test_an_affine_map_and_its_row_have_the_values_of_the_arrays():
    """The solution is (1.25, 1.75); the constraint also has the multiplier 3.75."""
    x = cp.Variable(2, nonneg=True)
    row = cp.sum(x) <= 3
    inequality = variational(M @ x + Q, over=[x], constraints=[row])
    solved(inequality)
    np.testing.assert_allclose(x.value, [1.25, 1.75], atol=1e-9)
    assert [float(one) for one in (inequality.dual_value[0], row.dual_value)] == pytest.approx(
        [3.75] * 2
    )
    gap = inequality.gap()
    assert gap is not None
    assert gap <= 1e-9


def test_the_gap_is_measured_at_the_present_values():
    """At x = 0 with F = q = (−8, −6) the best corner of the simplex is (3, 0): 24."""
    x = cp.Variable(2, nonneg=True, value=[0.0, 0.0])
    inequality = variational(M @ x + Q, over=[x], constraints=[cp.sum(x) <= 3])
    assert inequality.gap() == pytest.approx(24.0)


def test_a_smooth_map_of_two_variables_and_a_kink_are_solved():
    """‖x‖₁ ≤ 3 becomes an epigraph; y of a list of expressions is at its bound 1."""
    x, y = cp.Variable(2), cp.Variable()
    F = [M @ x + Q + cp.hstack([x[0] ** 3, 0.0]), cp.exp(y) - 2 * np.e]
    inequality = variational(F, over=[x, y], constraints=[cp.norm1(x) <= 3, y <= 1])
    solved(inequality)
    np.testing.assert_allclose([*x.value, y.value], [1.0, 2.0, 1.0], atol=1e-7)
    np.testing.assert_allclose(np.hstack(inequality.dual_value), [3.0, np.e], atol=1e-6)


def test_a_quasi_variational_inequality_is_the_game_of_harker():
    """Harker (1991): with a copy of x in the rows, (5, 9) or a point between (9, 6) and (10, 5) is a solution."""
    x, copy = cp.Variable(2, bounds=[0, 10]), cp.Variable(2)
    F = np.array([[2.0, 8 / 3], [5 / 4, 2.0]]) @ x - [34.0, 24.25]
    rows = [x + copy[::-1] <= 15]
    solved(variational(F, over=[x], constraints=rows), copy == x)
    assert np.allclose(x.value, [5, 9]) or (np.isclose(x.value.sum(), 15) and 9 <= x.value[0] <= 10)


def test_it_meets_a_pair_an_agent_and_a_leader():
    """The price of the row is set by a leader who wants sum(x) = 2; an agent follows x."""
    x, y, price = cp.Variable(2, nonneg=True), cp.Variable(), cp.Variable(nonneg=True)
    inequality = variational(M @ x + Q + price, over=[x], constraints=[x <= 5])
    agent = optimal(cp.Problem(cp.Minimize(cp.square(y - x[0]))), over=[y])
    pair = complements(price >= 0, 2 - cp.sum(x) >= 0)
    solved(inequality, agent, pair)
    both = [*x.value, y.value, price.value]
    solved(inequality, agent, cp.sum(x) <= 2, goal=cp.Minimize(price))
    np.testing.assert_allclose([*x.value, y.value, price.value], both, atol=1e-5)
    assert x.value.sum() == pytest.approx(2.0, abs=1e-5)


@pytest.mark.parametrize("kind", ["inequality", "agents"])
def test_dual_values_of_bounds_and_rows_have_derivatives_by_parameters(kind):
    """Of constraints that bound single decisions also: jvp agrees with differences, vjp with jvp."""
    cap, cost = cp.Parameter(value=2.0), cp.Parameter(value=1.0)
    if kind == "inequality":
        x = cp.Variable(3)
        rows = [2 * x >= cost * np.arange(3), x <= cap + 0.5, cp.sum(x) <= 9]
        F = np.array([[2, 1, 0], [-1, 2, 0], [0, 1, 3]]) @ x + [-1, 3, -9]
        stated = [variational(F, over=[x], constraints=rows)]
    else:
        x, y = cp.Variable(nonneg=True), cp.Variable(nonneg=True)
        rows = [x <= cap, x + y <= 3]
        profit = [cp.multiply(10 - x - y - cost, x), cp.multiply(8 - x - y, y)]
        stated = [
            optimal(cp.Problem(cp.Maximize(goal), [row]), over=[own])
            for goal, row, own in zip(profit, rows, (x, y), strict=True)
        ]
    problem = solved(*stated, tolerance=1e-12)
    found = derivative(problem)
    for parameter in (cap, cost):
        change = found.jvp({parameter: 1.0})
        ends = []
        for step in (1e-5, -2e-5):
            parameter.value += step
            problem.solve(method="LCP", tolerance=1e-12)
            ends.append([np.ravel(row.dual_value) for row in rows])
        parameter.value += 1e-5
        for row, first, last in zip(rows, *ends, strict=True):
            np.testing.assert_allclose(np.ravel(change[row]), (first - last) / 2e-5, atol=1e-6)
        sums = sum(float(np.sum(change[row])) for row in rows)
        ones = {row: np.ones(row.shape) for row in rows}
        problem.solve(method="LCP", tolerance=1e-12)
        assert derivative(problem).vjp(ones)[parameter] == pytest.approx(sums, abs=1e-8)


@pytest.mark.parametrize("is_smooth", [False, True])
def test_an_empty_set_is_infeasible_with_a_proof(is_smooth):
    """The conflict names both rows; the affine rows of a smooth model suffice."""
    x = cp.Variable(2, nonneg=True)
    rows = [cp.sum(x) <= 3, cp.sum(x) >= 4]
    F = M @ x + Q + (cp.power(x, 3) if is_smooth else 0)
    problem = cp.Problem(cp.Minimize(0), [variational(F, over=[x], constraints=rows)])
    problem.solve(method="LCP")
    assert problem.status == "infeasible"
    result = problem.solver_stats.extra_stats
    assert result.proof.verify()
    assert len(result.conflict.names) == 2


def test_an_affine_pair_without_solution_makes_a_smooth_model_infeasible():
    """The slack −x − 1 of a pair is negative for all x ≥ 0; the other pair is smooth."""
    x, y = cp.Variable(nonneg=True), cp.Variable(nonneg=True)
    pairs = [complements(x >= 0, cp.exp(x) - y >= 0), complements(y >= 0, -x - 1 >= 0)]
    problem = cp.Problem(cp.Minimize(0), pairs)
    problem.solve(method="LCP")
    assert problem.status == "infeasible"
    assert problem.solver_stats.extra_stats.proof.verify()
    bounded = [pairs[0], complements(box(y, 0, 2), -x - 1)]  # −x − 1 < 0 at the upper bound
    solved(*bounded)
    assert float(y.value) == pytest.approx(2.0)


def test_the_constraint_is_copied_and_printed():
    """Its text is the call."""
    x = cp.Variable(2, name="x")
    inequality = variational(x - [1, 2], over=[x], constraints=[x >= 0])
    assert repr(inequality) == "variational(x + -[1. 2.], over=[x])"
    twin = pickle.loads(pickle.dumps(inequality))
    assert repr(twin) == repr(inequality)


X = cp.Variable(2)


@refusals(r"""
variational(M @ X) → variational\(F, over=\[x\]\)
variational(M[0] @ X, over=[X]) → got F of \(\) and over of \(2,\)
variational(M @ X, over=[X], G=[[1, 1]], h=[3]) → constraints=\[G @ x <= h
variational(M @ X, over=[X], constraints=3) → a list as \[G @ x <= h\]
variational(X, over=[X], constraints=[complements(X >= 0, X + 1 >= 0)]) → equilibrium
variational(X[:1], over=[cp.Variable(1, integer=True)]) → relax it
""")
def test_a_wrong_call_is_told_what_to_write(call, words):
    """An error with the right call."""
    assert_refused(call, words, globals())
