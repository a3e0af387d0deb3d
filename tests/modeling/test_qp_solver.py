"""Ordinary quadratic programs solved inside cvxpy through their complementarity problem."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import cvxpy as cp
import numpy as np
import pytest

from lcp_plugin import QPSolver, UnsupportedModel

RNG = np.random.default_rng(7)
IS_OLD = tuple(map(int, cp.__version__.split(".")[:2])) < (1, 9)
has_duals = pytest.mark.skipif(
    IS_OLD, reason="this release of cvxpy forgets the duals of infeasible problems"
)


def nnls() -> tuple[Any, list[Any]]:
    A, b = RNG.standard_normal((30, 8)), RNG.standard_normal(30)
    x = cp.Variable(8)
    constraints = [x >= 0]
    return cp.Problem(cp.Minimize(cp.sum_squares(A @ x - b) + 3), constraints), constraints


def isotonic() -> tuple[Any, list[Any]]:
    y = np.sort(RNG.standard_normal(25)) + 0.8 * RNG.standard_normal(25)
    x = cp.Variable(25)
    constraints = [cp.diff(x) >= 0]
    return cp.Problem(cp.Minimize(cp.sum_squares(x - y) + 3), constraints), constraints


def total_variation() -> tuple[Any, list[Any]]:
    """The dual of total-variation denoising: a quadratic program in a box."""
    y = np.repeat([0.0, 2.0, -1.0], 12) + 0.1 * RNG.standard_normal(36)
    D = np.diff(np.eye(36), axis=0)
    u = cp.Variable(35)
    constraints = [u <= 0.5, u >= -0.5]
    return cp.Problem(cp.Minimize(0.5 * cp.sum_squares(D.T @ u - y) + 3), constraints), constraints


def portfolio() -> tuple[Any, list[Any]]:
    F = RNG.standard_normal((12, 4))
    covariance = F @ F.T + 0.3 * np.eye(12)
    gain = RNG.uniform(0.0, 0.2, 12)
    x = cp.Variable(12)
    constraints = [cp.sum(x) == 1, x >= 0, gain @ x >= 0.1]
    return cp.Problem(cp.Minimize(cp.quad_form(x, covariance) + 3), constraints), constraints


def elastic_net() -> tuple[Any, list[Any]]:
    A = RNG.standard_normal((20, 9))
    b = RNG.standard_normal(20)
    x = cp.Variable(9)
    v = cp.Variable()
    costs = cp.sum_squares(cp.multiply(RNG.uniform(0.5, 2.0, 20), A @ x + v - b))
    constraints = [x[:4] >= -0.1, -x[2:] >= -0.2]
    return cp.Problem(cp.Minimize(costs + cp.norm1(x[3:]) + 3), constraints), constraints


MODELS: dict[str, Callable[[], tuple[Any, list[Any]]]] = {
    "nnls": nnls, "isotonic": isotonic, "total variation": total_variation,
    "portfolio": portfolio, "elastic net": elastic_net,
}  # fmt: skip


@pytest.mark.quick(3)
@pytest.mark.parametrize("how", ["solver", "called", "method"])
@pytest.mark.parametrize("name", MODELS)
def test_quadratic_programs_agree_with_cvxpy(name, how):
    """Value, x and duals equal those of an accurate cvxpy solver to 1e-6, by solver= and by method=."""
    problem, constraints = MODELS[name]()
    problem.solve(solver=cp.OSQP, eps_abs=1e-10, eps_rel=1e-10, max_iter=200000)
    expected = (
        problem.value,
        problem.variables()[0].value.copy(),
        [c.dual_value for c in constraints],
    )
    if how == "method":
        problem.solve(method="LCP", tolerance=1e-12)
    else:
        problem.solve(solver=QPSolver() if how == "called" else QPSolver, tolerance=1e-12)
    assert problem.status == "optimal"
    assert problem.value == pytest.approx(expected[0], abs=1e-6)
    assert problem.solution.opt_val == pytest.approx(expected[0], abs=1e-6)
    np.testing.assert_allclose(problem.variables()[0].value, expected[1], atol=1e-6)
    for constraint, dual in zip(constraints, expected[2], strict=True):
        np.testing.assert_allclose(constraint.dual_value, dual, atol=2e-6)
    assert problem.solver_stats.solver_name == "LCP"
    # 0 where the minimum on the equations meets the rest
    assert problem.solver_stats.num_iters >= 0


def parametric(where: str, seed: int) -> tuple[Any, Any]:
    """Return a problem with one parameter in a vector or in a matrix of its program, and that parameter."""
    rng = np.random.default_rng(seed)
    A, G, x = rng.normal(size=(3, 6)), rng.normal(size=(4, 6)), cp.Variable(6)
    p = cp.Parameter({"c": 6, "b": 3, "h": 4, "bound": 6}.get(where, (4, 6)))
    loss = cp.sum_squares(rng.normal(size=(9, 6)) @ x - 1.0) + (p @ x if where == "c" else 0.0)
    rows = p if where == "G" else G
    constraints = [
        rows @ x <= (p if where == "h" else np.ones(4)),
        A @ x == (p if where == "b" else np.full(3, 0.1)),
        x >= (p if where == "bound" else -2.0),
    ]
    return cp.Problem(cp.Minimize(loss), constraints), p


@pytest.mark.parametrize("where", ["c", "b", "h", "bound", "G"])
def test_a_parameter_changes_numbers_only(where):
    """Solved again with other parameters, a problem has the status, values and duals of a fresh one, there and back."""
    problem, p = parametric(where, 4)
    rng = np.random.default_rng(5)
    values = [
        rng.normal(size=p.shape) * 0.1,
        rng.normal(size=p.shape) * 0.1 - 0.1,
        np.full(p.shape, 9.0),
    ]
    for value in (*values, values[0]):
        fresh, own = parametric(where, 4)
        p.value = own.value = value
        problem.solve(solver=QPSolver)
        fresh.solve(solver=QPSolver)
        assert problem.status == fresh.status
        if fresh.status == "optimal":
            assert problem.value == pytest.approx(fresh.value, rel=1e-8, abs=1e-9)
            for ours, theirs in zip(problem.constraints, fresh.constraints, strict=True):
                np.testing.assert_allclose(ours.dual_value, theirs.dual_value, atol=1e-6)


def test_a_limit_is_never_called_optimal():
    """A run that ended at a limit is user_limit, however small its residuals beside a huge coefficient."""
    rng, x = np.random.default_rng(0), cp.Variable(30)
    goal = cp.sum_squares(x - rng.standard_normal(30)) + 1e7 * x[0]
    problem = cp.Problem(cp.Minimize(goal), [rng.standard_normal((60, 30)) @ x <= 0.1, x >= -1])
    with pytest.warns(UserWarning, match="inaccurate"):
        problem.solve(solver=QPSolver, algorithm="interior_point", max_iterations=1)
    assert problem.status == "user_limit"


def without_minimum(kind: str, n: int) -> Any:
    rng = np.random.default_rng(3)
    x = cp.Variable(n)
    if kind == "infeasible":
        A = np.abs(rng.standard_normal((2 * n // 3, n)))
        return cp.Problem(cp.Minimize(cp.sum_squares(x)), [A @ x <= -1, x >= 0])
    C = rng.standard_normal((n // 2, n))
    return cp.Problem(
        cp.Minimize(0.5 * cp.quad_form(x, cp.psd_wrap(C.T @ C)) + rng.standard_normal(n) @ x)
    )


@pytest.mark.parametrize("kind", ["infeasible", "unbounded"])
def test_the_first_failure_ends_in_a_proof(kind):
    """A program without minimum gets its status with a proof before other methods are tried; the callback is called."""
    labels = set()
    problem = without_minimum(kind, 90)
    problem.solve(solver=QPSolver, callback=lambda sample, z: labels.add(sample.label))
    assert problem.status == kind
    assert problem.solver_stats.extra_stats.proof.verify()
    assert not labels & {"newton", "lemke", "search"}


@has_duals
@pytest.mark.parametrize("sense", [cp.Minimize, cp.Maximize])
def test_duals_of_an_infeasible_problem_prove_it_and_name_its_constraints(sense):
    """Σ y_i (lhs_i − rhs_i) ≤ 0 of all that holds is a positive constant, as other solvers' multipliers say."""
    x, y = cp.Variable(3, name="x"), cp.Variable(name="y", nonneg=True)
    constraints = [x[0] >= 1, cp.sum(x) <= 0, x >= 0, y <= 3, x[1] + y == 2]
    problem = cp.Problem(sense(cp.sum(x) - 2 * x[1]), constraints)
    problem.solve(solver=QPSolver)
    assert problem.status == "infeasible"
    combined = sum(cp.sum(cp.multiply(one.dual_value, one.expr)) for one in constraints)
    found = [
        combined.value
        for x.value, y.value in ((np.zeros(3), 0.0), (np.array([3.0, -1.0, 2.0]), 5.0))
    ]
    assert found == pytest.approx([1.0, 1.0])
    problem.solve(method="LCP")
    words = str(problem.solver_stats.extra_stats)
    assert all(
        part in words for part in ("1.0 <= x[0]", "0.0 <= x, entry 1", "are inconsistent", "0.25")
    )
    assert "y <= 3" not in words


