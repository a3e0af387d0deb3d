"""The constraints of a quadratic program as one list of rows; the scaling of its data."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from ...core.checks import FloatVector
from ...core.rounding import compensated_product, upper_end
from ...proofs.exact.rational import Row, rational_rows
from ...proofs.no_solution.linear_constraints import LinearConstraints
from .program_matrices import Indices, ProgramMatrices, as_csr

if TYPE_CHECKING:
    from .program import QuadraticProgram


@dataclass(frozen=True, eq=False)
class Constraints:
    """Rows C x ≤ d, equations among them: G x ≤ h, A x = b, −x ≤ −lower, x ≤ upper; a limit of ∞ says nothing.

    Attributes
    ----------
    matrices : ProgramMatrices
    limit : ndarray
        d.
    coefficient : ndarray
        The largest one of each in the program's own scaling.
    """

    matrices: ProgramMatrices
    limit: FloatVector
    coefficient: FloatVector

    @classmethod
    def of(cls, program: QuadraticProgram) -> Constraints:
        """Return the constraints of a program."""
        limit = np.concatenate([program.h, program.b, -program.lower, program.upper])
        return cls(program.matrices, limit, program.scaling.coefficient)

    @property
    def matrix(self) -> sp.csr_array:
        """C, shape (m + p + 2n, n)."""
        return self.matrices.constraints

    @property
    def is_equality(self) -> NDArray[np.bool_]:
        """Which rows are equations."""
        return self.matrices.is_equality

    @property
    def sizes(self) -> tuple[int, int, int, int]:
        """m, p, n, n: how many rows are of G, of A, and of each kind of bound."""
        return self.matrices.sizes

    @property
    def rows(self) -> int:
        """Number of rows of G and A."""
        return self.sizes[0] + self.sizes[1]

    @property
    def finite(self) -> Indices:
        """The rows that say something."""
        return np.flatnonzero(np.isfinite(self.limit))

    def split(self, values: Any) -> list[Any]:
        """Return the parts of one value a row: of G, of A, of the lower and of the upper bounds."""
        ends = np.cumsum(self.sizes).tolist()
        return [values[end - size : end] for end, size in zip(ends, self.sizes, strict=True)]

    @cached_property
    def unit(self) -> FloatVector:
        """What the residual of each row is relative to: sizes of its data, the same for every x.

        The largest coefficient in the program's own scaling plus the right-hand side: the row's own, so that no large
        number elsewhere excuses it. Where multipliers y contradict by c, every x violates some row by
        (c / Σ|y_i| unit_i) · unit_i at least: "optimal" and "infeasible" exclude each other.
        """
        right = np.abs(self.limit)
        with np.errstate(over="ignore"):
            return np.asarray(self.coefficient + np.where(np.isfinite(right), right, 0.0))

    @cached_property
    def as_rows(self) -> LinearConstraints:
        """All of them, bounds too, as rows of x that has none, with w = d − C x."""
        free, kept = np.full((2, self.matrix.shape[1]), np.inf), np.zeros(self.matrix.shape[1])
        return LinearConstraints(
            -self.matrix, self.limit, np.isfinite(self.limit), self.is_equality, -free[0], free[1], self.unit,
            (kept, kept),
        )

    @cached_property
    def within_bounds(self) -> LinearConstraints:
        """The rows of G and A within the bounds, with w = d − C x."""
        rows, (_, _, below, above) = slice(self.rows), self.split(self.limit)
        units = self.split(self.unit)
        return LinearConstraints(
            -self.matrices.rows, self.limit[rows], np.isfinite(self.limit[rows]), self.is_equality[rows],
            -below, above, self.unit[rows], (units[2], units[3]),
        )

    @cached_property
    def exactly(self) -> list[Row]:
        """The rows of C in fractions."""
        return rational_rows(self.matrix)

    def excess(self, x: FloatVector) -> FloatVector:
        """Return by how much x violates each row, −∞ to 0 where it holds; proved upper bounds, ∞ where it overflows."""
        is_finite = np.isfinite(self.limit)
        with np.errstate(all="ignore"):
            value, radius = compensated_product(self.matrix, x, np.where(is_finite, -self.limit, 0.0))
        above = upper_end(np.where(self.is_equality, np.abs(value), value), radius)
        return np.where(is_finite, above, -np.inf)


def dual_unit(program: QuadraticProgram) -> FloatVector:
    """Return what each component of a program's dual residual is relative to: sizes of its data.

    In the program's own scaling, where the largest coefficient of a row is 1: the largest entry of each column of P, G
    and A (1 where there is none) times 1 + the largest |c_j| ÷ that; where there is a P, the largest right-hand side
    of an equation, and of an inequality that x = 0 violates, if that is larger. Along a direction d of descent some
    component of the dual residual is at least (−cᵀd / Σ|d_j| dual_j) · dual_j, whatever x and the multipliers are.
    """
    column, size = program.column_sizes, program.size_of_multipliers
    return np.asarray(program.scaling.objective * (column * size) / program.scaling.unknown)


def stationarity(program: QuadraticProgram, P: Any) -> LinearConstraints:
    """Return P x + Gᵀy + Aᵀv + c with the signs that the bounds ask for, y ≥ 0; of P some rows that span the others."""
    rows = as_csr(program.G)[np.flatnonzero(np.isfinite(program.h))]
    matrix = sp.csr_array(sp.vstack([P, rows, as_csr(program.A)], format="csr").T)
    free, nothing = np.full(matrix.shape[1], np.inf), np.zeros(matrix.shape[1])
    is_inequality = np.repeat([False, True, False], [P.shape[0], rows.shape[0], program.b.size])
    return LinearConstraints(
        matrix, program.c, np.isinf(program.upper), np.isinf(program.lower),
        np.where(is_inequality, 0.0, -np.inf), free, program.dual_unit, (nothing, nothing),
    )
