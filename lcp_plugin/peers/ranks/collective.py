"""What all ranks do together: agree on a number, on a failure, on an end.

Every sum is taken in the order of the ranks, so that a run on a given number of ranks repeats bit for bit.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np
from mpi4py import MPI

from ...checks import FloatVector
from ...errors import InvalidProblem, LCPError, UnreadableFile

T = TypeVar("T")


def as_mpi(comm: Any) -> MPI.Comm:
    """Return the mpi4py communicator of a communicator of mpi4py or petsc4py; of None the one of the whole job."""
    if comm is None:
        return MPI.COMM_WORLD
    if hasattr(comm, "tompi4py"):
        comm = comm.tompi4py()
    if not isinstance(comm, MPI.Comm):
        raise InvalidProblem(f"comm must be a communicator of mpi4py or petsc4py, got {type(comm).__name__}")
    return comm


def gathered(comm: MPI.Comm, *numbers: float) -> FloatVector:
    """Return the numbers of all ranks, shape (ranks, how many)."""
    own = np.array(numbers, dtype=np.float64)
    of_all = np.empty((comm.size, own.size))
    comm.Allgather(own, of_all)
    return of_all


def largest(comm: MPI.Comm, *numbers: float) -> tuple[float, ...]:
    """Return the maximum over the ranks of each number; a NaN stays."""
    return tuple(gathered(comm, *numbers).max(axis=0).tolist())


def total(comm: MPI.Comm, *numbers: float) -> tuple[float, ...]:
    """Return the sum over the ranks of each number, in the order of the ranks."""
    if comm.size == 1:
        return numbers
    with np.errstate(over="ignore", invalid="ignore"):
        return tuple(gathered(comm, *numbers).sum(axis=0).tolist())


def together(comm: MPI.Comm, attempt: Callable[[], T]) -> T:
    """Return what `attempt` gives on each rank; where it fails on one, no rank goes on.

    Parameters
    ----------
    comm : mpi4py communicator
    attempt : callable
        Without arguments; must not wait for other ranks.

    Raises
    ------
    LCPError
        On every rank the error of the lowest rank that failed, which it names. What is no LCPError, as a caller's
        function or too little memory may raise, is passed on as it is where it was raised, and is named by an LCPError
        on the other ranks.
    """
    raised: Exception | None = None
    value: Any = None
    try:
        value = attempt()
    except Exception as error:  # whatever it is, the other ranks must not wait for ever
        raised = error
    failures = comm.allgather(None if raised is None else _described(raised))
    if not any(failures):
        result: T = value
        return result
    if raised is not None and not isinstance(raised, LCPError | OSError):
        raise raised
    rank, (kind, message) = next((rank, one) for rank, one in enumerate(failures) if one is not None)
    raise kind(f"rank {rank}: {message}" if comm.size > 1 else message) from raised


def _described(error: Exception) -> tuple[type[LCPError], str]:
    if isinstance(error, LCPError):
        return type(error), str(error)
    if isinstance(error, OSError):
        return UnreadableFile, str(error)
    return LCPError, f"{type(error).__name__}: {error}".removesuffix(": ")


def require_same(
    comm: MPI.Comm, what: str, value: Any, remedy: str, error: type[LCPError] = InvalidProblem
) -> None:
    """Raise that error on every rank unless all of them hold the same value, as its `repr` tells."""
    values = comm.allgather(repr(value))
    for rank, other in enumerate(values):
        if other != values[0]:
            raise error(f"{what} differs: {values[0]} on rank 0, {other} on rank {rank}; {remedy}")


def from_first(comm: MPI.Comm, attempt: Callable[[], T]) -> T:
    """Return on every rank what `attempt` gives on rank 0; where it fails there, raise as :func:`together` does."""
    value = together(comm, lambda: attempt() if comm.rank == 0 else None)
    result: T = comm.bcast(value, root=0)
    return result
