"""One step to the linear system of the case that a point names: which rows act and which unknowns are at a bound.

With the rows W that act and the free unknowns F, the conditions of optimality are linear. From the point (x, y) the
step solves

    [P_FF + δ I   C_WFᵀ] [Δx_F]   [what is left of the gradient]
    [C_WF         −δ I ] [Δy_W] = [what is left of the rows    ],

a few times with the same factor: for δ > 0 it exists in any order (Vanderbei 1995, doi:10.1137/0805005), and the
repeated steps tend to a solution of the system without δ, the nearest one where there are several.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import scipy.sparse as sp

from ..core.checks import FloatVector
from .engine import Multipliers, Point, Statement

STEPS = 5
SHIFT = 2.0**-26  # δ beside the largest entry of its row: √ε


def polished(program: Statement, point: Point) -> Iterator[Point]:
    """Yield the point after the step, one of Newton's on min(multiplier, slack) = 0; none where a system is singular.

    Parameters
    ----------
    program : Statement
        Whose rows are of one size: slacks are compared with multipliers.
    point : Point
        Finite.

    Examples
    --------
    >>> none = np.zeros((0, 1)), np.zeros(0)
    >>> program = Statement(np.eye(1), np.array([-3.0]), *none, *none, np.array([0.0]), np.array([2.0]))
    >>> near = Multipliers(np.zeros(0), np.zeros(0), np.zeros(1), np.array([0.9]))
    >>> (found,) = polished(program, Point(np.array([1.99]), near, 0, None))
    >>> found.x, found.multipliers.upper
    (array([2.]), array([1.]))
    """
    lower, upper, m = program.lower, program.upper, program.h.size
    both = [program.G, program.A]
    rows = sp.csr_array(sp.vstack(both)) if sp.issparse(program.G) else np.vstack(both)
    right, given = np.concatenate([program.h, program.b]), point.multipliers
    x, y, pull = np.clip(point.x, lower, upper), np.concatenate(given[:2]), given.upper - given.lower
    at_upper = pull > upper - x
    at_lower = (-pull > x - lower) & ~at_upper | (lower == upper)
    acts = np.append(y[:m] > np.abs(right[:m] - program.G @ x), np.ones(right.size - m, np.bool_))
    acting, free = rows[np.flatnonzero(acts)], np.flatnonzero(~(at_lower | at_upper))
    is_whole, transposed = free.size == x.size, rows.T
    if (solve := _solver(*((program.P, acting) if is_whole else (program.P[free][:, free], acting[:, free])))) is None:
        return
    x, y = np.where(at_lower, lower, np.where(at_upper, upper, x)), np.where(acts, y, 0.0)
    for _ in range(STEPS):
        gradient = program.P @ x + program.c + transposed @ y
        step = solve(np.concatenate([-gradient[free], right[acts] - acting @ x]))
        if not np.isfinite(step).all():
            return
        x[free] += step[: free.size]
        y[acts] += step[free.size :]
    # Multipliers of bounds take what the gradient leaves there.
    x, y = np.clip(x, lower, upper), np.append(np.maximum(y[:m], 0.0), y[m:])
    gradient = program.P @ x + program.c + transposed @ y
    below = np.where(x == program.lower, np.maximum(gradient, 0.0), 0.0)
    above = np.where(x == program.upper, np.maximum(-gradient, 0.0), 0.0)
    yield point._replace(x=x, multipliers=Multipliers(y[:m], y[m:], below, above))


def _solver(P: Any, C: Any) -> Callable[[FloatVector], FloatVector] | None:
    """Return what solves with the matrix above, by LDLᵀ where it is sparse; None where no factor is found."""
    m, n = C.shape
    if m + n == 0:
        return np.copy
    signs = np.where(np.arange(n + m) < n, 1.0, -1.0)
    if not sp.issparse(P):
        from scipy.linalg import lapack

        K = np.block([[P, C.T], [C, np.zeros((m, m))]])
        size = np.abs(K).max(axis=0)
        factor, pivots, info = lapack.dgetrf(K + np.diag(SHIFT * signs * np.where(size > 0.0, size, 1.0)))
        return None if info else lambda right: lapack.dgetrs(factor, pivots, right)[0]
    import qdldl

    size, (begins, columns, entries) = np.zeros(n + m), (P.indptr, P.indices, P.data)
    rows_of_P, rows_of_C = (np.repeat(np.arange(one.shape[0]), np.diff(one.indptr)) for one in (P, C))
    for rows, found in ((rows_of_P, entries), (n + rows_of_C, C.data), (C.indices, C.data)):
        np.maximum.at(size, rows, np.abs(found))
    # Columns of the upper triangle are rows of the lower one, those of P and of C, each with its diagonal entry last.
    below = columns < rows_of_P
    ends = np.append(np.cumsum(np.append(0, below))[begins[1:]], np.count_nonzero(below) + C.indptr[1:])
    diagonal = np.append(P.diagonal(), np.zeros(m)) + SHIFT * signs * np.where(size > 0.0, size, 1.0)
    upper = sp.csc_matrix((
        np.insert(np.append(entries[below], C.data), ends, diagonal),
        np.insert(np.append(columns[below], C.indices), ends, np.arange(n + m)),
        np.append(0, ends + np.arange(1, n + m + 1)),
    ), shape=(n + m, n + m))
    try:
        solver: Callable[[FloatVector], FloatVector] = qdldl.Solver(upper, upper=True).solve
    except RuntimeError:  # a pivot of 0, or no memory
        return None
    return solver
