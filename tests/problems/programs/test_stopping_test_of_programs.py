"""The stopping test of programs: values and violations of solutions, with the numbers that users write."""

from __future__ import annotations

from typing import Any

import cvxpy as cp
import numpy as np
import pytest
import qpsolvers
import scipy.sparse as sp
from campaigns import forbidding_costs
from campaigns.forbidding_costs import transport
from numpy.random import Generator
from oracles.exact_program import ExactProgram, exact

from lcp_plugin import QPSolver, QuadraticProgram, Status, certify, solve, solve_batch
from lcp_plugin.interfaces.qpsolvers import register_with_qpsolvers
from lcp_plugin.judges.program import KKTErrors, PrimalDualPoint

register_with_qpsolvers()

HALF_SPACES = (
    np.diag([2.0, 2.0]),
    np.array([-300.0, -500.0]),
    np.array([[3.0, 1.0], [1.0, 4.0]]),
    np.array([10.0, 10]),
)
NEAREST = [30 / 11, 20 / 11]  # the solution, for any value of the distant bounds
FAR = [1e20, 9.999999999999999e19, 1e30, np.inf]


# --- Right-hand sides and bounds of 1e20
# ---------------------------------------------------------------------------


def by_bounds(far: float) -> Any:
    P, c, G, h = HALF_SPACES
    return solve(QuadraticProgram(P, c, G, h, lower=[-far, 0.0], upper=far)).solution.x


def by_rows(far: float) -> Any:
    P, c, G, h = HALF_SPACES
    return solve(QuadraticProgram(P, c, [*G, [1.0, 0.0]], [*h, far], lower=0.0)).solution.x


def by_other_vectors(far: float) -> Any:
    P, c, G, h = HALF_SPACES
    program = QuadraticProgram(P, c, [*G, [1.0, 0.0]], [*h, 1.0], lower=0.0, upper=1.0)
    return solve(program.with_vectors(h=[*h, far], upper=[far, far])).solution.x


def by_batch(far: float) -> Any:
    P, c, G, h = HALF_SPACES
    rows = [*G, [1.0, 0.0]], [*h, far]
    program = QuadraticProgram(P, c, *rows, lower=[-far, 0.0], upper=far)
    answers = solve_batch([program, program])
    np.testing.assert_array_equal(answers.x[0], answers.x[1])
    return answers.x[0]


def by_qpsolvers(far: float) -> Any:
    P, c, G, h = HALF_SPACES
    return qpsolvers.solve_qp(
        P, c, G, h, lb=np.array([-far, 0.0]), ub=np.full(2, far), solver="lcp_plugin"
    )


def by_cvxpy(far: float) -> Any:
    P, c, G, h = HALF_SPACES
    x = cp.Variable(2, bounds=[-far, far])
    cp.Problem(
        cp.Minimize(0.5 * cp.quad_form(x, P) + c @ x), [G @ x <= h, x[0] <= min(far, 1e300)]
    ).solve(QPSolver)
    return x.value


@pytest.mark.parametrize("far", FAR)
@pytest.mark.parametrize(
    "answer", [by_bounds, by_rows, by_other_vectors, by_batch, by_qpsolvers, by_cvxpy]
)
def test_limits_of_1e20_say_nothing(answer, far):
    """An upper limit of 1e20 and beyond means none in every interface."""
    np.testing.assert_allclose(answer(far), NEAREST, rtol=1e-9)


# --- Numbers that users write -----------------------------------------------------------------------------------------

NOISE = [[-1.0, 0.0, -1.0, -9.2e-17], [-1.0, 1e-16, 9.8e-17, 0.0]]
P, C, G, H = HALF_SPACES
VALUE = 1300 / 121 - 19000 / 11
RIGHT = {
    "a row of 1e16": (QuadraticProgram(P, C, [*G, [1, 0]], [*H, 1e16], lower=0.0), VALUE),
    "bounds of 1e19": (QuadraticProgram(P, C, G, H, lower=0.0, upper=1e19), VALUE),
    "cos(π/2)": (
        QuadraticProgram(None, [-3, -4], [[1, np.cos(np.pi / 2)]], [1], lower=-10, upper=10),
        -43.0,
    ),
    "1e-5 in a row": (
        QuadraticProgram(np.diag([1, 0]), [0, 1], [[1e-5, 1]], [-1], lower=-10, upper=10),
        -10.0,
    ),
    "noise": (
        QuadraticProgram(
            np.diag([1, 0, 0, 1]), [0, 1, 1, -1], NOISE, [-1, -1], lower=-10, upper=10
        ),
        -10.0,
    ),
    "an empty row": (
        QuadraticProgram(
            [[1.000000001]], [-3.0], [[0], [2], [0]], [0, -4, 1], lower=-1e19, upper=1e10
        ),
        8.000000002,
    ),
    "no costs": (QuadraticProgram(None, [0.0], [[-1], [-1], [-1]], [-1, -1, 0], lower=-1e20), 0.0),
}


