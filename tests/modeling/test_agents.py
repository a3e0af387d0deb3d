"""optimal(program, over=…): published and closed-form equilibria, gaps, dual values, convexity and messages."""

from __future__ import annotations

import pickle
import warnings
from typing import Any

import cvxpy as cp
import numpy as np
import pytest
from campaigns import agents as campaign
from inputs.nonlinear_models import NASH_5_SOLUTION
from tools.refusals import assert_refused, refusals

from lcp_plugin import LCP, ModelWarning, UnsupportedModel, complements, derivative, optimal, trace


def solved(
    agents: list[Any], others: Any = (), objective: Any = None, **options: Any
) -> cp.Problem:
    """Return the solved problem; all values are finite, and no agent could gain more than 1e-6."""
    problem = cp.Problem(objective or cp.Minimize(0), [*agents, *others])
    problem.solve(method="LCP", **options)
    assert problem.status == "optimal"
    gaps = [one.gap() for one in agents]
    assert all(gap is not None and 0.0 <= gap <= 1e-6 for gap in gaps), gaps
    return problem


def cournot(n: int, sold: Any, a: float, b: float, cost: Any) -> list[Any]:
    """Return n firms with price a − b Σx and constant marginal costs."""
    price = a - b * sum(sold[i] for i in range(n))
    return [
        optimal(
            cp.Problem(cp.Maximize(cp.multiply(price, sold[i]) - cost[i] * sold[i])), over=[sold[i]]
        )
        for i in range(n)
    ]


@pytest.mark.parametrize("form", ["scalars", "entries"])
@pytest.mark.parametrize("n", [1, 2, 5])
def test_cournot_has_its_closed_form(n, form):
    """x_i = (a − c_i − Σ_j (c_i − c_j)) / (b (n + 1)) if all firms are active."""
    cost = np.linspace(1.0, 2.0, n)
    one = cp.Variable(n, nonneg=True)
    sold = one if form == "entries" else [cp.Variable(nonneg=True) for _ in range(n)]
    solved(cournot(n, sold, 20.0, 0.5, cost))
    expected = (20.0 - cost - (n * cost - cost.sum())) / (0.5 * (n + 1))
    np.testing.assert_allclose([float(sold[i].value) for i in range(n)], expected, rtol=1e-9)


COST, BETA = np.array([10.0, 8.0, 6.0, 4.0, 2.0]), np.array([1.2, 1.1, 1.0, 0.9, 0.8])
SCALE = 5000 ** (1 / 1.1)


def oligopoly(form: str) -> tuple[list[Any], Any]:
    """Return the five firms of Murphy, Sherali and Soyster; the income as a product, or by cvxpy's rules."""
    sold = [cp.Variable(nonneg=True, value=10.0) for _ in COST]
    agents = []
    for i, x in enumerate(sold):
        power = (1 + BETA[i]) / BETA[i]
        cost = COST[i] * x + 5.0 ** (-1 / BETA[i]) / power * cp.power(x, power)
        Y = sum(one for k, one in enumerate(sold) if k != i)
        if form == "product":
            income = cp.multiply(x, SCALE * cp.power(x + Y, -1 / 1.1))
        else:
            income = SCALE * (
                cp.power(x + Y, 1 - 1 / 1.1) - cp.multiply(Y, cp.power(x + Y, -1 / 1.1))
            )
        check = "local" if form == "product" else "convex"
        agents.append(optimal(cp.Problem(cp.Maximize(income - cost)), over=[x], check=check))
    return agents, sold


@pytest.mark.quick(1)
@pytest.mark.parametrize("form", ["product", "disciplined"])
def test_the_oligopoly_of_murphy_sherali_and_soyster_is_the_published_one(form):
    """As a product with check="local", and in a form that cvxpy's rules accept; no warning is issued."""
    agents, sold = oligopoly(form)
    with warnings.catch_warnings():
        warnings.simplefilter("error", ModelWarning)
        cp.Problem(cp.Minimize(0), agents).solve(method="LCP")
    np.testing.assert_allclose([float(one.value) for one in sold], NASH_5_SOLUTION, atol=2e-4)
    if form == "disciplined":
        gaps = [one.gap() for one in agents]
        assert all(gap is not None and gap <= 1e-4 for gap in gaps)  # Clarabel's values


