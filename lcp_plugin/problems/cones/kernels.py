"""Compiled loops over blocks: projections, residuals, their derivatives, sweeps of block Gauss–Seidel.

Block k has the rows starts[k] … starts[k + 1] − 1. One row is a number between bounds; several are a point of the cone
K = {‖x_T‖ ≤ μ x_N}, x_N the first of them, μ = slope[k]. With `friction` 1 the slack of a cone is û = w + μ‖w_T‖ e_N
(De Saxcé), with 0 it is w.
"""

from __future__ import annotations

import numpy as np

from ...core.kernels.compilation import helper, kernel
from ...core.kernels.enclosures import row_ends
from ...core.kernels.floats import NEGLIGIBLE, TINY, UNIT

OUTWARD = 1.0 + 2.0**-48  # of a handful of roundings
OUT, WITHIN, ON = (
    0,
    1,
    2,
)  # where a projection lies: at the apex or a bound, inside, on the boundary
LOCAL_STEPS = 30  # of Newton on the angle of sliding, or of projections, for one block
TURN = 0.5  # radians a step of Newton turns at the most
ACCURATE = 1e-14
LARGEST, LEAST = float(np.finfo(np.float64).max), float(np.finfo(np.float64).tiny)
FIRST = np.int64(0)  # row of a block by itself; numba compiles a function anew for a 0 of Python's


@helper
def tangent_of(x, first, end):  # type: ignore[no-untyped-def]
    """Return ‖x_T‖ of a block, without overflow."""
    largest = 0.0
    for i in range(first + 1, end):
        largest = max(largest, abs(x[i]))
    if largest == 0.0 or not largest < np.inf:
        return largest
    total = 0.0
    for i in range(first + 1, end):
        total += (x[i] / largest) ** 2
    return largest * np.sqrt(total)


@helper
def _project(x, first, end, mu):  # type: ignore[no-untyped-def]
    """Overwrite a block of x with its projection on the cone; return where that lies."""
    normal, tangent = x[first], tangent_of(x, first, end)
    if tangent <= mu * normal:
        return WITHIN
    if mu * tangent <= -normal:
        x[first:end] = 0.0
        return OUT
    on_axis = (normal + mu * tangent) / (1.0 + mu * mu)
    x[first] = on_axis
    for i in range(first + 1, end):
        x[i] *= mu * on_axis / tangent
    return ON


@helper
def _shifted(k, starts, slope, friction, z, w, scale, x):  # type: ignore[no-untyped-def]
    """Write x_T, of x = z − ŵ / scale, of one block; return ‖x_T‖ and x_N + μ‖x_T‖, > 0 outside the polar cone.

    With friction that is z_N − w_N / scale + μ (‖x_T‖ − ‖w_T‖ / scale), and the norms of a fast slide nearly cancel:
    ‖a‖ − ‖b‖ = (a − b)ᵀ(a + b) / (‖a‖ + ‖b‖).
    """
    first, end, slip = starts[k], starts[k + 1], 0.0
    for i in range(first, end):
        x[i] = z[i] - w[i] / scale[k]
    tangent = tangent_of(x, first, end)
    if not friction:
        return tangent, x[first] + slope[k] * tangent
    length = tangent + tangent_of(w, first, end) / scale[k]
    if length > 0.0:
        for i in range(first + 1, end):
            slip += z[i] * ((x[i] - w[i] / scale[k]) / length)
    return tangent, x[first] + slope[k] * slip


