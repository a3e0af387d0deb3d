"""Residuals and gradients of a least squares problem, enclosed."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sp

from ...core.checks import FloatVector
from ...core.kernels.floats import EPSILON
from ...core.matrix.matrix import Matrix
from ...core.rounding import gamma
from .data import ROWS_AT_ONCE, BoundedLeastSquares

Ball = tuple[FloatVector, FloatVector]
"""Value and radius: what is meant lies within."""

OUTWARD = 1.0 + 2.0**-30  # more than what rounds in a sum of 2²⁰ terms of one sign, or a few operations
NOTHING = np.empty(0)
GRAM_UP_TO = 3000  # columns; AᵀWA is factorised


class Enclosures:
    """Residuals and gradients of a problem with bounds of what rounding did; estimates for a LinearOperator.

    Parameters
    ----------
    problem : BoundedLeastSquares

    Attributes
    ----------
    reference : (float, float)
        A lower bound of ‖AᵀWb‖∞ in the caller's units, and with columns of about unit length. Where AᵀWb is 0, of the
        gradient at the point of [lower, upper] nearest to 0; where that is 0 as well, that point is the answer.
    """

    def __init__(self, problem: BoundedLeastSquares) -> None:
        self.problem = problem

    def residual(self, x: FloatVector) -> Ball:
        """Return A x − b."""
        problem = self.problem
        if not problem.has_entries:
            return problem.product(x) - problem.b, np.zeros(problem.shape[0])
        return self._product(x, NOTHING, problem.b, by_rows=True)

    def gradient(self, x: FloatVector, residual: Ball) -> Ball:
        """Return AᵀW(A x − b) + ridge x."""
        value, radius = self.transposed(*residual)
        return self._with_ridge(value, radius, x)

    def gradient_at(self, x: FloatVector, y: FloatVector) -> Ball:
        """Return AᵀWy + ridge x."""
        return self.gradient(x, (y, NOTHING))

    def gradients(self, x: FloatVector, residual: Ball) -> tuple[Ball, Ball]:
        """Return both of a residual with a radius, and of its value, for which both are the same but for the radius."""
        problem = self.problem
        if not problem.has_entries:
            value, radius = self.gradient(x, residual)
            return (value, _typical_rounding(problem, x, residual[0])), (value, radius)
        y, slip = map(problem.weighted, residual)
        sums, radius = self._sums(y, slip, by_rows=False), np.empty(problem.shape[1])
        known = self._with_ridge(sums[0].copy(), self._radius(sums, radius, by_rows=False), x)
        sums[2] = 0.0
        return known, self._with_ridge(sums[0], self._radius(sums, np.empty_like(radius), by_rows=False), x)

    def transposed(self, y: FloatVector, slip: FloatVector) -> Ball:
        """Return AᵀWy for a y known up to slip, nothing where it is exact."""
        problem = self.problem
        weighted, slip = problem.weighted(y), problem.weighted(slip) if slip.size else slip
        if not problem.has_entries:
            return problem.transposed(weighted), np.zeros(problem.shape[1])
        return self._product(weighted, slip, 0.0, by_rows=False)

    def _product(self, v: FloatVector, slip: FloatVector, less: FloatVector | float, *, by_rows: bool) -> Ball:
        """Return B v − less for a v known up to slip; B is A, or else Aᵀ."""
        sums = self._sums(v, slip, by_rows=by_rows)
        sums[0] -= less
        sums[1] += np.abs(less)
        return sums[0], self._radius(sums, np.empty(sums.shape[1]), by_rows=by_rows)

    def _sums(self, v: FloatVector, slip: FloatVector, *, by_rows: bool) -> Any:
        """Return B v, |B||v|, |B| slip, and 1 where a row of B has a term that is not 0."""
        problem = self.problem
        if problem.is_dense:
            return _sums_of_dense(problem.A if by_rows else problem.A.T, v, slip)
        B, sizes = (problem.A, self._sizes) if by_rows else (problem.A.T, self._sizes.T)
        sums = np.zeros((4, B.shape[0]))
        sums[0], sums[1] = B @ v, sizes @ np.abs(v)
        if slip.size:
            sums[2] = sizes @ slip
        sums[3] = sums[1] > 0.0
        if not sums[3].all():  # whatever underflows
            has_term = (v != 0.0) | (slip != 0.0 if slip.size else False)
            sums[3] = (sizes != 0.0).astype(np.float64) @ has_term.astype(np.float64)
        return sums

    def _radius(self, sums: Any, radius: FloatVector, *, by_rows: bool) -> FloatVector:
        from .sums import radii

        radii(sums, self._terms[not by_rows], radius)
        return radius

    def _with_ridge(self, value: FloatVector, radius: FloatVector, x: FloatVector) -> Ball:
        from .sums import with_ridge

        with_ridge(value, radius, self.problem.ridge, x)
        return value, radius

    @cached_property
    def reference(self) -> tuple[float, float]:
        """What residuals are measured against; see the class."""
        problem = self.problem
        for ball in self._references():
            least = np.maximum(np.abs(ball[0]) - ball[1], 0.0)
            if np.abs(ball[0]).any():
                scaled = least / problem.column_scales
                return float(least.max(initial=0.0)), float(scaled.max(initial=0.0))
        return 0.0, 0.0

    def _references(self) -> Any:
        yield self.transposed(self.problem.b, np.zeros(self.problem.shape[0]))
        start = self.problem.nearest_to_zero
        yield self.gradient(start, self.residual(start))

    @cached_property
    def convexity(self) -> FloatVector | None:
        """A d > 0, shape (n,), with AᵀWA + ridge − diag(d) proved positive semidefinite, or None."""
        from ...proofs.bounds.solution_bounds import smallest_eigenvalue_bound

        problem, n = self.problem, self.problem.shape[1]
        if not problem.has_entries or not 0 < n <= min(GRAM_UP_TO, problem.shape[0]):
            return None
        unit = problem.scaled
        gram = unit.gram()
        dense: Any = gram.toarray() if sp.issparse(gram) else gram
        dense.flat[:: n + 1] += unit.ridge
        if not np.isfinite(dense).all():
            return None
        terms = problem.shape[0] + 16
        # Columns are shorter than 2: no entry is wrong by more than 4 γ, nor an eigenvalue by more than n times that.
        slip = 8.0 * n * (gamma(2 * terms) + EPSILON)
        bound = smallest_eigenvalue_bound(Matrix(0.5 * (dense + dense.T)))
        if bound is None or not bound.is_rigorous:
            return None
        least = bound.value - slip * float(bound.scale.max()) ** 2
        return least * (1.0 - 2.0**-40) * (problem.column_scales / bound.scale) ** 2 if least > 0.0 else None

    @cached_property
    def _sizes(self) -> Any:
        """|A| of a sparse A."""
        A = self.problem.A
        return sp.csr_array((np.abs(A.data), A.indices, A.indptr), shape=A.shape)

    @cached_property
    def _terms(self) -> tuple[int, int]:
        """The most terms that a sum along a row, and one down a column, may have."""
        A, (m, n) = self.problem.A, self.problem.shape
        if self.problem.is_sparse:
            return int(np.diff(A.indptr).max(initial=0)), int(np.bincount(A.indices, minlength=1).max())
        across = m if A.flags.c_contiguous else n
        in_blocks = min(across, ROWS_AT_ONCE) + across // ROWS_AT_ONCE + 1
        return (n, in_blocks) if A.flags.c_contiguous else (in_blocks, m)


def _sums_of_dense(B: Any, v: FloatVector, slip: FloatVector) -> Any:
    """Return B v, |B||v|, |B| slip, and 1 where a row of B has a term that is not 0, B by rows or by columns."""
    from .sums import along_rows, down_columns

    sums, part = np.zeros((2, 4, B.shape[0]))
    if B.flags.c_contiguous:
        along_rows(B, v, slip, sums)
        return sums
    for begin in range(0, B.shape[1], ROWS_AT_ONCE):
        rows = slice(begin, begin + ROWS_AT_ONCE)
        down_columns(B.T[rows], v[rows], slip[rows], part)
        sums += part
    return sums


def _typical_rounding(problem: BoundedLeastSquares, x: FloatVector, residual: FloatVector) -> FloatVector:
    """Return about what rounding does to a gradient of which no magnitudes are known."""
    root, scales = problem.root_weights, problem.column_scales
    size = np.linalg.norm(root * residual) + np.linalg.norm(root * problem.b) + np.linalg.norm(scales * x)
    return 4.0 * EPSILON * (scales * size)
