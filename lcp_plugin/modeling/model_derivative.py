"""``problem.backward()`` and ``problem.derivative()`` after our solves, and what they ask of a solved model.

The derivative of its solution by its parameters is the LCP's own, at the solution, and that of its data. With z held,
all that M and q have to do with a parameter is in the residual F(x; p) = M(p) z + q(p): with μ the gradient by q,
dL = μᵀ ∂F/∂p, wherever in F the parameter stands. Definitions that were put in come back as rows of their own:
D u + … = 0 for the defined unknowns u moves them by −D⁻¹ ∂(D u + …)/∂p.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import cached_property
from itertools import pairwise
from typing import Any, Protocol

import cvxpy as cp
import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.sparse.linalg import splu

from ..core.checks import FloatVector
from ..core.errors import UnsupportedModel
from ..core.solving.result import Result
from . import _compat
from .expressions.program import Program
from .model import Model
from .reading import Reader, restricting_attribute

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
    >>> parametric.change({p.id: np.ones(2)}), parametric.gradient(np.ones(2))[p.id]
    (array([20., 42.]), array([20., 42.]))
    """

    def __init__(self, expressions: Iterable[Any], known: Changes) -> None:
        reader, each = Reader(held=known), {id(one): one for one in expressions}
        self._parameters = {p.id: p for one in each.values() for p in one.parameters()}
        self._spans, n = _spans(self._parameters)
        #: Where each expression is among all of them, by its id.
        self.spans, self.size = _spans(each)
        starts = {key: span.start for key, span in self._spans.items()}
        self._program = Program.of(
            reader.compiler, [reader.rows(one) for one in each.values()], starts, n
        )
        self._at = self._vector(
            {key: known.get(key, _compat.leaf_value(p)) for key, p in self._parameters.items()}
        )

    def change(self, changes: Changes) -> FloatVector:
        """Return the change of the expressions from those of parameters, by their ids; the others do not change."""
        moved: FloatVector = self._finite(self._program.change(self._at, self._vector(changes)))
        return moved

    def gradient(self, gradient: FloatVector) -> Changes:
        """Return the gradients by parameters, by their ids, from that by the expressions."""
        found = self._finite(self._program.gradient(self._at, gradient))
        return {
            key: found[self._spans[key]].reshape(p.shape, order="F")
            for key, p in self._parameters.items()
        }

    def _vector(self, values: Changes) -> FloatVector:
        parts = [
            values.get(key, np.zeros(parameter.size)) for key, parameter in self._parameters.items()
        ]
        return np.concatenate([*(_compat.by_columns(part) for part in parts), np.zeros(0)])

    @staticmethod
    def _finite(values: Any) -> Any:
        if not np.isfinite(values).all():
            raise UnsupportedModel(
                "the model has no finite derivative at the present values of its parameters; move them away from the "
                "edge of what its atoms accept"
            )
        return values


