"""Pyomo models as the content of an ``.nl`` file, whose rows Pyomo writes; answers are put back into the model."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import chain
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple, NoReturn

import numpy as np
import scipy.sparse as sp
from pyomo import core
from pyomo.common.collections import ComponentMap, ComponentSet
from pyomo.common.errors import InvalidValueError
from pyomo.core import Constraint, Var
from pyomo.core.expr import SumExpression, identify_variables
from pyomo.core.expr.numvalue import is_potentially_variable
from pyomo.core.staleflag import StaleFlagManager
from pyomo.mpec import Complementarity
from pyomo.network import Port
from pyomo.repn.plugins.nl_writer import NLWriter
from pyomo.repn.util import categorize_valid_components
from scipy.sparse.csgraph import maximum_bipartite_matching

from ..core.errors import InvalidOption, InvalidProblem, UnsupportedModel
from ..core.names import MOST_NAMES, format_count, listed
from ..problems.programs.certification import Certification
from .nl.model import NLAnswer, ProgramModel, certify_values, model_of, values_and_slopes
from .nl.reading import NLContent, number_tree, read_content

KINDS = "Block Constraint Expression ExternalFunction Objective Param RangeSet Set Suffix Var"
KNOWN = {Complementarity, Port} | {getattr(core, kind) for kind in KINDS.split()}
AS_PAIRS = "apply gdp.bigm or gdp.hull and a solver for integers, or state the cases as pairs"
INSTEAD = {
    **dict.fromkeys(("Disjunct", "Disjunction", "SOSConstraint", "LogicalConstraint"), AS_PAIRS),
    "BooleanVar": AS_PAIRS,
    "Arc": "expand it: TransformationFactory('network.expand_arcs')",
    "DerivativeVar": "discretise it, TransformationFactory('dae.collocation'), and add complementarities afterwards",
}
DISCRETISED = "DerivativeVar"  # these never report as active
UNCHANGED = "linear_presolve", "scale_model", "skip_trivial_constraints"  # options that are off
IN_ORDER = core.SortComponents.deterministic


# --- Pairs -------------------------------------------------------------------------------------------------------


class PairSide(NamedTuple):
    """Side of a pair, lower ≤ body ≤ upper; an absent bound is infinite, an equation has equal bounds."""

    lower: float
    body: Any
    upper: float

    @property
    def bounds(self) -> int:
        """The number of finite bounds."""
        return math.isfinite(self.lower) + math.isfinite(self.upper)

    @property
    def is_equation(self) -> bool:
        """True for body == number; a range with equal bounds holds its body, and leaves the row any sign."""
        return self.lower == self.upper

    @property
    def variable(self) -> Any:
        """The variable that the body is, or None; a fixed variable is a number."""
        is_variable = hasattr(self.body, "is_variable_type") and self.body.is_variable_type()
        return self.body if is_variable and not self.body.fixed else None

    @property
    def slack(self) -> Any:
        """The expression that is ≥ 0 at the one finite bound: body − lower or upper − body."""
        if math.isfinite(self.upper):
            return difference(self.upper, self.body)
        return difference(self.body, self.lower) if self.lower else self.body


class Pair(NamedTuple):
    """A pair with two finite bounds in total; `held` decides the sign of `row`.

    Attributes
    ----------
    stated : ComplementarityData or ConstraintData
    held : PairSide
    row : expression
        ≥ 0 if the held body is at its lower bound, ≤ 0 at its upper bound, 0 between.
    """

    stated: Any
    held: PairSide
    row: Any


def sides_of(stated: Any) -> list[PairSide]:
    """Return both sides of a ComplementarityData, checked.

    Raises
    ------
    UnsupportedModel
        If the pair has not exactly two finite bounds, or a bound that is not constant.
    """
    if getattr(stated, "_args", None) is None:
        raise UnsupportedModel(f"{stated.name} has no sides; write complements(x >= 0, F >= 0)")
    sides = [_to_side(argument, stated) for argument in stated._args]
    equations, bounds = [side.is_equation for side in sides], [side.bounds for side in sides]
    if any(equations):
        if bounds[equations.index(True) - 1]:
            raise UnsupportedModel(
                f"{stated.name} has an equation on one side and a bound on the other; if F = 0 holds only for x > 0, "
                "write complements(x >= 0, F >= 0); if F is always 0, write a Constraint and bound the variable"
            )
    elif sum(bounds) != 2:
        raise UnsupportedModel(
            f"{stated.name} has {format_count(sum(bounds), 'finite bound')} on its two sides together, and needs two: "
            "complements(x >= 0, F >= 0), or complements(inequality(lower, x, upper), F)"
        )
    return sides


def _to_side(argument: object, stated: Any) -> PairSide:
    if argument is None or isinstance(argument, (bool, str)):
        raise UnsupportedModel(f"a side of {stated.name} is {argument!r}; write an expression")
    if np.any(getattr(argument, "_strict", False)):
        raise UnsupportedModel(f"a side of {stated.name} is strict, {argument}; write <= or >=")
    lower, body, *upper = stated._canonical_expression(argument)  # two parts of an equation
    ends = [lower, *upper] if upper else [lower, lower]
    for end in ends:
        if not (end is None or cannot_vary(end)):
            raise UnsupportedModel(
                f"the bound {end} of {stated.name} varies; state the difference: complements(body - bound >= 0, …)"
            )
    low, high = infinite_if_absent(*ends)
    return PairSide(low, body, high)


def difference(first: Any, second: Any) -> Any:
    """Return first − second as a new sum: Pyomo's ``+`` may append to the list of a sum that the user holds."""
    return SumExpression([first, -second])


