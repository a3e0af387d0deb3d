"""The best of all solutions of a complementarity problem: published optima, and what their statements mean."""

from __future__ import annotations

import itertools
import sys
from dataclasses import replace
from typing import Any

import cvxpy as cp
import numpy as np
import pytest
from macmpec import COLLECTION
from scipy.optimize import linprog

from lcp_plugin import (
    EquilibriumProgram,
    QuadraticProgram,
    Status,
    box,
    certify,
    complements,
    optimal,
    solve,
)
from lcp_plugin.problems.equilibria.branch_and_bound import BranchAndBound


def solved(problem: cp.Problem, **options: Any) -> Any:
    """The result of a problem that is solved to the end."""
    problem.solve(method="LCP", max_seconds=60.0, **{"prove": True, **options})
    return problem.solver_stats.extra_stats


@pytest.mark.quick(1)
@pytest.mark.parametrize("name", list(COLLECTION))
def test_published_optima_are_found_and_proved(name):
    """Status optimal, the published value or the better one that is known, and every bound of the tree verifies."""
    published = COLLECTION[name]
    problem = published.state()
    result = solved(problem)
    assert (problem.status, result.is_solved) == (cp.OPTIMAL, True)
    assert result.gap <= 1e-6
    assert (
        abs(problem.value - published.optimum) <= 1e-6 * abs(published.optimum) + published.accuracy
    )
    assert result.verify()
    assert certify(result.problem, result).verdict == "proved"
    assert certify(result.problem, result.x).verdict == "proved"


@pytest.mark.parametrize(("bounds", "wanted"), [((-9, 1), 8.0), ((1, 9), 20.0), ((2, 4), 26.0)])
@pytest.mark.parametrize("is_attribute", [False, True])
def test_bounds_beside_a_pair_are_no_bounds_of_the_pair(bounds, wanted, is_attribute):
    """0 ≤ y ⟂ y − x ≥ 0 says y = x wherever y > 0, also at a bound of y that is stated elsewhere."""
    x, y = cp.Variable(), cp.Variable(bounds=list(bounds)) if is_attribute else cp.Variable()
    others = [] if is_attribute else [bounds[0] <= y, y <= bounds[1]]
    far = -3 if bounds[0] > 0 else 3
    problem = cp.Problem(
        cp.Minimize((x - far) ** 2 + (y - 3) ** 2), [complements(y >= 0, y - x >= 0), *others]
    )
    assert solved(problem).verify()
    np.testing.assert_allclose(problem.value, wanted, atol=1e-9)


def test_two_pairs_may_give_one_variable_different_bounds():
    """0 ≤ y ⟂ y − x ≥ 0 and 1 ≤ y ≤ 2 ⟂ u: y ≥ 1 > 0, so that y = x, while u > 0 only where y = 1."""
    x, y, u = cp.Variable(), cp.Variable(), cp.Variable()
    pairs = [complements(y >= 0, y - x >= 0), complements(box(y, 1, 2), u)]
    problem = cp.Problem(cp.Minimize((x + 3) ** 2 + (u - 1) ** 2), pairs)
    assert solved(problem).verify()
    np.testing.assert_allclose([problem.value, x.value, u.value], [16.0, 1.0, 1.0], atol=1e-9)


def test_a_cost_far_above_the_others_leaves_the_only_solution():
    """Of an LCP with one solution it is the best, where the least multipliers of a cost of 3e9 are none."""
    M, q = np.array([[6.0, -3.0], [-3.0, 4.0]]), np.array([-1e-7, 0.0])
    lower, cost = np.append(np.zeros(2), np.full(2, -np.inf)), [-2.0, -3e9, 0.0, 0.0]
    program = QuadraticProgram(None, cost, A=np.hstack([M, -np.eye(2)]), b=-q, lower=lower)
    result = solve(EquilibriumProgram(program, [0, 1], [2, 3]))
    np.testing.assert_allclose(result.x[:2], [4e-7 / 15, 2e-8], rtol=1e-6)


