"""How work of other libraries that cannot be divided obeys the limit of a run, and Ctrl-C."""

from __future__ import annotations

import _thread
import atexit
import math
import os
import sys
import threading
from collections.abc import Callable
from contextvars import copy_context
from typing import Any
from weakref import WeakSet

from ..core.deadline import OutOfTimeError, enforced_seconds_left

SLICE = 0.1  # seconds between two looks at the clock, and at Ctrl-C where that does not end a wait
_under_way: set[threading.Event] = set()
_kept: WeakSet[Kept] = WeakSet()


class Kept:
    """A value with `solve` that the thread which made it drops, once this is dropped; that thread waits meanwhile."""

    def __init__(self, value: list[Any], is_dropped: threading.Event, is_gone: threading.Event) -> None:
        self._value, self._is_dropped, self._is_gone = value, is_dropped, is_gone
        _kept.add(self)

    def solve(self, *right: Any, **how: Any) -> Any:
        """Return what the value's own method returns; nobody else is to hold that."""
        return self._value[0].solve(*right, **how)

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):  # of one that is only half made
            raise AttributeError(name)
        return getattr(self._value[0], name)

    def drop(self) -> None:
        """Let the other thread drop the value."""
        _under_way.add(self._is_gone)
        self._is_dropped.set()

    __del__ = drop


def interruptible(call: Callable[[], Any], *, is_kept: bool = False) -> Any:
    """Return what the call returns, unless the limit passes or Ctrl-C comes first; `is_kept` as a `Kept` value.

    The call runs in another thread while this one waits, for some 0.1 ms more than it takes by itself; it must let go
    of the interpreter's lock, and must read and write nothing that anybody else writes. When it is left behind it goes
    on to its end, and what it returns is dropped.

    Raises
    ------
    OutOfTimeError
        Where an enforced limit passed.
    """
    is_limited = enforced_seconds_left() < math.inf
    if not is_limited and threading.current_thread() is not threading.main_thread():  # which alone hears Ctrl-C
        return call()
    outcome: list[Any] = []
    is_done, is_dropped, is_gone = (threading.Event() for _ in range(3))
    taken = _thread.allocate_lock()

    def run() -> None:
        if not taken.acquire(blocking=False):
            return
        try:
            outcome.extend((call(), None))
        except BaseException as error:  # whatever it is, it is raised in the thread that waits
            outcome.extend((None, error))
        _under_way.discard(is_done)
        is_done.set()
        if outcome[1] is None:
            is_dropped.wait()
            outcome.clear()
        _under_way.discard(is_gone)
        is_gone.set()

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
    kept = Kept(outcome, is_dropped, is_gone)  # dropped as well where what follows is an exception
    while not is_done.wait(min(SLICE, max(enforced_seconds_left(), 0.0))):
        if enforced_seconds_left() < 0.0:
            raise OutOfTimeError
    if outcome[1] is not None:
        raise outcome[1]
    return kept if is_kept else outcome[0]


@atexit.register
def _wait_for_those_left_behind() -> None:
    """Let what was left behind come to its end: the libraries it is in do not survive the end of the interpreter.

    Nor is what threads keep to be dropped after it. Ctrl-C ends the process at once.
    """
    try:
        for kept in list(_kept):
            kept.drop()
        for is_done in list(_under_way):
            while not is_done.wait(SLICE):
                pass
    except KeyboardInterrupt:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(130)  # as a shell says of a process that Ctrl-C ended
