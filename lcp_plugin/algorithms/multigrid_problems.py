"""The complementarity problem of one grid, with its projected sweep."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..checks import FloatVector
from ..kernels import splitting_sweeps as kernels
from ..matrix.hierarchy.levels import Grid

if TYPE_CHECKING:
    from .multigrid import Multigrid


class GridProblem:
    """The complementarity problem of one grid, with its projected sweep."""

    def __init__(
        self, algorithm: Multigrid, grid: Grid, q: FloatVector, lower: FloatVector, upper: FloatVector
    ) -> None:
        self.grid, self.q, self.lower, self.upper = grid, q, lower, upper
        self.arrays = grid.matrix.arrays
        self.entries = grid.matrix.data.size
        self.rows = kernels.packed(q, lower, upper, grid.inverse)
        # Every diagonal entry is stored: behind it begins what a backward sweep has already updated.
        self.splits = {False: grid.split, True: _behind(grid.split)}
        self.residual = np.zeros(grid.width)
        self.is_projected_type = algorithm.smoother in ("npgs", "npsor")
        self.relaxation = algorithm.relaxation if algorithm.smoother in ("psor", "npsor") else 1.0
        self.peers = grid.peers
        if self.is_projected_type:
            pivots = np.full(q.size, 1.0 / (1.0 / self.relaxation + 3.0))  # of the matrix scaled to unit diagonal
            self.projected_type_rows = kernels.packed(q, lower, upper, grid.inverse, grid.inverse, pivots)
            self.new = np.empty(grid.width)

    def sweep(self, z: FloatVector, backward: bool) -> None:
        """Overwrite z by one projected sweep."""
        if not self.is_projected_type:
            self._relax(z, self.relaxation, backward)
            return
        indptr, indices, data = self.arrays
        self.peers.fetch(z)
        self.new[self.q.size:] = z[self.q.size:]
        kernels.splitting_sweep(
            indptr, self.splits[backward], indices, data, self.projected_type_rows, 1.0, True, backward, z, self.new
        )
        np.copyto(z, self.new)

    def gauss_seidel(self, z: FloatVector) -> float:
        """Overwrite z by one forward projected Gauss–Seidel sweep; return the largest change."""
        return self.peers.largest(self._relax(z, 1.0, backward=False))

    def _relax(self, z: FloatVector, relaxation: float, backward: bool) -> float:
        indptr, indices, data = self.arrays
        self.peers.fetch(z)
        largest, _ = kernels.relaxation_sweep(
            indptr, self.splits[backward], indices, data, self.rows, relaxation, backward, z
        )
        return float(largest)


def _behind(split: NDArray[Any]) -> NDArray[Any]:
    after: NDArray[Any] = split + 1
    after.flags.writeable = False
    return after
