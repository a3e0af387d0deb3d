"""The stopping criterion of a linear complementarity problem, in the user's own scaling.

z within its bounds is SOLVED if, in each connected component P of the graph of M,

    ‖r_P(z)‖∞ ≤ max(tolerance · ref_P, absolute tolerance),  r_i = z_i − mid(lower_i, upper_i, z_i − w_i/d_i),

rounding errors included, and if every row i satisfies the componentwise test

    v_i ≤ max(2⁻⁴² T_i, min(tolerance^(3/4) T_i, tolerance^(1/4) a_i)).

- T_i = |q_i| + Σ_j |m_ij z_j|; v_i is the part of w_i with the wrong sign, |w_i| off the bounds (a row *counts* if
  z_i is strictly between its bounds or the row is violated).
- ref_P is the smaller of ‖r_P(z°)‖∞ and the largest T_k/d_k of the rows of P that count, z° the point of the bounds
  nearest to 0. So a row at a bound with a large q_i does not relax the test of other rows.
- a_i = max(|w_i(z°)|, max_j |m_ij w_j(z°)|/d_j) is the demand of row i and its neighbors. If w_j(z°) is at its rounding
  level, it counts as 0, and a_i = 0 is omitted. Terms that cancel make T_i large, but not a_i.
- The second test tolerates a row with q_i = 0 if T_i ≤ 2⁻⁴² u_i or v_i ≤ 2⁻⁵⁰ u_i, u_i = d_i min(‖z_P‖∞, T_k/d_k),
  with the largest T_k/d_k of rows that count. Such rows are at rounding level, as in the far field of
  a grid. A small row (T_i ≤ 2⁻⁴² u_i) is not tolerated if a chain of small rows leads to a small row with q_k ≠ 0, or
  with an unknown at a bound other than 0: this row sets the unit of the chain, and counts as small up to
  T_k ≤ 2⁻⁴⁰ d_k ‖z_P‖∞. Two rows of a chain share an unknown z_j ≠ 0, or one contains the unknown of the other. A v_i
  that underflow explains is also tolerated.
- A tolerated row with v_i > 2⁻⁴² T_i must also be harmless. Its error e = D⁻¹(v + |M − D| e), D = m_ii if positive,
  otherwise d_i, is carried through the tolerated rows, and through each row k with Σ_i |m_ki| e_i > 10⁻⁶ T_k. It must
  stay within 10⁻⁸ ‖z_P‖∞, in any units of the rows. If e does not settle in 50 steps (a far field, or rows in which
  |M − D| exceeds D), e solves M e = w in the rows of the tolerated unknowns and of those off their bounds.
- A row with v_i > tolerance^(1/4) a_i > 0 passes only because rounding may explain v_i. Then z passes only if it is
  near the solution of the linear system of its active rows, which is not singular, or near one that a search finds.
- Rows with |r_i| ≤ absolute tolerance are not compared with their terms.
- The conditions of a program with rows G or A (``LCP.from_qp``) also need a small duality gap: rows that are right to 8
  digits do not determine the objective if z is large.

If the active set is known, after a linear solve, the exponent 1 replaces 3/4. A run first moves each z_i to a bound
whose distance is at most the step −w_i/d_i (:meth:`RowData.snap_to_bounds`); the moved point is measured and returned.

Units of rows change neither test; units of unknowns change the first one. A residual is not an error: see
``help("lcp_plugin.proofs")``.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar, NamedTuple

import numpy as np

from ..checks import BoolVector, Vector
from ..kernels.floats import DATA_ROUNDING, EPSILON, LARGEST, NEGLIGIBLE, NORMAL, TINY
from ..lcp import LCP
from ..matrix import BLOCK, IntVector, Matrix, connected_components, fact, largest_products
from ..names import Names
from ..rounding import compensated_product
from .measured import Measured, RowResiduals

VectorEnds = tuple[Vector, Vector]  # lower and upper bounds
POWER = 0.75  # of the tolerance, next to the terms of a row; 1 where a linear solve ended the run
DEMAND_POWER = 0.25  # of the tolerance, next to the demand a_i of a row
ROUNDING = 2.0**-50  # a violation so small next to the component is rounding
GAINED = 0.1  # of the reference: a larger residual is not limited by rounding
CERTAIN = 0.99  # of the upper bound of a residual: a lower bound as large needs no sharper sums
HARMLESS, REACHED = 1e-8, 1e-6  # errors of tolerated rows, relative to ‖z_P‖; to T_k of other rows
SETTLED = 1.001  # times the errors before: a smaller rise ends the iteration for the errors
MOST_CARRIES = 50  # iterations; a far field needs one for each row, so a linear system follows
MOST_FACTORED = 2e9  # rows times the square of their band: a factorization of a second
LEADING = 2.0**-40  # of ‖z_P‖: a row with q_k ≠ 0 up to 4 small ones sets the unit of its neighbors


class RowsAtPoint(NamedTuple):
    """Values of all rows at a point z, from one pass over M.

    Attributes
    ----------
    w : array, shape (…, n)
        The slack M z + q in double precision.
    terms : array, shape (…, n)
        T = |M||z| + |q|.
    rounding : array, shape (…, n)
        A bound of the rounding error of w, for any order of summation; 0 if M z = 0 exactly.
    violation : array, shape (…, n)
        The violations v_i, as the docstring of this module defines them.
    is_active : array of bool, shape (…, n)
        The rows that count: z_i strictly between its bounds, or the row is violated.
    """

    w: Vector
    terms: Vector
    rounding: Vector
    violation: Vector
    is_active: Any


@dataclass(eq=False)
class RowData:
    """M, q, bounds, d and components of one problem or of a stack: the data of the criterion.

    A class of problems with another product or other rows replaces `anywhere`, `worst`, `largest`, `follow_chains`,
    `largest_products` or `sharp_product`.

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
    start : array, shape (n,) or (B, n), optional
        z°, if it is computed already.
    origin : object, optional
        Problem before a conversion. Its method ``rejects(z, tolerance)``, if any, has the last word; its text
        `rejection` is then the advice.
    """

    M: Any
    absolute: Any
    q: Vector
    lower: Vector
    upper: Vector
    scale: Vector
    labels: Any = None
    start: Any = None
    origin: Any = None

    matrix: ClassVar[str] = "M"  # its name in results

    def __post_init__(self) -> None:
        if self.start is None:
            self.start = np.minimum(np.maximum(0.0, self.lower), self.upper)
        self._latest: tuple[Any, ...] = ()  # whether the origin rejects that point
        # By number of the problem, rows and point of the component.
        self._refuted: dict[tuple[Any, ...], bool] = {}
        # Number of entries of each row, at most.
        is_stack = isinstance(self.M, np.ndarray)
        self._counts: Any = self.q.shape[-1] if is_stack else np.diff(self.M.indptr)

    @cached_property
    def references(self) -> VectorEnds:
        """Bounds of ‖r_P(z°)‖∞ in the component of each row; the lower one is NaN if it is infinite."""
        z = self.start
        if not self.anywhere(z != 0.0):  # w(z°) is not rounded
            least, most = map(self.largest, self.residual_ends(z, self.q))
        else:
            at = self.rows(z)
            least, most = map(self.largest, self.residual_ends(z, at.w, at.rounding))
            is_open = (least == 0.0) & (most > 0.0)  # does z° solve the component?
            if self.anywhere(is_open) and (sharp := self.sharp_product(z)) is not None:
                ends = zip(
                    map(self.largest, self.residual_ends(z, *sharp)), (least, most), strict=True
                )
                least, most = (np.where(is_open, *two) for two in ends)
        return np.where(most < np.inf, least, np.nan), most

    @cached_property
    def is_near_start(self) -> Any:
        """Mask of the rows whose component z° solves up to rounding: r_i(z°) = 0, or w_i is at rounding level.

        A narrow box makes r_i small for any w_i.
        """
        if not self.anywhere(self.start != 0.0):
            return self.references[1] == 0.0
        at = self.rows(self.start)
        size, high = np.abs(at.w) / self.scale, self.residual_ends(self.start, at.w, at.rounding)[1]
        is_rounding = find_rounding_rows((size, size), self.rounding_floor(at.terms))
        is_open = np.where((high > 0.0) & ~is_rounding, 1.0, 0.0)
        return self.largest(is_open) == 0.0

    @cached_property
    def is_at_start(self) -> Any:
        """Mask of the rows in which z° is the only point that is measured; up to rounding only if there are others."""
        return self.references[1] == 0.0 if self.labels is None else self.is_near_start

    def anywhere(self, mask: BoolVector) -> bool:
        """Return whether the mask is True in any row."""
        return bool(mask.any())

    def worst(self, values: Vector) -> Any:
        """Return the largest of the values ≥ 0 of each problem; a NaN stays."""
        return values.max(-1, initial=0.0)

    def estimate(self, z: Vector) -> float:
        """Return the relative residual of z as computed in double precision, of components that z° does not solve."""
        w = times(self.M, z) + self.q
        residual = np.where(np.isinf(w), np.inf, np.abs(self.residual(z, w)))
        if self.labels is None:
            residual = residual.max(-1, keepdims=True, initial=0.0)
        relative = divide_nonnegative(residual, self.references[1])
        return float(np.where(self.is_at_start, 0.0, relative).max(initial=0.0))

    def measure(
        self, z: Vector, tolerance: float, power: float = POWER, absolute: float = 0.0
    ) -> Measured:
        """Move z to near bounds, and measure the moved point; its residual is of components that z° does not solve.

        Parameters and result as of :meth:`measure_at`.
        """
        found = self.measure_at(*self.snap(z), tolerance, power, absolute)
        if not found.passes.all():
            found = found._replace(is_limited=self.are_limited(found, tolerance))
        if self.labels is None:
            return found
        relative = np.where(self.is_at_start, 0.0, found.by_row.relative)
        return found._replace(residual=self.worst(relative))

    def measure_at(
        self, z: Vector, w: Any, tolerance: float, power: float = POWER, absolute: float = 0.0
    ) -> Measured:
        """Measure z by the stopping criterion.

        Parameters
        ----------
        z : array, shape (…, n)
        w : array, shape (…, n), or None
            The slack of z if it is known.
        tolerance, absolute : float
        power : float
            Exponent of the tolerance next to T_i.

        Returns
        -------
        Measured
            The relative residual and whether the point is SOLVED, shape (…).
        """
        at = self.rows(z, w)
        found = self.residuals_at(z, at, tolerance, power, absolute)
        passes = np.less_equal(found.worst, tolerance)
        passes = passes & np.less_equal(self.worst(found.terms), tolerance)
        passes &= ~self.are_refuted(z, at, tolerance, passes, ~(found.high <= absolute))
        return Measured(z, found.worst, passes, rows=at, by_row=found)

    def are_limited(self, found: Measured, tolerance: float) -> Any:
        """Return whether points fail in rows whose residuals rounding explains, and in no others: PRECISION_LIMIT."""
        rows = found.by_row
        fails = rows.fails(tolerance)
        is_rounding = find_rounding_rows(rows[:2], self.rounding_floor(found.rows.terms))
        is_rounding &= (rows.relative <= GAINED) | self.is_near_start
        is_limited = np.not_equal(self.worst(fails), 0.0)
        is_limited &= np.equal(self.worst(fails & ~is_rounding), 0.0)
        is_rejected = self.anywhere(is_limited) and self.is_rejected(found.z, tolerance)
        return is_limited & (not is_rejected)

    def residuals_at(
        self,
        z: Vector,
        at: RowsAtPoint,
        tolerance: float,
        power: float = POWER,
        absolute: float = 0.0,
    ) -> RowResiduals:
        """Return the residuals of all rows; by sums in twice the precision if rounding decides at the tolerance."""
        # The largest T_k/d_k of the rows that count in the component, rounding included
        may_be_active = at.is_active | ((np.abs(at.w) <= at.rounding) & (self.lower < self.upper))
        rounding = 1.0 - (self._counts + 8) * EPSILON
        of_active = np.where(may_be_active, at.terms / self.scale * rounding, 0.0)
        reference = np.minimum(self.references[0], self.largest(of_active))
        low, high = self.residual_ends(z, at.w, at.rounding)
        relative = divide_nonnegative(high, reference)
        worst = self.worst(relative)
        if np.size(worst) == 1 and not worst <= tolerance:
            is_certain = self.worst(divide_nonnegative(low, reference)) >= CERTAIN * worst
            if not is_certain and (sharp := self.sharp_product(z)) is not None:
                low, high = self.residual_ends(z, *sharp)
                relative = divide_nonnegative(high, reference)
                worst = self.worst(relative)
        if absolute:
            relative = np.where(high <= absolute, 0.0, relative)
            worst = self.worst(relative)
        is_near = np.less_equal(worst, tolerance).any()
        terms = self.term_residuals(z, at, power, tolerance if is_near else -1.0)
        if absolute:
            terms = np.where(high <= absolute, 0.0, terms)
        return RowResiduals(low, high, reference, relative, terms, worst)

    def sharp_product(self, z: Vector) -> VectorEnds | None:
        """Return M z + q by sums in twice the precision, and bounds of their errors; None for several problems."""
        if z.size > z.shape[-1]:
            return None
        from scipy.sparse import csr_array

        M = csr_array(self.M[0] if self.M.ndim > 2 else self.M)
        q = np.ascontiguousarray(np.broadcast_to(self.q, z.shape)).ravel()
        w, radius = compensated_product(M, np.ascontiguousarray(z).ravel(), q)
        return w.reshape(z.shape), radius.reshape(z.shape)

    def rows(self, z: Vector, w: Any = None) -> RowsAtPoint:
        """Return the values of all rows at z, with its slack w if that is known."""
        w = times(self.M, z) + self.q if w is None else w
        products = times(self.absolute, np.abs(z))
        terms = products + np.abs(self.q)
        bound = (self._counts + 6) * (EPSILON * terms + TINY)
        rounding = np.where(products > 0.0, bound, 0.0)  # NaN stays
        is_above, is_below = z > self.lower, z < self.upper
        violation = np.maximum(w * is_above, -w * is_below)
        is_active = (violation > 0.0) | (is_above & is_below)
        return RowsAtPoint(w, terms, rounding, violation, is_active)

    def largest(self, values: Vector) -> Any:
        """Return the largest of the values ≥ 0 in the component of each row; shape (…, 1) if there is one.

        A NaN stays.
        """
        if self.labels is None:
            return values.max(-1, keepdims=True, initial=0.0)
        found = np.zeros(int(self.labels.max(initial=-1)) + 1)
        np.maximum.at(found, self.labels, values)
        return found[self.labels]

    def residual(self, z: Vector, w: Vector, scale: Vector | None = None) -> Vector:
        """Return r(z), by mid(z − upper, z − lower, w/d): a small step is not lost next to a large z.

        Intermediate arrays are so short that they stay in the cache.
        """
        residual, scale = np.empty(w.shape), self.scale if scale is None else scale
        for first in range(0, w.shape[-1], BLOCK):
            part = (..., slice(first, first + BLOCK))
            step = np.divide(w[part], scale[part], out=residual[part])
            if not step.all():  # perhaps a quotient underflows
                is_lost = (step == 0.0) & (w[part] != 0.0)
                step[is_lost] = np.copysign(TINY, w[part][is_lost])
            np.maximum(step, z[part] - self.upper[part], out=step)
            np.minimum(step, z[part] - self.lower[part], out=step)
        return residual

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

    @cached_property
    def demand(self) -> Vector:
        """Demand of each row: a_i in the docstring of this module."""
        at = self.rows(self.start)
        w = np.abs(at.w)
        w = np.where(w > NEGLIGIBLE * at.terms, w, 0.0)
        return np.maximum(w, self.largest_products(w / self.scale))

    def largest_products(self, x: Vector) -> Vector:
        """Return max_j |m_ij| x_j of each row, x ≥ 0."""
        return largest_products(self.absolute, x)

    def term_residuals(
        self, z: Vector, at: RowsAtPoint, power: float = POWER, goal: float = np.inf
    ) -> Vector:
        """Return the least tolerance at which each row passes the componentwise test; ∞ and NaN pass at none.

        Parameters
        ----------
        z : array, shape (…, n)
        at : RowsAtPoint
            The rows at z.
        power : float
            Exponent of the tolerance next to T_i.
        goal : float
            The errors of tolerated rows are looked at only if the other rows pass at this tolerance.
        """
        violation = at.violation
        is_open = ~(violation <= NEGLIGIBLE * at.terms) | ~np.isfinite(at.terms)
        if not self.anywhere(is_open):
            return np.zeros(z.shape)
        is_open &= ~(violation <= self.underflow(z))
        demand = self.demand
        least = (violation / at.terms) ** (1.0 / power)
        of_demand = np.where(demand > 0.0, (violation / demand) ** (1.0 / DEMAND_POWER), 0.0)
        least = np.where(is_open, np.maximum(least, of_demand), 0.0)
        least = np.where(np.isfinite(least), least, np.inf)
        is_excused = is_open & self._is_excused(z, at)
        found = np.where(is_excused, 0.0, least)
        if self.anywhere(is_excused) and np.any(self.worst(found) <= goal):
            found = np.where(is_excused & self._is_harmful(z, at, is_excused), least, found)
        return found

    def are_refuted(
        self, z: Vector, at: RowsAtPoint, tolerance: float, passes: Any, is_open: Any = True
    ) -> Any:
        """Return a mask of the problems that pass only by the rounding level of a row, but not near a solution.

        It is also True if the problem's origin rejects z. Rows count where `is_open`: not within an absolute tolerance.
        """
        if not np.count_nonzero(passes):
            return np.False_
        if self.origin is not None and self.is_rejected(z, tolerance):
            return np.True_
        is_doubtful = at.violation > NEGLIGIBLE * np.abs(self.q)  # |q_i| is part of a_i, if z° = 0
        if not self.anywhere(is_doubtful | (self.start != 0.0)):
            return np.False_
        demand = self.demand
        is_doubtful = (at.violation > tolerance**DEMAND_POWER * demand) & (demand > 0.0) & is_open
        if not self.anywhere(is_doubtful):
            return np.False_
        found = np.array(passes & is_doubtful.any(-1))
        for k in map(tuple, np.argwhere(found).tolist()):
            labels: Any = np.zeros(z.shape[-1], int)
            if self.labels is not None:
                labels = np.broadcast_to(self.labels, self.q.shape)[k]
            parts = (np.flatnonzero(labels == one) for one in np.unique(labels[is_doubtful[k]]))
            found[k] = any(self.is_wrong(k, z[k], rows) for rows in parts)
        return found

    def is_rejected(self, z: Vector, tolerance: float) -> bool:
        """Return whether the problem's origin rejects z, as a program does if the duality gap is large."""
        rejects = getattr(self.origin, "rejects", None)
        if rejects is None:
            return False
        if self._latest[:2] != (key := (tolerance, z.tobytes())):
            self._latest = *key, bool(rejects(z, tolerance))
        return bool(self._latest[2])

    def is_wrong(self, k: tuple[int, ...], z: Vector, rows: IntVector) -> bool:
        """Return whether neither a linear solve nor a search finds a solution near z in these rows of problem k."""
        from ...methods.search import is_near_solution
        from ...proofs.no_solution import has_solution_near

        whole = self.q.shape
        M = self.M[min(*k, len(self.M) - 1)] if self.M.ndim > 2 else self.M
        q, lower, upper = (
            np.broadcast_to(one, whole)[k][rows] for one in (self.q, self.lower, self.upper)
        )
        part = LCP(M[rows][:, rows], q, lower=lower, upper=upper)
        key = (*k, rows.tobytes(), z[rows].tobytes())
        if key not in self._refuted:
            is_near = has_solution_near(part, z[rows])
            self._refuted[key] = not (is_near or is_near_solution(part, z[rows]))
        return self._refuted[key]

    def _is_excused(self, z: Vector, at: RowsAtPoint) -> Any:
        """Return the rows with q_i = 0 that are at the rounding level of their component, bool."""
        is_candidate = self.q == 0.0
        if not self.anywhere(is_candidate):
            return is_candidate
        of_z = self.scale * self.largest(np.abs(z))
        of_active = self.scale * self.largest(np.where(at.is_active, at.terms / self.scale, 0.0))
        unit = np.minimum(of_z, of_active)
        is_small = at.terms <= NEGLIGIBLE * unit
        is_at_bound = (z != 0.0) & ((z == self.lower) | (z == self.upper))
        has_unit = ~is_candidate | is_at_bound | (times(self.absolute, is_at_bound) > 0.0)
        leads = has_unit & (is_small | (at.terms <= LEADING * of_z))
        is_led = self.follow_chains(leads, is_small, z)
        return is_candidate & ~is_led & (is_small | (at.violation <= ROUNDING * unit))

    def _is_harmful(self, z: Vector, at: RowsAtPoint, is_open: BoolVector) -> Any:
        """Return the rows of the components in which errors of the open rows are not harmless, bool."""
        size = np.abs(self.diagonal)
        d = np.where(self.diagonal > 0.0, self.diagonal, self.scale)
        limit, errors = HARMLESS * self.largest(np.abs(z)), np.zeros(z.shape)
        is_carrier, is_harmful = is_open, np.zeros(z.shape, bool)
        for _ in range(MOST_CARRIES):
            carried = np.maximum(times(self.absolute, errors) - size * errors, 0.0)
            is_carrier = (is_carrier | (carried > REACHED * at.terms)) & ~is_harmful
            after = np.where(is_carrier, (at.violation + carried) / d, 0.0)
            is_harmful |= self.largest((is_carrier & ~(after <= limit)) * 1.0) > 0.0
            after = np.where(is_harmful, 0.0, after)
            is_rising, errors = after > SETTLED * errors, after
            if not self.anywhere(is_rising):
                return is_harmful
        errors = self.carried_errors(z, np.where(is_open & ~is_harmful, at.w, 0.0))
        return is_harmful | (self.largest(~(errors <= limit) * 1.0) > 0.0)

    def carried_errors(self, z: Vector, w: Vector) -> Vector:
        """Return |e| with M e = w in the rows with w_i ≠ 0 or z_i off its bounds, e_i = 0 elsewhere.

        ∞ if this system is singular, or too large for a factorization.
        """
        from scipy.sparse import csc_array, diags_array
        from scipy.sparse.linalg import splu

        is_free = ((self.lower < z) & (z < self.upper)) | (w != 0.0)
        e: Any
        M, on, off = self.M, is_free * 1.0, ~is_free * 1.0
        try:
            if isinstance(M, np.ndarray):
                M = np.where(is_free[..., None] & is_free[..., None, :], M, 0.0)
                e = np.linalg.solve(M + np.eye(w.shape[-1]) * off[..., None], w[..., None])[..., 0]
            else:
                i, j = M.nonzero()
                if not w.shape[-1] * float(np.abs(i - j).max(initial=0)) ** 2 <= MOST_FACTORED:
                    return np.full(w.shape, np.inf)
                e = np.empty(w.shape)
                for k in np.ndindex(w.shape[:-1]):
                    part = diags_array(on[k]) @ M @ diags_array(on[k]) + diags_array(off[k])
                    e[k] = splu(csc_array(part)).solve(w[k])
        except (np.linalg.LinAlgError, RuntimeError):  # singular
            return np.full(w.shape, np.inf)
        return np.abs(e)

    @cached_property
    def diagonal(self) -> Vector:
        """The diagonal of M, shape (…, n)."""
        is_stack = isinstance(self.M, np.ndarray)
        return np.diagonal(self.M, axis1=-2, axis2=-1) if is_stack else self.M.diagonal()

    def follow_chains(self, is_led: Any, is_small: Any, z: Vector) -> Any:
        """Return the small rows to which a chain of small rows leads from the rows `is_led`, bool."""
        if not is_led.any():
            return is_led
        is_dense = isinstance(self.absolute, np.ndarray)
        by_columns = self.absolute.swapaxes(-1, -2) if is_dense else self.absolute.T
        while True:
            is_shared = (is_led | (times(by_columns, is_led) > 0.0)) & (z != 0.0)
            after = is_led | (is_small & (times(self.absolute, is_shared) > 0.0))
            if (after == is_led).all():
                return is_led
            is_led = after

    def rounding_floor(self, terms: Vector, scale: Vector | None = None) -> Any:
        """Return the rounding level of each residual: k_i ε T_i / d_i with k_i = nonzeros of row i + 2."""
        rounding = (self._counts + 2) * (EPSILON * terms + TINY)
        return rounding / (self.scale if scale is None else scale)

    def underflow(self, z: Vector) -> Any:
        """Return the part of each w_i that underflow explains: a subnormal z_j cannot be more accurate."""
        grid = np.where((z != 0.0) & (np.abs(z) < NORMAL), TINY, 0.0)
        if not self.anywhere(grid > 0.0):
            return 0.0
        return times(self.absolute, grid) + (self._counts + 2) * TINY

    def snap(self, z: Vector) -> tuple[Vector, Vector | None]:
        """Return z, moved to near bounds, or to z° in components that it solves; and its slack if it did not move."""
        z = np.where(self.is_at_start, self.start, z)
        w = times(self.M, z) + self.q
        moved = self.snap_to_bounds(z, w)
        return moved, None if self.anywhere(moved != z) else w

    def snap_to_bounds(self, z: Vector, w: Vector) -> Vector:
        """Return z with z_i projected onto a bound whose distance is at most the step −w_i/d_i."""
        step = w / self.scale
        moved = np.where(-step >= self.upper - z, self.upper, z)
        return np.where(step >= z - self.lower, self.lower, moved)


