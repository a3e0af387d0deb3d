"""Small dense problems from data to enclosed answer in one compiled loop; arrays as in :mod:`~lcp_plugin.kernels.desk`.

A run is projected-type sweeps, which guess the active set, then rounds that solve for a guessed set and swap all rows
of the wrong sign, then Lemke's pivots. It ends as soon as the residual is *enclosed* within the tolerance, as that of
every other answer is. What is out of the ordinary (numbers near the ends of the range, a path lost to rounding, a
problem without solution) is left to others.

The same steps are taken one at a time (`advance`) or all at once (`run_all`): the numbers are the same bit for bit.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ..checks import DENSE_ABOVE_DENSITY
from ..crossovers import PIVOTED_AT_ONCE_UP_TO
from .compilation import compiled, compiled_in_any_order, compiled_in_place, compiled_into_others
from .desk import (
    AT_LOWER,
    AT_UPPER,
    BETWEEN,
    FOUND,
    KEPT,
    LOWER,
    SCALE,
    SIDE,
    STATE,
    UPPER,
    Q,
    W,
    Z,
    sizes,
)
from .enclosures import MAY_UNDERFLOW, fused, of_terms, row_ends, with_term
from .floats import NEGLIGIBLE_DIAGONAL
from .small_systems import solve_free
from .tableau import follow_path

SWEEP, ROUND, PIVOT, OVER = 0, 1, 2, 3
TOTAL = 3  # behind the work of the phases

# The row STATE: what comes next, how many of these were made, the fewest swaps of a round so far, rounds without fewer,
# what follows the rounds, and whether these go on as long as they may help an M-matrix.
PHASE, MADE, FEWEST, IDLE, LAST, TO_THE_END = 0, 1, 2, 3, 4, 5

SWEEPS = 2  # as many as improve the guess of the active set
ROUNDS = 12  # these cost about as much as the pivots of a whole path
IDLE_ROUNDS = 2
PIVOTS = 10  # times n + 10
RELAXATION = 1.7
USUAL = (1e-130, 1e130)  # magnitudes whose products stay in range


@compiled_in_any_order
def look_at(M, k, real):  # type: ignore[no-untyped-def]
    """Fill in SCALE; return (nonzeros, all usual, the diagonal positive, M symmetric)."""
    n = M.shape[1]
    nonzeros, difference, is_positive = 0, 0.0, True
    most, least = 0.0, USUAL[1]
    for i in range(n):
        largest = 0.0
        for j in range(n):
            size = abs(M[k, i, j])
            largest = max(largest, size)
            least = min(least, size if size > 0.0 else USUAL[1])
            nonzeros += size != 0.0
        for j in range(i):
            difference = max(difference, abs(M[k, i, j] - M[k, j, i]))
        d, most = M[k, i, i], max(most, largest)
        is_usable = d > 0.0 and d >= NEGLIGIBLE_DIAGONAL * largest
        is_positive &= is_usable
        real[SCALE, i] = d if is_usable else largest if largest > 0.0 else 1.0
    return max(nonzeros, 1), most < USUAL[1] and least > USUAL[0], is_positive, difference == 0.0


@compiled_in_any_order
def slack(M, k, real, point):  # type: ignore[no-untyped-def]
    """Write W = M x + q at that row x of `real`."""
    n = M.shape[1]
    for i in range(n):
        total = 0.0
        for j in range(n):
            total += M[k, i, j] * real[point, j]
        real[W, i] = total + real[Q, i]


@compiled_into_others
def largest_residual(real, n):  # type: ignore[no-untyped-def]
    """Return max_i |mid(z_i − u_i, z_i − l_i, w_i / d_i)|, as double precision gives it."""
    largest = 0.0
    for i in range(n):
        above, below = real[Z, i] - real[LOWER, i], real[Z, i] - real[UPPER, i]
        r = abs(min(max(real[W, i] / real[SCALE, i], below), above))
        largest = r if not r <= largest else largest
    return largest


@compiled_into_others
def classify(real, whole, n, point):  # type: ignore[no-untyped-def]
    """Note where x − w/d lies, x that row of `real`; return how many rows changed their side."""
    changes = 0
    for i in range(n):
        step, x = real[W, i] / real[SCALE, i], real[point, i]
        side = BETWEEN
        if step >= x - real[LOWER, i] or real[LOWER, i] == real[UPPER, i]:
            side = AT_LOWER
        elif step <= x - real[UPPER, i]:
            side = AT_UPPER
        changes += side != whole[SIDE, i]
        whole[SIDE, i] = side
    return changes


@compiled_into_others
def moved(M, k, real, point):  # type: ignore[no-untyped-def]
    """Put Z at the point of the box nearest to that row of `real`, and W with it; return its residual."""
    n = M.shape[1]
    for i in range(n):
        real[Z, i] = min(max(real[point, i], real[LOWER, i]), real[UPPER, i])
    slack(M, k, real, Z)
    return largest_residual(real, n)


@compiled_in_any_order
def sweep(M, k, real):  # type: ignore[no-untyped-def]
    """Write FOUND by a sweep of NPSOR with the row scaling 1/d from Z and W."""
    n, pivot = M.shape[1], 1.0 / (1.0 / RELAXATION + 3.0)
    for i in range(n):
        total = 0.0
        for j in range(i):
            total += M[k, i, j] * real[KEPT, j]
        z, lower, upper, scale = real[Z, i], real[LOWER, i], real[UPPER, i], real[SCALE, i]
        r = min(max(real[W, i] / scale, z - upper), z - lower)
        new = min(max(z - (2.0 * r + total / scale) * pivot, lower), upper)
        real[FOUND, i], real[KEPT, i] = new, new - z


@compiled
def begin(M, k, real, whole, sweeps, rounds, pivots, may_sweep, is_cold):  # type: ignore[no-untyped-def]
    """Begin at Z with the phases that the caller wants; return its residual."""
    n = M.shape[1]
    slack(M, k, real, Z)
    wants_sweeps = sweeps and may_sweep and is_cold
    wants_rounds = rounds and (may_sweep or not is_cold or not pivots)
    whole[STATE, PHASE] = SWEEP if wants_sweeps else ROUND if wants_rounds else PIVOT
    whole[STATE, MADE], whole[STATE, FEWEST], whole[STATE, IDLE] = 0, n + 1, 0
    whole[STATE, TO_THE_END] = not pivots
    whole[STATE, LAST] = PIVOT if pivots and (n <= PIVOTED_AT_ONCE_UP_TO or not may_sweep) else OVER
    classify(real, whole, n, Z)
    return largest_residual(real, n)


@compiled
def advance(M, k, real, whole, room, is_symmetric):  # type: ignore[no-untyped-def]
    """Take one step; return (its phase, the residual of Z, entries touched); OVER where nothing is left to be done."""
    n = M.shape[1]
    if whole[STATE, PHASE] == SWEEP:
        sweep(M, k, real)
        size = moved(M, k, real, FOUND)
        classify(real, whole, n, Z)
        whole[STATE, MADE] += 1
        if whole[STATE, MADE] >= SWEEPS:
            whole[STATE, PHASE], whole[STATE, MADE] = ROUND, 0
        return SWEEP, size, 1.5 * n * n
    if whole[STATE, PHASE] == ROUND:
        free = solve_free(M, k, real, whole, room, is_symmetric)
        if free >= 0:
            slack(M, k, real, FOUND)
            _judge_round(classify(real, whole, n, FOUND), whole, n)
            size = moved(M, k, real, FOUND)
            return ROUND, size, 2.0 * n * n + free * free * (free / (6.0 if is_symmetric else 3.0))
        whole[STATE, PHASE] = whole[STATE, LAST]
    if whole[STATE, PHASE] == PIVOT:
        whole[STATE, PHASE] = OVER
        made = follow_path(M, k, real, whole, room, PIVOTS * (n + 10))
        if made >= 0:
            size = _refined(M, k, real, whole, room, is_symmetric, moved(M, k, real, FOUND))
            return PIVOT, size, (made + 4.0) * n * (n + 1.0)
    return OVER, np.inf, 0.0


def next_phase(whole: Any) -> int:
    """Return which phase `advance` comes to next."""
    return int(whole[STATE, PHASE])


@compiled_into_others
def _judge_round(changes, whole, n):  # type: ignore[no-untyped-def]
    """Note what a round has changed, and whether another one is worth its work."""
    whole[STATE, MADE] += 1
    whole[STATE, IDLE] = 0 if changes < whole[STATE, FEWEST] else whole[STATE, IDLE] + 1
    whole[STATE, FEWEST] = min(changes, whole[STATE, FEWEST])
    is_long = whole[STATE, IDLE] >= IDLE_ROUNDS or whole[STATE, MADE] >= ROUNDS
    if changes == 0:
        whole[STATE, PHASE] = OVER
    elif whole[STATE, MADE] > n + 1 if whole[STATE, TO_THE_END] else is_long:  # enough where M is an M-matrix
        whole[STATE, PHASE] = whole[STATE, LAST]


@compiled_in_place
def _refined(M, k, real, whole, room, is_symmetric, size):  # type: ignore[no-untyped-def]
    """Solve for the end of a path once more on the problem's own data; keep what has the smaller residual."""
    for i in range(M.shape[1]):
        real[KEPT, i] = real[Z, i]
    if solve_free(M, k, real, whole, room, is_symmetric) < 0:
        return size
    after = moved(M, k, real, FOUND)
    return after if after <= size else moved(M, k, real, KEPT)


