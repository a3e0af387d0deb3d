"""Reading M, q, lower and upper from a file in PETSc's binary format, each rank its own part.

PETSc's own reader stops one rank alone at a damaged file, and does not check column indices; so the file is read here.
It holds big-endian numbers: for a matrix 1211216, rows, columns, nonzeros, the length of each row, the columns, the
values; for a vector 1211214, its length, the values. Whole numbers have 32 or 64 bits, as the PETSc that wrote them.

References
----------
PETSc users manual, *MatLoad* and *VecLoad*, https://petsc.org/release/manualpages/Mat/MatLoad/.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import scipy.sparse as sp
from mpi4py import MPI
from numpy.typing import NDArray

from ..checks import FloatVector
from ..errors import UnreadableFile
from ..peers.ranks.collective import from_first, together
from .files import INFINITE_BOUND, VECTORS
from .own_rows import equal_share

if TYPE_CHECKING:
    from .lcp import LCP

MATRIX, VECTOR = 1211216, 1211214
VALUE = np.dtype(">f8")
TOO_MANY = 2**31 - 1  # what stands for a number of nonzeros that 32 bits cannot hold
WANTED = "M as a sparse matrix (AIJ), q, and if wanted lower and upper, one after the other"


class Contents(NamedTuple):
    """Where everything stands in the file, in bytes."""

    path: Path
    whole_number: np.dtype[Any]
    n: int
    nonzeros: int
    lengths: int
    columns: int
    vectors: tuple[int, ...]


def load_binary(kind: type[LCP], path: Path, comm: MPI.Comm) -> LCP:
    """Return the problem of the file; all ranks call. A bound of 1e20 or more in absolute value means ∞.

    Raises
    ------
    UnreadableFile, InvalidProblem
        On every rank, where the file is damaged or holds something else.
    """
    contents = from_first(comm, lambda: _contents(path))
    first, last = equal_share(contents.n, comm.size, comm.rank)
    lengths = together(comm, lambda: _own_lengths(contents, first, last))
    counts = comm.allgather(int(lengths.sum()))
    if sum(counts) != contents.nonzeros:
        raise UnreadableFile(f"{path}: the rows have {sum(counts)} entries, its head says {contents.nonzeros}")
    begin = sum(counts[: comm.rank])
    rows = together(comm, lambda: _own_rows(contents, lengths, begin))
    q, *bounds = together(
        comm, lambda: [_numbers(path, VALUE, at + first * VALUE.itemsize, last - first) for at in contents.vectors]
    )
    for bound in bounds:
        is_none = np.abs(bound) >= INFINITE_BOUND
        bound[is_none] = np.copysign(np.inf, bound[is_none])
    return kind.from_rows(comm, rows, q, *bounds, first_row=first)


def _contents(path: Path) -> Contents:
    """Read the heads, and check that everything they announce has its place in the file."""
    size = path.stat().st_size
    whole_number = next((kind for kind in map(np.dtype, (">i4", ">i8")) if _head(path, kind, 0, 1) == (MATRIX,)), None)
    if whole_number is None:
        raise UnreadableFile(f"{path} is no PETSc binary file that begins with a matrix; write {WANTED}")
    wide = whole_number.itemsize
    _, n, columns, nonzeros = _head(path, whole_number, 0, 4) or (0, -1, -1, -1)
    if not 0 <= n == columns or nonzeros < 0:
        raise UnreadableFile(
            f"{path} begins with a matrix of {n} rows, {columns} columns, {nonzeros} entries (−1: stored dense); "
            f"write {WANTED}"
        )
    lengths = 4 * wide
    if wide == 4 and nonzeros == TOO_MANY:
        nonzeros = int(_numbers(path, whole_number, lengths, n).sum(dtype=np.int64))
    vectors: list[int] = []
    at = lengths + n * wide + nonzeros * (wide + 8)
    while at < size and len(vectors) < len(VECTORS):
        if _head(path, whole_number, at, 2) != (VECTOR, n):
            raise UnreadableFile(f"{path}: behind M must stand vectors of length {n}; write {WANTED}")
        vectors.append(at + 2 * wide)
        at = vectors[-1] + 8 * n
    if at != size or not vectors:
        raise UnreadableFile(f"{path} has {size} bytes, but its heads announce {at}; it must hold {WANTED}")
    return Contents(path, whole_number, n, nonzeros, lengths, lengths + n * wide, tuple(vectors))


def _head(path: Path, kind: np.dtype[Any], at: int, count: int) -> tuple[int, ...]:
    """Return so many whole numbers, or nothing where the file ends before."""
    found = np.fromfile(path, kind, count, offset=at)
    return tuple(map(int, found)) if found.size == count else ()


def _numbers(path: Path, kind: np.dtype[Any], at: int, count: int) -> NDArray[Any]:
    found = np.fromfile(path, kind, count, offset=at)
    if found.size != count:
        raise UnreadableFile(f"{path} ends too early: {found.size} of {count} numbers at byte {at}; write it again")
    return found.astype(kind.newbyteorder("="))


def _own_lengths(contents: Contents, first: int, last: int) -> NDArray[Any]:
    kind = contents.whole_number
    lengths = _numbers(contents.path, kind, contents.lengths + first * kind.itemsize, last - first).astype(np.int64)
    if lengths.size and not 0 <= lengths.min() <= lengths.max() <= contents.n:
        raise UnreadableFile(f"{contents.path}: a row has {lengths.min()} or {lengths.max()} entries; it is damaged")
    return lengths


def _own_rows(contents: Contents, lengths: NDArray[Any], begin: int) -> sp.csr_array:
    kind, count = contents.whole_number, int(lengths.sum())
    columns = _numbers(contents.path, kind, contents.columns + begin * kind.itemsize, count)
    values: FloatVector = _numbers(
        contents.path, VALUE, contents.columns + contents.nonzeros * kind.itemsize + begin * 8, count
    )
    if count and not 0 <= columns.min() <= columns.max() < contents.n:
        raise UnreadableFile(f"{contents.path}: a column index is not in 0 … {contents.n - 1}; the file is damaged")
    indptr = np.concatenate([[0], np.cumsum(lengths)]).astype(columns.dtype)
    return sp.csr_array((values, columns, indptr), shape=(lengths.size, contents.n))
