"""Complementarity in cvxpy: statuses, values, duals, copies, errors."""

from __future__ import annotations

import copy
import itertools
import pickle
from typing import Any

import cvxpy as cp
import numpy as np
import pytest
import scipy.sparse as sp
from tools.processes import printed_by
from tools.refusals import assert_refused, refusals

from lcp_plugin import LCP, ModelWarning, UnsupportedModel, box, complements, optimal, solve
from lcp_plugin.modeling.registration import is_complementarity_problem, model_of_constraints

M = np.array([[4.0, -1.0, 0.0], [-1.0, 4.0, -1.0], [0.0, -2.0, 4.0]])
Q = np.array([-3.0, 5.0, -4.0])
PLAIN = solve(LCP(M, Q), "pgs", tolerance=1e-13)


def model(*constraints: Any, **options: Any) -> Any:
    problem = cp.Problem(cp.Minimize(0), list(constraints))
    problem.solve(method="LCP", tolerance=1e-12, **options)
    return problem


def test_plain_pair_in_either_order():
    """complements(x >= 0, F >= 0) and the sides exchanged give the LCP's z and w, status, value and statistics."""
    for swap in (False, True):
        x = cp.Variable(3)
        sides = [x >= 0, M @ x + Q >= 0]
        pair = complements(*(reversed(sides) if swap else sides))
        problem = model(pair, algorithm="psor")
        assert (problem.status, problem.value) == ("optimal", 0.0)
        np.testing.assert_allclose(x.value, PLAIN.z, atol=1e-11)
        np.testing.assert_allclose(pair.dual_value, PLAIN.w, atol=1e-10)
        assert problem.solver_stats.solver_name == "LCP"
        assert problem.solver_stats.extra_stats.algorithm == "psor"
        assert problem.solver_stats.num_iters == problem.solver_stats.extra_stats.iterations
        assert pair.violation() < 1e-10
        assert pair.value()


def test_box_and_upper_bounds_have_the_sign_of_a_mixed_problem():
    """F ≤ 0 at an upper bound: box(x, l, u), x <= u with F <= 0 and attributes agree."""
    lower, upper = np.array([-1.0, -np.inf, 0.0]), np.array([0.25, np.inf, 0.25])
    expected = solve(LCP(M, Q, lower=lower, upper=upper), "pgs", tolerance=1e-13)
    assert expected.z[0] == 0.25
    assert expected.w[0] < 0.0
    x = cp.Variable(3)
    pair = complements(box(x, lower, upper), M @ x + Q)
    model(pair)
    np.testing.assert_allclose(x.value, expected.z, atol=1e-11)
    np.testing.assert_allclose(pair.dual_value, expected.w, atol=1e-10)
    y = cp.Variable(3, bounds=[lower, upper])
    model(complements(M @ y + Q, y))
    np.testing.assert_allclose(y.value, expected.z, atol=1e-11)
    u = np.full(3, 0.5)
    above = solve(LCP(M, Q, lower=-np.inf, upper=u), "pgs", tolerance=1e-13)
    z = cp.Variable(3)
    pair = complements(z <= u, M @ z + Q <= 0)
    model(pair)
    np.testing.assert_allclose(z.value, above.z, atol=1e-11)


def test_obstacle_matrix_shaped_and_n_dimensional():
    """complements(X >= psi, F(X) >= 0) with a matrix variable, and with a 3-D one where cvxpy has them."""
    psi = np.array([[1.0, -1.0], [0.5, 0.0], [-2.0, 0.25]])
    X = cp.Variable((3, 2))
    pair = complements(psi <= X, M @ X - 1 >= 0)
    model(pair)
    for k in range(2):
        column = solve(LCP(M, -np.ones(3), lower=psi[:, k]), "pgs", tolerance=1e-13)
        np.testing.assert_allclose(X.value[:, k], column.z, atol=1e-11)
        np.testing.assert_allclose(pair.dual_value[:, k], column.w, atol=1e-10)
    T = cp.Variable((2, 2, 2))
    model(complements(T >= 0, 2 * T - np.arange(8.0).reshape(2, 2, 2) + 3 >= 0))
    np.testing.assert_allclose(
        T.value, np.maximum(np.arange(8.0).reshape(2, 2, 2) - 3, 0) / 2, atol=1e-12
    )