@pytest.mark.parametrize("name", RIGHT)
def test_numbers_that_users_write(name):
    """The optimum is right, and no constraint is violated, for extreme limits or coefficients."""
    program, value = RIGHT[name]
    result = solve(program)
    x = result.solution.x
    assert result.is_solved
    assert result.solution.objective == pytest.approx(value, rel=1e-8, abs=1e-8)
    assert (program.G @ x - program.h <= 1e-9 * np.maximum(np.abs(program.h), 1.0)).all()
    assert ((program.lower <= x) & (x <= program.upper)).all()


# --- The judge, attacked: wrong answers whose measures an earlier form called small ----------------------------------

ONE_ROW = QuadraticProgram(None, [1.0, 1.0, 1e9], [[-1.0, -1.0, -1.0]], [-1.0], lower=0.0)
TWICE = QuadraticProgram(
    None, [1.0, 0.0], A=[[0.0, 1.0], [0.0, 1.0]], b=[1.0, 1.0], lower=[0.0, -np.inf]
)
AT_A_BOUND = QuadraticProgram(None, [1.0, 0.0], A=[[0.0, 1.0]], b=[1.0], lower=[0.0, 1.0])
IDLE = QuadraticProgram(np.diag([4.0, 0.0]), [3.0, 0.0], [[-1.0, 0.0]], [0.0])
NEARLY_IDLE = QuadraticProgram(
    np.diag([1.0, 0.0]), [-4.0, 0.0], [[1.0, 0.0], [0.0, 1.0], [1.0, 1.0]], [2.0, 1.0, 4.0]
)
# P d = 0 except for rounding, d = (3, −1)
LEVEL = QuadraticProgram([[0.01, 0.03], [0.03, 0.09]], [-1.0, 0.0])
FELL = {
    "a slack of cost 1e9": (ONE_ROW, [500, 0, 0], [1, 0, 0, 1e9 - 1, 0, 0, 0]),
    "its bounds hold all": (ONE_ROW, [500, 0, 0], [0, 1, 1, 1e9, 0, 0, 0]),
    "its row holds all": (ONE_ROW, [500, 0, 0], [1e9, 1 - 1e9, 1 - 1e9, 0, 0, 0, 0]),
    "two huge multipliers cancel": (TWICE, [7, 1], [1e9, -1e9, 0, 0, 0, 0]),
    "two huge multipliers, and the gap": (TWICE, [7, 1], [1e9, -1e9, 1, 0, 0, 0]),
    "a row and a bound cancel": (AT_A_BOUND, [7, 1], [1e8, 0, 1e8, 0, 0]),
    "a row and a wrong sign cancel": (AT_A_BOUND, [7, 1], [-1e8, 0, -1e8, 0, 0]),
    "an idle unknown is huge": (IDLE, [-0.75, -1e9], [0, 0, 0, 0, 0]),
    "an unknown in idle rows is huge": (NEARLY_IDLE, [4, -1.34e8], [0, 0, 0, 0, 0, 0, 0]),
    "a multiplier of 1e-22 wakes a huge unknown": (
        NEARLY_IDLE,
        [4, -1e14],
        [0, 0, 1e-22, 0, 0, 0, 0],
    ),
    "a multiplier of 1e-16 wakes a huge unknown": (
        NEARLY_IDLE,
        [4, -4e11],
        [0, 0, 1e-16, 0, 0, 0, 0],
    ),
    "a multiplier of 1e-14 wakes a huge unknown": (
        NEARLY_IDLE,
        [4, -4e9],
        [0, 0, 1e-14, 0, 0, 0, 0],
    ),
    "the cost is beneath rounding of P x": (LEVEL, [3e30, -1e30], [0, 0, 0, 0]),
    "xᵀP x is beyond doubles": (LEVEL, [3e197, -1e197], [0, 0, 0, 0]),
}


@pytest.mark.parametrize("name", FELL)
def test_the_judge_refuses_what_is_far_from_optimal(name):
    """Wrong objectives with large multipliers, idle unknowns and slacks do not pass."""
    program, x, multipliers = FELL[name]
    y = np.array(multipliers[: program.constraints.right.size], np.float64)
    errors = KKTErrors.of(program.judged, np.array(x, np.float64), y, 1e-6)
    assert errors.largest > 1e-5, errors


