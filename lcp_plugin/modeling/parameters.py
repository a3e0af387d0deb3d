"""The derivative of the solution of a cvxpy model by its parameters: ``lcp_plugin.derivative(problem)``.

It chains the LCP's derivative at the solution with the derivative of the LCP's data by the parameters. With z held,
a parameter enters M and q only through the residual F(x; p) = M(p) z + q(p): with μ the gradient by q,
dL = μᵀ ∂F/∂p, wherever p enters F. Substituted definitions return as additional rows:
D u + … = 0 for the defined unknowns u moves them by −D⁻¹ ∂(D u + …)/∂p.

Paths of cvxpy problems: parametric vectors are measured, points map back to variables.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import cvxpy as cp
import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike, NDArray
from scipy.sparse.linalg import splu

from ..core.checks import Vector, derived_property
from ..core.errors import InvalidOption, UnsuitableProblem, UnsupportedModel
from ..core.lcp import LCP
from ..expressions.rows import Program
from ..problems.cones.data import Blocks
from ..problems.nonlinear.data import NonlinearProblem
from ..problems.parametric.path import Path, PathPoint, Piece
from ..problems.parametric.tracing import trace_stated
from ..problems.programs.program import QuadraticProgram
from ..problems.sensitivity import derivative
from ..solving.result import Result
from . import _compat
from ._compat import by_columns, expression_of, leaf_value, name_of
from .model import DualReport, Model, spans_of
from .qp_solver import CompiledProblem
from .reading import Reader, restricting_attribute
from .registration import build_from, is_complementarity_problem

Changes = dict[int, Any]


class ParametricRows:
    """Expressions as functions of their parameters, with the variables held.

    Parameters
    ----------
    expressions : iterable of cvxpy expression
    known : dict
        Values by the id of a variable or parameter; all others have their present values.

    Examples
    --------
    >>> p, x = cp.Parameter(2), cp.Variable(2)
    >>> F = cp.multiply(p**2, x)
    >>> parametric = ParametricRows([F], {p.id: np.array([2.0, 3.0]), x.id: np.array([5.0, 7.0])})
    >>> parametric.change({p.id: np.ones(2)}), parametric.gradient(np.ones(2))[p.id]
    (array([20., 42.]), array([20., 42.]))
    """

    def __init__(self, expressions: Iterable[Any], known: Changes) -> None:
        reader, each = Reader(held=known), {id(one): one for one in expressions}
        self._parameters = {p.id: p for one in each.values() for p in one.parameters()}
        self._spans, n = spans_of(self._parameters)
        #: Slice of each expression among all entries, by its id.
        self.spans, self.size = spans_of(each)
        starts = {key: span.start for key, span in self._spans.items()}
        self._program = Program.of(
            reader.compiler, [reader.rows(one) for one in each.values()], starts, n
        )
        self._at = self._vector(
            {key: known.get(key, _compat.leaf_value(p)) for key, p in self._parameters.items()}
        )

    def change(self, changes: Changes) -> Vector:
        """Return the change of the expressions by changes of parameters; missing ones are 0."""
        return self._finite(self._program.jacobian(self._at) @ self._vector(changes))

    def gradient(self, gradient: Vector) -> Changes:
        """Return the gradients by parameters, by id, from the gradient by the expressions."""
        found = self._finite(self._program.gradient(self._at, gradient))
        return {
            key: found[self._spans[key]].reshape(p.shape, order="F")
            for key, p in self._parameters.items()
        }

    def _vector(self, values: Changes) -> Vector:
        parts = [values.get(key, np.zeros(one.size)) for key, one in self._parameters.items()]
        return np.concatenate([*map(_compat.by_columns, parts), np.zeros(0)])

    @staticmethod
    def _finite(values: Any) -> Any:
        if not np.isfinite(values).all():
            raise UnsupportedModel(
                "the model has no finite derivative at the present values of its parameters; move them away from the "
                "edge of what its atoms accept"
            )
        return values


class ModelDerivative:
    """The derivative of variables and dual values by parameters; made by ``lcp_plugin.derivative(problem)``.

    It is one class because both products use the same derivatives of rows, bounds and values.

    Parameters
    ----------
    model : Model
    result : Result
    parameters : list of cvxpy.Parameter
    """

    def __init__(self, model: Model, result: Result, parameters: list[Any]) -> None:
        self._model, self._result, self._parameters = model, result, parameters

    def __repr__(self) -> str:
        parameters = ", ".join(one.name() for one in self._parameters)
        return (
            f"ModelDerivative({len(self._model.variables)} variables by {parameters or 'nothing'})"
        )

    @property
    def is_unique(self) -> bool | None:
        """True if the derivative exists, so that jvp is linear; None if that is unknown (over cones)."""
        found: bool | None = self._at.is_unique
        return found

    @property
    def advice(self) -> str:
        """Warning that the derivative is not unique, with the names of unknowns that are not determined; or ""."""
        return getattr(self._at, "advice", "")

    def jvp(self, changes: Mapping[Any, Any] | None = None, **by_name: Any) -> dict[Any, Any]:
        """Return the change of each variable, and of the dual value of each constraint, by parameter changes.

        Parameters
        ----------
        changes : dict
            Change of a parameter, in its shape; parameters that are missing do not change.
        **by_name
            None: parameters of cvxpy need not have different names.

        Raises
        ------
        UnsupportedModel
            If a key is not a parameter of the model, or a change is not finite or has another shape.
        """
        model, at = self._model, self._at
        given = self._checked({**(changes or {}), **by_name}, self._parameters, "change")
        changed = self._parametric.change(given)
        rows, moved = changed[self._rows], np.zeros(model.square.elimination.offset.size)
        if self._definitions is not None:
            matrix, defining, solved = self._definitions
            moved[model.square.elimination.columns] = -solved(rows[defining], "N")
            rows = rows + matrix @ moved
        h = model.square.signs * rows[self._left]
        dlower, dupper = np.split(self._bounds @ changed, 2)
        of_friction = {"dfriction": self._friction @ changed} if model.friction else {}
        dz = at.jvp(dq=h, dlower=dlower, dupper=dupper, **of_friction)
        dw = model.square.elimination.expand_slack(at.dw(dz, dq=h))
        du = moved + model.square.elimination.expand_change(dz)
        values = model.split(du)
        found = {variable: values[variable.id] for variable in model.variables}
        for report in model.reports:
            change = report.scale * (dw if report.is_slack else du)[report.columns]
            if report.expression is not None:
                change = change + changed[self._parametric.spans[id(report.expression)]]
            found[report.constraint] = change.reshape(report.shape, order="F")
        return found

    def vjp(self, gradients: Mapping[Any, Any]) -> dict[Any, Any]:
        """Return the gradient by each parameter of a function of the solution.

        Parameters
        ----------
        gradients : dict
            Gradient of the function by a variable, or by the dual value of a constraint; 0 if missing.

        Raises
        ------
        UnsupportedModel
            If a key is neither a variable nor a constraint, or a gradient is not finite or has another shape.
        """
        model, total = self._model, np.zeros(self._parametric.size)
        owners = [*model.variables, *(report.constraint for report in model.reports)]
        given = self._checked(gradients, owners, "gradient")
        by_unknown, by_slack = np.zeros((2, model.square.elimination.offset.size))
        for variable in model.variables:
            by_unknown[model.spans[variable.id]] = np.ravel(given.get(variable.id, 0.0), order="F")
        for report in model.reports:
            if (own := given.get(report.constraint.id)) is not None:
                own = np.ravel(own, order="F")
                np.add.at(
                    by_slack if report.is_slack else by_unknown, report.columns, report.scale * own
                )
                if report.expression is not None:
                    total[self._parametric.spans[id(report.expression)]] += own
        kept, expansion = model.square.elimination.kept, model.square.elimination.expansion
        g = by_unknown[kept] if expansion is None else expansion.T @ by_unknown
        gradient = self._at.vjp(g, by_slack[kept])
        rows = np.zeros(self._rows.size)
        rows[self._left] = model.square.signs * gradient.q
        if self._definitions is not None:
            matrix, defining, solved = self._definitions
            rows[defining] = -solved(
                (by_unknown + matrix.T @ rows)[model.square.elimination.columns], "T"
            )
        np.add.at(total, self._rows, rows)
        total += self._bounds.T @ np.concatenate([gradient.lower, gradient.upper])
        if model.friction:
            total += self._friction.T @ gradient.friction
        found = self._parametric.gradient(total)
        return {one: found.get(one.id, np.zeros(one.shape)) for one in self._parameters}

    @staticmethod
    def _checked(given: Mapping[Any, Any], owners: list[Any], what: str) -> Changes:
        """Return the arrays that a user gave, by the ids of their owners."""
        found: Changes = {}
        for owner, value in given.items():
            if not any(owner is one for one in owners):
                instead = ", the objects and not their names" if isinstance(owner, str) else ""
                raise UnsupportedModel(
                    f"{_compat.name_of(owner)} has no {what} here; give one of "
                    f"{', '.join(map(_compat.name_of, owners))}{instead}"
                )
            array = np.asarray(value)
            if (
                array.dtype.kind not in "fiu"
                or array.shape != owner.shape
                or not np.isfinite(array).all()
            ):
                raise UnsupportedModel(
                    f"the {what} of {_compat.name_of(owner)} must be finite real numbers of its shape {owner.shape}, "
                    f"got {value!r}"
                )
            found[owner.id] = array.astype(np.float64)
        return found

    @derived_property
    def _at(self) -> Any:  # a Derivative, or a ConeDerivative
        # with compiled kernels, which a model alone does not need
        return derivative(self._result)

    @derived_property
    def _parametric(self) -> ParametricRows:
        """Expressions that depend on parameters, at the values of the solution."""
        model = self._model
        stated = [part for _, _, *parts in model.bounds for part in parts]
        shifts = [report.expression for report in model.reports]
        known = model.values(self._at.z)
        every = [*self._functions, *stated, *shifts, *(one for one, _ in model.friction)]
        return ParametricRows([one for one in every if isinstance(one, cp.Expression)], known)

    @property
    def _functions(self) -> list[Any]:
        """The expressions of the model's rows: pairs first, then equations."""
        statement = self._model.statement
        return [one.origin for one in (*statement.pairs, *statement.rows)]

    @derived_property
    def _rows(self) -> NDArray[np.int64]:
        """The positions of the rows of pairs and equations among the parametric expressions."""
        spans = [self._parametric.spans[id(one)] for one in self._functions]
        return np.concatenate(
            [*(np.arange(span.start, span.stop) for span in spans), np.zeros(0, dtype=np.int64)]
        )

    @derived_property
    def _left(self) -> NDArray[np.int64]:
        """The row of the model that each row of the LCP is, up to its sign."""
        first = self._model.square.stored[0].shape[0]
        rows = np.delete(np.arange(self._rows.size), first + self._model.square.elimination.rows)
        return rows[self._model.square.places]

    @derived_property
    def _definitions(
        self,
    ) -> tuple[sp.csr_array, NDArray[np.int64], Callable[[Vector, str], Vector]] | None:
        """Rows of the model, including definitions, and solves with these and their transpose."""
        elimination, (first, second) = self._model.square.elimination, self._model.square.stored
        if elimination.expansion is None:
            return None
        solved = splu(sp.csc_array(second[elimination.rows][:, elimination.columns])).solve
        return sp.csr_array(sp.vstack([first, second])), first.shape[0] + elimination.rows, solved

    @derived_property
    def _bounds(self) -> sp.csr_array:
        """The change of the lower, then of the upper bounds, by the change of their expressions."""
        model, spans = self._model, self._parametric.spans
        n, kept = model.square.elimination.offset.size, model.square.elimination.kept
        last = np.zeros(n, dtype=np.int64)
        for k, (columns, *_) in enumerate(model.bounds):
            last[columns] = k
        parts = [(np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64), np.zeros(0))]
        for k, (columns, scale, expression, *ends) in enumerate(model.bounds):
            own = np.flatnonzero(last[columns] == k)
            weights = np.broadcast_to(scale, columns.size)[own]
            for is_end, bound in enumerate(ends):
                is_upper = (weights > 0.0) == is_end
                for part, sign in ((expression, -1.0), (bound, 1.0)):
                    if isinstance(part, cp.Expression):
                        places = spans[id(part)].start + (own if part.size > 1 else 0 * own)
                        parts.append((columns[own] + n * is_upper, places, sign / weights))
        rows, columns, data = (np.concatenate(part) for part in zip(*parts, strict=True))
        matrix = sp.csr_array(
            sp.coo_array((data, (rows, columns)), shape=(2 * n, self._parametric.size))
        )
        return matrix[np.concatenate([kept, n + kept])]

    @derived_property
    def _friction(self) -> sp.csr_array:
        """The change of the coefficients of friction by the change of their expressions."""
        columns = [np.zeros(0, dtype=np.int64)]
        for one, count in self._model.friction:
            span = self._parametric.spans.get(id(one), slice(-1, 0))
            columns.append(span.start + np.arange(count) * (span.stop - span.start > 1))
        places = np.concatenate(columns)
        stated = np.flatnonzero(places >= 0)
        shape = places.size, self._parametric.size
        return sp.csr_array((np.ones(stated.size), (stated, places[stated])), shape=shape)


