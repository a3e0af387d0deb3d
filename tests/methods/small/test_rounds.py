"""Rounds of active sets and Lemke's paths on small dense problems, one or a stack."""

import subprocess
import sys
from importlib import import_module

import numpy as np
import pytest
from inputs.small_families import FAMILIES, definite_stack, draw, told
from oracles.exact_criterion import failures
from oracles.truth import ExactData

from lcp_plugin import LCP, Status, solve, solve_batch
from lcp_plugin.core.checks import read_only
from lcp_plugin.judges.lcp import bound_residual, row_data
from lcp_plugin.methods.small import FREE, active_point, dense_data, solve_stack

INF = np.inf


@pytest.mark.parametrize("family", FAMILIES)
def test_watching_a_run_changes_nothing(family, draws):
    """With record or a callback the same bits, iterations, work and stages, for cold and warm starts and limits."""
    rng = np.random.default_rng(0)
    for k, drawn in enumerate(draw(family, len(draws(6, 2)), 9)):
        z0 = None if k % 3 else rng.normal(size=drawn.n)
        limit = {} if k % 4 else {"max_iterations": k % 5}
        alone = solve(drawn, z0=z0, **limit)
        watched = solve(drawn, z0=z0, record=True, **limit)
        called = solve(drawn, z0=z0, callback=lambda sample, z: False, **limit)
        assert told(alone) == told(watched) == told(called)


@pytest.mark.parametrize("family", FAMILIES)
def test_no_solved_point_is_a_lie(family, draws):
    """Exact arithmetic confirms the residual of each SOLVED point, and a batch of any sizes has the same statuses."""
    problems = draw(family, len(draws(12, 2)), 8)
    results = [solve(drawn) for drawn in problems]
    for drawn, result in zip(problems, results, strict=True):
        assert not result.is_solved or not ExactData(drawn).is_lie(result.z, 1e-8)
    batch = solve_batch(problems)
    assert [result.status for result in results] == list(batch.status)
    assert isinstance(batch.z, list) or len({drawn.n for drawn in problems}) == 1
    for k in range(len(problems)):
        assert batch[k].status is batch.status[k]


@pytest.mark.parametrize("n", [1, 2, 5, 17, 60, 128, 256])
def test_a_planted_solution_is_found_by_the_first_rounds(n):
    """Bounds on both sides and free rows; M positive definite, or triangular and P."""
    rng = np.random.default_rng(n)
    for matrix in (
        definite_stack(1, n, n)[0][0],
        np.tril(rng.normal(size=(n, n)), -1) / n + np.eye(n),
    ):
        lower = np.where(rng.random(n) < 0.1, -INF, np.where(rng.random(n) < 0.3, -1.0, 0.0))
        upper = np.where(rng.random(n) < 0.4, np.maximum(lower, 0.0) + 1.0, INF)
        side = rng.integers(0, 3, n)
        side[(side == 0) & (lower == -INF)] = 1
        side[(side == 2) & (upper == INF)] = 1
        inside = np.maximum(np.minimum(lower, upper), -0.5) + 0.25
        z = np.select([side == 0, side == 2], [lower, upper], inside)
        w = np.select([side == 0, side == 2], [1.0, -1.0], 0.0)
        result = solve(LCP(matrix, w - matrix @ z, lower=lower, upper=upper))
        assert result.status is Status.SOLVED
        np.testing.assert_allclose(result.z, z, atol=1e-7)
        assert {stage.name for stage in result.stages} <= {"rounds", "path"}


def test_a_game_is_solved_by_its_path():
    """Lemke and Howson's path on random bimatrix games, where paths from r > 0 end on a ray."""
    rng = np.random.default_rng(0)
    for shape in ((1, 1), (1, 4), (3, 3), (2, 9), (8, 8), (20, 20), (25, 9)):
        problem = LCP.from_game(rng.random(shape), rng.random(shape))
        found = solve(problem).require_solved()
        assert problem.origin.recover(found).regret <= 1e-9
        assert {stage.name for stage in found.stages} == {"path"}


