"""SOLVED for nonlinear problems: draws checked in fractions, and right points."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from campaigns.small_nonlinear import SHAPES, attacks, has_solution_near
from inputs import nonlinear_models as models
from inputs.constructed_points import CONSTRUCTED
from nonlinear_families import KINDS, planted

from lcp_plugin import LCP, NonlinearProblem, Status, certify, solve
from lcp_plugin.problems.nonlinear.data import Linearization


def test_an_idle_row_is_no_reference_for_a_curved_one():
    """Next to F₀ = x₀ − 1e4 + 1e5 x₁, a double root is right to 2e-4: F₂ is within 1e-8 of its terms."""
    problem = NonlinearProblem(
        lambda x: np.array(
            [x[0] - 1e4 + 1e5 * x[1], x[1] + x[2] - 2, x[1] + x[2] - 2 + (x[2] - 1) ** 2]
        ),
        lower=np.zeros(3),
    )
    result = solve(problem)
    if result.is_solved:
        np.testing.assert_allclose(result.z, [0, 1, 1], atol=2e-4)


@pytest.mark.quick(1)
@pytest.mark.parametrize("shape", SHAPES)
def test_random_small_problems_have_no_false_solution(shape, draws):
    """No problem with known solutions is SOLVED at a point that is not near a solution."""
    found = Counter()
    texts = []
    for what, text in attacks(
        np.random.default_rng([91, SHAPES.index(shape)]), len(draws(80, 6)), shape
    ):
        found[what] += 1
        if what == "false":
            texts.append(text)
    assert texts == []
    assert found["right"] > 0.5 * found.total()


# --- right points pass ---------------------------------------------------------------------------------------------


A = np.random.default_rng(0).normal(size=(8, 8))
SPD, OFFSET = A @ A.T / 8, np.random.default_rng(1).normal(size=8)
RIGHT: dict[str, tuple[Callable[..., Any], int, float, Any]] = {  # F, start, lower, root or None
    "Kojima, Shindo": (models.kojima_shindo, 4, 0.0, None),
    "Josephy": (models.josephy, 4, 0.0, None),
    "exponential": (lambda x: np.array([np.exp(x[0]) - 2, x[1] ** 3 - x[0]]), 2, 0.0, None),
    "power": (lambda x: x**1.5 + SPD @ x + OFFSET, 8, 0.0, None),
    "reciprocal": (lambda x: x - 1 / (1 + x) + SPD @ x + OFFSET, 8, 0.0, None),
    "cube": (lambda x: x**3, 1, -np.inf, 0.0),
    "cube at a bound": (lambda x: x**3, 1, 0.0, 0.0),
    "double root": (lambda x: (x - 1) ** 2, 1, -np.inf, 1.0),
    "double root of two": (lambda x: np.array([(x[0] - 1) ** 2, x[1] - x[0]]), 2, -np.inf, 1.0),
    "cubic obstacle": (lambda x: 5 * x**3 + SPD @ x + OFFSET, 8, 0.0, None),
    "tanh": (lambda x: np.tanh(x) - 0.5 + 0.1 * (SPD @ x), 8, 0.0, None),
    "logarithm": (lambda x: np.log(x + 1e-3) + x, 5, 0.0, None),
    "square minus 1e-30": (lambda x: x**2 - 1e-30, 1, 0.0, 1e-15),
    "Nash, Cournot": (models.NASH_5, 5, 1e-3, models.NASH_5_SOLUTION),
}


@pytest.mark.quick(2)
@pytest.mark.parametrize("name", RIGHT)
def test_a_right_point_is_solved_and_solved_again(name):
    """The result is right, and it passes from itself without a step, also with the last bits changed."""
    F, n, lower, root = RIGHT[name]
    start = np.full(n, 2.0)
    jacobian = None if name != "square minus 1e-30" else lambda x: np.diag(2 * x)
    problem = NonlinearProblem(F, jacobian, np.full(n, lower))
    result = solve(problem, x0=start)
    assert result.is_solved
    if root is not None:
        np.testing.assert_allclose(result.z, root, rtol=1e-4)
    rng, is_free = np.random.default_rng(0), result.z != problem.lower
    for k in range(4):
        ulps = rng.integers(-1, 2, n) * is_free * (k > 0)
        again = solve(problem, x0=result.z * (1.0 + ulps * 2.0**-52))
        assert again.is_solved
        assert again.iterations == 0


@pytest.mark.quick(1)
@pytest.mark.parametrize(
    ("F", "jacobian"),
    [
        (lambda x: x**2 - 1e-30, lambda x: np.diag(2 * x)),
        (lambda x: x**2 - 1e-30, None),
        (lambda x: -((x - 1) ** 2) - 1e-15, None),
    ],
)
def test_a_run_without_a_slope_ends_soon(F, jacobian):
    """Near-double roots from 0 end within 2000 steps, restarts included, right or STALLED."""
    result = solve(NonlinearProblem(F, jacobian, lower=[0.0]))
    assert result.iterations <= 2000
    if result.is_solved:
        assert result.z[0] == pytest.approx(1e-15, rel=1e-4)
    else:
        assert result.status is Status.STALLED


def test_the_check_of_the_draws_separates_a_solution_from_a_wrong_point():
    """The check in fractions accepts (0, 1, 1) and rejects (0, 1.5, .5) in the idle row's problem."""
    case = CONSTRUCTED["an idle row is not a reference"]
    linear = LCP(case.M, case.q)
    assert has_solution_near(linear, case.right)
    assert not has_solution_near(linear, case.wrong)