def derivative_of(problem: cp.Problem) -> ModelDerivative:
    """Return the derivative of a solved cvxpy model; see :func:`lcp_plugin.derivative`.

    Raises
    ------
    UnsupportedModel
        If the problem has no complementarity, another solver solved it last, its parameters have other values now,
        or a parameter has entries that are tied to each other.
    UnsuitableProblem
        If the last solve found no solution.
    """
    if not is_complementarity_problem(problem):
        raise UnsupportedModel(
            "derivative takes a cvxpy problem with complementarities; of a program use cvxpy's "
            "problem.solve(requires_grad=True), or state its optimality conditions with complements"
        )
    parameters = differentiable_parameters(problem)
    result = getattr(problem.solver_stats, "extra_stats", None)
    if not isinstance(result, Result):
        raise UnsupportedModel(
            'derivative needs a solution of complementarities alone; call problem.solve(method="LCP") first, with the '
            "objective cp.Minimize(0)"
        )
    if not result.is_solved:
        raise UnsuitableProblem(
            f"only a solution has a derivative, and this run ended {result.status.name}: {result.advice}"
        )
    model = build_from(problem)
    if not _is_solved_by(model, result):
        raise UnsupportedModel(
            "the parameters have other values than at the last solve; solve the problem again"
        )
    model.reports += [report for agent in model.agents for report in _bounds_of(agent, model)]
    return ModelDerivative(model, result, parameters)


