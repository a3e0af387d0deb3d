"""A Pyomo model as the content of an ``.nl`` file; Pyomo writes the rows."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from pyomo import core
from pyomo.common.errors import InvalidValueError
from pyomo.core.expr.numvalue import is_potentially_variable
from pyomo.mpec import Complementarity
from pyomo.network import Port
from pyomo.repn.plugins.nl_writer import NLWriter
from pyomo.repn.util import categorize_valid_components

from ...core.checks import FloatVector
from ...core.errors import InvalidProblem, UnsupportedModel
from ..nl.reading import NLContent, Token, Trees, read_content
from .pairs import Pair, PairSide, cannot_vary, difference, number, paired, sides_of

KNOWN = {Complementarity, Port} | {
    getattr(core, name)
    for name in [
        "Block",
        "Constraint",
        "Expression",
        "ExternalFunction",
        "Objective",
        "Param",
        "RangeSet",
        "Set",
        "Suffix",
        "Var",
    ]
}
INTEGERS = (
    "apply gdp.bigm or gdp.hull and a solver for integers, or state the cases as complementarities"
)
INSTEAD = {
    "Disjunct": INTEGERS,
    "Disjunction": INTEGERS,
    "SOSConstraint": INTEGERS,
    "LogicalConstraint": INTEGERS,
    "BooleanVar": INTEGERS,
    "Arc": "expand it: TransformationFactory('network.expand_arcs')",
    "DerivativeVar": "discretise it, TransformationFactory('dae.collocation'), and add complementarities afterwards",
}
DISCRETISED = ("DerivativeVar",)
PLUS = 0  # the number of the operator
SOME = 5  # names that a message lists


@dataclass(frozen=True, eq=False)
class PyomoStatement:
    """A Pyomo model as arrays, with the map back to its components.

    Attributes
    ----------
    content : NLContent
    variables : list of VarData
        In the order of the content.
    rows : list
        Component that each row states: a ConstraintData, an equality given as ComplementarityData, or a Pair. For
        an added unknown, its name: the row is its equation.
    added : frozenset of int
        Numbers of the added unknowns.
    """

    content: NLContent
    variables: list[Any]
    rows: list[Any]
    added: frozenset[int]

    @property
    def in_a_file(self) -> NLContent:
        """The content for readers of ``.nl`` files: a pair's variable has all its finite bounds."""
        content = self.content
        if content.is_maximized.size:
            return content
        bound_bits = np.isfinite(content.lower) + 2 * np.isfinite(content.upper)
        bound_bits = np.where(
            content.partners >= 0, bound_bits[content.partners], content.partner_bounds
        )
        return replace(content, partner_bounds=bound_bits)


def stated(model: Any, path: Path) -> PyomoStatement:
    """Return the content of a Pyomo model or of one of its blocks, without changing the model.

    Parameters
    ----------
    model : Block
    path : Path
        Path of the ``.nl`` file that Pyomo writes.

    Raises
    ------
    UnsupportedModel
        Naming the component that is not taken.
    """
    if not (hasattr(model, "block_data_objects") and hasattr(model, "is_constructed")):
        raise UnsupportedModel(
            f"a Pyomo model or block is needed, got {type(model).__name__}; solve a model"
        )
    if not model.is_constructed():
        raise UnsupportedModel(
            "the model is abstract and holds no data yet; solve model.create_instance(…)"
        )
    _require_known(model)
    active = partial(
        model.component_data_objects,
        active=True,
        descend_into=True,
        sort=core.SortComponents.deterministic,
    )
    conditions, constraints = [*active(Complementarity)], [*active(core.Constraint)]
    objectives = [*active(core.Objective)]
    sides = [sides_of(condition) for condition in conditions]
    has_pairs = any(not any(side.is_equation for side in pair) for pair in sides)
    has_pairs |= any(hasattr(row, "_complementarity") for row in constraints)
    if has_pairs:
        objectives = [one for one in objectives if not cannot_vary(one.expr)]
    if len(objectives) > 1:
        raise UnsupportedModel(
            f"the model has {len(objectives)} active objectives; deactivate all but one"
        )
    is_whole = any(not one.is_continuous() for one in active(core.Var))
    draft = _Draft(is_search=bool(objectives) or is_whole)
    for row in constraints:
        draft.constrain(row)
    draft.pair(conditions, sides)
    return draft.written(objectives, has_pairs, path)


