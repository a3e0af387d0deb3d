"""Expression trees and linear terms of an ``.nl`` file as combinations of unknowns and of elementary functions.

Forwards, each token already knows which combination it belongs to, and with which coefficient: what belongs together is
collected as triplets and summed up once, thousands of rows at a time. The time is linear in the tokens.
"""

from __future__ import annotations

from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
import scipy.sparse as sp

from ...core.checks import FloatVector
from ...modeling.equations import put_in_all
from ...modeling.expressions import functions
from ...modeling.expressions.rows import Compiler, Rows
from .content import Indices, NLContent
from .tokens import INLINE, NONE, OPERATORS, OWN, PUT_IN, UNKNOWN, VARIABLE, Arithmetic, Tokens

UNKNOWNS = 0  # the key of the only source that is no function


class Combinations:
    """The triplets of all combinations: rows, objectives, defined variables, first and second arguments of functions.

    Parameters
    ----------
    tokens : Tokens

    Attributes
    ----------
    rows, columns, factors : list
        Of the triplets. Columns are variables, defined variables, functions.
    constant_rows, constants : list
        What is added to which combination.
    """

    def __init__(self, tokens: Tokens) -> None:
        self.tokens = tokens
        self.rows, self.columns, self.constant_rows = [], [], []  # type: list[int], list[int], list[int]
        self.factors, self.constants = [], []  # type: list[float], list[float]
        self._first_node = tokens.n + tokens.defined
        self._first = tokens.results + tokens.defined
        self._second = self._first + len(tokens.functions)
        self._held_by = [(NONE, 0.0)] * tokens.defined  # of those that one combination holds: which, how often
        self._waiting: list[tuple[int, float]] = []
        for tree in range(len(tokens.starts) - 1):
            self._read(tree)

    @property
    def size(self) -> int:
        """The number of combinations."""
        return self._second + len(self.tokens.functions)

    def first_arguments(self) -> Indices:
        """Return the combination that is the first argument of each function."""
        first = np.arange(self._first, self._second)
        for k, number in enumerate(self.tokens.nodes):
            if number != NONE:
                first[number] = self.tokens.results + k
        return first

    def second_arguments(self) -> Indices:
        """Return the combination that is the second argument of each function, if it has one."""
        return np.arange(self._second, self.size)

    def _read(self, tree: int) -> None:
        tokens = self.tokens
        target, factor, number = tree, 1.0, tokens.number_of(tree)
        if number != NONE:
            is_inline = tokens.ways[number] == INLINE
            target, factor = self._held_by[number] if is_inline else (tokens.results + number, 1.0)
            if target == NONE or not tokens.uses[number]:
                return
            if tokens.ways[number] in (PUT_IN, UNKNOWN):
                self._add(target, tokens.n + number, -1.0)
            self._add_linear(number, target, factor)
        place, stop, waiting = tokens.starts[tree], tokens.starts[tree + 1], self._waiting
        waiting.append((target, factor))
        while place < stop:
            target, factor = waiting.pop()
            value = tokens.constant[place]
            if target == NONE or value is not None:
                if target != NONE and value:
                    self.constant_rows.append(target)
                    self.constants.append(factor * value)
                place = tokens.end[place]
                continue
            if tokens.kinds[place] == VARIABLE:
                self._add_variable(int(tokens.values[place]), target, factor)
            else:
                self._open(place, target, factor)
            place += 1

    def _add(self, target: int, column: int, factor: float) -> None:
        self.rows.append(target)
        self.columns.append(column)
        self.factors.append(factor)

    def _add_linear(self, number: int, target: int, factor: float) -> None:
        linear = self.tokens.linear
        entries = slice(linear.indptr[number], linear.indptr[number + 1])
        for column, value in zip(linear.indices[entries].tolist(), linear.data[entries].tolist(), strict=True):
            if value:
                self._add_variable(column, target, factor * value)

    def _add_variable(self, column: int, target: int, factor: float) -> None:
        number = column - self.tokens.n
        if number < 0:
            self._add(target, column, factor)
        elif (value := self.tokens.value_of(number)) is not None:
            self.constant_rows.append(target)
            self.constants.append(factor * value)
        elif self.tokens.ways[number] == INLINE:
            self._held_by[number] = (target, factor)
        else:
            is_own = self.tokens.ways[number] == OWN
            self._add(target, self._first_node + self.tokens.nodes[number] if is_own else column, factor)

    def _open(self, place: int, target: int, factor: float) -> None:
        """Tell the operands of an operator which combinations they belong to; the first one is asked first."""
        tokens, waiting = self.tokens, self._waiting
        rule, node, first = OPERATORS[tokens.values[place]], tokens.node[place], place + 1
        if node == NONE and rule in (Arithmetic.SUM, Arithmetic.NEGATION):
            waiting.extend([(target, factor if rule is Arithmetic.SUM else -factor)] * tokens.counts[place])
            return
        if node == NONE and rule is Arithmetic.DIFFERENCE:
            waiting.extend([(target, -factor), (target, factor)])
            return
        second = tokens.end[first] if tokens.counts[place] > 1 else NONE
        constants: list[Any] = [tokens.constant[one] for one in (first, second)[: tokens.counts[place]]]
        if node == NONE:  # a multiple
            scale = factor
            if rule is Arithmetic.PRODUCT:
                scale *= constants[1] if constants[0] is None else constants[0]
            elif rule is Arithmetic.QUOTIENT:
                scale /= constants[1]
            self._wait(*((target, scale) if one is None else (NONE, 0.0) for one in constants))
            return
        function = tokens.functions[node]
        is_reciprocal = rule is Arithmetic.QUOTIENT and function.arguments == 1
        self._add(target, self._first_node + node, factor * constants[0] if is_reciprocal else factor)
        places = [(self._first + node, 1.0), (self._second + node, 1.0)][: function.arguments]
        if len(constants) > len(places):
            places.insert(0 if is_reciprocal else 1, (NONE, 0.0))
        self._wait(*places)

    def _wait(self, *operands: tuple[int, float]) -> None:
        self._waiting.extend(operands[::-1])


