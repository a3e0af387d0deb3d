"""The stopping criterion over cones against constructed wrong points and all modes in fractions."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp
from campaigns import cones as campaign
from inputs.cone_families import exact_residuals, planted_cones, planted_contacts

from lcp_plugin import ConeProblem, FrictionalContact, Status, certify, march, solve, solve_batch
from lcp_plugin.core.cone_stack import Pattern
from lcp_plugin.judges.cones import ConeRows
from lcp_plugin.problems.cones.factors import cone_stack_of
from lcp_plugin.problems.cones.sweeps import sweep_contacts

LINK = np.eye(6)
LINK[0, 3] = LINK[3, 0] = 2.0**-40
PLANE = np.array([0, 1, 3, 4])
SPACE = [-1, 1e7, 0, -1e9, 0, 0]
AHEAD, TURNED = [0, 0, 0, 1e9, 0, 0], [0.9990905, 0.0, -0.49954525, 1e9, 0, 0]


def slides(W: Any, b: Any, dimension: int) -> FrictionalContact:
    return FrictionalContact(W, b, 0.5, dimension=dimension)


RIGHT_2D = [1.0 - 1e9 * 2.0**-40, -0.5 + 0.5e9 * 2.0**-40, 1e9, 0]
CONSTRUCTED: dict[str, tuple[Any, Any, Any]] = {  # problem, a wrong point, the right one or None
    "closing next to a fast slide": (
        slides(LINK[np.ix_(PLANE, PLANE)], [-1, 1e7, -1e9, 0], 2),
        [0, 0, 1e9, 0],
        RIGHT_2D,
    ),
    "closing slowly next to a slide": (
        slides(LINK[np.ix_(PLANE, PLANE)], [-0.01, 1e5, -1e9, 0], 2),
        [0, 0, 1e9, 0],
        [0.01 - 1e9 * 2.0**-40, -0.005 + 0.5e9 * 2.0**-40, 1e9, 0],
    ),
    "closing in space": (slides(LINK, SPACE, 3), AHEAD, [*RIGHT_2D[:2], 0, 1e9, 0, 0]),
    "friction across a fast slide": (slides(LINK, SPACE, 3), TURNED, [*RIGHT_2D[:2], 0, 1e9, 0, 0]),
    "an edge across a large slack": (
        ConeProblem(np.eye(3), [1e9 - 1, -0.6e9 - 0.6, -0.8e9 - 0.8], [("second_order", 3)]),
        [1, 0.8, 0.6],
        None,
    ),
}


@pytest.mark.parametrize("name", CONSTRUCTED)
def test_a_constructed_wrong_point_is_never_solved(name):
    """From the wrong point and from none, solve, march and solve_batch are right or not SOLVED."""
    problem, wrong, right = CONSTRUCTED[name]
    wrong = np.array(wrong, float)
    step = march(problem, [problem.q], propagator=0.0, z0=wrong)
    batch = solve_batch([problem, problem], z0=[wrong, wrong])
    several = solve_batch([problem, problem])
    results = [solve(problem), solve(problem, z0=wrong), step[0], *batch, *several]
    tables = [(step.z[0], step.status[0]), *zip(batch.z, batch.status, strict=True)]
    points = [(one.z, one.status) for one in results]
    for z, status in [*tables, *points, *zip(several.z, several.status, strict=True)]:
        assert right is not None or status is not Status.SOLVED
        if status is Status.SOLVED:
            np.testing.assert_allclose(z, right, rtol=1e-6, atol=1e-6)
    assert solve(problem).is_solved is (right is not None)
    stack = cone_stack_of(problem)
    measured = ConeRows(stack).measure_blocks(stack.pattern.wide(wrong[None]), 1e-8)
    is_moved = right is not None and np.allclose(measured.z.ravel(), right)
    assert is_moved or not measured.passes[0]


def test_no_small_problem_is_solved_falsely(draws):
    """Every SOLVED point of a small problem, from right, wrong and no starts, is a solution in fractions."""
    for seed in draws(200, 20):
        found = campaign.check(seed, max_seconds=1.0, prove_infeasibility=False)
        assert not any(verdict.endswith("false") for verdict in found), (seed, found)


def test_solutions_pass_exactly_and_one_ulp_off(draws):
    """A solution in fractions passes when it is rounded, and so do its neighbors with other last bits."""
    rng, count = np.random.default_rng(0), 0
    for seed in draws(200):
        _, problem, run, kept = campaign.drawn(seed)
        stack = cone_stack_of(run)
        for right in campaign.solutions(problem)[0]:
            z = np.zeros(run.n)
            z[kept] = [float(x) for x in right]
            for k in range(3):
                moved = z * (1.0 + rng.integers(-1, 2, z.size) * (k > 0) * 2.0**-52)
                with np.errstate(all="ignore"):
                    at = stack.snap(stack.pattern.wide(moved[None]))
                measured = ConeRows(stack).measure_blocks(at, 1e-8)
                assert measured.passes[0] or measured.is_limited[0], (seed, moved)
                count += 1
    assert count > 10


def test_without_cones_the_search_of_an_lcp_proves_that_no_solution_exists():
    """A problem over boxes is an LCP; the proof verifies on its rows."""
    M, upper = [[1, -1, 3], [0, -1, 0], [3, -2, 0]], [np.inf, 2, np.inf]
    problem = ConeProblem(np.array(M, float), [0.0078125, 0, -256], [("box", 0, upper)])
    result = solve(problem)
    assert result.status is Status.NO_SOLUTION
    assert result.proof.verify()
    assert result.proof.problem is problem.rows


def test_a_contact_without_a_solution_ends_after_few_sweeps():
    """None of the four modes of the contact holds; Newton's method does not repeat halved steps."""
    problem = FrictionalContact([[1.0, -2.0], [-2.0, 4.0]], [-6.0, -32.0], 0.75, dimension=2)
    assert campaign.solutions(problem) == ([], False)
    result = solve(problem)
    assert result.status is Status.STALLED
    assert sum(one.iterations for one in result.stages if one.name == "newton") <= 500
    assert result.guarantee is None


