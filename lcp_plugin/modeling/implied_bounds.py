"""Bounds of unknowns that only equations determine, and whether the rest of the model implies them.

Such a bound is an inequality without a partner: nothing says what gives way at it. Where a complementarity or the
equation itself keeps it anyway, as in w == M @ x + q with w nonneg and complements(x >= 0, w >= 0), it says nothing new
and may go.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..checks import FloatVector

ROUNDING = 4.0 * 2.0**-52


class KnownRanges:
    """Where each unknown must lie, its own bounds aside; every number up to rounding of the caller's data."""

    def __init__(self, count: int) -> None:
        self.low, self.high = np.full(count, -np.inf), np.full(count, np.inf)
        self.rounding = np.zeros(count)

    def narrow(self, columns: NDArray[Any], low: FloatVector, high: FloatVector, size: FloatVector) -> None:
        """Take in that the unknowns in `columns` lie in [low, high], from numbers of that size."""
        np.maximum.at(self.low, columns, low)
        np.minimum.at(self.high, columns, high)
        np.maximum.at(self.rounding, columns, ROUNDING * size)

    def of_signed(self, columns: NDArray[Any], weights: FloatVector, offset: FloatVector, sign: FloatVector) -> None:
        """Take in that weights · u + offset is ≥ 0 where `sign` is 1, ≤ 0 where it is −1; nothing where it is 0."""
        edge, towards = -offset / weights, sign * weights
        self.narrow(
            columns, np.where(towards > 0.0, edge, -np.inf), np.where(towards < 0.0, edge, np.inf), np.abs(edge)
        )

    def of_equations(
        self, matrix: Any, offset: FloatVector, lower: FloatVector, upper: FloatVector, is_paired: NDArray[np.bool_]
    ) -> None:
        """Take in what follows from matrix · (all unknowns) + offset = 0 where all but one of a row belong to pairs.

        Those stay within `lower` and `upper`; the bounds of the others are not believed.
        """
        rows, count = np.repeat(np.arange(offset.size), np.diff(matrix.indptr)), offset.size
        is_open = ~is_paired[matrix.indices] & (matrix.data != 0.0)
        data, columns = matrix.data[~is_open], matrix.indices[~is_open]
        ends = [np.where(data == 0.0, 0.0, data * bound[columns]) for bound in (lower, upper)]
        finite = [np.where(np.isfinite(end), np.abs(end), 0.0) for end in ends]
        least, most, size = (
            np.bincount(rows[~is_open], values, minlength=count)
            for values in (np.minimum(*ends), np.maximum(*ends), np.maximum(*finite))
        )
        alone = np.flatnonzero(is_open & (np.bincount(rows[is_open], minlength=count)[rows] == 1))
        pivot, row = matrix.data[alone], rows[alone]
        low, high = -(most + offset)[row] / pivot, -(least + offset)[row] / pivot
        self.narrow(
            matrix.indices[alone], np.minimum(low, high), np.maximum(low, high),
            (size + np.abs(offset))[row] / np.abs(pivot),
        )

    def imply(self, lower: FloatVector, upper: FloatVector) -> NDArray[np.bool_]:
        """Return for which unknowns lower ≤ z ≤ upper says nothing new."""
        implied: NDArray[np.bool_] = (self.low >= lower - self.rounding) & (self.high <= upper + self.rounding)
        return implied

    def contradict(self, lower: FloatVector, upper: FloatVector) -> NDArray[np.bool_]:
        """Return for which unknowns lower ≤ z ≤ upper cannot be met."""
        wrong: NDArray[np.bool_] = (self.low > upper + self.rounding) | (self.high < lower - self.rounding)
        return wrong
