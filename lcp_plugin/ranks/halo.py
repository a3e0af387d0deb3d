"""The ranks of an MPI job that share the rows of a matrix: collective operations, and exchange of values and rows.

Every sum is taken in the order of the ranks, so that a run on a given number of ranks repeats bit for bit.
"""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple, TypeVar

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from ..core.checks import Array, Arrays, Indices, Vector, freeze_csr
from ..core.errors import InvalidOption, InvalidProblem, LCPError, UnreadableFile

T = TypeVar("T")


class Ranks:
    """Processes of a communicator of mpi4py, and collective decisions; None is the whole job."""

    def __init__(self, comm: Any) -> None:
        try:
            from mpi4py import MPI
        except (ImportError, RuntimeError) as error:  # the latter without an MPI library
            raise InvalidOption(
                f"several ranks need mpi4py and an MPI library ({error}); pip install mpi4py mpich (or lcp_plugin[mpi])"
            ) from None
        self.comm = MPI.COMM_WORLD if comm is None else comm
        if not isinstance(self.comm, MPI.Intracomm) or self.comm == MPI.COMM_NULL:
            raise InvalidProblem(
                f"comm must be an intracommunicator of mpi4py with this rank, got {type(comm).__name__}; "
                "give MPI.COMM_WORLD, or a part of it"
            )
        self.size, self.rank = self.comm.size, self.comm.rank

    def table(self, *numbers: float) -> Vector:
        """Return the numbers of all ranks, shape (ranks, how many)."""
        local = np.array(numbers, dtype=np.float64)
        of_all = np.empty((self.size, local.size))
        self.comm.Allgather(local, of_all)
        return of_all

    def largest(self, values: Array) -> float:
        """Return the largest of all ranks' values ≥ 0, arrays or one number each; a NaN stays."""
        return self.all_largest(float(np.max(values, initial=0.0)))[0]

    def all_largest(self, *values: float) -> tuple[float, ...]:
        """Return the largest of each of them."""
        return tuple(self.table(*values).max(axis=0).tolist())

    def total(self, value: float) -> float:
        """Return the sum of all ranks' values, in the order of the ranks."""
        return float(self.table(value).sum(axis=0)[0])

    def everywhere(self, is_so: Array) -> bool:
        """Return whether it is so on every rank, in every row of an array."""
        return not self.anywhere(not np.all(is_so))

    def anywhere(self, is_so: Array) -> bool:
        """Return whether a flag is true on at least one rank, in at least one entry."""
        return self.all_largest(float(np.any(is_so)))[0] > 0.0

    def together(self, attempt: Callable[[], T]) -> T:
        """Return the value of `attempt` on each rank; if it fails on one rank, no rank continues.

        Parameters
        ----------
        attempt : callable
            Without arguments; must not wait for other ranks.

        Raises
        ------
        LCPError
            On every rank the error of the lowest rank that failed, which it names. Any other error, for example of
            a caller's function, of the memory, SystemExit or KeyboardInterrupt, is raised unchanged on the rank where
            it occurred. The other ranks raise an LCPError that names it.
        """
        raised: BaseException | None = None
        value: Any = None
        try:
            value = attempt()
        except BaseException as error:  # for any error: the other ranks must not wait indefinitely
            raised = error
        failures = self.comm.allgather(None if raised is None else _described(raised))
        if not any(failures):
            return value
        if raised is not None and not isinstance(raised, LCPError | OSError):
            raise raised
        failed = ((rank, what) for rank, what in enumerate(failures) if what is not None)
        rank, (kind, message) = next(failed)
        raise kind(f"rank {rank}: {message}" if self.size > 1 else message) from raised

    def from_first(self, attempt: Callable[[], T]) -> T:
        """Call `attempt` on rank 0; return its value, or raise its error, on every rank."""
        value = self.together(lambda: attempt() if self.rank == 0 else None)
        return self.comm.bcast(value, root=0)

    def require_same(self, what: str, value: Any, remedy: str, error: Any = InvalidProblem) -> None:
        """Raise an error on every rank unless all ranks hold the same value, compared by `repr`."""
        values = self.comm.allgather(repr(value))
        for rank, other in enumerate(values):
            if other != values[0]:
                raise error(
                    f"{what} differs: {values[0]} on rank 0, {other} on rank {rank}; {remedy}"
                )


