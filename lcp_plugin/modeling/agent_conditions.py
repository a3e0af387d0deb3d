"""The optimality conditions of an agent's program: multipliers, bounds, and the gradient of the Lagrangian."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import cvxpy as cp
import numpy as np
import scipy.sparse as sp

from ..core.checks import FloatVector
from ..core.errors import UnsupportedModel
from ..expressions import functions
from ..expressions.differentiation import gradient
from ..expressions.rows import Indices, Rows, assembled, is_definition, stacked
from ._compat import (
    KINKS,
    attribute_bounds,
    attribute_expressions,
    by_columns,
    name_of,
    postorder,
)
from .constraint import Complements, Side, box
from .reading import Reader, hidden_parameters, rewritten
from .stated_terms import EQUATIONS, expression_of, sense_of

FIRST_KEY = (
    2**61
)  # of a subexpression that the agent does not influence: larger than any id of a variable
NO_BOUND = 1e30  # stands for ∞ in bounds with parameters, where constants must be finite
ATOMS: dict[str, Any] = {
    functions.SAME.name: lambda u: u,
    functions.EXP.name: cp.exp,
    functions.LOG.name: cp.log,
    functions.LOG1P.name: cp.log1p,
    functions.RELATIVE_ENTROPY.name: cp.rel_entr,
    functions.LOG_ADD_EXP.name: lambda u, v: cp.logistic(u - v) + v,
    functions.PRODUCT.name: cp.multiply,
    functions.QUOTIENT.name: lambda u, v: u / v,
}


class SimpleBound(NamedTuple):
    """Rows of a constraint that bound one decision each: weights · decisions[places] ≤ weights · bound.

    Attributes
    ----------
    origin : cvxpy constraint
    places : ndarray of int
    weights : ndarray
    bound : ndarray or cvxpy expression
        With parameters an expression.
    """

    origin: Any
    places: Indices
    weights: FloatVector
    bound: Any


class StandardRows(NamedTuple):
    """Constraint of an agent's program: expression ≤ 0 or = 0, as cvxpy's dual values count it."""

    origin: Any
    expression: Any
    is_equation: bool

    @classmethod
    def of(cls, constraint: Any, change: Any = lambda node: node) -> StandardRows:
        """Return the rows of a cvxpy constraint, each node of its expression changed."""
        expression = rewritten(expression_of(constraint), change)
        sign = -1.0 if isinstance(constraint, cp.constraints.NonNeg) else 1.0
        return cls(constraint, sign * expression, isinstance(constraint, EQUATIONS))


@dataclass(frozen=True, eq=False)
class Conditions:
    """Optimality conditions of an agent.

    Attributes
    ----------
    stationarity : Complements
        The vector of all decisions between their bounds, with the gradient of the Lagrangian.
    rows : dict
        The pair of each constraint with a multiplier, and the multiplier, by the id of the constraint.
    bounds : list of SimpleBound
        The other constraints.
    """

    stationarity: Complements
    rows: dict[int, tuple[Complements, Any]]
    bounds: list[SimpleBound]

    @property
    def pairs(self) -> list[Complements]:
        """All pairs."""
        return [self.stationarity, *(pair for pair, _ in self.rows.values())]

    def duals_of_bounds(self) -> dict[int, Any]:
        """Return the dual values of simple bounds by the id of the constraint; None without values."""
        w = self.stationarity.dual_value
        if w is None:
            return dict.fromkeys([one.origin.id for one in self.bounds])
        left, found = (np.maximum(w, 0.0), np.maximum(-w, 0.0)), {}
        for one in self.bounds:
            value = np.broadcast_to(getattr(one.bound, "value", one.bound), one.weights.shape)
            dual = np.zeros(value.size)
            for is_upper, end in enumerate(self.stationarity.first.bounds()):
                is_tight = ((one.weights > 0.0) == is_upper) & (value == end[one.places])
                places = one.places[is_tight]
                dual[is_tight] = left[is_upper][places] / np.abs(one.weights[is_tight])
                left[is_upper][places] = 0.0
            found[one.origin.id] = dual.reshape(expression_of(one.origin).shape, order="F")
        return found


class AgentProgram:
    """An agent's program without kinks, read as rows over its decisions and over all that it does not influence.

    Parameters
    ----------
    agent : Optimal

    Attributes
    ----------
    goal : cvxpy expression
    rows : list of StandardRows
        Constraints of the program, then of epigraphs.
    entries : list of tuple
        Variables and their entries that are decisions, epigraphs included.
    """

    def __init__(self, agent: Any) -> None:
        program = agent.program
        self.agent, self.own = agent, {variable.id for variable, _ in agent.entries}
        known, epigraphs, new = {one.id for one in program.variables()}, [], {}

        def change(node: Any) -> Any:
            graph = KINKS.get(type(node))
            if graph is None or self.own.isdisjoint(one.id for one in node.variables()):
                return node
            value, inequalities = graph(node, node.args)
            for one in (value, *inequalities):
                new.update({each.id: each for each in one.variables() if each.id not in known})
            self.own.update(new)
            epigraphs.extend(inequalities)
            return value

        self.goal = rewritten(program.objective.args[0], change)
        self.rows = [StandardRows.of(one, change) for one in program.constraints]
        self.rows += map(StandardRows.of, epigraphs)
        self.entries = [*agent.entries, *((one, np.arange(one.size)) for one in new.values())]
        self.decisions = cp.hstack([vector_of(one)[columns] for one, columns in self.entries])
        first = np.cumsum([0, *(one.size for one, _ in self.entries)])
        #: The first number of each variable's entries, and the decision with a number; −1 if it is none.
        self.first = {one.id: k for (one, _), k in zip(self.entries, first.tolist(), strict=False)}
        self.place = np.full(first[-1], -1)
        numbers = np.concatenate([self.first[one.id] + columns for one, columns in self.entries])
        self.place[numbers] = np.arange(numbers.size)
        self.lower, self.upper = np.full((2, numbers.size), NO_BOUND) * [[-1.0], [1.0]]
        self.reader = Reader(takes_integers=True)
        #: Vectors behind the sources, by their keys.
        self.vectors = {one.id: vector_of(one) for one, _ in self.entries}
        stated = [self.goal, *(one.expression for one in self.rows)]
        for number, node in enumerate(uninfluenced(stated, self.own)):
            key = node.id if isinstance(node, cp.Variable) else FIRST_KEY + number
            self.reader.hold(node, key)
            self.vectors[key] = vector_of(node)

    def conditions(self) -> Conditions:
        """Return the optimality conditions."""
        goal, sense = self.reader.rows(self.goal), np.array([sense_of(self.agent.program)])
        weighted, rows, bounds = [(goal, Rows({}, sense, (1,)))], {}, []
        self._add_attributes()
        for one in self.rows:
            own = self.reader.rows(one.expression)
            if (bound := self._simple(one, own)) is not None:
                self._tighten(bound)
                bounds.append(bound)
                continue
            multiplier = cp.Variable(one.expression.shape)
            if one.origin.id in self.agent.shared:
                multiplier = one.origin.dual_variables[0]
            if multiplier.value is None and self.decisions.value is not None:
                multiplier.value = np.zeros(multiplier.shape)  # a start for the run
            self.vectors[multiplier.id] = vector_of(multiplier)
            weighted.append((own, Rows({multiplier.id: 1.0}, np.zeros(own.size), (own.size,))))
            first = box(multiplier, -np.inf if one.is_equation else 0.0, np.inf)
            kind = "value" if one.is_equation else "nonnegative"
            second = Side(-one.expression, kind, one.origin)
            rows[one.origin.id] = Complements(first, second), multiplier
        slopes = gradient(self.reader.compiler, weighted, self.own)
        nothing = {one.id: Rows({}, np.zeros(one.size), (one.size,)) for one, _ in self.entries}
        parts = [
            slopes.get(one.id, nothing[one.id]).taken(columns) for one, columns in self.entries
        ]
        first = box(self.decisions, self.lower, self.upper)
        F = Side(self._expression(stacked(parts)), "value")
        return Conditions(Complements(first, F), rows, bounds)

    # --- bounds ---

    def _add_attributes(self) -> None:
        """Add the bounds that attributes of the variables state."""
        for variable, columns in self.entries:
            stated = variable.attributes.get("bounds") or ()
            is_symbolic = any(isinstance(one, cp.Expression) for one in stated)
            ends = attribute_expressions(variable) if is_symbolic else attribute_bounds(variable)
            places = self.place[self.first[variable.id] + columns]
            for sign, end in zip((-1.0, 1.0), ends, strict=True):
                if is_symbolic:
                    bound = vector_of(end + np.zeros(variable.shape))[columns]
                else:
                    bound = by_columns(np.broadcast_to(end, variable.shape))[columns]
                self._tighten(SimpleBound(None, places, np.full(columns.size, sign), bound))

    def _simple(self, one: StandardRows, rows: Rows) -> SimpleBound | None:
        """Return the bounds that rows state if each holds one decision and numbers or parameters; otherwise None."""
        own = {key: block for key, block in rows.blocks.items() if key in self.own}
        others = {key: block for key, block in rows.blocks.items() if key not in self.own}
        is_excluded = rows.level or one.is_equation or one.origin.id in self.agent.shared
        if is_excluded or not own or any(self.vectors[key].variables() for key in others):
            return None
        matrix, _ = assembled([replace(rows, blocks=own)], self.first, self.place.size)
        places, weights = self.place[matrix.indices], matrix.data
        if not (is_definition(matrix) and weights.all() and (places >= 0).all()):
            return None
        rest = self._expression(replace(rows, blocks=others)) if others else rows.offset
        return SimpleBound(
            one.origin,
            places,
            weights,
            (cp.multiply if others else np.multiply)(-1.0 / weights, rest),
        )

    def _tighten(self, bound: SimpleBound) -> None:
        """Intersect the bounds of decisions with others."""
        for is_upper, (name, extreme) in enumerate((("lower", "maximum"), ("upper", "minimum"))):
            rows = np.flatnonzero((bound.weights > 0.0) == is_upper)
            places, end = bound.places[rows], getattr(self, name)
            stated = np.full(self.decisions.size, NO_BOUND * (1.0 if is_upper else -1.0))
            if isinstance(bound.bound, cp.Expression):
                stated[places] = 0.0
                spread = np.ones(rows.size), (places, rows)
                stated = (
                    sp.csc_array(spread, shape=(stated.size, bound.weights.size)) @ bound.bound
                    + stated
                )
            else:
                stated[places] = bound.bound[rows]
            is_number = isinstance(end, np.ndarray) and isinstance(stated, np.ndarray)
            setattr(self, name, getattr(np if is_number else cp, extreme)(end, stated))

    # --- expressions of cvxpy ---

    def _expression(self, rows: Rows) -> Any:
        """Return rows as a vector of cvxpy: one product of a sparse matrix with the sources, and a constant."""
        if not rows.blocks:
            return cp.Constant(rows.offset)
        parts = [self._vector(key) for key in rows.blocks]
        if rows.is_source:
            return parts[0]
        ends = np.cumsum([0, *(part.size for part in parts)])
        first = dict(zip(rows.blocks, ends.tolist(), strict=False))
        matrix, offset = assembled([rows], first, int(ends[-1]))
        return cp.Constant(sp.csc_array(matrix)) @ cp.hstack(parts) + offset

    def _vector(self, key: int) -> Any:
        """Return the vector of a source; a function becomes the atom of cvxpy, once."""
        if key not in self.vectors:
            _, function, arguments, _ = self.reader.compiler.groups[-1 - key]
            values = [self._expression(rows) for rows in arguments]
            exponent = function.name.removeprefix("power ")
            atom = ATOMS.get(function.name, lambda u: cp.power(u, float(exponent)))
            self.vectors[key] = atom(*values)
        return self.vectors[key]


def vector_of(expression: Any) -> Any:
    """Return an expression as a vector, column by column."""
    return expression if expression.ndim == 1 else cp.vec(expression, order="F")


def uninfluenced(roots: Iterable[Any], own: Collection[int]) -> list[Any]:
    """Return the largest subexpressions with variables or parameters, but without the agent's variables."""
    moving: set[int] = set()
    influenced: set[int] = set()
    found: dict[int, Any] = {}
    for root in roots:
        for node in postorder(root, ()):
            below = [id(one) for one in node.args]
            if isinstance(node, (cp.Variable, cp.Parameter)) or not moving.isdisjoint(below):
                moving.add(id(node))
            if (isinstance(node, cp.Variable) and node.id in own) or not influenced.isdisjoint(
                below
            ):
                influenced.add(id(node))
                if hidden := hidden_parameters(node):
                    raise UnsupportedModel(
                        f"{name_of(node)} has the parameter {hidden[0].name()} as its exponent or weight, and its "
                        "derivative cannot follow it; use a number"
                    )
                found |= {id(one): one for one in node.args if id(one) in moving - influenced}
        if id(root) in moving - influenced:
            found[id(root)] = root
    return list(found.values())


def with_data(entries: Sequence[Any], data: Callable[[Any], Any]) -> Callable[[Any], Any]:
    """Return the change of a node that replaces the variables that are not decisions."""
    masks: dict[int, Any] = {}
    for variable, columns in entries:
        masks.setdefault(variable.id, np.zeros(variable.size))[columns] = 1.0

    def change(node: Any) -> Any:
        if not isinstance(node, cp.Variable):
            return node
        mask = masks.get(node.id, np.zeros(node.size)).reshape(node.shape, order="F")
        if mask.all():
            return node
        return (
            cp.multiply(mask, node) + cp.multiply(1.0 - mask, data(node))
            if mask.any()
            else data(node)
        )

    return change
