"""One compiled loop over small dense problems: scales and references, sweeps, Newton's steps, and what these prove."""

from __future__ import annotations

import numpy as np

from ...core.kernels.compilation import helper, kernel
from ...core.kernels.floats import TINY, UNIT
from ...core.matrix.scaling import BESIDE_DIAGONAL, SPREAD
from ...methods.small.kernels.small_systems import eliminate, substitute
from .kernels import (
    OUTWARD,
    block_bounds,
    block_derivative,
    measure,
    own_terms,
    project,
    sweep_once,
)
from .methods import EXACT, GAIN, LEAST_PROXIMAL

LAST_STEPS = 2  # where the system is singular and a proximal term left in it
SMALLEST_SCALE = 1e-10  # of the largest entry of a row: as the residual scale of an LCP


@helper
def copy(x, y):  # type: ignore[no-untyped-def]
    """Write x into y: as y[:] = x, whose check of shapes takes two seconds to compile."""
    for i in range(x.size):
        y[i] = x[i]


@helper
def put_back(starts, weights, origin, z):  # type: ignore[no-untyped-def]
    """Write z° into the blocks of z whose component it answers."""
    for k in range(weights.size):
        if weights[k] == 0.0:
            for i in range(starts[k], starts[k + 1]):
                z[i] = origin[i]


@helper
def gather(M, starts, indptr, indices, data, diagonal, norms, steps, scale):  # type: ignore[no-untyped-def]
    """Write M as CSR, its diagonal blocks, the norms of its blocks, 1/‖M_kk‖, and d; return whether M is in one unit.

    The rows of a block have one pattern. `norms` are the entries of the LCP of block norms, but for signs.
    """
    filled, largest, least, shows_none = 0, 0.0, np.inf, True
    for k in range(scale.size):
        first, end = starts[k], starts[k + 1]
        for i in range(first, end):
            indptr[i] = filled
            for j in range(M.shape[1]):
                is_stored = False
                for inner in range(first, end):
                    is_stored = is_stored or M[inner, j] != 0.0
                if is_stored:
                    indices[filled], data[filled] = j, M[i, j]
                    filled += 1
        row = 0.0
        for other in range(scale.size):
            most, total = 0.0, 0.0
            for i in range(first, end):
                for j in range(starts[other], starts[other + 1]):
                    most, total = max(most, abs(M[i, j])), total + M[i, j] * M[i, j]
            norms[k, other] = max(most, np.sqrt(total))
            if other == k:
                steps[k] = 1.0 / norms[k, k] if norms[k, k] > 0.0 else 0.0
                norms[k, k] /= np.sqrt(end - first)
            row = max(row, norms[k, other])
        for i in range(first, end):
            for j in range(first, end):
                diagonal[k, i - first, j - first] = M[i, j]
        own = norms[k, k]
        serves = (
            own >= SMALLEST_SCALE * row and own > 0.0 and (end - first > 1 or M[first, first] > 0.0)
        )
        scale[k] = own if serves else row if row > 0.0 else 1.0
        largest, least = max(largest, row), min(least, own)
        shows_none = shows_none and row * 2.0**-BESIDE_DIAGONAL <= own
    indptr[M.shape[0]] = filled
    return shows_none or largest * 2.0**-SPREAD <= least


@helper
def label(norms, labels):  # type: ignore[no-untyped-def]
    """Give each block the number of the first block in its connected component."""
    for k in range(labels.size):
        labels[k] = k
    has_changed = True
    while has_changed:
        has_changed = False
        for k in range(labels.size):
            for j in range(labels.size):
                if norms[k, j] > 0.0 and labels[j] != labels[k]:
                    labels[j] = labels[k] = min(labels[j], labels[k])
                    has_changed = True


@helper
def product(indptr, indices, data, q, z, w, slip):  # type: ignore[no-untyped-def]
    """Write w = M z + q, and how far rounding has taken it from that."""
    for i in range(q.size):
        w[i] = total = q[i]
        total, count = abs(total), 0
        for p in range(indptr[i], indptr[i + 1]):
            if z[indices[p]] != 0.0:
                term = data[p] * z[indices[p]]
                w[i], total, count = w[i] + term, total + abs(term), count + 1
        slip[i] = (count + 2.0) * UNIT * OUTWARD * total + count * TINY if count else 0.0


@helper
def references(  # type: ignore[no-untyped-def]
    starts,
    slope,
    friction,
    lower,
    upper,
    z,
    w,
    slip,
    scale,
    labels,
    R,
    least,
    most,
    reference,
    weights,
):
    """Write the lower bound of each block's reference ‖R_P(z°)‖, and 1 over the upper one; return whether it is known.

    It is not where double precision does not tell whether z° answers a component.
    """
    for k in range(slope.size):
        least[k], most[k] = block_bounds(
            k, starts, slope, friction, lower, upper, z, w, slip, scale, R
        )
    for k in range(slope.size):
        low, high = 0.0, 0.0
        for j in range(slope.size):
            if labels[j] == labels[k]:
                low, high = max(low, least[j]), max(high, most[j])
        if high > 0.0 and not 0.0 < low < np.inf:
            return False
        reference[k], weights[k] = low, 1.0 / high if high > 0.0 else 0.0
    return True


