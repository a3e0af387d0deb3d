"""Variables that an equation only defines, put in and taken out: cvxpy writes sum_squares(Ax − b) as t = Ax − b."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from ..checks import FloatVector, rectangular_matrix
from .blocks import as_csr
from .program import QuadraticProgram
from .program_matrices import ProgramMatrices, is_full
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
class Definitions:
    """Which equations define a variable each, and the matrices of the program without them: no vector is in it.

    A variable is only defined where it is free, stands in one row of A and in no row of G: x = E y + f then leaves
    P ← EᵀP E, and of G and the other rows of A the columns of the variables that stay.

    Attributes
    ----------
    rows, defined : ndarray of int
        Rows of A, and the variable that each defines.
    pivots : ndarray
        The entries of A there.
    kept, kept_rows : ndarray of int
        The variables and the rows of A that stay.
    expansion : E, an ndarray where it is full.
    reduced : ProgramMatrices
    """

    rows: Indices
    defined: Indices
    pivots: FloatVector
    kept: Indices
    kept_rows: Indices
    expansion: Any
    reduced: ProgramMatrices

    @classmethod
    def of(cls, matrices: ProgramMatrices, candidates: Indices) -> Definitions:
        """Return what the equations define of these variables, each of which stands in one row of A only."""
        P, A, n = matrices.P, as_csr(matrices.A), matrices.P.shape[0]
        by_column = sp.csc_array(A)
        rows, entries = (part[by_column.indptr[candidates]] for part in (by_column.indices, by_column.data))
        # The largest entry of a row is the safest pivot.
        order = np.lexsort((-np.abs(entries), rows))
        rows, first = np.unique(rows[order], return_index=True)
        defined, pivots = candidates[order[first]], entries[order[first]]
        order = np.argsort(defined)
        rows, defined, pivots = rows[order], defined[order], pivots[order]
        kept, kept_rows = _others(n, defined), _others(A.shape[0], rows)
        expansion = _expansion(A[rows], defined, pivots, kept)
        # What cancels leaves rounding errors, which differ on the two sides of the diagonal.
        curvature = expansion.T @ (P @ expansion)
        curvature = rectangular_matrix((curvature + curvature.T) * 0.5, "P", None, None)
        G, others = (rectangular_matrix(part[:, kept], "rows", None, None) for part in (matrices.G, A[kept_rows]))
        return cls(rows, defined, pivots, kept, kept_rows, expansion, ProgramMatrices(curvature, G, others))


@dataclass(frozen=True, eq=False)
class Substitution:
    """A program and the smaller one without the variables that an equation of their own defines.

    Attributes
    ----------
    program, reduced : QuadraticProgram
        Before and after: c ← Eᵀ(P f + c), and of all other vectors the entries that stay.
    definitions : Definitions
    offset : f of x = E y + f.
    """

    program: QuadraticProgram
    reduced: QuadraticProgram
    definitions: Definitions
    offset: FloatVector

    def expanded(self, y: FloatVector) -> FloatVector:
        """Return x = E y + f."""
        x: FloatVector = self.definitions.expansion @ y + self.offset
        return x

    def recover(self, solution: QPSolution) -> QPSolution:
        """Return the solution of the program from that of the smaller one, all multipliers included."""
        program, x, found = self.program, self.expanded(solution.x), self.definitions
        constraints, n = program.constraints, program.n
        equations = program.h.size + found.rows
        y = np.zeros(constraints.limit.size)
        stays = np.ones(y.size, dtype=bool)
        for gone in (equations, constraints.rows + found.defined, constraints.rows + n + found.defined):
            stays[gone] = False
        y[stays] = solution.multipliers
        # Each defined column meets its own equation only, whose multiplier is what stationarity leaves to it.
        y[equations] = -(program.P @ x + program.c)[found.defined] / found.pivots
        return QPSolution(program, x, *constraints.split(y))


def substitute_definitions(program: QuadraticProgram) -> Substitution | None:
    """Return the substitution of all variables that are only defined, or None where there are none.

    Examples
    --------
    min t² with t = x − 1 and x ≥ 0 is min (x − 1)²:

    >>> program = QuadraticProgram([[0, 0], [0, 2]], [0, 0], A=[[1, -1]], b=[1], lower=[0, -np.inf])
    >>> substitute_definitions(program).reduced.P
    array([[2.]])
    """
    matrices = program.matrices
    is_free = (program.lower == -np.inf) & (program.upper == np.inf)
    candidates = np.flatnonzero(is_free & matrices.is_definable)
    if not candidates.size:
        return None
    found = matrices.kept("definitions", (candidates,), lambda: Definitions.of(matrices, candidates))
    offset = np.zeros(program.n)
    offset[found.defined] = program.b[found.rows] / found.pivots
    reduced = QuadraticProgram.with_matrices(
        found.reduced, found.expansion.T @ (program.P @ offset + program.c), program.h, program.b[found.kept_rows],
        program.lower[found.kept], program.upper[found.kept],
    )
    return Substitution(program, reduced, found, offset)


def _expansion(A: sp.csr_array, defined: Indices, pivots: FloatVector, kept: Indices) -> Any:
    """Return E: the rows of I where a variable stays, and −a_ij / pivot_i where row i defines it, in their order."""
    counts = np.ones(A.shape[1], dtype=np.int64)
    counts[defined] = np.diff(A.indptr) - 1
    starts = np.concatenate([[0], np.cumsum(counts)])
    row = np.repeat(np.arange(defined.size), np.diff(A.indptr))
    position, stays = np.zeros(A.shape[1], dtype=np.int64), A.indices != defined[row]
    position[kept] = np.arange(kept.size)
    columns, entries, of_kept = np.empty(starts[-1], dtype=np.int64), np.ones(starts[-1]), starts[kept]
    is_defined = np.ones(starts[-1], dtype=bool)
    is_defined[of_kept] = False
    columns[of_kept], columns[is_defined] = np.arange(kept.size), position[A.indices[stays]]
    entries[is_defined] = -A.data[stays] / pivots[row[stays]]
    expansion = sp.csr_array((entries, columns, starts), shape=(A.shape[1], kept.size))
    return expansion.toarray() if is_full(expansion) else expansion


def _others(count: int, indices: Indices) -> Indices:
    """Return the numbers below `count` that are not among the indices."""
    return np.delete(np.arange(count), indices)
