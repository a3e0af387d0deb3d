"""Programs over equilibria by SCIP and without it: published optima, bilinear leaders, no time, advice."""

from __future__ import annotations

import sys
from functools import partial

import cvxpy as cp
import numpy as np
import pytest
from macmpec import COLLECTION

from lcp_plugin import EquilibriumProgram, QuadraticProgram, Status, complements, optimal, solve


@pytest.fixture
def without_scip(monkeypatch):
    """Make pyscipopt unavailable."""
    monkeypatch.setitem(sys.modules, "pyscipopt", None)


@pytest.mark.full
@pytest.mark.parametrize("has_scip", [True, False])
def test_fifty_pairs_have_their_published_optimum_with_scip_and_without(has_scip, monkeypatch):
    """The optimum is right, and the explanation names SCIP; without it our own nodes prove the optimum."""
    if not has_scip:
        monkeypatch.setitem(sys.modules, "pyscipopt", None)
    published = COLLECTION["liswet1_050"]
    problem = published.state()
    problem.solve(method="LCP", max_seconds=600)
    result = problem.solver_stats.extra_stats
    assert (problem.status, result.problem.pairs) == (cp.OPTIMAL, 50)
    assert result.bound_by == "proof" or has_scip
    assert result.bound_by == "proof" or "bound by SCIP, in floating point" in result.explain()
    assert result.problem.excess(result.x) <= 1e-7
    assert problem.value == pytest.approx(published.optimum, abs=1e-6 + published.accuracy)


def test_a_known_equilibrium_is_returned_without_time(monkeypatch):
    """The variables hold an equilibrium: with no time at all the answer is no worse."""
    problem, _ = monopolist()
    value = problem.solve(method="LCP")
    monkeypatch.setitem(sys.modules, "pyscipopt", None)
    problem.solve(method="LCP", max_seconds=0)
    assert problem.status in (cp.OPTIMAL, cp.settings.USER_LIMIT)
    assert problem.value >= value - 1e-6 * abs(value)


def monopolist() -> tuple[cp.Problem, cp.Variable]:
    """Price × quantity next to a fringe that sells where the price exceeds 2 + y."""
    x, y, price = cp.Variable(bounds=[0, 10]), cp.Variable(), cp.Variable()
    fringe = complements(y >= 0, 2 + y - price >= 0)
    return cp.Problem(cp.Maximize(cp.multiply(price, x) - x), [fringe, price == 10 - x - y]), x


def test_a_bilinear_leader_is_solved_by_scip():
    """Income (p − 1) x with y = (8 − x)/2 for x ≤ 6 and p = (12 − x)/2: x = 5, 12.5."""
    problem, x = monopolist()
    assert problem.solve(method="LCP") == pytest.approx(12.5, abs=1e-6)
    assert float(x.value) == pytest.approx(5.0, abs=1e-3)
    assert problem.solver_stats.extra_stats.proof is None


@pytest.mark.parametrize("unit", [1.0, 1e3])
def test_a_bilinear_minimum_of_zero_is_solved(unit):
    """The least x y is 0 for x and y from 0 to 3 units, and −0.3 units² if they are at least −0.1."""
    P = np.array([[0.0, 1.0], [1.0, 0.0]])
    at_zero = QuadraticProgram(P, np.zeros(2), lower=0.0, upper=3.0 * unit)
    result = solve(EquilibriumProgram(at_zero, [], []))
    assert (result.status, result.value) == (Status.SOLVED, 0.0)
    below = QuadraticProgram(P, np.zeros(2), lower=-0.1 * unit, upper=3.0 * unit)
    result = solve(EquilibriumProgram(below, [], []))
    assert result.require_solved().value == pytest.approx(-0.3 * unit**2, rel=1e-5)