def _bounds_of(agent: Any, model: Model) -> Iterator[DualReport]:
    """Yield the dual values of constraints that bound decisions of an agent: −w/a if a x ≤ a u is active."""
    conditions = agent.conditions
    own = next(one for one in model.reports if one.constraint is conditions.stationarity)
    duals = conditions.duals()
    for one in conditions.bounds:
        if one.rows is not None and isinstance(one.rows.kept, slice):
            row, dual = one.rows.origin, by_columns(duals[one.rows.origin.id])
            scale = np.where(dual != 0.0, -1.0 / one.weights, 0.0)
            columns, shape = own.columns[one.places], expression_of(row).shape
            yield DualReport(row, columns, shape, is_slack=True, scale=scale)


def _is_solved_by(model: Model, result: Result) -> bool:
    """Return whether the result belongs to the model with the present values of its parameters."""
    now: Any = model.problem
    z, w, rows = result.z, result.w, now.rows if isinstance(now, Blocks) else now
    then: Any = result.certificate.problem if rows is now else getattr(result, "problem", None)
    slack = now.value(z) if isinstance(now, NonlinearProblem) else rows.M @ z + rows.q
    size = 1.0 + np.abs(z).max(initial=0.0) + np.abs(w).max(initial=0.0)
    # A larger difference shows that parameters have changed since the solve
    return bool((np.abs(slack - w) <= 1e-8 * size).all()) and all(
        np.array_equal(getattr(now, name, 0.0), getattr(then, name, 0.0))
        for name in ("lower", "upper", "friction")
    )


