"""`certify`: verdicts for right solutions, for wrong solutions, and for other problem classes."""

from __future__ import annotations

import re
from fractions import Fraction
from typing import Any

import cvxpy as cp
import numpy as np
import pytest
import scipy.sparse as sp
from campaigns import certify as certify_campaign
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles import exact
from tools.refusals import assert_refused, refusals

from lcp_plugin import NonlinearProblem, QuadraticProgram, Status, certify, solve
from lcp_plugin.problems.programs.certification import SMALL
from lcp_plugin.problems.programs.solution import QPSolution
from lcp_plugin.proofs.bounds import constrained_curvature
from lcp_plugin.strategies import convex_qps

INF = np.inf


SIMPLE = QuadraticProgram([[2, 0], [0, 2]], [-2, -4], G=[[1, 1]], h=[2])


# --- Right and wrong answers to programs --------------------------------------------------------------------------


@pytest.mark.quick(1)
@pytest.mark.parametrize("kind", certify_campaign.KINDS)
def test_right_answers_are_proved_and_wrong_ones_never(kind):
    """Programs of each class: right points are proved, wrong points never are."""
    off = []
    for seed in range(5):
        rng = np.random.default_rng([seed, 20])
        case = certify_campaign.case(kind, rng, 7)
        for multipliers in (None, case.solution):
            result = certify(case.program, case.x, multipliers)
            assert result.verdict == "proved", result
            assert not certify_campaign.faults(case, case.x, result)
        for name, (x, multipliers) in certify_campaign.planted(case, rng).items():
            result = certify(case.program, x, multipliers)
            assert not certify_campaign.faults(case, x, result), (name, result)
            may_be_proved = (
                name not in certify_campaign.MULTIPLIERS
                and certify_campaign.is_near_optimal(case, x)
            )
            assert result.verdict != "proved" or may_be_proved, (name, result)
            off += [result.verdict] if name == "off by 1e-2" else []
    assert off.count("disproved") >= 4


@settings.get_profile("few")
@given(convex_qps())
def test_bounds_hold_for_exact_answers(drawn):
    """Lower ≤ the exact minimum ≤ upper, of programs with exact answers of any kind."""
    program, answer = drawn
    x = np.array([float(value) for value in answer.x])
    result = certify(program, x)
    assert result.verdict != "disproved"
    assert result.lower is None or Fraction(result.lower) <= answer.objective
    assert result.upper is None or Fraction(result.upper) >= answer.objective


def test_an_optimal_verdict_has_its_reason():
    """The reason of an optimal verdict states the bound and the argument of the proof."""
    result = certify(SIMPLE, [0.5, 1.5])
    assert re.fullmatch(
        r"no feasible x has an objective lower than this one's by more than \S+, which the multipliers prove by weak "
        r"duality: P is positive definite",
        result.reason,
    )


@pytest.mark.parametrize(
    ("x", "reason"),
    [
        ([0.5, 1.51], "a constraint is violated by 0.01"),
        ([0.4, 1.4], "a feasible point has the objective -4.5, below"),
    ],
)
def test_a_disproved_verdict_has_its_reason(x, reason):
    """A violated constraint; a better feasible point."""
    result = certify(SIMPLE, x)
    assert result.verdict == "disproved"
    assert result.reason.startswith(reason)


def test_a_value_that_no_feasible_point_has_is_disproved():
    """A violation within the tolerance that buys much more than the tolerance in the objective."""
    program = QuadraticProgram([[1.0]], [-1e3], upper=1.0)
    # relative to |c x| + xᵀP x
    assert certify(program, [1.0 + 9e-7], tolerance=1e-6).verdict == "proved"
    leaning = QuadraticProgram(None, [-1.0, 0.0], G=[[1.0, 1.0]], h=[1e6], A=[[0.0, 1.0]], b=[1e6])
    result = certify(leaning, [0.5, 1e6], tolerance=1e-6)  # a violation of 5e-7 of the row's terms
    assert result.verdict == "disproved"
    assert "no feasible x is below" in result.reason


