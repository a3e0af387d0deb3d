"""Variables that an equation only defines, put in and taken out: cvxpy writes sum_squares(Ax − b) as t = Ax − b."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from ..checks import FloatVector
from .qp_solution import QPSolution
from .quadratic_program import QuadraticProgram


@dataclass(frozen=True, eq=False)
class Substitution:
    """A program and the smaller one without the variables that an equation of their own defines.

    A variable is only defined where it is free, stands in one row of A and in no row of G. With x = E y + f the
    smaller program has EᵀP E, Eᵀ(P f + c), G E ≤ h − G f and the other rows of A.

    Attributes
    ----------
    program, reduced : QuadraticProgram
        Before and after.
    """

    program: QuadraticProgram
    reduced: QuadraticProgram
    defined: NDArray[np.int64]
    rows: NDArray[np.int64]
    kept_rows: NDArray[np.int64]
    kept: NDArray[np.int64]
    expansion: Any
    offset: FloatVector

    def recover(self, solution: QPSolution) -> QPSolution:
        """Return the solution of the program from that of the smaller one, all multipliers included."""
        x = self.expansion @ solution.x + self.offset
        equality = np.zeros(self.program.b.size)
        equality[self.kept_rows] = solution.equality
        # Each defined column meets its own equation only, whose multiplier is what stationarity leaves to it.
        gradient = (self.program.P @ x + self.program.c)[self.defined]
        pivots = np.asarray(sp.csr_array(self.program.A)[self.rows, self.defined]).ravel()
        equality[self.rows] = -gradient / pivots
        lower, upper = np.zeros(x.size), np.zeros(x.size)
        lower[self.kept], upper[self.kept] = solution.lower, solution.upper
        return QPSolution(self.program, x, solution.inequality, equality, lower, upper)


def substitute_definitions(program: QuadraticProgram) -> Substitution | None:
    """Return the substitution of all variables that are only defined, or None where there are none.

    Examples
    --------
    min t² with t = x − 1 and x ≥ 0 is min (x − 1)²:

    >>> program = QuadraticProgram([[0, 0], [0, 2]], [0, 0], A=[[1, -1]], b=[1], lower=[0, -np.inf])
    >>> substitute_definitions(program).reduced.P.toarray()
    array([[2.]])
    """
    rows, defined = _definitions(program)
    if not rows.size:
        return None
    A = sp.csr_array(program.A)
    kept = np.setdiff1d(np.arange(program.n), defined)
    kept_rows = np.setdiff1d(np.arange(program.b.size), rows)
    pivots = np.asarray(A[rows, defined]).ravel()
    expansion, offset = _expansion(A, program.b, rows, defined, kept, pivots)
    gradient = program.P @ offset + program.c
    # What cancels leaves rounding errors, which differ on the two sides of the diagonal.
    curvature = sp.csr_array(expansion.T @ (program.P @ expansion))
    reduced = QuadraticProgram(
        (curvature + curvature.T) / 2, expansion.T @ gradient,
        G=sp.csr_array(program.G @ expansion), h=program.h - program.G @ offset,
        A=sp.csr_array(A[kept_rows] @ expansion), b=program.b[kept_rows] - A[kept_rows] @ offset,
        lower=program.lower[kept], upper=program.upper[kept],
    )
    return Substitution(program, reduced, defined, rows, kept_rows, kept, expansion, offset)


def _definitions(program: QuadraticProgram) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return rows of A and the column that each defines, one column a row."""
    A, G = sp.csc_array(program.A), sp.csc_array(program.G)
    is_free = (program.lower == -np.inf) & (program.upper == np.inf)
    candidates = np.flatnonzero(is_free & (np.diff(A.indptr) == 1) & (np.diff(G.indptr) == 0))
    rows = A.indices[A.indptr[candidates]]
    # The largest entry of a row is the safest pivot.
    order = np.lexsort((-np.abs(A.data[A.indptr[candidates]]), rows))
    first, positions = np.unique(rows[order], return_index=True)
    columns = candidates[order[positions]]
    # A variable without a quadratic term defines nothing that would become strictly convex.
    is_quadratic = program.P.diagonal()[columns] > 0.0
    return first[is_quadratic].astype(np.int64), columns[is_quadratic].astype(np.int64)


def _expansion(
    A: Any, b: FloatVector, rows: NDArray[np.int64], defined: NDArray[np.int64], kept: NDArray[np.int64],
    pivots: FloatVector,
) -> tuple[Any, FloatVector]:
    """Return E and f of x = E y + f, y the kept variables."""
    n = A.shape[1]
    definition = sp.diags_array(-1.0 / pivots) @ A[rows][:, kept]
    place = sp.csr_array((np.ones(defined.size), (defined, np.arange(defined.size))), shape=(n, defined.size))
    same = sp.csr_array((np.ones(kept.size), (kept, np.arange(kept.size))), shape=(n, kept.size))
    offset = np.zeros(n)
    offset[defined] = b[rows] / pivots
    return sp.csr_array(same + place @ definition), offset
