"""The hierarchy: its operators, its truncation, its V-cycle; references are scipy's sparse products."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.sparse as sp
from hypothesis import given
from hypothesis import strategies as st

from lcp_plugin import gallery
from lcp_plugin.core.checks import read_only
from lcp_plugin.gallery.stencil import balanced_matrix
from lcp_plugin.systems.hierarchy import coarsening, galerkin, levels, sweeps, vectors
from lcp_plugin.systems.hierarchy.grids import Hierarchy, Operator, RowBlocks
from lcp_plugin.systems.hierarchy.levels import build_hierarchy
from lcp_plugin.systems.hierarchy.truncation import KrylovCorrection, Truncation

SCENES = [
    "obstacle_2d:size=20",
    "obstacle_3d:size=8",
    "coefficient_jumps:size=21",
    "convection_diffusion:size=20",
    "rotated_anisotropy:size=20",
    "journal_bearing:size=20,eccentricity=0.95",
    "american_put:size=300",
    "optimal_stopping:size=17,swirl=-7",
]


def as_scipy(operator: Operator, columns: int) -> sp.csr_array:
    return sp.csr_array(
        (operator.data, operator.indices, operator.indptr),
        shape=(operator.indptr.size - 1, columns),
    )


def random_matrix(seed: int, n: int, density: float) -> sp.csr_array:
    """A canonical matrix with a full, positive diagonal and entries of both signs."""
    generator = np.random.default_rng(seed)
    entries = generator.normal(size=(n, n)) * (generator.random((n, n)) < density)
    np.fill_diagonal(entries, generator.uniform(0.5, 2.0, n))
    return sp.csr_array(entries)


@pytest.fixture(params=SCENES)
def hierarchy(request: pytest.FixtureRequest) -> Hierarchy:
    return build_hierarchy(gallery.parse(request.param).problem.csr, coarsest=3)


# --- Operators ----------------------------------------------------------------------------------------------


def test_interpolation_is_nonnegative_and_injects(hierarchy: Hierarchy) -> None:
    """No weight is negative, and a coarse unknown takes the value of itself."""
    for grid, coarser, transfer in zip(
        hierarchy.grids, hierarchy.grids[1:], hierarchy.transfers, strict=False
    ):
        P = as_scipy(transfer.prolongation, coarser.n)
        assert P.data.min() > 0.0
        assert np.array_equal(P[np.flatnonzero(transfer.is_coarse)].toarray(), np.eye(coarser.n))
        assert (as_scipy(transfer.restriction, grid.n) != P.T).nnz == 0


@pytest.mark.parametrize(
    "text", ["obstacle_2d:size=20", "coefficient_jumps:size=21", "rotated_anisotropy:size=12"]
)
def test_constants_are_reproduced_where_rows_sum_to_zero(text: str) -> None:
    """A row of M that sums to zero and interpolates at all has weights that sum to one, on every grid."""
    M = gallery.parse(text).problem.csr
    found = 0
    hierarchy = build_hierarchy(M, coarsest=3)
    for grid, transfer in zip(hierarchy.grids, hierarchy.transfers, strict=False):
        matrix = as_scipy(grid.matrix, grid.n)
        sums, scale = matrix.sum(axis=1), abs(matrix).sum(axis=1)
        weights = np.add.reduceat(transfer.prolongation.data, transfer.prolongation.indptr[:-1])
        is_empty = np.diff(transfer.prolongation.indptr) == 0
        balanced = (np.abs(sums) <= 1e-12 * scale) & ~is_empty
        found += np.count_nonzero(balanced)
        np.testing.assert_allclose(weights[balanced], 1.0, rtol=0, atol=1e-10)
    assert found > 50


def test_coarse_matrices_are_galerkin_products(hierarchy: Hierarchy) -> None:
    """Every coarse matrix is PᵀMP by scipy, with sorted rows, every diagonal entry stored, and read-only."""
    for grid, coarser, transfer in zip(
        hierarchy.grids, hierarchy.grids[1:], hierarchy.transfers, strict=False
    ):
        P, fine = as_scipy(transfer.prolongation, coarser.n), as_scipy(grid.matrix, grid.n)
        coarse = as_scipy(coarser.matrix, coarser.n)
        expected = P.T @ fine @ P
        assert abs(coarse - expected).max() <= 1e-13 * abs(expected).max()
        assert coarse.has_canonical_format
        assert np.array_equal(coarser.matrix.indices[coarser.split], np.arange(coarser.n))
        assert not any(array.flags.writeable for array in coarser.matrix.arrays)


@given(st.integers(0, 10**6), st.integers(2, 40), st.floats(0.02, 1.0))
def test_products_and_transposes_of_any_matrices(seed: int, n: int, density: float) -> None:
    """RMP and Pᵀ agree with scipy for matrices of any density, whether or not the first capacity suffices."""
    M = random_matrix(seed, n, density)
    generator = np.random.default_rng(seed + 1)
    columns = int(generator.integers(1, n + 1))
    P = sp.csr_array(generator.random((n, columns)) * (generator.random((n, columns)) < density))
    arrays, p = (M.indptr, M.indices, M.data), (P.indptr, P.indices, P.data)
    r = galerkin.transposed(columns, *p)
    assert (as_scipy(Operator(*r), n) != P.T).nnz == 0
    c = galerkin.galerkin_product(arrays, p, r, r[0].size - 1)
    expected = (P.T @ M @ P).toarray()
    np.testing.assert_allclose(
        as_scipy(Operator(*c), columns).toarray(), expected, rtol=0, atol=1e-12 * (1 + n)
    )
    assert galerkin.count_products(M.indptr, M.indices, P.indptr) == (P != 0).sum(axis=1) @ (
        (M != 0) @ (P != 0).sum(1)
    )


@pytest.mark.parametrize("decades", [3, 6, 10])
def test_interpolation_reaches_through_fine_unknowns(decades: int) -> None:
    """Where couplings jump from edge to edge few rows have a coarse one near: still every fine row interpolates."""
    generator = np.random.default_rng(0)
    size = 40
    across, along = 10.0 ** (decades * generator.random((2, size + 1, size)))
    legs = [-across[:-1], -along.T[:, :-1]], [-across[1:], -along.T[:, 1:]]
    M = balanced_matrix((size, size), legs)
    hierarchy = build_hierarchy(M)
    P = hierarchy.transfers[0].prolongation
    assert np.diff(P.indptr).min() >= 1
    correction = KrylovCorrection(Truncation(hierarchy), generator.normal(size=size**2), True)
    begun = np.linalg.norm(correction.residual)
    for _ in range(16):
        assert correction.step()
    assert np.linalg.norm(correction.residual) <= 1e-6 * begun


@pytest.mark.parametrize("is_symmetric", [True, False])
def test_units_are_found(is_symmetric: bool) -> None:
    """Of D M D and M D, M with rows that sum to zero, the units are 1/D but for a factor that varies slowly."""
    M = gallery.build("obstacle_2d", size=30).problem.csr
    d = 10.0 ** np.random.default_rng(0).uniform(-4, 4, M.shape[0])
    scaled = sp.csr_array(
        (sp.diags_array(d) if is_symmetric else sp.eye_array(d.size)) @ M @ sp.diags_array(d)
    )
    _, _, lacking = coarsening.couplings_by_sign(scaled.indptr, scaled.indices, scaled.data)
    v, work = vectors.scaling_of_unknowns(scaled, lacking)
    assert v is not None
    assert 0.0 < work <= 50 * M.nnz
    field = (v * d).reshape(30, 30)[3:-3, 3:-3]
    assert max(np.abs(np.diff(np.log(field), axis=axis)).max() for axis in (0, 1)) <= 0.2


# --- When to stop -------------------------------------------------------------------------------------------


def test_positive_couplings_raise_the_strength() -> None:
    """A rotated anisotropy counts only couplings above half the largest; the rule is the documented one."""
    M = gallery.build("rotated_anisotropy", size=30).problem.csr
    chosen, stronger, usual = (
        build_hierarchy(M),
        build_hierarchy(M, strength=0.5),
        build_hierarchy(M, strength=0.25),
    )
    sizes = [[grid.n for grid in h.grids] for h in (chosen, stronger, usual)]
    assert sizes[0] == sizes[1] != sizes[2]


def test_extreme_entries_do_not_break_the_set_up() -> None:
    """Entries near the ends of the floating-point range give finite weights and inverses, or none."""
    M = gallery.build("obstacle_2d", size=12).problem.csr
    for scale in (1e-305, 1e-290, 1e300):
        hierarchy = build_hierarchy(sp.csr_array(M * scale), coarsest=5)
        assert all(np.isfinite(grid.inverse).all() for grid in hierarchy.grids)
        assert all(
            np.isfinite(transfer.prolongation.data).all() for transfer in hierarchy.transfers
        )


# --- Truncation ---------------------------------------------------------------------------------------------


def from_scratch(hierarchy: Hierarchy, is_free: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return (matrix, free) of every coarser grid by products of whole truncated matrices."""
    found = []
    matrix, free = as_scipy(hierarchy.grids[0].matrix, is_free.size).toarray(), is_free
    for grid, coarser, transfer in zip(
        hierarchy.grids, hierarchy.grids[1:], hierarchy.transfers, strict=False
    ):
        left = coupling(np.where(free, matrix, 0.0)) / diagonal_and_positive(matrix)
        before = coupling(
            whole := as_scipy(grid.matrix, free.size).toarray()
        ) / diagonal_and_positive(whole)
        is_held = (left < vectors.HELD * before) & ~transfer.is_coarse
        P = as_scipy(transfer.prolongation, coarser.n).toarray() * (free & ~is_held)[:, None]
        matrix = P.T @ matrix @ P
        free = matrix.diagonal() > 0.0
        found.append((matrix, free))
    return found


