"""What Krylov steps do to whole vectors, two at a time: each is read and written once; compiled, arrays only."""

from __future__ import annotations

from ...kernels.compilation import compiled


@compiled
def add_both(factor, vector, to, other_factor, other, to_other):  # type: ignore[no-untyped-def]
    """Add factor · vector to one vector, and other_factor · other to another one."""
    for i in range(vector.size):
        to[i] += factor * vector[i]
        to_other[i] += other_factor * other[i]


@compiled
def add_within(origin, factor, vector, lower, upper, z):  # type: ignore[no-untyped-def]
    """Overwrite z by mid(lower, upper, origin + factor · vector)."""
    for i in range(origin.size):
        value = origin[i] + factor * vector[i]
        value = lower[i] if lower[i] > value else value
        z[i] = upper[i] if upper[i] < value else value
