"""Hierarchy of the grids of one matrix, from the finest to the coarsest; immutable, so that all runs share it.

Memory for a five-point matrix, 12 bytes per entry: 1.4 times the entries of M in all coarser matrices together, 0.8
times in P and 0.8 times in Pᵀ. A run also stores the value of each coarse entry while some unknowns are fixed.
"""

from __future__ import annotations

from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...core.checks import FloatVector, read_only
from ...core.kernels.threads import share
from ...core.matrix.matrix import Matrix, fact
from ...core.matrix.symmetry import is_nearly_symmetric
from . import coarsening, galerkin
from .grids import (
    ALIKE,
    SMALLEST_PIECE,
    Grid,
    Hierarchy,
    Operator,
    Transfer,
    blocks_of,
    pivots,
    rows_from_kernel,
)
from .vectors import scaling_of_unknowns

STRENGTH, STRENGTH_AMONG_POSITIVE = 0.25, 0.5
NOTEWORTHY_POSITIVE = 0.02
NEGLIGIBLE_POSITIVE = 1e-3  # of coarser grids: less is none
MOST_POSITIVE = 1.0 / 3.0  # of all couplings: with more, lumping prevents the search for a scaling
NOTEWORTHY_LONELY = (
    5e-4  # share of the finest grid's unknowns that are coupled, but to no coarse one
)
COARSEST = 60
LARGEST_GRID_SHARE = 0.85  # a coarser grid with more unknowns than this is not worth its visit
LARGEST_GROWTH = 1.5  # of the entries from one grid to the next; 1.34 on the seven-point matrix
LARGEST_COMPLEXITY = 8.0
MOST_PRODUCTS = 45.0  # per entry of M; at most 32 occurred in cases that multigrid helps
LARGEST_NARROW = (
    2**30
)  # entries; a coarser matrix may have more of them, which 32 bits must still count
PASSES_TO_COARSEN = 6.0  # couplings, dependents, choice (twice), interpolation (twice)


class Interpolation(NamedTuple):
    """Rows of P, the mask of coarse unknowns, and the number of entries `read` for an extended interpolation."""

    indptr: NDArray[Any]
    columns: NDArray[Any]
    data: FloatVector
    is_coarse: NDArray[np.bool_]
    extends: bool
    read: int


def build_hierarchy(
    matrix: Any,
    coarsest: int = COARSEST,
    strength: float | None = None,
    *,
    scales_rows: bool = False,
) -> Hierarchy:
    """Return the classical hierarchy of a matrix with a positive diagonal.

    Parameters
    ----------
    matrix : csr_array, shape (n, n)
        Canonical: sorted, no duplicates, every diagonal entry positive.
    coarsest : int
        A grid with at most so many unknowns is not made coarser.
    strength : float, optional
        Couplings smaller than this share of the row's largest are not used for interpolation. By default 0.25, and on
        grids with noteworthy positive couplings 0.5, because a rotated anisotropy makes weak couplings misleading.
    scales_rows : bool
        If True, the restriction Pᵀ D⁻¹ first divides each row by its diagonal entry. Rows of M may then have any size,
        but coarse matrices of a symmetric M are not symmetric.

    Examples
    --------
    >>> from lcp_plugin import gallery
    >>> hierarchy = build_hierarchy(gallery.build("obstacle_2d", size=20).problem.csr)
    >>> [grid.n for grid in hierarchy.grids]
    [400, 200, 50]
    """
    indptr, indices = matrix.indptr, matrix.indices
    if matrix.data.size > LARGEST_NARROW:
        indptr, indices = indptr.astype(np.int64), indices.astype(np.int64)
    grid = grid_of(Operator(indptr, indices, matrix.data), may_cut=not scales_rows)
    entries = max(grid.entries, 1)
    positive, total, lacking = coarsening.couplings_by_sign(*grid.matrix.arrays)
    work = float(entries)
    is_mixed = strength is None and positive > NOTEWORTHY_POSITIVE * total
    if strength is None:
        strength = STRENGTH_AMONG_POSITIVE if is_mixed else STRENGTH
    scaling, extends = None, None
    if positive <= MOST_POSITIVE * total:
        scaling, further = scaling_of_unknowns(matrix, lacking)
        work += further
    alone, grids, transfers = (grid,), [grid], list[Transfer]()
    stored, products = 0.0, 0.0
    while grid.n > coarsest:
        work += PASSES_TO_COARSEN * grid.entries
        interpolation = _interpolation(grid, strength, scaling, extends)
        if interpolation is None:
            break
        extends = interpolation.extends  # the choice on the finest grid applies to all grids
        work += interpolation.read
        finer = grid
        stored += finer.entries
        products += galerkin.count_products(*finer.matrix.arrays[:2], interpolation.indptr)
        is_too_large = np.count_nonzero(interpolation.is_coarse) > LARGEST_GRID_SHARE * grid.n
        is_dear = products > MOST_PRODUCTS * entries or stored > LARGEST_COMPLEXITY * entries
        if is_too_large or is_dear:
            return Hierarchy(alone, (), work, is_helpful=False)
        coarser = _coarser(finer, interpolation, scales_rows, scaling)
        if coarser is None:
            break
        transfer, grid = coarser
        scaling = None if scaling is None else scaling[interpolation.is_coarse]
        if grid.entries > LARGEST_GROWTH * finer.entries:
            return Hierarchy(alone, (), work + products, is_helpful=False)
        if (
            is_mixed
        ):  # finite elements of second order have coarser grids without positive couplings
            positive, total, _ = coarsening.couplings_by_sign(*grid.matrix.arrays)
            strength = (
                STRENGTH_AMONG_POSITIVE if positive > NEGLIGIBLE_POSITIVE * total else STRENGTH
            )
            work += grid.entries
        grids.append(grid)
        transfers.append(transfer)
    return Hierarchy(
        tuple(grids), tuple(transfers), work + products, is_helpful=True, extends=bool(extends)
    )


