"""The clock and the time limit of a run; compilation of kernels does not count."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

# of a search that has no limit of its own: a smallest conflict, an agent's best value
SEARCH_SECONDS = 60.0
# Until when, on the clock that compilation stops, and whether that is enforced.
_limit: ContextVar[tuple[float, bool]] = ContextVar("limit", default=(math.inf, False))


class OutOfTimeError(Exception):
    """Indivisible work is predicted to end after the time limit; the code that set the limit ends the run."""


class Compilation:
    """The seconds that the current thread has spent on compilation."""

    def __init__(self) -> None:
        self.seconds, self._depth, self._began = 0.0, 0, 0.0

    def begin(self) -> None:
        """Record that a compilation begins, perhaps within another compilation."""
        if self._depth == 0:
            self._began = time.perf_counter()
        self._depth += 1

    def end(self) -> None:
        """Record that a compilation has ended."""
        self._depth = max(self._depth - 1, 0)
        if self._depth == 0:
            self.seconds += time.perf_counter() - self._began


_compilation: ContextVar[Compilation] = ContextVar("compilation")


def compilation() -> Compilation:
    """Return the record of compilation of the current thread."""
    record = _compilation.get(None)
    if record is None:
        _compilation.set(record := Compilation())
    return record


@contextmanager
def pause_for_compilation() -> Iterator[None]:
    """Stop the clocks and the time limits of all current runs inside a ``with`` statement."""
    record = compilation()
    record.begin()
    try:
        yield
    finally:
        record.end()


class Clock:
    """The clock of a run, without pauses and without compilation.

    Pauses count towards the time limit. Compilation does not, also not in runs inside this run.

    Parameters
    ----------
    limit : float
        Seconds of the run; ∞ without a limit.
    """

    def __init__(self, limit: float = math.inf) -> None:
        self._limit = limit
        self._compilation = compilation()  # of the thread that runs; others may read
        self._began = time.perf_counter() - self._compilation.seconds
        self._paused = self._elapsed = 0.0

    def read(self) -> float:
        """Return the seconds of the run up to now."""
        self._elapsed = time.perf_counter() - self._compilation.seconds - self._began
        return self._elapsed - self._paused

    @property
    def left(self) -> float:
        """Seconds to the limit, read now, at least 0."""
        self.read()
        return max(self._limit - self._elapsed, 0.0)

    @property
    def is_over(self) -> bool:
        """Whether the limit had passed at the last reading."""
        return self._elapsed >= self._limit

    @contextmanager
    def pause(self) -> Iterator[None]:
        """Exclude the work inside a ``with`` statement from the seconds of the run."""
        record = self._compilation
        began = time.perf_counter() - record.seconds
        try:
            yield
        finally:
            self._paused += time.perf_counter() - record.seconds - began


def _now() -> float:
    return time.perf_counter() - compilation().seconds


@contextmanager
def limit(seconds: float, *, is_enforced: bool = False) -> Iterator[None]:
    """Set a time limit for the work inside a ``with`` statement, in seconds from now; an earlier outer limit stays.

    If the limit is enforced, indivisible work that is predicted to end later raises OutOfTimeError before it begins.
    The caller of this function catches it.
    """
    token = _limit.set((min(_now() + seconds, _limit.get()[0]), is_enforced))
    try:
        yield
    finally:
        _limit.reset(token)


def left() -> float:
    """Return the seconds until the limit, at least 0.1; ∞ without a limit.

    Examples
    --------
    >>> left()
    inf
    >>> with limit(0.0):
    ...     left()
    0.1
    """
    return max(_limit.get()[0] - _now(), 0.1)


def enforced_left() -> float:
    """Return the seconds until the limit, negative after it; ∞ without an enforced limit."""
    until, is_enforced = _limit.get()
    return until - _now() if is_enforced else math.inf


def require_seconds(predicted: float) -> None:
    """Raise OutOfTimeError if indivisible work of this predicted duration would end after an enforced limit.

    Examples
    --------
    >>> with limit(1.0, is_enforced=True):
    ...     require_seconds(60.0)
    Traceback (most recent call last):
    lcp_plugin.core.deadline.OutOfTimeError
    """
    if predicted > enforced_left():
        raise OutOfTimeError


def is_over() -> bool:
    """Return whether the time limit has passed."""
    return _now() > _limit.get()[0]
