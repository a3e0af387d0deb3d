"""A square matrix in canonical, read-only form, with its properties, each computed once, at first use."""

from __future__ import annotations

import threading
from collections.abc import Callable, Hashable
from functools import cached_property, update_wrapper
from typing import Any, Generic, TypeVar, TypeVarTuple

import numpy as np
import scipy.sparse as sp

from .checks import AnyMatrix, Vector, checked_matrix, freeze_csr, read_only
from .entries import largest_in_rows, residual_scales
from .kernels.floats import NEGLIGIBLE_DIAGONAL

T = TypeVar("T")

Ts = TypeVarTuple("Ts")


class fact(Generic[T, *Ts]):  # noqa: N801 - a decorator
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

    def __init__(self, compute: Callable[[Any, *Ts], T]) -> None:
        self._compute = np.errstate(all="ignore")(compute)  # an overflow shows in the value
        update_wrapper(self, compute)

    def __call__(self, matrix: Any, *args: *Ts) -> T:
        """Return the cached value; compute it at the first call."""
        key, facts = (self, *args), matrix._facts
        if key not in facts:
            owner = getattr(matrix, "matrix", matrix)  # of a problem
            with owner._lock:
                if key not in facts:
                    facts[key] = self._compute(matrix, *args)
        value: T = facts[key]
        return value

    def __reduce__(self) -> str:
        """Return the name under which pickles of facts find the function."""
        return self._compute.__qualname__

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

    def __init__(self, M: AnyMatrix) -> None:
        self.array, self.nonzeros = checked_matrix(M)
        self.n: int = self.array.shape[0]
        self.is_dense = isinstance(self.array, np.ndarray)
        self._facts: dict[Hashable, Any] = {}
        self._lock = threading.RLock()

    @cached_property
    def csr(self) -> sp.csr_array:
        """The matrix as canonical, read-only CSR, shape (n, n)."""
        return csr_of_dense(self.array) if self.is_dense else self.array

    def toarray(self) -> Vector:
        """Return M as an ndarray, shape (n, n), not copied if it is stored as an array."""
        return self.array if self.is_dense else self.array.toarray()

    @property
    @fact
    def diagonal(self) -> Vector:
        """The diagonal entries, shape (n,)."""
        return read_only(np.array(self.array.diagonal(), dtype=np.float64))

    @property
    @fact
    def residual_scale(self) -> Vector:
        """D of the scaled residual, shape (n,): the diagonal where it is not negligible, else the row's largest.

        d_i = m_ii where m_ii ≥ 2⁻²⁰ max_j |m_ij|, else max_j |m_ij|, and 1 for an empty row.
        """
        entries, diagonal = self.array if self.is_dense else self.array.data, self.diagonal
        least, most = (ends.reduce(entries, None, initial=0.0) for ends in (np.minimum, np.maximum))
        largest, smallest = max(most, -least), np.minimum.reduce(diagonal, initial=np.inf)
        if smallest > 0.0 and smallest >= NEGLIGIBLE_DIAGONAL * largest:
            return diagonal  # without a search in each row
        return read_only(residual_scales(diagonal, largest_in_rows(self.array)))

    @property
    @fact
    def row_largest(self) -> Vector:
        """max_j |m_ij| of each row, 1 for an empty row, shape (n,)."""
        row_largest = largest_in_rows(self.array)
        return read_only(np.where(row_largest == 0.0, 1.0, row_largest))

    def __reduce__(self) -> tuple[Any, ...]:
        """Return the matrix without cached values and without the lock; a copy is checked again."""
        return type(self), (self.array,)


def csr_of_dense(dense: Vector) -> sp.csr_array:
    """Return a dense matrix as CSR; its entries are used without a copy if none is zero."""
    n = len(dense)
    if np.count_nonzero(dense) < dense.size or not dense.flags.c_contiguous:
        return freeze_csr(sp.csr_array(dense))
    columns = np.tile(np.arange(n, dtype=np.int32), n)
    rows = np.arange(0, n * n + 1, n, dtype=np.int32) if n else np.zeros(1, np.int32)
    compressed = sp.csr_array((dense.reshape(-1), columns, rows), shape=dense.shape)
    compressed.has_sorted_indices = compressed.has_canonical_format = True
    return freeze_csr(compressed)
