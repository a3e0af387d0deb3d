"""The grids of one matrix, from the finest to the coarsest; immutable, so that all runs on the matrix share them.

Memory at 12 bytes an entry, five-point matrix: 1.4 times the entries of M in all coarser matrices together, 0.8 times
in P and as many in its transpose; a run adds 8 bytes for each coarse entry, its value while some unknowns are fixed.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...checks import FloatVector
from ...kernels import splitting_sweeps as kernels
from ...peers.alone import ALONE, Peers
from . import coarsening, galerkin

STRENGTH, STRENGTH_AMONG_POSITIVE = 0.25, 0.5
NOTEWORTHY_POSITIVE = 0.02
COARSEST = 60
LARGEST_GRID_SHARE = 0.85  # a coarser grid with more unknowns than this is not worth its visit
LARGEST_GROWTH = 1.5  # of the entries from one grid to the next; 1.34 on the seven-point matrix
LARGEST_COMPLEXITY = 8.0
MOST_PRODUCTS = 45.0  # an entry of M; at most 32 were seen where multigrid helps
LARGEST_NARROW = 2**30  # entries; a coarser matrix may have more of them, which 32 bits must still count
PASSES_TO_COARSEN = 6.0  # couplings, dependents, choice (twice), interpolation (twice)


NO_WEIGHT = np.zeros(0)
NO_WEIGHT.flags.writeable = False


@dataclass(frozen=True, eq=False)
class Operator:
    """A read-only CSR matrix as bare arrays."""

    indptr: NDArray[Any]
    indices: NDArray[Any]
    data: FloatVector

    def __post_init__(self) -> None:
        # One signature for every kernel: the caller's matrix is read-only as well.
        for name in ("indptr", "indices", "data"):
            view = getattr(self, name).view()
            view.flags.writeable = False
            object.__setattr__(self, name, view)

    @property
    def arrays(self) -> tuple[NDArray[Any], NDArray[Any], FloatVector]:
        """The three arrays, in the order the kernels take them."""
        return self.indptr, self.indices, self.data


@dataclass(frozen=True, eq=False)
class Transfer:
    """The way from one grid to the next coarser one: prolongation P, restriction Pᵀ or Pᵀ D⁻¹, and who is on both.

    P has a row for each foreign unknown as well, which the Galerkin product needs.
    """

    prolongation: Operator
    restriction: Operator
    is_coarse: NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Grid:
    """One grid: its matrix with every diagonal entry stored, where those stand, and the inverses of the pivots.

    A pivot is the diagonal entry, plus its weight where other processes sweep at the same time.
    """

    matrix: Operator
    split: NDArray[Any]
    inverse: FloatVector
    peers: Peers = ALONE
    weight: FloatVector = field(default_factory=lambda: NO_WEIGHT)

    @property
    def n(self) -> int:
        """Number of own unknowns."""
        return self.inverse.size

    @property
    def width(self) -> int:
        """Number of unknowns that the own rows meet."""
        return self.inverse.size + self.peers.foreign


@dataclass(frozen=True, eq=False)
class Hierarchy:
    """The grids from the finest to the coarsest.

    Attributes
    ----------
    grids : tuple of Grid
    transfers : tuple of Transfer
        One fewer: from each grid to the next.
    work : float
        Matrix entries touched to build them.
    is_helpful : bool
        False where coarser grids would cost too much: then there is only the finest.
    """

    grids: tuple[Grid, ...]
    transfers: tuple[Transfer, ...]
    work: float
    is_helpful: bool

    @property
    def complexity(self) -> float:
        """Entries of all matrices together, divided by those of the finest."""
        return sum(grid.matrix.data.size for grid in self.grids) / max(self.grids[0].matrix.data.size, 1)


def build_hierarchy(
    matrix: Any, coarsest: int = COARSEST, strength: float | None = None, *, scales_rows: bool = False
) -> Hierarchy:
    """Return the classical hierarchy of a matrix with a positive diagonal.

    Parameters
    ----------
    matrix : csr_array, shape (n, n)
        Canonical: sorted, no duplicates, every diagonal entry positive.
    coarsest : int
        A grid with at most so many unknowns is not made coarser.
    strength : float, optional
        Couplings smaller than this share of the row's largest are not used for interpolation. By default 0.25, and
        0.5 where M has noteworthy positive couplings: those of a rotated anisotropy mislead the weak ones.
    scales_rows : bool
        Whether the restriction first divides each row by its diagonal entry, Pᵀ D⁻¹: then rows of M may have any size,
        but coarse matrices of a symmetric M are not symmetric.

    Examples
    --------
    >>> from lcp_plugin.evidence import gallery
    >>> hierarchy = build_hierarchy(gallery.build("obstacle_2d", size=20).problem.csr)
    >>> [grid.n for grid in hierarchy.grids], round(hierarchy.complexity, 2)
    ([400, 200, 50], 2.08)
    """
    indptr, indices = matrix.indptr, matrix.indices
    if matrix.data.size > LARGEST_NARROW:
        indptr, indices = indptr.astype(np.int64), indices.astype(np.int64)
    finest = grid_of(Operator(indptr, indices, matrix.data))
    entries = max(matrix.data.size, 1)
    work = 0.0
    if strength is None:
        share = coarsening.positive_share(*finest.matrix.arrays)
        strength = STRENGTH if not share > NOTEWORTHY_POSITIVE else STRENGTH_AMONG_POSITIVE
        work += entries
    grids, transfers = [finest], list[Transfer]()
    grid = finest
    stored, products = 0.0, 0.0
    while grid.n > coarsest:
        work += PASSES_TO_COARSEN * grid.matrix.data.size
        transfer = _transfer(grid, strength, scales_rows)
        if transfer is None:
            break
        stored += grid.matrix.data.size
        products += galerkin.count_products(grid.matrix.indptr, grid.matrix.indices, transfer.prolongation.indptr)
        is_too_large = transfer.restriction.indptr.size - 1 > LARGEST_GRID_SHARE * grid.n
        if is_too_large or products > MOST_PRODUCTS * entries or stored > LARGEST_COMPLEXITY * entries:
            return Hierarchy((finest,), (), work, is_helpful=False)
        finer, grid = grid, _coarser(grid, transfer)
        if grid.matrix.data.size > LARGEST_GROWTH * finer.matrix.data.size:
            return Hierarchy((finest,), (), work + products, is_helpful=False)
        grids.append(grid)
        transfers.append(transfer)
    return Hierarchy(tuple(grids), tuple(transfers), work + products, is_helpful=True)


def grid_of(
    matrix: Operator, peers: Peers = ALONE, own: int | None = None, weight: FloatVector = NO_WEIGHT
) -> Grid:
    """Return the grid of a matrix, whose first rows (all by default) are the own ones."""
    split = np.empty(matrix.indptr.size - 1 if own is None else own, matrix.indptr.dtype)
    kernels.split_rows(matrix.indptr, matrix.indices, False, split)
    diagonal = matrix.data[split]
    inverse = np.zeros(diagonal.size)
    pivot = diagonal + weight if weight.size else diagonal
    np.divide(1.0, pivot, out=inverse, where=diagonal > galerkin.SMALLEST_PIVOT)
    split.flags.writeable = inverse.flags.writeable = False
    return Grid(matrix, split, inverse, peers, weight)


def chosen_kinds(
    indptr: NDArray[Any], indices: NDArray[Any], data: FloatVector, strength: float, is_strong: NDArray[np.bool_]
) -> NDArray[np.uint8]:
    """Return who is COARSE and who FINE, decided among the unknowns that have rows; fill `is_strong`."""
    n = indptr.size - 1
    first = np.zeros(n + 1, indptr.dtype)
    coarsening.strong_couplings(indptr, indices, data, strength, n, is_strong, first)
    np.cumsum(first, out=first)
    dependents = np.empty(int(first[-1]), indices.dtype)
    coarsening.list_dependents(indptr, indices, is_strong, first, dependents)
    kind = np.zeros(n, np.uint8)
    entry, after = np.empty(n + data.size, indices.dtype), np.empty(n + data.size, indptr.dtype)
    coarsening.choose_coarse(indptr, indices, is_strong, first, dependents, kind, entry, after)
    return kind


def _transfer(grid: Grid, strength: float, scales_rows: bool) -> Transfer | None:
    """Return the way to the next coarser grid; None where nothing is coupled any more."""
    indptr, indices, data = grid.matrix.arrays
    n = grid.n
    is_strong = np.empty(data.size, np.bool_)
    kind = chosen_kinds(indptr, indices, data, strength, is_strong)
    is_coarse = kind == coarsening.COARSE
    if not is_coarse.any():
        return None
    number = np.cumsum(is_coarse, dtype=indices.dtype)
    coarse_count = int(number[-1])
    number -= 1
    p_indptr = np.empty(n + 1, indptr.dtype)
    p_indices = np.empty(data.size, indices.dtype)
    p_data = np.empty(data.size)
    size = coarsening.direct_interpolation(
        indptr, indices, data, is_strong, kind, number, p_indptr, p_indices, p_data
    )
    is_coarse.flags.writeable = False
    prolongation = Operator(p_indptr, p_indices[:size], p_data[:size])  # memory behind `size` was never touched
    r_indptr, r_indices, r_data = galerkin.transposed(coarse_count, *prolongation.arrays)
    if scales_rows:
        with np.errstate(over="ignore"):
            r_data *= grid.inverse[r_indices]
        if not np.isfinite(r_data).all():
            return None
    return Transfer(prolongation, Operator(r_indptr, r_indices, r_data), is_coarse)


def _coarser(grid: Grid, transfer: Transfer) -> Grid:
    arrays = galerkin.galerkin_product(
        grid.matrix.arrays, transfer.prolongation.arrays, transfer.restriction.arrays
    )
    return grid_of(Operator(*arrays))
