"""The comparison matrix ⟨M⟩, equilibrated, and approximate solutions of systems with it.

Nothing here is rigorous: what is solved is verified by those who ask (:mod:`.h_matrix`).
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy.sparse as sp

from ..checks import BoolVector, FloatVector
from ..errors import InvalidProblem
from .equilibration import Exponents, scaled, scaling_exponents, times_power
from .factors import factor_fits, solver_of
from .matrix import Matrix, fact
from .structure import row_numbers
from .symmetry import is_symmetric_entrywise

if TYPE_CHECKING:
    from .hierarchy.grids import Hierarchy

Solver = Callable[[FloatVector], FloatVector]

DIRECT_LIMIT = 5_000  # below, a sparse LU is as fast as a hierarchy
KRYLOV_STEPS = 60


def comparison_of(M: Any) -> sp.csr_array:
    """Return ⟨M⟩ for a CSR array, or for rows of one that begin with their own columns."""
    magnitudes = np.abs(M.data)
    signed = np.where(row_numbers(M) == M.indices, magnitudes, -magnitudes)
    return sp.csr_array((signed, M.indices, M.indptr), shape=M.shape)


class LinearSystem:
    """A system that is solved approximately: by Krylov steps on its grids where it is large, else by a factor.

    Parameters
    ----------
    matrix : CSR array, shape (n, n)
        Canonical, with a positive diagonal.
    is_symmetric : bool
    """

    def __init__(self, matrix: Any, is_symmetric: bool) -> None:
        self.matrix, self.is_symmetric = matrix, is_symmetric
        self._multigrid_failed = False

    @cached_property
    def hierarchy(self) -> Hierarchy:
        """The grids of the matrix."""
        from .hierarchy.levels import build_hierarchy

        return build_hierarchy(self.matrix)

    @cached_property
    def direct_solver(self) -> Solver | None:
        """Rhs ↦ matrix⁻¹ rhs by a factor, or None where the matrix is singular or too large for one."""
        return solver_of(self.matrix) if factor_fits(self.matrix) else None

    def solve(self, rhs: FloatVector, tolerance: float = 0.1) -> FloatVector | None:
        """Return an approximate solution, shape (n,), or None where no method applies.

        The matrix is then singular, or too large for a factorisation where multigrid fails. `tolerance` bounds
        ‖residual‖₂/‖rhs‖₂ where the solution is iterative.
        """
        if rhs.size > DIRECT_LIMIT and not self._multigrid_failed:
            x = self.iterated(rhs, tolerance)
            if x is not None:
                return x
            self._multigrid_failed = True
        return None if self.direct_solver is None else _finite(np.asarray(self.direct_solver(rhs)))

    @np.errstate(all="ignore")
    def iterated(self, rhs: FloatVector, tolerance: float) -> FloatVector | None:
        """Return x with ‖rhs − matrix x‖₂ ≤ tolerance ‖rhs‖₂ by Krylov steps, or None within a number of them."""
        from .hierarchy.truncation import KrylovCorrection, Truncation

        correction = KrylovCorrection(Truncation(self.hierarchy), rhs.copy(), self.is_symmetric)
        goal = tolerance * np.linalg.norm(correction.residual)
        for _ in range(KRYLOV_STEPS):
            if not np.linalg.norm(correction.residual) > goal or not correction.step():
                break
        if not np.linalg.norm(correction.residual) <= goal:
            return None
        x = np.empty(rhs.size)
        correction.apply_to(np.zeros(rhs.size), x)
        return _finite(x)


class ComparisonMatrix(LinearSystem):
    """⟨M⟩ scaled by powers of two to a diagonal near 1 where M needs it.

    Parameters
    ----------
    M : CSR array, shape (n, n)
        Its diagonal has no zero.

    Attributes
    ----------
    matrix : CSR array, shape (n, n)
        ⟨M⟩ with entries scaled by 2^(row_i + column_j).
    exponents : Exponents or None
        None where nothing was scaled.
    diagonal : array, shape (n,)
        Of `matrix`; positive.
    """

    def __init__(self, M: Any) -> None:
        is_symmetric = is_symmetric_entrywise(M)
        self.exponents: Exponents | None = scaling_exponents(M, is_symmetric)
        super().__init__(scaled(comparison_of(M), self.exponents), is_symmetric)
        self.diagonal: FloatVector = self.matrix.diagonal()

    def to_caller(self, x: FloatVector) -> FloatVector:
        """Return the vector in the caller's unit that belongs to x of the scaled matrix, shape (n,)."""
        return times_power(x, None if self.exponents is None else self.exponents.column)

    def from_caller(self, rhs: FloatVector) -> FloatVector:
        """Return the right-hand side of the scaled matrix that belongs to the caller's, shape (n,)."""
        return times_power(rhs, None if self.exponents is None else self.exponents.row)

    def solve_part(self, rhs: FloatVector, rows: BoolVector, tolerance: float) -> FloatVector | None:
        """Return an approximate solution of the system of these rows and columns, zero elsewhere, shape (n,), or None.

        The hierarchy of the whole matrix would need 5 to 50 times the steps that one of the block needs.
        """
        part = np.flatnonzero(rows)
        x = np.zeros(rhs.size)
        if part.size:
            block = LinearSystem(self.matrix[part][:, part], self.is_symmetric)
            solution = block.solve(rhs[part], tolerance)
            if solution is None:
                return None
            x[part] = solution
        return x


@fact
def shared_comparison(matrix: Matrix) -> ComparisonMatrix:
    """Return the comparison matrix ⟨M⟩; the diagonal has no zero."""
    return ComparisonMatrix(matrix.csr)


@np.errstate(all="ignore")  # what overflows is seen by those who verify
def comparison_solve(
    matrix: Matrix, rhs: FloatVector, rows: BoolVector | None = None, tolerance: float = 0.1
) -> FloatVector | None:
    """Return an approximate solution x of ⟨M⟩_FF x_F = rhs_F, zero outside F, shape (n,).

    Parameters
    ----------
    matrix : Matrix
        M, whose diagonal has no zero.
    rhs : array, shape (n,)
        Entries outside F are not read.
    rows : bool array, shape (n,), optional
        The set F; all rows by default.
    tolerance : float
        Bound of ‖residual‖₂/‖rhs‖₂ after equilibration where the solution is iterative (n above some thousands).

    Returns
    -------
    array or None
        None where ⟨M⟩_FF is numerically singular, or so large that only multigrid applies and it fails. The
        solution is not verified.

    Raises
    ------
    InvalidProblem
        Where a diagonal entry is zero.

    Examples
    --------
    >>> comparison_solve(Matrix([[2, 1], [-1, 2]]), np.ones(2))
    array([1., 1.])
    """
    if not matrix.diagonal.all():
        row = int(np.flatnonzero(matrix.diagonal == 0.0)[0])
        raise InvalidProblem(f"M[{row}, {row}] = 0; a system with ⟨M⟩ needs a diagonal without zeros")
    comparison = shared_comparison(matrix)
    scaled_rhs = comparison.from_caller(rhs)
    if rows is None or rows.all():
        x = comparison.solve(scaled_rhs, tolerance)
    else:
        x = comparison.solve_part(scaled_rhs, rows, tolerance)
    return None if x is None else comparison.to_caller(x)


def _finite(x: FloatVector) -> FloatVector | None:
    return x if np.isfinite(x).all() else None
