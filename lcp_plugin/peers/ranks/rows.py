"""The rows of a matrix that one rank owns, and the values it needs from the others."""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse as sp
from mpi4py import MPI
from numpy.typing import NDArray
from petsc4py import PETSc

from ...checks import FloatVector, read_only
from .collective import largest, total

Arrays = tuple[NDArray[Any], NDArray[Any], FloatVector]


class Layout:
    """Which rank owns which indices: consecutive ranges, in the order of the ranks.

    Parameters
    ----------
    comm : mpi4py communicator
    own : int
        How many indices this rank owns; may be 0.
    """

    def __init__(self, comm: MPI.Comm, own: int) -> None:
        self.comm = comm
        self.starts = np.concatenate([[0], np.cumsum(comm.allgather(int(own)))])
        self.n = int(self.starts[-1])
        self.first, self.last = int(self.starts[comm.rank]), int(self.starts[comm.rank + 1])
        self.own = self.last - self.first

    def owners(self, indices: NDArray[Any]) -> NDArray[Any]:
        """Return the rank that owns each index."""
        return np.searchsorted(self.starts, indices, side="right") - 1


class Halo:
    """The processes that share a grid: foreign values come by a PETSc star forest, decisions by MPI.

    Parameters
    ----------
    layout : Layout
    ghosts : array of int
        Foreign indices, none twice.
    own_entries : int, optional
        Entries of the own rows, where rows of foreign unknowns stand behind them.
    entries : array of int, shape (k, 2), optional
        Rank and place there of each entry of those rows.

    Attributes
    ----------
    foreign : int
        How many foreign indices there are.
    is_empty : bool
        True where no rank needs a foreign value; then nothing is ever sent.
    """

    def __init__(
        self, layout: Layout, ghosts: NDArray[Any], own_entries: int = 0, entries: NDArray[Any] | None = None
    ) -> None:
        self.layout, self.ghosts, self.foreign = layout, ghosts, int(ghosts.size)
        self.is_empty = not any(layout.comm.allgather(self.foreign))
        if self.is_empty:
            return
        owners = layout.owners(ghosts)
        self._forest = _forest(layout, layout.own, np.stack([owners, ghosts - layout.starts[owners]], axis=1))
        self._own_entries = own_entries
        self._entry_forest = None if entries is None else _forest(layout, own_entries, entries)
        self._flags = np.empty(layout.own + self.foreign)

    def fetch(self, x: FloatVector) -> None:
        """Overwrite what stands behind the own values in x, shape (own + foreign,), by the owners' values."""
        if not self.is_empty:
            own, foreign = x[: self.layout.own], x[self.layout.own :] if self.foreign else np.empty(0)
            self._forest.bcastBegin(MPI.DOUBLE, own, foreign, MPI.REPLACE)
            self._forest.bcastEnd(MPI.DOUBLE, own, foreign, MPI.REPLACE)

    def fetch_entries(self, data: FloatVector) -> None:
        """Overwrite the entries of the foreign rows, which stand behind those of the own rows."""
        if not self.is_empty and self._entry_forest is not None:
            own, foreign = data[: self._own_entries], data[self._own_entries :] if self.foreign else np.empty(0)
            self._entry_forest.bcastBegin(MPI.DOUBLE, own, foreign, MPI.REPLACE)
            self._entry_forest.bcastEnd(MPI.DOUBLE, own, foreign, MPI.REPLACE)

    def fetch_flags(self, flags: NDArray[Any]) -> None:
        """Do the same with flags."""
        if not self.is_empty:
            self._flags[: self.layout.own] = flags[: self.layout.own]
            self.fetch(self._flags)
            flags[self.layout.own :] = self._flags[self.layout.own :] > 0.0

    def largest(self, value: float) -> float:
        """Return the largest of all ranks' values; a NaN stays."""
        return largest(self.layout.comm, value)[0]

    def total(self, value: float) -> float:
        """Return the sum of all ranks' values."""
        return total(self.layout.comm, value)[0]


def _forest(layout: Layout, roots: int, places: NDArray[Any]) -> PETSc.SF:
    forest = PETSc.SF().create(comm=layout.comm)
    forest.setGraph(roots, None, places.astype(PETSc.IntType).ravel())
    forest.setUp()
    return forest


class Rows:
    """Own rows of a matrix in CSR, its columns renumbered: the own ones first, then the foreign ones it meets.

    Parameters
    ----------
    columns : Layout
        Of the columns.
    indptr, indices, data : arrays
        CSR with global column indices.
    """

    def __init__(self, columns: Layout, indptr: NDArray[Any], indices: NDArray[Any], data: FloatVector) -> None:
        first, last, own = columns.first, columns.last, columns.own
        is_foreign = (indices < first) | (indices >= last)
        ghosts, place = np.unique(indices[is_foreign], return_inverse=True)
        local = (indices - first).astype(np.int32)
        local[is_foreign] = (own + place).astype(np.int32)
        self.columns, self.ghosts = columns, ghosts
        self.count = indptr.size - 1
        local_rows = sp.csr_array(
            (np.asarray(data, dtype=np.float64), local, indptr.astype(np.int32, copy=False)),
            shape=(self.count, own + ghosts.size),
        )
        if ghosts.size:
            local_rows.sort_indices()
        self.indptr, self.indices, self.data = map(
            read_only, (local_rows.indptr, local_rows.indices, local_rows.data)
        )
        self.halo = Halo(columns, ghosts)
        self._buffer = np.empty(0) if self.halo.is_empty else np.empty(own + ghosts.size)

    @property
    def arrays(self) -> Arrays:
        """The three arrays, in the order the kernels take them."""
        return self.indptr, self.indices, self.data

    @property
    def width(self) -> int:
        """How many columns there are after renumbering."""
        return self.columns.own + self.ghosts.size

    def new_vector(self) -> FloatVector:
        """Return zeros with room for the foreign values."""
        return np.zeros(self.width)

    def filled(self, own: FloatVector) -> FloatVector:
        """Return the own values with the foreign ones behind them; a buffer, or `own` itself where none is needed."""
        if self.halo.is_empty:
            return own
        self._buffer[: own.size] = own
        self.halo.fetch(self._buffer)
        return self._buffer

    def global_columns(self) -> NDArray[Any]:
        """Return the column indices as the caller counts them."""
        numbers = np.concatenate([np.arange(self.columns.first, self.columns.last), self.ghosts])
        columns: NDArray[Any] = numbers[self.indices]
        return columns

    def as_csr(self) -> sp.csr_array:
        """Return the rows as a scipy array that shares the data."""
        return sp.csr_array((self.data, self.indices, self.indptr), shape=(self.count, self.width))
