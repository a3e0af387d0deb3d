"""numba, loaded and set up whole: an interrupted half of either can never be completed. Its names come from here.

>>> loaded_whole("json")
"""

from __future__ import annotations

import _imp
import _thread
import sys
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from importlib import import_module

from ..deadline import compiling

POLLED = 0.1  # seconds


def loaded_whole(name: str) -> None:
    """Import a module of another package to its end.

    It must import nothing of this package: modules that this thread is importing would wait for it.
    """
    if name not in sys.modules:
        to_its_end(partial(import_module, name))


def to_its_end(action: Callable[[], object]) -> None:
    """Run an action to its end; what is raised here meanwhile, as by Ctrl-C, is raised then.

    Another thread runs it, which no signal interrupts, so that no handler of signals need be changed. It must not wait
    for a lock that this thread holds.
    """
    # Not an Event: interrupted between two of its own lines it may keep its lock for good.
    is_done, waiter, raised = list[bool](), _thread.allocate_lock(), list[BaseException]()
    waiter.acquire()
    with suppress(RuntimeError):  # it is another thread's, which lets it go
        while (
            _imp.lock_held()
        ):  # by this thread, interrupted as it looked up a module: the other would never go on
            _imp.release_lock()

    def run() -> None:
        try:
            action()
        except BaseException as error:  # raised again by the thread that waits
            raised.append(error)
        is_done.append(True)
        waiter.release()

    try:
        _thread.start_new_thread(run, ())
    except (RuntimeError, MemoryError):  # there is no other thread to be had
        run()
    while not is_done:
        try:
            waiter.acquire(timeout=POLLED)  # an interruption may have come just after it
        except BaseException as error:  # whatever a handler of signals raises
            raised.append(error)
    if raised:
        raise raised[-1]


def _nothing() -> None:
    pass


with compiling():  # which takes most of a second
    loaded_whole("numba")
    from numba import config, float64, njit, types, uintp
    from numba.core import event
    from numba.extending import lower_builtin, overload, type_callable

    # Its tables of what it knows to compile are filled by its first compilation, and what Ctrl-C leaves half filled
    # stays so. It imports the module of what it compiles.
    _nothing.__module__ = "numba"
    to_its_end(partial(njit("void()"), _nothing))

__all__ = [
    "config",
    "event",
    "float64",
    "lower_builtin",
    "njit",
    "overload",
    "type_callable",
    "types",
    "uintp",
]
