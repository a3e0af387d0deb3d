"""Structure of a matrix: what its pattern and its row sums tell.

Its parts are the connected components of its graph, between which no entry stands.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np
import scipy.sparse as sp

from ..checks import FloatVector, read_only
from ..communicator.alone import Communicator
from ..exact.rounding import comparison_product, exact_comparison_row, lower_end, upper_end
from .matrix import Matrix, fact, largest_in_rows

IntVector = np.ndarray[Any, np.dtype[np.int64]]


def compressed_rows(M: Any) -> tuple[Any, Any, Any]:
    """Return indptr, indices and data of a canonical CSR array, read-only; of an ndarray all entries, zeros as well."""
    if sp.issparse(M):
        return read_only(M.indptr), read_only(M.indices), read_only(M.data)
    m, n = M.shape
    starts, columns = np.arange(m + 1, dtype=np.int32) * np.int32(n), np.arange(n, dtype=np.int32)
    return read_only(starts), read_only(np.tile(columns, m)), read_only(np.ascontiguousarray(M).reshape(-1))


def row_numbers(M: Any) -> IntVector:
    """Return the row number of each stored entry of a CSR array, shape (nnz,)."""
    return np.repeat(np.arange(M.shape[0], dtype=M.indices.dtype), np.diff(M.indptr))


def outer_on_pattern(matrix: Matrix, left: FloatVector, right: FloatVector) -> sp.csr_array:
    """Return left_i right_j in the places of M's entries; on ranks those of the own rows, columns of all.

    Parameters
    ----------
    left, right : array, shape (own,)

    Examples
    --------
    >>> outer_on_pattern(Matrix([[4.0, 1.0], [0.0, 4.0]]), np.array([2.0, 3.0]), np.array([1.0, 5.0])).toarray()
    array([[ 2., 10.],
           [ 0., 15.]])
    """
    rows, communicator = matrix.csr_rows, matrix.communicator
    with np.errstate(over="ignore"):
        data = left[row_numbers(rows)] * matrix.whole(right)[rows.indices]
    if communicator.is_alone:
        return sp.csr_array((data, rows.indices, rows.indptr), shape=rows.shape)
    columns = np.concatenate([np.arange(communicator.first, communicator.first + matrix.own), communicator.ghosts])
    outer = sp.csr_array((data, columns[rows.indices], rows.indptr.copy()), shape=(matrix.own, matrix.n))
    outer.sort_indices()
    return outer


def strong_blocks(M: Any) -> tuple[int, IntVector]:
    """Return the number of strongly connected blocks of M's graph and the block of each row, shape (n,)."""
    from scipy.sparse.csgraph import connected_components

    # The routine drops explicit zeros of floats; only the pattern counts.
    pattern = sp.csr_array((np.ones(M.nnz), M.indices, M.indptr), shape=M.shape)
    count, labels = connected_components(pattern, directed=True, connection="strong")
    return int(count), labels.astype(np.int64)


@fact
def diagonal_blocks(matrix: Matrix) -> tuple[int, IntVector]:
    """Return the same of a Matrix, read-only."""
    count, labels = strong_blocks(matrix.csr)
    return count, read_only(labels)


@fact
def components(matrix: Matrix) -> int:
    """Return the number of connected components of the graph of M."""
    found = parts(matrix)
    return min(matrix.n, 1) if found is None else found.total


def block_rows(labels: IntVector, count: int) -> list[IntVector]:
    """Return the row numbers of each block, in order of the labels."""
    order = np.argsort(labels, kind="stable")
    return np.split(order, np.cumsum(np.bincount(labels, minlength=count))[:-1])


def within_blocks(M: Any, labels: IntVector) -> Any:
    """Return a CSR array without the entries that couple rows of different blocks."""
    within = labels[row_numbers(M)] == labels[M.indices]
    return sp.csr_array((np.where(within, M.data, 0.0), M.indices, M.indptr), shape=M.shape)


@fact
def triangular_form(matrix: Matrix) -> str | None:
    """"diagonal", "lower", "upper", or None."""
    M = matrix.csr
    rows = row_numbers(M)
    if (rows == M.indices).all():
        return "diagonal"
    if (rows >= M.indices).all():
        return "lower"
    return "upper" if (rows <= M.indices).all() else None


@fact
def row_excess_signs(matrix: Matrix) -> IntVector:
    """Exact signs of |m_ii| − Σ_j≠i |m_ij|, shape (n,)."""
    M, ones = matrix.csr, np.ones(matrix.n)
    value, radius = comparison_product(M, ones)
    signs = np.where(lower_end(value, radius) > 0.0, 1, np.where(upper_end(value, radius) < 0.0, -1, 0))
    for row in np.flatnonzero((signs == 0) & (radius > 0.0)):
        exact = exact_comparison_row(M, ones, int(row))
        signs[row] = (exact > 0) - (exact < 0)
    return read_only(signs.astype(np.int64))


