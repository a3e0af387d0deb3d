"""What a Pyomo model says of its own values, by its expressions alone, and what a solve must not change."""

from __future__ import annotations

import math
from typing import Any

import pyomo.environ as pe
from pyomo.core.expr import EqualityExpression
from pyomo.core.expr.relational_expr import RelationalExpression
from pyomo.mpec import Complementarity


def residual(model: Any) -> float:
    """The largest violation of all that is active in the model, by Pyomo's own expressions."""
    worst = 0.0
    for condition in model.component_data_objects(Complementarity, active=True):
        worst = max(worst, pair_residual(*(pe_side(side) for side in condition._args)))
    for row in model.component_data_objects(pe.Constraint, active=True):
        body = pe.value(row.body)
        below = pe.value(row.lower) - body if row.lower is not None else 0.0
        above = body - pe.value(row.upper) if row.upper is not None else 0.0
        worst = max(worst, below, above)
    return worst


def pe_side(side: Any) -> tuple[float, float, float]:
    """(lower, body, upper) of a side by its arguments alone."""
    if not isinstance(side, RelationalExpression):
        return -math.inf, pe.value(side, exception=False), math.inf
    numbers = [pe.value(argument) for argument in side.args]
    if len(numbers) == 3:
        return numbers[0], numbers[1], numbers[2]
    if isinstance(side, EqualityExpression):
        return 0.0, numbers[1] - numbers[0], 0.0
    return 0.0, numbers[1] - numbers[0], math.inf


def pair_residual(first: tuple[float, float, float], second: tuple[float, float, float]) -> float:
    for side in (first, second):
        if side[0] == side[2]:
            return abs(side[1] - side[0])
    if math.isinf(first[0]) and math.isinf(first[2]):
        first, second = second, first
    if math.isfinite(second[0]):  # two slacks
        return abs(min(first[1] - first[0], second[1] - second[0]))
    return abs(first[1] - min(max(first[1] - second[1], first[0]), first[2]))


def picture(model: Any) -> list[Any]:
    """Return the state of a model that a solve must not change."""
    components = [
        (block.name, sorted(block.component_map()))
        for block in model.block_data_objects(active=None)
    ]
    return [
        components,
        [(v.name, v.lb, v.ub, v.fixed) for v in model.component_data_objects(pe.Var)],
        [
            (c.name, c.active, str(c._args), hidden(c._args))
            for c in model.component_data_objects(Complementarity)
        ],
    ]


def hidden(expressions: Any) -> list[Any]:
    """Return the number of arguments of each node, because sums share longer lists of arguments."""
    return [[len(e._args_), hidden(e.args)] for e in expressions if hasattr(e, "_args_")]
