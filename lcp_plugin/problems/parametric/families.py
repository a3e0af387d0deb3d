"""Parametric problems of `trace`: data, complementarity problem, inverse mapping."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
import scipy.sparse as sp

from ...api import solve
from ...core.certificates.residuals import Certificate
from ...core.checks import BoolVector, FloatVector, checked_vector, is_number, read_only
from ...core.errors import InvalidOption, UnsuitableProblem, did_you_mean
from ...core.lcp import LCP
from ...core.problem_classes import refusal, takes
from ...core.settings import Settings, Status
from ...core.solving.base_result import Outcome
from ...systems.definiteness import is_semidefinite_to_rounding
from ..least_squares.certificate import Optimality
from ..least_squares.data import BoundedLeastSquares
from ..least_squares.enclosures import Enclosures
from ..programs.conversion import conditions
from ..programs.convexity import refuse_nonconvex
from ..programs.criterion import PROGRAM_TOLERANCE
from ..programs.program import QuadraticProgram
from ..programs.solution import QPSolution
from .monotone_graphs import Columns, GramColumns, MonotoneGraphs

LARGEST = 6000  # rows, of which a dense factorization is made
MET = 1e-12  # of their terms: rounding error by which equal bounds may cross
NEARLY = 100.0  # times the tolerance: up to here the status is PRECISION_LIMIT
BOUNDS = ("lower", "upper")


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
    """

    begin: float
    end: float
    x0: FloatVector = field(repr=False)
    x1: FloatVector = field(repr=False)
    case: Any = field(repr=False)
    z0: FloatVector = field(repr=False)
    z1: FloatVector = field(repr=False)

    def z_at(self, theta: float) -> FloatVector:
        """Return x with the multipliers of rows at θ."""
        return self.z0 + (theta - self.begin) * self.z1

    def x_at(self, theta: float) -> FloatVector:
        """Return x at θ."""
        return self.x0 + (theta - self.begin) * self.x1


@dataclass(frozen=True, eq=False)
class PathPoint(Outcome):
    """The solution at one value of the parameter.

    Attributes
    ----------
    parameter : float
    problem : LCP, QuadraticProgram or BoundedLeastSquares
        With its data at that value.
    x : ndarray, shape (n,)
        z of an LCP.
    w : ndarray, shape (n,), or None
        M z + q of an LCP.
    solution : QPSolution or None
        Program only: x with the multipliers of all rows and bounds, and their residuals.
    status : Status
        Status by the criterion of the problem class for the data at that value. At a breakpoint it may be
        PRECISION_LIMIT.
    objective : float or None
        Objective of the problem class; None for an LCP.
    """

    parameter: float
    problem: Any = field(repr=False)
    x: FloatVector
    w: FloatVector | None = field(repr=False)
    solution: QPSolution | None = field(repr=False)
    _family: Family = field(repr=False)

    @property
    def z(self) -> FloatVector:
        """X, by the name that it has in an LCP."""
        return self.x

    @cached_property
    def objective(self) -> float | None:
        """Objective at x."""
        return self._family.objective(self)

    @cached_property
    def status(self) -> Status:
        """Status by the criterion of the problem class."""
        return self._family.judge(self)

    @cached_property
    def certificate(self) -> Certificate:
        """The residuals of an LCP's z.

        Raises
        ------
        InvalidProblem
            For other problem classes: see `solution` and `status`.
        """
        return Certificate.of(self.problem, self.x)


