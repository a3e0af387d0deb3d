"""Compiled rounds of active sets for banded M: say which bounds hold, solve for the other rows, look at what is wrong.

The bands are rows of an array: bands[k, i] = m_{i, i+k−below}, 0 outside of M.
"""

from __future__ import annotations

import numpy as np

from ...core.kernels.compilation import helper, kernel
from ...core.kernels.enclosures import residual_ends
from ...core.kernels.floats import SURELY_RIGHT
from ...core.kernels.rows import clamp, residual_of_row, wrong_part
from .march_kernels import NEGLIGIBLE_PIVOT, find_contacts, substitute

# What `memory` holds: how rounds go on, and for how long.
(
    WAY,
    LAST_WAY,
    SIDE,
    TURNS_LEFT,
    LEFT,
    FEWEST_WRONG,
    FEWEST_HELD,
    PATIENCE,
    HALVES_LEFT,
    IS_SETTLED,
    SLOTS,
) = range(11)
DIRECT, BLOCKS, BEGINNING = 0, 1, 2
RIDGE = 1e-8  # of a row of size 1: stands for a negligible pivot, so that no z gets too large to tell its residual
TURNS = (
    30  # direct rounds that take the sides in turn, before one side is found directly to the end
)
TRIES = 10  # changes of all wrong rows in which neither they nor the rows at bounds get fewer, then of half of them
HALVES = 200  # changes of every other wrong row, by lot, before the end; what converges needed less than 100
FEW_HALVES = 0  # the same where others are to have their turn: what converges soon needs none


@helper
def _measured(bands, below, q, lower, upper, scale, z, w, target):  # type: ignore[no-untyped-def]
    """Fill w = M z + q and, in target, the bounds that z − w/d reaches (−1, 0, 1); return ‖r(z)‖∞."""
    width, n = bands.shape
    for i in range(n):
        w[i] = 0.0
    for k in range(width):
        shift = k - below
        for i in range(-shift if shift < 0 else 0, n if shift < 0 else n - shift):
            w[i] += bands[k, i] * z[i + shift]
    largest, is_finite = 0.0, True
    for i in range(n):
        w[i] += q[i]
        step, above, beyond = w[i] / scale[i], z[i] - lower[i], z[i] - upper[i]
        r = abs(residual_of_row(step, z[i], lower[i], upper[i]))
        largest = r if r > largest else largest
        is_finite &= (abs(w[i]) < np.inf) & (abs(z[i]) < np.inf)
        target[i] = -1 if above <= step or lower[i] == upper[i] else 1 if beyond >= step else 0
    return largest if is_finite else np.inf


@helper
def _load(bands, below, weights, q, value, state, rows, right):  # type: ignore[no-untyped-def]
    """Fill the rows of the free block, each from its first column on, and what is right of them."""
    width, n = bands.shape
    for i in range(n):
        first = below - i if i < below else 0
        for k in range(width):
            rows[i, k] = 0.0
        if state[i] != 0:
            rows[i, below - first], right[i] = 1.0, value[i]
            continue
        total = -q[i]
        for k in range(first, width):
            j = i + k - below
            if j >= n:
                break
            if state[j] == 0:
                rows[i, k - first] = bands[k, i] * weights[i]
            else:
                total -= bands[k, i] * value[j]
        right[i] = total * weights[i]


