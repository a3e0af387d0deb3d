"""The run of a batch of quadratic programs: a compiled loop over small ones, one by one what that leaves open."""

from __future__ import annotations

from fractions import Fraction
from functools import cached_property, partial
from typing import Any

import numpy as np
import scipy.sparse as sp

from ...core.checks import FloatVector
from ...core.settings import Status
from ...core.solving.result import Result
from ..programs.program import QuadraticProgram
from ..programs.qp_certificates import with_bounds
from ..programs.qp_forms import program_goal
from ..programs.qp_proofs import QPInfeasibility
from ..programs.qp_solution import QPSolution
from ..programs.small_programs import MOST_STEPS, SEARCHED_UP_TO, SmallAnswers, SmallPrograms, may_be_small
from ..programs.solving import ACTIVE_SET, QuadraticProgramResult, judged_program
from ..programs.stacked_programs import QuadraticProgramBatch
from .batch_run import BatchAnswers, BatchLoop

STRICT = 1e-7  # what is within this is stationary to 1e-6


class ProgramBatchRun(BatchLoop):
    """The answers as they come, in tables with a row a program.

    Parameters
    ----------
    programs : QuadraticProgramBatch
    algorithm, wishes, threads, limit
        As in `BatchLoop`.
    """

    def __init__(
        self, programs: QuadraticProgramBatch, algorithm: Any, wishes: dict[str, Any], *, threads: int, limit: float
    ) -> None:
        super().__init__(len(programs), algorithm, wishes, {}, threads=threads, limit=limit)
        programs.refuse_nonconvex()
        self.programs, count, (m, p, n, _) = programs, len(programs), programs.sizes
        self.answers = SmallAnswers.empty(count, n, m + p)
        self.contradicts = np.zeros(count, np.bool_)  # where multipliers should prove that
        self.at_bounds = np.full((2, count, n), np.nan)
        self.results: dict[int, QuadraticProgramResult] = {}

    def run(self) -> ProgramBatchResult:
        """Solve all, and gather what was found."""
        self._solve_all()
        left, shape = self.is_open, self.answers.x.shape
        self._forget(left)
        lower, upper = (np.broadcast_to(self.programs.vectors[name], shape) for name in ("lower", "upper"))
        self.answers.x[left] = np.clip(0.0, lower[left], upper[left])
        self.status[left] = Status.INTERRUPTED if self.is_interrupted else Status.MAX_SECONDS
        self.seconds = self.clock.read()
        return ProgramBatchResult(self)

    def _solve_compiled(self) -> None:
        m, p, n, _ = self.programs.sizes
        is_small, may_run = 0 < n <= SEARCHED_UP_TO, self.settings.max_iterations >= MOST_STEPS
        if self.algorithm != "auto" or not (may_run and is_small and may_be_small(n, m + p)):
            return
        small, answers = SmallPrograms(*self.programs.arrays), self.answers
        tolerance = min(self.settings.tolerance, STRICT)

        def solve_chunk(first: int, end: int) -> None:
            small.search(tolerance, first, end, answers, self.contradicts)

        try:
            self._in_chunks(solve_chunk, len(self.status))
        finally:
            is_solved = answers.has_converged & self.programs.may_be_stated
            self.is_open, self.status[is_solved] = ~is_solved, Status.SOLVED
            self.residual[is_solved] = answers.measures[is_solved, :4].max(axis=1)
            self.at_bounds[:] = np.maximum(answers.reduced, 0.0), np.maximum(-answers.reduced, 0.0)

    def _solve(self, k: int, wishes: dict[str, Any]) -> None:
        y = self.answers.y[k].copy()
        self._forget(k)
        program = self.programs[k]
        if self.contradicts[k] and (proved := self._proved(program, y)) is not None:
            self.results[k], self.answers.x[k], self.status[k] = proved, proved.x, proved.status
            self.is_open[k] = False
            return
        result = self.results[k] = judged_program(program, self.algorithm, **wishes)
        found = result.solution
        self.answers.x[k], self.answers.steps[k] = found.x, result.iterations
        self.answers.y[k] = np.concatenate([found.inequality, found.equality])
        self.at_bounds[:, k], self.residual[k] = (found.lower, found.upper), max(found.residual, found.row_residual)
        self.status[k], self.is_open[k] = result.status, False
        self.is_interrupted |= result.status is Status.INTERRUPTED

    def _forget(self, items: Any) -> None:
        """Leave no numbers of what the loop has not solved."""
        for table in (self.answers.x, self.answers.y, *self.at_bounds):
            table[items] = np.nan

    def _proved(self, program: QuadraticProgram, y: FloatVector) -> QuadraticProgramResult | None:
        """Return the answer to an infeasible program, where these multipliers of its rows prove that; checked exactly.

        Those of bounds are what they leave.
        """
        proof = with_bounds(program, {i: Fraction(value) for i, value in enumerate(y.tolist()) if value})
        if not proof.verify() or not proof.excludes(program_goal(self.settings.tolerance)):
            return None
        program.__dict__["proof_of_no_minimum"] = proof
        nothing = (np.full(size, np.nan) for size in self.programs.sizes)
        solution = QPSolution(program, np.clip(0.0, program.lower, program.upper), *nothing)
        return self._result(Status.INFEASIBLE, solution, 0, proof)

    def _result(
        self, status: Status, solution: QPSolution, steps: int, proof: QPInfeasibility | None = None
    ) -> QuadraticProgramResult:
        """Return the result of a program that the compiled loop has settled, or nobody has begun."""
        goal, share = program_goal(self.settings.tolerance), self.clock.read() / max(len(self.status), 1)
        alone = partial(_lcp_result, solution.program, self.settings.tolerance)
        return QuadraticProgramResult(status, solution, goal, f"auto: {ACTIVE_SET}", steps, share, alone, proof)

    def result_of(self, k: int) -> QuadraticProgramResult:
        """Return the result of program k, which has no error."""
        if k not in self.results:
            m, (lower, upper), y = self.programs.sizes[0], self.at_bounds[:, k], self.answers.y[k]
            solution = QPSolution(self.programs[k], self.answers.x[k], y[:m], y[m:], lower, upper)
            self.results[k] = self._result(self.status[k], solution, int(self.answers.steps[k]))
        return self.results[k]


