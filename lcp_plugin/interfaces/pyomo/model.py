"""A Pyomo model as the content of an ``.nl`` file: its rows by Pyomo's own writer, its pairs as they are stated."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from pyomo.common.errors import InvalidValueError
from pyomo.core import (
    Block,
    ConcreteModel,
    Constraint,
    ConstraintList,
    Expression,
    ExternalFunction,
    Objective,
    Param,
    RangeSet,
    Reference,
    Set,
    SortComponents,
    Suffix,
    Var,
    VarList,
)
from pyomo.core.expr.numvalue import is_potentially_variable
from pyomo.mpec import Complementarity
from pyomo.network import Port
from pyomo.repn.plugins.nl_writer import NLWriter
from pyomo.repn.util import categorize_valid_components

from ...core.checks import FloatVector
from ...core.errors import InvalidProblem, UnsupportedModel
from ..nl.checks import excess, pair_excess
from ..nl.content import NLContent, Token, Trees
from ..nl.reading import read_content
from .pairs import Pair, PairSide, cannot_vary, difference, number, paired, sides_of, unit

KNOWN = {
    Block, Complementarity, Constraint, Expression, ExternalFunction, Objective, Param, Port, RangeSet, Set, Suffix,
    Var,
}
INTEGERS = "apply gdp.bigm or gdp.hull and a solver for integers, or state the cases as complementarities"
INSTEAD = {
    "Disjunct": INTEGERS, "Disjunction": INTEGERS, "SOSConstraint": INTEGERS, "LogicalConstraint": INTEGERS,
    "BooleanVar": INTEGERS, "Arc": "expand it: TransformationFactory('network.expand_arcs')",
    "DerivativeVar": "discretise it, TransformationFactory('dae.collocation'), and add complementarities afterwards",
}
DISCRETISED = ("DerivativeVar",)
PLUS = 0  # the number of the operator
SOME = 5  # names that a message lists


@dataclass(frozen=True, eq=False)
class Beside:
    """What holds beside the square problem: `excess()` ≤ a tolerance at the values found; its row, an inequality."""

    name: str
    excess: Callable[[], float]
    why: str = "stands beside the pairs, and no unknown gives way to it"
    row: Any = None


@dataclass(frozen=True, eq=False)
class Statement:
    """A Pyomo model as arrays, and what leads back to it.

    Attributes
    ----------
    content : NLContent
    variables : list of VarData
        As the content numbers them.
    rows : list
        What each row states: a ConstraintData, a ComplementarityData that is an equation, a Pair, or the name of an
        unknown that was added, whose equation it is.
    added : frozenset of int
        The numbers of unknowns that were added.
    beside : list of Beside
    """

    content: NLContent
    variables: list[Any]
    rows: list[Any]
    added: frozenset[int]
    beside: list[Beside]

    @property
    def in_a_file(self) -> NLContent:
        """The content as other readers of ``.nl`` files take it: of a pair's variable all finite bounds are its own."""
        content = self.content
        if content.is_maximized.size:
            return content
        bound_bits = np.isfinite(content.lower) + 2 * np.isfinite(content.upper)
        bound_bits = np.where(content.partners >= 0, bound_bits[content.partners], content.partner_bounds)
        return replace(content, partner_bounds=bound_bits)

    @property
    def is_nonlinear(self) -> bool:
        """True where a row has a nonlinear term."""
        return self.content.trees.kinds.size > self.content.trees.size


def stated(model: Any, path: Path) -> Statement:
    """Return what a Pyomo model, or a block of one, states; nothing in it is changed.

    Parameters
    ----------
    model : Block
    path : Path
        Where Pyomo writes the ``.nl`` file.

    Raises
    ------
    UnsupportedModel
        Naming the component that is not taken.
    """
    if not hasattr(model, "component_data_objects"):
        raise UnsupportedModel(f"a Pyomo model or block is needed, got {type(model).__name__}; solve a model")
    if not getattr(model, "is_constructed", lambda: True)():  # pyomo.kernel has no abstract models
        raise UnsupportedModel("the model is abstract and holds no data yet; solve model.create_instance(…)")
    _require_known(model)
    in_order = SortComponents.deterministic
    conditions = list(model.component_data_objects(Complementarity, active=True, descend_into=True, sort=in_order))
    constraints = list(model.component_data_objects(Constraint, active=True, descend_into=True, sort=in_order))
    objectives = list(model.component_data_objects(Objective, active=True, descend_into=True, sort=in_order))
    sides = [sides_of(condition) for condition in conditions]
    has_pairs = any(not any(side.is_equation for side in pair) for pair in sides)
    has_pairs |= any(hasattr(row, "_complementarity") for row in constraints)
    if has_pairs:
        objectives = [one for one in objectives if not cannot_vary(one.expr)]
    if len(objectives) > 1:
        raise UnsupportedModel(f"the model has {len(objectives)} active objectives; deactivate all but one")
    is_whole = any(not one.is_continuous() for one in model.component_data_objects(Var, active=True, descend_into=True))
    for takes_inequalities in (not has_pairs or bool(objectives) or is_whole, False):
        draft = _Draft(takes_inequalities)
        for row in constraints:
            draft.constrain(row)
        draft.pair(conditions, sides)
        statement = draft.written(objectives, has_pairs, path)
        if not takes_inequalities or objectives or is_whole or not statement.is_nonlinear:
            break
    return statement


