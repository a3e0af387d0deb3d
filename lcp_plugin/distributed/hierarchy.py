"""The algebraic hierarchy of a matrix whose rows lie on several ranks.

Each rank chooses the coarse ones among its own unknowns. Interpolation and Galerkin product then are those of a single
process: behind its own rows a rank holds those of the foreign unknowns next to them.
"""

from __future__ import annotations

from typing import Any, NamedTuple, cast

import numpy as np
import scipy.sparse as sp

from ..checks import FloatVector
from ..matrix.hierarchy import coarsening, galerkin
from ..matrix.hierarchy.levels import (
    LARGEST_COMPLEXITY,
    LARGEST_GRID_SHARE,
    MOST_PRODUCTS,
    NOTEWORTHY_POSITIVE,
    PASSES_TO_COARSEN,
    STRENGTH,
    STRENGTH_AMONG_POSITIVE,
    Grid,
    Hierarchy,
    Operator,
    Transfer,
    chosen_kinds,
    grid_of,
)
from ..peers.ranks.rows import Halo, Layout
from . import kernels
from .overlap import Integers, foreign_rows, overlapped, renumbered
from .pivots import pivot_weight
from .problem import DistributedLCP

LARGEST_GROWTH = 2.0  # of the entries from one grid to the next; more where the coarse unknowns of slabs do not match
NOBODY = np.empty(0, np.int64)


class Interpolation(NamedTuple):
    """Rows of P in CSR with global columns, and which of the own unknowns are coarse."""

    indptr: Integers
    columns: Integers
    data: FloatVector
    is_coarse: Any


def build_hierarchy(problem: DistributedLCP, coarsest: int, *, is_symmetric: bool) -> Hierarchy:
    """Return the hierarchy of the problem's matrix, as `hierarchy.levels.build_hierarchy` does; all ranks call.

    Parameters
    ----------
    problem : DistributedLCP
        With a positive diagonal.
    coarsest : int
        A grid with at most so many unknowns on all ranks together is not made coarser.
    is_symmetric : bool
        Otherwise the restriction divides each row by its diagonal entry.
    """
    rows, layout = problem.rows, problem.layout
    operator, halo = Operator(*rows.arrays), rows.halo
    if not halo.is_empty:
        operator, halo = overlapped(layout, operator, rows.ghosts, NOBODY)
    grid = _grid(operator, halo, layout.own, is_symmetric=is_symmetric)
    entries = max(halo.total(_own_entries(grid)), 1.0)
    share = halo.total(coarsening.positive_share(*_own_arrays(grid)) * _own_entries(grid)) / entries
    strength = STRENGTH if not share > NOTEWORTHY_POSITIVE else STRENGTH_AMONG_POSITIVE
    alone = Hierarchy((grid,), (), 0.0, is_helpful=False)
    grids, transfers = [grid], list[Transfer]()
    work = stored = products = 0.0
    while layout.n > coarsest:
        work += PASSES_TO_COARSEN * _own_entries(grid)
        interpolation = _interpolation(grid, layout, strength)
        below = Layout(layout.comm, int(np.count_nonzero(interpolation.is_coarse)))
        if below.n == 0:
            break
        size = halo.total(_own_entries(grid))
        stored += size
        here = galerkin.count_products(*_own_arrays(grid)[:2], interpolation.indptr)
        work += here
        products += halo.total(here)
        is_too_large = below.n > LARGEST_GRID_SHARE * layout.n
        if is_too_large or products > MOST_PRODUCTS * entries or stored > LARGEST_COMPLEXITY * entries:
            return alone
        step = _coarser(grid, layout, below, interpolation, scales_rows=not is_symmetric)
        if step is None:
            break
        transfer, grid = step
        layout = below
        if halo.total(_own_entries(grid)) > LARGEST_GROWTH * size:
            return alone
        grids.append(grid)
        transfers.append(transfer)
    return Hierarchy(tuple(grids), tuple(transfers), work, is_helpful=True)


def _grid(operator: Operator, halo: Halo, own: int, *, is_symmetric: bool) -> Grid:
    """Return the grid, with larger pivots where M is symmetric: others need none, and have any unit in any row."""
    if halo.is_empty or not is_symmetric:
        return grid_of(operator, halo, own)
    indptr, indices, data = operator.arrays
    rows = sp.csr_array((data, indices, indptr), shape=(indptr.size - 1, own + halo.foreign))[:own]
    whole = np.ones(own + halo.foreign)
    whole[:own] = rows.diagonal()
    halo.fetch(whole)
    weight = pivot_weight(whole[:own], rows[:, own:], whole[own:], 1.0)
    weight.flags.writeable = False
    return grid_of(operator, halo, own, weight)


def _own_entries(grid: Grid) -> int:
    return int(grid.matrix.indptr[grid.n])


def _own_arrays(grid: Grid) -> tuple[Integers, Integers, FloatVector]:
    matrix = grid.matrix
    if matrix.indptr.size == grid.n + 1:
        return matrix.arrays
    return Operator(matrix.indptr[: grid.n + 1], matrix.indices, matrix.data).arrays


def _interpolation(grid: Grid, layout: Layout, strength: float) -> Interpolation:
    """Return the interpolation of all unknowns that the own rows meet, the foreign ones as their owners do it."""
    own = _own_interpolation(grid, layout, strength)
    halo = _halo(grid)
    if halo.is_empty:
        return own
    found = foreign_rows(layout, halo.ghosts, own.indptr, own.data, lambda places: own.columns[places])
    return Interpolation(
        np.concatenate([own.indptr, own.indptr[-1] + np.cumsum(found.counts, dtype=own.indptr.dtype)]),
        np.concatenate([own.columns, found.columns.astype(own.columns.dtype)]),
        np.concatenate([own.data, found.values]), own.is_coarse,
    )


