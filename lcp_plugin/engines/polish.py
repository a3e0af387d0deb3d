"""Polish: Newton steps on the active set of a point (its active rows and its unknowns at a bound).

With the active rows W and the free unknowns F, the conditions of optimality are linear. From the point (x, y) the
step solves

    [P_FF + δ I   C_WFᵀ] [Δx_F]   [residual of the gradient]
    [C_WF         −δ I ] [Δy_W] = [residual of the rows    ],

a few times with one factorization, which exists in any order for δ > 0 (Vanderbei 1995, doi:10.1137/0805005). The
repeated steps tend to a solution of the system without δ, the nearest solution if there are several.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import numpy as np
import scipy.sparse as sp

from ..core.checks import AnyMatrix, Vector
from ..core.entries import largest_in_rows, or_one
from ..core.rounding import compensated_product
from .engine import EnginePoint, ProgramData

POLISH_STEPS = 2  # over both shifts
# With 2⁻⁵⁰, rounding errors left a gap of 4e-5 in an optimal control problem of 18 009 unknowns; with 2⁻⁴², 5e-7.
POLISH_SHIFTS = 2.0**-26, 2.0**-42  # δ relative to the largest entry of its row


def polish_steps(
    program: ProgramData, point: EnginePoint, rounds: int = POLISH_STEPS
) -> Iterator[EnginePoint]:
    """Yield the point after Newton's step on min(multiplier, slack) = 0, and again with a smaller δ.

    Each round begins at the last point. The polish ends when an active set repeats or its system is singular.

    Parameters
    ----------
    program : ProgramData
        Rows must be of one size, because slacks are compared with multipliers.
    point : EnginePoint
        Finite.

    Examples
    --------
    >>> none = np.zeros((0, 1)), np.zeros(0)
    >>> program = ProgramData(np.eye(1), np.array([-3.0]), *none, *none, np.array([0.0]), np.array([2.0]))
    >>> polished, *_ = polish_steps(program, EnginePoint(np.array([1.99]), np.zeros(0), 0, None))
    >>> polished.x
    array([2.])
    """
    lower, upper, m = program.lower, program.upper, program.h.size
    matrices = program.G, program.A
    rows = sp.vstack(matrices, "csr") if sp.issparse(program.G) else np.vstack(matrices)
    right, transposed, known = np.concatenate([program.h, program.b]), rows.T, set[bytes]()
    of_gradient = sp.csr_array(sp.hstack([program.P, transposed])) if sp.issparse(rows) else None
    x, y = np.clip(point.x, lower, upper), point.y
    for _ in range(rounds):
        descent = -(program.P @ x + program.c + transposed @ y)
        at_lower = (-descent > x - lower) | (lower == upper)
        at_upper = (descent > upper - x) & ~at_lower
        is_active = y > right - rows @ x
        is_active[m:] = True
        active_set = np.concatenate([at_lower, at_upper, is_active]).tobytes()
        if active_set in known:
            return
        known.add(active_set)
        free = np.flatnonzero(~(at_lower | at_upper))
        active = np.flatnonzero(is_active)
        x, y = np.where(at_lower, lower, np.where(at_upper, upper, x)), np.where(is_active, y, 0.0)
        blocks = program.P[free][:, free], rows[active][:, free]
        for shift in POLISH_SHIFTS:
            if (solve := shifted_solver(*blocks, shift)) is None:
                return
            for steps_left in reversed(range(15)):  # steps with one factorization
                gradient = program.P @ x + program.c + transposed @ y
                # Rounding errors of long sums are not random
                if of_gradient is not None and not steps_left:
                    gradient = compensated_product(of_gradient, np.append(x, y), program.c)[0]
                step = solve(np.concatenate([-gradient[free], (right - rows @ x)[active]]))
                if not np.isfinite(step).all():
                    return
                x[free] += step[: free.size]
                y[active] += step[free.size :]
            signed = np.append(np.maximum(y[:m], 0.0), y[m:])
            yield point._replace(x=np.clip(x, lower, upper), y=signed)


def shifted_solver(P: AnyMatrix, C: AnyMatrix, shift: float) -> Callable[[Vector], Vector] | None:
    """Return a solver with the matrix above, by LDLᵀ if it is sparse; None if it is singular or too large.

    δ is `shift` times the largest entry of its row.
    """
    m, n = C.shape
    if m + n == 0:
        return np.copy
    signs = np.where(np.arange(n + m) < n, 1.0, -1.0)
    if not sp.issparse(P):
        from scipy.linalg import lapack

        K = np.block([[P, C.T], [C, np.zeros((m, m))]])
        size = np.abs(K).max(axis=0)
        factor, pivots, info = lapack.dgetrf(K + np.diag(shift * signs * or_one(size)))
        return None if info else lambda right: lapack.dgetrs(factor, pivots, right)[0]
    below = sp.csr_array((C.data, C.indices, C.indptr), shape=(m, n + m))
    K = sp.vstack([sp.hstack([P, sp.csr_array(C.T)], "csr"), below], format="csr")
    size = largest_in_rows(K)
    shifted = sp.triu(K) + sp.diags_array(shift * signs * or_one(size))
    factorize: Callable[[Any], Any]
    try:
        from qdldl import Solver

        factorize = partial(Solver, upper=True)
    except ImportError:
        from scipy.sparse.linalg import splu

        factorize, shifted = splu, shifted + sp.triu(shifted, 1).T
    try:
        solver: Callable[[Vector], Vector] = factorize(sp.csc_matrix(shifted)).solve
    except RuntimeError:  # a pivot of 0, or no memory
        return None
    return solver
