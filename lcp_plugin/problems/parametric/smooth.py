"""Following the solution of a nonlinear problem along a parameter: smooth segments between changes of the active set.

The derivative of a solution with respect to t = |θ − start| predicts the next solution, and Newton's method corrects
the prediction; their distance determines the length of the next step. If the active set changes in a step, its first
change is located by the derivative, and by bisection.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import count
from typing import Any, NamedTuple

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from ...core.checks import Vector
from ...core.errors import LCPError
from ...solving.dispatch import solve
from ..nonlinear.data import STEP
from ..sensitivity import derivative
from .following import Motion
from .path import Piece

PREDICTION = 1e-3  # largest error of a prediction, relative to 1 + ‖x‖∞
NEAR = 2.0**-30  # of the way: distance of the two solutions at a breakpoint


class Knot(NamedTuple):
    """Solution at t, its motion, and the sides of the rows: −1 at the lower bound, 1 at the upper, 0 between them.

    `behind` is the rate of x before t, which differs from the motion's if a row changes its side at t.
    """

    t: float
    motion: Motion
    sides: bytes
    behind: Vector

    def predict(self, t: float) -> Vector:
        """Return the prediction of x at another t."""
        x, rate = self.motion.z
        return np.asarray(x + (t - self.t) * rate)


@dataclass(frozen=True, eq=False)
class SmoothPiece(Piece):
    """Smooth segment of a path, of degree three between computed solutions.

    Attributes
    ----------
    curve : callable
        ``curve(t, k)``: derivative k of x with respect to t = |θ − start|.
    line : Line
    """

    curve: Any = field(default=None, repr=False)
    line: Any = field(default=None, repr=False)

    @classmethod
    def through(cls, nodes: list[Knot], line: Any, begin: float, end: float) -> SmoothPiece:
        """Return the segment through solutions, from t = begin to end."""
        x, rate = (np.array([node.motion.z[k] for node in nodes]) for k in (0, 1))
        rate[-1] = nodes[-1].behind
        curve = CubicHermiteSpline([node.t for node in nodes], x, rate)
        ends, known = (line.theta(begin), line.theta(end)), (x[0], line.toward * rate[0])
        return cls(*ends, *known, None, *known, curve=curve, line=line)

    def z_at(self, theta: float, order: int = 0) -> Vector:
        """Return x at θ, or its derivative of an order."""
        toward, start = self.line.toward, self.line.start
        return np.asarray(toward**order * self.curve(toward * (theta - start), order))


class SmoothFollower:
    """Path following that starts at a solution.

    Parameters
    ----------
    line : Line
    t : float
    x : array, shape (n,)
        A solution at t.

    Attributes
    ----------
    begin : float
        Begin of the first segment.
    motion : Motion or None
        None if x is not a solution, or has no derivative.
    """

    def __init__(self, line: Any, t: float, x: Vector) -> None:
        self.line, self.t, self.begin, self.span = line, t, t, abs(line.stop - line.start)
        self.first = self._node(t, x)
        self.motion = None if self.first is None else self.first.motion

    def lines(self, stop: float) -> Iterator[tuple[float, float, Any, None]]:
        """Yield begin, end and solutions of each segment up to stop, or to where the path is lost."""
        nodes: list[Any] = [self.first]
        longest = self.span / 32.0  # shorter changes of sides that nothing predicts may be missed
        begin, step, goal, beyond = self.begin, longest, stop, None
        while step > 2.0**-20 * self.span or nodes[-1].t == goal:
            last, error = nodes[-1], np.inf
            if last.t == goal:
                if len(nodes) > 1:
                    yield begin, goal, nodes, None
                    begin = goal
                if beyond is None:
                    return
                nodes, step, goal, beyond = [beyond], longest, stop, None
                continue
            # Just beyond a predicted change: further on, other rows may change, or this row return to its side. If
            # rounding alone makes w ≠ 0, a change is predicted at once.
            step = min(step, longest, max(1.01 * last.motion.first_end()[0], self.span / 1024.0))
            t = min(last.t + step, goal)
            node = self._node(t, guess := last.predict(t))
            if node is not None and node.sides == last.sides:
                x = node.motion.z[0]
                error = np.abs(x - guess).max() / (PREDICTION * (1.0 + np.abs(x).max()))
                nodes += [node] if error <= 1.0 else []
            elif node is not None and (change := self._first_change(last, node)) is not None:
                goal, beyond = change[0].t, change[1]
                continue
            step *= min(max(0.9 * max(error, 1e-9) ** -0.5, 0.25), 4.0)
        if len(nodes) > 1:
            yield begin, nodes[-1].t, nodes, None

    def _first_change(self, low: Knot, high: Knot) -> tuple[Knot, Knot] | None:
        """Return solutions just before and just beyond the first change of sides; None if a solution fails."""
        near, newest = NEAR * self.span, high
        for k in count():
            if high.t - low.t <= 2.0 * near:
                break
            way = 1.0 if newest is low else -1.0
            t = newest.t + way * (newest.motion.first_end(way)[0] + 0.75 * near)
            # Every fourth step halves: one row may change several times
            t = t if low.t < t < high.t and k % 4 < 3 else 0.5 * (low.t + high.t)
            if (node := self._node(t, newest.predict(t))) is None:
                return None
            newest = node
            low, high = (node, high) if node.sides == low.sides else (low, node)
        return low, high

    def _node(self, t: float, guess: Vector) -> Knot | None:
        """Return the solution at t near a guess; None if Newton's method leads to no solution with a derivative."""
        step = STEP * self.span if 2.0 * t < self.span else -STEP * self.span
        problem, other = (self.line.at(self.line.theta(place)) for place in (t, t + step))
        options = {"max_iterations": 10, "restarts": 0, "check_jacobian": False}
        try:
            result = solve(problem, x0=guess, tolerance=self.line.tolerance, **options)
            # Rows within the tolerance may be on another side of x than of the solution
            at, tangent = derivative(result), result.certificate.problem
            x, dq = at.z, (other.value(at.z) - problem.value(at.z)) / step
            bounds, moved = (np.array([place.lower, place.upper]) for place in (problem, other))
            rates = np.where(np.isfinite(bounds), (moved - bounds) / step, 0.0)
            change = np.array([dq, *rates])
            dx, back = (at.jvp(dq=a, dlower=b, dupper=c) for a, b, c in (change, -change))
        except LCPError:
            return None
        z = np.array([x, dx])
        below, above = z - [bounds[0], rates[0]], [bounds[1], rates[1]] - z
        sides = np.where(at.free, 0, np.where(above[0] < below[0], 1, -1)).astype(np.int8)
        slack = -sides * np.array([tangent.slack(x), tangent.csr @ dx + dq])
        low = np.where(sides == 0, below, slack)
        high = np.where(sides == 0, above, [[np.inf], [0.0]])
        return Knot(t, Motion(z, low, high, *np.zeros(z.shape)), sides.tobytes(), -back)
