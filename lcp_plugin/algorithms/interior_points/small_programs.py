"""Small quadratic programs as dense arrays, given to the compiled loop that solves them at once."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp

from ...checks import BoolVector, FloatVector
from ...problem.lcp import LCP
from .quasidefinite import signs_of

UP_TO = 200  # unknowns and rows
MOST_STEPS = 100  # with a smaller limit they are taken one by one
LARGEST = 1e100  # numbers whose products stay in range


class SmallPrograms(NamedTuple):
    """Programs min ½ xᵀP x + cᵀx, C x ≤ d or C x = d, lower ≤ x ≤ upper of one size, as the kernel takes them.

    Attributes
    ----------
    P, C : ndarray, shapes (1 or count, n, n) and (1 or count, m, n)
    c, lower, upper : ndarray, shape (count, n)
    d : ndarray, shape (count, m)
    is_equality : ndarray of bool, shape (m,)
    """

    P: FloatVector
    c: FloatVector
    C: FloatVector
    d: FloatVector
    is_equality: BoolVector
    lower: FloatVector
    upper: FloatVector

    @classmethod
    def of_one(
        cls, P: Any, c: FloatVector, C: Any, d: FloatVector, is_equality: BoolVector, lower: FloatVector,
        upper: FloatVector,
    ) -> SmallPrograms | None:
        """Return one program, or None where it is out of the ordinary: large, with fixed variables or huge numbers."""
        if not 0 < c.size + d.size <= UP_TO or bool((lower == upper).any()):
            return None
        dense = [matrix.toarray() if sp.issparse(matrix) else matrix for matrix in (P, C)]
        if any(np.abs(part).max(initial=0.0) > LARGEST for part in (*dense, c, d)):
            return None
        P, c, C, d, lower, upper = (
            np.ascontiguousarray(part)[np.newaxis] for part in (dense[0], c, dense[1], d, lower, upper)
        )
        return cls(P, c, C, d, np.ascontiguousarray(is_equality), lower, upper)

    @classmethod
    def of_conditions(cls, problem: LCP) -> SmallPrograms | None:
        """Return the program whose optimality conditions a problem states, multipliers last; None where it states none.

        That is M = [[P, Cᵀ], [−C, 0]] with P symmetric and multipliers that are free or not negative.
        """
        if problem.is_distributed or not 0 < problem.n <= UP_TO:
            return None
        signs = signs_of(problem.M)
        if signs is None or not signs[-1] < 0.0 or bool((signs[:-1] < signs[1:]).any()):
            return None
        n, M = int((signs > 0.0).sum()), problem.M.toarray() if sp.issparse(problem.M) else problem.M
        lower, is_free = problem.lower[n:], np.isneginf(problem.lower[n:])
        if M[n:, n:].any() or bool((problem.upper[n:] < np.inf).any()) or bool((lower[~is_free] != 0.0).any()):
            return None
        return cls.of_one(M[:n, :n], problem.q[:n], -M[n:, :n], problem.q[n:], is_free, problem.lower[:n],
                          problem.upper[:n])

    def solved(self, tolerance: float) -> SmallAnswers:
        """Return the answers, as far as all measures of a program come below the tolerance."""
        from ...kernels import small_programs as kernels

        (count, n), m = self.c.shape, self.d.shape[1]
        answers = SmallAnswers(
            np.empty((count, n)), np.empty((count, m)), np.empty((count, n)),
            np.full((count, kernels.MEASURES), np.inf), np.zeros(count, np.int64), np.zeros(count, np.bool_),
        )
        room = np.empty((kernels.WIDTH, n + m)), np.empty((n + m, n + m)), np.empty((n, n)), np.empty((m, n))
        kernels.run(*self, tolerance, 0, count, *room, *answers)
        return answers


def work_of(n: int, m: int, steps: int) -> float:
    """Return how many multiplications such steps take, about: a factorisation and its assembly, four solves."""
    return steps * (n**3 / 6.0 + n * n * m / 2.0 + 8.0 * (n * n + 2.0 * n * m))


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
    measures : ndarray, shape (count, 5)
        Proved upper bounds of the primal and the dual residual, then complementarity, the largest error of a row and
        the slope along x, as :class:`~lcp_plugin.conversions.qp_solution.QPSolution` has them.
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
