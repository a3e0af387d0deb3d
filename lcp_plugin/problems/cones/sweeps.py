"""Compiled loops over cones: sweeps of block Gauss–Seidel.

A contact in space is solved exactly, a number is clipped into its bounds, other cones get projected steps.
"""

from __future__ import annotations

import numpy as np

from ...core.checks import Array, Vector, read_only
from ...core.cone_stack import ConeStack, read_blocks_of_problem
from ...core.kernels.compilation import helper, kernel
from ...core.kernels.floats import EPSILON
from ...judges.cones import bound_contacts
from .data import Blocks

LOCAL_STEPS = 30  # of Newton's method on the angle of sliding, or of projections
LAST_TURN = 1e-4  # Newton's method squares the error of the angle; later sweeps reduce the rest
TURN = 0.5  # largest tangent of the change of the angle per step
SWEEPS_PER_STEP = 10  # between two residuals
# of a change: its part that does not continue the change before, when it is summed up; more hides the limit
OTHER_CHANGE = 0.2


@helper
def _solve_contact(A, b, f, x, y):  # type: ignore[no-untyped-def]
    """Solve a contact with velocities A x + b in space for x, in place; return whether it succeeds.

    The contact opens, sticks with x = −A⁻¹b, or slides. Along the direction d of the impulse, x_N is −b_N / (A_NN + f
    A_NT d). Newton's method on the angle finds the d such that the velocity across d vanishes.
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
    co, si = x[1], x[2]
    if co == 0.0 and si == 0.0:
        co, si = -b[1], -b[2]
    norm, is_near = np.hypot(co, si), f == 0.0
    co, si = (co / norm, si / norm) if norm > 0.0 else (1.0, 0.0)
    for _ in range(LOCAL_STEPS):
        push = A[0, 0] + f * (A[0, 1] * co + A[0, 2] * si)
        if not push > 0.0:
            return False
        n = -b[0] / push
        if is_near:
            x[0], x[1], x[2] = n, f * n * co, f * n * si
            return True
        by_x = A[1, 0] + f * (A[1, 1] * co + A[1, 2] * si)
        by_y = A[2, 0] + f * (A[2, 1] * co + A[2, 2] * si)
        change = -n / push * f * (A[0, 2] * co - A[0, 1] * si)
        u, v = by_x * n + b[1], by_y * n + b[2]
        du = by_x * change + f * n * (A[1, 2] * co - A[1, 1] * si)
        dv = by_y * change + f * n * (A[2, 2] * co - A[2, 1] * si)
        across, along = co * v - si * u, co * u + si * v
        slope = co * dv - si * du - along
        turn = 1.0 if across < 0.0 else -1.0
        if slope > 0.0:
            turn = -max(-TURN, min(TURN, across / slope))
        norm = np.sqrt(1.0 + turn * turn)
        co, si = (co - turn * si) / norm, (si + turn * co) / norm
        is_near = along <= 0.0 and abs(turn) <= LAST_TURN
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
        if change <= 64.0 * EPSILON * longest:
            return


@helper
def _solve_one_block(A, b, f, friction, size, low, high, d, x, w):  # type: ignore[no-untyped-def]
    """Solve a block with slack A x + b for x, in place."""
    if size == 1:
        if A[0, 0] > 0.0:
            x[0] = min(max(-b[0] / A[0, 0], low), high)
    elif not (friction and size == 3 and _solve_contact(A, b, f, x, w)):
        _project_steps(A, b, f, friction, 1.0 / (np.sqrt(size) * d), size, x, w)


@kernel
def sweep_stack(  # type: ignore[no-untyped-def]
    starts, friction, mu, lower, upper, indptr, indices, data, q, blocks, d, most, stop, z, counts
):
    """Sweep over z, (B, n), until the changes of each problem are `stop` times its largest z_i; count the sweeps."""
    m = max(blocks.shape[2], 3)
    b, x, w = np.zeros(m), np.zeros(m), np.zeros(m)
    for instance in range(z.shape[0]):
        bounds = min(instance, lower.shape[0] - 1)
        for _ in range(most):
            moved, largest = 0.0, 0.0
            counts[instance] += 1
            for c in range(starts.size - 1):
                first, f = starts[c], mu[instance, c]
                size, A = starts[c + 1] - first, blocks[instance, c]
                for i in range(size):
                    total = q[instance, first + i]
                    for p in range(indptr[first + i], indptr[first + i + 1]):
                        total += data[instance, p] * z[instance, indices[p]]
                    for j in range(size):
                        total -= A[i, j] * z[instance, first + j]
                    b[i], x[i] = total, z[instance, first + i]
                low, high = lower[bounds, c], upper[bounds, c]
                _solve_one_block(A, b, f, friction, size, low, high, d[instance, c], x, w)
                for i in range(size):
                    moved = max(moved, abs(x[i] - z[instance, first + i]))
                    largest = max(largest, abs(x[i]))
                    z[instance, first + i] = x[i]
            if moved <= stop * largest:
                break


@kernel
def sweep_small(starts, W, b, mu, tolerance, most, z):  # type: ignore[no-untyped-def]
    """Sweep over one contact problem until a sufficient test accepts z, or nothing changes.

    The test follows every few sweeps; the sweeps between keep w = W z + b up to date. A point that does not pass is
    moved to the limit of the sweeps if their changes fall by one ratio (Aitken's extrapolation). Returns the number of
    sweeps and the bound of :func:`bound_contacts`.
    """
    n, k, m = b.size, mu.size, 3
    for c in range(k):  # np.diff would compile for 4 s
        m = max(m, starts[c + 1] - starts[c])
    blocks, d, labels = np.zeros((k, m, m)), np.zeros(k), np.zeros(k, np.int64)
    entries = np.arange(n + 1) * n, np.arange(n * n) % n, W.ravel()
    read_blocks_of_problem(starts, *entries, blocks, d, labels)
    columns, w, count, moved, largest = np.ascontiguousarray(W.T), b.copy(), 0, np.inf, 0.0
    offset, x, free = np.zeros(m), np.zeros(m), np.zeros(m)
    z_2 = z_1 = z.copy()  # two sweeps and one ago
    w_1 = w.copy()
    while True:
        is_last = moved <= EPSILON * largest or count >= most
        if is_last or count % SWEEPS_PER_STEP == 0:
            bound = bound_contacts(starts, W, b, z, mu, d, labels, tolerance, w)
            if is_last or bound < np.inf:
                return count, bound
            change, earlier = z - z_1, z_1 - z_2
            ratio = (change * earlier).sum() / (earlier * earlier).sum()
            other, size = np.linalg.norm(change - ratio * earlier), np.linalg.norm(change)
            if 0.0 < ratio < 1.0 and other <= OTHER_CHANGE * (1.0 - ratio) * size:
                z += ratio / (1.0 - ratio) * change
                w += ratio / (1.0 - ratio) * (w - w_1)
        if count % SWEEPS_PER_STEP >= SWEEPS_PER_STEP - 2:
            z_2, z_1, w_1 = z_1, z.copy(), w.copy()
        count += 1
        moved, largest = 0.0, 0.0
        for c in range(k):
            first, A = starts[c], blocks[c]
            size = starts[c + 1] - first
            for i in range(size):
                offset[i], x[i] = w[first + i], z[first + i]
                for j in range(size):
                    offset[i] -= A[i, j] * z[first + j]
            _solve_one_block(A, offset, mu[c], True, size, -np.inf, np.inf, d[c], x, free)
            for j in range(size):
                step = x[j] - z[first + j]
                largest, moved = max(largest, abs(x[j])), max(moved, abs(step))
                z[first + j] = x[j]
                if step != 0.0:
                    for i in range(n):
                        w[i] += columns[first + j, i] * step


def sweep_blocks(stack: ConeStack, z: Array, most: int, stop: float) -> tuple[Array, Array]:
    """Return z, (B, k, m), after at most so many sweeps over each problem, and their numbers, (B,)."""
    pattern = stack.pattern
    q, blocks = pattern.flat(stack.q), pattern.blocks
    arrays = stack.mu, stack.low, stack.high, *pattern.entries, q, blocks
    starts, *data = map(read_only, map(np.ascontiguousarray, (pattern.starts, *arrays, stack.d)))
    z, counts = np.array(pattern.flat(z), order="C"), np.zeros(stack.B, np.int64)
    sweep_stack(starts, stack.has_friction, *data, most, stop, z, counts)
    return pattern.wide(z), counts


def sweep_contacts(
    problem: Blocks, z: Vector, tolerance: float, most: int = 200
) -> tuple[Vector, int, float]:
    """Return a point of a small contact problem after sweeps from z, their number, and its bound.

    The default number of sweeps costs less than one of Newton's steps. The bound is an upper bound of the relative
    residual, which the criterion accepts; ∞ if in doubt.
    """
    M, z = problem.rows.M, z.copy()
    W = M if isinstance(M, np.ndarray) else read_only(M.toarray())
    data = problem.starts, W, problem.q, problem.slope
    return z, *sweep_small(*data, float(tolerance), most, z)
