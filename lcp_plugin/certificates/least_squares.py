r"""What is proved of an x for min ½ Σ weights (A x − b)² + ½ ridge ‖x‖², lower ≤ x ≤ upper: how optimal, how far above.

Write W = diag(weights), r = A x − b, f for the cost. For any y ∈ ℝᵐ and s = AᵀWy + ridge·x, convexity gives, summed
without cancellation, for every feasible z

    f(x) − f(z) ≤ ½ (r − y)ᵀW(r − y) + Σ_j s_j⁺(x_j − lower_j) + s_j⁻(upper_j − x_j),

and, with μ ≥ ridge such that f(z) − ½μ‖z‖² is convex, no more than s_j²/(2μ) for any column j while y = r. A column
without a bound on one side needs an s_j of one sign, which rounding and the tolerance deny to y = r: y = r + δp with
AᵀWp of that sign has it. Where there is none (a free column, A not proved to have full rank) f(x) − f(z) ≤ f(x) is all
there is to say.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sp

from ..checks import FloatVector
from ..exact.rounding import compensated_product, gamma
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
GRAM_UP_TO = 3000  # columns; AᵀWA is factorised


class Enclosures:
    """Residuals and gradients of a problem with bounds of what rounding did; estimates for a LinearOperator.

    Parameters
    ----------
    problem : BoundedLeastSquares
    is_sharp : bool
        Whether sums are compensated, so that nothing but the last rounding is left, and nothing at all where they are
        exact. That costs two copies of A.

    Attributes
    ----------
    reference : (float, float)
        A lower bound of ‖AᵀWb‖∞ in the caller's units, and with columns of about unit length. Where AᵀWb is 0, of the
        gradient at the point of [lower, upper] nearest to 0; where that is 0 as well, that point is the answer.
    """

    def __init__(self, problem: BoundedLeastSquares, *, is_sharp: bool = False) -> None:
        self.problem, self.is_sharp = problem, is_sharp

    def residual(self, x: FloatVector) -> Ball:
        """Return A x − b."""
        problem = self.problem
        if self.is_sharp:
            return compensated_product(self._rows, x, -problem.b)
        if not problem.has_entries:
            return problem.product(x) - problem.b, np.zeros(problem.shape[0])
        return self._product(x, NOTHING, problem.b, by_rows=True)

    def gradient(self, x: FloatVector, residual: Ball) -> Ball:
        """Return AᵀW(A x − b) + ridge x."""
        from ..kernels.least_squares_sums import with_ridge

        value, radius = self.transposed(*residual)
        with_ridge(value, radius, self.problem.ridge, x)
        return value, radius

    def transposed(self, y: FloatVector, slip: FloatVector) -> Ball:
        """Return AᵀWy for a y known up to slip."""
        problem = self.problem
        weighted, slip = problem.weighted(y), problem.weighted(slip)
        if self.is_sharp:
            if problem.weights is not None:
                slip = OUTWARD * (slip + EPSILON * np.abs(weighted) + TINY * (weighted != 0.0))
            value, radius = compensated_product(self._columns, weighted)
            return value, OUTWARD * (radius + abs(self._columns) @ slip)
        if not problem.has_entries:
            return problem.transposed(weighted), np.zeros(problem.shape[1])
        return self._product(weighted, slip, 0.0, by_rows=False)

    def _product(self, v: FloatVector, slip: FloatVector, less: FloatVector | float, *, by_rows: bool) -> Ball:
        """Return B v − less for a v known up to slip; B is A, or else Aᵀ."""
        from ..kernels.least_squares_sums import radii

        B = self.problem.A if by_rows else self.problem.A.T
        sums = _sums_of_sparse(B, v, slip) if self.problem.is_sparse else _sums_of_dense(B, v, slip)
        sums[0] -= less
        sums[1] += np.abs(less)
        radius = np.empty(sums.shape[1])
        radii(sums, self._terms[not by_rows], radius)
        return sums[0], radius

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
    def _rows(self) -> Any:
        return sp.csr_array(self.problem.A)

    @cached_property
    def _columns(self) -> Any:
        return sp.csr_array(self.problem.A.T)

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


def _sums_of_sparse(B: Any, v: FloatVector, slip: FloatVector) -> Any:
    """Return the same of a sparse B, whatever underflows."""
    columns = np.zeros((B.shape[1], 3))
    columns[:, 0], columns[:, 1] = np.abs(v), slip if slip.size else 0.0
    columns[:, 2] = columns.any(axis=1)
    return np.vstack([B @ v, (abs(B) @ columns).T])


@dataclass(frozen=True, eq=False)
class Optimality:
    """How optimal an x is.

    Attributes
    ----------
    x, residual : ndarray, shape (n,), (m,)
    value : float
        The larger of ‖mid(x − upper, x − lower, g)‖∞/‖AᵀWb‖∞, g = AᵀW(A x − b) + ridge x, and the same with columns of
        about unit length; an upper bound, rounding included, where A has entries.
    is_at_rounding_level : bool
        Whether no component is larger than what rounding explains.
    """

    x: FloatVector
    residual: FloatVector
    value: float
    is_at_rounding_level: bool

    @classmethod
    def of(cls, enclosures: Enclosures, x: FloatVector) -> Optimality:
        """Return the optimality of x on the caller's own data."""
        from ..kernels.least_squares_sums import largest_residuals

        problem, units = enclosures.problem, enclosures.problem.column_units
        with np.errstate(over="ignore", invalid="ignore"):
            residual = enclosures.residual(x)
            gradient, radius = enclosures.gradient(x, residual)
            if not problem.has_entries:
                radius = _typical_rounding(problem, x, residual[0])
            *largest, is_at_floor = largest_residuals(
                gradient, radius, x, problem.lower, problem.upper, units, problem.has_entries
            )
        return cls(x, residual[0], max(map(_ratio, largest, enclosures.reference)), is_at_floor)