@has_duals
def test_a_constraint_that_cannot_hold_is_named():
    """The proof of |x| ≤ −1 names it, and the rows that cvxpy adds by their numbers."""
    x = cp.Variable(name="x")
    problem = cp.Problem(cp.Minimize(x), [cp.abs(x) <= -1, x >= -5])
    problem.solve(method="LCP")
    assert "inconsistent, abs(x) <= -1.0" in problem.solver_stats.extra_stats.explain()


def refused() -> dict[str, Any]:
    x, k, z = cp.Variable(2), cp.Variable(2, integer=True), cp.Variable(2, complex=True)
    S, curve = cp.Variable((2, 2), PSD=True), cp.quad_form(x, cp.psd_wrap(-np.eye(2)))
    programs = {
        r"<= 1.0 is not piecewise linear.*CLARABEL": (cp.sum(x), cp.norm(x) <= 1),
        r"objective Pnorm\(.* is not quadratic or piecewise linear.*CLARABEL": (cp.norm(x), x == 1),
        r"is a SOC\. Choose": (x[0], cp.SOC(x[0], x)),
        r"is integer\. .*HIGHS": (cp.sum_squares(k - 0.4), x == 1),
        r"is PSD\. Choose": (cp.trace(S), S[0, 1] == 1),
        r"is complex; take .*CLARABEL": (cp.sum(cp.abs(z)), z == 1),
        r"is not convex: the smallest eigenvalue of P is -2": (curve, x <= 1),
    }
    return {words: cp.Problem(cp.Minimize(goal), [row]) for words, (goal, row) in programs.items()}


@pytest.mark.parametrize("words", refused())
def test_what_is_refused_is_a_solver_error_and_names_a_way_out(words):
    """By method="LCP" with the reason and of both classes; by solver=QPSolver cones and integers in cvxpy's words."""
    for kind in (cp.SolverError, UnsupportedModel):
        with pytest.raises(kind, match=words):
            refused()[words].solve(method="LCP")
    with pytest.raises(cp.SolverError):
        refused()[words].solve(solver=QPSolver)