@pytest.mark.full
def test_random_programs_agree_with_all_their_pieces(draws):
    """Status, value, bound and verify() hold against every piece, and verify() sees each of a dozen damages."""
    from campaigns.best_equilibria import complaints, random_problem, truth, undetected

    for case in draws(40):
        problem = random_problem(np.random.default_rng([36, 0, case]), most=5)
        known = truth(problem)
        for prove in (True, False):
            result = solve(problem, prove=prove)
            assert result.status in (
                Status.SOLVED,
                Status.INFEASIBLE,
                Status.NO_SOLUTION,
                Status.UNBOUNDED,
            )
            assert complaints(result, known) == [], case
            if case % 4 == 0 and prove:
                assert undetected(result) == [], case


def test_verify_sees_a_variable_beyond_the_bounds_of_its_pair():
    """0 ≤ z is said by the pair alone: z = −7 opposite w = 0 is no solution."""
    program = QuadraticProgram(
        np.zeros((3, 3)), [1, 0, 0], A=[[1, 0, -1]], b=[1], lower=[0, -np.inf, -np.inf]
    )
    result = solve(EquilibriumProgram(program, [1], [2], 0, np.inf))
    assert (result.status, result.value, result.verify()) == (Status.SOLVED, 1.0, True)
    assert not replace(result, x=np.array([1.0, -7.0, 0.0])).verify()


def test_verify_sees_a_gap_above_the_tolerance():
    """A bound of 0 is valid for a minimum of 1, and proves no optimum: the gap is its whole value."""
    result = solve(ending(Status.SOLVED), prove=True)
    assert (result.status, result.verify()) == (Status.SOLVED, True)
    assert not replace(result, lower_bound=0.0).verify()


ENDS = {  # bounds of x beside 0 ≤ x ⟂ x − 1 ≥ 0, cost of x, lower bound of y, whose cost is 1
    Status.SOLVED: (-np.inf, 2.0, 1.0, 0.0),
    Status.INFEASIBLE: (-np.inf, 0.5, 1.0, 0.0),
    Status.NO_SOLUTION: (1.5, 2.0, 1.0, 0.0),
    Status.UNBOUNDED: (-np.inf, 2.0, 0.0, -np.inf),
}


def ending(status: Status, height: float = 1.0) -> EquilibriumProgram:
    """Return a program of x, w = x − height and y that ends with the status."""
    lower, upper, cost, least = ENDS[status]
    A, ends = [[1.0, -1.0, 0.0]], ([lower, -np.inf, least], [upper, np.inf, np.inf])
    program = QuadraticProgram(
        None, [cost, 0.0, 1.0], A=A, b=[height], lower=ends[0], upper=ends[1]
    )
    return EquilibriumProgram(program, [0], [1], 0.0, np.inf)


@pytest.mark.parametrize("status", list(ENDS))
def test_the_conflict_is_the_one_of_the_linear_constraints(status):
    """Only a program whose linear constraints are inconsistent has a conflict, which is exact."""
    result = solve(ending(status))
    assert (result.status, result.verify()) == (status, True)
    assert result.has_conflict == (result.conflict is not None) == (status is Status.INFEASIBLE)
    assert result.conflict is None or result.conflict.verify()


def test_a_search_that_ends_before_it_finds_a_point_keeps_the_values(monkeypatch):
    """The status is user_limit, variables keep what they hold, and a bound of (y − x)² + x² + 1 is one."""
    monkeypatch.setattr(BranchAndBound, "solve_nearest_piece", lambda self, x, cases=None: None)
    monkeypatch.setitem(sys.modules, "pyscipopt", None)
    x, y = cp.Variable(value=7.0), cp.Variable(value=-3.0)
    pair = complements(x >= 0, y - x - 1 >= 0)
    problem = cp.Problem(cp.Minimize((y - x) ** 2 + x**2 + 1), [pair])
    problem.solve(method="LCP", callback=lambda search: True)
    found = problem.solver_stats.extra_stats
    assert (problem.status, found.status) == (cp.settings.USER_LIMIT, Status.INTERRUPTED)
    assert (float(x.value), float(y.value), found.x) == (7.0, -3.0, None)
    assert found.lower_bound == pytest.approx(2.0, abs=1e-6)
    assert found.lower_bound <= 2.0