@compiled
def _ends(M, k, real, is_zero, is_dense):  # type: ignore[no-untyped-def]
    """Return (a lower, an upper bound) of ‖r(z)‖∞ as `residual_ends` does; ∞ where a product may underflow."""
    n, least, most = M.shape[1], 0.0, 0.0
    for i in range(n):
        total, errors, size, is_small = real[Q, i], 0.0, 0.0, False
        terms = n if is_dense and not is_zero else 0
        for j in range(0 if is_zero else n):
            a, b = M[k, i, j], real[Z, j]
            terms += a != 0.0 and not is_dense
            h = a * b
            is_small |= (abs(h) < MAY_UNDERFLOW) & (a != 0.0) & (b != 0.0)
            total, errors, size = with_term(total, errors, size, h, a, b)
        high, slip = of_terms(total, errors, size, terms)
        smallest, largest = row_ends(high, slip, real[SCALE, i], real[Z, i], real[LOWER, i], real[UPPER, i])
        least, most = max(least, smallest), max(most, np.inf if is_small else largest)
    return least, most


@compiled_into_others
def _ratio_upwards(a, b):  # type: ignore[no-untyped-def]
    """Return a double that is no smaller than a / b."""
    quotient = a / b
    return np.nextafter(quotient, np.inf) if fused(quotient, b, -a) < 0.0 else quotient


