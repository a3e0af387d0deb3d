"""Many marches with tridiagonal M, side by side: the inner loops go over the marches, several at a time.

One M serves all of them, and what is made of it is a number a row; or each has its own on one pattern, and then it is
a row of numbers, one a march. The kernel is compiled for either from the same lines: `of_march` reads both.

As in :mod:`~lcp_plugin.methods.banded.kernels`, with M's off-diagonal entries ≤ 0, but a round starts from a guess:
Brennan and Schwartz's sweep with a factor of the whole M, right where the rows at bounds come first, as in a
put (*The valuation of American put options*, J. Finance 32 (1977), doi:10.2307/2326779). Where a march has found that
wrong, from the sides that its last step found: from one step to the next few rows change.

One problem alone, bounded on one side, z ≥ value, is answered without rounds. The theory is Chandrasekaran's, the order
of the rows Cryer's. With all rows at their bounds, free a row whose w is negative, then the next: z only rises, so that
no free row returns to its bound. Take the rows from first to last, with all later ones at their bounds. A row that
becomes free raises its neighbours on both sides: it joins the free rows before it, and if that makes w negative at the
bound where these begin, that row becomes free too, and joins what is free before it. A block of free rows depends on
the rest by the two values beside it alone, and the z of its two ends are linear in those; two blocks and the row
between them join by one division. Each row is joined once: O(n).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ...core.kernels.compilation import helper, inlined, kernel
from ...core.kernels.compiler import overload, types
from ...core.kernels.enclosures import (
    MAY_UNDERFLOW,
    fused,
    of_terms,
    row_ends,
    split_sum,
    with_term,
)
from ...core.kernels.floats import TINY, UNIT
from ...core.kernels.rows import residual_of_row

MARCHES = 16  # in one compiled loop: LLVM takes four registers of four numbers at a time
ROUNDS = 10  # beyond, the contacts of a march are rather found directly
UNDERFLOW = (
    4.0 * TINY / UNIT
)  # stands among the magnitudes of a sum for what it takes from a product and its error
SURELY = (
    1.0 - 2.0**-40
)  # so that the certificate, whose bounds are sharper but rounded as well, agrees
ORDINARY = 2.0**1000  # a scale below it has a reciprocal that is rounded once
LOST = UNIT * (1.0 + 2.0**-50)  # covers the roundings of the sum that it multiplies
WIDER = 1.0 + 2.0**-50  # covers seven roundings
NEGLIGIBLE_PIVOT = 1e-14  # of the diagonal entry: below, the block is singular to double precision
EMPTY = (
    0.0,
    0.0,
    1.0,
    0.0,
    1.0,
    0.0,
)  # the row right of no row is the first one, the row left of it the last


def of_march(value: Any, m: int) -> Any:
    """Return the value of march m: an entry of an array, or the number that is that of all."""
    return value[m] if np.ndim(value) else value


@overload(of_march, inline="always")
def _of_march(value, m):  # type: ignore[no-untyped-def]
    return (
        (lambda value, m: value[m]) if isinstance(value, types.Array) else (lambda value, m: value)
    )


@helper
def _row_sum(indptr, indices, data, i, x, m):  # type: ignore[no-untyped-def]
    """Return the sum of row i of M x of march m, as `with_term` makes it; what underflow takes is in its last part."""
    total = errors = size = 0.0
    for k in range(indptr[i], indptr[i + 1]):
        a, b = of_march(data[k], m), x[indices[k], m]
        h = a * b
        size += UNDERFLOW if (abs(h) < MAY_UNDERFLOW) & (b != 0.0) else 0.0
        total, errors, size = with_term(total, errors, size, h, a, b)
    return total, errors, size


@helper
def _largest_reference(indptr, indices, data, nearest, q, lower, upper, scale, rows, least):  # type: ignore[no-untyped-def]
    """Fill a lower bound of each ‖r(z°)‖∞: that of |r_i(z°)| in the row i in which it is largest but for rounding."""
    for m in range(rows.size):
        i = int(rows[m])
        total, errors, size = _row_sum(indptr, indices, data, i, nearest, m)
        s, f = split_sum(total, q[i, m])
        w, slip = of_terms(s, errors + f, size + abs(f), indptr[i + 1] - indptr[i] + 1)
        least[m], _ = row_ends(
            w, slip, of_march(scale[i], m), nearest[i, m], lower[i, m], upper[i, m]
        )


@helper
def _factor(below, centre, above, ratios, inverse_pivots):  # type: ignore[no-untyped-def]
    """Fill the factor of each M from its last row to its first; shapes (n, number of matrices)."""
    n, matrices = centre.shape
    for m in range(matrices):
        pivot = 1.0
        for i in range(n - 1, -1, -1):
            ratios[i, m] = -above[i, m] / pivot
            pivot = (
                centre[i, m] + ratios[i, m] * below[min(i + 1, n - 1), m]
            )  # the last row has no entry on its right
            inverse_pivots[i, m] = 1.0 / pivot


@helper
def _multiply(below, centre, above, x, y):  # type: ignore[no-untyped-def]
    """Fill y with M x."""
    n, marches = x.shape
    for i in range(n):
        a, d, c, before, after = below[i], centre[i], above[i], max(i - 1, 0), min(i + 1, n - 1)
        for m in range(marches):
            y[i, m] = (
                of_march(a, m) * x[before, m]
                + of_march(d, m) * x[i, m]
                + of_march(c, m) * x[after, m]
            )


@helper
def _next_offset(  # type: ignore[no-untyped-def]
    propagator_indptr, propagator_indices, propagator_data, forcing, z, ratios, q, y, total
):
    """Fill q = forcing + C z, and y with what is right of the rows that are eliminated from the last to the first."""
    n, marches = z.shape
    is_common = forcing.shape[1] == 1
    for i in range(n - 1, -1, -1):
        for m in range(marches):
            total[m] = 0.0
        for k in range(propagator_indptr[i], propagator_indptr[i + 1]):
            c, j = propagator_data[k], propagator_indices[k]
            for m in range(marches):
                total[m] += of_march(c, m) * z[j, m]
        if is_common:
            for m in range(marches):
                q[i, m] = forcing[i, 0] + total[m]
        else:
            for m in range(marches):
                q[i, m] = forcing[i, m] + total[m]
        ratio, after = ratios[i], min(i + 1, n - 1)
        for m in range(marches):
            y[i, m] = of_march(ratio, m) * y[after, m] - q[i, m]


@helper
def _find_references(of_nearest, q, nearest, lower, upper, inverse_scale, largest, rows):  # type: ignore[no-untyped-def]
    """Fill rows with the one in which |r(z°)| is largest but for rounding."""
    n, marches = q.shape
    for m in range(marches):
        largest[m] = rows[m] = 0.0
    for i in range(n):
        unit, row = inverse_scale[i], float(i)
        for m in range(marches):
            x = nearest[i, m]
            r = abs(
                residual_of_row(
                    (of_nearest[i, m] + q[i, m]) * of_march(unit, m), x, lower[i, m], upper[i, m]
                )
            )
            rows[m] = row if r > largest[m] else rows[m]
            largest[m] = r if r > largest[m] else largest[m]


@helper
def _eliminate(  # type: ignore[no-untyped-def]
    below,
    centre,
    above,
    inverse_pivots,
    y,
    q,
    lower,
    upper,
    trust,
    state,
    x,
    slope,
    guess,
    here,
    factor,
):
    """Fill x with the bounds that state says and, elsewhere, with what the rows from the first on make of w = 0.

    Fill state before, of marches with trust > 0, with the bounds that hold where the rows at bounds come first.
    """
    n, marches = x.shape
    for m in range(marches):
        guess[m] = here[m] = factor[m] = 0.0
    for i in range(n):
        a, d, c, inverse = below[i], centre[i], above[i], inverse_pivots[i]
        for m in range(marches):
            value, low, high = (
                (y[i, m] - of_march(a, m) * guess[m]) * of_march(inverse, m),
                lower[i, m],
                upper[i, m],
            )
            guess[m] = min(max(value, low), high)
            side = 1.0 if value >= high else 0.0
            side = -1.0 if value <= low else side
            state[i, m] = side if trust[m] > 0.0 else state[i, m]
        for m in range(marches):
            low, high, side = lower[i, m], upper[i, m], state[i, m]
            pivot = of_march(d, m) + of_march(a, m) * factor[m]
            value, share = (-of_march(a, m) * here[m] - q[i, m]) / pivot, -of_march(c, m) / pivot
            held = low if side < 0.0 else high
            x[i, m] = here[m] = value if side == 0.0 else held
            slope[i, m] = factor[m] = share if side == 0.0 else 0.0


@helper
def _substitute_and_measure(  # type: ignore[no-untyped-def]
    below,
    centre,
    above,
    q,
    lower,
    upper,
    inverse_scale,
    largest_unit,
    slope,
    x,
    z,
    state,
    here,
    sizes,
    wrong,
    most,
):
    """Fill x with the solution, z with x taken into bounds, and measure: each row once its neighbours are known.

    Fill state with the bounds that x − w/d reaches (−1, 0, 1), wrong with the number of rows in which that changes, and
    most with an upper bound of each ‖r(z)‖∞. w is three multiply–adds, each rounded once: wrong by at most u times the
    sum of their magnitudes, and what underflow takes (a running error bound: Higham, *Accuracy and stability*, SIAM
    2002, section 3.3). Of a z within its bounds |r| is at most |w|/d, and 0 where w pushes z to a bound that it has
    reached.
    """
    n, marches = x.shape
    for m in range(marches):
        here[m] = wrong[m] = most[m] = sizes[m] = 0.0
    for i in range(n - 1, -2, -1):
        if i >= 0:
            for m in range(marches):
                value = x[i, m] + slope[i, m] * here[m]
                x[i, m] = here[m] = value
                z[i, m] = min(max(value, lower[i, m]), upper[i, m])
        if i == n - 1:
            continue
        row, before, after = i + 1, max(i, 0), min(i + 2, n - 1)
        a, d, c, inverse = below[row], centre[row], above[row], inverse_scale[row]
        for m in range(marches):
            own, low, high = z[row, m], lower[row, m], upper[row, m]
            first = fused(of_march(d, m), own, q[row, m])
            second = fused(of_march(c, m), z[after, m], first)
            w = fused(of_march(a, m), z[before, m], second)
            size = abs(first) + abs(second) + abs(w)
            sizes[m] += size
            down, up = w if own > low else 0.0, -w if own < high else 0.0
            residual = fused(size, LOST, down if down > up else up) * (of_march(inverse, m) * WIDER)
            most[m] = residual if residual > most[m] else most[m]
            step, over, beyond = w * of_march(inverse, m), x[row, m] - low, x[row, m] - high
            side = 1.0 if beyond >= step else 0.0
            side = -1.0 if (over <= step) | (low == high) else side
            wrong[m] += 0.0 if side == state[row, m] else 1.0
            state[row, m] = side
    for m in range(marches):
        whole = (most[m] + (8.0 * TINY * largest_unit + 2.0 * TINY)) * WIDER
        most[m] = (
            whole if sizes[m] < np.inf else np.inf
        )  # a number that is none is the largest of nothing


@helper
def _are_small(most, least, tolerance, ends):  # type: ignore[no-untyped-def]
    """Fill the ends of a step; return whether all its residuals are within the tolerance."""
    are_small = True
    for m in range(most.size):
        ends[m, 0], ends[m, 1] = most[m], least[m]
        are_small &= least[m] > 0.0 and most[m] / least[m] < tolerance * SURELY
    return are_small


@kernel
def march_all(  # type: ignore[no-untyped-def]
    below,
    centre,
    above,
    scale,
    indptr,
    indices,
    data,
    propagator_indptr,
    propagator_indices,
    propagator_data,
    forcing,
    lower,
    upper,
    nearest,
    tolerance,
    most_rounds,
    kept,
    states,
    Z,
    rounds,
    ends,
):
    """March all along together; return how many steps converged for each of them.

    Parameters
    ----------
    below, centre, above, scale, indptr, indices, data
        M: its three diagonals, its residual scale, and its entries by rows. Where each march has its own on the one
        pattern, arrays of values have a last axis of length MARCHES for it.
    propagator_indptr, propagator_indices, propagator_data
        C by rows: C z of each step is added to the q of the next. Its values may have that axis, too.
    forcing : array, shape (k, n, MARCHES), or (k, n, 1) for all marches, k = 1 for all steps
    lower, upper, nearest : arrays, shape (n, MARCHES)
        Bounds, and the point between them that is nearest to 0.
    kept : array of int, shape (k,)
        Where the answer of each step goes, −1 for nowhere.
    states : array, shape (3, n, MARCHES)
        The first of them before the first step; that after step k comes to states[(k + 1) % 3].
    Z : array, shape (m, kept steps, n)
        Answers, to be filled.
    rounds : array of int, shape (k, MARCHES)
        How many there were.
    ends : array, shape (k, MARCHES, 2)
        An upper bound of ‖r(z)‖∞ and a lower one of ‖r(z°)‖∞.
    """
    n, marches = nearest.shape
    q, y, slope, x = (
        np.empty((n, marches)),
        np.zeros((n, marches)),
        np.empty((n, marches)),
        np.empty((n, marches)),
    )
    state, of_nearest, workspace = (
        np.zeros((n, marches)),
        np.empty((n, marches)),
        np.empty((3, marches)),
    )
    rows, no_trust = np.zeros(marches), np.zeros(marches)
    least, most, wrong, inverse_scale = (
        np.empty(marches),
        np.empty(marches),
        np.empty(marches),
        1.0 / scale,
    )
    trust, largest_unit = np.ones(marches), inverse_scale.max() * WIDER
    if not 1.0 / ORDINARY < scale.min() <= scale.max() < ORDINARY:
        return 0
    by_row = n, centre.size // n
    factor, inverse_pivot = np.empty(by_row), np.empty(by_row)
    _factor(
        below.reshape(by_row), centre.reshape(by_row), above.reshape(by_row), factor, inverse_pivot
    )
    ratios, inverse_pivots = factor.reshape(centre.shape), inverse_pivot.reshape(centre.shape)
    _multiply(below, centre, above, nearest, of_nearest)
    for k in range(kept.size):
        z, answer = states[k % 3], states[(k + 1) % 3]
        _next_offset(
            propagator_indptr,
            propagator_indices,
            propagator_data,
            forcing[min(k, forcing.shape[0] - 1)],
            z,
            ratios,
            q,
            y,
            workspace[0],
        )
        for m in range(marches):
            wrong[m], rounds[k, m] = 1.0, 0
        for round_ in range(min(ROUNDS, most_rounds)):
            for m in range(marches):
                rounds[k, m] += 1 if wrong[m] > 0.0 else 0
            _eliminate(
                below,
                centre,
                above,
                inverse_pivots,
                y,
                q,
                lower,
                upper,
                no_trust if round_ else trust,
                state,
                x,
                slope,
                workspace[0],
                workspace[1],
                workspace[2],
            )
            _substitute_and_measure(
                below,
                centre,
                above,
                q,
                lower,
                upper,
                inverse_scale,
                largest_unit,
                slope,
                x,
                answer,
                state,
                workspace[0],
                workspace[1],
                wrong,
                most,
            )
            if not wrong.any():
                break
        for m in range(marches):
            trust[m] = 0.0 if rounds[k, m] > 1 else trust[m]
        # Any row bounds ‖r(z°)‖∞ from below: another one is looked for where that of a step before is not enough.
        of_rows = indptr, indices, data, nearest, q, lower, upper, scale, rows, least
        _largest_reference(*of_rows)
        is_within = _are_small(most, least, tolerance, ends[k])
        if not is_within:
            _find_references(
                of_nearest, q, nearest, lower, upper, inverse_scale, workspace[0], rows
            )
            _largest_reference(*of_rows)
            is_within = _are_small(most, least, tolerance, ends[k])
        if (
            not is_within or wrong.any()
        ):  # where sides agree, elimination leaves each row right in its own terms
            return k
        if kept[k] >= 0:
            for i in range(n):
                for m in range(Z.shape[0]):
                    Z[m, kept[k], i] = answer[i, m]
    return kept.size


@inlined
def _join(before, after, a, d, c, q):  # type: ignore[no-untyped-def]
    """Return the block that two blocks and the free row between them make, and the pivot of that row.

    A block is the z of its first and of its last row, each as constant, factor of the z left, and of the z right of it.
    """
    pivot = d - a * before[5] - c * after[1]
    own, left, right = (
        (a * before[3] + c * after[0] - q) / pivot,
        a * before[4] / pivot,
        c * after[2] / pivot,
    )
    first = before[0] + before[2] * own, before[1] + before[2] * left, before[2] * right
    last = after[3] + after[4] * own, after[4] * left, after[5] + after[4] * right
    return (first[0], first[1], first[2], last[0], last[1], last[2]), pivot


@helper
def find_contacts(bands, q, sign, value, is_held, is_free, stops, blocks):  # type: ignore[no-untyped-def]
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
    is_held : array of flags, shape (n,)
        The rows that stay at their value whatever their w is.
    is_free : array of flags, shape (n,)
    stops, blocks : arrays, shapes (n + 1,) of int64 and (n + 1, 7)
        Workspace: the rows at their bounds so far; the free rows before each, and its w.

    Returns
    -------
    bool
        False where a pivot is not positive, or negligible: M is no M-matrix, or singular.
    """
    n = is_free.size
    top, left, block = (
        0,
        0.0,
        EMPTY,
    )  # rows at their bounds, the z of the last one, and the free rows behind it
    for i in range(n):
        a, d, c = -bands[0, i], bands[1, i], -bands[2, i]
        here, after = value[i], value[i + 1] if i + 1 < n else 0.0
        # w without the part of the next row
        w = d * here - a * (block[3] + block[4] * left + block[5] * here) + sign * q[i]
        is_free[i] = (not is_held[i]) and (here == -np.inf or w < c * after)
        if not is_free[i]:
            top += 1
            stops[top], blocks[top, 6], left = i, w, here
            blocks[top, 0], blocks[top, 1], blocks[top, 2] = block[0], block[1], block[2]
            blocks[top, 3], blocks[top, 4], blocks[top, 5] = block[3], block[4], block[5]
            block = EMPTY
            continue
        block, pivot = _join(block, EMPTY, a, d, c, sign * q[i])
        if not pivot > NEGLIGIBLE_PIVOT * d:
            return False
        while (
            top > 0 and after > -np.inf
        ):  # a row without bound becomes free next, and then they are looked at
            k = stops[top]
            a, d, c = -bands[0, k], bands[1, k], -bands[2, k]
            if is_held[k] or not blocks[top, 6] < c * (
                block[0] + block[1] * left + block[2] * after
            ):
                break
            is_free[k] = True
            kept = blocks[top]
            block, pivot = _join(
                (kept[0], kept[1], kept[2], kept[3], kept[4], kept[5]), block, a, d, c, sign * q[k]
            )
            if not pivot > NEGLIGIBLE_PIVOT * d:
                return False
            top -= 1
            left = value[stops[top]] if top > 0 else 0.0
    return True


@helper
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
