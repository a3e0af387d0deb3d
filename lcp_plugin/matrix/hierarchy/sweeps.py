"""What a V-cycle and a nested iteration do on one grid; compiled, arrays only.

`inverse` holds 1/diagonal, and 0 for an unknown that is fixed: it keeps the value 0 and passes no residual on.
`stretches` says which rows are equal (see there); a kernel takes those at once, and the others one by one.
"""

from __future__ import annotations

import numpy as np
from numba import njit, uintp

from ...kernels.compilation import compiled
from .stretches import LONGEST_REACH


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
def _add_products(first, last, but, shift, indices, data, x, sums):  # type: ignore[no-untyped-def]
    """Add Σ data_k x_j to every sums[p], j = p + shift + the column of k, over first ≤ k < last but one of them.

    Two entries at a time: half the passes over the sums.
    """
    one, size = uintp(1), uintp(sums.size)
    k = uintp(first)
    while k < last:
        after = k + one
        if k != but:
            after += one if after == but else uintp(0)
            begin = uintp(shift + indices[k])
            if after < last:
                begin_too = uintp(shift + indices[after])
                for p in range(size):
                    sums[p] += data[k] * x[begin + p] + data[after] * x[begin_too + p]
                after += one
            else:
                for p in range(size):
                    sums[p] += data[k] * x[begin + p]
        k = after


@njit(inline="always")
def _place(first, last, column, indices):  # type: ignore[no-untyped-def]
    """Return where that column stands among these entries, `last` where it does not."""
    for k in range(first, last):
        if indices[k] == column:
            return k
    return last


@compiled
def first_sweep(indptr, split, indices, data, stretches, inverse, b, x):  # type: ignore[no-untyped-def]
    """Overwrite x by one forward Gauss–Seidel sweep for M x = b from x = 0: a pass over the lower triangle."""
    room = np.empty(LONGEST_REACH)
    for s in range(stretches.shape[0]):
        first, end, reach = stretches[s, 0], stretches[s, 1], stretches[s, 2]
        if reach == 0:
            for i in range(uintp(first), uintp(end)):
                excess = _plus_products(-b[i], uintp(indptr[i]), uintp(split[i]), indices, data, x)
                x[i] = excess * -inverse[i]
            continue
        lowest, diagonal = uintp(indptr[first]), uintp(split[first])
        near = _place(lowest, diagonal, first - 1, indices)
        weight = data[near] if near < diagonal else 0.0
        for i in range(first, end, reach):
            sums = room[: min(reach, end - i)]
            part, pivots = x[i : i + sums.size], inverse[i : i + sums.size]
            sums[:] = b[i : i + sums.size]
            before = -x[i - 1] if near < diagonal else 0.0
            for p in range(sums.size):
                sums[p] = -sums[p]
            _add_products(lowest, diagonal, near, i - first, indices, data, x, sums)
            for p in range(sums.size):
                sums[p] *= pivots[p]
            for p in range(sums.size):  # the only one that waits
                before = sums[p] - (weight * pivots[p]) * before
                part[p] = -before


@compiled
def residual_after_first_sweep(  # type: ignore[no-untyped-def]
    indptr, split, indices, data, stretches, inverse, weight, x, residual
):
    """Write b − M x behind `first_sweep` into `residual`: row i held when it was left, then x_j, j > i, changed.

    It held with the pivot m_ii + weight_i, where there are weights.
    """
    one = uintp(1)
    for s in range(stretches.shape[0]):
        first, end, reach = stretches[s, 0], stretches[s, 1], stretches[s, 2]
        if reach == 0:
            for i in range(uintp(first), uintp(end)):
                excess = 0.0
                if inverse[i] != 0.0:
                    excess = _plus_products(0.0, uintp(split[i]) + one, uintp(indptr[i + one]), indices, data, x)
                residual[i] = -excess
            continue
        behind, last = uintp(split[first]) + one, uintp(indptr[first + 1])
        for i in range(first, end, reach):
            part = residual[i : min(i + reach, end)]
            pivots = inverse[i : i + part.size]
            for p in range(part.size):
                part[p] = 0.0
            _add_products(behind, last, last, i - first, indices, data, x, part)
            for p in range(part.size):
                part[p] = -part[p] if pivots[p] != 0.0 else 0.0
    for i in range(weight.size):
        if inverse[i] != 0.0:
            residual[i] += weight[i] * x[i]


@compiled
def sweep(indptr, split, indices, data, stretches, inverse, backward, b, x):  # type: ignore[no-untyped-def]
    """Overwrite x by one Gauss–Seidel sweep for M x = b."""
    one, count = uintp(1), stretches.shape[0]
    room = np.empty(LONGEST_REACH)
    for s in range(count):
        at = count - 1 - s if backward else s
        first, end, reach = stretches[at, 0], stretches[at, 1], stretches[at, 2]
        if reach == 0:
            for step in range(end - first):
                i = uintp(end - 1 - step if backward else first + step)
                if inverse[i] != 0.0:
                    excess = _excess(-b[i], indptr[i], split[i], indptr[i + one], backward, indices, data, x)
                    x[i] -= excess * inverse[i]
            continue
        lowest, last = uintp(indptr[first]), uintp(indptr[first + 1])
        near = _place(lowest, last, first + 1 if backward else first - 1, indices)
        weight = data[near] if near < last else 0.0
        for done in range(0, end - first, reach):
            size = min(reach, end - first - done)
            i = end - done - size if backward else first + done
            sums, part, pivots = room[:size], x[i : i + size], inverse[i : i + size]
            sums[:] = b[i : i + size]
            for p in range(size):
                sums[p] = -sums[p]
            _add_products(lowest, last, near, i - first, indices, data, x, sums)
            for p in range(size):
                sums[p] = part[p] - sums[p] * pivots[p]
            before = (x[i + size] if backward else x[i - 1]) if near < last else 0.0
            for step in range(size):  # the only loop in which a row waits for the one before
                p = size - 1 - step if backward else step
                before = sums[p] - (weight * pivots[p]) * before
                part[p] = before