@pytest.mark.full
def test_wherever_the_search_is_interrupted_its_bound_and_status_hold():
    """No bound lies above the optimum, nothing is called optimal that is not, and verify() agrees."""
    rng, k = np.random.default_rng(3), 5
    program = QuadraticProgram(
        None, rng.integers(-4, 5, k + 2), lower=[-1, -1] + [0] * k, upper=[1, 1] + [3] * k
    )
    M, q = rng.integers(-3, 4, (k, k + 2)), rng.integers(-3, 4, k)
    problem = EquilibriumProgram.of_rows(program, range(2, k + 2), M, q)
    calls = []

    def interrupted(at):
        def callback(search):
            calls.append(search)
            if len(calls) == at:
                raise KeyboardInterrupt

        calls.clear()
        return solve(problem, prove=True, callback=callback)

    whole = interrupted(0)
    assert (whole.status, whole.verify(), whole.nodes > 1) == (Status.SOLVED, True, True)
    for at in range(1, len(calls) + 1):
        result = interrupted(at)
        assert (result.status, result.verify()) == (Status.INTERRUPTED, True)
        assert result.lower_bound <= whole.value <= result.value
    assert len(calls) > 0


def test_a_row_with_a_tiny_coefficient_is_judged_by_its_own_terms():
    """Row 0, w = −2 z₀ − 2 z₁ − 3 ≥ 0, excludes every z ≥ 0; 6e-17 in row 1 made w = −3 pass for 0."""
    M, q = [[-2.0, -2.0], [6.123233995736766e-17, -2.0]], [-3.0, 1e10]
    problem = EquilibriumProgram.of_rows(
        QuadraticProgram(None, [2.0, -1.0], lower=0.0), [0, 1], M, q
    )
    assert problem.excess_of_rows(np.array([0.0, 0.0, 0.0, 1e10])).max() > 0.1
    result = solve(problem)
    assert not result.is_solved
    assert result.x is None or np.isnan(result.x).all()


@pytest.mark.quick(1)
@pytest.mark.parametrize("unit", [1e-12, 1e-9, 1e-6, 1.0, 1e9])
@pytest.mark.parametrize("prove", [False, True])
def test_the_unit_of_the_objective_changes_no_answer(unit, prove):
    """Costs of 1e-12 or of 1e9: the least over all cases, by enumeration with HiGHS, to 1e-6 of it."""
    rng, n = np.random.default_rng(3), 6
    root, N, q, costs = (rng.standard_normal(shape) for shape in ((n, n), (n, n), n, 2 * n))
    W, cost = np.hstack([N, root @ root.T + np.eye(n)]), unit * costs
    lower, upper = np.append(-np.ones(n), np.zeros(n)), np.append(np.ones(n), np.full(n, np.inf))
    best = np.inf
    for case in itertools.product([False, True], repeat=n):
        is_zero = np.array(case)
        ends = np.column_stack([lower, np.where(np.append(np.zeros(n, bool), is_zero), 0.0, upper)])
        found = linprog(costs, -W[is_zero], q[is_zero], W[~is_zero], -q[~is_zero], ends)
        best = min(best, unit * found.fun) if found.status == 0 else best
    problem = EquilibriumProgram.of_rows(
        QuadraticProgram(None, cost, lower=lower, upper=upper), range(n, 2 * n), W, q
    )
    result = solve(problem, prove=prove)
    assert result.is_solved
    np.testing.assert_allclose(result.value, best, rtol=1e-6)


def test_a_nonconvex_box_program_is_solved_at_its_least_face(draws):
    """Without pairs: the least value of an indefinite quadratic on a box, against an enumeration of its faces."""
    for seed in draws(12, 3):
        rng = np.random.default_rng(seed)
        B, c, best = rng.normal(size=(4, 4)), rng.normal(size=4), np.inf
        P = B + B.T
        for face in itertools.product((-1.0, 0.0, 1.0), repeat=4):
            x = np.array(face)
            free = x == 0.0
            inner = -(c[free] + P[np.ix_(free, ~free)] @ x[~free])
            x[free] = np.linalg.solve(P[np.ix_(free, free)], inner)
            if np.abs(x).max() <= 1.0:
                best = min(best, 0.5 * x @ P @ x + c @ x)
        result = solve(EquilibriumProgram(QuadraticProgram(P, c, lower=-1, upper=1), [], []))
        assert result.is_solved
        assert result.value == pytest.approx(best, rel=1e-6)


