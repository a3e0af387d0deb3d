"""The matrix of the coarser grid, PᵀMP, and its truncation; compiled, arrays only.

Truncation to a set of free unknowns zeroes the rows of P of all fixed unknowns, and of fine unknowns with nearly all
couplings to fixed unknowns (`HELD_SHARE`). P would interpolate such a fine unknown from its coarse neighbors, and if
couplings jump, conjugate gradients would take ten times as many steps. A row of the coarse matrix changes only if it
meets an unknown whose row of P is zeroed or restored, or a changed row of the finer matrix. Only such rows are computed
again.

Positions are unsigned, which spares the test for a negative index at each access: a third of the time.

`inverse` holds 1/diagonal, and 0 for an unknown that is fixed: it keeps the value 0 and passes no residual on.

Sums are split into the same chunks for any number of threads. A fine unknown is called held if seven eighths of its
couplings lead to fixed unknowns.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from ...core.checks import AnyMatrix, BoolVector, Vector, read_only
from ...core.kernels.compilation import inline, kernel, uintp
from ...core.kernels.rows import clamp
from ...core.kernels.threads import share
from ...core.tuning import SHARED_FROM
from .grids import Operator, RowBlocks, pivots

if TYPE_CHECKING:
    from .grids import Transfer

INVERTIBLE = 1e-300  # its inverse is finite


def galerkin(
    matrix: Operator, prolongation: Operator, restriction: Operator, columns: int
) -> Operator:
    """Return R M P with sorted rows, for a P that injects the coarse unknowns and M with a stored diagonal.

    An entry that cancels is stored, because it may not cancel in the truncated product.
    """
    width, parts = prolongation.indptr.size - 1, (matrix, prolongation, restriction)
    M, P, R = map(pattern_of, parts, (width, columns, matrix.indptr.size - 1))
    pattern = R @ M @ P
    pattern.sort_indices()
    entries = Operator(pattern.indptr, pattern.indices, np.zeros(pattern.nnz))
    split, inverse = pivots(entries, INVERTIBLE)
    values, all_rows = np.empty(pattern.nnz), np.ones((2, width), np.bool_)
    flags = np.zeros((3, columns), np.bool_)
    coarse = *entries.arrays[:2], values, split, inverse.copy(), *flags
    operands = prolongation.arrays, restriction.arrays, coarse
    update_product(matrix.arrays, tuple(all_rows), *operands)
    return Operator(pattern.indptr, pattern.indices, values)


def pattern_of(operator: Operator, columns: int) -> sp.csr_array:
    """Return the pattern of a matrix, bool: its products do not cancel."""
    ones = np.ones(operator.indices.size, np.bool_)
    shape = operator.indptr.size - 1, columns
    return sp.csr_array((ones, operator.indices, operator.indptr), shape=shape)


@kernel
def mark_rows(indptr, indices, is_free_changed, is_row_changed, touched, first, end):  # type: ignore[no-untyped-def]
    """Mark rows; all three flags are bytes."""
    one = uintp(1)
    for i in range(uintp(first), uintp(end)):
        touched[i] = is_row_changed[i]
        for k in range(uintp(indptr[i]), uintp(indptr[i + one])):
            touched[i] |= is_free_changed[uintp(indices[k])]


def update_product(
    matrix: AnyMatrix, flags: Any, prolongation: Any, restriction: Any, coarse: Any
) -> tuple[float, int]:
    """Compute the coarse rows again that meet a touched row; return the number of products and of changed rows.

    The operands are tuples of arrays, as `_update_rows` names them.
    """
    width, index_type = flags[0].size, matrix[1].dtype

    def piece(first: int, end: int) -> tuple[float, int]:
        sums = np.empty(width), np.empty(coarse[5].size)
        space = np.zeros(width, index_type), np.empty(width, index_type), *sums
        return _update_rows(matrix, flags, prolongation, restriction, coarse, space, first, end)

    products, changed = zip(*share(piece, restriction[0].size - 1, 16384), strict=True)
    return sum(products), sum(changed)


@kernel
def _update_rows(matrix, flags, prolongation, restriction, coarse, space, first, end):  # type: ignore[no-untyped-def]
    """Compute the changed coarse rows. A row of R M is computed before its product with P: it adds up couplings.

    A coarse unknown is fixed if all of its fine unknowns are fixed or held, or if its pivot is not positive.
    """
    (indptr, indices, data), (is_interpolated, touched) = matrix, flags
    (p_indptr, p_indices, p_data), (r_indptr, r_indices, r_data) = prolongation, restriction
    c_indptr, c_indices, c_data, c_diagonal, c_inverse = coarse[:5]
    c_is_free, c_free_changed, c_row_changed = coarse[5:]
    fine_place, fine, fine_sums, sums = space
    one = uintp(1)
    products = 0.0
    changed_rows = 0
    for row in range(uintp(first), uintp(end)):
        is_changed = False
        for a in range(uintp(r_indptr[row]), uintp(r_indptr[row + one])):
            if touched[uintp(r_indices[a])]:
                is_changed = True
                break
        c_free_changed[row] = False
        c_row_changed[row] = is_changed
        if not is_changed:
            continue
        changed_rows += 1
        count, added = uintp(0), uintp(0)
        for a in range(uintp(r_indptr[row]), uintp(r_indptr[row + one])):
            i = uintp(r_indices[a])
            if not is_interpolated[i]:
                continue
            weight = r_data[a]
            added += uintp(indptr[i + one] - indptr[i])
            for b in range(uintp(indptr[i]), uintp(indptr[i + one])):
                k = uintp(indices[b])
                if not is_interpolated[k]:
                    continue
                at = uintp(fine_place[k])
                if at == 0:
                    fine[count] = k
                    fine_sums[count] = weight * data[b]
                    count += one
                    fine_place[k] = count
                else:
                    fine_sums[at - one] += weight * data[b]
        for c in range(uintp(c_indptr[row]), uintp(c_indptr[row + one])):
            sums[uintp(c_indices[c])] = 0.0
        for f in range(count):
            k = uintp(fine[f])
            fine_place[k] = 0
            value = fine_sums[f]
            added += uintp(p_indptr[k + one] - p_indptr[k])
            for c in range(uintp(p_indptr[k]), uintp(p_indptr[k + one])):
                sums[uintp(p_indices[c])] += value * p_data[c]
        for c in range(uintp(c_indptr[row]), uintp(c_indptr[row + one])):
            c_data[c] = sums[uintp(c_indices[c])]
        products += added
        pivot = c_data[uintp(c_diagonal[row])]
        free = pivot > INVERTIBLE
        c_inverse[row] = 1.0 / pivot if free else 0.0
        c_free_changed[row] = free != c_is_free[row]
        c_is_free[row] = free
    return products, changed_rows


# CSR arrays and the positions of the diagonal
GridMatrix = tuple[NDArray[Any], NDArray[Any], NDArray[Any], Vector]
Vectors = tuple[Vector, ...]
NO_BOUNDS = (read_only(np.zeros(0)),) * 2


def residual_after_first_sweep(
    rows: GridMatrix, blocks: RowBlocks, inverse: Vector, b: Vector, x: Vector, residual: Vector
) -> None:
    """Write b − M x after the first sweep into `residual`: row i was exact until later rows changed."""
    operands = read_only(inverse), -1.0, read_only(b)
    shared(_product_of(rows, rows[1], 1, *operands, 0.0, x, residual), inverse.size)
    whole = _product_of(rows, rows[0], 0, *operands, 1.0, x, residual)
    for edge in blocks.edges[2:-1:2].tolist():  # next to these edges, other rows changed before
        whole(edge - blocks.reach, edge + blocks.reach)


def free_product(rows: GridMatrix, inverse: Vector, x: Vector, product: Vector) -> None:
    """Product ← M x on the free rows, 0 elsewhere."""
    inverse = read_only(inverse)
    shared(_product_of(rows, rows[0], 0, inverse, 1.0, inverse, 0.0, x, product), inverse.size)


def _product_of(rows: GridMatrix, begins: Any, further: int, *operands: Any) -> Any:
    """Return a function of some rows, `_products`; the operands are inverse, sign, b, weight, x, product."""
    return partial(_products, rows[0], begins, further, *rows[2:], *operands)


def mark_free(
    rows: GridMatrix, vectors: Vectors, z: Vector, flags: tuple[BoolVector, ...], residual: Vector
) -> tuple[float, int]:
    """Find the free rows of z: rows strictly between their bounds, or pushed off the bound by w, and their changes.

    Writes −w on the free rows and 0 elsewhere into `residual`; returns the largest scaled
    residual of the problem, and how many rows changed.
    """
    matrix = rows[0], *rows[2:]
    piece = partial(_free_rows, matrix, vectors, z, *flags, residual)
    largest, changed = zip(*shared(piece, residual.size), strict=True)
    return float(np.max(largest)), int(sum(changed))  # a NaN kept


def shared(work: Callable[[int, int], Any], rows: int) -> list[Any]:
    """Call ``work(first, end)`` on parts of all rows, which may be taken in any order."""
    return share(work, rows, SHARED_FROM)


def sweep(
    rows: GridMatrix,
    blocks: RowBlocks,
    vectors: Vectors,
    x: Vector,
    *,
    backward: bool = False,
    is_first: bool = False,
    relaxation: float = 1.0,
) -> None:
    """Overwrite x row by row: x_i ← mid(l_i, u_i, x_i − relaxation inverse_i (M x + q)_i) with the current x.

    `vectors` are the inverse pivots, q, lower and upper, or the inverse pivots and b of a linear system M x = b.
    The first sweep for M x = b begins with x = 0. It costs a pass over the lower triangle, and over full rows by which
    an odd block is coupled to the next even block.
    """
    indptr, *entries = rows
    sign, ends = 1.0 if len(vectors) > 2 else -1.0, rows[1] if is_first else indptr[1:]
    vectors = (*map(read_only, vectors), *NO_BOUNDS)[:4]
    operands = tuple(entries), vectors, (sign, relaxation, is_first, backward), x
    edges, block_ends = blocks.edges, blocks.edges[1:]
    for edge in edges[2::2].tolist() if is_first else ():
        x[edge - blocks.reach : edge] = 0.0

    def piece(color: int, first: int, last: int) -> None:
        # In the first sweep, so many rows at the end of an odd block need all their entries.
        reach = blocks.reach if is_first and color == 1 else 0
        seams = read_only(block_ends - reach)
        _sweep(indptr, ends, *operands, (color, edges, seams), first, last)
        if reach:
            _sweep(indptr, indptr[1:], *operands, (color, seams, block_ends), first, last)

    for color in (1, 0) if backward else (0, 1):
        if count := blocks.count(color):
            # Fewer blocks do not justify a thread; a sweep starts threads twice.
            fewest = max(SHARED_FROM // max(2 * int(edges[1]), 1), 1)
            share(partial(piece, color), count, fewest)


@inline
def _plus_products(total, first, last, indices, data, x):  # type: ignore[no-untyped-def]
    """Return total + Σ data_k x_j over the entries first ≤ k < last of a row."""
    for k in range(first, last):
        total += data[k] * x[uintp(indices[k])]
    return total


@kernel
def _sweep(indptr, ends, entries, vectors, how, x, blocks, first_block, last_block):  # type: ignore[no-untyped-def]
    """Overwrite x row by row, x_i ← mid(l_i, u_i, x_i − relaxation inverse_i r_i), r = M x + sign b from the current x.

    The sweep covers the blocks of one color with these numbers. An empty `lower` or `upper` means no bound. The entries
    of row i end before ends[i]. The first sweep starts from x = 0.
    """
    (split, indices, data), (inverse, b, lower, upper) = entries, vectors
    (sign, relaxation, is_first, backward), (color, begins, block_ends) = how, blocks
    has_lower, has_upper = lower.size > 0, upper.size > 0
    for counted in range(last_block - first_block):
        block = 2 * (last_block - 1 - counted if backward else first_block + counted) + color
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
        begin, end_of_row = uintp(begins[i]) + further, uintp(indptr[i + one])
        total = _plus_products(0.0, begin, end_of_row, indices, data, x)
        product[i] = sign * total + weight * b[i] if inverse[i] != 0.0 else 0.0


@kernel
def _free_rows(matrix, vectors, z, is_free, is_changed, residual, first, end):  # type: ignore[no-untyped-def]
    """Apply `mark_free` to the rows from first to end, in order; a NaN is the largest residual."""
    (indptr, indices, data), (inverse, q, lower, upper) = matrix, vectors
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


AT_ONCE = 8192  # terms that are summed in one piece, too few for BLAS to share; they stay in the fastest cache


def dot(x: Vector, y: Vector) -> float:
    """Return Σ x_i y_i."""
    sums = np.zeros(-(-x.size // AT_ONCE))

    def sum_pieces(first: int, end: int) -> None:
        for piece in range(first, end):
            part = slice(piece * AT_ONCE, (piece + 1) * AT_ONCE)
            sums[piece] = np.dot(x[part], y[part])

    share(sum_pieces, sums.size, 1)
    return float(sums.sum())


def span(vector: Vector) -> float:
    """Return the largest entry in absolute value; 0 of no entry."""
    return float(max(vector.max(initial=0.0), -vector.min(initial=0.0)))


# share of its couplings; no simple fraction, which rounding would decide on regular grids
HELD_SHARE = 0.13
NO_FLAGS = np.zeros(0, np.bool_)


def restrict(transfer: Transfer, fine: Vector, coarse: Vector) -> None:
    """Coarse ← R fine."""
    operands = *transfer.restriction.arrays, read_only(fine), False, NO_FLAGS, *NO_BOUNDS, coarse
    shared(partial(_interpolate, *operands), coarse.size)


def prolong(
    transfer: Transfer, coarse: Vector, flags: BoolVector, z: Vector, bounds: Vectors = NO_BOUNDS
) -> None:
    """Overwrite z by mid(lower, upper, z + P coarse) in flagged rows."""
    operands = *transfer.prolongation.arrays, read_only(coarse), True, flags, *bounds, z
    shared(partial(_interpolate, *operands), transfer.is_coarse.size)


@kernel
def _interpolate(  # type: ignore[no-untyped-def]
    indptr, indices, data, source, adds, flags, lower, upper, to, first, end
):
    """Set to ← A source; if `adds`, add A source in the rows with set flags and clip at the bounds, if any."""
    one, has_bounds = uintp(1), lower.size > 0
    for i in range(uintp(first), uintp(end)):
        if adds and not flags[i]:
            continue
        value = _plus_products(0.0, uintp(indptr[i]), uintp(indptr[i + one]), indices, data, source)
        if adds:
            value += to[i]
        to[i] = clamp(value, lower[i], upper[i]) if has_bounds else value


@kernel
def find_held(  # type: ignore[no-untyped-def]
    matrix, values, is_free, touched, is_interpolated, is_changed, is_coarse, first, end
):
    """Set which touched rows are interpolated; return the number of rows that are held or change with neighbors.

    `is_changed` marks the fixed or freed rows on entry and the rows of P that change on return. `whole` contains the
    values of the matrix with all unknowns free.
    """
    (indptr, indices, whole), one, count = matrix, uintp(1), 0
    for i in range(uintp(first), uintp(end)):
        became, is_changed[i] = is_changed[i], False
        if not touched[i]:
            continue
        is_held = False
        if is_free[i] and not is_coarse[i]:
            before, left, pivot_before, pivot = 0.0, 0.0, 0.0, 0.0
            for k in range(uintp(indptr[i]), uintp(indptr[i + one])):
                j = uintp(indices[k])
                if j == i or whole[k] > 0.0:
                    pivot_before += whole[k]
                else:
                    before -= whole[k]
                if j == i or values[k] > 0.0:
                    pivot += values[k]
                elif is_free[j]:
                    left -= values[k]
            is_held = (
                pivot > 0.0
                and pivot_before > 0.0
                and left / pivot < HELD_SHARE * (before / pivot_before)
            )
        interpolates = is_free[i] and not is_held
        is_changed[i] = interpolates != is_interpolated[i] and not became
        count += is_held or is_changed[i]
        is_interpolated[i] = interpolates
    return count
