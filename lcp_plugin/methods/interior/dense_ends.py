"""Newton matrices of programs whose factor ends in a dense block, which LAPACK eliminates.

In an order of little fill L is sparse at first, and its last columns are full: those of a lasso's residuals or of a
portfolio's factors, of which the others know only few; of the separators of a grid. With the last k rows apart,

    [[K₁₁, K₁₂], [K₂₁, K₂₂]] = L D Lᵀ   leaves   S = K₂₂ − L₂₁ D₁ L₂₁ᵀ,

quasi-definite as the whole. Columns of L₂₁ that are full themselves are multiplied at once; S, its rows with positive
pivots first, is two Cholesky factors. What comes out is L and D in one pattern as without that, and solves alike.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp

from ...core.checks import FloatVector, read_only
from ...core.matrix.structure import row_numbers
from ...core.tuning import BLOCKED_ENTRY, BLOCKED_FROM, BLOCKED_RATE
from .newton_matrix import DenseNewtonMatrix, NewtonMatrix, SparseNewtonMatrix, signed_cholesky
from .quasidefinite import QuasidefiniteNewtonMatrix, Symbolic

DENSE_UP_TO = 150  # rows up to which a sparse M is factorised by LAPACK, with pivoting
FULL = (1.0, 0.9, 0.75, 0.6)  # shares of the entries of the last columns from which on these are a dense block
LEAP, CLASSES = 1.2, 4  # rows with so many times as many entries as the next ones may be dense; so often at the most
NARROW = 2.0 * (BLOCKED_ENTRY + BLOCKED_FROM) * BLOCKED_RATE / (BLOCKED_RATE - 1.0)  # rows: fewer gain nothing
TALL = 3.0  # times as many dense rows as columns that share them are not looked at
SOLVES = 20.0  # times that an entry of L is used after each factorisation
KEPT_PATTERNS, KEPT_ENTRIES = 16, 50_000  # how many are kept, each of so many entries at the most
SHARED_BY = 3.0  # times the work of the dense block that an order with dense rows last may take in all


@dataclass(frozen=True, eq=False)
class DenseEnd(Symbolic):
    """Order and pattern of a factor with a dense block at its end, zeros stored where that makes others full.

    Attributes
    ----------
    slot : ndarray of int, shape (n,)
        Numbers the columns whose entries in the last rows are multiplied as one dense matrix; −1 elsewhere.
    last, positive : int
        Rows of the dense block, and of these the first ones that have positive pivots.
    """

    slot: Any
    last: int
    positive: int


class DensePart(NamedTuple):
    """Which columns are a dense block, which others are full in its rows, and what a factorisation takes then.

    `fill` zeros become entries of L. Work is in multiplications of compiled loops; `by_lapack` is LAPACK's part of it.
    """

    first: int
    is_blocked: Any
    fill: float
    work: float
    by_lapack: float


def analysed(M: sp.csr_array, signs: FloatVector) -> Symbolic:
    """Return order and pattern of a factor of M, canonical, with a dense end where that is predicted to be quicker.

    Those of small patterns are kept: a program that is stated anew with other numbers has the same.
    """
    if M.nnz > KEPT_ENTRIES:
        return _analysed(M, signs)
    return _of_pattern(M.indptr.tobytes(), M.indptr.dtype, M.indices.tobytes(), M.indices.dtype, signs.tobytes())


@lru_cache(maxsize=KEPT_PATTERNS)
def _of_pattern(indptr: bytes, of_starts: Any, indices: bytes, of_columns: Any, signs: bytes) -> Symbolic:
    starts, columns = np.frombuffer(indptr, of_starts), np.frombuffer(indices, of_columns)
    M = sp.csr_array((np.ones(columns.size), columns, starts), shape=(starts.size - 1, starts.size - 1))
    return _analysed(M, np.frombuffer(signs))


def _analysed(M: sp.csr_array, signs: FloatVector) -> Symbolic:
    order, last = dense_rows_last(M, signs)
    if last:
        symbolic = in_order(M, order)
        part = dense_part(symbolic, last)
        if part is not None and part.work <= SHARED_BY * part.by_lapack:
            return rearranged(symbolic, part, signs)
    symbolic = Symbolic.of(M)
    part = dense_part(symbolic)
    return symbolic if part is None else rearranged(symbolic, part, signs)


def dense_rows_last(M: sp.csr_array, signs: FloatVector) -> tuple[Any, int]:
    """Return an order with dense rows last, before them those that share entries with most of these; and how many.

    0 where LAPACK would gain nothing. To minimum degree the unknowns of a lasso have few neighbours, as it leaves dense
    rows out: it eliminates them first, which fills the rows of their bounds.
    """
    degrees = np.diff(M.indptr)
    if np.count_nonzero(is_almost(degrees, NARROW)) < NARROW / TALL:
        return None, 0
    sizes, counts = np.unique(degrees, return_counts=True)
    leaps = sizes[1:] / np.maximum(sizes[:-1], 1)
    most, chosen = 0.0, None
    for k in np.argsort(-leaps, kind="stable")[:CLASSES]:
        count, is_last = float(counts[k + 1 :].sum()), degrees > sizes[k]
        if leaps[k] < LEAP:
            break
        reach = np.add.reduceat(np.append(is_last[M.indices], False), M.indptr[:-1], dtype=np.int64)
        is_shared = ~is_last & (degrees > 0) & is_almost(reach, count)
        shared = float(np.count_nonzero(is_shared))
        gain = 0.5 * shared * count**2 - lapack_work(count, shared) - BLOCKED_FROM * shared * count
        if gain > most and count <= TALL * shared:
            most, chosen = gain, (is_shared, is_last)
    if chosen is None:
        return None, 0
    others = np.flatnonzero(~(chosen[0] | chosen[1]))
    first = others[Symbolic.of(sp.csr_array(M[others][:, others])).pattern[0]] if others.size else others
    dense = np.flatnonzero(chosen[1])
    dense = dense[np.argsort(-signs[dense], kind="stable")]
    return np.concatenate([first, np.flatnonzero(chosen[0]), dense]), dense.size


def is_almost(reach: Any, last: float) -> Any:
    """Return which columns with so many entries in the last rows are multiplied more quickly by LAPACK."""
    return BLOCKED_RATE * reach**2 >= max(last, 1.0) ** 2


def in_order(M: sp.csr_array, order: Any) -> Symbolic:
    """Return the pattern of L in that order."""
    from .kernels import dense_ends

    n, rows = M.shape[0], row_numbers(M)
    at = np.flatnonzero(M.indices < rows)
    position = np.empty(n, dtype=np.int64)
    position[order] = np.arange(n)
    above = _above(at, position[rows[at]], position[M.indices[at]], n)
    upper = above.indptr.astype(np.int64), above.indices.astype(np.int64)
    workspace, starts = np.empty((2, n), dtype=np.int64), np.zeros(n + 1, dtype=np.int64)
    columns = np.empty(2 * at.size + n, dtype=np.int64)
    while (count := dense_ends.rows_of_factor(*upper, *workspace, starts, columns)) > columns.size:
        columns = np.empty(count, dtype=np.int64)
    L = sp.csr_array((np.ones(count), columns[:count], starts), shape=(n, n))
    return _of(M.indptr, M.indices, order, L, above)


def _above(at: Any, first: Any, second: Any, n: int) -> sp.csc_array:
    return sp.csc_array((at, (np.minimum(first, second), np.maximum(first, second))), shape=(n, n))


def _of(indptr: Any, indices: Any, order: Any, L: Any, above: sp.csc_array) -> Symbolic:
    by_columns = sp.csc_array(L)
    by_rows = sp.csr_array(by_columns)
    parts = (
        (order, np.uint32), (by_columns.indptr, np.uint64), (by_columns.indices, np.uint32),
        (by_rows.indptr, np.uint64), (by_rows.indices, np.uint32), (above.indptr, np.uint64),
        (above.indices, np.uint32), (above.data, np.uint32),
    )
    pattern = tuple(read_only(part.astype(kind)) for part, kind in parts)
    counts = np.diff(by_columns.indptr).astype(np.float64)
    return Symbolic(indptr, indices, pattern, L.nnz, 0.5 * float(counts @ counts), 2.0 * L.nnz)


def dense_part(symbolic: Symbolic, expected: int = 0) -> DensePart | None:
    """Return what is best left to LAPACK, None where that is nothing; `expected` rows are among what is tried."""
    if symbolic.work <= 0.5 * NARROW * symbolic.entries:  # each column would have to be longer
        return None
    starts, _, row_starts, of_rows = symbolic.pattern[1:5]
    counts, n = np.diff(starts).astype(np.float64), starts.size - 1
    sums, sizes = np.cumsum(counts[::-1]), np.arange(n)
    best, least = None, symbolic.work - BLOCKED_FROM * symbolic.entries
    full = [np.flatnonzero(sums >= share * 0.5 * sizes * (sizes + 1)) for share in FULL]  # the last 1, 2, … columns
    for first in (n - expected, *(n - 1 - int(columns[-1]) for columns in full if columns.size)):
        reach = np.bincount(of_rows[row_starts[first] :], minlength=n)[:first]  # how many of the last rows each has
        is_blocked = is_almost(reach, n - first)
        among, entries = reach[is_blocked], counts[first:]
        by_lapack = lapack_work(n - first, float(among.size))
        fill = (among.size + 0.5 * (n - first - 1)) * (n - first) - float(among.sum() + entries.sum())
        work = symbolic.work - 0.5 * float(among @ among + entries @ entries) + by_lapack + SOLVES * fill
        if work < least:
            least, best = work, DensePart(first, is_blocked, fill, work, by_lapack)
    return best


def lapack_work(last: float, blocked: float) -> float:
    """Return what LAPACK takes of a factorisation, in multiplications of compiled loops."""
    multiplications = 0.5 * blocked * last**2 + last**3 / 6.0
    return multiplications / BLOCKED_RATE + BLOCKED_ENTRY * (blocked + 0.5 * last) * last


def rearranged(symbolic: Symbolic, part: DensePart, signs: FloatVector) -> DenseEnd:
    """Return the pattern with its last rows sorted by sign, and full where it is almost full."""
    order, starts, below, _, _, above_starts, above, at = symbolic.pattern
    n, first, blocked = order.size, part.first, np.flatnonzero(part.is_blocked)
    last, moved = n - first, np.argsort(-signs[order[first:]], kind="stable")
    if part.fill or (np.diff(moved) < 0).any():
        position = np.arange(n)
        position[first + moved] = np.arange(first, n)
        order = np.concatenate([order[:first], order[first:][moved]])
        columns, rows = np.repeat(np.arange(n), np.diff(starts.astype(np.int64))), position[below]
        is_kept = columns < first
        is_kept[is_kept] = ~(part.is_blocked[columns[is_kept]] & (rows[is_kept] >= first))
        lower, upper = np.tril_indices(last, -1)
        rows = np.concatenate([rows[is_kept], np.tile(np.arange(first, n), blocked.size), first + lower])
        columns = np.concatenate([columns[is_kept], np.repeat(blocked, last), first + upper])
        places = position[above], position[np.repeat(np.arange(n), np.diff(above_starts.astype(np.int64)))]
        L = sp.coo_array((np.ones(rows.size), (rows, columns)), shape=(n, n)).tocsr()
        symbolic = _of(symbolic.indptr, symbolic.indices, order, L, _above(at, *places, n))
    slot = np.full(n, -1, dtype=np.int64)
    slot[blocked] = np.arange(blocked.size)
    positive = int(np.count_nonzero(signs[order[first:]] > 0.0))
    return DenseEnd(**symbolic.__dict__ | {"work": part.work}, slot=read_only(slot), last=last, positive=positive)


class DenseEndNewtonMatrix(QuasidefiniteNewtonMatrix):
    """LDLᵀ in compiled loops and, of the dense block at its end, by LAPACK."""

    symbolic: DenseEnd

    def __init__(self, M: sp.csr_array, signs: FloatVector, symbolic: DenseEnd) -> None:
        super().__init__(M, signs, symbolic)
        blocked = int(symbolic.slot.max(initial=-1)) + 1
        self._block, self._rest = np.empty((blocked, symbolic.last)), np.empty((symbolic.last, symbolic.last))

    steps = NewtonMatrix.steps  # LAPACK has its part in each

    def _eliminate(self) -> bool:
        from .kernels import dense_ends

        known = self.symbolic
        arrays = *known.pattern, self._signed, self._values, self._pivots, self._spare[0]
        if not dense_ends.eliminate(*arrays, known.slot, self._block, self._rest):
            return False
        rest = _without(self._rest, self._block, np.sign(self._pivots[known.slot >= 0]))
        factor = signed_cholesky(rest, known.positive)
        if factor is None:
            return False
        dense_ends.store(
            known.pattern[1], self._values, self._pivots, known.slot, self._block, factor.T, known.positive
        )
        return True


def _without(left: FloatVector, block: FloatVector, signs: FloatVector) -> FloatVector:
    """Return left − blockᵀ diag(signs) block, by columns, in the lower triangle."""
    from scipy.linalg import blas

    rest = np.asfortranarray(left)
    for sign in (1.0, -1.0):
        part = block.T if (signs == sign).all() else block[signs == sign].T
        if part.shape[1]:
            rest = blas.dsyrk(-sign, part, 1.0, rest, lower=1, overwrite_c=1)
    return rest


def newton_matrix(
    M: Any, is_symmetric: bool, signs: FloatVector | None = None, symbolic: Symbolic | None = None
) -> NewtonMatrix:
    """Return the Newton matrix that suits M: dense or small, of a quadratic program with these signs, or sparse."""
    if not sp.issparse(M):
        return DenseNewtonMatrix(M, is_symmetric, signs)
    if signs is not None:
        known = symbolic if symbolic is not None and symbolic.fits(M) else analysed(M, signs)
        if isinstance(known, DenseEnd):
            return DenseEndNewtonMatrix(M, signs, known)
        return QuasidefiniteNewtonMatrix(M, signs, known)
    if M.shape[0] <= DENSE_UP_TO:
        return DenseNewtonMatrix(M.toarray(), is_symmetric)
    return SparseNewtonMatrix(M)
