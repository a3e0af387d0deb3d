"""Are all principal minors positive? A recursion over Schur complements, each with a bound of its rounding errors.

A is a P-matrix exactly if a₁₁ > 0 and both A without its first row and column and the Schur complement of a₁₁ are.
The recursion goes breadth first: level k holds 2ᵏ matrices of size n − k in one array. Where the bound hides the sign
of a pivot, what follows from it is decided in integers, as far as that is affordable.

References
----------
M. J. Tsatsomeros, L. Li, *A recursive test for P-matrices*, BIT 40 (2000), doi:10.1023/A:1022367507760.
"""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import numpy as np
import scipy.sparse as sp

from ...core.checks import FloatVector
from ...core.kernels.floats import TINY, UNIT
from ...core.matrix.scaling import scaled
from ...core.matrix.structure import row_numbers
from ...core.rounding import lower_end, upper_end
from ...systems.equilibration import scaling_exponents
from ..exact.linear_systems import Rows, eliminated, exact_rows, has_positive_minors

LARGEST_SIZE = 20
SCALED_TO_NOTHING = (
    2.0**-900
)  # more than what an entry loses that leaves the range when it is scaled
OUTWARD = 1.0 + 2.0**-48  # more than the rounding of a bound
LARGEST_WORK = 2.5e12  # of exact arithmetic, in products of bits: some seconds, and enough for any matrix of 10 rows
ROOT = 1

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
    undecided = _breadth_first(*_equilibrated(M))
    if undecided is None:
        return False
    return _settled(exact_rows(M), undecided) if undecided else True


def _settled(rows: Rows, undecided: list[int]) -> bool | None:
    """Return whether all minors below the undecided nodes are positive, in integers; None where that costs too much."""
    n, bits = len(rows), max(entry.bit_length() for row in rows for entry in row)

    def work(node: int) -> float:
        return (n**3 + 4.0 * 2.0 ** (n - node.bit_length() + 1)) * (n * float(bits)) ** 2

    if work(ROOT) <= min(LARGEST_WORK, sum(map(work, undecided))):
        undecided = [ROOT]
    total = 0.0
    for node in sorted(undecided, reverse=True):  # the deepest first: they are the cheapest
        level = node.bit_length() - 1
        total += work(node)
        if total > LARGEST_WORK:
            return None
        kept = [i for i in range(n) if i >= level or node >> (level - 1 - i) & 1]
        matrix, before = [[rows[i][j] for j in kept] for i in kept], 1
        while len(matrix) > n - level:
            matrix, before = eliminated(matrix, before), matrix[0][0]
        if not has_positive_minors(matrix, before):
            return False
    return True


def nonpositive_pair(M: Any) -> tuple[int, int] | None:
    """Return i < j with m_ii m_jj − m_ij m_ji ≤ 0, proven, or None where no such pair was found.

    Parameters
    ----------
    M : CSR array, shape (n, n)
        With a positive diagonal.
    """
    diagonal: FloatVector = M.diagonal()
    even = sp.csr_array((M.data / diagonal[row_numbers(M)], M.indices, M.indptr), shape=M.shape)
    ratios = sp.coo_array(sp.triu(even.multiply(even.T.tocsr()), 1))
    suspicious = np.flatnonzero(ratios.data > 1.0 - 8.0 * UNIT)
    for k in suspicious[np.argsort(-ratios.data[suspicious], kind="stable")][
        :2_000
    ]:  # the likeliest
        i, j = int(ratios.row[k]), int(ratios.col[k])
        exact = [Fraction(float(M[place])) for place in ((i, i), (j, j), (i, j), (j, i))]
        if exact[0] * exact[1] - exact[2] * exact[3] <= 0:
            return i, j
    return None


def _equilibrated(M: Any) -> tuple[FloatArray, FloatArray]:
    """Return M scaled by powers of two, shape (1, n, n), and bounds of what that changed."""
    values = scaled(M, scaling_exponents(M, is_symmetric=False)).toarray()
    stored = M.toarray() != 0.0
    lost = stored & (np.abs(values) < SCALED_TO_NOTHING)
    return values[None], np.where(lost, SCALED_TO_NOTHING, 0.0)[None]


def _breadth_first(values: FloatArray, bounds: FloatArray) -> list[int] | None:
    """Return the nodes whose pivot has no proven sign, or None where a pivot is proven not to be positive.

    A node is a 1 and a digit for each row before its own: 1 where that row is eliminated, 0 where it is left out.
    """
    nodes, undecided = np.array([ROOT], dtype=np.int64), []
    while values.shape[1]:
        pivot, uncertainty = values[:, 0, 0], bounds[:, 0, 0]
        # A nonpositive pivot is a nonpositive principal minor: all pivots before it are surely positive.
        if (upper_end(pivot, uncertainty) <= 0.0).any():
            return None
        sure = lower_end(pivot, uncertainty) > 0.0
        undecided += nodes[~sure].tolist()
        values, bounds, nodes = values[sure], bounds[sure], nodes[sure]
        complement, complement_bounds = _schur(values, bounds)
        values = np.concatenate([values[:, 1:, 1:], complement])
        bounds = np.concatenate([bounds[:, 1:, 1:], complement_bounds])
        nodes = np.concatenate([2 * nodes, 2 * nodes + 1])
    return undecided


def _schur(values: FloatArray, bounds: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the Schur complements of the first pivots and entrywise bounds of their errors, underflow included."""
    pivot, pivot_bound = values[:, :1, :1], bounds[:, :1, :1]
    column, column_bound = values[:, 1:, :1], bounds[:, 1:, :1]
    row, row_bound = values[:, :1, 1:], bounds[:, :1, 1:]
    product = (column / pivot) * row
    result = values[:, 1:, 1:] - product
    lost = TINY * (np.abs(row) + 1.0)  # a quotient that underflows may meet a large factor
    size = np.abs(product) + lost
    inherited = (
        np.abs(column) * row_bound
        + column_bound * (np.abs(row) + row_bound)
        + size * pivot_bound * OUTWARD
        + 4.0 * TINY
    ) / (pivot - pivot_bound)
    error = (
        bounds[:, 1:, 1:]
        + inherited * OUTWARD
        + (4.0 * size + 2.0 * np.abs(result)) * UNIT
        + lost
        + 8.0 * TINY
    )
    return result, error * OUTWARD
