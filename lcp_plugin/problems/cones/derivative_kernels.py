"""The derivatives of many small answers with contact in one compiled loop: ∂z/∂q and ∂z/∂μ of each, as matrices.

On the rows of the contacts that press, J ∂z = −R_w ∂q − R_μ ∂μ with J = R_z + R_w M, as in ``derivative.py``. Where J
is singular, the solution is that of least norm. What shows several units, or leaves in doubt whether J is singular, the
loop leaves.
"""

from __future__ import annotations

import numpy as np

from ...core.kernels.compilation import helper, kernel
from ...core.matrix.scaling import SPREAD
from .kernels import ON, WITHIN, block_derivative, block_residual, measure, tangent_of
from .methods import EXACT
from .small_kernels import copy, gather, label, newton_step, product, references

LEFT, REGULAR, SINGULAR = 0, 1, 2  # what becomes of an item
HALF = 2.0**-26  # of the digits of a double: pivots, beside the largest, of a regular system are larger
NOTHING = 2.0**-43  # … and what rounding makes of 0 is smaller: see systems/least_norm.py


@helper
def _is_in_one_unit(J, n):  # type: ignore[no-untyped-def]
    """Return whether no row and no column of J is far smaller than another."""
    largest, least = 0.0, np.inf
    for i in range(n):
        row, column = 0.0, 0.0
        for j in range(n):
            row, column = max(row, abs(J[i, j])), max(column, abs(J[j, i]))
        largest = max(largest, row)
        for side in (row, column):
            least = min(least, side) if side > 0.0 else least
    return largest * 2.0**-SPREAD <= least


@helper
def _triangular(A, R, order, norms, n):  # type: ignore[no-untyped-def]
    """Write R = Qᵀ A of A = [J, B] with J = Q R, by Gram and Schmidt with pivoting; return the rank, −1 in doubt.

    Step l makes the column order[l] of J its row l of R. A is overwritten.
    """
    first = 0.0
    for step in range(n):
        norms[:n] = 0.0
        for i in range(n):
            for j in range(n):
                norms[j] += A[i, j] * A[i, j]
        for before in range(step):
            norms[order[before]] = -1.0
        pivot = 0
        for j in range(n):
            pivot = j if norms[j] > norms[pivot] else pivot
        length = np.sqrt(norms[pivot])
        if step == 0:
            first = length
        if not 0.0 < first < np.inf:
            return -1
        if length < HALF * first:
            return step if length <= NOTHING * first else -1
        order[step], R[step] = pivot, 0.0
        for i in range(n):
            share = A[i, pivot] / length
            for j in range(A.shape[1]):
                R[step, j] += share * A[i, j]
            norms[i] = share
        for before in range(step):
            R[step, order[before]] = 0.0
        for i in range(n):
            share = norms[i]
            for j in range(A.shape[1]):
                A[i, j] -= share * R[step, j]
    return n


@helper
def _least_norm(R, order, rank, n, X):  # type: ignore[no-untyped-def]
    """Write the X of least norm with J X = B, from what `_triangular` wrote; R is overwritten."""
    X[:] = 0.0
    if rank == n:
        for step in range(n - 1, -1, -1):
            own = order[step]
            for column in range(X.shape[1]):
                X[own, column] = R[step, n + column]
            for later in range(step + 1, n):
                share, other = R[step, order[later]], order[later]
                for column in range(X.shape[1]):
                    X[own, column] -= share * X[other, column]
            for column in range(X.shape[1]):
                X[own, column] /= R[step, own]
        return
    for row in range(rank):  # orthonormal rows
        for before in range(row + 1):
            share = 0.0
            for j in range(n):
                share += R[row, j] * R[before, j]
            if before == row:
                share = np.sqrt(share)
            for j in range(n + X.shape[1]):
                R[row, j] = R[row, j] / share if before == row else R[row, j] - share * R[before, j]
        for i in range(n):
            for column in range(X.shape[1]):
                X[i, column] += R[row, i] * R[row, n + column]


@helper
def _by_friction(k, starts, slope, z, w, scale, by_w, x, found):  # type: ignore[no-untyped-def]
    """Write R_μ of a block on the boundary of its cone."""
    first, size, mu = starts[k], starts[k + 1] - starts[k], slope[k]
    slip = tangent_of(w, first, first + size)
    for i in range(size):
        x[i] = z[first + i] - w[first + i] / scale[k]
    tangent = tangent_of(x, np.int64(0), size)
    radius = (x[0] - mu * slip / scale[k] + mu * tangent) / (1.0 + mu * mu)
    change = (tangent - 2.0 * mu * radius) / (1.0 + mu * mu)
    found[0] = slip * by_w[0, 0] - change
    for i in range(1, size):
        found[i] = slip * by_w[i, 0] - (radius + mu * change) * (x[i] / tangent)


@helper
def _is_on_the_edge(  # type: ignore[no-untyped-def]
    k, starts, slope, lower, upper, indptr, indices, data, q, z, w, scale, edge, rounding, found
):
    """Return whether block k is on the edge of two cases: whether a small change of its z leads to another."""
    first, own, terms = starts[k], 0.0, 0.0
    for i in range(first, starts[k + 1]):
        row = abs(q[i])
        for p in range(indptr[i], indptr[i + 1]):
            row += abs(data[p] * z[indices[p]])
        own, terms = own + (abs(z[i]) + abs(w[i]) / scale[k]) ** 2, terms + row * row
    own, terms = np.sqrt(own), np.sqrt(terms) / scale[k]
    terms = 1.0 if terms == 0.0 else terms
    shift = rounding * terms if own <= rounding * terms else edge * own
    here, differs = z[first], False
    case = block_residual(k, starts, slope, 1.0, lower, upper, z, w, scale, found)
    for sign in (-1.0, 1.0):
        z[first] = here + sign * shift
        differs = differs or block_residual(k, starts, slope, 1.0, lower, upper, z, w, scale, found) != case
    z[first] = here
    return differs


