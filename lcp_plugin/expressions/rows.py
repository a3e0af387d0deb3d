"""Arrays of expressions, affine in unknowns and in the results of functions; and functions of them.

Each modeling language builds its own functions from these. Entries are numbered by columns. A block is the derivative
by one source, and an identity stores nothing; of a sparse matrix only the entries that may differ from zero are rows.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from ..core.checks import FloatVector
from . import functions
from .functions import Function

Indices: TypeAlias = NDArray[np.int64]
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
    places : ndarray of int or None
        Indices of the entries in the array, ascending, if all others are zero; None for all entries.
    level : int
        Level of the highest source; unknowns have level 0.
    """

    blocks: dict[int, Block]
    offset: FloatVector
    shape: tuple[int, ...]
    places: Indices | None = None
    level: int = 0

    @classmethod
    def of(cls, value: Any) -> Rows:
        """Return rows unchanged, and the entries of an array or a sparse matrix as rows without sources."""
        if isinstance(value, Rows):
            return value
        if not sp.issparse(value):
            return cls({}, np.asarray(value, dtype=np.float64).ravel(order="F"), np.shape(value))
        matrix = sp.csc_array(value)
        if not matrix.has_canonical_format:
            matrix = matrix.copy()
            matrix.sum_duplicates()
        columns = np.repeat(np.arange(matrix.shape[1]), np.diff(matrix.indptr))
        return cls(
            {},
            matrix.data.astype(np.float64),
            matrix.shape,
            columns * matrix.shape[0] + matrix.indices,
        )

    @property
    def size(self) -> int:
        """The number of rows."""
        return int(self.offset.size)

    @property
    def terms(self) -> int:
        """The number of entries of the blocks."""
        return sum(
            self.size if isinstance(block, float) else block.nnz for block in self.blocks.values()
        )

    @property
    def is_source(self) -> bool:
        """True if the rows are exactly the entries of one source."""
        blocks = list(self.blocks.values())
        return (
            len(blocks) == 1
            and isinstance(blocks[0], float)
            and blocks[0] == 1.0
            and not self.offset.any()
        )

    def array(self, entries: FloatVector) -> Any:
        """Return the array with these entries at the indices of the rows, sparse if not all."""
        if self.places is None:
            return entries.reshape(self.shape, order="F")
        columns, rows = np.divmod(self.places, max(self.shape[0], 1))
        return sp.csc_array((entries, (rows, columns)), shape=self.shape)

    def taken(
        self, numbers: Indices, shape: tuple[int, ...] | None = None, places: Indices | None = None
    ) -> Rows:
        """Return the rows with these numbers, −1 for one that is zero, as an array of that shape."""
        shape = numbers.shape if shape is None else shape
        if numbers.size == self.size and np.array_equal(numbers, np.arange(self.size)):
            return replace(self, shape=shape, places=places)
        is_taken, offset = numbers >= 0, np.zeros(numbers.size)
        offset[is_taken] = self.offset[numbers[is_taken]]
        blocks = {
            key: _rows_of(block, numbers, is_taken, self.size) for key, block in self.blocks.items()
        }
        return Rows(blocks, offset, shape, places, self.level)

    def spread(self, shape: tuple[int, ...], places: Indices | None = None) -> Rows:
        """Return the array broadcast to a shape, with the entries in these places; with all of them for None."""
        if self.shape == shape and self.places is places:
            return self
        numbers = entries_behind(
            np.arange(math.prod(shape)) if places is None else places, shape, self.shape
        )
        if self.places is not None:
            near = np.minimum(np.searchsorted(self.places, numbers), max(self.size - 1, 0))
            numbers = (
                np.where(self.places[near] == numbers, near, -1)
                if self.size
                else np.full(numbers.size, -1)
            )
        return self.taken(numbers, shape, places)

    def full(self) -> Rows:
        """Return all entries."""
        return self.spread(self.shape)

    def scaled(self, factor: Any, operation: np.ufunc = np.multiply) -> Rows:
        """Return the rows times, or divided by, a number or one number per row."""
        if np.ndim(factor) == 0:
            if factor == 1.0:
                return self
            blocks = {key: _changed(block, operation, factor) for key, block in self.blocks.items()}
        else:
            matrices = {key: as_matrix(block, self.size) for key, block in self.blocks.items()}
            blocks = {
                key: _changed(matrix, operation, np.repeat(factor, np.diff(matrix.indptr)))
                for key, matrix in matrices.items()
            }
        return replace(self, blocks=blocks, offset=operation(self.offset, factor))

    def applied(
        self, operator: sp.csr_array, shape: tuple[int, ...], places: Indices | None = None
    ) -> Rows:
        """Return operator · rows as an array of that shape; the operator itself where a block is the identity."""
        blocks = {
            key: (operator if block == 1.0 else operator * block)
            if isinstance(block, float)
            else operator @ block
            for key, block in self.blocks.items()
        }
        offset = operator @ self.offset if self.offset.any() else np.zeros(operator.shape[0])
        return Rows(blocks, offset, shape, places, self.level)

    def summed(
        self, targets: Indices, shape: tuple[int, ...] = (), places: Indices | None = None
    ) -> Rows:
        """Return sums of rows: row k is added to the sum with the number targets[k]."""
        size = math.prod(shape) if places is None else places.size
        by_columns = sp.csc_array(
            (np.ones(self.size), targets, np.arange(self.size + 1)), shape=(size, self.size)
        )
        return self.applied(by_columns.tocsr(), shape, places)


