"""Rounds for contacts: sweeps guess which of them open, stick and slip, and rounds solve for that.

Of a problem that :mod:`.friction_pyramids` has read, the unknowns are x = (p, f), less than half of the rows:

    p ⊥ u ≥ 0,    f = the point of Σ|f| ≤ μ p next to f − ρ v,    λ = max |v|,

u and v the velocities G x + g along normals and edges. A sweep takes one contact after the other by this equation. A
round keeps, of what sweeps or the last round left, which contacts press, which of these stick (Σ|f| < μ p: v = 0) and
at which edges the others slip (f on these, where |v| is largest), and solves for p and f. What contacts leave open, more
of them than motions, stays near to what it was: a small share of the diagonal is added, and the solution refined. Where
rounds do not settle, more sweeps follow from the best point so far.

Arrays as in :mod:`~lcp_plugin.core.kernels.workspace`, with rows of other names while this lasts.
"""

from __future__ import annotations

import numpy as np

from ....core.kernels.compilation import compiled_into_others, compiled_part
from ....core.kernels.workspace import (
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
)
from .small_systems import eliminate, solve_again, substitute

# Rows of `real` for the unknowns: the point, its velocities, the best point, g, 1/G_ii (of f: ρ), μ (of f: its unit),
# what a projection finds.
X, V, BEST, FREELY, STEP, SLOPE, FOR = WIDTH, BASE, ROW_UNIT, UNIT, LOW, HIGH, DISTANCE
FIRST, SECOND = PIVOT_ROW, W  # coefficients of the columns of a round
LEAST = KEPT  # the least residual so far, behind the last row
# Rows of `whole`: the row of M that an unknown is, that of −d behind them; whether it presses, sticks or slips; which
# cone a normal has, −1 for none; which unknowns, or pairs of them, a round solves for.
ROW, STATUS, CONE, SOLVED_FOR = FREE, OTHER, CANDIDATE, PLACE
OF_CONES = BASIC  # two numbers a cone, the row of λ and its first f; behind the last one, where another's would be

SETTLED = 1e-12  # of the residual without impulses
NEAR = 1e-9  # what is added, of the diagonal
FEWEST_SWEEPS, MOST_SWEEPS = 8, 128  # before the first rounds and before the last, four times as many each time
ROUNDS, IDLE = 12, 3
REFINED = 4
STICKS = 2


@compiled_part
def solve_contacts(real, whole, room, n, unknowns, has_start):  # type: ignore[no-untyped-def]
    """Write FOUND; return the entries touched. FOUND holds the start, used where `has_start` says so."""
    for i in range(unknowns):
        real[X, i], real[V, i], real[BEST, i] = 0.0, real[FREELY, i], 0.0
    none = real[LEAST, n] = _residual(real, whole)
    touched, settled, sweeps = float(n * n), SETTLED * none, FEWEST_SWEEPS
    if has_start:
        _begin_at(real, whole, n, unknowns)
        touched += _rounds(real, whole, room, n, unknowns, settled)
    while real[LEAST, n] > settled and sweeps <= MOST_SWEEPS:
        touched += _sweeps(real, whole, room, n, unknowns, sweeps)
        touched += _rounds(real, whole, room, n, unknowns, settled)
        sweeps *= 4
    for i in range(unknowns):
        real[X, i] = real[BEST, i]
    _move(real, room, unknowns)
    _classify(real, whole)
    _write(real, whole, n, unknowns)
    return touched


@compiled_part
def _sweeps(real, whole, room, n, unknowns, count):  # type: ignore[no-untyped-def]
    """Sweep so many times from the best point, and note what presses, sticks and slips then; return the work."""
    for i in range(unknowns):
        real[X, i] = real[BEST, i]
    _move(real, room, unknowns)
    for _ in range(count):
        _sweep(real, whole, room, unknowns)
    _keep(real, n, unknowns, _residual(real, whole))
    _classify(real, whole)
    return float((count + 1) * unknowns * unknowns)


@compiled_into_others
def _sign(x):  # type: ignore[no-untyped-def]
    return 1 if x > 0.0 else -1 if x < 0.0 else 0


@compiled_into_others
def _radius(real, i):  # type: ignore[no-untyped-def]
    """Return μ p of normal i."""
    return real[SLOPE, i] * max(real[X, i], 0.0)


@compiled_part
def _nearest(real, first, end, radius):  # type: ignore[no-untyped-def]
    """Write to FOR the point of Σ|f| ≤ radius next to f − ρ v, first ≤ i < end; return whether it is inside."""
    total, count = 0.0, end - first
    for i in range(first, end):
        real[FOR, i] = real[X, i] - real[STEP, i] * real[V, i]
        total += abs(real[FOR, i])
    if total <= radius:
        return True
    cut = (total - radius) / count
    for _ in range(count):  # edges that fall out, until none does
        above, left = 0.0, 0
        for i in range(first, end):
            if abs(real[FOR, i]) > cut:
                above += abs(real[FOR, i])
                left += 1
        if left == 0 or left == count:
            break
        count, cut = left, (above - radius) / left
    for i in range(first, end):
        size = abs(real[FOR, i]) - cut
        real[FOR, i] = (size if real[FOR, i] > 0.0 else -size) if size > 0.0 and radius > 0.0 else 0.0
    return False


