"""Linear constraints by themselves: rows with a sign, unknowns with bounds, and what each row is measured in."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from ..checks import FloatVector
from ..exact.rational import ZERO, rounded_down
from ..matrix.structure import row_numbers

BoolVector = NDArray[np.bool_]

DECISIVE = 1e-3  # a margin that no tolerance in use reaches: where one row has a larger one, no other is looked for
WIDE = 1e8  # times the size of the data: a proof within a smaller radius refutes nothing
DATA_ROUNDING = 2.0**-44  # as many roundings as a time step or an assembly adds up, with a margin
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


def radius_of_proof(contradiction: Fraction, left: Fraction) -> float:
    """Return the R with contradiction − R · left half the contradiction, rounded down; ∞ where nothing is left.

    Multipliers that combine rows to rounding errors instead of to 0 contradict for all ‖x‖∞ ≤ R: `left` is what may be
    taken off for each unit of x.
    """
    return rounded_down(max(contradiction, ZERO) / (2 * left) if left else None)


def without_rounding(matrix: sp.csr_array) -> sp.csr_array:
    """Return the matrix without entries that are rounding beside the largest ones of their row and of their column.

    What is left of a sum of decimals that should cancel has no size that a scale might be made of.
    """
    size = abs(matrix)
    if 0 in matrix.shape or not matrix.nnz:
        return matrix
    across, down = (np.asarray(size.max(axis=axis).toarray()).ravel() for axis in (1, 0))
    rows = row_numbers(matrix)
    kept = size.data > DATA_ROUNDING * np.minimum(across[rows], down[matrix.indices])
    if kept.all():
        return matrix
    return sp.csr_array((matrix.data[kept], (rows[kept], matrix.indices[kept])), shape=matrix.shape)


def is_rounding(left: Sequence[Fraction], terms: FloatVector) -> bool:
    """Return whether sums that should be 0 are rounding beside their terms: data of other sizes are no rounding."""
    return all(abs(value) <= DATA_ROUNDING * size for value, size in zip(left, terms.tolist(), strict=True) if value)


def within(radius: float, what: str) -> str:
    """Return the words for the radius of a proof; none where it is ∞.

    Examples
    --------
    >>> within(2.5e12, "x"), within(np.inf, "x")
    ('; of all x up to 2e+12', '')
    """
    digits, exponent = f"{radius:.15e}".split("e") if radius < np.inf else ("", "")
    return f"; of all {what} up to {digits[0]}e{exponent}" if digits else ""