def _require_known(model: Any) -> None:
    unknown = categorize_valid_components(model, active=True, sort=SortComponents.deterministic, valid=KNOWN)[1]
    for kind in model.collect_ctypes(active=True):
        if kind.__name__ in DISCRETISED:  # these never report as active
            unknown[kind] = list(model.component_objects(kind))
    for kind, components in sorted(unknown.items(), key=lambda each: each[0].__name__):
        names = ", ".join(component.name for component in components[:SOME])
        instead = INSTEAD.get(kind.__name__, "deactivate it, or state it as constraints and complementarities")
        raise UnsupportedModel(f"{kind.__name__} is not taken, and the model has {names}; {instead}")


class _Draft:
    """The rows of the square problem in a model of their own, which shares the user's variables."""

    def __init__(self, takes_inequalities: bool) -> None:
        self.takes_inequalities = takes_inequalities
        self.model = ConcreteModel()
        self.model.rows, self.model.spare_rows = ConstraintList(), ConstraintList()
        self.model.added, self.model.zero = VarList(), Var(initialize=0.0)
        self.model.zero.fix()
        self.given: list[Any] = []
        self.states: dict[int, Any] = {}  # by the row's id
        self.partners: dict[int, tuple[Any, Pair]] = {}  # variable and pair, by the variable's id
        self.spare: list[Pair] = []
        self.named: dict[int, str] = {}  # unknowns that were added
        self.held: dict[int, tuple[float, float]] = {}  # what the pairs say of a variable
        self.beside: list[Beside] = []

    def constrain(self, row: Any) -> None:
        """Take a constraint as a row of a program, or an equation; beside it what is neither, or cannot vary."""
        is_equation = row.lb == row.ub and row.lb is not None
        is_row = is_equation or self.takes_inequalities or hasattr(row, "_complementarity")
        if not is_row or (not self.takes_inequalities and cannot_vary(row.body)):
            self.look_at(row.name, row.body, row.lb, row.ub, row)
        elif _is_of_kernel(row):
            self.states[id(self.model.rows.add((row.lb, row.body, row.ub)))] = row
        else:
            self.given.append(row)
            self.states[id(row)] = row

    def look_at(self, name: str, body: Any, lower: float | None, upper: float | None, row: Any = None) -> None:
        """Remember bounds that are looked at afterwards."""
        least, most = -math.inf if lower is None else lower, math.inf if upper is None else upper
        if math.isfinite(least) or math.isfinite(most):
            self.beside.append(Beside(name, lambda: _excess(body, least, most), row=row))

    def pair(self, conditions: Sequence[Any], sides: Sequence[tuple[PairSide, PairSide]]) -> None:
        """Take the complementarities, first those that leave no choice of a partner."""
        choices = [sum(side.variable is not None for side in pair) for pair in sides]
        for condition, pair, _ in sorted(zip(conditions, sides, choices, strict=True), key=lambda each: each[2] != 1):
            equation = next((side for side in pair if side.is_equation), None)
            if equation is not None:
                body = difference(equation.body, equation.lower) if equation.lower else equation.body
                self.state(self.model.rows, body, condition, equation=True)
            else:
                self.hold(paired(condition, pair, lambda variable: id(variable) in self.partners))
            for side in pair:
                if side.variable is not None and side.bounds:
                    self.held[id(side.variable)] = side.lower, side.upper

    def hold(self, pair: Pair) -> None:
        """Take a pair: its variable, or an unknown that is added, goes with its row."""
        if pair.held.is_fixed and not self.takes_inequalities:
            self.spare.append(pair)
            if not pair.is_at_bound:
                self.state(self.model.spare_rows, pair.row, pair, equation=True)
            return
        variable = pair.held.variable
        if variable is None or id(variable) in self.partners:
            variable = self.model.added.add()
            self.named[id(variable)] = f"the unknown for {pair.stated.name}"
            variable.set_value(None if math.isnan(start := number(pair.held.body)) else start)
            self.state(self.model.rows, difference(variable, pair.held.body), self.named[id(variable)], equation=True)
        elif self.takes_inequalities and not _is_implied(variable, pair):
            row = self.model.rows.add((variable.lb, variable, variable.ub))
            self.states[id(row)] = f"the bounds of {variable.name}"
        self.partners[id(variable)] = variable, pair
        self.state(self.model.rows, pair.row, pair)

    def state(self, rows: Any, body: Any, what: Any, equation: bool = False) -> None:
        """Add a row body ≥ 0, or an equation body == 0."""
        body = body if is_potentially_variable(body) else difference(body, self.model.zero)
        self.states[id(rows.add((0.0, body, 0.0 if equation else None)))] = what

    def written(self, objectives: Sequence[Any], has_pairs: bool, path: Path) -> Statement:
        """Return the statement, through a file written by Pyomo."""
        if self.given:
            self.model.given = Reference(self.given, ctype=Constraint)
        if objectives and _is_of_kernel(objectives[0]):
            self.model.objective = Objective(expr=objectives[0].expr, sense=objectives[0].sense)
        elif objectives:
            self.model.objective = Reference(list(objectives), ctype=Objective)
        content, variables, rows = self._through(path)
        if len(rows) > len(variables) and len(self.model.spare_rows):  # as that of a price which is the unit
            self.model.spare_rows.deactivate()
            content, variables, rows = self._through(path)
        if not variables:
            raise UnsupportedModel("no active constraint, objective or complementarity has a free variable")
        if has_pairs:
            content = self._paired(content, variables, rows)
        for pair in self.spare:
            why = "holds a side that is fixed, so that no unknown gives way to it"
            self.beside.append(Beside(pair.stated.name, partial(_pair_excess, pair), why))
        added = {id(variable) for variable in self.model.added.values()}
        numbers = frozenset(j for j, variable in enumerate(variables) if id(variable) in added)
        return Statement(content, variables, rows, numbers, self.beside)

    def _through(self, path: Path) -> tuple[NLContent, list[Any], list[Any]]:
        """Write and read the rows; return their content, the variables, and what each row states."""
        information = self._write(path, [])
        written = {id(variable) for variable in information.variables}
        absent = [variable for variable, _ in self.partners.values() if id(variable) not in written]
        if absent:
            information = self._write(path, absent)
        for variable in information.variables:
            if not variable.is_continuous() and not self.partners:
                raise UnsupportedModel(
                    f"the variable {variable.name} is integer, and integers are taken beside complementarities only; "
                    "give it a continuous domain"
                )
        names = [self.named.get(id(variable)) or variable.name for variable in information.variables]
        rows = [self.states.get(id(row), row) for row in information.constraints]
        content = replace(read_content(path), names=names, row_names=[_name(row) for row in rows])
        return content, list(information.variables), rows

    def _write(self, path: Path, exported: list[Any]) -> Any:
        with path.open("w", newline="", encoding="utf-8") as file:
            try:
                return NLWriter().write(
                    self.model, file, linear_presolve=False, scale_model=False, skip_trivial_constraints=False,
                    export_nonlinear_variables=exported or None,
                )
            except InvalidValueError as error:
                raise InvalidProblem(f"numbers of a model must be finite: {' '.join(str(error).split())}") from error

    def _paired(self, content: NLContent, variables: list[Any], rows: list[Any]) -> NLContent:
        """Return the content with the pairs' bounds of variables, and no others but of a program."""
        number_of = {id(variable): j for j, variable in enumerate(variables)}
        partners, partner_bounds = content.partners.copy(), content.partner_bounds.copy()
        row_lower, row_upper = content.row_lower.copy(), content.row_upper.copy()
        constants = np.zeros(len(rows))
        lower, upper = np.full(len(variables), -np.inf), np.full(len(variables), np.inf)
        if self.takes_inequalities:
            lower[:], upper[:] = np.transpose([_own_bounds(variable) for variable in variables])
        for i in np.flatnonzero(content.partners >= 0).tolist():
            j = content.partners[i]
            counts = 3 if not self.takes_inequalities else partner_bounds[i]
            lower[j] = content.lower[j] if counts & 1 else -np.inf
            upper[j] = content.upper[j] if counts & 2 else np.inf
        held_by = {id(pair): variable for variable, pair in self.partners.values()}
        for i, pair in enumerate(rows):
            variable = held_by.get(id(pair))
            if variable is None:
                continue
            j = number_of[id(variable)]
            constants[i] = -row_lower[i]
            row_lower[i], row_upper[i], partners[i] = -np.inf, np.inf, j
            lower[j], upper[j] = self._within(variable, pair)
            is_same = lower[j] == pair.held.lower, upper[j] == pair.held.upper
            partner_bounds[i] = (is_same[0] & np.isfinite(lower[j])) + 2 * (is_same[1] & np.isfinite(upper[j]))
        if not self.takes_inequalities:
            self._look_at_bounds(variables, set(partners.tolist()))
        return replace(
            content, lower=lower, upper=upper, row_lower=row_lower, row_upper=row_upper, partners=partners,
            partner_bounds=partner_bounds, trees=with_constants(content.trees, constants),
        )

    def _within(self, variable: Any, pair: Pair) -> tuple[float, float]:
        """Return the bounds of a pair within the variable's own, which count as if it stated them."""
        own_lower, own_upper = _own_bounds(variable)
        lower, upper = max(pair.held.lower, own_lower), min(pair.held.upper, own_upper)
        if self.takes_inequalities:  # all solutions are searched, and bounds are constraints
            return pair.held.lower, pair.held.upper
        if lower <= upper:
            return lower, upper
        self.look_at(variable.name, variable, own_lower, own_upper)
        return pair.held.lower, pair.held.upper

    def _look_at_bounds(self, variables: list[Any], partners: set[int]) -> None:
        """Remember the own bounds of variables that no row holds and no pair implies."""
        for j, variable in enumerate(variables):
            lower, upper = _own_bounds(variable)
            least, most = self.held.get(id(variable), (-math.inf, math.inf))
            if j not in partners and (lower > least or upper < most):
                self.look_at(variable.name, variable, lower, upper)