def test_an_income_that_is_not_known_to_be_concave_causes_one_warning():
    """The same oligopoly without check="local": the conditions are only necessary."""
    x, y = cp.Variable(nonneg=True, value=1.0), cp.Variable(nonneg=True, value=1.0)
    firms = [cp.Problem(cp.Maximize(cp.multiply(one, cp.exp(-x - y)))) for one in (x, y)]
    agents = [optimal(firm, over=[one]) for firm, one in zip(firms, (x, y), strict=True)]
    problem = cp.Problem(cp.Minimize(0), agents)
    with pytest.warns(ModelWarning, match="only necessary") as found:
        problem.solve(method="LCP")
    assert len(found) == 2
    np.testing.assert_allclose([x.value, y.value], 1.0, rtol=1e-6)
    with warnings.catch_warnings():
        warnings.simplefilter("error", ModelWarning)
        problem.solve(method="LCP")


def test_the_bilevel_program_of_bards_book_has_its_value():
    """(x − 5)² + (2y + 1)² over a follower with (y − 1)² − 1.5 x y: 17 at (1, 0), proved."""
    x, y = cp.Variable(nonneg=True), cp.Variable()
    rows = [y >= 0, 3 * x - y >= 3, -x + 0.5 * y >= -4, -x - y >= -7]
    best = optimal(cp.Problem(cp.Minimize((y - 1) ** 2 - 1.5 * cp.multiply(x, y)), rows), over=[y])
    problem = solved([best], objective=cp.Minimize((x - 5) ** 2 + (2 * y + 1) ** 2), prove=True)
    assert problem.value == pytest.approx(17.0, abs=1e-6)
    np.testing.assert_allclose([x.value, y.value], [1.0, 0.0], atol=1e-6)


SHARED_BY_TWO = {
    "entries": lambda x: x[0] + x[1] <= 4,
    "a matrix": lambda x: np.array([1.0, 1.0, 0.0]) @ x <= 4,
    "kinks": lambda x: cp.norm1(x[:2]) <= 4,
    "products": lambda x: cp.square(x[0] + x[1]) <= 16,
}


@pytest.mark.parametrize("form", SHARED_BY_TWO)
def test_agents_with_entries_of_one_vector_share_a_row_that_holds_their_entries(form):
    """The two agents min x₀² − 8x₀ and min x₁² − 6x₁ share x₀ + x₁ ≤ 4 with one multiplier of 3.

    The third agent has no entry in the row, and its own minimum.
    """
    x = cp.Variable(3, value=np.ones(3))
    row = SHARED_BY_TWO[form](x)
    goals = [x[0] ** 2 - 8 * x[0], x[1] ** 2 - 6 * x[1], (x[2] - 2) ** 2]
    agents = [
        optimal(cp.Problem(cp.Minimize(goals[i]), [row]), over=[x[i]], shared=row) for i in (0, 1)
    ]
    agents.append(optimal(cp.Problem(cp.Minimize(goals[2])), over=[x[2]]))
    solved(agents)
    np.testing.assert_allclose(x.value, [2.5, 1.5, 2.0], atol=1e-6)
    if form in ("entries", "a matrix"):
        assert float(row.dual_value) == pytest.approx(3.0)
        assert [float(one.dual_value[0]) for one in agents[:2]] == pytest.approx([3.0, 3.0])
    third = optimal(cp.Problem(cp.Minimize(goals[1])), over=[x[1]])
    with pytest.raises(UnsupportedModel, match="does not share it"):
        cp.Problem(cp.Minimize(0), [agents[0], third]).solve(method="LCP")


@pytest.mark.parametrize("cap", [np.inf, np.array([1.0, np.inf])], ids=["number", "array"])
def test_an_infinite_bound_is_no_bound(cap):
    """The minimum of ‖x − 3‖² with x ≤ cap is min(3, cap); the dual value of an infinite bound is 0."""
    x = cp.Variable(2)
    program = cp.Problem(cp.Minimize(cp.sum_squares(x - 3)), [x <= cap, 2 * x >= -np.inf])
    best = optimal(program, over=[x])
    solved([best])
    expected = np.minimum(3.0, cap + np.zeros(2))
    np.testing.assert_allclose(x.value, expected)
    np.testing.assert_allclose(best.dual_value, [2 * (3 - expected), np.zeros(2)])


