"""Parts of a hierarchy: matrices as bare arrays, transfers between grids, grids; immutable.

Threads share a grid by blocks of rows: rows of block k have no entries in block k + 2. A forward sweep takes the even
blocks first and then the odd blocks, a backward sweep the reverse. The matrix determines the order of this Gauss–Seidel
sweep, independent of the threads.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from ...core.checks import Arrays, Vector, fill, read_only


@dataclass(frozen=True, eq=False)
class Operator:
    """A read-only CSR matrix as bare arrays."""

    indptr: NDArray[Any]
    indices: NDArray[Any]
    data: Vector

    def __post_init__(self) -> None:
        # One signature for every kernel: the caller's matrix is read-only as well.
        parts = {name: read_only(getattr(self, name)) for name in ("indptr", "indices", "data")}
        fill(self, **parts)

    @property
    def arrays(self) -> tuple[NDArray[Any], NDArray[Any], Vector]:
        """The three arrays, in the order the kernels take them."""
        return self.indptr, self.indices, self.data


@dataclass(frozen=True, eq=False)
class Transfer:
    """Transfer to the next coarser grid: prolongation P, restriction Pᵀ or Pᵀ D⁻¹, mask of coarse unknowns."""

    prolongation: Operator
    restriction: Operator
    is_coarse: NDArray[np.bool_]


class NoGhosts:
    """The halo of a grid in one process, which has all rows: nothing is exchanged."""

    foreign = 0

    def whole(self, x: Vector) -> Vector:
        """Return x, shape (n,), with the values of ghosts, shape (width,)."""
        return x

    def fetch(self, x: Vector) -> None:
        """Overwrite the values of ghosts in x, shape (width,)."""

    fetch_flags = fetch_entries = fetch

    def total(self, number: float) -> float:
        """Return the sum of a number of each rank."""
        return number

    largest = total


@dataclass(frozen=True, eq=False)
class Grid:
    """Grid: matrix with every diagonal entry stored, positions of the diagonal, inverses of the pivots.

    On ranks the matrix has the local rows, then the rows of adjacent ghosts. n counts local unknowns, and `weight` is a
    part of the pivots; it is None in one process.
    """

    matrix: Operator
    split: NDArray[Any]
    blocks: RowBlocks
    inverse: Vector
    halo: Any
    weight: Vector | None = None

    @property
    def n(self) -> int:
        """Number of unknowns."""
        return self.inverse.size

    @property
    def width(self) -> int:
        """Number of unknowns that the rows meet; on ranks, some are ghosts."""
        return self.n + int(self.halo.foreign)

    @property
    def entries(self) -> int:
        """Number of stored entries."""
        return self.matrix.data.size

    @property
    def local_rows(self) -> tuple[NDArray[Any], NDArray[Any], Vector]:
        """The local rows."""
        indptr, indices, data = self.matrix.arrays
        return Operator(indptr[: self.n + 1], indices, data).arrays

    @property
    def spread(self) -> float:
        """Ratio of the largest to the least pivot; ∞ if a pivot is not positive."""
        largest = float(self.inverse.max(initial=0.0))
        least = float(self.inverse.min(initial=np.inf))
        return largest / least if 0.0 < least < np.inf else np.inf

    @property
    def rows(self) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any], Vector]:
        """The matrix as sweeps take it."""
        return self.matrix.indptr, self.split, self.matrix.indices, self.matrix.data

    def dense(self, values: Vector) -> NDArray[np.float64]:
        """Return the dense matrix with these values on the pattern of the grid's matrix."""
        indptr, indices, _ = self.matrix.arrays
        return sp.csr_array((values, indices, indptr), shape=(self.n, self.n)).toarray()


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
        False if coarser grids would cost too much: then there is only the finest.
    has_jumps : bool
        Whether many fine unknowns would lack a coarse neighbor: couplings jump from edge to edge.
    """

    grids: tuple[Grid, ...]
    transfers: tuple[Transfer, ...]
    work: float
    is_helpful: bool
    has_jumps: bool = False


SMALLEST_BLOCK = 8192  # rows


class RowBlocks(NamedTuple):
    """First rows of the blocks, with the end of the last block, and the reach of a row if there are several blocks."""

    edges: NDArray[np.int64]
    reach: int

    def count(self, color: int) -> int:
        """Return the number of even (0) or odd (1) blocks."""
        return (self.edges.size - color) // 2


def blocks_of(matrix: Arrays, rows: int, *, may_cut: bool) -> RowBlocks:
    """Return the blocks of `rows` rows; one block if not `may_cut`, or if a split gains nothing."""
    indptr, indices, _ = matrix
    count, reach = 0, 0
    if may_cut and rows >= 4 * SMALLEST_BLOCK:  # two blocks of either color
        row, begins = np.arange(rows), indptr[: rows + 1]
        before, after = row - indices[begins[:-1]], indices[begins[1:] - 1] - row
        reach = int(max(before.max(), after.max()))
        # A block has four times as many rows as a row reaches far: little is done twice at the seams.
        count = min(16, rows // max(SMALLEST_BLOCK, 4 * reach)) // 2 * 2
    if count < 4:
        count, reach = 1, 0
    edges = np.linspace(0, rows, count + 1).astype(np.int64)
    edges.flags.writeable = False
    return RowBlocks(edges, reach)


def pivots(matrix: Operator, smallest: float) -> tuple[NDArray[Any], Vector]:
    """Return the positions of the diagonal entries and their inverses: 0 for an entry not above `smallest`."""
    indptr, indices, data = matrix.arrays
    row = np.repeat(np.arange(indptr.size - 1, dtype=indices.dtype), np.diff(indptr))
    split = np.flatnonzero(indices == row).astype(indptr.dtype)
    diagonal = data[split]
    inverse = np.where(diagonal > smallest, 1.0 / diagonal, 0.0)
    split.flags.writeable = inverse.flags.writeable = False
    return split, inverse
