"""`solve` of an LCP whose rows are spread over ranks: one loop, in step on all ranks."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from ..core.algorithm import Step
from ..core.certificates.measured import Measured
from ..core.checks import FloatVector, read_only
from ..core.deadline import Clock
from ..core.errors import InvalidOption, UnsuitableProblem
from ..core.kernels.threads import threads_for
from ..core.settings import Settings, Status, checked_callback
from ..core.solving.base_result import BaseResult
from ..core.solving.progress import Progress
from ..core.solving.result import Sample
from ..core.solving.run import Run
from ..core.solving.run_log import RunLog
from ..core.solving.stage import Named, Stage
from ..core.solving.termination import TerminationReason
from .certificate import CertificateOnRanks, RowDataOnRanks, error_bound, measured
from .collective import Interruptions
from .methods import chain

if TYPE_CHECKING:
    from .problem import RowsOnRanks

GROWTH = 1.05  # of the steps between two measurements
OF_RUN = {
    "tolerance",
    "absolute_tolerance",
    "max_iterations",
    "max_seconds",
    "error_bound",
    "verbose",
    "threads",
}


@dataclass(frozen=True, eq=False, repr=False)
class ResultOnRanks(BaseResult):
    """Result of a run on ranks: x, z and w are the local parts, all other attributes are the same on every rank.

    Attributes
    ----------
    z, w : ndarray, shape (own,)
        The local part of the best iterate and of its slack M z + q, read-only; `x` is z.
    n : int
        Number of unknowns of all ranks.
    status : Status
    certificate : CertificateOnRanks
    algorithm : str
        The methods that ran.
    iterations : int
    work : float
        Passes over M.
    seconds : float
        Seconds of the slowest rank.
    tolerance, absolute_tolerance : float
        The values passed to `solve`.
    history : tuple
        Empty, because runs on ranks are not recorded; use a callback.
    error_bound : float or None
        A proved bound of ‖z − z*‖∞ if it was requested; ∞ if M is not proved to be an H₊-matrix.
    """

    z: FloatVector = field(repr=False)
    w: FloatVector = field(repr=False)
    n: int
    status: Status
    certificate: CertificateOnRanks = field(repr=False)
    algorithm: str
    iterations: int
    work: float
    seconds: float
    tolerance: float
    absolute_tolerance: float = 0.0
    error_bound: float | None = None
    history: ClassVar[tuple[Sample, ...]] = ()

    @property
    def x(self) -> FloatVector:
        """The local part of the best iterate, z."""
        return self.z

    @property
    def residual(self) -> float:
        """The relative residual."""
        return self.certificate.relative_residual

    def plot(self, **how: Any) -> Any:
        """Raise UnsuitableProblem, because a rank has only a part of the unknowns.

        Raises
        ------
        UnsuitableProblem
            Always; plot the vector that ``problem.gathered(result.z)`` returns on rank 0.
        """
        raise UnsuitableProblem(
            "a result on ranks has only the local rows; plot the vector that problem.gathered(result.z) returns on "
            "rank 0"
        )

    def describe_accuracy(self) -> str:
        """Return the relative residual next to the tolerance, and the bound of the error if there is one."""
        bound = "" if self.error_bound is None else f", rigorous error bound {self.error_bound:.1e}"
        return f"relative residual {self.residual:.1e}, tolerance {self.tolerance:g}{bound}"

    def _size(self) -> int:
        return self.n

    def _numbers(self) -> dict[str, float]:
        names = "scaled_residual", "relative_residual", "term_residual"
        found = {name: getattr(self.certificate, name) for name in names}
        found |= {"work": self.work, "tolerance": self.tolerance}
        found |= {"absolute_tolerance": self.absolute_tolerance} if self.absolute_tolerance else {}
        return found if self.error_bound is None else {**found, "error_bound": self.error_bound}

    def __str__(self) -> str:
        return f"{self.status.name} by {self._effort()}, {self.describe_accuracy()}"


@np.errstate(all="ignore")
def solve_on_ranks(
    problem: RowsOnRanks,
    algorithm: str = "auto",
    *,
    z0: Any = None,
    callback: Callable[[Sample, FloatVector], Any] | None = None,
    **options: Any,
) -> ResultOnRanks:
    """Return the solution; parameters as in :func:`lcp_plugin.solve`, equal on every rank.

    Parameters
    ----------
    **options
        tolerance, absolute_tolerance, max_iterations, max_seconds, error_bound, verbose, threads (1 by default), and
        options of the algorithm.

    Raises
    ------
    UnknownAlgorithm, InvalidOption, UnsuitableMatrix
        On every rank.
    """
    ranks = problem.halo
    is_positive = ranks.everywhere(problem.diagonal > 0.0)
    of_run = {name: options.pop(name) for name in OF_RUN & options.keys()}
    settings, methods, callback = ranks.together(
        lambda: (
            Settings(**{"threads": 1, **of_run}),
            chain(algorithm, options, is_positive=is_positive),
            checked_callback(callback),
        )
    )
    ranks.require_same(
        "what is asked of solve", (algorithm, options, settings), "ask for the same", InvalidOption
    )
    start = problem.own_part(problem.nearest_to_zero if z0 is None else z0, "z0")
    z = np.clip(start, problem.lower, problem.upper)
    with threads_for(settings.threads), Interruptions() as is_interrupted:
        run = RunOnRanks(problem, ProgressOnRanks(problem, settings, callback, is_interrupted))
        found: ResultOnRanks = run.result(run.follow_all(run.plan(methods, z)))
    return found


class ProgressOnRanks(Progress):
    """Progress of a run whose limits and callback end it at the same step on all ranks.

    Parameters
    ----------
    problem : RowsOnRanks
    settings : Settings
    callback : callable or None
    is_interrupted : callable
        Returns whether this rank was interrupted by Ctrl-C.
    """

    def __init__(
        self, problem: RowsOnRanks, settings: Settings, callback: Any, is_interrupted: Any
    ) -> None:
        # The time limit of the loop is a limit of one rank: all ranks decide in `count`.
        log = RunLog(problem) if settings.verbose and not problem.halo.rank else None
        super().__init__(replace(settings, max_seconds=None), callback, Clock(), log)
        halo = problem.halo
        self.halo, self.max_seconds = halo, settings.max_seconds
        self.is_interrupted = is_interrupted
        self.is_watched = halo.anywhere(callback is not None) or settings.verbose

    def count(self, stage: Stage, step: Step) -> None:
        """Count a step, and decide with the other ranks whether a limit is reached."""
        super().count(stage, step)
        is_late = self.clock.elapsed >= self.max_seconds
        late, interrupted = self.halo.all_largest(float(is_late), float(self.is_interrupted()))
        if interrupted:
            self.end = TerminationReason.INTERRUPTED
        elif late:
            self.end = TerminationReason.TIME_LIMIT
        else:
            self.limit()

    def report(self, *given: Any, **how: Any) -> bool:
        """Print a line on rank 0, and call back; return whether a callback of any rank returned True."""
        report = super().report
        return self.halo.anywhere(self.halo.together(lambda: report(*given, **how)))


class RunOnRanks(Run):
    """Run of an LCP whose rows are spread over ranks: it measures at geometric intervals."""

    progress: ProgressOnRanks

    def __init__(self, problem: RowsOnRanks, progress: ProgressOnRanks) -> None:
        super().__init__(progress)
        self.problem, self.data, self.next_check = problem, RowDataOnRanks(problem), 0

    def plan(self, methods: Any, z: FloatVector) -> Iterator[Stage]:
        """Yield the methods one after the other, each from the best point."""
        for name, iterates in methods:
            points = iterates(self.problem, (z if self.best is None else self.best.z.z).copy())
            steps = (
                Step(point, work=work, iterations=int(k > 0 or work > 0.0))
                for k, (point, work) in enumerate(points)
            )
            yield Stage(Named(name), steps=steps)

    def measure(self, stage: Stage, step: Step) -> Measured | None:
        """Return the certificate of a step as measured; None if no measurement is due."""
        progress, settings = self.progress, self.settings
        is_due = progress.iteration >= self.next_check or progress.end is not None
        if not (is_due or progress.is_watched):
            return None
        found = measured(self.data, step.z, settings.tolerance, settings.absolute_tolerance)
        is_sweep = stage.algorithm.name != "multigrid"
        self.next_check = math.ceil(progress.iteration * GROWTH) + is_sweep
        return Measured(
            found,
            found.relative_residual,
            found.is_solved,
            found.is_at_rounding_level,
        )

    def end_of(self, stage: Stage, step: Step, found: Any) -> TerminationReason | None:
        """Return STALLED at rounding level, and if a residual is not finite."""
        if found is None or not (found.is_limited or not math.isfinite(found.residual)):
            return None
        return TerminationReason.STALLED

    def end_of_stage(self, stage: Stage, end: TerminationReason) -> TerminationReason:
        """Return the reason why the stage ended: the next method may do better at rounding level."""
        return end

    def result(self, end: TerminationReason) -> ResultOnRanks:
        """Return the result, the same on all ranks except z and w."""
        found, progress = self.best.z, self.progress
        bound = error_bound(self.data, found.z) if self.settings.error_bound else None
        return ResultOnRanks(
            z=read_only(found.z),
            w=read_only(found.w),
            n=self.problem.n,
            status=self.status(end),
            certificate=found,
            algorithm=" → ".join(stage.algorithm.name for stage in progress.stages),
            iterations=progress.iteration,
            work=progress.work,
            seconds=progress.halo.largest(progress.clock.read()),
            tolerance=self.settings.tolerance,
            absolute_tolerance=self.settings.absolute_tolerance,
            error_bound=bound,
        )