def test_an_unbounded_objective_that_is_not_convex_is_named():
    """Income x² + x y with 0 ≤ y ⟂ 2 + y − p ≥ 0, p = 10 − x − y, x not bounded: no value is called optimal."""
    x, y, price = cp.Variable(nonneg=True), cp.Variable(), cp.Variable()
    rows = [complements(y >= 0, 2 + y - price >= 0), price == 10 - x - y]
    problem = cp.Problem(cp.Maximize(cp.multiply(x, y) + cp.multiply(x, x)), rows)
    problem.solve(method="LCP")
    result = problem.solver_stats.extra_stats
    assert (problem.status, result.status) == (cp.settings.USER_LIMIT, Status.STALLED)
    assert "next: bound the variables" in result.advice
    bounded = cp.Problem(problem.objective, [*rows, x <= 4])  # what is advised
    assert bounded.solve(method="LCP") == pytest.approx(24.0, abs=1e-5)


def test_an_absolute_value_that_is_not_convex_is_taken_as_a_pair():
    """|x − 3| − x is largest at x = 0, proved; |a| + |b| − a b, |a| + b² ≤ 2, where 3 = 2 b + 3 b²; starts count."""
    x, y, v = cp.Variable(bounds=[0, 10]), cp.Variable(), cp.Variable(2, bounds=[-2, 1])
    problem = cp.Problem(cp.Maximize(cp.abs(x - 3) - x), [complements(y >= 0, 2 * y + x - 8 >= 0)])
    assert problem.solve(method="LCP") == pytest.approx(3.0, abs=1e-6)
    assert problem.solver_stats.extra_stats.bound_by == "proof"
    rows = [complements(y >= 0, y - v[0] >= 0), cp.abs(v)[0] + cp.square(v[1]) <= 2]
    b = (np.sqrt(10.0) - 1.0) / 3.0
    bent = cp.Problem(cp.Maximize(cp.sum(cp.abs(v)) - cp.multiply(v[0], v[1])), rows)
    assert bent.solve(method="LCP") == pytest.approx(2.0 + 3.0 * b - b**2 - b**3, abs=1e-5)


def test_programs_beyond_complementarity_problems_are_solved_without_scip(without_scip):
    """More rows than unknowns, and one unknown in two pairs."""
    over = QuadraticProgram(None, [1, 0], A=[[1, 0], [0, 1]], b=[1, 0], lower=0)
    twice = QuadraticProgram(None, [1, 0, 0], A=[[1, -1, 0]], b=[1], lower=0)
    for program, second in ((over, [1]), (twice, [1, 2])):
        result = solve(EquilibriumProgram(program, [0] * len(second), second))
        assert (result.status, result.value, result.bound_by) == (
            Status.SOLVED,
            pytest.approx(1.0),
            "proof",
        )


def test_rows_that_limit_sides_of_pairs_give_a_bound(without_scip):
    """Without an upper bound of sides of pairs there is no bound; rows that limit them give one, and keep the pairs."""
    M, q = [[0.0, 1.0], [1.0, 0.0]], [1.0, 1.0]  # 0 ≤ y₀ ⟂ 1 + y₁, 0 ≤ y₁ ⟂ 1 + y₀: y = 0
    results = [
        solve(EquilibriumProgram.of_rows(program, [0, 1], M, q), max_nodes=0)
        for program in (
            QuadraticProgram(None, [-1, -1], lower=0),
            QuadraticProgram(None, [-1, -1], np.eye(2), [9, 9], lower=0),
        )
    ]
    assert (results[0].value, results[0].lower_bound, results[1].lower_bound) == (
        0.0,
        -np.inf,
        pytest.approx(-18.0),
    )


def interdiction(rows: int) -> cp.Problem:
    """Return the problem of a leader who makes one arc of a network longer, with that many balances of nodes."""
    f, y = cp.Variable(4, nonneg=True), cp.Variable(4, boolean=True)
    balances = np.array([[1, 0, 1, -1], [-1, 1, 0, 1], [0, -1, -1, 0]])[:rows] @ f
    cost = cp.sum(cp.multiply(np.array([1.0, 1.0, 3.0, 1.0]) + 5.0 * y, f))
    way = optimal(cp.Problem(cp.Minimize(cost), [balances == np.array([1, 0, -1])[:rows]]), [f])
    return cp.Problem(cp.Maximize(cost), [way, cp.sum(y) <= 1])