@helper
def block_residual(k, starts, slope, friction, lower, upper, z, w, scale, found):  # type: ignore[no-untyped-def]
    """Write R = z − P(z − ŵ / scale) of one block into `found`; return where the projection lies."""
    first, end = starts[k], starts[k + 1]
    if end - first == 1:
        step = w[first] / scale[k]
        below, above = z[first] - upper[first], z[first] - lower[first]
        found[first] = min(max(step, below), above)
        return WITHIN if below < step < above else OUT
    mu = slope[k]
    tangent, above = _shifted(k, starts, slope, friction, z, w, scale, found)
    if above <= 0.0:
        for i in range(first, end):
            found[i] = z[i]
        return OUT
    on_axis = above / (1.0 + mu * mu)
    if tangent <= mu * on_axis:
        for i in range(first, end):
            found[i] = w[i] / scale[k]
        if friction:
            found[first] += mu * tangent_of(w, first, end) / scale[k]
        return WITHIN
    found[first] = z[first] - on_axis
    for i in range(first + 1, end):
        found[i] = z[i] - mu * on_axis * (found[i] / tangent)
    return ON


@kernel
def residuals(starts, slope, friction, lower, upper, z, w, scale, found, cases):  # type: ignore[no-untyped-def]
    """Write R = z − P(z − ŵ / scale) block by block into `found`, and into `cases` where the projections lie."""
    for k in range(slope.size):
        cases[k] = block_residual(k, starts, slope, friction, lower, upper, z, w, scale, found)


@helper
def project(starts, slope, lower, upper, z):  # type: ignore[no-untyped-def]
    """Overwrite z with the point of K nearest to it."""
    for k in range(slope.size):
        first = starts[k]
        if starts[k + 1] - first == 1:
            z[first] = min(max(z[first], lower[first]), upper[first])
        else:
            _project(z, first, starts[k + 1], slope[k])


@helper
def block_bounds(  # type: ignore[no-untyped-def]
    k, starts, slope, friction, lower, upper, z, w, slip, scale, found
):
    """Return bounds of ‖R‖ of one block, for every w in w ± slip; `found` gets R.

    The largest is 0 where z is 0 and w is proved to be in the dual cone: with friction û_N ≥ μ‖u_T‖ says u_N ≥ 0.
    """
    first, end = starts[k], starts[k + 1]
    size, mu = end - first, slope[k]
    if size == 1:
        return row_ends(w[first], slip[first], scale[k], z[first], lower[first], upper[first])
    case = block_residual(k, starts, slope, friction, lower, upper, z, w, scale, found)
    here, own = tangent_of(z, first - 1, end), tangent_of(found, first - 1, end)
    wide = tangent_of(slip, first - 1, end)
    stretch = 1.0 + mu if friction else 1.0
    is_inner = case == WITHIN and own < 0.5 * (mu * z[first] - tangent_of(z, first, end)) / (
        1.0 + mu
    )
    pushed = (
        abs(w[first]) if friction and case != WITHIN else stretch * tangent_of(w, first - 1, end)
    )
    terms = (0.0 if is_inner else here) + (pushed + stretch * wide) / scale[k]
    off = (
        OUTWARD * (stretch * wide / scale[k] + 4.0 * (size + 8.0) * UNIT * (1.0 + mu) * terms)
        + 4.0 * TINY
    )
    if not (own < np.inf and off < np.inf):
        return 0.0, np.inf
    needed = 0.0 if friction else OUTWARD * (tangent_of(w, first, end) + wide)
    is_open = here == 0.0 and w[first] - slip[first] >= OUTWARD * needed
    return max(own / OUTWARD - off, 0.0), 0.0 if is_open else OUTWARD * (own + off)


@kernel
def bounds(starts, slope, friction, lower, upper, z, w, slip, scale, least, most):  # type: ignore[no-untyped-def]
    """Write bounds of ‖R_k‖ of every block into `least` and `most`, for every w in w ± slip."""
    found = np.empty(z.size)
    for k in range(slope.size):
        least[k], most[k] = block_bounds(
            k, starts, slope, friction, lower, upper, z, w, slip, scale, found
        )


