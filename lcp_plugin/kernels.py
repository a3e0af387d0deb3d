"""Compiled sweeps over CSR arrays; they know arrays only.

Every sweep is one pass over the rows in the chosen direction. The matrix arrives as
``(indptr, split, indices, data)``; ``split`` cuts each row in two, so that one side of the cut holds exactly
the columns that a Gauss–Seidel sweep in that direction has already updated (see :func:`split_rows`).

Four things make the passes fast, each measured on the five-point matrix with n = 10⁶:
unsigned row positions (no wrap-around test at each access); pivots inverted beforehand; the updated neighbour
nearest to the diagonal taken out of the inner loop, because its value is still in a register and it is the
only one the next row has to wait for; and the vectors that are read once a row packed side by side in `rows`
(:func:`pack_rows`), because a processor prefetches one wide stream better than six narrow ones.

A comparison with NaN is false; every maximum below is written so that a NaN survives it.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import float64, njit, uintp
from numba.extending import intrinsic

from .compilation import compiled

LEAST = 2.0**-1074  # the smallest positive double; sums with such numbers take a processor a hundred times longer
MAY_UNDERFLOW = 2.0**-960  # the rounding error of a larger product is a double


@njit(inline="always")
def _clamp(value, lower, upper):  # type: ignore[no-untyped-def]
    """mid(lower, upper, value), a NaN kept."""
    value = lower if lower > value else value
    return upper if upper < value else value


@compiled
def split_rows(indptr, indices, backward, split):  # type: ignore[no-untyped-def]
    """Fill split[i] with the position in row i of the first column ≥ i (backward: > i)."""
    one = uintp(1)
    for i in range(uintp(split.size)):
        first = i + one if backward else i
        k = uintp(indptr[i])
        end = uintp(indptr[i + one])
        while k < end and uintp(indices[k]) < first:
            k += one
        split[i] = k


@compiled
def pack_rows(columns, rows):  # type: ignore[no-untyped-def]
    """Copy the vectors of the tuple `columns` into the columns of `rows`, shape (n, len(columns)), in one pass."""
    for i in range(rows.shape[0]):
        for k in range(rows.shape[1]):
            rows[i, k] = columns[k][i]


@compiled
def splitting_sweep(  # type: ignore[no-untyped-def]
    indptr, split, indices, data, rows, coupling, projected, backward, z, new
):
    """Write the next iterate of an AOR-type splitting into `new`; return two norms of the residual of z.

    `rows` holds q, lower, upper, inverse_scale, step, inverse_pivot. With w = M z + q at the old z and
    c_i = Σ m_ij (new_j − z_j) over the columns j already updated:

        projected:  new_i = mid(l_i, u_i, z_i − (2 r_i + coupling step_i c_i) inverse_pivot_i)
                    where r_i = z_i − mid(l_i, u_i, z_i − step_i w_i)
        otherwise:  new_i = mid(l_i, u_i, z_i − step_i (w_i + coupling c_i) inverse_pivot_i)

    r_i is computed as mid(z_i − u_i, z_i − l_i, step_i w_i), the same number without cancelling a small w
    against a large z. Returns max_i |mid(z_i − u_i, z_i − l_i, inverse_scale_i w_i)| and Σ_i r_i².
    """
    n = uintp(rows.shape[0])
    one = uintp(1)
    largest = 0.0
    squares = 0.0
    near = 0.0
    i = n if backward else uintp(0) - one
    for _ in range(n):
        if backward:
            i -= one
            first, last = uintp(split[i]), uintp(indptr[i + one])
            rest, rest_end = uintp(indptr[i]), first
        else:
            i += one
            first, last = uintp(indptr[i]), uintp(split[i])
            rest, rest_end = last, uintp(indptr[i + one])
        w = rows[i, 0]
        c = 0.0
        nearest_weight = 0.0
        nearest_change = 0.0
        inverse = rows[i, 5]
        s = rows[i, 4]
        for k in range(rest, rest_end):
            w += data[k] * z[uintp(indices[k])]
        if last > first:
            if backward:
                nearest = first
                first += one
            else:
                last -= one
                nearest = last
            for k in range(first, last):
                j = uintp(indices[k])
                old = z[j]
                w += data[k] * old
                c += data[k] * (new[j] - old)
            j = uintp(indices[nearest])
            old = z[j]
            w += data[nearest] * old
            nearest_weight = coupling * s * data[nearest] * inverse
            nearest_change = near if j + one == i or i + one == j else new[j] - old
        zi = z[i]
        low = rows[i, 1]
        high = rows[i, 2]
        above, below = zi - low, zi - high
        r = abs(_clamp(w * rows[i, 3], below, above))
        if r > largest or r != r or zi != zi:
            largest = r + zi if zi != zi else r
        r = _clamp(w * s, below, above)
        squares += r * r if zi == zi else zi
        drive = 2.0 * r if projected else w * s
        value = _clamp((zi - (drive + coupling * s * c) * inverse) - nearest_weight * nearest_change, low, high)
        new[i] = value
        near = value - zi
    return largest, squares


@compiled
def relaxation_sweep(  # type: ignore[no-untyped-def]
    indptr, split, indices, data, rows, relaxation, backward, z
):
    """Overwrite z row by row, z_i ← mid(l_i, u_i, z_i − relaxation inverse_scale_i w_i) with w_i from the current z.

    `rows` holds q, lower, upper, inverse_scale. Returns max_i |change of z_i| and Σ_i |change of z_i|.
    """
    n = uintp(rows.shape[0])
    one = uintp(1)
    largest = 0.0
    total = 0.0
    near = z[n] if uintp(z.size) > n else 0.0  # behind the own unknowns stand those of other processes, if any
    i = n if backward else uintp(0) - one
    for _ in range(n):
        if backward:
            i -= one
            first, last = uintp(split[i]), uintp(indptr[i + one])
            rest, rest_end = uintp(indptr[i]), first
        else:
            i += one
            first, last = uintp(indptr[i]), uintp(split[i])
            rest, rest_end = last, uintp(indptr[i + one])
        w = rows[i, 0]
        nearest_weight = 0.0
        nearest_value = 0.0
        s = relaxation * rows[i, 3]
        for k in range(rest, rest_end):
            w += data[k] * z[uintp(indices[k])]
        if last > first:
            if backward:
                nearest = first
                first += one
            else:
                last -= one
                nearest = last
            for k in range(first, last):
                w += data[k] * z[uintp(indices[k])]
            j = uintp(indices[nearest])
            nearest_weight = data[nearest] * s
            nearest_value = near if j + one == i or i + one == j else z[j]
        zi = z[i]
        value = _clamp((zi - w * s) - nearest_weight * nearest_value, rows[i, 1], rows[i, 2])
        z[i] = value
        near = value
        change = abs(value - zi)
        total += change
        if change > largest or change != change:
            largest = change
    return largest, total


@compiled
def modulus_sweep(  # type: ignore[no-untyped-def]
    indptr, split, indices, data, rows, relaxation, acceleration, backward, x, new, z
):
    """Write the next modulus vector into `new` and z = lower + max(x, 0) of the incoming x into `z`.

    `rows` holds q, lower, inverse_scale, omega, inverse_pivot. With w = M max(x, 0) + q and
    c_i = Σ m_ij (new_j − x_j) over the columns j already updated:

        new_i = x_i − (2 α (w_i − Ω_i max(−x_i, 0)) + β c_i) inverse_pivot_i

    Returns max_i |min(z_i − lower_i, w_i inverse_scale_i)| and Σ_i min(z_i − lower_i, w_i)².
    """
    n = uintp(rows.shape[0])
    one = uintp(1)
    largest = 0.0
    squares = 0.0
    i = n if backward else uintp(0) - one
    for _ in range(n):
        if backward:
            i -= one
            first, last = uintp(split[i]), uintp(indptr[i + one])
            rest, rest_end = uintp(indptr[i]), first
        else:
            i += one
            first, last = uintp(indptr[i]), uintp(split[i])
            rest, rest_end = last, uintp(indptr[i + one])
        w = rows[i, 0]
        c = 0.0
        for k in range(first, last):
            j = uintp(indices[k])
            old = x[j]
            w += data[k] * (0.0 if old < 0.0 else old)
            c += data[k] * (new[j] - old)
        for k in range(rest, rest_end):
            old = x[uintp(indices[k])]
            w += data[k] * (0.0 if old < 0.0 else old)
        xi = x[i]
        positive = 0.0 if xi < 0.0 else xi
        slack = w * rows[i, 2]
        r = abs(slack if slack < positive else positive)
        if r > largest or r != r or slack != slack:
            largest = r if slack == slack else slack
        r = w if w < positive else positive
        squares += r * r
        z[i] = rows[i, 1] + positive
        new[i] = xi - (2.0 * relaxation * (w - rows[i, 3] * (positive - xi)) + acceleration * c) * rows[i, 4]
    return largest, squares


@compiled
def is_mirrored(indptr, indices, data, tolerance):  # type: ignore[no-untyped-def]
    """Return whether a CSR array is its transpose up to a relative tolerance in each entry; rows sorted. One pass.

    Row by row, the entries right of the diagonal meet the entries below it in the order in which those are stored.
    """
    one = uintp(1)
    place = indptr[:-1].copy()
    for i in range(uintp(indptr.size - 1)):
        k = uintp(place[i])
        end = uintp(indptr[i + one])
        if k < end and uintp(indices[k]) < i:
            return False  # an entry left of the diagonal that no row above has met
        for m in range(k, end):
            j = uintp(indices[m])
            if j == i:
                continue
            p = uintp(place[j])
            if p >= uintp(indptr[j + one]) or uintp(indices[p]) != i:
                return False
            if not abs(data[m] - data[p]) <= tolerance * max(abs(data[m]), abs(data[p])):
                return False
            place[j] = p + one
    return True


def row_splits(matrix: Any, *, backward: bool) -> Any:
    """Return the read-only split pointers of a CSR array for sweeps in that direction, shape (n,)."""
    split = np.empty(matrix.shape[0], dtype=matrix.indptr.dtype)
    split_rows(matrix.indptr, matrix.indices, backward, split)
    split.flags.writeable = False
    return split


def packed(*columns: Any) -> Any:
    """Return the vectors, each of shape (n,), side by side in an array of shape (n, number of vectors)."""
    rows = np.empty((columns[0].size, len(columns)))
    # One signature for all: views that are contiguous and read-only.
    views = tuple(np.ascontiguousarray(column).view() for column in columns)
    for view in views:
        view.flags.writeable = False
    pack_rows(views, rows)
    return rows


def _fused_code(typing_context, a, b, c):  # type: ignore[no-untyped-def]
    """Return how a b + c, rounded once, is compiled: one instruction, or a function of the C library."""

    def code(context, builder, signature, arguments):  # type: ignore[no-untyped-def]
        return builder.fma(*arguments)

    return float64(float64, float64, float64), code


_fused: Any = intrinsic(_fused_code)


@njit(inline="always")
def _split_sum(a, b):  # type: ignore[no-untyped-def]
    """(s, e) with s = fl(a + b) and s + e = a + b, exactly."""
    s = a + b
    t = s - a
    return s, (a - (s - t)) + (b - t)


@njit(inline="always")
def _outward(value, error):  # type: ignore[no-untyped-def]
    """Return `error` and what the rounding of value ± error and of `error` itself may add to it; 0 for 0."""
    is_tiny = (abs(value) < MAY_UNDERFLOW) & (error > 0.0)
    return error + (abs(value) + error) * (2.0**-51 if error > 0.0 else 0.0) + (LEAST if is_tiny else 0.0)


@njit(inline="always")
def _difference(a, b):  # type: ignore[no-untyped-def]
    """Return fl(a − b) and a bound of its error, 0 where it is exact or b infinite."""
    value, error = _split_sum(a, -b)
    return value, _outward(value, abs(error)) if abs(value) < np.inf else 0.0


@njit(inline="always")
def _quotient(a, b, error):  # type: ignore[no-untyped-def]
    """Return fl(a / b), b > 0, and a bound of its distance from the quotient by b of any number in a ± error."""
    value = a / b
    is_exact = (error == 0.0) & ((a == 0.0) | ((_fused(value, b, -a) == 0.0) & (abs(a) > MAY_UNDERFLOW)))
    least = LEAST if (abs(value) < MAY_UNDERFLOW) & (not is_exact) else 0.0
    return value, _outward(value, 0.0 if is_exact else error / b + abs(value) * 2.0**-53 + least)


@njit
def _underflow(indices, data, x, first, end, shift):  # type: ignore[no-untyped-def]
    """Return a bound of what underflow takes from the products of a row and from their rounding errors."""
    lost = 0.0
    for k in range(first, end):
        a, b = data[k], x[uintp(indices[k - shift])]
        h = a * b
        if abs(h) < MAY_UNDERFLOW and a != 0.0 and b != 0.0:
            small, other = (a, b) if abs(a) < abs(b) else (b, a)
            small *= 2.0**960  # exactly, and large enough to show an error
            scaled = small * other
            is_exact = scaled == h * 2.0**960 and abs(scaled) > MAY_UNDERFLOW and _fused(small, other, -scaled) == 0.0
            lost += 0.0 if is_exact else 4.0 * LEAST
    return lost


def _summing_rows(comparison: bool) -> Any:
    """Return the kernel that sums the rows of M x + q, or of ⟨M⟩x + q, as high + low ± radius."""

    @compiled
    def row_sums(indptr, indices, data, x, q, high, low, radius):  # type: ignore[no-untyped-def]
        """Sum the rounded terms, beside them their rounding errors, beside them what that second sum loses."""
        one = uintp(1)
        for i in range(uintp(high.size)):
            first, end = uintp(indptr[i]), uintp(indptr[i + one])
            total, errors, lost, is_small = q[i], 0.0, 0.0, False
            for k in range(first, end):
                j = uintp(indices[k])
                a, b = data[k], x[j]
                if comparison:
                    a = abs(a) if i == j else -abs(a)
                h = a * b
                is_small |= (abs(h) < MAY_UNDERFLOW) & (b != 0.0)
                total, f = _split_sum(total, h)
                s, t = _split_sum(_fused(a, b, -h), f)
                errors, u = _split_sum(errors, s)
                lost += abs(t) + abs(u)
            high[i], low[i] = _split_sum(total, errors)
            # `lost` was itself rounded at most 2k times.
            radius[i] = lost * (1.0 + (4.0 * (end - first) + 8.0) * 2.0**-52)
            if not (abs(high[i]) < np.inf and abs(errors) < np.inf and lost < np.inf):
                low[i], radius[i] = 0.0, np.inf
            elif is_small:
                radius[i] += _underflow(indices, data, x, first, end, uintp(0))

    return row_sums


row_sums = _summing_rows(False)
comparison_row_sums = _summing_rows(True)
ROWS_AT_ONCE = 1024


@compiled
def residual_ends(  # type: ignore[no-untyped-def]
    indptr, indices, data, stride, x, q, z, lower, upper, scale, smallest, largest
):
    """Write bounds of every |r_i|, r_i = mid(z_i − upper_i, z_i − lower_i, w_i / scale_i), w = M x + q.

    The rounded terms of w are summed, and beside them their rounding errors; what that second sum of 2k terms loses
    is at most γ₂ₖ times their magnitudes. Where a row is not finite the bounds are 0 and ∞. The columns of a dense M
    come once, for all rows, with a stride of a row's length; a sparse M has the stride 0. Rows are taken in blocks,
    so that the second loop, which has no branches, runs on several at a time.
    """
    one, rows = uintp(1), uintp(z.size)
    slack, slip = np.empty(ROWS_AT_ONCE), np.empty(ROWS_AT_ONCE)
    for begin in range(uintp(0), rows, uintp(ROWS_AT_ONCE)):
        here = min(uintp(ROWS_AT_ONCE), rows - begin)
        for m in range(here):
            i = begin + m
            first, end = uintp(indptr[i]), uintp(indptr[i + one])
            shift = i * uintp(stride)
            total, errors, size, is_small = q[i], 0.0, 0.0, False
            for k in range(first, end):
                a, b = data[k], x[uintp(indices[k - shift])]
                h = a * b
                is_small |= (abs(h) < MAY_UNDERFLOW) & (b != 0.0)
                e = _fused(a, b, -h)
                total, f = _split_sum(total, h)
                errors += e + f
                size += abs(e) + abs(f)
            slack[m], low = _split_sum(total, errors)
            slip[m] = abs(low) + size * (4.0 * (end - first) + 8.0) * 2.0**-53
            if is_small:
                slip[m] += _underflow(indices, data, x, first, end, shift)
        for m in range(here):
            i = begin + m
            step, slip_step = _quotient(slack[m], scale[i], slip[m])
            below, slip_below = _difference(z[i], upper[i])
            above, slip_above = _difference(z[i], lower[i])
            bottom = _clamp(step - slip_step, below - slip_below, above - slip_above)
            top = _clamp(step + slip_step, below + slip_below, above + slip_above)
            is_finite = (abs(slack[m]) < np.inf) & (slip[m] < np.inf) & (abs(z[i]) < np.inf)
            least = bottom if bottom > -top else -top
            most = top if top > -bottom else -bottom
            smallest[i] = least if is_finite & (least > 0.0) else 0.0
            largest[i] = most if is_finite else np.inf
