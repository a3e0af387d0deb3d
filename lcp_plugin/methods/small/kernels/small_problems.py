"""Small dense problems from data to enclosed answer in one compiled loop; arrays as in :mod:`.workspace`.

A run is projected-type sweeps, which guess the active set, then rounds that solve for a guessed set and swap all rows
of the wrong sign, then Lemke's pivots. It ends as soon as the residual is *enclosed* within the tolerance, as that of
every other answer is. What is out of the ordinary (numbers near the ends of the range, a path lost to rounding, a
problem without solution) is left to others.

The same kernel takes one step at a time or all at once, so the numbers are the same bit for bit. Pivots are another
kernel, which few problems need.
"""

from __future__ import annotations

import numpy as np

from ....core.checks import DENSE_ABOVE_DENSITY
from ....core.kernels.compilation import helper, inlined, kernel
from ....core.kernels.enclosures import MAY_UNDERFLOW, fused, of_terms, row_ends, with_term
from ....core.kernels.floats import NEGLIGIBLE_DIAGONAL, SURELY_RIGHT
from ....core.kernels.rows import clamp, residual_of_row, wrong_part
from .small_systems import row_times, solve_free
from .tableau import follow_path
from .workspace import (
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
)

SWEEP, ROUND, PIVOT, OVER, BEGINNING, UNUSUAL = 0, 1, 2, 3, 4, 5
ALL, NONE_YET, ONE_MORE = -1, 0, 1  # steps that a call takes: the first two begin, the last goes on

# The row STATE: what comes next, how many of these were made, the fewest swaps of a round so far, rounds without fewer,
# what follows the rounds, whether these go on as long as they may help an M-matrix, and what M is like.
PHASE, MADE, FEWEST, IDLE, LAST, TO_THE_END, IS_SYMMETRIC, NONZEROS = 0, 1, 2, 3, 4, 5, 6, 7

SWEEPS = 2  # as many as improve the guess of the active set
ROUNDS = 12  # these cost about as much as the pivots of a whole path
IDLE_ROUNDS = 2
PIVOTS = 10  # times n + 10
RELAXATION = 1.7
USUAL = (1e-130, 1e130)  # magnitudes whose products stay in range


@helper
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
    return (
        nonzeros if nonzeros else 1,
        most < USUAL[1] and least > USUAL[0],
        is_positive,
        difference == 0.0,
    )


@helper
def slack(M, k, real, point):  # type: ignore[no-untyped-def]
    """Write W = M x + q at that row x of `real`."""
    n = M.shape[1]
    for i in range(n):
        real[W, i] = row_times(M, k, i, n, real, point) + real[Q, i]


@helper
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


@helper
def moved(M, k, real, point, has_slack):  # type: ignore[no-untyped-def]
    """Put Z at the point of the box nearest to that row x of `real`, and W with it; return its residual.

    That is max_i |mid(z_i − u_i, z_i − l_i, w_i / d_i)|, as double precision gives it. W may be that of x already.
    """
    n, largest, is_same = M.shape[1], 0.0, has_slack
    for i in range(n):
        real[Z, i] = clamp(real[point, i], real[LOWER, i], real[UPPER, i])
        is_same &= real[Z, i] == real[point, i]
    if not is_same:
        slack(M, k, real, Z)
    for i in range(n):
        r = abs(
            residual_of_row(real[W, i] / real[SCALE, i], real[Z, i], real[LOWER, i], real[UPPER, i])
        )
        largest = r if not r <= largest else largest
    return largest


@helper
def take(q, lower, upper, item, real, n):  # type: ignore[no-untyped-def]
    """Copy a problem's vectors, Z at the point of its box nearest to 0."""
    of_q, of_lower, of_upper = (
        item if q.shape[0] > 1 else 0, item if lower.shape[0] > 1 else 0, item if upper.shape[0] > 1 else 0
    )  # fmt: skip
    for i in range(n):
        real[Q, i], real[LOWER, i], real[UPPER, i] = (
            q[of_q, i],
            lower[of_lower, i],
            upper[of_upper, i],
        )
        real[Z, i] = clamp(0.0, real[LOWER, i], real[UPPER, i])


@helper
def _begin(  # type: ignore[no-untyped-def]
    starts, item, sweeps, rounds, pivots, may_sweep, has_start, real, whole, n
):
    """Write the start to FOUND, and which of the phases that the caller wants comes first."""
    is_cold = True
    for i in range(n):
        real[FOUND, i] = real[Z, i]
    if has_start:
        at = item if starts.shape[0] > 1 else 0
        for i in range(n):
            is_cold &= starts[at, i] == real[Z, i]
            real[FOUND, i] = starts[at, i]
    wants_sweeps = sweeps and may_sweep and is_cold
    wants_rounds = rounds and (may_sweep or not is_cold or not pivots)
    whole[STATE, MADE], whole[STATE, FEWEST], whole[STATE, IDLE] = 0, n + 1, 0
    whole[STATE, TO_THE_END] = not pivots
    whole[STATE, LAST] = PIVOT if pivots else OVER
    return SWEEP if wants_sweeps else ROUND if wants_rounds else PIVOT


