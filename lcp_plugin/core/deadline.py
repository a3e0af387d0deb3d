"""The clock of a run and the seconds it has left; compilation counts against no limit."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

AT_LEAST = 0.1  # seconds


# Until when, on the clock that compilation stops, and whether that is enforced.
_limit: ContextVar[tuple[float, bool]] = ContextVar("limit", default=(math.inf, False))


class OutOfTimeError(Exception):
    """Work that cannot be divided would end after the limit of a run; who set the limit ends the run."""


class Compilation:
    """The seconds that a thread has spent on compilation since it began."""

    def __init__(self) -> None:
        self.seconds, self._depth, self._began = 0.0, 0, 0.0

    def begin(self) -> None:
        """Note that a compilation begins, perhaps within another one."""
        if self._depth == 0:
            self._began = time.perf_counter()
        self._depth += 1

    def end(self) -> None:
        """Note that it has ended."""
        self._depth = max(self._depth - 1, 0)
        if self._depth == 0:
            self.seconds += time.perf_counter() - self._began


_compilation: ContextVar[Compilation] = ContextVar("compilation")


def compilation() -> Compilation:
    """Return that of the thread at work."""
    found = _compilation.get(None)
    if found is None:
        _compilation.set(found := Compilation())
    return found


@contextmanager
def pause_for_compilation() -> Iterator[None]:
    """Stop the clocks of all runs around, and their limits, inside a ``with`` statement."""
    own = compilation()
    own.begin()
    try:
        yield
    finally:
        own.end()


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
    def pause(self) -> Iterator[None]:
        """Take off what happens inside a ``with`` statement: the algorithm did not need it."""
        own = self._compilation
        began = time.perf_counter() - own.seconds
        try:
            yield
        finally:
            self._paused += time.perf_counter() - own.seconds - began


def _now() -> float:
    return time.perf_counter() - compilation().seconds


@contextmanager
def time_limit(seconds: float, *, is_enforced: bool = False) -> Iterator[None]:
    """Let what runs inside know that it ends so many seconds from now.

    If the limit is enforced, work that cannot be divided is not begun where it is predicted to end later:
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