@pytest.mark.quick(1)
@pytest.mark.parametrize("limit", [1e9, 1e11, 1e12, 1e14, 1e17])
def test_no_rounding_of_a_curvature_hides_a_cost(limit):
    """With P d = 0 and only a loose row along d, the value is right to 1e-6, or not SOLVED."""
    P, c = [[2.691650390625, 0.41015625], [0.41015625, 0.0625]], [-0.984375, -0.171875]
    G = [[-1.296875, 0.015625], [-0.03125, -0.296875]]
    for algorithm in ("auto", "piqp", "daqp", "interior_point"):
        result = solve(QuadraticProgram(P, c, G=G, h=[limit, 1.0]), algorithm)
        is_right = abs(result.objective / (-1.0258199581297976e-1 * limit) - 1.0) <= 1e-6
        assert is_right or not result.is_solved, algorithm


def test_rounding_of_a_curvature_is_no_size_of_an_objective():
    """The term xᵀP x is rounding error at x = 1e41 along P d = 0, where −2.667 must not pass."""
    P = [
        [8.0, 10.0, -4.0, -6.0],
        [10.0, 13.0, -3.0, -9.0],
        [-4.0, -3.0, 10.0, -3.0],
        [-6.0, -9.0, -3.0, 9.0],
    ]
    G = [[4.0, -3.0, 2.0, -1.0], [3.0, 3.0, 4.0, -2.0], [1.0, -4.0, -3.0, -4.0]]
    c = [-3.0000000000000004e-08, 1e-08, 4e-08, -4e-08]
    for algorithm in ("auto", "clarabel"):
        result = solve(QuadraticProgram(P, c, G=G, h=[3e9, 2e8, 3e6]), algorithm)
        assert not result.is_solved or abs(result.objective + 2.667068273) <= 1e-6, algorithm


@pytest.mark.parametrize("norm", [cp.norm1, cp.norm_inf], ids=["1", "infinity"])
@pytest.mark.parametrize("n", [1, 2, 10, 20])
def test_a_fit_without_an_error_is_solved(n, norm):
    """A fit with minimum 0 that no double attains is solved, with the x of the linear system."""
    draw = np.random.default_rng(n)
    A, x = draw.normal(size=(n, n)), cp.Variable(n)
    b = np.array([0.3]) if n == 1 else draw.normal(size=n)
    A = np.array([[3.0]]) if n == 1 else A
    problem = cp.Problem(cp.Minimize(norm(A @ x - b)))
    assert problem.solve(solver=QPSolver) <= 1e-12
    assert problem.status == cp.OPTIMAL
    np.testing.assert_allclose(x.value, np.linalg.solve(A, b), rtol=1e-9)


def test_a_minimum_at_0_where_products_of_a_curvature_cancel_is_solved():
    """The product P w is a rounding error where (w₀ + w₁)² is 0, and no cost is hidden in it."""
    w = cp.Variable(2)
    flat = cp.quad_form(w, np.ones((2, 2)))
    problem = cp.Problem(cp.Minimize(cp.huber(-3.0 * w[0] + 3.0 * w[1] - 1.0) + flat))
    assert problem.solve(solver=QPSolver) <= 1e-15
    assert problem.status == cp.OPTIMAL


@pytest.mark.parametrize("end", [1e2, 1e6, 1e9])
def test_a_tiny_cost_decides_the_point_along_a_flat_curvature(end):
    """The cost −1e-9 is below the rounding of P x, but exact sums have its sign: only the upper bounds are optimal."""
    program = QuadraticProgram([[1, -1], [-1, 1]], [-1e-9, 0], lower=-end, upper=end)
    result = solve(program)
    assert result.status is Status.SOLVED
    np.testing.assert_allclose(result.x, end, rtol=1e-12)
    opposite = KKTErrors.of(program.judged, np.full(2, -end), np.zeros(0), 1e-6)
    assert not opposite.meet(1e-6)


ROWS_OFF_BY_ONE = {
    "equations": {"A": [[1, -1], [1, -1]], "b": [0, 1]},
    "inequalities": {"G": [[1, -1], [-1, 1]], "h": [0, -1]},
    "both": {"G": [[1, -1]], "h": [0], "A": [[1, -1]], "b": [1]},
}


@pytest.mark.quick(2)
@pytest.mark.parametrize("least", [1e6, 1e9, 1e11, 1e13])
@pytest.mark.parametrize("rows", ROWS_OFF_BY_ONE.values(), ids=ROWS_OFF_BY_ONE)
def test_rows_that_are_off_by_one_are_infeasible_at_large_unknowns(rows, least):
    """A violation of 1/2 is small relative to x, but the engine reports infeasible and an exact proof exists."""
    program = QuadraticProgram(None, [1.0, 1.0], lower=least, **rows)
    result = solve(program)
    assert result.status is Status.INFEASIBLE
    assert result.proof is not None
    assert result.proof.verify()
    assert certify(program, claim="infeasible").verdict == "proved"
    assert certify(program, [least + 0.5, least]).verdict == "disproved"


