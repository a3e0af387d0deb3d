"""The run of a batch of quadratic programs: a compiled loop over small ones, one by one what that leaves open."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sp

from ...core.settings import Status
from ..programs.criterion import PROGRAM_TOLERANCE, Errors, program_goal
from ..programs.program_matrices import may_be_small
from ..programs.scaling import scaling_of_stacks
from ..programs.small_programs import ACTIVE_SET, MOST_STEPS, SmallAnswers, SmallPrograms
from ..programs.solution import QPSolution
from ..programs.solving import QuadraticProgramResult, solve_program
from ..programs.stacked_programs import QuadraticProgramBatch
from .batch_run import BatchAnswers, BatchLoop


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
        is_small, may_run = may_be_small(n, m + p, n * (n + m + p)), self.settings.max_iterations >= MOST_STEPS
        if self.algorithm != "auto" or not (may_run and is_small):
            return
        P, c, C, d, is_equality, lower, upper = self.programs.arrays
        objective, leaves_unknowns = scaling_of_stacks(P, c, C, d, is_equality, lower, upper)
        small, answers = SmallPrograms(P, c, C, d, is_equality, lower, upper, objective), self.answers
        tolerance, contradicts = min(self.settings.tolerance, PROGRAM_TOLERANCE), np.zeros(len(self.status), np.bool_)

        def solve_chunk(first: int, end: int) -> None:
            small.solve(tolerance, first, end, answers, contradicts)

        try:
            self._in_chunks(solve_chunk, len(self.status))
        finally:
            is_optimal = Errors(*answers.measures[:, :5].T).meet(program_goal(self.settings.tolerance))
            is_solved = answers.has_converged & is_optimal & self.programs.may_be_stated & leaves_unknowns
            self.is_open, self.status[is_solved] = ~is_solved, Status.SOLVED
            self.residual[is_solved] = answers.measures[is_solved, :4].max(axis=1)
            self.at_bounds[:] = np.maximum(answers.reduced, 0.0), np.maximum(-answers.reduced, 0.0)

    def _solve(self, k: int, wishes: dict[str, Any]) -> None:
        self._forget(k)
        result = self.results[k] = solve_program(self.programs[k], self.algorithm, **wishes)
        found = result.solution
        self.answers.x[k], self.answers.steps[k] = found.x, result.iterations
        self.answers.y[k] = np.concatenate([found.inequality, found.equality])
        self.at_bounds[:, k], self.residual[k] = (found.lower, found.upper), found.error
        self.status[k], self.is_open[k] = result.status, False
        self.is_interrupted |= result.status is Status.INTERRUPTED

    def _forget(self, items: Any) -> None:
        """Leave no numbers of what the loop has not solved."""
        for table in (self.answers.x, self.answers.y, *self.at_bounds):
            table[items] = np.nan

    def result_of(self, k: int) -> QuadraticProgramResult:
        """Return the result of program k, which has no error."""
        if k not in self.results:
            goal, share = program_goal(self.settings.tolerance), self.clock.read() / max(len(self.status), 1)
            multipliers = np.concatenate([self.answers.y[k], *self.at_bounds[:, k]])
            solution = QPSolution.of_rows(self.programs[k], self.answers.x[k], multipliers)
            self.results[k] = QuadraticProgramResult(
                self.status[k], solution, goal, f"auto: {ACTIVE_SET}", int(self.answers.steps[k]), share,
                self.settings.tolerance,
            )
        return self.results[k]


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