#: F tends to 0 as x₁ grows, and no x solves the problem.
ENDLESS: dict[str, Any] = {
    "exponential": lambda x: np.array([x[0] - 1 + np.exp(-x[1]), x[0] - 1]),
    "small unit": lambda x: np.array([x[0] - 1 + np.exp(-100 * x[1]), x[0] - 1]),
    "large unit": lambda x: np.array([x[0] - 1 + np.exp(-x[1] / 100), x[0] - 1]),
    "hyperbola": lambda x: np.array([x[0] - 1 + 1 / (1 + x[1]), x[0] - 1]),
}


UNITS = {"small unit": 0.01, "large unit": 100.0}  # of x₁; with exp(−1900) = 0 F would be 0


@pytest.mark.quick(1)
@pytest.mark.parametrize("has_start", [False, True])
@pytest.mark.parametrize("name", ENDLESS)
def test_a_point_on_the_way_to_infinity_is_not_solved(name, has_start):
    """The rows have the scale of x₀, so that they are small before x₁ is large: STALLED, with the reason."""
    start = [1.0, 19.0 * UNITS.get(name, 1.0)] if has_start else None
    result = solve(NonlinearProblem(ENDLESS[name], lower=np.zeros(2)), x0=start)
    assert not result.is_solved
    assert result.status is Status.STALLED
    assert "grow without limit" in result.advice


@pytest.mark.parametrize("kind", KINDS)
def test_a_manufactured_solution_is_not_taken_for_a_point_on_its_way(kind):
    """Units of 10^±4 in rows and unknowns, last bits changed, unknowns a bit off their bounds: none moves on."""
    for seed in range(20):
        rng = np.random.default_rng(seed)
        one = planted(rng, kind, int(rng.integers(1, 12)))
        row, unit = 10.0 ** rng.uniform(-4, 4, (2, one.x.size))
        problem = NonlinearProblem(
            lambda y, one=one, row=row, unit=unit: row * one.F(y * unit),
            lambda y, one=one, row=row, unit=unit: row[:, None] * one.jacobian(y * unit) * unit,
            one.lower / unit,
            one.upper / unit,
        )
        x = one.x / unit * (1 + 1e-15 * rng.integers(-1, 2, one.x.size))
        point = Linearization(problem, np.clip(x, problem.lower, problem.upper))
        assert not point.moves.any()


TAILS: dict[str, Any] = {
    "exp": (lambda y: np.exp(-y), lambda y: -np.exp(-y)),
    "1/y": (lambda y: 1 / (1 + y), lambda y: -1 / (1 + y) ** 2),
    "atan": (lambda y: np.pi / 2 - np.arctan(y), lambda y: -1 / (1 + y * y)),
}


@pytest.mark.quick(1)
@pytest.mark.parametrize("offset", [0.0, 64.0, 1000.0])
@pytest.mark.parametrize("size", [1e3, 1e5, 1e7])
@pytest.mark.parametrize("name", TAILS)
def test_no_offset_and_no_large_neighbor_makes_a_solution(name, size, offset):
    """x₀ − A + g(x₁ − offset) = 0 = x₀ − A has no solution, because g > 0 everywhere: no such point passes."""
    g, dg = TAILS[name]
    problem = NonlinearProblem(
        lambda x: np.array([x[0] - size + g(x[1] - offset), x[0] - size]),
        lambda x: np.array([[1.0, dg(x[1] - offset)], [1.0, 0.0]]),
        lower=[0.0, offset],
    )
    for y in (5.0, 19.0):
        assert certify(problem, [size, offset + y]).verdict != "proved"
    for tolerance in (1e-8, 1e-12):
        assert not solve(problem, x0=[1.0, offset], tolerance=tolerance).is_solved