def test_free_variables_take_equations():
    """A free variable with G == 0, paired or as a plain equality row, whose dual value is that variable."""
    for paired in (True, False):
        x, y = cp.Variable(3, nonneg=True), cp.Variable()
        row = cp.sum(x) + 4 * y == 2
        constraints = [complements(x, M @ x + Q - y)]
        constraints.append(complements(y, row) if paired else row)
        model(*constraints)
        assert np.sum(x.value) + 4 * y.value == pytest.approx(2.0)
        assert complements(x, M @ x + Q - y).violation() < 1e-10
        assert row.dual_value == pytest.approx(y.value)


def test_two_affine_sides_get_a_slack():
    """A x + a ≥ 0 ⟂ B x + b ≥ 0 without a variable side is solved through a slack."""
    x = cp.Variable(2)
    A, B = np.array([[3.0, 1.0], [0.0, 2.0]]), np.array([[2.0, 0.5], [0.5, 3.0]])
    pair = complements(A @ x - [1.0, 4.0] >= 0, B @ x - [2.0, 1.0] >= 0)
    assert model_of_constraints([pair]).problem.n == 4
    problem = model(pair, algorithm="npsor", scaling="diagonal", max_iterations=20000)
    assert problem.status == "optimal"
    assert pair.violation() < 1e-9


def test_parameters_dpp_or_not():
    """Parameters in q and in M, also as a product of two, are evaluated at every solve."""
    a, b, c = cp.Parameter(), cp.Parameter(), cp.Parameter(3)
    x = cp.Variable(3)
    problem = cp.Problem(cp.Minimize(0), [complements(x >= 0, (a * b) * (M @ x) + c >= 0)])
    for scale, q in ((1.0, Q), (2.0, -Q)):
        a.value, b.value, c.value = scale, 0.5, q
        problem.solve(method="LCP", tolerance=1e-12)
        np.testing.assert_allclose(
            x.value, solve(LCP(0.5 * scale * M, q), "pgs", tolerance=1e-13).z, atol=1e-10
        )


def test_second_solve_starts_from_the_first():
    """A repeated solve begins at the present values; warm_start=False does not."""
    x = cp.Variable(3)
    problem = cp.Problem(cp.Minimize(0), [complements(x >= 0, M @ x + Q >= 0)])
    problem.solve(method="LCP")
    first = problem.solver_stats.num_iters
    problem.solve(method="LCP")
    assert problem.solver_stats.num_iters < first
    problem.solve(method="LCP", warm_start=False)
    assert problem.solver_stats.num_iters == first


def test_copies_of_a_model_are_models():
    """Copy, deepcopy and pickle of a problem with complementarities solve to the same values."""
    x = cp.Variable(3)
    problem = cp.Problem(cp.Minimize(0), [complements(x >= 0, M @ x + Q >= 0)])
    assert problem.solve(method="LCP", algorithm="pgs", tolerance=1e-12) == 0.0
    for other in (copy.copy(problem), copy.deepcopy(problem), pickle.loads(pickle.dumps(problem))):
        assert is_complementarity_problem(other)
        other.solve(method="LCP", tolerance=1e-12)
        np.testing.assert_allclose(other.variables()[0].value, PLAIN.z, atol=1e-10)
    assert "complements" in str(problem)
    assert not is_complementarity_problem(cp.Problem(cp.Minimize(x[0]), [x >= 0]))


def test_limits_keep_the_values_and_warn():
    """An iteration limit gives user_limit with the best values and a warning that names it."""
    x = cp.Variable(3)
    problem = cp.Problem(cp.Minimize(0), [complements(x >= 0, M @ x + Q >= 0)])
    with pytest.warns(UserWarning, match="MAX_ITERATIONS"):
        problem.solve(method="LCP", algorithm="npgs", max_iterations=2)
    assert problem.status == "user_limit"
    assert x.value is not None


def test_divergence_is_a_solver_error_with_advice():
    """A run that diverges raises cvxpy's SolverError with our advice."""
    x = cp.Variable(2)
    problem = cp.Problem(
        cp.Minimize(0), [complements(x >= 0, np.array([[1.0, -9.0], [-9.0, 1.0]]) @ x - 1 >= 0)]
    )
    with pytest.raises(cp.error.SolverError, match="DIVERGED"):
        problem.solve(method="LCP", algorithm="npgs")


def test_a_proved_lack_of_solutions_is_a_status_with_its_proof():
    """A model without solution is infeasible for cvxpy and has a proof but no values; then q may change."""
    x, q = cp.Variable(2), cp.Parameter(2, value=[-1.0, -1.0])
    inner = x >= 0
    pair = complements(inner, np.array([[0.0, 1.0], [0.0, 0.0]]) @ x + q >= 0)
    problem = cp.Problem(cp.Minimize(0), [pair])
    assert problem.solve(method="LCP") == np.inf
    assert problem.status == cp.INFEASIBLE
    assert x.value is None
    assert pair.dual_value is None
    assert inner.dual_value is None
    assert problem.solver_stats.extra_stats.infeasibility.verify()
    q.value = [1.0, 1.0]
    problem.solve(method="LCP")
    assert problem.status == cp.OPTIMAL


