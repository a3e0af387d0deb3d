"""Classical algebraic multigrid on rows over MPI ranks, truncated to the free unknowns.

Each rank chooses coarse unknowns among its local unknowns, without regard to the couplings of other ranks.
Interpolation, Galerkin products and truncation equal the serial operations, because a rank also stores the rows of
adjacent ghost unknowns. A smoother sweeps on all ranks at once, with larger pivots if M is symmetric.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from ..core.checks import Arrays, FloatVector, read_only
from ..systems.hierarchy import kernels
from ..systems.hierarchy.grids import Grid, Operator, Transfer, blocks_of, pivots
from ..systems.hierarchy.levels import (
    COARSEST,
    LARGEST_GRID_SHARE,
    NOTEWORTHY_LONELY,
    interpolation_of,
    positive_shares,
    strength_of,
)
from ..systems.hierarchy.truncation import TruncatedGrid, Truncation
from .halo import NOBODY, Halo

LARGEST_GROWTH, LARGEST_COMPLEXITY = 2.0, 8.0


@dataclass(frozen=True, eq=False)
class GridOnRanks(Grid):
    """Local rows of one grid, then rows of adjacent ghosts, and the pivots of a sweep; n counts local unknowns."""

    halo: Halo
    weight: FloatVector

    @property
    def width(self) -> int:
        """Number of unknowns that the rows meet."""
        return self.n + self.halo.foreign

    @property
    def own(self) -> Arrays:
        """The local rows."""
        matrix = self.matrix
        return Operator(matrix.indptr[: self.n + 1], matrix.indices, matrix.data).arrays


@dataclass(frozen=True, eq=False)
class HierarchyOnRanks:
    """The grids from the finest to the coarsest, with transfers; one grid if coarser ones cost too much."""

    grids: tuple[GridOnRanks, ...]
    transfers: tuple[Transfer, ...]


class InterpolationOnRanks(NamedTuple):
    """The rows of P, for local unknowns and for ghosts with stored rows; columns of all ranks."""

    rows: Arrays
    is_coarse: NDArray[np.bool_]
    below: Halo
    has_jumps: bool


def build_hierarchy(matrix: Any, halo: Halo, *, scales_rows: bool) -> HierarchyOnRanks:
    """Return the hierarchy of the local rows, shape (own, own + foreign), with a positive diagonal.

    With `scales_rows` the restriction is Pᵀ D⁻¹ in place of Pᵀ, for matrices that are not symmetric.
    """
    rows = matrix.indptr, matrix.indices, matrix.data
    own, ranks = matrix.shape[0], halo
    if not halo.is_empty:
        rows, ranks = halo.overlapped(rows, halo.ghosts, NOBODY)
    grid = _grid(Operator(*rows), ranks, own, scales_rows)
    shares = positive_shares(Operator(*grid.own), grid.split)
    strength = strength_of(halo.total(float(shares.sum())) / max(halo.n, 1))
    grids, transfers, has_jumps = [grid], list[Transfer](), None
    entries = stored = halo.total(float(grid.own[0][-1]))
    size = halo.total(grid.n)
    while size > COARSEST:
        interpolation = _interpolation(grid, strength, has_jumps)
        if interpolation is None:
            break
        has_jumps = interpolation.has_jumps
        coarser = _coarser(grid, interpolation, scales_rows)
        if coarser is None:
            break
        transfer, below = coarser
        now = halo.total(float(below.own[0][-1]))
        is_large = halo.total(below.n) > LARGEST_GRID_SHARE * size
        stored += now
        if is_large or now > LARGEST_GROWTH * entries or stored > LARGEST_COMPLEXITY * entries:
            return HierarchyOnRanks((grids[0],), ())
        grid, size = below, halo.total(below.n)
        grids.append(grid)
        transfers.append(transfer)
    return HierarchyOnRanks(tuple(grids), tuple(transfers))


def pivot_weight(rows: Any, halo: Halo, relaxation: float) -> FloatVector:
    """Return the weights added to the pivots d_i of a sweep on all ranks at once, shape (own,).

    Notes
    -----
    With σ_i = Σ |m_ij| √(d_i/d_j) over the ghost columns j the weight is ω_i = max(0, (r σ_i − (1 − r/2) d_i)/2),
    r the relaxation. For M symmetric positive definite the splitting 𝓜 has
    𝓜 + 𝓜ᵀ − M = (2/r − 1) D + (2/r) Ω − (the ghost columns of M), and that is positive definite, because
    2 |m_ij x_i x_j| ≤ |m_ij| (s x_i² + x_j²/s) with s = √(d_i/d_j). For an H₊-matrix and r ≤ 1 any ω ≥ 0 does.
    """
    own = rows.shape[0]
    diagonal = rows.diagonal()
    whole = np.abs(halo.whole(diagonal))[own:]
    coupling = np.sqrt(np.abs(diagonal)) * (abs(rows[:, own:]) @ (1.0 / np.sqrt(whole)))
    weight = np.maximum(0.0, 0.5 * relaxation * coupling - 0.25 * (2.0 - relaxation) * diagonal)
    return np.where(np.isfinite(weight), weight, 0.0)


def _grid(matrix: Operator, halo: Halo, own: int, scales_rows: bool) -> GridOnRanks:
    indptr, indices, data = matrix.arrays
    first = Operator(indptr[: own + 1], indices[: indptr[own]], data[: indptr[own]])
    split, inverse = pivots(first, kernels.SMALLEST_PIVOT)
    weight = np.zeros(own)
    if not (halo.is_empty or scales_rows):
        rows = sp.csr_array((first.data, first.indices, first.indptr), (own, own + halo.foreign))
        weight = pivot_weight(rows, halo, 1.0)
        inverse = np.where(inverse > 0.0, 1.0 / (1.0 / inverse + weight), 0.0)
    blocks = blocks_of(first.arrays, own, may_cut=halo.is_empty and not scales_rows)
    return GridOnRanks(matrix, split, blocks, read_only(inverse), halo, weight)


def _interpolation(
    grid: GridOnRanks, strength: float, has_jumps: bool | None
) -> InterpolationOnRanks | None:
    """Return the interpolation from coarse unknowns of any rank; None if no unknowns are coupled.

    If couplings jump from edge to edge, each rank also makes the second pass of Ruge and Stüben among its unknowns.
    """
    indptr, indices, data = grid.own
    n, halo = grid.n, grid.halo
    square = np.pad(indptr, (0, grid.width - n), "edge")  # the rows of ghosts are empty

    def spread(choice: Any) -> Any:
        choice = np.concatenate([choice, np.zeros(halo.foreign, choice.dtype)])
        halo.fetch_flags(choice)
        return choice

    chosen, P, lonely = interpolation_of(
        (square, indices, data), n, strength, second_pass=bool(has_jumps), spread=spread
    )
    is_coarse = read_only(chosen[:n])
    below = Halo(halo.comm, int(np.count_nonzero(is_coarse)))
    if below.n == 0:
        return None
    if has_jumps is None and halo.total(lonely) > NOTEWORTHY_LONELY * halo.n:
        return _interpolation(grid, strength, has_jumps=True)
    number = halo.whole(below.first - 1.0 + np.cumsum(is_coarse))[chosen]
    end = int(P.indptr[n])
    rows = P.indptr[: n + 1], number[P.indices[:end]].astype(indices.dtype), P.data[:end]
    return InterpolationOnRanks(halo.with_foreign_rows(rows), is_coarse, below, bool(has_jumps))


def _coarser(
    grid: GridOnRanks, interpolation: InterpolationOnRanks, scales_rows: bool
) -> tuple[Transfer, GridOnRanks] | None:
    """Return the way to the coarser grid and that grid; None if its numbers are not finite."""
    halo, below = grid.halo, interpolation.below
    p_indptr, columns, p_data = interpolation.rows
    others, count = below.outside(columns), below.own
    p_indices = below.local(columns, others)
    fine = grid.matrix.indptr.size - 1  # local unknowns, and ghosts with stored rows
    P = sp.csr_array((p_data, p_indices, p_indptr), shape=(p_indptr.size - 1, count + others.size))
    R = P[:fine, :count].T.tocsr()
    if scales_rows:
        R.data *= halo.whole(grid.inverse)[R.indices]
        if not halo.everywhere(np.isfinite(R.data)):
            return None
    prolongation = Operator(p_indptr, p_indices, p_data)
    restriction = Operator(R.indptr, R.indices, R.data)
    rows = kernels.product(grid.matrix, prolongation, restriction, count + others.size).arrays
    if not halo.is_empty:
        met = p_indices[: int(p_indptr[grid.n])]
        further = others[np.unique(met[met >= count]) - count]
        rows, below = below.overlapped(rows, others, further)
        # Rows of P of distant unknowns may have any number.
        prolongation = Operator(p_indptr, below.local(columns, below.ghosts), p_data)
    transfer = Transfer(prolongation, restriction, interpolation.is_coarse)
    return transfer, _grid(Operator(*rows), below, count, scales_rows)


class TruncatedGridOnRanks(TruncatedGrid):
    """The values of one grid while some unknowns are fixed, and its vectors, with space for the ghosts."""

    grid: GridOnRanks

    def __init__(self, grid: GridOnRanks, *, is_finest: bool) -> None:
        super().__init__(grid, is_finest=is_finest)
        self.is_free, self.is_interpolated = np.ones((2, grid.width), np.bool_)
        self.free_changed, self.touched = np.zeros((2, grid.width), np.bool_)
        self.x, self.residual = np.zeros((2, grid.width))
        self.halo = grid.halo

    def factor(self) -> tuple[None, float]:
        """Return None: no rank has all rows."""
        return None, 0.0

    def fetch(self, x: FloatVector) -> None:
        """Fetch the values of ghosts."""
        self.halo.fetch(x)

    def add_pivot_weights(self, residual: FloatVector) -> None:
        """Add the weights of the pivots times x to the residual after the first sweep.

        All ranks sweep at once. The sweep adds a weight to the pivot of each row that is coupled to a ghost, because
        it might diverge otherwise; see :func:`pivot_weight`.
        """
        own = self.x[: self.grid.n]
        residual += np.where(self.inverse != 0.0, self.grid.weight * own, 0.0)


class TruncationOnRanks(Truncation):
    """A hierarchy with the fixed unknowns of its finest grid taken out of all grids."""

    kind = TruncatedGridOnRanks

    @property
    def halo(self) -> Halo:
        """The ranks, and the ghosts of the finest grid."""
        return self.grids[0].halo  # type: ignore[attr-defined, no-any-return]

    def mark(self, level: Any, transfer: Transfer) -> None:
        """Find the held unknowns of a grid, and the rows whose part of the coarser matrix has changed."""
        halo = level.halo
        halo.fetch_flags(level.is_free)
        halo.fetch_flags(level.free_changed)
        level.mark_rows(level.row_changed)
        level.find_held(transfer)
        halo.fetch_flags(level.is_interpolated)
        halo.fetch_flags(level.free_changed)
        if level.free_changed.any():
            level.mark_rows(level.touched)
        halo.fetch_flags(level.touched)
        if level.new_values is not None:
            halo.fetch_entries(level.new_values)

    def finish_update(self, below: Any, changed: int) -> float:
        """Invert the pivots of a coarser grid, and return the number of its rows that have changed on all ranks."""
        pivot = below.values[below.grid.split] + below.grid.weight
        below.inverse[:] = np.where(below.is_free[: below.grid.n], 1.0 / pivot, 0.0)
        return self.total(changed)

    def total(self, number: float) -> float:
        """Return the sum of a number of each rank."""
        return self.halo.total(number)

    def largest(self, number: float) -> float:
        """Return the largest of a number of each rank."""
        return self.halo.largest(number)