@compiled_part
def _residual(real, whole):  # type: ignore[no-untyped-def]
    """Return how far X is from the equations of contact, in the unit of impulses; p is made ≥ 0 before."""
    plain, largest = whole[OF_CONES, 1], 0.0
    for i in range(plain):
        r = abs(min(real[X, i], real[STEP, i] * real[V, i]))
        largest = r if not r <= largest else largest
    for i in range(plain):
        c = whole[CONE, i]
        if c >= 0:
            first, end = whole[OF_CONES, 2 * c + 1], whole[OF_CONES, 2 * c + 3]
            _nearest(real, first, end, _radius(real, i))
            for j in range(first, end):
                r = abs(real[X, j] - real[FOR, j])
                largest = r if not r <= largest else largest
    return largest


@compiled_part
def _move(real, room, unknowns):  # type: ignore[no-untyped-def]
    """Write V at X."""
    for i in range(unknowns):
        real[V, i] = real[FREELY, i]
    for j in range(unknowns):
        if real[X, j] != 0.0:
            _add(real, room, unknowns, j, real[X, j])


@compiled_into_others
def _add(real, room, unknowns, j, change):  # type: ignore[no-untyped-def]
    """Add to V what a change of unknown j does."""
    for i in range(unknowns):
        real[V, i] += change * room[unknowns + j, i]


@compiled_part
def _sweep(real, whole, room, unknowns):  # type: ignore[no-untyped-def]
    """Take each contact to the solution of its own equations, its friction by a step of projection."""
    for i in range(whole[OF_CONES, 1]):
        new = max(real[X, i] - real[STEP, i] * real[V, i], 0.0)
        if new != real[X, i]:
            change, real[X, i] = new - real[X, i], new
            _add(real, room, unknowns, i, change)
        c = whole[CONE, i]
        if c >= 0:
            first, end = whole[OF_CONES, 2 * c + 1], whole[OF_CONES, 2 * c + 3]
            _nearest(real, first, end, _radius(real, i))
            for j in range(first, end):
                if real[FOR, j] != real[X, j]:
                    change, real[X, j] = real[FOR, j] - real[X, j], real[FOR, j]
                    _add(real, room, unknowns, j, change)


@compiled_into_others
def _keep(real, n, unknowns, size):  # type: ignore[no-untyped-def]
    """Keep X where its residual is the least so far; return whether it is."""
    if not size < real[LEAST, n]:
        return False
    real[LEAST, n] = size
    for i in range(unknowns):
        real[BEST, i] = real[X, i]
    return True


@compiled_part
def _begin_at(real, whole, n, unknowns):  # type: ignore[no-untyped-def]
    """Take X and what presses, sticks and slips from FOUND."""
    plain = whole[OF_CONES, 1]
    for i in range(plain):
        real[X, i] = real[FOUND, whole[ROW, i]]
        whole[STATUS, i] = real[X, i] > 0.0
    for i in range(plain, unknowns):
        real[X, i] = (real[FOUND, whole[ROW, i]] - real[FOUND, whole[ROW, n + 1 + i]]) / real[SLOPE, i]
    for i in range(plain):
        c = whole[CONE, i]
        if c < 0:
            continue
        slips = real[FOUND, whole[OF_CONES, 2 * c]] > 0.0
        for j in range(whole[OF_CONES, 2 * c + 1], whole[OF_CONES, 2 * c + 3]):
            sign = _sign(real[X, j])
            whole[STATUS, j] = (sign if slips else STICKS) if whole[STATUS, i] == 1 else 0


@compiled_part
def _classify(real, whole):  # type: ignore[no-untyped-def]
    """Note what presses, sticks and slips by the equations of contact at X; return how many changed."""
    changes = 0
    for i in range(whole[OF_CONES, 1]):
        p = real[X, i] - real[STEP, i] * real[V, i]
        changes += whole[STATUS, i] != (p > 0.0)
        whole[STATUS, i] = p > 0.0
        c = whole[CONE, i]
        if c < 0:
            continue
        first, end = whole[OF_CONES, 2 * c + 1], whole[OF_CONES, 2 * c + 3]
        sticks = _nearest(real, first, end, real[SLOPE, i] * max(p, 0.0))
        for j in range(first, end):
            sign = _sign(real[FOR, j])
            status = (STICKS if sticks else sign) if p > 0.0 else 0
            changes += whole[STATUS, j] != status
            whole[STATUS, j] = status
    return changes


