"""The compiled loop over cones: sweeps of block Gauss–Seidel.

A contact in space is solved exactly, a number is clipped into its bounds, other cones get projected steps.
"""

from __future__ import annotations

import numpy as np

from ...core.checks import Array, read_only
from ...core.cone_stack import ConeStack
from ...core.kernels.compilation import helper, kernel

LOCAL_STEPS = 30  # of Newton's method on the angle of sliding, or of projections
ANGLE_ACCURACY = 1e-14  # relative change or force across: rounding level
TURN = 0.5  # radians: largest change of the angle per step


@helper
def _solve_contact(A, b, f, x, y):  # type: ignore[no-untyped-def]
    """Solve a contact with velocities A x + b in space for x, in place; return whether it succeeds.

    The contact opens, sticks with x = −A⁻¹b, or slides. Along the angle θ of the impulse, x_N is −b_N / (A_NN + f
    A_NT d(θ)). Newton's method finds the θ at which the velocity across d vanishes.
    """
    if b[0] >= 0.0:
        x[:] = 0.0
        return True
    for i in range(3):  # y = −A⁻¹b by Cramer's rule
        j, k = (i + 1) % 3, (i + 2) % 3
        u = A[1, j] * A[2, k] - A[2, j] * A[1, k]
        v = A[2, j] * A[0, k] - A[0, j] * A[2, k]
        w = A[0, j] * A[1, k] - A[1, j] * A[0, k]
        y[i] = -(b[0] * u + b[1] * v + b[2] * w) / (A[0, i] * u + A[1, i] * v + A[2, i] * w)
    if 0.0 <= y[0] < np.inf and np.hypot(y[1], y[2]) <= f * y[0]:
        x[0], x[1], x[2] = y[0], y[1], y[2]
        return True
    angle = np.arctan2(x[2], x[1])
    if x[1] == 0.0 and x[2] == 0.0:
        angle = np.arctan2(-b[2], -b[1])
    size = abs(b[0]) + abs(b[1]) + abs(b[2])
    for _ in range(LOCAL_STEPS):
        co, si = np.cos(angle), np.sin(angle)
        push = A[0, 0] + f * (A[0, 1] * co + A[0, 2] * si)
        if not push > 0.0:
            return False
        n = -b[0] / push
        by_x = A[1, 0] + f * (A[1, 1] * co + A[1, 2] * si)
        by_y = A[2, 0] + f * (A[2, 1] * co + A[2, 2] * si)
        change = -n / push * f * (A[0, 2] * co - A[0, 1] * si)
        u, v = by_x * n + b[1], by_y * n + b[2]
        du = by_x * change + f * n * (A[1, 2] * co - A[1, 1] * si)
        dv = by_y * change + f * n * (A[2, 2] * co - A[2, 1] * si)
        across, along = co * v - si * u, co * u + si * v
        slope = co * dv - si * du - along
        if f == 0.0 or (abs(across) <= ANGLE_ACCURACY * size and along <= 0.0):
            x[0], x[1], x[2] = n, f * n * co, f * n * si
            return True
        if slope > 0.0:
            angle -= max(-TURN, min(TURN, across / slope))
        else:
            angle += 1.0 if across < 0.0 else -1.0
    return False


@helper
def _project_steps(A, b, f, friction, step, size, x, w):  # type: ignore[no-untyped-def]
    """Move x towards the solution of one block by x ← P(x − step · ŵ), w = A x + b."""
    for _ in range(LOCAL_STEPS):
        slip, change, longest = 0.0, 0.0, 0.0
        for i in range(size):
            w[i] = b[i]
            for j in range(size):
                w[i] += A[i, j] * x[j]
        for i in range(1, size):
            slip = np.hypot(slip, w[i])
        if friction:
            w[0] += f * slip
        slip = 0.0
        for i in range(size):
            w[i] = x[i] - step * w[i]
            if i:
                slip = np.hypot(slip, w[i])
        axis = (w[0] + f * slip) / (1.0 + f * f)
        for i in range(size):
            new = w[i]
            if not axis > 0.0:
                new = 0.0
            elif slip > f * w[0]:
                new = f * axis * (w[i] / slip) if i else axis
            change, longest = max(change, abs(new - x[i])), max(longest, abs(new))
            x[i] = new
        if change <= ANGLE_ACCURACY * longest:
            return


@kernel
def sweep(  # type: ignore[no-untyped-def]
    starts, friction, mu, lower, upper, indptr, indices, data, q, own, d, most, stop, z, counts
):
    """Sweep over z, (B, n), until the changes of each problem are `stop` times its largest z_i; count the sweeps."""
    m = max(own.shape[2], 3)
    b, x, w = np.zeros(m), np.zeros(m), np.zeros(m)
    for world in range(z.shape[0]):
        bounds = min(world, lower.shape[0] - 1)
        for _ in range(most):
            moved, largest = 0.0, 0.0
            counts[world] += 1
            for c in range(starts.size - 1):
                first, f = starts[c], mu[world, c]
                size, A = starts[c + 1] - first, own[world, c]
                for i in range(size):
                    total = q[world, first + i]
                    for p in range(indptr[first + i], indptr[first + i + 1]):
                        total += data[world, p] * z[world, indices[p]]
                    for j in range(size):
                        total -= A[i, j] * z[world, first + j]
                    b[i], x[i] = total, z[world, first + i]
                if size == 1:
                    if A[0, 0] > 0.0:
                        x[0] = min(max(-b[0] / A[0, 0], lower[bounds, c]), upper[bounds, c])
                elif not (friction and size == 3 and _solve_contact(A, b, f, x, w)):
                    step = 1.0 / (np.sqrt(size) * d[world, c])
                    _project_steps(A, b, f, friction, step, size, x, w)
                for i in range(size):
                    moved = max(moved, abs(x[i] - z[world, first + i]))
                    largest = max(largest, abs(x[i]))
                    z[world, first + i] = x[i]
            if moved <= stop * largest:
                break


def sweep_blocks(stack: ConeStack, z: Array, most: int, stop: float) -> tuple[Array, Array]:
    """Return z, (B, k, m), after at most so many sweeps over each problem, and their numbers, (B,)."""
    pattern = stack.pattern
    arrays = stack.mu, stack.low, stack.high, *pattern.entries, pattern.flat(stack.q), pattern.own
    starts, *given = map(read_only, map(np.ascontiguousarray, (pattern.starts, *arrays, stack.d)))
    z, counts = np.array(pattern.flat(z), order="C"), np.zeros(stack.B, np.int64)
    sweep(starts, stack.has_friction, *given, most, stop, z, counts)
    return pattern.wide(z), counts