def differentiable_parameters(problem: cp.Problem) -> list[Any]:
    """Return the parameters of a problem, including the parameters in bounds of variables.

    Raises
    ------
    UnsupportedModel
        If one is an integer, a Boolean or complex, or has entries that are tied to each other.
    """
    bounds = [end for one in problem.variables() for end in one.attributes.get("bounds") or ()]
    owners = [problem, *(end for end in bounds if isinstance(end, cp.Expression))]
    parameters = list({p.id: p for owner in owners for p in owner.parameters()}.values())
    for parameter in parameters:
        if name := restricting_attribute(parameter):
            raise UnsupportedModel(
                f"parameter {parameter.name()} has the attribute {name!r}, so that its entries cannot move freely "
                "and have no gradients of their own; use a plain parameter, nonneg or with bounds, and build the "
                "matrix from it"
            )
    return parameters


VECTORS = {LCP: ("q", "lower", "upper"), QuadraticProgram: ("c", "h", "b", "lower", "upper")}
MATRICES = {LCP: ("M",), QuadraticProgram: ("P", "G", "A")}
Back = Callable[[Any], dict[int, Any]]
Lines = dict[cp.Parameter, tuple[Vector, Vector]]


class ModelPath(Path):
    """Path of a cvxpy problem, with values of the variables.

    Pieces, ``at(θ)`` and ``derivative(θ)`` belong to the LCP or program that cvxpy's problem becomes.
    """

    _lines: Lines
    _back: Back
    _problem: Any

    @classmethod
    def of(cls, path: Path, lines: Lines, back: Back, problem: cp.Problem) -> ModelPath:
        """Return a path with a map back to cvxpy's variables."""
        made = cls.__new__(cls)
        made.__dict__.update(path.__dict__, _lines=lines, _back=back, _problem=problem)
        return made

    def at(self, theta: float, piece: Piece | None = None) -> PathPoint:
        """Return the point at θ; the objective has the constant and the sense of the cvxpy problem."""
        point = super().at(theta, piece)
        if point.solution is not None:
            with moved_to(self._lines, float(theta)):
                value = _program(self._problem)[0].objective(point.x)
            point = replace(point, stated_objective=_compat.sense_of(self._problem) * value)
        return point

    def value(self, variable: cp.Variable, theta: ArrayLike) -> Any:
        """Return the value of a variable at θ, in its shape; at k values of θ shape (k, *its shape)."""
        found = [self._values(one) for one in np.ravel(np.asarray(theta, float)).tolist()]
        if any(variable.id not in values for values in found):
            raise UnsupportedModel(
                f"{name_of(variable)} is not a variable of the problem; pass one of its variables"
            )
        return np.reshape([one[variable.id] for one in found], (*np.shape(theta), *variable.shape))

    def _values(self, theta: float) -> dict[int, Any]:
        with moved_to(self._lines, theta):
            return self._back(self.piece_at(theta).z_at(theta))


