"""The set-up of multigrid at extreme entries, and the symmetry of its truncated V-cycle."""

import numpy as np
import pytest
import scipy.sparse as sp
from inputs import membranes

from lcp_plugin import gallery
from lcp_plugin.systems.hierarchy import grids, kernels
from lcp_plugin.systems.hierarchy.levels import build_hierarchy
from lcp_plugin.systems.hierarchy.truncation import Truncation


def test_extreme_entries_do_not_break_the_set_up():
    """Entries near the ends of the floating-point range give finite weights and inverses, or none."""
    M = gallery.build("obstacle_2d", size=12).problem.csr
    for scale in (1e-305, 1e-290, 1e300):
        hierarchy = build_hierarchy(sp.csr_array(M * scale), coarsest=5)
        assert all(np.isfinite(grid.inverse).all() for grid in hierarchy.grids)
        assert all(
            np.isfinite(transfer.prolongation.data).all() for transfer in hierarchy.transfers
        )


SYMMETRIC = ["obstacle_2d:size=20", "journal_bearing:size=20,eccentricity=0.95"]


@pytest.mark.parametrize("text", SYMMETRIC)
def test_a_truncated_cycle_is_symmetric_and_lowers_the_energy(text):
    """The V-cycle on the free set F is a symmetric map, leaves the rest at 0, and lowers ½ xᵀMx − bᵀx."""
    M = membranes.parse(text).problem.csr
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


def test_the_residual_after_a_sweep_is_that_of_x_in_each_block(monkeypatch):
    """Rows next to the edges of blocks, which run in another order, have the residual of the final x."""
    monkeypatch.setattr(grids, "SMALLEST_BLOCK", 64)
    M = gallery.build("obstacle_2d", size=40).problem.csr
    truncation = Truncation(build_hierarchy(M))
    truncation.update()
    top, b = truncation.grids[0], np.random.default_rng(0).standard_normal(M.shape[0])
    assert top.grid.blocks.edges.size > 5
    x, residual = np.full(b.size, np.nan), np.empty(b.size)
    kernels.first_sweep(top.rows, top.grid.blocks, top.inverse, b, x)
    kernels.residual_after_first_sweep(top.rows, top.grid.blocks, top.inverse, b, x, residual)
    assert np.isfinite(x).all()
    np.testing.assert_allclose(residual, b - M @ x, atol=1e-12)
