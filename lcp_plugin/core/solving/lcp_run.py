"""The run of an LCP: its steps, the residuals that are due, the last clean-up, the result."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from functools import cache
from typing import Any

import numpy as np

from ..algorithm import Algorithm, Step
from ..certificates.criterion import POWER, measured_residual, rounding_of_data, row_data
from ..certificates.measured import Measured
from ..certificates.residuals import Certificate, ratio
from ..checks import FloatVector
from ..deadline import Clock
from ..errors import UnsuitableMatrix, UnsuitableProblem
from ..kernels.floats import DATA_ROUNDING
from ..lcp import LCP
from ..settings import Settings, Status
from .advice import WITHOUT_END, advice_of_run
from .progress import Callback, Progress
from .result import Result
from .run import STATUS_OF, Run
from .run_log import Header, RunLog
from .stage import Stage
from .termination import FAILED, TerminationReason, TerminationTest

Polish = Callable[[LCP, FloatVector, float], Any]


class LCPRun(Run):
    """Run of an LCP.

    Parameters
    ----------
    problem : LCP
    chosen : str or Algorithm
        The algorithm of the call.
    settings : Settings
    callback : callable or None
    clock : Clock
        Running.
    start : ndarray, shape (n,)
        Within the bounds.
    header : callable, optional
        The lines on M that ``verbose=True`` prints.
    is_guaranteed : callable, optional
        Returns whether a theorem proves that the chosen method converges on M.
    polish : callable, optional
        Returns the solution of the linear system on the active set of z, and its work, from (problem, z, most work).
    """

    def __init__(
        self,
        problem: LCP,
        chosen: str | Algorithm,
        settings: Settings,
        callback: Callback | None,
        clock: Clock,
        start: FloatVector,
        header: Header | None = None,
        polish: Polish | None = None,
        is_guaranteed: Callable[[], bool] = bool,
    ) -> None:
        self.problem, self.chosen = problem, chosen
        self.test, self.polish = TerminationTest(problem, settings), polish
        self.is_guaranteed = cache(is_guaranteed)
        with clock.pause():
            log = RunLog(problem, header) if settings.verbose else None
        super().__init__(Progress(settings, callback, clock, log))
        if self.test.solved_rows is not None:  # no point but z° can be measured there
            start = np.where(self.test.solved_rows, problem.nearest_to_zero, start)
        self.start, self.start_residual = start, math.inf
        self.unmeasured: FloatVector | None = None  # the latest iterate
        self.is_polished = False

    @property
    def z(self) -> FloatVector:
        """The best point so far, or the start."""
        return self.start if self.best is None else self.best.z

    def steps_of(self, stage: Stage) -> Iterator[Step]:
        """Yield the steps; none if a method of auto does not take this problem."""
        try:
            yield from stage.algorithm.iterates(self.problem, self.z.copy())
        except (UnsuitableMatrix, UnsuitableProblem):
            if len(self.progress.stages) == 1 or stage.iterations > 0:
                raise

    def measure(self, stage: Stage, step: Step) -> Measured | None:
        """Return the residual of a step if it is known or due, proved if it may be small enough."""
        test, progress, self.unmeasured = self.test, self.progress, step.z
        found = step.measured
        if found is not None and self._is_solved(found):
            progress.work += 1.0
            stage.record(float(found.residual))
            return Measured(step.z, stage.residuals[-1][1], passes=True)
        known, increment = step.residual if test.is_uniform else None, None
        if known is not None:
            residual = ratio(known, test.reference)
        else:
            change = step.residual if step.increment is None else step.increment
            increment = None if change is None else ratio(change, test.reference)
            if stage.residuals and not stage.is_due(increment, test.goal):
                return None
            residual = test.measure(step.z)
            progress.work += 1.0 if progress.iteration > 0 else 0.0  # the start is always measured
        may_pass = residual <= test.goal
        if may_pass:
            residual = test.certify(step.z)
        stage.record(residual, increment)
        if progress.iteration == 0:
            self.start_residual = residual
        if may_pass:
            power = 1.0 if stage.algorithm.ends_on_active_set else POWER
            may_pass = test.is_passed(step.z, residual, progress.iteration, power)
        return Measured(step.z, residual, may_pass)

    def _is_solved(self, found: Measured) -> bool:
        given = found.z, found.rows, found.residual, found.terms, self.settings.tolerance
        return bool(row_data(self.problem).are_solved(*given))

    def keep(self, found: Measured) -> None:
        """Keep a copy of a point that passes, or whose residual is the smallest."""
        self.unmeasured = None
        if self.best is None or found.passes or found.residual < self.residual:
            if self.best is None:
                self.best = found._replace(z=found.z.copy())
            else:
                np.copyto(self.best.z, found.z)
            self.residual = math.inf if math.isnan(found.residual) else found.residual

    def residual_of(self, step: Step) -> float:
        """Return the residual of a step that was not measured."""
        return self.test.measure(step.z)

    def _measure_last(self) -> None:
        if (z := self.unmeasured) is not None:
            self.keep(Measured(z, self.test.measure(z), passes=False))

    def end_of(self, stage: Stage, step: Step, found: Measured | None) -> TerminationReason | None:
        """Return the reason that the stage ends with this step, or None."""
        algorithm, test, progress = stage.algorithm, self.test, self.progress
        if found is None:
            is_lost = step.increment is not None and not math.isfinite(step.increment)
            return TerminationReason.DIVERGED if is_lost else None
        # A method that is not monotone may rise, but not to ∞.
        is_lost = algorithm.is_monotone and stage.rises >= 10
        is_lost = is_lost or not math.isfinite(found.residual)
        is_lost = is_lost and not found.residual <= 1e8 * max(1.0, self.start_residual)
        # A contraction in a weighted norm may multiply the residual before it falls.
        if is_lost and not (math.isfinite(found.residual) and self.is_guaranteed()):
            return TerminationReason.DIVERGED
        left = self.settings.max_iterations - progress.iteration
        if left <= 0 or progress.clock.elapsed >= self.settings.max_seconds:
            return None  # because a limit is reached
        if stage.is_flat() and test.is_at_floor(self.z):
            return TerminationReason.AT_FLOOR
        is_watched = algorithm.is_monotone or algorithm.is_watched
        if is_watched and stage.is_stalled(self.problem.n, test.goal, left):
            too_few = self.is_guaranteed()
            return TerminationReason.STEP_LIMIT if too_few else TerminationReason.STALLED
        return None

    def end_of_stage(self, stage: Stage, end: TerminationReason) -> TerminationReason:
        """Return the reason, or AT_FLOOR if rounding explains the residual of the best point."""
        self._measure_last()
        is_at_floor = end in FAILED and self.best is not None and self.test.is_at_floor(self.z)
        return TerminationReason.AT_FLOOR if is_at_floor else end

    def end_of_proof(self, proof: Any) -> TerminationReason | None:
        """Keep a proof; the run ends if it excludes the tolerance, or if only the rounding of the data is left."""
        end = super().end_of_proof(proof)
        if end is None and self.best is not None and self._is_within_rounding_of_data(self.z):
            return TerminationReason.AT_FLOOR
        return end

    # --- the end ----------------------------------------------------------------------------------------

    def result(self, end: TerminationReason) -> Result:
        """Return the result: the best iterate, cleaned and polished, with the status of its certificate."""
        settings = self.settings
        self._measure_last()
        certificate = self._final(self.z, end)
        status = self._status(certificate, end)
        name = self.chosen if isinstance(self.chosen, str) else self.chosen.name
        chain = [stage.name for stage in self.progress.records()]
        is_solved = status is Status.SOLVED
        return self.result_at(
            certificate,
            status,
            algorithm=name if chain in ([], [name]) else f"{name}: {', '.join(chain)}",
            infeasibility=self.proof,
            is_polished=self.is_polished,
            _asked=self.chosen,
            _wants_bound=settings.error_bound and bool(chain),
            _advice={} if is_solved else self._advice(certificate),
        )

    def _advice(self, certificate: Certificate) -> dict[Status, str]:
        """Return the advice of each status; of the problem's origin if it rejects the point."""
        said = advice_of_run(self.problem, self.chosen, self.settings)
        if self.test.is_rejected(certificate):
            said |= dict.fromkeys(WITHOUT_END, self.problem.origin.rejection)
        if self.progress.end is None:  # a step limit that is not reached
            begin, end = "iteration limit reached", said[Status.MAX_ITERATIONS]
            why = "a theorem proves convergence, but the rate of the run is too small for max_iterations"
            said[Status.MAX_ITERATIONS] = end.replace(begin, why)
        return said

    def _final(self, z: FloatVector, end: TerminationReason) -> Certificate:
        """Return the certificate of z, or of z after a last step of the method or on its active set if no worse."""
        test, settings = self.test, self.settings
        certificate = test.certificate_of(z)
        if not certificate.meets(settings):
            # The best iterate itself; SOLVED refers to the projected point.
            plain = Certificate.of(self.problem, z)
            certificate = certificate if plain.meets(settings) else plain
        stages = self.progress.stages
        last = stages[-1] if stages else None
        if last is None:
            return certificate
        if not settings.polish:
            return certificate
        is_cut_short = end in (TerminationReason.INTERRUPTED, TerminationReason.TIME_LIMIT)
        if not is_cut_short and np.isfinite(z).all():
            finished = last.algorithm.finish(self.problem, z)
            if finished is not z:
                certificate = test.better_of(certificate, test.certificate_of(finished))
        is_exact = last.algorithm.ends_on_active_set
        return certificate if is_exact else self._polish(certificate, last, end)

    def _polish(self, certificate: Certificate, last: Stage, end: TerminationReason) -> Certificate:
        """Return the certificate of the solution of the linear system on the active set of z, if it is no worse.

        A residual is not an error: if M is ill-conditioned, as of heavy bodies on light ones, a small one allows any z,
        and the solution of that system is off by rounding errors. It may take a tenth of the work of the run, or all of
        that if auto has not solved the problem. Twenty passes pay for the calls around it.
        """
        most = math.inf if self.chosen == "auto" else 0.0
        if certificate.meets(self.settings):
            most = 0.1 * self.progress.work - 20.0
        elif end not in (TerminationReason.CONVERGED, TerminationReason.AT_FLOOR, *FAILED):
            return certificate
        if self.polish is None or most <= 0.0:
            return certificate
        found = self.polish(self.problem, certificate.z, min(most, self.progress.work + 20.0))
        if found is None:
            return certificate
        self.progress.work += found.work
        last.count(Step(found.z, work=found.work), iterations=0)
        polished = np.clip(found.z, self.problem.lower, self.problem.upper)
        better = self.test.better_of(certificate, self.test.certificate_of(polished))
        self.is_polished = better is not certificate
        return better

    def _status(self, certificate: Certificate, end: TerminationReason) -> Status:
        """Return the status from the certificate or a proof, or else from the reason for the end of the run."""
        if certificate.meets(self.settings):
            return Status.SOLVED
        if end is TerminationReason.NO_SOLUTION and self.proof is not None:
            return self.proof.status  # type: ignore[no-any-return]
        is_limited = certificate.is_limited_by_rounding and not self.test.is_rejected(certificate)
        if is_limited or self._is_within_rounding_of_data(certificate.z):
            return Status.PRECISION_LIMIT
        # If one of several algorithms diverged, the best z need not have.
        is_chain = end is TerminationReason.DIVERGED and len(self.progress.stages) > 1
        return Status.STALLED if is_chain else STATUS_OF.get(end, Status.STALLED)

    def _is_within_rounding_of_data(self, z: FloatVector) -> bool:
        """Return whether no z is a solution, but the violation at this z is at most the rounding of the data."""
        if self.proof is None or not self.proof.is_rounding:
            return False
        certificate, problem = self.test.certificate_of(z), self.problem
        rounding = DATA_ROUNDING * float(np.abs(problem.q).max(initial=0.0))
        is_large = certificate.natural_residual > rounding
        if is_large and certificate.term_residual > self.settings.goal:
            return False  # small relative to a coefficient that may be inactive
        return measured_residual(problem, certificate.z) <= rounding_of_data(problem)
