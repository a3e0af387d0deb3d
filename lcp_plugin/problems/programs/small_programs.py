"""Small quadratic programs as dense arrays, given to the compiled loop that solves them at once."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp

from ...core.checks import BoolVector, FloatVector

UP_TO, ROWS_UP_TO, WORK_UP_TO = 400, 1500, 2.5e7  # unknowns, rows, multiplications of a step
SEARCHED_UP_TO = 80  # unknowns of a program whose active set is found before interior points, called alone, are there
MEASURES = 7  # of an answer
MOST_STEPS = 100  # with a smaller limit they are taken one by one
SPARSE, SPARSE_UP_TO = 0.3, 1.5e6  # share of entries; multiplications of a step that sparse factors take more quickly
LARGEST = 1e100  # numbers whose products stay in range


class SmallPrograms(NamedTuple):
    """Programs min ½ xᵀP x + cᵀx, C x ≤ d or C x = d, lower ≤ x ≤ upper of one size, as the kernel takes them.

    Attributes
    ----------
    P, C : ndarray, shapes (1 or count, n, n) and (1 or count, m, n)
    c, lower, upper : ndarray, shape (count, n)
    d : ndarray, shape (count, m)
    is_equality : ndarray of bool, shape (m,)
    fixed : ndarray or None
        The values of all variables, NaN where they are unknown, of one program of which some are known.
    """

    P: FloatVector
    c: FloatVector
    C: FloatVector
    d: FloatVector
    is_equality: BoolVector
    lower: FloatVector
    upper: FloatVector
    fixed: Any = None

    @classmethod
    def of_one(
        cls, P: Any, c: FloatVector, C: Any, d: FloatVector, is_equality: BoolVector, lower: FloatVector,
        upper: FloatVector,
    ) -> SmallPrograms | None:
        """Return one program, or None where it is out of the ordinary: too much work for dense loops, or huge numbers.

        Variables whose bounds are equal are taken out.
        """
        free = lower < upper
        n, m = int(np.count_nonzero(free)), d.size
        if n == 0 or not may_be_small(n, m):
            return None
        is_sparse = sp.issparse(P) and P.nnz + (C.nnz if sp.issparse(C) else C.size) < SPARSE * n * (n + m)
        if work_of(n, m, 1) > (SPARSE_UP_TO if is_sparse else WORK_UP_TO):
            return None
        P, C = (matrix.toarray() if sp.issparse(matrix) else matrix for matrix in (P, C))
        if any(np.abs(part).max(initial=0.0) > LARGEST for part in (P, C, c, d)):
            return None
        fixed = None
        if n < c.size:
            fixed = np.where(free, 0.0, lower)
            c, d, lower, upper = (c + P @ fixed)[free], d - C @ fixed, lower[free], upper[free]
            fixed[free], P, C = np.nan, P[np.ix_(free, free)], C[:, free]
        P, c, C, d, lower, upper = (np.ascontiguousarray(part)[np.newaxis] for part in (P, c, C, d, lower, upper))
        return cls(P, c, C, d, np.ascontiguousarray(is_equality), lower, upper, fixed)

    def point(self, answers: SmallAnswers, k: int) -> FloatVector:
        """Return (x, y) of answer k, fixed variables put back."""
        x = answers.x[k]
        if self.fixed is not None:
            x, own = self.fixed.copy(), x
            x[np.isnan(x)] = own
        return np.append(x, answers.y[k])

    def solved(self, tolerance: float) -> SmallAnswers:
        """Return the answers, as far as all measures of a program come below the tolerance."""
        from .kernels import small_programs as kernels

        (count, n), m = self.c.shape, self.d.shape[1]
        answers = SmallAnswers.empty(count, n, m)
        room = np.zeros((kernels.WIDTH, n + m)), np.zeros((n + m, n + m)), np.zeros((n, n)), np.zeros((m, n))
        kernels.run(*self[:7], tolerance, 0, count, *room, *answers)
        return answers

    def searched(self, tolerance: float) -> SmallAnswers | None:
        """Return the answer to one program by its active set, where that is sooner found, and found at all."""
        n, m = self.c.shape[1], self.d.shape[1]
        if n > SEARCHED_UP_TO:
            return None
        answers = SmallAnswers.empty(1, n, m)
        self.search(tolerance, 0, 1, answers, np.zeros(1, np.bool_))
        return answers if answers.has_converged[0] else None

    def search(self, tolerance: float, first: int, end: int, answers: SmallAnswers, contradicts: BoolVector) -> None:
        """Write what the dual active-set method finds of programs first ≤ k < end; d may be ∞, variables fixed.

        Where constraints contradict each other, y and reduced should be multipliers that prove it.
        """
        from .kernels.dual_active_set import run

        run(*self[:7], tolerance, first, end, *answers, contradicts)


def may_be_small(n: int, m: int) -> bool:
    """Return whether dense loops may take a program with so many unknowns and rows."""
    return n <= UP_TO and m <= ROWS_UP_TO and work_of(n, m, 1) <= WORK_UP_TO


def work_of(n: int, m: int, steps: int) -> float:
    """Return how many multiplications such steps take, about: a factorisation and its assembly, four solves."""
    return steps * (n**3 / 6.0 + n * n * m / 2.0 + 8.0 * (n * n + 2.0 * n * m))


def work_of_search(n: int, m: int, steps: int) -> float:
    """Return the same of the steps of an active-set method: a look at all rows, a direction, an update."""
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
        """Return tables for so many answers, all open."""
        return cls(
            np.full((count, n), np.nan), np.full((count, m), np.nan), np.full((count, n), np.nan),
            np.full((count, MEASURES), np.inf), np.zeros(count, np.int64), np.zeros(count, np.bool_),
        )
