"""Everyday data are solved: outsiders judge the points, and rounding noise changes no status."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import cvxpy as cp
import numpy as np
import pytest
import scipy.sparse as sp
from campaigns import refusals
from inputs import everyday
from inputs.everyday import GRAVITY, NOISE
from scipy.optimize import linprog

from lcp_plugin import (
    LCP,
    ConeProblem,
    FrictionalContact,
    NonlinearProblem,
    QuadraticProgram,
    Status,
    complements,
    march,
    solve,
    solve_batch,
)


def worst_violation(problem: LCP, z: Any) -> float:
    """Return the largest violation of a row next to its terms."""
    w = problem.csr @ z + problem.q
    terms = abs(problem.csr) @ abs(z) + abs(problem.q)
    violation = np.maximum(np.where(z > problem.lower, w, 0), np.where(z < problem.upper, -w, 0))
    assert (z >= problem.lower).all()
    assert (z <= problem.upper).all()
    return float((violation / np.maximum(terms, 1e-6 * terms.max() + 1e-300)).max())


@pytest.mark.parametrize("angle", [0.3, 0.71, 1.234])
@pytest.mark.parametrize("courses", [2, 3, 4, 6])
def test_a_wall_in_a_rotated_frame_stays_at_rest(courses, angle):
    """Every brick of a wall on the ground has the velocity 0 after the impulses."""
    contacts = everyday.wall(courses, courses, angle)
    result = solve(contacts.lcp()).require_solved()
    assert abs(contacts.velocity_after(result.z)).max() <= 1e-6 * GRAVITY
    assert result.z.min() >= 0.0


@pytest.mark.quick(1)
@pytest.mark.parametrize("noise", NOISE)
@pytest.mark.parametrize("boxes", [2, 6, 15])
def test_a_stack_of_doubled_contacts_stays_at_rest(boxes, noise):
    """Noise in the velocities of contacts, most of which are redundant, leaves the boxes at rest."""
    rng = np.random.default_rng(boxes)
    contacts = everyday.doubled_stack(boxes, rng)
    result = solve(contacts.lcp(noise * rng.normal(size=8 * boxes)))
    assert abs(contacts.velocity_after(result.require_solved().z)).max() <= 1e-6 * GRAVITY


@pytest.mark.parametrize("nodes", [3, 5, 8, 11])
def test_a_network_with_decimal_weights_is_at_rest_on_its_bound(nodes):
    """A Laplacian leaves every constant at rest; with leaks, the load that balances the bound determines z."""
    rng = np.random.default_rng(nodes)
    for low in rng.integers(1, 10, 6) / 10:
        K = everyday.network(nodes, rng)
        free = solve(LCP(K, np.zeros(nodes), lower=low)).require_solved().z
        assert np.ptp(free) <= 1e-7 * free.max()
        assert free.min() >= low
        leaking = LCP(K + 0.1 * np.eye(nodes), np.full(nodes, -0.1 * low), lower=low)
        np.testing.assert_allclose(solve(leaking).require_solved().z, low, rtol=1e-9)


@pytest.mark.parametrize("seed", range(6))
def test_a_market_with_decimal_costs_ships_at_the_least_cost(seed):
    """The flows of an equilibrium cost as much as those of HiGHS, and meet supply and demand."""
    problem, costs, supplies, demands = everyday.market(np.random.default_rng(seed))
    flows = solve(problem).require_solved().z[:24].reshape(4, 6)
    program = linprog(costs.ravel(), -problem.M[24:, :24], np.concatenate([supplies, -demands]))
    assert (flows.sum(axis=1) <= supplies + 1e-6).all()
    assert (flows.sum(axis=0) >= demands - 1e-6).all()
    assert (costs * flows).sum() == pytest.approx(program.fun, rel=1e-6)


@pytest.mark.parametrize("seed", range(10))
def test_a_game_with_decimal_payoffs_and_ties_ends_at_an_equilibrium(seed):
    """No player gains by another pure strategy."""
    rng = np.random.default_rng(seed)
    A, B = rng.integers(0, 10, (2, *rng.integers(2, 7, 2))) / 10
    problem = LCP.from_game(A, B)
    found = problem.origin.recover(solve(problem).require_solved())
    x, y = found.row_strategy, found.column_strategy
    assert (A @ y).max() <= x @ A @ y + 1e-8
    assert (x @ B).max() <= x @ B @ y + 1e-8


@pytest.mark.parametrize("noise", [0.0, 1e-17, 1e-15])
@pytest.mark.parametrize("seed", range(4))
def test_sliding_contacts_are_solved_with_noise_on_loaded_rows(seed, noise):
    """A problem of friction with a solution is solved; a row without load gets no noise, which would leave none."""
    rng = np.random.default_rng(seed)
    exact, z = everyday.sliding_contacts(3, rng)
    has_unknown = np.array(z > 0.0)
    problem = LCP(
        exact.M, exact.q + noise * abs(exact.q).max() * rng.normal(size=exact.n) * has_unknown
    )
    assert worst_violation(problem, solve(problem).require_solved().z) <= 1e-6


# --- Rounding noise changes no status --------------------------------------------------------------------------------


class Rows:
    """M = J Jᵀ, whose rows repeat one another, q, and the velocity Jᵀ z that every solution z has."""

    def __init__(self, seed: int) -> None:
        rng = np.random.default_rng(seed)
        J = rng.integers(-3, 4, (4, 5)) / 10
        self.J = np.vstack([J, J[:2], J[1] + J[2]])
        z, w = np.array([0.3, 0, 0, 0.7, 0, 0, 0]), np.zeros(7)
        direction = np.linalg.lstsq(J, [0.0, 0.0, 0.2, 0.0], rcond=None)[0]
        w = self.J @ direction  # q = w − M z stays in the range of J
        self.M, self.q, self.velocity = self.J @ self.J.T, w - self.J @ (self.J.T @ z), self.J.T @ z


def one_ulp(rows: Rows) -> None:
    """Move each entry of q and of M to the next number."""
    rows.q = np.nextafter(rows.q, np.inf)
    rows.M = np.nextafter(rows.M, np.inf)


def small_for_zero(rows: Rows) -> None:
    """Replace the zeros of q and M by 1e-17."""
    rows.q = np.where(rows.q == 0.0, 1e-17, rows.q)
    rows.M = np.where(rows.M == 0.0, 1e-17, rows.M)


def rotated_frame(rows: Rows) -> None:
    """Multiply out J Jᵀ and J v in rotated coordinates."""
    rotation = np.linalg.qr(np.random.default_rng(0).normal(size=(5, 5)))[0]
    turned = rows.J @ rotation
    rows.M, rows.q = turned @ turned.T, turned @ (rotation.T @ np.linalg.lstsq(rows.J, rows.q)[0])


def power_of_two(rows: Rows) -> None:
    """Multiply every row by 2⁴⁰."""
    rows.q, rows.M = 2.0**40 * rows.q, 2.0**40 * rows.M


def as_contacts(rows: Rows) -> Any:
    """Return the points of contacts whose tangential rows are the identity."""
    W, b = np.eye(14) * rows.M[0, 0], np.zeros(14)
    W[::2, ::2], b[::2] = rows.M, rows.q
    result = solve(FrictionalContact(W, b, 0.5, dimension=2))
    return result.status, result.z[::2]


def as_cvxpy(rows: Rows) -> Any:
    """Return the value of a complementarity model."""
    x = cp.Variable(7)
    model = cp.Problem(cp.Minimize(0), [complements(x >= 0, rows.M @ x + rows.q >= 0)])
    model.solve(method="LCP")
    return (Status.SOLVED if model.status == cp.OPTIMAL else model.status), x.value


def point_of(result: Any) -> Any:
    """Return status and point of a result."""
    return result.status, result.x if hasattr(result, "x") else result.z


CHANGES = (one_ulp, small_for_zero, rotated_frame, power_of_two)
CLASSES: dict[str, Callable[[Rows], Any]] = {
    "LCP": lambda r: point_of(solve(LCP(r.M, r.q))),
    "sparse": lambda r: point_of(solve(LCP(sp.csr_array(r.M), r.q))),
    "batch": lambda r: point_of(solve_batch(r.M, [r.q, r.q])[1]),
    "march": lambda r: point_of(march(LCP(r.M, r.q), [r.q] * 2, propagator=0.0)[1]),
    "cones": lambda r: point_of(solve(ConeProblem(r.M, r.q, [("nonnegative", 7)]))),
    "contacts": as_contacts,
    "nonlinear": lambda r: point_of(
        solve(NonlinearProblem(lambda z: r.M @ z + r.q, lambda z: r.M, 0.0), x0=np.zeros(7))
    ),
    "program": lambda r: point_of(solve(QuadraticProgram(0.5 * (r.M + r.M.T), r.q, lower=0.0))),
    "cvxpy": as_cvxpy,
}


@pytest.mark.quick(1)
@pytest.mark.parametrize("change", CHANGES)
@pytest.mark.parametrize("problem_class", CLASSES)
def test_rounding_noise_changes_no_status(problem_class, change):
    """Redundant rows remain SOLVED, with the same velocity, in each class and after each change."""
    for seed in range(3):
        rows = Rows(seed)
        for alter in (lambda rows: None, change):
            alter(rows)
            status, z = CLASSES[problem_class](rows)
            assert status is Status.SOLVED
            np.testing.assert_allclose(rows.J.T @ z, rows.velocity, atol=1e-6)


@pytest.mark.parametrize("problem_class", refusals.CLASSES)
def test_a_right_point_is_solved(problem_class, draws):
    """A planted solution, exact, one ulp off or with noise in q, is SOLVED where the run begins."""
    for k in draws(400, 20):
        rng = np.random.default_rng([1, k])
        assert not [*refusals.refused(rng, problem_class)], k


@pytest.mark.full
def test_integer_problems_in_units_far_apart_are_not_solved_falsely():
    """An exact solution in fractions is near each SOLVED point, and half of the problems are solved."""
    found = [
        line for k in range(200) for line in refusals.false_in_units(np.random.default_rng([2, k]))
    ]
    assert found.count("SOLVED") == len(found) > 60


# --- Single inputs ---------------------------------------------------------------------------------------------------


def test_a_problem_of_the_largest_numbers_is_solved():
    """Terms that overflow when they are added do not refuse z = 1."""
    result = solve(LCP(np.diag([1e308, 1e308]), [-1e308, -1e308]))
    np.testing.assert_array_equal(result.require_solved().z, 1.0)


@pytest.mark.parametrize("correlation", [0.6, 0.3, -0.5])
@pytest.mark.parametrize("algorithm", ["auto", "psor", "newton", "multigrid", "interior_point"])
def test_a_put_on_two_assets_is_priced_to_its_far_field(algorithm, correlation):
    """Far from the strike the values fall below 1e-90, and no method computes all of their digits."""
    for nodes in (31, 41):
        problem = everyday.put_on_two_assets(nodes, (0.15, 0.35), correlation)
        z = solve(problem, algorithm).require_solved().z
        slack, above = problem.slack(z), z - problem.lower
        np.testing.assert_allclose(np.minimum(above, slack), 0.0, atol=1e-8)
        np.testing.assert_allclose(np.minimum(above, abs(slack)), 0.0, atol=1e-8)


@pytest.mark.parametrize("q", [-5e-324, -1e-323, -1e-310])
@pytest.mark.parametrize("diagonal", [9.99, 3.0, 1.0])
def test_a_load_below_the_normal_doubles_is_zero(diagonal, q):
    """The result is 0 or a denormal z, but no failure and no search."""
    result = solve(LCP([[diagonal]], [q])).require_solved()
    assert 0.0 <= result.z[0] <= 1e-310


def test_a_denormal_load_in_small_units_is_no_zero():
    """Only z = 10 solves 1e-310 z ≥ 1e-309."""
    assert solve(LCP([[1e-310]], [-1e-309])).require_solved().z[0] == pytest.approx(10.0)


def test_a_march_decays_to_nothing():
    """Each step divides z_0 by −2, beyond the smallest double."""
    problem = LCP(np.diag([2.0, 3.0]), [0.0, 0.0], lower=[-np.inf, 0.0])
    run = march(problem, np.zeros((1100, 2)), propagator=-1.0, z0=[1.0, 1.0])
    assert len(run) == 1100
    assert run[-1].require_solved().z[0] == 0.0


def test_a_contact_below_the_normal_doubles_is_at_rest():
    """An approach velocity of 1e-310 gives an impulse of at most 1e-310."""
    result = solve(FrictionalContact(np.eye(3), np.array([-1.0, 0.1, 0.2]) * 1e-310, 0.5))
    assert np.linalg.norm(result.require_solved().x) <= 2e-310


@pytest.mark.parametrize("correlation", [0.6, 0.3])
def test_a_nonlinear_far_field_is_right_after_a_few_steps(correlation):
    """A point that passes is accepted although its largest residual, rounding error, is no smaller."""
    put = everyday.put_on_two_assets(21, (0.1, 0.4), correlation)
    M, q = put.csr, put.q
    problem = NonlinearProblem(lambda x: M @ x + q, lambda x: M, lower=put.lower)
    x = solve(problem, max_iterations=12).require_solved().x
    np.testing.assert_allclose(x, solve(put).require_solved().z, atol=1e-12)
