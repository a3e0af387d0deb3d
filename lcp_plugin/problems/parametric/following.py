"""Following the solution of a parametric complementarity problem from breakpoint to breakpoint.

Between two breakpoints each row stays on its step: z of the free rows solves M_FF z_F = …, affine in t. When the first
row reaches the end of its step, the row changes to the next step, and a new system is factorized. If several rows
reach an end at the same t, the fastest row changes first, and the other rows follow at the same t.

If M_FF is singular, z moves by the least change that satisfies the rows. If the rows are inconsistent, if the path
would turn back, or if rounding error decides which row changes, the path is lost, and is started again just beyond
this point.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple, Self

import numpy as np
import scipy.sparse as sp
from scipy.linalg import lapack

from ...core.checks import AnyMatrix, Vector
from ...core.entries import IntVector, largest_in_rows, scale_matrix
from ...core.rounding import ROUNDING
from ...systems.equilibration import EQUILIBRATING_PASSES, equilibrating_exponents
from ..least_squares.data import BoundedLeastSquares

#: begin, end, z and the steps of all rows: z[0] + (t − begin) z[1] solves the problem for begin ≤ t ≤ end.
Segment = tuple[float, float, Vector, IntVector]
Change = tuple[int, int]  # a row, and +1 for the next step or −1 for the step before


@dataclass(frozen=True, eq=False)
class MonotoneGraphs:
    """Complementarity problem at parameter t, in units of its rows and unknowns: constants and slopes along axis 0.

    Let w = M z + q. The pair (z_i, w_i) of row i lies on a staircase that falls to the right: at z = p₀ any w ≥ v₁, w =
    v₁ for p₀ ≤ z ≤ p₁, at p₁ any w from v₁ down to v₂, w = v₂ for p₁ ≤ z ≤ p₂, at p₂ any w ≤ v₂. Bounds are a staircase
    with p₀ = lower, p₁ = upper, v₁ = 0. A penalty λ|z| within bounds is a staircase with p = (lower, 0, upper) and v =
    (λ, −λ). Step 2k of a staircase is its segment at z = p_k, and step 2k + 1 is its segment at w = v_{k+1}. A row is
    free on odd steps.

    Attributes
    ----------
    columns : callable
        ``columns(numbers)``: some columns of M as rows of an array, shape (k, n).
    sizes : ndarray, shape (n,)
        The largest |m_ij| of each row.
    units : ndarray, shape (n,)
        The unknowns of the caller are units · z.
    q : ndarray, shape (2, n)
    corners : ndarray, shape (2, 3, n)
        Corners p of each row; ∞ if a row has fewer corners.
    levels : ndarray, shape (2, 4, n)
        +∞, v₁, v₂, −∞ of each row; v₂ = −∞ if a row has two corners.
    """

    columns: Callable[[IntVector], Vector]
    sizes: Vector
    units: Vector
    q: Vector
    corners: Vector
    levels: Vector

    @classmethod
    def of_matrix(cls, M: AnyMatrix, q: Vector, lower: Vector, upper: Vector) -> Self:
        """Return the graphs of an LCP, M a CSR array, the vectors of shape (2, n)."""
        exponents = equilibrating_exponents(M, EQUILIBRATING_PASSES, 500)
        rows, units = (np.ldexp(1.0, part) for part in exponents)
        scaled = scale_matrix(M, exponents)
        by_columns = scaled.tocsc()

        def columns(numbers: IntVector) -> Vector:
            return np.asarray(by_columns[:, numbers].T.toarray())

        parts = q * rows, lower / units, upper / units, np.zeros_like(q)
        return cls._of_staircases(columns, largest_in_rows(scaled), units, *parts)

    @classmethod
    def of_least_squares(
        cls, problem: BoundedLeastSquares, q: Vector, lower: Vector, upper: Vector, penalty: Vector
    ) -> Self:
        """Return the graphs of the normal equations with penalty · |z|, whose matrix is not computed."""
        units = 1.0 / problem.column_scales
        A = problem.weighted_matrix * units[np.newaxis]
        A, transpose = (sp.csr_array(A), sp.csr_array(A.T)) if sp.issparse(A) else (A, A.T.copy())
        ridge = problem.ridge * units * units

        def columns(numbers: IntVector) -> Vector:
            chosen = transpose[numbers]
            made = (chosen @ A).toarray() if sp.issparse(chosen) else chosen @ A
            made[np.arange(len(numbers)), numbers] += ridge[numbers]
            return np.asarray(made)

        sizes = np.sign(largest_in_rows(transpose) + ridge)  # of columns of unit length
        parts = q * units, lower / units, upper / units, penalty * units
        return cls._of_staircases(columns, sizes, units, *parts)

    @classmethod
    def _of_staircases(cls, columns: Any, sizes: Vector, units: Vector, *vectors: Vector) -> Self:
        """Return the graphs of bounds, and of a penalty in rows whose penalty is not 0 at all t.

        The vectors are q, lower, upper and the penalty.
        """
        q, lower, upper, penalty = vectors
        has_kink, none = penalty.any(axis=0), np.array([[np.inf], [0.0]])
        top = np.broadcast_to(none, q.shape)
        corners = [lower, np.where(has_kink, 0.0, upper), np.where(has_kink, upper, none)]
        levels = [top, penalty, np.where(has_kink, -penalty, -none), -top]
        sizes = np.maximum(sizes, np.finfo(np.float64).tiny)
        return cls(columns, sizes, units, q, np.stack(corners, 1), np.stack(levels, 1))

    @property
    def n(self) -> int:
        """The number of rows."""
        return self.sizes.size

    def at(self, t: float) -> list[Vector]:
        """Return q, corners and levels as values at t and slopes."""
        parts = self.q, self.corners, self.levels
        return [np.stack([part[0] + t * part[1], part[1]]) for part in parts]

    def steps_of(self, t: float, z: Vector, w: Vector) -> IntVector:
        """Return the step of each row closest to (z, w) at t; corners are on even steps."""
        (_, corners, levels), size = self.at(t), self.sizes
        size = np.where(size > np.finfo(np.float64).tiny, size, 1.0)  # an empty row has no unit
        corners, levels, scaled = corners[0], levels[0] / size, w / size
        best, steps = np.full(self.n, np.inf), np.zeros(self.n, dtype=np.int64)
        for step in range(2 * len(corners) - 1):
            k = step // 2
            if step % 2 == 0:
                outside = np.maximum(np.maximum(levels[k + 1] - scaled, scaled - levels[k]), 0.0)
                miss = np.maximum(np.abs(z - corners[k]), outside)
            else:
                outside = np.maximum(np.maximum(corners[k] - z, z - corners[k + 1]), 0.0)
                miss = np.maximum(np.abs(scaled - levels[k + 1]), outside)
            miss = np.where(np.isfinite(miss), miss, np.inf)
            order = 1.0 if step % 2 == 0 else 1.0 + 1e-9
            is_better = order * miss < best
            steps[is_better], best[is_better] = step, miss[is_better]
        return steps


class Motion(NamedTuple):
    """Values and rates of rows on their steps, shape (2, n), and their errors, shape (n,).

    Attributes
    ----------
    z : ndarray
    low, high : ndarray
        Distances from the lower and the upper limits of the steps: of z on free rows, of −w on other rows.
    rounding, slow : ndarray, shape (n,)
        Rounding errors of distances and of rates.
    """

    z: Vector
    low: Vector
    high: Vector
    rounding: Vector
    slow: Vector

    @property
    def outside(self) -> Vector:
        """Violation of its step by each row, relative to the rounding error, shape (n,)."""
        return np.maximum(-self.low[0], -self.high[0]) / self.rounding

    def first_end(self, sign: float = 1.0) -> tuple[float, Change | None]:
        """Return the distance to the first end of a step, and the row that changes."""
        reached, candidates = np.inf, []
        for gap, way in ((self.low, -1), (self.high, 1)):
            rate = sign * gap[1]
            moving = np.flatnonzero(rate < -self.slow)
            speed = -rate[moving]
            ahead = np.maximum(gap[0, moving], 0.0) / speed
            latest = ahead + self.rounding[moving] / speed
            reached = min(reached, float(latest.min(initial=np.inf)))
            candidates.append((moving, ahead, speed, way))
        if reached == np.inf:
            return np.inf, None
        least = min(float(ahead.min(initial=np.inf)) for _, ahead, _, _ in candidates)
        best, fastest = None, 0.0
        for moving, ahead, speed, way in candidates:
            tied = np.where(ahead <= reached, speed, 0.0)
            if tied.max(initial=0.0) > fastest:
                k = int(np.argmax(tied))
                best, fastest = (int(moving[k]), way), float(tied[k])
        return least, best


class Follower:
    """Path following that starts at a solution.

    Parameters
    ----------
    problem : MonotoneGraphs
    t : float
    z, w : ndarray, shape (n,)
        A solution at t, to some accuracy.

    Attributes
    ----------
    steps : ndarray of int, shape (n,)
        Step of each row.
    begin : float
        Begin of the first segment, at most t.
    motion : Motion or None
        None if no steps near the solution are consistent.
    """

    def __init__(self, problem: MonotoneGraphs, t: float, z: Vector, w: Vector) -> None:
        self.problem, self.t, self.begin, self.n = problem, t, t, problem.n
        self.steps = problem.steps_of(t, z, w)
        self._columns: dict[int, Vector] = {}
        motion = self._settle(z)
        is_off = motion is None or bool((motion.outside > 1e3).any())
        self.motion = None if is_off else motion

    def lines(self, stop: float) -> Iterator[Segment]:
        """Yield the lines up to stop, or to where the path is lost."""
        begin, stuck, changed = self.begin, 0, None
        for _ in range(200 * self.n + 10_000):
            motion = self.motion
            if motion is None or (motion.outside > 1e5).any():  # a row violates its step
                return
            if changed is not None:
                row, way = changed
                back = (motion.low if way > 0 else motion.high)[1, row]
                if back < -motion.slow[row]:  # the path turns
                    return
            length, changed = motion.first_end()
            # A breakpoint so near the last value is none
            is_last = changed is None or length >= stop - self.t - 1e-10 * stop
            end = stop if is_last else self.t + length
            # A piece of rounding errors only, which the next piece takes in
            if end - begin > 1e-14 * stop or is_last:
                rate = motion.z[1]
                z = np.array([motion.z[0] + (begin - self.t) * rate, rate])
                yield begin, end, z, self.steps.copy()
                begin = end
            if is_last or changed is None:
                return
            stuck = stuck + 1 if length <= ROUNDING * stop else 0
            # A path is lost after so many changes without moving on
            if stuck > 2 * self.n + 100:
                return
            self.t, (row, way) = end, changed
            self.steps[row] += way
            self.motion = self._settle(motion.z[0] + length * motion.z[1])

    def _block(self, rows: IntVector) -> Vector:
        """Return the columns of M that belong to some rows, shape (k, n)."""
        if new := [int(j) for j in rows if int(j) not in self._columns]:
            self._columns.update(zip(new, self.problem.columns(np.array(new)), strict=True))
        return np.array([self._columns[int(j)] for j in rows]).reshape(rows.size, self.n)

    def _settle(self, near: Vector) -> Motion | None:
        """Return the motion of the steps through a point near `near`; None if infeasible."""
        q, corners, levels = self.problem.at(self.t)
        every, sizes, k = np.arange(self.n), self.problem.sizes, self.steps // 2
        is_free = self.steps % 2 == 1
        free = np.flatnonzero(is_free)
        z = np.where(is_free, 0.0, corners[:, k, every])
        fixed = np.flatnonzero(z.any(axis=0))
        w = q + z[:, fixed] @ self._block(fixed)
        if free.size:
            columns = self._block(free)
            level = levels[:, k[free] + 1, free]
            known = w[:, free] - level
            solution = _solve_block(columns[:, free].T, -known, sizes[free], near[free])
            if solution is None:
                return None
            z[:, free] = solution
        moving = np.flatnonzero(z.any(axis=0))
        w = q + z[:, moving] @ self._block(moving)
        above = np.minimum(k + 1, corners.shape[1] - 1)
        coordinate = np.where(is_free, z, -w)
        low = coordinate - np.where(is_free, corners[:, k, every], -levels[:, k, every])
        high = np.where(is_free, corners[:, above, every], -levels[:, k + 1, every]) - coordinate
        of_w = sizes * np.abs(z).sum(axis=1, keepdims=True) + np.abs(q)
        of_z = np.abs(z[:, is_free]).max(axis=1, initial=0.0, keepdims=True)
        known_to = ROUNDING * np.where(is_free, of_z, of_w) + np.finfo(np.float64).tiny
        return Motion(z, low, high, *known_to)


def _solve_block(block: Vector, right: Vector, sizes: Vector, near: Vector) -> Vector | None:
    """Return values and rates of block · z = right, shape (2, k); None if no z is a solution.

    If the block is singular, the values are the solution nearest to a point, the rates the least.
    """
    factor, pivots, info = lapack.dgetrf(np.ascontiguousarray(block))
    norm = float(np.abs(block).sum(axis=0).max())
    if not info and norm > 0.0 and lapack.dgecon(factor, norm)[0] * 1e13 > 1.0:
        solution, _ = lapack.dgetrs(factor, pivots, right.T)
        for _ in range(2):
            solution = solution + lapack.dgetrs(factor, pivots, right.T - block @ solution)[0]
        return np.asarray(solution.T)
    there = np.array([near, np.zeros_like(near)])
    missing = right - there @ block.T
    nearest = there + np.linalg.lstsq(block, missing.T, rcond=1e-12)[0].T
    terms = np.abs(right) + sizes * np.abs(nearest).sum(axis=1, keepdims=True)
    residual = np.abs(right - nearest @ block.T)
    return (
        nearest if (residual <= 1e-9 * terms).all() else None
    )  # largest residual of a singular system
