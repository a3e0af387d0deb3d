"""solve() for rows spread over ranks: the same promises, every decision taken by all ranks alike."""

from __future__ import annotations

import math
import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..algorithms.base import Algorithm, Step
from ..certificates.residuals import ratio
from ..checks import finite_vector
from ..errors import InvalidOption
from ..pacing import CheckSchedule, Progress
from ..problem import FloatVector
from ..result import Result, Sample, StageRecord, Status
from ..settings import CallersOwn, Settings
from . import algorithms
from .certificate import DistributedCertificate, reference_residual_of, residual_of
from .collective import gathered, together
from .problem import DistributedLCP

DIVERGED_BEYOND = 1e8

DistributedResult = Result
"""As of one machine: `certificate` is a DistributedCertificate, z and w are the own parts, all else agrees."""


def solve(
    problem: DistributedLCP, algorithm: str | Algorithm = "auto", *, z0: ArrayLike | None = None,
    tolerance: float = 1e-8, tolerance_on: str = "residual", measure: str = "relative",
    max_iterations: int | None = None, max_seconds: float | None = None, record: bool = False,
    callback: Callable[[Sample, FloatVector], Any] | None = None, error_bound: bool = False, **options: Any,
) -> Result:
    """Return the best z an algorithm finds, as :func:`lcp_plugin.solve` does; all ranks call with the same arguments.

    Parameters
    ----------
    problem : DistributedLCP
    algorithm : str or Algorithm
        "auto" (multigrid, then sweeps), "multigrid", "npj", "npgs", "npsor", "npaor", "pgs" or "psor".
    z0 : array, shape (last − first,), optional
        The own part of a start.
    tolerance, tolerance_on, measure, max_iterations, max_seconds, record, error_bound
        As there. The slowest rank's clock counts. An error bound is the v-certificate's.
    callback : callable, optional
        Called on every rank with its own part of z; the run ends where one of them returns something true.
    **options
        relaxation, acceleration, nested: of the named algorithm.

    Returns
    -------
    Result
        z and w are the own parts; everything else is the same on every rank.

    Raises
    ------
    LCPError
        On every rank, whichever rank found the fault.
    """
    comm = problem.comm
    chosen, settings, start = together(comm, lambda: (
        algorithms.chosen(algorithm, dict(options)),
        Settings(tolerance, tolerance_on, measure, max_iterations, max_seconds, record, error_bound),
        _checked_start(problem, z0),
    ))
    together(comm, lambda: _check_callback(callback))
    with np.errstate(), _Interruptions() as interruptions:
        run = _Run(problem, settings, callback, interruptions)
        names = [chosen] if algorithm != "auto" else [chosen, algorithms.chosen("psor", {})]
        reason = Status.STALLED
        for k, one in enumerate(names):
            reason = run.drive(one, start, algorithms.MULTIGRID_FAILED if k else "")
            if reason is not Status.STALLED:
                break
        return run.judged("auto" if algorithm == "auto" else chosen.name, start, reason)


