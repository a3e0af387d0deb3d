"""Bounds of each variable that all constraints together imply for it, rounded outwards.

A row a·x ≤ d bounds x_j where it bounds all other terms: a_j x_j ≤ d − Σ min a_k x_k. Every pass over the rows may
bound more variables, so passes go on as long as some do.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

from ..checks import FloatVector
from ..conversions.program import QuadraticProgram
from ..deadline import is_over
from ..exact.rounding import gamma
from ..exact.upward import product_above, quotient_above, sum_above
from ..matrix.structure import row_numbers

MOST_PASSES = 10_000  # a chain of equations needs one a link, and each looks only at rows beside new bounds

Box = tuple[FloatVector, FloatVector]


def implied_box(program: QuadraticProgram) -> Box:
    """Return (lower, upper) with lower ≤ x ≤ upper for every feasible x, shape (n,) each.

    Examples
    --------
    >>> program = QuadraticProgram([[0, 0], [0, 0]], [1, 1], A=[[1, 2]], b=[4], lower=0)
    >>> implied_box(program)
    (array([0., 0.]), array([4., 2.]))
    """
    lower, upper = np.array(program.lower), np.array(program.upper)
    A, G = sp.csr_array(program.A), sp.csr_array(program.G)
    limited = np.flatnonzero(np.isfinite(program.h))
    rows = sp.csr_array(sp.vstack([G[limited], A, -A], format="csr"))
    limit = np.concatenate([program.h[limited], program.b, -program.b])
    by_column = sp.csc_array(rows)
    touched = np.arange(limit.size)
    for _ in range(MOST_PASSES):
        was_open = np.isinf(lower), np.isinf(upper)
        _tighten(rows[touched], limit[touched], lower, upper)
        closed = np.flatnonzero((was_open[0] & np.isfinite(lower)) | (was_open[1] & np.isfinite(upper)))
        if not closed.size or is_over():
            break
        touched = np.unique(by_column[:, closed].indices)
    return lower, upper


@np.errstate(all="ignore")  # what is infinite or overflows bounds nothing
def _tighten(rows: sp.csr_array, limit: FloatVector, lower: FloatVector, upper: FloatVector) -> None:
    """Replace bounds by tighter ones that single rows imply."""
    entry, column, owner, m = rows.data, rows.indices, row_numbers(rows), limit.size
    # The largest value of −a x, the least of a x with its sign turned.
    most = np.where(entry > 0.0, product_above(-entry, lower[column]), product_above(-entry, upper[column]))
    is_open = most == np.inf
    held = np.where(is_open, 0.0, most)
    total = np.bincount(owner, held, m).astype(np.float64)
    size = np.bincount(owner, np.abs(held), m) * (1.0 + gamma(entry.size))
    total = sum_above(total, product_above(size, gamma(int(np.diff(rows.indptr).max(initial=0)) + 2)))
    open_terms = np.bincount(owner, is_open, m)
    is_bounded = open_terms[owner] - is_open == 0
    rest = sum_above(sum_above(limit, total)[owner], -held)
    rest = np.where(np.diff(rows.indptr)[owner] == 1, limit[owner], rest)
    most_of_x = quotient_above(rest, np.abs(entry))
    usable = is_bounded & np.isfinite(most_of_x)
    above, below = usable & (entry > 0.0), usable & (entry < 0.0)
    np.minimum.at(upper, column[above], most_of_x[above])
    np.maximum.at(lower, column[below], -most_of_x[below])