def test_plain_solve_names_the_method():
    """A DCPError of cvxpy is raised for problem.solve() without a method, and names it."""
    x = cp.Variable(3)
    problem = cp.Problem(cp.Minimize(0), [complements(x >= 0, M @ x + Q >= 0)])
    with pytest.raises(cp.error.DCPError, match='method="LCP"'):
        problem.solve()


def pair_of(x: Any) -> Any:
    return complements(x >= 0, 2 * x - 1 >= 0)


def with_other_bounds(y: Any) -> Any:
    return complements(y >= -1, 2 * y + cp.sum(y) - 9 >= 0)


@refusals(r"""
model(complements(x >= 0, cp.sum(x) >= 0)) → same shape
model(complements(x >= 0, cp.abs(x) >= 0)) → not smooth
model(complements(cp.sum(x) + 2 * cp.square(x) >= 0, x - 3)) → has no sign
model(pair_of(x), complements(x >= 0, 3 * x - 1 >= 0)) → as many equations
model(complements(x == 0, 2 * x == 1)) → two equalities
model(complements(x[:2] >= 0, 2 * x[:2] - x[2] >= 0)) → 1 unknown without
model(pair_of(x), cp.sum(x) == 1) → as many equations
model(pair_of(cp.Variable(3, integer=True))) → integer
model(pair_of(cp.Variable((2, 2), PSD=True))) → PSD
model(with_other_bounds(cp.Variable(3, nonneg=True))) → other bounds
model(complements(cp.SOC(x[0], x[1:]), x >= 0)) → a cone, and the other is
model(complements(box(x, 0, 1), x == 1)) → needs an expression
model(complements(box(x, 0, 1), x - 3 >= 0)) → F instead of F >= 0
model(complements(x >= 0, M @ x + cp.Parameter(3, name='load') >= 0)) → load
model(complements(1e-200 * x[0] >= 1e200, 1e200 * x[0] - 1 >= 0)) → bound of 1e\+200 <= 1e-200 [*@] .* is .*overflows
""")
def test_models_beyond_complementarity_are_refused(call, words):
    """Models that are not complementarity problems raise errors with the remedy."""
    assert_refused(call, words, {**globals(), "x": cp.Variable(3)}, UnsupportedModel)


@pytest.mark.filterwarnings("ignore:.*no pair, equation or agent determines")
@pytest.mark.parametrize("goal", [lambda x: 0, lambda x: 0 * cp.sum(x)])
def test_rows_and_bounds_without_a_pair_are_taken_with_any_objective(goal):
    """Rows and bounds without a pair start the search; LCP.from_cvxpy raises an error."""
    x, z, bounded = cp.Variable(2), cp.Variable(2), cp.Variable(nonneg=True)
    rows = np.array([[2.0, 1.0], [1.0, 2.0]]) @ x + [-5.0, 1.0]
    pair = complements(x >= 0, rows >= 0)
    for more in ([z >= 0.2], [bounded <= 3.0], [x[0] + bounded <= 2.6]):
        problem = cp.Problem(cp.Minimize(goal(x)), [pair, *more])
        problem.solve(method="LCP")
        assert problem.status == cp.OPTIMAL
        np.testing.assert_allclose(x.value, [2.5, 0.0], atol=1e-7)
        assert all(np.all(one.violation() <= 1e-7) for one in more)
    excluded = cp.Problem(cp.Minimize(goal(x)), [pair, x[1] >= 0.2])
    excluded.solve(method="LCP")
    assert excluded.status == cp.INFEASIBLE
    with pytest.raises(UnsupportedModel, match="has no pair"):
        LCP.from_cvxpy(cp.Problem(cp.Minimize(0), [pair, z >= 0.2]))


@pytest.mark.quick(1)
@pytest.mark.parametrize(
    "then",
    [
        "import cvxpy as cp, lcp_plugin",
        "import lcp_plugin, cvxpy as cp",
        "import cvxpy as cp, lcp_plugin.modeling",
    ],
)
def test_a_plain_program_is_solved_with_the_method_after_the_imports(then):
    """In either order the imports register the method without loading the models, and no import hook remains."""
    code = (
        f"import sys\nbefore = list(sys.meta_path)\n{then}\nassert sys.meta_path == before\n"
        "print('lcp_plugin.modeling' in sys.modules)\n"
        "x = cp.Variable()\n"
        "print(round(cp.Problem(cp.Minimize((x - 3)**2), [x <= 2]).solve(method='LCP'), 6))"
    )
    assert printed_by(code).split() == [str(then.endswith("modeling")), "1.0"]