class _Run:
    """The state of one run: its clock, its best iterate, its record; the same on every rank but for z."""

    def __init__(self, problem: DistributedLCP, settings: Settings, callback: Any, interruptions: _Interruptions) -> None:
        self._began = time.perf_counter()
        self.problem, self.settings, self.interruptions = problem, settings, interruptions
        self.callback = None if callback is None else CallersOwn(callback)
        self.reference = reference_residual_of(problem)
        self.iteration, self.work, self.seconds, self.setup_seconds = -1, 0.0, 0.0, 0.0
        self.best, self.best_z = math.inf, np.array(problem.nearest_to_zero)
        self.start_residual = math.inf
        self.history: list[Sample] = []
        self.stages: list[StageRecord] = []
        self._next_sample = 0

    def drive(self, algorithm: Algorithm, start: FloatVector, because: str) -> Status:
        """Run one algorithm from the start, or from the best iterate so far; return why it ended."""
        begun, work = max(self.iteration, 0), self.work
        z = start if self.iteration < 0 else self.best_z
        per_increment = ratio(1.0, self.reference) if self.settings.measure == "relative" else 1.0
        checks = CheckSchedule(per_increment, self.settings.tolerance)
        progress = Progress(self.problem.n, self.settings.max_iterations)
        progress.restart(begun, self.best)
        reason = Status.STALLED
        for k, step in enumerate(algorithms.iterates(self.problem, algorithm, z.copy())):
            self.work += step.work
            self.iteration += k > 0 or not self.stages
            found = self._observe(step, checks, progress, is_first=k == 0, is_monotone=algorithm.is_monotone)
            if found is not None:
                reason = found
                break
        self.stages.append(StageRecord(algorithm.name, because, self.iteration - begun, self.work - work))
        return reason

    def _observe(
        self, step: Step, checks: CheckSchedule, progress: Progress, *, is_first: bool, is_monotone: bool
    ) -> Status | None:
        residual = None if step.residual is None else ratio(step.residual, self.reference)
        if self.settings.measure == "euclidean":
            residual = None
        is_due = is_first or checks.is_due(self.iteration, step.increment)
        if residual is None and is_due:
            residual = self._measured(step.z)
            self.work += not is_first
            if step.increment is not None:
                checks.learn(self.iteration, step.increment, residual)
        elif residual is not None and residual <= self.settings.tolerance:
            residual = self._measured(step.z)  # only the caller's own rows count
        if residual is not None:
            if residual < self.best or self.iteration == 0:
                self.best = residual
                np.copyto(self.best_z, step.z)
            if self.iteration == 0:
                self.start_residual = residual
        clock, wants_to_end = gathered(
            self.problem.comm, time.perf_counter() - self._began, self._told(step, residual)
        ).max(axis=0)
        self.seconds = float(clock)
        if self.iteration == 0:
            self.setup_seconds = self.seconds
        return self._reason_to_end(residual, step, progress, bool(wants_to_end), is_monotone)

    def _reason_to_end(
        self, residual: float | None, step: Step, progress: Progress, wants_to_end: bool, is_monotone: bool
    ) -> Status | None:
        if residual is not None and residual <= self.settings.tolerance:
            return Status.SOLVED
        if wants_to_end:
            return Status.INTERRUPTED
        value = residual if residual is not None else step.increment
        if value is not None and (not math.isfinite(value) or (
            residual is not None and residual > DIVERGED_BEYOND * max(self.start_residual, 1.0)
        )):
            return Status.DIVERGED
        if self.iteration >= self.settings.max_iterations:
            return Status.MAX_ITERATIONS
        if self.seconds >= self.settings.max_seconds:
            return Status.MAX_SECONDS
        if residual is None or not is_monotone:
            return None
        return Status.STALLED if progress.is_stalled(self.iteration, self.best, self.settings.tolerance) else None

    def _measured(self, z: FloatVector) -> float:
        if self.settings.measure == "euclidean":
            return DistributedCertificate.of(self.problem, z).euclidean_residual
        return ratio(residual_of(self.problem, z), self.reference)

    def _told(self, step: Step, residual: float | None) -> bool:
        """Record and call back; return whether this rank wants to end."""
        sample = Sample(self.iteration, self.work, self.seconds, residual, self._label)
        if self.settings.record and self.iteration >= self._next_sample and residual is not None:
            self._next_sample = max(self.iteration + 1, math.ceil(self.iteration * 1.05))
            self.history.append(sample)
        wants = self.interruptions.asked
        if self.callback is not None:
            view = step.z.view()
            view.flags.writeable = False
            wants = self.callback(sample, view) or wants
        return wants

    @property
    def _label(self) -> str:
        return "" if not self.stages else self.stages[-1].name

    def judged(self, name: str, start: FloatVector, reason: Status) -> Result:
        """Return the result: certify the best iterate, and let the certificate name the status."""
        problem, settings = self.problem, self.settings
        z = self.best_z if self.iteration >= 0 else start.copy()
        certificate = DistributedCertificate.of(problem, z)
        bound, no_bound = None, ""
        if settings.error_bound or settings.is_on_error:
            from .guarantees import error_bound_or_reason

            bound, no_bound = error_bound_or_reason(problem, z)
        if settings.is_on_error:
            is_solved = bound is not None and bound.proves(settings.tolerance)
        else:
            is_solved = certificate.measured(settings.measure) <= settings.tolerance
        if is_solved:
            reason = Status.SOLVED
        elif certificate.is_gained and certificate.is_at_rounding_level:
            reason = Status.PRECISION_LIMIT
        elif reason is Status.SOLVED:
            reason = Status.STALLED
        z.flags.writeable = False
        chain = ", ".join(stage.name for stage in self.stages)
        return Result(
            z=z, w=certificate.w, status=reason, certificate=certificate,  # type: ignore[arg-type]
            algorithm=name if name == chain else f"{name}: {chain}", iterations=max(self.iteration, 0), work=self.work,
            seconds=self.seconds, setup_seconds=self.setup_seconds, tolerance=settings.tolerance,
            tolerance_on=settings.tolerance_on, measure=settings.measure, history=tuple(self.history),
            stages=tuple(self.stages), error_bound=bound, no_error_bound=no_bound,
        )


class _Interruptions:
    """Ctrl-C on any rank becomes a wish that all ranks hear of at the next step; a second one ends this rank."""

    def __init__(self) -> None:
        self.asked = False
        self._before: Any = None

    def __enter__(self) -> _Interruptions:
        if threading.current_thread() is threading.main_thread():
            self._before = signal.signal(signal.SIGINT, self._hear)
        return self

    def __exit__(self, *_: object) -> None:
        if self._before is not None:
            signal.signal(signal.SIGINT, self._before)

    def _hear(self, *_: object) -> None:
        if self.asked:
            raise KeyboardInterrupt
        self.asked = True


def _checked_start(problem: DistributedLCP, z0: ArrayLike | None) -> FloatVector:
    if z0 is None:
        return problem.nearest_to_zero
    return np.clip(finite_vector(z0, "z0", problem.layout.own), problem.lower, problem.upper)


def _check_callback(callback: Any) -> None:
    if callback is not None and not callable(callback):
        raise InvalidOption(f"callback must be callable as callback(sample, z), got {callback!r}")
