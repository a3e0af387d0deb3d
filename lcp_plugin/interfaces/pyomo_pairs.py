"""The pairs of a square Pyomo model: the variable that belongs to each constraint, as in a model statement of GAMS.

Index sets decide: the constraints ``market[i]`` belong to the variables ``price[i]`` if no other variables have these
indices. The sparsity pattern does not decide, because a row need not contain its own multiplier: in "maximize x for
x ≤ 3" the pattern pairs the limit with x. Equations that remain belong to variables without bounds. Every one-to-one
match states the same problem there, and the pattern shows whether one exists.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import Any

import scipy.sparse as sp
from pyomo.core import Constraint, Var
from pyomo.core.expr import identify_variables
from scipy.sparse.csgraph import maximum_bipartite_matching

from ..core.errors import InvalidOption, UnsupportedModel
from ..core.names import listed

SHOWN = 5  # names of a singular block in a message
Family = dict[Any, Any]  # members of a component by their indices, in blocks too


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
        raise InvalidOption(
            f"pairs must be 'match' or a ComponentMap from constraints to variables, got {pairs!r}"
        )
    found = [] if pairs == "match" else [*_stated(pairs)]
    owners: dict[int, Any] = {}
    partners: dict[int, Any] = {}
    for row, variable in found:
        if (other := partners.setdefault(id(row), variable)) is not variable:
            raise UnsupportedModel(
                f"{row.name} is paired with {other.name} and with {variable.name}; a row has one variable"
            )
        if (other := owners.setdefault(id(variable), row)) is not row:
            raise UnsupportedModel(
                f"{variable.name} is paired with {other.name} and with {row.name}; a variable has one row"
            )
    paired = owners.keys() | {id(row) for row, _ in found}
    rows = _families(row for row in constraints if id(row) not in paired)
    variables = _families(one for one in _variables(constraints) if id(one) not in paired)
    variables = [family for family in variables if not all(one.fixed for one in family.values())]
    while choices := [*_choices(rows, variables)]:
        family, matches = min(choices, key=lambda choice: len(choice[1]) != 1)
        if len(matches) != 1:
            _require_row_of_each(variables, rows)
            raise UnsupportedModel(_why_open(family, matches))
        own_rows, own = matches[0]
        found += [(row, own[key]) for key, row in own_rows.items()]
        rows = [one for one in rows if one is not own_rows]
        variables = [one for one in variables if one is not own]
    _require_full_rank(constraints, found)
    return found


def _stated(pairs: Mapping[Any, Any]) -> Iterator[tuple[Any, Any]]:
    """Yield the pairs of single constraints and variables."""
    for rows, variables in pairs.items():
        for one, kind in ((rows, Constraint), (variables, Var)):
            if getattr(one, "ctype", None) is not kind:
                raise InvalidOption(
                    f"pairs has {getattr(one, 'name', repr(one))} in the place of a {kind.__name__}; state "
                    "ComponentMap([(model.market, model.price)]), with the constraint first"
                )
        for index in rows if rows.is_indexed() else (None,):
            row = rows[index] if rows.is_indexed() else rows
            if variables.is_indexed() and index not in variables:
                raise UnsupportedModel(
                    f"pairs gives {row.name} no variable: {variables.name} has no index {index}"
                )
            if row.active:
                yield row, variables[index] if variables.is_indexed() else variables


def _variables(constraints: list[Any]) -> list[Any]:
    each = {
        id(one): one
        for row in constraints
        for one in identify_variables(row.body, include_fixed=True)
    }
    return [*each.values()]


def _families(members: Iterable[Any]) -> list[Family]:
    families: dict[Any, Family] = {}
    for one in members:
        names, indices, part = [], [], one
        while part is not None:
            names.append(part.parent_component().local_name)
            indices += [] if part.index() is None else [part.index()]
            part = part.parent_block()
        families.setdefault(tuple(names), {})[tuple(indices)] = one
    return [*families.values()]


def _has_bounds(variable: Any) -> bool:
    return not variable.fixed and variable.bounds != (None, None)


def _may_belong(rows: Family, variables: Family) -> bool:
    """Return whether rows have the indices of the variables that are not fixed, and inequalities one with bounds."""
    return rows.keys() <= variables.keys() and all(
        one.fixed or (key in rows and (rows[key].equality or _has_bounds(one)))
        for key, one in variables.items()
    )


def _choices(rows: list[Family], variables: list[Family]) -> Iterator[tuple[Family, list[Any]]]:
    """Yield each family with inequalities, or of variables with bounds, and its possible matches."""
    for row in rows:
        if not all(one.equality for one in row.values()):
            yield row, [(row, one) for one in variables if _may_belong(row, one)]
    for variable in variables:
        if any(map(_has_bounds, variable.values())):
            yield variable, [(row, variable) for row in rows if _may_belong(row, variable)]


def _require_row_of_each(variables: list[Family], rows: list[Family]) -> None:
    """Raise UnsupportedModel if no constraints have the indices of a variable with bounds."""
    for key, one in (pair for family in variables for pair in family.items()):
        if _has_bounds(one) and not any(key in row for row in rows):
            raise UnsupportedModel(
                f"{one.name} has bounds, and no other constraint has its indices; write its row, or state its pair"
            )


def _why_open(family: Family, matches: list[tuple[Family, Family]]) -> str:
    """Return why a family has no match of its own, and what to do."""
    name, others = _name(family), [_name(two if two is not family else one) for one, two in matches]
    if others:
        return (
            f"{name} may belong to {listed(others)}; state which: pairs=ComponentMap({{model.market: "
            "model.price}), with the constraint first"
        )
    return f"{name} has no partner with the same indices (for an inequality, a variable with bounds); state its pairs"


def _name(family: Family) -> str:
    return str(next(iter(family.values())).parent_component().name)


def _require_full_rank(constraints: list[Any], pairs: list[tuple[Any, Any]]) -> None:
    """Raise UnsupportedModel, naming a block, if no one-to-one match of the pattern exists.

    A row also has an entry for the variable of its pair, because the variable at its bound may replace the row.
    """
    partner = {id(row): variable for row, variable in pairs}
    rows = [row for row in constraints if not (id(row) in partner and partner[id(row)].fixed)]
    inside = [
        [*_variables([row]), *([partner[id(row)]] if id(row) in partner else [])] for row in rows
    ]
    open_ones = {id(one): one for columns in inside for one in columns if not one.fixed}
    place, variables = {key: j for j, key in enumerate(open_ones)}, [*open_ones.values()]
    pattern = sp.lil_array((len(rows), len(variables)))
    for i, columns in enumerate(inside):
        pattern[i, [place[id(one)] for one in columns if not one.fixed]] = 1.0
    for own, others, matrix, words in (
        (rows, variables, pattern.tocsr(), "contain only the variables"),
        (variables, rows, pattern.T.tocsr(), "appear only in the constraints"),
    ):
        partners = maximum_bipartite_matching(matrix, perm_type="column").tolist()
        if -1 in partners:
            block, reached = _dulmage_mendelsohn_block(matrix, partners)
            names = listed((own[k].name for k in block), SHOWN)
            few = listed((others[k].name for k in reached), SHOWN) or "that are fixed"
            raise UnsupportedModel(
                f"the model is structurally singular: {names} {words} {few}, which is one too "
                "few; see whether a constraint is missing or redundant, or a pair is wrong"
            )


def _dulmage_mendelsohn_block(matrix: Any, partners: list[int]) -> tuple[list[int], list[int]]:
    """Return the rows and columns on alternating paths from the first row without a match; it comes first."""
    row_of = {column: row for row, column in enumerate(partners) if column >= 0}
    rows, columns = [partners.index(-1)], dict[int, None]()
    for row in rows:
        for column in matrix.indices[matrix.indptr[row] : matrix.indptr[row + 1]].tolist():
            if column not in columns:
                columns[column] = None
                rows.append(row_of[column])
    return rows, [*columns]
