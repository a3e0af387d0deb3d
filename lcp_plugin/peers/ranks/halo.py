"""The ranks of an MPI job that share the rows of a matrix, and the values they need from each other."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import Any, TypeVar

import numpy as np
import scipy.sparse as sp
from mpi4py import MPI
from numpy.typing import NDArray
from petsc4py import PETSc

from ...checks import FloatVector, frozen
from ...errors import InvalidProblem
from ..alone import NOBODY, Arrays, Peers
from .collective import gathered, largest, require_same, together, total
from .failures import Interruptions
from .layout import Layout
from .overlap import foreign_rows, overlapped

T = TypeVar("T")


class Halo(Peers):
    """Several processes: foreign values come by a PETSc star forest, decisions by MPI.

    Parameters
    ----------
    layout : Layout
    ghosts : array of int
        Foreign indices, none twice.
    own_entries : int, optional
        Entries of the own rows, where rows of foreign unknowns stand behind them.
    entries : array of int, shape (k, 2), optional
        Rank and place there of each entry of those rows.
    """

    is_alone = False

    def __init__(
        self, layout: Layout, ghosts: NDArray[Any], own_entries: int = 0, entries: NDArray[Any] | None = None
    ) -> None:
        self.layout, self.comm, self.ghosts, self.foreign = layout, layout.comm, ghosts, int(ghosts.size)
        self.size, self.rank, self.first = layout.comm.size, layout.comm.rank, layout.first
        self.is_empty = not any(layout.comm.allgather(self.foreign))
        if self.is_empty:
            return
        owners = layout.owners(ghosts)
        self._forest = _forest(layout, layout.own, np.stack([owners, ghosts - layout.starts[owners]], axis=1))
        self._own_entries = own_entries
        self._entry_forest = None if entries is None else _forest(layout, own_entries, entries)
        self._flags = np.empty(layout.own + self.foreign)

    # --- values ------------------------------------------------------------------------------------------

    def fetch(self, x: FloatVector) -> None:
        """Overwrite what stands behind the own values in x, shape (own + foreign,), by the owners' values."""
        if not self.is_empty:
            self._send(self._forest, x, self.layout.own)

    def fetch_entries(self, data: FloatVector) -> None:
        """Overwrite the entries of the foreign rows, which stand behind those of the own rows."""
        if not self.is_empty and self._entry_forest is not None:
            self._send(self._entry_forest, data, self._own_entries)

    def _send(self, forest: PETSc.SF, values: FloatVector, own: int) -> None:
        ends = values[:own], values[own:] if self.foreign else np.empty(0)
        forest.bcastBegin(MPI.DOUBLE, *ends, MPI.REPLACE)
        forest.bcastEnd(MPI.DOUBLE, *ends, MPI.REPLACE)

    def fetch_flags(self, flags: NDArray[Any]) -> None:
        """Do the same with flags."""
        if not self.is_empty:
            self._flags[: self.layout.own] = flags[: self.layout.own]
            self.fetch(self._flags)
            flags[self.layout.own :] = self._flags[self.layout.own :] > 0.0

    def gathered(self, own: FloatVector) -> FloatVector | None:
        """Return the parts of all ranks one after the other on rank 0, None on the others."""
        counts = np.diff(self.layout.starts)
        whole = np.empty(self.layout.n) if self.rank == 0 else None
        self.comm.Gatherv(np.ascontiguousarray(own), (whole, counts), root=0)
        return whole

    def everybodys(self, own: NDArray[Any]) -> NDArray[Any]:
        """Return the rows of all ranks' tables one after the other, shape (all, columns), on every rank."""
        return np.concatenate(self.comm.allgather(own))

    # --- what all agree on -------------------------------------------------------------------------------

    def places(self, count: int) -> tuple[int, int]:
        """Return how many things the ranks before this one have, which has `count`, and how many all have."""
        counts = self.comm.allgather(count)
        return sum(counts[: self.rank]), sum(counts)

    def largest(self, value: float) -> float:
        """Return the largest of all ranks' values; a NaN stays."""
        return largest(self.comm, value)[0]

    def all_largest(self, *values: float) -> tuple[float, ...]:
        """Return the largest of each of them."""
        return largest(self.comm, *values)

    def total(self, value: float) -> float:
        """Return the sum of all ranks' values."""
        return total(self.comm, value)[0]

    def everywhere(self, is_so: bool) -> bool:
        """Return whether it is so on every rank."""
        return largest(self.comm, float(not is_so))[0] == 0.0

    def worst(self, value: float, row: int) -> tuple[float, int]:
        """Return the largest value ≥ 0, NaN before any other, and its row of the whole matrix; 0 and −1 of no row."""
        table = gathered(self.comm, value, float(self.first + row if row >= 0 else -1))
        has_rows = table[table[:, 1] >= 0.0]
        if not has_rows.size:
            return 0.0, -1
        k = int(np.argmax(has_rows[:, 0]))  # argmax stops at the first NaN
        return float(has_rows[k, 0]), int(has_rows[k, 1])

    def together(self, attempt: Callable[[], T]) -> T:
        """Return what `attempt` gives on this rank; where it fails on one, no rank goes on."""
        return together(self.comm, attempt)

    def require_same(self, what: str, value: Any, remedy: str, error: Any = InvalidProblem) -> None:
        """Raise that error on every rank unless all of them hold the same value."""
        require_same(self.comm, what, value, remedy, error)

    def interruptions(self) -> AbstractContextManager[Callable[[], bool]]:
        """Return a context in which the first Ctrl-C on a rank is a wish, and whether this rank has it."""
        return Interruptions()

    # --- a coarser grid ----------------------------------------------------------------------------------

    def coarser(self, own: int) -> Halo:
        """Return the ranks of a grid on which this one has so many unknowns."""
        return Halo(Layout(self.comm, own), NOBODY)

    def outside(self, columns: NDArray[Any]) -> NDArray[Any]:
        """Return which of these unknowns, counted over all ranks, are foreign, ascending."""
        return np.unique(columns[self.layout.is_foreign(columns)]).astype(np.int64)

    def local(self, columns: NDArray[Any], ghosts: NDArray[Any]) -> NDArray[Any]:
        """Return the unknowns as this rank counts them: the own from 0 on, then the ghosts in order, 0 for others."""
        return self.layout.local(columns, ghosts)

    def with_foreign_rows(self, rows: Arrays) -> Arrays:
        """Return the own rows, columns counted over all ranks, with those of the ghosts behind, as their owners do."""
        indptr, columns, data = rows
        if self.is_empty:
            return rows
        found = foreign_rows(self.layout, self.ghosts, indptr, data, lambda places: columns[places])
        return (
            np.concatenate([indptr, indptr[-1] + np.cumsum(found.counts, dtype=indptr.dtype)]),
            np.concatenate([columns, found.columns.astype(columns.dtype)]), np.concatenate([data, found.values]),
        )

    def overlapped(self, rows: Arrays, ghosts: NDArray[Any], further: NDArray[Any]) -> tuple[Arrays, Halo]:
        """Return the own rows with those of the unknowns next to them behind, and the halo of all unknowns met."""
        arrays, all_ghosts, entries = overlapped(self.layout, rows, ghosts, further)
        return arrays, Halo(self.layout, all_ghosts, rows[2].size, entries)