@fact
def hierarchy_of(matrix: Matrix, coarsest: int) -> Hierarchy:
    """Return the hierarchy of M, which its solves share."""
    scales_rows = not is_nearly_symmetric(matrix)
    return build_hierarchy(matrix.csr, coarsest, scales_rows=scales_rows)


def grid_of(matrix: Operator, *, may_cut: bool = False) -> Grid:
    """Return the grid of a matrix; whether it `may_cut` sweeps."""
    split, inverse = pivots(matrix, galerkin.SMALLEST_PIVOT)
    blocks = blocks_of(matrix.arrays, inverse.size, may_cut=may_cut)
    return Grid(matrix, split, blocks, inverse)


def chosen_kinds(
    indptr: NDArray[Any],
    indices: NDArray[Any],
    data: FloatVector,
    strength: float,
    is_strong: NDArray[np.bool_],
) -> NDArray[np.uint8]:
    """Return who is COARSE and who FINE, decided among the unknowns that have rows; fill `is_strong`."""
    # Allocated here and not in the kernels: numpy uses large pages, which makes the first touch four times cheaper.
    n = indptr.size - 1
    columns, last = np.empty(data.size, indices.dtype), np.empty(n, indptr.dtype)
    operands = indptr, indices, data, strength, n, is_strong, columns, last
    share(partial(coarsening.strong_couplings, *operands), n, SMALLEST_PIECE)
    depends = tuple(map(read_only, (indptr[:-1], last, columns)))
    # If the strong couplings are mutual, as on regular grids, no transpose is needed: a third of the set-up.
    mirror = partial(coarsening.unmirrored, *depends)
    dependents, is_mutual = depends, sum(share(mirror, n, SMALLEST_PIECE)) == 0
    if not is_mutual:
        starts = np.append(0, np.cumsum(last - indptr[:-1])).astype(indices.dtype)
        end = int(indptr[-1])  # other rows may follow
        strong = indices[:end][is_strong[:end]]
        first, rows, _ = galerkin.transposed(n, starts, strong, np.ones(strong.size))
        dependents = tuple(map(read_only, (first[:-1], first[1:], rows)))
    kind, weight = np.empty(n, np.uint8), np.empty(n, np.int32)
    entry, after = np.empty(n + data.size, indices.dtype), np.empty(n + data.size, indptr.dtype)
    head = np.full(2 * int((dependents[1] - dependents[0]).max(initial=0)) + 2, -1, indptr.dtype)
    coarsening.choose_coarse(*depends, *dependents, is_mutual, kind, weight, entry, after, head)
    return kind


def _interpolation(
    grid: Grid, strength: float, scaling: FloatVector | None, extends: bool | None
) -> Interpolation | None:
    """Return the interpolation from coarse unknowns; None if nothing is coupled any more.

    If `extends`, interpolation reaches through fine unknowns. None means that this function decides.
    """
    indptr, indices, data = grid.matrix.arrays
    if scaling is not None:
        data = Operator(indptr, indices, data * scaling[indices]).data
    is_strong = np.empty(data.size, np.bool_)
    kind = chosen_kinds(indptr, indices, data, strength, is_strong)
    is_coarse = kind == coarsening.COARSE
    is_coarse.flags.writeable = False
    if not is_coarse.any():
        return None
    number = np.cumsum(is_coarse, dtype=indices.dtype)
    number -= indices.dtype.type(1)
    operands, read = (indptr, indices, data, is_strong, kind, number), 0
    if not extends:
        kernel, smallest = coarsening.direct_interpolation, SMALLEST_PIECE
        (p_indptr, p_indices, p_data), lonely = rows_from_kernel(kernel, operands, 0, smallest)
        extends = extends is None and lonely > NOTEWORTHY_LONELY * grid.n
    if extends:
        kernel, more = coarsening.extended_interpolation, coarsening.MOST_WEIGHTS
        (p_indptr, p_indices, p_data), read = rows_from_kernel(
            kernel, operands, more, grid.n
        )  # all rows at once
    if scaling is not None:
        p_data *= np.repeat(scaling, np.diff(p_indptr)) / scaling[is_coarse][p_indices]
    return Interpolation(p_indptr, p_indices, p_data, is_coarse, extends, read)


def _coarser(
    grid: Grid, interpolation: Interpolation, scales_rows: bool, scaling: FloatVector | None
) -> tuple[Transfer, Grid] | None:
    """Return the way to the coarser grid and that grid; None if its numbers would not be finite."""
    prolongation, is_coarse = Operator(*interpolation[:3]), interpolation.is_coarse
    count = int(np.count_nonzero(is_coarse))
    restriction = galerkin.transposed(count, *prolongation.arrays)
    if scales_rows:
        # The rows of M V are brought to one size, not the rows of M.
        inverse = grid.inverse if scaling is None else grid.inverse / scaling**2
        with np.errstate(over="ignore"):
            restriction[2][:] *= inverse[restriction[1]]
        if not np.isfinite(restriction[2]).all():
            return None
    restricting = Operator(*restriction)
    rows = galerkin.galerkin_product(
        grid.matrix.arrays, prolongation.arrays, restricting.arrays, count
    )
    transfer = Transfer(
        prolongation, restricting, is_coarse, ALIKE if scaling is None else read_only(scaling)
    )
    return transfer, grid_of(Operator(*rows), may_cut=not scales_rows)
