"""Programs made smaller, and the way back for x and for multipliers.

Equations that only define a variable go with it, as cvxpy writes sum_squares(A x − b) as t = A x − b; then rows that
are only bounds become bounds.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy.sparse as sp

from ...core.checks import FloatVector, assembled, rectangular_matrix
from ...core.matrix.structure import row_numbers
from ...methods.presolve import like
from ...systems.definiteness import is_diagonal
from ...systems.symmetry import is_its_mirror
from .own_units import OwnUnits
from .predicted_work import worth_putting_in
from .program_matrices import Indices, ProgramMatrices, as_csr, block, diagonal_array, is_full

if TYPE_CHECKING:
    from .program import QuadraticProgram

OWN = -1  # the variable's own bound, not a row's
EVERY = slice(None)


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
        Of the variables that stay, those that D is kept for: where it is an ndarray, those that define something.
    D : ndarray or CSR array
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
    def of(cls, matrices: ProgramMatrices, candidates: Indices, saves_work: bool) -> Definitions | None:
        """Return what the equations define of these variables, each of which stands in one row of A only.

        With `saves_work` only of those that are predicted to be worth it; None where there are none.
        """
        A, is_kept = as_csr(matrices.A), np.zeros(matrices.P.shape[0], dtype=bool)
        is_kept[candidates] = True
        places = np.flatnonzero(is_kept[A.indices])
        rows, entries = row_numbers(A)[places], A.data[places]
        # The largest entry of a row is the safest pivot.
        order = np.lexsort((-np.abs(entries), rows))
        rows, first = np.unique(rows[order], return_index=True)
        places = places[order[first]]
        is_kept[:] = True
        is_kept[A.indices[places]] = False
        kept = np.flatnonzero(is_kept)
        D = block(A, rows, kept)
        chosen = worth_putting_in(D) if saves_work else np.arange(rows.size)
        if not chosen.size:
            return None
        if chosen.size < rows.size:
            is_kept[:] = True
            rows, places = rows[chosen], places[chosen]
            is_kept[A.indices[places]] = False
            kept = np.flatnonzero(is_kept)
            D = block(A, rows, kept)
        defined, pivots, stays = A.indices[places].astype(np.intp), A.data[places], np.ones(A.shape[0], dtype=bool)
        stays[rows] = False
        kept_rows, every_row = np.flatnonzero(stays), np.arange(matrices.G.shape[0])
        columns, used = np.arange(kept.size), np.flatnonzero(np.bincount(D.indices, minlength=kept.size))
        D = assembled(D.data / -pivots[row_numbers(D)], D.indices, D.indptr, D.shape)
        if is_full(D.nnz, (defined.size, used.size)):
            columns, D = used, (D if used.size == kept.size else block(D, np.arange(rows.size), used)).toarray()
        P = _without(matrices.P, kept, defined, columns, D)
        G, others = block(matrices.G, every_row, kept), block(A, kept_rows, kept)
        return cls(rows, defined, pivots, kept, kept_rows, columns, D, ProgramMatrices(P, G, others))


@dataclass(frozen=True, eq=False)
class Substitution:
    """A program and the smaller one without the variables that an equation of their own defines.

    Attributes
    ----------
    program, reduced : QuadraticProgram
        Before and after.
    definitions : Definitions
    offset : ndarray, shape (rows that define,)
        f.
    """

    program: QuadraticProgram
    reduced: QuadraticProgram
    definitions: Definitions
    offset: FloatVector

    def expanded(self, y: FloatVector) -> FloatVector:
        """Return x of the variables that stay."""
        found, x = self.definitions, np.zeros(self.program.n)
        x[found.kept], x[found.defined] = y, found.D @ y[found.columns] + self.offset
        return x

    def inward(self, x: FloatVector, multipliers: FloatVector) -> tuple[FloatVector, FloatVector]:
        """Return the variables that stay, and the multipliers of all constraints of the smaller program."""
        return x[self.definitions.kept], np.delete(multipliers, self._gone)

    @property
    def _gone(self) -> Indices:
        """The constraints of the program that the smaller one has not."""
        rows, n, found = self.program.constraints.rows, self.program.n, self.definitions
        return np.concatenate([self.program.h.size + found.rows, rows + found.defined, rows + n + found.defined])

    def restored(self, y: FloatVector, multipliers: FloatVector) -> tuple[FloatVector, FloatVector]:
        """Return x and the multipliers of all constraints of the program, from those of the smaller one."""
        program, x, found = self.program, self.expanded(y), self.definitions
        whole = np.zeros(program.constraints.rows + 2 * program.n)
        whole[np.delete(np.arange(whole.size), self._gone)] = multipliers
        # Each defined column meets its own equation only, whose multiplier is what stationarity leaves to it.
        whole[program.h.size + found.rows] = -(program.P @ x + program.c)[found.defined] / found.pivots
        return x, whole


def substitute_definitions(program: QuadraticProgram, *, saves_work: bool = False) -> Substitution | None:
    """Return the substitution of all variables that are only defined, or None where there are none.

    With `saves_work` of those that are predicted to make the program less work.

    Examples
    --------
    min t² with t = x − 1 and x ≥ 0 is min (x − 1)²:

    >>> from lcp_plugin import QuadraticProgram
    >>> program = QuadraticProgram([[0, 0], [0, 2]], [0, 0], A=[[1, -1]], b=[1], lower=[0, -np.inf])
    >>> substitute_definitions(program).reduced.P
    array([[2.]])
    """
    matrices = program.matrices
    is_free = (program.lower == -np.inf) & (program.upper == np.inf)
    candidates = np.flatnonzero(is_free & matrices.is_definable)
    if not candidates.size:
        return None
    name = "cheap definitions" if saves_work else "definitions"
    found = matrices.kept(name, (candidates,), lambda: Definitions.of(matrices, candidates, saves_work))
    if found is None:
        return None
    shift, offset = np.zeros(program.n), program.b[found.rows] / found.pivots
    shift[found.defined] = offset
    gradient = program.P @ shift + program.c
    c = gradient[found.kept]
    c[found.columns] += found.D.T @ gradient[found.defined]
    reduced = _in_units_of(program, program.with_matrices(
        found.reduced, c, program.h, program.b[found.kept_rows], program.lower[found.kept], program.upper[found.kept]
    ), found.kept)
    return Substitution(program, reduced, found, offset)


def _without(P: Any, kept: Indices, defined: Indices, columns: Indices, D: Any) -> Any:
    """Return P in the variables that stay."""
    if is_diagonal(P):
        d = P.diagonal()
        added, mixed = D.T @ _rows_scaled(d[defined], D), None
        of_kept = diagonal_array(d[kept], kept.size) if d[kept].any() else None
    else:
        order = np.argsort(defined)
        defined, D = defined[order], D[order]
        of_kept, across, of_defined = block(P, kept, kept), block(P, kept, defined), block(P, defined, defined)
        added = D.T @ (of_defined @ D)
        mixed = across @ D if np.count_nonzero(across.data if sp.issparse(across) else across) else None
    if columns.size < kept.size:
        count = columns.size
        place = assembled(np.ones(count), columns, np.arange(count + 1), (count, kept.size))
        added, mixed = place.T @ as_csr(added) @ place, None if mixed is None else as_csr(mixed) @ place
    if mixed is not None:
        added = added + (mixed + mixed.T)
    # What cancels leaves rounding errors, which differ on the two sides of the diagonal.
    if sp.issparse(added) and added.format == "csc":  # by columns what is, but for these, its rows
        added.sort_indices()
        added = sp.csr_array((added.data, added.indices, added.indptr), shape=added.shape)
    if not (sp.issparse(added) and is_its_mirror(added)):
        added = (added + added.T) * 0.5
    whole = added if of_kept is None else of_kept + added
    return rectangular_matrix(whole, "P", None, None, is_copied=False)


def _rows_scaled(scale: FloatVector, matrix: Any) -> Any:
    """Return diag(scale) times an ndarray or a CSR array."""
    if not sp.issparse(matrix):
        return scale[:, None] * matrix
    return assembled(scale[row_numbers(matrix)] * matrix.data, matrix.indices, matrix.indptr, matrix.shape)


@dataclass(frozen=True, eq=False)
class FoldedRows:
    """A program with its singleton rows folded into its bounds, and the way back for multipliers.

    Attributes
    ----------
    program, folded : QuadraticProgram
        Before and after; the same object where no row went.
    left : ndarray of int
        Rows of [G; A] that remain.
    lower_row, upper_row : ndarray of int, shape (n,)
        The row of [G; A] that gives the bound, or −1.
    coefficient : ndarray, shape (rows of G + rows of A,)
        The only entry of a singleton row; 1 elsewhere.
    """

    program: QuadraticProgram
    folded: QuadraticProgram
    left: Indices
    lower_row: Indices
    upper_row: Indices
    coefficient: FloatVector

    def unfold(self, multipliers: Any) -> Any:
        """Return the multipliers of all constraints of the program, from those of the folded one.

        What a bound has, its row gets. Of doubles, or of Fractions: these without rounding.
        """
        rows, lower, upper = np.split(multipliers, [self.left.size, self.left.size + self.program.n])
        every = np.zeros(self.coefficient.size, dtype=multipliers.dtype)
        every[self.left] = rows
        own = []
        for owner, share, sign in ((self.lower_row, lower, -1), (self.upper_row, upper, 1)):
            moved = np.flatnonzero((owner != OWN) & (share != 0))
            every[owner[moved]] += sign * share[moved] / like(self.coefficient[owner[moved]], multipliers)
            own.append(np.where(owner == OWN, share, 0))
        return np.concatenate([every, *own])


def fold_simple_rows(program: QuadraticProgram) -> FoldedRows:
    """Return the program's bounds and rows with singleton, empty and unlimited rows gone.

    A row g x_j ≤ h or a x_j = b becomes a bound; 0 ≤ h, 0 = 0 and g x ≤ ∞ are dropped. What cannot hold – 0 ≤ −1, or
    singleton rows whose bounds contradict one another – stays a row: that it has no solution is for a solver to find.
    Done once for a program.
    """
    known: FoldedRows | None = program.__dict__.get("_folded")
    if known is None:
        known = program.__dict__["_folded"] = _folded(program)
    return known


def _folded(program: QuadraticProgram) -> FoldedRows:
    matrices, right = program.matrices, np.concatenate([program.h, program.b])
    is_equality, (rows, columns, coefficient) = matrices.is_equality[: right.size], matrices.singletons
    with np.errstate(over="ignore"):
        limits = right[rows] / coefficient[rows]
    is_finite = np.isfinite(limits)
    rows, columns, limits = rows[is_finite], columns[is_finite], limits[is_finite]
    above, below = (is_equality[rows] | (sign * coefficient[rows] > 0.0) for sign in (1.0, -1.0))
    upper, upper_row = _tightest(program.upper, limits[above], columns[above], rows[above])
    negated, lower_row = _tightest(-program.lower, -limits[below], columns[below], rows[below])
    lower = -negated + 0.0  # no negative zeros
    contradicts = lower > upper
    lower[contradicts], upper[contradicts] = program.lower[contradicts], program.upper[contradicts]
    lower_row[contradicts] = upper_row[contradicts] = OWN

    is_empty = np.diff(matrices.rows.indptr) == 0
    stays = ~(np.where(is_equality, right == 0.0, right >= 0.0) & is_empty | (right == np.inf))
    stays[rows[~contradicts[columns]]] = False
    left = np.flatnonzero(stays)
    folded = program
    if left.size < right.size:
        folded = program.with_matrices(
            matrices.of_rows(left), program.c, program.h[left[left < program.h.size]],
            right[left[left >= program.h.size]], lower, upper,
        )
        folded.__dict__["units"] = program.units.of_rows(left)  # what a row says does not depend on where it stands
    return FoldedRows(program, folded, left, lower_row, upper_row, coefficient)


def _in_units_of(
    program: QuadraticProgram, smaller: QuadraticProgram, kept: Indices | slice = EVERY
) -> QuadraticProgram:
    """Return the smaller program, the unknowns that are kept in the units that they have in the whole one."""
    units = program.units
    unknown = None if units.are_the_users else units.unknown[kept]
    smaller.__dict__["units"] = OwnUnits.of_unknowns(smaller, unknown)
    return smaller


def _tightest(own: FloatVector, limits: FloatVector, columns: Indices, rows: Indices) -> tuple[FloatVector, Indices]:
    """Return the smallest limit of each variable and the row it comes from; a variable's own bound wins a tie."""
    tightest, owner = own.copy(), np.full(own.size, OWN)
    np.minimum.at(tightest, columns, limits)
    gives = np.flatnonzero((limits == tightest[columns]) & (limits < own[columns]))[::-1]  # of equal ones the first
    owner[columns[gives]] = rows[gives]
    return tightest, owner
