"""AMPL's operators by their numbers: what each is called, what it becomes, and trees of them evaluated.

Trees are read backwards: operands come before their operator then, so that no recursion is needed, however deep one is.
"""

from __future__ import annotations

from collections.abc import Callable
from enum import Enum
from typing import Any, TypeVar

import numpy as np

from ...core.errors import UnsupportedModel
from ...modeling.expressions import functions
from ...modeling.expressions.functions import Function
from .content import NLContent, Token, Trees

T = TypeVar("T")
NUMBER, VARIABLE, OPERATOR = int(Token.NUMBER), int(Token.VARIABLE), int(Token.OPERATOR)
#: What is not taken; none of it is smooth everywhere.
REFUSED = {
    4: "mod", 6: "less", 11: "min", 12: "max", 13: "floor", 14: "ceil", 15: "abs", 20: "or", 21: "and", 22: "<",
    23: "<=", 24: "=", 28: ">=", 29: ">", 30: "<>", 34: "not", 35: "if", 48: "atan2", 55: "div", 56: "precision",
    57: "round", 58: "trunc", 59: "count", 60: "numberof", 61: "numberof", 62: "atleast", 63: "atmost",
    64: "piecewise-linear term", 65: "if", 66: "exactly", 67: "not atleast", 68: "not atmost", 69: "not exactly",
    70: "forall", 71: "exists", 72: "==>", 73: "<==>", 74: "alldiff", 75: "not alldiff",
}
REMEDIES = {
    "abs": "abs(x) is x + 2 s with s >= 0 complements x + s >= 0",
    "max": "max(a, b) is a + s with s >= 0 complements a + s - b >= 0",
    "min": "min(a, b) is a - s with s >= 0 complements b - a + s >= 0",
}


class Arithmetic(Enum):
    """Operators that are affine, or become another function, where operands are constants."""

    SUM = "+"
    DIFFERENCE = "-"
    NEGATION = "unary -"
    PRODUCT = "*"
    QUOTIENT = "/"
    POWER = "^"
    SQUARE = "square"


OPERATORS: dict[int, Arithmetic | Function] = {
    0: Arithmetic.SUM,
    1: Arithmetic.DIFFERENCE,
    2: Arithmetic.PRODUCT,
    3: Arithmetic.QUOTIENT,
    5: Arithmetic.POWER,
    16: Arithmetic.NEGATION,
    37: functions.TANH,
    38: functions.TAN,
    39: functions.power(0.5),
    40: functions.SINH,
    41: functions.SIN,
    42: functions.LOG10,
    43: functions.LOG,
    44: functions.EXP,
    45: functions.COSH,
    46: functions.COS,
    47: functions.ATANH,
    49: functions.ATAN,
    50: functions.ASINH,
    51: functions.ASIN,
    52: functions.ACOSH,
    53: functions.ACOS,
    54: Arithmetic.SUM,
    76: Arithmetic.POWER,
    77: Arithmetic.SQUARE,
    78: Arithmetic.POWER,
}
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
    """Return what tree k is, from what its leaves are, by kind and value, and what operators make of their operands."""
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
    """Raise UnsupportedModel where an expression holds what no rule is for, naming the row and the operator."""
    for trees, called in (
        (content.trees, content.row), (content.objective_trees, "objective {}".format),
        (content.defined_trees, "defined variable {}".format),
    ):
        is_operator = trees.kinds == OPERATOR
        is_known = np.isin(trees.values, list(OPERATORS))
        is_taken = np.where(is_operator, is_known, (trees.kinds < OPERATOR) & np.isfinite(trees.values))
        for place in np.flatnonzero(~is_taken)[:1]:
            tree = int(np.searchsorted(trees.starts, place, side="right")) - 1
            reason = _refusal(content, Token(trees.kinds[place]), trees.values[place])
            raise UnsupportedModel(f"{called(tree)} {reason}")


def _refusal(content: NLContent, kind: Token, value: float) -> str:
    """Return what is said of a part of an expression that is not taken."""
    if kind is Token.NUMBER:
        return f"holds the number {value}; constants must be finite"
    if kind is not Token.OPERATOR:
        is_named = kind is Token.CALL and value < len(content.functions)
        what = content.functions[int(value)] if is_named else "with a text"
        return f"calls the external function {what}; write it with elementary functions"
    name = REFUSED.get(int(value), f"number {value:g}")
    remedy = REMEDIES.get(name, "state it by sums, products, powers and smooth functions")
    return f"holds the operator {name}, which is not smooth or not known here; {remedy}"


def value_of(rule: Arithmetic | Function, operands: list[Any]) -> Any:
    """Return what an operator makes of numbers; not finite, with numpy's warning, where it has no value."""
    return rule.value(*map(np.float64, operands)) if isinstance(rule, Function) else FOLDED[rule](*operands)
