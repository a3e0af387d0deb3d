"""The derivative of the solution of a cvxpy model by its parameters: ``lcp_plugin.derivative(problem)``.

It chains the LCP's derivative at the solution with the derivative of the LCP's data by the parameters. With z held,
a parameter enters M and q only through the residual F(x; p) = M(p) z + q(p): with μ the gradient by q,
dL = μᵀ ∂F/∂p, wherever p enters F. Substituted definitions return as additional rows:
D u + … = 0 for the defined unknowns u moves them by −D⁻¹ ∂(D u + …)/∂p.

Paths of cvxpy problems are here also: parametric vectors are measured, points map back to variables.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import cvxpy as cp
import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike
from scipy.sparse.linalg import splu

from ..core.checks import Indices, Vector, derived_property, fill
from ..core.errors import InvalidOption, UnsuitableProblem, UnsupportedModel
from ..core.lcp import LCP
from ..core.names import listed
from ..expressions.rows import Program
from ..problems.cones.data import Blocks
from ..problems.nonlinear.data import NonlinearProblem
from ..problems.parametric.path import Path, PathPoint, Piece
from ..problems.parametric.tracing import trace_stated
from ..problems.programs.program import QuadraticProgram
from ..problems.sensitivity import derivative
from ..solving.result import Result
from ._compat import by_columns, by_id, leaf_value, name_of, sense_of
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
        reader, roots = Reader(held=known), {id(root): root for root in expressions}
        self._parameters = by_id(p for root in roots.values() for p in root.parameters())
        self._spans, n = spans_of(self._parameters)
        #: Slice of each expression among all entries, by its id.
        self.spans, self.size = spans_of(roots)
        starts = {key: span.start for key, span in self._spans.items()}
        rows = [reader.rows(root) for root in roots.values()]
        self._program = Program.of(reader.compiler, rows, starts, n)
        held = {key: known.get(key, leaf_value(p)) for key, p in self._parameters.items()}
        self._at = self._vector(held)

    def change(self, changes: Changes) -> Vector:
        """Return the change of the expressions by changes of parameters; missing ones are 0."""
        return self._finite(self._program.jacobian(self._at) @ self._vector(changes))

    def gradient(self, gradient: Vector) -> Changes:
        """Return the gradients by parameters, by id, from the gradient by the expressions."""
        gradients = self._finite(self._program.gradient(self._at, gradient))
        parts = self._parameters.items()
        return {k: gradients[self._spans[k]].reshape(p.shape, order="F") for k, p in parts}

    def _vector(self, values: Changes) -> Vector:
        parts = [values.get(key, np.zeros(p.size)) for key, p in self._parameters.items()]
        return np.concatenate([*map(by_columns, parts), np.zeros(0)])

    @staticmethod
    def _finite(values: Any) -> Any:
        if not np.isfinite(values).all():
            raise UnsupportedModel(
                "the model has no finite derivative at the present parameters; move them away from the edge of a domain"
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
        names = ", ".join(parameter.name() for parameter in self._parameters) or "nothing"
        return f"ModelDerivative({len(self._model.variables)} variables by {names})"

    @property
    def is_unique(self) -> bool | None:
        """True if the derivative exists, so that jvp is linear; None if that is unknown (over cones)."""
        return self._at.is_unique

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
            Changes by the names of parameters; the last of several with one name counts.

        Raises
        ------
        UnsupportedModel
            If a key is not a parameter of the model, or a change is not finite or has another shape.
        """
        model, at, elimination = self._model, self._at, self._model.square.elimination
        of_parameters = self._checked({**(changes or {}), **by_name}, self._parameters, "change")
        changed = self._parametric.change(of_parameters)
        rows, moved = changed[self._rows], np.zeros(elimination.offset.size)
        if self._definitions is not None:
            matrix, defining, solved = self._definitions
            moved[elimination.columns] = -solved(rows[defining], "N")
            rows = rows + matrix @ moved
        h = model.square.signs * rows[model.square.numbers(rows.size)]
        dlower, dupper = np.split(self._bounds @ changed, 2)
        of_friction = {"dfriction": self._friction @ changed} if model.friction else {}
        dz = at.jvp(dq=h, dlower=dlower, dupper=dupper, **of_friction)
        dw = elimination.expand_slack(at.dw(dz, dq=h))
        du = moved + elimination.expansion @ dz
        values = model.split(du)
        changes_by_owner = {variable: values[variable.id] for variable in model.variables}
        for report in model.reports:
            change = report.scale * (dw if report.is_slack else du)[report.columns]
            if report.expression is not None:
                change = change + changed[self._parametric.spans[id(report.expression)]]
            changes_by_owner[report.constraint] = change.reshape(report.shape, order="F")
        return changes_by_owner

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
        elimination = model.square.elimination
        owners = [*model.variables, *(report.constraint for report in model.reports)]
        by_owner = self._checked(gradients, owners, "gradient")
        by_unknown, by_slack = np.zeros((2, elimination.offset.size))
        for variable in model.variables:
            by_unknown[model.spans[variable.id]] = by_owner.get(variable.id, 0.0)
        for report in model.reports:
            if (entries := by_owner.get(report.constraint.id)) is not None:
                side = by_slack if report.is_slack else by_unknown
                np.add.at(side, report.columns, report.scale * entries)
                if report.expression is not None:
                    total[self._parametric.spans[id(report.expression)]] += entries
        g = elimination.expansion.T @ by_unknown
        gradient = self._at.vjp(g, by_slack[elimination.kept])
        rows = np.zeros(self._rows.size)
        rows[model.square.numbers(rows.size)] = model.square.signs * gradient.q
        if self._definitions is not None:
            matrix, defining, solved = self._definitions
            rows[defining] = -solved((by_unknown + matrix.T @ rows)[elimination.columns], "T")
        np.add.at(total, self._rows, rows)
        total += self._bounds.T @ np.concatenate([gradient.lower, gradient.upper])
        if model.friction:
            total += self._friction.T @ gradient.friction
        by_parameter = self._parametric.gradient(total)
        return {p: by_parameter.get(p.id, np.zeros(p.shape)) for p in self._parameters}

    @staticmethod
    def _checked(stated: Mapping[Any, Any], owners: list[Any], what: str) -> Changes:
        """Return the entries of the user's arrays, column by column, by the ids of their owners."""
        arrays: Changes = {}
        named = {name_of(owner): owner for owner in owners}
        for key, value in stated.items():
            owner = named.get(key, key) if isinstance(key, str) else key
            if not any(owner is known for known in owners):
                raise UnsupportedModel(f"{name_of(owner)} has no {what}; give {listed(named)}")
            array = np.asarray(value)
            is_real = array.dtype.kind in "fiu" and np.isfinite(array).all()
            if not is_real or array.shape != owner.shape:
                raise UnsupportedModel(
                    f"the {what} of {name_of(owner)} must be finite, of its shape {owner.shape}, got {value!r}"
                )
            arrays[owner.id] = by_columns(array.astype(np.float64))
        return arrays

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
        every = [*self._functions, *stated, *shifts, *(friction for friction, _ in model.friction)]
        return ParametricRows([part for part in every if isinstance(part, cp.Expression)], known)

    @property
    def _functions(self) -> list[Any]:
        """The expressions of the model's rows: pairs first, then equations."""
        statement = self._model.statement
        return [row.origin for row in (*statement.pairs, *statement.rows)]

    @derived_property
    def _rows(self) -> Indices:
        """The positions of the rows of pairs and equations among the parametric expressions."""
        spans = [self._parametric.spans[id(function)] for function in self._functions]
        return np.r_[0:0, *spans]

    @derived_property
    def _definitions(self) -> tuple[sp.csr_array, Indices, Any] | None:
        """Rows of the model, including definitions, and solves with these and their transpose."""
        elimination, (first, second) = self._model.square.elimination, self._model.square.stored
        if not elimination.rows.size:
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
        parts: list[Any] = [(np.zeros(0, dtype=np.int64),) * 3]
        for k, (columns, scale, expression, *ends) in enumerate(model.bounds):
            entries = np.flatnonzero(last[columns] == k)
            weights = np.broadcast_to(scale, columns.size)[entries]
            for is_end, bound in enumerate(ends):
                is_upper = (weights > 0.0) == is_end
                for part, sign in ((expression, -1.0), (bound, 1.0)):
                    if isinstance(part, cp.Expression):
                        places = spans[id(part)].start + (entries if part.size > 1 else 0 * entries)
                        parts.append((columns[entries] + n * is_upper, places, sign / weights))
        rows, columns, data = (np.concatenate(part) for part in zip(*parts, strict=True))
        matrix = sp.csr_array((data, (rows, columns)), shape=(2 * n, self._parametric.size))
        return matrix[np.concatenate([kept, n + kept])]

    @derived_property
    def _friction(self) -> sp.csr_array:
        """The change of the coefficients of friction by the change of their expressions."""
        columns = [np.zeros(0, dtype=np.int64)]
        for friction, count in self._model.friction:
            span = self._parametric.spans.get(id(friction), slice(-1, 0))
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
            'derivative needs a solution of complementarities: solve with method="LCP" and cp.Minimize(0) first'
        )
    if not result.is_solved:
        raise UnsuitableProblem(
            f"only a solution has a derivative, and this run ended {result.status.name}: {result.advice}"
        )
    model = build_from(problem)
    if not _is_solved_by(model, result):
        raise UnsupportedModel("the parameters have changed since the last solve; solve again")
    model.reports += [report for agent in model.agents for report in _bounds_of(agent, model)]
    return ModelDerivative(model, result, parameters)


