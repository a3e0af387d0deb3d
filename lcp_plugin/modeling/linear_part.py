"""The derivative of one affine atom, composed with those of its arguments.

Rows and columns are entries in column-major order. Shapes tell everything; no variable needs a value.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterable
from typing import Any, TypeAlias

import cvxpy as cp
import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from ..errors import UnsupportedModel
from . import _compat as atoms
from ._compat import name_of

IndexVector = NDArray[np.int64]
#: The derivative by one variable; a number c stands for c times the identity, so that nothing is stored for it.
Block: TypeAlias = float | sp.csr_array
#: By the id of the variable.
Blocks: TypeAlias = dict[int, Block]
#: By the id of the node.
Values: TypeAlias = dict[int, Any]


def node_blocks(node: Any, arguments: list[Blocks], constants: Values) -> Blocks:
    """Return the blocks of a node from those of its arguments; constants have none."""
    if isinstance(node, cp.Variable):
        return {node.id: 1.0}
    if isinstance(node, atoms.SUM):
        return _added(node, arguments)
    if isinstance(node, atoms.NEGATIVE):
        return {key: -block for key, block in arguments[0].items()}
    if isinstance(node, atoms.PRODUCT):
        return _product(node, arguments, constants)
    if isinstance(node, atoms.GATHERS):
        return _gathered(node, arguments)
    if isinstance(node, atoms.ENTRY_SUM):
        return _applied(_summation(node), arguments[0])
    return _differentiated(node, arguments, constants)


def _differentiated(node: Any, arguments: list[Blocks], constants: Values) -> Blocks:
    """Apply the Jacobian that the atom itself gives, which is constant because the atom is affine."""
    # Anywhere inside their domains; a power is not differentiated at zero.
    values = [atoms.dense(constants.get(id(argument), np.ones(argument.shape))) for argument in node.args]
    jacobians = node._grad(values) if node.is_atom_affine() else [None]
    if any(jacobian is None for jacobian in jacobians):
        raise UnsupportedModel(
            f"{name_of(node)} is not affine in the variables: both sides of a complementarity must be affine; "
            "introduce a variable with its own complementarity, or linearise"
        )
    # Some atoms leave out the Jacobians of their last, constant arguments.
    parts = [
        _applied(sp.csr_array(sp.csr_array(jacobian).T), blocks)
        for jacobian, blocks in zip(jacobians, arguments, strict=False)
        if blocks
    ]
    return _joined(parts, node.size)


def _added(node: Any, arguments: list[Blocks]) -> Blocks:
    """Add the arguments' blocks; an argument of another shape is broadcast first."""
    parts = zip(node.args, arguments, strict=True)
    return _joined((_broadcast(blocks, argument, node) for argument, blocks in parts), node.size)


def _joined(parts: Iterable[Blocks], size: int) -> Blocks:
    terms: dict[int, list[Block]] = defaultdict(list)
    for blocks in parts:
        for key, block in blocks.items():
            terms[key].append(block)
    return {key: _total(blocks, size) for key, blocks in terms.items()}


def _total(terms: list[Block], size: int) -> Block:
    """Return the sum; of many at once, because one after the other would copy the first ones every time."""
    multiple = sum(term for term in terms if isinstance(term, float))
    matrices = [term for term in terms if not isinstance(term, float)]
    if not matrices:
        return float(multiple)
    if multiple:
        matrices.append(as_matrix(float(multiple), size))
    if len(matrices) <= 2:
        return matrices[0] if len(matrices) == 1 else matrices[0] + matrices[1]
    data, columns = (np.concatenate([getattr(m, part) for m in matrices]) for part in ("data", "indices"))
    rows = np.concatenate([np.repeat(np.arange(size), np.diff(m.indptr)) for m in matrices])
    return sp.csr_array(sp.coo_array((data, (rows, columns)), shape=matrices[0].shape))


