"""Threads for compiled loops: the rows of one large problem, or many small problems, are split into pieces.

Starting a thread costs about 50 µs, more if other programs use the cores. The calling thread therefore processes all
pieces that no thread has begun, and waits only for started pieces.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import contextmanager
from contextvars import ContextVar, copy_context
from functools import cache
from typing import Any, TypeVar

T = TypeVar("T")
MAX_THREADS = 128  # to begin more takes longer than the work that they share

_threads: ContextVar[int] = ContextVar("threads", default=1)


@cache
def usable_threads() -> int:
    """Return the number of threads that the process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@contextmanager
def threads_for(count: int | None) -> Iterator[None]:
    """Let the work inside a ``with`` statement use `count` threads; None means all that the process may use.

    Examples
    --------
    >>> with threads_for(3):
    ...     threads_now()
    3
    >>> threads_now()
    1
    """
    token = _threads.set(min(count or usable_threads(), MAX_THREADS))
    try:
        yield
    finally:
        _threads.reset(token)


def threads_now() -> int:
    """Return the number of threads that may share work here: 1 by default, and inside a chunk of shared work."""
    return _threads.get()


@cache
def _executor() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(MAX_THREADS, "lcp_plugin")


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_executor.cache_clear)
    # workers may have some cores only
    os.register_at_fork(after_in_child=usable_threads.cache_clear)


def share(work: Callable[[int, int], T], count: int, smallest: int) -> list[T]:
    """Return the values of ``work(first, end)`` for consecutive pieces of 0 ≤ k < count, in order.

    Parameters
    ----------
    work : callable
        Other threads may call it, in a copy of this thread's context. It must not wait for a lock that this thread may
        hold, as the facts of a matrix do.
    count : int
    smallest : int
        No piece is shorter, unless count is; there are as many as threads, or fewer.

    Raises
    ------
    Exception
        The exception of a failed chunk, when all started chunks have ended; also after Ctrl-C.

    Examples
    --------
    >>> with threads_for(2):
    ...     share(lambda first, end: (first, end), 10, 4)
    [(0, 5), (5, 10)]
    """
    threads = _threads.get()
    if threads == 1 or count < 2 * smallest:
        return [work(0, count)]
    pieces = min(threads, count // max(smallest, 1))
    return shared_among(work, [k * count // pieces for k in range(pieces + 1)], threads)


def shared_among(work: Callable[[int, int], T], ends: Sequence[int], threads: int) -> list[T]:
    """Return the values of ``work`` on the pieces between consecutive ends, computed by this thread and helpers."""
    count = len(ends) - 1
    pieces, values = iter(range(count)), list[Any]([None]) * count

    def take_pieces() -> None:
        _threads.set(1)
        try:
            for k in pieces:  # each piece goes to one thread
                values[k] = work(ends[k], ends[k + 1])
        except BaseException:
            for _ in pieces:  # none is begun after an error
                pass
            raise

    submit = _executor().submit
    helpers = [submit(copy_context().run, take_pieces) for _ in range(min(threads, count) - 1)]
    interruption: BaseException | None = None
    try:
        copy_context().run(take_pieces)
    except BaseException as error:
        interruption = error
    helpers = [helper for helper in helpers if not helper.cancel()]
    while True:
        try:
            wait(helpers)
            break
        except KeyboardInterrupt as error:  # pieces under way still write
            interruption = error
    if interruption is not None:
        raise interruption
    for helper in helpers:
        helper.result()
    return values
