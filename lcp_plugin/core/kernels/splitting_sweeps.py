"""Compiled sweeps over the rows of CSR arrays, for plain arrays.

Every sweep is one pass over the rows in the chosen direction. The matrix arrives as
``(indptr, split, indices, data)``; ``split`` cuts each row in two, so that one side of the cut holds exactly
the columns that a Gauss–Seidel sweep in that direction has already updated (`core.sweep_data.split_rows`).

Four techniques make the passes fast, each measured on the five-point matrix with n = 10⁶. Unsigned row positions avoid
a wrap-around test at each access. Pivots are inverted beforehand. The updated neighbor nearest to the diagonal is taken
out of the inner loop, because its value is still in a register and the next row has to wait only for this value.
Vectors that are read once per row are the columns of one array `rows`, because a processor prefetches one wide stream
better than six narrow streams.

A comparison with NaN is false; every maximum below is written so that a NaN survives it.

The compiled sweep of the modulus-based iterations, on arrays only.

Compiled sweeps of the modulus-based iterations.
"""

from __future__ import annotations

from .compilation import kernel, uintp
from .rows import clamp, halves_of_row, residual_of_row, without_nearest


@kernel
def splitting_sweep(  # type: ignore[no-untyped-def]
    indptr, split, indices, data, rows, coupling, projected, unit, backward, z, new
):
    """Write the next iterate of an AOR-type splitting into `new`; return the residual of z, and Σ (unit (new − z))².

    `rows` holds q, lower, upper, inverse_scale, step, inverse_pivot. With w = M z + q at the old z and
    c_i = Σ m_ij (new_j − z_j) over the columns j already updated:

        projected:  new_i = mid(l_i, u_i, z_i − (2 r_i + coupling step_i c_i) inverse_pivot_i)
                    where r_i = z_i − mid(l_i, u_i, z_i − step_i w_i)
        otherwise:  new_i = mid(l_i, u_i, z_i − step_i (w_i + coupling c_i) inverse_pivot_i)

    r_i is computed as mid(z_i − u_i, z_i − l_i, step_i w_i), the same number without cancelling a small w
    against a large z. The residual is max_i |mid(z_i − u_i, z_i − l_i, inverse_scale_i w_i)|.
    """
    n, one = uintp(rows.shape[0]), uintp(1)
    largest = squares = near = 0.0
    for k in range(n):
        i = n - one - k if backward else k
        first, last, other, other_end = halves_of_row(indptr, split, i, backward)
        w, low, high, inverse, s = rows[i, 0], rows[i, 1], rows[i, 2], rows[i, 5], rows[i, 4]
        c = nearest_weight = nearest_change = 0.0
        for at in range(other, other_end):
            w += data[at] * z[uintp(indices[at])]
        if last > first:
            nearest, first, last = without_nearest(first, last, backward)
            for at in range(first, last):
                j = uintp(indices[at])
                old = z[j]
                w += data[at] * old
                c += data[at] * (new[j] - old)
            j = uintp(indices[nearest])
            old = z[j]
            w += data[nearest] * old
            nearest_weight = coupling * s * data[nearest] * inverse
            nearest_change = near if j + one == i or i + one == j else new[j] - old
        zi = z[i]
        r = abs(residual_of_row(w * rows[i, 3], zi, low, high))
        if r > largest or r != r or zi != zi:
            largest = r + zi if zi != zi else r
        drive = 2.0 * residual_of_row(w * s, zi, low, high) if projected else w * s
        moved = (zi - (drive + coupling * s * c) * inverse) - nearest_weight * nearest_change
        value = clamp(moved, low, high)
        new[i] = value
        near = value - zi
        squares += (near * unit) * (near * unit)
    return largest, squares


@kernel
def extrapolate(after, weight, lower, upper, before):  # type: ignore[no-untyped-def]
    """Overwrite `before` by mid(lower, upper, after + weight (after − before)), without ghosts at the end of both."""
    for i in range(lower.size):
        before[i] = clamp(after[i] + weight * (after[i] - before[i]), lower[i], upper[i])


@kernel
def relaxation_sweep(  # type: ignore[no-untyped-def]
    indptr, split, indices, data, rows, relaxation, backward, z
):
    """Overwrite z row by row, z_i ← mid(l_i, u_i, z_i − relaxation inverse_scale_i w_i) with w_i from the current z.

    `rows` holds q, lower, upper, inverse_scale. Returns max_i |change of z_i| and Σ_i |change of z_i|.
    """
    n, one = uintp(rows.shape[0]), uintp(1)
    largest = total = near = 0.0
    for k in range(n):
        i = n - one - k if backward else k
        first, last, other, other_end = halves_of_row(indptr, split, i, backward)
        w, s = rows[i, 0], relaxation * rows[i, 3]
        nearest_weight = nearest_value = 0.0
        for at in range(other, other_end):
            w += data[at] * z[uintp(indices[at])]
        if last > first:
            nearest, first, last = without_nearest(first, last, backward)
            for at in range(first, last):
                w += data[at] * z[uintp(indices[at])]
            j = uintp(indices[nearest])
            nearest_weight = data[nearest] * s
            nearest_value = near if j + one == i or i + one == j else z[j]
        zi = z[i]
        value = clamp((zi - w * s) - nearest_weight * nearest_value, rows[i, 1], rows[i, 2])
        z[i] = value
        near = value
        change = abs(value - zi)
        total += change
        if change > largest or change != change:
            largest = change
    return largest, total


@kernel
def modulus_sweep(  # type: ignore[no-untyped-def]
    indptr, split, indices, data, rows, relaxation, acceleration, backward, x, new, z
):
    """Write the next modulus vector into `new` and z = lower + max(x, 0) of the incoming x into `z`.

    `rows` holds q, lower, inverse_scale, omega, inverse_pivot. With w = M max(x, 0) + q and
    c_i = Σ m_ij (new_j − x_j) over the columns j already updated:

        new_i = x_i − (2 α (w_i − Ω_i max(−x_i, 0)) + β c_i) inverse_pivot_i

    Returns max_i |min(z_i − lower_i, w_i inverse_scale_i)|, and 0.
    """
    n, one, largest = uintp(rows.shape[0]), uintp(1), 0.0
    for k in range(n):
        i = n - one - k if backward else k
        first, last, other, other_end = halves_of_row(indptr, split, i, backward)
        w, c = rows[i, 0], 0.0
        for at in range(first, last):
            j = uintp(indices[at])
            old = x[j]
            w += data[at] * (0.0 if old < 0.0 else old)
            c += data[at] * (new[j] - old)
        for at in range(other, other_end):
            old = x[uintp(indices[at])]
            w += data[at] * (0.0 if old < 0.0 else old)
        xi = x[i]
        positive = 0.0 if xi < 0.0 else xi
        slack = w * rows[i, 2]
        r = abs(slack if slack < positive else positive)
        if r > largest or r != r or slack != slack:
            largest = r if slack == slack else slack
        z[i] = rows[i, 1] + positive
        drive = 2.0 * relaxation * (w - rows[i, 3] * (positive - xi))
        new[i] = xi - (drive + acceleration * c) * rows[i, 4]
    return largest, 0.0
