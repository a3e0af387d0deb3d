"""Arrays of expressions, affine in unknowns and in the results of functions; and functions of them.

Each modeling language builds its own functions from these. Entries are numbered by columns. A block is the derivative
by one source, and an identity stores nothing.

A smooth map is a short program: levels of elementary functions between sparse matrices. A level takes linear
combinations of all previous quantities, beginning with the unknowns, and applies elementary functions to thousands of
them at once. The result is a linear combination of all quantities. Derivatives follow level by level from the chain
rule.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import groupby, pairwise
from operator import itemgetter
from typing import Any, TypeAlias

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from ..core.checks import Array, Indices, Vector, assemble_csr
from ..core.entries import row_numbers
from . import functions
from .functions import Function

Shape: TypeAlias = tuple[int, ...]
#: The derivative by one source; a number c stands for c times the identity.
Block: TypeAlias = float | sp.csr_array


@dataclass(frozen=True, eq=False)
class Rows:
    """An array of expressions: Σ blocks[source] · source + offset.

    Attributes
    ----------
    blocks : dict
        Coefficients by the keys of sources: unknowns, or results of functions.
    offset : ndarray
    shape : tuple
        Shape of the array.
    level : int
        Level of the highest source; unknowns have level 0.
    """

    blocks: dict[int, Block]
    offset: Vector
    shape: Shape
    level: int = 0

    @classmethod
    def of(cls, value: Any) -> Rows:
        """Return rows unchanged, and all entries of an array or a sparse matrix as rows without sources."""
        if isinstance(value, Rows):
            return value
        entries = value.toarray() if sp.issparse(value) else np.asarray(value)
        return cls({}, entries.astype(np.float64).ravel(order="F"), entries.shape)

    @property
    def size(self) -> int:
        """The number of rows."""
        return int(self.offset.size)

    @property
    def terms(self) -> int:
        """The number of entries of the blocks."""
        return sum(getattr(block, "nnz", self.size) for block in self.blocks.values())

    @property
    def is_source(self) -> bool:
        """True if the rows are exactly the entries of one source."""
        are_ones = [isinstance(block, float) and block == 1.0 for block in self.blocks.values()]
        return are_ones == [True] and not self.offset.any()

    def taken(self, numbers: Indices, shape: Shape | None = None) -> Rows:
        """Return the rows with these numbers, −1 for a row of zeros, as an array of that shape."""
        shape = numbers.shape if shape is None else shape
        if numbers.size == self.size and np.array_equal(numbers, np.arange(self.size)):
            return replace(self, shape=shape)
        is_taken, offset = numbers >= 0, np.zeros(numbers.size)
        offset[is_taken] = self.offset[numbers[is_taken]]
        parts = self.blocks.items()
        blocks = {key: _rows_of(block, numbers, is_taken, self.size) for key, block in parts}
        return Rows(blocks, offset, shape, self.level)

    def spread(self, shape: Shape) -> Rows:
        """Return the array broadcast to a shape."""
        if self.shape == shape:
            return self
        return self.taken(entries_behind(shape, self.shape), shape)

    def scaled(self, factor: Array, operation: np.ufunc = np.multiply) -> Rows:
        """Return the rows times, or divided by, a number or one number per row."""
        if np.ndim(factor) == 0 and factor == 1.0:
            return self
        blocks = {key: _changed(block, operation, factor) for key, block in self.blocks.items()}
        return replace(self, blocks=blocks, offset=operation(self.offset, factor))

    def applied(self, operator: sp.csr_array, shape: Shape) -> Rows:
        """Return operator · rows as an array of that shape; the operator itself where a block is the identity."""
        blocks = {
            key: (operator if block == 1.0 else operator * block)
            if isinstance(block, float)
            else operator @ block
            for key, block in self.blocks.items()
        }
        return Rows(blocks, operator @ self.offset, shape, self.level)

    def summed(self, targets: Indices, shape: Shape = ()) -> Rows:
        """Return sums of rows: row k is added to the sum with the number targets[k]."""
        entries = np.ones(self.size), (targets, np.arange(self.size))
        return self.applied(sp.csr_array(entries, shape=(math.prod(shape), self.size)), shape)


def entry_numbers(shape: Shape) -> Indices:
    """Return an array of a shape that holds the numbers of its entries, column by column."""
    return np.arange(math.prod(shape)).reshape(shape, order="F")


def entries_behind(shape: Shape, source: Shape) -> Indices:
    """Return the number of the source's entry that each entry is after broadcasting to a shape."""
    return np.broadcast_to(entry_numbers(source), shape).ravel(order="F")