ROUND_TRIPS = {
    "plain": LCP(M, Q),
    "box and free": LCP(M, Q, lower=[-np.inf, 0.0, -1.0], upper=[np.inf, np.inf, 2.0]),
    "sparse": LCP(sp.csr_array(M), Q, lower=-1.0),
    "one": LCP([[2.0]], [-3.0]),
    "none": LCP(np.zeros((0, 0)), []),
    "one, upper": LCP([[2.0]], [-3.0], lower=-np.inf, upper=1.0),
}


@pytest.mark.parametrize("name", ROUND_TRIPS)
def test_round_trip_through_cvxpy(name):
    """from_cvxpy(to_cvxpy(LCP)) has the same M, q and bounds, and solves to the same z."""
    problem = ROUND_TRIPS[name]
    back = LCP.from_cvxpy(problem.to_cvxpy())
    np.testing.assert_array_equal(back.csr.toarray(), problem.csr.toarray())
    for attribute in ("q", "lower", "upper"):
        np.testing.assert_array_equal(getattr(back, attribute), getattr(problem, attribute))
    stated = problem.to_cvxpy()
    stated.solve(method="LCP", tolerance=1e-12)
    if problem.n:
        np.testing.assert_allclose(
            stated.variables()[0].value, solve(problem, "pgs", tolerance=1e-13).z, atol=1e-10
        )


# --- Which side is the variable ------------------------------------------------------------------------------------


@pytest.mark.parametrize("swap", [False, True])
def test_diagonal_functions_are_not_taken_for_variables(swap):
    """If F is a multiple of one unknown, both orders of the arguments are equivalent."""
    lower, upper = np.array([0.0, -1.0, 0.5]), np.array([1.0, np.inf, 0.75])
    d, q = np.array([2.0, 3.0, 4.0]), np.array([-1.0, 6.0, -8.0])
    expected = solve(LCP(np.diag(d), q, lower=lower, upper=upper), "pgs", tolerance=1e-13)
    plain = solve(LCP(np.diag(d), q), "pgs", tolerance=1e-13)

    def pair(first, second):
        return complements(second, first) if swap else complements(first, second)

    x, y = cp.Variable(3), cp.Variable(3, nonneg=True)
    z, s = cp.Variable(3, bounds=[lower, upper]), cp.Variable(nonneg=True)
    pairs = [
        pair(x >= 0, cp.multiply(d, x) + q),
        pair(y, cp.multiply(d, y) + q),
        pair(z, cp.multiply(d, z) + q),
    ]
    pairs.append(pair(s, 2 * s - 1))
    for one in pairs:
        model(one)
        assert one.violation() < 1e-10
    np.testing.assert_allclose(x.value, plain.z, atol=1e-11)
    np.testing.assert_allclose(y.value, plain.z, atol=1e-11)
    np.testing.assert_allclose(z.value, expected.z, atol=1e-11)
    assert s.value == pytest.approx(0.5)
    w = cp.Variable(3, nonneg=True)
    model(pair(w, cp.multiply(d, w) + q >= 0))
    np.testing.assert_allclose(w.value, plain.z, atol=1e-11)


def test_violation_is_the_natural_residual_of_any_form():
    """The violation is ‖x − mid(l, u, x − F)‖ at any values, for attributes and slices."""
    x = cp.Variable(3, nonneg=True)
    x.value = np.array([0.5, 0.0, 2.0])
    F = M @ x + Q
    natural = np.abs(np.minimum(x.value, M @ x.value + Q))
    for first, second, expected in ((x, F, natural), (F, x, natural), (x[:2], F[:2], natural[:2])):
        assert complements(first, second).violation() == pytest.approx(expected.max())
    y = cp.Variable(3)
    y.value = np.array([0.5, -2.0, 3.0])
    inside = np.clip(y.value - (M @ y.value + Q), -1.0, 1.0)
    assert complements(box(y, -1, 1), M @ y + Q).violation() == pytest.approx(
        np.abs(y.value - inside).max()
    )
    top = cp.Variable(nonpos=True)
    top.value = np.array(0.0)
    assert [complements(top, F).violation() for F in (top - 1, top + 1)] == [0.0, 1.0]


