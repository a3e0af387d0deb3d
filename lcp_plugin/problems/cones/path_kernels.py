"""The central path of contacts of bodies, compiled, from near a point that sweeps have left.

It is that of :mod:`~lcp_plugin.problems.cones.central_path`: with x = S r and y = S⁻¹û, S = diag(μ, 1, 1), steps with
the scaling of Nesterov and Todd go to x ∘ y = σ e and û − μ‖û_T‖ e_N = W r + b. A step is a factor of W + G S H S over
the velocities of bodies. σ falls no faster than the square of what is left of the motion, whose linearisation a
complementarity that is ahead of it makes useless.
"""

from __future__ import annotations

import numpy as np

from ...core.kernels.compilation import helper
from .body_kernels import factor_of_bodies, invert, step_of_bodies, structure_of_bodies
from .central_path import LEAST_SLOPE, TO_THE_BOUNDARY
from .kernels import FIRST, measure_at, project, tangent_of, velocities

REGULAR = 1e-10  # of d, in the blocks of a system
SHORT, JAMMED = 0.1, 4  # a step; so many in turn lead nowhere


@helper
def begin_path(starts, slope, q, scale, share, z, w, x, y):  # type: ignore[no-untyped-def]
    """Write the point x, y where a path begins: impulses z, velocities w and a share of a start from nothing."""
    speed = 0.0
    for i in range(q.size):
        speed = max(speed, abs(q[i]))
    for k in range(slope.size):
        first, mu = starts[k], max(slope[k], LEAST_SLOPE)
        slip = tangent_of(w, first, starts[k + 1])
        for i in range(x.shape[1]):
            x[k, i], y[k, i] = z[first + i], w[first + i]
        x[k, 0] = mu * z[first] + share * speed / scale[k]
        y[k, 0] = max(w[first], 0.0) / mu + slip + share * speed


@helper
def _scale(x, y, H, root):  # type: ignore[no-untyped-def]
    """Write the symmetric H with H x = y, a quadratic representation, and its root."""
    m, x_tangent, y_tangent, total = (
        x.size,
        tangent_of(x, FIRST, x.size),
        tangent_of(y, FIRST, x.size),
        1.0,
    )
    of_x = np.sqrt((x[0] - x_tangent) * (x[0] + x_tangent))
    of_y = np.sqrt((y[0] - y_tangent) * (y[0] + y_tangent))
    for i in range(m):
        total += x[i] / of_x * y[i] / of_y
    for i in range(m):
        H[0, i] = (y[i] / of_y + (x[i] if i == 0 else -x[i]) / of_x) / np.sqrt(2.0 * total)
        root[0, i] = H[0, i] + (1.0 if i == 0 else 0.0)
    ratio, half = of_y / of_x, 1.0 / np.sqrt(2.0 * root[0, 0])
    for i in range(m):
        root[0, i] *= half
    for i in range(m - 1, -1, -1):
        for j in range(m - 1, -1, -1):
            mirror = (1.0 if i == 0 else -1.0) if i == j else 0.0
            H[i, j] = ratio * (2.0 * H[0, i] * H[0, j] - mirror)
            root[i, j] = np.sqrt(ratio) * (2.0 * root[0, i] * root[0, j] - mirror)


