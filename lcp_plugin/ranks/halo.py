"""The ranks of an MPI job that share the rows of a matrix, and the values and rows they need from each other."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from ..core.checks import Arrays, FloatVector, freeze_csr
from .collective import Ranks

Integers = NDArray[Any]
NOBODY = np.empty(0, np.int64)


class ForeignRows(NamedTuple):
    """Rows that others own: entries a row, global columns, values, and the places of the entries at their owner's."""

    counts: Integers
    columns: Integers
    values: FloatVector
    places: Integers


class Exchange:
    """Sends values to the ranks that need copies of them, each time the same ones.

    Parameters
    ----------
    comm : communicator of mpi4py
    own : int
        How many values this rank owns; copies of others stand behind them.
    places : array of int, shape (k, 2)
        Rank and place there of each copied value.
    """

    def __init__(self, comm: Any, own: int, places: Integers) -> None:
        self._comm, self._own = comm, own
        self._order = np.argsort(places[:, 0], kind="stable")
        self._received = np.bincount(places[:, 0], minlength=comm.size)
        asked = np.split(places[self._order, 1], np.cumsum(self._received)[:-1])
        wanted = comm.alltoall(asked)
        self._sent, self._which = np.array([one.size for one in wanted]), np.concatenate(wanted)

    def __call__(self, values: FloatVector) -> None:
        """Overwrite the copies behind the own values."""
        copies = np.empty(self._order.size)
        self._comm.Alltoallv([values[self._which], self._sent], [copies, self._received])
        values[self._own + self._order] = copies


