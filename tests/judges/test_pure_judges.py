"""SOLVED is a function of the data, the point and the tolerance: not of the algorithm, the start or the neighbors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import qpsolvers
import scipy.sparse as sp

from lcp_plugin import (
    LCP,
    BoundedLeastSquares,
    FrictionalContact,
    QuadraticProgram,
    Status,
    certify,
    solve,
    solve_batch,
)
from lcp_plugin.algorithms import REGISTRY
from lcp_plugin.judges.program import KKTErrors, PrimalDualPoint, sharp_errors


def planted(seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return M = A Aᵀ + I/10, q and the z* that was chosen first; every third problem has z* = 0."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(2, 9))
    A, size = rng.normal(size=(n, n)), np.abs(rng.normal(size=n))
    z = np.where((rng.random(n) < 0.5) & (seed % 3 > 0), size, 0.0)
    M = A @ A.T + 0.1 * np.eye(n)
    return M, np.where(z > 0.0, 0.0, size) - M @ z, z


@pytest.mark.parametrize("solver", ["clarabel", "piqp", "daqp"])
@pytest.mark.parametrize("seed", range(8))
def test_points_of_other_solvers_are_proved(seed, solver):
    """z_i = 1e-13 or −1e-13 is the point of an interior-point method for 0; moved by 1e-2 it is disproved."""
    M, q, z = planted(seed)
    P = sp.csc_matrix(M) if solver == "clarabel" else M
    x = qpsolvers.solve_qp(P, q, lb=np.zeros(z.size), solver=solver)
    unit = max(np.abs(z).max(), np.abs(q / M.diagonal()).max())
    assert np.abs(x - z).max() <= 1e-5 * unit
    found = certify(LCP(M, q), x)
    assert found.verdict == ("proved" if np.abs(x - z).max() <= 1e-7 * unit else found.verdict)
    assert certify(LCP(M, q), x + 1e-2 * unit).verdict == "disproved"
    if seed % 3 and seed < 6:  # 1e-13 and −1e-17 stand for the bound 0 also in the program
        program = QuadraticProgram(M, q, lower=0)
        assert certify(program, x).verdict == "proved"
        assert certify(program, x + 0.1 * np.abs(q / M.diagonal()).max()).verdict == "disproved"


def test_residuals_of_a_program_are_those_of_qpsolvers():
    """Absolute primal, dual and gap residuals of a point and its multipliers."""
    rng = np.random.default_rng(0)
    A, G, B = rng.normal(size=(5, 5)), rng.normal(size=(6, 5)), rng.normal(size=(2, 5))
    data = A @ A.T, rng.normal(size=5), G, np.ones(6), B, B @ rng.normal(size=5) * 0.1
    program = QuadraticProgram(*data, lower=-np.ones(5), upper=np.full(5, 2.0))
    theirs = qpsolvers.Solution(qpsolvers.Problem(*data, -np.ones(5), np.full(5, 2.0)))
    ours = solve(program).solution
    theirs.x, theirs.y, theirs.z = ours.x + 1e-3, np.array(ours.equality), np.array(ours.inequality)
    theirs.z_box = ours.upper - ours.lower
    theirs.found = True
    given = replace(ours, x=theirs.x)
    expected = theirs.primal_residual(), theirs.dual_residual(), theirs.duality_gap()
    assert given.residuals()[:3] == pytest.approx(expected, rel=1e-9, abs=1e-14)


@pytest.mark.parametrize(
    ("b", "z"),
    [([-1.0, 2, 0], [1, -0.5 * (1 - 1e-12), 0]), ([1.0, 2, 0], [1e-12, 0, 0])],
    ids=["sliding", "open"],
)
def test_a_contact_that_is_right_to_rounding_is_proved(b, z):
    """Sliding within 1e-12 of the boundary, and open with an impulse of 1e-12."""
    assert certify(FrictionalContact(np.eye(3), b, 0.5, dimension=3), z).verdict == "proved"


def test_an_impulse_outside_its_friction_cone_is_disproved_next_to_a_large_one():
    """Two contacts of 1e6 and 1e-3 that hardly interact: 1000 times the friction of the small one."""
    W = np.eye(6)
    W[0, 3] = W[3, 0] = 1e-12
    problem = FrictionalContact(W, [-1e6, 0, 0, -1e-3, 1.0, 0], [0.5, 0.5], dimension=3)
    z = np.array(solve(problem).z)
    assert certify(problem, z).verdict == "proved"
    z[4] *= 1000.0
    assert certify(problem, z).verdict == "disproved"


@pytest.mark.parametrize("x", [(5, 0), (5, 9999995), (-5, 0), (-9, 1)])
def test_an_inactive_row_is_no_scale_for_points_of_a_program(x):
    """Next to x₁ + x₂ ≤ 1e7, 5 is far from the minimizer 0, and −5 far outside of the bound 0."""
    program = QuadraticProgram(None, [1, 0], G=[[1, 1]], h=[1e7], lower=[0, 0])
    found = certify(program, x)
    assert found.verdict == "disproved"
    assert found.violation == max(-x[0], 0.0)


def test_a_gradient_that_is_no_rounding_error_has_no_price_by_cancelling_terms():
    """P is singular, and x₁ = 0 without a cost gains 9e-4 on its way to the bound −1e6."""
    g = 2.0**-30
    program = QuadraticProgram(np.ones((3, 3)), [-g, 0, -g], lower=[-np.inf, -1e6, -np.inf])
    x = np.array([1.0, 0.0, -1.0 + g])
    assert not KKTErrors.of(program.judged, x, np.zeros(0), 1e-6).meet(1e-6)


def test_a_sum_that_is_zero_by_rounding_is_no_least_squares_solution():
    """30 x₁ + 20 x₂ + 2 is 0 in double precision at x of 8e14, and 0.75 exactly."""
    problem = BoundedLeastSquares([[30.0, 20.0]], [-2.0], lower=[0, -np.inf], upper=np.inf)
    found = solve(problem, x0=[554700196225229.1, -832050294337843.8])
    assert not found.is_solved or np.abs(found.x).max() < 1e9


@pytest.mark.parametrize("t", [0.1, 0.5, -1.0])
def test_a_contact_that_falls_straight_is_solved_from_each_start(t):
    """No tangential velocity, no friction: z_T of a run is 1e-17, next to a row without terms."""
    problem = FrictionalContact(np.diag([5.0, 5.0]), [-0.9, 0], [0.5], dimension=2)
    assert solve(problem, z0=[1.0, t]).status is Status.SOLVED


@pytest.mark.parametrize(
    ("q", "z", "verdict"),
    [([1.0, 0.0], [2.4e-14, 0.5], "proved"), ([1.0, 0.0], [2.4e-3, 0.5], "disproved")],
)
def test_rounding_errors_next_to_a_row_without_load_are_zeros(q, z, verdict):
    """z* = (0, 1/2); the only term of the second row is an error of an interior-point method."""
    assert certify(LCP([[0, -2], [2, 0]], q), z).verdict == verdict


def test_a_component_without_data_has_no_scale():
    """M z = 1e-7 at z = (1, 1) next to q = 0: the only solution is 0."""
    assert certify(LCP([[1, -1], [-1, 1 + 1e-7]], [0, 0]), [1, 1]).verdict == "disproved"


def test_least_squares_solved_at_the_start_are_recorded():
    """AᵀWb is 0 up to rounding: the record has no reference to divide by."""
    A = [[-0.1], [-0.2], [-0.1], [0.3], [0.1]]
    problem = BoundedLeastSquares(A, [3, -3, 1, -1, 1], lower=-np.inf, upper=np.inf)
    assert solve(problem, record=True).is_solved


@pytest.mark.parametrize("n", [20, 40])
def test_a_row_of_equal_spinning_discs_is_solved(n):
    """Discs on the ground that touch and spin: the velocities of their contacts are 0 up to rounding."""
    J = np.zeros((4 * n - 2, 3 * n))
    at = iter(range(4 * n - 2))
    for i in range(n):
        J[next(at), 3 * i + 1] = 1.0
        J[next(at), [3 * i, 3 * i + 2]] = 1.0, 0.5
        if i:
            J[next(at), [3 * i, 3 * i - 3]] = 1.0, -1.0
            J[next(at), [3 * i + 1, 3 * i - 2, 3 * i + 2, 3 * i - 1]] = 1.0, -1.0, -0.5, -0.5
    inverse, v = np.tile([1.0, 1.0, 8.0], n), np.tile([0.0, -0.0981, 1.0], n)
    found = solve(FrictionalContact((J * inverse) @ J.T, J @ v, 0.3, dimension=2))
    assert found.status is Status.SOLVED


def test_least_squares_at_a_start_that_ran_away_are_not_solved_there():
    """Opposite columns allow x = 1e16 with any residual at rounding level of its terms; the minimum is 2.925."""
    rng = np.random.default_rng(9)
    B, a, b = rng.normal(size=(6, 4)), rng.normal(size=(6, 1)), rng.normal(size=6)
    problem = BoundedLeastSquares(np.hstack([B, a, -a]), b, lower=0)
    best = solve(problem)
    found = solve(problem, x0=[0, 0, 0, 0, 1e16, 1e16])
    assert best.is_solved
    assert not found.is_solved or found.cost == pytest.approx(best.cost, rel=1e-6)


def test_a_program_is_infeasible_also_next_to_large_ones_in_a_batch():
    """0 = 5e-10 is no rounding error of a right-hand side of 1e9 in another problem."""
    program = QuadraticProgram(np.eye(2), [0, 0], A=[[1.0, 1], [0, 0]], b=[1, 0])
    bad, big = program.with_vectors(b=[1, 5e-10]), program.with_vectors(b=[1e9, 0])
    assert solve(bad).status is Status.INFEASIBLE
    assert solve_batch([bad, big] * 20).status[0] is Status.INFEASIBLE


@pytest.mark.parametrize("lower", [-np.inf, 0.0])
def test_columns_that_are_dependent_up_to_decimals_are_solved(lower):
    """The fourth column is a sum of the others, rounded to 12 decimals: |x| is 1e11, which the data explain."""
    for seed in range(60300, 60310):
        rng = np.random.default_rng(seed)
        A, b = np.round(rng.normal(size=(20, 3)), 1), np.round(rng.normal(size=20), 1)
        B = np.column_stack([A, np.round(A @ rng.normal(size=3), 12)])
        assert solve(BoundedLeastSquares(B, b, lower=lower)).is_solved


def test_a_start_far_away_changes_no_status():
    """At a z that ran away along a null direction every residual is rounding; the problem stays INFEASIBLE."""
    problem = LCP([[1.0, -2], [-2, 4]], [7.0, -16])
    for z0 in (None, [8.8e14, 4.4e14], [1.0, 1.0]):
        assert solve(problem, z0=z0).status is Status.INFEASIBLE, z0


def test_a_start_that_is_the_solution_is_used_however_far_away():
    """On a chain of 4000 the solution itself lies far beyond the data: no iteration is needed from there."""
    n = 4000
    M = sp.diags_array([-1.0, 2.0, -1.0], offsets=[-1, 0, 1], shape=(n, n))
    z = np.arange(1.0, n + 1) * np.arange(n, 0.0, -1.0) / 2.0
    assert solve(LCP(M, -np.ones(n)), "npgs", z0=z).iterations == 0


@pytest.mark.parametrize("seed", range(6))
def test_one_problem_has_one_status_by_each_way(seed, tmp_path):
    """Conditions of a program, the same M and q by hand, after save and load, in batches, by each algorithm."""
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(4, 4))
    stated = LCP.from_qp(A @ A.T + np.eye(4), rng.normal(size=4), rng.normal(size=(2, 4)), [1, 1])
    plain = LCP(stated.M, stated.q, lower=stated.lower, upper=stated.upper)
    stated.save(tmp_path / "p.npz")
    ways = [stated, plain, LCP.load(tmp_path / "p.npz"), stated.with_q(stated.q)]
    z = solve(plain).z
    assert {certify(one, z).verdict for one in ways} == {"proved"}
    found = [solve(one) for one in ways]
    found += [solve(one, name) for one in ways for name in ("lemke", "newton", "interior_point")]
    assert {one.status for one in found} == {Status.SOLVED}
    assert {*solve_batch([stated]).status, *solve_batch(ways * 10).status} == {Status.SOLVED}


@pytest.mark.parametrize("name", REGISTRY)
def test_the_same_point_has_the_same_status_by_each_algorithm(name):
    """A start that is a solution is SOLVED, and returned as it is."""
    problem = LCP([[2.0, 1.0], [1.0, 2.0]], [-5.0, 1.0])
    found = solve(problem, name, z0=[2.5, 0.0], max_iterations=1)
    assert (found.status, *found.z) == (Status.SOLVED, 2.5, 0.0)


@pytest.mark.parametrize("sums", ["plain", "exact", "sufficient"])
def test_a_multiplier_of_the_wrong_sign_proves_no_minimum(sums):
    """The least x over x ≤ 1 is −∞, and 1 − 1 = 0 is the gradient at x = 1 with the multiplier −1."""
    judged = QuadraticProgram(None, [1.0], [[1.0]], [1.0]).judged
    x, y = np.array([1.0]), np.array([-1.0])
    errors = sharp_errors(judged, x, y)
    if sums != "sufficient":
        point = PrimalDualPoint(judged, x, y, is_exact=sums == "exact")
        errors = KKTErrors(point.row_errors().max(), point.gaps().max())
    assert not errors.meet(1e-6)