def _own_interpolation(grid: Grid, layout: Layout, strength: float) -> Interpolation:
    """Return the interpolation of the own unknowns, from coarse ones of any rank."""
    indptr, indices, data = _own_arrays(grid)
    n, halo = grid.n, _halo(grid)
    is_strong = np.empty(data.size, np.bool_)
    kind = _mended(grid, strength, chosen_kinds(indptr, indices, data, strength, is_strong))
    is_coarse = kind == coarsening.COARSE
    is_coarse.flags.writeable = False
    number = np.cumsum(is_coarse, dtype=indices.dtype) - indices.dtype.type(1)
    number += Layout(layout.comm, int(np.count_nonzero(is_coarse))).first
    if halo.foreign:
        everywhere = grid.width
        coarsening.strong_couplings(
            indptr, indices, data, strength, everywhere, is_strong, np.zeros(everywhere + 1, indptr.dtype)
        )
    if not halo.is_empty:
        numbers, flags = np.zeros(grid.width), np.zeros(grid.width, np.bool_)
        numbers[:n], flags[:n] = number, is_coarse
        halo.fetch(numbers)
        halo.fetch_flags(flags)
        number = numbers.astype(indices.dtype)
        kind = np.where(flags, coarsening.COARSE, coarsening.FINE).astype(np.uint8)
    p_indptr = np.empty(n + 1, indptr.dtype)
    p_indices, p_data = np.empty(data.size, indices.dtype), np.empty(data.size)
    size = coarsening.direct_interpolation(
        indptr, indices, data, is_strong, kind, number, p_indptr, p_indices, p_data
    )
    return Interpolation(p_indptr, p_indices[:size], p_data[:size], is_coarse)


def _mended(grid: Grid, strength: float, kind: Any) -> Any:
    """Return the choice with further coarse unknowns where those of two ranks do not fit together."""
    halo, n = _halo(grid), grid.n
    if halo.is_empty:
        return kind
    flags = np.zeros(grid.width, np.bool_)
    flags[:n] = kind == coarsening.COARSE
    halo.fetch_flags(flags)
    kinds = np.where(flags, coarsening.COARSE, coarsening.FINE).astype(np.uint8)
    kernels.mend_seams(*grid.matrix.arrays, strength, n, halo.ghosts >= halo.layout.last, kinds)
    return kinds[:n]


def _halo(grid: Grid) -> Halo:
    return cast(Halo, grid.peers)  # every grid of a hierarchy on ranks has one


def _coarser(
    grid: Grid, layout: Layout, below: Layout, interpolation: Interpolation, *, scales_rows: bool
) -> tuple[Transfer, Grid] | None:
    """Return the way to the coarser grid and that grid; None where its numbers would not be finite."""
    halo = _halo(grid)
    p_indptr, columns, p_data, is_coarse = interpolation
    foreign = columns[(columns < below.first) | (columns >= below.last)]
    others = np.unique(foreign).astype(np.int64)
    p_indices = renumbered(columns, below, others)
    restriction = _restriction(grid, below, p_indptr, p_indices, p_data)
    if scales_rows:
        inverse = np.zeros(grid.width)
        inverse[: grid.n] = grid.inverse
        halo.fetch(inverse)
        with np.errstate(over="ignore"):
            scaled = restriction.data * inverse[restriction.indices]
        if not all(layout.comm.allgather(bool(np.isfinite(scaled).all()))):
            return None
        restriction = Operator(restriction.indptr, restriction.indices, scaled)
    arrays = galerkin.galerkin_product(
        grid.matrix.arrays, Operator(p_indptr, p_indices, p_data).arrays, restriction.arrays, below.own + others.size
    )
    if halo.is_empty:
        operator, new_halo = Operator(*arrays), Halo(below, NOBODY)
    else:
        own_part = p_indices[: int(p_indptr[grid.n])]
        further = others[np.unique(own_part[own_part >= below.own]) - below.own]
        operator, new_halo = overlapped(below, Operator(*arrays), others, further)
        p_indices = renumbered(columns, below, new_halo.ghosts)  # rows of P far away need no right number
    transfer = Transfer(Operator(p_indptr, p_indices, p_data), restriction, is_coarse)
    return transfer, _grid(operator, new_halo, below.own, is_symmetric=not scales_rows)


def _restriction(grid: Grid, below: Layout, p_indptr: Integers, p_indices: Integers, p_data: FloatVector) -> Operator:
    """Return the own rows of Pᵀ: the fine unknowns are own ones, or foreign ones whose rows of M are here."""
    rows = grid.matrix.indptr.size - 1
    if not grid.peers.foreign:
        return Operator(*galerkin.transposed(below.own, *Operator(p_indptr, p_indices, p_data).arrays))
    end = int(p_indptr[rows])
    is_own = p_indices[:end] < below.own
    counts = np.concatenate([[0], np.cumsum(is_own)])
    kept = Operator(counts[p_indptr[: rows + 1]].astype(p_indptr.dtype), p_indices[:end][is_own], p_data[:end][is_own])
    return Operator(*galerkin.transposed(below.own, *kept.arrays))
