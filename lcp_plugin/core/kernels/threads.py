"""Compiled loops cut into pieces that several threads take: the rows of one large problem, or many small problems.

A hand-over costs some 50 µs (``python tests/benchmarks tuning``), more where other programs want the cores; so the
thread that has work to share does what no thread has begun, and waits only for what others are in the middle of.
"""

from __future__ import annotations

import _thread
from collections.abc import Callable, Sequence
from contextlib import suppress
from contextvars import Context, ContextVar, copy_context
from queue import SimpleQueue
from typing import Any, TypeVar

T = TypeVar("T")
MOST_THREADS = 128  # to begin more takes longer than what they share


class threads_for:  # noqa: N801 - read as a function; a generator takes three times as long
    """Let what runs inside a ``with`` statement be shared among so many threads, which begin when first needed.

    Parameters
    ----------
    count : int

    Examples
    --------
    >>> with threads_for(3):
    ...     threads_now()
    3
    >>> threads_now()
    1
    """

    __slots__ = ("_helpers", "_jobs", "_token", "count")

    def __init__(self, count: int) -> None:
        self.count, self._helpers = min(count, MOST_THREADS), 0

    def __enter__(self) -> None:
        self._token = _crew.set(self)

    def __exit__(self, *_: object) -> None:
        _crew.reset(self._token)
        for _helper in range(self._helpers):
            self._jobs.put(None)

    def help_with(self, job: _Job, helpers: int) -> None:
        """Let so many other threads take part."""
        if self._helpers == 0:
            self._jobs: SimpleQueue[tuple[_Job, Context] | None] = SimpleQueue()
        with suppress(RuntimeError):  # no more threads may begin: those there are will do
            while self._helpers < helpers:
                self._helpers += 1  # before Ctrl-C may come: to end one too many does no harm
                # threading.Thread.start would wait for ever for a thread that finds no memory to begin with
                _thread.start_new_thread(_work, (self._jobs,))
        for _ in range(helpers):
            self._jobs.put((job, copy_context()))


_crew: ContextVar[threads_for | None] = ContextVar("threads", default=None)


def threads_now() -> int:
    """Return how many threads may share what runs here: 1 by default, and inside a piece of shared work."""
    crew = _crew.get()
    return 1 if crew is None else crew.count


def share(work: Callable[[int, int], T], count: int, smallest: int) -> list[T]:
    """Return what ``work(first, end)`` gives for consecutive pieces of 0 ≤ k < count, in order.

    Parameters
    ----------
    work : callable
        It may be called in other threads, in a copy of this one's context. It must not wait for a lock that this one
        may hold, as the facts of a matrix do: what it needs of them is taken out before.
    count : int
    smallest : int
        No piece is shorter, unless count is; there are as many as threads, or fewer.

    Raises
    ------
    Exception
        What the first piece that failed has raised, when all that were begun have ended; after Ctrl-C, too.

    Examples
    --------
    >>> with threads_for(2):
    ...     share(lambda first, end: (first, end), 10, 4)
    [(0, 5), (5, 10)]
    """
    crew = _crew.get()
    if crew is None or crew.count == 1 or count < 2 * smallest:
        return [work(0, count)]
    pieces = min(crew.count, count // max(smallest, 1))
    return shared_among(work, [k * count // pieces for k in range(pieces + 1)], crew)


def shared_among(work: Callable[[int, int], T], ends: Sequence[int], crew: threads_for) -> list[T]:
    """Return what the pieces between consecutive ends give, on the threads of a crew, this one among them."""
    job = _Job(work, ends)
    own = copy_context()
    try:
        crew.help_with(job, min(crew.count, len(ends) - 1) - 1)
        own.run(job.take_part)
    finally:
        job.wait()
    return job.results()


class _Job:
    """Pieces of work, each taken by whoever comes first: dict.setdefault happens at once.

    Between taking a piece and saying that it is over nothing asks for memory, which a thread may not find.
    """

    def __init__(self, work: Callable[[int, int], Any], ends: Sequence[int]) -> None:
        self.work, self.ends, self.pieces = work, ends, range(len(ends) - 1)
        self.caller = _thread.get_ident()
        self.takers: dict[int, int] = {}
        self.failed = False
        self.given: list[Any] = [None for _ in self.pieces]
        self.errors: list[BaseException | None] = [None for _ in self.pieces]
        self.at_work = [_thread.allocate_lock() for _ in self.pieces]
        for lock in self.at_work:
            lock.acquire()

    def take_part(self) -> None:
        """Do what no thread has begun; what it shares in turn stays in this thread. After an error nothing is begun."""
        _crew.set(None)
        me = _thread.get_ident()
        for k in self.pieces:
            if k in self.takers or self.failed or self.takers.setdefault(k, me) != me:
                continue
            try:
                self.given[k] = self.work(self.ends[k], self.ends[k + 1])
            except BaseException as error:
                self.errors[k], self.failed = error, True
                if me == self.caller and not isinstance(error, Exception):
                    raise  # Ctrl-C comes before anything else
            finally:
                self.at_work[k].release()

    def wait(self) -> None:
        """Let no thread begin any more, and return when none is at work; Ctrl-C meanwhile is raised afterwards."""
        interruption: BaseException | None = None
        while True:
            try:
                for k in self.pieces:
                    if self.takers.setdefault(k, self.caller) != self.caller:
                        with self.at_work[k]:
                            pass
                break
            except (
                BaseException
            ) as error:  # Ctrl-C, or no memory: first those at work must have ended
                interruption = error
        del self.work  # nothing is left to do; the job may lie where no thread takes it up
        if interruption is not None:
            raise interruption

    def results(self) -> list[Any]:
        """Return what the pieces have given, or raise what the first that failed has raised."""
        given, self.given = self.given, []
        for error in self.errors:
            if error is not None:
                raise error
        return given


def _work(jobs: SimpleQueue[tuple[_Job, Context] | None]) -> None:
    with suppress(MemoryError):  # who shares the work does it without this thread
        while (given := jobs.get()) is not None:
            job, context = given
            context.run(job.take_part)
            del given, job, context  # and with them the arrays that they hold