class Expressions:
    """All rows and objectives of a file over the unknowns that have no known value, and over functions.

    Parameters
    ----------
    content : NLContent
    known : ndarray, shape (n,)
        The values of the variables that have one, NaN for the unknowns.

    Attributes
    ----------
    unknowns : ndarray of int
        The variables that are unknowns; from n on, defined variables.
    definitions : ndarray of int
        The combinations that are zero, one for each defined variable among the unknowns.
    matrix : CSR array
        Of the rows, of the objectives, then of arguments of functions: over the unknowns, then the functions.
    offset : ndarray
    """

    def __init__(self, content: NLContent, known: FloatVector) -> None:
        is_known = ~np.isnan(known)
        values = [value if one else None for value, one in zip(known.tolist(), is_known, strict=True)]
        tokens = Tokens(content, values)
        found = Combinations(tokens)
        defined = np.array([k for k, way in enumerate(tokens.ways) if way == UNKNOWN], dtype=np.int64)
        self.definitions = tokens.results + defined
        self.unknowns = np.concatenate([np.flatnonzero(~is_known), content.lower.size + defined])
        keys = list(zip(tokens.levels, (one.name for one in tokens.functions), strict=True))
        order = np.array(sorted(range(len(keys)), key=keys.__getitem__), dtype=np.int64)
        self._arguments = found.first_arguments()[order], found.second_arguments()[order]
        self._functions = [tokens.functions[k] for k in order]
        matrix, self.offset = _summed(found, content)
        n, first = content.lower.size, content.lower.size + tokens.defined
        if is_known.any():
            self.offset = self.offset + matrix[:, :n] @ np.where(is_known, known, 0.0)
        place = np.full(matrix.shape[1], NONE)
        place[self.unknowns] = np.arange(self.unknowns.size)
        place[first + order] = self.unknowns.size + np.arange(order.size)
        entries = sp.coo_array(matrix)
        kept = (place[entries.col] != NONE) & (entries.data != 0.0)
        shape = (matrix.shape[0], self.unknowns.size + order.size)
        kept_entries = entries.data[kept], (entries.row[kept], place[entries.col[kept]])
        self.matrix = sp.csr_array(sp.coo_array(kept_entries, shape=shape))
        self.matrix.sum_duplicates()
        # Where each source begins: the unknowns, then each group of one function on one level.
        begins = [k for k in range(order.size) if k == 0 or keys[order[k]] != keys[order[k - 1]]]
        self._starts = np.array([0, *(self.unknowns.size + k for k in (*begins, order.size))], dtype=np.int64)
        self._levels = [0, *(keys[order[k]][0] for k in begins)]
        self._begins = begins

    @cached_property
    def compiler(self) -> Compiler:
        """The functions, group by group; what is put in is put in before."""
        compiler = Compiler()
        for begin, end in pairwise([*self._begins, len(self._functions)]):
            function = self._functions[begin]
            own = [self.rows(numbers[begin:end]) for numbers in self._arguments[: function.arguments]]
            compiler.emit(function, *own)
        return compiler

    def put_in(self, definitions: Indices, columns: Indices) -> None:
        """Put unknowns in wherever they stand, each by the combination that is 0 and defines it, and forget them.

        Parameters
        ----------
        definitions : ndarray of int, shape (k,)
            Combinations.
        columns : ndarray of int, shape (k,)
            Of the unknowns.
        """
        whole, self.offset = put_in_all(self.matrix, self.offset, definitions, columns)
        keep = np.delete(np.arange(whole.shape[1]), columns)
        self.matrix = sp.csr_array(whole[:, keep])
        self.matrix.eliminate_zeros()
        self.unknowns = np.delete(self.unknowns, columns)
        self._starts[1:] -= columns.size

    def is_affine(self) -> Any:
        """Return of each combination whether it holds no function."""
        nonlinear = np.concatenate([[0], np.cumsum(self.matrix.indices >= self.unknowns.size)])
        return np.diff(nonlinear[self.matrix.indptr]) == 0

    def rows(self, numbers: Indices) -> Rows:
        """Return the combinations with these numbers."""
        part = self.matrix[numbers]
        source = np.searchsorted(self._starts, part.indices, side="right") - 1
        order = np.argsort(source, kind="stable")
        present, begins = np.unique(source[order], return_index=True)
        blocks: dict[int, Any] = {}
        for one, own in zip(present, np.split(order, begins[1:]), strict=False):
            entries = part.data[own], part.indices[own] - self._starts[one], np.searchsorted(own, part.indptr)
            shape = (numbers.size, int(self._starts[one + 1] - self._starts[one]))
            blocks[UNKNOWNS if one == 0 else -int(one)] = sp.csr_array(entries, shape=shape)
        level = max([self._levels[one] for one in present], default=0)
        return Rows(blocks, self.offset[numbers], (numbers.size,), None, level)

    def quadratic(self, number: int) -> tuple[sp.csr_array, FloatVector, float] | None:
        """Return P, c, r of a combination that is ½ xᵀP x + cᵀx + r; None where it is none."""
        n = self.unknowns.size
        row, offset = self._without_copies(self.matrix[[number]], self.offset[[number]])
        used = np.unique(row.indices[row.indices >= n]) - n
        if any(self._functions[k] not in (functions.PRODUCT, functions.SQUARE) for k in used):
            return None
        weights = np.asarray(row[:, n + used].todense()).ravel()
        is_product = np.array([self._functions[k] is functions.PRODUCT for k in used], dtype=bool)
        first, second = (numbers[used] for numbers in self._arguments)
        second = np.where(is_product, second, first)
        (A, a), (B, b) = (self._without_copies(self.matrix[k], self.offset[k]) for k in (first, second))
        if (A.indices >= n).any() or (B.indices >= n).any():
            return None
        A, B, linear = A[:, :n], B[:, :n], np.asarray(row[:, :n].todense()).ravel()
        half = sp.csr_array(A.T @ sp.diags_array(weights) @ B)
        c = linear + A.T @ (weights * b) + B.T @ (weights * a)
        return sp.csr_array(half + half.T), c, float(offset[0] + weights @ (a * b))

    def _without_copies(self, matrix: sp.csr_array, offset: FloatVector) -> tuple[sp.csr_array, FloatVector]:
        """Return combinations in which the quantities that only stand for others are put in."""
        n = self.unknowns.size
        is_copy = np.array([function is functions.SAME for function in self._functions], dtype=bool)
        while is_copy[matrix.indices[matrix.indices >= n] - n].any():
            copies = np.flatnonzero(is_copy)
            share, own = matrix[:, n + copies], self._arguments[0][copies]
            left = matrix @ sp.diags_array(np.concatenate([np.ones(n), ~is_copy]))
            matrix, offset = sp.csr_array(left + share @ self.matrix[own]), offset + share @ self.offset[own]
            matrix.eliminate_zeros()
        return matrix, offset