TINY = float(np.cos(np.pi / 2))
LEANING = QuadraticProgram(None, [-3, -4], G=[[1, TINY]], h=[1], lower=-10, upper=10)
PUSHED = QuadraticProgram(np.eye(2), [1, 1], G=[[-1, TINY]], h=[-1])
SLOPING = QuadraticProgram([[1, 0], [0, 0]], [0, 1], G=[[1e-5, 1]], h=[-1], lower=-10, upper=10)


@pytest.mark.parametrize(
    ("program", "wrong", "right", "optimum"),
    [
        (LEANING, [0.0, 10.0], [1.0, 10.0], -43.0),
        (PUSHED, [1e6, 1e6], [1.0, -1.0], 1.0),
        (SLOPING, [0.0, -6.5], [0.0, -10.0], -10.0),
    ],
)
def test_one_odd_coefficient_proves_no_point(program, wrong, right, optimum):
    """A coefficient of cos(π/2) or 1e-5 makes nothing small: only the optimum, known in closed form, is proved."""
    assert certify(program, wrong).verdict == "disproved"
    result = certify(program, right)
    assert result.verdict == "proved"
    assert result.lower == pytest.approx(optimum, rel=1e-12)
    assert result.upper == pytest.approx(optimum, rel=1e-12)


def test_multipliers_are_a_pair_or_a_solution():
    """A pair of multipliers (G, A) and a QPSolution have the same verdict."""
    zeros = np.zeros(2)
    for multipliers in (([1.0], []), QPSolution(SIMPLE, [0.5, 1.5], [1.0], [], zeros, zeros)):
        assert certify(SIMPLE, [0.5, 1.5], multipliers).verdict == "proved"


def test_a_second_certify_says_the_same_after_other_points():
    """The verdict on a point and its bounds do not depend on points that were certified before."""
    program = SIMPLE.with_vectors()
    given = [0.5 - 1e-8, 1.5], ([1.0], [])
    before = certify(program, *given)
    assert before.verdict == "proved"
    assert certify(program, [0.0, 0.0]).verdict != "proved"
    again = certify(program, *given)
    assert (again.upper, again.gap, again.reason) == (before.upper, before.gap, before.reason)


def test_multipliers_of_any_sign_prove_no_bound_above_the_minimum(draws):
    """Random multipliers of inequalities, at a right x: the lower bound is not above the exact minimum."""
    for seed in draws(60, 5):
        rng = np.random.default_rng([seed, 21])
        case = certify_campaign.case("definite", rng, 5)
        inequality, equality, *_ = case.multipliers
        given = (inequality + 2.0 * rng.normal(size=inequality.size), equality)
        lower = certify(case.program, case.x, given).lower
        assert lower is None or Fraction(lower) <= case.value


def test_wrong_multipliers_of_a_right_x_are_told():
    """A wrong sign, or a remaining gradient, is reported; the lower and upper bounds stay valid."""
    for wrong in ([-1.0], [0.5]):
        result = certify(SIMPLE, [0.5, 1.5], (wrong, []))
        assert result.verdict == "unproved"
        assert "of the gradient" in result.reason
        assert result.lower == pytest.approx(-4.5, abs=1e-12)


@pytest.mark.parametrize(
    "wrong",
    [
        ([8.0, 7.0, 0.0], [0.0, 0.0], [0.0, 0.0]),
        ([0.5, 0.0, 0.5], [0.0, 0.0], [0.0, 0.0]),
        ([1.0, 0.0, 0.0], [7.0, 0.0], [7.0, 0.0]),
        ([1.0, 0.0, 0.0], [0.0, 7.0], [0.0, 7.0]),
    ],
    ids=[
        "a row with slack",
        "a row without limit",
        "two bounds with slack",
        "a bound that is none",
    ],
)
def test_multipliers_that_cancel_are_wrong_where_nothing_holds(wrong):
    """Multipliers that cancel in the gradient are wrong if their constraints have slack."""
    program = QuadraticProgram(
        [[2, 0], [0, 2]],
        [-2, -4],
        G=[[1, 1], [-1, -1], [1, 1]],
        h=[2, 9, INF],
        lower=[-5.0, -INF],
        upper=9.0,
    )
    assert certify(program, [0.5, 1.5], ([1.0, 0.0, 0.0], [])).verdict == "proved"
    inequality, lower, upper = wrong
    result = certify(program, QPSolution(program, [0.5, 1.5], inequality, [], lower, upper))
    assert result.verdict == "unproved"
    assert "of slack" in result.reason


