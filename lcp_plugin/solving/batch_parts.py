"""Problems of a batch that share a compiled loop, and the tables that take what it writes: a row a problem."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ..checks import read_only
from ..kernels.threads import in_chunks
from .batch_items import Group


class BatchPart:
    """Problems of a batch that share a compiled loop.

    Attributes
    ----------
    z, side : arrays, shape (k, n)
        Their solutions, solved for once more, and where each row is: a side of `kernels.desk`.
    is_plain : array of bool, shape (k,)
        Where the compiled loop has settled these.
    """

    def __init__(self, group: Group, z: Any, is_solved: Any, threads: int) -> None:
        from ..kernels.small_derivatives import settle_all

        self.group, self.threads = group, threads
        self.z, self.side, self.is_plain = z, np.zeros(z.shape, np.int8), is_solved
        data = group.M, group.q, group.lower, group.upper

        def settle(first: int, end: int) -> None:
            settle_all(*data, first, end, self.z, self.side, self.is_plain)

        in_chunks(settle, group.items.size, threads)

    @property
    def plain(self) -> Any:
        """Which of the batch the loop has settled."""
        return self.group.items[self.is_plain]

    def derived(self, kernel: Any, given: Sequence[Any], count: int) -> tuple[list[Any], Any]:
        """Return so many arrays that the kernel writes of the rows given, and for which problems it has succeeded."""
        answers, is_plain = [np.empty(self.z.shape) for _ in range(count)], self.is_plain.copy()

        def derive(first: int, end: int) -> None:
            kernel(self.group.M, self.side, *given, first, end, *answers, is_plain)

        in_chunks(derive, self.group.items.size, self.threads)
        return answers, is_plain


def put(table: Any, items: Any, rows: Any) -> None:
    """Write rows of a table, an array or a list of arrays."""
    if isinstance(table, np.ndarray):
        table[items] = rows
    else:
        for k, row in zip(items.tolist(), rows, strict=True):
            table[k] = row


def chosen(rows: Any, items: Any) -> Any:
    """Return those rows as an array, read-only; one row in front stays for all."""
    if len(rows) == 1 and isinstance(rows, np.ndarray):
        return read_only(rows)
    return read_only(rows[items] if isinstance(rows, np.ndarray) else np.array([rows[k] for k in items]))