def set_value(parameter: cp.Parameter, value: float) -> cp.Parameter:
    """Set the value; skip the test if cvxpy raises ValueError for ∞ (up to 1.8)."""
    try:
        parameter.value = value
    except ValueError as error:
        pytest.skip(f"cvxpy {cp.__version__}: {error}")
    return parameter


@refusals(r"""
v >= np.inf → inf <= v in an agent's program is not finite; only a constant side
v <= -np.inf → v <= -inf in an agent's program is not finite
cp.NonNeg(v - np.inf) → in an agent's program is not finite
v <= set_value(cp.Parameter(name="cap"), np.inf) → parameter cap of v <= cap
v <= np.nan → v <= nan in an agent's program is not finite
cp.abs(v) <= -np.inf → in an agent's program is not finite
v == np.inf → v == inf in an agent's program
""")
def test_an_infinite_bound_that_excludes_or_hides_values_is_refused(call, words):
    """No finite v satisfies v ≥ ∞; the message has the user's constraint."""
    call = f"solved([optimal(cp.Problem(cp.Minimize((v - 3) ** 2), [{call}]), over=[v])])"
    names = {**globals(), "v": cp.Variable(name="v")}
    assert_refused(call, words, names, UnsupportedModel)


def test_the_gap_of_a_program_that_is_not_convex_is_known_where_its_least_value_is_zero():
    """(x² − y)² at (3, 4) is 25, and 0 at (2, 4)."""
    x, y = cp.Variable(value=3.0), cp.Variable(value=4.0)
    goal = cp.Minimize(cp.square(cp.square(x) - y))
    best = optimal(cp.Problem(goal), over=[x], check="local")
    for value, gain in ((3.0, 25.0), (2.0, 0.0)):
        x.value = value
        assert best.gap() == pytest.approx(gain, abs=1e-6)


def test_a_shared_constraint_must_be_jointly_convex():
    """The row x y ≤ 4 is affine for each agent, and not convex for both."""
    x, y = cp.Variable(nonneg=True), cp.Variable(nonneg=True)
    row = cp.multiply(x, y) <= 4
    agents = [
        optimal(cp.Problem(cp.Minimize((one - 3) ** 2), [row]), over=[one], shared=[row])
        for one in (x, y)
    ]
    with pytest.raises(UnsupportedModel, match="all its agents together"):
        cp.Problem(cp.Minimize(0), agents).solve(method="LCP")


# --- one agent: the same values as a convex solver's ---


def programs_with(y: Any) -> tuple[dict[str, Any], Any]:
    """Return objectives and rows with data y by name, and their decision."""
    x = cp.Variable(3, value=np.full(3, 0.5))
    target = np.array([1.0, -2.0, 0.4])
    quadratic = cp.sum_squares(x - target) / 2 - y * x[0]
    return {
        "abs": (quadratic + cp.sum(cp.abs(x)), [x <= 2]),
        "kink": (quadratic + 5 * cp.abs(x[0] - 1) + cp.norm_inf(x), []),
        "norm1": (quadratic, [cp.norm1(x) <= y]),
        "maximum": (quadratic + cp.max(cp.maximum(x, 2 * x - 1)), [cp.sum(x) >= -1]),
        "largest": (quadratic + cp.sum_largest(x, 2), [x[0] + x[1] == 0.5]),
        "equality": (quadratic, [cp.sum(x) == y, x[1:] >= -1, 2 * x >= -2.5, x <= 3]),
        "entropy": (quadratic - cp.sum(cp.entr(x)), [cp.sum(x) == 2]),
        "exponential": (quadratic + cp.sum(cp.exp(x)), [cp.exp(x[0]) <= y + 1]),
        "logistic": (
            quadratic + cp.sum(cp.logistic(x + y)) + cp.log_sum_exp(x),
            [cp.sum_squares(x) <= y],
        ),
        "powers": (quadratic + cp.quad_over_lin(x, 2.0) + cp.power(x[1] + 4, -0.5), [x[1] >= -3]),
        "logarithm": (quadratic - cp.sum(cp.log(x + 2)) - cp.log1p(x[0]) + cp.kl_div(x[2], 2), []),
        "means": (quadratic - cp.geo_mean(x + 3), [x >= -2]),
        "huber": (quadratic + cp.sum(cp.huber(2 * x - y, 1.5)), [cp.huber(x[0] + 3) <= 8]),
    }, x