@pytest.mark.parametrize("tolerance", [1e-6, 1e-3])
def test_a_violation_far_below_the_tolerance_may_buy_everything(tolerance):
    """A small row scale makes the violation of a distant x small, and proves nothing."""
    n = SMALL + 20
    P = sp.diags_array(np.append(1e3, np.ones(n - 1)))
    program = QuadraticProgram(
        P, np.append(-1e3, np.zeros(n - 1)), G=sp.csr_array(([1e-7], ([0], [0])), (1, n)), h=[0]
    )
    x = np.append(1.0, np.zeros(n - 1))  # the minimum of the objective alone, and −500 instead of 0
    assert certify(program, 0.0 * x, ([1e10], [])).verdict == "proved"
    assert certify(program, x, ([0.0], []), tolerance=tolerance).verdict == "disproved"


# --- Numbers at the edge -----------------------------------------------------------------------------------------


def test_an_objective_that_overflows_is_not_proved():
    """An objective of more than the largest double has no bounds: nothing is proved of it, and nothing is warned."""
    steep = QuadraticProgram(
        [[5, -1, -1], [-1, 2, 2], [-1, 2, 2]], [-3.0, 0.0, 1.7e308], lower=[-INF, 0.0, 0.0]
    )
    assert certify(steep, [0.67, 0.33, 1e-4]).verdict == "unproved"
    huge = certify(QuadraticProgram([[4.0]], [1e300]), [2e155], ([], []))
    assert (huge.verdict, huge.gap) == ("unproved", None)


def test_a_row_that_overflows_is_not_met():
    """A row that overflows gives no proof of feasibility and no upper bound."""
    program = QuadraticProgram(np.eye(2), [-1.0, -1.0], G=[[1e308, 1e308]], h=[0.0])
    result = certify(program, [1.0, 1.0])
    assert result.verdict != "proved"
    assert result.upper is None or result.upper >= 0.0


def test_a_row_is_met_only_if_it_is_proved_to_be():
    """A row violated by less than its rounding error in double precision has an excess above 0."""
    row = [
        -348.8201551564181,
        1.908583919254138e-14,
        2.650840420824661e-32,
        513697.1011682231,
        2.0133432009333935e-10,
    ]
    x = [1.0, 1.0, 1.0, 0.0006790385897898772, 1.091599154672567e-09]
    value = sum((Fraction(a) * Fraction(b) for a, b in zip(row, x, strict=True)), Fraction(0))
    program = QuadraticProgram(np.zeros((5, 5)), np.zeros(5), G=[row], h=[0.0])
    assert 0 < value <= Fraction(float(program.constraints.excess(np.array(x))[0]))


def assert_bounds_the_curvature(found: Any, P: np.ndarray, A: np.ndarray) -> None:
    """P + ρ AᵀA − diag(weights) of one row A has no negative minor in fractions."""
    rest, rows = exact.exact_rows(P), exact.exact_rows(A)
    for i in range(len(P)):
        for j in range(len(P)):
            rest[i][j] += Fraction(found.penalty) * rows[0][i] * rows[0][j]
        rest[i][i] -= Fraction(float(found.weights[i]))
    assert all(minor >= 0 for minor in exact.principal_minors(rest))


@pytest.mark.parametrize("row", [[1e-160, 2.8e-162], [5e-324, 0.0], [1e-200, 1e200]])
def test_equations_of_tiny_numbers_give_no_curvature(row):
    """Underflowing squares are not weights: P + ρ AᵀA at rounding level proves no curvature."""
    A, P = np.array([row]), np.diag([1e-16, 0.0])
    assert_bounds_the_curvature(constrained_curvature(P, A), P, A)