class Halo(Ranks):
    """Consecutive ranges of rows in the order of the ranks; `fetch` brings the foreign values.

    Parameters
    ----------
    comm : communicator of mpi4py
    own : int
        How many rows this rank owns; may be 0.
    ghosts : array of int
        Foreign indices, none twice.
    own_entries : int, optional
        Entries of the own rows, where rows of foreign unknowns stand behind them.
    entries : array of int, shape (k, 2), optional
        Rank and place there of each entry of those rows.
    starts : array of int, shape (ranks + 1,), optional
        Where the rows of each rank begin, if that is known; asked of all ranks otherwise.
    """

    def __init__(
        self,
        comm: Any,
        own: int,
        ghosts: Integers = NOBODY,
        own_entries: int = 0,
        entries: Integers | None = None,
        starts: Integers | None = None,
    ) -> None:
        super().__init__(comm)
        self.starts = np.cumsum([0, *self.comm.allgather(int(own))]) if starts is None else starts
        self.own, self.n, self.ghosts, self.foreign = (
            int(own),
            int(self.starts[-1]),
            ghosts,
            int(ghosts.size),
        )
        self.first, self.last = int(self.starts[self.rank]), int(self.starts[self.rank + 1])
        self.is_empty = not any(self.comm.allgather(self.foreign))
        if self.is_empty:
            return
        owners = self.owners(ghosts)
        places = np.stack([owners, ghosts - self.starts[owners]], axis=1)
        self._values = Exchange(self.comm, own, places)
        self._entries = None if entries is None else Exchange(self.comm, own_entries, entries)
        self._flags = np.empty(own + self.foreign)

    def owners(self, indices: Integers) -> Integers:
        """Return the rank that owns each index."""
        return np.searchsorted(self.starts, indices, side="right") - 1

    def is_foreign(self, indices: Integers) -> NDArray[np.bool_]:
        """Return which of the indices others own."""
        return (indices < self.first) | (indices >= self.last)

    # --- values ------------------------------------------------------------------------------------------

    def fetch(self, x: FloatVector) -> None:
        """Overwrite what stands behind the own values in x, shape (own + foreign,), by the owners' values."""
        if not self.is_empty:
            self._values(x)

    def whole(self, own: FloatVector) -> FloatVector:
        """Return the own values with the foreign ones behind them, shape (own + foreign,), a copy."""
        x = np.zeros(self.own + self.foreign)
        x[: self.own] = own
        self.fetch(x)
        return x

    def fetch_entries(self, data: FloatVector) -> None:
        """Overwrite the entries of the foreign rows, which stand behind those of the own rows."""
        if not self.is_empty and self._entries is not None:
            self._entries(data)

    def fetch_flags(self, flags: NDArray[Any]) -> None:
        """Do as `fetch` does with flags."""
        if not self.is_empty:
            self._flags[: self.own] = flags[: self.own]
            self.fetch(self._flags)
            flags[self.own :] = self._flags[self.own :] > 0.0

    # --- a coarser grid ----------------------------------------------------------------------------------

    def coarser(self, own: int) -> Halo:
        """Return the ranks of a grid on which this one has so many unknowns."""
        return Halo(self.comm, own)

    def outside(self, columns: Integers) -> Integers:
        """Return which of these unknowns, counted over all ranks, are foreign, ascending."""
        return np.unique(columns[self.is_foreign(columns)]).astype(np.int64)

    def local(self, columns: Integers, ghosts: Integers) -> Integers:
        """Return the unknowns as this rank counts them: the own from 0 on, then the ghosts in order, 0 for others."""
        local = (columns - self.first).astype(np.int32)
        at = np.flatnonzero((local < 0) | (local >= self.own))
        if not at.size:
            return local
        foreign = columns[at]
        local[at] = 0
        if ghosts.size:
            order = np.argsort(ghosts, kind="stable")
            ascending = ghosts[order]
            place = np.minimum(np.searchsorted(ascending, foreign), ghosts.size - 1)
            local[at] = np.where(ascending[place] == foreign, self.own + order[place], 0)
        return local

    def with_foreign_rows(self, rows: Arrays) -> Arrays:
        """Return the own rows, columns counted over all ranks, with those of the ghosts behind, as their owners do."""
        indptr, columns, data = rows
        if self.is_empty:
            return rows
        found = self._foreign_rows(self.ghosts, indptr, data, lambda places: columns[places])
        return _appended(rows, found.counts, found.columns, found.values)

    def overlapped(self, rows: Arrays, ghosts: Integers, further: Integers) -> tuple[Arrays, Halo]:
        """Return the own rows with those of the foreign unknowns next to them behind, and the halo of all they meet.

        Parameters
        ----------
        rows : CSR arrays
            The own rows, sorted; column own + k stands for the unknown ghosts[k].
        ghosts : array of int
            Ascending; not all of them need be met.
        further : array of int
            Foreign unknowns to be met in any case.

        Notes
        -----
        Next to the own unknowns is whoever an own row meets, or whose row meets an own unknown. The ghosts of the new
        halo are first those whose rows are here, then the others.
        """
        own = self.own
        indptr, indices, data = rows
        at = np.flatnonzero(indices >= own)
        met = ghosts[indices[at] - own]
        near = np.union1d(
            met, self._dependents(np.searchsorted(indptr, at, side="right") - 1 + self.first, met)
        )
        if not any(self.comm.allgather(near.size + further.size)):
            return rows, Halo(self.comm, own, near, data.size, starts=self.starts)
        if not np.array_equal(near, ghosts):  # both ascend: the rows stay sorted
            indices = indices.copy()
            indices[at] = own + np.searchsorted(near, met)

        def global_columns(places: Integers) -> Integers:
            columns = indices[places].astype(np.int64)
            is_foreign = columns >= own
            columns[~is_foreign] += self.first
            columns[is_foreign] = near[columns[is_foreign] - own]
            return columns

        found = self._foreign_rows(near, indptr, data, global_columns)
        far = np.setdiff1d(
            np.concatenate([found.columns[self.is_foreign(found.columns)], further]), near
        )
        all_ghosts = np.concatenate([near, far])
        local = self.local(found.columns, all_ghosts)
        order = np.lexsort((local, np.repeat(np.arange(near.size), found.counts)))
        entries = np.stack([np.repeat(self.owners(near), found.counts), found.places], axis=1)[
            order
        ]
        overlapping = _appended(
            (indptr, indices, data), found.counts, local[order], found.values[order]
        )
        return overlapping, Halo(self.comm, own, all_ghosts, data.size, entries, self.starts)

    def _foreign_rows(
        self,
        wanted: Integers,
        indptr: Integers,
        data: FloatVector,
        columns: Callable[[Integers], Integers],
    ) -> ForeignRows:
        """Return the rows `wanted`, global indices in any order; all ranks call.

        Parameters
        ----------
        wanted : array of int
            Foreign rows.
        indptr, data : arrays
            The own rows in CSR, which others may want.
        columns : callable
            Gives the global columns of the entries at the places it is called with.
        """
        owners = self.owners(wanted)
        order = np.argsort(owners, kind="stable")
        ends = np.searchsorted(owners[order], np.arange(self.size + 1))
        asked = [
            wanted[order[ends[rank] : ends[rank + 1]]] - self.starts[rank]
            for rank in range(self.size)
        ]
        replies = []
        for rows in self.comm.alltoall(asked):
            counts = (indptr[rows + 1] - indptr[rows]).astype(np.int64)
            places = _ranges(indptr[rows].astype(np.int64), counts)
            replies.append((counts, columns(places).astype(np.int64), data[places], places))
        parts = [np.concatenate(part) for part in zip(*self.comm.alltoall(replies), strict=True)]
        counts = np.empty(wanted.size, np.int64)
        counts[order] = parts[0]
        begins = np.empty(wanted.size, np.int64)
        begins[order] = np.cumsum(parts[0]) - parts[0]
        take = _ranges(begins, counts)
        return ForeignRows(counts, parts[1][take], parts[2][take], parts[3][take])

    def _dependents(self, rows: Integers, met: Integers) -> Integers:
        """Return the foreign unknowns whose rows meet an own one; `rows` meet the foreign unknowns `met`."""
        owners = self.owners(met)
        sent = [np.unique(rows[owners == rank]) for rank in range(self.size)]
        return np.concatenate(self.comm.alltoall(sent))