class Family:
    """Problems with the vectors of `problem` plus θ times a direction.

    Parameters
    ----------
    problem : LCP, QuadraticProgram or BoundedLeastSquares
    along : mapping from str to number or array
        Changes of the moving vectors per unit of θ.
    ends : (float, float)
        Values of θ at which a path starts and stops.
    tolerance : float or None
        None means `TOLERANCE`.

    Attributes
    ----------
    MOVES : tuple of str
        Names of the vectors that may move.
    FIXED : dict
        Advice for each name that may not move.
    """

    MOVES: ClassVar[tuple[str, ...]] = ()
    TOLERANCE: ClassVar[float] = 1e-8
    FIXED: ClassVar[dict[str, str]] = {}

    def __init__(
        self, problem: Any, along: Any, ends: tuple[float, float], tolerance: float | None
    ) -> None:
        settings = Settings(tolerance=self.TOLERANCE if tolerance is None else tolerance)
        self.problem, self.settings, self.ends = problem, settings, ends
        if not isinstance(along, Mapping) or not along:
            raise InvalidOption(
                f'along must name the data that move, for example {{"q": direction}}, got {along!r}'
            )
        self.directions = {
            str(name): self._check_change(name, change) for name, change in along.items()
        }

    def _check_change(self, name: str, change: Any) -> FloatVector:
        """Return the change of a vector for θ + 1, shape (size,)."""
        kind = type(self.problem).__name__
        if name in self.FIXED:
            raise InvalidOption(f"vectors of {kind} may move, not {name}: {self.FIXED[name]}")
        if name not in self.MOVES:
            raise InvalidOption(
                f"along={{{name!r}: …}} is not a vector of {kind}"
                f"{did_you_mean(name, self.MOVES)}; {', '.join(self.MOVES)} may move"
            )
        now: FloatVector = getattr(self.problem, name)
        step = (
            np.full(now.shape, float(change))
            if is_number(change)
            else checked_vector(change, name, now.size)
        )
        moved = ~np.isfinite(now) & (step != 0.0)
        if moved.any() and is_number(change):
            step = np.where(
                np.isfinite(now), step, 0.0
            )  # one number moves all bounds that there are
        elif moved.any():
            i = int(np.argmax(moved))
            raise InvalidOption(
                f"{name}[{i}] is {now[i]} and cannot move; let along[{name!r}][{i}] be 0"
            )
        return read_only(step)

    @property
    def is_monotone(self) -> bool:
        """True if the solutions at each θ are known to be convex, as for convex problems."""
        return True

    def pair(self, name: str) -> FloatVector:
        """Return a vector of the problem as (constant, slope), shape (2, size)."""
        now = getattr(self.problem, name)
        return np.array([now, self.directions.get(name, np.zeros(now.size))])

    def vectors_at(self, theta: float) -> dict[str, FloatVector]:
        """Return the vectors that move, at θ."""
        moved = {
            name: getattr(self.problem, name) + theta * step
            for name, step in self.directions.items()
        }
        if "upper" in moved:  # bounds that meet may cross by rounding
            moved["upper"] = np.maximum(moved["upper"], moved.get("lower", self.problem.lower))
        elif "lower" in moved:
            moved["lower"] = np.minimum(moved["lower"], self.problem.upper)
        return moved

    def find_crossing(self) -> tuple[float, str]:
        """Return the share of the way at which bounds cross (−1: at start), and a message."""
        low, high = (
            np.array([[1.0, theta] for theta in self.ends]) @ self.pair(name) for name in BOUNDS
        )
        size = np.abs(np.where(np.isfinite(low), low, 0.0)) + np.abs(
            np.where(np.isfinite(high), high, 0.0)
        )
        room = high - low
        room[np.abs(room) <= MET * size] = 0.0
        share = np.where(room[1] < 0.0, room[0] / (room[0] - room[1]), 1.0)
        share = np.where(room[0] < 0.0, -1.0, share)
        row = int(np.argmin(share)) if share.size else 0
        if not share.size or (share[row] == 1.0 and not room[1, row] < 0.0):
            return 1.0, ""
        return float(share[row]), f"lower[{row}] exceeds upper[{row}] beyond"

    def at(self, theta: Any) -> Any:
        """Return the problem at θ."""
        raise NotImplementedError

    @property
    def conditions(self) -> Any:
        """The complementarity problem at θ = 0 whose solution is followed."""
        return self.problem

    def rows(self) -> list[FloatVector]:
        """Return q, lower and upper of the complementarity problem, as pairs."""
        return [self.pair(name) for name in ("q", *BOUNDS)]

    def solve_at(self, theta: Any) -> Any:
        """Return the result of `solve` at θ."""
        return solve(self.at(theta), tolerance=self.settings.tolerance)

    def monotone_graphs(self) -> MonotoneGraphs:
        """Return the parametric complementarity problem in the form that is followed."""
        return MonotoneGraphs.from_bounds(Columns(self.conditions.M), *self.rows())

    def extract_unknowns(self, result: Any) -> FloatVector:
        """Return the unknowns of the complementarity problem from a result of `solve`."""
        return np.asarray(result.x)

    def point(self, theta: Any, z: FloatVector) -> PathPoint:
        """Return the solution at θ from the unknowns of the complementarity problem."""
        raise NotImplementedError

    def x_of(self, z: FloatVector) -> FloatVector:
        """Return the unknowns of the problem class from z, along the last axis."""
        return z

    def objective(self, point: PathPoint) -> float | None:
        """Return the objective at a point; None if the problem class has none."""
        return None

    def judge(self, point: PathPoint) -> Status:
        """Return the status of a point by the criterion of the problem class."""
        raise NotImplementedError

    def case_of(self, steps: Any) -> Any:
        """Return −1 at the lower bound, 0 between, 1 at the upper one."""
        return np.asarray(steps) - 1


