"""Functions of the entries of an array or CSR array: row numbers, largest entries, scaling of rows and columns."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp

from .checks import AnyMatrix, Array, BoolVector, Vector, assemble_csr
from .kernels.floats import NEGLIGIBLE_DIAGONAL


def largest_in_rows(M: AnyMatrix, sizes: Vector | None = None) -> Vector:
    """Return the largest |entry| of each row, 0 for an empty row.

    `sizes`, shape (…, entries), replaces the |entries| of a CSR array.
    """
    if isinstance(M, np.ndarray):
        return np.asarray(np.maximum.reduce(np.abs(M), axis=1, initial=0.0), dtype=np.float64)
    sizes = np.abs(M.data) if sizes is None else sizes
    largest = np.zeros((*sizes.shape[:-1], M.shape[0]))
    filled = np.flatnonzero(np.diff(M.indptr))
    if filled.size:
        largest[..., filled] = np.maximum.reduceat(sizes, M.indptr[filled], axis=-1)
    return largest


def max_norm(x: Vector) -> float:
    """Return ‖x‖∞, 0 of no entries; a NaN stays."""
    return float(np.maximum.reduce(np.abs(x), axis=None, initial=0.0))


def all_finite(x: Vector) -> bool:
    """Return whether all entries are finite, in half of the time of numpy's functions for short vectors."""
    return x.dot(x) < np.inf or bool(np.logical_and.reduce(np.isfinite(x)))


def clip(x: Array, lower: Vector, upper: Vector) -> Vector:
    """Return mid(lower, upper, x), in half of the time of numpy's function for short vectors."""
    return np.minimum(np.maximum(x, lower), upper)


def or_one(sizes: Vector) -> Vector:
    """Return the sizes with 1 in place of 0."""
    return np.where(sizes > 0.0, sizes, 1.0)


def unbounded(lower: Vector, upper: Vector) -> BoolVector:
    """Return the mask of the unknowns without bounds, whose rows are equations."""
    return (lower == -np.inf) & (upper == np.inf)


def with_entries(M: AnyMatrix, entries: Vector) -> sp.csr_array:
    """Return the CSR array with these entries on the pattern of M."""
    return sp.csr_array((entries, M.indices, M.indptr), shape=M.shape)


def count_entries(matrix: AnyMatrix) -> int:
    """Return the number of nonzeros of an ndarray or a CSR array."""
    return int(np.count_nonzero(matrix) if isinstance(matrix, np.ndarray) else matrix.nnz)


def entries_of_rows(matrix: AnyMatrix) -> Any:
    """Return the number of nonzeros of each row; without its zeros if the matrix, or a stack of matrices, is dense."""
    is_dense = isinstance(matrix, np.ndarray)
    return np.add.reduce(matrix != 0.0, axis=-1) if is_dense else np.diff(matrix.indptr)


def largest_products(sizes: AnyMatrix, x: Vector) -> Vector:
    """Return max_j |m_ij| x_j of each row, x ≥ 0; `sizes` is |M|, of one problem or, dense, of a stack."""
    if isinstance(sizes, np.ndarray):
        return np.asarray((sizes * x[..., None, :]).max(-1, initial=0.0))
    return largest_in_rows(sizes, sizes.data * x[..., sizes.indices])


def residual_scales(diagonal: Vector, largest: Vector) -> Vector:
    """Return D of the scaled residual from the diagonal and the largest |entry| of each row, arrays of one shape."""
    # The product may underflow to 0, which no diagonal of 0 may pass.
    is_usable = (diagonal > 0.0) & (diagonal >= NEGLIGIBLE_DIAGONAL * largest)
    if np.logical_and.reduce(is_usable, None):
        return np.array(diagonal)
    return np.where(largest == 0.0, 1.0, np.where(is_usable, diagonal, largest))


IntVector = np.ndarray[Any, np.dtype[np.int64]]


def row_numbers(M: AnyMatrix) -> IntVector:
    """Return the row number of each stored entry of a CSR array, shape (nnz,)."""
    return np.repeat(np.arange(M.shape[0], dtype=M.indices.dtype), np.diff(M.indptr))


def entries_of_row(matrix: AnyMatrix, i: int) -> tuple[list[int], list[float]]:
    """Return the columns and the values of the entries of row i of a CSR array."""
    part = slice(matrix.indptr[i], matrix.indptr[i + 1])
    return matrix.indices[part].tolist(), matrix.data[part].tolist()


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
    return with_entries(M, times_power(M.data, row[row_numbers(M)] + column[M.indices]))


def scale_by(A: AnyMatrix, rows: Vector, columns: Vector) -> Any:
    """Return the array or CSR array with entries a_ij rows_i columns_j, multiplied in this order; A is canonical."""
    if not sp.issparse(A):
        return rows[:, np.newaxis] * A * columns
    data = A.data * rows[row_numbers(A)] * columns[A.indices]
    return assemble_csr(data, A.indices, A.indptr, A.shape)


def times_power(x: Vector, exponent: IntVector | None) -> Vector:
    """Return x_i 2^exponent_i, of the shape of x."""
    return x if exponent is None else np.asarray(np.ldexp(x, exponent))
