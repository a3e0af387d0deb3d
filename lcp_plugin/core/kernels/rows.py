"""Compiled passes over rows: symmetry, sums over triangles, connected components; and the residual of one row."""

from __future__ import annotations

from .compilation import inlined, kernel, uintp

FEW = 8  # entries that are read one after the other


@inlined
def clamp(value, lower, upper):  # type: ignore[no-untyped-def]
    """Return mid(lower, upper, value), a NaN kept."""
    value = lower if lower > value else value
    return upper if upper < value else value


@inlined
def residual_of_row(step, z, lower, upper):  # type: ignore[no-untyped-def]
    """Return r = z − mid(lower, upper, z − step), as mid(z − upper, z − lower, step): a small step is not lost in z."""
    below, above = z - upper, z - lower
    step = below if below > step else step
    return above if above < step else step


@inlined
def wrong_part(w, z, lower, upper):  # type: ignore[no-untyped-def]
    """Return the part of w that has the wrong sign, |w| off bounds; not positive where w is right."""
    if z <= lower:
        return 0.0 if z >= upper else -w
    return w if z >= upper else abs(w)


@kernel
def unmirrored(begin, last, indices, data, tolerance, first_row, end_row):  # type: ignore[no-untyped-def]
    """Return how many more entries stand right of the diagonal than left of it; −n² where one lacks its mirror.

    Row i holds the columns indices[begin[i]:last[i]], sorted. An entry right of the diagonal lacks its mirror where
    there is none, or one that differs by more than the relative tolerance; without `data` the places alone count.
    """
    one, balance, has_data = uintp(1), 0, data.size > 0
    for i in range(uintp(first_row), uintp(end_row)):
        for m in range(uintp(begin[i]), uintp(last[i])):
            j = uintp(indices[m])
            if j <= i:
                balance -= j < i
                continue
            p, end = uintp(begin[j]), uintp(last[j])
            while end - p > uintp(FEW):
                middle = (p + end) // uintp(2)
                if uintp(indices[middle]) <= i:
                    p = middle
                else:
                    end = middle
            while p < end and uintp(indices[p]) < i:
                p += one
            if p == end or uintp(indices[p]) != i:
                return -begin.size * begin.size
            if has_data and not abs(data[m] - data[p]) <= tolerance * max(
                abs(data[m]), abs(data[p])
            ):
                return -begin.size * begin.size
            balance += 1
    return balance


@kernel
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


@kernel
def join(indptr, indices, first):  # type: ignore[no-untyped-def]
    """Write the least unknown of each one's connected component, by the entries of the rows."""
    for j in range(first.size):
        first[j] = j
    for i in range(indptr.size - 1):
        for k in range(indptr[i], indptr[i + 1]):
            a, b = i, indices[k]
            while first[a] != a:
                first[a] = first[first[a]]
                a = first[a]
            while first[b] != b:
                first[b] = first[first[b]]
                b = first[b]
            first[max(a, b)] = min(a, b)
    for j in range(first.size):
        first[j] = first[first[j]]  # of an earlier one, which is final