def test_violation_of_a_pair_whose_variable_has_another_pair():
    """The other side is the variable in the model, but not in the pair alone."""
    share, price = cp.Variable(bounds=[0, 1]), cp.Variable()
    pairs = [complements(share, share - 0.5), complements(share, price >= 0)]
    model(*pairs)
    assert [pair.violation() for pair in pairs] == [0.0, 0.0]


def bounded_beside_a_box() -> Any:
    x, w = cp.Variable(3), cp.Variable(3, nonneg=True, name="w")
    return [complements(box(x, 0, 1), w), w == cp.multiply([2.0, 3.0, 4.0], x) - 1]


def slack_pair_of_bounded() -> Any:
    w = cp.Variable(2, nonneg=True, name="w")
    A, B = np.array([[3.0, 1.0], [0.0, 2.0]]), np.array([[2.0, 1.0], [1.0, 3.0]])
    return [complements(A @ w - 1 >= 0, B @ w - 2 >= 0)]


def defined_below_its_bound() -> Any:
    x, w = cp.Variable(nonneg=True), cp.Variable(2, nonneg=True, name="w")
    return [complements(x, 2 * x - 1), w[1] == 3, w[0] == x - 1]


@pytest.mark.parametrize(
    ("make", "status"),
    [
        (bounded_beside_a_box, "optimal"),
        (slack_pair_of_bounded, "optimal"),
        (defined_below_its_bound, "infeasible"),
    ],
)
def test_bounds_that_no_pair_states_hold(make, status):
    """Solutions satisfy bounds without a pair, or none exists; from_cvxpy names the entry."""
    problem = cp.Problem(cp.Minimize(0), make())
    problem.solve(method="LCP")
    assert problem.status == status
    if status == "optimal":
        assert (problem.var_dict["w"].value >= -1e-8).all()
        assert max(one.violation() for one in make()[:0] + problem.constraints[:1]) <= 1e-6
    with pytest.raises(UnsupportedModel, match=r"^w\[0\] has bounds that no pair implies"):
        LCP.from_cvxpy(problem)


def pair_of_named(has_bound_x: bool, has_bound_w: bool) -> tuple[Any, Any, Any]:
    x = cp.Variable(2, nonneg=has_bound_x, name="x")
    w = cp.Variable(2, nonneg=has_bound_w, name="w")
    return x, w, w == np.array([[2.0, 1.0], [1.0, 2.0]]) @ x + [-5.0, 1.0]


@pytest.mark.parametrize(
    ("has_bound_x", "state"),
    [
        (False, lambda x, w: complements(w >= 0, x >= 0)),
        (False, lambda x, w: complements(x >= 0, w)),
        (True, lambda x, w: complements(w, x)),
    ],
)
def test_a_bound_that_a_pair_implies_may_be_stated(has_bound_x, state):
    """W == M @ x + q with w declared nonneg is the model that it is without the attribute."""
    for has_bound_w in (False, True):
        x, w, equation = pair_of_named(has_bound_x, has_bound_w)
        problem = cp.Problem(cp.Minimize(0), [equation, state(x, w)])
        problem.solve(method="LCP", tolerance=1e-12)
        assert problem.status == "optimal"
        np.testing.assert_allclose([x.value, w.value], [[2.5, 0.0], [0.0, 3.5]], atol=1e-9)


@pytest.mark.parametrize(
    ("value", "expected"), [(lambda h: 0.0, [2.5, 0.0, 0.0]), (lambda h: h[0] + 1, [2.5, 0.0, 3.5])]
)
def test_a_bound_that_an_equation_implies_may_be_stated(value, expected):
    """complements(h[:2], …) with the rest of h given by an equation that keeps its bounds; each way to write it."""
    for write in (lambda h: h, lambda h: h >= 0):
        h = cp.Variable(3, nonneg=True)
        F = np.array([[2.0, 1.0], [1.0, 2.0]]) @ h[:2] + [-5.0, 1.0]
        cp.Problem(cp.Minimize(0), [complements(write(h[:2]), F), h[2] == value(h)]).solve(
            method="LCP", tolerance=1e-12
        )
        np.testing.assert_allclose(h.value, expected, atol=1e-9)


@pytest.mark.parametrize("sense", [cp.Minimize, cp.Maximize])
def test_an_equation_outside_the_bounds_is_infeasible(sense):
    """h[2] == −1 with h nonneg has no solution: +∞ of Minimize, −∞ of Maximize, with a proof."""
    h = cp.Variable(3, nonneg=True, name="h")
    problem = cp.Problem(sense(0), [complements(h[:2], h[:2] - 1), h[2] == -1])
    assert problem.solve(method="LCP") == (np.inf if sense is cp.Minimize else -np.inf)
    assert problem.status == "infeasible"
    assert problem.solver_stats.extra_stats.verify()