@inlined
def _step(M, k, real, whole, matrix):  # type: ignore[no-untyped-def]
    """Take one step; return (its phase, the residual of Z, entries touched): a pivot or OVER where none is taken."""
    n, free, touched = M.shape[1], 0, float(M.shape[1] * M.shape[1])
    phase = whole[STATE, PHASE]
    if phase == ROUND:
        is_symmetric = whole[STATE, IS_SYMMETRIC] == 1
        free = solve_free(M, k, real, whole, matrix, is_symmetric)
        if free < 0:
            phase = whole[STATE, PHASE] = whole[STATE, LAST]
        else:
            slack(M, k, real, FOUND)
            changes = classify(real, whole, n, FOUND)
            whole[STATE, MADE] += 1
            whole[STATE, IDLE] += 1
            if changes < whole[STATE, FEWEST]:
                whole[STATE, FEWEST], whole[STATE, IDLE] = changes, 0
            is_long = whole[STATE, IDLE] >= IDLE_ROUNDS or whole[STATE, MADE] >= ROUNDS
            if whole[STATE, TO_THE_END]:
                is_long = whole[STATE, MADE] > n + 1  # enough where M is an M-matrix
            if changes == 0:
                whole[STATE, PHASE] = OVER
            elif is_long:
                whole[STATE, PHASE] = whole[STATE, LAST]
            touched = 2.0 * n * n + free * free * (free / (6.0 if is_symmetric else 3.0))
    elif phase == SWEEP:
        pivot = 1.0 / (1.0 / RELAXATION + 3.0)
        for i in range(n):  # FOUND by a sweep of NPSOR with the row scaling 1/d from Z and W
            total = row_times(M, k, i, i, real, KEPT)
            z, lower, upper, scale = real[Z, i], real[LOWER, i], real[UPPER, i], real[SCALE, i]
            r = residual_of_row(real[W, i] / scale, z, lower, upper)
            new = clamp(z - (2.0 * r + total / scale) * pivot, lower, upper)
            real[FOUND, i], real[KEPT, i] = new, new - z
        touched = 1.5 * n * n
        whole[STATE, MADE] += 1
        if whole[STATE, MADE] >= SWEEPS:
            whole[STATE, PHASE], whole[STATE, MADE] = ROUND, 0
    if phase in (PIVOT, OVER):
        whole[STATE, PHASE] = OVER
        return phase, np.inf, 0.0
    size = moved(M, k, real, FOUND, phase == ROUND)
    if phase != ROUND:
        classify(real, whole, n, Z)
    return phase, size, touched


@helper
def ends(M, k, real, is_dense):  # type: ignore[no-untyped-def]
    """Return (a lower, an upper bound) of ‖r(z)‖∞ as `residual_ends` does; ∞ where a product may underflow."""
    n, least, most, is_zero = M.shape[1], 0.0, 0.0, True
    for i in range(n):
        is_zero &= real[Z, i] == 0.0
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
        smallest, largest = row_ends(
            high, slip, real[SCALE, i], real[Z, i], real[LOWER, i], real[UPPER, i]
        )
        largest = np.inf if is_small else largest
        least, most = smallest if smallest > least else least, largest if largest > most else most
    return least, most


@inlined
def is_kept_dense(nonzeros, n):  # type: ignore[no-untyped-def]
    """Return whether M is kept with its zeros; a sparse one is kept without them, and has fewer terms a row."""
    return nonzeros > DENSE_ABOVE_DENSITY * n * n


@helper
def beside_terms(M, k, real):  # type: ignore[no-untyped-def]
    """Return an upper bound of the term residual of Z, as `core.certificates.own_terms` has it: no z_i is moved."""
    n, largest = M.shape[1], 0.0
    for i in range(n):
        wrong = wrong_part(real[W, i], real[Z, i], real[LOWER, i], real[UPPER, i])
        if wrong <= 0.0:
            continue
        terms = abs(real[Q, i]) + abs(M[k, i, i] * real[Z, i])
        if not wrong <= SURELY_RIGHT * terms:
            terms = abs(real[Q, i])
            for j in range(n):
                terms += abs(M[k, i, j] * real[Z, j])
        ratio = wrong / terms
        largest = largest if ratio <= largest else ratio
    return largest * largest


@helper
def enclosed(M, k, real, size, least, most, is_dense, tolerance):  # type: ignore[no-untyped-def]
    """Return upper bounds of the relative and of the term residual of Z, ∞ where `size` is no such hope.

    `size` and 0 without tolerance.
    """
    if tolerance < 0.0:
        return size, 0.0
    if not size / most <= tolerance:
        return np.inf, np.inf
    _, largest = ends(M, k, real, is_dense)
    ratio = largest / least
    if fused(ratio, least, -largest) < 0.0:
        ratio = np.nextafter(ratio, np.inf)  # upwards
    return ratio, beside_terms(M, k, real)


