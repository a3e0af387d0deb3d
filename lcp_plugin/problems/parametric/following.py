"""Following the solution of a parametric complementarity problem from breakpoint to breakpoint.

Between two breakpoints each row stays on its step: z of the free rows solves M_FF z_F = …, affine in t. Where the first
row comes to the end of its step it changes to the next one, F by that row, the inverse of M_FF by a matrix of rank one.
Which way t goes on is the way in which the row moves into its new step: always forward where M is monotone, back where
a solution of another M turns.

Where the new M_FF is singular, the solution at this t is a segment: the null vector leads along it at constant t to
where another row changes, as a pivot of the simplex method does. Where nothing changes for ever the path ends.

Of rows that come to their ends at once that one changes which moves fastest; the others follow at the same t. Should
they change in a circle, or rounding decide, the path is lost, and is begun again by a solve just beyond.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from enum import Enum

import numpy as np

from ...core.checks import FloatVector
from ...core.matrix.structure import IntVector
from .free_block import FreeBlock
from .staircases import Staircases

Pair = tuple[FloatVector, FloatVector]
Change = tuple[int, int]  # a row, and whether it goes to the next step or to the one before

ROUNDING = 1e-12  # of a z or a w beside its terms, of which a rate below is 0
RIGHT = 1e3  # times that: what a start may be off its step
NOISE = 1e-13  # of the largest z: what may be left of one that is 0; and of the terms of a row that it stands in
PARKED = 1e-10  # of its terms: the w of a row without bounds that rests
NULL = 1e-12  # singular values, beside the largest
REFINED_TO = 1e-13  # of the terms of a free row
LOST = 1e5  # times that: what a row may be off its step on a path
AT_GOAL = 1e-10  # of the way: a breakpoint so near the last value is none
SHORT = (
    1e-14  # of the way, or of the parameter: a piece of rounding alone, which the next one takes in
)
AT_ONE_PLACE = (
    2  # changes per row without moving on, and 100 besides, after which a path is given up
)
STEPS = 200  # changes per row, and 10 000 besides, after which it is given up


class End(Enum):
    """Why a path ended."""

    STOP = "the parameter reached its last value"
    RAY = "no solution goes on from here"
    TURNED = "the solution turned back to the start"
    LOST = "rounding decides which row changes"


@dataclass(frozen=True, eq=False)
class Line:
    """One piece of the path, z = z[0] + t z[1], begin ≤ t ≤ end.

    Attributes
    ----------
    jumps : bool
        Whether the path has turned back and come by again since the line before.
    slides : bool
        Whether a segment of solutions at `begin` leads to it.
    """

    begin: float
    end: float
    z: FloatVector
    steps: IntVector
    jumps: bool = False
    slides: bool = False


class SingularError(Exception):
    """Solutions at one t are a line without end."""


class Follower:
    """A point that moves along the path of solutions.

    Parameters
    ----------
    problem : Staircases
    steps : ndarray of int, shape (n,)
        Where each row is at t; made regular first where M_FF is singular.
    t : float
    z : ndarray, shape (n,)
        The solution there.

    Raises
    ------
    SingularError
        Where the solutions at t are a line without end.
    """

    def __init__(self, problem: Staircases, steps: IntVector, t: float, z: FloatVector) -> None:
        self.problem, self.steps, self.t, self.n = problem, steps.astype(np.int64), t, problem.n
        self._every = np.arange(self.n)
        self._sizes = problem.columns.sizes
        self.at_rest = np.zeros((2, self.n))  # what q and the rows that are not free give to w
        self._lower, self._upper = np.zeros((2, 2, self.n))
        self._place(self._every)
        self.block = FreeBlock(problem.columns, np.flatnonzero(self.steps % 2))
        self._begin_at_rest()
        self.changes = 0
        self.parked: list[int] = []
        if self.block.is_singular:
            self._make_regular(z.copy())

    # --- where rows are -----------------------------------------------------------------------------------

    def _place(self, rows: IntVector) -> None:
        """Set the ends of the steps of these rows: of z on odd ones, of −w on even ones."""
        corners, levels, steps = self.problem.corners, self.problem.levels, self.steps[rows]
        k, is_free = steps // 2, steps % 2 == 1
        above = np.minimum(k + 1, corners.shape[1] - 1)
        self._lower[:, rows] = np.where(is_free, corners[:, k, rows], -levels[:, k, rows])
        self._upper[:, rows] = np.where(is_free, corners[:, above, rows], -levels[:, k + 1, rows])

    def _begin_at_rest(self) -> None:
        """Compute what q and the rows at rest give to w, from nothing."""
        fixed = np.flatnonzero(self.steps % 2 == 0)
        values = self.problem.corners[:, self.steps[fixed] // 2, fixed]
        chosen = values.any(axis=0)
        self.at_rest = self.problem.q.copy()
        if chosen.any():
            self.at_rest += values[:, chosen] @ self.problem.columns.many(fixed[chosen])

    def _rest(self, row: int, sign: float) -> None:
        value = self.problem.corners[:, self.steps[row] // 2, row]
        if value.any():
            self.at_rest += sign * np.outer(value, self.problem.columns.one(row))

    @property
    def free(self) -> IntVector:
        """The rows on odd steps."""
        return np.flatnonzero(self.steps % 2)

    def _change(self, row: int, way: int) -> bool:
        """Let a row go to its next step, forwards or backwards; return whether it is free now."""
        self.changes += 1
        was_free = self.steps[row] % 2 == 1
        if not was_free:
            self._rest(row, -1.0)
        self.steps[row] += way
        if was_free:
            self._rest(row, 1.0)
        self._place(np.array([row]))
        return not was_free

    # --- lines --------------------------------------------------------------------------------------------

    def _settle(self) -> tuple[FloatVector, FloatVector]:
        """Return z and w of the present steps, shape (2, n) each, with one correction where rounding calls for it."""
        problem, block, rows = self.problem, self.block, self.block.rows
        z = np.where(self.steps % 2 == 0, problem.corners[:, self.steps // 2, self._every], 0.0)
        if not rows.size:
            return z, self.at_rest.copy()
        level = problem.levels[:, (self.steps[rows] + 1) // 2, rows]
        known = self.at_rest[:, rows] - level
        free = -known @ block.inverse.T
        w = self.at_rest + free @ block.columns
        terms = self._sizes[rows] * np.abs(free).sum(axis=1, keepdims=True) + np.abs(known)
        for attempt in range(4):
            wrong = w[:, rows] - level
            if not (np.abs(wrong) > REFINED_TO * terms).any():
                break
            if attempt == 2 and not block.renew():
                break
            correction = -wrong @ block.inverse.T
            free += correction
            w += correction @ block.columns
        if (quiet := self._without_noise(free, known)) is not None:
            free, w = quiet, self.at_rest + quiet @ block.columns
        z[:, rows], w[:, rows] = free, level
        return z, w

    def _without_noise(self, free: FloatVector, known: FloatVector) -> FloatVector | None:
        """Return z of the free rows with rounding alone made 0; None where there is none, or a row is made of it."""
        size = np.abs(free)
        is_noise = (size > 0.0) & (size <= NOISE * size.max(axis=1, keepdims=True))
        if not is_noise.any():
            return None
        quiet, across = np.where(is_noise, 0.0, free), self.block.block.T
        terms = np.abs(known) + np.abs(quiet) @ np.abs(across)
        return quiet if (np.abs(known + quiet @ across) <= NOISE * terms).all() else None

    def _gaps(self, z: FloatVector, w: FloatVector) -> tuple[FloatVector, FloatVector]:
        """Return how far each row is from the lower and from the upper end of its step."""
        coordinate = np.where(self.steps % 2 == 1, z, -w)
        return coordinate - self._lower, self._upper - coordinate

    def _blur(self, z: FloatVector, known: FloatVector) -> FloatVector:
        """Return how far the coordinates that belong to z, shape (n,), are known."""
        size = np.abs(z[self.block.rows])
        of_w = self._sizes * size.sum() + np.abs(known)
        of_z = size.max(initial=0.0)
        return np.asarray(ROUNDING * np.where(self.steps % 2 == 1, of_z, of_w))

    def _first_end(
        self, now: Pair, rates: Pair, blur: FloatVector, slow: FloatVector
    ) -> tuple[float, Change | None]:
        """Return how far it is to the first end of a step, and which row changes there, and which way; None for ever.

        Parameters
        ----------
        now, rates : pairs of ndarray, shape (n,)
            Distances from the lower and from the upper ends, and how fast they grow.
        blur, slow : ndarray, shape (n,)
            How far distances and rates are known.
        """
        reached, found = np.inf, []
        for gap, rate, way in zip(now, rates, (-1, 1), strict=True):
            moving = np.flatnonzero(rate < -slow)
            speed = -rate[moving]
            ahead = np.maximum(gap[moving], 0.0) / speed
            reached = min(reached, float((ahead + blur[moving] / speed).min(initial=np.inf)))
            found.append((moving, ahead, speed, way))
        if reached == np.inf:
            return np.inf, None
        least = min(float(ahead.min(initial=np.inf)) for _, ahead, _, _ in found)
        best, fastest = None, 0.0
        for moving, ahead, speed, way in found:
            tied = np.where(ahead <= reached, speed, 0.0)
            if tied.size and tied.max() > fastest:
                k = int(np.argmax(tied))
                best, fastest = (int(moving[k]), way), float(tied[k])
        return least, best

    def solution(self) -> FloatVector:
        """Return z at t, shape (n,)."""
        z, _ = self._settle()
        return np.asarray(z[0] + self.t * z[1])

    def is_right(self) -> bool:
        """Return whether each row is on its step at t, up to rounding."""
        z, w = (one[0] + self.t * one[1] for one in self._settle())
        return not (self.outside(z, w) > RIGHT * self._blur_of(z, w)).any()

    def outside(self, z: FloatVector, w: FloatVector) -> FloatVector:
        """Return how far each row is off its step at t, shape (n,)."""
        now = self._coordinates(z, w)
        lower, upper = (end[0] + self.t * end[1] for end in (self._lower, self._upper))
        return np.asarray(np.maximum(lower - now, now - upper))

    # --- the path -----------------------------------------------------------------------------------------

    def lines(self, stop: float, *, is_monotone: bool) -> Iterator[Line | End]:
        """Yield the lines up to stop, and at last why there are no more.

        Parameters
        ----------
        stop : float
        is_monotone : bool
            Whether M is: then no path turns back, and where rounding says that one does it is lost.
        """
        start, furthest, forward, jumps, slides = self.t, self.t, 1.0, False, False
        stuck, budget = 0, STEPS * self.n + 10_000
        changed: Change | None = None
        while True:
            z, w = self._settle()
            gaps, slow = self._gaps(z, w), self._blur(z[1], self.at_rest[1])
            if changed is not None:
                rate = gaps[0 if changed[1] > 0 else 1][1, changed[0]]
                forward = np.sign(rate) if abs(rate) > slow[changed[0]] else forward
            at, w_at = z[0] + self.t * z[1], w[0] + self.t * w[1]
            blur = self._blur(at, self.at_rest[0] + self.t * self.at_rest[1])
            if (is_monotone and forward < 0.0) or (self.outside(at, w_at) > LOST * blur).any():
                yield End.LOST
                return
            rates = gaps[0][1] * forward, gaps[1][1] * forward
            length, change = self._first_end(
                (gaps[0][0] + self.t * gaps[0][1], gaps[1][0] + self.t * gaps[1][1]),
                rates,
                blur,
                slow,
            )
            goal = stop if forward > 0.0 else start
            beside = AT_GOAL * max(abs(goal), stop - start) if forward > 0.0 else 0.0
            is_last = change is None or length >= forward * (goal - self.t) - beside
            t = goal if is_last else self.t + forward * length
            if t - furthest > SHORT * max(abs(t), stop - start):
                yield Line(furthest, t, z, self._shown_steps(), jumps, slides and not jumps)
                furthest, jumps, slides = t, False, False
            jumps = jumps or forward < 0.0
            if is_last:
                self.t = t
                yield End.STOP if forward > 0.0 else End.TURNED
                return
            stuck = stuck + 1 if length <= ROUNDING * max(abs(t), stop - start) else 0
            if stuck > AT_ONE_PLACE * self.n + 100 or self.changes > budget:
                yield End.LOST
                return
            assert change is not None
            changed = change
            at, w_at = at + (t - self.t) * z[1], w_at + (t - self.t) * w[1]
            self.t = t
            is_free = self._change(*changed)
            if not (self.block.enter if is_free else self.block.leave)(changed[0]):
                slides = True
                try:
                    changed = self._slide(changed, at, w_at)
                except SingularError:
                    yield End.RAY
                    return

    def _coordinates(self, z: FloatVector, w: FloatVector) -> FloatVector:
        """Return z of the free rows, and −w of the others."""
        return np.where(self.steps % 2 == 1, z, -w)

    def _make_regular(self, z: FloatVector) -> None:
        """Move along the solutions at t, from z on, until the free rows determine them.

        A direction without end leads to nothing but rows without bounds: one of them stays where it is, at a corner
        that its staircase, w = 0 for any z, is given there.
        """
        problem = self.problem
        for _ in range(self.n + 1):
            rows = self.free
            columns = problem.columns.many(rows)
            basis = _null_space(columns[:, rows].T, np.sqrt(self._sizes[rows]))
            if not len(basis):
                break
            while len(basis):
                dz = np.zeros(self.n)
                dz[rows] = basis[-1]
                dw = basis[-1] @ columns
                dw[rows] = 0.0
                row = self._slid_to_an_end(z, dz, dw)
                if self.steps[row] % 2:
                    break
                place = int(np.flatnonzero(rows == row)[0])
                most = int(np.argmax(np.abs(basis[:, place])))
                if basis[most, place] == 0.0:
                    raise SingularError
                basis -= np.outer(basis[:, place] / basis[most, place], basis[most])
                basis = np.delete(basis, most, axis=0)
        self.block = FreeBlock(problem.columns, self.free)
        if self.block.is_singular:
            raise SingularError

    def _slid_to_an_end(self, z: FloatVector, dz: FloatVector, dw: FloatVector) -> int:
        """Move z in place along dz to where a row changes, and change it; return the row."""
        free = self.free
        w = (
            self.at_rest[0]
            + self.t * self.at_rest[1]
            + (z[free] @ self.problem.columns.many(free) if free.size else 0)
        )
        lower, upper = (end[0] + self.t * end[1] for end in (self._lower, self._upper))
        now, blur, slow = self._coordinates(z, w), self._blur_of(z, w), self._blur_of(dz, None)
        for sign in (1.0, -1.0):
            rate = sign * self._coordinates(dz, dw)
            length, change = self._first_end((now - lower, upper - now), (rate, -rate), blur, slow)
            if change is not None:
                z += sign * length * dz
                self._change(*change)
                return change[0]
        has_none = self.steps % 2 == 1
        has_none &= (lower == -np.inf) & (upper == np.inf)
        row = int(np.argmax(np.where(has_none, np.abs(dz), 0.0)))
        if not has_none[row] or dz[row] == 0.0:
            raise SingularError
        self._park(row, z)
        return row

    def _park(self, row: int, z: FloatVector) -> None:
        """Let a row without bounds rest where it is, as long as its w is 0 up to rounding."""
        corners, levels = self.problem.corners, self.problem.levels
        corners[:, :, row], corners[0, :, row] = 0.0, (-np.inf, z[row], np.inf)
        near = PARKED * float(
            self._sizes[row] * np.abs(z).sum() + np.abs(self.at_rest[:, row]).sum()
        )
        levels[:, :, row], levels[0, :, row] = 0.0, (np.inf, near, -near, -np.inf)
        self.parked.append(row)
        self.steps[row] = 2
        self._rest(row, 1.0)
        self._place(np.array([row]))

    def _shown_steps(self) -> IntVector:
        """Return the steps, those of rows without bounds 1."""
        steps = self.steps.copy()
        steps[self.parked] = 1
        return steps

    def _slide(self, last: Change, z: FloatVector, w: FloatVector) -> Change:
        """Move along the solutions at this t until the block of free rows is regular; return the last change.

        Parameters
        ----------
        last : (int, int)
            The change that made the block singular, which the block has not followed.
        z, w : ndarray, shape (n,)
        """
        dz, dw = self._response(*last)
        for _ in range(4 * self.n + 10):
            held = (
                self._lower[0] + self.t * self._lower[1],
                self._upper[0] + self.t * self._upper[1],
            )
            now, blur = self._coordinates(z, w), self._blur_of(z, w)
            slow = self._blur_of(dz, None)
            rate = self._coordinates(dz, dw)
            length, change = self._first_end(
                (now - held[0], held[1] - now), (rate, -rate), blur, slow
            )
            if change is None:
                raise SingularError
            z, w = z + length * dz, w + length * dw
            self._change(*change)
            self.block = FreeBlock(self.problem.columns, self.free)
            if not self.block.is_singular:
                return change
            dz, dw = self._null_direction()
            own = dz[change[0]] if self.steps[change[0]] % 2 else -dw[change[0]]
            if own * change[1] < 0.0:
                dz, dw = -dz, -dw
        raise SingularError

    def _response(self, row: int, way: int) -> Pair:
        """Return how z and w move at constant t where a row does that has changed, and its block is singular."""
        block, dz = self.block, np.zeros(self.n)
        if self.steps[row] % 2:
            column, answer = block.response(row)
            dz[block.rows], dz[row] = answer * way, way
            return dz, answer * way @ block.columns + column * way
        answer = block.inverse[:, block.place(row)] * -way
        dz[block.rows], dz[row] = answer, 0.0
        return dz, answer @ block.columns

    def _null_direction(self) -> Pair:
        """Return a z, and its M z, for which M_FF z_F is 0."""
        block, dz = self.block, np.zeros(self.n)
        size = np.sqrt(self._sizes[block.rows])
        *_, across = np.linalg.svd(block.block / size / size[:, np.newaxis])
        dz[block.rows] = across[-1] / size
        dw = dz[block.rows] @ block.columns
        dw[block.rows] = 0.0
        return dz, dw

    def _blur_of(self, z: FloatVector, w: FloatVector | None) -> FloatVector:
        size = np.abs(z)
        of_w = self._sizes * size.sum() + (0.0 if w is None else np.abs(w))
        return np.asarray(ROUNDING * np.where(self.steps % 2 == 1, size.max(initial=0.0), of_w))


def _null_space(block: FloatVector, sizes: FloatVector) -> FloatVector:
    """Return a basis of the z with M_FF z = 0, a row each, where |m_ij| is about sizes_i sizes_j."""
    if not block.size:
        return np.zeros((0, sizes.size))
    _, values, across = np.linalg.svd(block / sizes / sizes[:, np.newaxis])
    return np.asarray(across[values <= NULL * values.max(initial=0.0)] / sizes)


def follower_from(problem: Staircases, t: float, z: FloatVector, w: FloatVector) -> Follower:
    """Return a follower at the solution at t that (z, w) is near.

    Where z is not exact, or its steps were mistaken, q is changed so that the steps are right, and the way back to q is
    followed.

    Raises
    ------
    SingularError
        Where the solutions at t are a line without end, or that way ends.
    """
    follower = Follower(problem, problem.steps_of(t, z, w), t, z)
    for _ in range(3):
        found_z, found_w = (one[0] + t * one[1] for one in follower._settle())
        now = follower._coordinates(found_z, found_w)
        lower, upper = (end[0] + t * end[1] for end in (follower._lower, follower._upper))
        outside = follower.outside(found_z, found_w)
        if not (outside > RIGHT * follower._blur_of(found_z, found_w)).any():
            return follower
        wrong = outside > 0.0
        margin = np.where(wrong, np.minimum(outside, 0.5 * (upper - lower)), 0.0)
        wanted = np.where(wrong, np.clip(now, lower + margin, upper - margin), now)
        is_free, rows = follower.steps % 2 == 1, follower.free
        shift = np.where(is_free, 0.0, now - wanted)  # of w
        if rows.size:
            shift -= (wanted - now)[rows] @ problem.columns.many(rows)
        homotopy = problem.at(t).with_offsets(shift, -shift)
        parked = follower.parked
        guide = Follower(homotopy, follower.steps, 0.0, np.where(is_free, wanted, found_z))
        end = [line for line in guide.lines(1.0, is_monotone=False) if isinstance(line, End)][-1]
        if end is not End.STOP:
            raise SingularError
        for row in guide.parked:
            for mine, others in (
                (problem.corners, homotopy.corners),
                (problem.levels, homotopy.levels),
            ):
                mine[:, :, row] = others[:, :, row]
        follower = Follower(problem, guide.steps, t, found_z)
        follower.parked += [*parked, *guide.parked]
    return follower