def _summed(found: Combinations, content: NLContent) -> tuple[sp.csr_array, FloatVector]:
    """Return matrix and offset of all combinations; of defined variables that are put in, none is left."""
    tokens, n = found.tokens, content.lower.size
    shape = (found.size, n + tokens.defined + len(tokens.functions))
    parts = [(np.array(found.factors), np.array(found.rows, dtype=np.int64), np.array(found.columns, dtype=np.int64))]
    start = 0
    for linear in (content.linear, content.objective_linear):
        numbers = np.repeat(np.arange(linear.shape[0]), np.diff(linear.indptr))
        parts.append((linear.data, start + numbers, linear.indices.astype(np.int64)))
        start += linear.shape[0]
    data, rows, columns = (np.concatenate(part) for part in zip(*parts, strict=True))
    offset: FloatVector = np.zeros(found.size)
    np.add.at(offset, np.array(found.constant_rows, dtype=np.int64), found.constants)
    matrix = sp.csr_array(sp.coo_array((data, (rows, columns)), shape=shape))
    numbers = np.array([k for k, way in enumerate(tokens.ways) if way == PUT_IN and tokens.uses[k]], dtype=np.int64)
    if not numbers.size:
        return matrix, offset
    return put_in_all(matrix, offset, tokens.results + numbers, n + numbers)
