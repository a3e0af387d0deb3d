"""Paths of problems stated in cvxpy."""

from __future__ import annotations

import cvxpy as cp
import numpy as np
import pytest

from lcp_plugin import InvalidOption, QPSolver, Status, UnsupportedModel, complements, trace


def test_lasso_in_cvxpy_follows_its_penalty() -> None:
    """A penalty that is a Parameter: values and objective at θ are those of a solve there."""
    rng = np.random.default_rng(0)
    A, b = rng.standard_normal((20, 6)), rng.standard_normal(20)
    x, penalty = cp.Variable(6), cp.Parameter(nonneg=True)
    problem = cp.Problem(cp.Minimize(0.5 * cp.sum_squares(A @ x - b) + penalty * cp.norm1(x)))
    path = trace(problem, penalty, 8.0, 0.1).require_solved()
    for theta in (6.0, 2.0, 0.3):
        penalty.value = theta
        problem.solve(solver=QPSolver)
        assert np.abs(path.value(x, theta) - x.value).max() <= 1e-6
        assert path.objective(theta)[0] == pytest.approx(problem.value, rel=1e-8)
    assert penalty.value == 0.3
    assert path.value(x, [1.0, 2.0]).shape == (2, 6)


def test_frontier_in_cvxpy_has_no_end() -> None:
    """Risk tolerance times return: from the least risk to the largest return, maximized."""
    rng = np.random.default_rng(1)
    root, mean = rng.standard_normal((5, 5)), rng.random(5)
    x, tolerance = cp.Variable(5, nonneg=True), cp.Parameter()
    problem = cp.Problem(
        cp.Maximize(tolerance * (mean @ x) - cp.sum_squares(root @ x)), [cp.sum(x) == 1]
    )
    path = trace(problem, tolerance, 0, 100).require_solved()
    tolerance.value = 3.0
    problem.solve(solver=QPSolver)
    assert np.abs(path.value(x, 3.0) - x.value).max() <= 1e-6
    assert path.objective(3.0)[0] == pytest.approx(problem.value, rel=1e-7)


def test_pairs_follow_a_load() -> None:
    """A model of complementarities, with a definition that is put in, along a vector parameter."""
    x, y, load = cp.Variable(2), cp.Variable(), cp.Parameter(2, value=[-5.0, 1.0])
    M = np.array([[2.0, 1.0], [1.0, 2.0]])
    problem = cp.Problem(
        cp.Minimize(0), [complements(x >= 0, M @ x + load >= 0), y == x[0] + 3 * load[1]]
    )
    path = trace(problem, {load: [0.0, -1.0]}, 0, 6).require_solved()
    assert path.breakpoints == pytest.approx([0.0, 3.5, 6.0])
    assert path.value(x, 4.5) == pytest.approx([13 / 6, 2 / 3])
    assert float(path.value(y, 4.5)) == pytest.approx(13 / 6 + 3 * (1 - 4.5))
    assert load.value.tolist() == [-5.0, 1.0]


def test_infeasible_from_a_value_on() -> None:
    """A budget that is too small from somewhere on."""
    x, need = cp.Variable(2, nonneg=True), cp.Parameter()
    path = trace(
        cp.Problem(cp.Minimize(cp.sum_squares(x)), [cp.sum(x) >= need, x <= 1]), need, 0, 5
    )
    assert path.status is Status.INFEASIBLE
    assert path.reached == pytest.approx(2.0, abs=1e-9)


def test_what_is_not_affine_is_refused_in_words() -> None:
    """A parameter in a matrix, one that bends, one of another problem, one of several entries."""
    x, p, v = cp.Variable(2), cp.Parameter(nonneg=True, value=1.0), cp.Parameter(2)
    quadratic = cp.Problem(cp.Minimize(p * cp.sum_squares(x) + cp.sum(x)))
    with pytest.raises(UnsupportedModel, match="divide the objective by it"):
        trace(quadratic, p, 1, 2)
    with pytest.raises(UnsupportedModel, match="enters the matrix"):
        trace(cp.Problem(cp.Minimize(cp.sum_squares(x)), [p * x[0] + x[1] >= 1]), p, 1, 2)
    plain = cp.Problem(cp.Minimize(cp.sum_squares(x)), [x >= v])
    with pytest.raises(InvalidOption, match="not a parameter of the problem"):
        trace(plain, p, 1, 2)
    with pytest.raises(InvalidOption, match="has 2 entries"):
        trace(plain, v, 1, 2)
    with pytest.raises(InvalidOption, match="has no value"):
        trace(plain, {v: [1, 1]}, 1, 2)
    with pytest.raises(InvalidOption, match="is a Parameter"):
        trace(plain, "v", 1, 2)
    with pytest.raises(UnsupportedModel, match="not a variable of the problem"):
        trace(cp.Problem(cp.Minimize(cp.sum_squares(x)), [x >= p]), p, 1, 2).value(
            cp.Variable(), 1.5
        )


def test_parameters_that_bend_or_may_not_move_are_named() -> None:
    """A parameter within a square, and a nonnegative one below zero, are refused in words."""
    y, h, positive = cp.Variable(2), cp.Parameter(value=1.0), cp.Parameter(nonneg=True)
    with pytest.raises(UnsupportedModel, match="make the nonlinear expression a parameter"):
        trace(cp.Problem(cp.Minimize(cp.sum_squares(y)), [cp.sum(y) >= cp.square(h)]), h, 0.0, 1.0)
    with pytest.raises(InvalidOption, match="does not accept its value at θ = -1"):
        trace(
            cp.Problem(cp.Minimize(cp.sum_squares(y)), [cp.sum(y) >= positive]), positive, -1.0, 1.0
        )