@pytest.mark.parametrize("is_regular", [True, False])
def test_free_rows_without_a_diagonal_are_eliminated_or_split(is_regular):
    """A program with an equation, and one with the same equation twice."""
    G = np.array([[1.0, 2.0, 1.0]]) if is_regular else np.array([[1.0, 2.0, 1.0]] * 2)
    m = len(G)
    M = np.block([[np.eye(3), -G.T], [G, np.zeros((m, m))]])
    lower = np.r_[np.zeros(3), np.full(m, -INF)]
    result = solve(LCP(M, np.r_[-1.0, 0.0, 1.0, -np.full(m, 1.0)], lower=lower))
    assert result.is_solved
    assert abs(G[0] @ result.z[:3] - 1.0) <= 1e-10


@pytest.mark.full
def test_a_point_that_the_sufficient_test_accepts_passes_the_criterion():
    """The criterion does not move the point, and its residual is at most the bound."""
    kernel, accepted = import_module("lcp_plugin.judges.lcp").bound_residuals, 0
    rng = np.random.default_rng(0)
    for drawn in (one for family in FAMILIES for one in draw(family, 60, 8)):
        data, n = (drawn.matrix.toarray(), drawn.q, drawn.lower, drawn.upper), drawn.n
        M, *vectors = (read_only(one[None]) for one in (*data, drawn.nearest_to_zero))
        solved, bound = solve(drawn).z, np.empty(1)
        for size in (0.0, 1e-16, 1e-13, 1e-10, 1e-8):
            z = solved * (1.0 + size * rng.normal(size=n))
            kernel(M, *vectors, 1e-8, np.empty((6, n)), z[None], bound)
            found = row_data(drawn).measure(z, 1e-8)
            if bound[0] < INF:
                accepted += 1
                assert found.passes
                assert found.residual <= bound[0]
                assert np.array_equal(found.z, z)
    assert accepted > 500


def test_a_point_that_the_quick_test_of_one_problem_accepts_passes_the_criterion():
    """The criterion does not move the point, also of several components, of which z° may solve some.

    In some problems w = 0 at upper bounds, next to which noise would be moved to them.
    """
    rng, accepted, coarse = np.random.default_rng(0), 0, 0
    ordinary = [one for family in FAMILIES for one in draw(family, 20, 8)]
    flat = [LCP(one.M, -one.M @ np.ones(one.n), upper=1.0) for one in ordinary]
    for drawn in (*ordinary, *flat):
        data, solved = dense_data(drawn), solve(drawn, z0=np.ones(drawn.n)).z
        for size in (0.0, 1e-16, 1e-13, 1e-10, 1e-8):
            z = np.clip(solved * (1.0 + size * rng.normal(size=drawn.n)), drawn.lower, drawn.upper)
            if (bound := bound_residual(data, z, 1e-8)) < INF:
                accepted += 1
                coarse += size == 1e-10  # above rounding
                found = data.measure(z, 1e-8)
                assert found.passes
                assert found.residual <= bound
                assert np.array_equal(found.z, z)
                assert not z[np.broadcast_to(data.is_solved_at_origin, z.shape)].any()
    assert min(accepted, 2 * coarse) > 100


