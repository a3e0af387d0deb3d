"""Least squares with an l1 penalty: planted answers, exact optimality conditions, ways in and out."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import cvxpy as cp
import numpy as np
import pytest
import scipy.sparse as sp
from campaigns.least_squares import Case, Exact, bounded_least_squares
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import linprog

from lcp_plugin import (
    BoundedLeastSquares,
    InvalidProblem,
    QuadraticProgram,
    Status,
    load_problem,
    solve,
)
from lcp_plugin.problems.programs.regression import regression_of

INF = np.inf


def planted(
    m: int, n: int, seed: int, ridge: float = 0.0, spread: int = 4
) -> tuple[np.ndarray, np.ndarray, dict[str, Any], np.ndarray]:
    """Whole numbers A, b, penalties, weights and bounds, and an answer x, chosen first with its residual y.

    Each column is free, at 0 with slack or without, at 0 because of a bound, or at a bound beside 0; its
    penalty is what the slope s = AᵀWy + ridge x then needs.
    """
    rng = np.random.default_rng(seed)
    A = rng.integers(-spread, spread + 1, (m, n)).astype(float)
    y = rng.integers(-spread, spread + 1, m).astype(float)
    weights = rng.integers(1, 4, m).astype(float)
    place = rng.choice(["free", "held", "degenerate", "one side", "upper", "lower"], n)
    x = np.where(
        np.isin(place, ["free", "upper", "lower"]), rng.integers(1, 5, n).astype(float), 0.0
    )
    slope = A.T @ (weights * y)
    # every column wants to rise; turned below where x < 0
    A, slope = (np.where(slope > 0.0, -A, A), -np.abs(slope))
    l1 = np.abs(slope + ridge * x)
    # too large for its slope
    small = np.isin(place, ["free", "upper", "lower"]) & (slope + ridge * x > 0.0)
    x[small], place[small] = 0.0, "held"
    l1 = np.where(place == "held", np.abs(slope) + rng.integers(1, 3, n), np.abs(slope + ridge * x))
    at_bound = np.isin(place, ["upper", "lower"])
    l1[at_bound] = np.floor(0.5 * l1[at_bound])
    upper = np.where(place == "upper", x, INF)
    lower = np.where(place == "one side", 0.0, -INF)
    turned = place == "lower"  # −x is at its lower bound
    A, x = np.where(turned, -A, A), np.where(turned, -x, x)
    lower[turned] = x[turned]
    return A, A @ x - y, dict(lower=lower, upper=upper, weights=weights, ridge=ridge, l1=l1), x


def exact_cost(A: Any, b: Any, x: Any, **rest: Any) -> Fraction:
    """Return the cost in fractions: the squares by campaigns.least_squares, and the penalty."""
    squares = (np.asarray(rest.get("weights", np.ones(len(b)))), float(rest.get("ridge", 0.0)))
    x = [Fraction(float(value)) for value in x]
    penalty = sum((Fraction(float(one)) * abs(v) for one, v in zip(rest["l1"], x, strict=True)))
    return Exact(Case("", np.asarray(A), b, x, x, *squares)).cost(x) + penalty


@given(st.integers(2, 9), st.integers(1, 9), st.integers(0, 10**6), st.sampled_from([0.0, 1.0]))
def test_planted_lassos_are_solved_exactly(m, n, seed, ridge):
    """Penalties per unknown, bounds, weights, a ridge: SOLVED, optimal in rational arithmetic, the planted cost."""
    A, b, rest, x = planted(m, n, seed, ridge)
    result = bounded_least_squares(A, b, **rest).require_solved()
    assert (rest["lower"] <= result.x).all()
    assert (result.x <= rest["upper"]).all()
    best = float(exact_cost(A, b, x, **rest))
    assert abs(float(exact_cost(A, b, result.x, **rest)) - best) <= 1e-8 * best
    assert abs(result.cost - best) <= 1e-8 * best


@pytest.mark.quick(1)
@pytest.mark.parametrize("form", [np.asarray, sp.csr_array])
@pytest.mark.parametrize("bounds", [{}, {"upper": 0.2}, {"lower": 0.0}])
def test_large_lassos_are_solved_without_doubling(form, bounds):
    """Dense, sparse, 400 columns: what the optimality conditions ask for; columns at 0 are exactly so."""
    rng = np.random.default_rng(5)
    A = rng.standard_normal((250, 400)) * (rng.random((250, 400)) < 0.3)
    b = A[:, :10] @ rng.standard_normal(10) + 0.1 * rng.standard_normal(250)
    l1, bounds = 0.05 * np.abs(A.T @ b).max(), {"lower": -INF, "upper": INF, **bounds}
    result = bounded_least_squares(form(A), b, l1=l1, **bounds).require_solved()
    whole = {name: np.broadcast_to(bound, 400) for name, bound in bounds.items()}
    slope = A.T @ (A @ result.x - b)
    moved = np.clip(
        np.sign(result.x - slope) * np.maximum(np.abs(result.x - slope) - l1, 0.0), *whole.values()
    )
    assert np.abs(result.x - moved).max() <= 1e-7 * np.abs(A.T @ b).max()
    assert 5 <= np.count_nonzero(result.x) <= 100


def test_a_penalty_that_is_large_enough_leaves_nothing():
    """From ‖AᵀWb‖∞ on x is 0, below it is not; a penalty on one side of 0 is a linear term."""
    A, b = np.array([[1.0, 2.0], [0.5, -1.0], [1.0, 0.0]]), np.array([1.0, -3.0, 0.5])
    largest = np.abs(A.T @ b).max()
    for l1, is_empty in ((largest, True), (1e305, True), (0.99 * largest, False)):
        result = bounded_least_squares(A, b, -INF, l1=l1).require_solved()
        assert (not result.x.any()) == is_empty
    nonnegative = solve(BoundedLeastSquares(A, b, l1=0.7)).require_solved()
    program = solve(QuadraticProgram(A.T @ A, 0.7 - A.T @ b, lower=0.0))
    np.testing.assert_allclose(nonnegative.x, program.x, atol=1e-8)


def test_a_lasso_goes_in_and_out_as_other_least_squares_do(tmp_path):
    """A file of arrays, repr, explain: the same answer as from solve, bit for bit."""
    A, b, rest, _ = planted(6, 5, 1)
    problem = BoundedLeastSquares(A, b, **rest)
    np.savez(tmp_path / "lasso.npz", A=A, b=b, **rest)
    read = load_problem(tmp_path / "lasso.npz")
    np.testing.assert_array_equal(solve(read).x, solve(problem).x)
    assert repr(problem) == "BoundedLeastSquares(6 rows, 5 columns, dense, l1)"
    assert "cost" in solve(problem).explain()


@pytest.mark.parametrize("l1", [-1.0, INF, np.nan, [1.0, 2.0, 3.0], [0.0, -2.0], "much"])
def test_what_is_no_penalty_is_refused(l1):
    """A negative or infinite one, NaN, another length, a word: in words that name l1."""
    with pytest.raises(InvalidProblem, match="l1"):
        BoundedLeastSquares(np.eye(2), [1.0, 2.0], l1=l1)


@pytest.mark.quick(1)
@pytest.mark.parametrize("noise", [0.0, 0.1])
@pytest.mark.parametrize("l1", [1e-1, 1e-6])
def test_a_tiny_penalty_is_no_trouble(l1, noise):
    """256 × 512, l1 down to 1e-6, with and without noise: SOLVED, and a ray of the dual bounds the cost from below."""
    rng = np.random.default_rng(5)
    A, x = rng.standard_normal((256, 512)), np.zeros(512)
    x[:20] = rng.standard_normal(20)
    b = A @ x + noise * rng.standard_normal(256)
    result = bounded_least_squares(A, b, -INF, l1=l1).require_solved()
    free = result.x != 0.0
    shortest = -l1 * np.linalg.lstsq(A[:, free].T, np.sign(result.x[free]), rcond=None)[0]
    bounds = []
    # scaled to |Aᵀy| ≤ l1: the one is good where little is left of b
    for y in (shortest, A @ result.x - b):
        y *= l1 / max(l1, float(np.abs(A.T @ y).max()))
        bounds.append(-0.5 * (y @ y) - b @ y)
    assert result.cost <= max(bounds) * (1.0 + 1e-6)
    if noise == 0.0:
        np.testing.assert_allclose(result.x, x, atol=10.0 * l1)


@pytest.mark.parametrize(
    ("n", "seed", "l1"),
    [(32, 3, 1e-6), (32, 3, 1e-9), (32, 4, 1e-9), (128, 1, 1e-9), (64, 2, 1e-11), (16, 5, 1e-11)],
)
def test_a_tiny_penalty_on_an_exact_fit_has_the_cost_of_basis_pursuit(n, seed, l1):
    """The least ‖x‖₁ of an x that fits b exactly, by HiGHS, is the cost; it is SOLVED for l1 of 1e-9 and more."""
    rng = np.random.default_rng(seed)
    A = rng.standard_normal((n, 2 * n))
    b = A @ (rng.standard_normal(2 * n) * (rng.random(2 * n) < 0.1))
    least = linprog(np.ones(4 * n), A_eq=np.hstack([A, -A]), b_eq=b, bounds=(0, None)).fun
    result = solve(BoundedLeastSquares(A, b, lower=-INF, l1=l1))
    assert result.is_solved or l1 < 1e-9
    assert result.cost == pytest.approx(l1 * least, rel=1e-6)


@pytest.mark.parametrize("weight", [1e4, 1e8])
def test_trend_of_changing_slopes_is_solved_next_to_the_whole_objective(weight):
    """A trend x with penalized slope changes d, weight (D x − d)², is SOLVED with the cost that Clarabel finds."""
    n, rng = 600, np.random.default_rng(0)
    D = sp.diags_array([1.0, -2.0, 1.0], offsets=[0, 1, 2], shape=(n - 2, n))
    b = 0.1 * np.cumsum(np.cumsum((rng.random(n) < 0.02) * rng.standard_normal(n)))
    b += rng.standard_normal(n)
    A = sp.csr_array(sp.block_array([[sp.eye_array(n), None], [D, -sp.eye_array(n - 2)]]))
    problem = BoundedLeastSquares(
        A,
        np.append(b, np.zeros(n - 2)),
        lower=-INF,
        weights=np.append(np.ones(n), np.full(n - 2, weight)),
        l1=np.append(np.zeros(n), np.full(n - 2, 50.0)),
    )
    result = solve(problem)
    assert result.status is Status.SOLVED
    x, r = cp.Variable(n), cp.Variable(n - 2)
    # the least over d of ½ weight (D x − d)² + 50 |d| is a Huber function of D x
    huber = 0.5 * weight * cp.sum_squares(D @ x - r) + 50.0 * cp.norm1(r)
    least = cp.Problem(cp.Minimize(0.5 * cp.sum_squares(x - b) + huber)).solve(solver=cp.CLARABEL)
    assert result.cost == pytest.approx(least, rel=1e-6)


@pytest.mark.parametrize(("lower", "upper", "active"), [(2.0, INF, 0), (-INF, -0.5, 1)])
def test_a_bound_that_is_not_zero_leaves_the_rows_of_a_penalty_their_multipliers(
    lower, upper, active
):
    """½ (2 x − 3)² + |x| at a bound of x: the active row of |x| has the penalty, the bound has the rest."""
    P, G = sp.diags_array([0.0, 0.0, 1.0]), [[1.0, -1.0, 0.0], [-1.0, -1.0, 0.0]]
    bounds = {"lower": [lower, -INF, -INF], "upper": [upper, INF, INF]}
    form = regression_of(QuadraticProgram(P, [0, 1, 0], G, [0, 0], [[2, 0, -1]], [3], **bounds))
    assert form is not None
    problem, outward = form
    multipliers = outward(solve(problem).x)[1]
    assert multipliers[:2].tolist() == [float(active == 0), float(active == 1)]
