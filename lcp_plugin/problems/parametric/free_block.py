"""The inverse of the block of free rows, changed by one row and column at a time."""

from __future__ import annotations

import numpy as np
from scipy.linalg import lapack

from ...core.checks import FloatVector
from ...core.matrix.structure import IntVector
from .staircases import Columns

SINGULAR = 1e-11  # a pivot, beside what it is the difference of
FIRST = 32  # rows that there is room for
MOST_CONDITION = 1e14  # of a block that is inverted


class FreeBlock:
    """B = M_FF⁻¹ for a growing and shrinking list F of rows; O(|F|² + n |F|) a change.

    Parameters
    ----------
    columns : Columns
    rows : sequence of int

    Attributes
    ----------
    is_singular : bool
        Whether the block that it was made of has no inverse.
    """

    def __init__(self, columns: Columns, rows: IntVector) -> None:
        self._source = columns
        self._count = k = len(rows)
        room = max(FIRST, 2 * k)
        self._rows = np.zeros(room, dtype=np.int64)
        self._rows[:k] = rows
        self._columns, self._inverse = np.zeros((room, columns.n)), np.zeros((room, room))
        if k:
            self._columns[:k] = columns.many(self._rows[:k])
        self.is_singular = not self.renew()

    @property
    def rows(self) -> IntVector:
        """F, in the order of the inverse."""
        return self._rows[: self._count]

    @property
    def columns(self) -> FloatVector:
        """The columns of M that belong to F, shape (|F|, n)."""
        return self._columns[: self._count]

    @property
    def inverse(self) -> FloatVector:
        """B, shape (|F|, |F|)."""
        return self._inverse[: self._count, : self._count]

    @property
    def block(self) -> FloatVector:
        """M_FF."""
        return np.ascontiguousarray(self.columns[:, self.rows].T)

    def renew(self) -> bool:
        """Factorise the block anew; return whether it has an inverse."""
        if not self._count:
            return True
        block = self.block
        size = np.abs(block).sum(axis=0).max()
        factor, pivots, info = lapack.dgetrf(block)
        if info or not size > 0.0:
            return False
        reciprocal, _ = lapack.dgecon(factor, size)
        inverse, info = lapack.dgetri(factor, pivots)
        self.inverse[:] = inverse
        return not info and reciprocal * MOST_CONDITION > 1.0

    def place(self, row: int) -> int:
        """Return where a row is in F."""
        return int(np.flatnonzero(self.rows == row)[0])

    def response(self, row: int) -> tuple[FloatVector, FloatVector]:
        """Return M_F,row's column of M and −B of it: how the free z answer a z_row of 1 more."""
        column = self._source.one(row)
        return column, -self.inverse.dot(column[self.rows])

    def enter(self, row: int) -> bool:
        """Add a row; return False, and change nothing, where the larger block is singular."""
        k = self._count
        column, answer = self.response(row)
        across = self.columns[:, row]
        pivot = column[row] + across.dot(answer)
        if abs(pivot) <= SINGULAR * (abs(column[row]) + np.abs(across).dot(np.abs(answer))):
            return False
        if k == self._rows.size:
            self._grow()
        beside = across.dot(self.inverse) / -pivot
        self.inverse[:] -= np.outer(answer, -beside)
        self._inverse[:k, k], self._inverse[k, :k], self._inverse[k, k] = (
            answer / pivot,
            beside,
            1.0 / pivot,
        )
        self._rows[k], self._columns[k] = row, column
        self._count = k + 1
        return True

    def leave(self, row: int) -> bool:
        """Take a row out; return False, and change nothing, where the smaller block is singular."""
        place, last = self.place(row), self._count - 1
        of_row, of_column = np.abs(self.inverse[place]), np.abs(self.inverse[:, place])
        pivot = self._inverse[place, place]
        if abs(pivot) <= SINGULAR * np.sqrt(of_row.max() * of_column.max()):
            return False
        if place != last:
            self._swap(place, last)
        outer = np.outer(self._inverse[:last, last], self._inverse[last, :last] / pivot)
        self._inverse[:last, :last] -= outer
        self._count = last
        return True

    def _swap(self, one: int, other: int) -> None:
        pair, turned = [one, other], [other, one]
        k = self._count
        self._rows[pair], self._columns[pair] = self._rows[turned], self._columns[turned]
        self._inverse[pair, :k] = self._inverse[turned, :k]
        self._inverse[:k, pair] = self._inverse[:k, turned]

    def _grow(self) -> None:
        k = self._count
        rows, columns, inverse = self._rows, self._columns, self._inverse
        self._rows, self._columns = (
            np.zeros(2 * k, dtype=np.int64),
            np.zeros((2 * k, columns.shape[1])),
        )
        self._inverse = np.zeros((2 * k, 2 * k))
        self._rows[:k], self._columns[:k], self._inverse[:k, :k] = rows, columns, inverse