def test_a_minimum_at_0_has_multipliers():
    """An engine's x is 0 up to noise, and its multipliers are not: x = 0 is tried with them."""
    x, one = cp.Variable(), cp.Variable()
    e = cp.hstack([-0.081807 * x, -2.196497 * x, 0.042343 * x])
    problem = cp.Problem(
        cp.Minimize(
            cp.sum_squares(e) + 1.39 * cp.norm1(cp.cumsum(cp.hstack([4 * x, -8 * x]))) + one
        ),
        [x >= -2.5, x <= 1.5, one >= 1],
    )
    assert problem.solve(solver=QPSolver) == pytest.approx(1.0, abs=1e-12)
    assert problem.status == cp.OPTIMAL


def test_an_objective_is_right_where_its_terms_cancel():
    """½ xᵀP x + cᵀx of a singular P of large norm, by fractions: rounding of its terms was 378 times the value."""
    P = np.array(
        [
            [13.0, 3.0, 6.0, -10.0],
            [3.0, 10.0, 9.0, -4.0],
            [6.0, 9.0, 9.0, -6.0],
            [-10.0, -4.0, -6.0, 8.0],
        ]
    )
    c = np.array([-45.9999999999998, -57.9999999999999, -60.0000000000001, 44.0000000000001])
    x = np.array([-9999999997.636364, -9999999994.90909, 10000000000.0, -10000000000.0])
    right = float(ExactProgram.of(QuadraticProgram(P, c)).value(exact(x)))
    for form in (P, sp.csr_array(P)):
        assert QuadraticProgram(form, c).objective(x) == pytest.approx(right, rel=1e-12)
    batch = solve_batch(
        [QuadraticProgram(P, cost, lower=-1e10, upper=1e10) for cost in (c, 2.0 * c)]
    )
    assert batch.objective == pytest.approx([one.objective for one in batch], rel=1e-12)


# --- A cost along a direction in which P is nearly singular, next to products that cancel -----------------------------


def wrong_by(data: tuple[Any, ...], x: Any) -> float:
    """Return the relative error of the objective, by enumeration with rationals."""
    P, c, G, h = data
    n, point = len(c), exact(x)
    program = ExactProgram(P, c, G, h, np.zeros((0, n)), [], [-np.inf] * n, [np.inf] * n)
    size = program.size(point)
    least = program.optimum()
    assert least is not None
    off = abs(program.value(point) - program.value(least))
    return float(off / size) if size else float(off > 0)


NEARLY_SINGULAR = (
    np.array([[1.000000000001, 0, -3], [0, 1e-12, 0], [-3, 0, 9.000000000001]]), [0.30000000000000004, -2, -4e-6],
    [[0.0, -2, -2], [1, 0, 1]], [4002.0, -999],
)  # fmt: skip


@pytest.mark.parametrize("kind", [np.asarray, sp.csr_array])
@pytest.mark.parametrize("algorithm", ["auto", "daqp", "piqp", "clarabel"])
def test_products_that_cancel_hide_no_cost(algorithm, kind):
    """Cost c₁ is 7e-8 of the terms of its component, and 2 % of the objective."""
    P, c, G, h = NEARLY_SINGULAR
    result = solve(QuadraticProgram(kind(P), c, kind(G), h), algorithm)
    assert wrong_by(NEARLY_SINGULAR, result.x) <= 1e-6 or not result.is_solved


def nearly_singular(rng: Generator) -> tuple[Any, ...]:
    """Draw an integer P of low rank plus 1e-6 to 1e-13 on its diagonal, with loose rows."""
    n, m, least = int(rng.integers(2, 5)), int(rng.integers(0, 4)), 10.0 ** -rng.integers(6, 14)
    B = rng.integers(-3, 4, (int(rng.integers(1, n)), n)) * (rng.random((1, n)) < 0.7)
    P = B.T @ B + np.diag(least * 10.0 ** rng.integers(-2, 3, n) ** (rng.random() < 0.5))
    c = rng.integers(-3, 4, n) * 10.0 ** rng.integers(-6, 2, n) + 0.1 * 3 * (rng.random() < 0.3)
    return (
        P,
        c,
        rng.integers(-2, 3, (m, n)).astype(float),
        rng.integers(-3, 4, m) * 10.0 ** rng.integers(0, 7, m),
    )


