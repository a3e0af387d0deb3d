"""What a V-cycle and a nested iteration do on one grid; compiled, arrays only.

`inverse` holds 1/diagonal, and 0 for an unknown that is fixed: it keeps the value 0 and passes no residual on.
`stretches` says which rows are equal (see there); a kernel takes those at once, and the others one by one.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit, uintp
from numpy.typing import NDArray

from ...checks import FloatVector, read_only
from ...kernels.compilation import compiled
from .stretches import LONGEST_REACH, Stretches

Matrix = tuple[NDArray[Any], NDArray[Any], NDArray[Any], FloatVector, Stretches]  # in CSR, and where diagonals stand
NO_BOUNDS = (read_only(np.zeros(0)),) * 2


def first_sweep(rows: Matrix, inverse: FloatVector, b: FloatVector, x: FloatVector) -> None:
    """Overwrite x by one forward Gauss–Seidel sweep for M x = b from x = 0: a pass over the lower triangle."""
    indptr, split, *rest = rows
    _sweep(indptr, split, split, *rest, read_only(inverse), -1.0, read_only(b), *NO_BOUNDS, 1.0, True, False, x)


def residual_after_first_sweep(
    rows: Matrix, inverse: FloatVector, weight: FloatVector, x: FloatVector, residual: FloatVector
) -> None:
    """Write b − M x behind `first_sweep` into `residual`: row i held when it was left, then x_j, j > i, changed.

    It held with the pivot m_ii + weight_i, where there are weights.
    """
    indptr, split, *rest = rows
    _free_product(indptr, split, 1, *rest, read_only(inverse), -1.0, x, residual)
    if weight.size:
        residual += np.where(inverse != 0.0, weight * x[: weight.size], 0.0)


def free_product(rows: Matrix, inverse: FloatVector, x: FloatVector, product: FloatVector) -> None:
    """Product ← M x on the free rows, 0 elsewhere."""
    indptr, _, *rest = rows
    _free_product(indptr, indptr, 0, *rest, read_only(inverse), 1.0, x, product)


def sweep(rows: Matrix, inverse: FloatVector, backward: bool, b: FloatVector, x: FloatVector) -> None:
    """Overwrite x by one Gauss–Seidel sweep for M x = b."""
    indptr, *rest = rows
    _sweep(indptr, indptr[1:], *rest, read_only(inverse), -1.0, read_only(b), *NO_BOUNDS, 1.0, False, backward, x)


def projected_sweep(
    rows: Matrix, vectors: tuple[FloatVector, ...], relaxation: float, backward: bool, z: FloatVector
) -> None:
    """Overwrite z row by row, z_i ← mid(l_i, u_i, z_i − relaxation inverse_i w_i) with w_i from the current z.

    `vectors` are the inverse pivots, q, lower and upper, read-only.
    """
    indptr, *rest = rows
    inverse, *problem = vectors
    _sweep(indptr, indptr[1:], *rest, inverse, 1.0, *problem, relaxation, False, backward, z)


@njit(inline="always")
def _plus_products(total, first, last, indices, data, x):  # type: ignore[no-untyped-def]
    """Return total + Σ data_k x_j over the entries first ≤ k < last of a row."""
    for k in range(first, last):
        total += data[k] * x[uintp(indices[k])]
    return total


@njit(inline="always")
def _plus_products_backward(total, first, last, indices, data, x):  # type: ignore[no-untyped-def]
    """Return the same, summed from the last entry to the first."""
    k = last
    while k > first:
        k -= uintp(1)
        total += data[k] * x[uintp(indices[k])]
    return total


@compiled
def _add_products(first, last, but, shift, indices, data, x, begin, size, sums):  # type: ignore[no-untyped-def]
    """Add Σ data_k x_j, j = p + shift + the column of k, to sums[begin + p], p < size; first ≤ k < last, k ≠ but.

    Two entries at a time: half the passes over the sums.
    """
    one, begin, size = uintp(1), uintp(begin), uintp(size)
    k = uintp(first)
    while k < last:
        after = k + one
        if k != but:
            after += one if after == but else uintp(0)
            at = uintp(shift + indices[k])
            if after < last:
                at_too = uintp(shift + indices[after])
                for p in range(size):
                    sums[begin + p] += data[k] * x[at + p] + data[after] * x[at_too + p]
                after += one
            else:
                for p in range(size):
                    sums[begin + p] += data[k] * x[at + p]
        k = after


@njit(inline="always")
def _place(first, last, column, indices):  # type: ignore[no-untyped-def]
    """Return where that column stands among these entries, `last` where it does not."""
    for k in range(first, last):
        if indices[k] == column:
            return k
    return last


@compiled
def _sweep(  # type: ignore[no-untyped-def]
    indptr, ends, split, indices, data, stretches, inverse, sign, b, lower, upper, relaxation, is_first, backward, x
):
    """Overwrite x row by row, x_i ← mid(l_i, u_i, x_i − relaxation inverse_i r_i), r = M x + sign b from the current x.

    Where `lower` is empty there are no bounds. The entries of row i end before ends[i]. The first sweep takes x for 0.
    """
    count, has_bounds = stretches.shape[0], lower.size > 0
    sums = np.empty(LONGEST_REACH)
    for s in range(count):
        at = count - 1 - s if backward else s
        first, end, reach = stretches[at, 0], stretches[at, 1], stretches[at, 2]
        if reach == 0:
            for step in range(end - first):
                i = uintp(end - 1 - step if backward else first + step)
                value, pivot = 0.0 if is_first else x[i], relaxation * inverse[i]
                if pivot != 0.0:
                    value -= pivot * _excess(sign * b[i], indptr[i], split[i], ends[i], backward, indices, data, x)
                x[i] = _clamped(value, lower[i], upper[i]) if has_bounds else value
            continue
        lowest, last = uintp(indptr[first]), uintp(ends[first])
        near = _place(lowest, last, first + 1 if backward else first - 1, indices)
        weight = relaxation * data[near] if near < last else 0.0
        for done in range(0, end - first, reach):
            size = min(reach, end - first - done)
            i = end - done - size if backward else first + done
            begin = uintp(i)
            for p in range(uintp(size)):
                sums[p] = sign * b[begin + p]
            _add_products(lowest, last, near, i - first, indices, data, x, 0, size, sums)
            for p in range(uintp(size)):
                before = 0.0 if is_first else x[begin + p]
                sums[p] = before - sums[p] * (relaxation * inverse[begin + p])
            before = (x[i + size] if backward else x[i - 1]) if near < last else 0.0
            for step in range(size):  # the only loop in which a row waits for the one before
                place = uintp(size - 1 - step if backward else step)
                p = begin + place
                before = sums[place] - weight * inverse[p] * before
                x[p] = before = _clamped(before, lower[p], upper[p]) if has_bounds else before


@njit(inline="always")
def _excess(total, first, diagonal, end, backward, indices, data, x):  # type: ignore[no-untyped-def]
    """Return total + (M x)_i, the neighbour that was swept last added last: the sum has waited for nothing else."""
    first, diagonal, end = uintp(first), uintp(diagonal), uintp(end)
    if backward:
        total = _plus_products(total, first, diagonal + uintp(1), indices, data, x)
        return _plus_products_backward(total, diagonal + uintp(1), end, indices, data, x)
    total = _plus_products(total, diagonal, end, indices, data, x)
    return _plus_products(total, first, diagonal, indices, data, x)


@njit(inline="always")
def _clamped(value, lower, upper):  # type: ignore[no-untyped-def]
    """mid(lower, upper, value), a NaN kept."""
    value = lower if lower > value else value
    return upper if upper < value else value


@compiled
def transposed_sweep(indptr, indices, data, inverse, backward, residual, x):  # type: ignore[no-untyped-def]
    """Add to x one Gauss–Seidel sweep for Mᵀx = b by the rows of M, which are the columns of Mᵀ.

    `residual` is b − Mᵀx before and after; where an unknown is fixed it means nothing.
    """
    one, n = uintp(1), uintp(inverse.size)
    for step in range(n):
        i = n - one - step if backward else step
        if inverse[i] != 0.0:
            change = residual[i] * inverse[i]
            x[i] += change
            for k in range(uintp(indptr[i]), uintp(indptr[i + one])):
                residual[uintp(indices[k])] -= data[k] * change


@compiled
def add_transposed_product(indptr, indices, data, factor, x, to):  # type: ignore[no-untyped-def]
    """Add factor · Aᵀx to `to`, by the rows of A."""
    one = uintp(1)
    for i in range(uintp(x.size)):
        if x[i] != 0.0:
            for k in range(uintp(indptr[i]), uintp(indptr[i + one])):
                to[uintp(indices[k])] += factor * (data[k] * x[i])


@compiled
def restrict(r_indptr, r_indices, r_data, fine, coarse):  # type: ignore[no-untyped-def]
    """Coarse ← Pᵀ fine."""
    one = uintp(1)
    for row in range(uintp(coarse.size)):
        coarse[row] = _plus_products(0.0, uintp(r_indptr[row]), uintp(r_indptr[row + one]), r_indices, r_data, fine)


@compiled
def prolong(p_indptr, p_indices, p_data, coarse, is_free, lower, upper, z):  # type: ignore[no-untyped-def]
    """Overwrite z by mid(lower, upper, z + P coarse) on the free rows; return how many were cut off at a bound."""
    one = uintp(1)
    cut = 0
    for i in range(uintp(lower.size)):
        if is_free[i]:
            value = _plus_products(z[i], uintp(p_indptr[i]), uintp(p_indptr[i + one]), p_indices, p_data, coarse)
            if value < lower[i]:
                value = lower[i]
                cut += 1
            if value > upper[i]:
                value = upper[i]
                cut += 1
            z[i] = value
    return cut


@compiled
def add_prolonged(p_indptr, p_indices, p_data, coarse, inverse, x):  # type: ignore[no-untyped-def]
    """Add P coarse to x on the free rows."""
    one = uintp(1)
    for i in range(uintp(inverse.size)):
        if inverse[i] != 0.0:
            x[i] = _plus_products(x[i], uintp(p_indptr[i]), uintp(p_indptr[i + one]), p_indices, p_data, coarse)


@compiled
def _add_rows(indptr, begins, further, indices, data, first, reach, i, size, x, sums):  # type: ignore[no-untyped-def]
    """Add M x to sums on `size` rows from i on, which belong to the stretch that begins with `first`.

    The entries of row i begin at begins[i] + further.
    """
    one, further = uintp(1), uintp(further)
    if reach > 0:
        last = uintp(indptr[first + 1])
        _add_products(uintp(begins[first]) + further, last, last, i - first, indices, data, x, i, size, sums)
    else:
        for p in range(uintp(i), uintp(i + size)):
            sums[p] = _plus_products(sums[p], uintp(begins[p]) + further, uintp(indptr[p + one]), indices, data, x)


@compiled
def free_rows(  # type: ignore[no-untyped-def]
    indptr, split, indices, data, stretches, inverse, q, lower, upper, z, snaps, is_free, is_changed, residual
):
    """Find the free rows of z: those strictly between their bounds, or pushed off the bound by w.

    With `snaps`, an unknown that a Gauss–Seidel step would put at a bound is put there: projected-type sweeps approach
    a bound without reaching it. Writes −w on the free rows and 0 elsewhere into `residual`; returns the largest scaled
    residual of the problem, and how many rows changed.
    """
    room = np.empty(2 * LONGEST_REACH)
    bits = room.view(np.int64)  # of numbers ≥ 0 they have the same order, and NaN is the largest
    largest, changed, done = np.int64(0), 0, 0
    for s in range(stretches.shape[0]):
        first, end, reach = stretches[s, 0], stretches[s, 1], stretches[s, 2]
        i = first
        while i < end:
            size = min(reach if reach > 0 else LONGEST_REACH, end - i)
            for p in range(uintp(i), uintp(i + size)):
                residual[p] = q[p]
            _add_rows(indptr, indptr, 0, indices, data, first, reach, i, size, z, residual)
            i += size
            if i - done < LONGEST_REACH and i < residual.size:
                continue  # short stretches are looked at together
            begin, size, done = uintp(done), uintp(i - done), i
            if snaps:
                _snap(begin, begin + size, residual, inverse, lower, upper, z)
            for k in range(size):
                row = begin + k
                w, above, below = residual[row], z[row] - lower[row], z[row] - upper[row]
                room[k] = abs(_clamped(w * inverse[row], below, above))
                is_off = ((above > 0.0) | (w < 0.0)) & ((below < 0.0) | (w > 0.0))
                is_changed[row] = is_off != is_free[row]
                is_free[row] = is_off
                residual[row] = -w if is_off else 0.0
            for k in range(size):
                changed += is_changed[begin + k]
                largest = max(largest, bits[k])
    bits[0] = largest
    return room[0], changed


@njit(inline="always")
def _snap(begin, end, w, inverse, lower, upper, z):  # type: ignore[no-untyped-def]
    for p in range(begin, end):
        r, above, below = w[p] * inverse[p], z[p] - lower[p], z[p] - upper[p]
        if r >= above > 0.0:
            z[p] = lower[p]
        elif r <= below < 0.0:
            z[p] = upper[p]


@compiled
def _free_product(indptr, begins, further, indices, data, stretches, inverse, sign, x, product):  # type: ignore[no-untyped-def]
    """Product ← sign · M x on the free rows, 0 elsewhere; the entries of row i begin at begins[i] + further."""
    for s in range(stretches.shape[0]):
        first, end, reach = stretches[s, 0], stretches[s, 1], stretches[s, 2]
        i = first
        while i < end:
            size = min(reach if reach > 0 else LONGEST_REACH, end - i)
            for row in range(uintp(i), uintp(i + size)):
                product[row] = 0.0
            _add_rows(indptr, begins, further, indices, data, first, reach, i, size, x, product)
            for row in range(uintp(i), uintp(i + size)):
                product[row] = sign * product[row] if inverse[row] != 0.0 else 0.0
            i += size
