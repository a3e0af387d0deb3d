"""Many marches with one tridiagonal M, side by side: the inner loops go over the marches, several at a time.

As in :mod:`~lcp_plugin.methods.banded.kernels`, with M's off-diagonal entries ≤ 0, but a round starts from the
sides that the last one found: from one step of a march to the next few rows change.

One problem alone, bounded on one side, z ≥ value, is answered without rounds. The theory is Chandrasekaran's, the order
of the rows Cryer's. With all rows at their bounds, free a row whose w is negative, then the next: z only rises, so that
no free row returns to its bound. Take the rows from first to last, with all later ones at their bounds. A row that
becomes free raises its neighbours on both sides: it joins the free rows before it, and if that makes w negative at the
bound where these begin, that row becomes free too, and joins what is free before it. A block of free rows depends on
the rest by the two values beside it alone, and the z of its two ends are linear in those; two blocks and the row
between them join by one division. Each row is joined once: O(n).
"""

from __future__ import annotations

import numpy as np

from ...core.kernels.compilation import compiled_into_others, compiled_part, interpreted_while_small
from ...core.kernels.enclosures import MAY_UNDERFLOW, of_terms, row_ends, split_sum, with_term
from ...core.kernels.floats import TINY, UNIT

ROUNDS = 10  # beyond, the contacts of a march are rather found directly
UNDERFLOW = 4.0 * TINY / UNIT  # stands among the magnitudes of a sum for what it takes from a product and its error
NEGLIGIBLE_PIVOT = 1e-14  # of the diagonal entry: below, the block is singular to double precision
EMPTY = (0.0, 0.0, 1.0, 0.0, 1.0, 0.0)  # the row right of no row is the first one, the row left of it the last


@compiled_part
def _sum_rows(indptr, indices, data, x, total, errors, size):  # type: ignore[no-untyped-def]
    """Fill the sums of M x as `with_term` makes them; what underflow takes is among their magnitudes."""
    n, marches = x.shape
    for i in range(n):
        for m in range(marches):
            total[i, m] = errors[i, m] = size[i, m] = 0.0
        for k in range(indptr[i], indptr[i + 1]):
            a, column = data[k], x[indices[k]]
            for m in range(marches):
                h = a * column[m]
                size[i, m] += UNDERFLOW if (abs(h) < MAY_UNDERFLOW) & (column[m] != 0.0) else 0.0
                total[i, m], errors[i, m], size[i, m] = with_term(
                    total[i, m], errors[i, m], size[i, m], h, a, column[m]
                )


@compiled_part
def _residual_ends(indptr, total, errors, size, q, x, lower, upper, scale, least, most):  # type: ignore[no-untyped-def]
    """Fill a lower and an upper bound of each ‖r(x)‖∞ from the sums of M x."""
    n, marches = x.shape
    for m in range(marches):
        least[m] = most[m] = 0.0
    for i in range(n):
        terms, unit = indptr[i + 1] - indptr[i] + 1, scale[i]
        for m in range(marches):
            s, f = split_sum(total[i, m], q[i, m])
            w, slip = of_terms(s, errors[i, m] + f, size[i, m] + abs(f), terms)
            low, high = row_ends(w, slip, unit, x[i, m], lower[i, m], upper[i, m])
            least[m], most[m] = max(least[m], low), max(most[m], high)


@compiled_part
def _substitute(bands, q, lower, upper, state, is_active, x, slope, room):  # type: ignore[no-untyped-def]
    """Fill x, where a march is active, with the bounds that state says and the solution of w = 0 elsewhere."""
    n, marches = x.shape
    here, factor = room[0], room[1]
    for m in range(marches):
        here[m] = factor[m] = 0.0
    for i in range(n):
        a, d, c = -bands[0, i], bands[1, i], -bands[2, i]
        for m in range(marches):
            pivot = d - a * factor[m]
            value = lower[i, m] if state[i, m] < 0.0 else upper[i, m]
            is_free = state[i, m] == 0.0
            here[m] = (a * here[m] - q[i, m]) / pivot if is_free else value
            factor[m] = c / pivot if is_free else 0.0
            x[i, m] = here[m] if is_active[m] > 0.0 else x[i, m]
            slope[i, m] = factor[m] if is_active[m] > 0.0 else 0.0
    for i in range(n - 2, -1, -1):
        for m in range(marches):
            x[i, m] += slope[i, m] * x[i + 1, m]