def test_pairing_does_not_depend_on_the_order_of_constraints():
    """A variable in two pairs: each order has the one solution y = 1, x = 0 of y ⟂ x, y ⟂ 2 x + y − 1."""
    x, y = cp.Variable(), cp.Variable()
    pairs = [complements(y >= 0, x >= 0), complements(y >= 0, 2 * x + y - 1 >= 0)]
    for order in (pairs, pairs[::-1]):
        cp.Problem(cp.Minimize(0), order).solve(method="LCP", tolerance=1e-12)
        assert all(pair.violation() <= 1e-9 for pair in pairs)
        assert (float(y.value), float(x.value)) == pytest.approx((1.0, 0.0), abs=1e-9)
    chain = [cp.Variable() for _ in range(4)]
    links = [complements(a >= 0, b >= 0) for a, b in itertools.pairwise(chain)]
    links.append(complements(chain[3] - 1 >= 0, chain[0] + chain[3] - 2 >= 0))
    for order in (links, links[::-1], [links[2], links[0], links[3], links[1]]):
        cp.Problem(cp.Minimize(0), order).solve(method="LCP")
        assert max(pair.violation() for pair in links) <= 1e-6


@pytest.mark.parametrize("other", [lambda x: x - 1, lambda x: -x + 1])
def test_a_forgotten_nonneg_is_warned_of(other):
    """A pair complements(x, F) without bounds of x means F == 0, with a warning at the call."""
    x = cp.Variable(2, name="x")
    problem = cp.Problem(cp.Minimize(0), [complements(x, other(x))])
    with pytest.warns(
        ModelWarning, match=r"x has no bounds: complements\(x, F\) means F == 0"
    ) as caught:
        problem.solve(method="LCP")
    assert [warning.filename for warning in caught] == [__file__]
    with pytest.warns(ModelWarning) as caught:
        cp.Problem(cp.Minimize(0), [complements(other(x), x)]).solve(method="LCP")
    assert [warning.filename for warning in caught] == [__file__]


@pytest.mark.parametrize(
    "state",
    [
        lambda x: complements(x, x - 1 == 0),
        lambda x: complements(x >= 0, x - 1),
        lambda x: complements(box(x, -np.inf, np.inf), x - 1),
        lambda x: x == 1,
    ],
)
def test_what_is_meant_is_not_warned_of(state):
    """A free variable with == 0, a box, a bound or infinite bounds raise no warning."""
    x = cp.Variable(2)
    assert cp.Problem(cp.Minimize(0), [state(x)]).solve(method="LCP") == 0.0
    free = cp.Variable(2, bounds=[-np.inf, np.inf])
    assert cp.Problem(cp.Minimize(0), [complements(free, free - 1)]).solve(method="LCP") == 0.0


def test_upper_bound_opposite_an_expression_has_the_sign_of_the_readme():
    """complements(x <= 1, F): at the upper bound F ≤ 0; so with any multiple of x, and for violation()."""
    for side in (lambda x: x <= 1, lambda x: 3 - 3 * x >= 0):
        x = cp.Variable()
        pair = complements(side(x), x - 3)
        model(pair)
        assert x.value == pytest.approx(1.0)
        assert pair.violation() <= 1e-9


def test_parameters_of_a_box_belong_to_the_problem():
    """A parameter as a bound is among problem.parameters() and is evaluated at every solve."""
    x, low = cp.Variable(2), cp.Parameter(value=-1.0)
    problem = cp.Problem(cp.Minimize(0), [complements(box(x, low, 2), x + 5)])
    assert [parameter.id for parameter in problem.parameters()] == [low.id]
    for value in (-1.0, 0.5):
        low.value = value
        problem.solve(method="LCP")
        np.testing.assert_allclose(x.value, value)


