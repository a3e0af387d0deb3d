"""One compiled loop over the contacts of bodies: sweeps name the cases, Newton's steps solve for them.

A step of Newton, (R_z + R_w (W + ε D)) s = −R with W = J m⁻¹ Jᵀ, is a system over the velocities v of the bodies: with
A = R_z + ε R_w D of each contact, s = −A⁻¹(R + R_w J v) and (m + Jᵀ A⁻¹ R_w J) v = −Jᵀ A⁻¹ R, however many contacts
there are. One factor serves further steps while they gain. Where a step is short the impulses that make the motion are
many, and a central path leads to the middle of them.
"""

from __future__ import annotations

import numpy as np

from ...core.kernels.compilation import helper, kernel
from ...core.matrix.scaling import BESIDE_DIAGONAL, SPREAD
from .body_kernels import (
    factor_of_bodies,
    gather_arms,
    invert,
    label_components,
    step_of_bodies,
    structure_of_bodies,
)
from .kernels import (
    OUTWARD,
    block_bounds,
    block_derivative,
    count_blocks,
    fill_blocks,
    measure,
    measure_at,
    own_terms,
    project,
    sweep_once,
)
from .methods import EXACT, GAIN
from .path_kernels import begin_path, follow_path
from .small_kernels import SMALLEST_SCALE, copy, product, put_back, references

WORTH = 0.1  # of the residual: what a step leaves at the most where its factor serves another one
SHORT = 0.3  # a step: sweeps name other cases
NEAR, NEARER = 1e-3, 0.01  # the residual from where Newton's steps follow a path; times that where these fail
# Newton's steps there, those of a path, and Newton's before it: numba compiles once more for a plain 8 or 30.
NEWTON_NEAR, PATH_STEPS, FEW = np.int64(8), np.int64(30), np.int64(12)
WARM, FURTHER = 0.01, 10.0  # of a start from nothing, added to what a path begins near; times that of the next path
AGAIN = 3  # steps more by one factor


@helper
def scale_blocks(starts, begins, others, norms, closed_indptr, closed, diagonal, steps, scale):  # type: ignore[no-untyped-def]
    """Write the diagonal blocks, 1/‖M_kk‖, and d; return whether M is in one unit."""
    largest, least, shows_none = 0.0, np.inf, True
    for k in range(scale.size):
        first, end, before = starts[k], starts[k + 1], 0
        size, row, own = end - first, 0.0, 0.0
        for at in range(begins[k], begins[k + 1]):
            row = max(row, abs(norms[at]))
            if others[at] < k:
                before += starts[others[at] + 1] - starts[others[at]]
            if others[at] == k:
                own = norms[at]
        total = 0.0
        for i in range(size):
            for j in range(size):
                diagonal[k, i, j] = closed[closed_indptr[first + i] + before + j]
                total += diagonal[k, i, j] ** 2
        steps[k] = 1.0 / np.sqrt(total) if total > 0.0 else 0.0
        scale[k] = own if own >= SMALLEST_SCALE * row and own > 0.0 else row if row > 0.0 else 1.0
        largest, least = max(largest, row), min(least, abs(own))
        shows_none = shows_none and row * 2.0**-BESIDE_DIAGONAL <= abs(own)
    return shows_none or largest * 2.0**-SPREAD <= least


@helper
def prepare_step(  # type: ignore[no-untyped-def]
    known, bodies, z, w, epsilon, x, way, by_z, by_w, inverse, by_speed, is_free
):
    """Write A⁻¹ and A⁻¹ R_w of each contact, and which are not open; return whether all are finite."""
    starts, slope, friction, lower, upper, _, _, _, _, scale = known
    m, is_finite = by_z.shape[1], True
    for k in range(slope.size):
        block_derivative(k, starts, slope, friction, lower, upper, z, w, scale, x, way, by_z[k], by_w[k])
        is_free[k] = False
        for i in range(m):
            for j in range(m):
                is_free[k] = is_free[k] or by_w[k, i, j] != 0.0
                by_z[k, i, j] += epsilon * scale[k] * by_w[k, i, j]
        invert(by_z[k], m, inverse[k])
        for i in range(m):
            for j in range(m):
                value = 0.0
                for c in range(m):
                    value += inverse[k, i, c] * by_w[k, c, j]
                by_speed[k, i, j] = value
                is_finite = is_finite and abs(value) < np.inf
    return is_finite


