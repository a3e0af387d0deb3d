"""The derivatives of a march in time on a narrow band: one banded solve a step, on the rows that are free there.

First each z is solved for once more, with w in twice the precision, and its rows are told apart. A tangent goes through
the steps forwards, an adjoint backwards: the same systems, or the transposed ones. Either ends before a step that more
digits have to decide, or a small LCP: where a row is about degenerate, where the free block is about singular. That
step is the caller's.

Rows whose numbers underflow, as far from the money as nothing is left of a price, count as degenerate: at the bound.
"""

from __future__ import annotations

import numpy as np

from ...core.kernels.compilation import helper, inlined, kernel
from ...core.kernels.enclosures import MAY_UNDERFLOW, fused, split_sum
from ...core.kernels.floats import EPSILON
from ...methods.banded.kernels import add_product, eliminate
from ...methods.banded.march_kernels import substitute

STEPS = 6  # of the active-set method; from a solved problem one or two settle all rows
SETTLED = 2.0**-26  # of z, of the last step: the next one would be rounding
LEFT = 2.0**-20  # of the last step: more than it leaves of the error
CLEAR = 64.0  # times rounding
BACKWARD = 2.0**-40  # error of a stable solution; a pivot that was replaced leaves more
CANCELLED = 2.0**40  # terms beside their sum: the block is about singular
KINK = 2  # times the side of a row that is at this bound, with w = 0


@helper
def _solve(band, right, value, state, x, rows, workspace):  # type: ignore[no-untyped-def]
    """Fill x with value where state is not 0 and the solution of B x + right = 0 elsewhere."""
    bands, below, is_direct, weights = band
    if is_direct:
        substitute(bands, right, value, state, x, workspace)
    else:
        eliminate(bands, below, weights, right, value, state, x, rows, workspace)


@helper
def _is_regular(band, right, state, x, w):  # type: ignore[no-untyped-def]
    """Fill w = B x + right; return whether it is rounding on the free rows and these not about singular, and rounding.

    That is of the largest terms, in units of the rows.
    """
    bands, below, _, weights = band
    width, n = bands.shape
    largest = terms = error = 0.0
    for i in range(n):
        given = total = right[i]
        size = abs(given)
        for k in range(max(0, below - i), min(width, n - i + below)):
            term = bands[k, i] * x[i + k - below]
            given += term if state[i + k - below] != 0 else 0.0
            total, size = total + term, size + abs(term)
        w[i] = total
        if state[i] == 0:
            largest = max(largest, abs(given) * weights[i])
            terms, error = max(terms, size * weights[i]), max(error, abs(total) * weights[i])
            if not size < np.inf:
                return False, 0.0
    return error <= BACKWARD * terms and terms <= CANCELLED * largest, EPSILON * terms


@helper
def _slacks(indptr, indices, data, q, z, change, w, size, spread):  # type: ignore[no-untyped-def]
    """Fill w = M z + q in twice the precision, the rounding of its terms, and |M| change."""
    for i in range(z.size):
        total, errors, largest, moved = q[i], 0.0, abs(q[i]), 0.0
        for k in range(indptr[i], indptr[i + 1]):
            a, b = data[k], z[indices[k]]
            h = a * b
            total, f = split_sum(total, h)
            errors += fused(a, b, -h) + f
            largest, moved = largest + abs(h), moved + abs(a) * change[indices[k]]
        w[i], size[i], spread[i] = (
            total + errors,
            largest * EPSILON * (indptr[i + 1] - indptr[i] + 1),
            moved,
        )


@inlined
def _is_negligible(distance, slack):  # type: ignore[no-untyped-def]
    """Return whether nothing is left of a row's distance from its bound and of its slack, both in the unit of w."""
    return (distance < MAY_UNDERFLOW) & (abs(slack) < MAY_UNDERFLOW)


@helper
def _take_sides(z, w, scale, lower, upper, state):  # type: ignore[no-untyped-def]
    """Fill state with the bound that z − w/d reaches (−1, 0, 1); return whether that changes nothing of any size."""
    is_same = True
    for i in range(z.size):
        step, above, beyond = w[i] / scale[i], z[i] - lower[i], z[i] - upper[i]
        side = -1 if above <= step else 1 if beyond >= step else 0
        if lower[i] == upper[i]:
            side = 1 if w[i] < 0.0 else -1
        elif _is_negligible(min(above, -beyond) * scale[i], w[i]):
            side, state[i] = -1 if above <= -beyond else 1, -1 if above <= -beyond else 1
        is_same &= state[i] == side
        state[i] = side
    return is_same