def _is_of_kernel(component: Any) -> bool:
    """Return whether a component is one of pyomo.kernel, which a reference of Pyomo's other models cannot hold."""
    return not hasattr(component, "parent_component")


def _is_implied(variable: Any, pair: Pair) -> bool:
    lower, upper = _own_bounds(variable)
    return lower <= pair.held.lower and pair.held.upper <= upper


def _own_bounds(variable: Any) -> tuple[float, float]:
    lower, upper = variable.bounds
    return -math.inf if lower is None else lower, math.inf if upper is None else upper


def _name(state: Any) -> str:
    return state if isinstance(state, str) else str(getattr(state, "stated", state).name)


def _excess(body: Any, lower: float, upper: float) -> float:
    found = number(body)
    return 0.0 if lower <= found <= upper else float(excess(found, lower, upper, unit(body)))


def _pair_excess(pair: Pair) -> float:
    row, held = pair.row, pair.held
    return float(pair_excess(number(held.body), number(row), held.lower, held.upper, unit(row)))


def with_constants(trees: Trees, constants: FloatVector) -> Trees:
    """Return the trees with a number added to each, shape (m,).

    Parameters
    ----------
    trees : Trees
    constants : array, shape (m,)
    """
    first = trees.starts[:-1]
    is_number = (np.diff(trees.starts) == 1) & (trees.kinds[first] == Token.NUMBER)
    values = trees.values.copy()
    values[first[is_number]] += constants[is_number]
    others = np.flatnonzero(~is_number & (constants != 0.0))
    at = np.repeat(first[others], 2)
    pairs = np.arange(at.size) % 2
    operators = np.where(pairs == 0, Token.OPERATOR, Token.NUMBER).astype(np.uint8)
    sums = np.where(pairs == 0, PLUS, np.repeat(constants[others], 2))
    added = np.zeros(trees.size, dtype=np.int64)
    added[others] = 2
    counts = np.insert(trees.counts, at, 2 * (1 - pairs))
    return Trees(
        np.insert(trees.kinds, at, operators), np.insert(values, at, sums), counts,
        trees.starts + np.concatenate([[0], np.cumsum(added)]), trees.strings,
    )
