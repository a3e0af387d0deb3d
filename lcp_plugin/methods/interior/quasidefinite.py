"""Newton matrices of quadratic programs: symmetric once the rows of the multipliers have their signs turned.

M = [[P, Aᵀ], [−A, Q]] with P and Q symmetric and semidefinite is monotone, and diag(s) (M + D), s = 1 above and −1
below, is [[P + D₁, Aᵀ], [A, −Q − D₂]]: quasi-definite for every D > 0, so that LDLᵀ exists in any order of the unknowns
(Vanderbei 1995, doi:10.1137/0805005). qdldl chooses one order of little fill for all D.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sp

from ...core.checks import FloatVector, read_only
from ...core.deadline import require_seconds
from ...core.tuning import SPARSE_OPERATIONS
from ...systems.factors import require_time_for_factor
from ...systems.graph import compressed_rows
from ...systems.refinement import REFINEMENTS
from .newton_matrix import DenseNewtonMatrix, NewtonMatrix, SparseNewtonMatrix

DEAR = (8.0, 30.0)  # times the work of a solve: factorisations that are worth one correction, or two
DENSE_UP_TO = 150  # rows up to which a sparse M is factorised by LAPACK, with pivoting
SAME = 1e-12  # entries that differ by less, beside their size, are the same but for rounding


@dataclass(frozen=True, eq=False)
class Symbolic:
    """The order and the pattern of L for every matrix with one pattern: made once, for all numbers, and never changed.

    Attributes
    ----------
    indptr, indices : ndarray of int
        The pattern of M that it is for, as of a canonical CSR array.
    pattern : tuple of arrays without signs
        For :mod:`lcp_plugin.methods.interior.kernels.symmetric_factors`: the order; L by columns (starts, rows); L by
        rows (starts, columns); what is above the diagonal in that order by columns (starts, rows, where M has it below
        its own).
    entries : int
        Of L.
    work, solve_work : float
        Multiplications of a factorisation, and of a solve.

    Examples
    --------
    >>> arrow = sp.csr_array(np.array([[1.0, 1.0, 1.0], [1.0, 1.0, 0.0], [1.0, 0.0, 1.0]]))
    >>> Symbolic.of(arrow).solve_work  # two entries of L, used twice: no fill where the first row comes last
    4.0
    """

    indptr: Any
    indices: Any
    pattern: tuple[Any, ...]
    entries: int
    work: float
    solve_work: float

    @classmethod
    def of(cls, M: sp.csr_array) -> Symbolic:
        """Return that of M, canonical, with the pattern of its transpose: qdldl's order, by minimum degree."""
        import qdldl

        n = M.shape[0]
        rows = np.repeat(np.arange(n), np.diff(M.indptr))
        at = np.flatnonzero(M.indices < rows)
        rows, columns = rows[at], M.indices[at]
        # Row by row the lower triangle, its diagonal last: column by column the upper one.
        starts = np.append(0, np.cumsum(np.bincount(rows, minlength=n) + 1))
        numbers = np.zeros(starts[-1])  # none is looked at, and no pivot of these is 0
        numbers[starts[1:] - 1] = 1.0
        indices = np.empty(numbers.size, dtype=np.int64)
        indices[numbers > 0.0], indices[numbers == 0.0] = np.arange(n), columns
        upper = sp.csc_array((numbers, indices, starts), shape=(n, n))
        try:
            require_time_for_factor(upper)
            solver = qdldl.Solver(upper, upper=True)
        except RuntimeError as error:  # no pivot is 0: it found no memory
            raise MemoryError(str(error)) from error
        lower, _, order = solver.factors()
        position = np.empty(n, dtype=np.int64)
        position[order] = np.arange(n)
        first, second = position[rows], position[columns]
        above = sp.csc_array((at, (np.minimum(first, second), np.maximum(first, second))), shape=(n, n))
        by_rows = sp.csc_array((np.ones(lower.nnz), lower.indices, lower.indptr), shape=(n, n)).tocsr()
        parts = (
            (order, np.uint32), (lower.indptr, np.uint64), (lower.indices, np.uint32), (by_rows.indptr, np.uint64),
            (by_rows.indices, np.uint32), (above.indptr, np.uint64), (above.indices, np.uint32),
            (above.data, np.uint32),
        )
        pattern = tuple(read_only(part.astype(kind)) for part, kind in parts)
        counts = np.diff(lower.indptr).astype(np.float64)
        return cls(M.indptr, M.indices, pattern, lower.nnz, float(counts @ counts) / 2.0, 2.0 * lower.nnz)

    def fits(self, M: sp.csr_array) -> bool:
        """Return whether M has this pattern."""
        is_same = self.indptr is M.indptr and self.indices is M.indices
        return is_same or (np.array_equal(self.indptr, M.indptr) and np.array_equal(self.indices, M.indices))