@pytest.mark.quick(1)
@pytest.mark.parametrize("kind", programs_with(1.0)[0])
def test_an_agent_has_the_optimum_and_the_dual_values_of_clarabel(kind):
    """Kinks at the optimum, equalities, bounds, entropy and other smooth terms; an equation outside determines y."""
    programs, x = programs_with(cp.Parameter(value=1.5, nonneg=True))
    program = cp.Problem(cp.Minimize(programs[kind][0]), programs[kind][1])
    program.solve(solver=cp.CLARABEL)
    expected, duals = x.value, [one.dual_value for one in program.constraints]
    y = cp.Variable(value=1.5)
    programs, x = programs_with(y)
    program = cp.Problem(cp.Minimize(programs[kind][0]), programs[kind][1])
    best = optimal(program, over=[x])
    problem = cp.Problem(cp.Minimize(0), [best, 2 * y == 3])
    problem.solve(method="LCP")
    assert problem.status == "optimal"
    np.testing.assert_allclose(x.value, expected, atol=2e-4)  # the flat direction of Clarabel
    for found, own, dual in zip(best.dual_value, program.constraints, duals, strict=True):
        np.testing.assert_allclose(found, dual, atol=1e-4)
        np.testing.assert_allclose(own.dual_value, found)
    gap = best.gap()
    assert gap is not None
    assert 0.0 <= gap <= 1e-6


def test_a_program_without_an_objective_is_a_feasibility_problem():
    """Any feasible point is optimal, and all dual values are 0."""
    x, y = cp.Variable(2), cp.Variable()
    best = optimal(cp.Problem(cp.Minimize(0), [x[0] >= 1, cp.sum(x) == y]), over=[x])
    solved([best], [y == 2])
    assert [float(one) for one in best.dual_value] == pytest.approx([0.0, 0.0])


@pytest.mark.parametrize("form", ["sum_squares", "quad_form", "products", "expanded"])
def test_the_conditions_of_quadratic_programs_are_an_lcp(form):
    """However the quadratic objective is written, and with bilinear terms of other agents."""
    P, A = np.array([[2.0, 1.0], [1.0, 3.0]]), np.array([[1.0, -1.0], [2.0, 0.5], [0.0, 1.0]])
    x, y = cp.Variable(2), cp.Variable(3)
    goal = {
        "sum_squares": cp.sum_squares(A @ x - y),
        "quad_form": cp.quad_form(x, P) / 2 + (A.T @ y - 1) @ x,
        "products": x @ (P @ x + A.T @ y + 1),
        "expanded": P[0, 0] * x[0] ** 2 + x[0] * x[1] + (x[1] + 1) * (x[1] - y[0]),
    }[form]
    first = optimal(cp.Problem(cp.Minimize(goal), [cp.sum(x) <= 3]), over=[x])
    second = optimal(cp.Problem(cp.Minimize(cp.sum_squares(y - 1) + y @ (A @ x))), over=[y])
    problem = solved([first, second])
    assert isinstance(problem.solver_stats.extra_stats.certificate.problem, LCP)


# --- economies and games ---


def test_walras_prices_are_those_of_cobb_and_douglas():
    """Two consumers with log utility and a linear producer: p = 1 for the numeraire, p₂ = its unit cost."""
    own, share = np.array([[4.0, 1.0], [2.0, 3.0]]), np.array([[0.3, 0.7], [0.4, 0.6]])
    price, made = cp.Variable(nonneg=True, value=1.0), cp.Variable(nonneg=True, value=1.0)
    p = cp.hstack([1.0, price])
    eaten = [cp.Variable(2, value=np.ones(2)) for _ in own]
    consumers = [
        optimal(
            cp.Problem(cp.Maximize(share[h] @ cp.log(eaten[h])), [p @ eaten[h] <= p @ own[h]]),
            over=[eaten[h]],
        )
        for h in range(2)
    ]
    # 2 of good 1 make 1 of good 2
    producer = optimal(cp.Problem(cp.Maximize((price - 2) * made)), over=[made])
    supply = own.sum(axis=0)[1] + made
    clearing = complements(price, supply - eaten[0][1] - eaten[1][1])
    cp.Problem(cp.Minimize(0), [*consumers, producer, clearing]).solve(method="LCP")
    at = np.array([1.0, 2.0])
    bought = share * (own @ at)[:, np.newaxis] / at
    expected = bought.sum(axis=0)[1] - own.sum(axis=0)[1]
    if expected < 0:
        raise AssertionError("the example is chosen so that the producer works")
    np.testing.assert_allclose([price.value, made.value], [2.0, expected], rtol=1e-6)
    np.testing.assert_allclose([one.value for one in eaten], bought, rtol=1e-6)
    assert all((one.gap() or 0.0) <= 1e-6 for one in (*consumers, producer))