@pytest.mark.quick(1)
@pytest.mark.parametrize(
    "problem",
    [
        "np.array([[4., 1.], [1., 3.]]), [-1., -2.]",
        "np.array([[0., 1.], [1., 0.]]), [-1., -1.]",
        "np.array([[0., -1.], [1., 0.]]), [1., -1.], lower=[-np.inf, 0.]",
    ],
)
def test_a_small_problem_loads_no_numba(problem):
    """The first solve of a process compiles nothing, and a batch of 10 problems does not wait for the loop."""
    code = (
        "import sys, numpy as np, lcp_plugin as lp\n"
        f"assert lp.solve(lp.LCP({problem})).is_solved\n"
        "assert lp.solve_batch([[[2.0]]] * 10, [-1.0]).all_solved\n"
        "assert 'numba' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_a_point_of_nearly_singular_rows_passes_the_rule_at_a_tolerance_of_rounding():
    """At 1e-16, SOLVED points pass the rule in rational arithmetic; a point that fails is followed by other stages."""
    rng = np.random.default_rng(0)
    for _ in range(60):
        A = np.vander(rng.integers(1, 9, 3) + 1e-4 * rng.random(3), 3)
        problem = LCP(A @ A.T, rng.standard_normal(3))
        result = solve(problem, tolerance=1e-16)
        assert not result.is_solved or failures(problem, result.z, tolerance=1e-16) == []


def test_the_far_field_of_a_batch_is_solved_to_its_terms():
    """A chain decays by 10⁻³ from row to row: every row of every problem is right to 1e-6 of its terms."""
    n, count = 6, 200
    M = 2.0 * np.eye(n) - 1e-3 * (np.eye(n, k=1) + np.eye(n, k=-1))
    q = np.zeros((count, n))
    q[:, 0] = -1.0 - np.arange(count) / count
    batch = solve_batch(M, q)
    assert batch.all_solved
    w, terms = batch.z @ M.T + q, batch.z @ np.abs(M).T + np.abs(q)
    assert (np.abs(w) <= 1e-6 * terms).all()
    assert (batch.z > 0.0).all()


def test_the_far_field_of_a_stack_is_solved_in_the_stack():
    """After the path, which leaves out what is below its perturbation, idle rows are free."""
    n, count = 60, 40
    M = 2.0 * np.eye(n) - 0.5 * (np.eye(n, k=1) + np.eye(n, k=-1))
    q = np.zeros((count, n))
    q[:, 0] = -1.0 - np.arange(count) / count
    z, _, _, is_solved = solve_stack(M[None], q, 0.0 * q, 0.0 * q + np.inf, tolerance=1e-8)
    assert is_solved.all()
    np.testing.assert_allclose(z, np.linalg.solve(M, -q.T).T, rtol=1e-9, atol=1e-30)


def test_a_singular_consistent_active_set_has_its_least_solution():
    """Of a network with every balance stated, one potential is superfluous."""
    M = np.array([[1.0, -1.0], [-1.0, 1.0]])
    z = active_point(M, np.array([-1.0, 1.0]), np.zeros(2), np.full(2, np.inf), np.full(2, FREE))
    np.testing.assert_allclose(z, [0.5, -0.5])


@pytest.mark.parametrize("family", FAMILIES)
def test_lemke_by_name_has_the_bits_of_a_batch_and_of_a_watched_run(family, draws):
    """The compiled path solves a problem by itself, in a batch of any size and under watch or limits with one z."""
    problems = draw(family, len(draws(6, 2)), 9)
    batch = solve_batch(problems, algorithm="lemke", prove_infeasibility=False)
    for k, drawn in enumerate(problems):
        how = {"prove_infeasibility": False}
        alone = solve(drawn, "lemke", **how)
        assert not alone.is_solved or not ExactData(drawn).is_lie(alone.z, 1e-8)
        for watch in (
            {"record": True},
            {"callback": lambda sample, z: False},
            {"max_seconds": 60.0},
            {"z0": drawn.nearest_to_zero},
        ):
            assert told(solve(drawn, "lemke", **how, **watch)) == told(alone)
        assert alone.status is batch.status[k]
        assert not alone.is_solved or alone.z.tobytes() == batch[k].z.tobytes()


def test_zeros_of_degenerate_problems_are_zeros_in_watched_runs_of_lemke():
    """Whole numbers with z_i = w_i = 0: the noise that one way sets to a bound, the others set to it."""
    rng = np.random.default_rng(25)
    for _ in range(40):
        n = int(rng.integers(2, 9))
        B = rng.integers(-2, 3, (n, n)).astype(float)
        z = np.where(rng.random(n) < 0.5, rng.integers(0, 3, n), 0.0)
        w = np.where(z > 0.0, 0.0, rng.integers(0, 3, n))
        problem = LCP(B - B.T, w - (B - B.T) @ z)
        alone, watched = solve(problem, "lemke"), solve(problem, "lemke", record=True)
        assert watched.z.tobytes() == alone.z.tobytes()
