"""The clock of a run, the seconds it has left, and what it has compiled.

Compilation counts against no limit, in whichever run inside a run it happens. Locks between threads are open in the
child of a fork: it has one thread, and no other could let go.
"""

from __future__ import annotations

import gc
import math
import os
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from contextvars import ContextVar
from weakref import WeakSet

AT_LEAST = 0.1  # seconds


class Lock:
    """A reentrant lock, free in the child of a fork whoever held it in the parent.

    What it guards must be whole at every moment: computed first, then stored at once.

    Examples
    --------
    >>> lock = Lock()
    >>> with lock.held():
    ...     print("alone")
    alone
    """

    def __init__(self) -> None:
        self.renew()
        _all.add(self)

    def renew(self) -> None:
        """Become free; for a process in which no other thread is left."""
        self._lock = threading.RLock()

    def held(self) -> AbstractContextManager[bool]:
        """Hold it, in a ``with`` statement."""
        return self._lock


_all: WeakSet[Lock] = WeakSet()


def _renew_all() -> None:
    for lock in _all:
        lock.renew()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_renew_all)


# Until when, on the clock that compilation stops, and whether that is enforced.
_limit: ContextVar[tuple[float, bool]] = ContextVar("limit", default=(math.inf, False))


class OutOfTimeError(Exception):
    """Work that cannot be divided would end after the limit of a run; who set the limit ends the run."""


class Compilation:
    """The seconds that a thread has spent on compilation since it began."""

    seconds = 0.0


_compilation: ContextVar[Compilation] = ContextVar("compilation")


def compilation() -> Compilation:
    """Return that of the thread at work."""
    found = _compilation.get(None)
    if found is None:
        _compilation.set(found := Compilation())
    return found


@contextmanager
def compiling() -> Iterator[None]:
    """Stop the clocks of all runs around, and their limits, inside a ``with`` statement."""
    own = compilation()
    began, before = time.perf_counter(), own.seconds
    try:
        yield
    finally:
        own.seconds = before + time.perf_counter() - began


class Clock:
    """The seconds of a run. Pauses are not its own; against a time limit all count but those for compilation.

    Those are not counted in runs inside this one either.

    Attributes
    ----------
    elapsed : float
        Seconds that count against the limit, up to the last reading.
    """

    def __init__(self) -> None:
        self._compilation = compilation()  # of the thread that runs; others may read
        self._began = time.perf_counter() - self._compilation.seconds
        self._paused = self.elapsed = 0.0

    def read(self) -> float:
        """Return the seconds of the run up to now."""
        self.elapsed = time.perf_counter() - self._compilation.seconds - self._began
        return self.elapsed - self._paused

    @contextmanager
    def paused(self) -> Iterator[None]:
        """Take off what happens inside a ``with`` statement: the algorithm did not need it."""
        own = self._compilation
        began = time.perf_counter() - own.seconds
        try:
            yield
        finally:
            self._paused += time.perf_counter() - own.seconds - began


class NewKernels:
    """What this process compiles because no cache has it, for those who tell the user why there is a wait.

    Python's collector of garbage rests meanwhile: a tenth of a compilation would be its search in what is still in use.
    """

    def __init__(self) -> None:
        self._lock = Lock()
        self._under_way, self._began, self._before, self._collects = 0, 0.0, 0.0, False
        self.watchers: list[
            Callable[[], None]
        ] = []  # called when compilation begins and when it has ended

    @property
    def is_under_way(self) -> bool:
        """Whether a thread compiles."""
        return self._under_way > 0

    @property
    def seconds(self) -> float:
        """Those in which some thread has compiled, up to now."""
        with self._lock.held():
            return self._before + (time.perf_counter() - self._began if self._under_way else 0.0)

    @contextmanager
    def compiling(self) -> Iterator[None]:
        """Compile inside a ``with`` statement, the clocks of all runs around stopped."""
        with compiling():
            self._count(1)
            try:
                yield
            finally:
                self._count(-1)

    @contextmanager
    def watched_by(self, watcher: Callable[[], None]) -> Iterator[None]:
        """Let this be one of the watchers inside a ``with`` statement."""
        self.watchers.append(watcher)
        try:
            yield
        finally:
            self.watchers.remove(watcher)

    def _count(self, change: int) -> None:
        with self._lock.held():
            now = time.perf_counter()
            if self._under_way:
                self._before += now - self._began
            else:
                self._collects = gc.isenabled()
                gc.disable()
            self._began, self._under_way = now, self._under_way + change
            if not self._under_way and self._collects:
                gc.enable()
        for watcher in list(self.watchers):
            watcher()


NEW_KERNELS = NewKernels()


def _now() -> float:
    return time.perf_counter() - compilation().seconds


@contextmanager
def time_limit(seconds: float, *, is_enforced: bool = False) -> Iterator[None]:
    """Let what runs inside know that it ends so many seconds from now.

    Where the limit is enforced, work that cannot be divided is not begun where it is predicted to end later:
    OutOfTimeError, which the caller expects.
    """
    token = _limit.set((_now() + seconds, is_enforced))
    try:
        yield
    finally:
        _limit.reset(token)


def seconds_left() -> float:
    """Return the seconds until the limit, a tenth of one at least; ∞ where there is none.

    Examples
    --------
    >>> seconds_left()
    inf
    >>> with time_limit(0.0):
    ...     seconds_left()
    0.1
    """
    return max(_limit.get()[0] - _now(), AT_LEAST)


def enforced_seconds_left() -> float:
    """Return the seconds until the limit, less than 0 beyond it; ∞ where none is enforced."""
    until, is_enforced = _limit.get()
    return until - _now() if is_enforced else math.inf


def require_seconds(predicted: float) -> None:
    """Raise OutOfTimeError where work that cannot be divided is predicted to end after an enforced limit.

    Examples
    --------
    >>> with time_limit(1.0, is_enforced=True):
    ...     require_seconds(60.0)
    Traceback (most recent call last):
    lcp_plugin.core.deadline.OutOfTimeError
    """
    if predicted > enforced_seconds_left():
        raise OutOfTimeError


def is_over() -> bool:
    """Return whether the limit has passed: what comes out of long work now comes too late."""
    return _now() > _limit.get()[0]