def _described(error: BaseException) -> tuple[type[LCPError], str]:
    if isinstance(error, LCPError):
        return type(error), str(error)
    if isinstance(error, OSError):
        what = f"cannot read or write {error.filename or 'a file'}: {error.strerror or error}"
        return UnreadableFile, what
    return LCPError, f"{type(error).__name__}: {error}".removesuffix(": ")


@contextmanager
def deferred_interruptions() -> Iterator[Callable[[], bool]]:
    """Turn Ctrl-C into a request to all ranks, which the yielded function returns; a second Ctrl-C ends this rank."""
    requests: list[int] = []

    def hear(number: int, _: object) -> None:
        if requests:
            raise KeyboardInterrupt
        requests.append(number)

    is_main = threading.current_thread() is threading.main_thread()
    before = signal.signal(signal.SIGINT, hear) if is_main else None
    try:
        yield lambda: bool(requests)
    finally:
        if before is not None:
            signal.signal(signal.SIGINT, before)


NOBODY = np.empty(0, np.int64)


class ForeignRows(NamedTuple):
    """Rows of other ranks: entries per row, global columns, values, positions on their rank."""

    counts: Indices
    columns: NDArray[Any]
    values: Vector
    places: Indices


class Exchange:
    """Sender of values to the ranks that need copies, always of the same unknowns.

    Parameters
    ----------
    comm : communicator of mpi4py
    count : int
        Number of values of this rank; the copies of other ranks' values follow them.
    places : array of int, shape (k, 2)
        Rank, and position on that rank, of each copied value.
    """

    def __init__(self, comm: Any, count: int, places: Indices) -> None:
        self._comm, self._own = comm, count
        self._order = np.argsort(places[:, 0], kind="stable")
        self._received = np.bincount(places[:, 0], minlength=comm.size)
        requested = np.split(places[self._order, 1], np.cumsum(self._received)[:-1])
        requests = comm.alltoall(requested)
        self._sent = np.array([part.size for part in requests])
        self._which = np.concatenate(requests)

    def __call__(self, values: Vector) -> None:
        """Overwrite the copies, which follow the local values."""
        copies = np.empty(self._order.size)
        self._comm.Alltoallv([values[self._which], self._sent], [copies, self._received])
        values[self._own + self._order] = copies


