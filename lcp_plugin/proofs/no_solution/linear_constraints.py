"""Linear constraints, and certificates of their inconsistency.

Rows with a sign, unknowns with bounds, the unit of each row; a Farkas vector and its proof.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from ...core.checks import FloatVector
from ...core.kernels.floats import DATA_ROUNDING
from ...core.matrix.structure import row_numbers
from ..exact.rational import (
    ZERO,
    IntegerMatrix,
    common_denominator,
    integers,
    power_of_two,
    rounded_down,
)

BoolVector = NDArray[np.bool_]

DECISIVE = 1e-3  # no tolerance in use is as large: the search ends if one row has this margin
WIDE = 1e8  # times the size of the data: a proof within a smaller radius does not count
MOST_SUSPECTS = 8  # rows that look contradictory in floating point and are checked exactly


@dataclass(frozen=True, eq=False)
class LinearConstraints:
    """The x within their bounds for which w = M x + q has the signs required by its rows.

    Attributes
    ----------
    matrix : CSR array, shape (m, n)
    q : array, shape (m,)
        Finite for rows with a required sign.
    needs_rise, needs_fall : arrays of bool, shape (m,)
        Whether w_i ≥ 0 and w_i ≤ 0 is required; both make an equality, neither leaves the row out.
    lower, upper : arrays, shape (n,)
    weights : array, shape (m,)
        Positive: unit of the violation of each row's sign.
    bound_weights : pair of arrays, shape (n,)
        Units of the violation of the lower and of the upper bounds of x; 0 if bounds must hold.
    reference : float
        Reference of the largest violation.
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

    def signs(self, row: int) -> tuple[bool, bool]:
        """Return whether w_i ≥ 0 and w_i ≤ 0 is required."""
        return bool(self.needs_rise[row]), bool(self.needs_fall[row])

    def bounds(self, column: int) -> tuple[float, float]:
        """Return the bounds of an unknown."""
        return float(self.lower[column]), float(self.upper[column])

    @property
    def missing(self) -> FloatVector:
        """Least violations of w_i ≥ 0, w_i ≤ 0 by x within the bounds, to rounding, shape (2, m).

        Positive if no such x gives the row its required sign.
        """
        lowest, highest = activity(self.matrix, self.lower, self.upper)
        below = np.where(self.needs_rise, -(highest + self.q), -np.inf)
        return np.stack([below, np.where(self.needs_fall, lowest + self.q, -np.inf)])

    def contradictory_rows(self) -> Iterator[tuple[int, int]]:
        """Yield the most violated rows, with +1 if w_i is too small, and −1 if it is too large."""
        missing = self.missing
        most = missing.max(axis=0)
        suspects = np.flatnonzero(most > 0.0)
        with np.errstate(all="ignore"):
            order = np.argsort(-most[suspects] / self.weights[suspects], kind="stable")
        for i in suspects[order][:MOST_SUSPECTS].tolist():
            yield i, 1 if missing[0, i] > 0.0 else -1


def activity(
    matrix: sp.csr_array, lower: FloatVector, upper: FloatVector
) -> tuple[FloatVector, FloatVector]:
    """Return the least and the largest value of each row of matrix · x within the bounds, to rounding."""
    rows, m = row_numbers(matrix), matrix.shape[0]
    with np.errstate(all="ignore"):
        ends = [matrix.data * bound[matrix.indices] for bound in (lower, upper)]
        lowest, highest = (
            np.bincount(rows, weights=side(*ends), minlength=m) for side in (np.minimum, np.maximum)
        )
    return lowest.astype(np.float64), highest.astype(np.float64)