@helper
def _newton(known, mass, bodies, weights, goal, shortest, most_steps, constants, z, w, R, memory):  # type: ignore[no-untyped-def]
    """Take Newton's steps to the goal, or until one is `shortest`; return the largest residual and how many.

    While a step leaves little of the residual its factor serves another one.
    """
    starts, slope, friction, lower, upper, indptr, indices, data, _, scale = known
    proximal, halvings, decrease, least_proximal, harder, easier = constants
    m, n, blocks = np.int64(1), z.size, slope.size
    for k in range(blocks):
        m = max(m, starts[k + 1] - starts[k])
    room_of_blocks = np.empty((4, blocks, m, m))
    by_z, by_w, inverse, by_speed = room_of_blocks[0], room_of_blocks[1], room_of_blocks[2], room_of_blocks[3]
    is_free, was_free = np.empty(blocks, np.bool_), np.zeros(blocks, np.bool_)
    x, way, speeds = np.empty(m), np.empty(m), np.empty(bodies[0].size)
    room = np.empty((4, n))
    start, step, at_start, along = room[0], room[1], room[2], room[3]
    largest, size = measure(*known, weights, z, w, R)
    sizes = np.full(memory, size)
    structure, factor = structure_of_bodies(bodies, was_free, m)
    is_new, made, widest = True, 0, proximal
    while made < most_steps and largest > goal and size < np.inf:
        epsilon, is_found = max(min(widest, 0.1 * largest), least_proximal), False
        while epsilon <= 1.0 and not is_found:
            is_found = prepare_step(known, bodies, z, w, epsilon, x, way, by_z, by_w, inverse, by_speed, is_free)
            for k in range(blocks):
                is_new = is_new or is_free[k] != was_free[k]
                was_free[k] = is_free[k]
            if is_new:
                structure, factor = structure_of_bodies(bodies, is_free, m)
                is_new = False
            is_found = is_found and factor_of_bodies(mass, bodies, is_free, by_speed, structure, factor)
            if not is_found:
                epsilon = harder * epsilon
        if not is_found:
            return largest, made
        made += 1
        for again in range(AGAIN + 1):
            step_of_bodies(starts, bodies, structure, factor, inverse, by_speed, R, speeds, step)
            length, allowed, before = 1.0, size, size
            for earlier in sizes:
                allowed = max(allowed, earlier)
            if again:
                allowed = WORTH * size
            for i in range(n):
                start[i], at_start[i], along[i] = z[i], w[i], 0.0
                for p in range(indptr[i], indptr[i + 1]):
                    along[i] += data[p] * step[indices[p]]
            for _ in range(1 if again else halvings):
                for i in range(n):
                    z[i], w[i] = start[i] + length * step[i], at_start[i] + length * along[i]
                largest, size = measure_at(starts, slope, friction, lower, upper, scale, weights, z, w, R)
                if size <= (1.0 - decrease * length) * allowed:
                    break
                length *= 0.5
            if again and length < 1.0:  # another factor takes it from where it was
                copy(start, z)
            largest, size = measure(*known, weights, z, w, R)
            if again and length < 1.0:
                break
            sizes[made % sizes.size] = size
            if not size <= WORTH * before or largest <= EXACT:
                break
        if length < shortest and not again:
            break
        if length < 1.0 and not again:
            widest = proximal
        elif size > GAIN * before:
            widest = easier * epsilon
    return largest, made


