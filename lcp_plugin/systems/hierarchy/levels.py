"""Hierarchy of the grids of one matrix, from the finest to the coarsest; immutable, so that all runs share it.

pyamg chooses the coarse unknowns by the first pass of Ruge and Stüben, and interpolates directly from them. Positive
couplings are lumped into the diagonal. If couplings jump from edge to edge, many fine unknowns depend strongly on no
coarse unknown. Then the second pass makes more unknowns coarse.

Memory for a five-point matrix, 12 bytes per entry: 1.2 times the entries of M in all coarser matrices together, 0.8
times in P and 0.8 times in Pᵀ. A run also stores the value of each coarse entry while some unknowns are fixed.

References
----------
J. W. Ruge, K. Stüben, *Algebraic multigrid*, in: Multigrid Methods, SIAM 1987, doi:10.1137/1.9781611971057.ch4.
N. Bell, L. N. Olson, J. Schroder, B. Southworth, *PyAMG: algebraic multigrid solvers in Python*, J. Open Source
Softw. 8 (2023), doi:10.21105/joss.05495.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from ...core import deadline
from ...core.checks import AnyMatrix, Arrays, Vector, read_only
from ...core.entries import largest_in_rows
from ...core.matrix import Matrix, fact
from ...core.structure import is_nearly_symmetric
from . import kernels
from .grids import Grid, Hierarchy, NoGhosts, Operator, Transfer, blocks_of, pivots

# Weaker couplings than this share of the row's largest do not interpolate. With positive couplings, as of a rotated
# anisotropy, weak couplings are misleading.
STRENGTH, STRENGTH_AMONG_POSITIVE = 0.25, 0.4
NOTEWORTHY_LONELY = 5e-4  # share of the unknowns that depend on others, but on no coarse unknown
Spread = Callable[[Any], Any]
COARSEST = 60  # rows that are not coarsened
LARGEST_GRID_SHARE = 0.85  # a coarser grid with more unknowns than this is not worth its visit


@np.errstate(all="ignore")
def build_hierarchy(
    matrix: AnyMatrix, coarsest: int = COARSEST, *, scales_rows: bool = False
) -> Hierarchy:
    """Return the classical hierarchy of a matrix with a positive diagonal.

    Parameters
    ----------
    matrix : csr_array, shape (n, n)
        Canonical: sorted, no duplicates, every diagonal entry positive.
    coarsest : int
        A grid with at most so many unknowns is not made coarser.
    scales_rows : bool
        If True, the restriction Pᵀ D⁻¹ first divides each row by its diagonal entry. Rows of M may then have any size,
        but coarse matrices of a symmetric M are not symmetric.

    Raises
    ------
    OutOfTimeError
        If an enforced time limit is over; it is checked twice on each grid.

    Examples
    --------
    >>> from lcp_plugin import gallery
    >>> hierarchy = build_hierarchy(gallery.build("obstacle_2d", size=20).problem.csr)
    >>> [grid.n for grid in hierarchy.grids]
    [400, 200, 52]
    """
    grid = grid_of(Operator(matrix.indptr, matrix.indices, matrix.data), may_cut=not scales_rows)
    alone, grids, transfers = (grid,), [grid], list[Transfer]()
    entries, work, has_jumps = max(grid.entries, 1), float(grid.entries), False
    products, strength = 0.0, STRENGTH_AMONG_POSITIVE
    while grid.n > coarsest:
        deadline.require_seconds(0.0)
        # pyamg counts in 32 bits.
        if grid.entries > 2**30:
            return Hierarchy(alone, (), work, is_helpful=False)
        if strength != STRENGTH:  # coarser grids may lack the positive couplings of finer ones
            strength = strength_of(float(positive_shares(grid.matrix, grid.split).mean()))
        rows = grid.matrix.arrays
        is_coarse, P, lonely = interpolation_of(rows, grid.n, strength, second_pass=has_jumps)
        if not transfers and lonely > NOTEWORTHY_LONELY * grid.n:
            has_jumps = True
            is_coarse, P, _ = interpolation_of(rows, grid.n, strength, second_pass=True)
        # Couplings, dependents, choice (twice), interpolation (twice).
        work += 6.0 * grid.entries
        R = P.T.tocsr()
        if scales_rows:
            R.data *= grid.inverse[R.indices]
        if not (is_coarse.any() and np.isfinite(P.data).all() and np.isfinite(R.data).all()):
            break
        prolongation, restriction = (Operator(X.indptr, X.indices, X.data) for X in (P, R))
        # Products of three entries in PᵀMP; integers could overflow
        sizes = np.diff(prolongation.indptr).astype(np.float64)
        products += float(sizes @ (kernels.pattern_of(grid.matrix, sizes.size) @ sizes))
        # At most 32 occurred in cases that multigrid helps
        if P.shape[1] > LARGEST_GRID_SHARE * grid.n or products > 45.0 * entries:
            return Hierarchy(alone, (), work, is_helpful=False)
        deadline.require_seconds(0.0)
        coarse = kernels.galerkin(grid.matrix, prolongation, restriction, P.shape[1])
        grid = grid_of(coarse, may_cut=not scales_rows)
        grids.append(grid)
        transfers.append(Transfer(prolongation, restriction, is_coarse))
    work += products
    return Hierarchy(tuple(grids), tuple(transfers), work, is_helpful=True, has_jumps=has_jumps)


@fact
def hierarchy_of(matrix: Matrix, coarsest: int) -> Hierarchy:
    """Return the hierarchy of M, which its solves share."""
    scales_rows = not is_nearly_symmetric(matrix)
    return build_hierarchy(matrix.csr, coarsest, scales_rows=scales_rows)


def grid_of(matrix: Operator, *, may_cut: bool = False) -> Grid:
    """Return the grid of a matrix; whether it `may_cut` sweeps."""
    split, inverse = pivots(matrix, kernels.INVERTIBLE)
    blocks = blocks_of(matrix.arrays, inverse.size, may_cut=may_cut)
    return Grid(matrix, split, blocks, inverse, NoGhosts())


def positive_shares(matrix: Operator, split: NDArray[Any]) -> Vector:
    """Return the share of the positive couplings in each row, shape (n,)."""
    couplings = matrix.data.copy()
    couplings[split] = 0.0
    firsts = matrix.indptr[:-1]
    positive = np.add.reduceat(np.maximum(couplings, 0.0), firsts)
    total = np.add.reduceat(np.abs(couplings), firsts)
    return np.divide(positive, total, out=np.zeros(split.size), where=total > 0.0)


def strength_of(positive_share: float) -> float:
    """Return the least share of the largest coupling of a row with which a coupling interpolates."""
    return STRENGTH_AMONG_POSITIVE if positive_share > 0.02 else STRENGTH


def interpolation_of(
    rows: Arrays, n: int, strength: float, *, second_pass: bool, spread: Spread = np.asarray
) -> tuple[NDArray[np.bool_], sp.csr_array, int]:
    """Return the mask of the coarse unknowns, P, and the number of fine unknowns without a coarse neighbor.

    `rows` has a row for each of the `n` local unknowns, and an empty row for each ghost. `spread` adds the choices of
    ghosts to the local choices.
    """
    indptr, indices, data = rows
    width = indptr.size - 1
    M = sp.csr_matrix((data, indices, indptr), shape=(width, width))
    try:
        from pyamg.classical.interpolate import direct_interpolation
        from pyamg.classical.split import RS
        from pyamg.strength import classical_strength_of_connection
    except ImportError:
        return _interpolation_in_numpy(M, n, strength, spread)
    strong = classical_strength_of_connection(M, strength, norm="min")
    choice = spread(RS(strong if n == width else strong[:n, :n], second_pass=second_pass))
    P = sp.csr_array(direct_interpolation(M, strong, choice))
    is_lonely = (np.diff(P.indptr) == 0) & (np.diff(strong.indptr) > 1)  # strong has the diagonal
    return read_only(choice == 1), P, int(np.count_nonzero(is_lonely))


def _interpolation_in_numpy(
    M: AnyMatrix, n: int, strength: float, spread: Spread
) -> tuple[NDArray[np.bool_], sp.csr_array, int]:
    """Return the result of :func:`interpolation_of` without pyamg.

    The coarse unknowns are a maximal independent set of the strong couplings, by Luby's rounds, and each other unknown
    is interpolated directly from its strong coarse neighbors.
    """
    M = sp.csr_array(M)
    diagonal = M.diagonal() + sp.csr_array(M - sp.diags_array(M.diagonal())).maximum(0).sum(axis=1)
    coupling = sp.csr_array((-M).maximum(0))
    strong = coupling.copy()
    limit = strength * largest_in_rows(coupling)
    strong.data *= coupling.data >= np.repeat(limit, np.diff(coupling.indptr))
    strong.eliminate_zeros()
    graph = sp.csr_array(strong[:n, :n] + strong[:n, :n].T)
    # As Ruge and Stüben: first the unknowns on which many depend; the random share decides ties.
    weight = np.bincount(strong[:n, :n].indices, minlength=n) + np.random.default_rng(0).random(n)
    is_open, is_coarse = np.diff(graph.indptr) > 0, np.zeros(n, np.bool_)
    while is_open.any():
        rival = largest_in_rows(graph, np.where(is_open, weight, 0.0)[graph.indices])
        is_new = is_open & (weight > rival)
        is_coarse |= is_new
        is_open &= ~is_new & (graph @ is_new == 0.0)
    choice = np.asarray(spread(is_coarse.astype(np.int32))) == 1
    used = strong[:, choice]
    with np.errstate(divide="ignore", invalid="ignore"):
        shares = coupling.sum(axis=1) / used.sum(axis=1) / diagonal
    shares[choice | ~np.isfinite(shares)] = 0.0
    P = sp.diags_array(shares) @ used + sp.eye_array(choice.size, format="csr")[:, choice]
    P = sp.csr_array(P)
    P.eliminate_zeros()
    is_lonely = (np.diff(P.indptr) == 0) & (np.diff(strong.indptr) > 0)
    return read_only(choice), P, int(np.count_nonzero(is_lonely))
