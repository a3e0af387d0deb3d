"""What a V-cycle and a nested iteration do on one grid; compiled, arrays only.

`inverse` holds 1/diagonal, and 0 for an unknown that is fixed: it keeps the value 0 and passes no residual on.
"""

from __future__ import annotations

from numba import njit, uintp

from ...kernels.compilation import compiled


@njit(inline="always")
def _plus_products(total, first, last, indices, data, x):  # type: ignore[no-untyped-def]
    """Return total + Σ data_k x_j over the entries first ≤ k < last of a row."""
    for k in range(first, last):
        total += data[k] * x[uintp(indices[k])]
    return total


@compiled
def first_sweep(indptr, split, indices, data, inverse, b, x):  # type: ignore[no-untyped-def]
    """Overwrite x by one forward Gauss–Seidel sweep for M x = b from x = 0: a pass over the lower triangle."""
    for i in range(uintp(b.size)):
        excess = _plus_products(-b[i], uintp(indptr[i]), uintp(split[i]), indices, data, x)
        x[i] = excess * -inverse[i]


@compiled
def residual_after_first_sweep(  # type: ignore[no-untyped-def]
    indptr, split, indices, data, inverse, weight, x, residual
):
    """Write b − M x behind `first_sweep` into `residual`: row i held when it was left, then x_j, j > i, changed.

    It held with the pivot m_ii + weight_i, where there are weights.
    """
    one = uintp(1)
    for i in range(uintp(residual.size)):
        excess = 0.0
        if inverse[i] != 0.0:
            excess = _plus_products(0.0, uintp(split[i]) + one, uintp(indptr[i + one]), indices, data, x)
            if weight.size > 0:
                excess -= weight[i] * x[i]
        residual[i] = -excess


@compiled
def forward_sweep(indptr, indices, data, inverse, b, x):  # type: ignore[no-untyped-def]
    """Overwrite x by one forward Gauss–Seidel sweep for M x = b."""
    one = uintp(1)
    for i in range(uintp(b.size)):
        if inverse[i] != 0.0:
            excess = _plus_products(-b[i], uintp(indptr[i]), uintp(indptr[i + one]), indices, data, x)
            x[i] -= excess * inverse[i]


@compiled
def backward_sweep(indptr, indices, data, inverse, b, x):  # type: ignore[no-untyped-def]
    """Overwrite x by one backward Gauss–Seidel sweep for M x = b."""
    one = uintp(1)
    i = uintp(b.size)
    for _ in range(uintp(b.size)):
        i -= one
        if inverse[i] != 0.0:
            excess = _plus_products(-b[i], uintp(indptr[i]), uintp(indptr[i + one]), indices, data, x)
            x[i] -= excess * inverse[i]


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
def free_rows(indptr, indices, data, rows, z, snaps, is_free, is_changed, residual):  # type: ignore[no-untyped-def]
    """Find the free rows of z: those strictly between their bounds, or pushed off the bound by w.

    `rows` holds q, lower, upper, inverse scale. With `snaps`, an unknown that a Gauss–Seidel step would put at a bound
    is put there: projected-type sweeps approach a bound without reaching it. Writes −w on the free rows and 0
    elsewhere into `residual`; returns the largest scaled residual of the problem, and how many rows changed.
    """
    one = uintp(1)
    largest = 0.0
    changed = 0
    for i in range(uintp(residual.size)):
        w = _plus_products(rows[i, 0], uintp(indptr[i]), uintp(indptr[i + one]), indices, data, z)
        above = z[i] - rows[i, 1]
        below = z[i] - rows[i, 2]
        r = w * rows[i, 3]
        if snaps:
            if r >= above > 0.0:
                z[i], above = rows[i, 1], 0.0
            elif r <= below < 0.0:
                z[i], below = rows[i, 2], 0.0
        free = (above > 0.0 or w < 0.0) and (below < 0.0 or w > 0.0)
        residual[i] = -w if free else 0.0
        is_changed[i] = free != is_free[i]
        if is_changed[i]:
            changed += 1
            is_free[i] = free
        r = below if below > r else r
        r = abs(above if above < r else r)
        if r > largest or r != r:  # noqa: PLR0124 - NaN
            largest = r
    return largest, changed


@compiled
def free_product(indptr, indices, data, is_free, p, product):  # type: ignore[no-untyped-def]
    """Product ← M p on the free rows, 0 elsewhere."""
    one = uintp(1)
    for i in range(uintp(product.size)):
        total = 0.0
        if is_free[i]:
            total = _plus_products(0.0, uintp(indptr[i]), uintp(indptr[i + one]), indices, data, p)
        product[i] = total