@helper
def eliminate(bands, below, weights, q, value, state, z, rows, right):  # type: ignore[no-untyped-def]
    """Fill z with value where state is not 0 and the solution of w = 0 elsewhere, by pivots from the column.

    Known z are taken to the right before, so that their rows and columns are those of the identity. The weights are
    powers of two that bring rows to size 1.
    """
    width, n = bands.shape
    _load(bands, below, weights, q, value, state, rows, right)
    for k in range(n):
        last, best = k + below + 1 if k + below < n else n, k
        for i in range(k + 1, last):
            if abs(rows[i, 0]) > abs(rows[best, 0]):
                best = i
        if best != k:
            right[k], right[best] = right[best], right[k]
            for m in range(width):
                rows[k, m], rows[best, m] = rows[best, m], rows[k, m]
        if not abs(rows[k, 0]) >= NEGLIGIBLE_PIVOT:
            rows[k, 0] = RIDGE
        for i in range(k + 1, last):
            factor = rows[i, 0] / rows[k, 0]
            right[i] -= factor * right[k]
            for m in range(1, width):
                rows[i, m - 1] = rows[i, m] - factor * rows[k, m]
            rows[i, width - 1] = 0.0
    for k in range(n - 1, -1, -1):
        total = right[k]
        for m in range(1, width if width < n - k else n - k):
            total -= rows[k, m] * z[k + m]
        z[k] = total / rows[k, 0]


@helper
def _choose(n, bands, q, lower, upper, value, sets, memory, stops, joined):  # type: ignore[no-untyped-def]
    """Fill sets[0] with the bounds that are to hold, and value with the z there."""
    state, target = sets[0], sets[1]
    if memory[WAY] == DIRECT:
        side, sign = memory[SIDE], float(memory[SIDE])
        is_held, is_free = sets[2], sets[3]
        for i in range(n):
            near, far = (lower[i], upper[i]) if side > 0 else (upper[i], lower[i])
            is_held[i] = lower[i] == upper[i] or target[i] == side
            value[i] = sign * (far if is_held[i] else near)
        if not find_contacts(bands, q, sign, value, is_held, is_free, stops, joined):
            memory[WAY] = BLOCKS
        for i in range(n):
            value[i] *= sign
            state[i] = 0 if is_free[i] else target[i] if is_held[i] else -side
    if memory[WAY] == BLOCKS:
        for i in range(n):
            state[i] = target[i]
            value[i] = lower[i] if state[i] < 0 else upper[i]


@helper
def _goes_on(state, target, memory):  # type: ignore[no-untyped-def]
    """Return whether another round may help; where changing all wrong rows leads nowhere, half of them."""
    wrong = far = held = 0
    for i in range(state.size):
        held += target[i] != 0
        if state[i] != target[i]:
            wrong += 1
            far += state[i] == memory[SIDE] or target[i] == memory[SIDE]
    memory[IS_SETTLED] = wrong == 0
    if wrong == 0:
        return True
    if memory[WAY] == DIRECT:
        memory[TURNS_LEFT] -= 1
        memory[LEFT] -= memory[TURNS_LEFT] < 0
        if far > 0 and memory[LEFT] > 0:
            if memory[TURNS_LEFT] >= 0:
                memory[SIDE] = -memory[SIDE]
            return True
        memory[WAY] = BLOCKS
    for i in range(state.size):
        if state[i] == -target[i]:
            target[i] = 0
    if wrong < memory[FEWEST_WRONG] or held < memory[FEWEST_HELD]:
        memory[PATIENCE] = TRIES
    elif memory[PATIENCE] > 0:
        memory[PATIENCE] -= 1
    else:
        memory[HALVES_LEFT] -= 1
        lot = memory[HALVES_LEFT]
        for i in range(state.size):
            lot = (lot * 1103515245 + 12345) % 2**31
            target[i] = target[i] if lot < 2**30 else state[i]
    memory[FEWEST_WRONG] = wrong if wrong < memory[FEWEST_WRONG] else memory[FEWEST_WRONG]
    memory[FEWEST_HELD] = held if held < memory[FEWEST_HELD] else memory[FEWEST_HELD]
    return memory[HALVES_LEFT] >= 0


@kernel
def step(  # type: ignore[no-untyped-def]
    bands, below, is_direct, weights, scale, q, lower, upper, z, vectors, sets, memory, rows, halves
):
    """Begin where memory[WAY] is BEGINNING, else make one round; return ‖r‖∞ of z, and whether to go on."""
    if memory[WAY] == BEGINNING:
        _begin(is_direct, lower, upper, memory, halves)
        memory[LAST_WAY] = BEGINNING
        return _measured(bands, below, q, lower, upper, scale, z, vectors[0], sets[1]), True
    stops, joined = np.empty(z.size + 1, np.int64), np.empty((z.size + 1, 7))
    return _advanced(
        bands, below, weights, scale, q, lower, upper, z, vectors, sets, memory, rows, stops, joined
    )


