"""Paths of problems stated in cvxpy."""

import cvxpy as cp
import numpy as np
import pytest
from tools.refusals import assert_refused, refusals

from lcp_plugin import QPSolver, Status, complements, trace


def test_lasso_in_cvxpy_follows_its_penalty():
    """A penalty that is a Parameter: values at θ are those of a solve there."""
    rng = np.random.default_rng(0)
    A, b = rng.standard_normal((20, 6)), rng.standard_normal(20)
    x, penalty = cp.Variable(6), cp.Parameter(nonneg=True)
    problem = cp.Problem(cp.Minimize(0.5 * cp.sum_squares(A @ x - b) + penalty * cp.norm1(x)))
    path = trace(problem, penalty, 8.0, 0.1).require_solved()
    for theta in (6.0, 2.0, 0.3):
        penalty.value = theta
        problem.solve(solver=QPSolver)
        assert np.abs(path.value(x, theta) - x.value).max() <= 1e-6
    assert penalty.value == 0.3
    assert path.value(x, [1.0, 2.0]).shape == (2, 6)


def test_frontier_in_cvxpy_has_no_end():
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


def test_pairs_follow_a_load():
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


def test_infeasible_from_a_value_on():
    """A budget that is too small from somewhere on."""
    x, need = cp.Variable(2, nonneg=True), cp.Parameter()
    path = trace(
        cp.Problem(cp.Minimize(cp.sum_squares(x)), [cp.sum(x) >= need, x <= 1]), need, 0, 5
    )
    assert path.status is Status.INFEASIBLE
    assert path.reached == pytest.approx(2.0, abs=1e-9)


@refusals(r"""
trace(least(p * cp.sum_squares(x) + cp.sum(x)), p, 1, 2) → UnsupportedModel: divide the objective by it
trace(least(cp.sum_squares(x), p * x[0] + x[1] >= 1), p, 1, 2) → UnsupportedModel: enters the matrix
trace(complements(x[0] >= 0, x[0] >= p), p, 1, 2) → UnsupportedModel: a cvxpy problem is needed, got Complements
trace(plain, p, 1, 2) → InvalidOption: not a parameter of the problem
trace(plain, v, 1, 2) → InvalidOption: has 2 entries
trace(plain, {v: [1, 1]}, 1, 2) → InvalidOption: has no value
trace(plain, "v", 1, 2) → InvalidOption: is a Parameter
trace(least(cp.sum_squares(x), x >= p), p, 1, 2).value(cp.Variable(), 1.5)
    → UnsupportedModel: is not a variable
trace(least(cp.sum_squares(x), cp.sum(x) >= cp.square(p)), p, 0.0, 1.0)
    → UnsupportedModel: make the nonlinear expression a parameter
trace(least(cp.sum_squares(x), cp.sum(x) >= p), p, -1.0, 1.0)
    → InvalidOption: does not accept its value at θ = -1
""")
def test_what_is_not_affine_is_refused_in_words(call, words):
    """A parameter in a matrix, one that bends, one of another problem, one of several entries, one below its bound."""

    def least(cost, *rows):
        return cp.Problem(cp.Minimize(cost), list(rows))

    x, p, v = cp.Variable(2), cp.Parameter(nonneg=True, value=1.0), cp.Parameter(2)
    plain = least(cp.sum_squares(x), x >= v)
    assert_refused(call, words, {"cp": cp, "x": x, "p": p, "v": v, "least": least, "plain": plain})