def coupling(matrix: np.ndarray) -> np.ndarray:
    return -np.minimum(matrix, 0.0).sum(axis=1)


def diagonal_and_positive(matrix: np.ndarray) -> np.ndarray:
    return np.maximum(np.maximum(matrix, 0.0).sum(axis=1), 1e-300)


@pytest.mark.parametrize("text", SCENES)
def test_an_update_equals_a_computation_from_scratch(text: str) -> None:
    """After any sequence of free sets, every coarse matrix is the product with the truncated interpolation."""
    hierarchy = build_hierarchy(gallery.parse(text).problem.csr, coarsest=3)
    generator = np.random.default_rng(0)
    truncation = Truncation(hierarchy)
    top = truncation.grids[0]
    for share in (0.5, 0.02, 0.02, 0.0, 0.9, 0.3):
        flips = generator.random(top.is_free.size) < share
        top.free_changed[:] = flips
        top.is_free ^= flips
        truncation.update()
        for level, (matrix, free) in zip(
            truncation.grids[1:], from_scratch(hierarchy, top.is_free), strict=True
        ):
            np.testing.assert_allclose(
                as_scipy(
                    Operator(level.grid.matrix.indptr, level.grid.matrix.indices, level.values),
                    free.size,
                ).toarray(),
                matrix,
                rtol=0,
                atol=1e-12 * max(abs(level.grid.matrix.data).max(), 1.0),
            )
            assert np.array_equal(level.is_free, free)
            assert np.array_equal(level.inverse > 0.0, free)


