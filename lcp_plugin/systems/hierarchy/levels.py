"""The grids of one matrix, from the finest to the coarsest; immutable, so that all runs on the matrix share them.

Memory, five-point matrix, at 12 bytes an entry: 1.4 times the entries of M in all coarser matrices together, 0.8 times
in P and as many in its transpose; a run adds the value of each coarse entry while some unknowns are fixed.
"""

from __future__ import annotations

from functools import partial
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from ...core.checks import Arrays, FloatVector, read_only
from ...core.communicator import ALONE, NOBODY, Communicator, SharedRows
from ...core.kernels.threads import share
from ...core.matrix.joint_facts import pivot_weight
from ...core.matrix.matrix import Matrix, fact
from ...core.matrix.symmetry import has_symmetric_entries, is_mirrored
from . import coarsening, galerkin
from .grids import (
    NO_WEIGHT,
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
MOST_POSITIVE = (
    1.0 / 3.0
)  # of all couplings: where they are more, lumping them leaves no scaling to be found
NOTEWORTHY_LONELY = (
    5e-4  # share of the finest grid's unknowns that are coupled, but to no coarse one
)
COARSEST = 60
LARGEST_GRID_SHARE = 0.85  # a coarser grid with more unknowns than this is not worth its visit
LARGEST_GROWTH = 1.5  # of the entries from one grid to the next; 1.34 on the seven-point matrix
LARGEST_GROWTH_OF_PARTS = 2.0  # more where the coarse unknowns of several processes do not match
LARGEST_COMPLEXITY = 8.0
MOST_PRODUCTS = 45.0  # an entry of M; at most 32 were seen where multigrid helps
LARGEST_NARROW = (
    2**30
)  # entries; a coarser matrix may have more of them, which 32 bits must still count
PASSES_TO_COARSEN = 6.0  # couplings, dependents, choice (twice), interpolation (twice)


class Interpolation(NamedTuple):
    """The rows of P: those of the own unknowns and, behind them, of the foreign ones whose rows are here.

    `columns` counts the coarse unknowns over all processes; `own` is how many of them are own ones, `below` who
    shares them. Where it `extends`, so many entries were `read` for it.
    """

    indptr: NDArray[Any]
    columns: NDArray[Any]
    data: FloatVector
    is_coarse: NDArray[np.bool_]
    own: int
    below: Communicator
    extends: bool
    read: int


def build_hierarchy(
    matrix: Any,
    coarsest: int = COARSEST,
    strength: float | None = None,
    *,
    scales_rows: bool = False,
    shared: SharedRows | None = None,
) -> Hierarchy:
    """Return the classical hierarchy of a matrix with a positive diagonal.

    Where several processes share the rows, each chooses the coarse ones among its own unknowns. Interpolation and
    Galerkin product then are those of one process: behind its own rows each holds those of the unknowns next to them.

    Parameters
    ----------
    matrix : csr_array, shape (own, width)
        Canonical: sorted, no duplicates, every diagonal entry positive. The own rows, which are all by default.
    coarsest : int
        A grid with at most so many unknowns is not made coarser.
    strength : float, optional
        Couplings smaller than this share of the row's largest are not used for interpolation. By default 0.25, and on
        grids with noteworthy positive couplings 0.5: those of a rotated anisotropy mislead the weak ones.
    scales_rows : bool
        Whether the restriction first divides each row by its diagonal entry, Pᵀ D⁻¹: then rows of M may have any size,
        but coarse matrices of a symmetric M are not symmetric.
    shared : SharedRows, optional
        What these rows are a part of, where other processes have some; all of them call.

    Examples
    --------
    >>> from lcp_plugin import gallery
    >>> hierarchy = build_hierarchy(gallery.build("obstacle_2d", size=20).problem.csr)
    >>> [grid.n for grid in hierarchy.grids]
    [400, 200, 50]
    """
    communicator = ALONE if shared is None else shared.communicator
    indptr, indices = matrix.indptr, matrix.indices
    if matrix.data.size > LARGEST_NARROW:
        indptr, indices = indptr.astype(np.int64), indices.astype(np.int64)
    rows, everybody = (indptr, indices, matrix.data), communicator
    if not communicator.is_empty:
        rows, everybody = communicator.overlapped(rows, communicator.ghosts, NOBODY)
    grid = _weighted_grid(Operator(*rows), everybody, matrix.shape[0], scales_rows)
    entries = max(communicator.total(grid.own_entries), 1)
    work = 0.0
    positive, total, lacking = map(grid.total_of, coarsening.couplings_by_sign(*grid.own_arrays))
    work += entries
    is_mixed = strength is None and positive > NOTEWORTHY_POSITIVE * total
    if strength is None:
        strength = STRENGTH_AMONG_POSITIVE if is_mixed else STRENGTH
    scaling, extends = None, None
    if communicator.is_empty and positive <= MOST_POSITIVE * total:
        scaling, further = scaling_of_unknowns(matrix, lacking)
        work += further
    alone, grids, transfers = (grid,), [grid], list[Transfer]()
    growth = LARGEST_GROWTH if communicator.is_empty else LARGEST_GROWTH_OF_PARTS
    stored, products, size = 0.0, 0.0, communicator.total(grid.n)
    while size > coarsest:
        work += PASSES_TO_COARSEN * grid.own_entries
        interpolation = _interpolation(grid, strength, scaling, extends)
        if interpolation is None:
            break
        extends = interpolation.extends  # what holds on the finest grid
        work += interpolation.read
        finer, own_indptr = grid, grid.own_arrays[0]
        stored += communicator.total(finer.own_entries)
        products += galerkin.count_products(own_indptr, finer.matrix.indices, interpolation.indptr)
        is_too_large = communicator.total(interpolation.own) > LARGEST_GRID_SHARE * size
        is_dear = (
            communicator.total(products) > MOST_PRODUCTS * entries
            or stored > LARGEST_COMPLEXITY * entries
        )
        if is_too_large or is_dear:
            return Hierarchy(alone, (), work, is_helpful=False)
        coarser = _coarser(finer, interpolation, scales_rows, scaling)
        if coarser is None:
            break
        transfer, grid = coarser
        scaling = None if scaling is None else scaling[interpolation.is_coarse]
        if communicator.total(grid.own_entries) > growth * communicator.total(finer.own_entries):
            return Hierarchy(alone, (), work + products, is_helpful=False)
        size = communicator.total(grid.n)
        if (
            is_mixed
        ):  # finite elements of second order have coarser grids without positive couplings
            positive, total, _ = map(grid.total_of, coarsening.couplings_by_sign(*grid.own_arrays))
            strength = (
                STRENGTH_AMONG_POSITIVE if positive > NEGLIGIBLE_POSITIVE * total else STRENGTH
            )
            work += grid.own_entries
        grids.append(grid)
        transfers.append(transfer)
    return Hierarchy(
        tuple(grids), tuple(transfers), work + products, is_helpful=True, extends=bool(extends)
    )


@fact
def hierarchy_of(matrix: Matrix, coarsest: int) -> Hierarchy:
    """Return the hierarchy of M, which its solves share."""
    scales_rows = not has_symmetric_entries(matrix)
    return build_hierarchy(matrix.csr_rows, coarsest, scales_rows=scales_rows, shared=matrix)


def grid_of(
    matrix: Operator,
    communicator: Communicator = ALONE,
    own: int | None = None,
    weight: FloatVector = NO_WEIGHT,
    *,
    may_cut: bool = False,
) -> Grid:
    """Return the grid of a matrix, whose first rows (all by default) are the own ones; whether it `may_cut` sweeps."""
    rows = matrix.indptr.size - 1 if own is None else own
    split, inverse = pivots(matrix, rows, weight, galerkin.SMALLEST_PIVOT)
    blocks = blocks_of(matrix.arrays, rows, may_cut=may_cut)
    return Grid(matrix, split, blocks, inverse, communicator, weight)


def chosen_kinds(
    indptr: NDArray[Any],
    indices: NDArray[Any],
    data: FloatVector,
    strength: float,
    is_strong: NDArray[np.bool_],
) -> NDArray[np.uint8]:
    """Return who is COARSE and who FINE, decided among the unknowns that have rows; fill `is_strong`."""
    # Allocated here and not in the kernels: numpy asks for large pages, which makes the first touch four times cheaper.
    n = indptr.size - 1
    columns, last = np.empty(data.size, indices.dtype), np.empty(n, indptr.dtype)
    operands = indptr, indices, data, strength, n, is_strong, columns, last
    share(partial(coarsening.strong_couplings, *operands), n, SMALLEST_PIECE)
    depends = tuple(map(read_only, (indptr[:-1], last, columns)))
    dependents, is_mutual = depends, is_mirrored(*depends)
    if not is_mutual:
        first, rows = galerkin.transposed_pattern(*depends)
        dependents = tuple(map(read_only, (first[:-1], first[1:], rows)))
    kind, weight = np.empty(n, np.uint8), np.empty(n, np.int32)
    entry, after = np.empty(n + data.size, indices.dtype), np.empty(n + data.size, indptr.dtype)
    head = np.full(2 * int((dependents[1] - dependents[0]).max(initial=0)) + 2, -1, indptr.dtype)
    coarsening.choose_coarse(*depends, *dependents, is_mutual, kind, weight, entry, after, head)
    return kind


def _weighted_grid(
    matrix: Operator, communicator: Communicator, own: int, scales_rows: bool
) -> Grid:
    """Return the grid, with larger pivots where M is symmetric: others need none, and have any unit in any row."""
    if communicator.is_empty or scales_rows:
        # One that follows a wind gets farther than in pieces.
        return grid_of(matrix, communicator, own, may_cut=not scales_rows)
    indptr, indices, data = matrix.arrays
    width = own + communicator.foreign
    rows = sp.csr_array((data, indices, indptr), shape=(indptr.size - 1, width))[:own]
    weight = pivot_weight(rows, communicator.fetch, 1.0)
    weight.flags.writeable = False
    return grid_of(matrix, communicator, own, weight)


def _interpolation(
    grid: Grid, strength: float, scaling: FloatVector | None, extends: bool | None
) -> Interpolation | None:
    """Return the interpolation from coarse unknowns of any process; None where nothing is coupled any more.

    Whether it reaches through fine unknowns is said by `extends`, or found out where that is None.
    """
    indptr, indices, data = grid.own_arrays
    if scaling is not None:
        data = Operator(indptr, indices, data * scaling[indices]).data
    n, communicator = grid.n, grid.communicator
    is_strong = np.empty(data.size, np.bool_)
    kind = chosen_kinds(indptr, indices, data, strength, is_strong)
    if not communicator.is_empty:
        kind = _mended(grid, strength, kind)
    is_coarse = kind == coarsening.COARSE
    is_coarse.flags.writeable = False
    count = int(np.count_nonzero(is_coarse))
    below = communicator.coarser(count)
    if communicator.total(count) == 0:
        return None
    number = np.cumsum(is_coarse, dtype=indices.dtype)
    number += indices.dtype.type(below.first - 1)
    if not communicator.is_empty:
        unused = np.empty(data.size, indices.dtype), np.empty(n, indptr.dtype)
        coarsening.strong_couplings(
            indptr, indices, data, strength, grid.width, is_strong, *unused, 0, n
        )
        kind, numbers = _kinds_of_all(grid, is_coarse), np.zeros(grid.width)
        numbers[:n] = number
        communicator.fetch(numbers)
        number = numbers.astype(indices.dtype)
    operands, read = (indptr, indices, data, is_strong, kind, number), 0
    if not extends:
        kernel, smallest = coarsening.direct_interpolation, SMALLEST_PIECE
        (p_indptr, p_indices, p_data), lonely = rows_from_kernel(kernel, operands, 0, smallest)
        extends = extends is None and communicator.total(
            lonely
        ) > NOTEWORTHY_LONELY * communicator.total(n)
    if extends:
        kernel, more = coarsening.extended_interpolation, coarsening.MOST_WEIGHTS
        (p_indptr, p_indices, p_data), read = rows_from_kernel(
            kernel, operands, more, n
        )  # all rows at once
    if scaling is not None:
        p_data *= np.repeat(scaling, np.diff(p_indptr)) / scaling[is_coarse][p_indices]
    rows = communicator.with_foreign_rows((p_indptr, p_indices, p_data))
    return Interpolation(*rows, is_coarse, count, below, extends, read)


def _mended(grid: Grid, strength: float, kind: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return the choice with further coarse unknowns where those of two processes do not fit together."""
    kinds, communicator = _kinds_of_all(grid, kind == coarsening.COARSE), grid.communicator
    coarsening.mend_seams(
        *grid.matrix.arrays, strength, grid.n, communicator.ghosts > communicator.first, kinds
    )
    return kinds[: grid.n]


def _kinds_of_all(grid: Grid, is_coarse: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """Return who is COARSE and who FINE among the own and the foreign unknowns."""
    flags = np.zeros(grid.width, np.bool_)
    flags[: grid.n] = is_coarse
    grid.fetch_flags(flags)
    return np.where(flags, coarsening.COARSE, coarsening.FINE).astype(np.uint8)


def _coarser(
    grid: Grid, interpolation: Interpolation, scales_rows: bool, scaling: FloatVector | None
) -> tuple[Transfer, Grid] | None:
    """Return the way to the coarser grid and that grid; None where its numbers would not be finite."""
    communicator = grid.communicator
    p_indptr, columns, p_data, is_coarse, count, below, *_ = interpolation
    others = below.outside(columns)
    p_indices = below.local(columns, others)
    restriction = _restriction(grid, count, (p_indptr, p_indices, p_data))
    if scales_rows:
        inverse = grid.inverse
        if not communicator.is_empty:
            inverse = np.zeros(grid.width)
            inverse[: grid.n] = grid.inverse
            communicator.fetch(inverse)
        elif scaling is not None:  # the rows of M V, not those of M, are brought to one size
            inverse = inverse / scaling**2
        with np.errstate(over="ignore"):
            restriction[2][:] *= inverse[restriction[1]]
        if not communicator.everywhere(bool(np.isfinite(restriction[2]).all())):
            return None
    prolongation, restricting = Operator(p_indptr, p_indices, p_data), Operator(*restriction)
    rows = galerkin.galerkin_product(
        grid.matrix.arrays, prolongation.arrays, restricting.arrays, count + others.size
    )
    if not communicator.is_empty:
        met = p_indices[: int(p_indptr[grid.n])]
        further = others[np.unique(met[met >= count]) - count]
        rows, below = below.overlapped(rows, others, further)
        # Rows of P far away need no right number.
        prolongation = Operator(p_indptr, below.local(columns, below.ghosts), p_data)
    transfer = Transfer(
        prolongation, restricting, is_coarse, NO_WEIGHT if scaling is None else read_only(scaling)
    )
    return transfer, _weighted_grid(Operator(*rows), below, count, scales_rows)


def _restriction(grid: Grid, count: int, prolongation: Arrays) -> Arrays:
    """Return the own rows of Pᵀ: the fine unknowns are own ones, or foreign ones whose rows of M are here."""
    p_indptr, p_indices, p_data = prolongation
    if grid.foreign:
        rows = grid.matrix.indptr.size - 1
        end = int(p_indptr[rows])
        is_own = p_indices[:end] < count
        counts = np.concatenate([[0], np.cumsum(is_own)])
        p_indptr = counts[p_indptr[: rows + 1]].astype(p_indptr.dtype)
        p_indices, p_data = p_indices[:end][is_own], p_data[:end][is_own]
    return galerkin.transposed(count, *Operator(p_indptr, p_indices, p_data).arrays)
