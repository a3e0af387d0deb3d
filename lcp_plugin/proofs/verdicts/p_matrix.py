"""Are all principal minors positive? A recursion over Schur complements in integers.

A is a P-matrix exactly if a₁₁ > 0 and both A without its first row and column and the Schur complement of a₁₁ are.

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
from ...core.kernels.floats import UNIT
from ...core.matrix.structure import row_numbers
from ..exact.linear_systems import exact_rows, has_positive_minors, shortened

LARGEST_SIZE = 16  # a third of a second; the time doubles with each row
MOST_BITS = 160  # of an entry, beyond 10 rows


def is_p_matrix_by_recursion(M: Any) -> bool | None:
    """Return whether all principal minors are positive, proven; None if the numbers are too long.

    Parameters
    ----------
    M : CSR array, shape (n, n)
        n ≤ 16; the time doubles with each row.

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
    columns = [shortened(column) for column in zip(*exact_rows(M), strict=True)]
    rows = [list(row) for row in zip(*columns, strict=True)]
    bits = max((entry.bit_length() for row in rows for entry in row), default=0)
    return None if len(rows) > 10 and bits > MOST_BITS else has_positive_minors(rows)


def nonpositive_pair(M: Any) -> tuple[int, int] | None:
    """Return i < j with m_ii m_jj − m_ij m_ji ≤ 0, proven, or None if no such pair was found.

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
