"""Programs as people write them: fits by normal equations, bodies at rest, parts without costs, large budgets."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import cvxpy as cp
import numpy as np
import pytest
import scipy.sparse as sp
from inputs.everyday import standing
from numpy.random import Generator
from oracles.exact import solve_fractions
from oracles.exact_program import ExactProgram, exact

from lcp_plugin import QPSolver, QuadraticProgram, Status, certify, solve
from lcp_plugin.judges.program import KKTErrors
from lcp_plugin.problems.programs import engine_points

YEARS = np.arange(1990.0, 2020.0)


# --- Fits by normal equations, judged by fractions ------------------------------------------------------------------


def regressors(kind: str, rng: Generator) -> Any:
    """Return the columns of a fit of 30 values, and the rows of a constraint that the fit meets."""
    if kind.startswith("trend"):
        X = np.vander(YEARS, 3, increasing=True)
        return X, X[10:11] if kind.endswith("value") else None
    if kind.startswith("polynomial"):
        X = np.vander(np.linspace(0.0, 1.0, 30), 9)
        return X, X[[0, -1]] if kind.endswith("values") else None
    X = np.column_stack([np.ones(30), 1e3 * rng.random(30), 1e6 * rng.random(30)])
    return X, np.ones((1, 3)) if kind.endswith("sum") else None


def excess(program: QuadraticProgram, x: Any) -> float:
    """Return by how much the objective at x exceeds the minimum over the equations, relative to its terms."""
    one, point = ExactProgram.of(program), exact(x)
    K = [row + [equation[j] for equation in one.A] for j, row in enumerate(one.P)]
    K += [row + [Fraction(0)] * len(one.A) for row in one.A]
    best = solve_fractions(K, [-value for value in one.c] + one.b)[: program.n]
    curved, linear = one.terms(point)
    return float((one.value(point) - one.value(best)) / (abs(curved) + abs(sum(linear))))


KINDS = (
    "trend",
    "trend through a value",
    "polynomial",
    "polynomial through two values",
    "units",
    "units of a sum",
)


@pytest.mark.parametrize("kind", KINDS)
def test_a_fit_by_normal_equations_is_solved_and_proved(kind, draws):
    """Where P is curved, ½ rᵀP⁻¹r bounds the gain: K |x_j| times a gradient of rounding refused 217 of 360."""
    rng = np.random.default_rng(len(kind))
    for _ in draws(60, 12):
        X, A = regressors(kind, rng)
        y = rng.random(30)
        b = None if A is None else np.full(len(A), 0.5)
        program = QuadraticProgram(X.T @ X, -X.T @ y, A=A, b=b)
        result = solve(program)
        assert result.status is Status.SOLVED
        assert abs(excess(program, result.x)) <= 1e-6
        assert certify(result).verdict == "proved"


def test_a_fit_of_degree_11_is_right_or_not_solved(draws):
    """Without the shift for the rounding of its factor, 16 of 20 passed, some with an excess of 2.7e-6."""
    rng, X = np.random.default_rng(11), np.vander(np.linspace(0.0, 1.0, 30), 12)
    for _ in draws(20, 5):
        program = QuadraticProgram(X.T @ X, -X.T @ rng.random(30))
        result = solve(program)
        assert not result.is_solved or abs(excess(program, result.x)) <= 1e-6


def test_curvature_covers_no_unknown_at_a_bound_and_no_cost_without_curvature():
    """A gradient of 1e-4 that the curvature bounds passes, next to a cost or a bound where moves gain more it fails."""
    P, wide = np.diag([1e6, 0.0, 1e6]), [0.0, 0.0, 0.0]
    program = QuadraticProgram(P, [-1e6, 1e-4, -1e6], lower=wide, upper=1e6)
    point = solve(program).solution
    for x, passes in (([1 + 1e-10, 0, 1], True), ([1, 1e3, 1], False), ([1, 0, 0], False)):
        errors = KKTErrors.of(program.judged, np.array(x, float), np.zeros(0), 1e-9)
        assert errors.meet(1e-9) is passes
    np.testing.assert_allclose(point.x, [1, 0, 1])


def test_a_cost_next_to_a_flat_curvature_is_solved():
    """Where c_j = 0 and r_j is a rounding error, terms of P x that cancel price a move: 26 of 60 were refused."""
    for k in range(0, 60, 4):
        rng = np.random.default_rng((5, k))
        n = int(rng.integers(2, 30))
        rank = int(rng.integers(1, n))
        B, c = rng.normal(size=(rank, n)), np.zeros(n)
        A = rng.normal(size=(int(rng.integers(0, n - rank + 1)), n))
        c[0], lower, upper = rng.normal(), np.where(rng.random(n) < 0.4, -1.0, -np.inf), np.ones(n)
        lower[0], upper[1:] = -1.0, np.inf
        b = rng.normal(size=len(A))
        assert solve(QuadraticProgram(B.T @ B, c, A=A, b=b, lower=lower, upper=upper)).is_solved


# --- An optimum of 0 --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("states", [4, 8, 12])
@pytest.mark.parametrize("feet", [1, 2, 4])
def test_a_body_at_rest_is_solved(feet, states, pytestconfig):
    """Control programs of 2 to 24 steps whose optimum is 0, and whose forces have no costs, are solved."""
    for steps in (2, 4, 8, 12, 16, 24) if pytestconfig.getoption("--full") else (4, 8):
        seed = 100 * steps + 10 * feet + states
        P, c, G, h, A, b = standing(steps, feet, states, np.random.default_rng(seed))
        result = solve(QuadraticProgram(P, c, G, h, A, b))
        x = result.x
        assert result.status is Status.SOLVED
        assert result.objective <= 1e-12
        assert (np.abs(A @ x - b) <= 1e-9 * (np.abs(A) @ np.abs(x) + np.abs(b))).all()
        assert (G @ x <= 1e-9 * (np.abs(G) @ np.abs(x))).all()
        assert steps > 4 or certify(result).verdict != "disproved"


@pytest.mark.parametrize("rows", [300, 3000])
def test_a_program_whose_only_point_is_0_is_solved(rows):
    """An interior point ends at noise of one size in all unknowns: the point of the bounds nearest to 0 is tried."""
    for seed in range(3):
        rng = np.random.default_rng(seed)
        program = QuadraticProgram(
            np.eye(10), rng.normal(size=10), rng.normal(size=(rows, 10)), np.zeros(rows)
        )
        result = solve(program)
        assert result.status is Status.SOLVED
        assert not result.x.any()


@pytest.mark.parametrize("sizes", [(100, 200), (20, 40)])
def test_a_component_without_costs_is_solved(sizes):
    """Least squares stand next to y ≥ 0 with sum 1: multipliers of 1e-17 had no size next to which they were small."""
    n, k = sizes
    a = np.random.default_rng(n).normal(size=n)
    P = sp.diags_array(np.append(np.full(n, 2.0), np.zeros(k)))
    A = sp.csr_array(np.append(np.zeros(n), np.ones(k))[np.newaxis])
    lower = np.append(np.full(n, -np.inf), np.zeros(k))
    result = solve(QuadraticProgram(P, np.append(-2.0 * a, np.zeros(k)), A=A, b=[1], lower=lower))
    assert result.status is Status.SOLVED
    np.testing.assert_allclose(result.x[:n], a, rtol=1e-6, atol=1e-9)
    assert len(result.stages) == 1


# --- Large right-hand sides, and many unknowns -----------------------------------------------------------------------


@pytest.mark.parametrize("side", [1.0, 1e9, 1e12, 1e15])
def test_an_unbounded_program_is_unbounded_next_to_a_budget(side):
    """The objective −x₁ falls along (1, 1), which x₁ − x₂ = b allows for every b; −x₁ ≥ 0 contradicts x₁ ≥ b."""
    program = QuadraticProgram(None, [-1.0, 0.0], A=[[1.0, -1.0]], b=[side], lower=0)
    result = solve(program)
    assert result.status is Status.UNBOUNDED
    assert result.proof.verify()
    assert solve(QuadraticProgram(None, [-1.0, 0.0], [[-1.0, 1.0]], [-side], lower=0)).proof
    bounded = QuadraticProgram(None, [-1.0, 0], A=[[1.0, -1]], b=[side], lower=0, upper=[0.5, 9])
    assert solve(bounded).status is Status.INFEASIBLE


def test_a_sparse_regression_of_hundreds_of_rows_is_sparse():
    """The minimum on the face of the first point passes: a general solver took 20 times as long."""
    rng = np.random.default_rng(1)
    A, w = rng.normal(size=(400, 600)), np.zeros(600)
    w[:5] = 3.0 * rng.normal(size=5)
    b = A @ w + 0.1 * rng.normal(size=400)
    x = cp.Variable(600)
    penalty = 0.3 * np.abs(A.T @ b).max()
    problem = cp.Problem(cp.Minimize(0.5 * cp.sum_squares(A @ x - b) + penalty * cp.norm1(x)))
    problem.solve(solver=QPSolver())
    assert problem.status == cp.OPTIMAL
    assert len(problem.solver_stats.extra_stats.stages) == 1
    assert np.count_nonzero(x.value) <= 10
    gradient = A.T @ (A @ x.value - b)
    assert (np.abs(gradient) <= penalty * (1.0 + 1e-6)).all()


def test_a_transport_has_no_noise_in_place_of_zeros():
    """The cleaned point is measured first: two thirds of the nonzeros of x were noise of 1e-15."""
    rng = np.random.default_rng(0)
    rows = np.vstack([np.kron(np.eye(12), np.ones(15)), np.kron(np.ones(12), np.eye(15))])
    sides = np.concatenate([np.full(12, 15.0), np.full(15, 12.0)])
    result = solve(QuadraticProgram(None, rng.random(180), A=rows, b=sides, lower=0))
    assert result.is_solved
    assert (result.x[result.x != 0.0] >= 1e-9).all()


def test_a_point_that_passes_is_not_polished(monkeypatch):
    """The first point of daqp has one to four times the gap of plain sums: two factorizations more changed nothing."""

    def polish(*data):
        raise AssertionError("a point that passes is polished")
        yield data

    monkeypatch.setattr(engine_points, "polish_steps", polish)
    rng = np.random.default_rng(0)
    B, G = rng.normal(size=(60, 60)), rng.normal(size=(30, 60))
    program = QuadraticProgram(B @ B.T / 60, rng.normal(size=60), G, rng.random(30))
    assert solve(program, verbose=False).is_solved
