"""Small quadratic programs as dense arrays, from data to judged answer in one compiled call: the dual active set."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from ...core.checks import BoolVector, FloatVector

UP_TO, ROWS_UP_TO = 400, 1500  # unknowns and rows
SPARSE, SPARSE_UP_TO = 0.3, 2e7  # share of entries; multiplications that sparse factors take more quickly
MEASURES = 7  # of an answer
MOST_STEPS = 100  # with a smaller limit they are taken one by one
LARGEST = 1e100  # numbers whose products stay in range


class SmallPrograms(NamedTuple):
    """Programs min ½ xᵀP x + cᵀx, C x ≤ d or C x = d, lower ≤ x ≤ upper of one size, as the kernel takes them.

    Attributes
    ----------
    P, C : ndarray, shapes (1 or count, n, n) and (1 or count, m, n)
    c, lower, upper : ndarray, shape (count, n)
    d : ndarray, shape (count, m)
        ∞ where a row says nothing.
    is_equality : ndarray of bool, shape (m,)
    objective : ndarray, shape (count, 2)
        The size of each objective, and its smallest cost.
    """

    P: FloatVector
    c: FloatVector
    C: FloatVector
    d: FloatVector
    is_equality: BoolVector
    lower: FloatVector
    upper: FloatVector
    objective: FloatVector

    def solve(self, tolerance: float, first: int, end: int, answers: SmallAnswers, contradicts: BoolVector) -> None:
        """Write the answers to programs first ≤ k < end, as far as all measures come below the tolerance.

        Where constraints contradict each other, y and reduced should be multipliers that prove it.
        """
        from .kernels.dual_active_set import run

        run(*self, tolerance, first, end, *answers, contradicts)


def may_be_small(n: int, m: int, entries: int) -> bool:
    """Return whether the compiled call may take a program with so many unknowns, rows, and entries of P and C."""
    if not (0 < n <= UP_TO and m <= ROWS_UP_TO):
        return False
    return n * n * (n + m) <= SPARSE_UP_TO or entries >= SPARSE * n * (n + m)


def work_of_search(n: int, m: int, steps: int) -> float:
    """Return how many multiplications such steps take, about: a look at all rows, a direction, an update."""
    return n**3 + (steps + 1.0) * (n * m + 6.0 * n * n)


class SmallAnswers(NamedTuple):
    """What the kernel writes.

    Attributes
    ----------
    x : ndarray, shape (count, n)
        Within the bounds.
    y : ndarray, shape (count, m)
        Multipliers of the rows, ≥ 0 where these are inequalities.
    reduced : ndarray, shape (count, n)
        Multipliers of lower bounds less those of upper ones; 0 where x is at neither.
    measures : ndarray, shape (count, 7)
        Proved upper bounds of the primal and the dual residual, then complementarity, the largest error of a row and
        the duality gap, as :class:`~lcp_plugin.problems.programs.qp_solution.QPSolution` has them; two sizes.
    steps : ndarray of int, shape (count,)
    has_converged : ndarray of bool, shape (count,)
        Where all measures are within the tolerance.
    """

    x: FloatVector
    y: FloatVector
    reduced: FloatVector
    measures: FloatVector
    steps: Any
    has_converged: BoolVector

    @classmethod
    def empty(cls, count: int, n: int, m: int) -> SmallAnswers:
        """Return tables for so many answers, all open: their numbers mean nothing before."""
        x, y, reduced = np.empty((count, n)), np.empty((count, m)), np.empty((count, n))
        measures, steps = np.empty((count, MEASURES)), np.zeros(count, np.int64)
        return cls(x, y, reduced, measures, steps, np.zeros(count, np.bool_))