@kernel
def derive_each(  # type: ignore[no-untyped-def]
    item, end_item, starts, slopes, lower, upper, matrices, offsets, origin, refinements, refining, edge, rounding,
    is_asked, points, by_q, by_friction, degenerate, ends
):
    """Refine the answers `points`, and write ∂z/∂q, (B, n, n), ∂z/∂μ, (B, n, k), degenerate blocks, and what was done.

    `ends` gets LEFT, REGULAR or SINGULAR; the rows of items that were left are not to be read.
    """
    blocks, n = starts.size - 1, offsets.shape[1]
    m = starts[1]
    indptr, indices, data = np.empty(n + 1, np.int64), np.empty(n * n, np.int64), np.empty(n * n)
    diagonal, norms, labels = np.empty((blocks, m, m)), np.empty((blocks, blocks)), np.empty(blocks, np.int64)
    steps, scale, reference, weights = np.empty(blocks), np.empty(blocks), np.empty(blocks), np.empty(blocks)
    least, most = np.empty(blocks), np.empty(blocks)
    x, way, own = np.empty(m), np.empty(m), np.empty(m)
    by_z, by_w, step, place = np.empty((blocks, m, m)), np.empty((blocks, m, m)), np.empty(n), np.empty(n, np.int64)
    w, R, slip, start, sizes = np.empty(n), np.empty(n), np.empty(n), np.empty(n), np.empty(n)
    J, order = np.empty((n + 4, n + 1)), np.empty(n, np.int64)
    for number in range(item, end_item):
        ends[number] = LEFT
        if not is_asked[number]:
            continue
        slope, q, z = slopes[number], offsets[number], points[number]
        if not gather(matrices[number], starts, indptr, indices, data, diagonal, norms, steps, scale):
            continue
        label(norms, labels)
        copy(origin, start)
        product(indptr, indices, data, q, start, w, slip)
        if not references(
            starts, slope, 1.0, lower, upper, start, w, slip, scale, labels, R, least, most, reference, weights
        ):
            continue
        largest = measure(starts, slope, 1.0, lower, upper, indptr, indices, data, q, scale, weights, z, w, R)[0]
        for _ in range(refinements):
            if largest <= EXACT or not newton_step(
                starts, slope, 1.0, lower, upper, indptr, indices, data, z, w, R, scale, refining, x, way, by_z,
                by_w, J, place, step,
            ):
                break
            copy(z, start)
            for i in range(n):
                z[i] += step[i]
            before, largest = largest, measure(
                starts, slope, 1.0, lower, upper, indptr, indices, data, q, scale, weights, z, w, R
            )[0]
            if not largest < before:
                copy(start, z)
                measure(starts, slope, 1.0, lower, upper, indptr, indices, data, q, scale, weights, z, w, R)
                break
        free = np.int64(0)
        for k in range(blocks):
            degenerate[number, k] = _is_on_the_edge(
                k, starts, slope, lower, upper, indptr, indices, data, q, z, w, scale, edge, rounding, R
            )
            if block_residual(k, starts, slope, 1.0, lower, upper, z, w, scale, R) == WITHIN:
                w[starts[k]:starts[k + 1]] = 0.0  # it sticks
            block_derivative(k, starts, slope, 1.0, lower, upper, z, w, scale, x, way, by_z[k], by_w[k])
            is_free = False
            for i in range(m):
                is_free = is_free or by_w[k, 0, i] != 0.0
            for i in range(starts[k], starts[k + 1]):
                place[i] = free if is_free else -1
                free += is_free
        by_q[number], by_friction[number], ends[number] = 0.0, 0.0, REGULAR
        if free == 0:
            continue
        A, triangle = np.zeros((free, 2 * free + blocks)), np.empty((free, 2 * free + blocks))
        X = np.empty((free, free + blocks))
        for k in range(blocks):
            first = starts[k]
            if place[first] < 0:
                continue
            for i in range(m):
                row = place[first + i]
                for j in range(m):
                    A[row, place[first + j]] += by_z[k, i, j]
                    A[row, free + place[first + j]] = -by_w[k, i, j]
                    if by_w[k, i, j] != 0.0:
                        for p in range(indptr[first + j], indptr[first + j + 1]):
                            if place[indices[p]] >= 0:
                                A[row, place[indices[p]]] += by_w[k, i, j] * data[p]
            if block_residual(k, starts, slope, 1.0, lower, upper, z, w, scale, R) == ON:
                _by_friction(k, starts, slope, z, w, scale, by_w[k], x, own)
                for i in range(m):
                    A[place[first + i], 2 * free + k] = -own[i]
        is_in_one_unit = _is_in_one_unit(A, free)
        rank = _triangular(A, triangle, order, sizes, free)
        if rank < 0 or (rank < free and not is_in_one_unit):
            ends[number] = LEFT
            continue
        if rank < free:
            ends[number] = SINGULAR
        _least_norm(triangle, order, rank, free, X)
        for i in range(n):
            if place[i] >= 0:
                for j in range(n):
                    if place[j] >= 0:
                        by_q[number, i, j] = X[place[i], place[j]]
                for k in range(blocks):
                    by_friction[number, i, k] = X[place[i], free + k]
