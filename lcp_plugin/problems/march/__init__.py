"""Time stepping: one matrix, and a q that depends on the solution of the previous step."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import scipy.sparse as sp

from ...api import solve
from ...auto import parse_call, plan, run_on, solve_lcp
from ...core.algorithm import Algorithm
from ...core.checks import (
    FloatVector,
    checked_start,
    is_number,
    read_only,
    real_array,
    rectangular_matrix,
    require_finite,
)
from ...core.deadline import Clock
from ...core.errors import InvalidProblem, LCPError
from ...core.lcp import LCP
from ...core.matrix.structure import connected_components
from ...core.settings import Settings, Status
from ...core.solving.result import Result, StageRecord
from ...methods.banded import Banded
from ...systems.factors import bands
from ..many.answers import AnswerSequence
from .on_band import BandSteps

ITERATIVE = ("npsor", "psor", "multigrid")
BLOCK = 64  # steps between two checks for Ctrl-C; results of earlier blocks are kept


class March(AnswerSequence[Result]):
    """The results of steps in time, in order; each is built when it is first read.

    Parameters
    ----------
    problem, forcing, propagator, z0 : problem, array of shape (k, n), csr_array of shape (n, n), array of shape (n,)
    keep : int
        The arguments of :func:`march`; keep 0 means the last step only.

    Attributes
    ----------
    z : list of arrays, shape (n,)
        The solution of each kept step.
    steps : list of int
        Number of each kept step, from 0; `taken` is the number of steps that were taken.
    all_solved : bool
        True if every step that was taken is SOLVED, and none was rejected or interrupted.
    error : LCPError or None
        Error of the q of the step that ended the march.
    seconds : float
        Wall-clock seconds of the march.
    """

    item = "step"
    all_solved = True

    def __init__(
        self,
        problem: Any,
        forcing: FloatVector,
        propagator: sp.csr_array,
        z0: FloatVector,
        keep: int = 1,
    ) -> None:
        self.problem, self.forcing, self.propagator, self.z0 = problem, forcing, propagator, z0
        self.keep, self.steps, self.taken = keep, list[int](), 0
        self.seconds = 0.0
        self.error: LCPError | None = None
        self.is_interrupted = False
        self.z: list[FloatVector] = []
        self._results: list[Result | Callable[[], Result]] = []

    def at(self, k: int) -> Result:
        """Return the result of step k."""
        found = self._results[k]
        if not isinstance(found, Result):
            found = self._results[k] = found()
        return found

    def __len__(self) -> int:
        return len(self.z)

    @property
    def status(self) -> list[Status]:
        """The status of each kept step; all but the last are SOLVED."""
        return [Status.SOLVED] * (len(self) - 1) + [one.status for one in self[-1:]]

    @property
    def algorithm(self) -> str:
        """Name of the algorithm of the last step."""
        return self[-1].algorithm if len(self) else "no step"

    def explain(self) -> str:
        """Return the number of steps by status, and the explanation of the last step."""
        last = f"the last step: {self[-1]}" if len(self) else ""
        return "\n".join(filter(None, [*self._summary(), last]))

    def _summary(self) -> list[str]:
        kept = f", {len(self)} kept" if len(self) < self.taken else ""
        found = f"{self.counts()}; {self.algorithm}, {self.seconds:.3g} s"
        steps = f"{self.taken} of {len(self.forcing)} steps{kept}: {found}"
        return [steps, *([f"ended by {self.error}"] if self.error else [])]

    def __repr__(self) -> str:
        return f"March({'; '.join(self._summary())})"

    def __getstate__(self) -> dict[str, Any]:
        """Build the results that were not read yet, because their builders cannot be pickled."""
        return {**self.__dict__, "_results": [self.at(k) for k in range(len(self))]}

    def take(self, z: FloatVector, result: Result | Callable[[], Result]) -> None:
        """Add one step; the step before it is dropped if it is not one of every `keep`."""
        if self.taken and (self.taken % self.keep if self.keep else True):
            del self.steps[-1], self.z[-1], self._results[-1]
        self.steps.append(self.taken)
        self.z.append(z)
        self._results.append(result)
        self.taken += 1


def take_steps_on_band(
    done: March, algorithm: str | Algorithm, wishes: dict[str, Any], limit: float
) -> None:
    """Take the steps of a march on a narrow band, until a time limit or an unsolved step."""
    problem, clock = done.problem, Clock()
    if not isinstance(problem, LCP) or not problem.n:
        return
    method, settings = parse_call(algorithm, wishes)
    begin = next(plan(problem, method, settings.goal))
    if (
        settings.record
        or settings.error_bound
        or settings.verbose
        or wishes.get("callback") is not None
        or not isinstance(begin.algorithm, Banded)
        or (band := bands(problem.matrix)) is None
        or connected_components(problem.matrix) is not None
    ):
        return
    steps, state = BandSteps(problem, band, done.propagator, settings.tolerance), done.z0
    while done.taken < len(done.forcing) and clock.read() < limit:
        forcing = done.forcing[done.taken : done.taken + BLOCK]
        solved = steps.solve(forcing, state)
        for q, state in zip(*solved, strict=True):
            row, z = (q, state) if done.keep == 1 else (q.copy(), read_only(state.copy()))
            done.take(z, partial(_result_at, problem, row, z, settings))  # without its block
        if len(solved[0]) < len(forcing):
            break
    done.seconds += clock.read()


def _result_at(problem: LCP, q: FloatVector, z: FloatVector, settings: Settings) -> Result:
    """Return the result of a step on a band, which is measured already."""
    stage = StageRecord(Banded.name, "M is a narrow band: many steps in one loop", 1, 1.0)
    return Result.at(problem.with_q(q), z, stage, settings)


def take_steps(
    done: March, algorithm: str | Algorithm, wishes: dict[str, Any], limit: float
) -> None:
    """Take the remaining steps of a march within a time limit, until one is not solved."""
    problem, propagator, total = done.problem, done.propagator, len(done.forcing)
    is_lcp, clock = isinstance(problem, LCP), Clock()
    state = done.z[-1] if done.z else done.z0
    begin: str | None = None  # the iteration that finished the step before
    while done.taken < total and done.all_solved:
        step = done.taken
        try:
            stated = problem.with_q(done.forcing[step] + propagator @ state)
            left = {} if limit == np.inf else {"max_seconds": max(limit - clock.read(), 0.0)}
            if is_lcp and begin is not None:
                within = parse_call("auto", {**wishes, **left})[1]
                near = checked_start(stated, state)
                found = run_on(
                    stated, None, within, near, Clock(), wishes.get("callback"), begin=begin
                )
            elif is_lcp:
                found = solve_lcp(stated, algorithm, z0=state, **{**wishes, **left})
            else:  # z° is not passed as a start, because over cones Newton's steps begin at a start
                start = {"z0": state} if (state != problem.nearest_to_zero).any() else {}
                found = solve(stated, algorithm, **{**wishes, **left, **start})
            done.all_solved = found.is_solved
            done.is_interrupted = found.status is Status.INTERRUPTED
            if is_lcp and algorithm == "auto" and found.is_solved and found.iterations:
                begin = beginning_of_next(found, step)
            done.take(found.z, found)
            state = found.z
        except InvalidProblem as error:
            if not done:
                raise
            done.error, done.all_solved = error, False
        except KeyboardInterrupt:
            if not done:
                raise
            done.is_interrupted, done.all_solved = True, False
    done.seconds += clock.read()


def beginning_of_next(found: Result, step: int) -> str | None:
    """Return the algorithm that finished this step and starts the next, or None for auto.

    The first step does not count, because it may start far from its solution.
    """
    last = found.stages[-1].name
    return last if step and last in ITERATIVE else None


def checked_rows(
    name: str, given: Any, shape: str, fits: Callable[[tuple[int, ...]], bool]
) -> FloatVector:
    """Return a finite array with a fitting shape."""
    need = f"{name} must be a finite array of shape {shape}"
    rows = real_array(given.toarray() if sp.issparse(given) else given, need)
    if not fits(rows.shape):
        raise InvalidProblem(f"{need}, got shape {rows.shape}")
    require_finite(rows, name)
    return rows


def checked_propagator(propagator: Any, n: int, name: str = "propagator") -> sp.csr_array:
    """Return the propagator as a finite matrix by rows; a number stands for a multiple of the identity."""
    if is_number(propagator):
        propagator = float(propagator) * sp.eye_array(n)
    return sp.csr_array(rectangular_matrix(propagator, name, n, n))