def test_release_undoes_truncation() -> None:
    """A truncation that starts afresh has the hierarchy's own values again."""
    hierarchy = build_hierarchy(gallery.build("obstacle_2d", size=20).problem.csr, coarsest=3)
    truncation = Truncation(hierarchy)
    truncation.grids[0].is_free[::3] = False
    truncation.grids[0].free_changed[::3] = True
    truncation.update()
    truncation.start_at(0)
    for level in truncation.grids:
        assert level.is_free.all()
        assert np.array_equal(level.values, level.grid.matrix.data)
        assert np.array_equal(level.inverse, level.grid.inverse)


SYMMETRIC = [text for text in SCENES if not text.startswith(("convection", "american", "optimal"))]


@pytest.mark.parametrize("text", SYMMETRIC)
def test_a_truncated_cycle_is_symmetric_and_lowers_the_energy(text: str) -> None:
    """The V-cycle on the free set F is a symmetric map, leaves the rest at 0, and lowers ½ xᵀMx − bᵀx."""
    M = gallery.parse(text).problem.csr
    truncation = Truncation(build_hierarchy(M, coarsest=3))
    generator = np.random.default_rng(3)
    top = truncation.grids[0]
    top.is_free[:] = generator.random(top.is_free.size) < 0.8
    top.free_changed[:] = ~top.is_free
    truncation.update()
    right, answers = generator.normal(size=(2, top.is_free.size)) * top.is_free, []
    for b in right:
        top.b[:] = b
        truncation.correct(0)
        x = top.x.copy()
        assert not x[~top.is_free].any()
        assert 0.5 * x @ (M @ x) - b @ x < 0.0
        answers.append(x)
    assert right[0] @ answers[1] == pytest.approx(right[1] @ answers[0], rel=1e-9)