def added(parts: Iterable[Any], shape: Shape) -> Rows:
    """Return the sum of rows and constants, each broadcast to the shape."""
    rows = [Rows.of(part).spread(shape) for part in parts]
    terms: dict[int, list[Block]] = defaultdict(list)
    for summand in rows:
        for key, block in summand.blocks.items():
            terms[key].append(block)
    offset = sum((summand.offset for summand in rows[1:]), start=rows[0].offset)
    blocks = {key: _total(blocks, offset.size) for key, blocks in terms.items()}
    return Rows(blocks, offset, shape, max(summand.level for summand in rows))


def stacked(parts: Sequence[Rows]) -> Rows:
    """Return the rows of all parts, one below the other."""
    if len(parts) == 1:
        return parts[0]
    terms: dict[int, list[tuple[sp.csr_array, int, int]]] = defaultdict(list)
    size = 0
    for part in parts:
        for key, block in part.blocks.items():
            terms[key].append((as_matrix(block, part.size), size, 0))
        size += part.size
    widths = {key: matrices[0][0].shape[1] for key, matrices in terms.items()}
    blocks: dict[int, Block] = {key: _placed(terms[key], (size, widths[key])) for key in terms}
    offset = np.concatenate([part.offset for part in parts])
    return Rows(blocks, offset, (size,), max(part.level for part in parts))


def _placed(parts: list[tuple[sp.csr_array, int, int]], shape: tuple[int, int]) -> sp.csr_array:
    """Return the sum of matrices, each with its first row and column in the sum."""
    if len(parts) == 1 and parts[0][0].shape[0] == shape[0]:
        A, _, column = parts[0]
        return sp.csr_array((A.data, A.indices + column, A.indptr), shape=shape, copy=True)
    entries = [(A.data, row + row_numbers(A), column + A.indices) for A, row, column in parts]
    if not entries:
        return sp.csr_array(shape)
    data, rows, columns = map(np.concatenate, zip(*entries, strict=True))
    return sp.csr_array((data, (rows, columns)), shape=shape)


def assembled(
    parts: Sequence[Rows], first: Mapping[int, int], count: int
) -> tuple[sp.csr_array, Vector]:
    """Return matrix and offset of rows one below the other, over numbered entries of the sources.

    Parameters
    ----------
    parts : sequence of Rows
    first : mapping
        From the key of a source to the number of its first entry.
    count : int
        Number of entries. The values of a single block are not copied.
    """
    offset = np.concatenate([*(part.offset for part in parts), np.zeros(0)])
    start, placed = 0, []
    for part in parts:
        for key, block in part.blocks.items():
            placed.append((as_matrix(block, part.size), start, first[key]))
        start += part.size
    return _placed(placed, (start, count)), offset


def is_definition(block: sp.csr_array) -> bool:
    """Return whether each row of a source's block has one entry, and no two rows share a column."""
    has_single_entries = bool((np.diff(block.indptr) == 1).all())
    return has_single_entries and np.unique(block.indices).size == block.nnz


def as_matrix(block: Block, size: int) -> sp.csr_array:
    """Return a block of that many rows as CSR."""
    if not isinstance(block, float):
        return block
    entries = np.full(size, block), np.arange(size), np.arange(size + 1)
    return sp.csr_array(entries, shape=(size, size))


