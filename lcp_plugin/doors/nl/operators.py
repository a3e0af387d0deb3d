"""AMPL's operators by their numbers: what each is called, and what becomes of it."""

from __future__ import annotations

from enum import Enum

from ...modeling.expressions import functions
from ...modeling.expressions.functions import Function


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