def entries_behind(places: Indices, shape: tuple[int, ...], source: tuple[int, ...]) -> Indices:
    """Return the source indices of entries after broadcasting to a shape."""
    if shape == source:
        return places
    if math.prod(source) == 1:
        return np.zeros(places.size, dtype=np.int64)
    index = np.unravel_index(places, shape, order="F")[len(shape) - len(source) :]
    own = tuple(
        np.zeros_like(one) if length == 1 else one
        for one, length in zip(index, source, strict=True)
    )
    behind: Indices = np.ravel_multi_index(own, source, order="F")
    return behind


def added(parts: Iterable[Any], shape: tuple[int, ...]) -> Rows:
    """Return the sum of rows and constants, each broadcast to the shape; sparse where all of them are."""
    rows, places = [Rows.of(part) for part in parts], None
    if all(one.places is not None and one.shape == shape for one in rows):
        places = np.unique(np.concatenate([one.places for one in rows]))
    rows = [one.spread(shape, places) for one in rows]
    terms: dict[int, list[Block]] = defaultdict(list)
    for one in rows:
        for key, block in one.blocks.items():
            terms[key].append(block)
    offset = sum((one.offset for one in rows[1:]), start=rows[0].offset)
    blocks = {key: _total(blocks, offset.size) for key, blocks in terms.items()}
    return Rows(blocks, offset, shape, places, max(one.level for one in rows))


def stacked(parts: Sequence[Rows]) -> Rows:
    """Return the rows of all, one below the other."""
    if len(parts) == 1:
        return parts[0]
    found: dict[int, list[tuple[int, sp.csr_array]]] = defaultdict(list)
    size = 0
    for part in parts:
        for key, block in part.blocks.items():
            found[key].append((size, as_matrix(block, part.size)))
        size += part.size
    blocks: dict[int, Block] = {}
    for key, matrices in found.items():
        counts = np.zeros(size + 1, dtype=np.int64)
        for start, matrix in matrices:
            counts[start + 1 : start + 1 + matrix.shape[0]] = np.diff(matrix.indptr)
        data, columns = (
            np.concatenate([getattr(m, part) for _, m in matrices]) for part in ("data", "indices")
        )
        blocks[key] = sp.csr_array(
            (data, columns, np.cumsum(counts)), shape=(size, matrices[0][1].shape[1])
        )
    offset = np.concatenate([part.offset for part in parts])
    return Rows(blocks, offset, (size,), None, max(part.level for part in parts))


def assembled(
    parts: Sequence[Rows], first: Mapping[int, int], count: int
) -> tuple[sp.csr_array, FloatVector]:
    """Return matrix and offset of rows one below the other, over numbered entries of the sources.

    Parameters
    ----------
    parts : sequence of Rows
    first : mapping
        From the key of a source to the number of its first entry.
    count : int
        Number of entries. A single block that has all entries is returned without a copy.
    """
    offset = np.concatenate([*(part.offset for part in parts), np.zeros(0)])
    if len(parts) == len(parts[0].blocks if parts else ()) == 1:
        ((key, block),) = parts[0].blocks.items()
        matrix = as_matrix(block, parts[0].size)
        if matrix.shape[1] == count and first[key] == 0:
            return matrix, offset
    start, entries = 0, [(np.zeros(0), np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64))]
    for part in parts:
        rows = np.arange(start, start + part.size)
        for key, block in part.blocks.items():
            if isinstance(block, float):
                entries.append((np.full(part.size, block), rows, rows - start + first[key]))
            else:
                entries.append(
                    (block.data, np.repeat(rows, np.diff(block.indptr)), block.indices + first[key])
                )
        start += part.size
    data, rows, columns = (np.concatenate(part) for part in zip(*entries, strict=True))
    return sp.csr_array(sp.coo_array((data, (rows, columns)), shape=(start, count))), offset


def is_definition(block: sp.csr_array) -> bool:
    """Return whether each row of a source's block has one entry, in a column of its own."""
    is_single = bool((np.diff(block.indptr) == 1).all())
    return is_single and int(np.bincount(block.indices, minlength=1).max()) <= 1


def as_matrix(block: Block, size: int) -> sp.csr_array:
    """Return a block of that many rows as CSR."""
    if not isinstance(block, float):
        return block
    return sp.csr_array(
        (np.full(size, block), np.arange(size), np.arange(size + 1)), shape=(size, size)
    )


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
    data, columns = (
        np.concatenate([getattr(m, part) for m in matrices]) for part in ("data", "indices")
    )
    rows = np.concatenate([np.repeat(np.arange(size), np.diff(m.indptr)) for m in matrices])
    return sp.csr_array(sp.coo_array((data, (rows, columns)), shape=matrices[0].shape))