def _require_known(model: Any) -> None:
    unknown = categorize_valid_components(
        model, active=True, sort=core.SortComponents.deterministic, valid=KNOWN
    )[1]
    for kind in model.collect_ctypes(active=True):
        if kind.__name__ in DISCRETISED:  # these never report as active
            unknown[kind] = list(model.component_objects(kind))
    for kind, components in sorted(unknown.items(), key=lambda each: each[0].__name__):
        names = ", ".join(component.name for component in components[:SOME])
        instead = INSTEAD.get(
            kind.__name__, "deactivate it, or state it as constraints and complementarities"
        )
        raise UnsupportedModel(
            f"{kind.__name__} is not taken, and the model has {names}; {instead}"
        )


class _Draft:
    """Rows of a model, in a temporary model that shares the user's variables.

    Parameters
    ----------
    is_search : bool
        Whether all solutions of the pairs are searched, so that bounds and inequalities are constraints.
    """

    def __init__(self, *, is_search: bool) -> None:
        self.is_search = is_search
        self.model = core.ConcreteModel()
        self.model.rows = core.ConstraintList()
        self.model.added, self.model.zero = core.VarList(), core.Var(initialize=0.0)
        self.model.zero.fix()
        self.given: list[Any] = []
        self.states: dict[int, Any] = {}  # by the row's id
        self.partners: dict[int, tuple[Any, Pair]] = {}  # variable and pair, by the variable's id
        self.named: dict[int, str] = {}  # unknowns that were added

    def constrain(self, row: Any) -> None:
        """Take a constraint as a row."""
        self.given.append(row)
        self.states[id(row)] = row

    def pair(self, conditions: Sequence[Any], sides: Sequence[tuple[PairSide, PairSide]]) -> None:
        """Take the complementarities, first those that leave no choice of a partner."""
        choices = [sum(side.variable is not None for side in pair) for pair in sides]
        for condition, pair, _ in sorted(
            zip(conditions, sides, choices, strict=True), key=lambda each: each[2] != 1
        ):
            equation = next((side for side in pair if side.is_equation), None)
            if equation is not None:
                body = (
                    difference(equation.body, equation.lower) if equation.lower else equation.body
                )
                self.state(body, condition, 0.0, 0.0)
            else:
                self.hold(paired(condition, pair, lambda variable: id(variable) in self.partners))

    def hold(self, pair: Pair) -> None:
        """Take a pair: its variable, or an unknown that is added, goes with its row."""
        if pair.held.is_fixed and not self.is_search:
            self.look_at(pair)
            return
        variable = pair.held.variable
        if variable is None or id(variable) in self.partners:
            variable = self.model.added.add()
            self.named[id(variable)] = f"the unknown for {pair.stated.name}"
            variable.set_value(None if math.isnan(start := number(pair.held.body)) else start)
            self.state(difference(variable, pair.held.body), self.named[id(variable)], 0.0, 0.0)
        elif not self._own_bounds_count(variable, pair):
            self.state(variable, f"the bounds of {variable.name}", variable.lb, variable.ub)
        self.partners[id(variable)] = variable, pair
        self.state(pair.row, pair, 0.0, None)

    def look_at(self, pair: Pair) -> None:
        """Take the row of a fixed pair as inequalities: of one sign at a bound, of both between the bounds."""
        lower, held, upper = pair.held.lower, number(pair.held.body), pair.held.upper
        if lower <= held < upper:
            self.state(pair.row, pair.stated.name, 0.0, None)
        if lower < held <= upper:
            self.state(pair.row, pair.stated.name, None, 0.0)
        if not lower <= held <= upper:
            self.state(pair.held.body, pair.stated.name, lower, upper)

    def state(self, body: Any, what: Any, lower: float | None, upper: float | None) -> None:
        """Add a row lower ≤ body ≤ upper."""
        body = body if is_potentially_variable(body) else difference(body, self.model.zero)
        self.states[id(self.model.rows.add((lower, body, upper)))] = what

    def written(self, objectives: Sequence[Any], has_pairs: bool, path: Path) -> PyomoStatement:
        """Return the statement, through a file written by Pyomo."""
        if self.given:
            self.model.given = core.Reference(self.given, ctype=core.Constraint)
        if objectives:
            self.model.objective = core.Reference(list(objectives), ctype=core.Objective)
        content, variables, rows = self._through(path)
        if not variables:
            raise UnsupportedModel(
                "no active constraint, objective or complementarity has a free variable"
            )
        if has_pairs:
            content = self._paired(content, variables, rows)
        added = {id(variable) for variable in self.model.added.values()}
        numbers = frozenset(j for j, variable in enumerate(variables) if id(variable) in added)
        return PyomoStatement(content, variables, rows, numbers)

    def _through(self, path: Path) -> tuple[NLContent, list[Any], list[Any]]:
        """Write and read the rows; return content, variables, and the component of each row."""
        information = self._write(path, [])
        written = {id(variable) for variable in information.variables}
        absent = [variable for variable, _ in self.partners.values() if id(variable) not in written]
        if absent:
            information = self._write(path, absent)
        names = [
            self.named.get(id(variable)) or variable.name for variable in information.variables
        ]
        rows = [self.states.get(id(row), row) for row in information.constraints]
        content = replace(read_content(path), names=names, row_names=[_name(row) for row in rows])
        return content, list(information.variables), rows

    def _write(self, path: Path, exported: list[Any]) -> Any:
        with path.open("w", newline="", encoding="utf-8") as file:
            try:
                return NLWriter().write(
                    self.model,
                    file,
                    linear_presolve=False,
                    scale_model=False,
                    skip_trivial_constraints=False,
                    export_nonlinear_variables=exported or None,
                )
            except InvalidValueError as error:
                raise InvalidProblem(
                    f"numbers of a model must be finite: {' '.join(str(error).split())}"
                ) from error

    def _paired(self, content: NLContent, variables: list[Any], rows: list[Any]) -> NLContent:
        """Return the content with the pairs, and their bounds of variables."""
        number_of = {id(variable): j for j, variable in enumerate(variables)}
        partners, partner_bounds = content.partners.copy(), content.partner_bounds.copy()
        row_lower, row_upper = content.row_lower.copy(), content.row_upper.copy()
        constants = np.zeros(len(rows))
        lower, upper = content.lower.copy(), content.upper.copy()
        if (
            self.is_search
        ):  # if a pair of Pyomo's own transformation has no other bounds than it states
            transformed = np.flatnonzero(partners >= 0)
            own, stated_bits = partners[transformed], partner_bounds[transformed]
            lower[own[stated_bits & 1 == 0]], upper[own[stated_bits & 2 == 0]] = -np.inf, np.inf
        held_by = {id(pair): variable for variable, pair in self.partners.values()}
        for i, pair in enumerate(rows):
            variable = held_by.get(id(pair))
            if variable is None:
                continue
            j = number_of[id(variable)]
            constants[i] = -row_lower[i]
            row_lower[i], row_upper[i], partners[i] = -np.inf, np.inf, j
            lower[j], upper[j] = pair.held.lower, pair.held.upper
            if not self.is_search and self._own_bounds_count(variable, pair):
                own_lower, own_upper = _own_bounds(variable)
                lower[j], upper[j] = max(lower[j], own_lower), min(upper[j], own_upper)
            is_same = lower[j] == pair.held.lower, upper[j] == pair.held.upper
            partner_bounds[i] = (is_same[0] & np.isfinite(lower[j])) + 2 * (
                is_same[1] & np.isfinite(upper[j])
            )
        return replace(
            content,
            lower=lower,
            upper=upper,
            row_lower=row_lower,
            row_upper=row_upper,
            partners=partners,
            partner_bounds=partner_bounds,
            trees=with_constants(content.trees, constants),
        )

    def _own_bounds_count(self, variable: Any, pair: Pair) -> bool:
        """Return whether the bounds of a pair's variable need no row.

        In a search, only bounds that the pair implies need none. Otherwise bounds count as if the pair stated them,
        unless they exclude its bounds.
        """
        lower, upper = _own_bounds(variable)
        if self.is_search:
            return lower <= pair.held.lower and pair.held.upper <= upper
        return max(lower, pair.held.lower) <= min(upper, pair.held.upper)


def _own_bounds(variable: Any) -> tuple[float, float]:
    lower, upper = variable.bounds
    return -math.inf if lower is None else lower, math.inf if upper is None else upper


def _name(state: Any) -> str:
    return state if isinstance(state, str) else str(getattr(state, "stated", state).name)


def with_constants(trees: Trees, constants: FloatVector) -> Trees:
    """Return the trees with a number added to each, shape (m,).

    Parameters
    ----------
    trees : Trees
    constants : array, shape (m,)
    """
    tokens = np.array([trees.kinds, trees.values, trees.counts], dtype=np.float64)
    parts = [tokens[:, :0]]
    for constant, span in zip(constants.tolist(), pairwise(trees.starts.tolist()), strict=True):
        plus = [[Token.OPERATOR, Token.NUMBER], [PLUS, constant], [2, 0]]
        parts += (
            [np.array(plus), tokens[:, slice(*span)]] if constant else [tokens[:, slice(*span)]]
        )
    kinds, values, counts = np.concatenate(parts, axis=1)
    starts = trees.starts + 2 * np.append(0, np.cumsum(constants != 0.0))
    return Trees(kinds.astype(np.uint8), values, counts.astype(np.int64), starts)
