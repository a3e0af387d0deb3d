"""The one door to SuperLU, the factors that proofs ask for, and whether one is worth beginning."""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse as sp

from .equilibration import row_numbers

ALWAYS = 1_000  # rows; up to here any fill is cheap
LARGEST_OPERATIONS = 4e10  # about ten seconds, a 3-D grid of 37³; a random graph's n³ exceeds it at some thousands
LARGEST_FILL = 2e8  # entries


def factor_fits(matrix: Any) -> bool:
    """Return whether a factorisation of a CSR or CSC array has its end in sight.

    Notes
    -----
    The factor in the order of Cuthill and McKee stays within an envelope, whose Σ width and Σ width² count its entries
    and operations. The order used has less fill on grids, and none has much less on random graphs.
    """
    n = matrix.shape[0]
    if n <= ALWAYS:
        return True
    pattern = sp.csr_array((np.ones(matrix.indices.size), matrix.indices, matrix.indptr), shape=matrix.shape)
    rows = row_numbers(pattern)
    if _is_affordable(rows, pattern.indices, n):
        return True
    from scipy.sparse.csgraph import reverse_cuthill_mckee

    position = np.empty(n, dtype=np.int64)
    position[reverse_cuthill_mckee(pattern, symmetric_mode=False)] = np.arange(n)
    return _is_affordable(position[rows], position[pattern.indices], n)


def _is_affordable(rows: Any, columns: Any, n: int) -> bool:
    first = np.arange(n)
    np.minimum.at(first, np.maximum(rows, columns), np.minimum(rows, columns))
    width = (np.arange(n) - first).astype(np.float64)
    return bool(width.sum() <= LARGEST_FILL and width @ width <= LARGEST_OPERATIONS)


def sparse_lu(matrix: Any, **options: Any) -> Any:
    """Return SuperLU's factor of a square sparse matrix; the options are those of scipy's `splu`.

    Raises
    ------
    RuntimeError
        Where a pivot is exactly zero (SuperLU's own), or no order of the rows avoids one: SuperLU reads and writes
        outside its arrays there.

    Examples
    --------
    >>> sparse_lu(sp.csc_array([[0.0, 1.0], [2.0, 0.0]])).solve(np.array([3.0, 4.0]))
    array([2., 3.])
    >>> sparse_lu(sp.csc_array([[0.0, 1.0], [0.0, 2.0]]))
    Traceback (most recent call last):
    RuntimeError: no order of the rows puts a nonzero on each place of the diagonal
    """
    from scipy.sparse.linalg import splu

    matrix = sp.csc_array(matrix)
    if not (matrix.diagonal() != 0.0).all() and not _is_structurally_regular(matrix):
        raise RuntimeError("no order of the rows puts a nonzero on each place of the diagonal")
    return splu(matrix, **options)


def _is_structurally_regular(matrix: Any) -> bool:
    from scipy.sparse.csgraph import structural_rank

    pattern = sp.csr_array(matrix, copy=True)  # zeros are taken out in place
    pattern.eliminate_zeros()
    row_lengths = np.diff(pattern.indptr)
    return bool(row_lengths.all() and structural_rank(pattern) == row_lengths.size)


def diagonal_pivot_factor(matrix: Any) -> Any | None:
    """Return SuperLU's factor with pivots from the diagonal, in one order for rows and columns, or None if singular.

    That order is a preference: a pivot of 0 is exchanged; those who need it compare `perm_r` with `perm_c`.
    """
    try:
        return sparse_lu(
            matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True}
        )
    except RuntimeError:
        return None


def positive_pivot_factor(matrix: Any) -> Any | None:
    """Return the factor of a symmetric matrix where all pivots are positive and from the diagonal, else None."""
    factor = diagonal_pivot_factor(matrix)
    if factor is None or not np.array_equal(factor.perm_r, factor.perm_c):
        return None
    return factor if (factor.U.diagonal() > 0.0).all() else None
