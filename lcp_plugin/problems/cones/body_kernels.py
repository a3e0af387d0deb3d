"""The linear systems of contacts over the velocities of their bodies, compiled.

With D a block of each contact and W = J m⁻¹ Jᵀ, (W + D) s = −R says s = −D⁻¹(R + J v) and (m + Jᵀ D⁻¹ J) v = −Jᵀ D⁻¹ R,
v the velocities of the bodies: six unknowns a body, however many contacts there are.
"""

from __future__ import annotations

import numpy as np

from ...core.kernels.compilation import helper
from .block_factors import (
    column_of,
    eliminate_in_order,
    factor_blocks,
    lay_out,
    link,
    solve_blocks,
)


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
    contacts, seen, met, shared = (
        starts.size - 1,
        np.full(v, -1),
        np.zeros(v + 1, np.int64),
        np.zeros(v, np.int64),
    )
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
    place, degrees, near = (
        np.empty(nodes, np.int64),
        np.empty(nodes, np.int64),
        np.empty(nodes + 64, np.int64),
    )
    total = eliminate_in_order(links, nodes, place, degrees, near)
    begins, later, columns = (
        np.empty(nodes + 1, np.int64),
        np.empty(total, np.int64),
        np.empty(total, np.int64),
    )
    widths, panels, firsts = (
        np.empty(nodes, np.int64),
        np.empty(nodes + 1, np.int64),
        np.empty(nodes + 1, np.int64),
    )
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
    mass, bodies, is_free, by_speed, structure, room
):
    """Write m + Jᵀ A⁻¹ R_w J and factor it; return whether that was possible."""
    mass_indptr, mass_indices, mass_data = mass
    body_of, inside, sizes, touched, at_body, at_arm, arms = bodies
    place, begins, later, columns, widths, panels, _, own = structure
    U, L, targets, total = room
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
                p, q, long, reach = (
                    place[at_body[one]],
                    place[at_body[other]],
                    sizes[at_body[other]],
                    at_arm[other],
                )
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
    return factor_blocks(
        sizes.size, own, begins, later, columns, widths, panels, U, L, targets, total
    )


@helper
def step_of_bodies(starts, bodies, structure, room, inverse, by_speed, R, x, step):  # type: ignore[no-untyped-def]
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
    solve_blocks(
        sizes.size, own, begins, later, columns, widths, panels, firsts, room[0], room[1], x
    )
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
def structure_of_bodies(bodies, is_free, m):  # type: ignore[no-untyped-def]
    """Return the structure of the system of bodies that share a contact that is_free, of m rows each, and its room."""
    _, _, sizes, touched, at_body, _, _ = bodies
    links = np.zeros((sizes.size, (sizes.size + 63) // 64), np.uint64)
    for k in range(is_free.size):
        if is_free[k]:
            for one in range(touched[k], touched[k + 1]):
                for other in range(touched[k], one):
                    link(links, at_body[one], at_body[other])
    own, longest = sizes.copy(), 0
    place, begins, later, columns, widths, panels, firsts = structure_of(links, sizes.size, own)
    for p in range(own.size):
        longest = max(longest, widths[p], own[p] * m)
    length = panels[own.size]
    room = np.empty(length), np.empty(length), np.empty(longest, np.int64), np.empty(longest)
    return (place, begins, later, columns, widths, panels, firsts, own), room
