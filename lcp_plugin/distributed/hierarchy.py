"""The algebraic hierarchy of a matrix whose rows lie on several ranks.

Each rank coarsens its own unknowns and interpolates them from its own coarse ones; couplings to other ranks count in
the weights, and the coarse matrices keep them. So prolongation and restriction send nothing, and taking unknowns out
needs but the neighbours' flags. A hierarchy of PETSc's GAMG in its place was measured and is slower: see the README.
"""

from __future__ import annotations

import numpy as np

from ..hierarchy import coarsening, galerkin
from ..hierarchy.levels import (
    LARGEST_COMPLEXITY,
    LARGEST_GRID_SHARE,
    LARGEST_GROWTH,
    MOST_PRODUCTS,
    NOTEWORTHY_POSITIVE,
    PASSES_TO_COARSEN,
    STRENGTH,
    STRENGTH_AMONG_POSITIVE,
    Grid,
    Hierarchy,
    Operator,
    Transfer,
    grid_of,
)
from . import kernels
from .problem import DistributedLCP
from .rows import Halo, Layout


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
    rows, total = problem.rows, problem.rows.halo.total
    grid = grid_of(Operator(*rows.arrays), rows.halo)
    layout = problem.layout
    entries = max(total(grid.matrix.data.size), 1.0)
    share = total(coarsening.positive_share(*grid.matrix.arrays) * grid.matrix.data.size) / entries
    strength = STRENGTH if not share > NOTEWORTHY_POSITIVE else STRENGTH_AMONG_POSITIVE
    alone = Hierarchy((grid,), (), 0.0, is_helpful=False)
    grids, transfers = [grid], list[Transfer]()
    work = stored = products = 0.0
    while layout.n > coarsest:
        work += PASSES_TO_COARSEN * grid.matrix.data.size
        step = _transfer(grid, layout, strength, scales_rows=not is_symmetric)
        if step is None:
            break
        transfer, below, halo = step
        size = total(grid.matrix.data.size)
        stored += size
        here = galerkin.count_products(grid.matrix.indptr, grid.matrix.indices, transfer.prolongation.indptr)
        work += here
        products += total(here)
        is_too_large = below.n > LARGEST_GRID_SHARE * layout.n
        if is_too_large or products > MOST_PRODUCTS * entries or stored > LARGEST_COMPLEXITY * entries:
            return alone
        arrays = galerkin.galerkin_product(
            grid.matrix.arrays, transfer.prolongation.arrays, transfer.restriction.arrays, below.own + halo.foreign
        )
        grid, layout = grid_of(Operator(*arrays), halo), below
        if total(grid.matrix.data.size) > LARGEST_GROWTH * size:
            return alone
        grids.append(grid)
        transfers.append(transfer)
    return Hierarchy(tuple(grids), tuple(transfers), work, is_helpful=True)


def _transfer(
    grid: Grid, layout: Layout, strength: float, *, scales_rows: bool
) -> tuple[Transfer, Layout, Halo] | None:
    """Return the way to the next coarser grid, who owns what there, and its halo; None where nothing is coupled."""
    comm = layout.comm
    p_indptr, p_indices, p_data, is_coarse = _own_interpolation(grid, strength)
    below = Layout(comm, int(np.count_nonzero(is_coarse)))
    if below.n == 0:
        return None
    r_indptr, r_indices, r_data = galerkin.transposed(below.own, p_indptr, p_indices, p_data)
    is_finite = True
    if scales_rows:
        with np.errstate(over="ignore"):
            r_data *= grid.inverse[r_indices]
        is_finite = bool(np.isfinite(r_data).all())
    if not all(comm.allgather(is_finite)):
        return None
    counts, columns, values = _foreign_interpolation(grid, below, p_indptr, p_indices, p_data)
    ghosts, place = np.unique(columns, return_inverse=True)
    prolongation = Operator(
        np.concatenate([p_indptr, p_indptr[-1] + np.cumsum(counts, dtype=p_indptr.dtype)]),
        np.concatenate([p_indices, (below.own + place).astype(p_indices.dtype)]),
        np.concatenate([p_data, values]),
    ) if counts.size else Operator(p_indptr, p_indices, p_data)
    transfer = Transfer(prolongation, Operator(r_indptr, r_indices, r_data), is_coarse)
    return transfer, below, Halo(below, ghosts)


def _own_interpolation(grid: Grid, strength: float):  # type: ignore[no-untyped-def]
    """Return the interpolation of the own unknowns in CSR, and which of them are coarse."""
    indptr, indices, data = grid.matrix.arrays
    n = grid.n
    is_strong = np.empty(data.size, np.bool_)
    first = np.zeros(n + 1, indptr.dtype)
    if grid.peers.foreign:
        kernels.own_strong_couplings(indptr, indices, data, strength, n, is_strong, first)
    else:
        coarsening.strong_couplings(indptr, indices, data, strength, is_strong, first)
    np.cumsum(first, out=first)
    dependents = np.empty(int(first[-1]), indices.dtype)
    coarsening.list_dependents(indptr, indices, is_strong, first, dependents)
    kind = np.zeros(n, np.uint8)
    entry, after = np.empty(n + data.size, indices.dtype), np.empty(n + data.size, indptr.dtype)
    coarsening.choose_coarse(indptr, indices, is_strong, first, dependents, kind, entry, after)
    del dependents, entry, after
    is_coarse = kind == coarsening.COARSE
    number = np.cumsum(is_coarse, dtype=indices.dtype) - indices.dtype.type(1)
    p_indptr = np.empty(n + 1, indptr.dtype)
    p_indices, p_data = np.empty(data.size, indices.dtype), np.empty(data.size)
    size = coarsening.direct_interpolation(
        indptr, indices, data, is_strong, kind, number, p_indptr, p_indices, p_data
    )
    is_coarse.flags.writeable = False
    return p_indptr, p_indices[:size], p_data[:size], is_coarse


def _foreign_interpolation(grid: Grid, below: Layout, p_indptr, p_indices, p_data):  # type: ignore[no-untyped-def]
    """Return the interpolation of the foreign unknowns: entries a row, global coarse columns, weights."""
    halo: Halo = grid.peers  # type: ignore[assignment]
    comm = below.comm
    if halo.is_empty:
        return np.empty(0, p_indptr.dtype), np.empty(0, np.int64), np.empty(0)
    owners = halo.layout.owners(halo.ghosts)
    wanted = [halo.ghosts[owners == rank] - halo.layout.starts[rank] for rank in range(comm.size)]
    replies = []
    for rows in comm.alltoall(wanted):
        counts = np.diff(p_indptr)[rows]
        places = np.repeat(p_indptr[rows] - np.concatenate([[0], np.cumsum(counts)[:-1]]), counts)
        places = (places + np.arange(places.size)).astype(np.int64)
        replies.append((counts, p_indices[places].astype(np.int64) + below.first, p_data[places]))
    # The ghosts ascend, and so do their owners: the answers stand in the right order.
    counts, columns, values = (np.concatenate(parts) for parts in zip(*comm.alltoall(replies), strict=True))
    return counts, columns, values
