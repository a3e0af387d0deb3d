"""The clock of a run, the seconds it has left, and how work of other libraries that cannot be divided obeys that.

Compilation counts against no limit, in whichever run inside a run it happens. Locks between threads are open in the
child of a fork: it has one thread, and nobody else in it could let go.
"""

from __future__ import annotations

import _thread
import atexit
import math
import os
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar, copy_context
from typing import TYPE_CHECKING, Any, TypeVar
from weakref import WeakSet

if TYPE_CHECKING:
    from .communicator import Communicator

T = TypeVar("T")
AT_LEAST = 0.1  # seconds
SLICE = 0.1  # seconds between two looks at the clock, and at Ctrl-C where that does not end a wait


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

    @contextmanager
    def held(self) -> Iterator[None]:
        """Hold it, in a ``with`` statement."""
        with self._lock:
            yield


_all: WeakSet[Lock] = WeakSet()


def _renew_all() -> None:
    for lock in _all:
        lock.renew()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_renew_all)


_until: ContextVar[float] = ContextVar("until", default=math.inf)  # on the clock that compilation stops
_is_enforced: ContextVar[bool] = ContextVar("is_enforced", default=False)
_under_way: set[threading.Event] = set()


class OutOfTimeError(Exception):
    """The limit of a run passed inside work that cannot be divided; who set the limit ends the run."""


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

    Those are not counted in runs inside this one either. On several ranks these are the seconds of the slowest one, and
    Ctrl-C is heard on any of them.

    Attributes
    ----------
    elapsed : float
        Seconds that count against the limit, up to the last reading.
    hears : callable
        Tells whether this rank was asked to end by Ctrl-C.
    is_interrupted : bool
        Whether one of them was, before the last reading.
    """

    def __init__(self, communicator: Communicator) -> None:
        self._compilation = compilation()  # of the thread that runs; others may read
        self._began = time.perf_counter() - self._compilation.seconds
        self._paused = self.elapsed = 0.0
        self._communicator, self.is_interrupted = communicator, False
        self.hears: Callable[[], bool] = bool

    def read(self) -> float:
        """Return the seconds of the run up to now."""
        self.elapsed = time.perf_counter() - self._compilation.seconds - self._began
        seconds = self.elapsed - self._paused
        if not self._communicator.is_alone:
            seconds, self.elapsed, wishes = self._communicator.all_largest(seconds, self.elapsed, self.hears())
            self.is_interrupted = wishes > 0.0
        return seconds

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
    """What this process compiles because no cache has it, for those who tell the user why there is a wait."""

    def __init__(self) -> None:
        self._lock = Lock()
        self._under_way, self._began, self._before = 0, 0.0, 0.0
        self.watchers: list[Callable[[], None]] = []  # called when compilation begins and when it has ended

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
            if self._under_way == 0:
                self._began = now
            self._under_way += change
            if self._under_way == 0:
                self._before += now - self._began
        for watcher in list(self.watchers):
            watcher()


NEW_KERNELS = NewKernels()


def _now() -> float:
    return time.perf_counter() - compilation().seconds


@contextmanager
def time_limit(seconds: float, *, is_enforced: bool = False) -> Iterator[None]:
    """Let what runs inside know that it ends so many seconds from now.

    Where the limit is enforced, :func:`interruptible` work raises OutOfTimeError, which the caller expects.
    """
    tokens = _until.set(_now() + seconds), _is_enforced.set(is_enforced)
    try:
        yield
    finally:
        _until.reset(tokens[0])
        _is_enforced.reset(tokens[1])


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
    return max(_until.get() - _now(), AT_LEAST)


def is_over() -> bool:
    """Return whether the limit has passed: what comes out of long work now comes too late."""
    return _now() > _until.get()


def interruptible(call: Callable[[], T]) -> T:
    """Return what the call returns, unless the limit passes or Ctrl-C comes first.

    The call runs in another thread while this one waits, for some 0.1 ms more than it takes by itself; it must let go
    of the interpreter's lock, and must read and write nothing that anybody else writes. When it is left behind it goes
    on to its end, and what it returns is dropped.

    Raises
    ------
    OutOfTimeError
        Where an enforced limit passed.
    """
    is_limited = _is_enforced.get() and _until.get() < math.inf
    if not is_limited and threading.current_thread() is not threading.main_thread():  # which alone hears Ctrl-C
        return call()
    outcome: list[Any] = []
    is_done, taken = threading.Event(), _thread.allocate_lock()

    def run() -> None:
        if not taken.acquire(blocking=False):
            return
        try:
            outcome.extend((call(), None))
        except BaseException as error:  # whatever it is, it is raised in the thread that waits
            outcome.extend((None, error))
        _under_way.discard(is_done)
        is_done.set()

    _under_way.add(is_done)
    try:  # threading.Thread.start would wait for ever for a thread that finds no memory to begin with
        _thread.start_new_thread(copy_context().run, (run,))
    except (RuntimeError, MemoryError):
        pass
    else:
        is_done.wait(SLICE)
    if taken.acquire(blocking=False):  # nobody has begun
        _under_way.discard(is_done)
        return call()
    while not is_done.wait(SLICE if not is_limited else min(SLICE, max(_until.get() - _now(), 0.0))):
        if is_limited and is_over():
            raise OutOfTimeError
    value: T
    value, error = outcome
    if error is not None:
        raise error
    return value


@atexit.register
def _wait_for_those_left_behind() -> None:
    """Let what was left behind come to its end: the libraries it is in do not survive the end of the interpreter.

    Ctrl-C ends the process at once.
    """
    try:
        for is_done in list(_under_way):
            while not is_done.wait(SLICE):
                pass
    except KeyboardInterrupt:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(130)  # as a shell says of a process that Ctrl-C ended
