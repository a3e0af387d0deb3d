"""The complementarity problem of one grid of projected full multigrid."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ...core.checks import FloatVector, read_only
from ...core.kernels import splitting_sweeps as kernels
from ...systems.hierarchy import sweeps
from ...systems.hierarchy.grids import Grid
from ...systems.hierarchy.vectors import span

if TYPE_CHECKING:
    from .multigrid import Multigrid


class GridProblem:
    """The complementarity problem of one grid, with its projected sweep."""

    def __init__(
        self, algorithm: Multigrid, grid: Grid, q: FloatVector, lower: FloatVector, upper: FloatVector
    ) -> None:
        self.grid, self.entries = grid, grid.matrix.data.size
        # All read-only, so that every kernel is compiled once.
        self.vectors = tuple(read_only(np.ascontiguousarray(vector)) for vector in (grid.inverse, q, lower, upper))
        _, self.q, self.lower, self.upper = self.vectors
        self.residual = np.zeros(grid.width, grid.inverse.dtype)
        self.is_projected_type = algorithm.smoother in ("npgs", "npsor")
        self.relaxation = algorithm.relaxation if algorithm.smoother in ("psor", "npsor") else 1.0
        self.communicator = grid.communicator
        if self.is_projected_type:
            pivots = np.full(q.size, 1.0 / (1.0 / self.relaxation + 3.0))  # of the matrix scaled to unit diagonal
            # Every diagonal entry is stored: behind it begins what a backward sweep has already updated.
            self.splits = {False: grid.split, True: read_only(grid.split + 1)}
            self.projected_type_rows = kernels.packed(q, lower, upper, grid.inverse, grid.inverse, pivots)
            self.new = np.empty_like(self.residual)

    def sweep(self, z: FloatVector, backward: bool) -> None:
        """Overwrite z by one projected sweep."""
        self.communicator.fetch(z)
        if not self.is_projected_type:
            sweeps.projected_sweep(self.grid.rows, self.grid.blocks, self.vectors, self.relaxation, backward, z)
            return
        indptr, _, indices, data, _ = self.grid.rows
        self.new[self.q.size:] = z[self.q.size:]
        kernels.splitting_sweep(
            indptr, self.splits[backward], indices, data, self.projected_type_rows, 1.0, True, backward, z, self.new
        )
        np.copyto(z, self.new)

    def gauss_seidel(self, z: FloatVector) -> float:
        """Overwrite z by one forward projected Gauss–Seidel sweep; return the largest change."""
        before = z[: self.q.size].copy()
        self.communicator.fetch(z)
        sweeps.projected_sweep(self.grid.rows, self.grid.blocks, self.vectors, 1.0, False, z)
        with np.errstate(over="ignore"):  # between bounds of ±1e308
            before -= z[: self.q.size]
        return self.communicator.largest(span(before))