@helper
def own_terms(  # type: ignore[no-untyped-def]
    starts,
    slope,
    friction,
    lower,
    upper,
    indptr,
    indices,
    data,
    q,
    scale,
    labels,
    z,
    w,
    near,
    slack,
    R,
    terms,
    longest,
    most,
    wrong,
):
    """Write into `wrong` how wrong each block is beside its own terms, squared: the guard of the criterion.

    It is measured at `near`: z with the blocks on their bounds, apexes and boundaries where the slack w at z keeps
    them there. There d ‖R_k‖ stands beside ‖|q_k| + Σ |m_ij z_j|‖, whose rows `terms` gets. A block with q_k = 0 does
    not count whose terms are NEGLIGIBLE beside those of the blocks that act and beside d ‖z_P‖, P its component.
    """
    for k in range(slope.size):
        first, end = starts[k], starts[k + 1]
        case = block_residual(k, starts, slope, friction, lower, upper, z, w, scale, R)
        for i in range(first, end):
            near[i] = z[i]
            if case == OUT:
                near[i] = z[i] - R[i]
            elif case == ON:
                near[i] += R[i] - w[i] / scale[k]
        if case == ON:
            near[first] -= friction * slope[k] * tangent_of(w, first, end) / scale[k]
            _project(near, first, end, slope[k])
    for i in range(q.size):
        slack[i], terms[i] = q[i], abs(q[i])
        for p in range(indptr[i], indptr[i + 1]):
            term = data[p] * near[indices[p]]
            slack[i], terms[i] = slack[i] + term, terms[i] + abs(term)
    longest[:], most[:] = 0.0, 0.0
    for k in range(slope.size):
        first, end, part = starts[k], starts[k + 1], labels[k]
        case = block_residual(k, starts, slope, friction, lower, upper, near, slack, scale, R)
        wrong[k] = scale[k] * tangent_of(R, first - 1, end)
        longest[part] = max(longest[part], tangent_of(near, first - 1, end))
        if case != OUT or wrong[k] > 0.0:
            most[part] = max(most[part], tangent_of(terms, first - 1, end))
    for k in range(slope.size):
        first, end, part = starts[k], starts[k + 1], labels[k]
        own = tangent_of(terms, first - 1, end)
        is_negligible = own <= NEGLIGIBLE * min(scale[k] * longest[part], most[part])
        if wrong[k] == 0.0 or (is_negligible and tangent_of(q, first - 1, end) == 0.0):
            wrong[k] = 0.0
        else:
            wrong[k] = (wrong[k] / own) ** 2 if wrong[k] < np.inf and own < np.inf else np.inf


@kernel
def term_residuals(  # type: ignore[no-untyped-def]
    starts, slope, friction, lower, upper, indptr, indices, data, q, scale, labels, z, w, wrong
):
    """Write into `wrong` how wrong each block is beside its own terms, squared; see own_terms."""
    n = q.size
    own_terms(
        starts,
        slope,
        friction,
        lower,
        upper,
        indptr,
        indices,
        data,
        q,
        scale,
        labels,
        z,
        w,
        np.empty(n),
        np.empty(n),
        np.empty(n),
        np.empty(n),
        np.empty(wrong.size),
        np.empty(wrong.size),
        wrong,
    )


