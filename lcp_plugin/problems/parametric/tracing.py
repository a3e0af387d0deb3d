"""trace(): the solution path along one parameter."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...core.checks import FloatVector, is_number
from ...core.deadline import Clock
from ...core.errors import InvalidOption
from .families import Family, Piece, family_of
from .following import Follower, Segment
from .monotone_graphs import MonotoneGraphs
from .path import Path

BEYOND = 1e-9, 1e-7, 1e-5, 1e-3  # of the way: distances at which a lost path is restarted
AT_END = 1e-6  # of a stretch: how much a piece may fall short of it
SAME = 1e-4  # largest change of a solution over the shortest of these distances


def trace(
    problem: Any, along: Any, start: float, stop: float, *, tolerance: float | None = None
) -> Path:
    """Return the exact piecewise affine solution for all values of θ between start and stop.

    Data(θ) = data + θ · direction. The solution is piecewise affine in θ; one linear system leads from each
    breakpoint to the next.

    Parameters
    ----------
    problem : LCP, QuadraticProgram or BoundedLeastSquares, or a problem of cvxpy
        Problem with the data at θ = 0.
    along : mapping, or a cvxpy Parameter
        The moving data, with their change per unit of θ: ``{"q": dq}`` and bounds of an LCP, c, h, b and bounds of a
        program, or b, l1 and bounds of least squares. A number moves all entries alike. For a cvxpy problem, use a
        scalar Parameter, whose value is θ, or ``{parameter: direction}``, added to its present value.
        ``path.value(x, θ)`` is then the value of a variable.
    start, stop : float
        Either may be the larger one.
    tolerance : float, optional
        As in `solve`: 1e-6 for a program, 1e-8 for others.

    Returns
    -------
    Path
        Also returned if the solution ends, or jumps, before `stop`: ``path.status`` and ``path.explain()`` report the
        place, and the proof just beyond it.

    Raises
    ------
    InvalidOption
        If other data should move, or θ is not finite.
    InvalidProblem
        If a direction has the wrong shape.
    UnsupportedModel
        If a program is not convex, or the parameter of a cvxpy problem appears in its matrices.

    Notes
    -----
    The cost is one solve at start, then one dense factorization of the unknowns off their bounds per breakpoint. The
    path may reach a singular breakpoint, or turn back if the matrix is not monotone. The problem is then solved again
    just beyond, and the new segment is extended back to the old one.

    References
    ----------
    Cottle, Pang, Stone, *The Linear Complementarity Problem*, SIAM 2009, §4.5, doi:10.1137/1.9780898719000; Efron,
    Hastie, Johnstone, Tibshirani, Annals of Statistics 32, 2004, doi:10.1214/009053604000000067.

    Examples
    --------
    How far does the second player's cost matter?

    >>> from lcp_plugin import LCP
    >>> path = trace(LCP([[2, 1], [1, 2]], [-5, 1]), {"q": [0, -1]}, 0, 6)
    >>> path.breakpoints
    array([0. , 3.5, 6. ])
    >>> path.at(4.5).z
    array([2.16666667, 0.66666667])
    >>> path.derivative(4.5).x
    array([-0.33333333,  0.66666667])

    The lasso, for all penalties at once:

    >>> from lcp_plugin import BoundedLeastSquares
    >>> lasso = trace(BoundedLeastSquares([[1, 0], [0, 1]], [3, -0.5], lower=-np.inf), {"l1": 1}, 3, 0)
    >>> lasso.breakpoints, lasso.at(1).x
    (array([3. , 0.5, 0. ]), array([2., 0.]))
    """
    for name, value in (("start", start), ("stop", stop)):
        if not is_number(value) or not np.isfinite(value):
            raise InvalidOption(f"{name} must be a finite number, got {value!r}")
    if type(problem).__module__.startswith(("cvxpy.", "lcp_plugin.modeling.")):
        from ...modeling.parametric_models import trace_model

        return trace_model(problem, along, float(start), float(stop), tolerance)
    return trace_stated(problem, along, float(start), float(stop), tolerance)


@np.errstate(all="ignore")
def trace_stated(
    problem: Any, along: Any, start: float, stop: float, tolerance: float | None
) -> Path:
    """Return the path of a problem of one of the three classes."""
    clock = Clock()
    family = family_of(problem, along, start, stop, tolerance)
    path = _Trace(family, start, stop).run()
    _ = path.status
    path.seconds = clock.read()
    return path


class _Trace:
    """A path during the trace: t = |θ − start| goes from 0 to `end`, at stop or at crossing bounds."""

    def __init__(self, family: Family, start: float, stop: float) -> None:
        self.family, self.path = family, Path(family, start, stop)
        self.toward, self.span = (1.0 if stop >= start else -1.0), abs(stop - start)
        stated = family.monotone_graphs()
        self.units = stated.columns.units()
        self.problem: MonotoneGraphs = stated.rescale(self.units).begun_at(start, self.toward)
        share, self.path.crossed = family.find_crossing()
        self.end, self.reached = self.span * share, 0.0

    def theta(self, t: float) -> float:
        """Return θ."""
        return self.path.stop if t == self.span else self.path.start + self.toward * t

    def run(self) -> Path:
        """Return the path."""
        path = self.path
        failed = -1  # shares that led to nothing since the last line; −1: the start
        while self.end >= 0.0 and failed < len(BEYOND):
            follower = self._begin((0.0, *BEYOND)[failed + 1 :])
            if follower is None:
                break
            self._reach_back(follower)
            failed += 1
            for line in follower.lines(self.end):
                self._add(self._piece(line))
                self.reached, failed = line.end, 0
            if self.reached == self.end and path.pieces:
                path.beyond = None
                break
        path.reached = self.theta(self.reached)
        return path

    def _begin(self, shares: tuple[float, ...]) -> Follower | None:
        """Return the first path follower just beyond `reached`, or None.

        The result is None if no solution exists there, or if the solution does not determine a path.
        """
        for share in shares:
            t = min(self.reached + share * self.span, self.end)
            result = self.path.beyond = self.family.solve_at(self.theta(t))
            self.path.starts += 1
            if result.has_no_solution or result.x is None:
                return None
            z = self.family.extract_unknowns(result) / self.units
            moving, q = np.flatnonzero(z), self.problem.q[0] + t * self.problem.q[1]
            w = q + z[moving] @ self.problem.columns.many(moving)
            follower = Follower(self.problem, t, z, w)
            if follower.motion is not None:
                return follower
            if t == self.end:
                return None
        return None

    def _reach_back(self, follower: Follower) -> None:
        """Extend the new segment back to the end of the last segment.

        A stretch beyond the limits of its steps becomes a separate segment, so that its statuses are computed
        separately.
        """
        t, begin = follower.t, self.reached
        assert follower.motion is not None
        if follower.motion.first_end(-1.0)[0] >= (t - begin) * (1.0 - AT_END):
            follower.begin = begin
        else:
            z, rate = follower.motion.z
            line = Segment(begin, t, np.array([z - (t - begin) * rate, rate]), follower.steps)
            self._add(self._piece(line))
            self.reached = t

    def _add(self, piece: Piece) -> None:
        """Add a segment; record a jump or a line of solutions if the path is discontinuous."""
        path = self.path
        if path.pieces and _is_apart(path.pieces[-1].z_at(piece.begin), piece.z0):
            # All solutions of a monotone problem are one convex set.
            (path.segments if self.family.is_monotone else path.jumps).append(piece.begin)
        path.pieces.append(piece)

    def _piece(self, line: Segment) -> Piece:
        """Return the segment as a `Piece`, from the rounded θ of its begin."""
        begin, rate = self.theta(line.begin), self.units * line.z[1]
        z = self.units * line.z[0]
        z += (self.toward * (begin - self.path.start) - line.begin) * rate
        slope, family = self.toward * rate, self.family
        x, x_slope, case = family.x_of(z), family.x_of(slope), family.case_of(line.steps)
        return Piece(begin, self.theta(line.end), x, x_slope, case, z, slope)


def _is_apart(one: FloatVector, other: FloatVector) -> bool:
    """Return whether two solutions just before and just after a value of θ differ."""
    return bool(np.abs(one - other).max(initial=0.0) > SAME * (1.0 + np.abs(one).max(initial=0.0)))
