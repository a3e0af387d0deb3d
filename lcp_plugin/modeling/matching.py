"""Which equation goes with which free unknown: the diagonal that a splitting method divides by."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.sparse.csgraph import maximum_bipartite_matching, min_weight_full_bipartite_matching

SAME = 1e-9


def matching(block: sp.csr_array) -> NDArray[np.int64]:
    """Return for each equation the unknown it goes with: large entries on the diagonal where that is possible."""
    size = block.shape[0]
    rows = np.repeat(np.arange(size), np.diff(block.indptr))
    magnitude = np.abs(block.data)
    largest = np.zeros(size)
    np.maximum.at(largest, rows, magnitude)
    # Costs must be positive; a hint of the distance from the diagonal settles ties in natural order.
    cost = 1.0 + np.log(largest[rows] / magnitude) + 1e-9 * np.abs(rows - block.indices)
    index, pointer = block.indices.astype(np.int32), block.indptr.astype(np.int32)
    pattern = sp.csr_matrix((cost, index, pointer), shape=block.shape)
    try:
        return np.asarray(min_weight_full_bipartite_matching(pattern)[1], dtype=np.int64)
    except ValueError:  # no full matching: the diagonal will have gaps
        matched = np.asarray(maximum_bipartite_matching(pattern, perm_type="column"), dtype=np.int64)
        missing = np.flatnonzero(matched < 0)
        matched[missing] = np.setdiff1d(np.arange(size), matched[matched >= 0])
        return matched


def matched_for_monotony(
    equations: sp.csr_array, pairs: sp.csr_array, paired: NDArray[np.int64], free: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Return for each equation the place in `free` of the unknown it goes with, and the sign of its row.

    Parameters
    ----------
    equations, pairs : CSR array
        Over all unknowns; the rows of pairs with their signs.
    paired, free : array of int
        The unknown of each row of pairs, and those that are left for the equations.

    Notes
    -----
    Optimality conditions are monotone, and good to solve, only if stationarity in x goes with x and feasibility with
    its multiplier. Their row and column then hold the same numbers up to signs: that is what is looked for, first
    against the pairs, then against what is matched already. If it does not settle all, large diagonal entries decide.
    """
    order = _mirrored(equations, pairs, paired, free)
    if order is None:
        order = matching(sp.csr_array(equations[:, free]))
    rows = np.arange(order.size)
    signs = np.sign(np.asarray(equations[rows, free[order]]).ravel()) if order.size else np.zeros(0)
    column = free[order]
    # A zero on the diagonal asks for a row that is minus the column.
    across = _row_dots(sp.csr_array(equations[:, paired]), sp.csr_array(pairs[:, column].T))
    signs = np.where(signs == 0.0, -np.sign(across), signs)
    block = sp.csr_array(equations[:, column])
    across = _row_dots(block, sp.csr_array(sp.diags_array(signs) @ block).T.tocsr())
    signs = np.where(signs == 0.0, -np.sign(across), signs)
    return order, np.where(signs == 0.0, 1.0, signs)


def _row_dots(first: sp.csr_array, second: sp.csr_array) -> NDArray[np.float64]:
    """Return the products of the rows of one with the same rows of the other."""
    return np.asarray(first.multiply(second).sum(axis=1), dtype=np.float64).ravel()


def _mirrored(
    equations: sp.csr_array, pairs: sp.csr_array, paired: NDArray[np.int64], free: NDArray[np.int64]
) -> NDArray[np.int64] | None:
    """Return the matching of rows and columns with equal absolute values; None where it does not settle all."""
    size = free.size
    weights = np.random.default_rng(0).random(paired.size + size) + 1.0
    row_sums = abs(equations[:, paired]) @ weights[: paired.size]
    column_sums = abs(sp.csr_array(pairs[:, free])).T @ weights[: paired.size]
    block = abs(sp.csr_array(equations[:, free]))
    order = np.full(size, -1, dtype=np.int64)
    while (order < 0).any():
        open_rows = np.flatnonzero((order < 0) & (row_sums > 0.0))
        is_taken = np.zeros(size, dtype=bool)
        is_taken[order[order >= 0]] = True
        open_columns = np.flatnonzero(~is_taken & (column_sums > 0.0))
        if not open_rows.size or open_rows.size != open_columns.size:
            return None
        new_rows = open_rows[np.argsort(row_sums[open_rows], kind="stable")]
        new_columns = open_columns[np.argsort(column_sums[open_columns], kind="stable")]
        if not np.allclose(row_sums[new_rows], column_sums[new_columns], rtol=SAME, atol=0.0):
            return None
        order[new_rows] = new_columns
        weight = weights[paired.size + new_rows]
        row_sums = row_sums + block[:, new_columns] @ weight
        column_sums = column_sums + block[new_rows].T @ weight
    return order
