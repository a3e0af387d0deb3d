"""Problems of a batch whose derivatives one compiled loop takes, or a few calls where their blocks are singular."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ...core.checks import read_only
from ...core.matrix.units import are_in_one_unit
from ...systems.least_norm import pseudo_inverses
from ..batches.batch_groups import Group
from ..many.chunks import in_chunks


class BatchPart:
    """Problems of a batch that share a compiled loop.

    Attributes
    ----------
    z, side : arrays, shape (k, n)
        Their solutions, solved for once more, and where each row is: a side of `methods.small.kernels.workspace`.
    is_plain : array of bool, shape (k,)
        Where the compiled loop has settled these.
    """

    def __init__(self, group: Group, z: Any, is_solved: Any, threads: int) -> None:
        from .kernels import settle_all

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

    @property
    def free(self) -> Any:
        """The rows between their bounds, and those at a kink that are taken for such, shape (k, n)."""
        from ...methods.small.kernels.workspace import BETWEEN
        from .kernels import KINK

        return self.side % KINK == BETWEEN

    def derived(self, kernel: Any, given: Sequence[Any], count: int) -> tuple[list[Any], Any]:
        """Return so many arrays that the kernel writes of the rows given, and for which problems it has succeeded."""
        answers, is_plain = [np.empty(self.z.shape) for _ in range(count)], self.is_plain.copy()

        def derive(first: int, end: int) -> None:
            kernel(self.group.M, self.side, *given, first, end, *answers, is_plain)

        in_chunks(derive, self.group.items.size, self.threads)
        return answers, is_plain

    def by_least_norm(self, given: Sequence[Any], answers: Sequence[Any], is_plain: Any) -> None:
        """Write the gradients of settled problems with singular blocks, as many at once as have so many free rows.

        Those of mixed units are left, as are blocks that are only nearly singular.
        """
        from ...methods.small.kernels.workspace import AT_UPPER
        from .kernels import KINK

        M, free = self.group.M, self.free
        missing = np.flatnonzero(self.is_plain & ~is_plain)
        for count in np.unique(free[missing].sum(axis=1)):
            items = missing[free[missing].sum(axis=1) == count]
            own = M[items if len(M) > 1 else np.zeros_like(items)]
            g, by_w = (rows[items if len(rows) > 1 else np.zeros_like(items)] for rows in given)
            rows = np.nonzero(free[items])[1].reshape(items.size, count)
            blocks = np.take_along_axis(np.take_along_axis(own, rows[:, :, np.newaxis], 1), rows[:, np.newaxis], 2)
            inverses, is_singular = pseudo_inverses(blocks)
            by_w, by_upper = np.where(free[items], 0.0, by_w), self.side[items] % KINK == AT_UPPER
            right = np.take_along_axis(g + _transposed_products(own, by_w), rows, 1)
            multiplier = by_w.copy()
            np.put_along_axis(multiplier, rows, -_transposed_products(inverses, right), 1)
            by_bound = np.where(free[items], 0.0, g + _transposed_products(own, multiplier))
            done = is_singular & are_in_one_unit(own)
            found = multiplier, np.where(by_upper, 0.0, by_bound), np.where(by_upper, by_bound, 0.0)
            for answer, values in zip(answers, found, strict=True):
                answer[items[done]] = values[done]
            is_plain[items[done]] = True


def _transposed_products(matrices: Any, vectors: Any) -> Any:
    """Return A_kᵀ x_k, matrices of shape (k, n, n) and vectors of shape (k, n)."""
    return np.matmul(vectors[:, np.newaxis], matrices)[:, 0]


def chosen(rows: Any, items: Any) -> Any:
    """Return those rows as an array, read-only; one row in front stays for all."""
    if len(rows) == 1 and isinstance(rows, np.ndarray):
        return read_only(rows)
    return read_only(rows[items] if isinstance(rows, np.ndarray) else np.array([rows[k] for k in items]))
