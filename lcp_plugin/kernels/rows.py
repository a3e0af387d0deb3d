"""Compiled passes over the rows of a matrix: is it symmetric, sums over its triangles, what a solve leaves over."""

from __future__ import annotations

from numba import uintp

from .compilation import compiled


@compiled
def is_mirrored(indptr, indices, data, tolerance):  # type: ignore[no-untyped-def]
    """Return whether a CSR array is its transpose up to a relative tolerance in each entry; rows sorted. One pass.

    Row by row, the entries right of the diagonal meet the entries below it in the order in which those are stored.
    """
    one = uintp(1)
    place = indptr[:-1].copy()
    for i in range(uintp(indptr.size - 1)):
        k = uintp(place[i])
        end = uintp(indptr[i + one])
        if k < end and uintp(indices[k]) < i:
            return False  # an entry left of the diagonal that no row above has met
        for m in range(k, end):
            j = uintp(indices[m])
            if j == i:
                continue
            p = uintp(place[j])
            if p >= uintp(indptr[j + one]) or uintp(indices[p]) != i:
                return False
            if not abs(data[m] - data[p]) <= tolerance * max(abs(data[m]), abs(data[p])):
                return False
            place[j] = p + one
    return True


@compiled
def triangle_sums(indptr, indices, data, scale, v, lower, upper):  # type: ignore[no-untyped-def]
    """Fill lower[i] and upper[i] with scale_i Σ |m_ij| v_j over j < i and j > i."""
    for i in range(lower.size):
        below = above = 0.0
        weight = scale[i]
        for k in range(indptr[i], indptr[i + 1]):
            j = indices[k]
            if j < i:
                below += (abs(data[k]) * weight) * v[j]
            elif j > i:
                above += (abs(data[k]) * weight) * v[j]
        lower[i] = below
        upper[i] = above


@compiled
def left_over(indptr, indices, data, diagonal, right, x, left):  # type: ignore[no-untyped-def]
    """Fill left with right − (M + diag(diagonal)) x; return its largest magnitude, NaN where one is NaN."""
    largest = 0.0
    for i in range(left.size):
        value = right[i] - diagonal[i] * x[i]
        for k in range(indptr[i], indptr[i + 1]):
            value -= data[k] * x[indices[k]]
        left[i] = value
        if not abs(value) <= largest:
            largest = abs(value) if largest == largest else largest
    return largest