def _forest(layout: Layout, roots: int, places: NDArray[Any]) -> PETSc.SF:
    forest = PETSc.SF().create(comm=layout.comm)
    forest.setGraph(roots, None, places.astype(PETSc.IntType).ravel())
    forest.setUp()
    return forest


def own_rows(layout: Layout, matrix: sp.csr_array) -> tuple[sp.csr_array, Halo]:
    """Return the own rows with local columns, first the own ones, then the foreign ones they meet; and their halo.

    Parameters
    ----------
    layout : Layout
        Of the columns.
    matrix : csr_array, shape (own, n)
        Canonical; columns counted over all ranks.
    """
    ghosts = np.unique(matrix.indices[layout.is_foreign(matrix.indices)]).astype(np.int64)
    rows = sp.csr_array(
        (matrix.data, layout.local(matrix.indices, ghosts), matrix.indptr.astype(np.int32, copy=False)),
        shape=(matrix.shape[0], layout.own + ghosts.size),
    )
    if ghosts.size:
        rows.data = rows.data.copy()  # the caller's stay in their order
        rows.sort_indices()
    return frozen(rows), Halo(layout, ghosts)


def numbered_over_all(rows: sp.csr_array, halo: Halo) -> sp.csr_array:
    """Return the own rows with columns counted over all ranks, shape (own, n)."""
    layout = halo.layout
    numbers = np.concatenate([np.arange(layout.first, layout.last), halo.ghosts])
    numbers = numbers.astype(np.int32 if layout.n < 2**31 else np.int64)
    matrix = sp.csr_array((rows.data.copy(), numbers[rows.indices], rows.indptr), shape=(layout.own, layout.n))
    matrix.sort_indices()
    return matrix
