"""What a round for contacts solves: the unknowns, their equations, and the names of their rows in the workspace.

Arrays as in :mod:`~lcp_plugin.methods.small.kernels.workspace`; their rows have other names while contacts are solved.
"""

from __future__ import annotations

import numpy as np

from ....core.kernels.compilation import helper, inlined
from .small_systems import eliminate, solve_again, substitute
from .workspace import (
    BASE,
    BASIC,
    CANDIDATE,
    DISTANCE,
    FOUND,
    FREE,
    HIGH,
    KEPT,
    LOW,
    OTHER,
    PIVOT_ROW,
    PLACE,
    ROW_UNIT,
    UNIT,
    WIDTH,
    W,
    Z,
)

# Rows of `real` for the unknowns: the point, its velocities, the best point, g, 1/G_ii (of f: ρ), μ (of f: its unit),
# what a projection finds.
X, V, BEST, FREELY, STEP, SLOPE, FOR = WIDTH, BASE, ROW_UNIT, UNIT, LOW, HIGH, DISTANCE
FIRST, SECOND = PIVOT_ROW, W  # coefficients of the columns of a round
OWN, PULLED, LEAST = Z, FOUND, KEPT  # G_ii; g where X is pulled to a point; the least residual, behind the last row
# Rows of `whole`: the row of M that an unknown is, that of −d behind them; whether it presses, sticks or slips; which
# cone a normal has, −1 for none; which unknowns, or pairs of them, a round solves for.
ROW, STATUS, CONE, SOLVED_FOR = FREE, OTHER, CANDIDATE, PLACE
OF_CONES = BASIC  # two numbers a cone, the row of λ and its first f; behind the last one, where another's would be

TINY_SHARE = 1e-9  # of the diagonal, added to it: what contacts leave open stays as near as it may to what it was
REFINED = 4
STICKS = 2


@helper
def move(real, matrix, unknowns):  # type: ignore[no-untyped-def]
    """Write V at X."""
    for i in range(unknowns):
        real[V, i] = real[PULLED, i]
    for j in range(unknowns):
        if real[X, j] != 0.0:
            add(real, matrix, unknowns, j, real[X, j])


@inlined
def add(real, matrix, unknowns, j, change):  # type: ignore[no-untyped-def]
    """Add to V what a change of unknown j does."""
    for i in range(unknowns):
        real[V, i] += change * matrix[unknowns + j, i]


@helper
def solve_equations(real, whole, matrix, n, unknowns, settled):  # type: ignore[no-untyped-def]
    """Move X, and V with it, to where the equations of what presses, sticks and slips hold; return how many these are.

    −1 stands for a system that is singular to working precision.
    """
    size = _name(real, whole, n, unknowns)
    move(real, matrix, unknowns)
    for t in range(size):
        for s in range(size):
            matrix[s, t] = _entry(real, whole, matrix, n, unknowns, s, t)
        matrix[t, t] *= 1.0 + TINY_SHARE
    last = np.inf
    for again in range(REFINED):
        wrong = 0.0
        for t in range(size):
            i, j = whole[SOLVED_FOR, t], whole[SOLVED_FOR, n + 1 + t]
            r = real[FIRST, t] * real[V, i] + (real[SECOND, t] * real[V, j] if i >= whole[OF_CONES, 1] else 0.0)
            matrix[t, size] = -r
            wrong = max(wrong, abs(r) * real[STEP, i])
        if again > 0 and (wrong <= 1e-4 * settled or not wrong < 0.5 * last):
            break
        last = wrong
        if again == 0:
            if not eliminate(matrix, whole, n, size):
                return -1
            substitute(matrix, size)
        else:
            solve_again(matrix, whole, n, size)
        for t in range(size):
            i, j = whole[SOLVED_FOR, t], whole[SOLVED_FOR, n + 1 + t]
            real[X, i] += real[FIRST, t] * matrix[t, size]
            real[X, j] += real[SECOND, t] * matrix[t, size]
        move(real, matrix, unknowns)
    return size


@inlined
def _entry(real, whole, matrix, n, unknowns, s, t):  # type: ignore[no-untyped-def]
    """Return what the unknown of column t does to the equation of row s."""
    i, j = whole[SOLVED_FOR, s], whole[SOLVED_FOR, n + 1 + s]
    p, q = unknowns + whole[SOLVED_FOR, t], unknowns + whole[SOLVED_FOR, n + 1 + t]
    a, b = real[FIRST, t], real[SECOND, t]
    entry = a * matrix[p, i] if b == 0.0 else a * matrix[p, i] + b * matrix[q, i]
    if i >= whole[OF_CONES, 1]:
        c, d = real[FIRST, s], real[SECOND, s]
        entry *= c
        if d != 0.0:
            entry += d * (a * matrix[p, j] + b * matrix[q, j])
    return entry


@helper
def _name(real, whole, n, unknowns):  # type: ignore[no-untyped-def]
    """Name what a round solves for, and move X to where it may be; return how many that are.

    A normal impulse takes the friction at its first edge along; at a further edge, impulse moves over from the first.
    """
    size = 0
    for i in range(whole[OF_CONES, 1]):
        presses, c = whole[STATUS, i] == 1, whole[CONE, i]
        real[X, i] = real[X, i] if presses else 0.0
        normal = size
        if presses:
            whole[SOLVED_FOR, size], whole[SOLVED_FOR, n + 1 + size] = i, i
            real[FIRST, size], real[SECOND, size] = 1.0, 0.0
            size += 1
        if c < 0:
            continue
        first, total = -1, 0.0
        begin, end = whole[OF_CONES, 2 * c + 1], whole[OF_CONES, 2 * c + 3]
        for j in range(begin, end):
            status = whole[STATUS, j]
            if not presses or status == 0:
                real[X, j] = 0.0
            elif status == STICKS:
                whole[SOLVED_FOR, size], whole[SOLVED_FOR, n + 1 + size] = j, j
                real[FIRST, size], real[SECOND, size] = 1.0, 0.0
                size += 1
            else:
                real[X, j] = max(status * real[X, j], 0.0)
                total += real[X, j]
                if first < 0:
                    first = j
                    whole[SOLVED_FOR, n + 1 + normal], real[SECOND, normal] = j, real[SLOPE, i] * status
                else:
                    whole[SOLVED_FOR, size], whole[SOLVED_FOR, n + 1 + size] = j, first
                    real[FIRST, size], real[SECOND, size] = status, -whole[STATUS, first]
                    size += 1
        if first >= 0:
            radius = real[SLOPE, i] * real[X, i]
            for j in range(begin, end):
                share = real[X, j] / total if total > 0.0 else 1.0 if j == first else 0.0
                real[X, j] = whole[STATUS, j] * radius * share
    return size
