"""The run of a batch of quadratic programs: an engine called for each small one, one judge of all in arrays."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sp

from ...core.kernels.floats import EPSILON
from ...core.settings import PROVEN, Status
from ...engines import ENGINES, engine_class
from ...engines.engine import beside_bounds
from ..programs.criterion import errors_of_each
from ..programs.program import CANCELS
from ..programs.program_matrices import may_be_small
from ..programs.solution import QPSolution
from ..programs.solving import QuadraticProgramResult, solve_program
from ..programs.stacked_programs import QuadraticProgramBatch, blocks
from .batch_run import BatchAnswers, BatchLoop

ENGINE = "daqp"
PROXIMAL = {"eta_prox": 1e-13, "eps_prox": -1e-3}  # of a singular P: no polish comes after it
ROUNDING = 4.0 * EPSILON  # of eigenvalues, beside the largest, an unknown
TOGETHER = 2**18  # entries that are judged at once
BLOCKS_A_THREAD = 4


class ProgramBatchRun(BatchLoop):
    """The answers as they come, in tables with a row a program.

    Parameters
    ----------
    programs : QuadraticProgramBatch
    algorithm, wishes, threads, limit
        As in `BatchLoop`.
    """

    def __init__(
        self,
        programs: QuadraticProgramBatch,
        algorithm: Any,
        wishes: dict[str, Any],
        *,
        threads: int,
        limit: float,
    ) -> None:
        is_engine = isinstance(algorithm, str) and algorithm in ENGINES
        super().__init__(
            len(programs),
            "auto" if is_engine else algorithm,
            wishes,
            {},
            threads=threads,
            limit=limit,
        )
        self.algorithm = algorithm
        programs.refuse_nonconvex()
        self.programs, count, (m, p, n, _) = programs, len(programs), programs.sizes
        self.x, self.y = np.full((count, n), np.nan), np.full((count, m + p), np.nan)
        self.at_bounds, self.steps = np.full((2, count, n), np.nan), np.zeros(count, np.int64)
        self.results: dict[int, QuadraticProgramResult] = {}
        self.start: Any = None

    def _answers(self) -> ProgramBatchResult:
        return ProgramBatchResult(self)

    def _leave(self, items: Any) -> None:
        self._forget(items)
        lower, upper = (
            np.broadcast_to(self.programs.vectors[name], self.x.shape)
            for name in ("lower", "upper")
        )
        self.x[items] = np.clip(0.0, lower[items], upper[items])

    def _solve_compiled(self) -> None:
        m, p, n, _ = self.programs.sizes
        if self.algorithm not in ("auto", ENGINE) or not may_be_small(n, m + p, [n * (n + m + p)]):
            return
        data, engine = self.programs.arrays, engine_class(ENGINE)(**PROXIMAL)
        count, share = len(self.status), 1 if self.threads == 1 else BLOCKS_A_THREAD * self.threads
        size = max(min(TOGETHER // max(n * (n + m + p), 1), -(-count // share)), 1)
        may = self.programs.may_be_stated & _are_semidefinite(data[0])

        def solve_blocks(first: int, end: int) -> None:
            for k in range(first, end):
                if self.has_time:
                    items = slice(k * size, min((k + 1) * size, count))
                    self._answer_together(data, engine, may, items)

        self._in_chunks(solve_blocks, -(-count // size))

    def _answer_together(self, data: tuple[Any, ...], engine: Any, may: Any, items: slice) -> None:
        """Ask the engine for each of these programs, and judge what it says of all."""
        P, c, C, d, lower, upper = (one[items] if len(one) > 1 else one for one in data)
        m, n, wanted = self.programs.sizes[0], c.shape[1], np.flatnonzero(may[items])
        x, signed, steps = (
            self.x[items],
            np.full((len(c), n + d.shape[1]), np.nan),
            self.steps[items],
        )
        points = engine.points(P, c, C, d, m, lower, upper, wanted.tolist())
        for k, (at, multipliers, _, count) in zip(wanted.tolist(), points, strict=True):
            x[k], signed[k], steps[k] = at, multipliers, count
        y = signed[:, n:]
        y[:, :m] = np.maximum(y[:, :m], 0.0)
        of_bounds = beside_bounds(signed[:, :n], lower, upper)
        self.x[items], self.y[items], self.at_bounds[:, items] = (
            np.clip(x, lower, upper),
            y,
            of_bounds,
        )
        together = blocks(P, c, C, d, m, lower, upper)
        of_rows = np.concatenate([y[:, :m].ravel(), y[:, m:].ravel()])
        errors = errors_of_each(together, self.x[items], of_rows, self.settings.tolerance)
        is_solved = errors.meet(self.settings.tolerance)
        self.is_open[items] = ~is_solved
        self.status[np.flatnonzero(is_solved) + items.start] = Status.SOLVED
        self.residual[items] = np.where(is_solved, errors.largest, np.nan)

    def _solve(self, k: int, wishes: dict[str, Any]) -> None:
        self._forget(k)
        result = self.results[k] = solve_program(
            self.programs[k], self.algorithm, z0=self.start, **wishes
        )
        found = result.solution
        if result.is_solved and self.programs.has_one_matrix:
            self.start = result.z  # a run goes on from the last one
        self.x[k], self.steps[k] = found.x, result.iterations
        self.y[k] = np.concatenate([found.inequality, found.equality])
        self.at_bounds[:, k], self.residual[k] = (found.lower, found.upper), found.error
        self.status[k], self.is_open[k] = result.status, False
        self.is_interrupted |= result.status is Status.INTERRUPTED

    def _forget(self, items: Any) -> None:
        """Leave no numbers of what the loop has not solved."""
        for table in (self.x, self.y, *self.at_bounds):
            table[items] = np.nan

    def result_of(self, k: int) -> QuadraticProgramResult:
        """Return the result of program k, which has no error."""
        if k not in self.results:
            share = self.clock.read() / max(len(self.status), 1)
            multipliers = np.concatenate([self.y[k], *self.at_bounds[:, k]])
            solution = QPSolution.of_rows(self.programs[k], self.x[k], multipliers)
            by = f"auto: {ENGINE}" if self.algorithm == "auto" else ENGINE
            self.results[k] = QuadraticProgramResult(
                self.status[k],
                solution,
                by,
                int(self.steps[k]),
                share,
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
        As of a :class:`~lcp_plugin.problems.programs.solving.QuadraticProgramResult`. None where the data are no convex
        program.
    residual : array, shape (B,)
        An upper bound of the largest measure of a QPSolution; NaN where nothing was found.
    iterations : array of int, shape (B,)
    seconds : float
        Seconds of the whole batch, compilation excluded.
    errors : dict
        What is wrong with program k, where something is; ``answers[k]`` raises it.
    programs : QuadraticProgramBatch

    Notes
    -----
    ``answers[k]`` is the :class:`~lcp_plugin.problems.programs.solving.QuadraticProgramResult` of program k.
    """

    ITEM = "program"

    def __init__(self, run: ProgramBatchRun) -> None:
        m = run.programs.sizes[0]
        super().__init__(run, run.result_of, run.x, run.y, run.steps, run.at_bounds)
        self.x, self.residual, self.iterations, self.programs = (
            run.x,
            run.residual,
            run.steps,
            run.programs,
        )
        self.inequality, self.equality = run.y[:, :m], run.y[:, m:]
        self.lower, self.upper = run.at_bounds

    @cached_property
    def objective(self) -> Any:
        """½ xᵀP x + cᵀx of each, shape (B,), NaN where a proof says that there is no minimum; made when looked at."""
        P, c, x = self.programs.P, self.programs.vectors["c"], self.x

        def values_of(P: Any, c: Any, x: Any) -> Any:
            Px = (P @ x.T).T if sp.issparse(P) else np.matmul(P, x[:, :, np.newaxis])[:, :, 0]
            return ((0.5 * Px + c) * x).sum(axis=1)

        values, terms = values_of(P, c, x), values_of(abs(P), np.abs(c), np.abs(x))
        for i in np.flatnonzero(x.shape[1] * EPSILON * terms > CANCELS * np.abs(values)).tolist():
            values[i] = self.programs[i].objective(x[i])  # where terms cancel
        return np.where([status in PROVEN for status in self.status], np.nan, values)


def _are_semidefinite(P: Any) -> Any:
    """Return which P are positive semidefinite up to rounding, shape (B or 1,); the others are looked at one by one."""
    if not P.any():
        return np.ones(len(P), np.bool_)
    is_finite = np.isfinite(P).all(axis=(1, 2))
    values = np.linalg.eigvalsh(np.where(is_finite[:, np.newaxis, np.newaxis], P, 0.0))
    return is_finite & (values[:, 0] >= -ROUNDING * P.shape[1] * np.abs(values[:, -1]))