@compiled_in_place
def _run(  # type: ignore[no-untyped-def]
    M, k, starts, sweeps, rounds, pivots, tolerance, max_iterations, real, whole, room, residual, made, work, item
):
    """Solve one problem; `starts` has no columns for z°. Return whether it arrived."""
    n = M.shape[1]
    nonzeros, is_usual, may_sweep, is_symmetric = look_at(M, k, real)
    is_zero = is_cold = True
    is_dense = nonzeros > DENSE_ABOVE_DENSITY * n * n  # a sparse M is kept without its zeros: fewer terms a row
    for i in range(n):
        real[Z, i] = min(max(0.0, real[LOWER, i]), real[UPPER, i])
        is_zero &= real[Z, i] == 0.0
    if not is_usual:
        return False
    least, most = _ends(M, k, real, is_zero, is_dense)
    if most > 0.0 and starts.shape[1] > 0:
        at = item if starts.shape[0] > 1 else 0
        for i in range(n):
            is_cold &= starts[at, i] == real[Z, i]
            real[Z, i] = starts[at, i]
    size = begin(M, k, real, whole, sweeps, rounds, pivots, may_sweep, is_cold)
    work[item, whole[STATE, PHASE]] = work[item, TOTAL] = n * n / nonzeros
    residual[item] = 0.0
    if most == 0.0:
        return True
    if not (least > 0.0 and USUAL[0] < most < USUAL[1]):
        return False
    for count in range(max_iterations + 1):
        if size / most <= tolerance:
            _, largest = _ends(M, k, real, False, is_dense)
            residual[item] = _ratio_upwards(largest, least)
            if residual[item] <= tolerance:
                return True
        if count < max_iterations:
            phase, size, touched = advance(M, k, real, whole, room, is_symmetric)
            if phase == OVER:
                break
            made[item, phase] += 1
            work[item, phase] += touched / nonzeros
            work[item, TOTAL] += touched / nonzeros
    return False


@compiled
def run_all(  # type: ignore[no-untyped-def]
    M, q, lower, upper, starts, sweeps, rounds, pivots, tolerance, max_iterations, first, end,
    z, residual, made, work, has_arrived,
):
    """Solve the problems first ≤ k < end of a batch; an array with one row in front stands for all of them.

    Written are z, shape (B, n), `residual` (B,), the relative one; `made` (B, 3): steps of each phase, `work` (B, 4):
    passes of each phase and of all, and `has_arrived` (B,).
    """
    n = M.shape[1]
    of_real, of_whole, of_room = sizes(n)
    real, whole, room = np.empty(of_real), np.empty(of_whole, np.int64), np.empty(of_room)
    for k in range(first, end):
        own = k if q.shape[0] > 1 else 0, k if lower.shape[0] > 1 else 0, k if upper.shape[0] > 1 else 0
        for i in range(n):
            real[Q, i], real[LOWER, i], real[UPPER, i] = q[own[0], i], lower[own[1], i], upper[own[2], i]
        for phase in range(3):
            made[k, phase], work[k, phase], work[k, TOTAL] = 0, 0.0, 0.0
        has_arrived[k] = _run(
            M, k if M.shape[0] > 1 else 0, starts, sweeps, rounds, pivots, tolerance, max_iterations, real, whole, room,
            residual, made, work, k,
        )
        for i in range(n):
            z[k, i] = real[Z, i]
