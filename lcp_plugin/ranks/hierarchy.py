"""Classical algebraic multigrid on rows over MPI ranks, truncated to the free unknowns.

Each rank chooses coarse unknowns among its local unknowns; the second pass of Ruge and Stüben repairs the interfaces.
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
from ..core.kernels.compilation import inline, kernel, uintp
from ..systems.factors import Factor, dense_lu
from ..systems.hierarchy import coarsening, galerkin, sweeps, vectors
from ..systems.hierarchy.coarsening import COARSE
from ..systems.hierarchy.grids import (
    SMALLEST_PIECE,
    Operator,
    RowBlocks,
    Transfer,
    blocks_of,
    pivots,
    rows_from_kernel,
)
from ..systems.hierarchy.levels import chosen_kinds
from .halo import NOBODY, Halo

COARSEST = 60  # unknowns of all ranks
COARSEST_SWEEPS = 10  # there and back
FACTORISED_UP_TO = 150
STRENGTH, STRENGTH_AMONG_POSITIVE = 0.25, 0.5
NOTEWORTHY_POSITIVE = 0.02  # share of positive couplings from which on the larger strength is taken
NOTEWORTHY_LONELY = 5e-4  # share of unknowns without a coarse neighbor: interpolation is extended
LARGEST_GRID_SHARE, LARGEST_GROWTH, LARGEST_COMPLEXITY = 0.85, 2.0, 8.0


@dataclass(frozen=True, eq=False)
class GridOnRanks:
    """Local rows of one grid, then rows of adjacent ghosts, and the pivots of a sweep."""

    matrix: Operator
    split: NDArray[Any]
    blocks: RowBlocks
    inverse: FloatVector
    halo: Halo
    weight: FloatVector

    @property
    def n(self) -> int:
        """Number of local unknowns."""
        return self.inverse.size

    @property
    def width(self) -> int:
        """Number of unknowns that the rows meet."""
        return self.inverse.size + self.halo.foreign

    @property
    def rows(self) -> tuple[Any, ...]:
        """The matrix as sweeps take it."""
        return self.matrix.indptr, self.split, self.matrix.indices, self.matrix.data

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
    extends: bool


def build_hierarchy(matrix: Any, halo: Halo, *, scales_rows: bool) -> HierarchyOnRanks:
    """Return the hierarchy of the local rows, shape (own, own + foreign), with a positive diagonal.

    With `scales_rows` the restriction is Pᵀ D⁻¹ in place of Pᵀ, for matrices that are not symmetric.
    """
    rows = matrix.indptr, matrix.indices, matrix.data
    own, ranks = matrix.shape[0], halo
    if not halo.is_empty:
        rows, ranks = halo.overlapped(rows, halo.ghosts, NOBODY)
    grid = _grid(Operator(*rows), ranks, own, scales_rows)
    positive, total, _ = map(halo.total, coarsening.couplings_by_sign(*grid.own))
    is_mixed = positive > NOTEWORTHY_POSITIVE * total
    strength = STRENGTH_AMONG_POSITIVE if is_mixed else STRENGTH
    grids, transfers, extends = [grid], list[Transfer](), None
    entries = stored = halo.total(float(grid.own[0][-1]))
    size = halo.total(grid.n)
    while size > COARSEST:
        interpolation = _interpolation(grid, strength, extends)
        if interpolation is None:
            break
        extends = interpolation.extends
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


@np.errstate(all="ignore")
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
    split, inverse = pivots(first, galerkin.SMALLEST_PIVOT)
    weight = np.zeros(own)
    if not (halo.is_empty or scales_rows):
        rows = sp.csr_array((first.data, first.indices, first.indptr), (own, own + halo.foreign))
        weight = pivot_weight(rows, halo, 1.0)
        with np.errstate(divide="ignore"):
            inverse = np.where(inverse > 0.0, 1.0 / (1.0 / inverse + weight), 0.0)
    blocks = blocks_of(first.arrays, own, may_cut=halo.is_empty and not scales_rows)
    return GridOnRanks(matrix, split, blocks, read_only(inverse), halo, weight)


def _interpolation(
    grid: GridOnRanks, strength: float, extends: bool | None
) -> InterpolationOnRanks | None:
    """Return the interpolation from coarse unknowns of any rank; None if no unknowns are coupled."""
    indptr, indices, data = grid.own
    n, halo = grid.n, grid.halo
    is_strong = np.empty(data.size, np.bool_)
    kind = chosen_kinds(indptr, indices, data, strength, is_strong)
    if not halo.is_empty:
        kinds = _kinds_of_all(grid, kind == COARSE)
        gives_way = halo.ghosts > halo.first
        mend_seams(*grid.matrix.arrays, strength, n, gives_way, kinds)
        kind = kinds[:n]
    is_coarse = kind == COARSE
    is_coarse.flags.writeable = False
    count = int(np.count_nonzero(is_coarse))
    below = halo.coarser(count)
    if halo.total(count) == 0:
        return None
    number = np.cumsum(is_coarse, dtype=indices.dtype)
    number += indices.dtype.type(below.first - 1)
    if not halo.is_empty:
        unused = np.empty(data.size, indices.dtype), np.empty(n, indptr.dtype)
        coarsening.strong_couplings(
            indptr, indices, data, strength, grid.width, is_strong, *unused, 0, n
        )
        kind = _kinds_of_all(grid, is_coarse)
        number = halo.whole(number.astype(np.float64)).astype(indices.dtype)
    operands = (indptr, indices, data, is_strong, kind, number)
    if not extends:
        direct = coarsening.direct_interpolation
        rows, lonely = rows_from_kernel(direct, operands, 0, SMALLEST_PIECE)
        many = NOTEWORTHY_LONELY * halo.total(n)
        extends = extends is None and halo.total(lonely) > many
    if extends:
        extended, more = coarsening.extended_interpolation, coarsening.MOST_WEIGHTS
        rows, _ = rows_from_kernel(extended, operands, more, n)
    return InterpolationOnRanks(halo.with_foreign_rows(rows), is_coarse, below, bool(extends))


def _kinds_of_all(grid: GridOnRanks, is_coarse: NDArray[np.bool_]) -> NDArray[np.uint8]:
    flags = np.zeros(grid.width, np.bool_)
    flags[: grid.n] = is_coarse
    grid.halo.fetch_flags(flags)
    return np.where(flags, COARSE, coarsening.FINE).astype(np.uint8)


def _coarser(
    grid: GridOnRanks, interpolation: InterpolationOnRanks, scales_rows: bool
) -> tuple[Transfer, GridOnRanks] | None:
    """Return the way to the coarser grid and that grid; None if its numbers are not finite."""
    halo, below = grid.halo, interpolation.below
    p_indptr, columns, p_data = interpolation.rows
    others = below.outside(columns)
    p_indices = below.local(columns, others)
    restriction = _restriction(grid, below.own, (p_indptr, p_indices, p_data))
    if scales_rows:
        with np.errstate(over="ignore"):
            restriction[2][:] *= halo.whole(grid.inverse)[restriction[1]]
        if not halo.everywhere(np.isfinite(restriction[2])):
            return None
    prolongation, restricting = Operator(p_indptr, p_indices, p_data), Operator(*restriction)
    rows = galerkin.galerkin_product(
        grid.matrix.arrays, prolongation.arrays, restricting.arrays, below.own + others.size
    )
    count = below.own
    if not halo.is_empty:
        met = p_indices[: int(p_indptr[grid.n])]
        further = others[np.unique(met[met >= count]) - count]
        rows, below = below.overlapped(rows, others, further)
        # Rows of P of distant unknowns may have any number.
        prolongation = Operator(p_indptr, below.local(columns, below.ghosts), p_data)
    transfer = Transfer(prolongation, restricting, interpolation.is_coarse)
    return transfer, _grid(Operator(*rows), below, count, scales_rows)


def _restriction(grid: GridOnRanks, count: int, prolongation: Arrays) -> Arrays:
    """Return the local rows of Pᵀ; fine unknowns are local, or ghosts with stored rows."""
    p_indptr, p_indices, p_data = prolongation
    if grid.halo.foreign:
        rows = grid.matrix.indptr.size - 1
        end = int(p_indptr[rows])
        is_own = p_indices[:end] < count
        counts = np.concatenate([[0], np.cumsum(is_own)])
        p_indptr = counts[p_indptr[: rows + 1]].astype(p_indptr.dtype)
        p_indices, p_data = p_indices[:end][is_own], p_data[:end][is_own]
    return galerkin.transposed(count, *Operator(p_indptr, p_indices, p_data).arrays)


@inline
def _least_strong(indptr, indices, data, strength, i):  # type: ignore[no-untyped-def]
    """Return the least −m_ij of a strong coupling of row i; ∞ if it has none."""
    largest = 0.0
    for k in range(uintp(indptr[i]), uintp(indptr[i + uintp(1)])):
        if -data[k] > largest and uintp(indices[k]) != i:
            largest = -data[k]
    return strength * largest if largest > 0.0 else np.inf


@kernel
def mend_seams(indptr, indices, data, strength, own, gives_way, kind):  # type: ignore[no-untyped-def]
    """Make local unknowns coarse that depend strongly on a fine ghost, without a common coarse one.

    The second pass of Ruge and Stüben, at the interface of ranks. A local unknown changes only if the flag of the ghost
    in `gives_way` is set. The rows of adjacent ghosts follow the local rows.
    """
    one = uintp(1)
    n = uintp(own)
    rows = uintp(indptr.size - 1)
    mark = np.full(kind.size, -1, indptr.dtype)
    for i in range(n):
        begin, end = uintp(indptr[i]), uintp(indptr[i + one])
        if kind[i] == COARSE or begin == end or uintp(indices[end - one]) < n:
            continue
        least = _least_strong(indptr, indices, data, strength, i)
        for k in range(begin, end):
            if -data[k] >= least and kind[uintp(indices[k])] == COARSE:
                mark[uintp(indices[k])] = i
        for k in range(begin, end):
            j = uintp(indices[k])
            if j < n or j >= rows or -data[k] < least or kind[j] == COARSE or not gives_way[j - n]:
                continue
            has_common = False
            its_least = _least_strong(indptr, indices, data, strength, j)
            for m in range(uintp(indptr[j]), uintp(indptr[j + one])):
                if -data[m] >= its_least and mark[uintp(indices[m])] == i:
                    has_common = True
                    break
            if not has_common:
                kind[i] = COARSE
                break


class TruncatedGridOnRanks:
    """The values of one grid while some unknowns are fixed, and its vectors."""

    def __init__(self, grid: GridOnRanks, *, is_finest: bool) -> None:
        self.grid, n, width = grid, grid.n, grid.width
        self.new_values = None if is_finest else grid.matrix.data.copy()
        self.values = grid.matrix.data if self.new_values is None else self.new_values.view()
        self.values.flags.writeable = False
        self.inverse = grid.inverse.copy()
        self.is_free = np.ones(width, np.bool_)
        self.free_changed = np.zeros(width, np.bool_)
        self.is_interpolated = np.ones(width, np.bool_)
        self.held = np.zeros(0, np.intp)
        self.row_changed = np.zeros(n, np.bool_)
        self.touched = np.zeros(width, np.bool_)
        self.x, self.b, self.residual = (np.zeros(size) for size in (width, n, width))

    @property
    def rows(self) -> tuple[Any, ...]:
        """The truncated matrix as sweeps take it."""
        matrix = self.grid.matrix
        return matrix.indptr, self.grid.split, matrix.indices, self.values


class TruncationOnRanks:
    """A hierarchy with the fixed unknowns of its finest grid taken out of all grids."""

    def __init__(self, hierarchy: HierarchyOnRanks) -> None:
        self.transfers = hierarchy.transfers
        self.grids = [
            TruncatedGridOnRanks(grid, is_finest=not k) for k, grid in enumerate(hierarchy.grids)
        ]
        self.work = 0.0
        self._factor: Factor | None = None

    @np.errstate(divide="ignore")
    def update(self) -> None:
        """Carry changes of `is_free`, marked in `free_changed`, from the finest to all grids."""
        self._factor = None
        top = self.grids[0]
        np.multiply(top.grid.inverse, top.is_free[: top.grid.n], out=top.inverse)
        top.row_changed[:] = False
        for k, transfer in enumerate(self.transfers):
            level, below = self.grids[k], self.grids[k + 1]
            self._mark(level, transfer)
            products, changed = galerkin.update_product(
                *level.grid.matrix.arrays[:2],
                level.values,
                level.is_interpolated,
                level.touched,
                *transfer.prolongation.arrays,
                *transfer.restriction.arrays,
                *below.grid.matrix.arrays[:2],
                below.new_values,
                below.grid.split,
                below.inverse,
                below.is_free,
                below.free_changed,
                below.row_changed,
            )
            pivot = below.values[below.grid.split] + below.grid.weight
            below.inverse[:] = np.where(below.is_free[: below.grid.n], 1.0 / pivot, 0.0)
            self.work += level.values.size + transfer.restriction.indices.size + products
            if level.grid.halo.total(changed) == 0:
                break

    def _mark(self, level: TruncatedGridOnRanks, transfer: Transfer) -> None:
        """Find the unknowns of a grid that follow no coarse one, and the rows that contribute otherwise than before."""
        halo, matrix = level.grid.halo, level.grid.matrix
        halo.fetch_flags(level.is_free)
        halo.fetch_flags(level.free_changed)
        pattern, touched = matrix.arrays[:2], level.touched.view(np.uint8)
        galerkin.mark_rows(
            *pattern, level.free_changed.view(np.uint8), level.row_changed.view(np.uint8), touched
        )
        if vectors.find_held(
            *matrix.arrays,
            level.values,
            level.is_free,
            level.touched,
            level.is_interpolated,
            level.free_changed,
            transfer.scaling,
            transfer.is_coarse,
        ):
            own = slice(level.grid.n)
            level.held = np.flatnonzero(level.is_free[own] & ~level.is_interpolated[own])
        halo.fetch_flags(level.is_interpolated)
        halo.fetch_flags(level.free_changed)
        if level.free_changed.any():
            galerkin.mark_rows(*pattern, level.free_changed.view(np.uint8), touched, touched)
        halo.fetch_flags(level.touched)
        if level.new_values is not None:
            halo.fetch_entries(level.new_values)

    def correct(self, k: int = 0) -> None:
        """Write into x one V(1,1)-cycle for the truncated M x = b of grid k, from x = 0."""
        level = self.grids[k]
        grid, halo, rows, n = level.grid, level.grid.halo, level.rows, level.grid.n
        if k == len(self.transfers):
            self._solve_coarsest(level)
            return
        sweeps.first_sweep(rows, grid.blocks, level.inverse, level.b, level.x)
        halo.fetch(level.x)
        residual = level.residual[:n]
        sweeps.residual_after_first_sweep(
            rows, grid.blocks, level.inverse, level.b, level.x, residual
        )
        residual += np.where(level.inverse != 0.0, grid.weight * level.x[:n], 0.0)
        self.restrict(k, level.residual)
        self.correct(k + 1)
        below, transfer = self.grids[k + 1], self.transfers[k]
        below.grid.halo.fetch(below.x)
        vectors.add_prolonged(transfer, below.x, level.is_interpolated, level.x)
        halo.fetch(level.x)
        sweeps.sweep(rows, grid.blocks, level.inverse, True, level.b, level.x)
        self.work += 2.0 * level.values.size + 2.0 * transfer.prolongation.data.size

    def restrict(self, k: int, residual: FloatVector) -> None:
        """Write the restriction of `residual`, shape (width,), into b of grid k + 1."""
        level, held = self.grids[k], self.grids[k].held
        kept = residual[held]
        residual[held] = 0.0
        level.grid.halo.fetch(residual)
        vectors.restrict(self.transfers[k], residual, self.grids[k + 1].b)
        residual[held] = kept

    def _solve_coarsest(self, level: TruncatedGridOnRanks) -> None:
        n, halo = level.grid.n, level.grid.halo
        if halo.is_empty and halo.size == 1 and n <= FACTORISED_UP_TO:
            if self._factor is None:
                indptr, indices, _ = level.grid.matrix.arrays
                dense = sp.csr_array((level.values, indices, indptr), shape=(n, n)).toarray()
                is_fixed = level.inverse == 0.0
                dense[is_fixed, :] = dense[:, is_fixed] = 0.0
                dense[is_fixed, is_fixed] = 1.0
                self._factor = dense_lu(dense)
            if self._factor is not None:
                level.x[:] = self._factor.solve(np.where(level.inverse != 0.0, level.b, 0.0))
                return
        level.x[:] = 0.0
        for sweep in range(2 * COARSEST_SWEEPS + 1):
            halo.fetch(level.x)
            sweeps.sweep(
                level.rows, level.grid.blocks, level.inverse, sweep % 2 == 1, level.b, level.x
            )
        self.work += (2.0 * COARSEST_SWEEPS + 1.0) * level.values.size