@helper
def _is_nondegenerate(z, w, scale, lower, upper, change, size, spread, state):  # type: ignore[no-untyped-def]
    """Mark the rows that are at a bound and have w = 0; return whether every row is clearly one or none of these."""
    for i in range(z.size):
        above, below = z[i] - lower[i], upper[i] - z[i]
        distance, slack, floor = min(above, below) * scale[i], abs(w[i]), size[i]
        near, slight = floor + LEFT * change[i] * scale[i], floor + LEFT * spread[i]
        if lower[i] == upper[i]:
            continue
        if not _is_negligible(distance, slack):
            if distance > CLEAR * near or slack > CLEAR * slight:
                continue
            if not (distance <= floor and slack <= floor):
                return False
        state[i] = KINK if below < above else -KINK
    return True


@kernel
def settle(  # type: ignore[no-untyped-def]
    band, indptr, indices, data, scale, propagator, states, Q, lower, upper, Z, sides, is_plain
):
    """Make Q of the forcing, each row of Z exact to rounding, and find the sides of its rows.

    Parameters
    ----------
    band : tuple
        M by its diagonals, how many are below the main one, whether `substitute` will do, and its weights.
    indptr, indices, data, scale
        M by rows, and its residual scale.
    propagator : tuple
        A matrix by rows.
    states : array, shape (k + 1, n)
        What each step began with, and the last answer.
    Q, Z : arrays, shape (k, n)
        The forcing, which becomes offsets, and the solutions; both are written to.
    sides : array of int8, shape (k, n)
        −1 at the lower bound, 0 between, 1 at the upper one; ∓2 where w = 0 as well.
    is_plain : array of bool, shape (k,)
        Where that succeeded.
    """
    n = Z.shape[1]
    w, value, step, workspace = np.empty(n), np.empty(n), np.empty(n), np.empty(n)
    change, size, spread, rows = (
        np.empty(n),
        np.empty(n),
        np.empty(n),
        np.empty((n, band[0].shape[0])),
    )
    for k in range(Z.shape[0]):
        z, state, is_settled, is_plain[k] = Z[k], sides[k], False, False
        add_product(propagator[0], propagator[1], propagator[2], states[k], Q[k])
        for i in range(n):
            change[i], state[i] = 0.0, KINK
        for _step in range(STEPS):
            _slacks(indptr, indices, data, Q[k], z, change, w, size, spread)
            is_same = _take_sides(z, w, scale, lower, upper, state)
            if is_settled and is_same:
                is_plain[k] = _is_nondegenerate(
                    z, w, scale, lower, upper, change, size, spread, state
                )
                break
            for i in range(n):
                value[i] = 0.0 if state[i] == 0 else (lower[i] if state[i] < 0 else upper[i]) - z[i]
            _solve(band, w, value, state, step, rows, workspace)
            most = largest = 0.0
            for i in range(n):
                z[i] = z[i] + step[i] if state[i] == 0 else lower[i] if state[i] < 0 else upper[i]
                change[i] = abs(step[i])
                most, largest = max(most, change[i]), max(largest, abs(z[i]))
            is_settled = most <= SETTLED * largest


@kernel
def solve_steps(  # type: ignore[no-untyped-def]
    band, propagator, right, lower, upper, sides, is_plain, first, way, carried, x, of_bounds
):
    """Write the x with B x + right + C x_before = 0 on the free rows of each step, and add what that is on the others.

    Return the step at which that ends, from `first` on forwards (way = 1) or backwards (−1).

    Parameters
    ----------
    band
        As in `settle`, transposed for steps backwards.
    propagator : tuple
        C by rows, likewise.
    right : array, shape (k, n)
    lower, upper : arrays, shape (n,)
        x in the rows at these bounds.
    sides, is_plain
        What `settle` has found.
    carried : array, shape (n,)
        The x before the first of these steps, then that of the last.
    x : array, shape (k, n)
    of_bounds : array, shape (2, n)
        The sums over the steps with a row at its lower, and at its upper bound.
    """
    n = carried.size
    value, w, h, state = np.empty(n), np.empty(n), np.empty(n), np.empty(n, np.int8)
    workspace, rows = np.empty(n), np.empty((n, band[0].shape[0]))
    k = first
    while 0 <= k < right.shape[0]:
        if not is_plain[k]:
            break
        for i in range(n):
            h[i], state[i] = right[k, i], sides[k, i]
            value[i] = 0.0 if state[i] == 0 else lower[i] if state[i] < 0 else upper[i]
        add_product(propagator[0], propagator[1], propagator[2], carried, h)
        _solve(band, h, value, state, x[k], rows, workspace)
        is_regular, rounding = _is_regular(band, h, state, x[k], w)
        if way > 0:
            for i in range(n):
                if abs(state[i]) == KINK:  # held, if its slack agrees; else a small LCP has to tell
                    is_regular &= (w[i] if state[i] > 0 else -w[i]) * band[3][i] <= rounding
        if not is_regular:
            break
        for i in range(n):
            carried[i] = x[k, i]
            of_bounds[0, i] += w[i] if state[i] < 0 else 0.0
            of_bounds[1, i] += w[i] if state[i] > 0 else 0.0
        k += way
    return k