@helper
def refer(known, origin, labels, of_blocks, of_rows, z):  # type: ignore[no-untyped-def]
    """Write the references of components, and put unknowns that nothing acts on back to z°; return whether all act."""
    starts, slope, friction, lower, upper, indptr, indices, data, q, scale = known
    reference, weights, least, most = of_blocks[2], of_blocks[3], of_blocks[4], of_blocks[5]
    w, R, slip, swept = of_rows[0], of_rows[1], of_rows[2], of_rows[4]
    copy(origin, swept)
    product(indptr, indices, data, q, swept, w, slip)
    if not references(
        starts,
        slope,
        friction,
        lower,
        upper,
        swept,
        w,
        slip,
        scale,
        labels,
        R,
        least,
        most,
        reference,
        weights,
    ):
        return False
    put_back(starts, weights, origin, z)
    return True


@helper
def settle(known, origin, labels, of_blocks, of_rows, z, proved):  # type: ignore[no-untyped-def]
    """Take the answer into the cones; write bounds of its relative residual and of its term residual into `proved`."""
    starts, slope, friction, lower, upper, indptr, indices, data, q, scale = known
    reference, weights, least, most = of_blocks[2], of_blocks[3], of_blocks[4], of_blocks[5]
    w, R, slip, start, swept, terms = (
        of_rows[0],
        of_rows[1],
        of_rows[2],
        of_rows[3],
        of_rows[4],
        of_rows[5],
    )
    put_back(starts, weights, origin, z)
    project(starts, slope, lower, upper, z)
    product(indptr, indices, data, q, z, w, slip)
    own_terms(*known, labels, z, w, start, terms, R, swept, least, most, weights)
    proved[0] = proved[1] = 0.0
    for k in range(slope.size):
        most[k] = block_bounds(k, starts, slope, friction, lower, upper, z, w, slip, scale, R)[1]
        if most[k] > 0.0:
            proved[0] = max(proved[0], OUTWARD * most[k] / reference[k])
            proved[1] = max(proved[1], weights[k])


@helper
def newton_step(known, z, w, R, epsilon, room, step):  # type: ignore[no-untyped-def]
    """Write the step s of (R_z + R_w (M + ε D)) s = −R; return whether there is one.

    Of open blocks, and of rows at bounds, s = −R; the system is that of the others, whose rows `place` numbers.
    """
    starts, slope, friction, lower, upper, indptr, indices, data, _, scale = known
    by_z, by_w, J, place, x, way = room
    n = np.int64(0)  # numpy's: one signature of `eliminate`
    for k in range(slope.size):
        block_derivative(
            k, starts, slope, friction, lower, upper, z, w, scale, x, way, by_z[k], by_w[k]
        )
        is_free = False
        for i in range(by_w.shape[1]):
            is_free = is_free or by_w[k, 0, i] != 0.0
        for i in range(starts[k], starts[k + 1]):
            place[i] = n if is_free else -1
            n += is_free
    for k in range(slope.size):
        first, width = starts[k], starts[k + 1] - starts[k]
        for i in range(width):
            row, step[first + i] = place[first + i], -R[first + i]
            if row < 0:
                continue
            for j in range(n):
                J[row, j] = 0.0
            right = -R[first + i]
            for j in range(width):
                J[row, place[first + j]] += by_z[k, i, j] + by_w[k, i, j] * epsilon * scale[k]
                if by_w[k, i, j] != 0.0:
                    for p in range(indptr[first + j], indptr[first + j + 1]):
                        column = indices[p]
                        if place[column] >= 0:
                            J[row, place[column]] += by_w[k, i, j] * data[p]
                        else:
                            right += by_w[k, i, j] * data[p] * R[column]
            J[row, n] = right
    if not eliminate(J, place.size, n):
        return False
    substitute(J, n)
    for i in range(place.size):
        if place[i] >= 0:
            step[i] = J[place[i], n]
    return True


@helper
def _newton(known, weights, goal, most_steps, memory, constants, z, w, R, start, step, room):  # type: ignore[no-untyped-def]
    """Take Newton's steps, with a nonmonotone line search, to the goal; return the largest residual and how many."""
    proximal, halvings, decrease, least_proximal, harder, easier = constants
    largest, size = measure(*known, weights, z, w, R)
    sizes = np.full(memory, size)
    widest = proximal
    for made in range(most_steps):
        if largest <= goal or not size < np.inf:
            return largest, made
        epsilon = max(min(widest, 0.1 * largest), least_proximal)
        while epsilon <= 1.0 and not newton_step(known, z, w, R, epsilon, room, step):
            epsilon *= harder
        if epsilon > 1.0:
            return largest, made
        copy(z, start)
        length, allowed, before = 1.0, size, size
        for earlier in sizes:
            allowed = max(allowed, earlier)
        for _ in range(halvings):
            for i in range(z.size):
                z[i] = start[i] + length * step[i]
            largest, size = measure(*known, weights, z, w, R)
            if size <= (1.0 - decrease * length) * allowed:
                break
            length *= 0.5
        if length < 1.0 or size >= before:
            widest = proximal
        elif size > GAIN * before:
            widest = easier * epsilon  # the term itself keeps the step short
        sizes[made % sizes.size] = size
    return largest, most_steps


