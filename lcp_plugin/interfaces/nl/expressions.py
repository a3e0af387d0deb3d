"""Expression trees and linear terms of an ``.nl`` file as linear combinations of unknowns and of elementary functions.

Each operator sums the combinations of its operands; functions are collected by level and type, and evaluated so.
Trees are read backwards: operands come before their operator then, so that any depth needs no recursion.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, partial, reduce
from itertools import chain, pairwise
from typing import Any, TypeVar

import numpy as np
import scipy.sparse as sp

from ...core.checks import Indices, Vector
from ...core.entries import entries_of_row
from ...core.errors import UnsupportedModel
from ...expressions import functions
from ...expressions.functions import Function
from ...expressions.rows import Compiler, Rows
from .reading import OPERATOR_NAMES, NLContent, Tree, variables_in

T = TypeVar("T")
REMEDIES = {
    "abs": "abs(x) is x + 2 s with s >= 0 complements x + s >= 0",
    "max": "max(a, b) is a + s with s >= 0 complements a + s - b >= 0",
    "min": "min(a, b) is a - s with s >= 0 complements b - a + s >= 0",
}


def evaluated_tree(
    tree: Tree, leaf: Callable[[str, float], T], operation: Callable[[int, list[T]], T]
) -> T:
    """Return the value of a tree, by rules for leaves (type and value) and operators."""
    stack: list[T] = []
    for kind, value, count in reversed(tree):
        if kind != "o":
            stack.append(leaf(kind, value))
            continue
        operands = stack[: -count - 1 : -1]
        del stack[-count:]
        stack.append(operation(int(value), operands))
    return stack.pop()


UNKNOWNS = 0  # the key of the only source that is not a function
MOST_NESTED = 1000  # functions in one another: derivatives go through every level


@dataclass
class Sum:
    """A linear combination: Σ terms[column] · column + constant, of functions nested up to a level."""

    terms: dict[int, float]
    constant: float
    level: int = 0

    @property
    def is_constant(self) -> bool:
        """True if it has no terms."""
        return not self.terms

    def scaled(self, factor: float, operation: Any = operator.mul) -> Sum:
        """Return the sum times, or divided by, a number."""
        if factor == 1.0:
            return self
        terms = {column: operation(value, factor) for column, value in self.terms.items()}
        return Sum(terms, operation(self.constant, factor), self.level)

    def add(self, other: Sum) -> Sum:
        """Return the sum; what is larger is changed, so that many terms cost each little."""
        large, small = (self, other) if len(self.terms) >= len(other.terms) else (other, self)
        for column, value in small.terms.items():
            large.terms[column] = large.terms.get(column, 0.0) + value
        large.constant += small.constant
        large.level = max(self.level, other.level)
        return large


#: The operators on sums, and the functions; nothing else is smooth everywhere.
RULES: dict[str, Callable[..., Sum] | Function] = {
    "+": lambda *parts: reduce(Sum.add, parts),
    "-": lambda first, second: first.add(second.scaled(-1.0)),
    "unary -": lambda expression: expression.scaled(-1.0),
    "*": functions.PRODUCT,
    "/": functions.QUOTIENT,
    "^": functions.POWER,
    "square": functions.SQUARE,
    "sqrt": functions.power(0.5),
    **{name: function for name, function in functions.FUNCTIONS.items() if function.arguments == 1},
}
NAMES = {number: name for names in OPERATOR_NAMES.values() for number, name in names.items()}
OPERATORS = {number: RULES[name] for number, name in NAMES.items() if name in RULES}


class _ExpressionReader:
    """The rows, objectives and defined variables of a file as sums over variables and functions.

    Columns are the variables, the defined variables and the functions.

    Parameters
    ----------
    content : NLContent
    known : list of float
        Values of the known variables, NaN for the unknowns.
    adds_unknowns : bool

    Attributes
    ----------
    results : list of Sum
        Rows, then objectives.
    definitions : dict of int to Sum
        Sum that is 0, for each defined variable that is an unknown.
    functions, arguments, levels : list
        For each function: its operator, its arguments, and its nesting level.
    """

    def __init__(self, content: NLContent, known: list[float], adds_unknowns: bool) -> None:
        self.content, self.n, self._known = content, content.lower.size, known
        self._adds_unknowns = adds_unknowns
        self.functions: list[Function] = []
        self.arguments: list[tuple[Sum, ...]] = []
        self.levels: list[int] = []
        self.definitions: dict[int, Sum] = {}
        self._defined: list[Sum] = []
        self._uses = _counted_uses(content)
        rows, goals, defined = content.trees, content.objective_trees, content.defined_trees
        size = sum(map(len, chain(rows, goals, defined)))
        # Substituted definitions may fill in four times the entries
        self._capacity = 4 * (size + content.defined_linear.nnz + content.linear.nnz) + 1000
        for k in range(len(defined)):
            self._define(k)
        self.results = [self._sum(tree, content.row(k)) for k, tree in enumerate(rows)]
        self.results += [self._sum(tree, f"objective {k}") for k, tree in enumerate(goals)]

    def _sum(self, tree: Tree, name: str) -> Sum:
        self._name = name
        return evaluated_tree(tree, self._leaf, self._operation)

    def _define(self, number: int) -> None:
        """Decide how a defined variable is represented.

        If several sums use it, all hold its terms, or it is a separate quantity: a function or, if it is affine, an
        additional unknown with an equation.
        """
        if not self._uses[number]:
            self._defined.append(Sum({}, 0.0))
            return
        tree = self.content.defined_trees[number]
        definition = self._sum(tree, f"defined variable {number}")
        linear, n = self.content.defined_linear, self.n
        for column, value in zip(*entries_of_row(linear, number), strict=True):
            if value:
                definition = definition.add(self._leaf("v", column).scaled(value))
        added = (self._uses[number] - 1) * len(definition.terms)
        if added <= self._capacity and (definition.level == 0 or len(definition.terms) <= 1):
            self._capacity -= added
        elif added and (definition.level or not self._adds_unknowns):
            definition = self._new(functions.SAME, definition)
        elif added:
            definition.terms[n + number] = -1.0
            self.definitions[number] = definition
            definition = Sum({n + number: 1.0}, 0.0)
        self._defined.append(definition)

    def _leaf(self, kind: str, value: float) -> Sum:
        if kind == "n":
            return Sum({}, value)
        column = int(value)
        if column >= self.n:
            definition = self._defined[column - self.n]
            if self._uses[column - self.n] == 1:
                return definition  # moved, not copied
            return replace(definition, terms=dict(definition.terms))
        known = self._known[column]
        return Sum({column: 1.0}, 0.0) if math.isnan(known) else Sum({}, known)

    def _operation(self, number: int, operands: list[Sum]) -> Sum:
        if (rule := OPERATORS.get(number)) is None:
            name = NAMES.get(number, f"number {number}")
            remedy = REMEDIES.get(name, "state it by sums, products, powers and smooth functions")
            raise UnsupportedModel(
                f"{self._name} holds the operator {name}, which is not smooth or not known here; {remedy}"
            )
        constants = [operand.constant for operand in operands]
        if not isinstance(rule, Function):
            combination = rule(*operands)
        elif all(operand.is_constant for operand in operands):
            with np.errstate(all="ignore"):
                combination = Sum({}, float(rule.value(*map(np.float64, constants))))
        else:
            cases = {"product": self._product, "quotient": self._quotient, "power of": self._power}
            return cases.get(rule.name, partial(self._new, rule))(*operands)
        if not np.isfinite(combination.constant):
            shown = f"{NAMES[number]} of {', '.join(f'{value:g}' for value in constants)}"
            raise UnsupportedModel(f"{self._name} holds {shown}, which is not finite; correct it")
        return combination

    def _product(self, first: Sum, second: Sum) -> Sum:
        if first.is_constant:
            return second.scaled(first.constant)
        if second.is_constant:
            return first.scaled(second.constant)
        if len(first.terms) == 1 and first == second:
            return self._new(functions.SQUARE, first)
        return self._new(functions.PRODUCT, first, second)

    def _quotient(self, first: Sum, second: Sum) -> Sum:
        if second.is_constant:
            if second.constant == 0.0:
                raise UnsupportedModel(f"{self._name} divides by zero; correct it")
            return first.scaled(second.constant, operator.truediv)
        if first.is_constant:
            return self._new(functions.power(-1.0), second).scaled(first.constant)
        return self._new(functions.QUOTIENT, first, second)

    def _power(self, base: Sum, exponent: Sum) -> Sum:
        if not exponent.is_constant:
            is_one = base.is_constant and base.constant == 1.0
            return Sum({}, 1.0) if is_one else self._new(functions.POWER, base, exponent)
        if exponent.constant in (0.0, 1.0):
            return base if exponent.constant else Sum({}, 1.0)
        return self._new(functions.power(exponent.constant), base)

    def _new(self, function: Function, *arguments: Sum) -> Sum:
        """Return a function of sums."""
        below = max(argument.level for argument in arguments)
        if below >= MOST_NESTED:
            raise UnsupportedModel(
                f"{self._name} nests {below + 1} functions in one another; give an inner one a variable and an equation"
            )
        self.functions.append(function)
        self.arguments.append(arguments)
        self.levels.append(below + 1)
        return Sum({self.n + len(self._uses) + len(self.functions) - 1: 1.0}, 0.0, below + 1)


def _counted_uses(content: NLContent) -> list[int]:
    """Return the number of sums that use each defined variable."""
    n, linear = content.lower.size, content.defined_linear
    used = variables_in(chain(content.trees, content.objective_trees, content.defined_trees))
    columns = np.append(linear.indices[linear.data != 0.0], used)
    return np.bincount(columns[columns >= n] - n, minlength=len(content.defined_trees)).tolist()


class Expressions:
    """Rows and objectives of a file over the unknowns that have no known value, and over functions.

    Parameters
    ----------
    content : NLContent
    known : ndarray, shape (n,)
        Values of the known variables, NaN for the unknowns.
    adds_unknowns : bool
        Whether a defined variable may be an unknown; otherwise it is a function.

    Attributes
    ----------
    unknowns : ndarray of int
        The variables that are unknowns; from n on, defined variables.
    definitions : ndarray of int
        The combinations that are zero, one for each defined variable among the unknowns.
    matrix : CSR array
        Rows, then objectives, then arguments of functions: over the unknowns, then the functions.
    offset : ndarray
    place : ndarray of int
        Column of each variable, defined variable and function in `matrix`; −1 if it has none.
    """

    def __init__(self, content: NLContent, known: Vector, *, adds_unknowns: bool = True) -> None:
        is_known = ~np.isnan(known)
        reader = _ExpressionReader(content, known.tolist(), adds_unknowns)
        n, d, count = content.lower.size, len(content.defined_trees), len(reader.functions)
        names = (function.name for function in reader.functions)
        keys = list(zip(reader.levels, names, strict=True))
        order = np.array(sorted(range(count), key=keys.__getitem__), dtype=np.int64)
        self._functions = [reader.functions[k] for k in order]
        defined = np.array(list(reader.definitions), dtype=np.int64)
        self.unknowns = np.concatenate([np.flatnonzero(~is_known), n + defined])
        self.definitions = len(reader.results) + np.arange(defined.size)
        first = len(reader.results) + defined.size + np.arange(count)
        self._arguments = first, first + count
        pairs = [(*reader.arguments[k], Sum({}, 0.0))[:2] for k in order]
        sums = [*reader.results, *reader.definitions.values()]
        sums += [pair[side] for side in (0, 1) for pair in pairs]
        self.place = np.full(n + d + count, -1)
        self.place[self.unknowns] = np.arange(self.unknowns.size)
        self.place[n + d + order] = self.unknowns.size + np.arange(count)
        self.offset = np.array([combination.constant for combination in sums])
        linear = sp.csr_array(sp.vstack([content.linear, content.objective_linear], format="csr"))
        self.offset[: linear.shape[0]] += linear @ np.where(is_known, known, 0.0)
        linear = linear[:, ~is_known]
        linear.resize((len(sums), self.unknowns.size + count))
        self.matrix = sp.csr_array(linear + _matrix_of_sums(sums, self.place, linear.shape))
        self.matrix.eliminate_zeros()
        # First column of each source: the unknowns, then each group of one function on one level.
        begins = [k for k in range(count) if k == 0 or keys[order[k]] != keys[order[k - 1]]]
        self._starts = np.append(0, self.unknowns.size + np.array([*begins, count]))
        self._levels = [0, *(keys[order[k]][0] for k in begins)]
        self._begins = begins

    @cached_property
    def compiler(self) -> Compiler:
        """The functions, group by group; definitions are substituted before."""
        compiler = Compiler()
        for begin, end in pairwise([*self._begins, len(self._functions)]):
            function = self._functions[begin]
            numbers = self._arguments[: function.arguments]
            compiler.emit(function, *(self.rows(part[begin:end]) for part in numbers))
        return compiler

    def all_values(self, x: Vector) -> Vector:
        """Return the values of the unknowns at x, and of defined variables by their definitions."""
        from scipy.sparse.linalg import spsolve

        is_defined = self.unknowns >= x.size
        values = x[np.where(is_defined, 0, self.unknowns)]
        if is_defined.any():
            A = sp.csc_array(self.matrix[self.definitions][:, : self.unknowns.size])
            right = A[:, ~is_defined] @ values[~is_defined] + self.offset[self.definitions]
            values[is_defined] = -spsolve(A[:, is_defined], right)
        return values

    def is_affine(self) -> Any:
        """Return the mask of combinations that hold no function."""
        nonlinear = np.concatenate([[0], np.cumsum(self.matrix.indices >= self.unknowns.size)])
        return np.diff(nonlinear[self.matrix.indptr]) == 0

    def rows(self, numbers: Indices) -> Rows:
        """Return the combinations with these numbers."""
        part = self.matrix[numbers]
        sources = np.unique(np.searchsorted(self._starts, part.indices, side="right") - 1).tolist()
        # Source 0 is UNKNOWNS, source k the k-th group of functions, whose key is −k
        blocks = {-k: part[:, self._starts[k] : self._starts[k + 1]] for k in sources}
        level = max([self._levels[k] for k in sources], default=0)
        return Rows(blocks, self.offset[numbers], (numbers.size,), level)


def _matrix_of_sums(sums: list[Sum], place: Indices, shape: tuple[int, int]) -> sp.csr_array:
    """Return the terms of sums, one row each, with their columns mapped by `place`."""
    terms = [combination.terms for combination in sums]
    columns = np.array([*chain.from_iterable(terms)], dtype=np.int64)
    values = np.array([*chain.from_iterable(part.values() for part in terms)], dtype=np.float64)
    return sp.csr_array((values, place[columns], np.cumsum([0, *map(len, terms)])), shape=shape)
