"""The optimality conditions of an agent's program: multipliers, bounds, and the gradient of the Lagrangian."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cached_property, partial
from typing import Any, NamedTuple

import cvxpy as cp
import numpy as np
import scipy.sparse as sp
from cvxpy.atoms.affine.add_expr import AddExpression
from cvxpy.atoms.elementwise.power import Power
from cvxpy.constraints import Inequality

from ..core.checks import Indices, Vector
from ..core.errors import UnsupportedModel
from ..expressions import functions
from ..expressions.rows import Rows, as_matrix, assembled, is_definition
from ..problems.statement import name_of_row
from . import _compat as compat
from ._compat import EQUATIONS, by_columns, by_id, dense, name_of
from .constraint import Complements, box
from .model import Side, spans_of
from .reading import Reader, rewritten


def _huber(node: cp.Expression, arguments: list[Any]) -> tuple[Any, list[Any]]:
    """Return min (x − s)² + 2 M |s| over s, which is huber(x, M), and its inequalities."""
    s, t = cp.Variable(node.shape), cp.Variable(node.shape)
    return cp.square(arguments[0] - s) + 2 * node.M * t, [s <= t, -s <= t]


def _name_of_optimality(variable: Any, columns: Indices, k: int) -> str:
    """Return the name of the row of decision k of a variable: optimality of output[0]."""
    return f"optimality of {compat.entry_of(variable, columns[k])}"


#: Atoms with kinks, and functions that return their epigraphs: a value, and inequalities.
GRAPHS = {**compat.KINKS, cp.huber: _huber}


def _positive_power(u: Vector, p: float) -> Any:
    """Return u**p, NaN for u < 0: the derivative of a function that is not defined there."""
    return cp.power(cp.sqrt(u), 2 * p)


#: The atom of an elementary function, and its derivatives by its arguments; r is its value.
CVXPY_FUNCTIONS: dict[str, tuple[Any, Any]] = {
    functions.SAME.name: (lambda u: u, lambda r, u: [np.ones(u.shape)]),
    functions.EXP.name: (cp.exp, lambda r, u: [r]),
    functions.LOG.name: (cp.log, lambda r, u: [_positive_power(u, -1)]),
    functions.LOG1P.name: (cp.log1p, lambda r, u: [_positive_power(1 + u, -1)]),
    functions.SQUARE.name: (cp.square, lambda r, u: [2 * u]),
    functions.PRODUCT.name: (cp.multiply, lambda r, u, v: [v, u]),
    functions.QUOTIENT.name: (lambda u, v: u / v, lambda r, u, v: [cp.power(v, -1), -r / v]),
    functions.RELATIVE_ENTROPY.name: (
        cp.rel_entr,
        lambda r, u, v: [1 + cp.log(u) - cp.log(v), -cp.multiply(u, _positive_power(v, -1))],
    ),
    functions.LOG_ADD_EXP.name: (
        lambda u, v: cp.logistic(u - v) + v,
        lambda r, u, v: [cp.power(1 + cp.exp(v - u), -1), cp.power(1 + cp.exp(u - v), -1)],
    ),
}


def function_of(name: str) -> tuple[Any, Any]:
    """Return the atom and the derivatives of an elementary function."""
    if name in CVXPY_FUNCTIONS:
        return CVXPY_FUNCTIONS[name]
    p = float(name.removeprefix("power "))
    slope = _positive_power if p < 0.0 else cp.power
    return lambda u: cp.power(u, p), lambda r, u: [p * slope(u, p - 1)]


class SimpleBound(NamedTuple):
    """Rows that bound one decision each: weights · decisions[places] ≤ weights · end.

    Attributes
    ----------
    rows : StandardRows or None
        None for bounds that attributes state.
    places : ndarray of int
    weights : ndarray
    end : ndarray or cvxpy expression
        An expression if the bound has parameters.
    """

    rows: StandardRows | None
    places: Indices
    weights: Vector
    end: Any


class StandardRows(NamedTuple):
    """Rows of a constraint of an agent's program: expression ≤ 0 or = 0, as cvxpy's dual values count it.

    Attributes
    ----------
    origin : cvxpy constraint
    expression : cvxpy expression
    is_equation : bool
    kept : ndarray of int or slice
        Entries of the constraint, column by column, that the expression holds.
    """

    origin: Any
    expression: cp.Expression
    is_equation: bool
    kept: Any = slice(None)

    @classmethod
    def of(cls, constraint: cp.Constraint, change: Any = lambda node: node) -> list[StandardRows]:
        """Return the rows of a cvxpy constraint, each node changed; none if all entries hold for all variables.

        Raises
        ------
        UnsupportedModel
            If data are NaN or infinite, except for entries of one side of an inequality that then always hold.
        """
        kept: Any = slice(None)
        expression: Any = compat.expression_of(constraint)
        is_equation = isinstance(constraint, EQUATIONS)
        for k, side in enumerate(constraint.args if isinstance(constraint, Inequality) else ()):
            if side.variables() or side.parameters() or not np.isinf(dense(side.value)).any():
                continue
            ends = np.broadcast_to(dense(side.value), constraint.shape)
            always = np.inf if k else -np.inf
            limit = cp.Constant(np.where(ends == always, 0.0, ends))
            difference = constraint.args[0] - limit if k else limit - constraint.args[1]
            kept = np.flatnonzero(by_columns(ends) != always)
            expression = vector_of(difference)[kept]
        if not expression.size:
            return []
        for leaf in (*expression.constants(), *expression.parameters()):
            if leaf.value is not None and not np.isfinite(compat.stored_entries(leaf.value)).all():
                named = f"the parameter {leaf.name()} of " if isinstance(leaf, cp.Parameter) else ""
                raise UnsupportedModel(
                    f"{named}{name_of(constraint)} in an agent's program is not finite; only a constant side of an "
                    "inequality may be infinite, if the inequality then holds: repair the data, or leave it out"
                )
        expression = rewritten(expression, change)
        if isinstance(constraint, cp.constraints.NonNeg):
            expression = -expression
        return [cls(constraint, expression, is_equation, kept)]

    def whole(self, values: object) -> Any:
        """Return values of the rows in the shape of the constraint, 0 in other entries."""
        entries = np.zeros(self.origin.size)
        entries[self.kept] = by_columns(values)
        return entries.reshape(self.origin.shape, order="F")


class AgentProgram:
    """An agent's program without kinks, read as rows over its decisions and over all that it does not influence.

    It is one class because the conditions refer to the decisions, multipliers and domains that were read.

    Parameters
    ----------
    agent : Optimal

    Attributes
    ----------
    goal : cvxpy expression
    F : cvxpy expression, shape (number of decisions,), or None
        Map of a variational inequality; the goal is 0 then.
    standard : list of StandardRows
        Constraints of the program, then of epigraphs.
    entries : list of tuple
        Variables and their entries that are decisions, epigraphs included.
    stationarity : Complements
        The vector of all decisions between their bounds, with the gradient of the Lagrangian.
    rows : dict
        The pair of each constraint with a multiplier, and the multiplier, by the id of the constraint.
    bounds : list of SimpleBound
        The other constraints.
    domain : list of Domain
        Conditions under which the functions of the program are defined.
    has_kinks : bool
    """

    def __init__(self, agent: Any) -> None:
        program = agent.program
        known, epigraphs, new = by_id(program.variables()), [], {}
        self.agent, self.variables = agent, by_id(variable for variable, _ in agent.entries)
        self.decision_ids = set(self.variables)

        def change(node: cp.Expression) -> Any:
            graph = GRAPHS.get(type(node))
            is_smooth = graph is None and not isinstance(node, compat.NONSMOOTH)
            if is_smooth or self.decision_ids.isdisjoint(by_id(node.variables())):
                return node
            if graph is None:
                raise UnsupportedModel(
                    f"{name_of(node)} in an agent's program has no epigraph of linear inequalities; write a norm as "
                    'cp.sum_squares(x) <= t**2, t constant, or cp.sqrt(cp.sum_squares(x) + 1e-9) with check="local"'
                )
            value, inequalities = graph(node, node.args)
            for part in (value, *inequalities):
                new.update(by_id(v for v in part.variables() if v.id not in known))
            self.decision_ids.update(new)
            epigraphs.extend(inequalities)
            return value

        of_F = agent.F is not None
        self.goal = cp.Constant(0.0) if of_F else rewritten(program.objective.args[0], change)
        stated = by_id(program.constraints).values()
        self.standard = [row for item in stated for row in StandardRows.of(item, change)]
        self.standard += [row for inequality in epigraphs for row in StandardRows.of(inequality)]
        self.has_kinks = bool(new)
        self.variables |= new
        self.entries = [*agent.entries, *((v, np.arange(v.size)) for v in new.values())]
        self.decisions = joined([*agent.decisions, *new.values()])
        zeros = [cp.Constant(np.zeros(v.size)) for v in new.values()]  # F of epigraphs
        self.F = joined([agent.F, *zeros]) if of_F else None
        spans, size = spans_of(self.variables)
        #: The first number of each variable's entries, and the decision with a number; −1 if it is not a decision.
        self.first, self.place = {key: span.start for key, span in spans.items()}, np.full(size, -1)
        numbers = np.concatenate([self.first[v.id] + columns for v, columns in self.entries])
        self.place[numbers] = np.arange(numbers.size)
        self.reader = Reader(takes_integers=True)
        self.roots = [self.goal, *(standard.expression for standard in self.standard)]
        # Keys larger than any id of a variable
        nodes = enumerate(uninfluenced(self.roots, self.decision_ids), 2**61)
        held = {node.id if isinstance(node, cp.Variable) else k: node for k, node in nodes}
        self.reader.hold(held)
        #: Expressions behind the sources as vectors, by their keys; a function is added at its first use.
        self.sources = {key: vector_of(node) for key, node in (held | self.variables).items()}
        self.rows: dict[int, tuple[Complements, Any]] = {}
        self.values: dict[int, list[Any]] = {}  # the arguments of functions, by their keys
        self.bounds: list[SimpleBound] = []
        no_bounds = [np.full(numbers.size, end) for end in (-np.inf, np.inf)]
        self._read_ends = 0, no_bounds  # how many bounds were read, and the ends by them
        self._state()

    def _state(self) -> None:
        """Read the constraints; write the pairs of multipliers, and of decisions with the gradient."""
        sense = cp.Constant([compat.sense_of(self.agent.program)])
        weighted: list[tuple[Rows, Any]] = [(self.reader.rows(self.goal), sense)]
        read = [(standard, self.reader.rows(standard.expression)) for standard in self.standard]
        others = [row for row in read if not self._add_bound(*row)]
        self.domain = domain_of(self.roots, self.decision_ids)
        for row in (row for condition in self.domain for row in self._inside(condition)):
            self._add_bound(*row)  # may imply other conditions
        inside = [row for condition in self.domain for row in self._inside(condition)]
        for standard, rows in others + [row for row in inside if self._simple(*row) is None]:
            stated = partial(compat.row_of, standard.expression, constraint=standard.origin)
            name = f"multiplier of {getattr(standard.origin, 'label', None) or name_of(standard.origin)}"
            multiplier = cp.Variable(standard.expression.shape, name=name)
            if standard.origin.id in self.agent.shared:
                if standard.expression.size < standard.origin.size:
                    raise UnsupportedModel(
                        f"the shared constraint {name_of(standard.origin)} is infinite in some entries; leave them out"
                    )
                multiplier = standard.origin.dual_variables[0]
            if multiplier.value is None and self.decisions.value is not None:
                multiplier.value = np.zeros(multiplier.shape)  # a start for the run
            weighted.append((rows, vector_of(multiplier)))
            first = box(multiplier, -np.inf if standard.is_equation else 0.0, np.inf)
            form = "value" if standard.is_equation else "nonnegative"
            second = Side(-standard.expression, form, standard.origin)
            pair = Complements(first, second)
            pair.name_of_row = stated
            self.rows[standard.origin.id] = pair, multiplier
        first = box(self.decisions, *self._ends())
        gradient = self._gradient(weighted)
        gradient = gradient if self.F is None else self.F + gradient
        self.stationarity = Complements(first, Side(gradient, "value"))
        named: list[Any] = [(e[1].size, partial(_name_of_optimality, *e)) for e in self.entries]
        self.stationarity.name_of_row = partial(name_of_row, named, range(self.decisions.size))

    def _add_bound(self, standard: StandardRows, rows: Rows) -> bool:
        """Store rows that only bound decisions; return whether they do."""
        if (bound := self._simple(standard, rows)) is not None:
            self.bounds.append(bound)
        return bound is not None

    def _inside(self, domain: Domain) -> Iterator[tuple[StandardRows, Rows]]:
        """Yield the rows of a condition of the domain that bounds, signs and slopes do not imply."""
        rows = self.reader.rows(domain.condition.expr)
        largest = rows.offset.copy()
        for key, block in rows.blocks.items():
            low, high = self._range(key)
            i, j, a = sp.find(as_matrix(block, rows.size))  # without zeros: 0 · ∞ is NaN
            np.add.at(largest, i, a * np.where(a > 0.0, high[j], low[j]))
        if (needed := np.flatnonzero(largest > 0.0)).size:
            (standard,) = StandardRows.of(vector_of(domain.condition.expr)[needed] <= 0)
            rows = rows.taken(needed)
            if not domain.is_steep or self._simple(standard, rows) is not None:
                yield standard, rows

    def _range(self, key: int) -> list[Vector]:
        """Return bounds of the entries of a source, from numbers and signs, for all values of parameters."""
        source = self._source(key)
        ends = 0.0 if source.is_nonneg() else -np.inf, 0.0 if source.is_nonpos() else np.inf
        bounds = [np.full(source.size, end) for end in ends]
        if key in self.first:
            places = self.place[self.first[key] :][: source.size]
            for bound, end in zip(bounds, self._ends(is_numeric=True), strict=True):
                bound[places >= 0] = end[places[places >= 0]]
        return bounds

    def _gradient(self, weighted: list[tuple[Rows, Any]]) -> Any:
        """Return the gradient of Σ weights · rows by all decisions; its functions are elementary functions again."""
        groups, active = self.reader.compiler.groups, set(self.decision_ids)
        for _, _, arguments, key in groups:
            if any(not active.isdisjoint(rows.blocks) for rows in arguments):
                active.add(key)
        adjoints: dict[int, list[Any]] = {key: [] for key in active}

        def distribute(rows: Rows, weights: Vector) -> None:
            for key in active.intersection(rows.blocks):
                block = rows.blocks[key]
                adjoints[key].append(times(block if isinstance(block, float) else block.T, weights))

        for rows, weights in weighted:
            distribute(rows, weights)
        for _, function, arguments, key in reversed(groups):
            if adjoints.get(key):
                result, values = self._source(key), self.values[key]
                slopes = function_of(function.name)[1](result, *values)
                for rows, slope in zip(arguments, slopes, strict=True):
                    distribute(rows, cp.multiply(sum(adjoints[key]), slope))
        zeros = {key: cp.Constant(np.zeros(v.size)) for key, v in self.variables.items()}
        total = {key: sum(adjoints[key], zero) for key, zero in zeros.items()}
        return joined([total[variable.id][columns] for variable, columns in self.entries])

    @property
    def pairs(self) -> list[Complements]:
        """All conditions."""
        return [self.stationarity, *(pair for pair, _ in self.rows.values())]

    def duals(self) -> dict[int, Any]:
        """Return the dual values by the id of the constraint; the tightest bound takes w⁺ or w⁻ of its decision."""
        if (w := self.stationarity.dual_value) is None:
            return {}
        duals = {row.id: np.zeros(row.shape) for row in self.agent.program.constraints}
        for standard in self.standard:
            if (key := standard.origin.id) in self.rows:
                duals[key] = standard.whole(self.rows[key][1].value)
        left = np.maximum(w, 0.0), np.maximum(-w, 0.0)
        for bound in self.bounds:
            value = np.broadcast_to(getattr(bound.end, "value", bound.end), bound.weights.shape)
            dual = np.zeros(value.size)
            for is_upper, end in enumerate(self.stationarity.first.bounds()):
                is_tight = ((bound.weights > 0.0) == is_upper) & (value == end[bound.places])
                places = bound.places[is_tight]
                dual[is_tight] = left[is_upper][places] / np.abs(bound.weights[is_tight])
                left[is_upper][places] = 0.0
            if bound.rows is not None:
                duals[bound.rows.origin.id] = bound.rows.whole(dual)
        return duals

    # --- bounds ---

    @cached_property
    def _of_attributes(self) -> list[SimpleBound]:
        """Bounds by the attributes of the variables."""
        bounds = []
        for variable, columns in self.entries:
            stated = variable.attributes.get("bounds") or ()
            is_symbolic = any(isinstance(part, cp.Expression) for part in stated)
            read = compat.attribute_expressions if is_symbolic else compat.attribute_bounds
            places = self.place[self.first[variable.id] + columns]
            for sign, end in zip((-1.0, 1.0), read(variable), strict=True):
                whole = end + np.zeros(variable.shape)
                bound = (vector_of if is_symbolic else by_columns)(whole)[columns]
                bounds.append(SimpleBound(None, places, np.full(columns.size, sign), bound))
        return bounds

    def _ends(self, *, is_numeric: bool = False) -> list[Any]:
        """Return the lower and the upper bounds of all decisions, by attributes and constraints, or by numbers only."""
        stated, (count, ends) = [*self._of_attributes, *self.bounds], self._read_ends
        for bound in stated[count:]:
            if not isinstance(bound.end, cp.Expression):
                is_upper = bound.weights > 0.0
                values = np.broadcast_to(bound.end, is_upper.shape)
                np.maximum.at(ends[0], bound.places[~is_upper], values[~is_upper])
                np.minimum.at(ends[1], bound.places[is_upper], values[is_upper])
        self._read_ends = len(stated), ends
        if is_numeric:
            return ends
        # The constants of an expression must be finite; box reads 1e30 as ∞
        expressions: list[Any] = [np.clip(end, -1e30, 1e30) for end in ends]
        for bound in (bound for bound in stated if isinstance(bound.end, cp.Expression)):
            for k, (sign, extreme) in enumerate(((-1.0, cp.maximum), (1.0, cp.minimum))):
                rows = np.flatnonzero(sign * bound.weights > 0.0)
                places, shape = bound.places[rows], (self.decisions.size, bound.weights.size)
                others = np.full(self.decisions.size, sign * 1e30)
                others[places] = 0.0
                spread = sp.csc_array((np.ones(rows.size), (places, rows)), shape)
                expressions[k] = extreme(expressions[k], spread @ bound.end + others)
        return expressions

    def _simple(self, standard: StandardRows, rows: Rows) -> SimpleBound | None:
        """Return the bounds that rows state if each holds one decision and numbers or parameters; otherwise None."""
        decided = {key: block for key, block in rows.blocks.items() if key in self.decision_ids}
        others = {key: block for key, block in rows.blocks.items() if key not in self.decision_ids}
        is_excluded = rows.level or standard.is_equation or standard.origin.id in self.agent.shared
        if is_excluded or not decided or any(self.sources[key].variables() for key in others):
            return None
        matrix, _ = assembled([replace(rows, blocks=decided)], self.first, self.place.size)
        places, weights = self.place[matrix.indices], matrix.data
        if not (is_definition(matrix) and weights.all() and (places >= 0).all()):
            return None
        shift = self._expression(replace(rows, blocks=others)) if others else rows.offset
        times = cp.multiply if others else np.multiply
        return SimpleBound(standard, places, weights, times(-1.0 / weights, shift))

    # --- expressions of cvxpy ---

    def _expression(self, rows: Rows) -> Any:
        """Return rows as a vector of cvxpy: a sum of multiples of sources and a constant."""
        parts = [cp.Constant(rows.offset)] if rows.offset.any() or not rows.blocks else []
        parts += [times(block, self._source(key)) for key, block in rows.blocks.items()]
        return AddExpression(parts) if len(parts) > 1 else parts[0]

    def _source(self, key: int) -> Any:
        """Return the expression of a source; a function becomes the atom of cvxpy, once."""
        if key not in self.sources:
            _, function, arguments, _ = self.reader.compiler.groups[-1 - key]
            self.values[key] = [self._expression(rows) for rows in arguments]
            self.sources[key] = function_of(function.name)[0](*self.values[key])
        return self.sources[key]


def vector_of(expression: cp.Expression) -> Any:
    """Return an expression as a vector, column by column."""
    return expression if expression.ndim == 1 else cp.vec(expression, order="F")


def times(block: Any, vector: Any) -> Any:
    """Return a block times a vector of cvxpy; a number is a multiple of the identity."""
    if not isinstance(block, float):
        return cp.Constant(sp.csc_array(block)) @ vector
    if abs(block) == 1.0:
        return vector if block == 1.0 else -vector
    return block * vector


def joined(parts: Sequence[Any]) -> Any:
    """Return one vector of all entries."""
    vectors = [vector_of(part) for part in parts]
    return cp.hstack(vectors) if len(vectors) > 1 else vectors[0]


class Domain(NamedTuple):
    """Condition under which an atom is defined by cvxpy's rules: least ≤ argument.

    Attributes
    ----------
    condition : cvxpy constraint
    is_steep : bool
        Whether slopes grow without limit at the boundary.
    """

    condition: Any
    is_steep: bool


def domain_of(roots: Sequence[Any], decision_ids: set[int]) -> list[Domain]:
    """Return the conditions on the agent's variables under which expressions are defined, as y >= 0 of log(y), y**3."""
    return [part for node in compat.postorder(roots) for part in _node_domain(node, decision_ids)]