def _product(node: Any, arguments: list[Blocks], constants: Values) -> Blocks:
    left, right = node.args
    if id(left) not in constants and id(right) not in constants:
        raise UnsupportedModel(
            f"{name_of(node)} multiplies or divides two expressions with variables: only products with constants "
            "are affine; replace one of the two factors by a constant or a parameter"
        )
    is_left = id(left) in constants
    if isinstance(node, atoms.DIVISION) and is_left:
        raise UnsupportedModel(f"{name_of(node)} divides by variables; only a constant divisor is affine")
    constant = constants[id(left if is_left else right)]
    if isinstance(node, atoms.ELEMENTWISE) or () in (left.shape, right.shape):
        return _scaled(node, right if is_left else left, arguments[is_left], constant)
    if max(left.ndim, right.ndim) > 2:
        return _applied(_batched(node, atoms.dense(constant), is_left), arguments[is_left])
    # vec(A X) = (I ⊗ A) vec X and vec(X A) = (Aᵀ ⊗ I) vec X; the transpose of CSC is CSR on the same arrays.
    argument, factor = (right, constant) if is_left else (left, constant.T)
    operator = sp.csr_array(factor if sp.issparse(factor) else np.atleast_2d(factor))
    copies = argument.shape[1 if is_left else 0] if argument.ndim == 2 else 1
    if copies > 1:
        identity = sp.eye_array(copies)
        operator = sp.kron(*((identity, operator) if is_left else (operator, identity)), format="csr")
    return _applied(operator, arguments[is_left])


def _scaled(node: Any, argument: Any, blocks: Blocks, constant: Any) -> Blocks:
    """Multiply or divide the rows by a constant of any shape that broadcasts."""
    operation = np.divide if isinstance(node, atoms.DIVISION) else np.multiply
    blocks = _broadcast(blocks, argument, node)
    number = atoms.uniform(constant)
    if number is not None:
        same = number == 1.0
        return {key: block if same else _changed(block, operation, number) for key, block in blocks.items()}
    factors = np.broadcast_to(atoms.dense(constant), node.shape).ravel(order="F")
    scaled: Blocks = {}
    for key, block in blocks.items():
        matrix = as_matrix(block, node.size)
        scaled[key] = _changed(matrix, operation, np.repeat(factors, np.diff(matrix.indptr)))
    return scaled


def _changed(block: Block, operation: np.ufunc, factor: Any) -> Block:
    """Return the block with other numbers in the same places, whose indices both share."""
    if isinstance(block, float):
        return float(operation(block, factor))
    return _csr(operation(block.data, factor), block.indices, block.indptr, block.shape)


def _gathered(node: Any, arguments: list[Blocks]) -> Blocks:
    """Let the atom move entry numbers instead of entries: where they end is which rows it takes."""
    numbers, first = [], 1
    for argument, blocks in zip(node.args, arguments, strict=True):
        entries = np.arange(first, first + argument.size) if blocks else np.zeros(argument.size, dtype=np.int64)
        numbers.append(entries.reshape(argument.shape, order="F"))
        first += argument.size
    # 0 stands for an entry of no variable: padding, or a constant argument.
    rows = np.asarray(node.numeric(numbers)).ravel(order="F").astype(np.int64) - 1
    blocks = arguments[0] if len(arguments) == 1 else _stacked(node, arguments, first - 1)
    return {key: _rows(block, rows, first - 1) for key, block in blocks.items()}


def _stacked(node: Any, arguments: list[Blocks], size: int) -> Blocks:
    """Put the arguments' rows one below the other."""
    parts: dict[int, list[tuple[int, sp.csr_array]]] = defaultdict(list)
    first = 0
    for argument, blocks in zip(node.args, arguments, strict=True):
        for key, block in blocks.items():
            parts[key].append((first, as_matrix(block, argument.size)))
        first += argument.size
    stacked: Blocks = {}
    for key, matrices in parts.items():
        counts = np.zeros(size + 1, dtype=np.int64)
        for start, matrix in matrices:
            counts[start + 1 : start + 1 + matrix.shape[0]] = np.diff(matrix.indptr)
        data, columns = (np.concatenate([getattr(m, part) for _, m in matrices]) for part in ("data", "indices"))
        stacked[key] = _csr(data, columns, np.cumsum(counts), (size, matrices[0][1].shape[1]))
    return stacked


