"""The derivatives of a march in time on a narrow band: one banded solve a step, on the rows that are free there.

First each z is solved for once more, with w in twice the precision, and its rows are told apart. A tangent goes through
the steps forwards, an adjoint backwards. Either ends before a step that more digits have to decide, or a small LCP:
where a row is about degenerate, where the free block is about singular. That step is the caller's.

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
        w[i], size[i], spread[i] = total + errors, largest * EPSILON * (indptr[i + 1] - indptr[i] + 1), moved


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
    change, size, spread, rows = np.empty(n), np.empty(n), np.empty(n), np.empty((n, band[0].shape[0]))
    for k in range(Z.shape[0]):
        z, state, is_settled, is_plain[k] = Z[k], sides[k], False, False
        add_product(propagator[0], propagator[1], propagator[2], states[k], Q[k])
        for i in range(n):
            change[i], state[i] = 0.0, KINK
        for _step in range(STEPS):
            _slacks(indptr, indices, data, Q[k], z, change, w, size, spread)
            is_same = _take_sides(z, w, scale, lower, upper, state)
            if is_settled and is_same:
                is_plain[k] = _is_nondegenerate(z, w, scale, lower, upper, change, size, spread, state)
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
def tangents(  # type: ignore[no-untyped-def]
    band, propagator, dM, dpropagator, dforcing, lower, upper, states, Z, sides, is_plain, first, before, dz
):
    """Write how each z changes, from row `first` on; return the row at which that ends.

    Parameters
    ----------
    band
        As in `settle`.
    propagator, dM, dpropagator : tuples
        Matrices by rows.
    dforcing : array, shape (k, n), or (1, n) for all steps
    lower, upper : arrays, shape (n,)
        The changes of the bounds.
    states : array, shape (k + 1, n)
        What each step began with, and the last answer.
    Z, sides, is_plain
        What `settle` has found.
    before : array, shape (n,)
        The change of the state that the first step begins with, then that of the last.
    dz : array, shape (k, n)
        Or (1, n) for the last one alone.
    """
    n = before.size
    h, value, state, change = np.empty(n), np.empty(n), np.empty(n, np.int8), np.empty(n)
    w, workspace, rows = np.empty(n), np.empty(n), np.empty((n, band[0].shape[0]))
    for k in range(first, Z.shape[0]):
        if not is_plain[k]:
            return k
        for i in range(n):
            h[i], state[i] = dforcing[min(k, dforcing.shape[0] - 1), i], sides[k, i]
            value[i] = 0.0 if state[i] == 0 else lower[i] if state[i] < 0 else upper[i]
        add_product(propagator[0], propagator[1], propagator[2], before, h)
        add_product(dM[0], dM[1], dM[2], Z[k], h)
        add_product(dpropagator[0], dpropagator[1], dpropagator[2], states[k], h)
        _solve(band, h, value, state, change, rows, workspace)
        is_regular, rounding = _is_regular(band, h, state, change, w)
        for i in range(n):
            if abs(state[i]) == KINK:  # held, if its slack agrees; else a small LCP has to tell
                is_regular &= (w[i] if state[i] > 0 else -w[i]) * band[3][i] <= rounding
        if not is_regular:
            return k
        to = min(k, dz.shape[0] - 1)
        for i in range(n):
            before[i] = dz[to, i] = change[i]
    return Z.shape[0]


@kernel
def adjoints(  # type: ignore[no-untyped-def]
    band, propagator, g, of_matrix, of_propagator, states, Z, sides, is_plain, last, after, by_q, by_lower, by_upper,
    by_M, by_propagator
):
    """Add the gradients of a function of z, from row `last` backwards; return the row at which that ends, −1 for none.

    Parameters
    ----------
    band, propagator
        As in `tangents`, but of the transposed matrices.
    g : array, shape (k, n), or (0, n) for nothing
        The gradient by each z.
    of_matrix, of_propagator : pairs of arrays
        The row and the column of each entry of M and of the propagator.
    states, Z, sides, is_plain
        As in `tangents`.
    after : array, shape (n,)
        The gradient by the z of row `last` that later steps give, then that by the state before the first row.
    by_q : array, shape (k, n)
        Written to, or (0, n) for nothing.
    by_lower, by_upper, by_M, by_propagator : arrays, shapes (n,), (n,), and an entry for each of the two matrices
    """
    n = after.size
    right, value, state, multiplier = np.empty(n), np.zeros(n), np.empty(n, np.int8), np.empty(n)
    w, workspace, rows = np.empty(n), np.empty(n), np.empty((n, band[0].shape[0]))
    for k in range(last, -1, -1):
        if not is_plain[k]:
            return k
        for i in range(n):
            state[i] = sides[k, i]
            right[i] = -(after[i] + g[k, i]) if g.shape[0] > 0 else -after[i]
        _solve(band, right, value, state, multiplier, rows, workspace)
        is_regular, _ = _is_regular(band, right, state, multiplier, w)
        if not is_regular:
            return k
        for i in range(n):
            multiplier[i] = -multiplier[i]
            by_lower[i] -= w[i] if state[i] < 0 else 0.0
            by_upper[i] -= w[i] if state[i] > 0 else 0.0
            after[i] = 0.0
            if by_q.shape[0] > 0:
                by_q[k, i] = multiplier[i]
        for p in range(by_M.size):
            by_M[p] += multiplier[of_matrix[0][p]] * Z[k, of_matrix[1][p]]
        for p in range(by_propagator.size):
            by_propagator[p] += multiplier[of_propagator[0][p]] * states[k, of_propagator[1][p]]
        add_product(propagator[0], propagator[1], propagator[2], multiplier, after)
    return -1
