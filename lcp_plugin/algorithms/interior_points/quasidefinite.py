"""Newton matrices of quadratic programs: symmetric once the rows of the multipliers have their signs turned.

M = [[P, Aᵀ], [−A, Q]] with P and Q symmetric and semidefinite is monotone, and diag(s) (M + D), s = 1 above and −1
below, is [[P + D₁, Aᵀ], [A, −Q − D₂]]: quasi-definite for every D > 0, so that LDLᵀ exists in any order of the unknowns
(Vanderbei 1995, doi:10.1137/0805005). qdldl chooses one order of little fill for all D.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse as sp

from ...checks import FloatVector, read_only
from .newton_matrix import NewtonMatrix

SAME = 1e-12  # entries that differ by less, beside their size, are the same but for rounding


class QuasidefiniteNewtonMatrix(NewtonMatrix):
    """LDLᵀ by qdldl, ordered once by its minimum degree; afterwards only numbers change."""

    def __init__(self, M: sp.csr_array, signs: FloatVector) -> None:
        super().__init__(M)
        self.signs = signs
        rows = np.repeat(np.arange(self.n), np.diff(M.indptr))
        below = rows > M.indices
        # Row by row the lower triangle, its diagonal last: column by column the upper one.
        counts = np.bincount(rows[below], minlength=self.n) + 1
        starts = np.concatenate([[0], np.cumsum(counts)])
        indices, data = np.empty(starts[-1], dtype=np.int64), np.empty(starts[-1])
        self._diagonal_at = starts[1:] - 1
        is_below = np.ones(starts[-1], dtype=bool)
        is_below[self._diagonal_at] = False
        indices[is_below], data[is_below] = M.indices[below], signs[rows[below]] * M.data[below]
        indices[self._diagonal_at] = np.arange(self.n)
        self._own_diagonal = M.diagonal()
        self._upper = sp.csc_array((data, indices, starts), shape=M.shape)
        self._rows = read_only(M.indptr), read_only(M.indices), read_only(M.data)
        self._factor: Any = None
        self._factor_work = self._solve_work = 0.0

    def _try(self, diagonal: FloatVector) -> bool:
        import qdldl

        self._upper.data[self._diagonal_at] = self.signs * (self._own_diagonal + diagonal)
        if self._factor is None:
            try:
                self._factor = qdldl.Solver(self._upper, upper=True)
            except RuntimeError:  # a pivot is exactly zero
                return False
            lower = self._factor.factors()[0]
            columns = np.diff(lower.indptr).astype(np.float64)
            self._factor_work, self._solve_work = float(columns @ columns) / 2.0, 2.0 * lower.nnz
        else:
            self._factor.update(self._upper, upper=True)  # which is silent about a zero pivot: the check below is not
        self.work += self._factor_work
        return self.is_useful(diagonal)

    def _left(self, right: FloatVector, x: FloatVector) -> tuple[FloatVector, float]:
        from ...kernels.rows import left_over

        self.work += float(self.M.nnz)
        left = np.empty(self.n)
        return left, float(left_over(*self._rows, self._diagonal, right, x, left))

    def _apply(self, right: FloatVector) -> FloatVector:
        self.work += self._solve_work
        x: FloatVector = self._factor.solve(self.signs * right)
        return x


def signs_of(M: sp.csr_array) -> FloatVector | None:
    """Return s of ±1, shape (n,), with diag(s) M symmetric to rounding, or None where there is none; M is canonical.

    Examples
    --------
    >>> signs_of(sp.csr_array([[2.0, 3.0], [-3.0, 0.0]]))
    array([ 1., -1.])
    >>> signs_of(sp.csr_array([[2.0, 3.0], [-1.0, 0.0]])) is None
    True
    """
    mirrored = sp.csr_array(M.T)
    mirrored.sort_indices()
    if not (np.array_equal(M.indptr, mirrored.indptr) and np.array_equal(M.indices, mirrored.indices)):
        return None
    size = SAME * np.abs(M.data)
    is_same, is_opposite = np.abs(M.data - mirrored.data) <= size, np.abs(M.data + mirrored.data) <= size
    if not (is_same | is_opposite).all():
        return None
    rows, columns = np.repeat(np.arange(M.shape[0]), np.diff(M.indptr)), M.indices
    # Multipliers come last as a rule: who is opposed by an earlier row is one.
    signs = np.ones(M.shape[0])
    signs[rows[~is_same & (columns < rows)]] = -1.0
    if _fits(signs, rows, columns, is_same):
        return signs
    signs = _two_colours(rows, columns, is_same, M.shape[0])
    return signs if _fits(signs, rows, columns, is_same) else None


def _fits(signs: FloatVector, rows: Any, columns: Any, is_same: Any) -> bool:
    return bool(np.array_equal(signs[rows] == signs[columns], is_same))


def _two_colours(rows: Any, columns: Any, is_same: Any, n: int) -> FloatVector:
    """Return the signs that each connected part allows, if any: in a graph of every row and its opposite."""
    from scipy.sparse.csgraph import connected_components

    beside = columns + np.where(is_same, 0, n)
    edges = (np.ones(rows.size), (rows, beside))
    twofold = sp.csr_array(edges, shape=(n, 2 * n))
    opposite = sp.csr_array((np.ones(rows.size), (rows, (beside + n) % (2 * n))), shape=(n, 2 * n))
    _, part = connected_components(sp.vstack([twofold, opposite]), directed=False)
    signs: FloatVector = np.where(part[:n] <= part[n:], 1.0, -1.0)
    return signs


def rehearse() -> None:
    """Compile what a problem of one unknown does not need."""
    matrix = QuasidefiniteNewtonMatrix(sp.csr_array([[1.0]]), np.ones(1))
    matrix.factorise(np.ones(1))
    matrix.solve(np.ones(1))
