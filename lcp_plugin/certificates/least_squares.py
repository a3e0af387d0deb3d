r"""What SOLVED means for min ½ Σ weights (A x − b)² + ½ ridge ‖x‖², lower ≤ x ≤ upper, and what is proved of an x.

Write W = diag(weights), r = A x − b, f for the cost. For any y ∈ ℝᵐ and s = AᵀWy + ridge·x, convexity gives, summed
without cancellation, for every feasible z

    f(x) − f(z) ≤ gap(x, y) = ½ Σ_i weights_i (r_i − y_i)² + Σ_j s_j⁺(x_j − lower_j) + s_j⁻(upper_j − x_j),

and, with μ ≥ ridge such that f(z) − ½μ‖z‖² is convex, no more than s_j²/(2μ) for any column j while y = r. A column
without a bound on one side needs an s_j of one sign, which rounding and the tolerance deny to y = r: y = r + δp with
AᵀWp of that sign has it. Where there is none (a free column, A not proved to have full rank) f(x) − f(z) ≤ f(x) is all
there is to say: that is the `gap` of a result, rounding included.

**SOLVED: x is within the bounds and, for some y, the gap is at most tolerance · cost, cost = ½ Σ weights y² + ½ ridge
‖x‖², where of r_i − y_i and of s_j only what exceeds rounding counts**: what exceeds ρ_i = γ (|A||x| + |b|)_i in row i
and τ_j = γ (|A|ᵀW|y| + ridge |x|)_j in column j, γ = 4 u (terms + 4). So x is optimal to the tolerance beside its cost
for entries of A and b that differ from those given by no more than that relative rounding: b_i moved by r_i − y_i, and
column j such that s_j is 0. The sums are taken with y, not r: y_i of a large row is small, so that its rounding hides
nothing of the others, and a residual that is rounding in each row (y = 0) is a cost of 0. All that is compared is in
the unit of its row, or of its column, or a cost: units of rows (with weights ÷ their squares) and columns change
nothing but rounding. It cannot see what such a change of A decides: columns that depend on others up to rounding, where
no bound stops them. For a LinearOperator, whose entries nobody knows, SOLVED means a small gradient, and all is an
estimate.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sp

from ..checks import BoolVector, FloatVector
from ..exact.rounding import gamma
from ..kernels.floats import EPSILON, TINY
from ..matrix.matrix import Matrix
from ..problem.least_squares import ROWS_AT_ONCE, BoundedLeastSquares

Ball = tuple[FloatVector, FloatVector]
"""Value and radius: what is meant lies within."""

OUTWARD = 1.0 + 2.0**-30  # more than what rounds in a sum of 2²⁰ terms of one sign, or a few operations
REPAIR_STEPS = 300  # for a p; more than A of condition 100 needs
IS_NEAR = 1  # what LSMR says then
ENOUGH = 0.8  # of the 1 that (AᵀWp)_j is to be, in units of column j
IN_DOUBT = 1e-6  # of the largest multiplier: smaller ones may be those of free columns
PUSHES = 4  # times that δ may be doubled
NOTHING = np.empty(0)
ACCURACIES = (1e-3, 1e-6, 1e-8)  # with which a dual point is made orthogonal to the free columns, one after the other
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
        columns = np.zeros((B.shape[1], 3))
        columns[:, 0], columns[:, 1] = np.abs(v), slip if slip.size else 0.0
        columns[:, 2] = columns.any(axis=1)  # whatever underflows
        return np.vstack([B @ v, (sizes @ columns).T])

    def _radius(self, sums: Any, radius: FloatVector, *, by_rows: bool) -> FloatVector:
        from ..kernels.least_squares_sums import radii

        radii(sums, self._terms[not by_rows], radius)
        return radius

    def _with_ridge(self, value: FloatVector, radius: FloatVector, x: FloatVector) -> Ball:
        from ..kernels.least_squares_sums import with_ridge

        with_ridge(value, radius, self.problem.ridge, x)
        return value, radius

    @cached_property
    def reference(self) -> tuple[float, float]:
        """What residuals are measured against; see the class."""
        problem = self.problem
        for ball in self._references():
            least = np.maximum(np.abs(ball[0]) - ball[1], 0.0)
            if np.abs(ball[0]).any():
                scaled = least / problem.column_units
                return float(least.max(initial=0.0)), float(scaled.max(initial=0.0))
        return 0.0, 0.0

    def _references(self) -> Any:
        yield self.transposed(self.problem.b, np.zeros(self.problem.shape[0]))
        start = self.problem.nearest_to_zero
        yield self.gradient(start, self.residual(start))

    @cached_property
    def convexity(self) -> FloatVector | None:
        """What is found of :func:`_convexity`."""
        return _convexity(self.problem)

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
    from ..kernels.least_squares_sums import along_rows, down_columns

    sums, part = np.zeros((2, 4, B.shape[0]))
    if B.flags.c_contiguous:
        along_rows(B, v, slip, sums)
        return sums
    for begin in range(0, B.shape[1], ROWS_AT_ONCE):
        rows = slice(begin, begin + ROWS_AT_ONCE)
        down_columns(B.T[rows], v[rows], slip[rows], part)
        sums += part
    return sums


@dataclass(frozen=True, eq=False)
class Optimality:
    """How optimal an x is.

    Attributes
    ----------
    x, residual : ndarray, shape (n,), (m,)
    value : float
        What SOLVED asks to be at most the tolerance: the least gap found, rounding aside, beside its cost, 1 at the
        most; of a LinearOperator `steepness`.
    steepness : float
        The larger of ‖mid(x − upper, x − lower, g)‖∞/‖AᵀWb‖∞, g = AᵀW(A x − b) + ridge x, and the same with columns of
        about unit length; an upper bound, rounding included, where A has entries.
    is_at_rounding_level : bool
        Whether no component of it is larger than what rounding explains.
    dual : ndarray, shape (m,)
        The y of the value.
    """

    x: FloatVector
    residual: FloatVector
    value: float
    steepness: float
    is_at_rounding_level: bool
    dual: FloatVector

    @classmethod
    def of(
        cls, enclosures: Enclosures, x: FloatVector, dual: FloatVector | None = None, *, tolerance: float = np.inf
    ) -> Optimality:
        """Return the optimality of x on the caller's own data.

        A y that somebody has for x is tried beside the residual; others are computed where neither reaches `tolerance`.
        """
        from ..kernels.least_squares_sums import largest_residuals

        problem, units = enclosures.problem, enclosures.problem.column_units
        with np.errstate(over="ignore", invalid="ignore"):
            residual = enclosures.residual(x)
            gradient, slope = enclosures.gradients(x, residual)
            *largest, is_at_floor = largest_residuals(
                *gradient, x, problem.lower, problem.upper, units, problem.has_entries
            )
            steepness = max(map(_ratio, largest, enclosures.reference))
            value, y = steepness, residual[0]
            if problem.has_entries:
                value, y = _beside_cost(enclosures, x, residual, slope, dual, tolerance)
        return cls(x, residual[0], value, steepness, is_at_floor, y)


def _beside_cost(
    enclosures: Enclosures, x: FloatVector, residual: Ball, slope: Ball, dual: FloatVector | None, tolerance: float
) -> tuple[float, FloatVector]:
    """Return what SOLVED compares with the tolerance (the module's docstring), 1 at the most, and its y."""
    least, best, problem = np.inf, residual[0], enclosures.problem
    for y, at_y, convexity in _dual_points(enclosures, x, residual, slope, dual):
        gap, cost, _ = _gap(problem, x, residual, y, at_y, convexity, rounding=-1.0)
        value = 0.0 if gap == 0.0 else OUTWARD * gap / cost if cost > 0.0 else np.inf
        if value < least:
            least, best = value, y
        if least <= tolerance:
            break
    return min(least, 1.0), best


def _dual_points(
    enclosures: Enclosures, x: FloatVector, residual: Ball, slope: Ball, dual: FloatVector | None
) -> Iterator[tuple[FloatVector, Ball, FloatVector]]:
    """Yield what y may be, with its s and the convexity that goes with it, the cheapest first."""
    r, slip = residual
    problem, root = enclosures.problem, enclosures.problem.root_weights
    if dual is not None:
        yield dual, enclosures.gradient_at(x, dual), NOTHING
        sizes = root * np.abs(dual)  # what is rounding of rounding may be 0
        dual = np.where(sizes > EPSILON * EPSILON * np.max(sizes, initial=0.0), dual, 0.0)
        yield dual, enclosures.gradient_at(x, dual), NOTHING
    yield r, slope, NOTHING
    if (np.abs(r) <= slip).any():
        zeroed = np.where(np.abs(r) > slip, r, 0.0)
        yield zeroed, enclosures.gradient_at(x, zeroed), NOTHING
    free, y, at_y = (problem.lower < x) & (x < problem.upper), r, slope
    yield from ((*found, NOTHING) for found in _repaired(enclosures, x, y, at_y, rounding=-1.0))
    for accuracy in ACCURACIES:
        y = y - _push(problem, np.where(free, at_y[0] / problem.column_units, 0.0), free, accuracy)
        at_y = enclosures.gradient_at(x, y)
        yield y, at_y, NOTHING
        yield from ((*found, NOTHING) for found in _repaired(enclosures, x, y, at_y, rounding=-1.0))
    if (convexity := enclosures.convexity) is not None:
        yield r, slope, convexity


def _ratio(size: float, unit: float) -> float:
    if math.isnan(size):
        return math.inf
    return OUTWARD * size / unit if unit > 0.0 else (math.inf if size > 0.0 else 0.0)


def _typical_rounding(problem: BoundedLeastSquares, x: FloatVector, residual: FloatVector) -> FloatVector:
    """Return about what rounding does to a gradient of which no magnitudes are known."""
    root, units = problem.root_weights, problem.column_units
    size = np.linalg.norm(root * residual) + np.linalg.norm(root * problem.b) + np.linalg.norm(units * x)
    return 4.0 * EPSILON * (units * size)


def duality_gap(problem: BoundedLeastSquares, x: FloatVector, *duals: FloatVector) -> float:
    """Return an upper bound of f(x) − min f, for x within the bounds; an estimate for a LinearOperator.

    Parameters
    ----------
    problem : BoundedLeastSquares
    x : array, shape (n,)
    *duals : arrays, shape (m,)
        Of any origin; residuals of points nearer to the answer make the bound sharper.
    """
    enclosures = Enclosures(problem)
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        residual = enclosures.residual(x)
        at_x = enclosures.gradient(x, residual)
        found = [_gap_of(_gap(problem, x, (residual[0], np.zeros(residual[0].size)), residual[0], at_x))]
        duals = duals or (residual[0],)
        found += [_gap_of(_gap(problem, x, residual, y, enclosures.gradient_at(x, y))) for y in duals]
        if not np.nanmin(found) < np.inf:
            repaired = _repaired(enclosures, x, duals[0], enclosures.gradient_at(x, duals[0]))
            found += [_gap_of(_gap(problem, x, residual, *repair)) for repair in repaired]
        if not np.nanmin(found) < np.inf:
            found.append(_gap_of_definite(problem, x, residual, at_x))
    return min(gap for gap in (_cost_above(problem, x, residual), *found) if not np.isnan(gap))


def _cost_above(problem: BoundedLeastSquares, x: FloatVector, residual: Ball) -> float:
    largest = np.abs(residual[0]) + residual[1]
    return float(OUTWARD**3 * (problem.cost(x, largest) + TINY))


def _gap(
    problem: BoundedLeastSquares, x: FloatVector, residual: Ball, y: FloatVector, slope: Ball,
    convexity: FloatVector = NOTHING, *, rounding: float = 1.0,
) -> tuple[float, float, float]:
    """Return gap(x, y) for s in `slope`, the cost, and the size whose square is the unit of both.

    What rounding may have done is added, or with rounding=−1 excused.
    """
    from ..kernels.least_squares_sums import gap_beside_cost

    found: tuple[float, float, float] = gap_beside_cost(
        *residual, y, *slope, x, problem.lower, problem.upper, problem.root_weights, problem.column_units,
        problem.ridge, convexity, rounding,
    )
    return found


def _gap_of(found: tuple[float, float, float]) -> float:
    gap, _, size = found
    return OUTWARD * gap * size * size + TINY if gap < np.inf else np.inf


def _repaired(
    enclosures: Enclosures, x: FloatVector, y: FloatVector, slope: Ball, *, rounding: float = 1.0
) -> Iterator[tuple[FloatVector, Ball]]:
    """Yield y + δp with a least δ that gives all columns the sign that they need, and its s, if one is found.

    p is to push the columns whose sign is in doubt, or else all of them.
    """
    problem = enclosures.problem
    wanted = np.where(problem.upper == np.inf, 1.0, 0.0) - np.where(problem.lower == -np.inf, 1.0, 0.0)
    wanted = np.where(np.maximum(np.abs(slope[0]), slope[1]) > 0.0, wanted, 0.0)
    sizes = wanted * slope[0] / problem.column_units
    in_doubt = sizes <= IN_DOUBT * np.max(np.abs(sizes), initial=0.0)
    missing = np.maximum(rounding * slope[1] - wanted * slope[0], 0.0)
    lacking = (wanted != 0.0) & (missing > 0.0)
    for push in _pushes(problem, np.where(in_doubt, wanted, 0.0), wanted):
        moved = wanted * problem.transposed(problem.weighted(push))
        share = float(np.max(missing[lacking] / moved[lacking], initial=0.0))
        for _ in range(PUSHES if (moved[lacking] > 0.0).all() else 0):
            share *= 1.0 + 2.0**-10
            repaired = y + share * push
            value, radius = enclosures.gradient_at(x, repaired)
            if (wanted * value >= rounding * radius)[wanted != 0.0].all():
                yield repaired, (value, radius)
                return
            share *= 2.0


def _pushes(problem: BoundedLeastSquares, *wanted: FloatVector) -> Iterator[FloatVector]:
    """Yield what p may be: A times the first of what is wanted, which serves where entries are ≥ 0, then the shortest."""
    yield problem.product(wanted[0] / problem.column_units)
    for signs in wanted:
        yield _push(problem, signs, signs != 0.0, ENOUGH / math.sqrt(max(np.count_nonzero(signs), 1)))


def _push(problem: BoundedLeastSquares, wanted: FloatVector, chosen: BoolVector, accuracy: float) -> FloatVector:
    """Return the shortest p with (AᵀWp)_j about wanted_j times the length of column j, for the chosen j.

    Its signs are looked at where it is used.
    """
    unit, columns, root = problem.unit, np.flatnonzero(chosen), problem.root_weights
    if not wanted[columns].any():
        return np.zeros(root.size)
    from scipy.sparse.linalg import LinearOperator, lsmr

    from .dual_bounds import least_squares

    def back(pull: FloatVector) -> FloatVector:
        full = np.zeros(wanted.size)
        full[columns] = pull
        return np.asarray(unit.product(full))

    shape = (columns.size, root.size)
    across = LinearOperator(shape, lambda push: unit.transposed(push)[columns], back, dtype=np.float64)
    steps = min(REPAIR_STEPS, 2 * columns.size + 1)
    push, reason, *_ = lsmr(across, wanted[columns], atol=0.0, btol=accuracy, conlim=0.0, maxiter=steps)
    if reason != IS_NEAR and problem.is_cheap_to_copy:  # however ill-conditioned A is
        push = least_squares(sp.csr_array(unit.entries()[:, columns]).T, wanted[columns])
    return np.asarray(np.divide(push, root, out=np.zeros(root.size), where=root > 0.0))


def _gap_of_definite(problem: BoundedLeastSquares, x: FloatVector, residual: Ball, slope: Ball) -> float:
    """Return the bound for y = r where AᵀWA is proved to be positive definite."""
    convexity = _convexity(problem)
    if convexity is None:
        return np.inf
    return _gap_of(_gap(problem, x, (residual[0], np.zeros(residual[0].size)), residual[0], slope, convexity))


def _convexity(problem: BoundedLeastSquares) -> FloatVector | None:
    """Return d > 0, shape (n,), with AᵀWA + ridge − diag(d) proved positive semidefinite, or None."""
    from .solution_bounds import smallest_eigenvalue_bound

    n = problem.shape[1]
    if not problem.has_entries or not 0 < n <= min(GRAM_UP_TO, problem.shape[0]):
        return None
    unit = problem.unit
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
    return least * (1.0 - 2.0**-40) * (problem.column_units / bound.scale) ** 2 if least > 0.0 else None
