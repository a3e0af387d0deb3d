"""trace(): the solution path along one parameter, for complementarity problems, convex programs and least squares."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np

from ...core.checks import Array, Indices, Vector, checked_vector, is_number, read_only
from ...core.deadline import Clock
from ...core.entries import max_norm
from ...core.errors import InvalidOption, UnsuitableProblem, did_you_mean
from ...core.lcp import LCP
from ...core.problem_classes import class_of, classes_of, foreign_function, refusal
from ...core.rounding import ROUNDING
from ...core.settings import DEFAULTS, Settings
from ...core.tuning import PIVOTED_UP_TO
from ...judges.program import PROGRAM_TOLERANCE
from ...solving.dispatch import solve
from ...systems.definiteness import is_semidefinite_to_rounding
from ..least_squares.data import BoundedLeastSquares
from ..nonlinear.data import NonlinearProblem
from ..programs.conversion import conditions
from ..programs.program import QuadraticProgram, refuse_nonconvex
from ..programs.solution import QPSolution
from .following import Follower, MonotoneGraphs
from .path import Path, PathPoint, Piece
from .smooth import SmoothFollower, SmoothPiece

BOUNDS = ("lower", "upper")
BEYOND = 1e-9, 1e-7, 1e-5, 1e-3  # of the way: distances at which a lost path is restarted


def trace(
    problem: Any, along: Any, start: float, stop: float, *, tolerance: float | None = None
) -> Path:
    """Return the solution for all values of θ between start and stop, exact and piecewise affine unless F is nonlinear.

    Data(θ) = data + θ · direction. The solution is piecewise affine in θ; one linear system leads from each
    breakpoint to the next. For a NonlinearProblem the solution is piecewise smooth, and Newton's method follows it.

    Parameters
    ----------
    problem : LCP, NonlinearProblem, QuadraticProgram or BoundedLeastSquares, or a problem of cvxpy
        Problem with the data at θ = 0.
    along : mapping, or callable, or a cvxpy Parameter
        The moving data, with their change per unit of θ: ``{"q": dq}`` and bounds of an LCP, c, h, b and bounds of a
        program, or b, l1 and bounds of least squares. A number moves all entries alike. For a NonlinearProblem, q is
        added to F; a callable returns the NonlinearProblem for θ, whose F replaces the F of `problem`, which has the
        bounds. For a cvxpy problem, use a
        scalar Parameter, whose value is θ, or ``{parameter: direction}``, added to its present value.
        ``path.value(x, θ)`` is then the value of a variable.
    start, stop : float
        Either may be larger.
    tolerance : float, optional
        As in `solve`: 1e-6 for a program, 1e-8 for other problems.

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
    just beyond, and the new segment is extended back to the old segment.

    Along a nonlinear F, ``path.at(θ)`` solves again from the path. ``path.x`` and ``path.derivative`` interpolate the
    computed solutions, of which each is predicted from the solution before within 10⁻³. A row that leaves its bound and
    returns within a step, at most 1/32 of the way, may be missed. A path that turns back ends, or jumps to a solution
    beyond.

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

    x + x³ = θ, with x from 0 to 1:

    >>> from lcp_plugin import NonlinearProblem
    >>> roots = trace(NonlinearProblem(lambda x: x + x**3, lower=[0.0], upper=1.0), {"q": -1}, -1, 3)
    >>> roots.breakpoints.round(6) + 0.0, roots.at(1).x.round(6)
    (array([-1.,  0.,  2.,  3.]), array([0.682328]))
    """
    for name, value in (("start", start), ("stop", stop)):
        if not is_number(value) or not np.isfinite(value):
            raise InvalidOption(f"{name} must be a finite number, got {value!r}")
    trace_any = foreign_function("trace", problem) or trace_stated
    path: Path = trace_any(problem, along, float(start), float(stop), tolerance)
    return path


@np.errstate(all="ignore")
def trace_stated(problem: Any, along: Any, start: float, stop: float, tolerance: object) -> Path:
    """Return the path of a problem of one of the classes."""
    clock = Clock()
    path = _Trace(Line(problem, along, start, stop, tolerance)).run()
    _ = path.status
    path.seconds = clock.read()
    return path


class Line:
    """Problems with the vectors of `problem` plus θ times a direction, for θ from start to stop.

    Parameters
    ----------
    problem : LCP, NonlinearProblem, QuadraticProgram or BoundedLeastSquares
    along : mapping from str to number or array, or callable
        Changes of the moving vectors per unit of θ, or the nonlinear problem for θ.
    start, stop : float
    tolerance : float or None
        None means the tolerance of the problem class.
    """

    def __init__(self, problem: Any, along: Any, start: float, stop: float, tolerance: Any) -> None:
        if (name := class_of(problem)) not in classes_of("trace"):
            raise InvalidOption(refusal("trace", problem))
        self.conditions = CONDITIONS[name]
        is_program = isinstance(problem, QuadraticProgram)
        usual = PROGRAM_TOLERANCE if is_program else DEFAULTS["tolerance"]
        self.tolerance = Settings(tolerance=usual if tolerance is None else tolerance).tolerance
        if getattr(problem, "n", 0) is None:
            raise InvalidOption("trace needs the number of unknowns; pass a bound as an array")
        self.problem, self.start, self.stop = problem, start, stop
        self.toward = 1.0 if stop >= start else -1.0
        self.function: Any = None  # from θ to a nonlinear problem
        if isinstance(problem, NonlinearProblem) and callable(along):
            self.function, along = along, {"q": 0.0}
        if not isinstance(along, Mapping) or not along:
            raise InvalidOption(f'along must name data, as in {{"q": direction}}, got {along!r}')
        self.directions = {
            str(name): self._check_change(name, change) for name, change in along.items()
        }

    def _check_change(self, name: str, change: Any) -> Vector:
        """Return the change of a vector for θ + 1, shape (size,)."""
        class_name, names = type(self.problem).__name__, self.problem.vector_names
        if name in self.problem.matrix_names:
            raise InvalidOption(
                f"vectors of {class_name} may move, not {name}: the solution is not piecewise affine in {name}; "
                "solve_batch takes a list of problems. If θ multiplies P, divide the objective by it and move c"
            )
        if name not in names:
            others = f"{did_you_mean(name, names)}; {', '.join(names)} may move"
            raise InvalidOption(f"along={{{name!r}: …}} is not a vector of {class_name}{others}")
        now: Vector = getattr(self.problem, name)
        if is_number(change):  # it moves all bounds that there are
            return read_only(np.where(np.isfinite(now), float(change), 0.0))
        step = checked_vector(change, name, now.size)
        if (moved := ~np.isfinite(now) & (step != 0.0)).any():
            i = int(np.argmax(moved))
            raise InvalidOption(f"{name}[{i}] is {now[i]} and cannot move; set its change to 0")
        return read_only(step)

    def slope(self, name: str) -> Vector:
        """Return the change of a vector for θ + 1, shape (size,)."""
        return self.directions.get(name, np.zeros(getattr(self.problem, name).size))

    def pair(self, value: Vector, slope: Vector) -> Vector:
        """Return a vector at start and its change per unit of |θ − start|, shape (2, size)."""
        return np.array([value + self.start * slope, self.toward * slope])

    def ends(self, name: str) -> list[Vector]:
        """Return a vector at start and at stop."""
        now, step = getattr(self.problem, name), self.slope(name)
        return [now + theta * step for theta in (self.start, self.stop)]

    def find_crossing(self) -> tuple[float, str]:
        """Return the share of the way at which bounds cross (−1: at start), and a message."""
        lower, upper = map(self.ends, BOUNDS)
        room = []
        for low, high in zip(lower, upper, strict=True):
            size = sum(np.nan_to_num(np.abs(end), posinf=0.0) for end in (low, high))
            # Rounding error by which equal bounds may cross
            room.append(np.where(np.abs(high - low) <= 1e-12 * size, 0.0, high - low))
        share = np.where(room[1] < 0.0, room[0] / (room[0] - room[1]), 1.0)
        share = np.where(room[0] < 0.0, -1.0, share)
        row = int(np.argmin(share)) if share.size else 0
        if not share.size or (share[row] == 1.0 and not room[1][row] < 0.0):
            return 1.0, ""
        return float(share[row]), f"lower[{row}] exceeds upper[{row}]"

    def at(self, theta: float) -> Any:
        """Return the problem at θ."""
        if self.function is not None:
            return self.problem.with_function_of(self.function(theta), f"along({theta:.6g})")
        present = ((name, getattr(self.problem, name)) for name in self.directions)
        moved = {name: now + theta * self.directions[name] for name, now in present}
        if "upper" in moved:  # bounds that meet may cross by rounding
            moved["upper"] = np.maximum(moved["upper"], moved.get("lower", self.problem.lower))
        elif "lower" in moved:
            moved["lower"] = np.minimum(moved["lower"], self.problem.upper)
        if "l1" in moved:
            moved["l1"] = np.maximum(moved["l1"], 0.0)
        return self.problem.with_vectors(**moved)

    def theta(self, t: float) -> float:
        """Return θ at the distance t from start."""
        return self.stop if t == abs(self.stop - self.start) else self.start + self.toward * t

    def point(self, theta: float, z: Vector, case: Array) -> PathPoint:
        """Return the solution at θ from the unknowns of the complementarity problem and their active set."""
        problem = self.at(theta)
        if isinstance(problem, NonlinearProblem):
            x = solve(problem, x0=z, tolerance=self.tolerance, restarts=0).x
            return PathPoint(theta, problem, x, self.tolerance)
        lower, upper, case = problem.lower, problem.upper, case[: problem.lower.size]
        masks, ends = [case == -1, case == 1, case == 2], [lower, upper, np.zeros(lower.size)]
        held = np.select(masks, ends, z[: lower.size])
        x = read_only(np.clip(held, lower, upper))
        if isinstance(problem, BoundedLeastSquares) and "b" in self.directions:
            x = self._with_digits_of_b(problem, x, np.flatnonzero(case == 0))
        if not isinstance(problem, QuadraticProgram):
            return PathPoint(theta, problem, x, self.tolerance)
        y, m = z[x.size :], problem.h.size
        y = np.append(np.maximum(y[:m], 0.0), y[m:])
        slope = problem.P @ x + problem.c + problem.matrices.terms.rows.T @ y
        sides = (lower, slope), (upper, -slope)
        of_bounds = [np.where(x == end, np.maximum(pull, 0.0), 0.0) for end, pull in sides]
        solution = QPSolution.of_rows(problem, x, np.concatenate([y, *of_bounds]))
        return PathPoint(theta, problem, x, self.tolerance, solution)

    def _with_digits_of_b(self, problem: BoundedLeastSquares, x: Vector, free: Any) -> Vector:
        """Return x, solved again on its free entries if b is small compared with its values at start and stop."""
        if not 0.0 < max_norm(problem.b) < 1e-2 * np.abs(self.ends("b")).max():
            return x
        A, residual = problem.weighted_matrix[:, free], problem.product(x) - problem.b
        slope = problem.apply_transpose(problem.apply_weights(residual)) + problem.ridge * x
        slope += problem.l1 * np.sign(x)
        gram = (A.T @ A).toarray() if problem.is_sparse else A.T @ A
        refined = np.array(x)
        refined[free] -= np.linalg.lstsq(gram + problem.ridge * np.eye(free.size), slope[free])[0]
        return read_only(np.clip(refined, problem.lower, problem.upper))

    @cached_property
    def is_monotone(self) -> bool:
        """True if the solutions at each θ are known to be convex; for an LCP this costs a factorization."""
        if not isinstance(self.problem, LCP):
            return not isinstance(self.problem, NonlinearProblem)
        M = self.problem.M
        return is_semidefinite_to_rounding(M + M.T) is True


# --- Problem classes ----------------------------------------------------------------------------------------------


def _matrix_conditions(line: Line) -> MonotoneGraphs:
    """Return an LCP, or the optimality conditions of a convex program."""
    stated = line.problem
    if isinstance(stated, QuadraticProgram):
        refuse_nonconvex(stated)
        stated = conditions(stated)
    if stated.n > PIVOTED_UP_TO:
        raise UnsuitableProblem(
            f"trace takes up to {PIVOTED_UP_TO} rows, got {stated.n}; solve_batch(problem, Q) solves at given values"
        )
    *rows, lower, upper = map(line.slope, line.problem.vector_names)
    zeros = np.zeros(stated.n - lower.size)  # bounds of multipliers
    slopes = np.concatenate(rows), np.append(lower, zeros), np.append(upper, zeros)
    values = stated.q, stated.lower, stated.upper
    return MonotoneGraphs.of_matrix(stated.matrix.csr, *map(line.pair, values, slopes))


def _penalty_conditions(line: Line) -> MonotoneGraphs:
    """Return the normal equations of least squares; a penalty within bounds of both signs is a kink at 0."""
    problem = line.problem
    l1, lower, upper = (line.ends(name) for name in ("l1", *BOUNDS))
    if (least := np.minimum(*l1)).min(initial=0.0) < 0.0:
        j = int(np.argmin(least))
        raise InvalidOption(f"l1 must be ≥ 0, got l1[{j}] = {least[j]}; trace to where it is 0")
    has_penalty = np.maximum(*l1) > 0.0
    is_negative = has_penalty & (np.maximum(*upper) <= 0.0)
    has_kink = has_penalty & (np.minimum(*lower) < 0.0) & ~is_negative
    crossing = has_kink & ((np.maximum(*lower) > 0.0) | (np.minimum(*upper) < 0.0))
    if crossing.any():
        j = int(np.flatnonzero(crossing)[0])
        raise UnsuitableProblem(
            f"a bound of x[{j}], which has a penalty, changes its sign on the way; trace up to there, then on"
        )
    names = line.problem.vector_names
    b, penalty, low, high = (line.pair(getattr(problem, name), line.slope(name)) for name in names)
    q = -np.array([problem.apply_transpose(problem.apply_weights(part)) for part in b])
    q += np.where(has_kink, 0.0, np.where(is_negative, -penalty, penalty))
    return MonotoneGraphs.of_least_squares(problem, q, low, high, np.where(has_kink, penalty, 0.0))


#: The complementarity problem of a line from start to stop, by problem class; None if it is nonlinear.
CONDITIONS: dict[str, Callable[[Line], Any]] = {
    "LCP": _matrix_conditions,
    "NonlinearProblem": lambda line: None,
    "QuadraticProgram": _matrix_conditions,
    "BoundedLeastSquares": _penalty_conditions,
}


# --- the trace ------------------------------------------------------------------------------------------------


class _Trace:
    """A path during the trace: t = |θ − start| goes from 0 to `end`, at stop or at crossing bounds."""

    def __init__(self, line: Line) -> None:
        self.line, self.path, self.problem = line, Path(line), line.conditions(line)
        self.span = abs(line.stop - line.start)
        share, self.path.crossed = line.find_crossing()
        self.end, self.reached = self.span * share, 0.0

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
                self._add(*line)
                failed = 0
            if self.reached == self.end and path.pieces:
                path.beyond = None
                break
        path.reached = self.line.theta(self.reached)
        return path

    def _begin(self, shares: tuple[float, ...]) -> Any:
        """Return the first path follower just beyond `reached`, or None.

        The result is None if no solution exists there, or if the solution does not determine a path.
        """
        for share in shares:
            t = min(self.reached + share * self.span, self.end)
            stated = self.line.at(self.line.theta(t))
            is_smooth, pieces = isinstance(stated, NonlinearProblem), self.path.pieces
            near = {"x0": pieces[-1].z_at(self.line.theta(t))} if is_smooth and pieces else {}
            result = self.path.beyond = solve(stated, tolerance=self.line.tolerance, **near)
            self.path.starts += 1
            if result.has_no_solution or (is_smooth and not result.is_solved):
                return None
            follower: Any = SmoothFollower(self.line, t, result.x) if is_smooth else None
            if not is_smooth:
                z = result.x
                if isinstance(stated, QuadraticProgram):
                    z = np.concatenate([z, result.solution.inequality, result.solution.equality])
                z = z / self.problem.units
                moving, q = np.flatnonzero(z), self.problem.q[0] + t * self.problem.q[1]
                w = q + z[moving] @ self.problem.columns(moving)
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
        missing = t - begin - follower.motion.first_end(-1.0)[0]
        if self.problem is None or missing <= max(1e-6 * (t - begin), ROUNDING * self.span):
            follower.begin = begin
        else:
            z, rate = follower.motion.z
            self._add(begin, t, np.array([z - (t - begin) * rate, rate]), follower.steps)

    def _add(self, t: float, end: float, line: Any, steps: Indices) -> None:
        """Add a segment; record a jump or a line of solutions if the path is discontinuous."""
        path, begin, toward = self.path, self.line.theta(t), self.line.toward
        if self.problem is None:
            piece: Piece = SmoothPiece.through(line, self.line, t, end)
        else:
            z, rate = self.problem.units * line
            z += (toward * (begin - self.line.start) - t) * rate  # from the rounded θ of its begin
            slope, n = toward * rate, self.line.problem.lower.size
            has_kink = np.isfinite(self.problem.levels[0, 2])
            case = np.where(has_kink, np.array([-1, 0, 2, 0, 1])[steps], steps - 1)
            piece = Piece(begin, self.line.theta(end), z[:n], slope[:n], case, z, slope)
        self.reached = end
        before = path.pieces[-1].z_at(piece.begin) if path.pieces else piece.z0
        change, size = (max_norm(vector) for vector in (before - piece.z0, before))
        # The solution moves no farther over the shortest of these distances
        if change > 1e-4 * (1.0 + size):
            # All solutions of a monotone problem are one convex set.
            (path.segments if self.line.is_monotone else path.jumps).append(piece.begin)
        elif path.pieces and change <= 1e-12 * size:
            path.pieces[-1] = replace(path.pieces[-1], last=piece.z0)
        path.pieces.append(piece)