@helper
def block_derivative(k, starts, slope, friction, lower, upper, z, w, scale, x, way, by_z, by_w):  # type: ignore[no-untyped-def]
    """Write an element of the generalised derivative of R by z and by w of one block, of shape (m, m)."""
    first, end = starts[k], starts[k + 1]
    size, mu = end - first, slope[k]
    by_z[:], by_w[:] = 0.0, 0.0
    if size == 1:
        step = w[first] / scale[k]
        is_free = z[first] - upper[first] < step < z[first] - lower[first]
        by_z[0, 0], by_w[0, 0] = (0.0, 1.0 / scale[k]) if is_free else (1.0, 0.0)
        return
    slip = tangent_of(w, first, end)
    for i in range(size):
        x[i] = z[first + i] - w[first + i] / scale[k]
        by_z[i, i] = 1.0
    if friction:
        x[0] -= mu * slip / scale[k]
    tangent = tangent_of(x, FIRST, size)
    if mu * tangent <= -x[0] and not tangent <= mu * x[0]:
        return
    if mu == 0.0:  # a half-line: tangents are held at 0
        by_z[0, 0], by_w[0, 0] = 0.0, 1.0 / scale[k]
        return
    if tangent <= mu * x[0]:
        for i in range(size):
            by_z[i, i], by_w[i, i] = 0.0, 1.0 / scale[k]
    else:
        share = 1.0 / (1.0 + mu * mu)
        radius = mu * (x[0] + mu * tangent) * share
        for i in range(1, size):
            way[i] = x[i] / tangent
        by_w[0, 0] = share / scale[k]
        for i in range(1, size):
            by_w[0, i] = by_w[i, 0] = mu * share * way[i] / scale[k]
            for j in range(1, size):
                outer = (mu * mu * share - radius / tangent) * way[i] * way[j]
                by_w[i, j] = (outer + (radius / tangent if i == j else 0.0)) / scale[k]
        for i in range(size):
            for j in range(size):
                by_z[i, j] -= scale[k] * by_w[i, j]
    if friction and slip > 0.0:  # ŵ_N depends on w_T
        for i in range(size):
            for j in range(1, size):
                by_w[i, j] += by_w[i, 0] * mu * w[first + j] / slip


@kernel
def derivatives(starts, slope, friction, lower, upper, z, w, scale, by_z, by_w):  # type: ignore[no-untyped-def]
    """Write an element of the generalised derivative of R by z and by w, blocks of shape (k, m, m)."""
    x, way = np.empty(by_z.shape[1]), np.empty(by_z.shape[1])
    for k in range(slope.size):
        block_derivative(
            k, starts, slope, friction, lower, upper, z, w, scale, x, way, by_z[k], by_w[k]
        )


@kernel
def newton_rows(  # type: ignore[no-untyped-def]
    starts, by_z, by_w, indptr, indices, data, proximal, place, found_indptr, found_indices, found
):
    """Write by_z + by_w (M + diag(proximal)) as CSR, of the rows and columns that have a place ≥ 0 in it.

    Rows of a block have one pattern, and places or none.
    """
    found_indptr[0] = 0
    for k in range(starts.size - 1):
        first, end = starts[k], starts[k + 1]
        if place[first] < 0:
            continue
        size, begin, length, filled = (
            end - first,
            found_indptr[place[first]],
            indptr[first + 1] - indptr[first],
            0,
        )
        for p in range(length):
            filled += place[indices[indptr[first] + p]] >= 0
        for i in range(size):
            found_indptr[place[first] + i + 1] = begin + (i + 1) * filled
        at = begin
        for p in range(length):
            column = indices[indptr[first] + p]
            if place[column] < 0:
                continue
            for i in range(size):
                total = 0.0
                for j in range(size):
                    total += by_w[k, i, j] * data[indptr[first + j] + p]
                if first <= column < end:
                    total += by_z[k, i, column - first] + by_w[k, i, column - first] * proximal[k]
                found_indices[at + i * filled] = place[column]
                found[at + i * filled] = total
            at += 1


@kernel
def block_products(starts, blocks, is_transposed, v, found):  # type: ignore[no-untyped-def]
    """Write the product of each block, or of its transpose, with its rows of v into `found`."""
    for k in range(starts.size - 1):
        first, size = starts[k], starts[k + 1] - starts[k]
        for i in range(size):
            found[first + i] = 0.0
            for j in range(size):
                found[first + i] += (blocks[k, j, i] if is_transposed else blocks[k, i, j]) * v[
                    first + j
                ]


@kernel
def count_blocks(starts, of_row, indptr, indices, begins, closed_indptr):  # type: ignore[no-untyped-def]
    """Write where the list of blocks of each row of blocks begins, of those with an entry and its own; and each row."""
    seen = np.full(starts.size - 1, -1)
    begins[0], closed_indptr[0] = 0, 0
    for k in range(starts.size - 1):
        seen[k], count, length = k, 1, starts[k + 1] - starts[k]
        for p in range(indptr[starts[k]], indptr[starts[k + 1]]):
            other = of_row[indices[p]]
            if seen[other] != k:
                seen[other], count, length = (
                    k,
                    count + 1,
                    length + starts[other + 1] - starts[other],
                )
        begins[k + 1] = begins[k] + count
        for i in range(starts[k], starts[k + 1]):
            closed_indptr[i + 1] = closed_indptr[i] + length


