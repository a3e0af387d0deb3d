"""Variational inequalities over polyhedra: constructed and published solutions, empty sets, gaps, messages."""

from __future__ import annotations

import pickle
from typing import Any

import cvxpy as cp
import numpy as np
import pytest
from tools.refusals import assert_refused, refusals

from lcp_plugin import LCP, InvalidProblem, QuadraticProgram, Status, derivative, solve, variational

#: Braess (1968), as in Nagurney, Network Economics: arcs a (1→2), b (1→3), c (2→4), d (3→4), e (2→3), demand 6.
BRAESS = np.array(
    [
        [1.0, 1.0, 0.0, 0.0, 0.0],
        [-1.0, 0.0, 1.0, 0.0, 1.0],
        [0.0, -1.0, 0.0, 1.0, -1.0],
        [0.0, 0.0, -1.0, -1.0, 0.0],
    ]
)
COSTS = np.diag([10.0, 1.0, 1.0, 10.0, 1.0]), np.array([0.0, 50.0, 50.0, 0.0, 10.0])


def answer(problem: Any, **options: Any) -> Any:
    return problem.origin.recover(solve(problem, **options).require_solved()).solution


def gap_by_enumeration(F: Any, x: Any, corners: Any) -> float:
    return float(max(F @ (x - corner) for corner in corners))


@pytest.mark.parametrize("seed", range(8))
def test_a_constructed_solution_with_multipliers_is_found(seed):
    """x* and multipliers come first, then q: M is monotone and not symmetric, with bounds, G and A."""
    random = np.random.default_rng(seed)
    n, m, p = 12, 3, 1
    skew, root = random.standard_normal((2, n, n))
    M, G, A = root @ root.T + skew - skew.T, *np.split(random.standard_normal((m + p, n)), [m])
    x = np.maximum(random.standard_normal(n), 0.0)
    inequality = np.maximum(random.standard_normal(m), 0.0)
    h = G @ x + np.where(inequality > 0.0, 0.0, 1.0)
    equality, slack = random.standard_normal(p), np.where(x > 0.0, 0.0, random.random(n))
    q = slack - M @ x - G.T @ inequality - A.T @ equality
    found = answer(variational((M, q), G, h, A, A @ x, lower=0))
    np.testing.assert_allclose(found.x, x, atol=1e-8)
    np.testing.assert_allclose(found.inequality, inequality, atol=1e-7)
    np.testing.assert_allclose(found.equality, equality, atol=1e-7)
    np.testing.assert_allclose(found.lower, slack, atol=1e-7)
    assert found.gap() <= 1e-7


@pytest.mark.parametrize("is_function", [False, True])
def test_the_network_of_braess_has_its_published_flows(is_function):
    """Flows 4, 2, 2, 4, 2 on the arcs: each path takes 92. Conservation at one node follows from the others."""
    slopes, free = COSTS
    F = (lambda f: slopes @ f + free, lambda f: slopes) if is_function else COSTS
    found = answer(variational(F, A=BRAESS, b=[6.0, 0.0, 0.0, -6.0], lower=0))
    np.testing.assert_allclose(found.x, [4.0, 2.0, 2.0, 4.0, 2.0], atol=1e-9)
    assert found.equality[3] - found.equality[0] == pytest.approx(92.0)
    without = variational(COSTS, A=BRAESS, b=[6.0, 0.0, 0.0, -6.0], lower=0, upper=[9, 9, 9, 9, 0])
    np.testing.assert_allclose(answer(without).x, [3.0, 3.0, 3.0, 3.0, 0.0], atol=1e-9)


@pytest.mark.parametrize("has_jacobian", [True, False])
def test_a_smooth_function_has_its_constructed_solution(has_jacobian):
    """x* = (1, 2) with multiplier 3 of x₁ + x₂ ≤ 3: F is a cubic that is no gradient."""

    def F(x):
        return np.array([2 * x[0] + x[1] + x[0] ** 3 - 8, 2 * x[1] - x[0] - 6])

    def slopes(x):
        return np.array([[2 + 3 * x[0] ** 2, 1], [-1, 2]])

    found = answer(variational((F, slopes) if has_jacobian else F, [[1, 1]], [3], lower=0))
    np.testing.assert_allclose(found.x, [1.0, 2.0], atol=1e-7)
    np.testing.assert_allclose(found.inequality, [3.0], atol=1e-6)
    assert found.gap() <= 1e-6


def test_the_gap_is_the_largest_gain_over_all_corners():
    """At any point of the set; ∞ where F decreases along a ray of the set."""
    M, q = np.array([[2.0, 1.0], [-1.0, 2.0]]), np.array([-8.0, -6.0])
    origin = variational((M, q), [[1, 1]], [3], lower=0).origin
    for x in np.array([[0.0, 0.0], [1.0, 0.5], [3.0, 0.0]]):
        corners = np.array([[0.0, 0.0], [3.0, 0.0], [0.0, 3.0]])
        expected = gap_by_enumeration(M @ x + q, x, corners)
        assert origin.recover([*x, 0.0]).solution.gap() == pytest.approx(expected)
    assert (
        variational((M, q), [[1, -1]], [3], lower=0).origin.recover([0, 0, 0]).solution.gap()
        == np.inf
    )