@pytest.mark.parametrize("rows", [2, 3])
def test_multipliers_of_redundant_balances_are_left_out(rows):
    """Balances of all nodes are dependent, and their multipliers have no bound; the longest shortest way is 3."""
    problem = interdiction(rows)
    assert problem.solve(method="LCP") == pytest.approx(3.0, abs=1e-6)
    assert problem.status == cp.OPTIMAL


@pytest.mark.parametrize("end", [1.0, 5.0])
def test_a_follower_of_value_0_is_polished(end):
    """The follower minimizes (x + eˣ) y: y is 0 to 1e-4 in SCIP's point, and 0 in the minimizer of its piece."""
    x, y = cp.Variable(bounds=[-2, 2]), cp.Variable(bounds=[-3, end])
    way = optimal(cp.Problem(cp.Minimize(cp.multiply(x + cp.exp(x), y))), [y])
    problem = cp.Problem(cp.Minimize(cp.square(y)), [way])
    assert problem.solve(method="LCP") == pytest.approx(0.0, abs=1e-12)
    assert problem.status == cp.OPTIMAL
    assert float(x.value) == pytest.approx(-0.5671432904097838, abs=1e-9)


def game(*, has_start: bool) -> tuple[cp.Problem, float]:
    """A leader of a 15 × 15 game who commits to a mixed strategy; the start is an equilibrium of value 6."""
    gains, answers = np.random.default_rng(7).integers(0, 10, (2, 15, 15)).astype(float)
    x, y = cp.Variable(15, nonneg=True), cp.Variable(15, nonneg=True)
    best = optimal(cp.Problem(cp.Maximize(x @ answers @ y), [cp.sum(y) == 1]), over=[y])
    row = next(i for i in range(15) if gains[i, answers[i].argmax()] == 6)
    if has_start:
        x.value, y.value = np.eye(15)[row], np.eye(15)[answers[row].argmax()]
    return cp.Problem(cp.Maximize(x @ gains @ y), [cp.sum(x) == 1, best]), 6.0 * has_start


def routes() -> tuple[cp.Problem, float]:
    """Tolls on two routes of which a follower uses the cheaper one: at most 2.5."""
    y, f = cp.Variable(2, nonneg=True), cp.Variable(2, nonneg=True)
    cost = cp.sum(cp.multiply([1, 2] + 2 * y, f))
    best = optimal(cp.Problem(cp.Minimize(cost), [cp.sum(f) == 1, f <= 1]), over=[f])
    return cp.Problem(cp.Maximize(cost), [y <= 1, cp.sum(y) <= 1, best]), 2.5 - 1e-6


def quartic() -> tuple[cp.Problem, float]:
    """A follower whose answer is a fourfold root; x = 6 gives the leader −2.25."""
    x, y = cp.Variable(), cp.Variable()
    best = optimal(cp.Problem(cp.Minimize((x + 2 * y - 15) ** 4), [y >= 0, y <= 10]), over=[y])
    goal = cp.Maximize(-((x - 6) ** 2) - (y - 3) ** 2)
    return cp.Problem(goal, [y <= x, x >= 0, x <= 10, best]), -2.26


@pytest.mark.quick(1)
@pytest.mark.parametrize(
    "model",
    [partial(game, has_start=True), partial(game, has_start=False), routes, quartic],
    ids=["game from an equilibrium", "game", "routes", "quartic"],
)
def test_followers_answers_to_a_decision_are_a_point(model, without_scip):
    """Every search returns a point before SCIP starts, not worse than the start, at which no follower could gain."""
    problem, least = model()
    problem.solve(method="LCP")
    assert problem.value is not None
    assert problem.value >= least
    assert problem.constraints[-1].gap() <= 1e-6
