"""Small programs solved by one compiled call, on their own data: what it found, and its complementarity problem."""

from __future__ import annotations

from fractions import Fraction
from typing import Any, NamedTuple

import numpy as np

from ...core.checks import BoolVector, FloatVector
from ...core.communicator import ALONE
from ...core.deadline import Clock
from ...core.solving.result import StageRecord
from .conversion import QPOrigin
from .convexity import refuse_nonconvex
from .criterion import PROGRAM_TOLERANCE, Errors, program_goal
from .no_minimum import QPInfeasibility, with_bounds
from .program import QuadraticProgram
from .program_matrices import may_be_small
from .reductions import FixedVariables, Purpose, Reduction
from .solution import QPSolution
from .steps import reduction_for

MEASURES = 7  # of an answer
MOST_STEPS = 100  # with a smaller limit they are taken one by one
LARGEST = 1e100  # numbers whose products stay in range
ACTIVE_SET = "dual active set"
AT_ONCE = "begins at the minimum without constraints and takes in those that are violated, one by one, until none is"
BOXED_UP_TO, BOXED = 160, 1.5  # unknowns and their bounds; where few rows hold x, the path from far outside is long
REACHED = 1e-9  # the smallest tolerance that the compiled call is asked for


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
        the duality gap, as :class:`~lcp_plugin.problems.programs.solution.QPSolution` has them; two sizes.
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


class Found(NamedTuple):
    """The answer to a program before there is a run, judged by the program's own criterion; by what, and how long.

    Where the program's complementarity problem was solved, `origin` is that problem's.
    """

    solution: QPSolution
    stage: StageRecord
    seconds: float
    origin: QPOrigin | None = None


def solved_at_once(program: QuadraticProgram, tolerance: float) -> Found | None:
    """Return the answer to a small program by one compiled call, None where it finds none."""
    found = settled_at_once(program, tolerance)
    return found if isinstance(found, Found) else None


def settled_at_once(program: QuadraticProgram, tolerance: float) -> Found | QPInfeasibility | None:
    """Return the answer to a small program by one compiled call, or a proof that there is none; None where it has none.

    The proof, that constraints contradict each other, is checked in exact arithmetic, and the program keeps it.
    """
    clock, goal = Clock(ALONE), program_goal(tolerance)
    reduction = _made_small(program)
    if reduction is None:
        return None
    reduced, contradicts = reduction.reduced, np.zeros(1, np.bool_)
    m = sum(reduced.matrices.sizes[:2])
    answers = SmallAnswers.empty(1, reduced.n, m)
    _arrays(reduced).solve(min(max(tolerance, REACHED), PROGRAM_TOLERANCE), 0, 1, answers, contradicts)
    if contradicts[0]:
        proof = program.accept_proof(reduction.proof(contradiction(reduced, answers.y[0])), goal)
        if isinstance(proof, QPInfeasibility):
            return proof
    if not answers.has_converged[0]:
        return None
    y, costs = answers.y[0], answers.reduced[0]
    every = np.concatenate([y, np.maximum(costs, 0.0), np.maximum(-costs, 0.0)])
    solution = QPSolution.of_rows(program, *reduction.outward(answers.x[0], every))
    if reduced is program and program.scaling.leaves_unknowns:
        solution.__dict__["_errors"] = Errors(*answers.measures[0, :5].tolist())
    if not solution.is_stationary(goal):
        return None
    steps, entries = int(answers.steps[0]), max(sum(program.matrices.entries), 1)
    work = work_of_search(reduced.n, m, steps) / entries
    return Found(solution, StageRecord(ACTIVE_SET, AT_ONCE, steps, work), clock.read())


def _made_small(program: QuadraticProgram) -> Reduction | None:
    """Return what the compiled call is to take of a program; None where that is too much work for dense loops."""
    reduction = reduction_for(program, Purpose.COMPILED_CALL)
    if reduction.computes:
        refuse_nonconvex(program)  # on the subspace that is left P may be convex
    reduced = reduction.reduced
    free = reduced.lower < reduced.upper
    count, rows = int(np.count_nonzero(free)), sum(reduced.matrices.sizes[:2])
    if not may_be_small(count, rows, reduced.matrices.stored):
        return None
    sides = int(np.isfinite(reduced.lower[free]).sum() + np.isfinite(reduced.upper[free]).sum())
    if count > BOXED_UP_TO and sides > BOXED * count and BOXED * rows < count:
        return None
    return reduction.then(FixedVariables.of)


def _arrays(program: QuadraticProgram) -> SmallPrograms:
    """Return a program as the compiled call takes it."""
    (P, C), (m, p, _, _) = program.matrices.dense, program.matrices.sizes
    d = program.h if not p else program.b if not m else np.concatenate([program.h, program.b])
    is_equality = program.matrices.is_equality[: m + p]
    vectors = [one[np.newaxis] for one in (program.c, d, program.lower, program.upper)]
    return SmallPrograms(
        P, vectors[0], C, vectors[1], is_equality, vectors[2], vectors[3], np.array([program.scaling[2:4]])
    )


def contradiction(program: QuadraticProgram, y: FloatVector) -> QPInfeasibility:
    """Return what these multipliers of rows prove if they contradict each other, with those of bounds."""
    return with_bounds(program, {i: Fraction(value) for i, value in enumerate(y.tolist()) if value})
