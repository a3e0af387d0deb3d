"""What a factorisation takes, predicted from counts of entries: which equations are worth putting into a program.

An equation that defines an unknown goes with it, for what it fills in of P: with D the entries of such equations, P
gets DᵀP D, which is full where equations are long and few. Left where they are they cost L their own entries.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse as sp

from ...core.matrix.structure import row_numbers
from .program_matrices import Indices

STEPS = 6  # numbers of entries that are tried as limits, each half of the one before


def worth_putting_in(D: sp.csr_array) -> Indices:
    """Return the rows of D that are put in where the program is to be solved with the fewest multiplications.

    All, none, or those with few entries.

    Examples
    --------
    Four residuals of two unknowns are put in, two of four are not; and of a long row and short ones these:

    >>> worth_putting_in(sp.csr_array(np.ones((4, 2)))), worth_putting_in(sp.csr_array(np.ones((2, 4))))
    (array([0, 1, 2, 3]), array([], dtype=int64))
    >>> worth_putting_in(sp.csr_array(np.vstack([np.ones((1, 9)), np.eye(9)])))
    array([1, 2, 3, 4, 5, 6, 7, 8, 9])
    """
    m, n = D.shape[0], np.count_nonzero(np.bincount(D.indices, minlength=D.shape[1]))
    if D.nnz == m * n:  # a full block
        return np.arange(m if n**3 <= 3 * n * m**2 + m**3 else 0)
    lengths, rows = np.diff(D.indptr), row_numbers(D)
    best, least = np.arange(0), _of_rows_left(rows, D.indices, D.shape)
    for limit in _limits(lengths):
        is_in = lengths <= limit
        if is_in.all():
            work = full_work(product_entries(rows, D.indices, D.shape))
        else:
            inside = is_in[rows]
            work = full_work(product_entries(rows[inside], D.indices[inside], D.shape))
            work += _of_rows_left(rows[~inside], D.indices[~inside], D.shape)
        if work <= least:
            best, least = np.flatnonzero(is_in), work
    return best


def _limits(counts: Any) -> list[int]:
    """Return some of the counts, each at most half of the one before, from the largest one on."""
    present, found = np.unique(counts), list[int]()
    while present.size and len(found) < STEPS:
        found.append(int(present[-1]))
        present = present[2 * present <= found[-1]]
    return found


def _of_rows_left(rows: Any, columns: Any, shape: tuple[int, int]) -> float:
    """Return the multiplications of eliminating the columns, each with the rows it has, and then what the rows are."""
    counts = np.bincount(columns, minlength=shape[1]).astype(np.float64)
    return 0.5 * float(counts @ counts) + full_work(product_entries(columns, rows, shape[::-1]))


def full_work(entries: float) -> float:
    """Return the multiplications that a symmetric matrix with so many entries takes, all in one block."""
    return float(entries * np.sqrt(entries)) / 6.0


def product_entries(rows: Any, columns: Any, shape: tuple[int, int]) -> float:
    """Return how many entries CᵀC has at the most, C with these entries: long columns, in a block, and short ones."""
    counts = np.bincount(columns, minlength=shape[1])
    lengths = np.bincount(rows, minlength=shape[0]).astype(np.float64)
    least = min(float(lengths @ lengths), float(np.count_nonzero(counts)) ** 2)
    for limit in _limits(counts)[1:]:
        long = np.bincount(rows[(counts > limit)[columns]], minlength=shape[0])
        short = lengths - long
        least = min(least, float(np.count_nonzero(counts > limit)) ** 2 + float(2.0 * long @ short + short @ short))
    return least
