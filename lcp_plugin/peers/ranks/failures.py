"""No rank waits for ever for one that has failed: all ranks go on, all raise the same, or the job ends."""

from __future__ import annotations

import signal
import sys
import threading
import time
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
from mpi4py import MPI

from ...errors import LCPError
from .collective import as_mpi

ABORTED = 1
PATIENCE = 5.0
PAUSE = 0.001
COURTESY = 0.5  # seconds that other ranks wait before they speak: where all fail alike, one message is enough


@contextmanager
def ends_together(comm: Any = None, *, patience: float = PATIENCE, speaker: str = "lcp_plugin") -> Iterator[None]:
    """Let a block of code end alike on all ranks, or end the whole job.

    Put what calls MPI, directly or through this package, into ``with ends_together(comm):``. Without it an exception
    on one rank leaves the others waiting in their next common call, for ever.

    - The block ends on every rank: nothing happens.
    - Every rank raises an :class:`lcp_plugin.errors.LCPError`, as this package does on purpose, or leaves by
      ``sys.exit``: each goes on to raise its own, so that you can catch it around the block.
    - One rank alone raises anything, or all raise something else: the first such rank writes one message with its
      number to stderr, with the traceback where nobody expects such an exception, and ends all ranks by
      ``comm.Abort``.

    Parameters
    ----------
    comm : communicator of mpi4py or petsc4py; None for the whole job
        All of its ranks enter the block together.
    patience : float
        Seconds that a rank with an LCPError waits for the others to have one too.
    speaker : str
        The first word of the message.

    Notes
    -----
    On one rank exceptions are passed on unchanged. A rank that is killed from outside says nothing: then mpiexec ends
    the others.

    Examples
    --------
    >>> with ends_together(MPI.COMM_WORLD):
    ...     largest = MPI.COMM_WORLD.allreduce(1.0, MPI.MAX)
    >>> largest
    1.0
    """
    mpi = as_mpi(comm)
    if mpi.size == 1:
        yield
        return
    ballot = mpi.Dup()  # no call of the block can take a vote for its own message
    try:
        try:
            yield
        except (LCPError, SystemExit) as error:
            if not _all_failed(ballot, patience):
                _abort(mpi, speaker, error)
            raise
        if not _none_failed(ballot):
            ballot.Barrier()  # for ever: the rank that failed speaks, then ends this one too
    except (LCPError, SystemExit):
        raise
    except BaseException as error:
        _abort(mpi, speaker, error)
        raise
    ballot.Free()


def message_of(error: BaseException) -> str:
    """Return what an exception means, in words for the person at the terminal."""
    if isinstance(error, LCPError):
        return str(error)
    if isinstance(error, MemoryError):
        return f"not enough memory ({error}); use more machines, or choose a smaller problem"
    if isinstance(error, OSError):
        return f"cannot read or write {error.filename or 'a file'}: {error.strerror or error}"
    if isinstance(error, KeyboardInterrupt):
        return "interrupted"
    if isinstance(error, SystemExit):
        return f"left alone, by sys.exit({error.code!r})"
    return f"{type(error).__name__}: {error}"


def _is_bug(error: BaseException) -> bool:
    return not isinstance(error, LCPError | MemoryError | OSError | KeyboardInterrupt | SystemExit)


def _abort(comm: MPI.Comm, speaker: str, error: BaseException) -> None:
    if comm.rank > 0:
        time.sleep(COURTESY)
    stream = sys.__stderr__ or sys.stderr  # a command may have silenced the other one on this rank
    story = "".join(traceback.format_exception(error)) if _is_bug(error) else ""
    stream.write(f"{story}{speaker}: rank {comm.rank} of {comm.size}: {message_of(error)}; all ranks end\n")
    stream.flush()
    comm.Abort(ABORTED)


def _all_failed(ballot: MPI.Comm, patience: float) -> bool:
    votes = _voted(ballot, True, patience)
    return votes is not None and bool(votes.all())


def _none_failed(ballot: MPI.Comm) -> bool:
    votes = _voted(ballot, False, np.inf)
    return votes is not None and not votes.any()


def _voted(ballot: MPI.Comm, has_failed: bool, patience: float) -> Any:
    """Return who has failed, shape (ranks,), or None where somebody does not come to vote in time."""
    votes = np.zeros(ballot.size, dtype=np.uint8)
    request = ballot.Iallgather(np.array([has_failed], dtype=np.uint8), votes)
    until = time.monotonic() + patience
    while not request.Test():
        if time.monotonic() > until:
            return None
        time.sleep(PAUSE)  # leaves the processor to the ranks that still work, and hears Ctrl-C
    return votes.astype(np.bool_)


class Interruptions:
    """Ctrl-C on any rank becomes a wish that all ranks hear of at the next step; a second one ends this rank."""

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