class Halo(Ranks):
    """Consecutive ranges of rows in the order of the ranks; `fetch` updates the ghost values.

    Parameters
    ----------
    comm : communicator of mpi4py
    count : int
        Number of rows of this rank; may be 0.
    ghosts : array of int
        Global indices of the ghosts, none twice.
    entries : int and array of int, shape (k, 2), optional
        If rows of ghosts follow the local rows: number of entries of the local rows; rank, and position on that rank,
        of each entry of the ghosts' rows.
    starts : array of int, shape (ranks + 1,), optional
        First row of each rank, if it is known; gathered from all ranks otherwise.
    """

    def __init__(
        self,
        comm: Any,
        count: int,
        ghosts: Indices = NOBODY,
        entries: tuple[int, Indices] | None = None,
        starts: Indices | None = None,
    ) -> None:
        super().__init__(comm)
        self.starts = np.cumsum([0, *self.comm.allgather(int(count))]) if starts is None else starts
        self.own, self.n = int(count), int(self.starts[-1])
        self.ghosts, self.foreign = ghosts, int(ghosts.size)
        self.first, self.last = int(self.starts[self.rank]), int(self.starts[self.rank + 1])
        self.is_empty = not any(self.comm.allgather(self.foreign))
        if self.is_empty:
            return
        owners = self.owners(ghosts)
        places = np.stack([owners, ghosts - self.starts[owners]], axis=1)
        self._values = Exchange(self.comm, count, places)
        self._entries = None if entries is None else Exchange(self.comm, *entries)

    def owners(self, indices: Indices) -> Indices:
        """Return the rank that owns each index."""
        return np.searchsorted(self.starts, indices, side="right") - 1

    def is_foreign(self, indices: NDArray[Any]) -> NDArray[np.bool_]:
        """Return the mask of the indices that belong to other ranks."""
        return (indices < self.first) | (indices >= self.last)

    # --- values ------------------------------------------------------------------------------------------

    def fetch(self, x: Vector) -> None:
        """Overwrite the ghost values, which follow the local ones in x, shape (own + foreign,)."""
        if not self.is_empty:
            self._values(x)

    def whole(self, local: Vector) -> Vector:
        """Return a copy of the local values and the ghost values, shape (own + foreign,)."""
        x = np.zeros(self.own + self.foreign)
        x[: self.own] = local
        self.fetch(x)
        return x

    def fetch_entries(self, data: Vector) -> None:
        """Overwrite the entries of the ghosts' rows, which follow the entries of the local rows."""
        if not self.is_empty and self._entries is not None:
            self._entries(data)

    def fetch_flags(self, flags: NDArray[Any]) -> None:
        """Do as `fetch` does with flags."""
        flags[self.own :] = self.whole(flags[: self.own])[self.own :] > 0.0

    # --- a coarser grid ----------------------------------------------------------------------------------

    def outside(self, columns: Indices) -> Indices:
        """Return the unknowns, global indices, that belong to other ranks, ascending."""
        return np.unique(columns[self.is_foreign(columns)]).astype(np.int64)

    def local(self, columns: NDArray[Any], ghosts: Indices) -> NDArray[np.int32]:
        """Return local indices: local unknowns from 0 on, then ghosts in order, 0 for others."""
        local = (columns - self.first).astype(np.int32)
        is_foreign = self.is_foreign(columns)
        foreign = columns[is_foreign]
        local[is_foreign] = 0
        if ghosts.size:
            order = np.argsort(ghosts, kind="stable")
            place = np.searchsorted(ghosts, foreign, sorter=order)
            place = order[np.minimum(place, ghosts.size - 1)]
            local[is_foreign] = np.where(ghosts[place] == foreign, self.own + place, 0)
        return local

    def with_foreign_rows(self, rows: Arrays) -> Arrays:
        """Return the local rows, then the ghosts' rows in their ranks' order, in global columns."""
        indptr, columns, data = rows
        if self.is_empty:
            return rows
        foreign = self._foreign_rows(self.ghosts, indptr, data, lambda places: columns[places])
        return _appended(rows, foreign)

    def overlapped(self, rows: Arrays, ghosts: Indices, further: Indices) -> tuple[Arrays, Halo]:
        """Return the local rows, then the rows of adjacent ghosts, and the halo of the columns.

        Parameters
        ----------
        rows : CSR arrays
            The local rows, sorted; column own + k is the unknown ghosts[k].
        ghosts : array of int
            Ascending; some of them may have no entry.
        further : array of int
            Ghosts to include in any case.

        Notes
        -----
        A ghost is adjacent if a local row has an entry in its column, or its row in a local column. The ghosts of the
        new halo are first the ghosts with stored rows, then the others.
        """
        count = self.own
        indptr, indices, data = rows
        at = np.flatnonzero(indices >= count)
        met = ghosts[indices[at] - count]
        near = np.union1d(
            met, self._dependents(np.searchsorted(indptr, at, side="right") - 1 + self.first, met)
        )
        if not any(self.comm.allgather(near.size + further.size)):
            return rows, Halo(self.comm, count, near, starts=self.starts)
        if not np.array_equal(near, ghosts):  # both ascend: the rows stay sorted
            indices = indices.copy()
            indices[at] = count + np.searchsorted(near, met)

        def global_columns(places: Indices) -> Indices:
            columns = indices[places].astype(np.int64)
            is_foreign = columns >= count
            columns[~is_foreign] += self.first
            columns[is_foreign] = near[columns[is_foreign] - count]
            return columns

        foreign = self._foreign_rows(near, indptr, data, global_columns)
        outside = foreign.columns[self.is_foreign(foreign.columns)]
        far = np.setdiff1d(np.concatenate([outside, further]), near)
        all_ghosts = np.concatenate([near, far])
        local = self.local(foreign.columns, all_ghosts)
        order = np.lexsort((local, np.repeat(np.arange(near.size), foreign.counts)))
        owners = np.repeat(self.owners(near), foreign.counts)
        entries = np.stack([owners, foreign.places], axis=1)[order]
        foreign = foreign._replace(columns=local[order], values=foreign.values[order])
        rows = _appended((indptr, indices, data), foreign)
        return rows, Halo(self.comm, count, all_ghosts, (data.size, entries), self.starts)

    def _foreign_rows(
        self, wanted: Indices, indptr: Indices, data: Vector, columns: Callable[..., Indices]
    ) -> ForeignRows:
        """Return the rows `wanted`, global indices in any order; all ranks call.

        Parameters
        ----------
        wanted : array of int
            Global indices of rows of other ranks.
        indptr, data : arrays
            The local rows in CSR, which other ranks may request.
        columns : callable
            Function from positions of entries to their global columns.
        """
        owners = self.owners(wanted)
        order, ranks = np.argsort(owners, kind="stable"), range(self.size)
        asked = [wanted[owners == rank] - self.starts[rank] for rank in ranks]
        replies = []
        for rows in self.comm.alltoall(asked):
            counts = (indptr[rows + 1] - indptr[rows]).astype(np.int64)
            places = _ranges(indptr[rows].astype(np.int64), counts)
            replies.append((counts, columns(places).astype(np.int64), data[places], places))
        parts = [np.concatenate(part) for part in zip(*self.comm.alltoall(replies), strict=True)]
        place_of = np.argsort(order)
        begins = np.cumsum(parts[0]) - parts[0]
        counts = parts[0][place_of]
        take = _ranges(begins[place_of], counts)
        return ForeignRows(counts, parts[1][take], parts[2][take], parts[3][take])

    def _dependents(self, rows: Indices, met: Indices) -> Indices:
        """Return the ghosts whose rows have local columns; local `rows` have the columns `met`."""
        owners = self.owners(met)
        sent = [np.unique(rows[owners == rank]) for rank in range(self.size)]
        return np.concatenate(self.comm.alltoall(sent))