def _node_domain(node: cp.Expression, decision_ids: set[int]) -> list[Domain]:
    """Return the conditions of one node."""
    exponent = node.p.value if isinstance(node, Power) else 0.0
    if not node.args or exponent is None or decision_ids.isdisjoint(by_id(node.variables())):
        return []
    is_steep = not (isinstance(node, cp.xexp) or np.all(exponent > 1.0))
    conditions = (c for c in node._domain() if not decision_ids.isdisjoint(by_id(c.variables())))
    return [Domain(condition, is_steep) for condition in conditions]


def violated_domain(roots: Sequence[Any], decision_ids: set[int]) -> Any:
    """Return a condition of the domain that present values violate; None if there is none."""
    for condition, _ in domain_of(roots, decision_ids):
        size = max(np.abs(dense(v.value)).max(initial=1.0) for v in condition.variables())
        # Size is max(1, |x|): a condition of the domain is violated by more than rounding
        if not np.all(dense(condition.expr.value) <= 1e-8 * size):
            return condition
    return None


def value_in_domain(expression: cp.Expression, decision_ids: set[int]) -> Any:
    """Return the value of an expression, with arguments at least at the boundary of their domain."""

    def change(node: cp.Expression) -> Any:
        conditions = [domain.condition for domain in _node_domain(node, decision_ids)]
        least = {id(condition.args[1]): condition.args[0] for condition in conditions}
        inside = [cp.maximum(least[id(k)], k) if id(k) in least else k for k in node.args]
        return node.copy(inside) if least else node

    return rewritten(expression, change).value