@compiled_part
def _take_sides(bands, q, lower, upper, inverse_scale, x, state, wrong):  # type: ignore[no-untyped-def]
    """Fill state with the bounds that x − w/d reaches (−1, 0, 1), and wrong with the number of rows that change."""
    n, marches = x.shape
    for m in range(marches):
        wrong[m] = 0.0
    for i in range(n):
        a, d, c, unit = bands[0, i], bands[1, i], bands[2, i], inverse_scale[i]
        before, here, after = x[max(i - 1, 0)], x[i], x[min(i + 1, n - 1)]
        for m in range(marches):
            step = (a * before[m] + d * here[m] + c * after[m] + q[i, m]) * unit
            above, beyond = here[m] - lower[i, m], here[m] - upper[i, m]
            side = 1.0 if beyond >= step else 0.0
            side = -1.0 if (above <= step) | (lower[i, m] == upper[i, m]) else side
            wrong[m] += 0.0 if side == state[i, m] else 1.0
            state[i, m] = side


@compiled_part
def _next_offset(carry_indptr, carry_indices, carry_data, forcing, z, q, total):  # type: ignore[no-untyped-def]
    """Fill q = forcing + C z."""
    n, marches = z.shape
    for i in range(n):
        for m in range(marches):
            total[m] = 0.0
        for k in range(carry_indptr[i], carry_indptr[i + 1]):
            c, column = carry_data[k], z[carry_indices[k]]
            for m in range(marches):
                total[m] += c * column[m]
        for m in range(marches):
            q[i, m] = (forcing[i, 0] if forcing.shape[1] == 1 else forcing[i, m]) + total[m]


@interpreted_while_small
def march_all(  # type: ignore[no-untyped-def]
    bands, scale, indptr, indices, data, carry_indptr, carry_indices, carry_data, forcing, lower, upper, nearest,
    tolerance, most_rounds, z, Z, rounds, ends
):
    """March all along together; return how many steps converged for each of them.

    Parameters
    ----------
    bands, scale, indptr, indices, data
        M: its three diagonals, its residual scale, and its entries by rows.
    carry_indptr, carry_indices, carry_data
        C by rows: C z of each step is added to the q of the next.
    forcing : array, shape (k, n, m), or (k, n, 1) for all marches
    lower, upper, nearest : arrays, shape (n, m)
        Bounds, and the point between them that is nearest to 0.
    z : array, shape (n, m)
        The states before the first step, to be overwritten.
    Z : array, shape (m, k, n)
        Answers, to be filled.
    rounds : array of int, shape (m, k)
        How many there were.
    ends : array, shape (m, k, 2)
        An upper bound of ‖r(z)‖∞ and a lower one of ‖r(z°)‖∞.
    """
    n, marches = z.shape
    q, slope, state, inverse_scale = np.empty((n, marches)), np.empty((n, marches)), np.empty((n, marches)), 1.0 / scale
    of_nearest, of_z = np.empty((3, n, marches)), np.empty((3, n, marches))
    least, most, low, room = np.empty(marches), np.empty(marches), np.empty(marches), np.empty((2, marches))
    wrong, is_active = np.empty(marches), np.empty(marches)
    _sum_rows(indptr, indices, data, nearest, of_nearest[0], of_nearest[1], of_nearest[2])
    for k in range(forcing.shape[0]):
        _next_offset(carry_indptr, carry_indices, carry_data, forcing[k], z, q, room[0])
        _residual_ends(
            indptr, of_nearest[0], of_nearest[1], of_nearest[2], q, nearest, lower, upper, scale, least, most
        )
        if k == 0:
            _take_sides(bands, q, lower, upper, inverse_scale, z, state, wrong)
        left = float(marches)
        for m in range(marches):
            is_active[m], rounds[m, k] = 1.0, 0
        for _round in range(min(ROUNDS, most_rounds)):
            _substitute(bands, q, lower, upper, state, is_active, z, slope, room)
            _take_sides(bands, q, lower, upper, inverse_scale, z, state, wrong)
            left = 0.0
            for m in range(marches):
                rounds[m, k] += 1 if is_active[m] > 0.0 else 0
                is_active[m] = 0.0 if wrong[m] == 0.0 else is_active[m]
                left += is_active[m]
            if left == 0.0:
                break
        for i in range(n):
            for m in range(marches):
                z[i, m] = min(max(z[i, m], lower[i, m]), upper[i, m])
        _sum_rows(indptr, indices, data, z, of_z[0], of_z[1], of_z[2])
        _residual_ends(indptr, of_z[0], of_z[1], of_z[2], q, z, lower, upper, scale, low, most)
        for m in range(marches):
            ends[m, k, 0], ends[m, k, 1] = most[m], least[m]
            if not (least[m] > 0.0 and most[m] / least[m] < tolerance):
                return k
            for i in range(n):
                Z[m, k, i] = z[i, m]
    return forcing.shape[0]


