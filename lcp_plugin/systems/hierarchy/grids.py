"""What a hierarchy is made of: matrices as bare arrays, ways between grids, grids; immutable.

Threads share a grid by blocks of rows, no row of which meets one of the next block but one. A sweep takes the even
blocks first and then the odd ones, backward the other way round: a Gauss–Seidel sweep in an order that the matrix alone
decides, whoever takes which block. Rows of a new matrix are written in pieces, which are joined.

In runs of equal rows neighbours in a grid have the same entries at the same distance from the diagonal. Over a run a
product with M is a sum of shifted vectors, each times a number: no index and no entry of M is read again, and a
processor takes several rows at once. A Gauss–Seidel sweep does so in blocks, which reach no further than to the nearest
unknown that the sweep has to have done before; only the neighbour just before waits for its turn.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...core.checks import Arrays, BoolVector, FloatVector
from ...core.communicator import ALONE, Communicator, SharedRows
from ...core.kernels.compilation import inlined, kernel
from ...core.kernels.compiler import uintp
from ...core.kernels.threads import share
from ...core.tuning import SHARED_FROM

EqualRows = NDArray[np.int64]

NO_WEIGHT = np.zeros(0)
NO_WEIGHT.flags.writeable = False


@dataclass(frozen=True, eq=False)
class Operator:
    """A read-only CSR matrix as bare arrays."""

    indptr: NDArray[Any]
    indices: NDArray[Any]
    data: FloatVector

    def __post_init__(self) -> None:
        # One signature for every kernel: the caller's matrix is read-only as well.
        for name in ("indptr", "indices", "data"):
            view = getattr(self, name).view()
            view.flags.writeable = False
            object.__setattr__(self, name, view)

    @property
    def arrays(self) -> tuple[NDArray[Any], NDArray[Any], FloatVector]:
        """The three arrays, in the order the kernels take them."""
        return self.indptr, self.indices, self.data


@dataclass(frozen=True, eq=False)
class Transfer:
    """The way from one grid to the next coarser one: prolongation P, restriction Pᵀ or Pᵀ D⁻¹, and who is on both.

    P has a row for each foreign unknown as well, which the Galerkin product needs. `scaling` is that of the fine
    unknowns, empty where all are alike.
    """

    prolongation: Operator
    restriction: Operator
    is_coarse: NDArray[np.bool_]
    scaling: FloatVector = field(default_factory=lambda: NO_WEIGHT)


@dataclass(frozen=True, eq=False)
class Grid(SharedRows):
    """One grid: its matrix with every diagonal entry stored, where those stand, equal rows, inverses of the pivots.

    A pivot is the diagonal entry, plus its weight where other processes sweep at the same time.
    """

    matrix: Operator
    split: NDArray[Any]
    runs: EqualRows
    blocks: RowBlocks
    inverse: FloatVector
    communicator: Communicator = ALONE
    weight: FloatVector = field(default_factory=lambda: NO_WEIGHT)

    @property
    def n(self) -> int:
        """Number of own unknowns."""
        return self.inverse.size

    @property
    def width(self) -> int:
        """Number of unknowns that the own rows meet."""
        return self.inverse.size + self.foreign

    @property
    def spread(self) -> float:
        """How many times the least pivot the largest one is, ∞ where not all are positive."""
        largest, least = float(self.inverse.max(initial=0.0)), float(self.inverse.min(initial=np.inf))
        return largest / least if 0.0 < least < np.inf else np.inf

    @property
    def rows(self) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any], FloatVector, EqualRows]:
        """The matrix as sweeps take it."""
        return self.matrix.indptr, self.split, self.matrix.indices, self.matrix.data, self.runs

    def dense(self, values: FloatVector) -> NDArray[np.float64]:
        """Return the matrix with these values in the place of its own, of a grid that nobody shares."""
        indptr, indices, _ = self.matrix.arrays
        dense = np.zeros((self.n, self.n))
        dense[np.repeat(np.arange(self.n), np.diff(indptr)), indices] = values
        return dense

    @property
    def own_entries(self) -> int:
        """Number of entries of the own rows."""
        return int(self.matrix.indptr[self.n])

    @property
    def own_arrays(self) -> Arrays:
        """The own rows, where those of foreign unknowns stand behind them."""
        matrix = self.matrix
        if matrix.indptr.size == self.n + 1:
            return matrix.arrays
        return Operator(matrix.indptr[: self.n + 1], matrix.indices, matrix.data).arrays


@dataclass(frozen=True, eq=False)
class Hierarchy:
    """The grids from the finest to the coarsest.

    Attributes
    ----------
    grids : tuple of Grid
    transfers : tuple of Transfer
        One fewer: from each grid to the next.
    work : float
        Matrix entries touched to build them.
    is_helpful : bool
        False where coarser grids would cost too much: then there is only the finest.
    extends : bool
        Whether interpolation reaches through fine unknowns: couplings jump from edge to edge.
    """

    grids: tuple[Grid, ...]
    transfers: tuple[Transfer, ...]
    work: float
    is_helpful: bool
    extends: bool = False


MOST_BLOCKS = 16
SMALLEST_BLOCK = 8192  # rows
REACHES = 4  # times as many rows as a row reaches far: what is done twice at the seams is little
FEWEST = 4  # two of either kind


class RowBlocks(NamedTuple):
    """Where blocks begin, with the end of the last, and how far a row reaches where there are several."""

    edges: NDArray[np.int64]
    reach: int

    def count(self, colour: int) -> int:
        """Return how many blocks are even (0) or odd (1)."""
        return (self.edges.size - colour) // 2

    @property
    def smallest_share(self) -> int:
        """The fewest blocks of a colour that are worth a hand-over; a sweep has two."""
        return max(SHARED_FROM // max(2 * int(self.edges[1]), 1), 1)


def blocks_of(matrix: Arrays, unlike: NDArray[Any], rows: int, *, may_cut: bool) -> RowBlocks:
    """Return the blocks of that many rows; one where it may not be cut, or would be for nothing.

    Only the rows that are `unlike` the one before need be looked at: the others reach as far.
    """
    indptr, indices, _ = matrix
    count, reach = 0, 0
    if may_cut and rows >= FEWEST * SMALLEST_BLOCK:
        reach = int(max((unlike - indices[indptr[unlike]]).max(), (indices[indptr[unlike + 1] - 1] - unlike).max()))
        count = min(MOST_BLOCKS, rows // max(SMALLEST_BLOCK, REACHES * reach)) // 2 * 2
    if count < FEWEST:
        count, reach = 1, 0
    edges = np.linspace(0, rows, count + 1).astype(np.int64)
    edges.flags.writeable = False
    return RowBlocks(edges, reach)


SMALLEST_PIECE = 16384  # rows


def joined(pieces: list[Arrays]) -> Arrays:
    """Return the CSR rows of consecutive pieces of rows; the first may have space for those of the others behind it."""
    sizes = [int(indptr[-1]) for indptr, _, _ in pieces]
    ends = np.cumsum(sizes, dtype=pieces[0][0].dtype)
    further = [piece[0][1:] + before for piece, before in zip(pieces[1:], ends, strict=False)]
    indptr = np.concatenate([pieces[0][0], *further]) if further else pieces[0][0]
    indices, data = (
        _appended([piece[k] for piece in pieces], sizes, int(ends[-1])) for k in (1, 2)
    )
    return indptr, indices, data


def _appended(parts: list[Any], sizes: list[int], total: int) -> Any:
    """Return the first entries of all parts, so many of each, in the memory of the first part where that suffices."""
    if parts[0].size < total:
        return np.concatenate([part[:size] for part, size in zip(parts, sizes, strict=True)])
    end = sizes[0]
    for part, size in zip(parts[1:], sizes[1:], strict=True):
        parts[0][end : end + size] = part[:size]
        end += size
    return parts[0][:total]


def rows_from_kernel(kernel: Any, operands: tuple[Any, ...], more: int, smallest: int) -> tuple[Arrays, int]:
    """Return the rows of P that a kernel writes with space for those of M and `more` a row, and what else it tells."""
    indptr, indices = operands[:2]
    n = indptr.size - 1

    def piece(first: int, end: int) -> tuple[Arrays, int]:
        last = end if first else n  # memory that nothing is written to was never touched
        capacity = int(indptr[last] - indptr[first]) + more * (last - first)
        rows = np.empty(end - first + 1, indptr.dtype), np.empty(capacity, indices.dtype), np.empty(capacity)
        _, counts = kernel(*operands, first, end, *rows)
        return rows, counts

    pieces, counts = zip(*share(piece, n, smallest), strict=True)
    return joined(list(pieces)), sum(counts)


SHORTEST = 16  # rows; fewer are taken one by one
LONGEST_REACH = 1024  # rows, whose sums stay in the fastest cache


def unlike_rows(matrix: Arrays, rows: int, weight: FloatVector) -> NDArray[np.int64]:
    """Return which of the own rows, so many, are not that before with each column one further; weights count, too."""
    is_same = np.zeros(rows, np.uint8)
    share(partial(mark_equal, 1, *matrix, is_same), rows, SMALLEST_PIECE)
    if weight.size:
        is_same[1:] &= weight[1:] == weight[:-1]
    return np.flatnonzero(is_same == 0)


def runs_of_equal_rows(matrix: Arrays, unlike: NDArray[np.int64], rows: int) -> EqualRows:
    """Return the runs of the own rows, shape (count, 3): first row, row behind the last, and reach.

    The reach is the number of rows that a sweep may take at once, 0 where they are unlike and taken one by one.
    """
    begins = np.append(unlike, rows)
    is_long = begins[1:] - begins[:-1] >= SHORTEST
    first, end = begins[:-1][is_long], begins[1:][is_long]
    if first.size == 0:
        return _with_gaps(rows, first, end, end)
    reach = _reaches(*matrix[:2], first)
    return _with_gaps(rows, *(column[reach >= SHORTEST] for column in (first, end, reach)))


def _reaches(indptr: NDArray[Any], indices: NDArray[Any], first: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return how near to the diagonal the nearest entry of these rows stands that is no neighbour's."""
    size = indptr[first + 1] - indptr[first]
    begin = np.cumsum(size) - size
    entries = np.arange(size.sum()) + np.repeat(indptr[first] - begin, size)
    distance = np.abs(indices[entries].astype(np.int64) - np.repeat(first, size))
    distance[(distance <= 1) | (distance > LONGEST_REACH)] = LONGEST_REACH
    return np.minimum.reduceat(distance, begin)