@refusals(r"""
p.solve(method='LCP', gp=True) → has no option gp
p.solve(method='LCP', nlp=True) → has no option nlp
cp.Problem(cp.Minimize(cp.sum(x)), p.constraints).solve(method='LCP', algorithm='newton') → newton.*leave it out
p.solve(method='LCP', solver='OSQP') → solver
LCP.from_cvxpy(3) → cvxpy problem is needed, got int
LCP.from_cvxpy(cp.Problem(cp.Minimize(cp.sum(x)), [pair_of(x)]))
    → objective .*sum.*solve\(method=\"LCP\"\).* best of all solutions
model(complements(box(x, cp.Variable(value=0.5), 2), x - 1)) → bound
model(complements(box(x, 'a', 2), x - 1)) → bound
model(complements(box(x, np.nan, 2), x - 1)) → bound
model(complements(box(x, 1j, 2), x - 1)) → bound
complements(None, x) → None
complements(x >= 0, -np.ones(3) >= 0) → Booleans, \[False False False\].*Constant
complements([True, False, True], x) → Booleans
box(None, 0, 1) → not a cvxpy expression
complements(p.constraints[0], x) → is complements\(.*\); write <=
""")
def test_misuse_is_told(call, words):
    """Unsupported methods, flags and objects raise errors with a message."""
    x = cp.Variable(3, value=np.zeros(3))
    names = {**globals(), "x": x, "p": cp.Problem(cp.Minimize(0), [pair_of(x)])}
    assert_refused(call, words, names, UnsupportedModel)


@pytest.mark.parametrize("order", [1, -1])
def test_one_expression_in_two_boxes_keeps_the_bounds_of_each(order):
    """Two pairs of the same expression object with different bounds hold both, for variables and sums of them."""
    x, u = cp.Variable(), cp.Variable()
    pairs = [complements(box(x, 0, 1), x - 3), complements(box(x, 0, 2), x + u - 5)]
    problem = model(*pairs[::order])
    assert problem.status == "optimal"
    assert (float(x.value), float(u.value)) == pytest.approx((1.0, 4.0))
    a, b, cap = cp.Variable(2), cp.Variable(2), cp.Parameter(value=1.0)
    f = a + 2 * b
    pairs += [
        complements(box(f, 0, cap), a - np.array([3.0, -1.0])),
        complements(box(f, -1, 4), b - np.array([2.0, 0.1])),
    ]
    problem = model(*pairs[2:][::order])
    values = [
        (f.value, a.value - [3.0, -1.0], 0.0, 1.0),
        (f.value, b.value - [2.0, 0.1], -1.0, 4.0),
    ]
    for z, w, low, high in values:
        assert np.abs(z - np.clip(z - w, low, high)).max() <= 1e-10
    assert max(pair.violation() for pair in pairs) <= 1e-10


def test_a_variable_of_several_pairs_is_warned_of():
    """Five pairs of x next to four free unknowns are solved, and a warning names x; without them the error does."""
    x, u = cp.Variable(name="x"), [cp.Variable() for _ in range(4)]
    pairs = [complements(x >= 0, x - 1 >= 0)]
    pairs += [complements(x >= 0, x + one - k >= 0) for k, one in enumerate(u)]
    with pytest.warns(ModelWarning, match="x is the variable of 5 pairs"):
        assert model(*pairs).status == "optimal"
    with pytest.raises(UnsupportedModel, match="x is the variable of 2 pairs"):
        model(complements(x >= 0, x - 1 >= 0), complements(x >= 0, x - 2 >= 0))


def test_an_equation_that_fixes_a_variable_of_a_pair_is_named():
    """Next to a pair of x, x[1] == 2 has no unknown of its own: the advice is a box, not a market."""
    x = cp.Variable(3, name="x")
    with pytest.raises(UnsupportedModel, match=r"box\(x\[1\], 2, 2\)"):
        model(complements(x >= 0, x - 1 >= 0), 3 * x[1] == 6)
    model(complements(box(x, [0, 2, 0], [np.inf, 2, np.inf]), x - 1))
    np.testing.assert_allclose(x.value, [1.0, 2.0, 1.0])


@pytest.mark.parametrize(("sign", "status"), [(-1.0, "infeasible"), (1.0, "optimal")])
def test_a_market_without_a_pair_is_named(sign, status):
    """An unknown with bounds and without a pair is any value, and a warning names it, whether the run fails or not."""
    x = cp.Variable(2, name="x", nonneg=True)
    with pytest.warns(ModelWarning, match=rf"{status}: .*without a complementarity \(x\[1\]\)"):
        model(complements(x[0] >= 0, sign * cp.sum(x) - 1 >= 0))