def cannot_vary(expression: object) -> bool:
    """Return whether nothing in an expression is free."""
    return next(iter(identify_variables(expression, include_fixed=False)), None) is None


def pair_of_sides(stated: Any, sides: Sequence[PairSide], is_taken: Callable[[Any], bool]) -> Pair:
    """Return a pair. Held is the ranged side, else a variable that is not taken, else a fixed side.

    Parameters
    ----------
    stated : ComplementarityData
    sides : sequence of PairSide
        Both sides, neither an equality.
    is_taken : callable
        Returns whether a variable already belongs to another row.
    """
    for held, free in (sides, sides[::-1]):
        if free.bounds == 0:
            return Pair(stated, held, free.body)
    first, second = sides
    open_sides = [side for side in sides if not (side.variable is None or is_taken(side.variable))]
    held = open_sides[0] if open_sides else second if cannot_vary(second.body) else first
    slack = (second if held is first else first).slack
    return Pair(stated, held, slack if math.isfinite(held.lower) else -slack)


def pair_of(row: Any, variable: Any) -> Pair:
    """Return the pair of a constraint and a variable: an equation F = 0 gives F, an inequality its slack, as in mpec.

    Raises
    ------
    UnsupportedModel
        If the constraint is a range, or an inequality whose variable has no bounds.
    """
    lower, upper = bounds_of(variable)
    low, high = bounds_of(row)
    held, side = PairSide(lower, variable, upper), PairSide(low, row.body, high)
    if side.is_equation:
        return Pair(row, held, difference(row.body, row.lb) if row.lb else row.body)
    if side.bounds != 1 or not (held.bounds or variable.fixed):
        raise UnsupportedModel(
            f"{row.name} cannot be the row of {variable.name}: a range has no pair, and an inequality needs a "
            "variable with bounds; write an equation, or give the variable its bound"
        )
    return Pair(row, held, side.slack if math.isfinite(lower) or not held.bounds else -side.slack)