def _lcp_result(program: QuadraticProgram, tolerance: float) -> Result:
    """Return the run on the complementarity problem of one program of a batch."""
    return judged_program(program, tolerance=tolerance).lcp_result


class ProgramBatchResult(BatchAnswers[QuadraticProgramResult]):
    """The answers to a batch of quadratic programs.

    Parameters
    ----------
    run : ProgramBatchRun
        At its end.

    Attributes
    ----------
    x : array, shape (B, n)
        NaN where the data are no convex program.
    inequality, equality, lower, upper : arrays, shapes (B, m), (B, p), (B, n), (B, n)
        Multipliers as those of a QPSolution; NaN where there are none.
    status : array of Status, shape (B,)
        As of a :class:`~lcp_plugin.QuadraticProgramResult`. None where the data are no convex program.
    residual : array, shape (B,)
        An upper bound of the largest residual of a QPSolution, `row_residual` included; NaN where nothing was found.
    iterations : array of int, shape (B,)
    seconds : float
        Seconds of the whole batch, compilation excluded.
    errors : dict
        What is wrong with program k, where something is; ``answers[k]`` raises it.
    programs : QuadraticProgramBatch

    Notes
    -----
    ``answers[k]`` is the :class:`~lcp_plugin.QuadraticProgramResult` of program k.
    """

    ITEM = "program"

    def __init__(self, run: ProgramBatchRun) -> None:
        answers, m = run.answers, run.programs.sizes[0]
        super().__init__(run, run.result_of, answers.x, answers.y, answers.steps, run.at_bounds)
        self.x, self.residual, self.iterations, self.programs = answers.x, run.residual, answers.steps, run.programs
        self.inequality, self.equality = run.answers.y[:, :m], run.answers.y[:, m:]
        self.lower, self.upper = run.at_bounds

    @cached_property
    def objective(self) -> Any:
        """½ xᵀP x + cᵀx of each, shape (B,); computed when it is looked at."""
        P, x = self.programs.P, self.x
        Px = (P @ x.T).T if sp.issparse(P) else np.matmul(P, x[:, :, np.newaxis])[:, :, 0]
        return ((0.5 * Px + self.programs.vectors["c"]) * x).sum(axis=1)