def _with_gaps(
    rows: int, first: NDArray[np.int64], end: NDArray[np.int64], reach: NDArray[np.int64]
) -> EqualRows:
    """Return the runs with one of unlike rows wherever rows are left before, between and behind them."""
    found = np.zeros((2 * first.size + 1, 3), np.int64)
    found[1::2, 0], found[1::2, 1], found[1::2, 2] = first, end, reach
    found[2::2, 0], found[:-1:2, 1], found[-1, 1] = end, first, rows
    found = found[found[:, 0] < found[:, 1]]
    found.flags.writeable = False
    return found


def without(runs: EqualRows, changed: BoolVector) -> EqualRows:
    """Return the runs that are left when the rows marked in `changed`, shape (rows,), are like no other."""
    found = np.empty((changed.size // (SHORTEST // 2) + 2, 3), np.int64)
    left = found[: _cut(runs, changed, found)].copy()
    left.flags.writeable = False
    return left


@inlined
def run_at(row, runs):  # type: ignore[no-untyped-def]
    """Return which run that row belongs to."""
    low, high = 0, runs.shape[0] - 1
    while low < high:
        middle = (low + high + 1) // 2
        if runs[middle, 0] <= row:
            low = middle
        else:
            high = middle - 1
    return low


@kernel
def find_pivots(indptr, indices, data, weight, smallest, split, inverse, first, end):  # type: ignore[no-untyped-def]
    """Write where the diagonal entries stand, and the inverse pivots: 0 of a diagonal entry that is not above that."""
    for i in range(uintp(first), uintp(end)):
        k = uintp(indptr[i])
        while uintp(indices[k]) < i:
            k += uintp(1)
        split[i] = k
        pivot = data[k] + weight[i] if weight.size > 0 else data[k]
        inverse[i] = 1.0 / pivot if data[k] > smallest else 0.0


@kernel
def mark_equal(step, indptr, indices, data, is_same, first, end):  # type: ignore[no-untyped-def]
    """Mark the rows i that are those of i − step with each column one further; the flags are bytes."""
    one, step = uintp(1), uintp(step)
    for i in range(max(step, uintp(first)), uintp(end)):
        k, last = uintp(indptr[i]), uintp(indptr[i + one])
        before = uintp(indptr[i - step])
        same = last - k == uintp(indptr[i - step + one]) - before
        while same and k < last:
            same = data[k] == data[before] and indices[k] == indices[before] + 1
            k += one
            before += one
        is_same[i] = same


@kernel
def _cut(runs, changed, found):  # type: ignore[no-untyped-def]
    """Write what is left of the runs into `found`; return how many there are."""
    count = 0
    for s in range(runs.shape[0]):
        first, end, reach = runs[s, 0], runs[s, 1], runs[s, 2]
        while first < end:
            is_changed, last = reach == 0 or changed[uintp(first)], first + 1
            if reach == 0:
                last = end
            while last < end and changed[uintp(last)] == is_changed:
                last += 1
            is_unlike = is_changed or last - first < SHORTEST
            if is_unlike and count > 0 and found[count - 1, 2] == 0:
                found[count - 1, 1] = last
            else:
                found[count, 0], found[count, 1], found[count, 2] = first, last, 0 if is_unlike else reach
                count += 1
            first = last
    return count
