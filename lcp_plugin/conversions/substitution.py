"""Variables that an equation only defines, put in and taken out: cvxpy writes sum_squares(Ax − b) as t = Ax − b."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from ..checks import FloatVector
from .program import QuadraticProgram
from .qp_solution import QPSolution

Indices = NDArray[np.int64]


def put_in(matrix: Any, offset: FloatVector, columns: Indices) -> tuple[sp.csr_array, FloatVector]:
    """Return R and r of z ← R z + r, which puts in what matrix · z + offset = 0 says of the unknowns in the columns.

    Parameters
    ----------
    matrix : CSR array, shape (k, n)
        Row i defines the unknown ``columns[i]``, and none of the others.
    offset : ndarray, shape (k,)
    columns : ndarray of int, shape (k,)
    """
    k, n = matrix.shape
    pivots = np.asarray(matrix[np.arange(k), columns]).ravel()
    keep, shift = np.ones(n), np.zeros(n)
    keep[columns], shift[columns] = 0.0, -offset / pivots
    definition = sp.diags_array(-1.0 / pivots) @ matrix @ sp.diags_array(keep)
    place = sp.csr_array((np.ones(k), (columns, np.arange(k))), shape=(n, k))
    substitution = sp.csr_array(sp.diags_array(keep) + place @ definition)
    substitution.eliminate_zeros()
    return substitution, shift


@dataclass(frozen=True, eq=False)
class Substitution:
    """A program and the smaller one without the variables that an equation of their own defines.

    A variable is only defined where it is free, stands in one row of A and in no row of G. With x = E y + f the
    smaller program has EᵀP E, Eᵀ(P f + c), G E ≤ h − G f and the other rows of A.

    Attributes
    ----------
    program, reduced : QuadraticProgram
        Before and after.
    rows, defined : ndarray of int
        Rows of A, and the variable that each defines.
    expansion, offset : E and f.
    """

    program: QuadraticProgram
    reduced: QuadraticProgram
    rows: Indices
    defined: Indices
    expansion: Any
    offset: FloatVector

    def recover(self, solution: QPSolution) -> QPSolution:
        """Return the solution of the program from that of the smaller one, all multipliers included."""
        program, x = self.program, self.expansion @ solution.x + self.offset
        constraints, n = program.constraints, program.n
        equations = program.h.size + self.rows
        gone = [equations, constraints.rows + self.defined, constraints.rows + n + self.defined]
        y = np.zeros(constraints.limit.size)
        y[_others(y.size, np.concatenate(gone))] = solution.multipliers
        # Each defined column meets its own equation only, whose multiplier is what stationarity leaves to it.
        pivots = np.asarray(constraints.matrix[equations, self.defined]).ravel()
        y[equations] = -(program.P @ x + program.c)[self.defined] / pivots
        return QPSolution(program, x, *constraints.split(y))


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
    kept, kept_rows = _others(program.n, defined), _others(program.b.size, rows)
    whole, offset = put_in(A[rows], -program.b[rows], defined)
    expansion = whole[:, kept]
    gradient = program.P @ offset + program.c
    # What cancels leaves rounding errors, which differ on the two sides of the diagonal.
    curvature = sp.csr_array(expansion.T @ (program.P @ expansion))
    reduced = QuadraticProgram(
        (curvature + curvature.T) / 2, expansion.T @ gradient,
        G=sp.csr_array(program.G @ expansion), h=program.h - program.G @ offset,
        A=sp.csr_array(A[kept_rows] @ expansion), b=program.b[kept_rows] - A[kept_rows] @ offset,
        lower=program.lower[kept], upper=program.upper[kept],
    )
    return Substitution(program, reduced, rows, defined, expansion, offset)


def _definitions(program: QuadraticProgram) -> tuple[Indices, Indices]:
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


def _others(count: int, indices: Indices) -> Indices:
    """Return the numbers below `count` that are not among the indices."""
    return np.delete(np.arange(count), indices)