# --- Models ------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class PyomoStatement:
    """A Pyomo model as arrays, with the map back to its components.

    Attributes
    ----------
    content : NLContent
    variables : list of VarData
        In the order of the content.
    rows : list
        Component that each row states: a ConstraintData, an equality of a ComplementarityData, or a Pair. For
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
        bits = np.isfinite(content.lower) + 2 * np.isfinite(content.upper)
        bits = np.where(content.partners >= 0, bits[content.partners], content.partner_bounds)
        return replace(content, partner_bounds=bits)


def certify_model(model: object, tolerance: float, pairs: list[Any] | None = None) -> Certification:
    """Return the verdict on the values of a Pyomo model; see :func:`lcp_plugin.certify`."""
    return certify_values(statement_of(model, pairs).content, tolerance)


def file_content_of(model: object) -> NLContent:
    """Return the content of a ``.nl`` file of a Pyomo model."""
    return statement_of(model).in_a_file


def statement_of(model: Any, pairs: list[Any] | None = None) -> PyomoStatement:
    """Return the content of a Pyomo model or of one of its blocks, without changing the model.

    Parameters
    ----------
    model : ConcreteModel or Block
    pairs : "match" or mapping, optional
        Of :func:`square_pairs`.

    Raises
    ------
    UnsupportedModel
        Naming the component that is not taken.
    """
    if not (hasattr(model, "block_data_objects") and hasattr(model, "is_constructed")):
        kind = type(model).__name__
        raise UnsupportedModel(f"a Pyomo model or block is needed, got {kind}; solve a model")
    if not model.is_constructed():
        raise UnsupportedModel("an abstract model has no data; solve model.create_instance(…)")
    _require_known(model)
    active = partial(model.component_data_objects, active=True, descend_into=True, sort=IN_ORDER)
    conditions, constraints = [*active(Complementarity)], [*active(core.Constraint)]
    objectives = [*active(core.Objective)]
    sides = [sides_of(condition) for condition in conditions]
    matched = [] if pairs is None else square_pairs(constraints, pairs)
    matched_rows = ComponentSet(row for row, _ in matched)
    constraints = [row for row in constraints if row not in matched_rows]
    has_pairs = any(not any(side.is_equation for side in pair) for pair in sides)
    has_pairs |= bool(matched) or any(hasattr(row, "_complementarity") for row in constraints)
    if has_pairs:
        objectives = [objective for objective in objectives if not cannot_vary(objective.expr)]
    if len(objectives) > 1:
        count = len(objectives)
        raise UnsupportedModel(f"the model has {count} active objectives; deactivate all but one")
    is_whole = any(not variable.is_continuous() for variable in active(core.Var))
    draft = _Draft(constraints, objectives, is_search=bool(objectives) or is_whole)
    draft.pair(conditions, sides)
    for row, variable in matched:
        draft.hold(pair_of(row, variable))
    return draft.written(has_pairs)


def _require_known(model: Any) -> None:
    unknown = categorize_valid_components(model, active=True, sort=IN_ORDER, valid=KNOWN)[1]
    for kind in model.collect_ctypes(active=True):
        if kind.__name__ == DISCRETISED:
            unknown[kind] = list(model.component_objects(kind))
    for kind, components in sorted(unknown.items(), key=lambda each: each[0].__name__):
        names = ", ".join(component.name for component in components[:MOST_NAMES])
        instead = INSTEAD.get(kind.__name__, "deactivate it, or state it as constraints and pairs")
        raise UnsupportedModel(f"{kind.__name__} is not taken; the model has {names}; {instead}")


class _Draft:
    """Rows of a model, in a temporary model that shares the user's variables.

    Parameters
    ----------
    constraints, objectives : list
        Of the user's model.
    is_search : bool
        Whether all solutions of the pairs are searched, so that bounds and inequalities are constraints.
    """

    def __init__(self, constraints: list[Any], objectives: list[Any], *, is_search: bool) -> None:
        self.is_search = is_search
        self.model = model = core.ConcreteModel()
        model.rows = core.ConstraintList()
        model.added, model.zero = core.VarList(), core.Var(initialize=0.0)
        model.zero.fix()
        if constraints:
            model.constraints = core.Reference(constraints, ctype=core.Constraint)
        if objectives:
            model.objective = core.Reference(objectives, ctype=core.Objective)
        self.states = ComponentMap()  # of each row, the component or the name that states it
        self.partners = ComponentMap()  # of each variable of a pair, the pair
        self.named = ComponentMap()  # names of the added unknowns

    def pair(self, conditions: Sequence[Any], sides: Sequence[Sequence[PairSide]]) -> None:
        """Take the complementarities, first those that leave no choice of a partner."""
        choices = [sum(side.variable is not None for side in pair) for pair in sides]
        for k in sorted(range(len(choices)), key=lambda k: choices[k] != 1):
            if equation := next((side for side in sides[k] if side.is_equation), None):
                self.state(equation.body, conditions[k], equation.lower, equation.lower)
            else:
                self.hold(pair_of_sides(conditions[k], sides[k], self.partners.__contains__))

    def hold(self, pair: Pair) -> None:
        """Take a pair: its variable, or an unknown that is added, goes with its row."""
        if not self.is_search and cannot_vary(pair.held.body):
            self.state_fixed(pair)
            return
        variable = pair.held.variable
        if variable is None or variable in self.partners:
            variable = self.model.added.add()
            self.named[variable] = name = f"the unknown for {pair.stated.name}"
            variable.set_value(core.value(pair.held.body, exception=False), skip_validation=True)
            self.state(difference(variable, pair.held.body), name, 0.0, 0.0)
        elif not self._needs_no_bound_row(variable, pair):
            self.state(variable, f"the bounds of {variable.name}", variable.lb, variable.ub)
        self.partners[variable] = pair
        self.state(pair.row, pair, 0.0, None)

    def state_fixed(self, pair: Pair) -> None:
        """Take the row of a fixed pair as inequalities: of one sign at a bound, of both between the bounds."""
        lower, body, upper = pair.held
        held, name = float(core.value(body)), pair.stated.name
        if lower <= held < upper:
            self.state(pair.row, name, 0.0, None)
        if lower < held <= upper:
            self.state(pair.row, name, None, 0.0)
        if not lower <= held <= upper:
            self.state(body, name, lower, upper)

    def state(self, body: Any, what: object, lower: float | None, upper: float | None) -> None:
        """Add a row lower ≤ body ≤ upper."""
        body = body if is_potentially_variable(body) else difference(body, self.model.zero)
        self.states[self.model.rows.add((lower, body, upper))] = what

    def written(self, has_pairs: bool) -> PyomoStatement:
        """Return the statement, through a file written by Pyomo."""
        content, information = self._through([])
        written = ComponentSet(information.variables)
        if absent := [variable for variable in self.partners if variable not in written]:
            content, information = self._through(absent)
        variables = list(information.variables)
        rows = [self.states.get(row, row) for row in information.constraints]
        if not variables:
            raise UnsupportedModel("no active constraint, objective or pair has a free variable")
        names = [self.named.get(variable) or variable.name for variable in variables]
        stated = (getattr(row, "stated", row) for row in rows)
        row_names = [getattr(component, "name", component) for component in stated]
        content = replace(content, names=names, row_names=row_names)
        if has_pairs:
            content = self._paired(content, variables, rows)
        added = (j for j, variable in enumerate(variables) if variable in self.named)
        return PyomoStatement(content, variables, rows, frozenset(added))

    def _through(self, exported: list[Any]) -> tuple[NLContent, Any]:
        """Write and read the rows; return the content, and the information of the writer."""
        with TemporaryDirectory() as folder:
            path = Path(folder) / "model.nl"
            with path.open("w", newline="", encoding="utf-8") as file:
                options: dict[str, Any] = dict.fromkeys(UNCHANGED, False)
                options["export_nonlinear_variables"] = exported or None
                try:
                    information = NLWriter().write(self.model, file, **options)
                except InvalidValueError as error:
                    fault = " ".join(str(error).split())
                    raise InvalidProblem(f"numbers of a model must be finite: {fault}") from error
            return read_content(path), information

    def _paired(self, content: NLContent, variables: list[Any], rows: list[Any]) -> NLContent:
        """Return the content with the pairs, and their bounds of variables."""
        number_of = ComponentMap((variable, j) for j, variable in enumerate(variables))
        names = "partners", "partner_bounds", "row_lower", "row_upper", "lower", "upper"
        new = {name: getattr(content, name).copy() for name in names}
        partners, bits, row_lower, row_upper, lower, upper = new.values()
        trees = [*content.trees]
        # a pair of Pyomo's own transformation has no other bounds than it states
        if self.is_search:
            lower[partners[(partners >= 0) & (bits & 1 == 0)]] = -np.inf
            upper[partners[(partners >= 0) & (bits & 2 == 0)]] = np.inf
        place = {id(row): i for i, row in enumerate(rows)}
        for variable, pair in self.partners.items():
            i, j, held = place[id(pair)], number_of[variable], pair.held
            if constant := -float(row_lower[i]):
                trees[i] = [("o", 0, 2), *number_tree(constant), *trees[i]]
            row_lower[i], row_upper[i], partners[i] = -np.inf, np.inf, j
            lower[j], upper[j] = held.lower, held.upper
            if not self.is_search and self._needs_no_bound_row(variable, pair):
                low, high = bounds_of(variable)
                lower[j], upper[j] = max(held.lower, low), min(held.upper, high)
            has_lower = lower[j] == held.lower > -math.inf
            has_upper = upper[j] == held.upper < math.inf
            bits[i] = has_lower + 2 * has_upper
        return replace(content, **new, trees=trees)

    def _needs_no_bound_row(self, variable: Any, pair: Pair) -> bool:
        """Return whether the bounds of a pair's variable need no row.

        In a search, only bounds that the pair implies need none. Otherwise bounds count as if the pair stated them,
        unless they exclude its bounds.
        """
        (lower, upper), held = bounds_of(variable), pair.held
        if self.is_search:
            return lower <= held.lower and held.upper <= upper
        return max(lower, held.lower) <= min(upper, held.upper)


def bounds_of(component: Any) -> tuple[float, float]:
    """Return the bounds of a variable or constraint."""
    return infinite_if_absent(component.lb, component.ub)


def infinite_if_absent(lower: Any, upper: Any) -> tuple[float, float]:
    """Return the values of two bounds; ∓∞ for None."""
    low = -math.inf if lower is None else float(core.value(lower))
    return low, math.inf if upper is None else float(core.value(upper))


# --- Answers -----------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class PyomoAnswer:
    """The answer to a Pyomo model; values, duals and reduced costs by component."""

    statement: PyomoStatement
    solution: NLAnswer
    is_program: bool

    @property
    def has_point(self) -> bool:
        """True if there is something to load."""
        return self.solution.x is not None

    @cached_property
    def values(self) -> ComponentMap:
        """The values of the model's variables."""
        return self._of_variables([] if self.solution.x is None else self.solution.x.tolist())

    @cached_property
    def duals(self) -> ComponentMap:
        """The values of the rows of pairs, and the multipliers of constraints."""
        duals = [] if self.solution.duals is None else self.solution.duals.tolist()
        rows = zip(self.statement.rows, duals, strict=False)
        return ComponentMap((row.stated if isinstance(row, Pair) else row, w) for row, w in rows)

    @cached_property
    def reduced_costs(self) -> ComponentMap:
        """The multipliers of the variables' bounds: the rows of their pairs, or slopes of the Lagrangian."""
        content, x, duals = self.statement.content, self.solution.x, self.solution.duals
        if x is None or duals is None:
            return ComponentMap()
        is_pair, costs = content.partners >= 0, np.full(x.size, np.nan)
        costs[content.partners[is_pair]] = duals[is_pair]
        if self.is_program:  # a variable with equal bounds is a constant there
            weights = np.append(-duals, np.ones(content.is_maximized.size))
            costs = values_and_slopes(content, x, np.arange(weights.size))[1].T @ weights
        return self._of_variables(costs.tolist())

    def _of_variables(self, numbers: list[float]) -> ComponentMap:
        """Return the finite numbers by the variables of the model."""
        added, pairs = self.statement.added, zip(self.statement.variables, numbers, strict=False)
        kept = (pair for j, pair in enumerate(pairs) if j not in added and math.isfinite(pair[1]))
        return ComponentMap(kept)

    def load(self, model: object) -> None:
        """Put values and suffixes into the model."""
        if not self.has_point:
            return
        StaleFlagManager.mark_all_as_stale()
        for variable, value in self.values.items():
            variable.set_value(value, skip_validation=True)
        StaleFlagManager.mark_all_as_stale(delayed=True)
        for name in ("dual", "rc"):
            if (suffix := suffix_of(model, name)) is not None:
                suffix.clear()
                suffix.update(self.duals if name == "dual" else self.reduced_costs)