def _bounds_of(agent: Any, model: Model) -> Iterator[DualReport]:
    """Yield the dual values of constraints that bound decisions of an agent: −w/a if a x ≤ a u is active."""
    conditions, duals = agent.conditions, agent.conditions.duals()
    columns_of = {report.constraint.id: report.columns for report in model.reports}
    decisions = columns_of[conditions.stationarity.id]
    for bound in conditions.bounds:
        if bound.rows is not None and isinstance(bound.rows.kept, slice):
            row = bound.rows.origin
            scale = np.where(by_columns(duals[row.id]) != 0.0, -1.0 / bound.weights, 0.0)
            yield DualReport(row, decisions[bound.places], row.shape, is_slack=True, scale=scale)


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
    bounds = [end for v in problem.variables() for end in v.attributes.get("bounds") or ()]
    owners = [problem, *(end for end in bounds if isinstance(end, cp.Expression))]
    parameters = list(by_id(p for owner in owners for p in owner.parameters()).values())
    for parameter in parameters:
        if name := restricting_attribute(parameter):
            raise UnsupportedModel(
                f"parameter {parameter.name()} has the attribute {name!r}, so that its entries have no gradients of "
                "their own; use a plain parameter, nonneg or with bounds, and build the matrix from it"
            )
    return parameters