@pytest.mark.parametrize("seed", range(4))
def test_the_curvature_on_a_null_space_is_rounded_downwards(seed):
    """P + ρ AᵀA − diag(weights) has nonnegative minors in fractions, for P singular on the null space also."""
    rng = np.random.default_rng(seed)
    for k in range(12):
        n = 2 + k % 3
        half, A = rng.normal(size=(n - 1, n)), rng.normal(size=(1, n))
        if k % 2:  # P is singular on the null space of A
            v = rng.normal(size=n)
            half -= np.outer(half @ v, v) / (v @ v)
            A -= np.outer(A @ v, v) / (v @ v)
        P = half.T @ half
        P = 0.5 * (P + P.T)
        found = constrained_curvature(P, A)
        if found.penalty:
            assert_bounds_the_curvature(found, P, A)


# --- Claims ------------------------------------------------------------------------------------------------------


def test_claims_are_proved_by_proofs_and_disproved_by_points():
    """Infeasible and unbounded, right and wrong."""
    infeasible = QuadraticProgram([[0.0]], [1.0], G=[[1.0], [-1.0]], h=[0.0, -1.0])
    unbounded = QuadraticProgram([[0.0]], [1.0], upper=1.0)
    verdicts = [
        [certify(program, claim=claim).verdict for claim in ("infeasible", "unbounded")]
        for program in (infeasible, unbounded, SIMPLE)
    ]
    assert verdicts == [
        ["proved", "disproved"],
        ["disproved", "proved"],
        ["disproved", "disproved"],
    ]
    deep = certify(QuadraticProgram([[1e-200]], [1e200]), claim="unbounded")  # at least −5e599
    assert (deep.verdict, deep.claim, deep.lower) == ("unproved", "unbounded", None)
    answer = certify(unbounded, [0.0])
    assert (answer.verdict, answer.lower) == ("disproved", None)
    assert answer.reason.startswith("the program is unbounded")
    assert certify(infeasible, [0.5]).verdict == "disproved"


@pytest.mark.parametrize("seed", range(6))
def test_a_claim_is_proved_after_a_solve_as_before(seed):
    """The proof of a compiled solve may be rounded, but "infeasible" is proved exactly."""
    rng = np.random.default_rng(seed)
    G, h = rng.normal(size=(40, 6)), np.full(40, -1.0)
    program = QuadraticProgram(np.eye(6), np.zeros(6), G, h)
    result = solve(program)
    assert result.status is Status.INFEASIBLE
    assert certify(program, claim="infeasible").verdict == "proved"
    assert certify(result).verdict == "proved"
    assert certify(program, result).claim == "infeasible"


def test_a_result_claims_what_its_status_says():
    """`certify` of a result without a minimum proves that there is none."""
    contradicting = QuadraticProgram(
        np.eye(2), [1.0, 1.0], A=[[1.0, 1.0], [1.0, 1.0]], b=[1.0, 2.0]
    )
    falling = QuadraticProgram(None, [1.0, 1.0])
    for program, claim in (
        (contradicting, "infeasible"),
        (falling, "unbounded"),
        (SIMPLE, "optimal"),
    ):
        found = certify(solve(program))
        assert (found.verdict, found.claim) == ("proved", claim)


@pytest.mark.parametrize("miss", [1e-7, 1e-5])
def test_optimal_and_infeasible_are_never_both_proved(miss):
    """Constraints inconsistent by less than the tolerance pass; else "infeasible" is proved."""
    program = QuadraticProgram([[1.0]], [0.0], G=[[1.0], [-1.0]], h=[1.0, -1.0 - miss])
    claimed, answered = certify(program, claim="infeasible"), certify(program, [1.0 + miss / 2.0])
    assert (claimed.verdict, answered.verdict) == (
        ("unproved", "proved") if miss < 1e-6 else ("proved", "disproved")
    )
    assert ("only" in claimed.reason) == (miss < 1e-6)


# --- cvxpy -------------------------------------------------------------------------------------------------------


