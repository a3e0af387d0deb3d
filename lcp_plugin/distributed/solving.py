"""solve() for rows spread over ranks: the same promises, every decision taken by all ranks alike."""

from __future__ import annotations

import math
import signal
import threading
import time
from collections.abc import Callable
from functools import cached_property
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike

from ..algorithms.base import Algorithm, Step
from ..algorithms.rehearsal import rehearse
from ..certificates.error_bounds import ErrorBound
from ..certificates.residuals import Certificate, ratio
from ..checks import FloatVector, finite_vector
from ..errors import InvalidOption, InvalidProblem, UnsuitableMatrix
from ..peers.ranks.collective import largest, require_same, together
from ..policy.pacing import CheckSchedule, Progress, reason_to_end
from ..problem.lcp import LCP
from ..settings import Settings, Status
from ..solving.error_watch import Bounded
from ..solving.result import Result, Sample, StageRecord
from . import algorithms
from .certificate import DistributedCertificate, reference_residual_of, residual_of
from .guarantees import NO_PROOF, HPlusCertificate, error_bound, h_plus_certificate
from .problem import DistributedLCP

SAMPLE_GROWTH = 1.05
FALL = (0.01, 0.8)  # how far the residual has to fall until the next bound


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
        The own part of a start, projected onto the bounds.
    tolerance, tolerance_on, measure, max_iterations, max_seconds, record, error_bound
        As there. The slowest rank's clock counts. An error bound is the v-certificate's.
    callback : callable, optional
        Called on every rank that gives one, with its own part of z; the run ends where one of them returns something
        true. What it raises is passed on, and named by an LCPError on the other ranks.
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
        _checked_start(problem, z0, callback),
    ))
    is_auto = algorithm == "auto"
    require_same(
        comm, "what is asked of solve", f"{chosen!r}, {'auto, ' * is_auto}{settings!r}",
        "every rank must ask for the same", InvalidOption,
    )
    chain = [(chosen, "")]
    if is_auto:
        chain.append((algorithms.chosen("psor", {}), algorithms.MULTIGRID_FAILED))
    for one, _ in chain:
        rehearse(one, LCP([[1.0]], [-1.0]))
    with np.errstate(), _Interruptions() as interruptions:
        run = _Run(problem, settings, callback, interruptions)
        return run.judged("auto" if is_auto else chosen.name, run.drive(chain, start))


