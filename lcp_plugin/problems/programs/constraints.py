"""The constraints of a quadratic program as one list of rows."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from ...core.checks import FloatVector
from ...core.matrix.matrix import largest_in_rows
from ...core.rounding import compensated_product, upper_end
from ...proofs.exact.rational import Row, rational_rows
from ...proofs.no_solution.linear_constraints import LinearConstraints
from .program_matrices import Indices, ProgramMatrices, or_one

if TYPE_CHECKING:
    from .program import QuadraticProgram

NOISE = 1e-5  # of the coefficients of a row: 1e-14 of this on the right counts as a rounded 0


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
    limit: FloatVector

    @classmethod
    def of(cls, program: QuadraticProgram) -> Constraints:
        """Return the constraints of a program."""
        limit = np.concatenate([program.h, program.b, -program.lower, program.upper])
        return cls(program.matrices, limit)

    @property
    def matrix(self) -> sp.csr_array:
        """C, shape (m + p + 2n, n)."""
        return self.matrices.constraints

    @property
    def is_equality(self) -> NDArray[np.bool_]:
        """Mask of the equality rows."""
        return self.matrices.is_equality

    @property
    def sizes(self) -> tuple[int, int, int, int]:
        """m, p, n, n: numbers of rows of G, of A, of lower and of upper bounds."""
        return self.matrices.sizes

    @property
    def rows(self) -> int:
        """Number of rows of G and A."""
        return self.sizes[0] + self.sizes[1]

    @property
    def right(self) -> FloatVector:
        """[h; b]: the limits of the rows of G and A."""
        return self.limit[: self.rows]

    @property
    def finite(self) -> Indices:
        """The rows that say something."""
        return np.flatnonzero(np.isfinite(self.limit))

    def split(self, values: Any) -> list[Any]:
        """Return the parts of values per row: of G, of A, of the lower and of the upper bounds."""
        ends = np.cumsum(self.sizes).tolist()
        return [values[end - size : end] for end, size in zip(ends, self.sizes, strict=True)]

    @cached_property
    def own_sizes(self) -> FloatVector:
        """Size of each row: |right-hand side|, or 1e-5 of its smallest coefficient if larger; 1 without coefficients.

        An inconsistency at rounding level, relative to all unscaled coefficients, is attributed to rounded data.
        """
        right = np.where(np.isfinite(self.limit), np.abs(self.limit), 0.0)
        inverse = largest_in_rows(self.matrix, 1.0 / np.abs(self.matrix.data))
        return np.maximum(right, NOISE / np.where(inverse > 0.0, inverse, NOISE))

    @cached_property
    def unit(self) -> FloatVector:
        """Largest |coefficient| of each row plus its |right-hand side|: weight in searches for a certificate."""
        right = np.where(np.isfinite(self.limit), np.abs(self.limit), 0.0)
        return np.asarray(self.matrices.row_sizes + right)

    @cached_property
    def as_rows(self) -> LinearConstraints:
        """All constraints, including bounds, as rows of an unbounded x, with w = d − C x."""
        free, kept = np.full((2, self.matrix.shape[1]), np.inf), np.zeros(self.matrix.shape[1])
        return LinearConstraints(
            -self.matrix,
            self.limit,
            np.isfinite(self.limit),
            self.is_equality,
            -free[0],
            free[1],
            self.unit,
            (kept, kept),
        )

    @cached_property
    def within_bounds(self) -> LinearConstraints:
        """The rows of G and A within the bounds, with w = d − C x."""
        rows, (_, _, below, above) = slice(self.rows), self.split(self.limit)
        units = self.split(self.unit)
        return LinearConstraints(
            -self.matrices.rows,
            self.limit[rows],
            np.isfinite(self.limit[rows]),
            self.is_equality[rows],
            -below,
            above,
            self.unit[rows],
            (units[2], units[3]),
        )

    @cached_property
    def exactly(self) -> list[Row]:
        """The rows of C in fractions."""
        return rational_rows(self.matrix)

    def excess(self, x: FloatVector) -> FloatVector:
        """Return proved upper bounds of the violation of each row: −∞ to 0 if satisfied, ∞ if a sum overflows."""
        is_finite = np.isfinite(self.limit)
        value, radius = compensated_product(self.matrix, x, np.where(is_finite, -self.limit, 0.0))
        above = upper_end(np.where(self.is_equality, np.abs(value), value), radius)
        return np.where(is_finite, above, -np.inf)


def stationarity(program: QuadraticProgram, P: Any) -> LinearConstraints:
    """Return P x + Gᵀy + Aᵀv + c with the signs that bounds require, y ≥ 0; P may contain only spanning rows."""
    rows = sp.csr_array(program.G)[np.flatnonzero(np.isfinite(program.h))]
    matrix = sp.csr_array(sp.vstack([P, rows, sp.csr_array(program.A)], format="csr").T)
    free, nothing = np.full(matrix.shape[1], np.inf), np.zeros(matrix.shape[1])
    is_inequality = np.repeat([False, True, False], [P.shape[0], rows.shape[0], program.b.size])
    return LinearConstraints(
        matrix,
        program.c,
        np.isinf(program.upper),
        np.isinf(program.lower),
        np.where(is_inequality, 0.0, -np.inf),
        free,
        or_one(largest_in_rows(matrix)) + np.abs(program.c),
        (nothing, nothing),
    )
