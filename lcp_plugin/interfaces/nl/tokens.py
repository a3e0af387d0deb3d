"""Expression trees in one row of tokens, read backwards: what each token is, before anything is made of it.

Operands come before their operator then, so that no recursion is needed, however deep a tree is.

A table has AMPL's operators by their numbers: what each is called, and what becomes of it.
"""

from __future__ import annotations

from bisect import bisect_right
from enum import Enum
from typing import Any

import numpy as np

from ...core.errors import UnsupportedModel
from ...modeling.expressions import functions
from ...modeling.expressions.functions import Function
from .content import NLContent, Token

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
MOST_FILL = 4  # how much of what there is may be put in for defined variables
MOST_NESTED = 1000  # functions in one another: each level is one more that derivatives go through
NUMBER, VARIABLE, OPERATOR = int(Token.NUMBER), int(Token.VARIABLE), int(Token.OPERATOR)
NONE = -1
#: What becomes of a defined variable: its only user holds it, or all users do, or it is a quantity of its own: a
#: function, or where it is affine, one more unknown with an equation.
INLINE, PUT_IN, OWN, UNKNOWN = range(4)


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


SUMS = (Arithmetic.SUM, Arithmetic.DIFFERENCE, Arithmetic.NEGATION)


class Tokens:
    """The trees of rows, of objectives, and of defined variables, last first, and what is known of each token.

    Parameters
    ----------
    content : NLContent
    known : list of float or None
        The values of the variables that have one.

    Attributes
    ----------
    starts : list of int
        Where each tree begins; the last is where they all end.
    end : list of int
        Of each token, the place behind its own tree.
    constant : list of float or None
    level : list of int
        How many functions are nested in it; 0 for what is affine.
    terms : list of int
        How many terms it has as a linear combination, at the most.
    node : list of int
        The number of the function that it is, NONE for no function.
    functions, levels : list
        Of each function: which it is, and its level.
    ways : list of int
        Of each defined variable, what becomes of it.
    nodes : list of int
        Of each defined variable, its number among the functions, if it is one.

    Raises
    ------
    UnsupportedModel
        Naming the row and the operator that is not taken.
    """

    def __init__(self, content: NLContent, known: list[float | None]) -> None:
        self.content, self.n, self._known = content, content.lower.size, known
        self.results, self.defined = content.trees.size + content.objective_trees.size, content.defined_trees.size
        self._flatten()
        size = len(self.kinds)
        self.end, self.constant = list(range(1, size + 1)), [None] * size  # type: list[int], list[float | None]
        self.level, self.terms, self.node = [0] * size, [1] * size, [NONE] * size
        self.functions: list[Function] = []
        self.levels: list[int] = []
        self.ways, self.nodes = [INLINE] * self.defined, [NONE] * self.defined
        self.linear = content.defined_linear
        self._of_defined: list[tuple[float | None, int, int]] = [(None, 0, 0)] * self.defined
        self.uses = self._counted_uses()
        self._capacity = MOST_FILL * (size + self.linear.nnz + content.linear.nnz) + 1000
        for tree in range(len(self.starts) - 2, -1, -1):
            self._read(tree)

    def _flatten(self) -> None:
        """Put all trees into one row, checked: whatever no rule is for is refused."""
        content, defined = self.content, self.content.defined_trees
        lengths = np.diff(defined.starts)[::-1]
        order = np.repeat(defined.starts[:-1][::-1] - (np.cumsum(lengths) - lengths), lengths)
        order += np.arange(order.size)
        kinds, values, counts = (
            np.concatenate([getattr(part, name) for part in (content.trees, content.objective_trees)]
                           + [getattr(defined, name)[order]])
            for name in ("kinds", "values", "counts")
        )
        sizes = [np.diff(part.starts) for part in (content.trees, content.objective_trees)]
        self.starts: list[int] = np.concatenate([[0], np.cumsum(np.concatenate([*sizes, lengths]))]).tolist()
        is_operator = kinds == OPERATOR
        is_taken = np.where(is_operator, np.isin(values, list(OPERATORS)), (kinds < OPERATOR) & np.isfinite(values))
        if not is_taken.all():
            self._refuse(int(np.flatnonzero(~is_taken)[0]), kinds, values)
        self.kinds, self.counts = kinds.tolist(), counts.tolist()
        self.values: list[Any] = values.tolist()
        self._is_use = (kinds == VARIABLE) & (values >= self.n)
        self._used = values[self._is_use].astype(np.int64) - self.n

    def _refuse(self, place: int, kinds: Any, values: Any) -> None:
        where = self.name_at(place)
        if kinds[place] == Token.NUMBER:
            raise UnsupportedModel(f"{where} holds the number {values[place]}; constants must be finite")
        if kinds[place] != OPERATOR:
            names, number = self.content.functions, int(values[place])
            what = names[number] if kinds[place] == Token.CALL and number < len(names) else "with a text"
            raise UnsupportedModel(f"{where} calls the external function {what}; write it with elementary functions")
        name = REFUSED.get(int(values[place]), f"number {values[place]:g}")
        remedy = REMEDIES.get(name, "state it by sums, products, powers and smooth functions")
        raise UnsupportedModel(f"{where} holds the operator {name}, which is not smooth or not known here; {remedy}")

    def name_at(self, place: int) -> str:
        """Return what the tree around a token belongs to: row c[3], objective 1, defined variable 2."""
        tree, rows = bisect_right(self.starts, place) - 1, self.content.trees.size
        if tree < rows:
            return self.content.row(tree)
        return f"objective {tree - rows}" if tree < self.results else f"defined variable {self.number_of(tree)}"

    def value_of(self, number: int) -> float | None:
        """Return the value of a defined variable that is constant."""
        return self._of_defined[number][0]

    def number_of(self, tree: int) -> int:
        """Return which defined variable a tree belongs to; negative for a row or an objective."""
        return len(self.starts) - 2 - tree if tree >= self.results else NONE

    def _counted_uses(self) -> list[int]:
        columns = self.linear.indices[(self.linear.indices >= self.n) & (self.linear.data != 0.0)] - self.n
        used = np.concatenate([self._used, columns.astype(np.int64)])
        uses: list[int] = np.bincount(used, minlength=self.defined).tolist()
        return uses

    def _read(self, tree: int) -> None:
        number = self.number_of(tree)
        if number != NONE and not self.uses[number]:
            return
        kinds, values, known, n = self.kinds, self.values, self._known, self.n
        for place in range(self.starts[tree + 1] - 1, self.starts[tree] - 1, -1):
            kind = kinds[place]
            if kind == OPERATOR:
                self._read_operator(place)
            elif kind == NUMBER:
                self.constant[place], self.terms[place] = values[place], 0
            elif values[place] < n:
                self.constant[place] = known[int(values[place])]
            else:
                found = self._of_defined[int(values[place]) - n]
                self.constant[place], self.level[place], self.terms[place] = found
        if number != NONE:
            self._define(number, self.starts[tree])

    def _define(self, number: int, root: int) -> None:
        """Settle what becomes of a defined variable, whose tree has just been read."""
        level, terms, linear = self.level[root], self.terms[root], self.linear
        entries = slice(linear.indptr[number], linear.indptr[number + 1])
        columns = linear.indices[entries][linear.data[entries] != 0.0].tolist()
        if not columns and self.constant[root] is not None:
            self._of_defined[number] = (self.constant[root], 0, 0)
            return
        for column in columns:
            _, below, more = self._of_defined[column - self.n] if column >= self.n else (None, 0, 1)
            level, terms = max(level, below), terms + more
        uses = self.uses[number]
        if uses > 1:
            added = (uses - 1) * terms
            if added <= self._capacity and (level == 0 or terms <= 1):
                self.ways[number] = PUT_IN
                self._capacity -= added
            elif level == 0:
                self.ways[number], terms = UNKNOWN, 1
            else:
                self.ways[number] = OWN
                self.nodes[number], level, terms = self._new_node(functions.SAME, level, root), level + 1, 1
        self._of_defined[number] = (None, level, terms)

    def _read_operator(self, place: int) -> None:
        operands = [place + 1]
        for _ in range(self.counts[place] - 1):
            operands.append(self.end[operands[-1]])
        self.end[place] = self.end[operands[-1]]
        rule, constants = OPERATORS[self.values[place]], [self.constant[one] for one in operands]
        if None not in constants:
            self.constant[place], self.terms[place] = self._folded(rule, constants, place), 0
            return
        if rule in SUMS:
            self.level[place] = max([self.level[one] for one in operands])
            self.terms[place] = sum([self.terms[one] for one in operands])
            return
        function = self._function(rule, operands, constants, place)
        if function is not None:
            level = max([self.level[one] for one in operands])
            self.node[place], self.level[place] = self._new_node(function, level, place), level + 1
        elif self.constant[place] is None:  # a multiple of the operand that is not constant
            carried = operands[0] if constants[0] is None else operands[1]
            self.level[place], self.terms[place] = self.level[carried], self.terms[carried]

    def _function(self, rule: Any, operands: list[int], constants: list[Any], place: int) -> Function | None:
        """Return the function that a token is; None where it is a multiple of one operand, or constant."""
        if isinstance(rule, Function):
            return rule
        if rule is Arithmetic.SQUARE:
            return functions.SQUARE
        first, second = constants
        if rule is Arithmetic.PRODUCT:
            if first is not None or second is not None:
                return None
            a, b = operands
            is_square = self.kinds[a] == self.kinds[b] == VARIABLE and self.values[a] == self.values[b]
            return functions.SQUARE if is_square else functions.PRODUCT
        if rule is Arithmetic.QUOTIENT:
            if second == 0.0:
                raise UnsupportedModel(f"{self.name_at(place)} divides by zero; correct it")
            if second is not None:
                return None
            return functions.QUOTIENT if first is None else functions.power(-1.0)
        if second == 0.0 or first == 1.0:
            self.constant[place], self.terms[place] = 1.0, 0
        if self.constant[place] is not None or second == 1.0:
            return None
        return functions.POWER if second is None else functions.power(second)

    def _new_node(self, function: Function, below: int, place: int) -> int:
        if below >= MOST_NESTED:
            raise UnsupportedModel(
                f"{self.name_at(place)} nests more than {MOST_NESTED} functions in one another; give an inner one a "
                "variable of its own and an equation"
            )
        self.functions.append(function)
        self.levels.append(below + 1)
        return len(self.functions) - 1

    def _folded(self, rule: Any, constants: list[Any], place: int) -> float:
        with np.errstate(all="ignore"):
            value = FOLDED[rule](*constants) if isinstance(rule, Arithmetic) else rule.value(np.float64(constants[0]))
        if not np.isfinite(value):
            name = rule.value if isinstance(rule, Arithmetic) else rule.name
            raise UnsupportedModel(
                f"{self.name_at(place)} holds {name} of {', '.join(f'{one:g}' for one in constants)}, which is no "
                "finite number; correct it"
            )
        return float(value)


FOLDED: dict[Arithmetic, Any] = {
    Arithmetic.SUM: lambda *a: sum(a),
    Arithmetic.DIFFERENCE: lambda a, b: a - b,
    Arithmetic.NEGATION: lambda a: -a,
    Arithmetic.PRODUCT: lambda a, b: a * b,
    Arithmetic.QUOTIENT: lambda a, b: np.float64(a) / b,
    Arithmetic.POWER: lambda a, b: np.float64(a) ** b,
    Arithmetic.SQUARE: lambda a: a * a,
}