def solve_model(model: Any, options: dict[str, Any], pairs: list[Any] | None = None) -> PyomoAnswer:
    """Return the solution of a Pyomo model, which is not changed, by options of :func:`lcp_plugin.solve`."""
    statement = statement_of(model, pairs)
    content, added = statement.content, sorted(statement.added)[:MOST_NAMES]
    try:
        problem = model_of(content)
    except UnsupportedModel as error:
        if not (added and content.row_lower.size > content.lower.size):
            raise
        names = ", ".join(map(content.variable, added))
        raise UnsupportedModel(
            f"{error}; one of the equations is for {names}: its pair holds no variable, or one that another pair holds"
        ) from error
    return PyomoAnswer(statement, problem.solve(**options), isinstance(problem, ProgramModel))


def suffix_of(model: Any, name: str) -> Any:
    """Return the suffix of that name nearest to the root that imports values, or None."""
    suffixes = model.component_objects(core.Suffix, active=True, descend_into=True, sort=IN_ORDER)
    imported = (suffix for suffix in suffixes if suffix.import_enabled())
    return next((suffix for suffix in imported if suffix.local_name == name), None)


# --- The pairs of square models ------------------------------------------------------------------------------------

Family = dict[Any, Any]  # members of a component by their indices, in blocks too
Match = tuple[Family, Family]  # rows and their variables