@helper
def longest(x, dx, y, dy):  # type: ignore[no-untyped-def]
    """Return the largest t for which x + t dx and y + t dy are in the cones."""
    t = np.inf
    for k in range(2 * x.shape[0]):
        a, d = (x[k // 2], dx[k // 2]) if k % 2 else (y[k // 2], dy[k // 2])
        of_a, of_d, b = tangent_of(a, FIRST, a.size), tangent_of(d, FIRST, a.size), a[0] * d[0]
        for i in range(1, a.size):
            b -= a[i] * d[i]
        square, rest = (d[0] - of_d) * (d[0] + of_d), (a[0] - of_a) * (a[0] + of_a)
        inner = b * b - square * rest
        if d[0] < 0.0:
            t = min(t, -a[0] / d[0])
        if inner >= 0.0:
            larger = -(b + (np.sqrt(inner) if b >= 0.0 else -np.sqrt(inner)))
            if larger * square > 0.0:
                t = min(t, larger / square)
            if larger > 0.0:
                t = min(t, rest / larger)
    return t


@helper
def follow_path(known, mass, bodies, weights, near, most_steps, x, y, z, w, R):  # type: ignore[no-untyped-def]
    """Take steps to a point z near the end of the path, or until they jam; return the largest residual and how many."""
    starts, slope, friction, lower, upper, indptr, indices, data, q, scale = known
    blocks, m = x.shape
    by_contact, of_rows, of_one = (
        np.empty((6, blocks, m)),
        np.empty((2, q.size)),
        np.empty((2, m, m)),
    )
    dx, dy, c, at, moved, slip = (
        by_contact[0],
        by_contact[1],
        by_contact[2],
        by_contact[3],
        by_contact[4],
        by_contact[5],
    )
    left, step, D, right, speeds = (
        of_rows[0],
        of_rows[1],
        of_one[0],
        of_one[1, 0],
        np.empty(bodies[0].size),
    )
    scalings = np.empty((3, blocks, m, m))
    H, root, inverse, is_closed = scalings[0], scalings[1], scalings[2], np.ones(blocks, np.bool_)
    structure, room = structure_of_bodies(bodies, is_closed, m)
    first_mean, first_left, made, jammed = 0.0, 0.0, 0, 0
    while True:
        mean, most_left = 0.0, 0.0
        for k in range(blocks):
            mu = max(slope[k], LEAST_SLOPE)
            for i in range(m):
                mean += x[k, i] * y[k, i] / blocks
                z[starts[k] + i] = x[k, i] / (mu if i == 0 else 1.0)
        velocities(indptr, indices, data, q, z, w)
        project(starts, slope, lower, upper, z)
        largest = measure_at(starts, slope, friction, lower, upper, scale, weights, z, w, R)[0]
        if largest <= near or made == most_steps or jammed == JAMMED:
            return largest, made
        for k in range(blocks):
            first, mu, speed = starts[k], max(slope[k], LEAST_SLOPE), tangent_of(y[k], FIRST, m)
            _scale(x[k], y[k], H[k], root[k])
            for i in range(m):
                at[k, i], unit = 0.0, mu if i == 0 else 1.0
                for j in range(m):
                    at[k, i] += root[k, i, j] * x[k, j]
                    D[i, j] = unit * H[k, i, j] * (mu if j == 0 else 1.0)
                slip[k, i] = y[k, i] / speed if speed > 0.0 else 0.0
                left[first + i] = unit * y[k, i] - w[first + i] - (mu * speed if i == 0 else 0.0)
                most_left = max(most_left, abs(left[first + i]) / unit)
            for j in range(m):
                for i in range(1, m):
                    D[0, j] -= mu * slip[k, i] * D[i, j]
            for i in range(m):
                D[i, i] += REGULAR * scale[k]
            invert(D, m, inverse[k])
        if made == 0:
            first_mean, first_left = mean, most_left
        if not (
            mean < np.inf and factor_of_bodies(mass, bodies, is_closed, inverse, structure, room)
        ):
            return largest, made
        length = after = 0.0
        for phase in range(2):
            sigma = 0.0
            if phase:
                behind = (1.0 - length) * (most_left / first_left) ** 2 * first_mean
                sigma = max(mean * min(1.0, max(after / mean, 0.0) ** 3), min(mean, behind))
            for k in range(blocks):
                first, mu = starts[k], max(slope[k], LEAST_SLOPE)
                for i in range(m):
                    c[k, i] = -y[k, i]
                if phase:  # root⁻¹ y = at, and root⁻¹ dy = −at − moved
                    right[0] = sigma
                    for i in range(m):
                        right[0] += moved[k, i] * (at[k, i] + moved[k, i]) - at[k, i] ** 2
                    normal = at[k, 0] * right[0]
                    for i in range(1, m):
                        right[i] = (
                            moved[k, 0] * (at[k, i] + moved[k, i])
                            + (at[k, 0] + moved[k, 0]) * moved[k, i]
                        )
                        right[i] -= 2.0 * at[k, 0] * at[k, i]
                        normal -= at[k, i] * right[i]
                    tangent = tangent_of(at[k], FIRST, m)
                    normal /= (at[k, 0] - tangent) * (at[k, 0] + tangent)
                    right[0] = normal
                    for i in range(1, m):
                        right[i] = (right[i] - normal * at[k, i]) / at[k, 0]
                    for i in range(m):
                        c[k, i] = 0.0
                        for j in range(m):
                            c[k, i] += root[k, i, j] * right[j]
                R[first] = -left[first] - mu * c[k, 0]
                for i in range(1, m):
                    R[first + i] = -left[first + i] - c[k, i]
                    R[first] += mu * slip[k, i] * c[k, i]
            step_of_bodies(starts, bodies, structure, room, inverse, inverse, R, speeds, step)
            for k in range(blocks):
                for i in range(m):
                    dx[k, i] = step[starts[k] + i] * (max(slope[k], LEAST_SLOPE) if i == 0 else 1.0)
                for i in range(m):
                    dy[k, i], moved[k, i] = c[k, i], 0.0
                    for j in range(m):
                        dy[k, i] -= H[k, i, j] * dx[k, j]
                        moved[k, i] += root[k, i, j] * dx[k, j]
            length = min(1.0, (TO_THE_BOUNDARY if phase else 1.0) * longest(x, dx, y, dy))
            for k in range(blocks):
                for i in range(m):
                    if phase:
                        x[k, i], y[k, i] = x[k, i] + length * dx[k, i], y[k, i] + length * dy[k, i]
                    else:
                        after += (
                            (x[k, i] + length * dx[k, i]) * (y[k, i] + length * dy[k, i]) / blocks
                        )
        made, jammed = made + 1, jammed + 1 if length < SHORT else 0