def _appended(rows: Arrays, foreign: ForeignRows) -> Arrays:
    indptr, indices, data = rows
    return (
        np.concatenate([indptr, indptr[-1] + np.cumsum(foreign.counts, dtype=indptr.dtype)]),
        np.concatenate([indices, foreign.columns.astype(indices.dtype)]),
        np.concatenate([data, foreign.values]),
    )


def _ranges(begins: Indices, counts: Indices) -> Indices:
    """Return begins[0], begins[0] + 1, … counts[0] of them, then the same for the next."""
    return np.repeat(begins - (np.cumsum(counts) - counts), counts) + np.arange(int(counts.sum()))


def own_rows(ranks: Halo, matrix: sp.csr_array) -> tuple[sp.csr_array, Halo]:
    """Return the local rows in local columns, first local unknowns, then ghosts; and the halo.

    Parameters
    ----------
    ranks : Halo
        Halo of the columns.
    matrix : csr_array, shape (own, n)
        Canonical; columns counted over all ranks.
    """
    ghosts = ranks.outside(matrix.indices)
    indptr = matrix.indptr.astype(np.int32, copy=False)
    parts = (matrix.data, ranks.local(matrix.indices, ghosts), indptr)
    width = ranks.own + ghosts.size
    rows = sp.csr_array(parts, shape=(matrix.shape[0], width))
    if ghosts.size:
        rows.data = rows.data.copy()  # the caller's stay in their order
        rows.sort_indices()
    return freeze_csr(rows), Halo(ranks.comm, ranks.own, ghosts, starts=ranks.starts)