@pytest.mark.parametrize(("size", "start"), [(1e5, 1.0), (1e3, 1e3)])
@pytest.mark.parametrize("name", TAILS)
def test_differences_that_miss_a_weak_slope_make_no_solution(name, size, start):
    """x₀ (1 + g(x₁)) = A = x₀ has no solution; forward differences are rounding errors where g is flat.

    With g(y) = e⁻ʸ both rows are 0 as doubles at x₁ = 1000.
    """
    g = TAILS[name][0]
    problem = NonlinearProblem(
        lambda x: np.array([x[0] * (1 + g(x[1])) - size, x[0] - size]), lower=[0.0, 0.0]
    )
    assert not solve(problem, x0=[size, start]).is_solved


def test_another_start_finds_the_solution_next_to_an_endless_path():
    """The path of Newton leads to x₁ = 2e8, and the solution is (e^¼ − 1, 0, √1.25)."""

    def F(x):
        log, far, square = 2 * np.log1p(x[0]), 2 / (1 + x[1]), 2 * x[2] ** 2
        return np.array([log + far - square, -log + far - square + 2, log - far / 2 + square - 2])

    result = solve(NonlinearProblem(F, lower=np.zeros(3)))
    assert result.is_solved
    np.testing.assert_allclose(result.z, [np.expm1(0.25), 0.0, np.sqrt(1.25)], atol=1e-6)


@pytest.mark.parametrize("weak", [1e-6, 1e-9, 1e-12])
def test_an_unknown_with_small_slopes_is_not_taken_for_endless(weak):
    """x₀ − 1 + weak (x₁ − 3)³ = 0 = x₀ − 1 + weak (x₁ − 3) has the solution (1, 3): its F is 0 there."""
    problem = NonlinearProblem(
        lambda x: np.array([x[0] - 1 + weak * (x[1] - 3) ** 3, x[0] - 1 + weak * (x[1] - 3)]),
        lower=np.zeros(2),
    )
    result = solve(problem, x0=[1.0, 3.0])
    assert result.is_solved
    np.testing.assert_allclose(result.z, [1.0, 3.0])


@pytest.mark.parametrize("start", [[5.0, 1.0], [2.0, 1.0], [-3.0, 7.0]])
def test_a_wrong_jacobian_gives_no_false_solution(start):
    """Its −1e9 for −1 makes every residual small: only (2, 1), where differences of F agree, is SOLVED."""
    problem = NonlinearProblem(
        lambda x: np.array([x[0] - x[1] - 1, x[1] - 1]),
        lambda x: np.array([[1.0, -1e9], [0.0, 1.0]]),
        lower=np.full(2, -np.inf),
    )
    result = solve(problem, x0=start)
    if result.is_solved:
        np.testing.assert_allclose(result.z, [2.0, 1.0])
    assert result.is_solved or start == [-3.0, 7.0]
    assert "jacobian disagrees" in result.begun


@pytest.mark.parametrize("size", [1e17, 1e20])
def test_contradictory_rows_that_rounding_makes_zero_are_not_solved(size):
    """The rows x₀ = x₁ + 1 and x₀ = x₁ − 1 hold as doubles at x₀ = x₁ = 10¹⁷, and at no x in exact numbers."""
    problem = NonlinearProblem(
        lambda x: np.array([x[0] - (x[1] + 1.0), x[0] - (x[1] - 1.0)]), lower=[-np.inf, -np.inf]
    )
    assert solve(problem, x0=[size, size]).status is not Status.SOLVED


@pytest.mark.parametrize("has_jacobian", [True, False])
def test_moving_unknowns_take_two_further_values_of_f_at_most(has_jacobian):
    """Beyond a Jacobian by central differences, at points that move on, right ones and flat ones."""
    problems = [(F, np.array([1.0, 19.0])) for F in ENDLESS.values()]
    problems += [(lambda x: np.exp(-x), np.array([800.0])), (lambda x: x - 1e-17, np.array([1e5]))]
    problems += [(lambda x: 1.0 - np.exp(-x) - 1e-12, np.array([1e-12 * (1 + 1e-4)]))]
    problems += [(lambda x: (x - 1) ** 2 + 1e-9, np.array([1.0 + 1e-4]))]
    most = 0
    for F, x in problems:
        points: list[Any] = []
        given = (lambda x, F=F: np.diag(F(x + 1e-3) - F(x)) / 1e-3) if has_jacobian else None
        counted = lambda x, F=F, points=points: (points.append(x), F(x))[1]  # noqa: E731
        point = Linearization(NonlinearProblem(counted, given, lower=np.zeros(x.size)), x)
        _ = point.references, point.q
        before = len(points)
        _ = point.moves
        limit = 2 if has_jacobian else 2 + 2 * x.size
        assert len(points) - before <= limit
        most = max(most, len(points) - before)
        assert point.moves is point.moves
    assert most >= 2
