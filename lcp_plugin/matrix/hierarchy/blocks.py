"""Blocks of rows, every other of which may be swept at the same time.

No row of a block meets one of the next but one. A sweep takes the even blocks first and then the odd ones, backward the
other way round: a Gauss–Seidel sweep in an order that the matrix alone decides, whoever takes which block.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...crossovers import SHARED_FROM

MOST_BLOCKS = 16
SMALLEST_BLOCK = 8192  # rows
REACHES = 4  # times as many rows as a row reaches far: what is done twice at the seams is little
FEWEST = 4  # two of either kind


class Blocks(NamedTuple):
    """Where blocks begin, with the end of the last, and how far a row reaches where there are several."""

    edges: NDArray[np.int64]
    reach: int

    def count(self, colour: int) -> int:
        """Return how many blocks are even (0) or odd (1)."""
        return (self.edges.size - colour) // 2

    @property
    def smallest_share(self) -> int:
        """The fewest blocks of a colour that are worth a hand-over; a sweep has two."""
        return max(SHARED_FROM // max(2 * int(self.edges[1]), 1), 1)


def blocks_of(indptr: NDArray[Any], indices: NDArray[Any], rows: int, *, may_cut: bool) -> Blocks:
    """Return the blocks of that many rows; one where it may not be cut, or would be for nothing."""
    count, reach = 0, 0
    if may_cut and rows >= FEWEST * SMALLEST_BLOCK:
        own, begins, ends = np.arange(rows, dtype=indices.dtype), indptr[:rows], indptr[1 : rows + 1]
        reach = int(max((own - indices[begins]).max(), (indices[ends - 1] - own).max()))
        count = min(MOST_BLOCKS, rows // max(SMALLEST_BLOCK, REACHES * reach)) // 2 * 2
    if count < FEWEST:
        count, reach = 1, 0
    edges = np.linspace(0, rows, count + 1).astype(np.int64)
    edges.flags.writeable = False
    return Blocks(edges, reach)
