"""Which processes hold the other rows of a matrix; here none does.

A vector with space for all that the own rows meet holds the own values first and behind them those of foreign unknowns.
What is computed from all rows is asked of everybody, so that every process takes the same decisions: all of them ask
the same questions in the same order.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from .checks import Arrays, FloatVector

T = TypeVar("T")
NOBODY = np.empty(0, np.int64)
AS_IT_IS: AbstractContextManager[Callable[[], bool]] = nullcontext(bool)


class Communicator:
    """The processes that share the rows of a matrix, this one among them: it alone, so that nothing is to be done.

    Attributes
    ----------
    comm : mpi4py communicator, or None
    is_alone : bool
        True where one process holds all rows.
    is_empty : bool
        True where no process needs a foreign value; then nothing is ever sent.
    size, rank : int
        How many processes there are, and which one this is.
    first : int
        The own rows begin with this one.
    foreign : int
        How many foreign unknowns the own rows meet.
    ghosts : array of int, shape (foreign,)
        Which.
    """

    comm: Any = None
    is_alone = is_empty = True
    size, rank, first, foreign = 1, 0, 0, 0
    ghosts = NOBODY

    # --- values ------------------------------------------------------------------------------------------

    def fetch(self, x: FloatVector) -> None:
        """Overwrite the foreign values in x, shape (own + foreign,), by the owners' values."""

    def fetch_flags(self, flags: NDArray[np.bool_]) -> None:
        """Do the same with flags."""

    def fetch_entries(self, data: FloatVector) -> None:
        """Overwrite the entries of the foreign rows, which stand behind those of the own rows."""

    def gathered(self, own: FloatVector) -> FloatVector | None:
        """Return everybody's parts one after the other on rank 0, None on the others."""
        return own

    def everybodys(self, own: NDArray[Any]) -> NDArray[Any]:
        """Return the rows of everybody's tables one after the other, shape (all, columns), on every process."""
        return own

    # --- what all agree on -------------------------------------------------------------------------------

    def places(self, count: int) -> tuple[int, int]:
        """Return how many things the processes before this one have, which has `count`, and how many all have."""
        return 0, count

    def largest(self, value: float) -> float:
        """Return the largest of everybody's values; a NaN stays."""
        return value

    def all_largest(self, *values: float) -> tuple[float, ...]:
        """Return the largest of each of them."""
        return values

    def total(self, value: float) -> float:
        """Return the sum of everybody's values."""
        return value

    def everywhere(self, is_so: bool) -> bool:
        """Return whether it is so on every process."""
        return is_so

    def anywhere(self, is_so: bool | np.bool_) -> bool:
        """Return whether it is so on one process or more."""
        return not self.everywhere(not is_so)

    def worst(self, value: float, row: int) -> tuple[float, int]:
        """Return the largest value ≥ 0, NaN before any other, and its row of the whole matrix; 0 and −1 of no row.

        Given are those of the own rows, counted from 0, with −1 for no row.
        """
        return value, row

    def together(self, attempt: Callable[[], T]) -> T:
        """Return what `attempt`, which waits for no other process, gives here; where one fails, raise on all."""
        return attempt()

    def from_first(self, attempt: Callable[[], T]) -> T:
        """Return everywhere what `attempt` gives on the first process; where it fails there, raise on all."""
        return attempt()

    def require_same(self, what: str, value: Any, remedy: str, error: Any = None) -> None:
        """Raise that error on every process unless all of them hold the same value."""

    def interruptions(self) -> AbstractContextManager[Callable[[], bool]]:
        """Return a context that tells whether Ctrl-C asked this process to end; alone, that raises as ever."""
        return AS_IT_IS

    # --- a coarser grid ----------------------------------------------------------------------------------

    def coarser(self, own: int) -> Communicator:
        """Return those who share a grid on which this process has so many unknowns, and meets no foreign one yet."""
        return self

    def outside(self, columns: NDArray[Any]) -> NDArray[Any]:
        """Return which of these unknowns, counted over all processes, are foreign, ascending."""
        return NOBODY

    def local(self, columns: NDArray[Any], ghosts: NDArray[Any]) -> NDArray[Any]:
        """Return the unknowns as counted here: the own ones from 0 on, then the ghosts in order, 0 for others."""
        return columns

    def with_foreign_rows(self, rows: Arrays) -> Arrays:
        """Return the own rows, columns counted over all processes, with those of the ghosts behind."""
        return rows

    def overlapped(
        self, rows: Arrays, ghosts: NDArray[Any], further: NDArray[Any]
    ) -> tuple[Arrays, Communicator]:
        """Return the own rows with those of the unknowns next to them behind, and the ranks of all unknowns met."""
        return rows, self


