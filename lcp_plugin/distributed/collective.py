"""What all ranks do together: agree on a number, on a failure, on an end.

Every sum is taken in the order of the ranks, so that a run on a given number of ranks repeats bit for bit.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np
from mpi4py import MPI

from ..errors import InvalidProblem, LCPError
from ..problem import FloatVector

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
    everybody_s = np.empty((comm.size, own.size))
    comm.Allgather(own, everybody_s)
    return everybody_s


def largest(comm: MPI.Comm, *numbers: float) -> tuple[float, ...]:
    """Return the maximum over the ranks of each number; a NaN stays."""
    return tuple(gathered(comm, *numbers).max(axis=0).tolist())


def total(comm: MPI.Comm, *numbers: float) -> tuple[float, ...]:
    """Return the sum over the ranks of each number, in the order of the ranks."""
    if comm.size == 1:
        return numbers
    return tuple(math.fsum(column) if np.isfinite(column).all() else float(column.sum())
                 for column in gathered(comm, *numbers).T)


def together(comm: MPI.Comm, attempt: Callable[[], T]) -> T:
    """Return what `attempt` gives on each rank; where it fails on one, raise its error on all.

    Raises
    ------
    LCPError
        The error of the lowest rank that failed, which it names. Not enough memory and unreadable files count as well.
    """
    failure: tuple[type[Exception], str] | None = None
    value: Any = None
    try:
        value = attempt()
    except (LCPError, MemoryError, OSError) as error:
        kind = type(error) if isinstance(error, LCPError) else InvalidProblem
        failure = kind, str(error) or "not enough memory"
    failures = comm.allgather(failure)
    for rank, one in enumerate(failures):
        if one is not None:
            kind, message = one
            raise kind(f"rank {rank}: {message}" if comm.size > 1 else message)
    result: T = value
    return result


def require_same(comm: MPI.Comm, what: str, value: Any, remedy: str) -> None:
    """Raise InvalidProblem on every rank unless all of them hold the same value."""
    values = comm.allgather(value)
    for rank, other in enumerate(values):
        if other != values[0]:
            raise InvalidProblem(f"{what} differs: {values[0]!r} on rank 0, {other!r} on rank {rank}; {remedy}")