class _Run:
    """The state of one run: its clock, its best iterate, its record; the same on every rank but for z."""

    def __init__(
        self, problem: DistributedLCP, settings: Settings, callback: Any, interruptions: _Interruptions
    ) -> None:
        self._began, self._stopped = time.perf_counter(), 0.0
        self.problem, self.settings, self.interruptions = problem, settings, interruptions
        self.callback = callback
        self.is_followed = bool(largest(problem.comm, float(callback is not None))[0])
        self.reference = reference_residual_of(problem)
        self.target = _ErrorTarget(problem, settings.tolerance, self._proof_of_matrix) if settings.is_on_error else None
        self.iteration, self.work, self.seconds, self.setup_seconds = -1, 0.0, 0.0, 0.0
        self.best, self.best_z = math.inf, np.array(problem.nearest_to_zero)
        self.start_residual = math.inf
        self.history: list[Sample] = []
        self.stages: list[StageRecord] = []
        per_increment = ratio(1.0, self.reference) if settings.measure == "relative" else 1.0
        self.checks = CheckSchedule(per_increment, settings.tolerance)
        self.progress = Progress(problem.n, settings.max_iterations)
        self._unmeasured: FloatVector | None = None
        self._next_sample = 0

    # --- the loop ---------------------------------------------------------------------------------------

    def drive(self, chain: list[tuple[Algorithm, str]], start: FloatVector) -> Status:
        """Run the algorithms, each as a reason says, until one ends well; return why the last one ended."""
        if self.reference == 0.0:  # z° solves the problem, and no other point can be measured against it
            start = self.problem.nearest_to_zero
        reason = Status.STALLED
        for algorithm, because in chain:
            z = start if self.iteration < 0 else self.best_z
            reason = self._run_stage(algorithm, because, z.copy())
            if reason not in (Status.STALLED, Status.DIVERGED):
                break
            if self.is_at_floor():
                return Status.PRECISION_LIMIT
        return reason

    def _run_stage(self, algorithm: Algorithm, because: str, z: FloatVector) -> Status:
        begun, work = max(self.iteration, 0), self.work
        self.progress.restart(begun, self.best)
        reason: Status | None = None
        for k, step in enumerate(algorithms.iterates(self.problem, algorithm, z)):
            self._unmeasured = step.z
            self.work += step.work
            # A later stage begins with the iterate that the one before ended with.
            self.iteration += k > 0 or not self.stages
            reason = self._observe(step, algorithm, is_first_step=k == 0)
            if reason is not None:
                break
        self.stages.append(StageRecord(algorithm.name, because, self.iteration - begun, self.work - work))
        return reason or Status.STALLED

    def _observe(self, step: Step, algorithm: Algorithm, *, is_first_step: bool) -> Status | None:
        """Take note of one step; return the reason to end, if there is one."""
        own_seconds = time.perf_counter() - self._began - self._stopped
        self.seconds, is_interrupted = largest(self.problem.comm, own_seconds, float(self.interruptions.asked))
        if self.iteration == 0:
            self.setup_seconds = self.seconds
        residual = self._residual(step, is_first_step)
        if residual is not None:
            if residual <= self.settings.tolerance:  # only the certificate counts
                residual = DistributedCertificate.of(self.problem, step.z).measured(self.settings.measure)
            if step.residual is None and step.increment is not None:
                self.checks.learn(self.iteration, step.increment, residual)
            self._keep_if_better(step.z, residual)
            if self.iteration == 0:
                self.start_residual = residual
        reason = reason_to_end(self, step, residual, is_monotone=algorithm.is_monotone)
        if reason is None and is_interrupted:
            reason = Status.INTERRUPTED
        wants_to_end = self._told(step, residual, algorithm.name, is_last=reason is not None)
        return reason or (Status.INTERRUPTED if wants_to_end else None)

    # --- measuring --------------------------------------------------------------------------------------

    def _residual(self, step: Step, is_first_step: bool) -> float | None:
        """Return the residual of the step in the run's measure: the algorithm's own, or measured where it is due."""
        if self.settings.measure == "relative" and step.residual is not None:
            return ratio(step.residual, self.reference)
        if not (is_first_step or self.checks.is_due(self.iteration, step.increment)):
            return None
        self.work += self.iteration > 0
        return self._measured(step.z)

    def _measured(self, z: FloatVector) -> float:
        if self.settings.measure == "euclidean":
            return DistributedCertificate.of(self.problem, z).euclidean_residual
        return ratio(residual_of(self.problem, z), self.reference)

    @property
    def elapsed(self) -> float:
        """Seconds of the slowest rank, its pauses taken off."""
        return self.seconds

    def passes(self, z: FloatVector, residual: float) -> bool:
        if self.target is None:
            return bool(residual <= self.settings.tolerance)
        is_relative = self.settings.measure == "relative"
        return self.target.is_met(z, residual * self.reference if is_relative else residual_of(self.problem, z))

    @cached_property
    def unit(self) -> float:
        """The size of a residual that is nothing to worry about: that of z°."""
        return 1.0 if self.settings.measure == "relative" else self._measured(self.problem.nearest_to_zero)

    def is_at_floor(self) -> bool:
        certificate = DistributedCertificate.of(self.problem, self.best_z)
        return certificate.is_gained and certificate.is_at_rounding_level

    def _keep_if_better(self, z: FloatVector, residual: float) -> None:
        self._unmeasured = None
        if residual < self.best or self.iteration == 0:
            self.best = math.inf if math.isnan(residual) else residual
            np.copyto(self.best_z, z)

    # --- telling ----------------------------------------------------------------------------------------

    def _told(self, step: Step, residual: float | None, label: str, *, is_last: bool) -> bool:
        """Record and call back, the clock stopped; return whether a rank's callback wants to end."""
        paused = time.perf_counter()
        wants_to_end = self.is_followed and self._called_back(
            Sample(self.iteration, self.work, self.seconds, residual, label), step.z
        )
        if self.settings.record and (is_last or wants_to_end or self.iteration >= self._next_sample):
            self._next_sample = max(self.iteration + 1, math.ceil(self.iteration * SAMPLE_GROWTH))
            residual = self._measured(step.z) if residual is None else residual
            bound, _ = self._bound(step.z)
            infinity = None if bound is None else bound.infinity
            self.history.append(Sample(self.iteration, self.work, self.seconds, residual, label, infinity))
        self._stopped += time.perf_counter() - paused
        return wants_to_end

    def _called_back(self, sample: Sample, z: FloatVector) -> bool:
        view = z.view()
        view.flags.writeable = False
        wish = together(self.problem.comm, lambda: self.callback is not None and bool(self.callback(sample, view)))
        return bool(largest(self.problem.comm, float(wish))[0])

    def judged(self, name: str, reason: Status) -> Result:
        """Return the result: certify the best iterate, and let the certificate name the status."""
        problem, settings = self.problem, self.settings
        if self._unmeasured is not None:
            self._keep_if_better(self._unmeasured, self._measured(self._unmeasured))
        proof = self.target.proof if self.target is not None else None
        certificate = DistributedCertificate.of(problem, self.best_z if proof is None else proof[0])
        seconds = largest(problem.comm, time.perf_counter() - self._began - self._stopped)[0]
        bound, no_bound = self._bound(certificate.z) if proof is None else (proof[1], "")
        if settings.is_on_error:
            is_solved = bound is not None and bound.proves(settings.tolerance)
        else:
            is_solved = certificate.measured(settings.measure) <= settings.tolerance
        if is_solved:
            reason = Status.SOLVED
        elif certificate.is_gained and certificate.is_at_rounding_level:
            reason = Status.PRECISION_LIMIT
        elif reason in (Status.SOLVED, Status.PRECISION_LIMIT) or (reason is Status.DIVERGED and len(self.stages) > 1):
            reason = Status.STALLED
        ran = ", ".join(stage.name for stage in self.stages)
        return Result(
            z=certificate.z, w=certificate.w, status=reason, certificate=cast(Certificate, certificate),
            algorithm=name if name == ran else f"{name}: {ran}", iterations=max(self.iteration, 0), work=self.work,
            seconds=seconds, setup_seconds=self.setup_seconds, tolerance=settings.tolerance,
            tolerance_on=settings.tolerance_on, measure=settings.measure, history=tuple(self.history),
            stages=tuple(self.stages), bounded=Bounded(bound, no_bound),
        )

    def _bound(self, z: FloatVector) -> tuple[ErrorBound | None, str]:
        if not (self.settings.error_bound or self.settings.is_on_error):
            return None, ""
        if self._proof_of_matrix is None:
            return None, NO_PROOF
        return error_bound(self.problem, z, self._proof_of_matrix), ""

    @cached_property
    def _proof_of_matrix(self) -> HPlusCertificate | None:
        return h_plus_certificate(self.problem)