def _appended(rows: Arrays, counts: Integers, columns: Integers, values: FloatVector) -> Arrays:
    indptr, indices, data = rows
    return (
        np.concatenate([indptr, indptr[-1] + np.cumsum(counts, dtype=indptr.dtype)]),
        np.concatenate([indices, columns.astype(indices.dtype)]),
        np.concatenate([data, values]),
    )


def _ranges(begins: Integers, counts: Integers) -> Integers:
    """Return begins[0], begins[0] + 1, … counts[0] of them, then the same for the next."""
    places: Integers = np.repeat(begins - (np.cumsum(counts) - counts), counts) + np.arange(
        int(counts.sum())
    )
    return places


def own_rows(ranks: Halo, matrix: sp.csr_array) -> tuple[sp.csr_array, Halo]:
    """Return the own rows with local columns, first the own ones, then the foreign ones they meet; and their halo.

    Parameters
    ----------
    ranks : Halo
        Of the columns.
    matrix : csr_array, shape (own, n)
        Canonical; columns counted over all ranks.
    """
    ghosts = ranks.outside(matrix.indices)
    rows = sp.csr_array(
        (
            matrix.data,
            ranks.local(matrix.indices, ghosts),
            matrix.indptr.astype(np.int32, copy=False),
        ),
        shape=(matrix.shape[0], ranks.own + ghosts.size),
    )
    if ghosts.size:
        rows.data = rows.data.copy()  # the caller's stay in their order
        rows.sort_indices()
    return freeze_csr(rows), Halo(ranks.comm, ranks.own, ghosts, starts=ranks.starts)


def numbered_over_all(rows: sp.csr_array, halo: Halo) -> sp.csr_array:
    """Return the own rows with columns counted over all ranks, shape (own, n)."""
    numbers = np.concatenate([np.arange(halo.first, halo.last), halo.ghosts])
    numbers = numbers.astype(np.int32 if halo.n < 2**31 else np.int64)
    matrix = sp.csr_array(
        (rows.data.copy(), numbers[rows.indices], rows.indptr), shape=(halo.own, halo.n)
    )
    matrix.sort_indices()
    return matrix
