"""AMPL's operators by number: names, representation, and the evaluation of expression trees.

Trees are read backwards: operands come before their operator then, so that any depth needs no recursion.
"""

from __future__ import annotations

from collections.abc import Callable
from enum import Enum
from typing import Any, TypeVar

import numpy as np

from ...core.errors import UnsupportedModel
from ...expressions import functions
from ...expressions.functions import Function
from .content import OPERATOR_NAMES, NLContent, Token, Trees

T = TypeVar("T")
NUMBER, VARIABLE, OPERATOR = int(Token.NUMBER), int(Token.VARIABLE), int(Token.OPERATOR)
REMEDIES = {
    "abs": "abs(x) is x + 2 s with s >= 0 complements x + s >= 0",
    "max": "max(a, b) is a + s with s >= 0 complements a + s - b >= 0",
    "min": "min(a, b) is a - s with s >= 0 complements b - a + s >= 0",
}


class Arithmetic(Enum):
    """Operators that are affine, or become another function, if operands are constants."""

    SUM = "+"
    DIFFERENCE = "-"
    NEGATION = "unary -"
    PRODUCT = "*"
    QUOTIENT = "/"
    POWER = "^"
    SQUARE = "square"


#: What is taken; nothing else is smooth everywhere.
RULES: dict[str, Arithmetic | Function] = {
    **{one.value: one for one in Arithmetic},
    "sqrt": functions.power(0.5),
    **{name: one for name, one in functions.FUNCTIONS.items() if one.arguments == 1},
}
NAMES = {number: name for names in OPERATOR_NAMES.values() for number, name in names.items()}
OPERATORS = {number: RULES[name] for number, name in NAMES.items() if name in RULES}
FOLDED: dict[Arithmetic, Any] = {
    Arithmetic.SUM: lambda *a: sum(a),
    Arithmetic.DIFFERENCE: lambda a, b: a - b,
    Arithmetic.NEGATION: lambda a: -a,
    Arithmetic.PRODUCT: lambda a, b: a * b,
    Arithmetic.QUOTIENT: lambda a, b: np.float64(a) / b,
    Arithmetic.POWER: lambda a, b: np.float64(a) ** b,
    Arithmetic.SQUARE: lambda a: a * a,
}


def evaluated_tree(
    trees: Trees, k: int, leaf: Callable[[int, float], T], operation: Callable[[int, list[T]], T]
) -> T:
    """Return the value of tree k, by rules for leaves (type and value) and operators."""
    part = slice(trees.starts[k], trees.starts[k + 1])
    columns = (getattr(trees, name)[part][::-1].tolist() for name in ("kinds", "values", "counts"))
    stack: list[T] = []
    for kind, value, count in zip(*columns, strict=True):
        if kind != OPERATOR:
            stack.append(leaf(kind, value))
            continue
        operands = stack[: -count - 1 : -1]
        del stack[-count:]
        stack.append(operation(int(value), operands))
    return stack.pop()


def check_operators(content: NLContent) -> None:
    """Raise UnsupportedModel for an expression without a rule, naming the row and the operator."""
    for trees, called in (
        (content.trees, content.row),
        (content.objective_trees, "objective {}".format),
        (content.defined_trees, "defined variable {}".format),
    ):
        is_operator = trees.kinds == OPERATOR
        is_known = np.isin(trees.values, list(OPERATORS))
        is_taken = np.where(is_operator, is_known, np.isfinite(trees.values))
        for place in np.flatnonzero(~is_taken)[:1]:
            tree = int(np.searchsorted(trees.starts, place, side="right")) - 1
            reason = _refusal(trees.kinds[place], trees.values[place])
            raise UnsupportedModel(f"{called(tree)} {reason}")


def _refusal(kind: int, value: float) -> str:
    """Return the description of a part of an expression that is not supported."""
    if kind == NUMBER:
        return f"holds the number {value}; constants must be finite"
    name = NAMES.get(int(value), f"number {value:g}")
    remedy = REMEDIES.get(name, "state it by sums, products, powers and smooth functions")
    return f"holds the operator {name}, which is not smooth or not known here; {remedy}"


def value_of(rule: Arithmetic | Function, operands: list[Any]) -> Any:
    """Return the value of an operator; not finite, with numpy's warning, if it is undefined."""
    return (
        rule.value(*map(np.float64, operands))
        if isinstance(rule, Function)
        else FOLDED[rule](*operands)
    )
