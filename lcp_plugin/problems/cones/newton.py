"""Newton's method on the natural map of cones, for all problems of a stack at once, and the systems of its steps.

A step solves (R_z + R_w (M + ε D)) s = −R, D = diag(d). The proximal term ε falls with the residual. It keeps the
system regular if several impulses make the same motion. Open blocks leave the system. The unknowns of the system are
the unknowns of the blocks, or the velocities of the bodies if contacts are defined by bodies and these have fewer
velocities.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import scipy.sparse as sp

from ...core.checks import Array, Vector
from ...core.cone_stack import ConeStack, NaturalMap
from ...systems.free_systems import solved
from .factors import Factors, factorize_matrix

PROXIMAL, LEAST_PROXIMAL = 1e-3, 1e-12  # of d
LEAST_OF_BODIES = 1e-8  # the system of the velocities contains 1/ε
EXACT_OF_BODIES = 2.0**-36  # 1/ε enlarges rounding errors by so much
# residuals whose largest a step may reach; times ε after a full step without NEWTON_GAIN
RECENT, EASIER = 5, 0.01
MOST_HALVINGS, DECREASE = 14, 1e-4
NEWTON_GAIN, EXACT = 0.9, 2.0**-46  # a relative residual at rounding level of the linear systems


def newton_steps(
    stack: ConeStack, z: Vector, steps: int, goal: float
) -> Iterator[tuple[Any, Any, Any, float]]:
    """Yield the open problems, points, residuals and work, for the start and each step.

    Steps use a nonmonotone line search on ‖R‖₂. A problem whose residual is at most `goal` is left out.
    """
    instances, points, residual = np.arange(stack.B), z, stack.measure(z)
    yield instances, points, residual.largest, 1.0
    norms, widest = np.repeat(residual.norm[:, None], RECENT, 1), np.full(stack.B, PROXIMAL)
    best, since, least = residual.norm.copy(), np.zeros(stack.B, np.int64), accuracy_of(stack)[0]
    for count in range(steps):
        # Points without a gain; each halving is a point
        going = np.isfinite(residual.norm) & (residual.largest > goal) & (since < 60)
        if not going.any():
            return
        if not going.all():
            kept = (instances, points, norms, widest, best, since)
            instances, points, norms, widest, best, since = (array[going] for array in kept)
            stack, residual = stack.take(going), NaturalMap(*(array[going] for array in residual))
        by_z, by_w = stack.derivative(*residual[1:6])
        epsilon = np.maximum(np.minimum(widest, 0.1 * residual.largest), least)
        shift = (epsilon[:, None] * stack.d)[..., None, None]
        try:
            factors = factorize_blocks(stack, by_z + shift * by_w, by_w)
            step = factors.solve(-residual.R)
        except np.linalg.LinAlgError:
            return
        t, allowed, before, start = np.ones(stack.B), norms.max(1), residual.norm, points
        points = start + step
        residual = stack.measure(points)
        for _ in range(MOST_HALVINGS):
            is_short = ~(residual.norm <= (1.0 - DECREASE * t) * allowed)
            if not is_short.any():
                break
            t[is_short] *= 0.5
            points[is_short] = (start + t[:, None, None] * step)[is_short]
            shorter = stack.take(is_short).measure(points[is_short])
            for whole, part in zip(residual, shorter, strict=True):
                whole[is_short] = part
        is_poor = (t < 1.0) | (residual.norm >= before)
        narrower = np.where(residual.norm > NEWTON_GAIN * before, EASIER * epsilon, widest)
        widest = np.where(is_poor, PROXIMAL, narrower)
        norms[:, count % RECENT] = residual.norm
        tried = 1 - np.log2(t).astype(np.int64)  # each halving costs as much as a step
        since = np.where(residual.norm < NEWTON_GAIN * best, 0, since + tried)
        best = np.minimum(best, residual.norm)
        work = 2.0 + factors.entries / max(stack.pattern.nonzeros, 1)
        yield instances, points, residual.largest, work


def accuracy_of(stack: ConeStack) -> tuple[float, float]:
    """Return the least proximal term, and the residual that no further step reduces."""
    if stack.arms is not None and stack.arms.are_fewer(stack.pattern.n):
        return LEAST_OF_BODIES, EXACT_OF_BODIES
    return LEAST_PROXIMAL, EXACT


def polish_points(stack: ConeStack, z: Vector) -> tuple[Any, Any]:
    """Return points and residuals after the linear systems of two active sets, if these reduce the residual.

    The linear systems are solved because a small residual does not imply a small error if M is ill-conditioned.
    """
    least, exact = accuracy_of(stack)
    residual = stack.measure(z)
    best, smallest, shift = z, residual.largest, least * stack.d[..., None, None]
    for _ in range(2):
        if (residual.largest <= exact).all():
            break
        by_z, by_w = stack.derivative(*residual[1:6])
        try:
            z = z + factorize_blocks(stack, by_z + shift * by_w, by_w).solve(-residual.R)
        except np.linalg.LinAlgError:
            break
        residual = stack.measure(z)
        is_better = residual.largest < smallest
        best = np.where(is_better[:, None, None], z, best)
        smallest = np.where(is_better, residual.largest, smallest)
    return best, smallest


def factorize_blocks(stack: ConeStack, mixed: Vector, by_w: Array) -> Factors:
    """Return a solver for (mixed + by_w M) s = right, shape (B, k, m).

    Raises
    ------
    LinAlgError
        For a singular matrix.
    """
    pattern = stack.pattern
    # Few unknowns: open blocks are not left out
    if stack.B > 1 or (not pattern.is_sparse and pattern.n <= 12):
        J = whole_systems(stack, mixed, by_w)

        def solve_all(right: Vector) -> Any:
            return pattern.wide(solved(J, pattern.flat(right)[..., None])[..., 0])

        return Factors(solve_all, pattern.n**3 / 3.0)
    free = by_w[0].any((1, 2))
    arms = stack.arms
    if arms is not None and arms.are_fewer(pattern.sizes[free].sum()):
        return arms.factorize(mixed[0], by_w[0], np.flatnonzero(free))
    J, rows = system_of_free_rows(stack, mixed[0], by_w[0], free)
    inverse = factorize_matrix(J)

    def solve(right: Vector) -> Any:
        # of open blocks s is the right-hand side
        of_open = np.where(free[:, None], 0.0, right)
        known = right[0]
        if of_open.any():
            known = known - (by_w[0] @ pattern.times(of_open)[0][..., None])[..., 0]
        s = pattern.flat(of_open)
        s[0, rows] = inverse.solve(pattern.flat(known[None])[0, rows])
        return pattern.wide(s)

    return Factors(solve, inverse.entries)


def whole_systems(stack: ConeStack, mixed: Vector, by_w: Array) -> Any:
    """Return mixed + by_w M of each problem, shape (B, n, n)."""
    pattern = stack.pattern
    row, column = pattern.inner
    J = pattern.flat(by_w @ pattern.wide(pattern.M))
    J[:, row, column] += mixed[pattern.entry(row, column)]
    return J


def system_of_free_rows(stack: ConeStack, mixed: Any, by_w: Array, free: Any) -> tuple[Any, Any]:
    """Return mixed + by_w M on rows and columns of the free blocks of one problem, and the rows."""
    pattern = stack.pattern
    rows = np.flatnonzero(free[pattern.of_row])
    if not pattern.is_sparse:
        return whole_systems(stack, mixed[None], by_w[None])[0][np.ix_(rows, rows)], rows
    row, column = pattern.inner
    entry, indptr = pattern.entry(row, column), np.searchsorted(row, np.arange(pattern.n + 1))
    parts, shape = (part[None][entry][0] for part in (by_w, mixed)), pattern.M.shape
    of_w, of_z = (sp.csr_array((part, column, indptr), shape=shape)[rows] for part in parts)
    return (of_w @ pattern.M + of_z)[:, rows], rows
