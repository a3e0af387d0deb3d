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

from ...core.kernels.compilation import kernel, uintp
from ...core.kernels.threads import share
from ...core.tuning import SHARED_FROM
from .grids import Operator, pivots

SMALLEST_PIVOT = 1e-300  # its inverse is finite


def count_products(matrix: Operator, prolongation: Operator) -> float:
    """Return the number of products of three entries in PᵀMP."""
    sizes = np.diff(prolongation.indptr).astype(np.float64)  # integers could overflow
    return float(sizes @ (_pattern(matrix, sizes.size) @ sizes))


def product(
    matrix: Operator, prolongation: Operator, restriction: Operator, columns: int
) -> Operator:
    """Return R M P with sorted rows, for a P that injects the coarse unknowns and M with a stored diagonal.

    An entry that cancels is stored, because it may not cancel in the truncated product.
    """
    width = prolongation.indptr.size - 1
    pattern = (
        _pattern(restriction, matrix.indptr.size - 1)
        @ _pattern(matrix, width)
        @ _pattern(prolongation, columns)
    )
    pattern.sort_indices()
    entries = Operator(pattern.indptr, pattern.indices, np.zeros(pattern.nnz))
    split, inverse = pivots(entries, SMALLEST_PIVOT)
    values = np.empty(pattern.nnz)
    update_product(
        *matrix.arrays,
        np.ones(width, np.bool_),
        np.ones(width, np.bool_),
        *prolongation.arrays,
        *restriction.arrays,
        *entries.arrays[:2],
        values,
        split,
        inverse.copy(),
        *(np.zeros(columns, np.bool_) for _ in range(3)),
    )
    return Operator(pattern.indptr, pattern.indices, values)


def _pattern(operator: Operator, columns: int) -> sp.csr_array:
    """Return the pattern of a matrix, bool: its products do not cancel."""
    ones = np.ones(operator.indices.size, np.bool_)
    shape = operator.indptr.size - 1, columns
    return sp.csr_array((ones, operator.indices, operator.indptr), shape=shape)


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
        width = is_interpolated.size
        fine_place, fine = np.zeros(width, indices.dtype), np.empty(width, indices.dtype)
        space = fine_place, fine, np.empty(width), np.empty(c_is_free.size)
        counts: tuple[float, int] = _update_rows(*operands, *space, first, end)
        return counts

    products, changed = zip(*share(piece, r_indptr.size - 1, 16384), strict=True)
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
    """Compute the changed coarse rows. A row of R M is computed before its product with P: it adds up couplings.

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
