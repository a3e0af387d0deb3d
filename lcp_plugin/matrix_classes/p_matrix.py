"""Are all principal minors positive? A recursion over Schur complements, each with a bound of its rounding errors.

A is a P-matrix exactly if a₁₁ > 0 and both A without its first row and column and the Schur complement of a₁₁ are.
The recursion goes breadth first: level k holds 2ᵏ matrices of size n − k in one array.

References
----------
M. J. Tsatsomeros, L. Li, *A recursive test for P-matrices*, BIT 40 (2000), doi:10.1023/A:1022367507760.
"""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import numpy as np

from ..problem import FloatVector
from ..rounding import UNIT
from .equilibration import row_numbers, scaled, scaling_exponents
from .exact import EXACT_SIZE, exact_rows, has_positive_minors

LARGEST_SIZE = 20
SCALED_TO_NOTHING = 2.0**-900  # more than what an entry loses that leaves the range when it is scaled
OUTWARD = 1.0 + 2.0**-48  # more than the rounding of a bound
EXACT_PAIRS = 2_000

FloatArray = np.ndarray[Any, np.dtype[np.float64]]


def is_p_matrix_by_recursion(M: Any) -> bool | None:
    """Return whether all principal minors are positive: True and False are proven, None where rounding hides it.

    Parameters
    ----------
    M : CSR array, shape (n, n)
        n ≤ 20; the time doubles with each row.

    Examples
    --------
    >>> import scipy.sparse as sp
    >>> is_p_matrix_by_recursion(sp.csr_array(np.array([[1.0, -3.0], [3.0, 0.5]])))
    True
    >>> is_p_matrix_by_recursion(sp.csr_array(np.array([[1.0, 2.0], [2.0, 4.0]])))
    False
    """
    if not (M.diagonal() > 0.0).all():
        return False
    values, bounds = _equilibrated(M)
    verdict = _breadth_first(values, bounds)
    if verdict is None and M.shape[0] <= EXACT_SIZE:
        return has_positive_minors(exact_rows(M))
    return verdict


def nonpositive_pair(M: Any) -> tuple[int, int] | None:
    """Return i < j with m_ii m_jj − m_ij m_ji ≤ 0, proven, or None where no such pair was found.

    Parameters
    ----------
    M : CSR array, shape (n, n)
        With a positive diagonal.
    """
    transposed = M.T.tocsr()
    pairs = _signed_pairs(M, transposed)
    if pairs is None:
        return None
    rows, columns, ours, theirs = pairs
    diagonal: FloatVector = M.diagonal()
    with np.errstate(all="ignore"):
        # Quotients by the diagonal: products could leave the range.
        ratio = (ours / diagonal[rows]) * (theirs / diagonal[columns])
    suspicious = np.flatnonzero(ratio > 1.0 - 8.0 * UNIT)
    for k in suspicious[np.argsort(-ratio[suspicious], kind="stable")][:EXACT_PAIRS]:
        i, j = int(rows[k]), int(columns[k])
        exact = [Fraction(float(number)) for number in (diagonal[i], diagonal[j], ours[k], theirs[k])]
        if exact[0] * exact[1] - exact[2] * exact[3] <= 0:
            return i, j
    return None


def _signed_pairs(M: Any, transposed: Any) -> tuple[Any, Any, FloatVector, FloatVector] | None:
    """Return rows, columns, m_ij, m_ji of the pairs i < j with m_ij m_ji > 0, or None where there is none."""
    same = np.array_equal(M.indptr, transposed.indptr) and np.array_equal(M.indices, transposed.indices)
    if same:
        rows, columns, ours, theirs = row_numbers(M), M.indices, M.data, transposed.data
    else:
        pattern = (abs(M) > 0).multiply(abs(transposed) > 0).tocoo()
        rows, columns = pattern.row, pattern.col
        if rows.size == 0:
            return None
        ours, theirs = np.asarray(M[rows, columns]).ravel(), np.asarray(M[columns, rows]).ravel()
    upper = (rows < columns) & ((ours > 0.0) == (theirs > 0.0)) & (ours != 0.0) & (theirs != 0.0)
    return (rows[upper], columns[upper], ours[upper], theirs[upper]) if upper.any() else None


def _equilibrated(M: Any) -> tuple[FloatArray, FloatArray]:
    """Return M scaled by powers of two, shape (1, n, n), and bounds of what that changed."""
    rows = row_numbers(M)
    exponents = scaling_exponents(M, rows, is_symmetric=False)
    values = scaled(M, rows, exponents).toarray()
    stored = M.toarray() != 0.0
    lost = stored & (np.abs(values) < SCALED_TO_NOTHING)
    return values[None], np.where(lost, SCALED_TO_NOTHING, 0.0)[None]


def _breadth_first(values: FloatArray, bounds: FloatArray) -> bool | None:
    decided = True
    with np.errstate(all="ignore"):
        while values.shape[1]:
            pivot, uncertainty = values[:, 0, 0], bounds[:, 0, 0]
            # A nonpositive pivot is a nonpositive principal minor if all pivots before it are surely positive.
            if (pivot <= -uncertainty * OUTWARD).any():
                return False
            sure = pivot > uncertainty * OUTWARD
            if not sure.all():
                decided = False
                values, bounds, pivot = values[sure], bounds[sure], pivot[sure]
            rest, rest_bounds = values[:, 1:, 1:], bounds[:, 1:, 1:]
            complement, complement_bounds = _schur(values, bounds)
            values = np.concatenate([rest, complement])
            bounds = np.concatenate([rest_bounds, complement_bounds])
    return True if decided else None


def _schur(values: FloatArray, bounds: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the Schur complements of the first pivots and entrywise bounds of their errors."""
    pivot, pivot_bound = values[:, :1, :1], bounds[:, :1, :1]
    column, column_bound = values[:, 1:, :1], bounds[:, 1:, :1]
    row, row_bound = values[:, :1, 1:], bounds[:, :1, 1:]
    product = (column / pivot) * row
    result = values[:, 1:, 1:] - product
    size = np.abs(product)
    inherited = (
        np.abs(column) * row_bound + column_bound * (np.abs(row) + row_bound) + size * pivot_bound * OUTWARD
    ) / (pivot - pivot_bound)
    error = bounds[:, 1:, 1:] + inherited * OUTWARD + (4.0 * size + 2.0 * np.abs(result)) * UNIT + SCALED_TO_NOTHING
    return result, error * OUTWARD