# --- leaders, parameters and other constraints ---


def test_a_constraint_on_a_follower_couples_it_with_the_leader():
    """The leader minimizes the tax for which the follower sells at most 1: 2; without an objective any is found."""
    tax, sold = cp.Variable(bounds=[0, 4]), cp.Variable(nonneg=True)
    firm = optimal(cp.Problem(cp.Maximize((3 - tax) * sold - cp.square(sold) / 2)), over=[sold])
    solved([firm], [sold <= 1], cp.Minimize(tax))
    assert float(tax.value) == pytest.approx(2.0, abs=1e-6)
    with pytest.warns(ModelWarning, match="determines var"):
        solved([firm], [sold <= 1])
    assert float(sold.value) <= 1 + 1e-6


@pytest.mark.parametrize(
    ("goal", "rows"),
    [
        (lambda x, y: x, lambda x, y: [x >= y + 2, x <= y + 1]),
        (lambda x, y: -x + y, lambda x, y: [x >= y]),
    ],
    ids=["infeasible", "unbounded"],
)
def test_a_follower_without_an_optimum_is_infeasible(goal, rows):
    """An infeasible or unbounded program has no optimality conditions: the model is infeasible, with a proof."""
    x, y = cp.Variable(), cp.Variable()
    best = optimal(cp.Problem(cp.Minimize(goal(x, y)), rows(x, y)), over=[x])
    problem = cp.Problem(cp.Minimize(0), [best, y == 1])
    problem.solve(method="LCP")
    assert problem.status == "infeasible"
    assert best.dual_value == [None] * len(best.dual_value)
    with pytest.raises(ValueError, match="no values"):
        best.gap()


def test_parameters_move_an_equilibrium_as_its_derivative_states():
    """By capacity and cost: derivative agrees with solves, trace with a piecewise affine path."""
    x, y = cp.Variable(nonneg=True), cp.Variable(nonneg=True)
    cap, cost = cp.Parameter(value=2.0), cp.Parameter(value=1.0)
    price = 10 - x - y - cost
    agents = [
        optimal(cp.Problem(cp.Maximize(cp.multiply(price, x)), [x <= cap]), over=[x]),
        optimal(cp.Problem(cp.Maximize(cp.multiply(price, y))), over=[y]),
    ]
    problem = solved(agents)
    np.testing.assert_allclose([x.value, y.value], [2.0, 3.5])
    change = derivative(problem).jvp({cap: 1.0, cost: 0.5})
    np.testing.assert_allclose([change[x], change[y]], [1.0, -0.75])
    path = trace(problem, cap, start=0.0, stop=5.0)
    np.testing.assert_allclose(path.value(y, [0.0, 1.0, 3.0, 4.0]), [4.5, 4.0, 3.0, 3.0])
    cap.value = 5.0
    solved(agents)
    np.testing.assert_allclose([x.value, y.value], [3.0, 3.0])
    assert float(agents[0].dual_value[0]) == 0.0


def test_bounds_of_decisions_may_be_parameters_and_attributes():
    """The tightest of an attribute with a parameter, of a constraint on one entry and of a constraint on all."""
    low, high = cp.Parameter(2, value=[0.5, 1.5]), cp.Parameter(nonneg=True, value=3.0)
    try:
        x = cp.Variable(2, bounds=[low, 9.0])
    except ValueError:
        pytest.skip("this release of cvxpy takes no parameter as a bound")
    rows = [x[1] >= 2 * high - 4, x <= 2 * high, 0.5 * x[0] >= 0.1, x[0] <= 4]
    best = optimal(cp.Problem(cp.Minimize(cp.sum_squares(x)), rows), over=[x])
    problem = solved([best])
    np.testing.assert_allclose(x.value, [0.5, 2.0])
    assert float(best.dual_value[0]) == pytest.approx(4.0)
    np.testing.assert_allclose(derivative(problem).jvp({high: 1.0, low: np.ones(2)})[x], [1.0, 2.0])
    low.value, high.value = [0.1, 2.5], 3.0
    solved([best])
    np.testing.assert_allclose(x.value, [0.2, 2.5])
    assert [float(best.dual_value[k]) for k in (0, 2)] == pytest.approx([0.0, 0.8])