@compiled
def projected_sweep(  # type: ignore[no-untyped-def]
    indptr, split, indices, data, stretches, inverse, q, lower, upper, relaxation, backward, z
):
    """Overwrite z row by row, z_i ← mid(l_i, u_i, z_i − relaxation inverse_i w_i) with w_i from the current z."""
    one, count = uintp(1), stretches.shape[0]
    room = np.empty(LONGEST_REACH)
    for s in range(count):
        at = count - 1 - s if backward else s
        first, end, reach = stretches[at, 0], stretches[at, 1], stretches[at, 2]
        if reach == 0:
            for step in range(end - first):
                i = uintp(end - 1 - step if backward else first + step)
                w = _excess(q[i], indptr[i], split[i], indptr[i + one], backward, indices, data, z)
                z[i] = _clamped(z[i] - w * (relaxation * inverse[i]), lower[i], upper[i])
            continue
        lowest, last = uintp(indptr[first]), uintp(indptr[first + 1])
        near = _place(lowest, last, first + 1 if backward else first - 1, indices)
        pivot = relaxation * inverse[first]
        weight = pivot * data[near] if near < last else 0.0
        for done in range(0, end - first, reach):
            size = min(reach, end - first - done)
            i = end - done - size if backward else first + done
            sums, part = room[:size], z[i : i + size]
            least, most = lower[i : i + size], upper[i : i + size]
            sums[:] = q[i : i + size]
            _add_products(lowest, last, near, i - first, indices, data, z, sums)
            for p in range(size):
                sums[p] = part[p] - sums[p] * pivot
            before = (z[i + size] if backward else z[i - 1]) if near < last else 0.0
            for step in range(size):
                p = size - 1 - step if backward else step
                before = _clamped(sums[p] - weight * before, least[p], most[p])
                part[p] = before


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


@njit(inline="always")
def _rows_at_once(i, end, reach):  # type: ignore[no-untyped-def]
    """Return how many rows from i on a product takes in one go; it waits for none, alike or not."""
    return min(reach if reach > 0 else LONGEST_REACH, end - i)


@compiled
def _add_rows(indptr, indices, data, first, reach, i, x, sums):  # type: ignore[no-untyped-def]
    """Add the rows of M x from i on to sums; they belong to the stretch that begins with `first`."""
    if reach > 0:
        last = uintp(indptr[first + 1])
        _add_products(uintp(indptr[first]), last, last, i - first, indices, data, x, sums)
    else:
        for p in range(sums.size):
            k, last = uintp(indptr[i + p]), uintp(indptr[i + p + 1])
            sums[p] = _plus_products(sums[p], k, last, indices, data, x)


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
    largest, changed, done = np.int64(0), 0, 0
    for s in range(stretches.shape[0]):
        first, end, reach = stretches[s, 0], stretches[s, 1], stretches[s, 2]
        i = first
        while i < end:
            size = _rows_at_once(i, end, reach)
            residual[i : i + size] = q[i : i + size]
            _add_rows(indptr, indices, data, first, reach, i, z, residual[i : i + size])
            i += size
            if i - done < LONGEST_REACH and i < residual.size:
                continue  # short stretches are looked at together
            w, part, pivots, sizes = residual[done:i], z[done:i], inverse[done:i], room[: i - done]
            least, most, free, news = lower[done:i], upper[done:i], is_free[done:i], is_changed[done:i]
            done = i
            if snaps:
                _snap(w, pivots, least, most, part)
            for p in range(w.size):
                above, below = part[p] - least[p], part[p] - most[p]
                sizes[p] = abs(_clamped(w[p] * pivots[p], below, above))
                is_off = ((above > 0.0) | (w[p] < 0.0)) & ((below < 0.0) | (w[p] > 0.0))
                news[p] = is_off != free[p]
                free[p] = is_off
                w[p] = -w[p] if is_off else 0.0
            for p in range(w.size):
                changed += news[p]
            bits = sizes.view(np.int64)  # of numbers ≥ 0 they have the same order, and NaN is the largest
            for p in range(w.size):
                largest = max(largest, bits[p])
    room.view(np.int64)[0] = largest
    return room[0], changed


@njit(inline="always")
def _snap(w, inverse, lower, upper, z):  # type: ignore[no-untyped-def]
    for p in range(z.size):
        r, above, below = w[p] * inverse[p], z[p] - lower[p], z[p] - upper[p]
        if r >= above > 0.0:
            z[p] = lower[p]
        elif r <= below < 0.0:
            z[p] = upper[p]


@compiled
def free_product(indptr, split, indices, data, stretches, is_free, p, product):  # type: ignore[no-untyped-def]
    """Product ← M p on the free rows, 0 elsewhere."""
    for s in range(stretches.shape[0]):
        first, end, reach = stretches[s, 0], stretches[s, 1], stretches[s, 2]
        i = first
        while i < end:
            size = _rows_at_once(i, end, reach)
            part, free = product[i : i + size], is_free[i : i + size]
            part[:] = 0.0
            _add_rows(indptr, indices, data, first, reach, i, p, part)
            for row in range(size):
                part[row] = part[row] if free[row] else 0.0
            i += size
