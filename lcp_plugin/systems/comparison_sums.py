"""The comparison matrix ⟨M⟩ and its row sums: with a rigorous bound of the rounding error, and exact."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import numpy as np
import scipy.sparse as sp

from ..core.checks import FloatVector
from ..core.matrix import row_numbers
from ..core.rounding import compensated_product


def comparison_of(M: Any) -> sp.csr_array:
    """Return ⟨M⟩ for a CSR array, or for rows of an array whose first columns belong to these rows."""
    magnitudes = np.abs(M.data)
    signed = np.where(row_numbers(M) == M.indices, magnitudes, -magnitudes)
    return sp.csr_array((signed, M.indices, M.indptr), shape=M.shape)


def comparison_product(M: Any, v: FloatVector) -> tuple[FloatVector, FloatVector]:
    """Return (value, radius) with |⟨M⟩v − value| ≤ radius; ⟨M⟩ has |m_ii| on, −|m_ij| off the diagonal.

    Parameters
    ----------
    M : CSR array, shape (n, n)
    v : array, shape (n,)

    Returns
    -------
    value, radius : arrays, shape (n,)
        As for :func:`compensated_product`.

    Raises
    ------
    InvalidProblem
        If the shapes do not fit.

    Examples
    --------
    >>> import numpy as np
    >>> import scipy.sparse as sp
    >>> value, radius = comparison_product(sp.csr_array(np.array([[2.0, 1.0], [-3.0, 3.0]])), np.ones(2))
    >>> value, radius
    (array([1., 0.]), array([0., 0.]))
    """
    return compensated_product(comparison_of(M), v)


def exact_comparison_row(M: Any, v: FloatVector, row: int) -> Fraction:
    """Return (⟨M⟩v)_row without any rounding; M a CSR array, v finite."""
    total = Fraction(0)
    for k in range(M.indptr[row], M.indptr[row + 1]):
        column = int(M.indices[k])
        product = abs(Fraction(float(M.data[k]))) * Fraction(float(v[column]))
        total += product if column == row else -product
    return total
