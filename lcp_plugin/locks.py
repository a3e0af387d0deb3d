"""Locks between threads that a fork leaves open: a child has one thread, and nobody else in it could let go."""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from weakref import WeakSet


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
