"""A stack of small least squares problems with one A, by the LCPs of their normal equations."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...core.certificates.criterion import RowData
from ...core.checks import BoolVector, FloatVector
from ...methods.small.rounds import (
    CHUNK,
    FREE,
    HIGH,
    LOW,
    SMALL_DENSE,
    solve_active_sets,
    solve_stack,
)
from .certificate import measure_stack
from .data import BoundedLeastSquares
from .enclosures import clip, times

RESIDUALS = (
    2**15
)  # entries of the vectors of a stack: allocating larger arrays costs more than the sums


def suits_stack(problem: BoundedLeastSquares) -> bool:
    """Return whether the normal equations of the problem are a small LCP; a penalty may not have a kink."""
    has_kink = (problem.l1 > 0.0) & (problem.lower < 0.0) & (problem.upper > 0.0)
    is_dense = problem.is_dense or problem.is_small
    return is_dense and 0 < problem.shape[1] <= SMALL_DENSE and not has_kink.any()


def length_of_stack(problem: BoundedLeastSquares) -> int:
    """Return the number of problems in a stack whose arrays stay in the cache."""
    m, n = problem.shape
    return int(max(1, min(CHUNK // n**2, RESIDUALS // max(m, n))))


def solve_least_squares_stack(
    problem: BoundedLeastSquares, tolerance: float
) -> tuple[FloatVector, FloatVector, Any, BoolVector]:
    """Return points of a stack of problems, one step of refinement after the LCPs of their normal equations.

    The step solves the normal equations on the same active sets for the gradient AᵀW(A x − b) of the data. So the
    error of x grows with the condition of A, not with its square (Björck 1987, doi:10.1016/0024-3795(87)90101-7).

    Returns
    -------
    x : array, shape (B, n)
    value, iterations, is_solved : array, shape (B,)
        Relative gap; 0 if the point is the start, else 1; whether the certificate of these data proves the point.
    """
    columns, (A, gram) = problem.column_scales, problem.normal_equations
    lower, upper = problem.lower * columns, problem.upper * columns
    linear = np.where(problem.upper <= 0.0, -problem.l1, problem.l1) / columns
    b = problem.root_weights * problem.b
    z, _, iterations, _ = solve_stack(gram[None], linear - b @ A, lower, upper, None, tolerance)
    side = np.where(z <= lower, LOW, np.where(z >= upper, HIGH, FREE))
    unit, items = np.ones(z.shape), np.arange(len(z))

    def newton_step(slope: FloatVector) -> FloatVector:
        gradient = slope / columns + linear
        change = RowData(gram[None], gram[None], gradient, lower - z, upper - z, unit)
        return solve_active_sets(change, side, items) / columns

    x = z / columns
    residual = times(problem.A, x) - problem.b
    slope = times(problem.A.T, problem.apply_weights(residual)) + problem.ridge * x
    x = clip(x + newton_step(slope), problem.lower, problem.upper)
    x = np.where(side == LOW, problem.lower, np.where(side == HIGH, problem.upper, x))
    value, is_solved = measure_stack(problem, x, tolerance, newton_step)
    return x, value, iterations, is_solved
