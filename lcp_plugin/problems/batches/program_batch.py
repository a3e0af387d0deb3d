"""Batch of quadratic programs: one engine call per small program, one array criterion."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import scipy.sparse as sp

from ...auto import method_of
from ...core.kernels.floats import EPSILON
from ...core.settings import PROVEN, Status
from ...engines import ENGINES, engine_class
from ..many.chunks import run_in_chunks
from ..programs.criterion import QPSolution, errors_of_each
from ..programs.program import CANCELS, QuadraticProgram
from ..programs.program_matrices import may_be_small
from ..programs.solving import QuadraticProgramResult, solve_program
from ..programs.stacked_programs import QuadraticProgramBatch, block_matrices
from .batch_run import BatchRun

ENGINE = "daqp"
PROXIMAL = {"eta_prox": 1e-13, "eps_prox": -1e-3}  # for singular P, because no polish follows
ROUNDING = 4.0 * EPSILON  # of eigenvalues, relative to the largest and per unknown
TOGETHER = 2**18  # entries per evaluation of the criterion
BLOCKS_A_THREAD = 4


class ProgramBatchRun(BatchRun):
    """The results of programs of one shape in tables.

    Parameters
    ----------
    programs : QuadraticProgramBatch
    algorithm, options
        As for BatchRun.
    """

    def __init__(
        self, programs: QuadraticProgramBatch, algorithm: Any, options: dict[str, Any]
    ) -> None:
        if not (isinstance(algorithm, str) and algorithm in ENGINES):
            method_of(algorithm, {})
        super().__init__(programs, algorithm, options)
        programs.refuse_nonconvex()
        count, (m, p, n, _) = len(programs), programs.sizes
        self.y, self.at_bounds = np.full((count, m + p), np.nan), np.full((2, count, n), np.nan)
        self.begun: Any = None

    def solve_at_once(self) -> None:
        """Run the engine on small programs, in blocks, if the algorithm is auto or this engine."""
        m, p, n, _ = self.problems.sizes
        is_asked = self.algorithm in ("auto", ENGINE)
        if not (is_asked and may_be_small(n, m + p, [n * (n + m + p)])):
            return
        data, engine = self.problems.arrays, engine_class(ENGINE)(**PROXIMAL)
        count, threads = len(self.status), self.threads
        share = 1 if threads == 1 else BLOCKS_A_THREAD * threads
        size = max(min(TOGETHER // max(n * (n + m + p), 1), -(-count // share)), 1)
        may = self.problems.may_be_stated & _are_semidefinite(data[0])
        shared = cache(lambda count: block_matrices(data[0], data[2], m, count))

        def solve_blocks(first: int, end: int) -> None:
            for k in range(first, end):
                if self.has_time:
                    items = slice(k * size, min((k + 1) * size, count))
                    self._answer_together(data, engine, may, items, shared)

        run_in_chunks(solve_blocks, -(-count // size), threads)

    def _answer_together(
        self, data: tuple[Any, ...], engine: Any, may: Any, items: slice, shared: Any
    ) -> None:
        """Run the engine on each of these programs, and check all points together."""
        P, c, C, d, lower, upper = (one[items] if len(one) > 1 else one for one in data)
        m, n, wanted = self.problems.sizes[0], c.shape[1], np.flatnonzero(may[items])
        signed, steps = np.full((len(c), n + d.shape[1]), np.nan), self.iterations[items]
        x = np.full((len(c), n), np.nan)
        points = engine.points(P, c, C, d, m, lower, upper, wanted.tolist())
        for k, (at, multipliers, _, count) in zip(wanted.tolist(), points, strict=True):
            x[k], signed[k], steps[k] = at, multipliers, count
        y = signed[:, n:]
        y[:, :m] = np.maximum(y[:, :m], 0.0)
        of_bounds = (
            np.maximum(-signed[:, :n], 0.0) * np.isfinite(lower),
            np.maximum(signed[:, :n], 0.0) * np.isfinite(upper),
        )
        x = np.clip(x, lower, upper)
        is_shared, count = self.problems.has_one_matrix, len(c)
        matrices = shared(count) if is_shared else block_matrices(P, C, m, count)
        bounds = lower.ravel(), upper.ravel()
        rights = d[:, :m].ravel(), d[:, m:].ravel()
        together = QuadraticProgram.with_matrices(matrices, c.ravel(), *rights, *bounds)
        of_rows = np.concatenate([y[:, :m].ravel(), y[:, m:].ravel()])
        errors = errors_of_each(together, x, of_rows, self.settings.tolerance)
        is_solved = errors.meet(self.settings.tolerance)
        good = np.flatnonzero(is_solved)
        at = good + items.start
        self.z[at], self.y[at] = x[good], y[good]
        self.at_bounds[:, at] = np.array(of_bounds)[:, good]
        self.residual[at] = errors.largest[good]
        self.is_open[at], self.status[at] = False, Status.SOLVED
        self.report()

    def solve_alone(self, k: int, options: dict[str, Any]) -> None:
        """Solve program k by itself, from the previous solution if all have the same matrices."""
        result = solve_program(self.problems[k], self.algorithm, z0=self.begun, **options)
        if result.is_solved and self.problems.has_one_matrix:
            self.begun = result.z
        self.keep(k, result)

    def keep(self, k: int, found: QuadraticProgramResult) -> None:
        """Keep the result of program k."""
        point, self.results[k] = found.solution, found
        self.z[k], self.iterations[k] = point.x, found.iterations
        self.y[k] = np.concatenate([point.inequality, point.equality])
        self.at_bounds[:, k], self.residual[k] = (point.lower, point.upper), point.error
        self.status[k], self.is_open[k] = found.status, False
        self.is_interrupted |= found.status is Status.INTERRUPTED

    @classmethod
    def of(cls, problems: list[Any], starts: list[Any], *given: Any) -> BatchRun:
        """Return the run of a list of programs, one by one where a batch would take too much memory."""
        together = QuadraticProgramBatch.of(problems, problems[0])
        return BatchRun.of(problems, starts, *given) if together is None else cls(together, *given)

    def take(self, items: Any, run: BatchRun) -> None:
        """Take the results of the run of these programs."""
        super().take(items, run)
        if isinstance(run, ProgramBatchRun):
            self.y[items], self.at_bounds[:, items] = run.y, run.at_bounds

    def result_of(self, k: int) -> QuadraticProgramResult:
        """Return the result of program k, which has no error."""
        if k in self.results:
            found: QuadraticProgramResult = self.results[k]
            return found
        multipliers = np.concatenate([self.y[k], *self.at_bounds[:, k]])
        solution = QPSolution.of_rows(self.problems[k], self.z[k], multipliers)
        by = f"auto: {ENGINE}" if self.algorithm == "auto" else ENGINE
        share, steps = self.seconds / len(self.status), int(self.iterations[k])
        return QuadraticProgramResult(
            self.status[k], solution, by, steps, share, self.settings.tolerance
        )

    def tables(self) -> dict[str, Any]:
        """Return the arrays of the results by name."""
        m, (lower, upper) = self.problems.sizes[0], self.at_bounds
        rows = {"inequality": self.y[:, :m], "equality": self.y[:, m:]}
        shared = {"x": self.z, "residual": self.residual, "iterations": self.iterations}
        return {**shared, **rows, "lower": lower, "upper": upper}

    def objectives(self) -> Any:
        """Return ½ xᵀP x + cᵀx + constant of each program, NaN if it is proved infeasible or unbounded."""
        P, c, x = self.problems.P, self.problems.vectors["c"], self.z

        def values_of(P: Any, c: Any, x: Any) -> Any:
            Px = (P @ x.T).T if sp.issparse(P) else np.matmul(P, x[:, :, np.newaxis])[:, :, 0]
            return ((0.5 * Px + c) * x).sum(axis=1)

        values, terms = values_of(P, c, x), values_of(abs(P), np.abs(c), np.abs(x))
        values = values + self.problems.constant
        for i in np.flatnonzero(x.shape[1] * EPSILON * terms > CANCELS * np.abs(values)).tolist():
            values[i] = self.problems[i].objective(x[i])  # where terms cancel
        return np.where([status in PROVEN for status in self.status], np.nan, values)


def _are_semidefinite(P: Any) -> Any:
    """Return a mask of positive semidefinite P up to rounding error, shape (B or 1,)."""
    if not P.any():
        return np.ones(len(P), np.bool_)
    is_finite = np.isfinite(P).all(axis=(1, 2))
    values = np.linalg.eigvalsh(np.where(is_finite[:, np.newaxis, np.newaxis], P, 0.0))
    return is_finite & (values[:, 0] >= -ROUNDING * P.shape[1] * np.abs(values[:, -1]))
