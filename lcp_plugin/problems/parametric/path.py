"""The path of a solution over one parameter: segments, values, derivatives and statuses."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from pkgutil import resolve_name
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ...core.checks import Indices, Vector, derived_property, is_number, read_only
from ...core.errors import InvalidOption, NotConverged
from ...core.lcp import LCP
from ...core.names import format_count
from ...core.problem_classes import CLASSES, Door, class_of
from ...core.settings import Status
from ...solving.result import Outcome
from ..least_squares.certificate import Optimality
from ..least_squares.data import BoundedLeastSquares, Enclosures
from ..nonlinear.data import NonlinearProblem
from ..programs.solution import QPSolution

BREAKPOINTS_SHOWN = 8  # breakpoints in a paragraph
NO_WAY_ON = "the solution determines no way on, a singular case; solve_batch solves at given values"
MISSED = (
    "a row that leaves its bound and returns within a step, at most 1/32 of the way, may be missed"
)
WORST_FIRST = Status.STALLED, Status.PRECISION_LIMIT, Status.SOLVED


@dataclass(frozen=True, eq=False)
class Piece:
    """Affine segment of a path: x = x0 + (θ − begin) x1 for θ from begin to end.

    Attributes
    ----------
    begin, end : float
        In the order in which the path is traced.
    x0, x1 : ndarray, shape (n,)
    case : ndarray of int, shape (n,)
        Active set: −1 at the lower bound, 0 between the bounds, 1 at the upper bound, 2 at 0 because of a penalty. For
        a program, the entries of x are followed by the rows of G (−1 inactive, 0 active) and the rows of A.
    z0, z1 : ndarray
        For a program, x followed by the multipliers of rows, and their rates; x0 and x1 for other problem classes.
    last : ndarray or None
        z at the end, as the next segment begins with it: near a breakpoint at 0, z0 + … has the rounding of z0.
    """

    begin: float
    end: float
    x0: Vector = field(repr=False)
    x1: Vector = field(repr=False)
    case: Indices | None = field(repr=False)
    z0: Vector = field(repr=False)
    z1: Vector = field(repr=False)
    last: Vector | None = field(default=None, repr=False)

    def z_at(self, theta: float, order: int = 0) -> Vector:
        """Return x with the multipliers of rows at θ, or their rates for order 1."""
        if order:
            return self.z1
        if self.last is not None and abs(theta - self.end) < abs(theta - self.begin):
            return self.last + (theta - self.end) * self.z1
        return self.z0 + (theta - self.begin) * self.z1

    def x_at(self, theta: float) -> Vector:
        """Return x at θ."""
        return self.z_at(theta)[: self.x0.size]


@dataclass(frozen=True, eq=False)
class PathPoint(Outcome):
    """The solution at one value of the parameter.

    Attributes
    ----------
    parameter : float
    problem : LCP, NonlinearProblem, QuadraticProgram or BoundedLeastSquares
        With its data at that value.
    x : ndarray, shape (n,)
        z of an LCP.
    w : ndarray, shape (n,), or None
        M z + q of an LCP, F(x) of a nonlinear problem.
    solution : QPSolution or None
        Program only: x with the multipliers of all rows and bounds, and their residuals.
    status : Status
        Status by the criterion of the problem class for the data at that value. At a breakpoint it may be
        PRECISION_LIMIT.
    objective : float or None
        Objective of the problem class; None for a complementarity problem.
    """

    parameter: float
    problem: Any = field(repr=False)
    x: Vector
    _tolerance: float = field(repr=False)
    solution: QPSolution | None = field(default=None, repr=False)
    stated_objective: float | None = field(default=None, repr=False)  # of the model of the program

    @property
    def z(self) -> Vector:
        """X, by the name that it has in an LCP."""
        return self.x

    @cached_property
    def w(self) -> Vector | None:
        """M z + q of an LCP, F(x) of a nonlinear problem."""
        if isinstance(self.problem, NonlinearProblem):
            return self.problem.value(self.x)
        return read_only(self.problem.slack(self.x)) if isinstance(self.problem, LCP) else None

    @cached_property
    def objective(self) -> float | None:
        """Objective at x."""
        problem = self.problem
        if self.stated_objective is not None:
            return self.stated_objective
        if isinstance(problem, BoundedLeastSquares):
            return float(problem.cost(self.x, problem.product(self.x) - problem.b))
        return None if self.solution is None else problem.sense * float(self.solution.objective)

    @derived_property
    def status(self) -> Status:
        """Status by the criterion of the problem class."""
        # Up to 100 times the tolerance the status is PRECISION_LIMIT
        tolerance, near = self._tolerance, 100.0 * self._tolerance
        if isinstance(self.problem, (LCP, NonlinearProblem)):
            criterion = resolve_name(f"lcp_plugin.{CLASSES[str(class_of(self.problem))].criterion}")
            data, x, w, _ = criterion(self.problem, self.x)
            measured = data.measure_at(x, w, tolerance)
            is_solved = bool(measured.passes)
            is_near = bool(data.are_limited(measured, tolerance))
        elif self.solution is not None:
            is_solved = self.solution.is_optimal(tolerance)
            is_near = not is_solved and self.solution.error <= near
        else:
            at = Optimality.of(Enclosures(self.problem), self.x, tolerance=tolerance)
            is_solved, is_near = at.residual <= tolerance, at.is_limited or at.residual <= near
        if is_solved:
            return Status.SOLVED
        return Status.PRECISION_LIMIT if is_near else Status.STALLED


@dataclass(frozen=True, eq=False)
class Slope:
    """Rate of change of the solution with the parameter.

    Attributes
    ----------
    x : ndarray, shape (n,)
    multipliers : ndarray or None
        Rates of the multipliers of the rows of G and A of a program.
    """

    x: Vector
    multipliers: Vector | None = None


class Path(Outcome):
    """The solution of a family of problems along one parameter, returned by `trace`.

    Attributes
    ----------
    pieces : list of Piece
        Segments in the order of the trace; the solution is affine on each, or smooth for a nonlinear problem.
    start, stop : float
        Requested first and last value of θ.
    reached : float
        Last value of θ on the path.
    status : Status
        SOLVED if the path reached `stop` and each segment is SOLVED in its interior and just inside its begin and end,
        by the criterion of the problem class. Points between these are convex combinations; of a
        nonlinear problem they are not verified, and ``at(θ)`` has the status of a point. INFEASIBLE if bounds cross
        on the way. Otherwise the worst status of a segment, or the status of the problem just beyond `reached`.
    jumps : list of float
        Values of θ at which the solution jumps. A jump requires a matrix that is not monotone.
    segments : list of float
        Values of θ at which two segments are connected by a line of solutions, for example between two optimal
        vertices of a linear program.
    beyond : result or None
        Result of `solve` just beyond `reached`, with its proof, if the path ends before stop.
    crossed : str
        Names of the bounds that cross at `reached`, or "".
    seconds : float
        Wall-clock time of the trace, certificates included.
    """

    def __init__(self, line: Any) -> None:
        self.line, self.start, self.stop, self.reached = line, line.start, line.stop, line.start
        self.pieces: list[Piece] = []
        self.jumps: list[float] = []
        self.segments: list[float] = []
        self.beyond: Any = None
        self.crossed, self.starts, self.seconds = "", 0, 0.0

    @property
    def problem(self) -> Any:
        """The problem at θ = 0."""
        return self.line.problem

    @derived_property
    def breakpoints(self) -> Vector:
        """Values of θ at which segments begin and end, from start to `reached`, both included."""
        if not self.pieces:
            return np.zeros(0)
        return np.array([self.pieces[0].begin, *(piece.end for piece in self.pieces)])

    @derived_property
    def statuses(self) -> list[Status]:
        """The worst status of each segment, in its interior and just inside its begin and end."""
        worst = []
        for piece in self.pieces:
            # Integers would cancel at a simple fraction
            middle = piece.begin + 0.3819660112501051 * (piece.end - piece.begin)
            inner = (end + 1e-5 * (middle - end) for end in (piece.begin, piece.end))
            known = [self.at(theta, piece).status for theta in (middle, *inner)]
            worst.append(next(status for status in WORST_FIRST if status in known))
        return worst

    @derived_property
    def status(self) -> Status:
        """SOLVED, or the reason why the path is not solved."""
        if self.beyond is not None:
            return Status(self.beyond.status) if not self.beyond.is_solved else Status.STALLED
        if self.crossed:
            return Status.INFEASIBLE
        if self.reached != self.stop:
            return Status.STALLED
        return next(status for status in WORST_FIRST if status in self.statuses)

    @property
    def proof(self) -> Any:
        """Proof that no solution exists just beyond `reached`, or None."""
        return None if self.beyond is None else self.beyond.proof

    def require_solved(self) -> Path:
        """Return this path, or raise NotConverged with `explain` if it is not solved."""
        if not self.is_solved:
            raise NotConverged(self.explain())
        return self

    # --- values -------------------------------------------------------------------------------------------

    def at(self, theta: float, piece: Piece | None = None) -> PathPoint:
        """Return x, multipliers, objective and status at θ; at a jump, the later solution.

        Raises
        ------
        InvalidOption
            If θ is not on the path.
        """
        piece = self.piece_at(theta) if piece is None else piece
        return self.line.point(float(theta), piece.z_at(float(theta)), piece.case)

    def x(self, thetas: ArrayLike) -> Vector:
        """Return x at many values, shape (k, n); of a nonlinear problem interpolated."""
        values = np.atleast_1d(np.asarray(thetas, dtype=np.float64))
        made: Vector = np.empty((values.size, self.pieces[0].x0.size if self.pieces else 0))
        for k, theta in enumerate(values):
            made[k] = self.piece_at(theta).x_at(theta)
        return made

    def derivative(self, theta: float, *, side: str = "ahead") -> Slope:
        """Return the derivative of the solution at θ with respect to θ.

        Parameters
        ----------
        theta : float
        side : {"ahead", "behind"}
            At a breakpoint: the later segment, in the order of the trace, or the earlier segment.
        """
        if side not in ("ahead", "behind"):
            raise InvalidOption(f'side must be "ahead" or "behind", got {side!r}')
        piece = self.piece_at(float(theta), is_behind=side == "behind")
        rate, n = piece.z_at(float(theta), 1), piece.x1.size
        return Slope(rate[:n], rate[n:] if rate.size > n else None)

    def piece_at(self, theta: float, *, is_behind: bool = False) -> Piece:
        """Return the segment that contains θ; at a breakpoint the later (or earlier) segment."""
        if not is_number(theta):
            raise InvalidOption(f"θ must be a number, got {theta!r}")
        along = self.line.toward * float(theta)
        low, high = self.line.toward * self.start, self.line.toward * self.reached
        slack = 1e-12 * max(abs(low), abs(high))
        if not self.pieces or not low - slack <= along <= high + slack:
            there = f"from {self.start:.9g} to {self.reached:.9g}" if self.pieces else "nowhere"
            raise InvalidOption(f"θ = {theta!r} is not on the path, which goes {there}")
        side = "left" if is_behind else "right"
        begins = [self.line.toward * piece.begin for piece in self.pieces]
        return self.pieces[max(int(np.searchsorted(begins, along, side=side)) - 1, 0)]  # type: ignore[call-overload]

    # --- text, tables, figures ----------------------------------------------------------------------------

    def explain(self) -> str:
        """Return a summary of the path in a few lines."""
        inner = self.breakpoints[1:-1]
        shown = ", ".join(f"{value:.6g}" for value in inner[:BREAKPOINTS_SHOWN])
        hidden = inner.size - BREAKPOINTS_SHOWN
        more = f", and {hidden} more" if hidden > 0 else ""
        count, reached = format_count(len(self.pieces), "piece"), f"{self.reached:.9g}"
        is_smooth = isinstance(self.problem, NonlinearProblem)
        shape = "smooth" if is_smooth else "affine"
        lines = [
            f"{self.status.name}: {count}, {shape} in θ, from {self.start:.6g} to {reached}{self._why}",
            f"breakpoints: {shown or 'none'}{more}",
            *([MISSED] if is_smooth else []),
            *(f"the solution jumps at {value:.9g}" for value in self.jumps),
            *(f"at {value:.6g} it jumps along a line of solutions" for value in self.segments),
            f"{format_count(self.starts, 'solve')}, then steps with a factorization each; {self.seconds:.3g} s",
        ]
        return "\n".join(lines)

    @property
    def _why(self) -> str:
        """Reason why the path is not solved, as text."""
        if self.is_solved:
            return ""
        if self.reached == self.stop and self.beyond is None and not self.crossed:
            worst = self.pieces[self.statuses.index(self.status)]
            return f"; the piece from {worst.begin:.9g} is not within the tolerance"
        why = self.crossed or "the path was lost"
        if self.beyond is not None:
            why = NO_WAY_ON if self.beyond.is_solved else self.beyond.advice
        return f"; it ends at {self.reached:.9g}, before {self.stop:.6g}: {why}"

    plot = Door()  # evidence.drawing.plot_path

    def __len__(self) -> int:
        return len(self.pieces)

    def __repr__(self) -> str:
        count = format_count(len(self.pieces), "piece")
        where = f"{self.start:.6g} to {self.reached:.6g}"
        return f"Path({self.status.name}, {count}, {where}, {self.seconds:.3g} s)"

    def __str__(self) -> str:
        return self.explain()
