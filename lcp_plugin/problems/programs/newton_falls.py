"""By how much Newton's steps lower a program's objective from a point whose residuals are small.

Along a direction in which P is nearly singular a small rest of the gradient may be all that there is of a cost, and
stand beside products p_jk x_k that cancel. A residual cannot tell; a step can. From x, with the rows W that act and the
free unknowns F, d solves

    [P_FF   C_WFᵀ] [d ]     [the gradient that is left, of P x + c + C_Wᵀ y_W]
    [C_WF    0   ] [Δy] = − [0                                               ]

and x + t d, t ≤ 1, goes on to the first constraint that stops it, which acts from there on. What the objective falls by
is surely to be had: it is computed from the gradient without rounding, less what rounding of x may be of it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ...core.checks import FloatVector
from ...core.rounding import compensated_product
from ...engines.polish import block, shifted_solver

if TYPE_CHECKING:
    from .program import QuadraticProgram

SINGULAR = 2.0**-46  # of the largest entry of a row: P is 0 along what is flatter
ROUNDS = 12  # constraints that may stop a step, one after the other
REFINED = 2  # times, with the same factor
TOUCHING = 1e-7  # of a row's terms, between it and its limit
HELD = 1e-6  # of the terms of C_W d: a step along which they are more is none


@np.errstate(divide="ignore", invalid="ignore")  # a limit that d leads away from
def newton_fall(
    program: QuadraticProgram,
    x: FloatVector,
    y: FloatVector,
    of_lower: FloatVector,
    of_upper: FloatVector,
    blur: FloatVector,
) -> float:
    """Return by how much a few of Newton's steps from x surely lower the objective within the constraints.

    Parameters
    ----------
    x, y, of_lower, of_upper : arrays, shapes (n,), (rows,), (n,), (n,)
        The point, and the multipliers of rows and bounds.
    blur : array, shape (n,)
        What rounding may be of each component of the gradient.

    Examples
    --------
    >>> from lcp_plugin import QuadraticProgram
    >>> none, program = np.zeros(0), QuadraticProgram([[1, 0], [0, 1e-12]], [-1, -1e-6], upper=[9, 1e5])
    >>> round(newton_fall(program, np.ones(2), none, np.zeros(2), np.zeros(2), np.full(2, 1e-16)), 6)
    0.094999
    """
    matrices, (m, p, n, _) = program.matrices, program.matrices.sizes
    P = program.P
    C: Any = (
        matrices.dense_rows
        if isinstance(P, np.ndarray) and not matrices.has_sparse_rows
        else matrices.rows
    )
    P = P if isinstance(C, np.ndarray) else matrices.sparse_P
    limits, sizes, fall = np.concatenate([program.h, program.b]), np.abs(C), 0.0
    lower, upper = program.lower, program.upper
    slack = limits - C @ x
    acts = (y > 0.0) & (slack <= TOUCHING * (np.abs(limits) + sizes @ np.abs(x)))
    acts[m:] = True
    free = ~((x <= lower) & (of_lower > 0.0) | (x >= upper) & (of_upper > 0.0) | (lower == upper))
    for _ in range(ROUNDS):
        of_acting = np.where(acts, y, 0.0)
        left = compensated_product(matrices.gradient, np.concatenate([x, of_acting]), program.c)[0]
        d, change = np.zeros(n), np.zeros(m + p)
        blocks = block(P, free, free), block(C, acts, free)
        if (left[free] == 0.0).all() or (solve := shifted_solver(*blocks, SINGULAR)) is None:
            return fall
        moved = blocks[0].shape[0]
        for _ in range(1 + REFINED):
            rest = (left + P @ d + change @ C)[free]
            step = solve(-np.concatenate([rest, (C @ d)[acts]]))
            d[free] += step[:moved]
            change[acts] += step[moved:]
        along, bend = C @ d, float(d @ (P @ d))
        slope = float(left @ d + blur @ np.abs(d) + np.abs(of_acting) @ np.abs(along))
        if not (slope < 0.0 <= bend) or (np.abs(along) > HELD * (sizes @ np.abs(d)))[acts].any():
            return fall
        ends = [
            np.where((along > 0.0) & ~acts, np.maximum(slack, 0.0) / along, np.inf),
            np.where(d < 0.0, (lower - x) / d, np.where(d > 0.0, (upper - x) / d, np.inf)),
        ]
        stops = np.concatenate(ends)
        first = int(stops.argmin())
        t = min(1.0, float(stops[first]))
        fall -= t * slope + 0.5 * t * t * bend
        if t == 1.0:
            return fall
        x, y = np.clip(x + t * d, lower, upper), of_acting + t * change
        slack = limits - C @ x
        if first < m + p:
            acts[first] = True
        else:
            free[first - m - p] = False
    return fall
