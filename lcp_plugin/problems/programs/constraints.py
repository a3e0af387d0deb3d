"""The constraints of a quadratic program as one list of rows."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import accumulate, pairwise
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from ...core.checks import Indices, Vector
from ...core.entries import largest_in_rows
from ...core.rounding import compensated_product, upper_end
from ...judges.program import NOISE
from ...proofs.exact import Row, rational_rows
from ...proofs.farkas import LinearConstraints
from .program_matrices import ProgramMatrices


def sums_and_terms(rows: sp.csr_array, y: Vector) -> tuple[Any, Any]:
    """Return yᵀM and |y|ᵀ|M| of a CSR array, which is not transposed.

    Examples
    --------
    >>> sums_and_terms(sp.csr_array([[1.0, -2.0], [0.0, 3.0]]), np.array([1.0, 1.0]))
    (array([1., 1.]), array([1., 5.]))
    """
    terms: Vector = np.repeat(y, np.diff(rows.indptr)) * rows.data
    both = terms, np.abs(terms)
    sums, sizes = (np.bincount(rows.indices, weights, rows.shape[1]) + 0.0 for weights in both)
    return sums, sizes


@dataclass(frozen=True, eq=False)
class Constraints:
    """Rows C x ≤ d, including equalities: G x ≤ h, A x = b, −x ≤ −lower, x ≤ upper; d_i = ∞ means no constraint.

    Attributes
    ----------
    matrices : ProgramMatrices
    limit : ndarray
        d.
    """

    matrices: ProgramMatrices
    limit: Vector

    @property
    def matrix(self) -> sp.csr_array:
        """C, shape (m + p + 2n, n)."""
        return self.matrices.constraints

    @property
    def is_equality(self) -> NDArray[np.bool_]:
        """Mask of the equality rows."""
        return self.matrices.is_equality

    @property
    def rows(self) -> int:
        """Number of rows of G and A."""
        return sum(self.matrices.sizes[:2])

    @property
    def right(self) -> Vector:
        """[h; b]: the limits of the rows of G and A."""
        return self.limit[: self.rows]

    @property
    def finite(self) -> Indices:
        """The rows that say something."""
        return np.flatnonzero(np.isfinite(self.limit))

    def split(self, values: Vector) -> list[Any]:
        """Return the parts of values per row: of G, of A, of the lower and of the upper bounds."""
        ends = accumulate(self.matrices.sizes, initial=0)
        return [values[begin:end] for begin, end in pairwise(ends)]

    @cached_property
    def own_sizes(self) -> Vector:
        """Size of each row: |right-hand side|, or 1e-5 of its smallest coefficient if larger.

        The largest right-hand side takes the place of coefficients in a row that has none. An inconsistency at rounding
        level, relative to all unscaled coefficients, is attributed to rounded data.
        """
        limits = self._limit_sizes
        inverse = largest_in_rows(self.matrix, 1.0 / np.abs(self.matrix.data))
        has_entry, largest = inverse > 0.0, float(limits[: self.rows].max(initial=0.0))
        smallest = np.divide(1.0, inverse, where=has_entry, out=np.full(inverse.size, largest))
        return np.maximum(limits, NOISE * smallest)

    @property
    def coefficient_sizes(self) -> Vector:
        """Largest |coefficient| of each row and bound; 1 for a row without entries."""
        sizes = self.matrices.terms.row_sizes
        return np.append(sizes, np.ones(self.limit.size - sizes.size))

    @cached_property
    def unit(self) -> Vector:
        """Largest |coefficient| of each row plus its |right-hand side|: weight in searches for a certificate."""
        return self.coefficient_sizes + self._limit_sizes

    @property
    def _limit_sizes(self) -> Vector:
        return np.where(np.isfinite(self.limit), np.abs(self.limit), 0.0)

    @cached_property
    def as_rows(self) -> LinearConstraints:
        """All constraints, including bounds, as rows of an unbounded x, with w = d − C x."""
        free, kept = np.full(self.matrix.shape[1], np.inf), np.zeros(self.matrix.shape[1])
        return self._conditions(self.matrix, -free, free, (kept, kept))

    @cached_property
    def within_bounds(self) -> LinearConstraints:
        """The rows of G and A within the bounds, with w = d − C x."""
        (below, above), units = self.split(self.limit)[2:], self.split(self.unit)[2:]
        return self._conditions(self.matrices.terms.rows, -below, above, tuple(units))

    def _conditions(self, C: sp.csr_array, *bounds: Any) -> LinearConstraints:
        """Return the first rows, which C are, as w = d − C x with these bounds of x and their units."""
        vectors: tuple[Any, ...] = (self.limit, self.is_equality, self.unit)
        limit, is_equality, unit = (vector[: C.shape[0]] for vector in vectors)
        lower, upper, units = bounds
        return LinearConstraints(
            -C, limit, np.isfinite(limit), is_equality, lower, upper, unit, units
        )

    @cached_property
    def exactly(self) -> list[Row]:
        """The rows of C in fractions."""
        return rational_rows(self.matrix)

    def excess(self, x: Vector) -> Vector:
        """Return proved upper bounds of the violation of each row: −∞ to 0 if satisfied, ∞ if a sum overflows."""
        is_finite = np.isfinite(self.limit)
        value, radius = compensated_product(self.matrix, x, np.where(is_finite, -self.limit, 0.0))
        above = upper_end(np.where(self.is_equality, np.abs(value), value), radius)
        return np.where(is_finite, above, -np.inf)
