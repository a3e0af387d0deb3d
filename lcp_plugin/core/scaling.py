"""Row and column scaling of an array or CSR array, by exact powers of two or by any factors."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp

from .checks import AnyMatrix, Vector, assemble_csr
from .entries import IntVector, row_numbers


class Exponents(NamedTuple):
    """One exponent per row and per column: the scaled matrix has entries m_ij 2^(row_i + column_j)."""

    row: IntVector
    column: IntVector


def scale_matrix(M: AnyMatrix, exponents: Exponents | None) -> Any:
    """Return the array or CSR array with entries m_ij 2^(row_i + column_j)."""
    if exponents is None:
        return M
    row, column = (side.astype(np.int32) for side in exponents)
    if not sp.issparse(M):
        return times_power(M, row[:, None] + column)
    data = times_power(M.data, row[row_numbers(M)] + column[M.indices])
    return sp.csr_array((data, M.indices, M.indptr), shape=M.shape)


def scale_by(A: AnyMatrix, rows: Vector, columns: Vector) -> Any:
    """Return the array or CSR array with entries a_ij rows_i columns_j, multiplied in this order; A is canonical."""
    if not sp.issparse(A):
        return rows[:, np.newaxis] * A * columns
    data = A.data * rows[row_numbers(A)] * columns[A.indices]
    return assemble_csr(data, A.indices, A.indptr, A.shape)


def times_power(x: Vector, exponent: IntVector | None) -> Vector:
    """Return x_i 2^exponent_i, of the shape of x."""
    return x if exponent is None else np.asarray(np.ldexp(x, exponent))