@pytest.mark.parametrize("is_smooth", [False, True])
def test_an_empty_set_has_a_farkas_certificate_with_the_names_of_its_rows(is_smooth):
    """x₁ + x₂ ≤ 3 contradicts x₁ + x₂ = 5; the proof is checked again."""
    M, q = np.array([[2.0, 1.0], [-1.0, 2.0]]), np.array([-8.0, -6.0])
    F = (lambda x: M @ x + q + x**3) if is_smooth else (M, q)
    problem = variational(F, [[1, 1]], [3], [[1, 1]], [5])
    result = solve(problem)
    assert result.status is Status.INFEASIBLE
    assert result.proof.verify()
    assert sorted(name[-10:] for name in result.conflict.names) == ["row 0 of A", "row 0 of G"]
    assert np.isnan(problem.origin.recover(result).solution.gap())


def test_a_constant_map_without_minimum_on_an_unbounded_set_has_no_solution():
    """F = (−1, 0) on x₁ − x₂ ≤ 1, x ≥ 0 descends along (1, 1): the dual rows are inconsistent."""
    problem = variational((np.zeros((2, 2)), [-1, 0]), [[1, -1]], [1], lower=0)
    result = solve(problem)
    assert result.has_no_solution
    assert result.proof.verify()
    assert problem.origin.recover(result).solution.gap() == np.inf


def test_an_equation_stated_twice_changes_nothing_but_its_multipliers():
    """Their sum is the multiplier of one."""
    F = [[2, 1], [-1, 2]], [-8, -6]
    once, twice = (
        answer(variational(F, A=[[1, 1]] * k, b=[3] * k, lower=0, upper=9)) for k in (1, 2)
    )
    np.testing.assert_allclose(twice.x, once.x, atol=1e-9)
    assert twice.equality.sum() == pytest.approx(once.equality.sum())


def test_the_problem_has_derivatives_and_can_be_pickled():
    """Of x = (1.25, 1.75) by h: 1/4 and 3/4."""
    problem = variational(([[2, 1], [-1, 2]], [-8, -6]), [[1, 1]], [3], lower=0)
    change = derivative(solve(problem)).jvp(dq=[0, 0, 1])
    np.testing.assert_allclose(change[:2], [0.25, 0.75], atol=1e-12)
    assert answer(pickle.loads(pickle.dumps(problem))).gap() <= 1e-12


def test_a_loosely_solved_inequality_is_recovered_as_solved():
    """At the tolerance .1 the linear program of F(x) is far from its minimum; the criterion is the problem's own."""
    problem = variational((np.diag([1.0, 1e3]), [-1.0, -1.0]))
    result = solve(problem, "npsor", tolerance=0.1, polish=False)
    assert result.is_solved
    recovered = problem.origin.recover(result)
    assert recovered.is_solved
    assert not recovered.solution.is_optimal()


@refusals(r"""
variational(np.eye(2)) → variational\(\(M, q\), …\)
variational(lambda x: x) → pass a bound as an array
variational((np.eye(2), [0, 0]), G=[[1, 1]]) → G and h belong together
variational((np.eye(2), [0, 0]), over=[1]) → G=…, h=…
variational((np.eye(2), [0])) → length 2
""")
def test_a_wrong_call_is_told_what_to_write(call, words):
    """InvalidProblem with the right call."""
    assert_refused(call, words, {}, InvalidProblem)


def test_a_result_of_other_data_is_not_solved_here():
    """X = 0 solves the inequality with q = (8, 6), and not the one with q = (−8, −6)."""
    problem = variational(([[2.0, 1], [-1, 2]], [-8.0, -6]), G=[[1.0, 1]], h=[3.0], lower=0)
    other = solve(LCP(problem.M, [8.0, 6, 3], lower=problem.lower, upper=problem.upper))
    assert other.is_solved
    assert not problem.origin.recover(other).is_solved
    assert problem.origin.recover(solve(problem)).is_solved


@pytest.mark.parametrize("seed", range(8))
def test_the_gap_of_free_unknowns_is_zero_at_a_solution(seed):
    """F(x) of free unknowns is a rounding error, along which y is unbounded."""
    rng = np.random.default_rng(seed)
    S = rng.normal(size=(3, 3))
    F = np.eye(3) + S - S.T, rng.normal(size=3)
    problem = variational(F, G=rng.normal(size=(1, 3)), h=[rng.normal()])
    assert problem.origin.recover(solve(problem).require_solved()).solution.gap() <= 1e-9
    program = QuadraticProgram([[2.0, 1], [1, 3]], [-1.3, 0.7], upper=[np.inf, 9])
    assert solve(program).solution.gap() <= 1e-9


def test_bounds_next_to_an_expression_of_cvxpy_are_refused():
    """They would be ignored: the set of a cvxpy expression is its constraints."""
    x = cp.Variable(2)
    with pytest.raises(InvalidProblem, match="x >= lower"):
        variational(x - [-1, 2], over=[x], lower=0, upper=1)


def test_a_shifted_problem_does_not_inherit_the_proof_of_its_old_rows():
    """x₀ + x₁ ≤ −1 is infeasible for x ≥ 0, and x₀ + x₁ ≤ 4, where q shifts it, is not: x = (0.5, 0) is in the set."""

    def rugged(x):
        first = 1e3 * np.sign(x[0] - 0.5) * abs(x[0] - 0.5) ** 0.1 + 50 * x[1] * np.sin(30 * x[0])
        return np.array([first, x[1] - 0.3 + 40 * np.cos(20 * x[1] + x[0])])

    problem = variational(rugged, G=[[1.0, 1]], h=[-1.0], lower=0)
    assert solve(problem, restarts=0).status is Status.INFEASIBLE
    assert solve(problem.with_q([0.0, 0, 5]), restarts=0).proof is None
