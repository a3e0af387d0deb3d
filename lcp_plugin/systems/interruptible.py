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
from typing import Any, TypeVar

from ..core.deadline import OutOfTimeError, enforced_seconds_left

T = TypeVar("T")
SLICE = 0.1  # seconds between two looks at the clock, and at Ctrl-C where that does not end a wait
_under_way: set[threading.Event] = set()


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
    is_limited = enforced_seconds_left() < math.inf
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
    while not is_done.wait(min(SLICE, max(enforced_seconds_left(), 0.0))):
        if enforced_seconds_left() < 0.0:
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