@helper
def _advanced(  # type: ignore[no-untyped-def]
    bands, below, weights, scale, q, lower, upper, z, vectors, sets, memory, rows, stops, joined
):
    """Go to the z of the active set in sets[1], taken into the bounds; return its ‖r‖∞, and whether to go on.

    On the direct way the contacts on one side are found for the given ones on the other. An active set that comes
    out again has its z refined once.
    """
    n, state, target = z.size, sets[0], sets[1]
    w, value, slope, step = vectors[0], vectors[1], vectors[2], vectors[3]
    is_refined = memory[IS_SETTLED] == 1
    if is_refined:
        for i in range(n):
            value[i] = 0.0
    else:
        _choose(n, bands, q, lower, upper, value, sets, memory, stops, joined)
    memory[LAST_WAY] = memory[WAY]
    right = w if is_refined else q
    if memory[WAY] == DIRECT:
        substitute(bands, right, value, state, step, slope)
    else:
        eliminate(bands, below, weights, right, value, state, step, rows, slope)
    for i in range(n):
        z[i] = z[i] + step[i] if is_refined else step[i]
    now = _measured(bands, below, q, lower, upper, scale, z, w, target)
    goes_on = _goes_on(state, target, memory)
    is_outside = False
    for i in range(n):
        inside = clamp(z[i], lower[i], upper[i])
        is_outside |= inside != z[i]
        z[i] = inside
    if is_outside:
        now = _measured(bands, below, q, lower, upper, scale, z, w, state)
    return now, goes_on and not (is_refined and memory[IS_SETTLED] == 1)


@helper
def _beside_terms(indptr, indices, data, q, lower, upper, z, w):  # type: ignore[no-untyped-def]
    """Return an upper bound of the term residual of z, as `core.certificates.own_terms` has it: no z_i is moved."""
    largest = 0.0
    for i in range(z.size):
        wrong = wrong_part(w[i], z[i], lower[i], upper[i])
        if wrong <= SURELY_RIGHT * abs(q[i]):
            continue
        terms = abs(q[i])
        for k in range(indptr[i], indptr[i + 1]):
            terms += abs(data[k] * z[indices[k]])
        ratio = wrong / terms
        largest = largest if ratio <= largest else ratio
    return largest * largest


@helper
def _begin(is_direct, lower, upper, memory, halves):  # type: ignore[no-untyped-def]
    """Fill the memory of a run that begins; the contacts of the side with most bounds are found directly at first."""
    n = lower.size
    lowers = uppers = 0
    for i in range(n):
        lowers += lower[i] > -np.inf
        uppers += upper[i] < np.inf
    memory[WAY], memory[SIDE] = DIRECT if is_direct else BLOCKS, 1 if lowers >= uppers else -1
    memory[TURNS_LEFT], memory[LEFT] = TURNS, n + 2
    memory[FEWEST_WRONG] = memory[FEWEST_HELD] = n + 1
    memory[PATIENCE], memory[HALVES_LEFT], memory[IS_SETTLED] = TRIES, halves, 0


@helper
def add_product(indptr, indices, data, x, y):  # type: ignore[no-untyped-def]
    """Add A x to y."""
    for i in range(y.size if data.size > 0 else 0):
        total = 0.0
        for k in range(indptr[i], indptr[i + 1]):
            total += data[k] * x[indices[k]]
        y[i] += total


@helper
def _largest(values):  # type: ignore[no-untyped-def]
    """Return the largest of some values, NaN where one of them is."""
    largest = values[0]
    for i in range(1, values.size):
        if values[i] > largest or values[i] != values[i]:
            largest = values[i]
    return largest