@kernel
def fill_blocks(  # type: ignore[no-untyped-def]
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
):
    """Write M with all entries of its blocks, zeros where it has none, as CSR; and which `others`, and their norms.

    `begins` and `closed_indptr` are those of :func:`count_blocks`. The norms are Frobenius', on the diagonal over √m of
    m rows; of one row there, the entry itself.
    """
    blocks = starts.size - 1
    seen, offset = np.full(blocks, -1), np.empty(blocks, np.int64)
    for k in range(blocks):
        first, end, begin, filled = starts[k], starts[k + 1], begins[k], begins[k] + 1
        others[begin], seen[k] = k, k
        for p in range(indptr[first], indptr[end]):
            other = of_row[indices[p]]
            if seen[other] != k:
                seen[other], at = k, filled
                filled += 1
                while at > begin and others[at - 1] > other:  # a sorted list stays one
                    others[at] = others[at - 1]
                    at -= 1
                others[at] = other
        length = 0
        for at in range(begin, filled):
            offset[others[at]] = length
            length += starts[others[at] + 1] - starts[others[at]]
        for i in range(first, end):
            row = closed_indptr[i]
            for at in range(begin, filled):
                for j in range(starts[others[at]], starts[others[at] + 1]):
                    closed_indices[row], closed[row] = j, 0.0
                    row += 1
            for p in range(indptr[i], indptr[i + 1]):
                other = of_row[indices[p]]
                closed[closed_indptr[i] + offset[other] + indices[p] - starts[other]] = data[p]
        for at in range(begin, filled):
            other, largest, total = others[at], 0.0, 0.0
            width = starts[other + 1] - starts[other]
            for i in range(first, end):
                for p in range(
                    closed_indptr[i] + offset[other], closed_indptr[i] + offset[other] + width
                ):
                    largest = max(largest, abs(closed[p]))
            unit = max(largest, LEAST)
            share = 1.0 / unit
            for i in range(first, end):
                for p in range(
                    closed_indptr[i] + offset[other], closed_indptr[i] + offset[other] + width
                ):
                    total += (closed[p] * share) ** 2
            norms[at] = min(unit * np.sqrt(total), LARGEST)
            if other == k:
                norms[at] /= np.sqrt(end - first)
                if end - first == 1:
                    norms[at] = closed[closed_indptr[first] + offset[k]]


@helper
def _solve_three(A, b, x):  # type: ignore[no-untyped-def]
    """Write the x of A x + b = 0 by Cramer's rule; return whether there is one."""
    a = A[1, 1] * A[2, 2] - A[1, 2] * A[2, 1]
    c = A[1, 2] * A[2, 0] - A[1, 0] * A[2, 2]
    e = A[1, 0] * A[2, 1] - A[1, 1] * A[2, 0]
    det = A[0, 0] * a + A[0, 1] * c + A[0, 2] * e
    if not abs(det) > ACCURATE * abs(A[0, 0]) * max(abs(A[1, 1] * A[2, 2]), abs(A[1, 2] * A[2, 1])):
        return False
    det = -det
    x[0] = (
        b[0] * a
        + A[0, 1] * (A[1, 2] * b[2] - b[1] * A[2, 2])
        + A[0, 2] * (b[1] * A[2, 1] - A[1, 1] * b[2])
    ) / det
    x[1] = (
        A[0, 0] * (b[1] * A[2, 2] - A[1, 2] * b[2])
        + b[0] * c
        + A[0, 2] * (A[1, 0] * b[2] - b[1] * A[2, 0])
    ) / det
    x[2] = (
        A[0, 0] * (A[1, 1] * b[2] - b[1] * A[2, 1])
        + A[0, 1] * (b[1] * A[2, 0] - A[1, 0] * b[2])
        + b[0] * e
    ) / det
    return True


