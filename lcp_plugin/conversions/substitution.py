"""Variables that an equation only defines, put in and taken out: cvxpy writes sum_squares(Ax − b) as t = Ax − b."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from ..checks import FloatVector, rectangular_matrix
from ..matrix.definiteness import is_diagonal
from ..matrix.structure import row_numbers
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

    A variable is only defined where it is free, stands in one row of A and in no row of G. With K the variables that
    stay, x_defined = D x_K + f leaves P_KK + P_Kd D + Dᵀ P_dK + Dᵀ P_dd D of P, and of G and the other rows of A the
    columns K.

    Attributes
    ----------
    rows, defined : ndarray of int
        Rows of A, and the variable that each defines.
    pivots : ndarray
        The entries of A there.
    kept, kept_rows : ndarray of int
        The variables and the rows of A that stay.
    columns : ndarray of int
        Of the variables that stay, those that define something.
    D : ndarray or CSR array
        Its columns of these only.
    reduced : ProgramMatrices
    """

    rows: Indices
    defined: Indices
    pivots: FloatVector
    kept: Indices
    kept_rows: Indices
    columns: Indices
    D: Any
    reduced: ProgramMatrices

    @classmethod
    def of(cls, matrices: ProgramMatrices, candidates: Indices) -> Definitions:
        """Return what the equations define of these variables, each of which stands in one row of A only."""
        A, by_column = as_csr(matrices.A), sp.csc_array(matrices.A)
        rows, entries = (part[by_column.indptr[candidates]] for part in (by_column.indices, by_column.data))
        # The largest entry of a row is the safest pivot.
        order = np.lexsort((-np.abs(entries), rows))
        rows, first = np.unique(rows[order], return_index=True)
        defined, pivots = candidates[order[first]], entries[order[first]]
        kept, kept_rows = _others(A.shape[1], defined), _others(A.shape[0], rows)
        columns, D = _coefficients(A[rows], defined, pivots, kept)
        P = _without(matrices.P, kept, defined, columns, D)
        G, others = (rectangular_matrix(part[:, kept], "rows", None, None) for part in (matrices.G, A[kept_rows]))
        return cls(rows, defined, pivots, kept, kept_rows, columns, D, ProgramMatrices(P, G, others))

    def expanded(self, y: FloatVector) -> FloatVector:
        """Return x of the y = x_K that stay, with f = 0."""
        x = np.zeros(self.kept.size + self.defined.size)
        x[self.kept], x[self.defined] = y, self.D @ y[self.columns]
        return x

    def gathered(self, gradient: FloatVector) -> FloatVector:
        """Return the gradient in x_K of what has this one in x."""
        of_kept: FloatVector = gradient[self.kept]
        of_kept[self.columns] += self.D.T @ gradient[self.defined]
        return of_kept


@dataclass(frozen=True, eq=False)
class Substitution:
    """A program and the smaller one without the variables that an equation of their own defines.

    Attributes
    ----------
    program, reduced : QuadraticProgram
        Before and after.
    definitions : Definitions
    offset : ndarray, shape (n,)
        f, and 0 where a variable stays.
    """

    program: QuadraticProgram
    reduced: QuadraticProgram
    definitions: Definitions
    offset: FloatVector

    def expanded(self, y: FloatVector) -> FloatVector:
        """Return x of the variables that stay."""
        return self.definitions.expanded(y) + self.offset

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
        found.reduced, found.gathered(program.P @ offset + program.c), program.h, program.b[found.kept_rows],
        program.lower[found.kept], program.upper[found.kept],
    )
    return Substitution(program, reduced, found, offset)


def _coefficients(A: sp.csr_array, defined: Indices, pivots: FloatVector, kept: Indices) -> tuple[Indices, Any]:
    """Return the variables that stay and stand in these rows, and −a_ij / pivot_i, an ndarray where that is full."""
    row = row_numbers(A)
    stays = A.indices != defined[row]
    row, place = row[stays], np.zeros(A.shape[1], dtype=np.int64)
    place[kept] = np.arange(kept.size)
    column = place[A.indices[stays]]
    columns = np.flatnonzero(np.bincount(column, minlength=kept.size))
    place[columns] = np.arange(columns.size)
    starts = np.concatenate([[0], np.cumsum(np.diff(A.indptr) - 1)])
    shape = (defined.size, columns.size)
    D = sp.csr_array((A.data[stays] / -pivots[row], place[column], starts), shape=shape)
    return columns, D.toarray() if is_full(D.nnz, shape) else D


def _without(P: Any, kept: Indices, defined: Indices, columns: Indices, D: Any) -> Any:
    """Return P in the variables that stay."""
    if is_diagonal(P):
        of_kept, of_defined = (_diagonal(P.diagonal()[part]) for part in (kept, defined))
        across = None
    else:
        rows = P[kept]
        of_kept, across, of_defined = rows[:, kept], rows[:, defined], P[defined][:, defined]
    added = _spread(D.T @ (of_defined @ D), columns, columns, kept.size)
    if across is not None and np.count_nonzero(across.data if sp.issparse(across) else across):
        mixed = _spread(across @ D, np.arange(kept.size), columns, kept.size)
        added = added + (mixed + mixed.T)
    # What cancels leaves rounding errors, which differ on the two sides of the diagonal.
    return rectangular_matrix(of_kept + (added + added.T) * 0.5, "P", None, None)


def _diagonal(entries: FloatVector) -> sp.csr_array:
    filled = np.flatnonzero(entries)
    starts = np.searchsorted(filled, np.arange(entries.size + 1))
    return sp.csr_array((entries[filled], filled, starts), shape=(entries.size, entries.size))


def _spread(block: Any, rows: Indices, columns: Indices, n: int) -> Any:
    """Return the matrix, shape (n, n), that has the block in these rows and columns, in ascending order."""
    if rows.size == columns.size == n:
        return block
    block, counts = as_csr(block), np.zeros(n, dtype=np.int64)
    block.sort_indices()
    counts[rows] = np.diff(block.indptr)
    starts = np.concatenate([[0], np.cumsum(counts)])
    return sp.csr_array((block.data, columns[block.indices], starts), shape=(n, n))


def _others(count: int, indices: Indices) -> Indices:
    """Return the numbers below `count` that are not among the indices."""
    return np.delete(np.arange(count), indices)