def beside_a_large_part(rng: Generator) -> tuple[Any, ...]:
    """A nearly singular P in any basis, and an unknown that has nearly all of the objective."""
    n, least = int(rng.integers(2, 4)), 10.0 ** -rng.uniform(6, 13)
    basis = np.linalg.qr(rng.normal(size=(n, n)))[0]
    sizes = np.where(rng.random(n) < 0.5, 1.0, least)
    sizes[0], sizes[-1] = 1.0, least
    P = np.diag(np.append(np.zeros(n), 10.0 ** rng.uniform(-13, 0)))
    P[:n, :n] = basis @ np.diag(sizes) @ basis.T
    P = 0.5 * (P + P.T) + least * np.diag(np.append(np.ones(n), 0.0))
    c = np.append(basis @ 10.0 ** rng.uniform(-8, 1, n), -(10.0 ** rng.uniform(-3, 3)))
    m = int(rng.integers(0, 3))
    return (
        P,
        c,
        rng.integers(-2, 3, (m, n + 1)).astype(float),
        abs(rng.normal(size=m)) * 10.0 ** rng.integers(0, 12, m),
    )


@pytest.mark.quick(1)
@pytest.mark.parametrize("tolerance", [1e-4, 1e-6])
@pytest.mark.parametrize("draw", [nearly_singular, beside_a_large_part])
def test_what_is_solved_of_a_nearly_singular_curvature_is_right(draw, tolerance, draws):
    """The objective of SOLVED results is right to ten times the tolerance, and 45 % at the least are SOLVED.

    If x violates a row by at most the tolerance, the reference uses the right-hand side that x satisfies, because
    so small a violation of a loose row may change the objective considerably.
    """
    rng, results = np.random.default_rng(3), []
    for _ in draws(1000, 32):
        data = draw(rng)
        results.append(solve(QuadraticProgram(*data), tolerance=tolerance))
        if results[-1].is_solved:
            P, c, G, h = data
            kept = P, c, G, np.maximum(h, G @ results[-1].x)
            assert wrong_by(kept, results[-1].x) <= 10.0 * tolerance, data
    assert sum(result.is_solved for result in results) >= 0.45 * len(results)


# --- Constructed from the formulas: points far from optimal, each of which an earlier form of the test let pass -------

V = np.array([1e6, 1.0, -1.0])
TWICE_EQUAL = [[1, -1, 0], [1, -1, 0]]
CONSTRUCTED = {
    "multipliers are no numbers": ({"c": [1, 1], "G": [[-1, -1]], "h": [-1]}, [500, 3], [np.nan]),
    **{
        f"2^{k} cancels": (
            {
                "c": [-1, 0, 1], "G": [[0, 1, 1]], "h": [100], "A": TWICE_EQUAL, "b": [0, 0],
                "lower": [0, 0, 1], "upper": [10, 10, np.inf],
            },
            [0, 0, 1], [0, 2.0**k, -(2.0**k)],
        )
        for k in (37, 51)
    },
    "a cost beneath a cancelling curvature": (
        {
            "P": np.outer(V, V), "c": [0.5, 0, 0], "lower": [-1, -np.inf, 1e4],
            "upper": [1, np.inf, 1e4],
        },
        [0, 1e4, 1e4], [],
    ),
    "a row excused by an unknown far out": (
        {
            "c": [1, 1, -1e-13], "G": [[-1, -1, 0], [1, 0, 1]], "h": [-1, 4e13], "lower": 0,
            "upper": [np.inf, np.inf, 2e13],
        },
        [0, 0, 2e13], [0, 0],
    ),
    "multipliers that cancel size the dual": (
        {"c": [1, -1, -2], "A": TWICE_EQUAL, "b": [1, 1], "upper": [np.inf, np.inf, 1]},
        [1e7 + 1, 1e7, 0], [-1 - 2.0**23, 2.0**23],
    ),
    "a small slope to a bound of 1e12": (
        {"c": [-1e-10, 0], "A": [[1, -1], [1, -1]], "b": [0, 0], "lower": 0, "upper": 1e12},
        [0, 0], [1, -1],
    ),
    "contradicting equations far out": (
        {"c": [0, 1, 1], "A": TWICE_EQUAL, "b": [0, 1], "lower": [0, 0, 1]},
        [1e9, 1e9, 1], [0, 0],
    ),
    "a row off by 1e-7 that y does not see": (
        {"P": np.diag([1, 0]), "c": [0, 0], "G": [[0, 1], [-1, -1e9]], "h": [1, -1e9 - 50]},
        [0, 1 + 1e-7], [0, 0],
    ),
    "a row with a coefficient of 1e200": (
        {
            "P": np.diag([0, 1]), "c": [-1e200, -1], "G": [[1e200, 1]], "h": [1], "lower": 0,
            "upper": [1e-199, 10],
        },
        [1e-199, 1], [0],
    ),
}  # fmt: skip


