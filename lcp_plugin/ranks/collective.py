"""Collective operations of the ranks: sums, maxima, and errors that all ranks raise.

Every sum is taken in the order of the ranks, so that a run on a given number of ranks repeats bit for bit.
"""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from ..core.checks import FloatVector
from ..core.errors import InvalidOption, InvalidProblem, LCPError, UnreadableFile

try:
    from mpi4py import MPI
except (ImportError, RuntimeError) as error:  # mpi4py without an MPI library raises the latter
    raise InvalidOption(
        f"several ranks need mpi4py and an MPI library ({error}); pip install '.[mpi]'"
    ) from None

T = TypeVar("T")


class Ranks:
    """Processes of a communicator of mpi4py, and collective decisions; None is the whole job."""

    def __init__(self, comm: Any) -> None:
        self.comm = MPI.COMM_WORLD if comm is None else comm
        if not isinstance(self.comm, MPI.Comm):
            raise InvalidProblem(
                f"comm must be a communicator of mpi4py, got {type(comm).__name__}"
            )
        self.size, self.rank = self.comm.size, self.comm.rank

    def table(self, *numbers: float) -> FloatVector:
        """Return the numbers of all ranks, shape (ranks, how many)."""
        own = np.array(numbers, dtype=np.float64)
        of_all = np.empty((self.size, own.size))
        self.comm.Allgather(own, of_all)
        return of_all

    def allgather_rows(self, own: NDArray[Any]) -> NDArray[Any]:
        """Return the rows of all ranks' tables one after the other, shape (all, columns), on every rank."""
        return np.concatenate(self.comm.allgather(own))

    def places(self, count: int) -> tuple[int, int]:
        """Return the offset of this rank, which has `count` items, and the number of all items."""
        counts = self.comm.allgather(count)
        return sum(counts[: self.rank]), sum(counts)

    def largest(self, values: Any) -> float:
        """Return the largest of all ranks' values ≥ 0, arrays or one number each; a NaN stays."""
        here = values.max(initial=0.0) if isinstance(values, np.ndarray) else values
        return self.all_largest(float(here))[0]

    def all_largest(self, *values: float) -> tuple[float, ...]:
        """Return the largest of each of them."""
        return tuple(self.table(*values).max(axis=0).tolist())

    def total(self, value: float) -> float:
        """Return the sum of all ranks' values, in the order of the ranks."""
        if self.size == 1:
            return value
        return float(self.table(value).sum(axis=0)[0])

    def everywhere(self, is_so: Any) -> bool:
        """Return whether it is so on every rank, in every row of an array."""
        return self.all_largest(float(not np.all(is_so)))[0] == 0.0

    def anywhere(self, is_so: Any) -> bool:
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
            a caller's function or of the memory, is raised unchanged on the rank where it occurred. The other ranks
            raise an LCPError that names it.
        """
        raised: Exception | None = None
        value: Any = None
        try:
            value = attempt()
        except Exception as error:  # for any error: the other ranks must not wait indefinitely
            raised = error
        failures = self.comm.allgather(None if raised is None else _described(raised))
        if not any(failures):
            result: T = value
            return result
        if raised is not None and not isinstance(raised, LCPError | OSError):
            raise raised
        rank, (kind, message) = next(
            (rank, one) for rank, one in enumerate(failures) if one is not None
        )
        raise kind(f"rank {rank}: {message}" if self.size > 1 else message) from raised

    def from_first(self, attempt: Callable[[], T]) -> T:
        """Call `attempt` on rank 0; return its value, or raise its error, on every rank."""
        value = self.together(lambda: attempt() if self.rank == 0 else None)
        result: T = self.comm.bcast(value, root=0)
        return result

    def require_same(self, what: str, value: Any, remedy: str, error: Any = InvalidProblem) -> None:
        """Raise an error on every rank unless all ranks hold the same value, compared by `repr`."""
        values = self.comm.allgather(repr(value))
        for rank, other in enumerate(values):
            if other != values[0]:
                raise error(
                    f"{what} differs: {values[0]} on rank 0, {other} on rank {rank}; {remedy}"
                )


def _described(error: Exception) -> tuple[type[LCPError], str]:
    if isinstance(error, LCPError):
        return type(error), str(error)
    if isinstance(error, OSError):
        what = f"cannot read or write {error.filename or 'a file'}: {error.strerror or error}"
        return UnreadableFile, what
    return LCPError, f"{type(error).__name__}: {error}".removesuffix(": ")


class Interruptions:
    """Handler of Ctrl-C: a request to all ranks at the next step; a second one ends this rank."""

    def __init__(self) -> None:
        self._is_asked = False
        self._before: Any = None

    def __enter__(self) -> Callable[[], bool]:
        if threading.current_thread() is threading.main_thread():
            self._before = signal.signal(signal.SIGINT, self._hear)
        return lambda: self._is_asked

    def __exit__(self, *_: object) -> None:
        if self._before is not None:
            signal.signal(signal.SIGINT, self._before)

    def _hear(self, *_: object) -> None:
        if self._is_asked:
            raise KeyboardInterrupt
        self._is_asked = True