def test_bounds_of_the_residual_hold_within_rounding_of_an_edge():
    """The bounds enclose the residual in 60 digits for points whose step ends within rounding of the cone's edge."""
    for seed in range(60):
        rng = np.random.default_rng(seed)
        way = rng.standard_normal(2)
        way /= np.hypot(*way)
        z = np.array([1.0, *way]) * 10.0 ** rng.uniform(-3, 3)
        w = np.array([1.0, *-way]) * 10.0 ** rng.uniform(-18, -6) * z[0]
        z = z + w * rng.uniform(0, 2)
        stack = cone_stack_of(ConeProblem(np.eye(3), w, [("second_order", 3)]))
        low, high = (ends[0, 0] for ends in ConeRows(stack).residual_ends(z[None], w[None]))
        right = exact_residuals(ConeProblem(np.zeros((3, 3)), w, [("second_order", 3)]), z)[0]
        assert low <= right <= high, seed


def test_solved_by_an_absolute_tolerance_means_residuals_within_it(draws):
    """Problems of two sizes, also with tolerance=0: SOLVED, and the residual in 60 digits is within the tolerance."""
    for seed in draws(80):
        rng = np.random.default_rng(seed)
        problem = planted_contacts(3, 3, 10, rng)[0] if seed % 2 else planted_cones(4, rng)[0]
        absolute = 10.0 ** rng.uniform(-8, -1)
        result = solve(problem, tolerance=0.0, absolute_tolerance=absolute)
        assert result.is_solved, seed
        assert max(exact_residuals(problem, result.z)) <= absolute
        again = solve(problem, z0=result.z, tolerance=0.0, absolute_tolerance=absolute)
        assert again.is_solved
        assert again.iterations == 0


def test_the_sufficient_test_accepts_only_points_that_pass(draws):
    """Solutions with errors from 0 to 1e-4, and of other scales: the criterion passes, with no larger residual."""
    accepted, refused = 0, 0
    for seed in draws(2000, 60):
        rng = np.random.default_rng([7, seed])
        problem, r, _ = planted_contacts(int(rng.integers(1, 6)), 2, 10.0, rng)
        scale, error = 10.0 ** rng.uniform(-9, 9), 10.0 ** rng.uniform(-18, -4)
        problem = problem.with_q(scale * problem.q)
        stack, z = cone_stack_of(problem), scale * r * (1.0 + error * rng.standard_normal(r.size))
        with np.errstate(all="ignore"):
            at = stack.snap(stack.pattern.wide(z[None]))
            bound = sweep_contacts(problem, stack.pattern.flat(at)[0], 1e-8, 0)[2]
            rows = ConeRows(stack)
            found = rows.measure_at(rows.flat(at), None, 1e-8)
        accepted, refused = accepted + (bound < np.inf), refused + (bound == np.inf)
        assert bound == np.inf or (found.passes[0] and found.residual[0] <= 1.01 * bound + 1e-15)
    assert min(accepted, refused) > 5