Back = Callable[[Any], dict[int, Any]]
ParameterLines = dict[cp.Parameter, tuple[Vector, Vector]]


class ModelPath(Path):
    """Path of a cvxpy problem, with values of the variables.

    Pieces, ``at(θ)`` and ``derivative(θ)`` belong to the LCP or program that cvxpy's problem becomes.
    """

    _lines: ParameterLines
    _back: Back
    _problem: Any

    @classmethod
    def of(cls, path: Path, lines: ParameterLines, back: Back, problem: cp.Problem) -> ModelPath:
        """Return a path with a map back to cvxpy's variables."""
        return fill(cls.__new__(cls), **vars(path), _lines=lines, _back=back, _problem=problem)

    def at(self, theta: float, piece: Piece | None = None) -> PathPoint:
        """Return the point at θ; the objective has the constant and the sense of the cvxpy problem."""
        point = super().at(theta, piece)
        if point.solution is not None:
            with moved_to(self._lines, float(theta)):
                value = _compiled_program(self._problem)[0].objective(point.x)
            point = replace(point, stated_objective=sense_of(self._problem) * value)
        return point

    def value(self, variable: cp.Variable | str, theta: ArrayLike) -> Any:
        """Return the value of a variable, or of its name, at θ in its shape; at k values of θ shape (k, *shape)."""
        known = self._problem.variables()
        named = {v.name(): v for v in known}
        variable = named.get(variable, variable) if isinstance(variable, str) else variable
        if all(variable is not v for v in known):
            raise UnsupportedModel(
                f"{variable!r} is not a variable of the problem; give one of {listed(named)}"
            )
        points = [self._values(value) for value in np.ravel(np.asarray(theta, float)).tolist()]
        shape = (*np.shape(theta), *variable.shape)
        return np.reshape([values[variable.id] for values in points], shape)

    def _values(self, theta: float) -> dict[int, Any]:
        with moved_to(self._lines, theta):
            return self._back(self.piece_at(theta).z_at(theta))