class ComplementarityFamily(Family):
    """q and bounds of an LCP."""

    MOVES = ("q", *BOUNDS)
    FIXED: ClassVar[dict[str, str]] = {
        "M": "z is not piecewise affine in M; solve_batch takes a list of problems"
    }

    @cached_property
    def is_monotone(self) -> bool:
        """True if M is positive semidefinite to rounding error; costs one factorization."""
        M = self.problem.M
        return is_semidefinite_to_rounding(M + M.T) is True

    def at(self, theta: Any) -> LCP:
        """Return the problem at θ."""
        moved = self.vectors_at(theta)
        bounds = {name: moved[name] for name in BOUNDS if name in moved}
        problem: LCP = self.problem.with_q(moved.get("q", self.problem.q), **bounds)
        return problem

    def point(self, theta: Any, z: FloatVector) -> PathPoint:
        """Return z at θ, with w."""
        problem = self.at(theta)
        z = np.clip(z, problem.lower, problem.upper)
        return PathPoint(theta, problem, read_only(z), read_only(problem.slack(z)), None, self)

    def judge(self, point: PathPoint) -> Status:
        """Return the status of z by its certificate."""
        if point.certificate.meets(self.settings):
            return Status.SOLVED
        return (
            Status.PRECISION_LIMIT if point.certificate.is_limited_by_rounding else Status.STALLED
        )


class ProgramFamily(Family):
    """c, h, b and bounds of a convex quadratic program, by its optimality conditions."""

    MOVES = ("c", "h", "b", *BOUNDS)
    TOLERANCE = PROGRAM_TOLERANCE
    FIXED: ClassVar[dict[str, str]] = {
        "P": "x is not piecewise affine in P; where θ multiplies the whole quadratic term, divide the objective by it "
        "and move c",
        **{
            name: f"x is not piecewise affine in {name}; solve_batch takes a list of programs"
            for name in "GA"
        },
    }

    def __init__(self, *given: Any) -> None:
        super().__init__(*given)
        refuse_nonconvex(self.problem)

    @cached_property
    def conditions(self) -> LCP:
        """The optimality conditions as a complementarity problem."""
        return conditions(self.problem)

    def at(self, theta: Any) -> QuadraticProgram:
        """Return the problem at θ."""
        problem: QuadraticProgram = self.problem.with_vectors(**self.vectors_at(theta))
        return problem

    def rows(self) -> list[FloatVector]:
        """Return q, lower and upper of the conditions, as pairs."""
        names = "c", "h", "b", *BOUNDS
        c, h, b, lower, upper = map(self.pair, names)
        has_limit, of_rows = np.isfinite(h[0]), np.zeros((len(h), h.shape[1] + b.shape[1]))
        least, most = of_rows.copy(), of_rows.copy()
        least[0, h.shape[1] :], most[0] = -np.inf, np.inf
        most[0, : h.shape[1]][~has_limit] = 0.0
        h[0] = np.where(has_limit, h[0], 0.0)
        return [
            np.concatenate(parts, axis=1) for parts in ((c, h, b), (lower, least), (upper, most))
        ]

    def extract_unknowns(self, result: Any) -> FloatVector:
        """Return x and the multipliers of rows."""
        found = result.solution
        return np.concatenate([found.x, found.inequality, found.equality])

    def point(self, theta: Any, z: FloatVector) -> PathPoint:
        """Return x at θ, with the multipliers."""
        problem, n = self.at(theta), self.problem.n
        x = np.clip(z[:n], problem.lower, problem.upper)
        y = z[n:].copy()
        y[: problem.h.size] = np.maximum(y[: problem.h.size], 0.0)
        left = problem.P @ x + problem.c + problem.matrices.rows.T @ y
        at_lower = np.where((x == problem.lower) & (left > 0.0), left, 0.0)
        at_upper = np.where((x == problem.upper) & (left < 0.0), -left, 0.0)
        solution = QPSolution.of_rows(problem, x, np.concatenate([y, at_lower, at_upper]))
        return PathPoint(theta, problem, solution.x, None, solution, self)

    def x_of(self, z: FloatVector) -> FloatVector:
        """Return x."""
        return z[..., : self.problem.n]

    def objective(self, point: PathPoint) -> float:
        """Return ½ xᵀP x + cᵀx."""
        return float(point.problem.objective(point.x))

    def judge(self, point: PathPoint) -> Status:
        """Return the status by the criterion of programs."""
        tolerance, solution = self.settings.tolerance, point.solution
        assert solution is not None
        if solution.is_optimal(tolerance):
            return Status.SOLVED
        return Status.PRECISION_LIMIT if solution.error <= NEARLY * tolerance else Status.STALLED


