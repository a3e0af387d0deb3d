"""Rows of a new CSR matrix that several threads write, each a piece of its own, joined behind one another."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...kernels.threads import share
from ...peers.alone import Arrays

SMALLEST_PIECE = 16384  # rows


def joined(pieces: list[Arrays]) -> Arrays:
    """Return the CSR rows of consecutive pieces of rows; the first may have room for those of the others behind it."""
    sizes = [int(indptr[-1]) for indptr, _, _ in pieces]
    ends = np.cumsum(sizes, dtype=pieces[0][0].dtype)
    further = [piece[0][1:] + before for piece, before in zip(pieces[1:], ends, strict=False)]
    indptr = np.concatenate([pieces[0][0], *further]) if further else pieces[0][0]
    indices, data = (
        _appended([piece[k] for piece in pieces], sizes, int(ends[-1])) for k in (1, 2)
    )
    return indptr, indices, data


def _appended(parts: list[Any], sizes: list[int], total: int) -> Any:
    """Return the first entries of all parts, so many of each, in the memory of the first part where that suffices."""
    if parts[0].size < total:
        return np.concatenate([part[:size] for part, size in zip(parts, sizes, strict=True)])
    end = sizes[0]
    for part, size in zip(parts[1:], sizes[1:], strict=True):
        parts[0][end : end + size] = part[:size]
        end += size
    return parts[0][:total]


def written_rows(kernel: Any, operands: tuple[Any, ...], more: int, smallest: int) -> tuple[Arrays, int]:
    """Return the rows of P that a kernel writes with room for those of M and `more` a row, and what else it tells."""
    indptr, indices = operands[:2]
    n = indptr.size - 1

    def piece(first: int, end: int) -> tuple[Arrays, int]:
        last = end if first else n  # memory that nothing is written to was never touched
        room = int(indptr[last] - indptr[first]) + more * (last - first)
        rows = np.empty(end - first + 1, indptr.dtype), np.empty(room, indices.dtype), np.empty(room)
        _, told = kernel(*operands, first, end, *rows)
        return rows, told

    pieces, told = zip(*share(piece, n, smallest), strict=True)
    return joined(list(pieces)), sum(told)