@kernel
def run_all(  # type: ignore[no-untyped-def]
    M,
    q,
    lower,
    upper,
    starts,
    sweeps,
    rounds,
    pivots,
    tolerance,
    max_iterations,
    first,
    end,
    steps,
    real,
    whole,
    matrix,
    z,
    residual,
    terms,
    made,
    work,
    needs_path,
):
    """Solve the problems first ≤ item < end of a batch; an array with one row in front stands for all of them.

    Written are z, shape (B, n), `residual` (B,), the relative one, enclosed, or ∞, and `terms` (B,), the term residual
    beside it; `made` and `work` (B, 3): steps and passes of each phase; and `needs_path` (B,) where pivots are to
    follow; their number is returned. What is not reached stays as it was: ∞, 0, False. Where one problem is watched,
    `steps` says how far a call goes, a tolerance below 0 that nothing is enclosed, and `residual` is the absolute one.
    No column of `starts` stands for z°.
    """
    n, is_enclosed, paths = M.shape[1], tolerance >= 0.0, 0
    for item in range(first, end):
        k, least, most, is_dense, count = item if M.shape[0] > 1 else 0, 1.0, 1.0, True, -1
        if steps == ONE_MORE:
            count, limit = 0, 1
        else:
            limit = max_iterations if steps == ALL else 0
            take(q, lower, upper, item, real, n)
            nonzeros, is_usual, may_sweep, is_symmetric = look_at(M, k, real)
            whole[STATE, IS_SYMMETRIC], whole[STATE, NONZEROS], whole[STATE, PHASE] = (
                is_symmetric,
                nonzeros,
                UNUSUAL,
            )
            is_dense = is_kept_dense(nonzeros, n)
            if is_usual and is_enclosed:
                least, most = ends(M, k, real, is_dense)
            has_start = starts.shape[1] > 0 and most > 0.0
            after = _begin(
                starts, item, sweeps, rounds, pivots, may_sweep, has_start, real, whole, n
            )
            work[item, after] = n * n / nonzeros
            if is_usual and most == 0.0:
                residual[item], terms[item] = 0.0, 0.0
            is_usual &= not is_enclosed or (least > 0.0 and USUAL[0] < most < USUAL[1])
            if is_usual:
                whole[STATE, PHASE] = BEGINNING
            else:
                count = limit
        while count < limit:
            before = whole[STATE, PHASE]
            phase, size, touched = _step(M, k, real, whole, matrix)
            needs_path[item] = phase == PIVOT
            if phase in (PIVOT, OVER):
                paths += needs_path[item]
                break
            if before == BEGINNING:
                whole[STATE, PHASE] = after
            else:
                made[item, phase] += 1
                work[item, phase] += touched / whole[STATE, NONZEROS]
            count += 1
            residual[item], terms[item] = enclosed(
                M, k, real, size, least, most, is_dense, tolerance
            )
            if residual[item] <= tolerance and terms[item] <= tolerance:
                break
        for i in range(n):
            z[item, i] = real[Z, i]
    return paths


@kernel
def follow_all(  # type: ignore[no-untyped-def]
    M,
    q,
    lower,
    upper,
    tolerance,
    first,
    end,
    real,
    whole,
    matrix,
    z,
    residual,
    terms,
    made,
    work,
    needs_path,
):
    """Follow Lemke's path to its end where `needs_path` says so; all the rest as in `run_all`, to which it adds."""
    n = M.shape[1]
    for item in range(first, end):
        if not needs_path[item]:
            continue
        k, least, most = item if M.shape[0] > 1 else 0, 1.0, 1.0
        take(q, lower, upper, item, real, n)
        nonzeros, _, _, is_symmetric = look_at(M, k, real)
        if tolerance >= 0.0:
            least, most = ends(M, k, real, is_kept_dense(nonzeros, n))
        pivots = follow_path(M, k, real, whole, matrix, PIVOTS * (n + 10))
        if pivots < 0:
            continue
        size = moved(M, k, real, FOUND, False)
        for i in range(n):
            real[KEPT, i] = real[Z, i]
        if (
            solve_free(M, k, real, whole, matrix, is_symmetric) >= 0
        ):  # once more on the problem's own data
            after = moved(M, k, real, FOUND, False)
            size = after if after <= size else moved(M, k, real, KEPT, False)
        made[item, PIVOT] += 1
        work[item, PIVOT] += (pivots + 4.0) * n * (n + 1.0) / nonzeros
        is_dense = is_kept_dense(nonzeros, n)
        residual[item], terms[item] = enclosed(M, k, real, size, least, most, is_dense, tolerance)
        for i in range(n):
            z[item, i] = real[Z, i]