@pytest.mark.parametrize("kind", [np.asarray, sp.csr_array])
@pytest.mark.parametrize("name", CONSTRUCTED)
def test_constructed_points_are_refused(name, kind):
    """Each is far from optimal, infeasible, or has no proof."""
    data, x, y = CONSTRUCTED[name]
    matrices = {key: kind(np.array(data[key], float)) for key in ("P", "G", "A") if key in data}
    program = QuadraticProgram(**{"P": None, **data, **matrices})
    assert not KKTErrors.of(program.judged, np.array(x, float), np.array(y, float), 1e-6).meet(1e-6)


# --- Noise ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("k", [1e8, 1e15])
def test_a_coefficient_of_noise_excuses_no_violation(k):
    """x₀ ≥ 1/2 is a row with −1e-16 x₁ in it, and −1e-16 x₀ stands next to x₂/k: .5 is the right x₀."""
    G = [[-2, -1e-16, 0], [-1e-16, 0, 1 / k]]
    program = QuadraticProgram(None, [1, -1, 0], G, [-1, 3], lower=0, upper=[5, 5, 2 * k])
    result = solve(program)
    assert result.status is Status.SOLVED
    np.testing.assert_allclose(result.x[:2], [0.5, 5.0], rtol=1e-9)
    assert certify(result).verdict == "proved"
    assert certify(program, [0.0, 5.0, 2 * k]).verdict == "disproved"


@pytest.mark.parametrize(("side", "far"), [(1.0, 1e15), (0.01, 1e12)])
def test_a_large_side_excuses_no_row_without_entries(side, far):
    """0 x = 1 next to x₁ + x₂ ≤ 1e15, and 0 x ≤ −.4 next to one whose rounding is .1, are neither SOLVED nor proved."""
    program = QuadraticProgram(np.eye(2), [1, 1], [[1, 1]], [far], [[0, 0]], [side])
    assert not solve(program).is_solved
    assert certify(program, [-1.0, -1.0]).verdict == "disproved"
    limited = QuadraticProgram(
        None, [1, 1], [[0, 0], [-1, -1]], [-0.4 * side, -far], lower=0, upper=2 * far
    )
    assert not solve(limited).is_solved
    assert certify(limited, [far / 2, far / 2]).verdict != "proved"


@pytest.mark.parametrize(("side", "is_right"), [(-1e-16, True), (-1e-9, False)])
def test_a_side_of_noise_is_0(side, is_right):
    """x₁ + x₂ = −1e-16 with x ≥ 0 says x₁ = x₂ = 0, as data with subtracted origins state it; −1e-9 contradicts."""
    A, b = [[1.0, 1.0, 0.0], [1.0, 0.0, 1.0]], [side, 1.0]
    program = QuadraticProgram(np.eye(3), [1.0, 1.0, 1.0], A=A, b=b, lower=0)
    result = solve(program)
    assert result.is_solved is is_right
    assert (certify(program, [0.0, 0.0, 1.0]).verdict == "proved") is is_right


def test_a_side_of_noise_that_an_expensive_unknown_must_meet_is_a_demand():
    """x₁ ≥ 1e-15 as a row costs 1 of 101 at a price of 1e15, although 1e-15 is noise next to x₂ = 100."""
    G, h = [[-1.0, 0.0, -1.0], [-1.0, -1.0, 0.0]], [-1e-15, -100.0]
    program = QuadraticProgram(None, [1e15, 1.0, 1e15], G, h, lower=0)
    assert solve(program).objective == pytest.approx(101.0)
    for y in ([0.0, 1.0], [1e15, 1.0]):
        assert not KKTErrors.of(program.judged, np.array([0.0, 100, 0]), np.array(y), 1e-6).meet(
            1e-6
        )


@pytest.mark.parametrize("x", [[2e-17, 1, 1e-17, 0, 1e-17], [2e-15, 1, 1.3e-15, 0, 1e-15]])
def test_a_body_at_rest_with_noise_is_proved(x):
    """Unknowns below 2⁻⁴² of the largest count as 0: the optimum is 0, and noise in three rows has no larger term."""
    A = [[0, 1, 0, 0, 0], [-0.5, 0, 1, 0, 0], [0, 0, -1, 0, 1]]
    G = [[1, -1, 0, 0, 0], [-1, -1, 0, 0, 0]]
    program = QuadraticProgram(np.diag([0, 0, 0, 0, 1.0]), np.zeros(5), G, [0, 0], A, [1, 0, 0])
    assert certify(program, x).verdict == "proved"
    assert certify(program, np.array(x) * 1e12 + [0, 1 - 1e12, 0, 0, 0]).verdict == "disproved"