@fact
def scale_spread(matrix: Matrix) -> Mapping[str, float]:
    """Decades between largest and smallest nonzero magnitude: entries, rows, columns, diagonal."""
    M = matrix.csr
    magnitudes = np.abs(M.data)
    row_largest, column_largest = largest_in_rows(M), largest_in_rows(sp.csr_array(M.T))
    sizes = {
        "entries": magnitudes, "rows": row_largest, "columns": column_largest, "diagonal": np.abs(M.diagonal())
    }
    return MappingProxyType({name: _decades(values) for name, values in sizes.items()})


def _decades(values: FloatVector) -> float:
    nonzero = values[values > 0.0]
    return float(np.log10(nonzero.max()) - np.log10(nonzero.min())) if nonzero.size else 0.0


@fact
def bandwidth(matrix: Matrix) -> tuple[int, int] | None:
    """Return the numbers of sub- and superdiagonals of a sparse M, None where M is kept dense."""
    M = matrix.array
    if not sp.issparse(M):
        return None
    offsets = M.indices.astype(np.int64) - row_numbers(M)
    return (max(0, -int(offsets.min())), max(0, int(offsets.max()))) if offsets.size else (0, 0)


BLOCK = 2**14  # rows


@dataclass(frozen=True, eq=False)
class Parts:
    """Which part each of the own rows belongs to, where a matrix has several.

    Attributes
    ----------
    labels : array of int, shape (own,)
        Numbers of parts, from 0 on; on ranks the parts that several of them share come first, the same on all.
    count : int
        How many parts there are; on a rank those that it counts.
    total : int
        How many there are in all.
    shared : int
        How many of them lie on several ranks.
    communicator : Communicator
    """

    labels: IntVector
    count: int
    total: int
    shared: int
    communicator: Communicator

    def largest(self, values: FloatVector) -> FloatVector:
        """Return the largest of the values ≥ 0 of each part's rows, shape (count,); a NaN stays."""
        found = np.zeros(self.count)
        np.maximum.at(found, self.labels, values)
        if self.shared:
            found[: self.shared] = self.communicator.all_largest(*found[: self.shared].tolist())
        return found


@fact
def parts(matrix: Matrix) -> Parts | None:
    """Return the parts of M; None where all rows belong together, as they mostly do.

    Examples
    --------
    >>> parts(Matrix([[2.0, 0.0, 1.0], [0.0, 3.0, 0.0], [0.0, 0.0, 2.0]])).labels
    array([0, 1, 0])
    >>> parts(Matrix([[2.0, 1.0], [0.0, 2.0]])) is None
    True
    """
    if not matrix.communicator.is_alone:
        return _parts_on_ranks(matrix)
    if _is_seen_connected(matrix):
        return None
    labels, count = _local_parts(matrix)
    return Parts(read_only(labels), count, count, 0, matrix.communicator) if count > 1 else None


def _is_seen_connected(matrix: Matrix) -> bool:
    """Return whether every row but the first meets one before it, by its first entry: all lead to row 0 then."""
    if matrix.n < 2:
        return True
    if matrix.is_dense and bool(matrix.rows[0].all()):
        return True
    if matrix.is_dense:  # entries left of the diagonal, or mirrored above it
        nonzero = matrix.rows != 0.0
        return bool(np.tril(nonzero | nonzero.T, -1).any(axis=1)[1:].all())
    starts, indices = matrix.csr_rows.indptr, matrix.csr_rows.indices
    if starts[-1] == 0:
        return False
    for first in range(1, matrix.n, BLOCK):
        last = min(first + BLOCK, matrix.n)
        begin, end = starts[first:last], starts[first + 1 : last + 1]
        if not (end > begin).all() or not (indices[begin] < np.arange(first, last, dtype=indices.dtype)).all():
            return False
    return True


def _local_parts(matrix: Matrix) -> tuple[IntVector, int]:
    """Return the part of every unknown that the own rows meet, by these rows alone, and how many there are."""
    from ..kernels.rows import join  # numba, which `import lcp_plugin` must not load

    rows = matrix.csr_rows
    first = np.empty(matrix.width, np.int64)
    join(rows.indptr, rows.indices, first)
    roots, labels = np.unique(first, return_inverse=True)
    return labels.astype(np.int64).reshape(-1), roots.size


def _parts_on_ranks(matrix: Matrix) -> Parts | None:
    """Return the parts of rows over several ranks: those of each rank, joined where one of its unknowns is another's.

    What a rank calls a part is told to the others by the values of its unknowns there; the parts that meet are few.
    """
    communicator, own = matrix.communicator, matrix.own
    local, count = _local_parts(matrix)
    before, total = communicator.places(count)
    theirs = matrix.whole((local[:own] + before).astype(np.float64))[own:].astype(np.int64)
    met = np.unique(np.stack([local[own:] + before, theirs], axis=1), axis=0)
    pairs = communicator.everybodys(met)
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    pattern = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(total, total))
    joined_count, joined = connected_components(pattern, directed=False)
    if joined_count <= 1:
        return None
    shared = np.unique(joined[pairs[pairs[:, 0] != pairs[:, 1]].ravel()])
    mine = joined[local[:own] + before]
    order = np.concatenate([shared, np.setdiff1d(mine, shared)])
    number = np.full(joined_count, -1)
    number[order] = np.arange(order.size)
    return Parts(read_only(number[mine]), order.size, int(joined_count), shared.size, communicator)