def parameter_lines(problem: cp.Problem, along: object) -> ParameterLines:
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
                f"{name_of(along)} has {along.size} entries; write along={{parameter: direction}}"
            )
        lines = {along: (np.zeros(along.shape), np.ones(along.shape))}
    elif isinstance(along, Mapping) and along and all(isinstance(p, cp.Parameter) for p in along):
        if lacking := [parameter for parameter in along if parameter.value is None]:
            raise InvalidOption(f"{name_of(lacking[0])} has no value to start from; give it one")
        steps = {p: np.broadcast_to(np.asarray(step, float), p.shape) for p, step in along.items()}
        lines = {p: (np.array(leaf_value(p), float), step) for p, step in steps.items()}
    else:
        raise InvalidOption(f"along is a Parameter, or {{parameter: direction}}, got {along!r}")
    known = by_id(problem.parameters())
    if strange := [parameter for parameter in lines if parameter.id not in known]:
        raise InvalidOption(f"{name_of(strange[0])} is not a parameter of the problem; pass one")
    return lines


@contextmanager
def moved_to(lines: ParameterLines, theta: float) -> Iterator[None]:
    """Give the parameters their values at θ, and restore the previous values at the end."""
    before = {parameter: parameter.value for parameter in lines}
    try:
        for parameter, (base, step) in lines.items():
            try:
                parameter.value = base + theta * step
            except ValueError as error:
                raise InvalidOption(
                    f"{name_of(parameter)} does not accept its value at θ = {theta:.6g}: {error}"
                ) from error
        yield
    finally:
        for parameter, value in before.items():
            parameter.value = value


def trace_model(
    problem: cp.Problem, along: object, start: float, stop: float, tolerance: float | None = None
) -> ModelPath:
    """Return the path of a cvxpy problem; see :func:`lcp_plugin.trace`.

    Raises
    ------
    UnsupportedModel
        If a matrix depends on the parameter, or a vector depends on it not affinely.
    """
    stated = _pairs if is_complementarity_problem(problem) else _compiled_program
    lines = parameter_lines(problem, along)
    other = stop if stop != start else start + 1.0
    # A test point that no simple fraction hits
    values = (start, other, start + 0.3819660112501051 * (other - start))
    problems = []
    for theta in values:
        with moved_to(lines, theta):
            program, back = stated(problem)
        problems.append(program)
    path = trace_stated(*_affine_data(problems, values), start, stop, tolerance)
    return ModelPath.of(path, lines, back, problem)


def _pairs(problem: cp.Problem) -> tuple[LCP, Back]:
    return build_from(problem).lcp("trace"), lambda z: build_from(problem).values(z)


def _compiled_program(problem: cp.Problem) -> tuple[QuadraticProgram, Back]:
    # With parameters as numbers: for an expression that is not affine, cvxpy's cache may be of an old value.
    compiled = CompiledProblem.of(problem, is_folded=True, ignore_dpp=True)
    return compiled.program, compiled.values


def _affine_data(problems: list[Any], values: tuple[float, ...]) -> tuple[Any, dict[str, Vector]]:
    """Return the problem at θ = 0 and its vectors' directions, from three values of θ; raise if they are not affine."""
    first = problems[0]
    for name in first.matrix_names:
        matrix, *others = (getattr(problem, name) for problem in problems)
        if any(matrix.shape != one.shape or abs(matrix - one).sum() != 0.0 for one in others):
            remedy = "where it multiplies the quadratic term, divide the objective by it"
            remedy = remedy if name == "P" else "let it multiply no variable of a constraint"
            raise UnsupportedModel(
                f"the parameter enters the matrix {name}, so that the path is not piecewise affine; {remedy}"
            )
    begin, end, between = values
    base, directions = {}, {}
    for name in first.vector_names:
        vectors = np.array([getattr(problem, name) for problem in problems])
        moves = np.isfinite(vectors).all(axis=0)
        at_begin, at_end, at_middle = np.where(moves, vectors, 0.0)
        slope = (at_end - at_begin) / (end - begin)
        deviation = np.abs(at_begin + (between - begin) * slope - at_middle)
        is_fixed = (vectors == vectors[0]).all(axis=0)
        # A vector in between is off the line by more than rounding
        is_bent = deviation > 1e-9 * np.abs(at_middle).max(initial=0.0)
        if is_bent.any() or not (moves | is_fixed).all():
            raise UnsupportedModel(
                f"{name} of the program that cvxpy compiles is not affine in the parameter between {begin:.6g} and "
                f"{end:.6g}; make the nonlinear expression a parameter"
            )
        base[name] = np.where(moves, at_begin - begin * slope, vectors[0])
        if slope.any():
            directions[name] = slope
    if not directions:
        name = first.vector_names[0]
        directions = {name: np.zeros_like(base[name])}
    return first.with_vectors(**base), directions
