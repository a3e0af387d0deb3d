"""Paths of cvxpy problems: parametric vectors are measured, points map back to variables."""

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
from ..problems.parametric.path import Path
from ..problems.parametric.tracing import trace_stated
from ..problems.programs.program import QuadraticProgram
from ._compat import dense, leaf_value, name_of
from .qp_solver import CompiledProblem
from .registration import build_from, is_complementarity_problem

AFFINE_TO = 1e-9  # of the largest entry: by how much a vector in between may be off the line
BETWEEN = 0.3819660112501051  # position of the test point between start and stop
VECTORS = {LCP: ("q", "lower", "upper"), QuadraticProgram: ("c", "h", "b", "lower", "upper")}
MATRICES = {LCP: ("M",), QuadraticProgram: ("P", "G", "A")}
Back = Callable[[Any], dict[int, Any]]
Lines = dict[cp.Parameter, tuple[FloatVector, FloatVector]]


class ModelPath(Path):
    """Path of a cvxpy problem, with values of the variables and the objective.

    Pieces, ``at(θ)`` and ``derivative(θ)`` belong to the LCP or program that cvxpy's problem becomes.
    """

    _problem: Any
    _lines: Lines
    _back: Back

    @classmethod
    def of(cls, path: Path, problem: Any, lines: Lines, back: Back) -> ModelPath:
        """Return a path with a map back to cvxpy's variables."""
        made = cls.__new__(cls)
        made.__dict__.update(path.__dict__, _problem=problem, _lines=lines, _back=back)
        return made

    def value(self, variable: cp.Variable, theta: ArrayLike) -> Any:
        """Return the value of a variable at θ, in its shape; at k values of θ shape (k, *its shape)."""
        found = [self._values(one) for one in np.ravel(np.asarray(theta, float)).tolist()]
        if any(variable.id not in values for values in found):
            raise UnsupportedModel(
                f"{name_of(variable)} is not a variable of the problem; pass one of its variables"
            )
        return np.reshape([one[variable.id] for one in found], (*np.shape(theta), *variable.shape))

    def objective(self, thetas: ArrayLike) -> FloatVector:
        """Return the value of the user's objective at many θ, shape (k,)."""
        variables = self._problem.variables()
        before, found = [one.value for one in variables], []
        try:
            for theta in np.ravel(np.asarray(thetas, float)).tolist():
                values = self._values(theta)
                for variable in variables:
                    variable.save_value(values[variable.id])
                with moved_to(self._lines, theta):
                    found.append(float(dense(self._problem.objective.value)))
        finally:
            for variable, value in zip(variables, before, strict=True):
                variable.save_value(value)
        return np.array(found)

    def _values(self, theta: float) -> dict[int, Any]:
        with moved_to(self._lines, theta):
            return self._back(self.piece_at(theta).z_at(theta))


def parameter_lines(problem: Any, along: Any) -> Lines:
    """Return value and direction of each parameter that moves: it is value + θ · direction.

    Parameters
    ----------
    problem : cvxpy.Problem
    along : Parameter, or mapping from Parameter to direction
        θ is the value of a lone Parameter, which has one entry.
    """
    if isinstance(along, cp.Parameter):
        if along.size != 1:
            raise InvalidOption(
                f"{name_of(along)} has {along.size} entries: write along={{parameter: direction}}, which is added "
                "to its present value"
            )
        lines = {along: (np.zeros(along.shape), np.ones(along.shape))}
    elif isinstance(along, Mapping) and along and all(isinstance(p, cp.Parameter) for p in along):
        if lacking := [one for one in along if one.value is None]:
            raise InvalidOption(
                f"{name_of(lacking[0])} has no value, to which the direction is added; give it one"
            )
        steps = {p: np.broadcast_to(np.asarray(step, float), p.shape) for p, step in along.items()}
        lines = {one: (np.array(leaf_value(one), float), step) for one, step in steps.items()}
    else:
        raise InvalidOption(
            f"along of a cvxpy problem is a Parameter, or {{parameter: direction}}, got {along!r}"
        )
    known = {one.id for one in problem.parameters()}
    if strange := [one for one in lines if one.id not in known]:
        raise InvalidOption(
            f"{name_of(strange[0])} is not a parameter of the problem; pass one of its parameters"
        )
    return lines


@contextmanager
def moved_to(lines: Lines, theta: float) -> Iterator[None]:
    """Give the parameters their values at θ, and restore the previous values at the end."""
    before = {one: one.value for one in lines}
    try:
        for one, (base, step) in lines.items():
            try:
                one.value = base + theta * step
            except ValueError as error:
                raise InvalidOption(
                    f"{name_of(one)} does not accept its value at θ = {theta:.6g}: {error}"
                ) from error
        yield
    finally:
        for one, value in before.items():
            one.value = value


def trace_model(
    problem: Any, along: Any, start: float, stop: float, tolerance: float | None = None
) -> ModelPath:
    """Return the path of a cvxpy problem; see :func:`lcp_plugin.trace`.

    Raises
    ------
    UnsupportedModel
        If a matrix depends on the parameter, or a vector depends on it not affinely.
    """
    lines = parameter_lines(problem, along)
    stated = _pairs if is_complementarity_problem(problem) else _program
    other = stop if stop != start else start + 1.0
    values = (start, other, start + BETWEEN * (other - start))
    found = []
    for theta in values:
        with moved_to(lines, theta):
            found.append(stated(problem))
    (first, back), (last, _), (middle, _) = found
    base, directions = _line(first, last, middle, values)
    path = trace_stated(base, directions, start, stop, tolerance)
    return ModelPath.of(path, problem, lines, back)


def _pairs(problem: Any) -> tuple[LCP, Back]:
    model = build_from(problem)
    return model.lcp("trace"), lambda z: build_from(problem).values(z)


def _program(problem: Any) -> tuple[QuadraticProgram, Back]:
    # With parameters as numbers: for an expression that is not affine, cvxpy's cache may be of an old value.
    compiled = CompiledProblem.of(problem, is_folded=True, ignore_dpp=True)
    return compiled.program, compiled.values


def _line(
    first: Any, last: Any, middle: Any, values: tuple[float, float, float]
) -> tuple[Any, dict[str, FloatVector]]:
    """Return the problem at θ = 0 and its vectors' directions; raise if they are not affine."""
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
                    f"the parameter enters the matrix {name} of the program that cvxpy compiles, so the path is not "
                    f"piecewise affine; {remedy}"
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
                f"{name} of the program that cvxpy compiles is not affine in the parameter between {begin:.6g} and "
                f"{end:.6g}; make the nonlinear expression a parameter"
            )
        base[name] = np.where(moves, here - begin * slope, one)
        if slope.any():
            directions[name] = slope
    if not directions:
        directions = {VECTORS[kind][0]: np.zeros(base[VECTORS[kind][0]].size)}
    if kind is LCP:
        return first.with_q(base["q"], lower=base["lower"], upper=base["upper"]), directions
    return first.with_vectors(**base), directions
