"""``problem.backward()`` and ``problem.derivative()`` after our solves, and what they ask of a solved model.

The derivative of its solution by its parameters is the LCP's own, at the solution, and that of its data. With z held,
all that M and q have to do with a parameter is in the residual F(x; p) = M(p) z + q(p): with μ the gradient by q,
dL = μᵀ ∂F/∂p, wherever in F the parameter stands. Definitions that were put in come back as rows of their own:
D u + … = 0 for the defined unknowns u moves them by −D⁻¹ ∂(D u + …)/∂p.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from functools import cached_property
from typing import TYPE_CHECKING, Any, Protocol

import cvxpy as cp
import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from ..checks import FloatVector
from ..errors import UnsupportedModel
from ..expressions.program import Program
from ..solving.result import Result
from . import _compat
from .model import BoundSource, Model
from .reading import Reader

if TYPE_CHECKING:
    from ..solving.derivative import Derivative

Changes = dict[int, Any]


class ParametricRows:
    """Expressions as functions of their parameters, the variables held.

    Parameters
    ----------
    expressions : iterable of cvxpy expression
    known : dict
        From the id of a variable or parameter to its value; the others have the value they have.

    Examples
    --------
    >>> p, x = cp.Parameter(2), cp.Variable(2)
    >>> F = cp.multiply(p**2, x)
    >>> parametric = ParametricRows([F], {p.id: np.array([2.0, 3.0]), x.id: np.array([5.0, 7.0])})
    >>> parametric.changes({p.id: np.ones(2)})[id(F)], parametric.gradients({id(F): np.ones(2)})[p.id]
    (array([20., 42.]), array([20., 42.]))
    """

    def __init__(self, expressions: Iterable[Any], known: Changes) -> None:
        reader = Reader(held=known)
        self._expressions = {id(one): one for one in expressions}
        self._parameters = {p.id: p for one in self._expressions.values() for p in one.parameters()}
        rows = [reader.rows(one) for one in self._expressions.values()]
        self._spans, first = {}, 0
        for key, parameter in self._parameters.items():
            self._spans[key], first = slice(first, first + parameter.size), first + parameter.size
        starts = {key: span.start for key, span in self._spans.items()}
        self._program = Program.of(reader.compiler, rows, starts, first)
        self._at = self._vector({key: known.get(key, _compat.leaf_value(p)) for key, p in self._parameters.items()})
        self._ends = np.cumsum([one.size for one in rows])[:-1]

    def changes(self, changes: Changes) -> Changes:
        """Return the change of each expression, by its id, from those of parameters; the others do not change."""
        moved = self._program.change(self._at, self._vector(changes))
        return dict(zip(self._expressions, np.split(self._finite(moved), self._ends), strict=True))

    def gradients(self, gradients: Changes) -> Changes:
        """Return the gradients by parameters, by their ids, from those by expressions; the others have none."""
        parts = [gradients.get(key, np.zeros(one.size)) for key, one in self._expressions.items()]
        found = self._finite(self._program.gradient(self._at, np.concatenate([*parts, np.zeros(0)])))
        return {key: found[self._spans[key]].reshape(p.shape, order="F") for key, p in self._parameters.items()}

    def _vector(self, values: Changes) -> FloatVector:
        parts = [values.get(key, np.zeros(parameter.size)) for key, parameter in self._parameters.items()]
        return np.concatenate([*(np.ravel(_compat.dense(part), order="F") for part in parts), np.zeros(0)])

    @staticmethod
    def _finite(values: Any) -> Any:
        if not np.isfinite(values).all():
            raise UnsupportedModel(
                "the model has no finite derivative at the present values of its parameters; move them away from the "
                "edge of what its atoms accept"
            )
        return values


class ModelDerivative:
    """The derivative at the solution of a model of complementarities.

    Parameters
    ----------
    model : Model
    result : Result
    known : dict
        From the id of a parameter to the value with which the model was solved.
    """

    def __init__(self, model: Model, result: Result, known: Changes) -> None:
        self._model, self._result, self._known = model, result, known

    def pushed(self, changes: Changes) -> tuple[Changes, list[tuple[Any, Any]]]:
        """Return the change of each variable, by its id, and of each dual value, with its constraint.

        Parameters
        ----------
        changes : dict
            From the id of a parameter to its change.
        """
        model, at, changed = self._model, self._at, self._parametric.changes(changes)
        rows = np.concatenate([*(changed[id(one)] for one in model.sources.functions), np.zeros(0)])
        moved = np.zeros(model.elimination.offset.size)
        pairs, equations = self._split(rows)
        if (solved := self._definitions) is not None:
            moved[model.elimination.columns] = -solved(equations[model.elimination.rows], "N")
            pairs, equations = (
                part + matrix @ moved for part, matrix in zip((pairs, equations), model.sources.matrices, strict=True)
            )
        undefined = np.delete(equations, model.elimination.rows)
        h = model.sources.signs * np.concatenate([pairs, undefined])[model.sources.places]
        dlower, dupper = self._moved_bounds(changed)
        dz = at.jvp(dq=h, dlower=dlower, dupper=dupper)
        dw = model.elimination.expand_slack(at.dw(dz, dq=h))
        du = moved + dz if model.elimination.expansion is None else moved + model.elimination.expansion @ dz
        duals = []
        for report in model.reports:
            change = report.scale * (dw if report.is_slack else du)[report.columns]
            if report.expression is not None:
                change = change + changed[id(report.expression)]
            duals.append((report.constraint, change.reshape(report.shape, order="F")))
        return model.split(du), duals

    def pulled(self, by_variable: Changes, by_dual: Changes) -> Changes:
        """Return the gradients by the parameters, by their ids, of a function of variables and dual values.

        Parameters
        ----------
        by_variable, by_dual : dict
            From the id of a variable, or of a constraint, to the gradient in its shape.
        """
        model, total = self._model, dict[int, Any]()
        by_unknown, by_slack = np.zeros((2, model.elimination.offset.size))
        for variable in model.variables:
            first = model.offsets[variable.id]
            by_unknown[first : first + variable.size] = np.ravel(by_variable[variable.id], order="F")
        for report in model.reports:
            if (own := by_dual.get(report.constraint.id)) is not None:
                own = np.ravel(own, order="F")
                np.add.at(by_slack if report.is_slack else by_unknown, report.columns, report.scale * own)
                if report.expression is not None:
                    _add(total, report.expression, own)
        kept, expansion = model.elimination.kept, model.elimination.expansion
        g = by_unknown[kept] if expansion is None else expansion.T @ by_unknown
        gradient = self._at.vjp(g, by_slack[kept])
        rows = self._row_multipliers(gradient.q, by_unknown)
        ends = np.cumsum([one.size for one in model.sources.functions])
        for one, part in zip(model.sources.functions, np.split(rows, ends[:-1]) if ends.size else [], strict=True):
            _add(total, one, part)
        by_lower, by_upper = np.zeros((2, by_unknown.size))
        by_lower[kept], by_upper[kept] = gradient.lower, gradient.upper
        for source, is_last in self._bounds():
            self._pull_bound(source, by_lower[source.columns] * is_last, by_upper[source.columns] * is_last, total)
        return self._parametric.gradients(total)

    @cached_property
    def _at(self) -> Derivative:
        from ..solving.derivative import derivative  # with compiled kernels, which a model alone does not need

        return derivative(self._result)

    @cached_property
    def _parametric(self) -> ParametricRows:
        """What parameters enter into, at the values of parameters and variables at the solution."""
        bounds = [part for source in self._model.sources.bounds for part in (source.expression, *_expressions(source))]
        shifts = [report.expression for report in self._model.reports if report.expression is not None]
        known = {**self._known, **self._model.values(self._at.z)}
        return ParametricRows([*self._model.sources.functions, *bounds, *shifts], known)

    def _split(self, rows: FloatVector) -> tuple[FloatVector, FloatVector]:
        """Return the rows of the pairs and those of the equations."""
        count = self._model.sources.matrices[0].shape[0]
        return rows[:count], rows[count:]

    @cached_property
    def _definitions(self) -> Callable[[FloatVector, str], FloatVector] | None:
        """Solutions with the matrix of the defined unknowns in the rows that define them, and with its transpose."""
        elimination = self._model.elimination
        if elimination.expansion is None:
            return None
        matrix = self._model.sources.matrices[1][elimination.rows][:, elimination.columns]
        solution: Callable[[FloatVector, str], FloatVector] = splu(sp.csc_array(matrix)).solve
        return solution

    def _row_multipliers(self, multipliers: FloatVector, by_unknown: FloatVector) -> FloatVector:
        """Return the gradient by each row of the model from that by the rows of the LCP."""
        model, sources = self._model, self._model.sources
        first, second = sources.matrices
        undefined = np.delete(np.arange(second.shape[0]), model.elimination.rows)
        rows = np.zeros(first.shape[0] + second.shape[0])
        places = np.append(np.arange(first.shape[0]), first.shape[0] + undefined)
        rows[places[sources.places]] = sources.signs * multipliers
        if (solved := self._definitions) is not None:
            pairs, equations = self._split(rows)
            by_defined = (by_unknown + first.T @ pairs + second.T @ equations)[model.elimination.columns]
            rows[first.shape[0] + model.elimination.rows] = -solved(by_defined, "T")
        return rows

    def _bounds(self) -> Iterator[tuple[BoundSource, Any]]:
        """Yield where bounds come from, and for which of its unknowns nothing comes later."""
        last = np.zeros(self._model.elimination.offset.size, dtype=np.int64)
        for k, source in enumerate(self._model.sources.bounds):
            last[source.columns] = k
        for k, source in enumerate(self._model.sources.bounds):
            yield source, last[source.columns] == k

    def _moved_bounds(self, changed: Changes) -> tuple[FloatVector, FloatVector]:
        lower, upper = np.zeros((2, self._model.elimination.offset.size))
        for source, _ in self._bounds():
            own = changed[id(source.expression)]
            low, high = (changed.get(id(bound), 0.0) - own for bound in (source.lower, source.upper))
            positive = source.weights > 0.0
            lower[source.columns] = np.where(positive, low, high) / source.weights
            upper[source.columns] = np.where(positive, high, low) / source.weights
        return lower[self._model.elimination.kept], upper[self._model.elimination.kept]

    @staticmethod
    def _pull_bound(source: BoundSource, by_lower: FloatVector, by_upper: FloatVector, total: Changes) -> None:
        positive = source.weights > 0.0
        low = np.where(positive, by_lower, by_upper) / source.weights
        high = np.where(positive, by_upper, by_lower) / source.weights
        _add(total, source.expression, -(low + high))
        for bound, gradient in ((source.lower, low), (source.upper, high)):
            if isinstance(bound, cp.Expression):
                _add(total, bound, np.array([gradient.sum()]) if bound.size == 1 else gradient)


def _expressions(source: BoundSource) -> list[Any]:
    return [bound for bound in (source.lower, source.upper) if isinstance(bound, cp.Expression)]


def _add(total: Changes, expression: Any, gradient: FloatVector) -> None:
    total[id(expression)] = total.get(id(expression), 0.0) + gradient


#: They tie the entries of a parameter to each other, or make it no real number.
UNDIFFERENTIABLE = (
    *("boolean", "integer", "symmetric", "diag", "PSD", "NSD", "sparsity", "hermitian", "complex", "imag"),
)


class SolutionMap(Protocol):
    """How a solution changes with parameters, in both directions."""

    def pushed(self, changes: Changes) -> tuple[Changes, list[tuple[Any, Any]]]:
        """Return the changes of variables and of dual values."""

    def pulled(self, by_variable: Changes, by_dual: Changes) -> Changes:
        """Return the gradients by parameters."""


class Differentiable:
    """A solution that answers for `backward` and `derivative` of its problem.

    Parameters
    ----------
    solution : SolutionMap
    parameters : list of cvxpy.Parameter
    constraints : list of cvxpy constraint
        Those whose dual values may have a gradient.
    """

    def __init__(self, solution: SolutionMap, parameters: list[Any], constraints: list[Any]) -> None:
        self._solution, self._parameters, self._constraints = solution, parameters, constraints

    def backward(self, problem: Any) -> None:
        """Set the gradients of all parameters from those of variables and dual variables; a variable has 1 by default.

        Raises
        ------
        UnsupportedModel
            Where a gradient has not the shape of its variable, or is not finite.
        """
        by_variable = {
            variable.id: _checked(variable, "gradient", 1.0) for variable in problem.variables()
        }
        duals = {constraint.id: constraint.dual_variables[0] for constraint in self._constraints}
        by_dual = {key: _checked(dual, "gradient", 0.0) for key, dual in duals.items() if dual.gradient is not None}
        gradients = self._solution.pulled(by_variable, by_dual)
        for parameter in self._parameters:
            parameter.gradient = np.zeros(parameter.shape) + gradients.get(parameter.id, 0.0)

    def derivative(self, problem: Any) -> None:
        """Set the changes of all variables and dual variables from those of the parameters; 0 by default.

        Raises
        ------
        UnsupportedModel
            Where a change has not the shape of its parameter, or is not finite.
        """
        changes = {parameter.id: _checked(parameter, "delta", 0.0) for parameter in self._parameters}
        moved, duals = self._solution.pushed(changes)
        for variable in problem.variables():
            variable.delta = moved.get(variable.id, np.zeros(variable.shape))
        for constraint, change in duals:
            constraint.dual_variables[0].delta = change


def _checked(leaf: Any, name: str, default: float) -> Any:
    """Return what a user set as gradient or delta of a leaf."""
    given = getattr(leaf, name)
    if given is None:
        return np.full(leaf.shape, default)
    values = given.toarray() if hasattr(given, "toarray") else np.asarray(given)
    if values.dtype.kind not in "fiu" or values.shape != leaf.shape or not np.isfinite(values).all():
        raise UnsupportedModel(
            f"the {name} of {leaf.name()} must be finite real numbers of its shape {leaf.shape}, got {given!r}; leave "
            f"it None for {default:g} everywhere"
        )
    return values.astype(np.float64)


def differentiable_parameters(problem: Any) -> list[Any]:
    """Return the parameters of a problem, those in bounds of variables included.

    Raises
    ------
    UnsupportedModel
        Where one is an integer, a Boolean or complex, or has entries that are tied to each other.
    """
    bounds = [bound for v in problem.variables() for bound in _compat.attribute_expressions(v) or ()]
    stated = [parameter for bound in bounds if isinstance(bound, cp.Expression) for parameter in bound.parameters()]
    parameters = list({parameter.id: parameter for parameter in (*problem.parameters(), *stated)}.values())
    for parameter in parameters:
        for name in UNDIFFERENTIABLE:
            if not (parameter.attributes.get(name) is None or parameter.attributes.get(name) is False):
                raise UnsupportedModel(
                    f"parameter {parameter.name()} has the attribute {name!r}, so that its entries cannot move freely "
                    "and have no gradients of their own; use a plain parameter, nonneg or with bounds, and build the "
                    "matrix from it, or leave requires_grad out"
                )
    return parameters


def values_of_parameters(parameters: list[Any]) -> Changes:
    """Return copies of the present values by the ids of the parameters."""
    values = {parameter.id: _compat.leaf_value(parameter) for parameter in parameters}
    return {key: value.copy() for key, value in values.items() if value is not None}
