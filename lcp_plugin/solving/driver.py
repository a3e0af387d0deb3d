"""solve(): the one loop, with its clock, its limits and its judgement."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..algorithms import Algorithm, Step
from ..algorithms.base import require_step
from ..algorithms.rehearsal import rehearse
from ..certificates.residuals import GAINED, Certificate, ratio, reference_residual, scaled_residual
from ..checks import FloatVector
from ..deadline import time_limit
from ..errors import InvalidOption, UnsuitableMatrix, UnsuitableProblem
from ..policy.choice import Choice, Policy, Single, Stage, policy_for
from ..policy.pacing import CheckSchedule, Ending, Paused, Progress
from ..problem.lcp import LCP, checked_start
from ..settings import PROVEN, CallersOwn, Settings, Status
from .error_watch import Bounded, ErrorWatch
from .guarantees import warn_where_uncovered
from .result import Result, Sample, StageRecord, status_of

Callback = Callable[[Sample, FloatVector], Any]

FAILED = (Status.STALLED, Status.DIVERGED, Status.MAX_ITERATIONS)
SAMPLE_GROWTH = 1.05
SAFE_TO_SQUARE = (1e-140, 1e140)  # beyond, a sum of squares has lost digits or overflowed


def solve(
    problem: LCP,
    algorithm: str | Algorithm = "auto",
    *,
    z0: ArrayLike | None = None,
    tolerance: float = 1e-8,
    tolerance_on: str = "residual",
    measure: str = "relative",
    max_iterations: int | None = None,
    max_seconds: float | None = None,
    record: bool = False,
    callback: Callback | None = None,
    error_bound: bool = False,
    **options: Any,
) -> Result:
    """Return the best z an algorithm finds, judged by a certificate on the problem's own data.

    Parameters
    ----------
    problem : LCP
        Never modified. A DistributedLCP is solved on all its ranks.
    algorithm : str or Algorithm
        A registered name (see ``lcp-plugin list``), "auto", or an object such as ``NPSOR(relaxation=1.5)``.
    z0 : array, shape (n,), optional
        Warm start, projected onto the bounds; by default the point of [lower, upper] nearest to 0.
    tolerance : float
        SOLVED means that the measured residual of the returned z is at most this.
    tolerance_on : {"residual", "error"}
        With "error", SOLVED means instead that ‖z − z*‖∞ ≤ tolerance · ‖z‖∞ is proved, z* the solution.
    measure : {"relative", "euclidean"}
        The residual to stop on: ``Certificate.relative_residual`` (without unit) or the paper's
        ``Certificate.euclidean_residual``.
    max_iterations : int, default 100 000
    max_seconds : float, optional
        Wall-clock limit in seconds, set-up included and compilation of kernels excluded; obeyed at the end of
        the iteration under way.
    record : bool
        Keep samples of the run at geometric intervals in ``Result.history``.
    callback : callable, optional
        Called as ``callback(sample, z)`` at every step with a read-only view of z; a truthy return value ends the
        run with status INTERRUPTED. What it raises is passed on.
    error_bound : bool
        Bound |z − z*|: in the result, computed when it is looked at; with ``record=True`` also along the run, the
        clock stopped. None where nothing about M allows a bound; see :func:`lcp_plugin.error_bound`.
    **options
        Options of the named algorithm.

    Returns
    -------
    Result
        Always, whatever the status, with the best iterate whose residual was measured (in-place methods are
        measured at intervals and at the end), also after Ctrl-C; before the first step that is the start.
        ``result.require_solved()`` raises instead.

    Raises
    ------
    UnknownAlgorithm, InvalidOption, UnsuitableMatrix, UnsuitableProblem
        Before the first iteration; UnsuitableMatrix also where ``tolerance_on="error"`` and M allows no error bound.

    Examples
    --------
    >>> problem = LCP([[4, -1], [-1, 4]], [-3, 5])
    >>> result = solve(problem, "npsor", relaxation=1.7)
    >>> result.status.name, result.z.round(6)
    ('SOLVED', array([0.75, 0.  ]))
    """
    if hasattr(problem, "solve_with"):  # its rows are not all here
        return problem.solve_with(  # type: ignore[no-any-return]
            algorithm=algorithm, z0=z0, tolerance=tolerance, tolerance_on=tolerance_on, measure=measure, record=record,
            max_iterations=max_iterations, max_seconds=max_seconds, callback=callback, error_bound=error_bound,
            **options,
        )
    if not isinstance(problem, LCP):
        raise InvalidOption(f"solve needs an LCP, got {type(problem).__name__}; write solve(LCP(M, q))")
    with np.errstate():  # Ctrl-C that hits one further down while it ends leaves its settings behind
        policy = policy_for(algorithm, options)
        settings = Settings(tolerance, tolerance_on, measure, max_iterations, max_seconds, record, error_bound)
        start = checked_start(problem, z0)
        run: _Run | None = None
        try:
            # Before the clock starts: the reference and the question below need compiled code too.
            rehearse(policy.algorithm if isinstance(policy, Single) else None, problem)
            run = _Run(problem, policy, settings, callback)
            run.errors.require_rigorous()
            if isinstance(policy, Single):
                warn_where_uncovered(problem, policy.algorithm, has_failed=False, stacklevel=2)
            with time_limit(settings.max_seconds):
                reason = run.drive(start)
            result = run.judged(start, reason)
        except KeyboardInterrupt:
            run = run or _Run(problem, policy, settings, callback)
            return run.judged(start, Status.INTERRUPTED)
        # What could be learnt from an analysis is not worth more time than the caller allows.
        if isinstance(policy, Single) and result.status in FAILED and not result.seconds >= settings.max_seconds:
            try:
                warn_where_uncovered(problem, policy.algorithm, has_failed=True, stacklevel=2)
            except KeyboardInterrupt:
                return replace(result, status=Status.INTERRUPTED)
        return result


class _Run(Ending):
    """The state of one run: its clock, its best iterate, its record."""

    def __init__(self, problem: LCP, policy: Policy, settings: Settings, callback: Callback | None) -> None:
        self._began = self._now = time.perf_counter()
        self.stopped = self._compiling = 0.0
        self.problem, self.policy, self.settings = problem, policy, settings
        self.callback = None if callback is None else CallersOwn(callback)
        if callback is not None and not callable(callback):
            raise InvalidOption(f"callback must be callable as callback(sample, z), got {callback!r}")
        self.reference = reference_residual(problem)
        self.errors = ErrorWatch(problem, settings)
        self.stages: list[Stage] = []
        self.iteration, self.work = -1, 0.0
        self.seconds = self.setup_seconds = 0.0  # up to the present step, the clock's pauses taken off
        self.history: list[Sample] = []
        self.best_z: FloatVector | None = None
        self.best = math.inf
        self.start_residual = math.inf
        # Near the answer an increment is about as large as the scaled residual.
        per_increment = ratio(1.0, self.reference) if settings.measure == "relative" else 1.0
        self.checks = CheckSchedule(per_increment, settings.tolerance)
        self.progress = Progress(problem.n, settings.max_iterations)
        self._last_certificate: Certificate | None = None
        self._unmeasured: FloatVector | None = None
        self._next_sample = 0
        self.proof: Any = None  # that there is no solution

    # --- the loop ---------------------------------------------------------------------------------------

    def drive(self, start: FloatVector) -> Status:
        """Run the chain of algorithms; return why it ended."""
        choice: Choice | None = self.policy.first(self.problem)
        if self.reference == 0.0:  # z° solves the problem, and no other point can be measured against it
            start = self.problem.nearest_to_zero
        while choice is not None:
            with Paused(self) as pause:
                rehearse(choice.algorithm, self.problem)
            self._compiling += pause.seconds
            self.stages.append(Stage(choice.algorithm, choice.because))
            z = (start if self.best_z is None else self.best_z).copy()
            choice, reason = self._run_stage(choice.iterates(self.problem, z))
            if reason is not None:
                return reason
        return Status.STALLED

    def _run_stage(self, steps: Iterator[Step]) -> tuple[Choice | None, Status | None]:
        """Run one algorithm; return the next one, or why the run is over."""
        try:
            following, reason = self._follow(steps)
        except (UnsuitableMatrix, UnsuitableProblem) as error:
            is_the_caller_s = self.callback is not None and error is self.callback.raised
            if len(self.stages) == 1 or self.stages[-1].iterations > 0 or is_the_caller_s:
                raise
            following, reason = None, Status.STALLED  # auto tried what does not take this problem
        if following is not None:
            return following, None
        if reason not in (Status.STALLED, Status.DIVERGED):
            return None, reason
        if self.is_at_floor():
            return None, Status.PRECISION_LIMIT
        following = self.policy.next_step(self.problem, self.stages, self.settings.tolerance, True)
        return (following, None) if following is not None else (None, reason)

    def _follow(self, steps: Iterator[Step]) -> tuple[Choice | None, Status]:
        """Take the steps of one algorithm until the policy or the run wants an end; STALLED where they just end."""
        stage = self.stages[-1]
        self.progress.restart(max(self.iteration, 0), self.best)
        is_first_step = True
        for step in steps:
            if is_first_step:
                require_step(stage.algorithm.name, step)
            self._now = time.perf_counter()
            self.seconds = self._now - self._began - self.stopped
            self._unmeasured = step.z
            self.work += step.work
            stage.work += step.work
            stage.remark = step.remark or stage.remark
            # A later stage begins with the iterate that the one before ended with.
            if not is_first_step or len(self.stages) == 1:
                self.iteration += 1
            stage.iterations += 0 if is_first_step else 1
            reason = self._observe(step, is_first_step)
            is_first_step = False
            if step.proof is not None and reason is None and self._counts(step.proof):
                return None, status_of(step.proof)
            if reason is not None:
                return None, reason
            following = self.policy.next_step(self.problem, self.stages, self.settings.tolerance, False)
            if following is not None:
                return following, Status.STALLED
        return None, Status.STALLED

    def _counts(self, proof: Any) -> bool:
        """Keep the proof of the largest margin; return whether no z at all could be called solved beside this one.

        Where the problem is made from a program, that has to be refuted in its own units as well.
        """
        settings = self.settings
        if not proof.verify():
            return False
        if self.proof is None or proof.measured(settings.measure) > self.proof.measured(settings.measure):
            self.proof = proof
        if not proof.excludes(settings.tolerance, settings.measure, settings.tolerance_on):
            return False
        is_refuted = getattr(self.problem.origin, "is_refuted", None)
        return is_refuted is None or is_refuted(settings.tolerance)

    def _observe(self, step: Step, is_first_step: bool) -> Status | None:
        """Take note of one step; return the reason to end, if there is one."""
        if self.iteration == 0:
            self.setup_seconds = self.seconds
        wanted = is_first_step or self.checks.is_due(self.iteration, step.increment)
        residual = self._residual(step, wanted)
        if residual is not None:
            if residual <= self.settings.tolerance:  # measured, not proved
                residual = self._certified_residual(step.z)
            if step.residual is None and step.increment is not None:
                self.checks.learn(self.iteration, step.increment, residual)
            self._keep_if_better(step.z, residual)
            self.stages[-1].note(residual)
            if self.iteration == 0:
                self.start_residual = residual
        reason = self.reason_to_end(step, residual, is_monotone=self.stages[-1].algorithm.is_monotone)
        wants_to_stop = self._report(step, residual, is_last=reason is not None)
        return reason or (Status.INTERRUPTED if wants_to_stop else None)

    @property
    def elapsed(self) -> float:
        """Seconds by the clock of the wall, compilation taken off."""
        return self._now - self._began - self._compiling

    def passes(self, z: FloatVector, residual: float) -> bool:
        if self.settings.is_on_error:
            if self.settings.measure == "euclidean":  # another norm, in another unit
                residual = Certificate.of(self.problem, z).relative_residual
            return self.errors.proves(z, residual * self.reference, self.iteration)
        return bool(residual <= self.settings.tolerance)

    # --- measuring --------------------------------------------------------------------------------------

    def _residual(self, step: Step, wanted: bool) -> float | None:
        """Return the residual of the step in the run's measure: the algorithm's own, or measured when wanted."""
        if self.settings.measure == "relative":
            if step.residual is not None:
                return ratio(step.residual, self.reference)
        elif step.euclidean is not None and SAFE_TO_SQUARE[0] < step.euclidean < SAFE_TO_SQUARE[1]:
            return step.euclidean
        if not wanted:
            return None
        if self.iteration > 0:  # every problem starts with a measured residual; only further ones are work
            self.work += 1.0
        return self._measure(step.z)

    def _measure(self, z: FloatVector) -> float:
        if self.settings.measure == "euclidean":
            return Certificate.of(self.problem, z).euclidean_residual
        with np.errstate(all="ignore"):
            residual = scaled_residual(self.problem, z, self.problem.slack(z))
            largest = float(np.max(np.abs(residual, out=residual), initial=0.0))
        return ratio(largest, self.reference)

    def _certified_residual(self, z: FloatVector) -> float:
        self._last_certificate = Certificate.of(self.problem, z)
        return self._last_certificate.measured(self.settings.measure)

    def is_at_floor(self) -> bool:
        if self.best_z is None:
            return False
        certificate = Certificate.of(self.problem, self.best_z)
        return certificate.relative_residual <= GAINED and certificate.is_at_rounding_level

    @cached_property
    def unit(self) -> float:
        """The size of a residual that is nothing to worry about: that of z°."""
        return 1.0 if self.settings.measure == "relative" else self._measure(self.problem.nearest_to_zero)

    def _keep_if_better(self, z: FloatVector | None, residual: float | None = None) -> None:
        """Keep a copy of the best iterate; measure z where its residual is not given."""
        if z is None:
            return
        self._unmeasured = None
        if residual is None:
            residual = self._measure(z)
        if self.best_z is None:
            self.best_z = z.copy()
            self.best = math.inf if math.isnan(residual) else residual
        elif residual < self.best:
            np.copyto(self.best_z, z)
            self.best = residual

    # --- telling ----------------------------------------------------------------------------------------

    def _report(self, step: Step, residual: float | None, *, is_last: bool) -> bool:
        """Record and call back, the clock stopped; return whether the caller wants to stop."""
        due = self.settings.record and (is_last or self.iteration >= self._next_sample)
        if not due and self.callback is None:
            return False
        with Paused(self):
            name = self.stages[-1].algorithm.name
            wants_to_stop = False
            if self.callback is not None:
                view = step.z.view()
                view.flags.writeable = False
                sample = Sample(self.iteration, self.work, self.seconds, residual, name)
                wants_to_stop = self.callback(sample, view)
            if due or (self.settings.record and wants_to_stop):
                self._next_sample = max(self.iteration + 1, math.ceil(self.iteration * SAMPLE_GROWTH))
                residual = self._measure(step.z) if residual is None else residual
                bound = self.errors.along_the_run(step.z, self.work)
                self.history.append(Sample(self.iteration, self.work, self.seconds, residual, name, bound))
            return wants_to_stop

    def judged(self, start: FloatVector, reason: Status) -> Result:
        """Return the result: finish, certify, and let the certificate name the status."""
        problem = self.problem
        self._keep_if_better(self._unmeasured)
        z = start if self.best_z is None else self.best_z
        if self.errors.proof is not None:  # in another measure it need not be the best
            z = self.errors.proof[0]
        certificate = self._last_certificate
        if certificate is None or not np.array_equal(certificate.z, z):
            certificate = Certificate.of(problem, z)
        may_finish = reason not in (Status.INTERRUPTED, Status.MAX_SECONDS) and self.settings.measure == "relative"
        if self.stages and may_finish and np.isfinite(z).all():
            finished = self.stages[-1].algorithm.finish(problem, z)
            cleaned = certificate if finished is z else Certificate.of(problem, finished)
            if cleaned.relative_residual <= certificate.relative_residual < math.inf:
                certificate = cleaned
        if self.settings.is_on_error:
            with Paused(self):
                is_solved = self.errors.is_proved(certificate.z)
        else:
            is_solved = certificate.measured(self.settings.measure) <= self.settings.tolerance
        if is_solved:
            reason = Status.SOLVED
        elif reason in PROVEN:
            pass
        elif certificate.relative_residual <= GAINED and certificate.is_at_rounding_level:
            reason = Status.PRECISION_LIMIT
        elif reason in (Status.SOLVED, Status.PRECISION_LIMIT) or (reason is Status.DIVERGED and len(self.stages) > 1):
            reason = Status.STALLED
        seconds = time.perf_counter() - self._began - self.stopped
        chain = [stage.algorithm.name for stage in self.stages]
        is_one = "".join(chain) in ("", self.policy.name)
        name = self.policy.name if is_one else f"{self.policy.name}: {', '.join(chain)}"
        return Result(
            z=certificate.z, w=certificate.w, status=reason, certificate=certificate, algorithm=name,
            iterations=max(self.iteration, 0), work=self.work, seconds=seconds, setup_seconds=self.setup_seconds,
            tolerance=self.settings.tolerance, tolerance_on=self.settings.tolerance_on, measure=self.settings.measure,
            history=tuple(self.history), bounded=self.errors.final(certificate.z) if self.stages else Bounded(),
            infeasibility=self.proof,
            stages=tuple(
                StageRecord(stage.algorithm.name, stage.because, stage.iterations, stage.work, stage.remark)
                for stage in self.stages
            ),
        )