@helper
def _one_contact(A, b, mu, x):  # type: ignore[no-untyped-def]
    """Write the impulse of one contact in space with velocities A x + b over x; return whether it was found.

    It opens where b_N ≥ 0, sticks where −A⁻¹b lies in the cone. Else it slides: along the angle θ of the impulse x_N is
    −b_N / (A_NN + μ A_NT d(θ)), and θ is where the velocity across d vanishes, which Newton's method finds.
    """
    if b[0] >= 0.0:
        x[:] = 0.0
        return True
    was_x, was_y = x[1], x[2]
    is_solved = (
        _solve_three(A, b, x) and x[1] * x[1] + x[2] * x[2] <= mu * mu * x[0] * x[0] and x[0] >= 0.0
    )
    if is_solved:
        return True
    if mu == 0.0:
        x[0], x[1], x[2] = -b[0] / A[0, 0], 0.0, 0.0
        return A[0, 0] > 0.0
    if was_x == 0.0 and was_y == 0.0:
        was_x, was_y = -b[1], -b[2]
    angle, size = np.arctan2(was_y, was_x), abs(b[0]) + abs(b[1]) + abs(b[2])
    for _ in range(LOCAL_STEPS):
        c, s = np.cos(angle), np.sin(angle)
        push = A[0, 0] + mu * (A[0, 1] * c + A[0, 2] * s)
        if not push > 0.0:
            return False
        x[0] = -b[0] / push
        change = -x[0] / push * mu * (A[0, 2] * c - A[0, 1] * s)
        row_x, row_y = (
            A[1, 0] + mu * (A[1, 1] * c + A[1, 2] * s),
            A[2, 0] + mu * (A[2, 1] * c + A[2, 2] * s),
        )
        u, v = row_x * x[0] + b[1], row_y * x[0] + b[2]
        du = row_x * change + mu * x[0] * (A[1, 2] * c - A[1, 1] * s)
        dv = row_y * change + mu * x[0] * (A[2, 2] * c - A[2, 1] * s)
        across, along = c * v - s * u, c * u + s * v
        slope = c * dv - s * du - along
        x[1], x[2] = mu * x[0] * c, mu * x[0] * s
        if abs(across) <= ACCURATE * size and along <= 0.0:
            return True
        if slope > 0.0:
            angle -= max(-TURN, min(TURN, across / slope))
        else:
            angle += 1.0 if across < 0.0 else -1.0
    return False


@helper
def _by_projections(A, b, mu, friction, step, size, x, w):  # type: ignore[no-untyped-def]
    """Take x nearer to the answer of one block by x ← P(x − step · ŵ), w = A x + b."""
    for _ in range(LOCAL_STEPS):
        change, length = 0.0, 0.0
        for i in range(size):
            w[i] = b[i]
            for j in range(size):
                w[i] += A[i, j] * x[j]
        if friction:
            w[0] += mu * tangent_of(w, FIRST, size)
        for i in range(size):
            w[i], x[i] = x[i], x[i] - step * w[i]
        _project(x, FIRST, size, mu)
        for i in range(size):
            change, length = max(change, abs(x[i] - w[i])), max(length, abs(x[i]))
        if change <= ACCURATE * length:
            return


