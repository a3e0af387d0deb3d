"""From cvxpy expressions to a program of elementary functions and sparse matrices.

An expression is cut at its nonlinear atoms. What lies between two cuts is affine in the variables and in the results of
the atoms below, and is extracted as any affine expression is. An atom with a matrix or a sum inside, as a product of
matrices, becomes elementary functions of single numbers and a sum of them.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from typing import Any

import cvxpy as cp
import numpy as np
import scipy.sparse as sp

from ..checks import FloatVector
from . import _compat as atoms
from . import nonlinear_rules as rules
from .extract import affine_map, check_attributes, key_of, postorder
from .nonlinear_atoms import Rows, compiled, refuse_unknown
from .nonlinear_program import Combination, Indices, Level, Program
from .nonlinear_rules import Rule

EVERYTHING = -1  # the key of all unknowns together; those of variables are ≥ 0, those of nodes < −1


def nonlinear_nodes(expression: Any) -> list[Any]:
    """Return the nodes of an expression that are not affine in their arguments, arguments first.

    Raises
    ------
    UnsupportedModel
        Where one of them has no derivative that is known here.
    """
    varying: set[int] = set()
    found = []
    for node in postorder(expression, ()):
        kind = _kind(node.__class__)
        varies = [id(argument) in varying for argument in node.args]
        if not any(varies) and kind != "variable":
            continue
        varying.add(id(node))
        if kind not in ("variable", "affine") and _is_nonlinear(node, kind, varies):
            refuse_unknown(node)
            found.append(node)
    return found


@cache
def _kind(kind: Any) -> str:
    """Return what decides whether atoms of a class are affine; asked once a class, because that takes a while."""
    kinds = {
        "variable": (cp.Variable,), "affine": (*atoms.SUM, *atoms.NEGATIVE, *atoms.GATHERS, *atoms.ENTRY_SUM),
        "quotient": atoms.DIVISION, "product": atoms.PRODUCT,
    }
    return next((name for name, classes in kinds.items() if issubclass(kind, classes)), "other")


def _is_nonlinear(node: Any, kind: str, varies: list[bool]) -> bool:
    if kind == "quotient":
        return varies[1]
    if kind == "product":
        return all(varies)
    return not node.is_atom_affine()


class Compiler:
    """Turns expressions into rows over the unknowns and the results of elementary functions.

    Parameters
    ----------
    first : dict
        From the key of a variable to the number of its first unknown.
    count : int
        The number of unknowns.
    memo : dict
        As for :func:`affine_map`.
    """

    def __init__(self, first: dict[int, int], count: int, memo: dict[Any, Any]) -> None:
        self._first: dict[int, int] = {EVERYTHING: 0, **first}
        self._level_of = dict.fromkeys(self._first, 0)
        self._unknowns = self._count = count
        self._memo = memo
        #: Of each group of functions: level, rule, arguments and the number of the first result.
        self._groups: list[tuple[int, Rule, tuple[Rows, ...], int]] = []
        self._nodes: dict[int, Any] = {}  # by their ids, which stay theirs while they are kept

    def add(self, nodes: Sequence[Any]) -> None:
        """Compile nonlinear nodes, arguments first; those that are known already are not compiled again."""
        for node in nodes:
            if key_of(node) in self._first:
                continue
            self._nodes[id(node)] = node
            rows = compiled(self, node)
            if not rows.are_last:
                rows = self.emit(rules.SAME, rows)
            self._first[key_of(node)], self._level_of[key_of(node)] = self._count - rows.size, rows.level

    def rows(self, blocks: Iterable[tuple[int, sp.csr_array]], offset: FloatVector) -> Rows:
        """Return rows from blocks by the keys of variables and compiled nodes."""
        shape, level, placed = (offset.size, self._count), 0, []
        for key, block in blocks:
            level = max(level, self._level_of[key])
            places = block.indices + np.int64(self._first[key])
            placed.append(sp.csr_array((block.data, places, block.indptr), shape=shape))
        if len(placed) == 1 and placed[0].has_canonical_format:
            return Rows(placed[0], offset, level)
        parts = [part.tocoo() for part in placed]
        data, rows, columns = (
            np.concatenate([np.zeros(0, dtype=kind), *(getattr(part, name) for part in parts)])
            for name, kind in (("data", np.float64), ("row", np.int64), ("col", np.int64))
        )
        return Rows(sp.csr_array(sp.coo_array((data, (rows, columns)), shape=shape)), offset, level)

    def of_function(
        self, matrix: sp.csr_array, blocks: Mapping[int, sp.csr_array], offset: FloatVector
    ) -> Rows:
        """Return the rows matrix · unknowns + Σ block · results of a node + offset."""
        return self.rows([(EVERYTHING, matrix), *blocks.items()], offset)

    def argument(self, expression: Any) -> Rows:
        """Return the rows of an argument whose nonlinear nodes are compiled."""
        selected = self._selected(expression)
        if selected is not None:
            return selected
        found = affine_map(expression, memo=self._memo, unknowns=self._nodes)
        return self.rows(found.blocks.items(), found.offset)

    def _selected(self, expression: Any) -> Rows | None:
        """Return the rows of a variable, of a compiled node, or of entries of one: a tenth of the time of a map."""
        is_selection = isinstance(expression, atoms.SELECTION)
        node = expression.args[0] if is_selection else expression
        first = self._first.get(key_of(node))
        if first is None:
            return None
        if isinstance(node, cp.Variable):
            check_attributes(node)
        numbers = np.arange(first, first + node.size)
        if is_selection:
            numbers = np.ravel(expression.numeric([numbers.reshape(node.shape, order="F")]), order="F")
        return self._quantities(numbers, self._level_of[key_of(node)])

    def _quantities(self, numbers: Indices, level: int, are_last: bool = False) -> Rows:
        entries = (np.ones(numbers.size), numbers, np.arange(numbers.size + 1))
        return Rows(sp.csr_array(entries, shape=(numbers.size, self._count)), np.zeros(numbers.size), level, are_last)

    def emit(self, rule: Rule, *arguments: Rows) -> Rows:
        """Add a function of the arguments, row by row, and return its results."""
        size, level = arguments[0].size, 1 + max(rows.level for rows in arguments)
        first, self._count = self._count, self._count + size
        self._groups.append((level, rule, arguments, first))
        return self._quantities(np.arange(first, first + size), level, are_last=True)

    def total(self, *terms: tuple[float, Rows]) -> Rows:
        """Return a linear combination of rows."""
        matrix = sp.csr_array((terms[0][1].size, self._count))
        offset = np.zeros(terms[0][1].size)
        for factor, rows in terms:
            matrix, offset = matrix + factor * rows.over(self._count), offset + factor * rows.offset
        return Rows(sp.csr_array(matrix), offset, max(rows.level for _, rows in terms))

    def program(self, results: list[Rows]) -> Program:
        """Return the program whose results are these rows, one below the other."""
        groups = sorted(self._groups, key=lambda group: (group[0], len(group[2]) == 1, group[1].name))
        renumbered = np.arange(self._count)
        number = self._unknowns
        for _, _, arguments, first in groups:
            renumbered[first : first + arguments[0].size] = np.arange(number, number + arguments[0].size)
            number += arguments[0].size
        levels, start = [], self._unknowns
        for level in sorted({group[0] for group in groups}):
            own = [group for group in groups if group[0] == level]
            levels.append(_level(own, renumbered, start))
            start += levels[-1].size
        return Program(self._unknowns, levels, _combination(results, renumbered, self._count))


def _level(groups: list[Any], renumbered: Indices, count: int) -> Level:
    """Return one level from its groups, those of two arguments first."""
    spans: list[tuple[Rule, slice]] = []
    start = 0
    for _, rule, arguments, _ in groups:
        stop = start + arguments[0].size
        if spans and spans[-1][0] is rule:
            spans[-1] = (rule, slice(spans[-1][1].start, stop))
        else:
            spans.append((rule, slice(start, stop)))
        start = stop
    both = [[arguments[k] for _, _, arguments, _ in groups if len(arguments) > k] for k in (0, 1)]
    first, second = (_combination(rows, renumbered, count) for rows in both)
    return Level((first, second), spans)


def _combination(parts: list[Rows], renumbered: Indices, count: int) -> Combination:
    """Return rows one below the other, over the quantities in their new order."""
    data, columns = (
        np.concatenate([*(getattr(rows.matrix, name) for rows in parts), np.zeros(0, dtype=kind)])
        for name, kind in (("data", np.float64), ("indices", np.int64))
    )
    lengths = np.concatenate([np.zeros(1, dtype=np.int64), *(np.diff(rows.matrix.indptr) for rows in parts)])
    offset = np.concatenate([*(rows.offset for rows in parts), np.zeros(0)])
    entries = (data, renumbered[columns], np.cumsum(lengths))
    matrix = sp.csr_array(entries, shape=(offset.size, count))
    matrix.sort_indices()
    matrix.eliminate_zeros()
    return Combination(matrix, offset)
