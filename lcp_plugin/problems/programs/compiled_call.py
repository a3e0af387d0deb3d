"""Small programs solved by one compiled call, on their own data: what it found, and its complementarity problem."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from typing import NamedTuple

import numpy as np

from ...core.checks import FloatVector
from ...core.communicator import ALONE
from ...core.deadline import Clock
from ...core.solving.result import StageRecord
from .convexity import refuse_nonconvex
from .criterion import PROGRAM_TOLERANCE, Errors, program_goal
from .program import QuadraticProgram
from .qp_certificates import with_bounds
from .qp_forms import QPOrigin
from .qp_proofs import QPInfeasibility
from .qp_solution import QPSolution
from .reductions import Substitution, fold_simple_rows, substitute_definitions
from .small_programs import ROWS_UP_TO, UP_TO, SmallAnswers, SmallPrograms, may_be_small, work_of_search

ACTIVE_SET = "dual active set"
AT_ONCE = "begins at the minimum without constraints and takes in those that are violated, one by one, until none is"
BOXED_UP_TO, BOXED = 160, 1.5  # unknowns and their bounds; where few rows hold x, the path from far outside is long
FOLDED_FROM = 5e5  # multiplications by rows that may be bounds: to look for these takes as long
SUBSTITUTED_FROM = 5e5  # multiplications: to put in what equations define takes as long
MANY = UP_TO**2 * ROWS_UP_TO  # entries: those that are left are not counted yet
REACHED = 1e-9  # the smallest tolerance that the compiled call is asked for


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
    clock, substitution, rows = Clock(ALONE), None, None
    reduced, goal = program, program_goal(tolerance)
    if program.b.size and (substitution := _worthwhile(program)) is not None:
        refuse_nonconvex(program)  # on the subspace that is left P may be convex
        reduced = substitution.reduced
    if reduced.matrices.has_sparse_rows and reduced.matrices.sizes[0] * reduced.n**2 > FOLDED_FROM:
        free, simple = np.count_nonzero(reduced.lower < reduced.upper), reduced.matrices.singletons[0].size
        if not may_be_small(int(free), reduced.constraints.rows - simple, MANY):
            return None
        rows = fold_simple_rows(reduced)
        reduced = rows.folded
    if (part := _FreePart.of(reduced)) is None:
        return None
    answers, contradicts = part.solved(min(max(tolerance, REACHED), PROGRAM_TOLERANCE))
    if contradicts and reduced is program and (proof := contradiction(program, answers.y[0], goal)) is not None:
        return proof
    if not answers.has_converged[0]:
        return None
    x, y, costs = part.whole(answers)
    every = np.concatenate([y, np.maximum(costs, 0.0), np.maximum(-costs, 0.0)])
    if rows is not None:
        every = rows.unfold(every)
    if substitution is not None:
        x, every = substitution.restored(x, every)
    solution = QPSolution.of_rows(program, x, every)
    if reduced is program and part.x is None and program.units.are_the_users:
        solution.__dict__["_errors"] = Errors(*answers.measures[0, :5].tolist())
    if not solution.is_stationary(goal):
        return None
    steps, entries = int(answers.steps[0]), max(sum(reduced.matrices.entries), 1)
    work = work_of_search(reduced.n, reduced.constraints.rows, steps) / entries
    return Found(solution, StageRecord(ACTIVE_SET, AT_ONCE, steps, work), clock.read())


def contradiction(program: QuadraticProgram, y: FloatVector, goal: float) -> QPInfeasibility | None:
    """Return the proof that these multipliers of an infeasible program's rows are, checked exactly, if they are one.

    Those of bounds are what they leave.
    """
    proof = with_bounds(program, {i: Fraction(value) for i, value in enumerate(y.tolist()) if value})
    if not (proof.verify() and proof.excludes(goal)):
        return None
    program.__dict__["_proof"] = proof
    return proof


def _worthwhile(program: QuadraticProgram) -> Substitution | None:
    """Return the substitution of what equations define; None where the call is quick, or too long, with it or without.

    Without, P has to be definite by the look of its diagonal: on the subspace that is left it may be so.
    """
    n, defined = program.n, min(int(np.count_nonzero(program.matrices.is_definable)), program.b.size)
    is_quick = n**2 * (n + program.constraints.rows) <= SUBSTITUTED_FROM and bool((program.P.diagonal() > 0.0).all())
    return substitute_definitions(program) if not is_quick and may_be_small(n - defined, 0, 0) else None


@dataclass(frozen=True, eq=False)
class _FreePart:
    """A program in its variables whose bounds differ, as the compiled call takes it.

    Attributes
    ----------
    program : QuadraticProgram
    arrays : SmallPrograms
    x : ndarray, shape (n,), or None
        The values of the other variables, 0 elsewhere; None where there are none.
    """

    program: QuadraticProgram
    arrays: SmallPrograms
    x: FloatVector | None

    @classmethod
    def of(cls, program: QuadraticProgram) -> _FreePart | None:
        """Return that of a program, or None where it is too much work for dense loops."""
        matrices, (m, p, n, _) = program.matrices, program.matrices.sizes
        c, lower, upper, x = program.c, program.lower, program.upper, None
        free = lower < upper
        count = int(np.count_nonzero(free))
        if not may_be_small(count, m + p, matrices.stored):
            return None
        sides = int(np.isfinite(lower[free]).sum() + np.isfinite(upper[free]).sum())
        if count > BOXED_UP_TO and sides > BOXED * count and BOXED * (m + p) < count:
            return None
        P, C = matrices.dense
        d = program.h if not p else program.b if not m else np.concatenate([program.h, program.b])
        if count < n:
            x = np.where(free, 0.0, lower)
            c, d, lower, upper = (c + P[0] @ x)[free], d - C[0] @ x, lower[free], upper[free]
            P, C = np.ascontiguousarray(P[:, free][:, :, free]), np.ascontiguousarray(C[:, :, free])
        vectors = c[np.newaxis], d[np.newaxis], lower[np.newaxis], upper[np.newaxis]
        is_equality = matrices.is_equality[: m + p]
        arrays = SmallPrograms(
            P, vectors[0], C, vectors[1], is_equality, vectors[2], vectors[3], np.array([program.units[2:4]])
        )
        return cls(program, arrays, x)

    def solved(self, tolerance: float) -> tuple[SmallAnswers, bool]:
        """Return what the compiled call finds, and whether constraints contradict each other."""
        answers = SmallAnswers.empty(1, self.arrays.c.shape[1], self.arrays.d.shape[1])
        contradicts = np.zeros(1, np.bool_)
        self.arrays.solve(tolerance, 0, 1, answers, contradicts)
        return answers, bool(contradicts[0])

    def whole(self, answers: SmallAnswers) -> tuple[FloatVector, FloatVector, FloatVector]:
        """Return x, the multipliers of rows, and those of lower less those of upper bounds, of all variables.

        Of a fixed one that is what stationarity leaves.
        """
        found, y, reduced = answers.x[0], answers.y[0], answers.reduced[0]
        if self.x is None:
            return found, y, reduced
        x, free = self.x.copy(), self.program.lower < self.program.upper
        x[free] = found
        P, C = self.program.matrices.dense
        costs = P[0] @ x + self.program.c + y @ C[0]
        costs[free] = reduced
        return x, y, costs
