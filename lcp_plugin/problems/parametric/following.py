"""Following the solution of a parametric complementarity problem from breakpoint to breakpoint.

Between two breakpoints each row stays on its step: z of the free rows solves M_FF z_F = …, affine in t. When the first
row reaches the end of its step, the row changes to the next step, and a new system is factorized. If several rows
reach an end at the same t, the fastest row changes first, and the other rows follow at the same t.

If M_FF is singular, z moves by the least change that satisfies the rows. If the rows are inconsistent, if the path
would turn back, or if rounding error decides which row changes, the path is lost, and is started again just beyond
this point.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.linalg import lapack

from ...core.checks import FloatVector
from ...core.matrix.structure import IntVector
from .monotone_graphs import MonotoneGraphs

Change = tuple[int, int]  # a row, and +1 for the next step or −1 for the step before

ROUNDING = 1e-12  # error of a z or a w relative to its terms; smaller rates count as 0
MOST_CONDITION = 1e13  # of a regular block
SINGULAR = 1e-12  # singular values relative to the largest
CONSISTENT = 1e-9  # of the terms of a free row: largest residual of a singular system
MISSED = 1e3  # times ROUNDING: largest violation of its step by a row at the start
LOST = 1e5  # times ROUNDING: largest violation of its step by a row on a path
AT_GOAL = 1e-10  # of the way: a breakpoint so near the last value is none
SHORT = 1e-14  # of the way: a piece of rounding alone, which the next one takes in
AT_ONE_PLACE = 2  # changes per row without moving on, and 100 besides, after which a path is lost
MOST_CHANGES = 200  # per row, and 10 000 besides


@dataclass(frozen=True, eq=False)
class Segment:
    """Affine segment of the path, z = z[0] + (t − begin) z[1] for begin ≤ t ≤ end."""

    begin: float
    end: float
    z: FloatVector
    steps: IntVector


class Motion(NamedTuple):
    """Values and rates of rows on given steps, shape (2, n), and their errors, shape (n,).

    Attributes
    ----------
    z : ndarray
    low, high : ndarray
        Distances from the lower and the upper limits of the steps: of z on free rows, of −w on other rows.
    blur, slow : ndarray, shape (n,)
        Rounding errors of distances and of rates.
    """

    z: FloatVector
    low: FloatVector
    high: FloatVector
    blur: FloatVector
    slow: FloatVector

    @property
    def outside(self) -> FloatVector:
        """Violation of its step by each row, relative to the rounding error, shape (n,)."""
        off: FloatVector = np.maximum(-self.low[0], -self.high[0]) / self.blur
        return off

    def first_end(self, sign: float = 1.0) -> tuple[float, Change | None]:
        """Return the distance to the first end of a step, and the row that changes."""
        reached, found = np.inf, []
        for gap, way in ((self.low, -1), (self.high, 1)):
            rate = sign * gap[1]
            moving = np.flatnonzero(rate < -self.slow)
            speed = -rate[moving]
            ahead = np.maximum(gap[0, moving], 0.0) / speed
            reached = min(reached, float((ahead + self.blur[moving] / speed).min(initial=np.inf)))
            found.append((moving, ahead, speed, way))
        if reached == np.inf:
            return np.inf, None
        least = min(float(ahead.min(initial=np.inf)) for _, ahead, _, _ in found)
        best, fastest = None, 0.0
        for moving, ahead, speed, way in found:
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

    def __init__(self, problem: MonotoneGraphs, t: float, z: FloatVector, w: FloatVector) -> None:
        self.problem, self.t, self.begin, self.n = problem, t, t, problem.n
        self.steps = problem.steps_of(t, z, w)
        self._columns: dict[int, FloatVector] = {}
        motion = self._settle(z)
        is_off = motion is None or bool((motion.outside > MISSED).any())
        self.motion = None if is_off else motion

    def lines(self, stop: float) -> Iterator[Segment]:
        """Yield the lines up to stop, or to where the path is lost."""
        begin, stuck, changed = self.begin, 0, None
        for _ in range(MOST_CHANGES * self.n + 10_000):
            motion = self.motion
            if motion is None or (motion.outside > LOST).any():
                return
            if changed is not None:
                row, way = changed
                back = (motion.low if way > 0 else motion.high)[1, row]
                if back < -motion.slow[row]:  # the path turns
                    return
            length, changed = motion.first_end()
            is_last = changed is None or length >= stop - self.t - AT_GOAL * stop
            end = stop if is_last else self.t + length
            if end - begin > SHORT * stop or is_last:
                rate = motion.z[1]
                yield Segment(
                    begin,
                    end,
                    np.array([motion.z[0] + (begin - self.t) * rate, rate]),
                    self.steps.copy(),
                )
                begin = end
            if is_last or changed is None:
                return
            stuck = stuck + 1 if length <= ROUNDING * stop else 0
            if stuck > AT_ONE_PLACE * self.n + 100:
                return
            self.t, (row, way) = end, changed
            self.steps[row] += way
            self.motion = self._settle(motion.z[0] + length * motion.z[1])

    def _block(self, rows: IntVector) -> FloatVector:
        """Return the columns of M that belong to some rows, shape (k, n)."""
        if new := [int(j) for j in rows if int(j) not in self._columns]:
            self._columns.update(zip(new, self.problem.columns.many(new), strict=True))
        return np.array([self._columns[int(j)] for j in rows]).reshape(rows.size, self.n)

    def _settle(self, near: FloatVector) -> Motion | None:
        """Return the motion of the steps through a point near `near`; None if infeasible."""
        q, corners, levels = self.problem.at(self.t)
        every, sizes, k = np.arange(self.n), self.problem.columns.sizes, self.steps // 2
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


def _solve_block(
    block: FloatVector, right: FloatVector, sizes: FloatVector, near: FloatVector
) -> FloatVector | None:
    """Return values and rates of block · z = right, shape (2, k); None if no z is a solution.

    If the block is singular, the values are the solution nearest to a point, the rates the least.
    """
    factor, pivots, info = lapack.dgetrf(np.ascontiguousarray(block))
    norm = float(np.abs(block).sum(axis=0).max())
    if not info and norm > 0.0 and lapack.dgecon(factor, norm)[0] * MOST_CONDITION > 1.0:
        solution, _ = lapack.dgetrs(factor, pivots, right.T)
        for _ in range(2):
            solution = solution + lapack.dgetrs(factor, pivots, right.T - block @ solution)[0]
        return np.asarray(solution.T)
    root = np.sqrt(sizes)
    scaled = block / root / root[:, np.newaxis]
    there = np.array([near, np.zeros_like(near)])
    missing = (right - there @ block.T) / root
    found = there + np.linalg.lstsq(scaled, missing.T, rcond=SINGULAR)[0].T / root
    terms = np.abs(right) + sizes * np.abs(found).sum(axis=1, keepdims=True)
    left = np.abs(right - found @ block.T)
    return found if (left <= CONSISTENT * terms).all() else None