@kernel
def run_all(  # type: ignore[no-untyped-def]
    bands,
    below,
    is_direct,
    weights,
    scale,
    indptr,
    indices,
    data,
    propagator_indptr,
    propagator_indices,
    propagator_data,
    Q,
    lower,
    upper,
    nearest,
    tolerance,
    most_rounds,
    halves,
    Z,
    rounds,
    ends,
):
    """Run rounds for one q after the other, each from its row of Z to its answer there.

    Parameters
    ----------
    bands, below, weights, scale, indptr, indices, data
        M: its bands, what `step` asks for, and its entries by rows.
    is_direct : bool
        M is tridiagonal, and its off-diagonal entries are ≤ 0.
    propagator_indptr, propagator_indices, propagator_data
        C by rows, or nothing: C z of each row is added to the q of the next, which starts from that z, in a march that
        ends where it does not converge.
    Q, Z : arrays, shape (k, n)
        Offsets; starts, then answers.
    lower, upper, nearest : arrays, shape (n,)
        Bounds, and the point between them that is nearest to 0.
    most_rounds, halves : int
        Of each row, and how often half of the wrong rows change before the end.
    rounds : array of int, shape (k, 2)
        How many there were on the direct way and on the other.
    ends : array, shape (k, 3)
        An upper bound of ‖r(z)‖∞, ∞ where that is beyond the tolerance, a lower one of ‖r(z°)‖∞, and an upper one of
        the term residual of z.
    """
    n = Q.shape[1]
    vectors, sets, memory = np.empty((6, n)), np.empty((4, n), np.int8), np.empty(SLOTS, np.int64)
    rows, stops, joined = (
        np.empty((n, bands.shape[0])),
        np.empty(n + 1, np.int64),
        np.empty((n + 1, 7)),
    )
    smallest, largest = vectors[4], vectors[5]
    for k in range(Q.shape[0]):
        rounds[k, 0] = rounds[k, 1] = 0
        ends[k, 0] = ends[k, 1] = ends[k, 2] = np.inf
    for k in range(Q.shape[0]):
        q, z, direct, blocks = Q[k], Z[k], 0, 0
        if propagator_indptr.size > 0 and k > 0:
            for i in range(n):
                z[i] = Z[k - 1, i]
            add_product(propagator_indptr, propagator_indices, propagator_data, z, q)
            for i in range(n):
                z[i] = clamp(z[i], lower[i], upper[i])
        for i in range(n):  # a start that may be written to, as z: one signature of what follows
            vectors[1, i] = nearest[i]
        residual_ends(
            indptr,
            indices,
            data,
            0,
            vectors[1],
            q,
            vectors[1],
            lower,
            upper,
            scale,
            smallest,
            largest,
        )
        least, most = _largest(smallest), _largest(largest)
        _begin(is_direct, lower, upper, memory, halves)
        residual, goes_on = (
            _measured(bands, below, q, lower, upper, scale, z, vectors[0], sets[1]),
            least > 0.0,
        )
        while goes_on and direct + blocks < most_rounds and not residual / most <= tolerance:
            residual, goes_on = _advanced(
                bands,
                below,
                weights,
                scale,
                q,
                lower,
                upper,
                z,
                vectors,
                sets,
                memory,
                rows,
                stops,
                joined,
            )
            direct, blocks = (
                direct + (memory[LAST_WAY] == DIRECT),
                blocks + (memory[LAST_WAY] == BLOCKS),
            )
        if least > 0.0 and residual / most <= tolerance:
            residual_ends(indptr, indices, data, 0, z, q, z, lower, upper, scale, smallest, largest)
            ends[k, 0], ends[k, 1] = _largest(largest), least
            ends[k, 2] = _beside_terms(indptr, indices, data, q, lower, upper, z, vectors[0])
        rounds[k, 0], rounds[k, 1] = direct, blocks
        if propagator_indptr.size > 0 and not (
            ends[k, 0] / ends[k, 1] < tolerance and ends[k, 2] <= tolerance
        ):
            return
