"""The stopping criterion of a linear complementarity problem, a function of M, q, the bounds, z and the tolerance.

With T_i = |q_i| + Σ_j |m_ij z_j|, d_i = m_ii if this is positive and at least 2⁻²⁰ max_j |m_ij|, otherwise
max_j |m_ij|, and r_i = z_i − mid(lower_i, upper_i, z_i − w_i/d_i), z is SOLVED if in each connected component P of the
graph of M and in each row i

    1. ‖r_P(z)‖∞ ≤ max(tolerance · ref_P, absolute tolerance),
    2. v_i = d_i |r_i| ≤ max(2⁻⁴² T_i, min(tolerance^(3/4) T_i, tolerance^(1/4) a_i)), or |r_i| ≤ 2⁻¹⁰⁴ ‖r_P(z°)‖∞ if
       the row is idle.

- v_i is the smaller of the changes of z_i and w_i that make the pair complementary, in the unit of w_i.
- ref_P is the smaller of ‖r_P(z°)‖∞, or the largest |w_k(z°)|/d_k if that is 0, and the largest T_k/d_k of the rows of
  P that are violated or off their bounds; z° is the point of the bounds nearest to 0.
- a_i = max(|w_i(z°)|, max_j |m_ij w_j(z°)|/d_j), left out if it is 0, is the demand of the row and its neighbors.
- A slack at the rounding level of its row counts as 0: |w_i| ≤ 8 ε min(T_i, S_i), S_i = T_i(z°) + 2²⁰ d_i ‖r_P(z°)‖∞,
  so that a z that ran away does not make every slack rounding. A w_i also counts as 0 if |w_i| and |w_i|/d_i are below
  the smallest normal double.
- An idle row has d_i = m_ii and w_i(z°) = 0: other rows determine its z_i, as in the far field of a price, where z_i
  underflows. 2⁻¹⁰⁴ is ε². If d_i is another entry, z_i may have to move much further than |r_i|.

Rounding errors are included in test 1. A row whose demand is below 2⁻⁴² of its terms is noise, and violations below the
smallest normal double pass test 2: these are the limits. Test 2 is omitted in rows with |r_i| ≤ absolute tolerance.
A run moves each z_i to a bound that is nearer than the step −w_i/d_i, and z to z° in components that z° solves; then
the run measures and returns the moved point. ``certify`` measures the user's point by the same function. A residual is
not an error: ``help("lcp_plugin.proofs")``.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar, NamedTuple

import numpy as np

from ..core.checks import AnyMatrix, Array, BoolVector, Vector
from ..core.entries import clip, entries_of_rows, largest_products, max_norm
from ..core.kernels import floats
from ..core.kernels.compilation import kernel
from ..core.kernels.floats import (
    EPSILON,
    INF,
    NEGLIGIBLE,
    NEGLIGIBLE_DIAGONAL,
    NORMAL,
    SMALLEST,
    TINY,
)
from ..core.lcp import LCP
from ..core.matrix import Matrix, fact
from ..core.names import Names
from ..core.rounding import compensated_product
from ..core.structure import connected_components
from ..core.sweep_data import BLOCK

VectorEnds = tuple[Vector, Vector]  # lower and upper bounds
ROW_POWER = 0.75  # of the tolerance, next to the terms of a row
DEMAND_POWER = 0.25  # of the tolerance, next to the demand a_i of a row
NEAREST = 8.0 * EPSILON  # of the terms of a row: rounding of them explains such a slack
IDLE_ROUNDING = 2.0**-104  # ε², of the reference: no residual of an idle row is measured finer
RAN_AWAY = 2.0**20  # times the reference: the terms of a larger z are not explained by the data
GAINED = 0.1  # of the reference: a larger residual is not limited by rounding
SET_TO_BOUND = 2.0**-50  # of the largest z: a smaller distance from a bound is at rounding level
CERTAIN = 0.99  # of the upper bound of a residual: a lower bound as large needs no sharper sums


class RowsAtPoint(NamedTuple):
    """Values of all rows at a point z, from one pass over M.

    Attributes
    ----------
    w : array, shape (…, n)
        The slack M z + q in double precision.
    terms : array, shape (…, n)
        T = |M||z| + |q|; at most the largest double.
    rounding : array, shape (…, n)
        A bound of the rounding error of w, for any order of summation; 0 if M z = 0 exactly.
    violation : array, shape (…, n)
        The violations v_i, as the docstring of this module defines them.
    is_active : array of bool, shape (…, n)
        The rows whose terms count: z_i strictly between its bounds, or the row is violated.
    """

    w: Vector
    terms: Vector
    rounding: Vector
    violation: Vector
    is_active: Any


class RowResiduals(NamedTuple):
    """Residuals of the rows at a point, arrays of shape (…, n).

    Attributes
    ----------
    low, high : array
        Bounds of |r_i|.
    reference : array
        A lower bound of ref_P, of the component of each row; it may have the shape (…, 1).
    relative : array
        The quotients of `high` and `reference`, 0 for 0/0 and within an absolute tolerance.
    componentwise : array
        The least tolerance at which the row passes the componentwise test, 0 within an absolute tolerance.
    worst : float, or array of shape (…)
        The largest of `relative`.
    """

    low: Array
    high: Array
    reference: Array
    relative: Array
    componentwise: Array
    worst: Array

    def fails(self, tolerance: float) -> Any:
        """Return the rows that do not pass the criterion at a tolerance, bool."""
        return ~((self.relative <= tolerance) & (self.componentwise <= tolerance))


class Measured(NamedTuple):
    """Point, or stack of points, and its measure by the stopping criterion.

    Attributes
    ----------
    z : array
        The measured point, of the shape that its problem class uses.
    residual : float, or array with a number per point
        Number that a run compares, the smaller the better: the relative residual.
    passes : bool, or array of bool
        Whether the point is SOLVED.
    is_limited : bool, or array of bool
        Whether the point does not pass because of rounding only: PRECISION_LIMIT.
    rows : RowsAtPoint or None
        The values of the rows at z.
    by_row : RowResiduals or None
    """

    z: Any
    residual: Array
    passes: Any
    is_limited: Any = False
    rows: Any = None
    by_row: Any = None


@dataclass(eq=False)
class RowData:
    """M, q, bounds, d and components of one problem or of a stack: the data of the criterion.

    A class of problems with another product or other rows replaces `anywhere`, `worst`, `largest`, `largest_products`,
    `rows` or `sharp_product`.

    It is one class because the measures call each other, and a subclass replaces some of them.

    Parameters
    ----------
    M : ndarray or CSR array, shape (n, n), or ndarray, shape (B, n, n)
        A CSR array may have vectors of shape (B, n).
    absolute : the same
        |M|.
    q, lower, upper, scale : array, shape (n,) or (B, n)
        `scale` is d.
    labels : array of int, shape (n,) or (B, n), or None
        Connected component of each row, all different in a stack; None if each problem is connected.
    origin : array, shape (n,) or (B, n), optional
        z°, if it is computed already.
    """

    M: AnyMatrix
    absolute: Any
    q: Vector
    lower: Vector
    upper: Vector
    scale: Vector
    labels: Any = None
    origin: Any = None

    matrix: ClassVar[str] = "M"  # its name in results

    def __post_init__(self) -> None:
        if self.origin is None:
            self.origin = clip(0.0, self.lower, self.upper)

    @cached_property
    def _counts(self) -> Any:
        """Number of nonzeros of each row; a status does not depend on whether M is stored with its zeros."""
        return entries_of_rows(self.M)

    # --- the point z° ---------------------------------------------------------------------------------------

    @cached_property
    def rows_at_origin(self) -> RowsAtPoint:
        """Values of all rows at z°."""
        return self.rows(self.origin)

    @cached_property
    def references(self) -> VectorEnds:
        """Bounds of ‖r_P(z°)‖∞ in the component of each row; the lower end is NaN if it is infinite."""
        z, at = self.origin, self.rows_at_origin
        ends = self.residual_ends(z, at.w, at.rounding)
        is_zero = self.is_rounding(at.w, at.rounding, at.terms, np.inf)
        least, most = (self.largest(np.where(is_zero, 0.0, end)) for end in ends)
        is_open = (least == 0.0) & (most > 0.0)  # does z° solve the component?
        if self.anywhere(is_open) and (sharp := self.sharp_product(z)) is not None:
            is_zero = self.is_rounding(*sharp, at.terms, np.inf)
            ends = self.residual_ends(z, *sharp)
            least, most = (
                np.where(is_open, self.largest(np.where(is_zero, 0.0, end)), before)
                for end, before in zip(ends, (least, most), strict=True)
            )
        return np.where(most < np.inf, least, np.nan), most

    @cached_property
    def is_solved_at_origin(self) -> Any:
        """Mask of the rows whose component z° solves."""
        return self.references[1] == 0.0

    @cached_property
    def slack_at_origin(self) -> Vector:
        """The |w_i(z°)|, 0 for a slack at rounding level."""
        w = np.abs(self.rows_at_origin.w)
        return np.where(w > NEGLIGIBLE * self.rows_at_origin.terms, w, 0.0)

    @cached_property
    def largest_slack_at_origin(self) -> Any:
        """The largest |w_i(z°)|/d_i in the component of each row, slacks at rounding level left out."""
        return self.largest(self.slack_at_origin / self.scale)

    @cached_property
    def sizes(self) -> Any:
        """Terms of each row that the data explain: S_i in the docstring of this module."""
        return self.rows_at_origin.terms + RAN_AWAY * self._changes_at_origin

    @cached_property
    def _changes_at_origin(self) -> Any:
        """d_i ‖r_P(z°)‖∞ of each row, 0 if it is infinite."""
        reference = self.references[1]
        return self.scale * np.where(np.isfinite(reference), reference, 0.0)

    @cached_property
    def least_violation(self) -> Vector:
        """Violation of each row that passes next to any terms: of rounding in idle rows, or below normal doubles."""
        M = self.M
        diagonal = np.diagonal(M, 0, -2, -1) if isinstance(M, np.ndarray) else M.diagonal()
        is_idle = (self.norm(self.slack_at_origin) == 0.0) & (self.scale == diagonal)
        return np.maximum(np.where(is_idle, IDLE_ROUNDING * self._changes_at_origin, 0.0), NORMAL)

    @cached_property
    def demand(self) -> Vector:
        """Demand of each row: a_i in the docstring of this module."""
        w = self.slack_at_origin
        return np.maximum(w, self.largest_products(w / self.scale))

    # --- operations that a class of problems may replace ----------------------------------------------------

    def anywhere(self, mask: BoolVector) -> bool:
        """Return whether the mask is True in any row."""
        return bool(mask.any())

    def worst(self, values: Vector) -> Any:
        """Return the largest of the values ≥ 0 of each problem; a NaN stays."""
        return values.max(-1, initial=0.0)

    def largest(self, values: Vector) -> Any:
        """Return the largest of the values ≥ 0 in the component of each row; shape (…, 1) if it is the only one.

        A NaN stays.
        """
        if self.labels is None:
            return np.maximum.reduce(values, axis=-1, keepdims=True, initial=0.0)
        maxima = np.zeros(self.labels.size)
        np.maximum.at(maxima, self.labels, values)
        return maxima[self.labels]

    def largest_products(self, x: Vector) -> Vector:
        """Return max_j |m_ij| x_j of each row, x ≥ 0."""
        return largest_products(self.absolute, x)

    def sharp_product(self, z: Vector) -> VectorEnds | None:
        """Return M z + q by sums in twice the precision, and bounds of their errors; None for several problems."""
        if self.q.size > self.q.shape[-1]:
            return None
        from scipy.sparse import csr_array

        M = csr_array(self.M[0] if self.M.ndim > 2 else self.M)
        w, radius = compensated_product(M, np.ascontiguousarray(z).ravel(), self.q.ravel())
        return w.reshape(z.shape), radius.reshape(z.shape)

    def rows(self, z: Vector, w: Array = None) -> RowsAtPoint:
        """Return the values of all rows at z, with its slack w if that is known."""
        w = matvec(self.M, z) + self.q if w is None else w
        products = matvec(self.absolute, np.abs(z))
        terms = np.minimum(products + np.abs(self.q), floats.LARGEST)
        bound = (self._counts + 6) * (EPSILON * terms + TINY)
        rounding = np.where(products > 0.0, bound, 0.0)  # NaN stays
        below, above = self.scale * (z - self.lower), self.scale * (z - self.upper)
        violation = np.abs(np.maximum(above, np.minimum(below, w)))
        is_active = (violation > 0.0) | ((below > 0.0) & (above < 0.0))
        return RowsAtPoint(w, terms, rounding, violation, is_active)

    def norm(self, x: Vector) -> Vector:
        """Return |x|; over cones the norm of each block in its rows."""
        return np.abs(x)

    def is_rounding(self, w: Vector, rounding: Vector, terms: Vector, sizes: Array) -> Any:
        """Return the rows whose slack is at their rounding level, w within `rounding` if z ran away, bool."""
        size = self.norm(w) + np.where(terms > sizes, self.norm(rounding), 0.0)
        least = NORMAL * np.minimum(self.scale, 1.0)
        return size <= np.maximum(NEAREST * np.minimum(terms, sizes), least)

    def residual_ends(
        self, z: Vector, w: Vector, rounding: Vector | None = None, scale: Vector | None = None
    ) -> VectorEnds:
        """Return bounds of every |r_i(z)| for slacks within w ± rounding; 0 and ∞ for numbers that are not finite."""
        if rounding is None:
            size = np.abs(self.residual(z, w, scale))
            return size * (1.0 - 4.0 * EPSILON), size * (1.0 + 4.0 * EPSILON)
        bottom, top = self.residual(z, np.array([w - rounding, w + rounding]), scale)
        low = np.maximum(np.maximum(bottom, -top), 0.0) * (1.0 - 4.0 * EPSILON)
        high = np.maximum(-bottom, top) * (1.0 + 4.0 * EPSILON)
        is_number = np.isfinite(w + rounding + z)
        if not is_number.all():
            low, high = np.where(is_number, low, 0.0), np.where(is_number, high, np.inf)
        return low, high

    def residual(self, z: Vector, w: Vector, scale: Vector | None = None) -> Vector:
        """Return r(z), by mid(z − upper, z − lower, w/d): a small step is not lost next to a large z.

        Intermediate arrays are so short that they stay in the cache.
        """
        residual, scale = np.empty(w.shape), self.scale if scale is None else scale
        for first in range(0, w.shape[-1], BLOCK):
            part = (..., slice(first, first + BLOCK))
            step = np.divide(w[part], scale[part], out=residual[part])
            if not np.logical_and.reduce(step, None):  # perhaps a quotient underflows
                is_lost = (step == 0.0) & (w[part] != 0.0)
                step[is_lost] = np.copysign(TINY, w[part][is_lost])
            np.maximum(step, z[part] - self.upper[part], out=step)
            np.minimum(step, z[part] - self.lower[part], out=step)
        return residual

    def snap_to_bounds(self, z: Vector, w: Vector) -> Vector:
        """Return z with z_i projected onto a bound whose distance is at most the step −w_i/d_i."""
        step = w / self.scale
        moved = np.where(-step >= self.upper - z, self.upper, z)
        return np.where(step >= z - self.lower, self.lower, moved)

    # --- the measure ------------------------------------------------------------------------------------------

    def estimate(self, z: Vector) -> float:
        """Return the relative residual of z as computed in double precision, of components that z° does not solve."""
        w = matvec(self.M, z) + self.q
        residual = np.where(np.isinf(w), np.inf, np.abs(self.residual(z, w)))
        if self.labels is None:
            residual = residual.max(-1, keepdims=True, initial=0.0)
        relative = divide_nonnegative(residual, self.references[1])
        return float(np.where(self.is_solved_at_origin, 0.0, relative).max(initial=0.0))

    def snap(self, z: Vector) -> tuple[Vector, Vector | None]:
        """Return z, moved to near bounds, or to z° in components that it solves; and its slack if it did not move."""
        z = np.where(self.is_solved_at_origin, self.origin, z)
        w = matvec(self.M, z) + self.q
        moved = self.snap_to_bounds(z, w)
        return moved, None if self.anywhere(moved != z) else w

    def measure(self, z: Vector, tolerance: float, absolute: float = 0.0) -> Measured:
        """Measure the snapped z; if it fails, with zeros for rounding errors. Parameters and result of `measure_at`."""
        measured = self.measure_at(*self.snap(z), tolerance, absolute)
        measured = self.with_zeros(measured, tolerance, absolute)
        return measured._replace(is_limited=self.are_limited(measured, tolerance))

    def with_zeros(self, measured: Measured, tolerance: float, absolute: float = 0.0) -> Measured:
        """Return the measure, or the measure with 0 for unknowns at rounding level if a point passes only so.

        A linear solve leaves errors of 10⁻¹⁶ of the largest unknown everywhere, an interior-point method of 10⁻¹³.
        """
        if np.all(measured.passes | (measured.residual > tolerance)):
            return measured
        z = measured.z
        is_noise = np.abs(z) <= NEGLIGIBLE * self.largest(np.abs(z))
        is_noise &= (self.lower <= 0.0) & (self.upper >= 0.0) & (z != 0.0)
        if not self.anywhere(is_noise):
            return measured
        again = self.measure_at(np.where(is_noise, 0.0, z), None, tolerance, absolute)
        is_better = np.asarray(again.passes & ~np.asarray(measured.passes))
        if is_better.all() or not is_better.any():
            return again if is_better.all() else measured
        mixed = np.where(is_better[..., np.newaxis], again.z, z)
        return self.measure_at(mixed, None, tolerance, absolute)

    def measure_at(self, z: Vector, w: Array, tolerance: float, absolute: float = 0.0) -> Measured:
        """Measure z by the stopping criterion.

        Parameters
        ----------
        z : array, shape (…, n)
        w : array, shape (…, n), or None
            The slack of z if it is known.
        tolerance, absolute : float

        Returns
        -------
        Measured
            The relative residual and whether the point is SOLVED, shape (…).
        """
        at = self.rows(z, w)
        residuals = self.residuals_at(z, at, tolerance, absolute)
        passes = np.less_equal(residuals.worst, tolerance)
        passes = passes & np.less_equal(self.worst(residuals.componentwise), tolerance)
        return Measured(z, residuals.worst, passes, False, at, residuals)

    def are_limited(self, measured: Measured, tolerance: float) -> Any:
        """Return whether points fail in rows whose residuals rounding explains, and in no others: PRECISION_LIMIT."""
        if np.all(measured.passes):
            return np.False_
        rows = measured.by_row
        fails = rows.fails(tolerance)
        is_rounding = find_rounding_rows(rows[:2], self.rounding_floor(measured.rows.terms))
        is_rounding &= (rows.relative <= GAINED) | self.is_solved_at_origin
        is_limited = np.not_equal(self.worst(fails), 0.0)
        return is_limited & np.equal(self.worst(fails & ~is_rounding), 0.0)

    def residuals_at(
        self, z: Vector, at: RowsAtPoint, tolerance: float, absolute: float = 0.0
    ) -> RowResiduals:
        """Return the residuals of all rows; by sums in twice the precision if rounding decides at the tolerance."""
        # The largest T_k/d_k of the rows that count in the component, rounding included
        may_be_active = at.is_active | ((np.abs(at.w) <= at.rounding) & (self.lower < self.upper))
        shrink = 1.0 - (self._counts + 8) * EPSILON
        of_active = np.where(may_be_active, at.terms / self.scale * shrink, 0.0)
        of_origin = self.references[0]
        if self.anywhere(of_origin == 0.0):  # z° solves the component
            of_origin = np.where(of_origin == 0.0, self.largest_slack_at_origin, of_origin)
        reference = np.minimum(of_origin, self.largest(of_active))
        w, rounding, terms = at.w, at.rounding, self.term_residuals(at)
        for is_sharp in (False, True):
            low, high = self.residual_ends(z, w, rounding)
            relative = divide_nonnegative(high, reference)
            worst = self.worst(relative)
            is_open = ~np.less_equal(worst, tolerance)
            if not is_open.any():
                break
            is_zero = self.is_rounding(w, rounding, at.terms, self.sizes)
            is_zero &= np.isfinite(z) & is_open[..., None] & np.less_equal(terms, tolerance)
            low, high, relative = (np.where(is_zero, 0.0, x) for x in (low, high, relative))
            worst = self.worst(relative)
            if is_sharp or np.size(worst) > 1 or worst <= tolerance:
                break
            is_certain = self.worst(divide_nonnegative(low, reference)) >= CERTAIN * worst
            if is_certain or (sharp := self.sharp_product(z)) is None:
                break
            w, rounding = sharp
        if absolute:
            relative = np.where(high <= absolute, 0.0, relative)
            terms = np.where(high <= absolute, 0.0, terms)
            worst = self.worst(relative)
        return RowResiduals(low, high, reference, relative, terms, worst)

    def term_residuals(self, at: RowsAtPoint) -> Vector:
        """Return the least tolerance at which each row passes test 2; ∞ passes at none."""
        violation = at.violation
        is_open = ~(violation <= np.maximum(NEGLIGIBLE * at.terms, self.least_violation))
        if not self.anywhere(is_open):
            return np.zeros(violation.shape)
        demand = self.demand
        least = (violation / at.terms) ** (1.0 / ROW_POWER)
        of_demand = np.where(demand > 0.0, (violation / demand) ** (1.0 / DEMAND_POWER), 0.0)
        least = np.where(is_open, np.maximum(least, of_demand), 0.0)
        return np.where(np.isfinite(least), least, np.inf)

    def rounding_floor(self, terms: Vector, scale: Vector | None = None) -> Any:
        """Return the rounding level of each residual: k_i ε T_i / d_i with k_i = nonzeros of row i + 2."""
        rounding = (self._counts + 2) * (EPSILON * terms + TINY)
        return rounding / (self.scale if scale is None else scale)


def matvec(M: AnyMatrix, x: Vector) -> Vector:
    """Return M x for one problem, or for each problem of a stack, which may share one M."""
    if x.ndim == 1:
        product: Vector = M @ x
    elif M.ndim == 2:
        product = (M @ x.T).T
    elif M.shape[0] == 1 < x.shape[0]:
        product = x @ M[0].T
    else:
        product = (M @ x[..., None])[..., 0]
    return product


@fact
def row_data(problem: LCP) -> RowData:
    """Return the data of one problem.

    Examples
    --------
    >>> data = row_data(LCP([[2.0, 1.0], [1.0, 2.0]], [-5.0, 1.0]))
    >>> for z in (np.array([2.5, 0.0]), np.array([2.0, 0.0])):
    ...     print(data.term_residuals(data.rows(z)).round(3))
    [0. 0.]
    [0.053 0.   ]
    >>> data.snap_to_bounds(np.array([2.5, 1e-9]), np.array([0.0, 3.5]))
    array([2.5, 0. ])
    """
    return RowData(
        problem.matrix.array,
        absolute(problem.matrix),
        problem.q,
        problem.lower,
        problem.upper,
        problem.matrix.residual_scale,
        connected_components(problem.matrix),
        problem.nearest_to_zero,
    )


@fact
def absolute(matrix: Matrix) -> Any:
    """Return |M|, stored as M is."""
    return abs(matrix.array)


def criterion_at(problem: LCP, z: Vector) -> tuple[RowData, Vector, None, Names]:
    """Return the data of the criterion, with z, no slack, and the names."""
    return row_data(problem), z, None, problem.names


def scaled_residual(problem: LCP, z: Vector, w: Vector, scale: Vector | None = None) -> Vector:
    """Return r(z), shape (n,); ∞ where w_i is not finite, because its sign is then unknown."""
    residual = row_data(problem).residual(z, w, scale)
    if not np.isfinite(w.sum()):
        residual[np.isinf(w)] = np.inf
    return residual


def measured_residual(problem: LCP, z: Vector) -> float:
    """Return ‖r(z)‖∞ as computed in double precision, without a bound of its rounding error."""
    return max_norm(scaled_residual(problem, z, problem.slack(z)))


def reference_residual(problem: LCP) -> float:
    """Return ‖r(z°)‖∞, rounded upwards."""
    return float(row_data(problem).references[1].max(initial=0.0))


def rounding_of_data(problem: LCP) -> float:
    """Return the largest residual that rounding of the largest number in q explains: 2⁻⁴⁴ max_i |q_i|/d_i.

    A quotient that overflows counts as the largest double, so that no infinite residual is explained.
    """
    sizes = np.abs(problem.q / problem.matrix.residual_scale)
    return floats.DATA_ROUNDING * min(float(sizes.max(initial=0.0)), floats.LARGEST)


def find_rounding_rows(ends: VectorEnds, floor: Vector) -> BoolVector:
    """Return the rows whose residual, within its ends, may be at most four times its rounding level."""
    return (ends[0] <= 4.0 * floor) & np.isfinite(floor + ends[1])


def divide_nonnegative(numerators: Array, denominators: Array) -> Any:
    """Return the quotients of numbers that are ≥ 0; only 0/0 and 0/x are 0, NaN stays NaN."""
    quotients = np.maximum(numerators / denominators, TINY)
    return np.where(numerators == 0.0, 0.0, quotients)


def bound_residual(data: RowData, z: Vector, tolerance: float, most: Any = INF) -> float:
    """Return an upper bound of the relative residual of z, within its bounds; ∞ if the test does not decide.

    A finite bound shows that the criterion accepts z, as :func:`bound_residuals` proves it for stacks; it takes half of
    the time. The factors .999 and 1.001 cover the rounding of the last lines. `most` bounds the reference of each row.
    If a |w_i| that counts exceeds 2⁻⁴³ T_i, which is above its rounding, half of the other limit of test 2 decides.
    """
    if not z.size:
        return INF
    origin, scale, size_of_q, at_0 = data.origin, data.scale, np.abs(data.q), data.q
    products = data.absolute.dot(np.abs(z))
    w, terms = data.M.dot(z) + data.q, products + size_of_q
    above, below = z - data.lower, data.upper - z
    # a violation that reaches a bound is at least the gap
    violation = np.abs(clip(w, -scale * below, scale * above))
    margin = 2.0 * EPSILON * (z.size + 8)
    residual = (violation + (margin * terms + SMALLEST**2) * (products > 0.0)) / scale
    nearest, farthest = np.minimum(above, below), np.maximum(above, below)
    is_free = nearest > 0.0
    if is_shifted := origin.any():
        at_0 = data.M.dot(origin) + data.q
    first = np.abs(clip(at_0 / scale, origin - data.upper, origin - data.lower))
    terms_at_0 = size_of_q
    if is_shifted:
        terms_at_0 = data.absolute.dot(np.abs(origin)) + size_of_q
        first -= (margin * terms_at_0 + SMALLEST**2) / scale
    top: Any = np.maximum.reduce if data.labels is None else data.largest
    largest, first = top(residual), top(first)
    reference = np.minimum(np.minimum(first, most), top(terms / scale * is_free))  # or less
    is_right = (residual < 0.999 * np.where(is_free, nearest, farthest)) | (farthest <= 0.0)
    allowed = NEGLIGIBLE * terms
    if np.count_nonzero(violation > 0.5 * allowed):
        demand = np.abs(at_0) - 2.0 * NEGLIGIBLE * terms_at_0
        wider = np.minimum(tolerance**ROW_POWER * terms, tolerance**DEMAND_POWER * demand)
        allowed = np.maximum(allowed, wider)
    is_right &= violation <= 0.5 * allowed
    if not (first > 0.0).all():
        is_right &= (first > 0.0) | (top(np.abs(z - origin)) == 0.0)
    if not np.logical_and.reduce(is_right & (1.001 * largest <= 0.5 * tolerance * reference)):
        return INF
    return float((1.001 * largest / np.maximum(reference, NORMAL)).max(initial=0.0))


@kernel
def bound_residuals(M, q, lower, upper, start, tolerance, rows, z, residual):  # type: ignore[no-untyped-def]
    """Write upper bounds of the relative residuals of points that the stopping criterion accepts; ∞ if in doubt.

    z is moved into the bounds; noise near a bound is set to it if that helps. NaN stays. `start` is z°. The test
    implies the criterion, because

    - the maxima over the rows of a component are its ‖r‖∞ and its reference;
    - the computed w, T and w(z°) are within `rounding`, which is at least twice the criterion's own bound, so that
      their values by another order of summation stay within the limits here;
    - −w_i/d_i does not reach a bound, rounding included, so that the criterion does not move z;
    - ‖r‖∞ with rounding is at most half of the tolerance times `limit`, and `limit` is below the reference;
    - each |w_i| that counts, at least v_i, is at most 2⁻⁴³ T_i, half of what test 2 allows at any tolerance.
    """
    n = q.shape[1]
    moved, label, first, counts, high, away = rows[0], rows[1], rows[2], rows[3], rows[4], rows[5]
    margin = 4.0 * (n + 8)
    for k in range(q.shape[0]):
        m, residual[k], size, shift = k % M.shape[0], INF, 0.0, 0.0
        for i in range(n):
            size = max(size, abs(z[k, i]))
            shift = max(shift, abs(start[k, i]))
        if k < M.shape[0]:
            # A component has the number of its first row; rows of `number + n` are not searched yet
            for i in range(n):
                label[i] = -1.0
            for number in range(n):
                has_grown = label[number] < 0.0
                if has_grown:
                    label[number] = number + n
                while has_grown:
                    has_grown = False
                    for i in range(n):
                        if label[i] == number + n:
                            label[i] = number
                            for j in range(n):
                                if label[j] < 0.0 and (M[m, i, j] != 0.0 or M[m, j, i] != 0.0):
                                    label[j] = number + n
                                    has_grown = True
        for attempt in range(2):
            for i in range(n):
                x = 0.0 if abs(z[k, i]) <= SMALLEST * min(size, 1.0) else z[k, i]
                if x - lower[k, i] <= attempt * SET_TO_BOUND * size:
                    x = lower[k, i]
                elif upper[k, i] - x <= attempt * SET_TO_BOUND * size:
                    x = upper[k, i]
                moved[i], first[i], counts[i], high[i], away[i] = x, 0.0, 0.0, 0.0, 0.0
            is_right, largest_relative = True, 0.0
            for i in range(n):
                c, w, w0, largest = int(label[i]), q[k, i], q[k, i], 0.0
                terms, terms0 = abs(w), abs(w)
                for j in range(n):
                    product = M[m, i, j] * moved[j]
                    w += product
                    terms += abs(product)
                    largest = max(largest, abs(M[m, i, j]))
                if shift > 0.0:
                    for j in range(n):
                        product = M[m, i, j] * start[k, j]
                        w0 += product
                        terms0 += abs(product)
                d = M[m, i, i]
                if d < NEGLIGIBLE_DIAGONAL * largest or not d > 0.0:
                    d = largest if largest > 0.0 else 1.0
                rounding = margin * (EPSILON * terms + 2.0**-1000) if terms > abs(q[k, i]) else 0.0
                rounding0 = margin * (EPSILON * terms0 + 2.0**-1000) if shift > 0.0 else 0.0
                above, below = moved[i] - lower[k, i], upper[k, i] - moved[i]
                up, down = w if above > 0.0 else -INF, -w if below > 0.0 else -INF
                wrong = max(up, down, 0.0)
                r = max(min(up, d * above), min(down, d * below), 0.0)
                high[c] = max(high[c], (r + rounding) / d)
                if wrong > 0.0 or min(above, below) > 0.0:
                    counts[c] = max(counts[c], terms / d)
                is_right &= (
                    wrong <= 2.0**-43 * terms < INF
                    and (down + rounding < d * below * (1.0 - 1e-9) or below == 0.0)
                    and (up + rounding < d * above * (1.0 - 1e-9) or above == 0.0)
                )
                below, above = upper[k, i] - start[k, i], start[k, i] - lower[k, i]
                first[c] = max(first[c], abs(min(max(w0 / d, -below), above)) - rounding0 / d)
                away[c] = max(away[c], abs(start[k, i] - moved[i]))
            for c in range(n):
                limit = min(first[c], counts[c]) * (1.0 - margin * EPSILON)
                is_right &= high[c] <= 0.5 * tolerance * limit
                is_right &= first[c] > 0.0 or away[c] == 0.0
                if is_right and high[c] > 0.0:
                    largest_relative = max(largest_relative, high[c] / limit)
            if is_right or attempt == 0:
                for i in range(n):
                    z[k, i] = moved[i]
            if is_right:
                residual[k] = largest_relative
                break