def times(M: Any, x: Vector) -> Vector:
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
    ...     print(data.term_residuals(z, data.rows(z)).round(3))
    [0. 0.]
    [0.053 0.   ]
    >>> data.snap_to_bounds(np.array([2.5, 1e-9]), np.array([0.0, 3.5]))
    array([2.5, 0. ])
    """
    several = connected_components(problem.matrix)
    return RowData(
        problem.matrix.array,
        absolute(problem.matrix),
        problem.q,
        problem.lower,
        problem.upper,
        problem.matrix.residual_scale,
        None if several is None else several.labels,
        problem.nearest_to_zero,
        problem.origin,
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
    return float(np.abs(scaled_residual(problem, z, problem.slack(z))).max(initial=0.0))


def reference_residual(problem: LCP) -> float:
    """Return ‖r(z°)‖∞, rounded upwards."""
    return float(row_data(problem).references[1].max(initial=0.0))


def rounding_of_data(problem: LCP) -> float:
    """Return the largest residual that rounding of the largest number in q explains: 2⁻⁴⁴ max_i |q_i|/d_i.

    A quotient that overflows counts as the largest double, so that no infinite residual is explained.
    """
    sizes = np.abs(problem.q / problem.matrix.residual_scale)
    return DATA_ROUNDING * min(float(sizes.max(initial=0.0)), LARGEST)


def find_rounding_rows(ends: VectorEnds, floor: Vector) -> BoolVector:
    """Return the rows whose residual, within its ends, may be at most four times its rounding level."""
    return (ends[0] <= 4.0 * floor) & np.isfinite(floor + ends[1])


def divide_nonnegative(numerators: Any, denominators: Any) -> Any:
    """Return the quotients of numbers that are ≥ 0; only 0/0 and 0/x are 0, NaN stays NaN."""
    quotients = np.maximum(numerators / denominators, TINY)
    return np.where(numerators == 0.0, 0.0, quotients)