def uninfluenced(roots: Sequence[Any], decision_ids: Collection[int]) -> list[Any]:
    """Return the largest subexpressions with variables or parameters, but without the agent's variables."""
    moving: set[int] = set()
    influenced: set[int] = set()
    largest: dict[int, Any] = {}
    for node in compat.postorder(roots):
        below = [id(argument) for argument in node.args]
        if isinstance(node, (cp.Variable, cp.Parameter)) or not moving.isdisjoint(below):
            moving.add(id(node))
        is_decision = isinstance(node, cp.Variable) and node.id in decision_ids
        if is_decision or not influenced.isdisjoint(below):
            influenced.add(id(node))
            largest |= dict(zip(below, node.args, strict=True))
    largest |= {id(root): root for root in roots}
    return [largest[key] for key in largest if key in moving and key not in influenced]


def with_data(entries: Sequence[Any], data: Mapping[int, Any]) -> Callable[[Any], Any]:
    """Return the change of a node that puts data, by id, in place of variables that are not among the entries."""
    masks: dict[int, Any] = {}
    for variable, columns in entries:
        masks.setdefault(variable.id, np.zeros(variable.size))[columns] = 1.0

    def change(node: cp.Expression) -> Any:
        if not isinstance(node, cp.Variable) or (mask := masks.get(node.id, np.zeros(1))).all():
            return node
        if not mask.any():
            return data[node.id]
        mask = mask.reshape(node.shape, order="F")
        return cp.multiply(mask, node) + cp.multiply(1.0 - mask, data[node.id])

    return change
