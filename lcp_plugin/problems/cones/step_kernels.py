"""One compiled loop over the contacts of bodies: sweeps name the cases, Newton's steps solve for them.

A step of Newton, (R_z + R_w (W + ε D)) s = −R with W = J m⁻¹ Jᵀ, is a system over the velocities v of the bodies: with
A = R_z + ε R_w D of each contact, s = −A⁻¹(R + R_w J v) and (m + Jᵀ A⁻¹ R_w J) v = −Jᵀ A⁻¹ R, however many contacts
there are. One factor serves further steps while they gain. Where they do not halve the residual the impulses that make
the motion are many, and a central path leads to the middle of them.
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
    block_derivative,
    count_blocks,
    fill_blocks,
    measure,
    measure_at,
    project,
    sweep,
)
from .methods import EXACT, GAIN
from .path_kernels import begin_path, follow_path
from .small_kernels import SMALLEST_SCALE, copy, refer, settle

WORTH = 0.1  # of the residual: what a step leaves at the most where its factor serves another one
HALVES = 4  # steps of Newton's method that halve the residual, or are its last
NEAR, NEARER = (
    1e-3,
    0.01,
)  # the residual from where Newton's steps follow a path; times that where these fail
NEWTON_NEAR, PATH_STEPS = (
    np.int64(8),
    np.int64(30),
)  # steps of both; numba compiles once more for a plain 8 or 30
SHARES = (
    0.01,
    0.1,
    0.001,
    0.01,
    1.0,
)  # of a start from nothing, added to what each path begins near
FROM_NOTHING = 1  # which of them begins near no impulse, not near what sweeps have left
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
def begin(starts, slope, friction, lower, upper, indptr, indices, data, q, origin, z):  # type: ignore[no-untyped-def]
    """Return whether M is in one unit and references are known; what runs know, and room for them.

    These are the blocks with M closed and d, the diagonal blocks, components, and six arrays of blocks and six of rows:
    1/‖M_kk‖, d, references, weights and two for bounds; w, R, the rounding of w and three others.
    """
    blocks, n, m = slope.size, q.size, np.int64(1)
    of_row = np.empty(n, np.int64)
    for k in range(blocks):
        m = max(m, starts[k + 1] - starts[k])
        for i in range(starts[k], starts[k + 1]):
            of_row[i] = k
    begins, closed_indptr = np.empty(blocks + 1, indices.dtype), np.empty(n + 1, indices.dtype)
    count_blocks(starts, of_row, indptr, indices, begins, closed_indptr)
    others, norms = np.empty(begins[blocks], indices.dtype), np.empty(begins[blocks])
    closed_indices, closed = np.empty(closed_indptr[n], indices.dtype), np.empty(closed_indptr[n])
    fill_blocks(
        starts,
        of_row,
        indptr,
        indices,
        data,
        begins,
        others,
        norms,
        closed_indptr,
        closed_indices,
        closed,
    )
    diagonal, labels = np.empty((blocks, m, m)), np.empty(blocks, np.int64)
    of_blocks, of_rows = np.empty((6, blocks)), np.empty((6, n))
    is_known = scale_blocks(
        starts, begins, others, norms, closed_indptr, closed, diagonal, of_blocks[0], of_blocks[1]
    )
    known = (
        starts,
        slope,
        friction,
        lower,
        upper,
        closed_indptr,
        closed_indices,
        closed,
        q,
        of_blocks[1],
    )
    if is_known:
        label_components(begins, others, labels)
        is_known = refer(known, origin, labels, of_blocks, of_rows, z)
    return is_known, known, diagonal, labels, of_blocks, of_rows


@helper
def prepare_step(  # type: ignore[no-untyped-def]
    known, bodies, z, w, epsilon, x, way, by_z, by_w, inverse, by_speed, is_free
):
    """Write A⁻¹ and A⁻¹ R_w of each contact, and which are not open; return whether all are finite."""
    starts, slope, friction, lower, upper, _, _, _, _, scale = known
    m, is_finite = by_z.shape[1], True
    for k in range(slope.size):
        block_derivative(
            k, starts, slope, friction, lower, upper, z, w, scale, x, way, by_z[k], by_w[k]
        )
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
def _newton(known, mass, bodies, weights, goal, most_steps, constants, z, w, R, memory):  # type: ignore[no-untyped-def]
    """Take Newton's steps to the goal, or until HALVES do not halve the residual; return the largest and how many.

    While a step leaves little of the residual its factor serves another one.
    """
    starts, slope, friction, lower, upper, indptr, indices, data, _, scale = known
    proximal, halvings, decrease, least_proximal, harder, easier = constants
    m, n, blocks = np.int64(1), z.size, slope.size
    for k in range(blocks):
        m = max(m, starts[k + 1] - starts[k])
    room_of_blocks = np.empty((4, blocks, m, m))
    by_z, by_w, inverse, by_speed = (
        room_of_blocks[0],
        room_of_blocks[1],
        room_of_blocks[2],
        room_of_blocks[3],
    )
    is_free, was_free = np.empty(blocks, np.bool_), np.zeros(blocks, np.bool_)
    x, way, speeds = np.empty(m), np.empty(m), np.empty(bodies[0].size)
    room = np.empty((4, n))
    start, step, at_start, along = room[0], room[1], room[2], room[3]
    largest, size = measure(*known, weights, z, w, R)
    sizes = np.full(memory, size)
    structure, factor = structure_of_bodies(bodies, was_free, m)
    is_new, made, widest, half, since = True, 0, proximal, 0.5 * size, 0
    while made < most_steps and largest > goal and size < np.inf:
        epsilon, is_found = max(min(widest, 0.1 * largest), least_proximal), False
        while epsilon <= 1.0 and not is_found:
            is_found = prepare_step(
                known, bodies, z, w, epsilon, x, way, by_z, by_w, inverse, by_speed, is_free
            )
            for k in range(blocks):
                is_new = is_new or is_free[k] != was_free[k]
                was_free[k] = is_free[k]
            if is_new:
                structure, factor = structure_of_bodies(bodies, is_free, m)
                is_new = False
            is_found = is_found and factor_of_bodies(
                mass, bodies, is_free, by_speed, structure, factor
            )
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
                largest, size = measure_at(
                    starts, slope, friction, lower, upper, scale, weights, z, w, R
                )
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
        half, since = (0.5 * size, 0) if size <= half else (half, since + 1)
        if since == HALVES:
            break
        if length < 1.0 and not again:
            widest = proximal
        elif size > GAIN * before:
            widest = easier * epsilon
    return largest, made


@kernel
def solve_step(  # type: ignore[no-untyped-def]
    starts,
    slope,
    friction,
    lower,
    upper,
    indptr,
    indices,
    data,
    q,
    origin,
    mass_indptr,
    mass_indices,
    mass_data,
    J_indptr,
    J_indices,
    J_data,
    goal,
    rounds,
    most_steps,
    memory,
    constants,
    z,
    made,
    proved,
):
    """Solve the contacts of bodies from z, which gets the answer: sweeps and Newton's method, sweeps and central paths.

    `rounds` are the sweeps before Newton's method and before each path, near whose end Newton's steps follow.

    `made` gets how many sweeps, Newton's steps and steps of the path it took, `proved` bounds of the relative residual
    and of the term residual: ∞ where M shows several units or the goal was not reached.
    """
    is_known, known, diagonal, labels, of_blocks, of_rows = begin(
        starts, slope, friction, lower, upper, indptr, indices, data, q, origin, z
    )
    if not is_known:
        return
    blocks, m = slope.size, diagonal.shape[1]
    steps, scale, weights = of_blocks[0], of_blocks[1], of_blocks[3]
    w, R, swept = of_rows[0], of_rows[1], of_rows[4]
    mass = mass_indptr, mass_indices, mass_data
    bodies = gather_arms(starts, mass_indptr, mass_indices, J_indptr, J_indices, J_data)
    x, y = np.empty((blocks, m)), np.empty((blocks, m))
    largest = measure(*known, weights, z, w, R)[0]
    if largest > goal:
        project(starts, slope, lower, upper, z)
        sweep(*known[:9], diagonal, steps, z, rounds[0])
        largest, made[1] = _newton(
            known, mass, bodies, weights, goal, most_steps, constants, z, w, R, memory
        )
        made[0] = rounds[0]
    if largest > goal:
        project(starts, slope, lower, upper, z)
        copy(z, swept)
    for path in range(len(SHARES)):
        if largest <= goal:
            break
        if path == FROM_NOTHING:
            copy(origin, z)
        else:
            copy(swept, z)
            sweep(*known[:9], diagonal, steps, z, rounds[path + 1])
            copy(z, swept)
            made[0] += rounds[path + 1]
        largest = measure(*known, weights, z, w, R)[0]
        begin_path(starts, slope, q, scale, SHARES[path], z, w, x, y)
        near, left = NEAR, PATH_STEPS
        while left > 0 and largest > goal:
            largest, taken = follow_path(known, mass, bodies, weights, near, left, x, y, z, w, R)
            left, made[2] = left - taken, made[2] + taken
            if not largest <= near:
                break
            largest, taken = _newton(
                known, mass, bodies, weights, goal, NEWTON_NEAR, constants, z, w, R, memory
            )
            near, made[1] = NEARER * near, made[1] + taken
    if largest <= goal:
        settle(known, origin, labels, of_blocks, of_rows, z, proved)