def _changed(block: Block, operation: np.ufunc, factor: Any) -> Block:
    """Return the block with changed numbers; both blocks share their indices."""
    if isinstance(block, float):
        return float(operation(block, factor))
    return sp.csr_array(
        (operation(block.data, factor), block.indices, block.indptr), shape=block.shape
    )


def _rows_of(block: Block, numbers: Indices, is_taken: NDArray[np.bool_], size: int) -> Block:
    taken, counts = numbers[is_taken], np.zeros(numbers.size + 1, dtype=np.int64)
    if isinstance(block, float):
        counts[1:] = is_taken
        return sp.csr_array(
            (np.full(taken.size, block), taken, np.cumsum(counts)), shape=(numbers.size, size)
        )
    matrix = block[taken]
    if taken.size == numbers.size:
        return matrix
    counts[1:][is_taken] = np.diff(matrix.indptr)
    return sp.csr_array(
        (matrix.data, matrix.indices, np.cumsum(counts)), shape=(numbers.size, block.shape[1])
    )


class Compiler:
    """Makes products, quotients and functions of arrays; an operand is an array, a sparse matrix, or `Rows`."""

    def __init__(self) -> None:
        #: Groups of functions, each with its level, function, arguments and the key of the results, which is negative.
        self.groups: list[tuple[int, Function, tuple[Rows, ...], int]] = []

    def emit(self, function: Function, *arguments: Rows) -> Rows:
        """Return a function of the arguments, row by row."""
        first, level, key = (
            arguments[0],
            1 + max(rows.level for rows in arguments),
            -1 - len(self.groups),
        )
        self.groups.append((level, function, arguments, key))
        return Rows({key: 1.0}, np.zeros(first.size), first.shape, first.places, level)

    def elementwise(
        self, function: Function, left: Any, right: Any, shape: tuple[int, ...]
    ) -> Rows:
        """Return the product or the quotient of two operands, one of them `Rows`, broadcast to a shape."""
        is_product = function is functions.PRODUCT
        if left is right and is_product:
            return self.emit(functions.SQUARE, left)
        # A product with a sparse array, or its quotient by an array, keeps its zeros.
        sparse = [
            Rows.of(one) for one in ((left, right) if is_product else (left,)) if _is_sparse(one)
        ]
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
                operator = sp.kron(
                    *((identity, operator) if is_left else (operator, identity)), format="csr"
                )
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
            first, second = (
                one if one.terms <= one.size else self.emit(functions.SAME, one) for one in both
            )
            terms = self.emit(functions.PRODUCT, first.taken(at_first), second.taken(at_second))
            return terms.summed(targets, shape, places)
        factors, numbers = (
            (first.offset[at_first], at_second) if is_left else (second.offset[at_second], at_first)
        )
        size = math.prod(shape) if places is None else places.size
        operator = sp.csr_array(
            sp.coo_array((factors, (targets, numbers)), shape=(size, rows.size))
        )
        operator.eliminate_zeros()
        return (second if is_left else first).applied(operator, shape, places)


def _is_sparse(operand: Any) -> bool:
    return operand.places is not None if isinstance(operand, Rows) else sp.issparse(operand)


def _factors(constant: Any, shape: tuple[int, ...], places: Indices | None) -> Any:
    """Return the entries of a constant broadcast to a shape, or a number if it is uniform."""
    number = uniform(constant)
    return Rows.of(constant).spread(shape, places).offset if number is None else number


def _meeting(left: Rows, right: Rows) -> tuple[Indices, Indices, Indices]:
    """Return the factors of a matrix product: rows of the left, rows of the right, and the entry that they add to."""
    shapes = [
        (1, *left.shape) if len(left.shape) == 1 else left.shape,
        (*right.shape, 1) if len(right.shape) == 1 else right.shape,
    ]
    batch = np.broadcast_shapes(shapes[0][:-2], shapes[1][:-2])
    count, depth = math.prod(batch), shapes[0][-1]
    found = []
    for rows, shape in zip((left, right), shapes, strict=True):
        whole = batch + shape[-2:]
        places = np.arange(math.prod(whole)) if rows.places is None else rows.places
        numbers = (
            entries_behind(places, whole, shape) if rows.places is None else np.arange(places.size)
        )
        entry, stack = np.divmod(places, max(count, 1))
        found.append((numbers, stack, *np.divmod(entry, max(shape[-2], 1))))  # column, row
    (number, stack, column, row), (other, other_stack, other_column, other_row) = found
    wanted, held = stack * depth + column, other_stack * depth + other_row
    order = np.argsort(held, kind="stable")
    begin, end = (np.searchsorted(held[order], wanted, side=side) for side in ("left", "right"))
    counts = end - begin
    at_left = np.repeat(np.arange(number.size), counts)
    at_right = order[
        np.repeat(begin - (np.cumsum(counts) - counts), counts) + np.arange(at_left.size)
    ]
    place = (row[at_left] + shapes[0][-2] * other_column[at_right]) * count + stack[at_left]
    return number[at_left], other[at_right], place
