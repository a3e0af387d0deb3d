"""How many seconds a run has left, for work of other libraries that cannot be divided into steps."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

AT_LEAST = 0.1  # seconds

_until: ContextVar[float] = ContextVar("until", default=math.inf)


@contextmanager
def time_limit(seconds: float) -> Iterator[None]:
    """Let what runs inside know that it ends so many seconds from now."""
    token = _until.set(time.perf_counter() + seconds)
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
    return max(_until.get() - time.perf_counter(), AT_LEAST)


def is_over() -> bool:
    """Return whether the limit has passed: what comes out of long work now comes too late."""
    return time.perf_counter() > _until.get()