def _ratio(size: float, unit: float) -> float:
    if math.isnan(size):
        return math.inf
    return OUTWARD * size / unit if unit > 0.0 else (math.inf if size > 0.0 else 0.0)


def _typical_rounding(problem: BoundedLeastSquares, x: FloatVector, residual: FloatVector) -> FloatVector:
    """Return about what rounding does to a gradient of which no magnitudes are known."""
    root, units = problem.root_weights, problem.column_units
    size = np.linalg.norm(root * residual) + np.linalg.norm(root * problem.b) + np.linalg.norm(units * x)
    return 4.0 * EPSILON * (units * size)


def duality_gap(problem: BoundedLeastSquares, x: FloatVector, nearer: FloatVector | None = None) -> float:
    """Return an upper bound of f(x) − min f, for x within the bounds; an estimate for a LinearOperator.

    Parameters
    ----------
    problem : BoundedLeastSquares
    x : array, shape (n,)
    nearer : array, shape (n,), optional
        A point nearer to the answer, wherever it comes from: y is its residual, and the bound is sharper.
    """
    enclosures = Enclosures(problem)
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        residual = enclosures.residual(x)
        at_x = enclosures.gradient(x, residual)
        y = residual[0] if nearer is None else problem.product(nearer) - problem.b
        slope = enclosures.gradient(x, (y, np.zeros(y.size)))
        found = [
            _cost_above(problem, x, residual),
            _gap(problem, x, residual, residual[0], at_x, problem.ridge),
            _gap(problem, x, residual, y, slope, problem.ridge),
        ]
        if not np.fmin(found[1], found[2]) < np.inf:
            found.append(_repaired_gap(enclosures, x, residual, y, slope))
            if not found[-1] < np.inf:
                found.append(_gap_of_definite(problem, x, residual, at_x))
    return min(gap for gap in found if not np.isnan(gap))


def _cost_above(problem: BoundedLeastSquares, x: FloatVector, residual: Ball) -> float:
    largest = np.abs(residual[0]) + residual[1]
    return float(OUTWARD**3 * (problem.cost(x, largest) + TINY))


def _gap(
    problem: BoundedLeastSquares, x: FloatVector, residual: Ball, y: FloatVector, slope: Ball,
    convexity: FloatVector | float,
) -> float:
    """Return the bound of the module's docstring for s in `slope`, with s²/(2 convexity) where that is less."""
    if not (np.isfinite(slope[0]).all() and np.isfinite(slope[1]).all()):
        return np.inf
    distance = OUTWARD * (np.abs(residual[0] - y) + residual[1])
    rising, falling = np.maximum(slope[0] + slope[1], 0.0), np.maximum(slope[1] - slope[0], 0.0)
    terms = _times(rising, x - problem.lower) + _times(falling, problem.upper - x)
    with np.errstate(divide="ignore", invalid="ignore"):
        steepest = np.maximum(rising, falling)
        curved = np.where(steepest > 0.0, steepest * steepest / (2.0 * np.asarray(convexity)) + TINY, 0.0)
    total = 0.5 * float(problem.weighted(distance) @ distance) + float(np.fmin(terms, curved).sum())
    return OUTWARD**4 * total + x.size * TINY