def uniform(value: Any) -> Any:
    """Return the number that a dense array repeats because its strides are 0, for instance a promoted scalar."""
    if sp.issparse(value) or not value.size or (value.size > 1 and any(value.strides)):
        return None
    return value.flat[0]


def _total(terms: list[Block], size: int) -> Block:
    """Return the sum; many matrices at once, because repeated addition copies the first terms."""
    multiple = sum(term for term in terms if isinstance(term, float))
    matrices = [term for term in terms if not isinstance(term, float)]
    if not matrices:
        return float(multiple)
    if multiple:
        matrices.append(as_matrix(float(multiple), size))
    if len(matrices) <= 2:
        return matrices[0] if len(matrices) == 1 else matrices[0] + matrices[1]
    return _placed([(matrix, 0, 0) for matrix in matrices], matrices[0].shape)


def _changed(block: Block, operation: np.ufunc, factor: Array) -> Block:
    """Return the block with changed numbers; both blocks share their indices."""
    is_number = np.ndim(factor) == 0
    if is_number and isinstance(block, float):
        return float(operation(block, factor))
    matrix = as_matrix(block, np.size(factor))
    each = factor if is_number else np.repeat(factor, np.diff(matrix.indptr))
    entries = operation(matrix.data, each), matrix.indices, matrix.indptr
    return sp.csr_array(entries, shape=matrix.shape)


def _rows_of(block: Block, numbers: Indices, is_taken: NDArray[np.bool_], size: int) -> Block:
    matrix = as_matrix(block, size)[numbers[is_taken]]
    if is_taken.all():
        return matrix
    counts = np.zeros(numbers.size + 1, dtype=np.int64)
    counts[1:][is_taken] = np.diff(matrix.indptr)
    entries = matrix.data, matrix.indices, np.cumsum(counts)
    return sp.csr_array(entries, shape=(numbers.size, matrix.shape[1]))


class Compiler:
    """Makes products, quotients and functions of arrays; an operand is an array, a sparse matrix, or `Rows`."""

    def __init__(self) -> None:
        #: Groups of functions, each with its level, function, arguments and the key of the results, which is negative.
        self.groups: list[tuple[int, Function, tuple[Rows, ...], int]] = []

    def emit(self, function: Function, *arguments: Rows) -> Rows:
        """Return a function of the arguments, row by row."""
        level, key = 1 + max(rows.level for rows in arguments), -1 - len(self.groups)
        self.groups.append((level, function, arguments, key))
        return Rows({key: 1.0}, np.zeros(arguments[0].size), arguments[0].shape, level)

    def elementwise(self, function: Function, left: Any, right: Array, shape: Shape) -> Rows:
        """Return the product or the quotient of two operands, one of them `Rows`, broadcast to a shape."""
        is_product = function is functions.PRODUCT
        if left is right and is_product:
            return self.emit(functions.SQUARE, left)
        if is_product and not isinstance(left, Rows):
            left, right = right, left
        rows = Rows.of(left).spread(shape)
        if isinstance(right, Rows):
            return self.emit(function, rows, right.spread(shape))
        factor = uniform(right)
        if factor is None:
            factor = Rows.of(right).spread(shape).offset
        return rows.scaled(factor, np.multiply if is_product else np.divide)

    def product(self, left: Any, right: Array, shape: Shape) -> Rows:
        """Return the matrix product of two operands, one of them `Rows`, or of stacks of matrices."""
        if left is right and len(left.shape) == 1:
            return self.emit(functions.SQUARE, left).summed(np.zeros(left.size, dtype=np.int64))
        is_left = not isinstance(left, Rows)
        rows: Rows = right if is_left else left
        constant: Any = left if is_left else right
        if not isinstance(constant, Rows) and max(len(left.shape), len(right.shape)) <= 2:
            # vec(A X) = (I ⊗ A) vec X and vec(X A) = (Aᵀ ⊗ I) vec X; the transpose of CSC is CSR on the same arrays.
            factor = constant if is_left else constant.T
            operator = sp.csr_array(factor if sp.issparse(factor) else np.atleast_2d(factor))
            copies = rows.shape[1 if is_left else 0] if len(rows.shape) == 2 else 1
            if copies > 1:
                identity = sp.eye_array(copies)
                factors = (identity, operator) if is_left else (operator, identity)
                operator = sp.kron(*factors, format="csr")
            return rows.applied(operator, shape)
        at_left, at_right, targets = _meeting(left.shape, right.shape)
        if isinstance(constant, Rows):
            # Rows of many terms, of which each product would hold a copy, become quantities of their own.
            named = [self.emit(functions.SAME, x) if x.terms > x.size else x for x in (left, right)]
            first, second = named
            terms = self.emit(functions.PRODUCT, first.taken(at_left), second.taken(at_right))
            return terms.summed(targets, shape)
        of_constant, of_rows = (at_left, at_right) if is_left else (at_right, at_left)
        entries = Rows.of(constant).offset[of_constant], (targets, of_rows)
        operator = sp.csr_array(entries, shape=(math.prod(shape), rows.size))
        operator.eliminate_zeros()
        return rows.applied(operator, shape)