class _ErrorTarget:
    """When to bound the error of an iterate, which costs some passes over M, and whether one was proved."""

    def __init__(self, problem: DistributedLCP, tolerance: float, certificate: HPlusCertificate | None) -> None:
        if certificate is None:
            raise UnsuitableMatrix(f'tolerance_on="error" needs a rigorous bound; {NO_PROOF}')
        self.problem, self.tolerance, self.certificate = problem, tolerance, certificate
        self.proof: tuple[FloatVector, ErrorBound] | None = None
        self.next = math.inf
        with np.errstate(all="ignore"):
            sums = np.asarray(abs(problem.rows.as_csr()).sum(axis=1)) / problem.residual_scale
        # ‖r‖∞ ≤ (1 + max Σ|m_ij|/d_i)‖z − z*‖∞: a larger residual belongs to a larger error.
        self.residual_per_error = 1.0 + largest(problem.comm, float(sums.max(initial=0.0)))[0]

    def is_met(self, z: FloatVector, residual: float) -> bool:
        """Return whether the error of z, which has that scaled residual, is proved to be within the tolerance."""
        size, = largest(self.problem.comm, float(np.abs(z).max(initial=0.0)))
        if not residual <= min(self.next, self.residual_per_error * self.tolerance * size):
            return False
        bound = error_bound(self.problem, z, self.certificate)
        if bound.proves(self.tolerance):
            self.proof = z.copy(), bound
            return True
        # The bound falls with the residual.
        self.next = residual * min(max(self.tolerance / bound.relative, FALL[0]), FALL[1])
        return False


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


def _checked_start(problem: DistributedLCP, z0: ArrayLike | None, callback: Any) -> FloatVector:
    if callback is not None and not callable(callback):
        raise InvalidOption(f"callback must be callable as callback(sample, z), got {callback!r}")
    if z0 is None:
        return problem.nearest_to_zero
    try:
        start = finite_vector(z0, "z0", problem.layout.own)
    except InvalidProblem as error:
        raise InvalidOption(f"{error}; give the own part of it") from error
    return np.clip(start, problem.lower, problem.upper)
