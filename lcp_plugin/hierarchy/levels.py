"""The grids of a hierarchy, built once a matrix, and the truncated values of one run."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..kernels import row_splits
from ..problem import FloatVector
from . import coarsening, galerkin, sweeps

STRENGTH = 0.25
COARSEST = 60
LARGEST_GRID_SHARE = 0.85  # a coarser grid with more unknowns than this is not worth its visit
LARGEST_COMPLEXITY = 12.0
PASSES_TO_COARSEN = 6.0  # couplings, dependents, choice, interpolation: reads of M, in round figures counted in the code


@dataclass(frozen=True, eq=False)
class Operator:
    """A CSR matrix as bare arrays; for P and R of one grid."""

    indptr: NDArray[Any]
    indices: NDArray[Any]
    data: FloatVector

    @property
    def arrays(self) -> tuple[NDArray[Any], NDArray[Any], FloatVector]:
        """The three arrays, in the order the kernels take them."""
        return self.indptr, self.indices, self.data


@dataclass(frozen=True, eq=False)
class Grid:
    """One grid: its matrix, and the way to the next coarser one (None on the coarsest)."""

    matrix: Operator
    split: NDArray[Any]
    inverse: FloatVector
    is_coarse: NDArray[np.bool_] | None = None
    prolongation: Operator | None = None
    restriction: Operator | None = None

    @property
    def n(self) -> int:
        """Number of unknowns."""
        return self.inverse.size


@dataclass(frozen=True, eq=False)
class Hierarchy:
    """The grids from the finest to the coarsest, and what building them cost in matrix entries touched."""

    grids: tuple[Grid, ...]
    work: float = field(default=0.0)

    @property
    def complexity(self) -> float:
        """Entries of all matrices together, divided by those of the finest."""
        return sum(grid.matrix.data.size for grid in self.grids) / max(self.grids[0].matrix.data.size, 1)


def build_hierarchy(matrix: Any, strength: float = STRENGTH, coarsest: int = COARSEST) -> Hierarchy:
    """Return the classical hierarchy of a CSR matrix, shape (n, n), with a positive diagonal.

    Parameters
    ----------
    matrix : csr_array, shape (n, n)
        Canonical: sorted, no duplicates.
    strength : float
        Couplings smaller than this share of the row's largest are not used for interpolation.
    coarsest : int
        A grid with at most so many unknowns is not made coarser.
    """
    grid = _grid(matrix.indptr, matrix.indices, matrix.data)
    grids: list[Grid] = []
    work = 0.0
    entries = matrix.data.size
    while grid.n > coarsest:
        coarser = _coarser(grid, strength)
        if coarser is None:
            break
        finished, grid, products = coarser
        entries += grid.matrix.data.size
        work += PASSES_TO_COARSEN * finished.matrix.data.size + products
        if entries > LARGEST_COMPLEXITY * max(matrix.data.size, 1):
            grid = finished
            break
        grids.append(finished)
    return Hierarchy((*grids, _without_coarser(grid)), work)


def _grid(indptr: NDArray[Any], indices: NDArray[Any], data: FloatVector) -> Grid:
    from scipy.sparse import csr_array

    n = indptr.size - 1
    matrix = csr_array((data, indices, indptr), shape=(n, n))
    diagonal = matrix.diagonal()
    inverse = np.zeros(n)
    np.divide(1.0, diagonal, out=inverse, where=diagonal > 0.0)
    return Grid(Operator(indptr, indices, data), row_splits(matrix, backward=False), inverse)


def _without_coarser(grid: Grid) -> Grid:
    return Grid(grid.matrix, grid.split, grid.inverse)


def _coarser(grid: Grid, strength: float) -> tuple[Grid, Grid, int] | None:
    """Return the grid with its transfer operators, the next coarser one, and the products that took; None: no use."""
    indptr, indices, data = grid.matrix.arrays
    n = grid.n
    is_strong = np.empty(data.size, np.bool_)
    first = np.zeros(n + 1, indptr.dtype)
    coarsening.strong_couplings(indptr, indices, data, strength, is_strong, first)
    np.cumsum(first, out=first)
    dependents = np.empty(int(first[-1]), indices.dtype)
    coarsening.list_dependents(indptr, indices, is_strong, first, dependents)
    kind = np.zeros(n, np.uint8)
    coarsening.choose_coarse(indptr, indices, is_strong, first, dependents, kind)
    is_coarse = kind == coarsening.COARSE
    coarse_count = int(np.count_nonzero(is_coarse))
    if not 0 < coarse_count <= LARGEST_GRID_SHARE * n:
        return None
    number = np.cumsum(is_coarse, dtype=indices.dtype)
    number -= 1
    p_indptr = np.empty(n + 1, indptr.dtype)
    p_indices = np.empty(data.size, indices.dtype)
    p_data = np.empty(data.size)
    size = coarsening.direct_interpolation(
        indptr, indices, data, is_strong, kind, number, p_indptr, p_indices, p_data
    )
    prolongation = Operator(p_indptr, p_indices[:size].copy(), p_data[:size].copy())
    restriction = Operator(*galerkin.transposed(coarse_count, *prolongation.arrays))
    *coarse, products = galerkin.galerkin_product(*grid.matrix.arrays, *prolongation.arrays, *restriction.arrays)
    return (
        Grid(grid.matrix, grid.split, grid.inverse, is_coarse, prolongation, restriction), _grid(*coarse), products
    )


class TruncatedGrid:
    """The values of one grid while some unknowns are fixed; its own, so that runs in several threads do not meet."""

    def __init__(self, grid: Grid, *, is_finest: bool) -> None:
        self.grid = grid
        n = grid.n
        self.values = grid.matrix.data if is_finest else grid.matrix.data.copy()
        self.inverse = grid.inverse.copy()
        self.is_free = np.ones(n, np.bool_)
        self.free_changed = np.zeros(n, np.bool_)
        self.row_changed = np.zeros(n, np.bool_)
        self.touched = np.zeros(n, np.bool_)
        self.x, self.b, self.residual = np.zeros(n), np.zeros(n), np.zeros(n)
        indptr, indices, _ = grid.matrix.arrays
        self.diagonal = grid.split  # rows are sorted, and every diagonal entry is stored
        self.indptr, self.indices = indptr, indices


class Truncation:
    """A hierarchy seen from one of its grids, with the unknowns of that grid that are fixed taken out."""

    def __init__(self, hierarchy: Hierarchy) -> None:
        self.hierarchy = hierarchy
        self.grids = [TruncatedGrid(grid, is_finest=k == 0) for k, grid in enumerate(hierarchy.grids)]
        self.top = 0
        self.work = 0.0

    def take(self) -> float:
        """Return the matrix entries touched since the last call."""
        work, self.work = self.work, 0.0
        return work

    def start_at(self, top: int) -> None:
        """Look from the grid `top`: it and all unknowns below are whole again."""
        self.top = top
        for k in range(top, len(self.grids)):
            level, grid = self.grids[k], self.hierarchy.grids[k]
            level.is_free[:] = True
            level.inverse[:] = grid.inverse
            if k > 0:
                level.values[:] = grid.matrix.data
            level.free_changed[:] = False
            level.row_changed[:] = False

    def update(self) -> None:
        """Carry what changed in `is_free` of the top grid (marked in `free_changed`) down to the coarser grids."""
        top = self.grids[self.top]
        np.multiply(self.hierarchy.grids[self.top].inverse, top.is_free, out=top.inverse)
        top.row_changed[:] = False
        for k in range(self.top, len(self.grids) - 1):
            level, below, grid = self.grids[k], self.grids[k + 1], self.hierarchy.grids[k]
            assert grid.prolongation is not None and grid.restriction is not None
            galerkin.mark_rows(level.indptr, level.indices, level.free_changed, level.row_changed, level.touched)
            self.work += level.indices.size
            self.work += galerkin.update_product(
                level.indptr, level.indices, level.values, level.is_free, level.touched,
                *grid.prolongation.arrays, *grid.restriction.arrays,
                below.indptr, below.indices, below.values, below.diagonal, below.inverse,
                below.is_free, below.free_changed, below.row_changed,
            )
            if not below.row_changed.any():
                break

    def correct(self, k: int) -> None:
        """x ← one V(1,1)-cycle for the truncated M x = b of grid k, from x = 0."""
        level, grid = self.grids[k], self.hierarchy.grids[k]
        arrays = level.indptr, level.indices, level.values
        sweeps.first_sweep(level.indptr, grid.split, level.indices, level.values, level.inverse, level.b, level.x)
        self.work += 0.5 * level.indices.size
        if grid.prolongation is None or grid.restriction is None:
            self._solve_coarsest(level, arrays)
            return
        sweeps.residual_after_first_sweep(
            level.indptr, grid.split, level.indices, level.values, level.inverse, level.x, level.residual
        )
        below = self.grids[k + 1]
        sweeps.restrict(*grid.restriction.arrays, level.residual, below.b)
        self.correct(k + 1)
        sweeps.add_prolonged(*grid.prolongation.arrays, below.x, level.inverse, level.x)
        sweeps.backward_sweep(*arrays, level.inverse, level.b, level.x)
        self.work += 1.5 * level.indices.size + 2.0 * grid.prolongation.data.size

    def _solve_coarsest(self, level: TruncatedGrid, arrays: Any) -> None:
        sweeps.backward_sweep(*arrays, level.inverse, level.b, level.x)
        for _ in range(10):
            sweeps.forward_sweep(*arrays, level.inverse, level.b, level.x)
            sweeps.backward_sweep(*arrays, level.inverse, level.b, level.x)
        self.work += 21.0 * level.indices.size
