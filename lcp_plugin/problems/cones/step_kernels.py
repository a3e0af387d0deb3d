"""One compiled loop over the contacts of bodies: sweeps name the cases, Newton's steps solve for them.

A step of Newton, (R_z + R_w (W + ε D)) s = −R with W = J m⁻¹ Jᵀ, is a system over the velocities v of the bodies: with
A = R_z + ε R_w D of each contact, s = −A⁻¹(R + R_w J v) and (m + Jᵀ A⁻¹ R_w J) v = −Jᵀ A⁻¹ R, however many contacts
there are. One factor serves further steps while they gain.
"""

from __future__ import annotations

import numpy as np

from ...core.kernels.compilation import helper, kernel
from ...core.matrix.scaling import BESIDE_DIAGONAL, SPREAD
from .block_factors import (
    column_of,
    eliminate_in_order,
    factor_blocks,
    lay_out,
    link,
    solve_blocks,
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
from .small_kernels import SMALLEST_SCALE, copy, product, put_back, references

WORTH = 0.1  # of the residual: what a step leaves at the most where its factor serves another one
SHORT = 0.3  # a step: sweeps name other cases
AGAIN = 3  # steps more by one factor


@helper
def root_of(labels, i):  # type: ignore[no-untyped-def]
    """Return the first of the set that i is in, and shorten the way there."""
    while labels[i] != i:
        labels[i] = labels[labels[i]]
        i = labels[i]
    return i


@helper
def label_components(indptr, indices, labels):  # type: ignore[no-untyped-def]
    """Give each row the number of the first row of its connected component."""
    for i in range(labels.size):
        labels[i] = i
    for i in range(labels.size):
        for p in range(indptr[i], indptr[i + 1]):
            one, other = root_of(labels, i), root_of(labels, indices[p])
            labels[max(one, other)] = min(one, other)
    for i in range(labels.size):
        labels[i] = root_of(labels, i)


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
def gather_arms(starts, mass_indptr, mass_indices, indptr, indices, data):  # type: ignore[no-untyped-def]
    """Return the bodies behind rows J: unknowns that the mass matrix links, and neighbours that meet the same contacts.

    These are the body of each unknown, its number there, and the sizes of bodies; and the blocks of J: those of a
    contact, which body each is of, where it begins in an array, and that.
    """
    v = mass_indptr.size - 1
    labels, body_of = np.empty(v, np.int64), np.empty(v, np.int64)
    inside, place = np.empty(v, np.int64), np.empty(v, np.int64)
    sizes = np.zeros(v, np.int64)
    label_components(mass_indptr, mass_indices, labels)
    contacts, seen, met, shared = starts.size - 1, np.full(v, -1), np.zeros(v + 1, np.int64), np.zeros(v, np.int64)
    for k in range(contacts):
        for p in range(indptr[starts[k]], indptr[starts[k + 1]]):
            i = indices[p]
            if seen[i] != k:
                seen[i] = k
                met[i] += 1
                shared[i] += i > 0 and seen[i - 1] == k
                if i + 1 < v and seen[i + 1] == k:
                    shared[i + 1] += 1
    for i in range(1, v):
        if 2 * shared[i] > max(met[i], met[i - 1]):
            one, other = root_of(labels, i - 1), root_of(labels, i)
            labels[max(one, other)] = min(one, other)
    bodies = 0
    for i in range(v):
        labels[i] = root_of(labels, i)
    seen[:] = -1
    for i in range(v):
        if labels[i] == i:
            body_of[i] = bodies
            bodies += 1
        else:
            body_of[i] = body_of[labels[i]]
        inside[i] = sizes[body_of[i]]
        sizes[body_of[i]] += 1
    touched = np.zeros(contacts + 1, np.int64)
    at_body, at_arm = np.empty(data.size, np.int64), np.empty(data.size + 1, np.int64)
    count, length = 0, 0
    for k in range(contacts):
        for p in range(indptr[starts[k]], indptr[starts[k + 1]]):
            body = body_of[indices[p]]
            if seen[body] != k:
                seen[body], at_body[count], at_arm[count] = k, body, length
                count, length = count + 1, length + sizes[body] * (starts[k + 1] - starts[k])
        touched[k + 1] = count
    at_arm[count] = length
    arms = np.zeros(length)
    for k in range(contacts):
        for at in range(touched[k], touched[k + 1]):
            place[at_body[at]] = at_arm[at]
        for i in range(starts[k], starts[k + 1]):
            for p in range(indptr[i], indptr[i + 1]):
                body = body_of[indices[p]]
                arms[place[body] + (i - starts[k]) * sizes[body] + inside[indices[p]]] = data[p]
    return body_of, inside, sizes[:bodies], touched, at_body, at_arm, arms


@helper
def structure_of(links, nodes, sizes):  # type: ignore[no-untyped-def]
    """Return the place of each node in the elimination, and the panels' structure."""
    place, degrees, near = np.empty(nodes, np.int64), np.empty(nodes, np.int64), np.empty(nodes + 64, np.int64)
    total = eliminate_in_order(links, nodes, place, degrees, near)
    begins, later, columns = np.empty(nodes + 1, np.int64), np.empty(total, np.int64), np.empty(total, np.int64)
    widths, panels, firsts = np.empty(nodes, np.int64), np.empty(nodes + 1, np.int64), np.empty(nodes + 1, np.int64)
    lay_out(links, nodes, place, sizes, begins, later, columns, widths, panels, firsts, near)
    return place, begins, later, columns, widths, panels, firsts


@helper
def invert(A, size, inverse):  # type: ignore[no-untyped-def]
    """Write the inverse of A, which is overwritten, by elimination with pivots."""
    for i in range(size):
        for j in range(size):
            inverse[i, j] = 1.0 if i == j else 0.0
    for p in range(size):
        best = p
        for i in range(p + 1, size):
            best = i if abs(A[i, p]) > abs(A[best, p]) else best
        for j in range(size):
            A[p, j], A[best, j] = A[best, j], A[p, j]
            inverse[p, j], inverse[best, j] = inverse[best, j], inverse[p, j]
        pivot = A[p, p]
        for j in range(size):
            A[p, j], inverse[p, j] = A[p, j] / pivot, inverse[p, j] / pivot
        for i in range(size):
            if i != p:
                factor = A[i, p]
                for j in range(size):
                    A[i, j] -= factor * A[p, j]
                    inverse[i, j] -= factor * inverse[p, j]


@helper
def factor_of_bodies(  # type: ignore[no-untyped-def]
    mass, bodies, is_free, by_speed, structure, U, L, targets, total
):
    """Write m + Jᵀ A⁻¹ R_w J and factor it; return whether that was possible."""
    mass_indptr, mass_indices, mass_data = mass
    body_of, inside, sizes, touched, at_body, at_arm, arms = bodies
    place, begins, later, columns, widths, panels, _, own = structure
    U[:], L[:] = 0.0, 0.0
    for i in range(body_of.size):
        for p in range(mass_indptr[i], mass_indptr[i + 1]):
            where = place[body_of[i]]
            U[panels[where] + inside[i] * widths[where] + inside[mass_indices[p]]] += mass_data[p]
    m = by_speed.shape[1]
    for k in range(is_free.size):
        if not is_free[k]:
            continue
        for one in range(touched[k], touched[k + 1]):
            width, arm = sizes[at_body[one]], at_arm[one]
            for r in range(width):
                for i in range(m):
                    value = 0.0
                    for j in range(m):
                        value += arms[arm + j * width + r] * by_speed[k, j, i]
                    total[r * m + i] = value
            for other in range(touched[k], touched[k + 1]):
                p, q, long, reach = place[at_body[one]], place[at_body[other]], sizes[at_body[other]], at_arm[other]
                if p <= q:
                    first = panels[p] + column_of(p, q, begins, later, columns)
                    panel, down, along = U, widths[p], 1
                else:
                    first = panels[q] + column_of(q, p, begins, later, columns)
                    panel, down, along = L, 1, widths[q]
                for r in range(width):
                    for c in range(long):
                        value = 0.0
                        for i in range(m):
                            value += total[r * m + i] * arms[reach + i * long + c]
                        panel[first + r * down + c * along] += value
    return factor_blocks(sizes.size, own, begins, later, columns, widths, panels, U, L, targets, total)


@helper
def step_of_bodies(starts, bodies, structure, U, L, inverse, by_speed, R, x, step):  # type: ignore[no-untyped-def]
    """Write the step that the factor gives for the residual R."""
    _, _, sizes, touched, at_body, at_arm, arms = bodies
    place, begins, later, columns, widths, panels, firsts, own = structure
    x[:] = 0.0
    for k in range(starts.size - 1):
        first, m = starts[k], starts[k + 1] - starts[k]
        for i in range(m):
            value = 0.0
            for j in range(m):
                value -= inverse[k, i, j] * R[first + j]
            step[first + i] = value
        for at in range(touched[k], touched[k + 1]):
            width, here = sizes[at_body[at]], firsts[place[at_body[at]]]
            for i in range(m):
                for r in range(width):
                    x[here + r] += arms[at_arm[at] + i * width + r] * step[first + i]
    solve_blocks(sizes.size, own, begins, later, columns, widths, panels, firsts, U, L, x)
    for k in range(starts.size - 1):
        first, m = starts[k], starts[k + 1] - starts[k]
        for at in range(touched[k], touched[k + 1]):
            width, here = sizes[at_body[at]], firsts[place[at_body[at]]]
            for j in range(m):
                speed = 0.0
                for r in range(width):
                    speed += arms[at_arm[at] + j * width + r] * x[here + r]
                for i in range(m):
                    step[first + i] -= by_speed[k, i, j] * speed


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
def structure_of_bodies(bodies, is_free):  # type: ignore[no-untyped-def]
    """Return the structure of the system of bodies that share a contact that is not open."""
    _, _, sizes, touched, at_body, _, _ = bodies
    links = np.zeros((sizes.size, (sizes.size + 63) // 64), np.uint64)
    for k in range(is_free.size):
        if is_free[k]:
            for one in range(touched[k], touched[k + 1]):
                for other in range(touched[k], one):
                    link(links, at_body[one], at_body[other])
    own = sizes.copy()
    place, begins, later, columns, widths, panels, firsts = structure_of(links, sizes.size, own)
    return place, begins, later, columns, widths, panels, firsts, own


@helper
def _newton(known, mass, bodies, weights, goal, shortest, most_steps, constants, z, w, R, memory):  # type: ignore[no-untyped-def]
    """Take Newton's steps to the goal, or until one is `shortest`; return the largest residual and how many.

    While a step leaves little of the residual its factor serves another one.
    """
    starts, slope, friction, lower, upper, indptr, indices, data, _, scale = known
    proximal, halvings, decrease, least_proximal, harder, easier = constants
    m, n, blocks = 1, z.size, slope.size
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
    structure = structure_of_bodies(bodies, was_free)
    U, L, targets, total = np.empty(0), np.empty(0), np.empty(0, np.int64), np.empty(0)
    is_new, made, widest = True, 0, proximal
    while made < most_steps and largest > goal and size < np.inf:
        epsilon, is_found = max(min(widest, 0.1 * largest), least_proximal), False
        while epsilon <= 1.0 and not is_found:
            is_found = prepare_step(known, bodies, z, w, epsilon, x, way, by_z, by_w, inverse, by_speed, is_free)
            for k in range(blocks):
                is_new = is_new or is_free[k] != was_free[k]
                was_free[k] = is_free[k]
            if is_new:
                structure = structure_of_bodies(bodies, is_free)
                widths, panels, own = structure[4], structure[5], structure[7]
                U, L = np.empty(panels[own.size]), np.empty(panels[own.size])
                longest = 0
                for p in range(own.size):
                    longest = max(longest, widths[p], own[p] * m)
                targets, total, is_new = np.empty(longest, np.int64), np.empty(longest), False
            is_found = is_found and factor_of_bodies(mass, bodies, is_free, by_speed, structure, U, L, targets, total)
            if not is_found:
                epsilon = harder * epsilon
        if not is_found:
            return largest, made
        made += 1
        for again in range(AGAIN + 1):
            step_of_bodies(starts, bodies, structure, U, L, inverse, by_speed, R, speeds, step)
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

    After sweeps Newton's method ends where a step is short, without them it goes on.

    `made` gets how many sweeps and Newton's steps it took, `proved` bounds of the relative residual and of the term
    residual: ∞ where M shows several units or the goal was not reached.
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
        shortest = SHORT if rounds[turn] else 0.0
        largest, taken = _newton(known, mass, bodies, weights, goal, shortest, most_steps, constants, z, w, R, memory)
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
