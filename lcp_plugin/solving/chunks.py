"""Compiled loops over many problems, cut into chunks that several threads take."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np

from ..errors import InvalidOption

LARGEST_CHUNK = 256  # problems between two looks at the clock
CHUNKS_A_THREAD = 32  # so that none waits long for another at the end


def checked_threads(threads: Any) -> int:
    """Return how many threads take part; all that the process may use for None.

    Raises
    ------
    InvalidOption
        Where it is no whole number ≥ 1.
    """
    if threads is None:
        return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    if isinstance(threads, bool) or not isinstance(threads, (int, np.integer)) or threads < 1:
        raise InvalidOption(f"threads must be a whole number ≥ 1, or None for all that may be used, got {threads!r}")
    return int(threads)


def in_chunks(work: Callable[[int, int], None], count: int, threads: int) -> None:
    """Call ``work(first, end)`` for all of 0 ≤ k < count; after Ctrl-C the chunks that wait are not begun."""
    size = int(np.clip(count // (CHUNKS_A_THREAD * threads), 1, LARGEST_CHUNK))
    chunks = range(0, count, size)

    def work_on(first: int) -> None:
        work(first, min(first + size, count))

    if threads == 1 or len(chunks) == 1:
        for first in chunks:
            work_on(first)
        return
    with ThreadPoolExecutor(threads) as pool:
        try:
            list(pool.map(work_on, chunks))
        except KeyboardInterrupt:
            pool.shutdown(wait=False, cancel_futures=True)
            raise
