"""The hierarchy: its operators, its truncation, its V-cycle; references are scipy's sparse products."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.sparse as sp

from lcp_plugin import gallery
from lcp_plugin.gallery.stencil import balanced_matrix
from lcp_plugin.systems.hierarchy.grids import Hierarchy, Operator
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
        weights = as_scipy(transfer.prolongation, transfer.is_coarse.sum()).sum(axis=1)
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


@pytest.mark.parametrize("decades", [3, 6, 10])
def test_fine_unknowns_have_coarse_neighbors_at_jumps(decades: int) -> None:
    """If couplings jump from edge to edge, every fine row still interpolates."""
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


# --- When to stop -------------------------------------------------------------------------------------------


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
