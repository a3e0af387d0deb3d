"""The residual of one row, compiled."""

from __future__ import annotations

from .compilation import inline


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
