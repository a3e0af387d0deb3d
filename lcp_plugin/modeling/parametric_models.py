"""Paths of problems stated in cvxpy: what a parameter moves is read off, and points lead back to variables."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import cvxpy as cp
import numpy as np
from numpy.typing import ArrayLike

from ..core.checks import FloatVector
from ..core.errors import InvalidOption, UnsupportedModel
from ..core.lcp import LCP
from ..problems.parametric.families import PathPoint, Piece
from ..problems.parametric.path import Path, Slope
from ..problems.parametric.tracing import trace_stated
from ..problems.programs.program import QuadraticProgram
from ._compat import dense, leaf_value, name_of
from .qp_solver import ProgramEntries, QPSolver, quadratic_program
from .registration import build_from, is_complementarity_problem

AFFINE_TO = 1e-9  # of the largest entry: by how much a vector in between may be off the line
BETWEEN = 0.3819660112501051  # where it is looked at
VECTORS = {LCP: ("q", "lower", "upper"), QuadraticProgram: ("c", "h", "b", "lower", "upper")}
MATRICES = {LCP: ("M",), QuadraticProgram: ("P", "G", "A")}
Back = Callable[[Any], dict[int, Any]]


class ModelPoint:
    """The solution of a cvxpy problem at one value of the parameter; ``point[x]`` is that of a variable.

    Attributes
    ----------
    parameter : float
    inner : PathPoint
        Of the LCP or program behind it: status, residuals, multipliers.
    objective : float
        Of the problem as it was stated.
    """

    def __init__(
        self, parameter: float, inner: PathPoint, values: dict[int, Any], objective: float
    ) -> None:
        self.parameter, self.inner, self._values, self.objective = (
            parameter,
            inner,
            values,
            objective,
        )

    @property
    def status(self) -> Any:
        """What the criterion says."""
        return self.inner.status

    @property
    def is_solved(self) -> bool:
        """True where the status is SOLVED."""
        return self.inner.is_solved

    def __getitem__(self, variable: cp.Variable) -> Any:
        """Return the value of a variable, in its shape."""
        return _of_variable(self._values, variable)

    def __repr__(self) -> str:
        return (
            f"ModelPoint({self.parameter:.9g}, {self.status.name}, objective {self.objective:.9g})"
        )


class ModelSlope:
    """How the solution of a cvxpy problem changes with the parameter; ``slope[x]`` is that of a variable.

    Attributes
    ----------
    inner : Slope
        Of the LCP or program behind it, with the multipliers.
    objective : float or None
        Of the problem as it was stated; None for complementarity, which has none.
    """

    def __init__(self, inner: Slope, values: dict[int, Any], objective: float | None) -> None:
        self.inner, self._values, self.objective = inner, values, objective

    def __getitem__(self, variable: cp.Variable) -> Any:
        """Return how a variable changes, in its shape."""
        return _of_variable(self._values, variable)

    def __repr__(self) -> str:
        return f"ModelSlope(objective {self.objective})"


def _of_variable(values: dict[int, Any], variable: cp.Variable) -> Any:
    if variable.id not in values:
        raise UnsupportedModel(
            f"{name_of(variable)} is no variable of the problem; ask for one of its own"
        )
    return values[variable.id]


class ModelPath(Path):
    """The path of a cvxpy problem: that of the LCP or program behind it, with values by variable.

    ``path.at(θ)[x]`` is the value of a variable, ``path.value(x, thetas)`` many of them; pieces and x are those of what
    cvxpy compiles the problem to.
    """

    _problem: Any
    _moved: Moved
    _back: Back

    @classmethod
    def of(cls, path: Path, problem: Any, moved: Moved, back: Back) -> ModelPath:
        """Return a path with the way back."""
        made = cls.__new__(cls)
        made.__dict__.update(path.__dict__, _problem=problem, _moved=moved, _back=back)
        return made

    def at(self, theta: float) -> ModelPoint:  # type: ignore[override]
        """Return the solution at θ; ``path.at(θ)[x]`` is the value of a variable."""
        inner = super().at(theta)
        values, objective = self._stated(theta, self.piece_at(theta))
        return ModelPoint(float(theta), inner, values, objective)

    def _stated(self, theta: float, piece: Piece) -> tuple[dict[int, Any], float]:
        """Return the variables at θ on a piece, and the objective as it was stated."""
        variables = self._problem.variables()
        before = [one.value for one in variables]
        with self._moved.to(float(theta)):
            values = self._back(piece.z_at(float(theta)))
            try:
                for variable in variables:
                    variable.save_value(values[variable.id])
                objective = float(dense(self._problem.objective.value))
            finally:
                for variable, value in zip(variables, before, strict=True):
                    variable.save_value(value)
        return values, objective

    def derivative(self, theta: float, *, side: str = "ahead") -> ModelSlope:  # type: ignore[override]
        """Return how the solution at θ changes with θ; ``path.derivative(θ)[x]`` is that of a variable.

        Variables are affine on a piece. The objective as it was stated is ± that of the program and a term affine in θ.
        """
        inner = super().derivative(theta, side=side)
        piece = self.piece_at(theta, is_behind=side == "behind")
        ends = (piece.begin, piece.end) if piece.end != piece.begin else (self.start, self.start)
        (first, one), (last, other) = (self._stated(end, piece) for end in ends)
        length = ends[1] - ends[0]
        rates = {
            key: (last[key] - value) / length if length else np.zeros_like(value)
            for key, value in first.items()
        }
        if inner.objective is None or not length:
            return ModelSlope(inner, rates, inner.objective)
        sign = -1.0 if isinstance(self._problem.objective, cp.Maximize) else 1.0
        own = [sign * (self.family.point(end, piece.z_at(end)).objective or 0.0) for end in ends]
        offset = ((other - own[1]) - (one - own[0])) / length
        return ModelSlope(inner, rates, sign * inner.objective + offset)

    def value(self, variable: cp.Variable, thetas: ArrayLike) -> Any:
        """Return the values of a variable at many θ, shape (k, *its shape)."""
        return np.array(
            [self.at(float(theta))[variable] for theta in np.atleast_1d(np.asarray(thetas))]
        )


class Moved:
    """Parameters that are their values plus θ times a direction.

    Parameters
    ----------
    problem : cvxpy.Problem
    along : Parameter, or mapping from Parameter to direction
        θ is the value of a lone Parameter, which has one entry.
    """

    def __init__(self, problem: Any, along: Any) -> None:
        if isinstance(along, cp.Parameter):
            if along.size != 1:
                raise InvalidOption(
                    f"{name_of(along)} has {along.size} entries: write along={{parameter: direction}}, which is added "
                    "to its present value"
                )
            self._lines = {along: (np.zeros(along.shape), np.ones(along.shape))}
        elif (
            isinstance(along, Mapping)
            and along
            and all(isinstance(one, cp.Parameter) for one in along)
        ):
            if lacking := [one for one in along if one.value is None]:
                raise InvalidOption(
                    f"{name_of(lacking[0])} has no value, to which the direction is added; give it one"
                )
            self._lines = {
                one: (
                    np.array(leaf_value(one), dtype=float),
                    np.broadcast_to(np.asarray(step, float), one.shape),
                )
                for one, step in along.items()
            }
        else:
            raise InvalidOption(
                f"along of a cvxpy problem is a Parameter, or {{parameter: direction}}, got {along!r}"
            )
        known = {one.id for one in problem.parameters()}
        if strange := [one for one in self._lines if one.id not in known]:
            raise InvalidOption(f"{name_of(strange[0])} is no parameter of the problem")

    @contextmanager
    def to(self, theta: float) -> Iterator[None]:
        """Give the parameters their values at θ, and those of before again."""
        before = {one: one.value for one in self._lines}
        try:
            for one, (base, step) in self._lines.items():
                try:
                    one.value = base + theta * step
                except ValueError as error:
                    raise InvalidOption(
                        f"{name_of(one)} cannot be what it is at {theta:.6g}: {error}"
                    ) from error
            yield
        finally:
            for one, value in before.items():
                one.value = value


def trace_model(
    problem: Any, along: Any, start: float, stop: float, tolerance: float = 1e-8
) -> ModelPath:
    """Return the path of a cvxpy problem; see :func:`lcp_plugin.trace`.

    Raises
    ------
    UnsupportedModel
        Where the parameter stands in a matrix, or not affinely.
    """
    moved = Moved(problem, along)
    stated = _pairs if is_complementarity_problem(problem) else _program
    other = stop if stop != start else start + 1.0
    values = (start, other, start + BETWEEN * (other - start))
    found = []
    for theta in values:
        with moved.to(theta):
            found.append(stated(problem))
    (first, back), (last, _), (middle, _) = found
    base, directions = _line(first, last, middle, values)
    path = trace_stated(base, directions, start, stop, tolerance)
    return ModelPath.of(path, problem, moved, back)


def _pairs(problem: Any) -> tuple[LCP, Back]:
    model = build_from(problem)
    return model.lcp("trace"), lambda z: build_from(problem).values(z)


def _program(problem: Any) -> tuple[QuadraticProgram, Back]:
    # With parameters as numbers: what cvxpy keeps of the value before is not that of an expression which bends.
    data, chain, inverse = problem.get_problem_data(QPSolver, ignore_dpp=True)
    program = quadratic_program(data)
    entries = ProgramEntries.of(problem, program, data, chain, inverse).variables
    if entries is None:
        raise UnsupportedModel(
            "cvxpy made a program in which a variable is not found again; use plain variables"
        )
    return program, lambda z: {key: one.taken(z) for key, one in entries.items()}


def _line(
    first: Any, last: Any, middle: Any, values: tuple[float, float, float]
) -> tuple[Any, dict[str, FloatVector]]:
    """Return the problem at θ = 0 and the directions of its vectors, or raise where they are no line."""
    kind = type(first)
    for name in MATRICES[kind]:
        one = getattr(first, name)
        for other in (last, middle):
            if (
                one.shape != getattr(other, name).shape
                or abs(one - getattr(other, name)).sum() != 0.0
            ):
                remedy = "where it multiplies the quadratic term, divide the objective by it"
                remedy = remedy if name == "P" else "let it multiply no variable of a constraint"
                raise UnsupportedModel(
                    f"the parameter stands in the matrix {name} of what cvxpy makes of the problem, so that the path "
                    f"is not piecewise affine; {remedy}"
                )
    begin, end, between = values
    base, directions = {}, {}
    for name in VECTORS[kind]:
        one, other, seen = (getattr(each, name) for each in (first, last, middle))
        moves = np.isfinite(one) & np.isfinite(other) & np.isfinite(seen)
        here, there, inside = (np.where(moves, part, 0.0) for part in (one, other, seen))
        slope = (there - here) / (end - begin)
        off = np.abs(here + (between - begin) * slope - inside)
        is_fixed = (one == other) & (one == seen)
        if (off > AFFINE_TO * np.abs(inside).max(initial=0.0)).any() or not (
            moves | is_fixed
        ).all():
            raise UnsupportedModel(
                f"{name} of what cvxpy makes of the problem is not affine in the parameter between {begin:.6g} and "
                f"{end:.6g}; make the expression that bends a parameter of its own"
            )
        base[name] = np.where(moves, here - begin * slope, one)
        if slope.any():
            directions[name] = slope
    if not directions:
        directions = {VECTORS[kind][0]: np.zeros(base[VECTORS[kind][0]].size)}
    if kind is LCP:
        return first.with_q(base["q"], lower=base["lower"], upper=base["upper"]), directions
    return first.with_vectors(**base), directions
