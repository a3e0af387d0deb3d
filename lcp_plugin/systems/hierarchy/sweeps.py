"""Sweeps and residuals of a V-cycle and a nested iteration on one grid; compiled, arrays only.

`inverse` holds 1/diagonal, and 0 for an unknown that is fixed: it keeps the value 0 and passes no residual on.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...core.checks import BoolVector, FloatVector, read_only
from ...core.kernels.compilation import inline, kernel, uintp
from ...core.kernels.rows import clamp
from ...core.kernels.threads import share
from ...core.tuning import SHARED_FROM
from .grids import RowBlocks

Matrix = tuple[
    NDArray[Any], NDArray[Any], NDArray[Any], FloatVector
]  # CSR arrays and the positions of the diagonal
NO_BOUNDS = (read_only(np.zeros(0)),) * 2


def first_sweep(
    rows: Matrix, blocks: RowBlocks, inverse: FloatVector, b: FloatVector, x: FloatVector
) -> None:
    """Overwrite x by one forward Gauss–Seidel sweep for M x = b from x = 0.

    Cost: a pass over the lower triangle, and over full rows by which an odd block is coupled to the next even block.
    """
    for edge in blocks.edges[2::2].tolist():
        x[edge - blocks.reach : edge] = 0.0
    vectors = read_only(inverse), read_only(b), *NO_BOUNDS
    _swept(rows, rows[1], blocks, vectors, -1.0, 1.0, True, False, x)


def residual_after_first_sweep(
    rows: Matrix,
    blocks: RowBlocks,
    inverse: FloatVector,
    b: FloatVector,
    x: FloatVector,
    residual: FloatVector,
) -> None:
    """Write b − M x after `first_sweep` into `residual`: row i was exact until later rows changed."""
    split, reach = rows[1], blocks.reach
    shared(_product_of(rows, split, 1, inverse, -1.0, b, 0.0, x, residual), inverse.size)
    whole = _product_of(rows, rows[0], 0, inverse, -1.0, b, 1.0, x, residual)
    for edge in blocks.edges[2:-1:2].tolist():  # next to these edges, other rows changed before
        whole(edge - reach, edge + reach)


def free_product(rows: Matrix, inverse: FloatVector, x: FloatVector, product: FloatVector) -> None:
    """Product ← M x on the free rows, 0 elsewhere."""
    shared(_product_of(rows, rows[0], 0, inverse, 1.0, inverse, 0.0, x, product), inverse.size)


def _product_of(
    rows: Matrix,
    begins: Any,
    further: int,
    inverse: FloatVector,
    sign: float,
    b: FloatVector,
    weight: float,
    x: FloatVector,
    product: FloatVector,
) -> Callable[[int, int], Any]:
    indptr, _, *rest = rows
    operands = (
        indptr,
        begins,
        further,
        *rest,
        read_only(inverse),
        sign,
        read_only(b),
        weight,
        x,
        product,
    )
    return partial(_products, *operands)


def sweep(
    rows: Matrix,
    blocks: RowBlocks,
    inverse: FloatVector,
    backward: bool,
    b: FloatVector,
    x: FloatVector,
) -> None:
    """Overwrite x by one Gauss–Seidel sweep for M x = b."""
    vectors = read_only(inverse), read_only(b), *NO_BOUNDS
    _swept(rows, rows[0][1:], blocks, vectors, -1.0, 1.0, False, backward, x)


def projected_sweep(
    rows: Matrix,
    blocks: RowBlocks,
    vectors: tuple[FloatVector, ...],
    relaxation: float,
    backward: bool,
    z: FloatVector,
) -> None:
    """Overwrite z row by row, z_i ← mid(l_i, u_i, z_i − relaxation inverse_i w_i) with w_i from the current z.

    `vectors` are the inverse pivots, q, lower and upper, read-only.
    """
    _swept(rows, rows[0][1:], blocks, vectors, 1.0, relaxation, False, backward, z)


def free_rows(
    rows: Matrix,
    vectors: tuple[FloatVector, ...],
    z: FloatVector,
    is_free: BoolVector,
    is_changed: BoolVector,
    residual: FloatVector,
) -> tuple[float, int]:
    """Find the free rows of z: those strictly between their bounds, or pushed off the bound by w.

    Writes −w on the free rows and 0 elsewhere into `residual`; returns the largest scaled
    residual of the problem, and how many rows changed.
    """
    indptr, _, *rest = rows
    piece = partial(_free_rows, indptr, *rest, *vectors, z, is_free, is_changed, residual)
    found = shared(piece, residual.size)
    largest = np.max([one for one, _ in found])  # a NaN kept
    return float(largest), int(sum(changed for _, changed in found))


def shared(work: Callable[[int, int], Any], rows: int) -> list[Any]:
    """Call ``work(first, end)`` on parts of all rows, which may be taken in any order."""
    return share(work, rows, SHARED_FROM)


def _swept(
    rows: Matrix,
    ends: Any,
    blocks: RowBlocks,
    vectors: tuple[FloatVector, ...],
    sign: float,
    relaxation: float,
    is_first: bool,
    backward: bool,
    x: FloatVector,
) -> None:
    """Sweep the blocks of one color and then the blocks of the other color; the entries of row i end before ends[i]."""
    indptr, *rest = rows
    operands, edges = (*rest, *vectors, sign, relaxation, is_first, backward, x), blocks.edges
    for colour in (1, 0) if backward else (0, 1):
        if count := blocks.count(colour):
            reach = blocks.reach if is_first and colour == 1 else 0
            share(
                partial(_swept_piece, indptr, ends, operands, x, edges, reach, colour),
                count,
                blocks.smallest_share,
            )


def _swept_piece(
    indptr: Any,
    ends: Any,
    operands: tuple[Any, ...],
    x: FloatVector,
    edges: Any,
    reach: int,
    colour: int,
    first: int,
    last: int,
) -> None:
    """Sweep some blocks of a colour; so many rows at the end of each need all their entries in the first sweep."""
    block_ends = edges[1:]
    if reach == 0:
        _sweep(indptr, ends, *operands, colour, edges, block_ends, first, last)
        return
    seams = read_only(block_ends - reach)
    _sweep(indptr, ends, *operands, colour, edges, seams, first, last)
    _sweep(indptr, indptr[1:], *operands, colour, seams, block_ends, first, last)


@inline
def _plus_products(total, first, last, indices, data, x):  # type: ignore[no-untyped-def]
    """Return total + Σ data_k x_j over the entries first ≤ k < last of a row."""
    for k in range(first, last):
        total += data[k] * x[uintp(indices[k])]
    return total


@kernel
def _sweep(  # type: ignore[no-untyped-def]
    indptr,
    ends,
    split,
    indices,
    data,
    inverse,
    b,
    lower,
    upper,
    sign,
    relaxation,
    is_first,
    backward,
    x,
    colour,
    begins,
    block_ends,
    first_block,
    last_block,
):
    """Overwrite x row by row, x_i ← mid(l_i, u_i, x_i − relaxation inverse_i r_i), r = M x + sign b from the current x.

    The sweep covers the blocks of one color with these numbers. An empty `lower` or `upper` means no bound. The entries
    of row i end before ends[i]. The first sweep starts from x = 0.
    """
    has_lower, has_upper = lower.size > 0, upper.size > 0
    for counted in range(last_block - first_block):
        block = 2 * (last_block - 1 - counted if backward else first_block + counted) + colour
        begin, end = begins[block], block_ends[block]
        for step in range(end - begin):
            i = uintp(end - 1 - step if backward else begin + step)
            value, pivot = 0.0 if is_first else x[i], relaxation * inverse[i]
            if pivot != 0.0:
                value -= pivot * _excess(
                    sign * b[i], indptr[i], split[i], ends[i], backward, indices, data, x
                )
            if has_lower:
                value = lower[i] if lower[i] > value else value
            if has_upper:
                value = upper[i] if upper[i] < value else value
            x[i] = value


@inline
def _excess(total, first, diagonal, end, backward, indices, data, x):  # type: ignore[no-untyped-def]
    """Return total + (M x)_i; the last swept neighbor is added last, so that the sum waits only for this value."""
    first, diagonal, end, one = uintp(first), uintp(diagonal), uintp(end), uintp(1)
    behind = diagonal + one
    total = _plus_products(
        total, first if backward else diagonal, behind if backward else end, indices, data, x
    )
    k, step = end - one if backward else first, uintp(-1) if backward else one
    for _ in range(end - behind if backward else diagonal - first):
        total += data[k] * x[uintp(indices[k])]
        k += step
    return total


@kernel
def _products(  # type: ignore[no-untyped-def]
    indptr, begins, further, indices, data, inverse, sign, b, weight, x, product, first, end
):
    """Product ← sign · M x + weight · b on the free rows, 0 elsewhere; row i begins at begins[i] + further."""
    one, further = uintp(1), uintp(further)
    for i in range(uintp(first), uintp(end)):
        total = _plus_products(
            0.0, uintp(begins[i]) + further, uintp(indptr[i + one]), indices, data, x
        )
        product[i] = sign * total + weight * b[i] if inverse[i] != 0.0 else 0.0


@kernel
def _free_rows(  # type: ignore[no-untyped-def]
    indptr,
    indices,
    data,
    inverse,
    q,
    lower,
    upper,
    z,
    is_free,
    is_changed,
    residual,
    first,
    end,
):
    """Apply `free_rows` to the rows from first to end, in order; a NaN is the largest residual."""
    one, largest, changed = uintp(1), 0.0, 0
    for i in range(uintp(first), uintp(end)):
        w = _plus_products(q[i], uintp(indptr[i]), uintp(indptr[i + one]), indices, data, z)
        step, above, below = w * inverse[i], z[i] - lower[i], z[i] - upper[i]
        r = abs(clamp(step, below, above))
        largest = largest if r <= largest else r
        is_off = ((above > 0.0) | (w < 0.0)) & ((below < 0.0) | (w > 0.0))
        is_changed[i] = is_off != is_free[i]
        changed += is_changed[i]
        is_free[i] = is_off
        residual[i] = -w if is_off else 0.0
    return largest, changed