def test_a_small_residual_next_to_a_large_impulse_is_no_rounding():
    """Of connected contacts of sizes 1 and 1e-6 … 1e-9, no SOLVED is refused by `certify`."""
    for seed, size in ((0, 1e-8), (212, 1e-6), (0, 1e-9)):
        rng = np.random.default_rng(seed)
        J, sizes = rng.standard_normal((6, 6)), np.repeat([1.0, size], 3)
        b = rng.standard_normal(6) * sizes
        b[[0, 3]] = -np.abs(b[[0, 3]])
        problem = FrictionalContact(J @ J.T * sizes * sizes[:, None], b, [0.5, 0.5])
        result = solve(problem)
        assert not (
            result.is_solved and certify(problem, result.z, tolerance=1e-8).verdict == "disproved"
        )


def test_a_run_that_is_recorded_or_limited_has_the_same_bits():
    """Sweeps that solve a small problem are a stage of the run."""
    problem, _, _ = planted_contacts(5, 5, 10.0, np.random.default_rng(1), definite=True)
    plain, recorded = solve(problem), solve(problem, record=True)
    limited = solve(problem, max_iterations=plain.iterations)
    assert plain.z.tobytes() == recorded.z.tobytes() == limited.z.tobytes()
    assert [stage.name for stage in plain.stages] == ["nsgs"]
    assert recorded.history[-1].iteration == plain.iterations > 0


def small_contacts(seed: int) -> FrictionalContact:
    """Return 4 contacts; W is singular if the seed is even."""
    rng = np.random.default_rng(seed)
    J = rng.standard_normal((12, 8))
    W = J @ J.T + 0.05 * (seed % 2) * np.eye(12)
    return FrictionalContact(W, rng.standard_normal(12), rng.uniform(0.0, 1.2, 4))


@pytest.mark.parametrize("seed", range(6))
def test_a_tiny_absolute_tolerance_changes_nothing(seed):
    """Small contact problems are swept to rounding with and without one."""
    problem = small_contacts(seed)
    plain, absolute = solve(problem), solve(problem, absolute_tolerance=1e-300)
    assert (plain.status, plain.work) == (absolute.status, absolute.work)
    np.testing.assert_array_equal(plain.z, absolute.z)


def test_a_limit_just_above_the_quick_sweeps_changes_nothing():
    """Sweeps that lead nowhere take no iterations of a limit."""
    problem = small_contacts(61)
    plain = solve(problem)
    for limit in (0, 13, 14, 15, 20):
        assert (
            solve(problem, max_iterations=plain.iterations + limit).z.tobytes() == plain.z.tobytes()
        )


def test_block_data_of_dense_and_sparse_matrices_agree_with_their_definition() -> None:
    """The scale of a block is its Frobenius norm / √m, unless another block of its row is far larger; components."""
    rng = np.random.default_rng(3)
    starts = np.array([0, 3, 4, 6, 9, 10])
    M = rng.standard_normal((10, 10))
    M[:4, 4:] = M[4:, :4] = 0.0
    M[3, 3], M[4:6, 4:6], M[9, 9] = -1.0, 1e-9, 0.0
    sizes, rows = np.diff(starts), [slice(*ends) for ends in pairwise(starts.tolist())]
    sums = np.array([[np.abs(M[a, b]).sum() for b in rows] for a in rows])
    largest = (sums / np.sqrt(sizes * sizes[:, np.newaxis])).max(1)
    norms = [np.linalg.norm(M[a, a]) / np.sqrt(a.stop - a.start) for a in rows]
    expected = np.where([True, False, False, True, False], norms, largest)
    for matrix in (M[np.newaxis], sp.csr_array(M)):
        found = Pattern(matrix, starts)
        np.testing.assert_allclose(found.d[0], expected, rtol=1e-14)
        np.testing.assert_array_equal(found.blocks[0, 0], M[:3, :3])
        assert found.labels is not None
        assert found.labels.tolist() == [[0, 0, 2, 2, 2]]
    assert Pattern(rng.standard_normal((2, 10, 10)), starts).labels is None


def test_slow_sweeps_are_extrapolated() -> None:
    """Most small problems with a small shift of a singular W are solved by sweeps, without Newton's method."""
    swept = 0
    for seed in range(40):
        rng = np.random.default_rng([11, seed])
        J = rng.standard_normal((30, 12))
        W, friction = J @ J.T + 0.5 * np.eye(30), rng.uniform(0.0, 1.2, 10)
        result = solve(FrictionalContact(W, rng.standard_normal(30), friction))
        assert result.is_solved
        swept += result.algorithm == "auto: nsgs"
    assert swept >= 35