def test_keywords_of_cvxpys_compilation_are_taken():
    """A pair, an equilibrium with an objective and a program accept what every solver of cvxpy accepts."""
    x = cp.Variable(2, nonneg=True)
    pair = complements(x >= 0, x - np.array([1.0, -1.0]) >= 0)
    models = {
        "pair": cp.Problem(cp.Minimize(0), [pair]),
        "equilibrium": cp.Problem(cp.Minimize(cp.sum_squares(x)), [pair]),
        "program": cp.Problem(cp.Minimize(cp.sum_squares(x - np.array([1.0, -1.0])))),
    }
    for model in models.values():
        for given in (
            {"canon_backend": "SCIPY"},
            {"enforce_dpp": True},
            {"ignore_dpp": True},
            {"bibtex": False, "canon_backend": None},
        ):
            x.value = None
            model.solve(method="LCP", **given)
            np.testing.assert_allclose(x.value, [1.0, 0.0], atol=1e-6)
    p = cp.Parameter(value=1.0)
    without_dpp = cp.Problem(cp.Minimize(cp.sum_squares(p * p * x - 1)))
    with pytest.raises(cp.error.DPPError):
        without_dpp.solve(method="LCP", enforce_dpp=True)


ATTRIBUTES: dict[str, tuple[dict[str, Any], float]] = {  # and the point nearest to t
    "nonneg": ({"nonneg": True}, 0.0),
    "pos": ({"pos": True}, 0.0),
    "nonpos": ({"nonpos": True}, 0.0),
    "neg": ({"neg": True}, 0.0),
    "bounds": ({"bounds": [-0.5, 0.5]}, 0.5),
    "symbolic bounds": ({"bounds": [cp.Constant(-0.5), cp.Constant(0.5)]}, 0.5),
}


@pytest.mark.quick(1)
@pytest.mark.parametrize("name", ATTRIBUTES)
def test_the_attributes_of_variables_are_bounds_in_every_kind_of_model(name):
    """The point nearest to t is t or the bound between: as a pair, an agent, a program and an equilibrium."""
    given, end = ATTRIBUTES[name]
    for t in (1.0, -1.0):
        is_inside = name in ("nonneg", "pos") if t > 0 else name in ("nonpos", "neg")
        expected = t if is_inside else np.sign(t) * end
        u = cp.Variable(**given)
        distance = cp.square(u - t)
        models = {
            "pair": cp.Problem(cp.Minimize(0), [complements(u, u - t)]),
            "agent": cp.Problem(
                cp.Minimize(0), [optimal(cp.Problem(cp.Minimize(distance)), over=[u])]
            ),
            "program": cp.Problem(cp.Minimize(distance)),
            "equilibrium": cp.Problem(cp.Minimize(distance), [complements(u, u - t)]),
        }
        for kind, model in models.items():
            u.value = None
            model.solve(method="LCP")
            assert (kind, float(u.value)) == (kind, pytest.approx(expected, abs=1e-5))


def market(signs: dict[str, Any]) -> cp.Problem:
    """A market of 2 plants and 3 places, 950 and 900 units; a sign of each row of the three constraints."""
    x, r, p = cp.Variable((2, 3), name="ship"), cp.Variable(2, name="rent"), cp.Variable(3)
    cost = 0.09 * np.array([[2.5, 1.7, 1.8], [2.5, 1.8, 1.4]])
    sides = {
        "capacity": (r, np.array([350.0, 600.0]) - cp.sum(x, axis=1)),
        "profit": (x, cp.reshape(r, (2, 1), order="C") + cost - cp.reshape(p, (1, 3), order="C")),
        "balance": (p, cp.sum(x, axis=0) - np.array([325.0, 300.0, 275.0]) + p / 100),
    }
    pairs = []
    for name, (first, second) in sides.items():
        sign = np.broadcast_to(np.array(signs.get(name, 1.0)), second.shape)
        pairs.append(complements(first >= 0, cp.multiply(sign, second) >= 0))
        if hasattr(pairs[-1], "set_label"):
            pairs[-1].set_label(name)
    return cp.Problem(cp.Minimize(0), pairs)


@pytest.mark.skipif(not hasattr(cp.constraints.Zero, "set_label"), reason="cvxpy 1.9 has labels")
@pytest.mark.parametrize(
    ("signs", "words"),
    [
        ({}, ""),
        ({"capacity": [1.0, -1.0]}, "the sign of capacity[1] may be wrong: its terms"),
        ({"capacity": -1.0}, "the sign of capacity, in all 2 rows, may be wrong"),
        ({"profit": -1.0}, ""),  # and so would capacity and balance be
    ],
    ids=["right", "one row", "a constraint", "ambiguous"],
)
def test_a_constraint_with_the_wrong_sign_in_all_rows_is_named(signs, words):
    """A rule typed once for all plants is named as one constraint; a right model has no such line."""
    model = market(signs)
    model.solve(method="LCP")
    told = model.solver_stats.extra_stats.explain()
    assert words in told
    assert ("may be wrong" in told) == bool(words)
