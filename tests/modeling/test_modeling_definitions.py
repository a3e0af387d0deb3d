"""Free variables that an equation defines disappear from the model, and come back with their values."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import cvxpy as cp
import numpy as np
import pyomo.environ as pe
import pytest
import scipy.sparse as sp
from pyomo.mpec import Complementarity
from pyomo.mpec import complements as pyomo_complements

import lcp_plugin.pyomo  # noqa: F401 - registers the solver
from lcp_plugin import complements
from lcp_plugin.modeling.registration import model_of_constraints

N = 6


def planted(seed: int = 0, n: int = N) -> tuple[Any, Any, Any, Any]:
    """M, q, x, w with x ≥ 0, w = M x + q ≥ 0 complementary; M strictly diagonally dominant, not symmetric."""
    rng = np.random.default_rng(seed)
    M = rng.normal(size=(n, n)) + 4 * n * np.eye(n)
    x = np.where(np.arange(n) % 3 == 0, rng.uniform(1, 2, n), 0.0)
    w = np.where(np.arange(n) % 3 == 1, rng.uniform(1, 2, n), 0.0)
    return M, w - M @ x, x, w


def solved(constraints: list[Any], **options: Any) -> Any:
    problem = cp.Problem(cp.Minimize(0), constraints)
    problem.solve(method="LCP", tolerance=1e-12, **options)
    assert problem.status == "optimal"
    return problem


@pytest.mark.parametrize("order", [0, 1])
@pytest.mark.parametrize("side", ["w == F", "-3 w == -3 F", "first"])
def test_a_defined_slack_leaves_the_problem_of_x_alone(side, order):
    """A slack w == M x + q beside x ≥ 0 ⟂ w ≥ 0 is the problem (M, q), in either order of the sides."""
    M, q, x_true, w_true = planted()
    x, w = cp.Variable(N, name="x"), cp.Variable(N, name="w")
    F = M @ x + q
    equation = {"w == F": w == F, "-3 w == -3 F": -3 * w == -3 * F, "first": w == F}[side]
    pair = complements(x >= 0, w >= 0) if order == 0 else complements(w >= 0, x >= 0)
    constraints = [equation, pair] if side == "first" else [pair, equation]
    model = model_of_constraints(constraints)
    np.testing.assert_allclose(model.problem.csr.toarray(), M, rtol=1e-15)
    np.testing.assert_allclose(model.problem.q, q, rtol=1e-15)
    solved(constraints)
    np.testing.assert_allclose(x.value, x_true, atol=1e-9)
    np.testing.assert_allclose(w.value, w_true, atol=1e-8)
    np.testing.assert_allclose(pair.dual_value, w_true, atol=1e-8)
    np.testing.assert_allclose(np.abs(equation.dual_value), w_true, atol=1e-8)


def test_chains_in_any_order():
    """Three definitions u == M x, v == 2 u + 1, w == v + q − 1: all three go, whichever order they are stated in."""
    M, q, x_true, w_true = planted(1)
    x, u, v, w = (cp.Variable(N, name=name) for name in "xuvw")
    equations = [w == v + q - 1, v == 2 * u + 1, M @ x == 2 * u]
    for order in ([0, 1, 2], [2, 1, 0], [1, 0, 2]):
        constraints = [*(equations[k] for k in order), complements(x >= 0, w >= 0)]
        model = model_of_constraints(constraints)
        assert model.problem.n == N
        solved(constraints)
        np.testing.assert_allclose(x.value, x_true, atol=1e-9)
        np.testing.assert_allclose(w.value, w_true, atol=1e-8)
        np.testing.assert_allclose(2 * u.value, M @ x_true, atol=1e-8)
        np.testing.assert_allclose(v.value, M @ x_true + 1, atol=1e-8)


def test_a_definition_that_would_fill_the_matrix_stays():
    """A mean that every row uses stays an unknown of its own: the matrix keeps its few entries."""
    n = 400
    x, mean = cp.Variable(n), cp.Variable()
    D = sp.diags_array([np.full(n, 3.0), -np.ones(n - 1)], offsets=[0, 1], format="csr")
    constraints = [complements(x >= 0, D @ x + mean - 1 >= 0), mean == cp.sum(x) / n]
    model = model_of_constraints(constraints)
    assert model.problem.nonzeros < 10 * n
    solved(constraints)
    assert float(mean.value) == pytest.approx(float(np.mean(x.value)), abs=1e-8)


@pytest.mark.quick(1)
@pytest.mark.parametrize("door", ["cvxpy", "pyomo"])
def test_a_proof_is_about_the_numbers_of_the_model(door):
    """With t = a x, b t − fl(a b) x ≥ 1 has the solution x = 1/(a b − fl(a b)): no proof may cover such a large x."""
    rng, count = np.random.default_rng(1), 0
    while count < 5:
        a, b = map(float, rng.uniform(1, 2, 2))
        if (left := Fraction(a) * Fraction(b) - Fraction(a * b)) <= 0:
            continue
        count += 1
        proof = _proof_by(door, a, b, a * b)
        assert proof.verify()
        assert Fraction(proof.radius) < 1 / left
    exact = _proof_by(door, 2.0, 3.0, 6.0)
    assert (exact.verify(), exact.radius) == (True, np.inf)


def _proof_by(door: str, a: float, b: float, product: float) -> Any:
    """Return the proof that t = a x and 0 ≤ x ⟂ b t − product · x − 1 ≥ 0 have no solution."""
    if door == "cvxpy":
        x, t = cp.Variable(nonneg=True), cp.Variable()
        rows = [t == a * x, complements(x >= 0, b * t - product * x - 1 >= 0)]
        problem = cp.Problem(cp.Minimize(0), rows)
        problem.solve(method="LCP")
        return problem.solver_stats.extra_stats.proof
    m = pe.ConcreteModel()
    m.x, m.t = pe.Var(bounds=(0, None)), pe.Var()
    m.defined = pe.Constraint(expr=m.t == a * m.x)
    m.pair = Complementarity(expr=pyomo_complements(m.x >= 0, b * m.t - product * m.x - 1 >= 0))
    solver = pe.SolverFactory("lcp_plugin")
    solver.solve(m, load_solutions=False)
    return solver.result.proof