def _rows(block: Block, rows: IndexVector, size: int) -> Block:
    """Return the given rows of a block that has `size`, -1 for an empty one; the block itself where nothing moves."""
    if rows.size == size and np.array_equal(rows, np.arange(size)):
        return block
    is_taken = rows >= 0
    taken = rows[is_taken]
    counts = np.zeros(rows.size + 1, dtype=np.int64)
    if isinstance(block, float):
        counts[1:] = is_taken
        return _csr(np.full(taken.size, block), taken, np.cumsum(counts), (rows.size, size))
    matrix = block[taken]
    if taken.size == rows.size:
        return matrix
    counts[1:][is_taken] = np.diff(matrix.indptr)
    return _csr(matrix.data, matrix.indices, np.cumsum(counts), (rows.size, block.shape[1]))


def _broadcast(blocks: Blocks, argument: Any, node: Any) -> Blocks:
    """Return the blocks of the argument broadcast to the shape of the node."""
    rows = broadcast_rows(argument.shape, node.shape)
    return blocks if rows is None else {key: _rows(block, rows, argument.size) for key, block in blocks.items()}


def broadcast_rows(shape: tuple[int, ...], target: tuple[int, ...]) -> IndexVector | None:
    """Return which entry of an array of that shape each entry of the broadcast array is; None for the same shape."""
    if shape == target:
        return None
    entries = np.arange(math.prod(shape)).reshape(shape, order="F")
    return np.broadcast_to(entries, target).ravel(order="F")


def _summation(node: Any) -> sp.csr_array:
    """Return the matrix that adds the entries of the argument along the axes of a sum."""
    shape = node.args[0].shape
    axes = range(len(shape)) if node.axis is None else [axis % len(shape) for axis in np.atleast_1d(node.axis)]
    kept = tuple(1 if axis in axes else length for axis, length in enumerate(shape))
    columns = np.arange(node.args[0].size)
    rows = broadcast_rows(kept, shape)
    entries = (columns if rows is None else rows, columns)
    return sp.csr_array(sp.coo_array((np.ones(columns.size), entries), shape=(node.size, columns.size)))


def _batched(node: Any, constant: Any, is_left: bool) -> sp.csr_array:
    """Return the matrix of a product of stacks of matrices, the constant stack on one side."""
    left, right = node.args
    argument = right if is_left else left
    depth = (left.shape[-1],)
    batch = np.broadcast_shapes(left.shape[:-2], right.shape[:-2])
    m, n = (left.shape[-2:-1] or (1,)), (right.shape[-1:] if right.ndim > 1 else (1,))
    rows = np.arange(node.size).reshape(batch + m + n, order="F")[..., :, None, :]
    entries = np.arange(argument.size).reshape(argument.shape, order="F")
    if is_left:
        columns = entries.reshape(right.shape[:-2] + depth + n)[..., None, :, :]
        data = constant.reshape(left.shape[:-2] + m + depth)[..., :, :, None]
    else:
        columns = entries.reshape(left.shape[:-2] + m + depth)[..., :, :, None]
        data = constant.reshape(right.shape[:-2] + depth + n)[..., None, :, :]
    shape = batch + m + depth + n
    rows, columns, data = (np.broadcast_to(part, shape).ravel() for part in (rows, columns, data))
    matrix = sp.csr_array(sp.coo_array((data, (rows, columns)), shape=(node.size, argument.size)))
    matrix.eliminate_zeros()
    return matrix


def _applied(operator: sp.csr_array, blocks: Blocks) -> Blocks:
    """Multiply the blocks from the left; the operator itself where a block is the identity."""
    return {
        key: (operator if block == 1.0 else operator * block) if isinstance(block, float) else operator @ block
        for key, block in blocks.items()
    }


def as_matrix(block: Block, size: int) -> sp.csr_array:
    """Return a block of that many rows as CSR."""
    if not isinstance(block, float):
        return block
    return _csr(np.full(size, block), np.arange(size), np.arange(size + 1), (size, size))


def _csr(data: Any, columns: Any, indptr: Any, shape: tuple[int, int]) -> sp.csr_array:
    return sp.csr_array((data, columns, indptr), shape=shape)