def test_an_agent_is_copied_and_pickled():
    """The problem that pickle returns has the same solution."""
    sold = [cp.Variable(nonneg=True) for _ in range(2)]
    problem = cp.Problem(cp.Minimize(0), cournot(2, sold, 10.0, 1.0, [1.0, 1.0]))
    for twin in (problem, pickle.loads(pickle.dumps(problem)), problem.copy()):
        twin.solve(method="LCP")
        values = [float(one.value) for one in twin.variables() if one.attributes["nonneg"]]
        assert values == pytest.approx([3.0, 3.0])


def test_a_smooth_terms_convexity_uses_the_signs_of_others():
    """The term y exp(x) is convex for y ≥ 0, which an attribute, a constraint outside or another program states."""
    for place in ("attribute", "outside", "program"):
        x, y = cp.Variable(value=0.0), cp.Variable(nonneg=place == "attribute", value=1.0)
        rows = [y >= 0] if place == "program" else []
        agents = [
            optimal(cp.Problem(cp.Minimize(cp.multiply(y, cp.exp(x)) - x)), over=[x]),
            optimal(cp.Problem(cp.Minimize((y - 2) ** 2), rows), over=[y]),
        ]
        with warnings.catch_warnings():
            warnings.simplefilter("error", ModelWarning)
            solved(agents, [y >= 0] if place == "outside" else [])
        assert float(x.value) == pytest.approx(-np.log(2.0), abs=1e-6)


# --- random markets and bilevel programs ---


@pytest.mark.quick(1)
@pytest.mark.parametrize("seed", [0, 3, 10])
def test_no_agent_of_a_random_market_could_gain(seed):
    """Quadratic and smooth ones; Clarabel solves the agents' programs of the first and of the last."""
    assert campaign.market(seed) == ""


@pytest.mark.full
def test_many_random_markets_and_bilevel_programs_have_no_fault():
    """A tenth of the campaign, with proofs."""
    assert list(campaign.faults(range(20), range(6))) == []


def test_a_gap_is_measured_at_values_that_the_user_sets():
    """The least value of |x − 1| + x²/2 is 1/2: at 3 the gain is 6, at −1 it is 2; violations count."""
    x = cp.Variable()
    best = optimal(cp.Problem(cp.Minimize(cp.abs(x - 1) + x**2 / 2), [cp.abs(x) <= 2]), over=[x])
    with pytest.raises(ValueError, match="no values"):
        best.gap()
    for value, gain in ((-1.0, 2.0), (3.0, 6.0), (1.0, 0.0)):
        x.value = value
        assert best.gap() == pytest.approx(gain, abs=1e-6)
    bounded = cp.Variable(nonneg=True)
    other = optimal(cp.Problem(cp.Minimize(bounded)), over=[bounded])
    bounded.save_value(np.array(-0.5))
    assert other.gap() == pytest.approx(0.5, abs=1e-6)


@pytest.mark.quick(2)
@pytest.mark.parametrize("margin", [0.0, 4e-16, 1.8e-15, -1.8e-15, 1e-10, 0.1, -0.1])
@pytest.mark.parametrize("form", ["one", "chain", "kink"])
def test_a_trader_with_constant_returns_gains_nothing_by_rounding(form, margin):
    """A margin at the rounding level of its prices gains 0; a tenth gains without limit, or its loss at 1.5 units."""
    price, made = cp.Variable(value=2 + margin), cp.Variable(2, nonneg=True, value=[1.5, 3.0])
    profit, rows = {
        "one": (cp.multiply(price - 2, made[0]), []),
        "chain": (cp.multiply(price, made[0]) - made[1], [made[1] >= 2 * made[0]]),
        "kink": (cp.multiply(price, made[0]) - 2 * cp.abs(made[0]), [made[1] == 3]),
    }[form]
    gap = optimal(cp.Problem(cp.Maximize(profit), rows), over=[made]).gap()
    expected = np.inf if margin == 0.1 else -1.5 * min(margin, 0.0)
    assert gap == pytest.approx(expected, abs=1e-7)