@pytest.mark.parametrize("row", [[[-1.0, 0.0]], np.zeros((0, 2))], ids=["row", "bound"])
def test_a_row_with_one_entry_is_a_bound_in_certify(row):
    """x₁ = −1.5e-16 is proved where x₁ ≥ 0 is a row, as where it is a bound, and x₁ = −1e-3 is not."""
    lower = [-np.inf if len(row) else 0.0, -np.inf]
    program = QuadraticProgram(np.eye(2), [1.0, -1.0], row, np.zeros(len(row)), lower=lower)
    assert certify(program, [-1.5e-16, 1.0]).verdict == "proved"
    assert certify(program, [-1e-3, 1.0]).verdict == "disproved"


@pytest.mark.parametrize(
    ("lower", "upper", "row"),
    [(1e14, 1e14, []), (1e14, np.inf, []), (-np.inf, np.inf, [[0.0, 0.0, -1.0]])],
    ids=["fixed", "bound", "row"],
)
def test_inconsistent_rows_next_to_a_large_unknown_are_infeasible(lower, upper, row):
    """x₁ + x₂ ≤ −1 and x ≥ 0 are inconsistent; the violation is small next to x₃ = 1e14 of this component."""
    G, h = [[1, 1, 0], [1, 0, -1], *row], [-1, 0, *(-1e14 for _ in row)]
    program = QuadraticProgram(
        None, [0, 0, 1], G, h, lower=[0, 0, lower], upper=[np.inf, np.inf, upper]
    )
    for algorithm in ("auto", "piqp", "clarabel"):
        assert solve(program, algorithm).status is Status.INFEASIBLE
    assert solve_batch([program, program]).status[1] is Status.INFEASIBLE


def test_documented_limits_of_the_test():
    """A row violated by 9e-10 of its terms passes, also a program within 1e-11 of a bounded one."""
    row = QuadraticProgram(np.diag([1.0, 0.0]), [0, 0], [[0, 1], [-1, -1e11]], [1, -1e11 - 50])
    assert KKTErrors.of(row.judged, np.array([0, 1 + 9e-10]), np.zeros(2), 1e-6).meet(1e-6)
    nearly = QuadraticProgram(None, [1, -(1 + 1e-11)], [[-1, 1]], [-1])
    assert solve(nearly).status is Status.SOLVED


def test_an_objective_near_0_leaves_no_unknown_beyond_its_bound():
    """The row x₁ + x₂ ≥ 1 has a multiplier of 1; x₂ is 1e-15 below its bound, which costs x₁ a thousand optima."""
    program = QuadraticProgram(None, [1, 1e-18], [[-1, -1]], [-1], lower=0, upper=[10, 1])
    assert not KKTErrors.of(program.judged, np.array([1e-15, 1 - 1e-15]), np.ones(1), 1e-6).meet(
        1e-6
    )
    assert KKTErrors.of(program.judged, np.array([0.0, 1.0]), np.ones(1), 1e-6).meet(1e-6)


def test_an_exact_minimizer_is_optimal_although_products_cancel():
    """P x = 0 is the sum of terms of 1e12; the optimum of x₃ is 0, and 1e-9 next to 1e6 counts as 0."""
    v = np.array([1e6, 1.0, -1.0])
    program = QuadraticProgram(np.outer(v, v), [0, 0, 1], lower=[-10, -2e6, 0], upper=[10, 2e6, 1])
    none = np.zeros(0)
    assert KKTErrors.of(program.judged, np.array([1, -1e6, 0.0]), none, 1e-6).meet(1e-6)
    assert KKTErrors.of(program.judged, np.array([1, -1e6, 1e-9]), none, 1e-6).meet(1e-6)
    assert not KKTErrors.of(program.judged, np.array([1, -1e6, 1e-6]), none, 1e-6).meet(1e-6)


@pytest.mark.parametrize("value", [1e160, 1e308, np.nan, np.inf])
def test_no_number_is_no_answer(value):
    """NaN, ∞ and overflowing values are rejected as x and as multipliers."""
    program = QuadraticProgram(np.eye(2), [-1, -2], [[1, 1]], [1])
    for x, y in (([value, 1.0], [1.0]), ([0.0, 1.0], [value])):
        assert not KKTErrors.of(program.judged, np.array(x), np.array(y), 1e-6).meet(1e-6)


