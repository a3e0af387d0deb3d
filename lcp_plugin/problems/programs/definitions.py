"""Programs without the variables that an equation of their own defines, as cvxpy writes t = A x − b.

An equation that defines an unknown goes with it, for what it fills in of P: with D the entries of such equations, P
gets DᵀP D, which is full where equations are long and few. Left where they are they cost L their own entries. Which are
worth it is predicted from counts of entries: the multiplications of a factorisation.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
import scipy.sparse as sp

from ...core.checks import FloatVector, assembled, rectangular_matrix
from ...core.matrix.structure import row_numbers
from ...methods.presolve import like
from ...proofs.exact.rational import products, rational_rows
from ...systems.definiteness import is_diagonal
from ...systems.symmetry import is_its_mirror
from .program_matrices import Indices, ProgramMatrices, as_csr, block, diagonal_array, is_full
from .reductions import Purpose, Step
from .scaling import ProgramScaling

if TYPE_CHECKING:
    from .program import QuadraticProgram

STEPS = 6  # numbers of entries that are tried as limits, each half of the one before


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
class Substitution(Step):
    """The program without the variables that an equation of their own defines.

    Attributes
    ----------
    definitions : Definitions
    offset : ndarray, shape (rows that define,)
        f.
    """

    computes: ClassVar[bool] = True
    remark: ClassVar[str] = "defined variables put in"

    definitions: Definitions
    offset: FloatVector

    @classmethod
    def for_purpose(cls, program: QuadraticProgram, purpose: Purpose) -> Substitution | None:
        """Return that of a program for the purpose."""
        if purpose is Purpose.AS_IT_STANDS or not program.b.size:
            return None
        return cls.of(program, saves_work=purpose is Purpose.LEAST_WORK)

    @classmethod
    def of(cls, program: QuadraticProgram, *, saves_work: bool = False) -> Substitution | None:
        """Return the substitution of all variables that are only defined, or None where there are none.

        With `saves_work` of those that are predicted to make the program less work.

        Examples
        --------
        min t² with t = x − 1 and x ≥ 0 is min (x − 1)²:

        >>> from lcp_plugin import QuadraticProgram
        >>> program = QuadraticProgram([[0, 0], [0, 2]], [0, 0], A=[[1, -1]], b=[1], lower=[0, -np.inf])
        >>> Substitution.of(program).reduced.P
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
        reduced = program.with_matrices(
            found.reduced, c, program.h, program.b[found.kept_rows],
            program.lower[found.kept], program.upper[found.kept],
        )
        scaling = program.scaling
        unknown = None if scaling.leaves_unknowns else scaling.unknown[found.kept]
        reduced.__dict__["scaling"] = ProgramScaling.of_unknowns(reduced, unknown)
        return cls(program, reduced, found, offset)

    def inward(self, x: FloatVector, multipliers: FloatVector) -> tuple[FloatVector, FloatVector]:
        """Return the variables that stay, and the multipliers of the constraints that do."""
        return x[self.definitions.kept], np.delete(multipliers, self._gone)

    def point(self, x: Any, *, is_direction: bool = False) -> Any:
        """Return x of all variables."""
        found, whole = self.definitions, np.zeros(self.program.n, dtype=x.dtype)
        whole[found.kept] = x
        if x.dtype != object:
            defined = found.D @ x[found.columns]
            whole[found.defined] = defined if is_direction else defined + self.offset
            return whole
        right = 0 if is_direction else like(self.program.b[found.rows], x)
        left = products(rational_rows(as_csr(self.program.A)[found.rows]), whole.tolist())
        whole[found.defined] = (right - np.array(list(left), dtype=object)) / like(found.pivots, x)
        return whole

    def multipliers(self, reduced: Any, x: FloatVector | None) -> Any:
        """Return those of all constraints: a defined column meets only its own equation, which balances it."""
        program, found = self.program, self.definitions
        whole = np.zeros(program.constraints.rows + 2 * program.n, dtype=reduced.dtype)
        whole[np.delete(np.arange(whole.size), self._gone)] = reduced
        if x is not None:
            whole[program.h.size + found.rows] = -(program.P @ x + program.c)[found.defined] / found.pivots
        return whole

    @property
    def _gone(self) -> Indices:
        """The constraints of the program that the smaller one has not."""
        rows, n, found = self.program.constraints.rows, self.program.n, self.definitions
        return np.concatenate([self.program.h.size + found.rows, rows + found.defined, rows + n + found.defined])


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


def worth_putting_in(D: sp.csr_array) -> Indices:
    """Return the rows of D that are put in where the program is to be solved with the fewest multiplications.

    All, none, or those with few entries.

    Examples
    --------
    Four residuals of two unknowns are put in, two of four are not; and of a long row and short ones these:

    >>> worth_putting_in(sp.csr_array(np.ones((4, 2)))), worth_putting_in(sp.csr_array(np.ones((2, 4))))
    (array([0, 1, 2, 3]), array([], dtype=int64))
    >>> worth_putting_in(sp.csr_array(np.vstack([np.ones((1, 9)), np.eye(9)])))
    array([1, 2, 3, 4, 5, 6, 7, 8, 9])
    """
    m, n = D.shape[0], np.count_nonzero(np.bincount(D.indices, minlength=D.shape[1]))
    if D.nnz == m * n:  # a full block
        return np.arange(m if n**3 <= 3 * n * m**2 + m**3 else 0)
    lengths, rows = np.diff(D.indptr), row_numbers(D)
    best, least = np.arange(0), _of_rows_left(rows, D.indices, D.shape)
    for limit in _limits(lengths):
        is_in = lengths <= limit
        if is_in.all():
            work = full_work(product_entries(rows, D.indices, D.shape))
        else:
            inside = is_in[rows]
            work = full_work(product_entries(rows[inside], D.indices[inside], D.shape))
            work += _of_rows_left(rows[~inside], D.indices[~inside], D.shape)
        if work <= least:
            best, least = np.flatnonzero(is_in), work
    return best


def _limits(counts: Any) -> list[int]:
    """Return some of the counts, each at most half of the one before, from the largest one on."""
    present, found = np.unique(counts), list[int]()
    while present.size and len(found) < STEPS:
        found.append(int(present[-1]))
        present = present[2 * present <= found[-1]]
    return found


def _of_rows_left(rows: Any, columns: Any, shape: tuple[int, int]) -> float:
    """Return the multiplications of eliminating the columns, each with the rows it has, and then what the rows are."""
    counts = np.bincount(columns, minlength=shape[1]).astype(np.float64)
    return 0.5 * float(counts @ counts) + full_work(product_entries(columns, rows, shape[::-1]))


def full_work(entries: float) -> float:
    """Return the multiplications that a symmetric matrix with so many entries takes, all in one block."""
    return float(entries * np.sqrt(entries)) / 6.0


def product_entries(rows: Any, columns: Any, shape: tuple[int, int]) -> float:
    """Return how many entries CᵀC has at the most, C with these entries: long columns, in a block, and short ones."""
    counts = np.bincount(columns, minlength=shape[1])
    lengths = np.bincount(rows, minlength=shape[0]).astype(np.float64)
    least = min(float(lengths @ lengths), float(np.count_nonzero(counts)) ** 2)
    for limit in _limits(counts)[1:]:
        long = np.bincount(rows[(counts > limit)[columns]], minlength=shape[0])
        short = lengths - long
        least = min(least, float(np.count_nonzero(counts > limit)) ** 2 + float(2.0 * long @ short + short @ short))
    return least