def square_pairs(constraints: list[Any], pairs: Any) -> list[tuple[Any, Any]]:
    """Return the constraints that have a variable, each with it; the other equations need none.

    Parameters
    ----------
    constraints : list of ConstraintData
    pairs : "match" or mapping
        From constraints to variables, single or indexed. Constraints that it leaves out are matched.

    Raises
    ------
    UnsupportedModel
        Naming constraints and variables that have no match, or several.
    """
    if pairs != "match" and not isinstance(pairs, Mapping):
        raise InvalidOption(f"pairs must be 'match' or {{constraint: variable}}, got {pairs!r}")
    matched = [] if pairs == "match" else [*single_pairs(pairs)]
    owners, partners = ComponentMap(), ComponentMap()
    for row, variable in matched:
        if (other := partners.setdefault(row, variable)) is not variable:
            raise UnsupportedModel(
                f"{row.name} is paired with {other.name} and with {variable.name}; a row has one variable"
            )
        if (other := owners.setdefault(variable, row)) is not row:
            raise UnsupportedModel(
                f"{variable.name} is paired with {other.name} and with {row.name}; a variable has one row"
            )
    rows = families_of(row for row in constraints if row not in partners)
    families = families_of(column for column in variables_of(constraints) if column not in owners)
    variables = [family for family in families if not all(part.fixed for part in family.values())]
    while choices := [*_choices(rows, variables)]:
        family, matches = min(choices, key=lambda choice: len(choice[1]) != 1)
        if len(matches) != 1:
            _refuse_match(family, matches, variables, rows)
        family_rows, members = matches[0]
        matched += [(row, members[key]) for key, row in family_rows.items()]
        rows = [family for family in rows if family is not family_rows]
        variables = [family for family in variables if family is not members]
    _require_full_rank(constraints, matched)
    return matched


