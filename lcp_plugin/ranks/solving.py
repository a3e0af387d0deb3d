"""`solve` of an LCP whose rows are spread over ranks: one loop, in step on all ranks."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from ..core.checks import FloatVector, read_only
from ..core.errors import InvalidOption, NotConverged
from ..core.kernels.threads import threads_for
from ..core.settings import Settings, Status, checked_callback
from ..core.solving.result import Sample
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


@dataclass(frozen=True, eq=False)
class ResultOnRanks:
    """Result of a run on ranks; z and w are the local parts, all else is the same on every rank.

    Attributes
    ----------
    z, w : array, shape (own,)
    status : Status
    certificate : CertificateOnRanks
    algorithm : str
        The methods that ran.
    iterations : int
    work : float
        Passes over M.
    seconds : float
        Seconds of the slowest rank.
    error_bound : float or None
        A proved bound of ‖z − z*‖∞ if it was requested; ∞ if M is not proved to be an H₊-matrix.
    """

    z: FloatVector = field(repr=False)
    w: FloatVector = field(repr=False)
    status: Status
    certificate: CertificateOnRanks = field(repr=False)
    algorithm: str
    iterations: int
    work: float
    seconds: float
    error_bound: float | None = None

    @property
    def is_solved(self) -> bool:
        """True if the status is SOLVED."""
        return self.status is Status.SOLVED

    def require_solved(self) -> ResultOnRanks:
        """Return the result, or raise NotConverged if it is not solved."""
        if not self.is_solved:
            raise NotConverged(f"{self.status.name}: {self.status.value}")
        return self

    def __str__(self) -> str:
        bound = "" if self.error_bound is None else f", rigorous error bound {self.error_bound:.1e}"
        return (
            f"{self.status.name} by {self.algorithm}: {self.iterations} iterations, {self.seconds:.3g} s, "
            f"relative residual {self.certificate.relative_residual:.1e}{bound}"
        )


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
    z = problem.nearest_to_zero
    if z0 is not None:
        z = np.clip(problem.own_part(z0, "z0"), problem.lower, problem.upper)
    with threads_for(settings.threads), Interruptions() as is_interrupted:
        return _Run(problem, settings, callback, is_interrupted).follow(methods, z)


class _Run:
    """The loop over the methods' iterates: it measures, watches the limits and keeps the best point."""

    def __init__(
        self,
        problem: RowsOnRanks,
        settings: Settings,
        callback: Callable[[Sample, FloatVector], Any] | None,
        is_interrupted: Callable[[], bool],
    ) -> None:
        self.problem, self.settings, self.callback = problem, settings, callback
        self.is_interrupted, self.began = is_interrupted, time.perf_counter()
        self.data = RowDataOnRanks(problem)
        has_callback = problem.halo.anywhere(callback is not None)
        self.has_callback, self.is_watched = has_callback, has_callback or settings.verbose
        self.best: CertificateOnRanks | None = None
        self.iterations, self.work, self.next_check = 0, 0.0, 0

    def follow(self, methods: Any, z: FloatVector) -> ResultOnRanks:
        """Run the methods one after the other; return the result."""
        names, end = [], Status.STALLED
        for name, iterates in methods:
            names.append(name)
            start = z if self.best is None else self.best.z
            end = self._take(name, iterates(self.problem, start.copy()))
            if end is not Status.STALLED:
                break
        assert self.best is not None
        if self.best.is_solved(self.settings.tolerance, self.settings.absolute_tolerance):
            end = Status.SOLVED
        elif end is Status.STALLED and self.best.is_at_rounding_level:
            end = Status.PRECISION_LIMIT
        bound = error_bound(self.data, self.best.z) if self.settings.error_bound else None
        return ResultOnRanks(
            read_only(self.best.z),
            read_only(self.best.w),
            end,
            self.best,
            " → ".join(names),
            self.iterations,
            self.work,
            self._seconds(),
            bound,
        )

    def _seconds(self) -> float:
        return self.problem.halo.largest(time.perf_counter() - self.began)

    def _take(self, name: str, iterates: Any) -> Status:
        """Take the iterates of one method; return its status, STALLED if another may continue."""
        settings, first = self.settings, self.iterations
        for z, work in iterates:
            if self.iterations > first or work:
                self.iterations += 1
            self.work += work
            limit = self._limit()
            is_due = self.iterations >= self.next_check or limit is not None
            if is_due or self.is_watched:
                found = self._measured(z)
                self.next_check = math.ceil(self.iterations * GROWTH) + (name != "multigrid")
                if found.is_solved(settings.tolerance, settings.absolute_tolerance):
                    return Status.SOLVED
                if not math.isfinite(found.scaled_residual) or found.is_at_rounding_level:
                    return Status.STALLED
                if self._reported(name, found, z):
                    return Status.INTERRUPTED
            if limit is not None:
                return limit
        return Status.STALLED

    def _limit(self) -> Status | None:
        """Return the limit reached, the same on all ranks."""
        late = time.perf_counter() - self.began >= self.settings.max_seconds
        late, interrupted = self.problem.halo.all_largest(float(late), float(self.is_interrupted()))
        if interrupted:
            return Status.INTERRUPTED
        if late:
            return Status.MAX_SECONDS
        return Status.MAX_ITERATIONS if self.iterations >= self.settings.max_iterations else None

    def _measured(self, z: FloatVector) -> CertificateOnRanks:
        found = measured(self.data, z)
        best = self.best
        if best is None or not found.relative_residual > best.relative_residual:
            self.best = found
        return found

    def _reported(self, name: str, found: CertificateOnRanks, z: FloatVector) -> bool:
        """Call the callback, print a line on rank 0; return whether a callback requests a stop."""
        ranks = self.problem.halo
        sample = Sample(
            self.iterations,
            self.work,
            time.perf_counter() - self.began,
            found.relative_residual,
            name,
        )
        if self.settings.verbose and ranks.rank == 0:
            print(f"{name:>10} {self.iterations:>8} {found.relative_residual:>12.2e}", flush=True)
        if not self.has_callback:
            return False
        callback = self.callback
        wants = ranks.together(
            lambda: callback is not None and bool(callback(sample, read_only(z.copy())))
        )
        return ranks.anywhere(wants)