def test_plain_sums_pass_nothing_that_exact_ones_refuse(draws):
    """Plain sums with a bound of their rounding bound the measures, also of −x with the bounds on the other side."""
    rng, passed = np.random.default_rng(5), 0
    for _ in draws(2000, 32):
        n, m = int(rng.integers(1, 6)), int(rng.integers(0, 5))
        F, C = rng.integers(-2, 3, (n, n)), rng.integers(-3, 4, (m, n)) * 2.0 ** rng.integers(-9, 9)
        x = rng.integers(-3, 4, n) * 2.0 ** rng.integers(-10, 20, n)
        y = rng.integers(0, 4, m) * 2.0 ** rng.integers(-20, 20)
        P, c = (F @ F.T).astype(float), -(F @ F.T @ x) - C.T @ y
        c = c + rng.choice([0.0, 1e-12, 1e-7]) * rng.normal(size=n) * np.abs(c).max(initial=0.0)
        lower = np.where(rng.random(n) < 0.5, -np.inf, x - rng.integers(0, 2, n))
        for kind in (np.asarray, sp.csr_array):
            program = QuadraticProgram(kind(P), c, kind(C), C @ x, lower=lower)
            with np.errstate(all="ignore"):
                plain, exact = (
                    PrimalDualPoint(program.judged, x, y, is_exact=one) for one in (False, True)
                )
                turned = QuadraticProgram(kind(P), -c, kind(-C), C @ x, upper=-lower).judged
                mirrored = PrimalDualPoint(turned, -x, y, is_exact=False)
                assert np.array_equal(mirrored.gaps(), plain.gaps())
                assert np.array_equal(mirrored.row_errors(), plain.row_errors())
                passes = (plain.gaps() <= 1e-6).all()
                assert not passes or (exact.gaps() <= 1e-6).all()
                passed += bool(passes)
                assert (exact.row_errors() <= plain.row_errors() * (1.0 + 1e-9)).all()
    assert passed > 0


# --- Costs that forbid ---------------------------------------------------------------------------------------------


@pytest.mark.quick(1)
@pytest.mark.parametrize("exponent", [12, 20, 28, 32, 36])
def test_a_cost_that_forbids_hides_no_better_transport(exponent):
    """Sums of 1/3 and two forbidden pairs: 5, and certify disproves 6 and 6 with noise on the forbidden pairs."""
    B, third = 10.0**exponent, np.full(3, 1.0 / 3.0)
    program = transport([[B, 4.0, 4.0], [10.0, 6.0, 7.0], [B, 7.0, 1.0]], third, third)
    result = solve(program)
    assert not result.is_solved or result.objective == pytest.approx(5.0)
    assert certify(program, [0, 1 / 3, 0, 1 / 3, 0, 0, 0, 0, 1 / 3]).verdict != "disproved"
    wrong = np.array([0.0, 1.0, 1.0, 2.0, 0.0, 0.0, 0.0, 1.0, 1.0]) / 6.0
    noisy = wrong + 6e-24 * np.eye(9)[0] + 9e-25 * np.eye(9)[6]
    multipliers = [2e-16, 1.0, 2e-16, -1.0, -2e-16, -2e-16]
    for x in (wrong, noisy):
        for given in (None, ([], B * np.array(multipliers))):
            assert certify(program, x, given).verdict != "proved"


def test_multipliers_as_large_as_a_cost_that_forbids_excuse_no_gap():
    """Costs of 1e34 allow multipliers of 1e33, next to whose sums 2 and 6 are lost: 5.5 is not optimal, 3 is."""
    B, third = 1e34, np.full(3, 1.0 / 3.0)
    program = transport([[2.0, B, 8.0], [6.0, 6.0, B], [10.0, B, 1.0]], third, third)
    wrong = np.array([1.0, 0.0, 1.0, 0.0, 2.0, 0.0, 1.0, 0.0, 1.0]) / 6.0
    large = np.array([-9.993053386490377e32, 1.9986126077377203e33, -9.993053386490377e32])
    assert not KKTErrors.of(program.judged, wrong, np.append(large, -large), 1e-6).meet(1e-6)
    result = solve(program)
    assert result.is_solved
    assert result.objective == pytest.approx(3.0)
    assert certify(result).verdict == "proved"


@pytest.mark.quick(3)
@pytest.mark.parametrize("seed", range(200))
def test_drawn_transports_are_solved_and_proved_as_without_the_forbidden_pairs(seed):
    """Transports and assignments with costs of 1e20 … 1e36 have the value that HiGHS finds without these pairs."""
    if (drawn := forbidding_costs.draw(seed)) is not None:
        program, known = drawn
        result = solve(program)
        assert result.is_solved
        assert not forbidding_costs.is_wrong(result.objective, known)
        assert certify(program, result).verdict == "proved"


def test_an_unknown_below_the_smallest_price_counts_as_0_for_certify_also():
    """x_2 = 3.5e-319 violates 4 x_2 ≤ x_1 = 0 by all of its terms; solve accepts such a point, and so does certify."""
    program = QuadraticProgram(np.eye(2), [1.0, 1.0], [[-1.0, 4.0]], [0.0], lower=0.0)
    assert KKTErrors.of(program.judged, np.array([0.0, 3.5e-319]), np.zeros(1), 1e-6).meet(1e-6)
    assert certify(program, [0.0, 3.5e-319]).verdict == "proved"
    assert certify(program, [0.0, 3.5e-19]).verdict == "disproved"