def models() -> dict[str, cp.Problem]:
    """Problems with constraints on the user's variables and with auxiliary ones."""
    rng = np.random.default_rng(3)
    A, b = rng.normal(size=(20, 4)), rng.normal(size=20)
    x, y, z = cp.Variable(4), cp.Variable(4, nonneg=True), cp.Variable((2, 2), symmetric=True)
    risk = np.diag([1.0, 2.0, 3.0, 4.0])
    return {
        "least squares": cp.Problem(cp.Minimize(cp.sum_squares(A @ x - b) + 3), [x >= 0]),
        "portfolio": cp.Problem(cp.Maximize(A[0] @ y - cp.quad_form(y, risk)), [cp.sum(y) == 1]),
        "lasso": cp.Problem(cp.Minimize(cp.sum_squares(A @ x - b) + cp.norm1(x))),
        "linear": cp.Problem(cp.Minimize(cp.norm_inf(A @ x - b)), [x <= 1]),
        "symmetric": cp.Problem(
            cp.Minimize(cp.sum_squares(z - np.array([[1.0, 2.0], [3.0, 4.0]]))), [z >= 0]
        ),
    }


@pytest.mark.quick(2)
@pytest.mark.filterwarnings(
    "ignore:.*is deprecated:DeprecationWarning"
)  # osqp's, of options that old cvxpy sends
@pytest.mark.parametrize("name", models())
@pytest.mark.parametrize("solver", ["CLARABEL", "OSQP"])
def test_answers_of_any_solver_to_cvxpy_problems(name, solver):
    """Proved, with bounds on either side of the value, in the user's sense; nothing of the problem is changed."""
    problem = models()[name]
    problem.solve(solver=solver)
    value, values = problem.value, [variable.value for variable in problem.variables()]
    result = certify(problem)
    assert result.verdict == "proved", result
    assert result.lower is not None
    assert result.upper is not None
    assert result.lower - 1e-12 <= value + 1e-6
    assert result.upper + 1e-6 >= value
    assert result.upper - result.lower < 1e-9
    assert problem.value == value
    assert problem.status == "optimal"
    for before, variable in zip(values, problem.variables(), strict=True):
        np.testing.assert_array_equal(before, variable.value)


def test_wrong_values_of_cvxpy_variables():
    """Off by 1e-4: never proved; off by 1e-2, and the answer without a row: disproved."""
    problem = models()["portfolio"]
    problem.solve(solver="CLARABEL")
    y = problem.variables()[0]
    right = y.value
    # One share more of the second and less of the first.
    for off, verdicts in ((1e-4, ("unproved", "disproved")), (1e-2, ("disproved",))):
        y.save_value(right + off * np.array([1.0, -1.0, 0.0, 0.0]))
        assert certify(problem).verdict in verdicts
    y.save_value(right)
    assert certify(problem).verdict == "proved"
    other = models()["least squares"]
    free = cp.Problem(other.objective)
    free.solve(solver="CLARABEL")
    other._status = "optimal"
    assert certify(other).verdict == "disproved"


@pytest.mark.parametrize("value", [0.0, 0.25, 1.0])
def test_every_optimal_value_is_proved(value):
    """If x is not unique, the auxiliary variables of cvxpy are chosen optimally for this x."""
    x = cp.Variable()
    problem = cp.Problem(cp.Minimize(cp.pos(x) + cp.pos(1.0 - x)), [x <= 5.0])
    problem.solve(solver="CLARABEL")
    x.save_value(np.array(value))
    result = certify(problem)
    assert result.verdict == "proved", result
    x.save_value(np.array(1.0 + 1e-4))
    assert certify(problem).verdict == "disproved"


def test_claims_of_cvxpy_solvers():
    """Statuses of cvxpy solvers are checked against the problem, right and wrong statuses."""
    x = cp.Variable(2)
    infeasible = cp.Problem(cp.Minimize(cp.sum_squares(x)), [x >= 1, cp.sum(x) <= 1])
    unbounded = cp.Problem(cp.Maximize(cp.sum(x)), [x >= 1])
    for problem, claim in ((infeasible, "infeasible"), (unbounded, "unbounded")):
        problem.solve(solver="CLARABEL")
        result = certify(problem)
        assert (result.claim, result.verdict) == (claim, "proved")
    fine = cp.Problem(cp.Minimize(cp.sum_squares(x)), [x >= 1])
    fine.solve(solver="CLARABEL")
    for status in ("infeasible", "unbounded"):
        fine._status = status
        assert certify(fine).verdict == "disproved"