@kernel
def solve_step(  # type: ignore[no-untyped-def]
    starts, slope, friction, lower, upper, indptr, indices, data, q, origin, mass_indptr, mass_indices,
    mass_data, J_indptr, J_indices, J_data, goal, rounds, most_steps, memory, constants, z, made, proved
):
    """Solve the contacts of bodies from z, which gets the answer: sweeps, then steps of Newton's method, in turns.

    At first Newton's method ends where a step is short; without sweeps it goes on, for a FEW steps but in the last
    turn. Later sweeps are followed by the central path, and Newton's steps from near its end.

    `made` gets how many sweeps, Newton's steps and steps of the path it took, `proved` bounds of the relative residual
    and of the term residual: ∞ where M shows several units or the goal was not reached.
    """
    blocks, n = slope.size, q.size
    of_row = np.empty(n, np.int64)
    for k in range(blocks):
        of_row[starts[k]:starts[k + 1]] = k
    begins, closed_indptr = np.empty(blocks + 1, indices.dtype), np.empty(n + 1, indices.dtype)
    count_blocks(starts, of_row, indptr, indices, begins, closed_indptr)
    others, norms = np.empty(begins[blocks], indices.dtype), np.empty(begins[blocks])
    closed_indices, closed = np.empty(closed_indptr[n], indices.dtype), np.empty(closed_indptr[n])
    fill_blocks(starts, of_row, indptr, indices, data, begins, others, norms, closed_indptr, closed_indices, closed)
    m = 1
    for k in range(blocks):
        m = max(m, starts[k + 1] - starts[k])
    diagonal, labels = np.empty((blocks, m, m)), np.empty(blocks, np.int64)
    of_blocks, of_rows, of_one = np.empty((6, blocks)), np.empty((6, n)), np.empty((4, m))
    steps, scale, reference = of_blocks[0], of_blocks[1], of_blocks[2]
    weights, least, most = of_blocks[3], of_blocks[4], of_blocks[5]
    if not scale_blocks(starts, begins, others, norms, closed_indptr, closed, diagonal, steps, scale):
        return
    label_components(begins, others, labels)
    w, R, slip, start, swept, terms = of_rows[0], of_rows[1], of_rows[2], of_rows[3], of_rows[4], of_rows[5]
    copy(origin, swept)
    product(closed_indptr, closed_indices, closed, q, swept, w, slip)
    if not references(
        starts, slope, friction, lower, upper, swept, w, slip, scale, labels, R, least, most, reference, weights
    ):
        return
    put_back(starts, weights, origin, z)
    known = starts, slope, friction, lower, upper, closed_indptr, closed_indices, closed, q, scale
    mass = mass_indptr, mass_indices, mass_data
    bodies = gather_arms(starts, mass_indptr, mass_indices, J_indptr, J_indices, J_data)
    b, x, y, before = of_one[0], of_one[1], of_one[2], of_one[3]
    largest = measure(*known, weights, z, w, R)[0]
    path, share = np.empty((2, blocks, m)), WARM
    for turn in range(rounds.size):
        if largest <= goal:
            break
        if rounds[turn]:
            project(starts, slope, lower, upper, z)
        for _ in range(rounds[turn]):
            sweep_once(
                starts, slope, friction, lower, upper, closed_indptr, closed_indices, closed, q, diagonal, steps, z, b,
                x, y, before
            )
        made[0] += rounds[turn]
        if turn and rounds[turn]:
            measure(*known, weights, z, w, R)
            begin_path(starts, slope, q, scale, share, z, w, path[0], path[1])
            copy(z, swept)
            near, left, largest = NEAR, PATH_STEPS, np.inf
            while left > 0 and largest > goal:
                largest, taken = follow_path(known, mass, bodies, weights, near, left, path[0], path[1], z, w, R)
                left, made[2] = left - taken, made[2] + taken
                if not largest <= near:
                    break
                copy(z, swept)
                largest, taken = _newton(
                    known, mass, bodies, weights, goal, SHORT, NEWTON_NEAR, constants, z, w, R, memory
                )
                near, made[1] = NEARER * near, made[1] + taken
            share = FURTHER * share
            if largest > goal:
                copy(swept, z)
            continue
        shortest, allowed = 0.0 if turn else SHORT, FEW if 0 < turn < rounds.size - 1 else most_steps
        largest, taken = _newton(known, mass, bodies, weights, goal, shortest, allowed, constants, z, w, R, memory)
        made[1] += taken
    if largest <= goal:
        put_back(starts, weights, origin, z)
        project(starts, slope, lower, upper, z)
        product(closed_indptr, closed_indices, closed, q, z, w, slip)
        own_terms(
            starts, slope, friction, lower, upper, closed_indptr, closed_indices, closed, q, scale, labels, z, w, start,
            terms, R, swept, least, most, weights,
        )
        proved[0] = proved[1] = 0.0
        for k in range(blocks):
            most[k] = block_bounds(k, starts, slope, friction, lower, upper, z, w, slip, scale, R)[1]
            if most[k] > 0.0:
                proved[0] = max(proved[0], OUTWARD * most[k] / reference[k])
                proved[1] = max(proved[1], weights[k])