def without_rounding(matrix: sp.csr_array) -> sp.csr_array:
    """Return the matrix without entries at rounding level relative to the largest of their row and column.

    The result of a cancelling sum of decimals must not influence the scaling.
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


class FarkasCertificate:
    """Inconsistency of linear constraints, proved by a Farkas vector y in exact arithmetic.

    y_i > 0 takes w_i ≥ 0 for granted, y_i < 0 takes w_i ≤ 0, and yᵀw = qᵀy + (Mᵀy)ᵀx for every x. If its supremum
    over the bounds is −c < 0, no x within the bounds gives all rows their signs: each misses some of them, and of
    bounds that may be missed too, by t in units u with t (Σ|y_i| u_i + Σ|(Mᵀy)_j| u_j) ≥ c. If Mᵀy should be 0 on an
    open side but is at rounding level of its terms, the proof covers all x with |x_j| ≤ `radius` there.

    Attributes
    ----------
    sides : LinearConstraints or Choices
        Signs of rows, bounds of unknowns, the matrix and q.
    y : mapping of int to Fraction
        Entries by row, none of them 0.
    rows : IntegerMatrix, optional
        M, if it is known in integers.
    left : dict of int to Fraction
        Entries of Mᵀy that are not 0 on open sides.
    plain : Fraction
        c without the contribution of `left`.
    """

    def __init__(
        self, sides: Any, y: Mapping[int, Fraction], rows: IntegerMatrix | None = None
    ) -> None:
        self.sides, self.y = sides, y
        self.plain, self.left = ZERO, dict[int, Fraction]()
        self._integers, self._unit = dict[int, int](), ZERO  # the product is these times the unit
        if self.has_signs:
            self._combine(rows)

    @cached_property
    def product(self) -> dict[int, Fraction]:
        """The entries of Mᵀy that are not 0."""
        return {j: self._unit * value for j, value in self._integers.items()}

    def _combine(self, rows: IntegerMatrix | None) -> None:
        """Compute Mᵀy, c and what is left of open sides."""
        numbers, (whole, denominator) = list(self.y), common_denominator(list(self.y.values()))
        matrix = rows or IntegerMatrix.of(self.sides.matrix, numbers)
        unit = self._unit = power_of_two(matrix.exponent) / denominator
        product = self._integers = matrix.combination(dict(zip(numbers, whole, strict=True)))
        bounds = {j: self.sides.bounds(j)[value > 0] for j, value in product.items()}
        closed = [j for j, bound in bounds.items() if math.isfinite(bound)]
        highest = unit * exact_dot([product[j] for j in closed], [bounds[j] for j in closed])
        self.plain = -exact_dot(whole, self.sides.q[numbers].tolist()) / denominator - highest
        self.left = {j: unit * value for j, value in product.items() if math.isinf(bounds[j])}

    @cached_property
    def radius(self) -> float:
        """Bound of the |x_j| without bounds that the proof covers: ∞, or the value that leaves half the margin."""
        left = sum(map(abs, self.left.values()))
        return rounded_down(max(self.plain, ZERO) / (2 * left) if left else None)

    @property
    def size(self) -> Fraction:
        """A lower bound of c, within the radius."""
        return self.plain / 2 if self.left else self.plain

    @property
    def has_signs(self) -> bool:
        """True if each y_i has the sign required by its row."""
        return all(self.sides.signs(i)[value < 0] for i, value in self.y.items())

    @property
    def holds(self) -> bool:
        """True if it is a proof for all x."""
        return self.has_signs and not self.left and self.plain > 0

    @cached_property
    def sizes(self) -> tuple[Fraction, FloatVector, FloatVector]:
        """The largest |y_i|, the |y_i| divided by it, and Σ|y_i m_ij| of each column in this unit."""
        largest = max(map(abs, self.y.values()))
        y = np.array([float(abs(value) / largest) for value in self.y.values()])
        return largest, y, abs(self.sides.matrix[list(self.y)]).T @ y

    def is_wide_beside_terms(self, known: Mapping[int, float] | None = None) -> bool:
        """Return whether x of 10⁸ times the size that it has itself leaves half the contradiction.

        That size is Σ|y_i q_i| / Σ|y_i m_ij|, at which the terms of column j are as large as the terms of q, or a known
        size if that is larger; columns of size 0 do not count.
        """
        if not self.left:
            return True
        (largest, y, terms), known = self.sizes, known or {}
        offset = float(y @ np.abs(self.sides.q[list(self.y)]))
        with np.errstate(all="ignore"):
            moved = sum(
                float(abs(value) / largest) * max(offset / terms[j], known.get(j, 0.0))
                for j, value in self.left.items()
                if known.get(j) != 0.0
            )
        return bool(float(self.plain / largest) >= 2.0 * WIDE * moved)

    def is_rounding(self, first: int = 0) -> bool:
        """Return whether sums that should be 0 are at rounding level of their terms; data are larger."""
        left = {j: value for j, value in self.left.items() if j >= first}
        if not left:
            return True
        largest, _, terms = self.sizes
        return all(
            abs(value) <= largest * Fraction(DATA_ROUNDING * float(terms[j]))
            for j, value in left.items()
        )

    def miss(self, weights: FloatVector) -> float:
        """Return the least violation, by any x, in these units, rounded down; 0 after overflow."""
        used = [float(weights[i]) for i in self.y]
        if not all(map(math.isfinite, used)):
            return 0.0
        whole, denominator = common_denominator([abs(value) for value in self.y.values()])
        return rounded_down(self.size * denominator / exact_dot(whole, used))


def exact_dot(factors: Sequence[int], values: Sequence[float]) -> Fraction:
    """Return Σ factor · value without rounding; the values are finite."""
    whole, exponent = integers(np.array(values, dtype=np.float64))
    total: Fraction = power_of_two(exponent) * sum(map(operator.mul, factors, whole))
    return total