# --- messages ---


def agent(cost: Any, *rows: Any, **given: Any) -> Any:
    """Return the minimization of one agent."""
    return optimal(cp.Problem(cp.Minimize(cost), list(rows)), **given)


@refusals(r"""
solved([agent((x - y) ** 2, over=[x])]) → list them in over=
agent(x**2, over=[y]) → not a variable of the program
agent(x**2, over=[2 * x]) → needs variables or entries of them
agent(x**2, over=[]) → over must be
optimal(x**2, over=[x]) → write cp.Problem
solved([agent(x, cp.SOC(y, cp.hstack([x, 1])), over=[x])]) → second-order cone as cp.sum_squares
solved([agent(x, agent(x * y, over=[y]), over=[x])]) → .EPEC. are not supported; keep one leader
agent(x, over=None) → list of variables
agent(x, over=[x], shared=None) → list of constraints
agent(x, over=np.array(1.0)) → list of variables
agent(x, over=[x], shared=np.array(1.0)) → list of constraints
agent(x**2, over=[x], shared=[x >= 0]) → not in the program; list it in both
solved([agent(cp.power(x, cp.Parameter(value=2)), over=[x])]) → no derivative reaches
solved([agent(x + cp.norm(cp.hstack([x, 1])), over=[x])]) → sum_squares
solved([agent(cp.square(x) - cp.abs(x), over=[x])]) → not smooth
solved([agent(x**2, over=[x]), agent(x**2, over=[x])]) → over=.* twice
agent(cp.sum_squares(z), over=[z, z[0]]) → lists var\d+ twice
agent(cp.sum_squares(z), over=[z[-1], z[2]]) → lists var\d+ twice
agent(cp.sum_squares(z), over=[z, z]) → lists var\d+ twice
agent(x**2, over=[x], check="none") → InvalidOption: local
""")
def test_a_program_that_has_no_conditions_raises_an_error_that_names_the_part(call, words):
    """What is not an agent's program, decision or constraint: when it is stated, or when it is solved."""
    names = {**globals(), "x": cp.Variable(), "y": cp.Variable(), "z": cp.Variable(3)}
    assert_refused(call, words, names, UnsupportedModel)


@pytest.mark.parametrize("attribute", ["integer", "boolean"])
def test_integer_decisions_have_no_conditions(attribute):
    """They belong to the leader."""
    x = cp.Variable(**{attribute: True})
    with pytest.raises(UnsupportedModel, match="no optimality conditions"):
        optimal(cp.Problem(cp.Minimize(x)), over=[x])
    y = cp.Variable(nonneg=True)
    follower = optimal(cp.Problem(cp.Minimize((y - 3 * x) ** 2)), over=[y])
    cp.Problem(cp.Minimize((y - 2) ** 2), [follower]).solve(method="LCP")
    assert float(x.value) == pytest.approx(1.0)


def test_cvxpy_names_the_call_that_solves_agents():
    """Without method="LCP" the model is not convex by cvxpy's rules."""
    x = cp.Variable()
    problem = cp.Problem(cp.Minimize(0), [optimal(cp.Problem(cp.Minimize(x**2)), over=[x])])
    assert not problem.is_dcp()
    with pytest.raises(cp.error.DCPError, match='method="LCP"'):
        problem.solve()


def test_a_parameter_that_makes_a_program_concave_warns_at_the_next_solve():
    """Min c x² + x/10 is convex for c = 1; with c = −1 the same model issues the warning of a new one."""
    c, x = cp.Parameter(value=1.0), cp.Variable(bounds=[-1, 1])
    best = optimal(cp.Problem(cp.Minimize(c * cp.square(x) + 0.1 * x)), over=[x])
    problem = cp.Problem(cp.Minimize(0), [best])
    problem.solve(method="LCP")
    assert float(x.value) == pytest.approx(-0.05, abs=1e-6)
    c.value = -1.0
    with pytest.warns(ModelWarning, match="only necessary"):
        problem.solve(method="LCP")