def _meeting(left: Shape, right: Shape) -> tuple[Indices, ...]:
    """Return the factors of a matrix product: rows of the left, rows of the right, and the entry that they add to."""
    first = (1, *left) if len(left) == 1 else left
    second = (*right, 1) if len(right) == 1 else right
    entry = (*np.broadcast_shapes(first[:-2], second[:-2]), first[-2], second[-1])
    at_left, at_right, target = map(entry_numbers, (first, second, entry))
    both = np.broadcast_arrays(at_left[..., None], at_right[..., None, :, :], target[..., None, :])
    return tuple(numbers.ravel() for numbers in both)


@dataclass(frozen=True, eq=False)
class Combination:
    """Linear combinations of quantities: matrix · quantities + offset.

    Attributes
    ----------
    matrix : CSR array, shape (m, k)
        Canonical: sorted, without duplicates.
    offset : ndarray, shape (m,)
    """

    matrix: sp.csr_array
    offset: Vector

    def __call__(self, quantities: Vector) -> Any:
        """Return the combinations of these quantities."""
        return self.matrix @ quantities + self.offset


@dataclass(frozen=True, eq=False)
class Level:
    """Elementary functions of linear combinations; functions of two arguments come first.

    Attributes
    ----------
    arguments : tuple of Combination
        The first argument of every function, and the second argument of the functions of two.
    spans : list of (Function, slice)
    """

    arguments: tuple[Combination, ...]
    spans: list[tuple[Function, slice]]

    @property
    def size(self) -> int:
        """The number of functions."""
        return int(self.arguments[0].offset.size)

    def values(self, arguments: list[Vector]) -> Vector:
        """Return the values of the functions at the first and the second arguments."""
        result = np.empty_like(arguments[0])
        for function, span in self.spans:
            result[span] = function.value(*(u[span] for u in arguments[: function.arguments]))
        return result

    def derivatives(self, arguments: list[Vector]) -> list[Vector]:
        """Return the derivatives by the first and by the second arguments."""
        derivatives = [np.empty_like(u) for u in arguments]
        for function, span in self.spans:
            slopes = function.derivatives(*(u[span] for u in arguments[: function.arguments]))
            for whole, slope in zip(derivatives, slopes, strict=False):
                whole[span] = slope
        return derivatives

    def jacobian(self, arguments: list[Vector], count: int) -> sp.csr_array:
        """Return the derivative by the first quantities, of which the functions take no other, as CSR."""
        parts = []
        for one, slope in zip(self.arguments, self.derivatives(arguments), strict=True):
            if slope.size:  # 0 times an infinite slope is NaN
                A, shape = one.matrix, (slope.size, count)
                entries = A.data * np.repeat(slope, np.diff(A.indptr))
                parts.append((assemble_csr(entries, A.indices, A.indptr, shape), 0, 0))
        return parts[0][0] if len(parts) == 1 else _placed(parts, (self.size, count))