def test_an_integer_beside_pairs_is_solved_at_the_only_least_point():
    """Five unknowns, two pairs, one integer: (0, 0, 1, 0, 0), of value 1."""
    G = [[-1.0, 2.0, 0.0, 2.0, 0.0]]
    A = [[-1.0, 1.0, 2.0, 2.0, 0.0], [0.0, 2.0, -2.0, 0.0, -2.0]]
    program = QuadraticProgram(None, np.ones(5), G, [0.0], A, [2.0, -2.0], lower=0, upper=5)
    problem = EquilibriumProgram(program, [0, 1], [2, 3], upper=np.inf, integers=[4])
    result = solve(problem).require_solved()
    np.testing.assert_allclose(result.x, [0, 0, 1, 0, 0], atol=1e-8)
    assert result.value == pytest.approx(1.0)


def test_pairs_without_a_solution_are_proved_so_beside_integers():
    """Y ≥ 1 contradicts both cases of y ≥ 0 ⟂ y + 1 ≥ 0, whatever the integer is."""
    x, y = cp.Variable(integer=True), cp.Variable()
    rows = [complements(y >= 0, y + 1 >= 0), y >= 1, x >= 0, x <= 5]
    problem = cp.Problem(cp.Minimize(x), rows)
    problem.solve(method="LCP")
    assert problem.status == cp.INFEASIBLE
    assert problem.solver_stats.extra_stats.verify()


def test_a_solution_far_beyond_the_data_leaves_zero_unproved():
    """The solution with z₂ = 4.8e16 is better than z = 0, which is not proved, also where numpy raises at underflow."""
    M = [
        [9.000000000000001e-09, -3.0000000000000004e-09, -3.0000000000000004e-09],
        [-3.0, 10.0, 1.0],
        [-3.0000000000000004e-09, 1e-09, 1e-09],
    ]
    program = QuadraticProgram(np.zeros((3, 3)), [0.0, 2.0, -1.0], lower=0.0)
    problem = EquilibriumProgram.of_rows(
        program, [0, 1, 2], M, [1e-09, 1.0, 3.0000000000000004e-09]
    )
    with np.errstate(all="raise"):
        result = solve(problem, prove=True)
        assert result.is_solved == result.verify()
    # PIQP 0.6 finds a point whose rows hold within 1e-9 of their terms.
    assert not result.is_solved or result.value < -1e16


def test_an_objective_of_zero_has_no_gap():
    """The gap is 0 if value and bound are equal, also relative to an objective without terms."""
    program = QuadraticProgram(None, [0.0, 0.0], [[-1.0, -1.0]], [-1.0], lower=0.0, upper=4.0)
    result = solve(EquilibriumProgram(program, [0], [1]))
    assert (result.value, result.gap) == (0.0, 0.0)


def test_a_leaders_decision_is_polished():
    """A monopolist over a follower in quantities, 4.25 by hand, at any tolerance: its piece is a program."""
    Q, q, o = cp.Variable(nonneg=True), cp.Variable(nonneg=True), cp.Parameter(value=0.5)
    own = cp.Maximize(cp.multiply(10 - q - Q - o, q) - q)
    follower = optimal(cp.Problem(own), over=[q])
    goal = cp.Maximize(cp.multiply(10 - Q - o - q, Q) - Q)
    leader = cp.Problem(goal, [follower])
    for tolerance in (1e-6, 1e-9):
        leader.solve(method="LCP", tolerance=tolerance)
        assert leader.status == cp.OPTIMAL
        assert (Q.value, q.value) == pytest.approx((4.25, 2.125), abs=1e-8)
