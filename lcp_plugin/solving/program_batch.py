"""The run of a batch of quadratic programs: a compiled loop over small ones, one by one what that leaves open."""

from __future__ import annotations

from fractions import Fraction
from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sp

from ..algorithms.interior_points.small_programs import (
    MOST_STEPS,
    SEARCHED_UP_TO,
    SmallAnswers,
    SmallPrograms,
    may_be_small,
)
from ..checks import FloatVector
from ..conversions.program import QuadraticProgram
from ..conversions.program_batch import QuadraticProgramBatch
from ..conversions.qp_certificates import with_bounds
from ..conversions.qp_forms import program_goal
from ..conversions.qp_solution import QPSolution
from ..settings import Status
from .batch_run import BatchAnswers, BatchLoop
from .quadratic_program import solve_quadratic_program

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
        self.solutions: dict[int, QPSolution] = {}  # of those that were solved one by one

    def run(self) -> ProgramBatchResult:
        """Solve all, and gather what was found."""
        self._solve_all()
        left, shape = self.is_open, self.answers.x.shape
        self._forget(left)
        lower, upper = (np.broadcast_to(self.programs.vectors[name], shape) for name in ("lower", "upper"))
        self.answers.x[left] = np.clip(0.0, lower[left], upper[left])
        self.status[left] = "unknown"
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
            self.is_open, self.status[is_solved] = ~is_solved, "optimal"
            self.residual[is_solved] = answers.measures[is_solved, :4].max(axis=1)
            self.at_bounds[:] = np.maximum(answers.reduced, 0.0), np.maximum(-answers.reduced, 0.0)

    def _solve(self, k: int, wishes: dict[str, Any]) -> None:
        y = self.answers.y[k].copy()
        self._forget(k)
        program = self.programs[k]
        if self.contradicts[k] and (proved := self._proved(program, y)) is not None:
            self.solutions[k], self.answers.x[k], self.status[k] = proved, proved.x, proved.status
            self.is_open[k] = False
            return
        result, found = solve_quadratic_program(program, self.algorithm, **wishes)
        may_refute = self.settings.refute
        self.solutions[k], self.answers.x[k], self.answers.steps[k] = found, found.x, result.iterations
        self.answers.y[k] = np.concatenate([found.inequality, found.equality])
        self.at_bounds[:, k], self.residual[k] = (found.lower, found.upper), max(found.residual, found.row_residual)
        self.status[k] = found.status if may_refute or found.is_stationary() else "unknown"
        self.is_open[k] = False
        if result.status is Status.INTERRUPTED:
            is_refuted = may_refute and program.refutation(program_goal(self.settings.tolerance)) is not None
            self.is_interrupted = not is_refuted

    def _forget(self, items: Any) -> None:
        """Leave no numbers of what the loop has not solved."""
        for table in (self.answers.x, self.answers.y, *self.at_bounds):
            table[items] = np.nan

    def _proved(self, program: QuadraticProgram, y: FloatVector) -> QPSolution | None:
        """Return the answer to an infeasible program, where these multipliers of its rows prove that; checked exactly.

        Those of bounds are what they leave.
        """
        proof = with_bounds(program, {i: Fraction(value) for i, value in enumerate(y.tolist()) if value})
        if not proof.verify() or not proof.excludes(program_goal(self.settings.tolerance)):
            return None
        program.__dict__["proof_of_no_minimum"] = proof
        nothing = (np.full(size, np.nan) for size in self.programs.sizes)
        return QPSolution(program, np.clip(0.0, program.lower, program.upper), *nothing)

    def solution_of(self, k: int) -> QPSolution:
        """Return the solution of program k, which has no error."""
        if k not in self.solutions:
            m, (lower, upper), y = self.programs.sizes[0], self.at_bounds[:, k], self.answers.y[k]
            self.solutions[k] = QPSolution(self.programs[k], self.answers.x[k], y[:m], y[m:], lower, upper)
        return self.solutions[k]


class ProgramBatchResult(BatchAnswers[QPSolution]):
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
    status : array of str, shape (B,)
        As `QPSolution.status`: "optimal" by the residuals of the program itself, "infeasible" or "unbounded" by a
        proof; otherwise, and where the clock or Ctrl-C came first, "unknown". None where the data are no convex
        program.
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
    ``answers[k]`` is the :class:`~lcp_plugin.conversions.qp_solution.QPSolution` of program k.
    """

    ITEM = "program"

    def __init__(self, run: ProgramBatchRun) -> None:
        answers, m = run.answers, run.programs.sizes[0]
        super().__init__(run, run.solution_of, answers.x, answers.y, answers.steps, run.at_bounds)
        self.x, self.residual, self.iterations, self.programs = answers.x, run.residual, answers.steps, run.programs
        self.inequality, self.equality = run.answers.y[:, :m], run.answers.y[:, m:]
        self.lower, self.upper = run.at_bounds

    @cached_property
    def objective(self) -> Any:
        """½ xᵀP x + cᵀx of each, shape (B,); computed when it is looked at."""
        P, x = self.programs.P, self.x
        Px = (P @ x.T).T if sp.issparse(P) else np.matmul(P, x[:, :, np.newaxis])[:, :, 0]
        return ((0.5 * Px + self.programs.vectors["c"]) * x).sum(axis=1)

    @property
    def all_solved(self) -> bool:
        """Whether every status is "optimal"."""
        return bool((self.status == "optimal").all())