ALONE = Communicator()


class SharedRows:
    """The rows of a matrix or a grid, all here or spread over processes, and what is taken over all of them.

    Every process gives its own part and gets the same answer. On several all of them call, in the same order.
    """

    communicator: Communicator = ALONE

    @property
    def is_distributed(self) -> bool:
        """True where the rows are spread over the ranks of an MPI job."""
        return not self.communicator.is_alone

    @property
    def processes(self) -> int:
        """How many processes hold rows."""
        return self.communicator.size

    @property
    def rank(self) -> int:
        """Which of them this is, from 0 on."""
        return self.communicator.rank

    @property
    def foreign(self) -> int:
        """How many unknowns of other processes the own rows meet."""
        return self.communicator.foreign

    @property
    def is_coupled(self) -> bool:
        """True where rows of some process meet unknowns of another one."""
        return not self.communicator.is_empty

    @property
    def first(self) -> int:
        """The index of the first row that is here."""
        return self.communicator.first

    def all_rows(self, flags: Any) -> bool:
        """Return whether every row's flag, an array of the own ones or one for all of them, is set."""
        return self.communicator.everywhere(
            bool(flags.all() if isinstance(flags, np.ndarray) else flags)
        )

    def any_row(self, flags: Any) -> bool:
        """Return whether the flag of one row or more is set."""
        return self.communicator.anywhere(
            bool(flags.any() if isinstance(flags, np.ndarray) else flags)
        )

    def count_of(self, flags: NDArray[np.bool_]) -> int:
        """Return how many flags are set."""
        return int(self.total_of(float(np.count_nonzero(flags))))

    def largest_of(self, values: Any) -> float:
        """Return the largest of all rows' values ≥ 0, 0 of none, or of one number a process; a NaN stays."""
        here = values.max(initial=0.0) if isinstance(values, np.ndarray) else values
        return self.communicator.largest(float(here))

    def each_largest(self, *values: float) -> tuple[float, ...]:
        """Return the largest of the first numbers that the processes give, of their second ones, and so on."""
        return self.communicator.all_largest(*values)

    def row_of_largest(self, value: float, own_row: int) -> int:
        """Return the row of the whole matrix with the largest value ≥ 0, of each process's largest; −1 of no row."""
        return self.communicator.worst(value, own_row)[1]

    def total_of(self, value: float) -> float:
        """Return the sum of the numbers that the processes give."""
        return self.communicator.total(value)

    def together(self, attempt: Callable[[], T]) -> T:
        """Return what `attempt`, which waits for no other process, gives here; where one fails, raise on all."""
        return self.communicator.together(attempt)

    def require_same(self, what: str, value: Any, remedy: str, error: Any = None) -> None:
        """Raise that error on every process unless all of them hold the same value."""
        self.communicator.require_same(what, value, remedy, error)

    def interruptions(self) -> AbstractContextManager[Callable[[], bool]]:
        """Return a context that tells whether Ctrl-C asked this process to end; alone, that raises as ever."""
        return self.communicator.interruptions()

    def fetch(self, x: FloatVector) -> None:
        """Overwrite the foreign values in x, shape (width,), by those of the processes that own them."""
        self.communicator.fetch(x)

    def fetch_flags(self, flags: NDArray[np.bool_]) -> None:
        """Do the same with flags."""
        self.communicator.fetch_flags(flags)

    def fetch_entries(self, data: FloatVector) -> None:
        """Overwrite the entries of the foreign rows, which stand behind those of the own rows."""
        self.communicator.fetch_entries(data)
