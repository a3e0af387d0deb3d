"""Residuals and gradients of a least squares problem, enclosed."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.sparse.csgraph import connected_components

from ...core.checks import BoolVector, FloatVector, assembled
from ...core.kernels.floats import EPSILON, TINY, UNIT
from ...core.matrix.matrix import Matrix
from ...core.rounding import gamma
from .data import ROWS_AT_ONCE, BoundedLeastSquares

Ball = tuple[FloatVector, FloatVector]
"""Value and radius: what is meant lies within."""

OUTWARD = (
    1.0 + 2.0**-30
)  # more than what rounds in a sum of 2²⁰ terms of one sign, or a few operations
NOTHING = np.empty(0)
SMALLEST_NORMAL = 2.0**-1022  # smaller products may vanish
MOST_HIDDEN, NOTHING_BESIDE = 1e-4, 1e-12  # of what stands at the start, and of the whole cost
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
    basic, near_answer : ndarray, shape (n,), or None
        A least squares solution of independent columns without bounds, and an answer that was found from near 0, once
        somebody has asked.
    """

    def __init__(self, problem: BoundedLeastSquares) -> None:
        self.problem = problem
        self.basic: FloatVector | None = None
        self.near_answer: FloatVector | None = None

    def residual(self, x: FloatVector) -> Ball:
        """Return A x − b."""
        problem = self.problem
        if not problem.has_entries:
            return problem.product(x) - problem.b, np.zeros(problem.shape[0])
        return self._product(x, NOTHING, problem.b, by_rows=True)

    def gradient(self, x: FloatVector, residual: Ball) -> Ball:
        """Return AᵀW(A x − b) + ridge x."""
        return self._with_ridge(*self.transposed(*residual), x)

    def gradient_at(self, x: FloatVector, y: FloatVector) -> Ball:
        """Return AᵀWy + ridge x."""
        return self.gradient(x, (y, NOTHING))

    def transposed(self, y: FloatVector, slip: FloatVector) -> Ball:
        """Return AᵀWy for a y known up to slip, nothing where it is exact."""
        problem = self.problem
        weighted, slip = problem.weighted(y), problem.weighted(slip) if slip.size else slip
        if not problem.has_entries:
            return problem.transposed(weighted), np.zeros(problem.shape[1])
        return self._product(weighted, slip, 0.0, by_rows=False)

    def _product(
        self, v: FloatVector, slip: FloatVector, less: FloatVector | float, *, by_rows: bool
    ) -> Ball:
        """Return B v − less for a v known up to slip; B is A, or else Aᵀ."""
        sums = self._sums(v, slip, by_rows=by_rows)
        sums[0] -= less
        sums[1] += np.abs(less)
        return sums[0], self._radius(sums, by_rows=by_rows)

    def _sums(self, v: FloatVector, slip: FloatVector, *, by_rows: bool) -> Any:
        """Return B v, |B||v|, |B| slip, and 1 where a row of B has a term that is not 0."""
        of_terms = np.abs(v)
        sums = np.zeros((4, self.problem.shape[not by_rows]))
        for rows, part, sizes in self._blocks():
            B, at = (part, rows) if by_rows else (part.T, slice(None))
            along = slice(None) if by_rows else rows
            _add_products(
                sums[:, at],
                B,
                sizes if by_rows else sizes.T,
                v[along],
                of_terms[along],
                slip[along],
            )
        return sums

    def _blocks(self) -> Iterator[tuple[slice, Any, Any]]:
        """Yield rows of A, themselves and their sizes: all at once where both are kept anyway."""
        A = self.problem.A
        if self._sizes is not None:
            yield slice(None), A, self._sizes
            return
        for begin in range(0, A.shape[0], ROWS_AT_ONCE):
            rows = slice(begin, begin + ROWS_AT_ONCE)
            yield rows, A[rows], np.abs(A[rows])

    def _radius(self, sums: Any, *, by_rows: bool) -> FloatVector:
        """Return by how much rounding, and slip, may have moved such sums."""
        terms = self._terms[not by_rows]
        k = (2 * terms + 8) * UNIT
        rounding = k / (1.0 - k) * (1.0 + 8.0 * UNIT) * (sums[1] + sums[2])
        return np.asarray(rounding + OUTWARD * sums[2] + (terms + 1) * TINY * (sums[3] > 0.0))

    def _with_ridge(self, value: FloatVector, radius: FloatVector, x: FloatVector) -> Ball:
        """Return the value with ridge x added, and the radius with what that rounds."""
        if not self.problem.ridge > 0.0:
            return value, radius
        added = self.problem.ridge * x
        value = value + added
        return value, OUTWARD * (
            radius + 4.0 * EPSILON * (np.abs(value) + np.abs(added)) + TINY * (x != 0.0)
        )

    @np.errstate(over="ignore", invalid="ignore")
    def hidden_costs(self, residual: Ball) -> tuple[FloatVector, BoolVector]:
        """Return what rounding may cost in each row, and in which rows that is much.

        It is not beside the terms of A x − b at the x nearest to 0, nor what is nothing beside the whole cost.
        """
        hidden = self.problem.weighted(residual[1]) * residual[1]
        most = np.maximum(MOST_HIDDEN * self._terms_at_start, self._nothing_beside(residual))
        return hidden, ~(hidden <= most)

    @np.errstate(over="ignore", invalid="ignore")
    def hides_beside_components(self, hidden: FloatVector, residual: Ball) -> bool:
        """Return whether it is much beside all such terms of a connected component of A, whose rows share columns."""
        of_hidden, of_start = (
            np.bincount(self._components, terms) for terms in (hidden, self._terms_at_start)
        )
        return not bool(
            (of_hidden <= np.maximum(MOST_HIDDEN * of_start, self._nothing_beside(residual))).all()
        )

    def _nothing_beside(self, residual: Ball) -> float:
        """Return what is nothing beside the whole cost."""
        sure = np.maximum(np.abs(residual[0]) - residual[1], 0.0)
        return NOTHING_BESIDE * float(self.problem.weighted(sure) @ sure) + TINY

    @cached_property
    def _terms_at_start(self) -> FloatVector:
        """Of each row of A x − b, squared and weighted."""
        problem = self.problem
        terms = self._sums(problem.nearest_to_zero, NOTHING, by_rows=True)[1] + np.abs(problem.b)
        return np.asarray(problem.weighted(terms) * terms)

    @cached_property
    def _components(self) -> NDArray[np.int32]:
        """The component of each row, shape (m,): rows and columns of A are joined by its entries."""
        A, (m, n) = sp.coo_array(self.problem.A), self.problem.shape
        joined = sp.csr_array((np.ones(A.nnz), (A.row, m + A.col)), shape=(m + n, m + n))
        labels: NDArray[np.int32] = connected_components(joined, directed=False)[1]
        return labels[:m]

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
        scaled = problem.scaled
        gram = scaled.gram()
        dense: Any = gram.toarray() if sp.issparse(gram) else gram
        dense.flat[:: n + 1] += scaled.ridge
        if not np.isfinite(dense).all():
            return None
        terms = problem.shape[0] + 16
        # Columns are shorter than 2: no entry is wrong by more than 4 γ, nor an eigenvalue by more than n times that.
        slip = 8.0 * n * (gamma(2 * terms) + EPSILON)
        bound = smallest_eigenvalue_bound(Matrix(0.5 * (dense + dense.T)))
        if bound is None or not bound.is_rigorous:
            return None
        least = bound.value - slip * float(bound.scale.max()) ** 2
        return (
            least * (1.0 - 2.0**-40) * (problem.column_scales / bound.scale) ** 2
            if least > 0.0
            else None
        )

    @cached_property
    def _sizes(self) -> Any:
        """|A|, or None where a copy of a dense A is too much."""
        A = self.problem.A
        if self.problem.is_sparse:
            return assembled(np.abs(A.data), A.indices, A.indptr, A.shape)
        return np.abs(A) if self.problem.is_cheap_to_copy else None

    @cached_property
    def _terms(self) -> tuple[int, int]:
        """The most terms that a sum along a row, and one down a column, may have."""
        A, (m, n) = self.problem.A, self.problem.shape
        if self.problem.is_sparse:
            return int(np.diff(A.indptr).max(initial=0)), int(
                np.bincount(A.indices, minlength=1).max()
            )
        return n, m if self.problem.is_cheap_to_copy else min(
            m, ROWS_AT_ONCE
        ) + m // ROWS_AT_ONCE + 1


