"""Linear constraints by themselves: rows with a sign, unknowns with bounds, and what each row is measured in."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from ..checks import FloatVector
from ..matrix.structure import row_numbers

BoolVector = NDArray[np.bool_]

DECISIVE = 1e-3  # a margin that no tolerance in use reaches: where one row has a larger one, no other is looked for
MOST_SUSPECTS = 8  # rows that look contradictory in floating point and are checked exactly


@dataclass(frozen=True, eq=False)
class LinearConstraints:
    """The x within their bounds for which w = M x + q has the signs that its rows ask for.

    Attributes
    ----------
    matrix : CSR array, shape (m, n)
    q : array, shape (m,)
        Finite where a row asks for a sign.
    needs_rise, needs_fall : arrays of bool, shape (m,)
        Whether w_i ≥ 0 and w_i ≤ 0 is asked for; both make an equation, neither leaves the row out.
    lower, upper : arrays, shape (n,)
    weights : array, shape (m,)
        Positive: the unit in which w_i misses its sign.
    bound_weights : pair of arrays, shape (n,)
        The units in which x may miss its lower and its upper bounds too; 0 where bounds are kept.
    reference : float
        What the largest miss is relative to.
    """

    matrix: sp.csr_array
    q: FloatVector
    needs_rise: BoolVector
    needs_fall: BoolVector
    lower: FloatVector
    upper: FloatVector
    weights: FloatVector
    bound_weights: tuple[FloatVector, FloatVector]
    reference: float = 1.0

    @property
    def missing(self) -> FloatVector:
        """By how much all x within the bounds miss w_i ≥ 0 and w_i ≤ 0 at least, to rounding; shape (2, m).

        Positive where no such x gives the row the sign it asks for.
        """
        lowest, highest = activity(self.matrix, self.lower, self.upper)
        with np.errstate(invalid="ignore"):
            below = np.where(self.needs_rise, -(highest + self.q), -np.inf)
            return np.stack([below, np.where(self.needs_fall, lowest + self.q, -np.inf)])

    def contradictory_rows(self) -> Iterator[tuple[int, int]]:
        """Yield the rows that x within the bounds miss by most, and +1 where w_i is too small, −1 where too large."""
        missing = self.missing
        most = missing.max(axis=0)
        suspects = np.flatnonzero(most > 0.0)
        with np.errstate(all="ignore"):
            order = np.argsort(-most[suspects] / self.weights[suspects], kind="stable")
        for i in suspects[order][:MOST_SUSPECTS].tolist():
            yield i, 1 if missing[0, i] > 0.0 else -1


def activity(matrix: sp.csr_array, lower: FloatVector, upper: FloatVector) -> tuple[FloatVector, FloatVector]:
    """Return the least and the largest value of each row of matrix · x within the bounds, to rounding."""
    rows, m = row_numbers(matrix), matrix.shape[0]
    with np.errstate(all="ignore"):
        ends = [matrix.data * bound[matrix.indices] for bound in (lower, upper)]
        lowest, highest = (np.bincount(rows, weights=side(*ends), minlength=m) for side in (np.minimum, np.maximum))
    return lowest.astype(np.float64), highest.astype(np.float64)
