"""How many seconds a run has left, for work of other libraries that cannot be divided into steps.

Compilation counts against no limit, in whichever run inside a run it happens.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

AT_LEAST = 0.1  # seconds

_until: ContextVar[float] = ContextVar("until", default=math.inf)  # on the clock that compilation stops


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


def _now() -> float:
    return time.perf_counter() - compilation().seconds


@contextmanager
def time_limit(seconds: float) -> Iterator[None]:
    """Let what runs inside know that it ends so many seconds from now."""
    token = _until.set(_now() + seconds)
    try:
        yield
    finally:
        _until.reset(token)


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
