"""Programs stated in cvxpy: bounds that cvxpy infers are not used, statuses come with proofs."""

from __future__ import annotations

import warnings
from typing import Any

import cvxpy as cp
import numpy as np
import pytest

from lcp_plugin import QPSolver, optimal
from lcp_plugin.modeling._compat import CVXPY_STATUS

SolverError = cp.error.SolverError


def hinge_loss() -> Any:
    """The loss of a support vector machine, 0.017347 at its minimum; 2 where pos(…) is held at or above 1."""
    w, y, A = cp.Variable(2), np.array([1.0, -1.0]), np.array([[1.0, 2.0], [3.0, -1.0]])
    return cp.Problem(
        cp.Minimize(cp.sum(cp.pos(1 - cp.multiply(y, A @ w))) + 0.05 * cp.sum_squares(w))
    )


@pytest.mark.parametrize("first", [None, cp.CLARABEL, cp.SCS], ids=str)
def test_a_hinge_loss_has_its_minimum(first):
    """The hinge loss is 0.017347 from the first solve and after another solver's, where bounds are inferred or not."""
    problem = hinge_loss()
    if first is not None:
        problem.solve(solver=first)
    assert problem.solve(solver=QPSolver) == pytest.approx(0.0173469, abs=1e-6)
    assert problem.status == "optimal"


@pytest.mark.quick(2)
@pytest.mark.parametrize(
    "kind",
    [
        {"nonneg": True},
        {"nonpos": True},
        {"bounds": [-0.25, 0.5]},
        {"symmetric": True},
        {"sparsity": ([0, 1], [1, 0])},
        {},
    ],
    ids=str,
)
@pytest.mark.parametrize("turned", [cp.Minimize, cp.Maximize])
def test_attributes_of_one_s_own_variables_hold(kind, turned):
    """Minima and maxima over variables of every attribute are Clarabel's, with constants and parameters about."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # cvxpy's words about sparse values
        X, target = cp.Variable((2, 2), **kind), cp.Parameter((2, 2))
        loss = cp.sum_squares(X - target) + cp.norm1(X) + 3.0
        problem = cp.Problem(turned(loss if turned is cp.Minimize else -loss), [cp.sum(X) <= 0.75])
        for value in (np.array([[1.0, 2.0], [-1.0, 0.5]]), -np.ones((2, 2))):
            target.value = value
            expected = problem.solve(solver=cp.CLARABEL)
            assert problem.solve(solver=QPSolver) == pytest.approx(expected, abs=1e-6)
            assert problem.status == "optimal"


def losses() -> Any:
    x = cp.Variable(3)
    a = np.array([1.0, -2.0, 0.5])
    return cp.Problem(
        cp.Minimize(cp.norm1(x - a) + cp.sum_squares(x)), [cp.sum(x) == 1, x[0] <= 0.25, x[1] >= -1]
    )


def impossible() -> Any:
    x = cp.Variable(3)
    return cp.Problem(cp.Minimize(cp.sum_squares(x)), [cp.norm1(x) <= 1, x[0] + x[1] >= 1.5])


def endless() -> Any:
    x = cp.Variable(3)
    return cp.Problem(cp.Maximize(x[0] - cp.pos(x[1])), [cp.norm_inf(x[1:]) <= 1, x[0] >= 2 * x[1]])


PROBLEMS = {"optimal": losses, "infeasible": impossible, "unbounded": endless}


# --- What a person finds afterwards ----------------------------------------------------------------------------------


@pytest.mark.parametrize("how", [{"solver": QPSolver}, {"method": "LCP"}], ids=["solver", "method"])
@pytest.mark.parametrize("status", PROBLEMS)
def test_extra_stats_have_one_shape(status, how):
    """extra_stats is a Result with status and infeasibility, whatever became of the program."""
    problem = PROBLEMS[status]()
    problem.solve(**how)
    told = problem.solver_stats.extra_stats
    assert problem.status == status
    assert CVXPY_STATUS[told.status] == status
    assert (told.proof is None) == (status == "optimal")
    if status != "optimal":
        assert told.proof.verify()
        assert status in str(told.proof)
        assert status in told.explain()


def test_a_quadratic_objective_outside_of_cvxpys_rules_is_told_two_ways():
    """DCPError names optimal(…), which solves it, and QuadraticProgram; another objective has cvxpy's text alone."""
    x, L = cp.Variable(2), np.diag([2.0, 1.0])
    problem = cp.Problem(cp.Minimize(x.T @ L @ (x - 1)), [x >= 0])
    with pytest.raises(cp.DCPError, match=r"optimal\(problem, over=.*QuadraticProgram"):
        problem.solve(method="LCP")
    conditions = optimal(problem, over=problem.variables())
    cp.Problem(cp.Minimize(0), [conditions]).solve(method="LCP")
    np.testing.assert_allclose(x.value, [0.5, 0.5], atol=1e-9)
    with pytest.raises(cp.DCPError, match=r"(?s)^((?!QuadraticProgram).)*$"):
        cp.Problem(cp.Minimize(cp.sqrt(x[0])), [x >= 0]).solve(method="LCP")