def single_pairs(pairs: Mapping[Any, Any]) -> Iterator[tuple[Any, Any]]:
    """Yield the pairs of single constraints and variables."""
    for rows, variables in pairs.items():
        for component, kind in ((rows, Constraint), (variables, Var)):
            if getattr(component, "ctype", None) is not kind:
                raise InvalidOption(
                    f"pairs has {getattr(component, 'name', repr(component))} in the place of a {kind.__name__}; state "
                    "ComponentMap([(model.market, model.price)]), with the constraint first"
                )
        for index in rows if rows.is_indexed() else (None,):
            row = rows[index] if rows.is_indexed() else rows
            if variables.is_indexed() and index not in variables:
                raise UnsupportedModel(f"{variables.name} has no index {index} for {row.name}")
            if row.active:
                yield row, variables[index] if variables.is_indexed() else variables


def variables_of(constraints: list[Any]) -> list[Any]:
    """Return the variables of constraints, each once."""
    bodies = (identify_variables(row.body, include_fixed=True) for row in constraints)
    return [*ComponentSet(chain.from_iterable(bodies))]


def families_of(members: Iterable[Any]) -> list[Family]:
    """Return the members grouped by their component, by their indices."""
    families: dict[Any, Family] = {}
    for member in members:
        names, indices, part = [], [], member
        while part is not None:
            names.append(part.parent_component().local_name)
            indices += [] if part.index() is None else [part.index()]
            part = part.parent_block()
        families.setdefault(tuple(names), {})[tuple(indices)] = member
    return [*families.values()]