def _times(slope: FloatVector, room: FloatVector) -> FloatVector:
    """Return slope · room, 0 where the slope is; rounded upwards by what OUTWARD allows but for underflow."""
    return np.where(slope > 0.0, slope * np.where(slope > 0.0, room, 0.0) + np.where(room > 0.0, TINY, 0.0), 0.0)


def _repaired_gap(
    enclosures: Enclosures, x: FloatVector, residual: Ball, y: FloatVector, slope: Ball
) -> float:
    """Return the bound for y + δp with the least δ that gives all columns the sign that they need.

    p is to push the columns whose sign is in doubt, or else all of them.
    """
    problem, exactly = enclosures.problem, np.zeros(y.size)
    wanted = np.where(problem.upper == np.inf, 1.0, 0.0) - np.where(problem.lower == -np.inf, 1.0, 0.0)
    wanted = np.where(np.maximum(np.abs(slope[0]), slope[1]) > 0.0, wanted, 0.0)
    sizes = wanted * slope[0] / problem.column_units
    in_doubt = sizes <= IN_DOUBT * np.max(np.abs(sizes), initial=0.0)
    missing = np.maximum(slope[1] - wanted * slope[0], 0.0)
    lacking = (wanted != 0.0) & (missing > 0.0)
    for pushed in (np.where(in_doubt, wanted, 0.0), wanted):
        push = _pushing(problem, pushed)
        moved, slip = enclosures.transposed(push, exactly)
        least = wanted * moved - slip
        share = float(np.max(missing[lacking] / least[lacking], initial=0.0))
        for _ in range(PUSHES if (least[lacking] > 0.0).all() else 0):
            share *= 1.0 + 2.0**-10
            repaired = y + share * push
            gap = _gap(problem, x, residual, repaired, enclosures.gradient(x, (repaired, exactly)), problem.ridge)
            if gap < np.inf:
                return gap
            share *= 2.0
    return np.inf


def _pushing(problem: BoundedLeastSquares, wanted: FloatVector) -> FloatVector:
    """Return the shortest p with (AᵀWp)_j about wanted_j times the length of column j, where wanted_j is not 0.

    Its signs are looked at where it is used.
    """
    unit, columns, root = problem.unit, np.flatnonzero(wanted), problem.root_weights
    if not columns.size:
        return np.zeros(root.size)
    from scipy.sparse.linalg import LinearOperator, lsmr

    from .dual_bounds import least_squares

    def back(pull: FloatVector) -> FloatVector:
        full = np.zeros(wanted.size)
        full[columns] = pull
        return np.asarray(unit.product(full))

    shape, enough = (columns.size, root.size), ENOUGH / math.sqrt(columns.size)
    across = LinearOperator(shape, lambda push: unit.transposed(push)[columns], back, dtype=np.float64)
    steps = min(REPAIR_STEPS, 2 * columns.size + 1)
    push, reason, *_ = lsmr(across, wanted[columns], atol=0.0, btol=enough, conlim=0.0, maxiter=steps)
    if reason != IS_NEAR and problem.is_cheap_to_copy:  # however ill-conditioned A is
        push = least_squares(sp.csr_array(unit.entries()[:, columns]).T, wanted[columns])
    return np.asarray(np.divide(push, root, out=np.zeros(root.size), where=root > 0.0))


def _gap_of_definite(problem: BoundedLeastSquares, x: FloatVector, residual: Ball, slope: Ball) -> float:
    """Return the bound for y = r where AᵀWA is proved to be positive definite."""
    convexity = _convexity(problem)
    return np.inf if convexity is None else _gap(problem, x, residual, residual[0], slope, convexity)


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
    terms = problem.shape[0] + 16
    # Columns are shorter than 2: no entry is wrong by more than 4 γ, nor an eigenvalue by more than n times that.
    slip = 8.0 * n * (gamma(2 * terms) + EPSILON)
    bound = smallest_eigenvalue_bound(Matrix(0.5 * (dense + dense.T)))
    if bound is None or not bound.is_rigorous:
        return None
    least = bound.value - slip * float(bound.scale.max()) ** 2
    return least * (1.0 - 2.0**-40) * (problem.column_units / bound.scale) ** 2 if least > 0.0 else None
