"""Least squares on the free columns by a factor: orthogonal where A is dense, of AᵀA where A is sparse.

Both give a *correction* d of x, so that the next one refines it. The factor of AᵀA, whose condition is squared, is only
a preconditioner.
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

RANK = 4.0 * EPSILON  # times the larger dimension: singular values below this share of the largest are 0
LOOKED_AT = 100  # columns of AᵀA, which tell how many entries it has
LARGER = 3.0  # entries of AᵀA by those of A: one that is symmetric could be kept in half of them
SHIFT = 8.0 * EPSILON  # of columns of unit length, so that the factor of a singular AᵀA is one
MOST_STEPS = 30
GOAL = 1e-24  # of the energy of the error: what is left is for the next correction


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
        triangle: Any = np.eye(n if problem.ridge.any() else 0, n + 1)
        triangle[:, :n] *= np.sqrt(problem.ridge)
        if m + triangle.shape[0] <= n:
            return cls(_whole(problem), problem.b)
        at_once = 4 * n + 1  # a block's share of the work that is done again
        for begin in range(0, m, at_once):
            if is_over():
                return None
            rows = slice(begin, min(begin + at_once, m))
            block = np.column_stack([_whole(problem, rows), problem.b[rows]])
            triangle = np.linalg.qr(np.vstack([triangle, block]) if triangle.size else block, mode="r")
        return cls(triangle[:n, :n], triangle[:n, n])

    def correction(self, point: Point, free: BoolVector) -> FloatVector | None:
        """Return the shortest correction that minimises."""
        from scipy.linalg import LinAlgError, lstsq

        correction = np.zeros(free.size)
        residual = self.matrix @ point.x - self.right
        try:
            block, rank_below = self.matrix[:, free], RANK * max(self.matrix.shape)
            correction[free] = lstsq(block, -residual, rank_below, lapack_driver="gelsy", check_finite=False)[0]
        except (LinAlgError, ValueError):
            return None
        return correction


class SparseFaces:
    """Faces of a sparse A whose AᵀA is no larger than A: conjugate gradients with the factor of AᵀA for preconditioner.

    Parameters
    ----------
    problem : UnitLeastSquares
    gram : CSR array, shape (n, n)
        AᵀA + ridge.
    """

    def __init__(self, problem: UnitLeastSquares, gram: sp.csr_array) -> None:
        self.problem, self.gram = problem, gram

    @classmethod
    def of(cls, problem: UnitLeastSquares) -> SparseFaces | None:
        """Return the faces, or None where AᵀA or its factor would be too large."""
        entries = problem.entries()
        if _gram_size(entries) > LARGER * entries.nnz + entries.shape[1]:
            return None
        gram = sp.csr_array(entries.T @ entries + sp.diags_array(problem.ridge))
        return cls(problem, gram) if np.isfinite(gram.data).all() and factor_fits(gram) else None

    def correction(self, point: Point, free: BoolVector) -> FloatVector | None:
        """Return the correction that minimises, in a few steps as the factor is one of AᵀA up to rounding."""
        columns, correction = np.flatnonzero(free), np.zeros(free.size)
        block = self.gram[columns][:, columns] + sp.diags_array(np.full(columns.size, SHIFT))
        factor = factorise(sp.csr_array(block), is_symmetric=True) if columns.size else None
        if factor is None:
            return None if columns.size else correction
        left, direction, goal = -point.gradient[columns], np.zeros(free.size), 0.0
        size = 0.0
        for _ in range(MOST_STEPS):
            solved = factor.solve(left)
            before, size = size, float(left @ solved)
            goal = goal or GOAL * size
            if not goal < size < np.inf:
                break
            direction[columns] = solved + (size / before if before > 0.0 else 0.0) * direction[columns]
            product = self.problem.product(direction)
            curvature = point.curvature(direction, product)
            if not curvature > 0.0:
                break
            correction += (size / curvature) * direction
            gradient = self.problem.transposed(product) + self.problem.ridge * direction
            left = left - (size / curvature) * gradient[columns]
        return correction if np.isfinite(correction).all() else None


def _gram_size(entries: Any) -> float:
    """Return about how many entries AᵀA has."""
    n = entries.shape[1]
    looked_at = np.unique(np.linspace(0, n - 1, min(n, LOOKED_AT)).astype(np.intp))
    return float((entries.T @ entries[:, looked_at]).nnz * n / max(looked_at.size, 1))


def _whole(problem: UnitLeastSquares, rows: slice = slice(None)) -> FloatVector:
    entries = problem.entries(rows)
    dense: FloatVector = entries.toarray() if sp.issparse(entries) else entries
    return dense