class QuasidefiniteNewtonMatrix(NewtonMatrix):
    """LDLᵀ in compiled loops, in the order that qdldl finds once for all matrices of one pattern.

    Attributes
    ----------
    symbolic : Symbolic
        Order and pattern, made here where no other matrix of the same pattern hands them on.
    """

    def __init__(self, M: sp.csr_array, signs: FloatVector, symbolic: Symbolic | None = None) -> None:
        super().__init__(M.shape[0], M)
        self.signs = read_only(signs)
        self.symbolic = symbolic if symbolic is not None and symbolic.fits(M) else Symbolic.of(M)
        self._own_diagonal, self._entries_of = M.diagonal(), compressed_rows(M)
        self._signed = np.repeat(signs, np.diff(M.indptr)) * M.data
        self._values, self._pivots = np.empty(self.symbolic.entries), np.empty(self.n)
        self._spare = np.empty((3, self.n))
        self._system = *self.symbolic.pattern[:3], self._values, self._pivots, self.signs, *self._entries_of

    def _try(self, shifted: FloatVector, right: FloatVector) -> FloatVector | None:
        from .kernels import symmetric_factors

        self.work += self.symbolic.work + self.symbolic.solve_work + self.M.nnz
        np.multiply(self.signs, self._own_diagonal + shifted, out=self._pivots)
        require_seconds(self.symbolic.work / SPARSE_OPERATIONS)
        x = np.empty(self.n)
        is_useful = self._eliminate() and symmetric_factors.is_useful(*self._system, shifted, right, x, self._spare)
        return x if is_useful else None

    def _eliminate(self) -> bool:
        """Fill L and D; return whether no pivot was 0."""
        from .kernels import symmetric_factors

        arrays = *self.symbolic.pattern, self._signed, self._values, self._pivots, self._spare[0]
        return bool(symmetric_factors.factorise(*arrays))

    @property
    def corrections(self) -> int:
        """As in every Newton matrix; the work is known."""
        times = self.symbolic.work / max(self.symbolic.solve_work, 1.0)
        return 2 if times > DEAR[1] else int(times > DEAR[0])

    def _refined(self, right: FloatVector, diagonal: FloatVector, enough: float) -> tuple[FloatVector, float, float]:
        from .kernels import symmetric_factors

        x = np.empty(self.n)
        error, size, passes = symmetric_factors.solve(
            *self._system, diagonal, right, x, self._spare, REFINEMENTS, enough
        )
        self.work += passes * (self.symbolic.solve_work + self.M.nnz)
        return x, error, size


def newton_matrix(
    M: Any, is_symmetric: bool, signs: FloatVector | None = None, symbolic: Symbolic | None = None
) -> NewtonMatrix:
    """Return the Newton matrix that suits M: dense or small, of a quadratic program with these signs, or sparse."""
    if not sp.issparse(M):
        return DenseNewtonMatrix(M, is_symmetric, signs)
    if signs is not None:
        return QuasidefiniteNewtonMatrix(M, signs, symbolic)
    if M.shape[0] <= DENSE_UP_TO:
        return DenseNewtonMatrix(M.toarray(), is_symmetric)
    return SparseNewtonMatrix(M)


def signs_of(M: Any) -> FloatVector | None:
    """Return s of ±1, shape (n,), with diag(s) M symmetric to rounding, or None where there is none.

    Of a dense M only those are found with which all multipliers come last.

    Parameters
    ----------
    M : canonical CSR array or ndarray, shape (n, n)

    Examples
    --------
    >>> signs_of(sp.csr_array([[2.0, 3.0], [-3.0, 0.0]]))
    array([ 1., -1.])
    >>> signs_of(sp.csr_array([[2.0, 3.0], [-1.0, 0.0]])) is None
    True
    """
    from .kernels.interior_rows import oppose

    # Multipliers come last as a rule: who is opposed by an earlier row is one.
    signs = np.empty(M.shape[0])
    fits = oppose(*compressed_rows(M), SAME, signs)
    if fits or not sp.issparse(M):
        return signs if fits > 0 else None
    mirrored = sp.csr_array(M.T)
    mirrored.sort_indices()
    is_same = np.abs(M.data - mirrored.data) <= SAME * np.abs(M.data)
    rows, columns = np.repeat(np.arange(M.shape[0]), np.diff(M.indptr)), M.indices
    signs = _two_colours(rows, columns, is_same, M.shape[0])
    return signs if np.array_equal(signs[rows] == signs[columns], is_same) else None


def _two_colours(rows: Any, columns: Any, is_same: Any, n: int) -> FloatVector:
    """Return the signs that each connected component allows, if any: in a graph of every row and its opposite."""
    from scipy.sparse.csgraph import connected_components

    beside = columns + np.where(is_same, 0, n)
    edges = (np.ones(rows.size), (rows, beside))
    twofold = sp.csr_array(edges, shape=(n, 2 * n))
    opposite = sp.csr_array((np.ones(rows.size), (rows, (beside + n) % (2 * n))), shape=(n, 2 * n))
    _, component = connected_components(sp.vstack([twofold, opposite]), directed=False)
    signs: FloatVector = np.where(component[:n] <= component[n:], 1.0, -1.0)
    return signs