@compiled_part
def _rounds(real, whole, room, n, unknowns, settled):  # type: ignore[no-untyped-def]
    """Solve for what presses, sticks and slips until that is the answer or gets no better; return the work."""
    touched, idle, least = 0.0, 0, np.inf
    for _ in range(ROUNDS):
        solved = _solve(real, whole, room, n, unknowns, settled)
        if solved < 0:
            break
        touched += 3.0 * unknowns * unknowns + solved * solved * (solved / 3.0)
        changes = _classify(real, whole)
        if _project(real, whole):
            _move(real, room, unknowns)
        size = _residual(real, whole)
        _keep(real, n, unknowns, size)
        idle, least = (0, size) if size < least else (idle + 1, least)
        if size <= settled or idle >= IDLE or changes == 0:
            break
    return touched


@compiled_part
def _project(real, whole):  # type: ignore[no-untyped-def]
    """Move X to p ≥ 0 and Σ|f| ≤ μ p; return whether it was elsewhere."""
    is_moved = False
    for i in range(whole[OF_CONES, 1]):
        if real[X, i] < 0.0:
            real[X, i], is_moved = 0.0, True
        c = whole[CONE, i]
        if c < 0:
            continue
        total, radius = 0.0, real[SLOPE, i] * real[X, i]
        for j in range(whole[OF_CONES, 2 * c + 1], whole[OF_CONES, 2 * c + 3]):
            total += abs(real[X, j])
        if total > radius:
            for j in range(whole[OF_CONES, 2 * c + 1], whole[OF_CONES, 2 * c + 3]):
                real[X, j] *= radius / total
            is_moved = True
    return is_moved


@compiled_part
def _solve(real, whole, room, n, unknowns, settled):  # type: ignore[no-untyped-def]
    """Move X, and V with it, to where the equations of what presses, sticks and slips hold; return how many these are.

    −1 stands for a system that is singular to working precision.
    """
    size = _name(real, whole, n, unknowns)
    _move(real, room, unknowns)
    for t in range(size):
        for s in range(size):
            room[s, t] = _entry(real, whole, room, n, unknowns, s, t)
        room[t, t] *= 1.0 + NEAR
    last = np.inf
    for again in range(REFINED):
        wrong = 0.0
        for t in range(size):
            i, j = whole[SOLVED_FOR, t], whole[SOLVED_FOR, n + 1 + t]
            r = real[FIRST, t] * real[V, i] + (real[SECOND, t] * real[V, j] if i >= whole[OF_CONES, 1] else 0.0)
            room[t, size] = -r
            wrong = max(wrong, abs(r) * real[STEP, i])
        if again > 0 and (wrong <= 0.01 * settled or not wrong < 0.5 * last):
            break
        last = wrong
        if again == 0:
            if not eliminate(room, whole, n, size):
                return -1
            substitute(room, size)
        else:
            solve_again(room, whole, n, size)
        for t in range(size):
            i, j = whole[SOLVED_FOR, t], whole[SOLVED_FOR, n + 1 + t]
            real[X, i] += real[FIRST, t] * room[t, size]
            real[X, j] += real[SECOND, t] * room[t, size]
        _move(real, room, unknowns)
    return size


@compiled_into_others
def _entry(real, whole, room, n, unknowns, s, t):  # type: ignore[no-untyped-def]
    """Return what the unknown of column t does to the equation of row s."""
    i, j = whole[SOLVED_FOR, s], whole[SOLVED_FOR, n + 1 + s]
    p, q = unknowns + whole[SOLVED_FOR, t], unknowns + whole[SOLVED_FOR, n + 1 + t]
    a, b = real[FIRST, t], real[SECOND, t]
    entry = a * room[p, i] if b == 0.0 else a * room[p, i] + b * room[q, i]
    if i >= whole[OF_CONES, 1]:
        c, d = real[FIRST, s], real[SECOND, s]
        entry *= c
        if d != 0.0:
            entry += d * (a * room[p, j] + b * room[q, j])
    return entry


@compiled_part
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


@compiled_part
def _write(real, whole, n, unknowns):  # type: ignore[no-untyped-def]
    """Write X, what it is at each edge, and the speeds λ to FOUND."""
    for i in range(n):
        real[FOUND, i] = 0.0
    for i in range(whole[OF_CONES, 1]):
        real[FOUND, whole[ROW, i]] = real[X, i]
    c, fastest = 0, 0.0
    for j in range(whole[OF_CONES, 1], unknowns):
        x = real[X, j] * real[SLOPE, j]
        real[FOUND, whole[ROW, j if x > 0.0 else n + 1 + j]] = abs(x)
        fastest = max(fastest, 0.0 if whole[STATUS, j] == STICKS else abs(real[V, j]))
        if j + 1 == whole[OF_CONES, 2 * c + 3]:
            real[FOUND, whole[OF_CONES, 2 * c]] = fastest
            c, fastest = c + 1, 0.0
