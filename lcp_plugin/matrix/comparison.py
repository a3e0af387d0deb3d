"""The comparison matrix ⟨M⟩, equilibrated, and approximate solutions of systems with it.

Nothing here is rigorous: what is solved is verified by those who ask (:mod:`.h_matrix`).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import scipy.sparse as sp

from ..checks import FloatVector
from ..errors import InvalidProblem
from ..locks import Lock
from .equilibration import Exponents, scaled, scaling_exponents, times_power
from .factors import factor_fits, solver_of
from .matrix import Matrix, fact
from .structure import row_numbers
from .symmetry import is_symmetric_entrywise

Solver = Callable[[FloatVector], FloatVector]
BoolVector = np.ndarray[Any, np.dtype[np.bool_]]

DIRECT_LIMIT = 5_000  # below, a sparse LU is as fast as a hierarchy
KRYLOV_STEPS = 60


class ComparisonMatrix:
    """⟨M⟩ scaled by powers of two to a diagonal near 1 where M needs it, with cached factors.

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
        rows = row_numbers(M)
        on_diagonal = rows == M.indices
        self.is_symmetric = is_symmetric_entrywise(M)
        self.exponents: Exponents | None = scaling_exponents(M, rows, self.is_symmetric)
        magnitudes = np.abs(M.data)
        signed = np.where(on_diagonal, magnitudes, -magnitudes)
        comparison = sp.csr_array((signed, M.indices, M.indptr), shape=M.shape)
        self.matrix = scaled(comparison, rows, self.exponents)
        self.diagonal: FloatVector = self.matrix.diagonal()
        self._lock = Lock()
        self._whole: Solver | None = None
        self._hierarchy: Any = None
        self._multigrid_failed = False

    def to_caller(self, x: FloatVector) -> FloatVector:
        """Return the vector in the caller's unit that belongs to x of the scaled matrix, shape (n,)."""
        return times_power(x, None if self.exponents is None else self.exponents.column)

    def from_caller(self, rhs: FloatVector) -> FloatVector:
        """Return the right-hand side of the scaled matrix that belongs to the caller's, shape (n,)."""
        return times_power(rhs, None if self.exponents is None else self.exponents.row)

    def solve(self, rhs: FloatVector, rows: BoolVector | None = None, tolerance: float = 0.1) -> FloatVector | None:
        """Return an approximate solution x of matrix x = rhs on the rows given, zero elsewhere, shape (n,).

        None where no method applies: the matrix is singular, or too large for a factorisation where multigrid
        fails. `tolerance` bounds ‖residual‖₂/‖rhs‖₂ where the solution is iterative.
        """
        if rows is None or rows.all():
            return self._solve_whole(rhs, tolerance)
        x = np.zeros(rhs.size)
        solution = self._solve_part(np.flatnonzero(rows), rhs[rows], tolerance)
        if solution is None:
            return None
        x[rows] = solution
        return x

    def _solve_whole(self, rhs: FloatVector, tolerance: float) -> FloatVector | None:
        if rhs.size > DIRECT_LIMIT and not self._multigrid_failed:
            x = krylov(self.matrix, rhs, self.preconditioner(), tolerance, self.is_symmetric, KRYLOV_STEPS)
            if x is not None:
                return x
            self._multigrid_failed = True
        with self._lock.held():
            if self._whole is None:
                self._whole = _direct_solver(self.matrix)
        return None if self._whole is None else _finite(self._whole(rhs))

    def _solve_part(self, part: Any, rhs: FloatVector, tolerance: float) -> FloatVector | None:
        if part.size == 0:
            return rhs
        block = self.matrix[part][:, part]
        if part.size > DIRECT_LIMIT:
            # The hierarchy of the whole matrix needs 5 to 50 times the steps that one of the block needs.
            cycle = v_cycle(hierarchy(block))
            x = krylov(block, rhs, cycle, tolerance, self.is_symmetric, KRYLOV_STEPS)
            if x is not None:
                return x
        solver = _direct_solver(block)
        return None if solver is None else _finite(solver(rhs))

    def preconditioner(self) -> Solver:
        """Return one V-cycle of the cached hierarchy of the whole matrix."""
        with self._lock.held():
            if self._hierarchy is None:
                self._hierarchy = hierarchy(self.matrix)
        return v_cycle(self._hierarchy)


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
    x = comparison.solve(comparison.from_caller(rhs), rows, tolerance)
    return None if x is None else comparison.to_caller(x)


def _direct_solver(matrix: Any) -> Solver | None:
    return solver_of(matrix) if factor_fits(matrix) else None


def hierarchy(matrix: Any) -> Any:
    """Return a Ruge–Stüben hierarchy of a CSR array, or None where pyamg cannot take it."""
    if matrix.indices.dtype != np.int32:
        return None
    import pyamg

    copied = sp.csr_matrix((matrix.data, matrix.indices, matrix.indptr), shape=matrix.shape)
    with np.errstate(all="ignore"):
        # Direct interpolation halves the set-up and costs no step at loose tolerances.
        return pyamg.ruge_stuben_solver(copied, interpolation="direct", CF=("RS", {"second_pass": False}))


def v_cycle(levels: Any) -> Solver:
    """Return residual ↦ correction by one V-cycle (the identity where there is no hierarchy)."""
    if levels is None:
        return lambda residual: residual
    operator = levels.aspreconditioner(cycle="V")
    return lambda residual: np.asarray(operator.matvec(residual))


def krylov(
    matrix: Any, rhs: FloatVector, preconditioner: Solver, tolerance: float, is_symmetric: bool, steps: int
) -> FloatVector | None:
    """Return x with ‖rhs − matrix x‖₂ ≤ tolerance ‖rhs‖₂ by preconditioned CG or GMRES, or None within `steps`."""
    from scipy.sparse.linalg import LinearOperator, cg, gmres

    n = rhs.size
    operator = LinearOperator((n, n), matvec=preconditioner, dtype=np.float64)
    with np.errstate(all="ignore"):
        if is_symmetric:
            x, info = cg(matrix, rhs, rtol=tolerance, atol=0.0, maxiter=steps, M=operator)
        else:
            x, info = gmres(
                matrix, rhs, rtol=tolerance, atol=0.0, restart=min(steps, 30), maxiter=max(1, steps // 30), M=operator
            )
    return _finite(np.asarray(x)) if info == 0 else None


def _finite(x: FloatVector) -> FloatVector | None:
    return x if np.isfinite(x).all() else None