class Program:
    """A map from n unknowns to m results, with its derivatives.

    Attributes
    ----------
    n : int
    levels : list of Level
    result : Combination

    Notes
    -----
    Outside the domain of F entries are NaN or infinite; nothing is raised. A value costs a product with each matrix, a
    gradient two, a Jacobian a product of sparse matrices for each level.
    """

    def __init__(self, n: int, levels: Sequence[Level], result: Combination) -> None:
        self.n, self.levels, self.result = n, list(levels), result
        ends = np.cumsum([n, *(level.size for level in levels)]).tolist()
        self._spans = [slice(*pair) for pair in pairwise(ends)]
        self._identity = sp.eye_array(n, format="csr")

    @classmethod
    def of(
        cls, compiler: Compiler, results: Sequence[Rows], first: Mapping[int, int], n: int
    ) -> Program:
        """Return the program with these rows, stacked, as results.

        Parameters
        ----------
        compiler : Compiler
            Compiler that created the rows.
        results : sequence of Rows
        first : mapping
            From the key of a source to the number of its first unknown.
        n : int
            The number of unknowns.
        """
        # Functions of two arguments first.
        groups = sorted(compiler.groups, key=lambda one: (one[0], len(one[2]) == 1, one[1].name))
        numbers, count = dict(first), n
        for _, _, arguments, key in groups:
            numbers[key], count = count, count + arguments[0].size
        levels = []
        for _, members in groupby(groups, key=itemgetter(0)):
            part = list(members)
            both = ([each[2][k] for each in part if len(each[2]) > k] for k in (0, 1))
            combinations = tuple(_combination(rows, numbers, count) for rows in both)
            levels.append(Level(combinations, _spans(part)))
        return cls(n, levels, _combination(results, numbers, count))

    def rearranged(self, places: Indices, signs: Vector) -> Program:
        """Return the program whose result k is signs[k] times the result places[k] of this one."""
        matrix = sp.csr_array(sp.diags_array(signs) @ self.result.matrix[places])
        return Program(self.n, self.levels, Combination(matrix, signs * self.result.offset[places]))

    def value(self, x: Vector) -> Vector:
        """Return F(x), shape (m,)."""
        with np.errstate(all="ignore"):
            return self.result(self._swept(x)[0])

    def jacobian(self, x: Vector) -> sp.csr_array:
        """Return F′(x) as CSR, shape (m, n)."""
        with np.errstate(all="ignore"):
            known = self._identity  # of all quantities so far
            for level, values in zip(self.levels, self._swept(x)[1], strict=True):
                known = sp.vstack([known, level.jacobian(values, known.shape[0]) @ known], "csr")
            return self.result.matrix @ known

    def gradient(self, x: Vector, by_result: Vector) -> Vector:
        """Return F′(x)ᵀ by_result without the Jacobian."""
        with np.errstate(all="ignore"):
            arguments, total = self._swept(x)[1], self.result.matrix.T @ by_result
            levels = list(zip(self.levels, self._spans, arguments, strict=True))
            for level, span, values in reversed(levels):
                for slope, argument in zip(level.derivatives(values), level.arguments, strict=True):
                    total += argument.matrix.T @ (slope * total[span][: slope.size])
            return total[: self.n]

    def _swept(self, x: Vector) -> tuple[Vector, list[list[Vector]]]:
        """Return all quantities, and the arguments of each level."""
        # A level takes no quantity of a later level
        quantities, arguments = np.zeros(self.result.matrix.shape[1]), []
        quantities[: self.n] = x
        for level, span in zip(self.levels, self._spans, strict=True):
            arguments.append([argument(quantities) for argument in level.arguments])
            quantities[span] = level.values(arguments[-1])
        return quantities, arguments


def _spans(groups: list[Any]) -> list[tuple[Function, slice]]:
    spans: list[tuple[Function, slice]] = []
    start = 0
    for function, members in groupby(groups, key=itemgetter(1)):
        stop = start + sum(arguments[0].size for _, _, arguments, _ in members)
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