@pytest.mark.parametrize("text", ["obstacle_2d:size=8", "convection_diffusion:size=8"])
def test_the_coarsest_grid_is_solved(text: str) -> None:
    """A cycle on the coarsest grid answers the free rows' system after each change of the free set."""
    M = gallery.parse(text).problem.csr
    truncation = Truncation(build_hierarchy(M, coarsest=100))
    top = truncation.grids[0]
    generator = np.random.default_rng(0)
    for _ in range(3):
        flips = generator.random(top.is_free.size) < 0.3
        top.free_changed[:] = flips
        top.is_free ^= flips
        truncation.update()
        free = np.flatnonzero(top.is_free)
        top.b[:] = generator.normal(size=top.b.size)
        truncation.correct(0)
        expected = np.zeros(top.b.size)
        expected[free] = np.linalg.solve(M.toarray()[np.ix_(free, free)], top.b[free])
        np.testing.assert_allclose(top.x, expected, rtol=0, atol=1e-12 * np.abs(expected).max())


def test_sweeps_agree_with_triangular_solves() -> None:
    """The first forward sweep is a solve with the lower triangle; what it leaves is −U x."""
    M = gallery.build("convection_diffusion", size=15).problem.csr
    grid = levels.build_hierarchy(M, coarsest=1000).grids[0]
    b = np.random.default_rng(0).normal(size=M.shape[0])
    x, residual = np.empty_like(b), np.empty_like(b)
    sweeps.first_sweep(grid.rows, grid.blocks, grid.inverse, b, x)
    sweeps.residual_after_first_sweep(grid.rows, grid.blocks, grid.inverse, b, x, residual)
    dense = M.toarray()
    np.testing.assert_allclose(x, np.linalg.solve(np.tril(dense), b), rtol=1e-11)
    np.testing.assert_allclose(residual, b - dense @ x, rtol=0, atol=1e-12)
    sweeps.sweep(grid.rows, grid.blocks, grid.inverse, True, b, x)
    np.testing.assert_allclose((b - dense @ x)[0], 0.0, atol=1e-12)


@pytest.mark.parametrize(
    "text", ["obstacle_2d:size=12", "rotated_anisotropy:size=12", "obstacle_3d:size=6"]
)
@pytest.mark.parametrize("share_free", [1.0, 0.7])
def test_sweeps_in_blocks_are_gauss_seidel_in_the_order_of_the_blocks(
    text: str, share_free: float
) -> None:
    """Even blocks first and then odd ones, backward the other way round; the first sweep tells the residual it left."""
    M = gallery.parse(text).problem.csr
    n, generator = M.shape[0], np.random.default_rng(0)
    grid = levels.build_hierarchy(M, coarsest=1000).grids[0]
    reach = int(np.abs(M.tocoo().row - M.tocoo().col).max())
    edges = np.linspace(0, n, 5).astype(np.int64)
    assert np.diff(edges).min() >= reach
    blocks = RowBlocks(read_only(edges), reach)
    b, start, free = (
        generator.normal(size=n),
        generator.normal(size=n),
        generator.random(n) < share_free,
    )
    inverse = grid.inverse * free
    order = np.concatenate([np.arange(edges[k], edges[k + 1]) for k in (0, 2, 1, 3)])
    kept = order[free[order]]
    dense, right = M.toarray()[np.ix_(kept, kept)], b[kept]

    x, residual = np.full(n, np.nan), np.empty(n)
    sweeps.first_sweep(grid.rows, blocks, inverse, b, x)
    sweeps.residual_after_first_sweep(grid.rows, blocks, inverse, b, x, residual)
    np.testing.assert_allclose(x[kept], np.linalg.solve(np.tril(dense), right), rtol=0, atol=1e-12)
    np.testing.assert_allclose(residual[kept], right - dense @ x[kept], rtol=0, atol=1e-12)
    assert not x[~free].any()
    assert not residual[~free].any()
    sweeps.sweep(grid.rows, blocks, inverse, True, b, x)
    before = np.linalg.solve(np.tril(dense), right)
    after = np.linalg.solve(np.triu(dense), right - np.tril(dense, -1) @ before)
    np.testing.assert_allclose(x[kept], after, rtol=0, atol=1e-12)

    q, lower, upper = map(read_only, (-b, np.full(n, -0.1), np.full(n, 0.2)))
    z, expected = start.copy(), start.copy()
    sweeps.projected_sweep(grid.rows, blocks, (grid.inverse, q, lower, upper), 1.0, False, z)
    for i in order:
        w = (M[[i]] @ expected)[0] - b[i]
        expected[i] = np.clip(expected[i] - w / M[i, i], -0.1, 0.2)
    np.testing.assert_allclose(z, expected, rtol=0, atol=1e-12)
