"""A square matrix in canonical, read-only form; the decorator `fact` caches its properties."""

from __future__ import annotations

import threading
from collections.abc import Callable, Hashable
from functools import cached_property, update_wrapper
from typing import Any, Concatenate, Generic, ParamSpec, TypeVar

import numpy as np
import scipy.sparse as sp

from ..checks import FloatVector, checked_matrix, freeze_csr, read_only
from ..kernels.floats import NEGLIGIBLE_DIAGONAL

P = ParamSpec("P")
T = TypeVar("T")


class fact(Generic[P, T]):  # noqa: N801 - a decorator
    """Decorator of a function of a matrix or a problem (and hashable arguments): its value is cached in that object.

    Such a function may be in any module; the function itself is the key of the cache.

    Examples
    --------
    >>> @fact
    ... def trace(matrix: Matrix) -> float:
    ...     print("summed")
    ...     return float(matrix.diagonal.sum())
    >>> identity = Matrix([[1.0, 0.0], [0.0, 1.0]])
    >>> trace(identity), trace(identity)
    summed
    (2.0, 2.0)
    """

    def __init__(self, compute: Callable[Concatenate[Any, P], T]) -> None:
        self._compute = compute
        update_wrapper(self, compute)

    def __call__(self, matrix: Any, *args: P.args, **kwargs: P.kwargs) -> T:
        """Return the cached value; compute it at the first call."""
        key = (self, *args)
        try:
            value: T = matrix._facts[key]
        except KeyError:
            with matrix._lock:
                if key not in matrix._facts:
                    with np.errstate(all="ignore"):  # an overflow shows in the value
                        matrix._facts[key] = self._compute(matrix, *args, **kwargs)
                value = matrix._facts[key]
        return value

    def is_known(self, matrix: Matrix, *args: Hashable) -> bool:
        """Return whether the value is cached."""
        return (self, *args) in matrix._facts


class Matrix:
    """A real, finite, square matrix as canonical CSR, or as an ndarray where it is small and dense.

    Parameters
    ----------
    M : array or sparse array, shape (n, n)
        Matrix as for :class:`lcp_plugin.LCP`.

    Attributes
    ----------
    array : csr_array or ndarray, shape (n, n)
        The stored matrix: an ndarray if it is dense and small.
    n : int
        Number of rows.
    is_dense : bool
        True if it is stored as an ndarray.
    nonzeros : int
        Number of nonzero entries.

    Raises
    ------
    InvalidProblem
        If M is not such a matrix.

    Examples
    --------
    >>> Matrix([[4, 1e-12], [1, 0]]).residual_scale
    array([4., 1.])
    """

    def __init__(self, M: Any) -> None:
        self.array, self.nonzeros = checked_matrix(M)
        self.n: int = self.array.shape[0]
        self.is_dense = isinstance(self.array, np.ndarray)
        self._facts: dict[Hashable, Any] = {}
        self._lock = threading.RLock()

    @cached_property
    def csr(self) -> sp.csr_array:
        """The matrix as canonical, read-only CSR, shape (n, n)."""
        return csr_of_dense(self.array) if self.is_dense else self.array

    def toarray(self) -> FloatVector:
        """Return M as an ndarray, shape (n, n), not copied if it is stored as one."""
        return self.array if self.is_dense else self.array.toarray()  # type: ignore[no-any-return]

    @property
    @fact
    def diagonal(self) -> FloatVector:
        """The diagonal entries, shape (n,)."""
        return read_only(np.array(self.array.diagonal(), dtype=np.float64))

    @property
    @fact
    def residual_scale(self) -> FloatVector:
        """D of the scaled residual, shape (n,): the diagonal where it is not negligible, else the row's largest.

        d_i = m_ii where m_ii ≥ 2⁻²⁰ max_j |m_ij|, else max_j |m_ij|, and 1 for an empty row.
        """
        entries, diagonal = self.array if self.is_dense else self.array.data, self.diagonal
        largest = max(entries.max(initial=0.0), -entries.min(initial=0.0))
        smallest = diagonal.min(initial=np.inf)
        if smallest > 0.0 and smallest >= NEGLIGIBLE_DIAGONAL * largest:
            return diagonal  # without a search in each row
        return read_only(residual_scales(diagonal, largest_in_rows(self.array)))

    @property
    @fact
    def row_largest(self) -> FloatVector:
        """max_j |m_ij| of each row, 1 for an empty one, shape (n,)."""
        row_largest = largest_in_rows(self.array)
        return read_only(np.where(row_largest == 0.0, 1.0, row_largest))

    @property
    @fact
    def csc(self) -> sp.csc_array:
        """The matrix by columns, shape (n, n)."""
        return sp.csc_array(self.csr)

    def __reduce__(self) -> tuple[Any, ...]:
        """Return the matrix without cached values and without the lock; a copy is checked again."""
        return type(self), (self.array,)


def csr_of_dense(dense: FloatVector) -> sp.csr_array:
    """Return a dense matrix as CSR; its entries are used without a copy if none is zero."""
    n = len(dense)
    if np.count_nonzero(dense) < dense.size or not dense.flags.c_contiguous:
        return freeze_csr(sp.csr_array(dense))
    columns = np.tile(np.arange(n, dtype=np.int32), n)
    rows = np.arange(0, n * n + 1, n, dtype=np.int32) if n else np.zeros(1, np.int32)
    compressed = sp.csr_array((dense.reshape(-1), columns, rows), shape=dense.shape)
    compressed.has_sorted_indices = compressed.has_canonical_format = True
    return freeze_csr(compressed)


def largest_in_rows(M: Any, sizes: FloatVector | None = None) -> FloatVector:
    """Return the largest |entry| of each row, 0 for an empty row.

    `sizes`, shape (…, entries), replaces the |entries| of a CSR array.
    """
    if not sp.issparse(M):
        return np.asarray(np.abs(M).max(axis=1, initial=0.0), dtype=np.float64)
    sizes = np.abs(M.data) if sizes is None else sizes
    largest = np.zeros((*sizes.shape[:-1], M.shape[0]))
    filled = np.flatnonzero(np.diff(M.indptr))
    if filled.size:
        largest[..., filled] = np.maximum.reduceat(sizes, M.indptr[filled], axis=-1)
    return largest


def largest_products(sizes: Any, x: FloatVector) -> FloatVector:
    """Return max_j |m_ij| x_j of each row, x ≥ 0; `sizes` is |M|, of one problem or, dense, of a stack."""
    if sp.issparse(sizes):
        return largest_in_rows(sizes, sizes.data * x[..., sizes.indices])
    return np.asarray((sizes * x[..., None, :]).max(-1, initial=0.0))


def residual_scales(diagonal: FloatVector, largest: FloatVector) -> FloatVector:
    """Return D of the scaled residual from the diagonal and the largest |entry| of each row, arrays of one shape."""
    # The product may underflow to 0, which no diagonal of 0 may pass.
    is_usable = (diagonal > 0.0) & (diagonal >= NEGLIGIBLE_DIAGONAL * largest)
    return np.where(largest == 0.0, 1.0, np.where(is_usable, diagonal, largest))