# --- Errors
# ---------------------------------------------------------------------------------------------------------


def unsolved(constraints: Any = (), **attributes: Any) -> cp.Problem:
    x = cp.Variable(2, **attributes)
    return cp.Problem(cp.Minimize(cp.sum_squares(x)), [make(x) for make in constraints])


CURVED = NonlinearProblem(lambda x: x**3 - 1.0)


@refusals(r"""
certify(unsolved()) → InvalidProblem: status is None, .*; call problem\.solve\(\)
certify(unsolved([lambda x: cp.norm2(x) <= 1])) → UnsupportedModel: is not piecewise linear
certify(unsolved(integer=True)) → UnsupportedModel: is integer
certify(unsolved([lambda x: cp.sqrt(x) <= 1])) → UnsupportedModel: convex
certify(unsolved([lambda x: complements(x >= 0, x >= 1)])) → UnsupportedModel: with complementarity is not a single LCP
certify(cp.Problem(cp.Minimize(3))) → UnsupportedModel: no variables
certify(SIMPLE) → InvalidProblem: needs an x
certify(SIMPLE, [1.0]) → InvalidProblem: length 2, got shape \(1,\)
certify(SIMPLE, [1.0, np.nan]) → InvalidProblem: x\[1\] = nan
certify(SIMPLE, [0.5, 1.5], [1.0]) → InvalidProblem: must be \(inequality, equality\)
certify(SIMPLE, [0.5, 1.5], ([np.nan], [])) → InvalidProblem: inequality\[0\] = nan
certify(QuadraticProgram([[1, 2], [2, 1]], [0, 0]), [0.0, 0.0]) → UnsupportedModel: not convex
certify(SIMPLE, claim='optimum') → InvalidOption: did you mean 'optimal'
certify(SIMPLE, [0.5, 1.5], tolerance=0.0) → InvalidOption: tolerance must be a number > 0
certify(SIMPLE, [0.5, 1.5], tolerance=5) → InvalidOption: must be less than 1, got 5
certify(SIMPLE, [0.5, 1.5], max_seconds=-1) → InvalidOption: max_seconds must be
certify(unsolved(), [1.0, 2.0]) → InvalidOption: a model has values
certify([[1.0]]) → InvalidProblem: got list
certify(CURVED, [1.0]).worst(0) → InvalidOption: count must be
certify(LCP([[1.0]], [1.0])) → InvalidOption: certify\(problem, x\)
certify(CURVED) → InvalidOption: needs a point of the NonlinearProblem
certify(CURVED, [1.0], claim='optimal') → InvalidOption: go with a QuadraticProgram
""")
def test_mistakes_are_refused_in_words(call, words):
    """Invalid arguments raise errors that state the requirement."""
    assert_refused(call, words, globals())


# --- Small multipliers, and time -----------------------------------------------------------------------------------


@given(
    *[st.integers(-40, 40)] * 2,
    st.integers(-20, 20),
    st.sampled_from(["right", "with multipliers", "off", "a sign", "beside slack", "a gradient"]),
)
def test_verdicts_do_not_depend_on_units(objective, row, unknowns, answer):
    """The objective, a row, and all unknowns times powers of two: the same verdict, of x and of its multipliers."""
    P, c = np.array([[2.0, 1.0], [1.0, 3.0]]), np.array([-6.0, -4.0])
    G, h = np.array([[1.0, 1.0], [1.0, -2.0]]), np.array([2.0, 8.0])
    x, y = np.array([2.0, 0.0]), np.array([2.0, 0.0])
    # and the bound is met without a multiplier
    lower, below = (np.array([-np.inf, 0.0]), np.array([0.0, 0.0]))
    assert (P @ x + c + y @ G == below).all()
    x = x - np.array([0.05 * (answer == "off"), 0.0])
    y = {"a sign": -y, "beside slack": np.array([2.0, 0.5]), "a gradient": 0.9 * y}.get(answer, y)
    s, r, u = np.ldexp(1.0, [objective, row, unknowns])
    of_rows = np.array([r, 1.0])
    scaled = QuadraticProgram(
        s * u * u * P, s * u * c, u * of_rows[:, None] * G, of_rows * h, lower=lower / u
    )
    multipliers = None if answer in ("right", "off") else (s * y / of_rows, [])
    given_units = QuadraticProgram(P, c, G, h, lower=lower)
    expected = certify(given_units, x, None if multipliers is None else (y, []))
    found = certify(scaled, x / u, multipliers)
    verdicts = {"right": "proved", "with multipliers": "proved", "off": "disproved"}
    assert expected.verdict == verdicts.get(answer, "unproved")
    assert found.verdict == expected.verdict
    if found.lower is not None and expected.lower is not None:
        assert found.lower == pytest.approx(s * expected.lower, rel=1e-6)


