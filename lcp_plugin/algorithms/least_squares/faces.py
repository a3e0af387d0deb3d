"""Least squares on the free columns by a factor: orthogonal where A is dense, of the augmented system where sparse.

Neither squares the condition of A. Both give a *correction* d of x, so that the next one refines it.
"""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np
import scipy.sparse as sp

from ...checks import BoolVector, FloatVector
from ...deadline import is_over
from ...kernels.floats import EPSILON
from ...matrix.factors import factor_fits, factorise
from ...problem.least_squares import UnitLeastSquares
from .point import Point


class Faces(Protocol):
    """Minimises over the free columns."""

    def correction(self, point: Point, free: BoolVector) -> FloatVector | None:
        """Return d, 0 but on the free columns, that minimises the cost at x + d; None where that cannot be had."""


class DenseFaces:
    """Faces of a dense A: of its triangular factor where that is smaller than A.

    Parameters
    ----------
    matrix : array, shape (k, n)
        (A; √ridge) or its triangular factor R, (A; √ridge) = Q R.
    right : array, shape (k,)
        (b; 0) or Qᵀ(b; 0).
    """

    def __init__(self, matrix: FloatVector, right: FloatVector) -> None:
        self.matrix, self.right = matrix, right

    @classmethod
    def of(cls, problem: UnitLeastSquares) -> DenseFaces | None:
        """Return the faces, or None where time ended before."""
        m, n = problem.problem.shape
        has_ridge = problem.ridge.any()
        head = np.diag(np.sqrt(problem.ridge)) if has_ridge else np.empty((0, n))
        if m + head.shape[0] <= n:
            return cls(_whole(problem), problem.b)
        triangle = np.hstack([head, np.zeros((head.shape[0], 1))])
        at_once = 4 * n + 1  # a block's share of the work that is done again
        for begin in range(0, m, at_once):
            if is_over():
                return None
            rows = slice(begin, min(begin + at_once, m))
            triangle = _triangle(np.vstack([triangle, np.column_stack([_whole(problem, rows), problem.b[rows]])]))
        return cls(triangle[:n, :n], triangle[:n, n])

    def correction(self, point: Point, free: BoolVector) -> FloatVector | None:
        """Return the shortest correction that minimises."""
        from scipy.linalg import LinAlgError, lstsq

        correction = np.zeros(free.size)
        residual = self.matrix @ point.x - self.right
        try:
            correction[free] = lstsq(self.matrix[:, free], -residual, lapack_driver="gelsy", check_finite=False)[0]
        except (LinAlgError, ValueError):
            return None
        return correction


class SparseFaces:
    """Faces of a sparse A, by the factor of (I, A_F; A_Fᵀ, −ridge) that SuperLU finds with little fill.

    Parameters
    ----------
    problem : UnitLeastSquares
    """

    def __init__(self, problem: UnitLeastSquares) -> None:
        self.problem, self._entries = problem, problem.entries()

    @classmethod
    def of(cls, problem: UnitLeastSquares) -> SparseFaces | None:
        """Return the faces, or None where a factor might fill in too much."""
        faces = cls(problem)
        return faces if factor_fits(_augmented(faces._entries, problem.ridge)) else None

    def correction(self, point: Point, free: BoolVector) -> FloatVector | None:
        """Return the correction that minimises; where A_F is rank-deficient, one in units of rounding."""
        m, columns = self._entries.shape[0], np.flatnonzero(free)
        block, ridge = self._entries[:, columns], self.problem.ridge[columns]
        right = np.concatenate([np.zeros(m), -point.gradient[columns]])
        for shift in (EPSILON**2, EPSILON * m):  # none of them 0, which would have to be matched with other rows first
            factor = factorise(_augmented(block, ridge + shift), is_symmetric=True)
            found = None if factor is None else factor.solve(right)[m:]
            if found is not None and np.isfinite(found).all():
                correction = np.zeros(free.size)
                correction[columns] = -found
                return correction
        return None


def _augmented(block: Any, ridge: FloatVector) -> sp.csr_array:
    m = block.shape[0]
    return sp.csr_array(sp.block_array([[sp.eye_array(m), block], [block.T, -sp.diags_array(ridge)]]))


def _whole(problem: UnitLeastSquares, rows: slice = slice(None)) -> FloatVector:
    entries = problem.entries(rows)
    dense: FloatVector = entries.toarray() if sp.issparse(entries) else entries
    return dense


def _triangle(matrix: FloatVector) -> FloatVector:
    """Return R, of as many rows as columns at the most, with matrix = Q R."""
    from scipy.linalg import qr

    triangle: FloatVector = qr(matrix, mode="r", overwrite_a=True, check_finite=False)[0][: matrix.shape[1]]
    return triangle