def _add_products(
    sums: Any, B: Any, sizes: Any, v: FloatVector, of_terms: FloatVector, slip: FloatVector
) -> None:
    """Add B v, |B||v|, |B| slip, and 1 where a row has a term that is not 0, whatever underflows."""
    sums[0] += B @ v
    sums[1] += sizes @ of_terms
    if slip.size:
        sums[2] += sizes @ slip
    is_filled = (sums[1] > 0.0) | (sums[2] > 0.0)
    sums[3] += is_filled
    if (
        not is_filled.all()
        and _least(sizes) * min(_least(of_terms), _least(slip)) < SMALLEST_NORMAL
    ):
        has_term = (v != 0.0) | (slip != 0.0 if slip.size else False)
        sums[3] += (sizes != 0.0).astype(np.float64) @ has_term.astype(np.float64)


def _least(sizes: Any) -> float:
    """Return the smallest of these that is not 0, ∞ of none."""
    data = sizes.data if sp.issparse(sizes) else sizes
    return float(np.min(data, initial=np.inf, where=data > 0.0))


def typical_rounding(
    problem: BoundedLeastSquares, x: FloatVector, residual: FloatVector
) -> FloatVector:
    """Return about what rounding does to a gradient of which no magnitudes are known."""
    root, scales = problem.root_weights, problem.column_scales
    size = (
        np.linalg.norm(root * residual)
        + np.linalg.norm(root * problem.b)
        + np.linalg.norm(scales * x)
    )
    return 4.0 * EPSILON * (scales * size)


def largest_residuals(
    gradient: FloatVector,
    radius: FloatVector,
    x: FloatVector,
    lower: FloatVector,
    upper: FloatVector,
    l1: FloatVector,
    scales: FloatVector,
    is_enclosed: bool,
) -> tuple[float, float, bool]:
    """Return ‖x − mid(lower, upper, prox(x − g))‖∞, that in units of columns, and if all are at most twice the radius.

    prox moves by l1 towards 0, but not beyond. They are those of any g within the radius of the gradient, rounded
    upwards, where that encloses it; ∞ where one is not a number.
    """
    below, above, left, right = x - upper, x - lower, gradient - l1, gradient + l1
    one = np.abs(clipped(clipped(x, left, right), below, above))
    two = np.abs(
        clipped(clipped(x * scales, left / scales, right / scales), below * scales, above * scales)
    )
    off = np.where(np.isfinite(gradient), radius if is_enclosed else 0.0, np.nan)
    sizes = [float(np.max(size, initial=0.0)) for size in (one + off, two + off / scales)]
    plain, scaled = (OUTWARD * size if size < np.inf else np.inf for size in sizes)
    return plain, scaled, bool((np.maximum(one, two * scales) <= 2.0 * radius).all())


def clipped(x: FloatVector, lower: FloatVector, upper: FloatVector) -> FloatVector:
    """Return mid(lower, upper, x), sooner than numpy does for short vectors."""
    return np.minimum(np.maximum(x, lower), upper)
