"""Of all multipliers that make a point of a degenerate program stationary, small ones.

Where active rows depend on each other, or variables are fixed, multipliers are not unique, and a method ends with any:
those of 5e12 cancel to what some of 1e3 say at once, less their rounding.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import scipy.sparse as sp

from ..checks import BoolVector, FloatVector
from ..problem.farkas import linear_program
from .blocks import as_csr

if TYPE_CHECKING:
    from .program import QuadraticProgram

CANCELS = 100.0  # times the gradient: terms that may be small, as they cancel
ACTIVE = 1e-7  # of the unit of a row
LARGEST = 5000  # variables and rows of a program that is worth a linear program
LARGEST_DENSE = 1_000_000  # entries of a least squares problem; .1 s
RANK = 1e-12  # beside the largest singular value: what should depend on each other is independent by rounding


def least_multipliers(program: QuadraticProgram, x: FloatVector, y: FloatVector) -> FloatVector | None:
    """Return multipliers of G and A of the least Σ|y_i| + Σ|μ_j|, μ those of bounds; None where these cancel nothing.

    Only those of active constraints differ from 0. Nothing is judged here: look at the residuals.

    Parameters
    ----------
    x : array, shape (n,)
    y : array, shape (rows of G + rows of A,)
        Some multipliers; None is returned where their terms are at most 100 times as large as the gradient.

    Notes
    -----
    One linear program, then least squares on the multipliers that it leaves: their error is that of rounding, where
    the linear program's is 1e-9. Σ|·| is at most the number of nonzeros times the largest of any others.

    Examples
    --------
    >>> from lcp_plugin import QuadraticProgram
    >>> twice = QuadraticProgram(np.eye(1), [0.0], A=[[1.0], [2.0]], b=[1.0, 2.0])
    >>> least_multipliers(twice, np.ones(1), np.array([-1e9 - 1.0, 5e8]))
    array([ 0. , -0.5])
    """
    rows, count = program.matrices.rows, y.size
    gradient = np.asarray(program.P @ x + program.c)
    size = float(np.abs(gradient).max(initial=0.0))
    terms = program.matrices.row_sizes[:count] * np.abs(y)
    if not terms.max(initial=0.0) > CANCELS * size or not 0.0 < size < np.inf or program.n + count > LARGEST:
        return None
    limits, is_equality = program.constraints.limit[:count], program.constraints.is_equality[:count]
    unit = program.constraints.unit[:count]
    with np.errstate(invalid="ignore"):
        active = is_equality | (limits - rows @ x <= ACTIVE * unit)
        at_lower = x - program.lower <= ACTIVE * (1.0 + np.abs(x))
        at_upper = program.upper - x <= ACTIVE * (1.0 + np.abs(x))
    listed, found = np.flatnonzero(active), np.zeros(count)
    columns = sp.csc_array(as_csr(rows)[listed].T)
    identity = sp.eye_array(program.n, format="csc")
    free = is_equality[listed]
    parts = [columns, -columns[:, np.flatnonzero(free)],
             -identity[:, np.flatnonzero(at_lower)], identity[:, np.flatnonzero(at_upper)]]
    matrix = sp.csc_array(sp.hstack(parts, format="csc"))
    answer = linear_program(np.ones(matrix.shape[1]), matrix, -gradient / size, (0.0, None), (None, None))
    if answer is None:
        return None
    found[listed] = answer.x[: listed.size]
    found[listed[free]] -= answer.x[listed.size : listed.size + int(free.sum())]
    _, _, below, above = np.split(answer.x, np.cumsum([part.shape[1] for part in parts[:3]]))
    is_balanced = np.zeros(program.n, dtype=bool)
    is_balanced[np.flatnonzero(at_lower)[below > 0.0]] = is_balanced[np.flatnonzero(at_upper)[above > 0.0]] = True
    return _polished(program, gradient, size * found, is_balanced)


def _polished(
    program: QuadraticProgram, gradient: FloatVector, y: FloatVector, is_balanced: BoolVector
) -> FloatVector:
    """Return the multipliers near y, 0 where they are 0, that leave least of the gradient where no bound takes it."""
    used, left = np.flatnonzero(y), np.flatnonzero(~is_balanced)
    if used.size and used.size * left.size <= LARGEST_DENSE:
        block = as_csr(program.matrices.rows)[used][:, left].toarray().T
        y = y.copy()
        for _ in range(2):  # the second takes off what the first has rounded
            y[used] -= np.linalg.lstsq(block, gradient[left] + block @ y[used], rcond=RANK)[0]
    is_inequality = ~program.constraints.is_equality[: y.size]
    return np.where(is_inequality, np.maximum(y, 0.0), y)