@compiled_into_others
def _join(before, after, a, d, c, q):  # type: ignore[no-untyped-def]
    """Return the block that two blocks and the free row between them make, and the pivot of that row.

    A block is the z of its first and of its last row, each as constant, factor of the z left, and of the z right of it.
    """
    pivot = d - a * before[5] - c * after[1]
    own, left, right = (a * before[3] + c * after[0] - q) / pivot, a * before[4] / pivot, c * after[2] / pivot
    first = before[0] + before[2] * own, before[1] + before[2] * left, before[2] * right
    last = after[3] + after[4] * own, after[4] * left, after[5] + after[4] * right
    return (first[0], first[1], first[2], last[0], last[1], last[2]), pivot


@compiled_part
def find_contacts(bands, q, sign, value, is_held, is_free, stops, slack, blocks):  # type: ignore[no-untyped-def]
    """Fill is_free with the rows that are not at their bound in the least z ≥ value with w ≥ 0, complementary.

    Parameters
    ----------
    bands : array, shape (3, n)
        m_{i,i−1}, m_ii and m_{i,i+1}; 0 outside of M.
    q : array, shape (n,)
    sign : float
        1, or −1: the problem is the one of −z, with −q.
    value : array, shape (n,)
        The bound of each row, −∞ for none.
    is_held : array of bool, shape (n,)
        The rows that stay at their value whatever their w is.
    is_free : array of bool, shape (n,)
    stops, slack, blocks : arrays, shapes (n + 1,) of int64, (n + 1,) and (n + 1, 6)
        Room: the rows at their bounds so far, their w, and the free rows before each.

    Returns
    -------
    bool
        False where a pivot is not positive, or negligible: M is no M-matrix, or singular.
    """
    n = is_free.size
    top, left, block = 0, 0.0, EMPTY  # rows at their bounds, the z of the last one, and the free rows behind it
    for i in range(n):
        a, d, c = -bands[0, i], bands[1, i], -bands[2, i]
        here, after = value[i], value[i + 1] if i + 1 < n else 0.0
        # w without the part of the next row
        w = d * here - a * (block[3] + block[4] * left + block[5] * here) + sign * q[i]
        is_free[i] = (not is_held[i]) and (here == -np.inf or w < c * after)
        if not is_free[i]:
            top += 1
            stops[top], slack[top], left = i, w, here
            blocks[top, 0], blocks[top, 1], blocks[top, 2] = block[0], block[1], block[2]
            blocks[top, 3], blocks[top, 4], blocks[top, 5] = block[3], block[4], block[5]
            block = EMPTY
            continue
        block, pivot = _join(block, EMPTY, a, d, c, sign * q[i])
        if not pivot > NEGLIGIBLE_PIVOT * d:
            return False
        while top > 0 and after > -np.inf:  # a row without bound becomes free next, and then they are looked at
            k = stops[top]
            a, d, c = -bands[0, k], bands[1, k], -bands[2, k]
            if is_held[k] or not slack[top] < c * (block[0] + block[1] * left + block[2] * after):
                break
            is_free[k] = True
            kept = blocks[top]
            block, pivot = _join((kept[0], kept[1], kept[2], kept[3], kept[4], kept[5]), block, a, d, c, sign * q[k])
            if not pivot > NEGLIGIBLE_PIVOT * d:
                return False
            top -= 1
            left = value[stops[top]] if top > 0 else 0.0
    return True


@compiled_part
def substitute(bands, q, value, state, z, slope):  # type: ignore[no-untyped-def]
    """Fill z with value where state is not 0 and the solution of w = 0 elsewhere; no pivot is looked for.

    On M-matrices that is backward stable in every entry (Higham, *Accuracy and stability*, SIAM 2002, theorem 9.12).
    """
    n = z.size
    here = factor = 0.0
    for i in range(n):
        if state[i] != 0:
            here, factor = value[i], 0.0
        else:
            a = -bands[0, i]
            pivot = bands[1, i] - a * factor
            here, factor = (a * here - q[i]) / pivot, -bands[2, i] / pivot
        z[i], slope[i] = here, factor
    for i in range(n - 2, -1, -1):
        z[i] += slope[i] * z[i + 1]
