"""Projected multigrid and batches: comparison with direct and known solutions, statuses, limits."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.sparse as sp
from inputs import membranes
from inputs.planted import planted_lcp
from stability_atlas import balanced_matrix

from lcp_plugin import LCP, Result, Status, gallery, solve
from lcp_plugin.algorithms import Multigrid
from lcp_plugin.gallery.problems import five_point_matrix
from lcp_plugin.systems.hierarchy.levels import hierarchy_of
from lcp_plugin.systems.hierarchy.truncation import Truncation

SCENES = [
    "obstacle_2d:size=60",
    "obstacle_3d:size=14",
    "coefficient_jumps:size=59,contrast=1e2",
    "coefficient_jumps:size=59,contrast=1e6",
    "coefficient_jumps:size=59,contrast=1e10",
    "convection_diffusion:size=60,diffusion=1",
    "convection_diffusion:size=60,diffusion=1e-3",
    "convection_diffusion:size=60,diffusion=1e-5",
    "rotated_anisotropy:size=60",
    "journal_bearing:size=60,eccentricity=0.99",
    "journal_bearing:size=62,eccentricity=0.99",
    "paper_example_1:n=3600,delta=0",
]


def assert_same(problem: LCP, result: Result, relative: float = 1e-6) -> None:
    expected = membranes.active_set(problem, result.z.copy())
    assert np.abs(result.z - expected).max() <= relative * np.abs(expected).max()


@pytest.mark.quick(1)
@pytest.mark.parametrize("algorithm", ["multigrid", "auto"])
def test_neumann_problem_with_a_mean_load_below_zero_is_infeasible(algorithm):
    """M 1 = 0: no z has M z + q ≥ 0 if the sum of q is negative."""
    D = sp.diags_array(
        [np.r_[1, np.full(38, 2), 1], -np.ones(39), -np.ones(39)], offsets=[0, 1, -1]
    )
    M = sp.kronsum(D, D)
    q = 0.3 * np.random.default_rng(0).standard_normal(1600) - 0.01
    assert solve(LCP(M, q), algorithm).status is Status.INFEASIBLE


def test_regular_coarsest_matrix_is_solved_to_rounding():
    """A ridge there slowed the cycles of a tower of masses, which ended SOLVED with 0.98 of its weight."""
    coarsest = Truncation(hierarchy_of(gallery.obstacle_2d(size=60).problem.matrix, 50)).grids[-1]
    A = coarsest.grid.dense(coarsest.values)
    x = coarsest.factor()[0].solve(A @ np.ones(len(A)))
    np.testing.assert_allclose(x, 1.0, rtol=1e-10)


# --- Answers ------------------------------------------------------------------------------------------------


@pytest.mark.quick(2)
@pytest.mark.parametrize("text", SCENES)
def test_the_answer_is_that_of_the_direct_active_set(text):
    """The z of the default tolerance is within 1e-6 of the direct solution, in 40 iterations."""
    problem = membranes.parse(text).problem
    result = solve(problem, "multigrid", max_iterations=40)
    assert result.status is Status.SOLVED
    assert_same(problem, result)


def jumps_by_edge(kind: str, decades: int, *, size: int = 60, seed: int = 0) -> LCP:
    """Return a membrane whose every edge, or cell, has a stiffness of its own."""
    generator = np.random.default_rng(seed)

    def stiffness(*shape: int) -> np.ndarray:
        share = generator.random(shape)
        return 10.0 ** (
            decades * {"all": share - 0.5, "half": share < 0.5, "tenth": share < 0.1}[kind]
        )

    across, along = stiffness(size + 1, size), stiffness(size, size + 1)
    M = balanced_matrix(
        (size, size), ([-across[:-1], -along[:, :-1]], [-across[1:], -along[:, 1:]])
    )
    return LCP(M, membranes.build("coefficient_jumps", size=size).problem.q)


@pytest.mark.quick(1)
@pytest.mark.parametrize("kind", ["all", "half", "tenth"])
@pytest.mark.parametrize("decades", [3, 6, 10])
def test_couplings_that_jump_from_edge_to_edge(kind, decades):
    """Contrasts up to 1e10 between neighboring edges are SOLVED, and up to 1e6 the error is small as well."""
    problem = jumps_by_edge(kind, decades)
    result = solve(problem, "multigrid", max_iterations=60)
    assert result.status is Status.SOLVED
    if decades <= 6:
        assert_same(problem, result)


def plate(size: int) -> LCP:
    """Return a simply supported plate above a paraboloid: thirteen points, no M-matrix."""
    laplacian = five_point_matrix(size, 4.0)
    axis = np.linspace(-0.5, 0.5, size + 2)[1:-1]
    obstacle = (0.1 - 2.0 * np.add.outer(axis**2, axis**2)).ravel()
    return LCP(laplacian @ laplacian, np.full(size**2, 20.0 / (size + 1) ** 4), lower=obstacle)


def planted(seed: int) -> tuple[LCP, np.ndarray]:
    """Return a small H₊ or SPD problem with all types of bounds, and its solution."""
    generator = np.random.default_rng(seed)
    n = int(generator.integers(1, 41))
    B = generator.normal(size=(n, n)) * (generator.random((n, n)) < generator.uniform(0.05, 1.0))
    if seed % 2:
        M = B @ B.T + np.diag(generator.uniform(0.1, 1.0, n))
    else:
        M = B if seed % 4 else -np.abs(B)
        np.fill_diagonal(M, 0.0)
        np.fill_diagonal(M, np.abs(M).sum(axis=1) * generator.uniform(1.01, 2.0) + 0.1)
        M *= 10.0 ** generator.uniform(-3.0, 3.0, n)[:, None]
    return planted_lcp(M, generator)


@pytest.mark.quick(1)
@pytest.mark.parametrize("block", range(10))
def test_small_problems_with_tiny_coarsest_grids(block):
    """All 200 small H₊ and SPD problems with boxes, free and fixed rows are solved."""
    for seed in range(20 * block, 20 * block + 20):
        problem, z = planted(seed)
        result = solve(problem, "multigrid", coarsest=2, tolerance=1e-11, max_iterations=5000)
        assert result.status in (Status.SOLVED, Status.PRECISION_LIMIT), (
            seed,
            result.status,
            result.residual,
        )
        condition = np.linalg.cond(problem.csr.toarray() / problem.diagonal[:, None])
        assert np.abs(result.z - z).max() <= 1e-8 * condition, seed


# --- Cycles, work, starts -----------------------------------------------------------------------------------


def test_cycles_hardly_grow_with_the_grid():
    """16 times the unknowns cost at most 6 more cycles, for each of three families."""
    for name, facts in [
        ("obstacle_2d", {}),
        ("coefficient_jumps", {"contrast": 100.0}),
        ("convection_diffusion", {}),
    ]:
        cycles = [
            solve(membranes.build(name, size=size, **facts).problem, "multigrid").iterations
            for size in (45, 180)
        ]
        assert cycles[1] <= cycles[0] + 6, (name, cycles)


# --- Problems for which multigrid does not help -------------------------------------------------------------


def random_sparse(margin: float, *, n: int = 1000, positive: bool = False) -> LCP:
    generator = np.random.default_rng(5)
    B = sp.csr_array(
        (generator.random(n * 7), (np.repeat(np.arange(n), 7), generator.integers(0, n, n * 7))),
        shape=(n, n),
    )
    M = sp.csr_array(sp.diags_array(B.sum(axis=1) * margin) + (B if positive else -B))
    M.sum_duplicates()
    return LCP(M, generator.normal(size=n))


@pytest.mark.full
def test_a_matrix_without_geometry_is_left_to_sweeps():
    """If no coarser grid pays, sweeps continue as long as they contract, and then the run ends."""
    assert solve(random_sparse(1.4), "multigrid").status is Status.SOLVED
    slow = solve(random_sparse(1.0001), "multigrid")
    assert slow.status is Status.STALLED
    assert slow.work <= 150


def test_an_indefinite_matrix_ends_the_run():
    """The run on a matrix that is neither definite nor H₊ ends by itself, with its best iterate."""
    M = random_sparse(0.3, n=800, positive=True).csr
    shifted = LCP(
        sp.csr_array(M - 0.9 * M.T + sp.eye_array(800)), np.random.default_rng(0).normal(size=800)
    )
    result = solve(shifted, "multigrid", max_iterations=2000)
    assert result.iterations < 1000
    assert np.isfinite(result.residual)


# --- Batches ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("n", "contrast"), [(1000, 1e4), (1000, 1e6), (3000, 1e6), (20_000, 1.0)])
def test_stiff_layers_and_long_chains_need_few_cycles(n, contrast):
    """Twenty layers with alternating stiffness, and a chain of one material, need few cycles."""
    edges = np.where(np.arange(n + 1) // (n // 20) % 2 == 0, 1.0, contrast)
    M = sp.diags_array(
        [-edges[1:-1], edges[1:] + edges[:-1], -edges[1:-1]], offsets=[-1, 0, 1], format="csr"
    )
    problem = LCP(M, -np.sign(np.sin(np.arange(n) * 6.0 / n) + 0.2) / n)
    result = solve(problem, "multigrid")
    assert result.is_solved
    assert result.iterations <= 25


# --- The theorem on projected multigrid ---


def test_a_row_at_a_bound_stays_there_in_units_that_differ():
    """Iterates in columns of other units have the numbers of the bounds, which units times quotients round."""
    grid = gallery.obstacle_2d(size=40).problem
    rng = np.random.default_rng(0)
    units = sp.diags_array(10.0 ** rng.uniform(-1.0, 1.0, grid.n))
    lower = rng.uniform(0.1, 0.9, grid.n)
    problem = LCP(units @ grid.csr @ units, np.ones(grid.n), lower=lower)
    *_, last = Multigrid().iterates(problem, lower)
    is_near = last.z - lower <= 4.0 * np.spacing(lower)
    assert is_near.sum() > grid.n / 2
    np.testing.assert_array_equal(last.z[is_near], lower[is_near])


def test_one_unknown_in_another_unit_costs_few_cycles():
    """If one pressure is in millibar and the others in bar, multigrid needs at most three times the cycles."""
    grid = gallery.obstacle_2d(size=60).problem
    units = np.ones(grid.n)
    units[grid.n // 2] = 4096.0
    problem = LCP(grid.csr @ sp.diags_array(units), grid.q, lower=grid.lower / units)
    result = solve(problem, "multigrid")
    assert result.is_solved
    assert result.iterations <= 3 * solve(grid, "multigrid").iterations