def parameter_lines(problem: cp.Problem, along: object) -> Lines:
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
    problem: cp.Problem, along: object, start: float, stop: float, tolerance: float | None = None
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
    # A test point that no simple fraction hits
    values = (start, other, start + 0.3819660112501051 * (other - start))
    found = []
    for theta in values:
        with moved_to(lines, theta):
            found.append(stated(problem))
    (first, back), (last, _), (middle, _) = found
    base, directions = _line(first, last, middle, values)
    path = trace_stated(base, directions, start, stop, tolerance)
    return ModelPath.of(path, lines, back, problem)


def _pairs(problem: cp.Problem) -> tuple[LCP, Back]:
    model = build_from(problem)
    return model.lcp("trace"), lambda z: build_from(problem).values(z)


def _program(problem: cp.Problem) -> tuple[QuadraticProgram, Back]:
    # With parameters as numbers: for an expression that is not affine, cvxpy's cache may be of an old value.
    compiled = CompiledProblem.of(problem, is_folded=True, ignore_dpp=True)
    return compiled.program, compiled.values


def _line(
    first: Any, last: Any, middle: Any, values: tuple[float, float, float]
) -> tuple[Any, dict[str, Vector]]:
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
        # A vector in between is off the line by more than rounding
        if (off > 1e-9 * np.abs(inside).max(initial=0.0)).any() or not (moves | is_fixed).all():
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