@kernel
def solve_each(  # type: ignore[no-untyped-def]
    item,
    end_item,
    starts,
    friction,
    slopes,
    lowers,
    uppers,
    matrices,
    offsets,
    origins,
    goal,
    rounds,
    most_steps,
    memory,
    constants,
    away,
    points,
    made,
    proved,
):
    """Solve problems of the same blocks: sweeps, then steps of Newton's method, from `points`, which get the answers.

    `rounds` are the sweeps before each run of Newton's method, of at most `most_steps`. Sweeps go on from sweeps; each
    second run of Newton's method begins at a point moved at random, by `away` times the mean of its |z_i|, the same for
    each item. `constants` are those of Newton's method: proximal term, halvings, decrease, least proximal term, factor
    where a system is singular.
    `made` gets how many sweeps and Newton's steps an item took, `proved` bounds of the relative residual and of the
    term residual: ∞ where M shows several units or the goal was not reached. Cases that are found end with their linear
    system, where that costs less than the run did.
    """
    blocks, n, m = starts.size - 1, offsets.shape[1], 1
    for k in range(blocks):
        m = max(m, starts[k + 1] - starts[k])
    indptr, indices, data = np.empty(n + 1, np.int32), np.empty(n * n, np.int32), np.empty(n * n)
    by_z, by_w, of_one = np.empty((blocks, m, m)), np.empty((blocks, m, m)), np.empty((4, m))
    b, x, y, before = of_one[0], of_one[1], of_one[2], of_one[3]
    room = by_z, by_w, np.empty((n + 4, n + 1)), np.empty(n, np.int64), x, y
    diagonal, norms, labels = (
        np.empty((blocks, m, m)),
        np.empty((blocks, blocks)),
        np.empty(blocks, np.int64),
    )
    of_blocks, of_rows = np.empty((6, blocks)), np.empty((6, n))
    steps, scale, weights = of_blocks[0], of_blocks[1], of_blocks[3]
    w, R, start, swept, step = of_rows[0], of_rows[1], of_rows[3], of_rows[4], of_rows[5]
    for number in range(item, end_item):
        made[number], proved[number] = 0, np.inf
        z, origin = points[number], origins[number]
        if not gather(
            matrices[number], starts, indptr, indices, data, diagonal, norms, steps, scale
        ):
            continue
        label(norms, labels)
        known = (
            starts,
            slopes[number],
            friction,
            lowers[number],
            uppers[number],
            indptr,
            indices,
            data,
            offsets[number],
            scale,
        )
        if not refer(known, origin, labels, of_blocks, of_rows, z):
            continue
        largest = measure(*known, weights, z, w, R)[0]
        random, newton_steps = 1, 0
        copy(z, swept)
        for turn in range(rounds.size):
            if largest <= goal:
                break
            copy(swept, z)
            for _ in range(rounds[turn]):
                sweep_once(*known[:9], diagonal, steps, z, b, x, y, before)
            made[number, 0] += rounds[turn]
            copy(z, swept)
            if turn % 2:
                total = 0.0
                for i in range(n):
                    total += abs(swept[i])
                spread = 2.0 * away * (total / n)
                for i in range(n):
                    random = (1103515245 * random + 12345) % 2147483648
                    z[i] += spread * (random / 1073741824.0 - 1.0)
            largest, taken = _newton(
                known, weights, goal, most_steps, memory, constants, z, w, R, start, step, room
            )
            newton_steps += taken
        made[number, 1] = newton_steps
        if not largest <= goal:
            continue
        pays = (
            newton_steps > 0 or 3 * made[number, 0] >= n
        )  # a last system costs less than the run did
        for _ in range(LAST_STEPS):
            if largest <= EXACT or not pays:
                break
            copy(z, start)
            epsilon = 0.0
            while epsilon <= LEAST_PROXIMAL and not newton_step(
                known, z, w, R, epsilon, room, step
            ):
                epsilon = max(2.0 * epsilon, LEAST_PROXIMAL)
            if epsilon > LEAST_PROXIMAL:
                break
            made[number, 1] += 1
            for i in range(n):
                z[i] += step[i]
            before_it, largest = largest, measure(*known, weights, z, w, R)[0]
            if not largest < before_it:
                copy(start, z)
                break
        settle(known, origin, labels, of_blocks, of_rows, z, proved[number])