def _has_bounds(variable: Any) -> bool:
    return not variable.fixed and variable.bounds != (None, None)


def _may_belong(rows: Family, variables: Family) -> bool:
    """Return whether rows have the indices of the free variables, and inequalities a variable with bounds."""
    return rows.keys() <= variables.keys() and all(
        variable.fixed or (key in rows and (rows[key].equality or _has_bounds(variable)))
        for key, variable in variables.items()
    )


def _choices(rows: list[Family], variables: list[Family]) -> Iterator[tuple[Family, list[Match]]]:
    """Yield each family with inequalities, or of variables with bounds, and its possible matches."""
    for row in rows:
        if not all(member.equality for member in row.values()):
            yield row, [(row, variable) for variable in variables if _may_belong(row, variable)]
    for variable in variables:
        if any(map(_has_bounds, variable.values())):
            yield variable, [(row, variable) for row in rows if _may_belong(row, variable)]


def _refuse_match(
    family: Family, matches: list[Match], variables: list[Family], rows: list[Family]
) -> NoReturn:
    """Raise UnsupportedModel, naming a variable without a row, or a family with no match or several."""
    for key, variable in (pair for members in variables for pair in members.items()):
        if _has_bounds(variable) and not any(key in row for row in rows):
            raise UnsupportedModel(
                f"{variable.name} has bounds, and no other constraint has its indices; write its row, or state its pair"
            )
    name = _name(family)
    if others := [_name(first if second is family else second) for first, second in matches]:
        raise UnsupportedModel(
            f"{name} may belong to {listed(others)}; state which: pairs={{model.constraint: model.variable}}"
        )
    raise UnsupportedModel(
        f"{name} has no partner with the same indices (for an inequality, a variable with bounds); state its pairs"
    )


def _name(family: Family) -> str:
    return str(next(iter(family.values())).parent_component().name)


def _require_full_rank(constraints: list[Any], pairs: list[tuple[Any, Any]]) -> None:
    """Raise UnsupportedModel, naming a constraint or a variable, if no one-to-one match of the pattern exists.

    A row also has an entry for the variable of its pair, because the variable at its bound may replace the row.
    """
    partner = ComponentMap((row, [variable]) for row, variable in pairs)
    inside = ComponentMap((row, variables_of([row]) + partner.get(row, [])) for row in constraints)
    rows = [row for row in constraints if not any(part.fixed for part in partner.get(row, []))]
    variables = [*ComponentSet(part for row in rows for part in inside[row] if not part.fixed)]
    place = ComponentMap((variable, j) for j, variable in enumerate(variables))
    pattern = sp.lil_array((len(rows), len(variables)))
    for i, row in enumerate(rows):
        pattern[i, [place[part] for part in inside[row] if part in place]] = 1.0
    sides = (rows, pattern, "constraint {}"), (variables, pattern.T, "variable {}")
    for named, matrix, one in sides:
        partners = maximum_bipartite_matching(sp.csr_array(matrix), perm_type="column")
        for k in np.flatnonzero(partners < 0)[:1]:
            raise UnsupportedModel(
                f"the model is structurally singular: {one.format(named[k].name)} would need the partner of another; "
                "see whether a constraint is missing or redundant, or a pair is wrong"
            )
