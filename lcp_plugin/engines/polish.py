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

from ..core.checks import BoolVector, FloatVector, assembled
from ..core.matrix.structure import row_numbers
from .engine import Multipliers, Point, Statement

STEPS = 5
SHIFTS = (
    2.0**-26,
    2.0**-50,
)  # δ beside the largest entry of its row: √ε, and where P is nearly singular


def polished(program: Statement, point: Point) -> Iterator[Point]:
    """Yield the point after the step, one of Newton's on min(multiplier, slack) = 0, and after it with a smaller δ.

    None where a system is singular.

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
    >>> found, _ = polished(program, Point(np.array([1.99]), near, 0, None))
    >>> found.x, found.multipliers.upper
    (array([2.]), array([1.]))
    """
    lower, upper, m = program.lower, program.upper, program.h.size
    rows = _stacked(program.G, program.A)
    right, given = np.concatenate([program.h, program.b]), point.multipliers
    x, y, pull = (
        np.clip(point.x, lower, upper),
        np.concatenate(given[:2]),
        given.upper - given.lower,
    )
    at_upper = pull > upper - x
    at_lower = (-pull > x - lower) & ~at_upper | (lower == upper)
    acts = np.append(y[:m] > np.abs(right[:m] - program.G @ x), np.ones(right.size - m, np.bool_))
    free, transposed = ~(at_lower | at_upper), rows.T
    moved, blocks = np.count_nonzero(free), (block(program.P, free, free), block(rows, acts, free))
    x, y = np.where(at_lower, lower, np.where(at_upper, upper, x)), np.where(acts, y, 0.0)
    for shift in SHIFTS:
        if (solve := shifted_solver(*blocks, shift)) is None:
            return
        for _ in range(STEPS):
            gradient = program.P @ x + program.c + transposed @ y
            step = solve(np.concatenate([-gradient[free], (right - rows @ x)[acts]]))
            if not np.isfinite(step).all():
                return
            x[free] += step[:moved]
            y[acts] += step[moved:]
        # Multipliers of bounds take what the gradient leaves there.
        near, of_rows = np.clip(x, lower, upper), np.append(np.maximum(y[:m], 0.0), y[m:])
        gradient = program.P @ near + program.c + transposed @ of_rows
        below = np.where(near == program.lower, np.maximum(gradient, 0.0), 0.0)
        above = np.where(near == program.upper, np.maximum(-gradient, 0.0), 0.0)
        yield point._replace(
            x=near, multipliers=Multipliers(of_rows[:m], of_rows[m:], below, above)
        )


def _stacked(G: Any, A: Any) -> Any:
    """Return G above A; of sparse arrays, in a fifth of scipy's time."""
    if not sp.issparse(G):
        return np.vstack([G, A])
    if not A.shape[0]:
        return G
    entries, places = np.append(G.data, A.data), np.append(G.indices, A.indices)
    return assembled(
        entries,
        places,
        np.append(G.indptr, G.nnz + A.indptr[1:]),
        (G.shape[0] + A.shape[0], A.shape[1]),
    )


def block(A: Any, is_row: BoolVector, is_column: BoolVector) -> Any:
    """Return some rows and columns."""
    if not sp.issparse(A):
        return A[is_row][:, is_column]
    rows, number = row_numbers(A), np.cumsum(is_column) - 1
    kept = is_row[rows] & is_column[A.indices]
    counts = np.bincount(rows[kept], minlength=A.shape[0])[is_row]
    shape = counts.size, int(np.count_nonzero(is_column))
    return assembled(A.data[kept], number[A.indices[kept]], np.append(0, np.cumsum(counts)), shape)


def shifted_solver(P: Any, C: Any, shift: float) -> Callable[[FloatVector], FloatVector] | None:
    """Return what solves with the matrix above, by LDLᵀ where it is sparse; None where no factor is found.

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
        factor, pivots, info = lapack.dgetrf(
            K + np.diag(shift * signs * np.where(size > 0.0, size, 1.0))
        )
        return None if info else lambda right: lapack.dgetrs(factor, pivots, right)[0]
    import qdldl

    size, (begins, columns, entries) = np.zeros(n + m), (P.indptr, P.indices, P.data)
    rows_of_P, rows_of_C = (
        np.repeat(np.arange(one.shape[0]), np.diff(one.indptr)) for one in (P, C)
    )
    for rows, found in ((rows_of_P, entries), (n + rows_of_C, C.data), (C.indices, C.data)):
        np.maximum.at(size, rows, np.abs(found))
    # Columns of the upper triangle are rows of the lower one, those of P and of C, each with its diagonal entry last.
    below = columns < rows_of_P
    ends = np.append(
        np.cumsum(np.append(0, below))[begins[1:]], np.count_nonzero(below) + C.indptr[1:]
    )
    diagonal = np.append(P.diagonal(), np.zeros(m)) + shift * signs * np.where(
        size > 0.0, size, 1.0
    )
    upper = sp.csc_matrix(
        (
            np.insert(np.append(entries[below], C.data), ends, diagonal),
            np.insert(np.append(columns[below], C.indices), ends, np.arange(n + m)),
            np.append(0, ends + np.arange(1, n + m + 1)),
        ),
        shape=(n + m, n + m),
    )
    try:
        solver: Callable[[FloatVector], FloatVector] = qdldl.Solver(upper, upper=True).solve
    except RuntimeError:  # a pivot of 0, or no memory
        return None
    return solver
