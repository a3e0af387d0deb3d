"""trace(): the solutions along one parameter, all of them at once."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...core.checks import FloatVector, is_number
from ...core.deadline import Clock
from ...core.errors import InvalidOption
from .families import Family, Piece, family_of
from .following import End, Follower, Line, SingularError, follower_from
from .path import Path
from .staircases import Staircases

BEYOND = (
    1e-7,
    1e-5,
    1e-3,
)  # of the way from start to stop: where a path that has ended is looked for again
SAME = 1e-4  # what a solution may move on the shortest of these
MOST_RESTARTS = 50


def trace(
    problem: Any, along: Any, start: float, stop: float, *, tolerance: float | None = None
) -> Path:
    """Return the solutions for every value of a parameter θ between start and stop: exact pieces, not samples.

    Data(θ) = data + θ · direction. The solution is piecewise affine in θ; one change of a factor leads from each
    breakpoint to the next.

    Parameters
    ----------
    problem : LCP, QuadraticProgram or BoundedLeastSquares, or a problem of cvxpy
        Its data are those at θ = 0.
    along : mapping, or a cvxpy Parameter
        What moves, and how much for θ + 1: ``{"q": dq}`` and bounds of an LCP; c, h, b and bounds of a program; b, l1
        and bounds of least squares. A number moves all entries alike. Of a problem of cvxpy a scalar Parameter, whose
        value θ is, or ``{parameter: direction}``, added to its present value; then
        ``path.value(x, θ)`` is the value of a variable.
    start, stop : float
        Either may be the larger one.
    tolerance : float, optional
        As in `solve`: 1e-6 of a program, 1e-8 of others.

    Returns
    -------
    Path
        Also where the solution ends, or jumps, on the way: ``path.status`` and ``path.explain()`` say where, and what
        is proved just beyond.

    Raises
    ------
    InvalidOption
        Where something else is to move, or θ is not finite.
    UnsupportedModel
        Where a program is not convex, or the parameter of a cvxpy problem stands in its matrices.

    Notes
    -----
    Cost: a solve at start, then O(n |F| + |F|²) a breakpoint, F the unknowns off their bounds. Dense inverse of F.
    Where M is not monotone a path may turn back: it is followed through the turn, and where it comes by again the
    solution has jumped.

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


def trace_stated(
    problem: Any, along: Any, start: float, stop: float, tolerance: float | None
) -> Path:
    """Return the path of a problem of ours."""
    clock = Clock()
    return traced(family_of(problem, along, start, stop, tolerance), start, stop, clock)


def traced(family: Family, start: float, stop: float, clock: Clock) -> Path:
    """Return the path of a family, certified."""
    toward = 1.0 if stop >= start else -1.0
    stated = family.staircases()
    units = stated.columns.units()
    problem = _turned(stated.measured(units), toward)
    crossed = family.crossing()
    end, t = toward * (stop if crossed is None else crossed.at), toward * start
    pieces: list[Piece] = []
    jumps: list[float] = []
    segments: list[float] = []
    beyond, starts, reached = crossed, 0, toward * start
    follower: Follower | None = None
    with np.errstate(invalid="ignore", over="ignore", under="ignore", divide="ignore"):
        for attempt in range(0 if crossed is not None and crossed.is_at_start else MOST_RESTARTS):
            for share in BEYOND if attempt else (0.0,):
                t = min(reached + share * max(end - toward * start, abs(reached)), end)
                follower, beyond, asked = _begun(
                    family, problem, t, toward, units, is_first=not attempt
                )
                starts += asked
                if follower is not None or beyond.has_no_solution or t == end:
                    break
            if follower is None:
                break
            if pieces and _is_apart(pieces[-1].z_at(toward * reached), units * follower.solution()):
                # All solutions of a monotone problem are one convex set.
                (segments if family.is_monotone else jumps).append(toward * reached)
            why, reached = None, t
            for line in follower.lines(end, is_monotone=family.is_monotone):
                if isinstance(line, End):
                    why = line
                    break
                pieces.append(_piece(family, line, toward, units))
                reached = line.end
                jumps += [toward * line.begin] if line.jumps else []
                segments += [toward * line.begin] if line.slides else []
            if why is End.STOP or reached == end:
                beyond = crossed
                break
    if toward * start == end and follower is not None:
        pieces.append(_still(family, follower, toward, units))
    path = Path(family, start, stop, pieces, jumps, segments, beyond, toward * reached, starts)
    _ = path.status
    path.seconds = clock.read()
    return path


def _is_apart(one: FloatVector, other: FloatVector) -> bool:
    """Return whether two solutions, just before and just behind a value of θ, are not the same."""
    return bool(np.abs(one - other).max(initial=0.0) > SAME * (1.0 + np.abs(one).max(initial=0.0)))


def _begun(
    family: Family,
    problem: Staircases,
    t: float,
    toward: float,
    units: FloatVector,
    *,
    is_first: bool,
) -> tuple[Follower | None, Any, int]:
    """Return a follower at t, or what `solve` says where there is no solution; and how often it was asked."""
    if is_first and (follower := _at_rest(problem, t)) is not None:
        return follower, None, 0
    result = family.solved(toward * t)
    if result.has_no_solution or result.x is None:
        return None, result, 1
    z = family.followed(result, toward * t) / units
    q = problem.q[0] + t * problem.q[1]
    moving = np.flatnonzero(z)
    w = q + (z[moving] @ problem.columns.many(moving) if moving.size else 0.0)
    try:
        return follower_from(problem, t, z, w), None, 1
    except SingularError:
        return None, result, 1


def _at_rest(problem: Staircases, t: float) -> Follower | None:
    """Return a follower where the corner nearest to 0 is the solution at t, as for a large penalty; else None."""
    corners = problem.corners[0] + t * problem.corners[1]
    nearest = np.argmin(np.abs(corners), axis=0)
    z = np.take_along_axis(corners, nearest[np.newaxis], axis=0)[0]
    if not np.isfinite(z).all():
        return None
    follower = Follower(problem, 2 * nearest, t, z)
    return follower if follower.is_right() else None


def _turned(problem: Staircases, toward: float) -> Staircases:
    """Return the problem over t = ±θ, so that t grows."""
    if toward > 0.0:
        return problem
    sign = np.array([1.0, -1.0])
    return Staircases(
        problem.columns,
        problem.q * sign[:, np.newaxis],
        problem.corners * sign[:, np.newaxis, np.newaxis],
        problem.levels * sign[:, np.newaxis, np.newaxis],
    )


def _piece(family: Family, line: Line, toward: float, units: FloatVector) -> Piece:
    z0, z1 = units * line.z[0], toward * units * line.z[1]
    return Piece(
        toward * line.begin,
        toward * line.end,
        family.x_of(z0),
        family.x_of(z1),
        family.case_of(line.steps),
        z0,
        z1,
    )


def _still(family: Family, follower: Follower, toward: float, units: FloatVector) -> Piece:
    """Return the piece of a path of length 0."""
    z: FloatVector = follower.solution()
    line = Line(follower.t, follower.t, np.array([z, np.zeros_like(z)]), follower.steps)
    return _piece(family, line, toward, units)
