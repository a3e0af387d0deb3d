"""Small programs solved by one compiled call, on their own data: what it found, and its complementarity problem."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property

import numpy as np

from ...core.certificates.residuals import Certificate
from ...core.checks import FloatVector, read_only
from ...core.communicator import ALONE
from ...core.deadline import Clock
from ...core.settings import Status
from ...core.solving.result import BoundOrReason, Result, StageRecord
from .convexity import refuse_nonconvex
from .criterion import PROGRAM_TOLERANCE, Errors, program_goal
from .program import QuadraticProgram
from .qp_certificates import with_bounds
from .qp_forms import KKTForm, QPOrigin
from .qp_proofs import QPInfeasibility
from .qp_solution import QPSolution
from .reductions import FoldedRows, Substitution, fold_simple_rows, substitute_definitions
from .small_programs import ROWS_UP_TO, UP_TO, SmallAnswers, SmallPrograms, may_be_small, work_of_search

ACTIVE_SET = "dual active set"
AT_ONCE = "begins at the minimum without constraints and takes in those that are violated, one by one, until none is"
BOXED_UP_TO, BOXED = 160, 1.5  # unknowns and their bounds; where few rows hold x, the path from far outside is long
FOLDED_FROM = 5e5  # multiplications by rows that may be bounds: to look for these takes as long
SUBSTITUTED_FROM = 5e5  # multiplications: to put in what equations define takes as long
MANY = UP_TO**2 * ROWS_UP_TO  # entries: those that are left are not counted yet
REACHED = 1e-9  # the smallest tolerance that the compiled call is asked for


@dataclass(frozen=True, eq=False)
class CompiledAnswer:
    """The answer to a small program, judged by the program's own criterion.

    Attributes
    ----------
    solution : QPSolution
    steps : int
    seconds : float
    """

    solution: QPSolution
    steps: int
    seconds: float
    name = ACTIVE_SET
    _substitution: Substitution | None
    _rows: FoldedRows | None
    _point: tuple[FloatVector, FloatVector]

    def result(self, tolerance: float, algorithm: str = "auto") -> ProgramResult:
        """Return the same as the result of the complementarity problem of the program."""
        program = self.solution.program if self._substitution is None else self._substitution.reduced
        rows, (x, y) = fold_simple_rows(program) if self._rows is None else self._rows, self._point
        z = np.append(x, y if self._rows is not None else y[rows.left])
        entries = max(sum(rows.folded.matrices.entries), 1)
        stage = StageRecord(ACTIVE_SET, AT_ONCE, self.steps, work_of_search(x.size, y.size, self.steps) / entries)
        return ProgramResult.of(KKTForm(rows, self._substitution), z, stage, self.seconds, tolerance, algorithm)


def solved_at_once(program: QuadraticProgram, tolerance: float) -> CompiledAnswer | None:
    """Return the answer to a small program by one compiled call, None where it finds none."""
    found = settled_at_once(program, tolerance)
    return found if isinstance(found, CompiledAnswer) else None


def settled_at_once(program: QuadraticProgram, tolerance: float) -> CompiledAnswer | QPInfeasibility | None:
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
    point, every = (x, y), np.concatenate([y, np.maximum(costs, 0.0), np.maximum(-costs, 0.0)])
    if rows is not None:
        every = rows.unfold(every)
    if substitution is not None:
        x, every = substitution.restored(x, every)
    solution = QPSolution.of_rows(program, x, every)
    if reduced is program and part.x is None and program.units.are_the_users:
        solution.__dict__["_errors"] = Errors(*answers.measures[0, :5].tolist())
    if not solution.is_stationary(goal):
        return None
    found = CompiledAnswer(solution, int(answers.steps[0]), clock.read(), substitution, rows, point)
    if tolerance < REACHED and not found.result(tolerance).residual <= tolerance:
        return None  # that is asked of the complementarity problem, too
    return found


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
    is_quick = n**2 * (n + program.constraints.rows) <= SUBSTITUTED_FROM and program.P.diagonal().min() > 0.0
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


class ProgramResult(Result):
    """The result of a program that was solved as it is: its complementarity problem is made once somebody asks for it.

    SOLVED means that the program's own residuals are within the tolerance.

    Attributes
    ----------
    origin : QPOrigin
        Of that problem.
    z : ndarray, shape (n,)
    """

    origin: QPOrigin

    @classmethod
    def of(
        cls, origin: QPOrigin, z: FloatVector, stage: StageRecord, seconds: float, tolerance: float, algorithm: str
    ) -> ProgramResult:
        """Return the result of z, found in one stage."""
        made = object.__new__(cls)
        made.__dict__.update(
            origin=origin, z=read_only(z), status=Status.SOLVED, iterations=stage.iterations, work=stage.work,
            algorithm=stage.name if algorithm == stage.name else f"{algorithm}: {stage.name}", seconds=seconds,
            setup_seconds=0.0, tolerance=tolerance, history=(), stages=(stage,),
            infeasibility=None, tolerance_on="residual", absolute_tolerance=0.0, _asked=algorithm,
            _bound=BoundOrReason(), _advice={},
        )
        return made

    @cached_property
    def certificate(self) -> Certificate:
        """The certificate of z in the KKT form of the program."""
        problem = self.origin.problem()
        problem.origin = problem.criterion = self.origin
        return Certificate.of(problem, self.z)

    @cached_property
    def w(self) -> FloatVector:
        """The certificate's w."""
        return self.certificate.w
