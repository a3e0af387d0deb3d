"""Problems of a batch that are solved together."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from ...core.matrix.structure import IntVector


class Group(NamedTuple):
    """Problems of one size as arrays; one row in front stands for all of them.

    Attributes
    ----------
    items : array of int, shape (k,)
        Which of the batch they are.
    M : array, shape (k or 1, n, n)
    q, lower, upper, starts : arrays, shape (k or 1, n)
        Without columns, `starts` means z°.
    """

    items: Any
    M: Any
    q: Any
    lower: Any
    upper: Any
    starts: Any

    @property
    def shape(self) -> tuple[int, int]:
        """How many problems there are, and the unknowns of each."""
        return self.items.size, self.M.shape[1]

    def chosen(self, rows: IntVector) -> Group:
        """Return the problems in these rows."""
        if rows.size == self.items.size:
            return self
        return Group(
            self.items[rows], *(array if len(array) == 1 else array[rows] for array in self[1:])
        )

    def vectors(self, *names: str) -> list[Any]:
        """Return these vectors of all problems, each of shape (k, n)."""
        return [np.broadcast_to(getattr(self, name), self.shape) for name in names]