def test_a_program_without_unknowns_is_judged():
    """A program without unknowns has the value 0, and its rows 0 ≤ h are checked."""
    empty = np.zeros((0, 0))
    assert certify(QuadraticProgram(empty, []), []).verdict == "proved"
    for h, verdict in ((1.0, "proved"), (-1.0, "disproved")):
        program = QuadraticProgram(empty, [], np.zeros((1, 0)), [h])
        assert certify(program, []).verdict == verdict


@pytest.mark.parametrize("n", [1, 2, 5])
def test_a_fit_without_an_error_is_proved(n):
    """The least maximum norm of A x − b is 0; no x of doubles reaches it, and a residual of 1e-9 is disproved."""
    rng = np.random.default_rng(n)
    A, b = rng.normal(size=(n, n)), rng.normal(size=n)
    rows = np.hstack([np.vstack([A, -A]), -np.ones((2 * n, 1))])
    program = QuadraticProgram(None, np.append(np.zeros(n), 1.0), rows, np.append(b, -b))
    x = np.linalg.solve(A, b)
    t = np.abs(A @ x - b).max() + 1e-17
    assert certify(program, np.append(x, t)).verdict == "proved"
    assert certify(program, np.append(x, 1e-9)).verdict == "disproved"


def test_inactive_bounds_change_no_verdict(draws):
    """Exact integer optima in mixed units: with bounds of 1e6 that hold nothing the verdict is as without them."""
    for seed in draws(60, 5):
        rng = np.random.default_rng(seed)
        units, B = 10.0 ** rng.integers(-4, 5, 5), rng.integers(-3, 4, (5, 5)).astype(float)
        P, x = (B @ B.T) / np.outer(units, units), rng.integers(-9, 9, 5) * units
        G, y = rng.integers(-3, 4, (3, 5)) / units, rng.integers(0, 4, 3) * (rng.random(3) < 0.6)
        h = G @ x + np.where(y > 0, 0, rng.integers(1, 5, 3))
        data, far = (P, -P @ x - G.T @ y, G, h), np.abs(x) + 1e6 * units
        alone = certify(QuadraticProgram(*data), x).verdict
        assert certify(QuadraticProgram(*data, lower=-far, upper=far), x).verdict == alone


@pytest.mark.parametrize("off", [1e-9, -1e-9])
def test_a_point_that_an_interior_point_method_leaves_next_to_its_bounds_is_proved(off):
    """Min x₀ + 2 x₁ over x₀ + x₁ = 1, x ≥ 0 at (1 − off, off): right, as Clarabel and OSQP return it."""
    program = QuadraticProgram(None, [1.0, 2.0], A=[[1.0, 1.0]], b=[1.0], lower=0.0)
    assert certify(program, [1.0 - off, off]).verdict == "proved"
    assert certify(program, [1.0 - 1e4 * off, 1e4 * off]).verdict == "disproved"


def test_a_tolerance_below_the_default_is_met_by_the_sums_themselves():
    """P of rank 1, units from 1e-4 to 1e4, tolerance=1e-11: auto's points are proved."""
    for seed in range(10):
        rng = np.random.default_rng(seed)
        f = rng.normal(size=3) * 10.0 ** rng.integers(-4, 5, 3)
        x, G = rng.normal(size=3), rng.normal(size=(7, 3))
        program = QuadraticProgram(np.outer(f, f), -f * (f @ x), G, G @ x + 0.5)
        assert certify(program, solve(program).x, tolerance=1e-11).verdict == "proved"
