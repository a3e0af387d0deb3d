"""absolute_tolerance: a residual in the unit of z that is small enough whatever it is relative to."""

from __future__ import annotations

import json
from typing import Any

import cvxpy as cp
import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from lcp_plugin import LCP, NonlinearProblem, Status, complements, march, solve, solve_batch
from lcp_plugin.problems.nonlinear.solving import solve_nonlinear

AT_REST = [[-1.0, -1.0], [-1.0, 2.0]], [-5.6e-17, 1.0]  # no solution, by rounding


def test_contact_at_rest_is_accepted_or_said_to_be_rounding() -> None:
    """A contradiction of rounding size is PRECISION_LIMIT, and an absolute tolerance as large accepts it."""
    problem = LCP(*AT_REST)
    plain = solve(problem)
    assert plain.status is Status.PRECISION_LIMIT
    assert plain.infeasibility is not None
    value = 1.1 * max(plain.certificate.scaled_residual, plain.infeasibility.absolute_margin)
    for algorithm in ("auto", "lemke", "newton", "interior_point"):
        accepted = solve(problem, algorithm, absolute_tolerance=value)
        assert accepted.is_solved
        assert accepted.certificate.scaled_residual <= value
    assert "in the unit of z" in str(accepted)
    assert json.loads(accepted.to_json())["absolute_tolerance"] == value


def test_infeasible_beyond_the_tolerance_only() -> None:
    """Z ≥ 0, w = −z − gap has no solution by gap/1: INFEASIBLE where that is more than both tolerances."""
    problem = LCP([[-1.0]], [-1e-3])
    assert solve(problem).status is Status.INFEASIBLE
    assert solve(problem, absolute_tolerance=1e-5).status is Status.INFEASIBLE
    assert solve(problem, absolute_tolerance=2e-3).is_solved


@given(
    st.integers(0, 10**6),
    st.integers(1, 12),
    st.floats(-9, 3),
    st.sampled_from(["auto", "psor", "newton", "lemke"]),
)
def test_solved_means_one_tolerance_or_the_other_in_every_part(
    seed: int, n: int, exponent: float, name: str
) -> None:
    """SOLVED ⇔ ‖r_P‖∞ ≤ max(tolerance · reference, absolute_tolerance) for each component, in units of their own."""
    random = np.random.default_rng(seed)
    cut = int(random.integers(0, n))
    M = random.standard_normal((n, n)) * (random.random((n, n)) < 0.7)
    M[:cut, cut:], M[cut:, :cut] = 0.0, 0.0
    np.fill_diagonal(M, np.abs(M).sum(axis=1) + np.abs(M).sum(axis=0) + 1.0)
    unit = np.where(np.arange(n) < cut, 10.0 ** random.uniform(-6, 6), 1.0)
    problem, absolute = LCP(M, random.standard_normal(n) * unit), 10.0**exponent
    result = solve(
        problem,
        name,
        absolute_tolerance=absolute,
        tolerance=float(random.choice([1e-8, 1e-4, 0.0])),
    )
    largest, least = result.certificate.residuals_of_components
    assert result.is_solved == bool(
        (largest <= np.maximum(result.tolerance * least, absolute)).all()
    )
    assert result.is_solved


def test_a_start_that_is_good_enough_stays() -> None:
    """From a z within the absolute tolerance nothing is done; without it there is work."""
    problem = LCP([[2.0, -1.0], [-1.0, 2.0]], [-1.0, -1.0])
    near = [1.0 + 1e-6, 1.0]
    assert solve(problem, "psor", z0=near, absolute_tolerance=1e-5).iterations == 0
    assert solve(problem, "psor", z0=near).iterations > 0


def test_batches_marches_and_nonlinear_problems_take_it() -> None:
    """The same sentence holds for each problem of a batch, each step of a march, and F."""
    M, q = AT_REST
    batch = solve_batch([M, [[2.0, 0.0], [0.0, 2.0]]], [q, [-1.0, 1.0]], absolute_tolerance=1e-15)
    assert batch.all_solved
    steps = march(LCP(M, q), [q, q], propagator=0.0, absolute_tolerance=1e-15)
    assert len(steps) == 2
    assert steps.all_solved

    def F(x: Any) -> Any:
        return np.array(M) @ x + q + np.array([-1e-9, 0.0]) * x**2

    assert not solve_nonlinear(NonlinearProblem(F), [0.0, 0.0]).is_solved
    assert solve_nonlinear(NonlinearProblem(F), [0.0, 0.0], absolute_tolerance=1e-15).is_solved


def test_cvxpy_takes_it() -> None:
    """A model with a contact at rest has a value once rounding is allowed."""
    x = cp.Variable(2)
    M, q = map(np.array, AT_REST)
    problem = cp.Problem(cp.Minimize(0), [complements(x >= 0, M @ x + q >= 0)])
    problem.solve(method="LCP", absolute_tolerance=1e-15)
    assert problem.status == cp.OPTIMAL


def test_a_part_at_rest_does_not_hide_another() -> None:
    """A contact that is open by rounding beside a free body, or by more than that: both are answered."""
    M = np.zeros((4, 4))
    M[:2, :2], M[2:, 2:] = AT_REST[0], [[2.0, -1.0], [-1.0, 2.0]]
    problem = LCP(M, [*AT_REST[1], -1.0, -1.0])
    for absolute in (1e-16, 1e-9, 1e-3):
        for algorithm in ("auto", "newton", "interior_point"):
            result = solve(problem, algorithm, absolute_tolerance=absolute)
            assert result.is_solved, (absolute, algorithm)
            assert np.allclose(result.z, [0.0, 0.0, 1.0, 1.0], atol=2.0 * absolute)
    assert solve(LCP([[-1.0, 0.0], [0.0, 2.0]], [-1e-3, -1.0]), absolute_tolerance=2e-3).is_solved


@given(st.integers(0, 10**6))
def test_the_advised_number_is_enough(seed: int) -> None:
    """Where the advice names an absolute tolerance, the same call with it is SOLVED."""
    random = np.random.default_rng(seed)
    n = int(random.integers(1, 5))
    M = random.integers(-3, 4, (n, n)).astype(float)
    q = np.where(
        random.random(n) < 0.5, 1e-17 * random.standard_normal(n), random.integers(-3, 4, n)
    )
    plain = solve(LCP(M, q))
    if "absolute_tolerance=" in plain.advice:
        value = float(plain.advice.split("absolute_tolerance=")[1].split()[0])
        assert solve(LCP(M, q), absolute_tolerance=value).is_solved


def test_a_huge_one_accepts_everything() -> None:
    """Nothing overflows on the way."""
    for M, q in (([[2.0, 1.0], [1.0, 2.0]], [-5.0, 1.0]), (np.eye(2), [-1e-9, -1.0])):
        assert solve(LCP(M, q), absolute_tolerance=1e300).is_solved
        assert solve(LCP(M, q), absolute_tolerance=1e300, tolerance=0.0).is_solved