def _spans(leaves: Changes) -> tuple[dict[int, slice], int]:
    """Return where each expression is where all of them follow each other, and how many entries they have."""
    ends = np.cumsum([0, *(one.size for one in leaves.values())]).tolist()
    return {key: slice(*pair) for key, pair in zip(leaves, pairwise(ends), strict=True)}, ends[-1]


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
        model, at = self._model, self._at
        changed = self._parametric.change(changes)
        rows, moved = changed[self._rows], np.zeros(model.elimination.offset.size)
        if self._definitions is not None:
            matrix, defining, solved = self._definitions
            moved[model.elimination.columns] = -solved(rows[defining], "N")
            rows = rows + matrix @ moved
        h = model.sources.signs * rows[self._left]
        dlower, dupper = np.split(self._bounds @ changed, 2)
        of_friction = (
            {"dfriction": self._friction @ changed} if self._model.sources.friction else {}
        )
        dz = at.jvp(dq=h, dlower=dlower, dupper=dupper, **of_friction)
        dw = model.elimination.expand_slack(at.dw(dz, dq=h))
        du = (
            moved + dz
            if model.elimination.expansion is None
            else moved + model.elimination.expansion @ dz
        )
        duals = []
        for report in model.reports:
            change = report.scale * (dw if report.is_slack else du)[report.columns]
            if report.expression is not None:
                change = change + changed[self._parametric.spans[id(report.expression)]]
            duals.append((report.constraint, change.reshape(report.shape, order="F")))
        return model.split(du), duals

    def pulled(self, by_variable: Changes, by_dual: Changes) -> Changes:
        """Return the gradients by the parameters, by their ids, of a function of variables and dual values.

        Parameters
        ----------
        by_variable, by_dual : dict
            From the id of a variable, or of a constraint, to the gradient in its shape.
        """
        model, total = self._model, np.zeros(self._parametric.size)
        by_unknown, by_slack = np.zeros((2, model.elimination.offset.size))
        for variable in model.variables:
            first = model.offsets[variable.id]
            by_unknown[first : first + variable.size] = np.ravel(
                by_variable[variable.id], order="F"
            )
        for report in model.reports:
            if (own := by_dual.get(report.constraint.id)) is not None:
                own = np.ravel(own, order="F")
                np.add.at(
                    by_slack if report.is_slack else by_unknown, report.columns, report.scale * own
                )
                if report.expression is not None:
                    total[self._parametric.spans[id(report.expression)]] += own
        kept, expansion = model.elimination.kept, model.elimination.expansion
        g = by_unknown[kept] if expansion is None else expansion.T @ by_unknown
        gradient = self._at.vjp(g, by_slack[kept])
        rows = np.zeros(self._rows.size)
        rows[self._left] = model.sources.signs * gradient.q
        if self._definitions is not None:
            matrix, defining, solved = self._definitions
            rows[defining] = -solved((by_unknown + matrix.T @ rows)[model.elimination.columns], "T")
        np.add.at(total, self._rows, rows)
        total += self._bounds.T @ np.concatenate([gradient.lower, gradient.upper])
        if model.sources.friction:
            total += self._friction.T @ gradient.friction
        return self._parametric.gradient(total)

    @cached_property
    def _at(self) -> Any:  # a Derivative, or a ConeDerivative
        from ..problems.sensitivity import (
            derivative,  # with compiled kernels, which a model alone does not need
        )

        return derivative(self._result)

    @cached_property
    def _parametric(self) -> ParametricRows:
        """What parameters enter into, at the values of parameters and variables at the solution."""
        sources = self._model.sources
        stated = [
            part
            for source in sources.bounds
            for part in (source.expression, source.lower, source.upper)
        ]
        shifts = [report.expression for report in self._model.reports]
        known = {**self._known, **self._model.values(self._at.z)}
        every = [*sources.functions, *stated, *shifts, *(one for one, _ in sources.friction)]
        return ParametricRows([one for one in every if isinstance(one, cp.Expression)], known)

    @cached_property
    def _rows(self) -> NDArray[np.int64]:
        """The places of the model's rows, those of the pairs and of the equations, among the parametric ones."""
        spans = [self._parametric.spans[id(one)] for one in self._model.sources.functions]
        return np.concatenate(
            [*(np.arange(span.start, span.stop) for span in spans), np.zeros(0, dtype=np.int64)]
        )

    @cached_property
    def _left(self) -> NDArray[np.int64]:
        """The row of the model that each row of the LCP is, up to its sign."""
        first = self._model.sources.matrices[0].shape[0]
        rows = np.delete(np.arange(self._rows.size), first + self._model.elimination.rows)
        return rows[self._model.sources.places]

    @cached_property
    def _definitions(
        self,
    ) -> tuple[sp.csr_array, NDArray[np.int64], Callable[[FloatVector, str], FloatVector]] | None:
        """All rows of the model, those that define unknowns, and solutions with these and with their transpose."""
        elimination, (first, second) = self._model.elimination, self._model.sources.matrices
        if elimination.expansion is None:
            return None
        solved = splu(sp.csc_array(second[elimination.rows][:, elimination.columns])).solve
        return sp.csr_array(sp.vstack([first, second])), first.shape[0] + elimination.rows, solved

    @cached_property
    def _bounds(self) -> sp.csr_array:
        """The change of the lower bounds, then of the upper ones, by that of the expressions that state them."""
        n, kept, spans = (
            self._model.elimination.offset.size,
            self._model.elimination.kept,
            self._parametric.spans,
        )
        last = np.zeros(n, dtype=np.int64)
        for k, source in enumerate(self._model.sources.bounds):
            last[source.columns] = k
        parts = [(np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64), np.zeros(0))]
        for k, source in enumerate(self._model.sources.bounds):
            own = np.flatnonzero(last[source.columns] == k)
            columns, weights = source.columns[own], source.weights[own]
            for bound, is_upper in ((source.lower, weights < 0.0), (source.upper, weights > 0.0)):
                parts.append(
                    (
                        columns + n * is_upper,
                        spans[id(source.expression)].start + own,
                        -1.0 / weights,
                    )
                )
                if isinstance(bound, cp.Expression):
                    places = spans[id(bound)].start + (own if bound.size > 1 else 0 * own)
                    parts.append((columns + n * is_upper, places, 1.0 / weights))
        rows, columns, data = (np.concatenate(part) for part in zip(*parts, strict=True))
        matrix = sp.csr_array(
            sp.coo_array((data, (rows, columns)), shape=(2 * n, self._parametric.size))
        )
        return matrix[np.concatenate([kept, n + kept])]

    @cached_property
    def _friction(self) -> sp.csr_array:
        """The change of the coefficients of friction by that of the expressions that state them."""
        columns = [np.zeros(0, dtype=np.int64)]
        for one, count in self._model.sources.friction:
            span = self._parametric.spans.get(id(one), slice(-1, 0))
            columns.append(span.start + np.arange(count) * (span.stop - span.start > 1))
        places = np.concatenate(columns)
        stated = np.flatnonzero(places >= 0)
        shape = places.size, self._parametric.size
        return sp.csr_array((np.ones(stated.size), (stated, places[stated])), shape=shape)


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

    def __init__(
        self, solution: SolutionMap, parameters: list[Any], constraints: list[Any]
    ) -> None:
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
        by_dual = {
            key: _checked(dual, "gradient", 0.0)
            for key, dual in duals.items()
            if dual.gradient is not None
        }
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
        changes = {
            parameter.id: _checked(parameter, "delta", 0.0) for parameter in self._parameters
        }
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
    if (
        values.dtype.kind not in "fiu"
        or values.shape != leaf.shape
        or not np.isfinite(values).all()
    ):
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
    bounds = [
        bound for v in problem.variables() for bound in _compat.attribute_expressions(v) or ()
    ]
    stated = [
        parameter
        for bound in bounds
        if isinstance(bound, cp.Expression)
        for parameter in bound.parameters()
    ]
    parameters = list(
        {parameter.id: parameter for parameter in (*problem.parameters(), *stated)}.values()
    )
    for parameter in parameters:
        if name := restricting_attribute(parameter):
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