class LeastSquaresFamily(Family):
    """b, l1 and bounds of least squares, by the normal equations."""

    MOVES = ("b", "l1", *BOUNDS)
    FIXED: ClassVar[dict[str, str]] = {
        name: f"x is not piecewise affine in {name}; solve_batch takes a list of problems"
        for name in ("A", "weights", "ridge")
    }

    def __init__(self, *given: Any) -> None:
        super().__init__(*given)
        problem = self.problem
        if not problem.has_entries:
            raise UnsuitableProblem(
                "trace needs the entries of A, no LinearOperator; give an array or a sparse array"
            )
        ends = [self.vectors_at(theta) for theta in self.ends]
        l1, lower, upper = (
            [one.get(name, getattr(problem, name)) for one in ends] for name in ("l1", *BOUNDS)
        )
        if (low := np.minimum(*l1)).min(initial=0.0) < 0.0:
            j = int(np.argmin(low))
            raise InvalidOption(
                f"l1 must be ≥ 0, but l1[{j}] = {low[j]} at one end; trace to where it is 0"
            )
        has_penalty = np.maximum(*l1) > 0.0
        self._negative: BoolVector = has_penalty & (np.maximum(*upper) <= 0.0)
        positive = has_penalty & (np.minimum(*lower) >= 0.0) & ~self._negative
        self._has_kink = has_penalty & ~positive & ~self._negative
        crossing = self._has_kink & ((np.maximum(*lower) > 0.0) | (np.minimum(*upper) < 0.0))
        if crossing.any():
            j = int(np.flatnonzero(crossing)[0])
            raise UnsuitableProblem(
                f"a bound of x[{j}], which has a penalty, changes its sign on the way; trace up to there, then on"
            )

    def at(self, theta: float) -> BoundedLeastSquares:
        """Return the problem at θ."""
        moved = self.vectors_at(theta)
        if "l1" in moved:
            moved["l1"] = np.maximum(moved["l1"], 0.0)
        problem: BoundedLeastSquares = self.problem.with_vectors(**moved)
        return problem

    def monotone_graphs(self) -> MonotoneGraphs:
        """Return the normal equations with penalties as a parametric complementarity problem."""
        problem, root = self.problem, self.problem.root_weights
        b, l1, lower, upper = map(self.pair, self.MOVES)
        A = problem.A
        if problem.weights is not None:
            A = (
                sp.csr_array(sp.diags_array(root) @ A)
                if problem.is_sparse
                else root[:, np.newaxis] * A
            )
        q = -np.array([problem.apply_transpose(problem.apply_weights(part)) for part in b])
        q += np.where(self._has_kink, 0.0, np.where(self._negative, -l1, l1))
        return MonotoneGraphs.from_penalty(
            GramColumns(A, problem.ridge), q, lower, upper, l1, self._has_kink
        )

    def point(self, theta: Any, z: FloatVector) -> PathPoint:
        """Return x at θ."""
        problem = self.at(theta)
        return PathPoint(
            theta, problem, read_only(np.clip(z, problem.lower, problem.upper)), None, None, self
        )

    def objective(self, point: PathPoint) -> float:
        """Return the cost."""
        problem = point.problem
        return float(problem.cost(point.x, problem.product(point.x) - problem.b))

    def judge(self, point: PathPoint) -> Status:
        """Return the status by the optimality certificate."""
        tolerance = self.settings.tolerance
        found = Optimality.of(Enclosures(point.problem), point.x, tolerance=tolerance)
        if found.residual <= tolerance:
            return Status.SOLVED
        is_near = found.is_limited or found.residual <= NEARLY * tolerance
        return Status.PRECISION_LIMIT if is_near else Status.STALLED

    def case_of(self, steps: Any) -> Any:
        """Return −1 at the lower bound, 0 between, 1 at the upper bound, 2 at a kink at 0."""
        of_kinks = np.array([-1, 0, 2, 0, 1])
        return np.where(self._has_kink, of_kinks[steps], np.asarray(steps) - 1)


FAMILIES: dict[type, type[Family]] = {
    LCP: ComplementarityFamily,
    QuadraticProgram: ProgramFamily,
    BoundedLeastSquares: LeastSquaresFamily,
}


def family_of(
    problem: Any, along: Mapping[str, Any], start: float, stop: float, tolerance: float | None
) -> Family:
    """Return the family of a problem.

    Raises
    ------
    InvalidOption
        If the problem class has none.
    """
    if not takes("trace", problem):
        raise InvalidOption(refusal("trace", problem))
    family = FAMILIES[type(problem)](problem, along, (start, stop), tolerance)
    if not isinstance(problem, BoundedLeastSquares) and (rows := family.conditions.n) > LARGEST:
        raise UnsuitableProblem(
            f"trace factorizes dense matrices of up to {LARGEST} rows, and this problem has {rows}; "
            "solve_batch(problem, Q) solves at given values"
        )
    return family
