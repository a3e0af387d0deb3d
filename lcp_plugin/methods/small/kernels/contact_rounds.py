"""Rounds for contacts: sweeps guess which of them open, stick and slip, and rounds solve for that.

Of a problem that :mod:`.friction_pyramids` has read, the unknowns are x = (p, f), half of the rows:

    p ⊥ u ≥ 0,    f = the point of Σ|f| ≤ μ p next to f − ρ v,    λ = max |v|,

u and v the velocities G x + g along normals and edges. A sweep takes one contact after the other by this equation. A
round keeps, of what sweeps or the last round left, which contacts press, which of these stick (Σ|f| < μ p: v = 0) and
at which edges the others slip (f on these, where |v| is largest), and solves for p and f: a semismooth Newton step.

More contacts than motions leave x open, and rounds astray. Then X is pulled to a point near, velocities being
G x + g + ε D (x − that point) with D the diagonal of G, which leaves nothing open; the answer to that is the next point
(the proximal point method, whose ends have ε D (x − that point) = 0), and a round without the pull may be the last.

References
----------
R. T. Rockafellar, SIAM J. Control Optim. 14 (1976), doi:10.1137/0314056; P. Alart, A. Curnier, Comput. Methods Appl.
Mech. Eng. 92 (1991), doi:10.1016/0045-7825(91)90022-X (rounds).

Arrays as in :mod:`.contact_systems`.
"""

from __future__ import annotations

import numpy as np

from ....core.kernels.compilation import helper, inlined
from .contact_systems import (
    BEST,
    CONE,
    FOR,
    FREELY,
    LEAST,
    OF_CONES,
    OWN,
    PULLED,
    ROW,
    SLOPE,
    STATUS,
    STEP,
    STICKS,
    V,
    X,
    add,
    move,
    solve_equations,
)
from .workspace import FOUND, KEPT

SETTLED = 1e-10  # of the residual without impulses; rounds that arrive leave less
PROMISING = 1e-3  # the same, from which a round of the problem itself may be the last
FIRST_NEAR, LAST_NEAR = 0.01, 1e-6  # ε
FIRST_SWEEPS, SWEEPS = 8, 4
ROUNDS, MOST_ROUNDS, IDLE = 12, 40, 3  # in a row; altogether, and one for three rows; in vain, before X is pulled


@helper
def solve_contacts(real, whole, matrix, n, unknowns, has_start):  # type: ignore[no-untyped-def]
    """Write FOUND; return the entries touched. FOUND holds the start, used where `has_start` says so."""
    for i in range(unknowns):
        real[X, i], real[V, i], real[BEST, i], real[OWN, i] = 0.0, real[FREELY, i], 0.0, matrix[unknowns + i, i]
    none = real[LEAST, n] = _residual(real, whole)
    settled, near = SETTLED * none, FIRST_NEAR
    if has_start:
        _begin_at(real, whole, n, unknowns)
        _copy(real, unknowns, X, BEST)
        _stay_near(real, matrix, unknowns, 0.0)
    else:
        _stay_near(real, matrix, unknowns, 0.0)
        _sweep(real, whole, matrix, unknowns, FIRST_SWEEPS)
        _keep(real, n, unknowns, _residual(real, whole))
    rounds, _ = _rounds(real, whole, matrix, n, unknowns, settled, 1 if has_start else IDLE, True)
    _copy(real, unknowns, BEST, X)
    while real[LEAST, n] > settled and rounds < MOST_ROUNDS + n // 3:
        _stay_near(real, matrix, unknowns, near)
        _sweep(real, whole, matrix, unknowns, SWEEPS)
        made, is_settled = _rounds(real, whole, matrix, n, unknowns, settled, ROUNDS, False)
        _stay_near(real, matrix, unknowns, 0.0)
        move(real, matrix, unknowns)
        size = _residual(real, whole)
        _keep(real, n, unknowns, size)
        rounds += made
        if is_settled and size <= PROMISING * none:
            for i in range(unknowns):
                real[KEPT, unknowns + i] = real[X, i]
            _classify(real, whole)
            made, _ = _rounds(real, whole, matrix, n, unknowns, settled, 0, True)
            for i in range(unknowns):
                real[X, i] = real[KEPT, unknowns + i]
            rounds += made
        near = max(0.5 * near, LAST_NEAR) if is_settled else min(5.0 * near, 1.0)
    _copy(real, unknowns, BEST, X)
    move(real, matrix, unknowns)
    _classify(real, whole)
    _write(real, whole, n, unknowns)
    return float(n * n + (rounds + 1.0) * (4.0 + unknowns / 12.0) * unknowns * unknowns)


