"""The entries and the residual of one row, compiled."""

from __future__ import annotations

from .compilation import inline, uintp


@inline
def clamp(value, lower, upper):  # type: ignore[no-untyped-def]
    """Return mid(lower, upper, value), a NaN kept."""
    value = lower if lower > value else value
    return upper if upper < value else value


@inline
def residual_of_row(step, z, lower, upper):  # type: ignore[no-untyped-def]
    """Return r = z − mid(lower, upper, z − step), as mid(z − upper, z − lower, step): a small step is not lost in z."""
    below, above = z - upper, z - lower
    step = below if below > step else step
    return above if above < step else step


@inline
def halves_of_row(indptr, split, i, backward):  # type: ignore[no-untyped-def]
    """Return first and last of the entries of row i that a sweep has updated, then of the other entries."""
    middle = uintp(split[i])
    if backward:
        return middle, uintp(indptr[i + uintp(1)]), uintp(indptr[i]), middle
    return uintp(indptr[i]), middle, middle, uintp(indptr[i + uintp(1)])


@inline
def without_nearest(first, last, backward):  # type: ignore[no-untyped-def]
    """Return the updated entry nearest to the diagonal, and first and last of the others."""
    if backward:
        return first, first + uintp(1), last
    return last - uintp(1), first, last - uintp(1)
