"""Loop over many small problems, in chunks for several threads."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

from ...core.kernels.threads import MAX_THREADS, shared_among

LARGEST_CHUNK = 256  # problems between two checks of the clock
CHUNKS_A_THREAD = 32  # small chunks, so that all threads end at about the same time


def run_in_chunks(work: Callable[[int, int], None], count: int, threads: int) -> None:
    """Call ``work(first, end)`` for all of 0 ≤ k < count; after Ctrl-C no further chunk starts."""
    threads = min(threads, MAX_THREADS)
    size = min(max(count // (CHUNKS_A_THREAD * threads), 1), LARGEST_CHUNK)
    ends = [*range(0, count, size), count]
    if threads == 1 or len(ends) <= 2:
        for first, end in pairwise(ends):
            work(first, end)
        return
    shared_among(work, ends, threads)
