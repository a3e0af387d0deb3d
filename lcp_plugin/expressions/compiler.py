"""Products, quotients and elementary functions of arrays of expressions, collected until they make a program.

What a language has of its own, it makes of these. An operand is an array, a sparse matrix, or `Rows`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import scipy.sparse as sp

from . import functions
from .functions import Function
from .program import Combination, Level, Program
from .rows import Indices, Rows, assembled, entries_behind, uniform


class Compiler:
    """Collects functions of rows, and numbers their results after the unknowns."""

    def __init__(self) -> None:
        #: Of each group of functions: level, function, arguments and the key of the results, which is negative.
        self._groups: list[tuple[int, Function, tuple[Rows, ...], int]] = []

    def emit(self, function: Function, *arguments: Rows) -> Rows:
        """Return a function of the arguments, row by row."""
        first, level, key = arguments[0], 1 + max(rows.level for rows in arguments), -1 - len(self._groups)
        self._groups.append((level, function, arguments, key))
        return Rows({key: 1.0}, np.zeros(first.size), first.shape, first.places, level)

    def elementwise(self, function: Function, left: Any, right: Any, shape: tuple[int, ...]) -> Rows:
        """Return the product or the quotient of two operands, one of them `Rows`, broadcast to a shape."""
        is_product = function is functions.PRODUCT
        if left is right and is_product:
            return self.emit(functions.SQUARE, left)
        # What multiplies a sparse array, or divides it, leaves its zeros.
        sparse = [Rows.of(one) for one in ((left, right) if is_product else (left,)) if _is_sparse(one)]
        places = next((one.places for one in sparse if one.shape == shape), None)
        if is_product and not isinstance(left, Rows):
            left, right = right, left
        own = Rows.of(left).spread(shape, places)
        if isinstance(right, Rows):
            return self.emit(function, own, right.spread(shape, places))
        return own.scaled(_factors(right, shape, places), np.multiply if is_product else np.divide)

    def product(self, left: Any, right: Any, shape: tuple[int, ...]) -> Rows:
        """Return the matrix product of two operands, one of them `Rows`, or of stacks of matrices."""
        if left is right and len(left.shape) == 1:
            return self.emit(functions.SQUARE, left).summed(np.zeros(left.size, dtype=np.int64))
        is_left = not isinstance(left, Rows)
        rows: Rows = right if is_left else left
        constant: Any = left if is_left else right
        are_matrices = max(len(left.shape), len(right.shape)) <= 2
        if not isinstance(constant, Rows) and are_matrices and rows.places is None:
            # vec(A X) = (I ⊗ A) vec X and vec(X A) = (Aᵀ ⊗ I) vec X; the transpose of CSC is CSR on the same arrays.
            factor = constant if is_left else constant.T
            operator = sp.csr_array(factor if sp.issparse(factor) else np.atleast_2d(factor))
            copies = rows.shape[1 if is_left else 0] if len(rows.shape) == 2 else 1
            if copies > 1:
                identity = sp.eye_array(copies)
                operator = sp.kron(*((identity, operator) if is_left else (operator, identity)), format="csr")
            return rows.applied(operator, shape)
        first, second = Rows.of(left), Rows.of(right)
        if not are_matrices:
            first, second = first.full(), second.full()
        places, at_first, at_second, targets = None, *_meeting(first, second)
        if first.places is not None and second.places is not None:
            places, targets = np.unique(targets, return_inverse=True)
        if isinstance(constant, Rows):
            # Rows of many terms, of which each product would hold a copy, become quantities of their own.
            both = (first, second)
            first, second = (one if one.terms <= one.size else self.emit(functions.SAME, one) for one in both)
            terms = self.emit(functions.PRODUCT, first.taken(at_first), second.taken(at_second))
            return terms.summed(targets, shape, places)
        factors, numbers = (first.offset[at_first], at_second) if is_left else (second.offset[at_second], at_first)
        size = math.prod(shape) if places is None else places.size
        operator = sp.csr_array(sp.coo_array((factors, (targets, numbers)), shape=(size, rows.size)))
        operator.eliminate_zeros()
        return (second if is_left else first).applied(operator, shape, places)

    def program(self, results: Sequence[Rows], first: Mapping[int, int], n: int) -> Program:
        """Return the program whose results are these rows, one below the other.

        Parameters
        ----------
        results : sequence of Rows
        first : mapping
            From the key of a source to the number of its first unknown.
        n : int
            The number of unknowns.
        """
        # Those of two arguments first.
        groups = sorted(self._groups, key=lambda group: (group[0], len(group[2]) == 1, group[1].name))
        numbers, count = dict(first), n
        for _, _, arguments, key in groups:
            numbers[key], count = count, count + arguments[0].size
        levels = []
        for level in sorted({group[0] for group in groups}):
            own = [group for group in groups if group[0] == level]
            both = [[arguments[k] for _, _, arguments, _ in own if len(arguments) > k] for k in (0, 1)]
            first_of_two, second = (_combination(rows, numbers, count) for rows in both)
            levels.append(Level((first_of_two, second), _spans(own)))
        return Program(n, levels, _combination(results, numbers, count))


def _spans(groups: list[Any]) -> list[tuple[Function, slice]]:
    spans: list[tuple[Function, slice]] = []
    start = 0
    for _, function, arguments, _ in groups:
        stop = start + arguments[0].size
        if spans and spans[-1][0] is function:
            spans[-1] = (function, slice(spans[-1][1].start, stop))
        else:
            spans.append((function, slice(start, stop)))
        start = stop
    return spans


def _combination(rows: Sequence[Rows], first: Mapping[int, int], count: int) -> Combination:
    matrix, offset = assembled(rows, first, count)
    if not (matrix.has_canonical_format and (matrix.data != 0.0).all()):
        matrix = matrix.copy()
        matrix.sum_duplicates()
        matrix.eliminate_zeros()
    return Combination(matrix, offset)


def _is_sparse(operand: Any) -> bool:
    return operand.places is not None if isinstance(operand, Rows) else sp.issparse(operand)


def _factors(constant: Any, shape: tuple[int, ...], places: Indices | None) -> Any:
    """Return the entries of a constant broadcast to a shape, a single number where its layout shows that it is one."""
    number = uniform(constant)
    return Rows.of(constant).spread(shape, places).offset if number is None else number


def _meeting(left: Rows, right: Rows) -> tuple[Indices, Indices, Indices]:
    """Return what a matrix product multiplies: rows of the left, rows of the right, and the entry that they add to."""
    shapes = [(1, *left.shape) if len(left.shape) == 1 else left.shape,
              (*right.shape, 1) if len(right.shape) == 1 else right.shape]
    batch = np.broadcast_shapes(shapes[0][:-2], shapes[1][:-2])
    count, depth = math.prod(batch), shapes[0][-1]
    found = []
    for rows, shape in zip((left, right), shapes, strict=True):
        whole = batch + shape[-2:]
        places = np.arange(math.prod(whole)) if rows.places is None else rows.places
        numbers = entries_behind(places, whole, shape) if rows.places is None else np.arange(places.size)
        entry, stack = np.divmod(places, max(count, 1))
        found.append((numbers, stack, *np.divmod(entry, max(shape[-2], 1))))  # column, row
    (number, stack, column, row), (other, other_stack, other_column, other_row) = found
    wanted, held = stack * depth + column, other_stack * depth + other_row
    order = np.argsort(held, kind="stable")
    begin, end = (np.searchsorted(held[order], wanted, side=side) for side in ("left", "right"))
    counts = end - begin
    at_left = np.repeat(np.arange(number.size), counts)
    at_right = order[np.repeat(begin - (np.cumsum(counts) - counts), counts) + np.arange(at_left.size)]
    place = (row[at_left] + shapes[0][-2] * other_column[at_right]) * count + stack[at_left]
    return number[at_left], other[at_right], place