@inlined
def _copy(real, unknowns, source, target):  # type: ignore[no-untyped-def]
    for i in range(unknowns):
        real[target, i] = real[source, i]


@helper
def _stay_near(real, matrix, unknowns, near):  # type: ignore[no-untyped-def]
    """Let velocities grow with the distance from X, by that share of the diagonal; 0 gives those of the problem."""
    for i in range(unknowns):
        matrix[unknowns + i, i] = real[OWN, i] * (1.0 + near)
        real[PULLED, i] = real[FREELY, i] - near * real[OWN, i] * real[X, i]


@inlined
def _sign(x):  # type: ignore[no-untyped-def]
    return 1 if x > 0.0 else -1 if x < 0.0 else 0


@helper
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
        if left in (0, count):
            break
        count, cut = left, (above - radius) / left
    for i in range(first, end):
        size = abs(real[FOR, i]) - cut
        real[FOR, i] = (size if real[FOR, i] > 0.0 else -size) if size > 0.0 and radius > 0.0 else 0.0
    return False


@helper
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
            _nearest(real, first, end, real[SLOPE, i] * max(real[X, i], 0.0))
            for j in range(first, end):
                r = abs(real[X, j] - real[FOR, j])
                largest = r if not r <= largest else largest
    return largest


@helper
def _sweep(real, whole, matrix, unknowns, count):  # type: ignore[no-untyped-def]
    """Take each contact to the solution of its own equations, its friction by a step of projection, so many times."""
    move(real, matrix, unknowns)
    for _ in range(count):
        for i in range(whole[OF_CONES, 1]):
            new = max(real[X, i] - real[STEP, i] * real[V, i], 0.0)
            if new != real[X, i]:
                change, real[X, i] = new - real[X, i], new
                add(real, matrix, unknowns, i, change)
            c = whole[CONE, i]
            if c < 0:
                continue
            first, end = whole[OF_CONES, 2 * c + 1], whole[OF_CONES, 2 * c + 3]
            _nearest(real, first, end, real[SLOPE, i] * real[X, i])
            for j in range(first, end):
                if real[FOR, j] != real[X, j]:
                    change, real[X, j] = real[FOR, j] - real[X, j], real[FOR, j]
                    add(real, matrix, unknowns, j, change)
    _classify(real, whole)


@inlined
def _keep(real, n, unknowns, size):  # type: ignore[no-untyped-def]
    """Keep X where its residual is the least so far; return whether it is."""
    if not size < real[LEAST, n]:
        return False
    real[LEAST, n] = size
    for i in range(unknowns):
        real[BEST, i] = real[X, i]
    return True


@helper
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


@helper
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


@helper
def _rounds(real, whole, matrix, n, unknowns, settled, idle, is_kept):  # type: ignore[no-untyped-def]
    """Solve for what presses, sticks and slips until that is the answer, or so many rounds got no better.

    Returns how many rounds were made, and whether they settled; X is the best of them. With `is_kept` they are those
    of the problem itself, and BEST is kept.
    """
    made, least, is_settled = 0, np.inf, False
    while made < ROUNDS and not is_settled:
        if solve_equations(real, whole, matrix, n, unknowns, settled) < 0:
            break
        made += 1
        is_settled = _classify(real, whole) == 0
        if _project(real, whole):
            move(real, matrix, unknowns)
        size = _residual(real, whole)
        is_settled |= size <= settled
        if is_kept:
            _keep(real, n, unknowns, size)
        if size < least:
            least = size
            _copy(real, unknowns, X, KEPT)
        else:
            idle -= 1
        if idle <= 0:
            break
    if made > 0:
        _copy(real, unknowns, KEPT, X)
    return made, is_settled


@helper
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


@helper
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
