"""The matrix of the coarser grid, PᵀMP, and its truncation; compiled, arrays only.

Truncation to a set of free unknowns zeroes the rows of P of all fixed unknowns, and of fine unknowns with nearly all
couplings to fixed unknowns (`vectors.HELD`). P would interpolate such a fine unknown from its coarse neighbors, and if
couplings jump, conjugate gradients would take ten times as many steps. A row of the coarse matrix changes only if it
meets an unknown whose row of P is zeroed or restored, or a changed row of the finer matrix. Only such rows are computed
again.

Positions are unsigned, which spares the test for a negative index at each access: a third of the time.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from ...core.checks import Arrays, FloatVector
from ...core.kernels.compilation import inline, kernel, uintp
from ...core.kernels.threads import share
from ...core.tuning import SHARED_FROM
from .grids import SMALLEST_PIECE, joined

Indices = NDArray[Any]

SMALLEST_PIVOT = 1e-300  # its inverse is finite


def transposed(columns: int, indptr: Indices, indices: Indices, data: FloatVector) -> Arrays:
    """Return the transpose in CSR; its rows are sorted."""
    by_column = sp.csr_array((data, indices, indptr), shape=(indptr.size - 1, columns)).tocsc()
    return by_column.indptr, by_column.indices, by_column.data


@inline
def _sort_row(indices, begin, end):  # type: ignore[no-untyped-def]
    """Sort by insertion: the rows are short."""
    one = uintp(1)
    for a in range(begin + one, end):
        column = indices[a]
        place = a
        while place > begin and indices[place - one] > column:
            indices[place] = indices[place - one]
            place -= one  # type: ignore[assignment]
        indices[place] = column


def count_products(indptr: Indices, indices: Indices, p_indptr: Indices) -> float:
    """Return the number of products of three entries in PᵀMP."""
    size = np.diff(p_indptr).astype(
        np.float64
    )  # not of integers, of which more than 64 bits may take

    def piece(first: int, end: int) -> float:
        met = size[indices[indptr[first] : indptr[end]]]
        return float(np.dot(np.repeat(size[first:end], np.diff(indptr[first : end + 1])), met))

    rows = indptr.size - 1
    return sum(
        piece(first, min(first + SMALLEST_PIECE, rows)) for first in range(0, rows, SMALLEST_PIECE)
    )


def galerkin_product(
    matrix: Arrays, prolongation: Arrays, restriction: Arrays, columns: int
) -> Arrays:
    """Return R M P in CSR with sorted rows and every diagonal entry stored; R has at most as many rows as P columns."""
    n = restriction[0].size - 1
    longest = int(np.diff(prolongation[0]).max(initial=1))
    operands = *matrix, *prolongation, *restriction, longest
    return joined(
        share(
            lambda first, end: _product_piece(operands, columns, n, first, end), n, SMALLEST_PIECE
        )
    )


def _product_piece(operands: tuple[Any, ...], columns: int, n: int, first: int, end: int) -> Arrays:
    """Return the rows [first, end) of the n of R M P, which do not depend on where pieces begin."""
    indptr, indices = operands[:2]
    width, rows = operands[3].size - 1, end - first
    capacity = indices.size * rows // max(n, 1) + rows if first else indices.size + n
    c_indptr = np.zeros(rows + 1, indptr.dtype)
    c_indices, c_data = np.empty(capacity, indices.dtype), np.empty(capacity)
    space = *_row_space(width, indices.dtype), *_row_space(columns, indices.dtype)[::2]
    row = _product_rows(*operands, first, first, end, *space, c_indptr, c_indices, c_data)
    while row < end:  # the capacity did not suffice
        size, capacity = int(c_indptr[row - first]), capacity + capacity // 2 + max(n, columns)
        c_indices, c_data = _enlarged(c_indices, size, capacity), _enlarged(c_data, size, capacity)
        row = _product_rows(*operands, first, row, end, *space, c_indptr, c_indices, c_data)
    return c_indptr, c_indices, c_data


def _row_space(width: int, dtype: Any) -> tuple[Indices, Indices, FloatVector]:
    """Return workspace for a row of `width` columns: positions (zero if absent), column numbers, sums."""
    return np.zeros(width, dtype), np.empty(width, dtype), np.empty(width)


def _enlarged(values: Any, size: int, capacity: int) -> Any:
    larger = np.empty(capacity, values.dtype)
    larger[:size] = values[:size]
    return larger


@kernel
def _product_rows(  # type: ignore[no-untyped-def]
    indptr,
    indices,
    data,
    p_indptr,
    p_indices,
    p_data,
    r_indptr,
    r_indices,
    r_data,
    longest,
    first,
    next_row,
    end,
    fine_place,
    fine,
    fine_sums,
    place,
    sums,
    c_indptr,
    c_indices,
    c_data,
):
    """Compute the rows [first, end) of R M P from `next_row` on; return the first that may not fit, or `end`.

    A row of R M is computed first, because it adds up all couplings to a fine unknown before the product with P.
    """
    one = uintp(1)
    capacity = uintp(c_indices.size)
    size = uintp(c_indptr[next_row - first])
    for row in range(uintp(next_row), uintp(end)):
        begin, own = size, row - uintp(first)
        count = uintp(0)
        for a in range(uintp(r_indptr[row]), uintp(r_indptr[row + one])):
            i = uintp(r_indices[a])
            weight = r_data[a]
            for b in range(uintp(indptr[i]), uintp(indptr[i + one])):
                k = uintp(indices[b])
                at = uintp(fine_place[k])
                if at == 0:
                    fine[count] = k
                    fine_sums[count] = weight * data[b]
                    count += one
                    fine_place[k] = count
                else:
                    fine_sums[at - one] += weight * data[b]
        for f in range(count):
            fine_place[uintp(fine[f])] = 0
        if capacity - size < min(one + count * uintp(longest), uintp(place.size)):
            return row
        c_indices[size] = row
        sums[0] = 0.0
        size += one
        place[row] = 1
        for f in range(count):
            k = uintp(fine[f])
            value = fine_sums[f]
            for c in range(uintp(p_indptr[k]), uintp(p_indptr[k + one])):
                column = uintp(p_indices[c])
                at = uintp(place[column])
                if at == 0:
                    c_indices[size] = column
                    sums[size - begin] = value * p_data[c]
                    size += one
                    place[column] = size - begin
                else:
                    sums[at - one] += value * p_data[c]
        _sort_row(c_indices, begin, size)
        for c in range(begin, size):
            column = uintp(c_indices[c])
            c_data[c] = sums[uintp(place[column]) - one]
            place[column] = 0
        c_indptr[own + one] = size
    return uintp(end)


def mark_rows(*operands: Any) -> None:
    """Mark the rows whose contribution to the coarse matrix changed; same operands as `_mark_rows`."""
    share(partial(_mark_rows, *operands), operands[0].size - 1, SHARED_FROM)


@kernel
def _mark_rows(indptr, indices, is_free_changed, is_row_changed, touched, first, end):  # type: ignore[no-untyped-def]
    """Mark rows; all three flags are bytes."""
    one = uintp(1)
    for i in range(uintp(first), uintp(end)):
        touched[i] = is_row_changed[i]
        for k in range(uintp(indptr[i]), uintp(indptr[i + one])):
            touched[i] |= is_free_changed[uintp(indices[k])]


def update_product(*operands: Any) -> tuple[float, int]:
    """Compute the coarse rows again that meet a touched row; return the number of products and of changed rows.

    The operands are the arrays that `_update_rows` names first.
    """
    indices, is_interpolated, r_indptr, c_is_free = (
        operands[1],
        operands[3],
        operands[8],
        operands[-3],
    )

    def piece(first: int, end: int) -> tuple[float, int]:
        space = *_row_space(is_interpolated.size, indices.dtype), np.empty(c_is_free.size)
        counts: tuple[float, int] = _update_rows(*operands, *space, first, end)
        return counts

    products, changed = zip(*share(piece, r_indptr.size - 1, SMALLEST_PIECE), strict=True)
    return sum(products), sum(changed)


@kernel
def _update_rows(  # type: ignore[no-untyped-def]
    indptr,
    indices,
    data,
    is_interpolated,
    touched,
    p_indptr,
    p_indices,
    p_data,
    r_indptr,
    r_indices,
    r_data,
    c_indptr,
    c_indices,
    c_data,
    c_diagonal,
    c_inverse,
    c_is_free,
    c_free_changed,
    c_row_changed,
    fine_place,
    fine,
    fine_sums,
    sums,
    first,
    end,
):
    """Update rows in the order of `_product_rows`: if all unknowns are free, the result is the coarse matrix exactly.

    A coarse unknown is fixed if all of its fine unknowns are fixed or held, or if its pivot is not positive.
    """
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
        free = pivot > SMALLEST_PIVOT
        c_inverse[row] = 1.0 / pivot if free else 0.0
        c_free_changed[row] = free != c_is_free[row]
        c_is_free[row] = free
    return products, changed_rows