@helper
def sweep_once(  # type: ignore[no-untyped-def]
    starts,
    slope,
    friction,
    lower,
    upper,
    indptr,
    indices,
    data,
    q,
    diagonal,
    steps,
    z,
    b,
    x,
    w,
    before,
):
    """Solve each block with the others as they are; return the largest change, in the unit of z."""
    moved = 0.0
    for k in range(slope.size):
        first, end = starts[k], starts[k + 1]
        size, mu, A = end - first, slope[k], diagonal[k]
        length = indptr[first + 1] - indptr[first]
        for i in range(0, size, 3):  # three sums at once
            two, three = indptr[first + min(i + 1, size - 1)], indptr[first + min(i + 2, size - 1)]
            one, x_sum, y_sum, z_sum = indptr[first + i], 0.0, 0.0, 0.0
            for place in range(length):
                value = z[indices[one + place]]
                x_sum += data[one + place] * value
                y_sum += data[two + place] * value
                z_sum += data[three + place] * value
            b[min(i + 2, size - 1)], b[min(i + 1, size - 1)], b[i] = z_sum, y_sum, x_sum
        for i in range(size):
            total = b[i] + q[first + i]
            for j in range(size):
                total -= A[i, j] * z[first + j]
            b[i] = total
        if size == 1:
            if A[0, 0] > 0.0:
                new = min(max(-b[0] / A[0, 0], lower[first]), upper[first])
                moved = max(moved, abs(new - z[first]))
                z[first] = new
            continue
        for i in range(size):
            x[i] = before[i] = z[first + i]
        if not (friction and size == 3 and _one_contact(A, b, mu, x)):
            for i in range(size):
                x[i] = before[i]
            _by_projections(A, b, mu, friction, steps[k], size, x, w)
        for i in range(size):
            moved = max(moved, abs(x[i] - before[i]))
            z[first + i] = x[i]
    return moved


@kernel
def sweep(  # type: ignore[no-untyped-def]
    starts, slope, friction, lower, upper, indptr, indices, data, q, diagonal, steps, z, sweeps
):
    """Take sweeps of block Gauss–Seidel on z; return the largest change of the last one, in the unit of z.

    Each block is solved with the others as they are: a contact in space exactly, another cone by a few projections of
    the step steps[k] = 1/‖M_kk‖. `diagonal` has the blocks M_kk, shape (k, m, m). Rows of a block have one pattern.
    """
    m = diagonal.shape[1]
    b, x, w, before, moved = np.empty(m), np.empty(m), np.empty(m), np.empty(m), 0.0
    for _ in range(sweeps):
        moved = sweep_once(
            starts,
            slope,
            friction,
            lower,
            upper,
            indptr,
            indices,
            data,
            q,
            diagonal,
            steps,
            z,
            b,
            x,
            w,
            before,
        )
    return moved


@helper
def measure_at(starts, slope, friction, lower, upper, scale, weights, z, w, R):  # type: ignore[no-untyped-def]
    """Write R of z and w; return the largest ‖R_k‖ times weights, and their norm."""
    largest, total = 0.0, 0.0
    for k in range(slope.size):
        own = 0.0
        block_residual(k, starts, slope, friction, lower, upper, z, w, scale, R)
        for i in range(starts[k], starts[k + 1]):
            own += R[i] * R[i]
        own = np.sqrt(own) * weights[k]
        largest, total = (max(largest, own) if own == own else np.inf), total + own * own
    return largest, np.sqrt(total)


@helper
def velocities(indptr, indices, data, q, z, w):  # type: ignore[no-untyped-def]
    """Write w = M z + q."""
    for i in range(q.size):
        w[i] = q[i]
        for p in range(indptr[i], indptr[i + 1]):
            w[i] += data[p] * z[indices[p]]


@helper
def measure(  # type: ignore[no-untyped-def]
    starts, slope, friction, lower, upper, indptr, indices, data, q, scale, weights, z, w, R
):
    """Write w and R; return the largest ‖R_k‖ times weights, and their norm."""
    velocities(indptr, indices, data, q, z, w)
    return measure_at(starts, slope, friction, lower, upper, scale, weights, z, w, R)


@kernel
def measured(  # type: ignore[no-untyped-def]
    starts, slope, friction, lower, upper, indptr, indices, data, q, scale, weights, z, w, R
):
    """Write w and R; return the largest ‖R_k‖ times weights, and their norm."""
    return measure(
        starts, slope, friction, lower, upper, indptr, indices, data, q, scale, weights, z, w, R
    )
