"""The least multipliers of a program that an x has, where those that a method ends with are large and cancel."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import scipy.sparse as sp

from ...core.checks import BoolVector, FloatVector
from ...proofs.no_solution.farkas import linear_program
from .program_matrices import as_csr

if TYPE_CHECKING:
    from .program import QuadraticProgram

CANCELS = 100.0  # times the gradient: terms that may be small, as they cancel
ACTIVE = 1e-7  # of the unit of a row
LARGEST = 5000  # variables and rows of a program that is worth a linear program
LARGEST_DENSE = 1_000_000  # entries of a least squares problem; .1 s; and of the active rows of a linear program
EXACTLY = 1e-12  # of the gradient: what a vertex of a linear program leaves, as a rule
RANK = 1e-12  # beside the largest singular value: what should depend on each other is independent by rounding


def least_multipliers(
    program: QuadraticProgram, x: FloatVector, y: FloatVector, cancels: float = CANCELS
) -> FloatVector | None:
    """Return multipliers of G and A of the least Σ|y_i| + Σ|μ_j|, μ those of bounds; None where these cancel nothing.

    Only those of active constraints differ from 0. Nothing is judged here: look at the residuals.

    Parameters
    ----------
    x : array, shape (n,)
    y : array, shape (rows of G + rows of A,)
        Some multipliers.
    cancels : float
        None is returned where their terms are at most so many times as large as the gradient.

    Notes
    -----
    Where active rows depend on each other, or variables are fixed, multipliers are not unique, and a method ends with
    any: those of 5e12 cancel to what some of 1e3 say at once, less their rounding.

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
    if not terms.max(initial=0.0) > cancels * size or not 0.0 < size < np.inf or program.n + count > LARGEST:
        return None
    limits, is_equality = program.constraints.limit[:count], program.constraints.is_equality[:count]
    unit = program.constraints.unit[:count]
    with np.errstate(invalid="ignore"):
        active = is_equality | (limits - rows @ x <= ACTIVE * unit)
        at_lower = x - program.lower <= ACTIVE * (program.scaling.unknown + np.abs(x))
        at_upper = program.upper - x <= ACTIVE * (program.scaling.unknown + np.abs(x))
    listed, found = np.flatnonzero(active), np.zeros(count)
    columns = sp.csc_array(as_csr(rows)[listed].T)
    if columns.nnz > LARGEST_DENSE:
        return None
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
    from scipy.linalg import solve_triangular

    used, left = np.flatnonzero(y), np.flatnonzero(~is_balanced)
    rest = np.abs(gradient + y @ program.matrices.rows)[left].max(initial=0.0)
    if used.size and rest > EXACTLY * np.abs(gradient).max() and used.size * left.size <= LARGEST_DENSE:
        block = as_csr(program.matrices.rows)[used][:, left].toarray().T
        y, (Q, R) = y.copy(), np.linalg.qr(block)
        sizes = np.abs(R.diagonal())
        # Rows of a vertex of that linear program are independent as a rule.
        has_rank = used.size <= left.size and sizes.min() > RANK * sizes.max()
        for _ in range(2):  # the second takes off what the first has rounded
            rest = gradient[left] + block @ y[used]
            y[used] -= solve_triangular(R, Q.T @ rest) if has_rank else np.linalg.lstsq(block, rest, rcond=RANK)[0]
    is_inequality = ~program.constraints.is_equality[: y.size]
    return np.where(is_inequality, np.maximum(y, 0.0), y)
