"""`solve` of an LCP whose rows are spread over ranks: the loop and the criterion."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import partial
from pkgutil import resolve_name
from typing import Any

import numpy as np
import scipy.sparse as sp
from scipy.sparse import csgraph

from ..core.algorithm import Step
from ..core.checks import Array, Vector, read_only
from ..core.deadline import Clock
from ..core.entries import largest_products
from ..core.errors import InvalidOption, UnsuitableProblem
from ..core.kernels.threads import threads_for
from ..core.problem_classes import CLASSES
from ..core.rounding import compensated_product
from ..core.settings import PROVEN, Settings, Status, checked_callback
from ..judges.lcp import Measured, RowData, VectorEnds, divide_nonnegative
from ..judges.worst_rows import outside_row
from ..solving.result import BaseResult, Sample
from ..solving.run import Named, Progress, Run, Stage
from .halo import Halo, deferred_interruptions
from .methods import chain
from .problem import RowsOnRanks


class ComponentsOnRanks:
    """The connected components of M's graph over all ranks."""

    def __init__(self, problem: RowsOnRanks) -> None:
        self.halo = halo = problem.halo
        size = problem.own
        rows, width = problem.rows, problem.rows.shape[1]
        indptr = np.pad(rows.indptr, (0, width - size), "edge")  # the rows of ghosts are empty
        square = sp.csr_array((rows.data, rows.indices, indptr), shape=(width, width))
        count, local = csgraph.connected_components(square, directed=False)
        counts = halo.comm.allgather(count)
        names, total = local + sum(counts[: halo.rank]), sum(counts)
        theirs = halo.whole(names[:size].astype(np.float64))[size:].astype(np.int64)
        met = np.unique(np.stack([names[size:], theirs], axis=1), axis=0)
        pairs = np.concatenate(halo.comm.allgather(met))
        pattern = sp.coo_array((np.ones(len(pairs)), tuple(pairs.T)), shape=(total, total))
        self.count, joined = csgraph.connected_components(pattern, directed=False)
        self.labels = joined[names[:size]]
        # Several ranks share few components; only those are compared.
        self._shared = np.unique(joined[pairs[pairs[:, 0] != pairs[:, 1]].ravel()])

    def largest(self, values: Vector) -> Vector:
        """Return, per local row, the largest value ≥ 0 of its component's rows; a NaN stays."""
        largest = np.zeros(self.count)
        np.maximum.at(largest, self.labels, values)
        if self._shared.size:
            largest[self._shared] = self.halo.all_largest(*largest[self._shared].tolist())
        return largest[self.labels]


@dataclass(frozen=True, eq=False)
class CertificateOnRanks:
    """The residual of a point, measured on the problem's data; every number is the same on all ranks.

    Attributes
    ----------
    z, w : array, shape (own,)
        The point and its slack; unknowns closer to a bound than w_i/d_i are moved to it.
    scaled_residual : float
        ‖r(z)‖∞, rounding included.
    relative_residual : float
        The largest ‖r_P(z)‖∞ / ref_P of the components P.
    term_residual : float
        The least tolerance at which every row passes the componentwise test.
    """

    z: Vector = field(repr=False)
    w: Vector = field(repr=False)
    scaled_residual: float
    relative_residual: float
    term_residual: float


class ProductOnRanks:
    """A matrix by which each rank multiplies the vectors of all ranks; it returns the local part."""

    def __init__(self, rows: sp.csr_array, halo: Halo) -> None:
        self.rows, self.halo, self.indptr, self.diagonal = rows, halo, rows.indptr, rows.diagonal

    def __matmul__(self, x: Vector) -> Vector:
        return self.rows @ self.halo.whole(x.astype(np.float64, copy=False))


class RowDataOnRanks(RowData):
    """M, q, bounds, d and components: the data of the criterion, of the local rows."""

    def __init__(self, problem: RowsOnRanks) -> None:
        M, size = (ProductOnRanks(rows, problem.halo) for rows in (problem.rows, abs(problem.rows)))
        d = problem.residual_scale
        super().__init__(M, size, problem.q, problem.lower, problem.upper, d)
        self.problem, self.components = problem, ComponentsOnRanks(problem)

    def anywhere(self, mask: object) -> bool:
        """Return whether the mask is True in any row of any rank."""
        return self.problem.halo.anywhere(mask)

    def worst(self, values: Vector) -> float:
        """Return the largest of the values ≥ 0 of all ranks."""
        return self.problem.halo.largest(values)

    def largest(self, values: Vector) -> Vector:
        """Return the largest of the values ≥ 0 in the component of each row; a NaN stays."""
        return self.components.largest(values)

    def sharp_product(self, z: Vector) -> VectorEnds:
        """Return M z + q by sums in twice the precision, and bounds of their errors."""
        problem = self.problem
        return compensated_product(problem.rows, problem.halo.whole(z), problem.q)

    def largest_products(self, x: Vector) -> Vector:
        """Return max_j |m_ij| x_j of each row, x ≥ 0."""
        return largest_products(self.absolute.rows, self.problem.halo.whole(x))


OF_RUN = {"tolerance", "absolute_tolerance", "max_iterations", "max_seconds", "verbose", "threads"}


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
    infeasibility : NoSolutionProof or None
        A proof that no solution exists, of a problem that one process has solved.
    """

    z: Vector
    w: Vector
    n: int
    certificate: CertificateOnRanks
    work: float
    absolute_tolerance: float = 0.0
    infeasibility: Any = None

    @property
    def x(self) -> Vector:
        """The local part of the best iterate, z."""
        return self.z

    @property
    def residual(self) -> float:
        """The relative residual."""
        return self.certificate.relative_residual

    def plot(self, **options: Any) -> Any:
        """Raise UnsuitableProblem, because a rank has only a part of the unknowns.

        Raises
        ------
        UnsuitableProblem
            Always; plot the vector that ``problem.gathered(result.z)`` returns on rank 0.
        """
        raise UnsuitableProblem("a result on ranks is local; plot problem.gathered(z) on rank 0")

    def describe_accuracy(self) -> str:
        """Return the relative residual next to the tolerance."""
        return f"relative residual {self.residual:.1e}, tolerance {self.tolerance:g}"

    def __str__(self) -> str:
        return f"{self.status.name} by {self._effort()}, {self.describe_accuracy()}"


@np.errstate(all="ignore")
def solve_on_ranks(
    problem: RowsOnRanks,
    algorithm: str = "auto",
    *,
    z0: Array = None,
    callback: Callable[[Sample, Vector], Any] | None = None,
    **options: Any,
) -> ResultOnRanks:
    """Return the solution; parameters as in :func:`lcp_plugin.solve`, equal on every rank.

    Parameters
    ----------
    **options
        tolerance, absolute_tolerance, max_iterations, max_seconds, verbose, threads (1 by default), and
        options of the algorithm.

    Raises
    ------
    UnknownAlgorithm, InvalidOption, UnsuitableMatrix
        On every rank.
    """
    ranks = problem.halo
    is_positive = ranks.everywhere(problem.diagonal > 0.0)
    of_run = {name: options.pop(name) for name in OF_RUN & options.keys()}
    plan = partial(chain, algorithm, options, problem.methods, is_positive=is_positive)
    settings, methods, callback = ranks.together(
        lambda: (Settings(**{"threads": 1, **of_run}), plan(), checked_callback(callback))
    )
    asked = algorithm, options, settings
    ranks.require_same("what is asked of solve", asked, "ask for the same", InvalidOption)
    # Unknowns that rank 0 solves after multigrid
    is_gathered = algorithm == "auto" and problem.n <= 100_000
    if is_gathered:
        methods = methods[:-1]  # one process is faster than sweeps over the ranks
    start = problem.own_part(problem.nearest_to_zero if z0 is None else z0, "z0")
    z = np.clip(start, problem.lower, problem.upper)
    with threads_for(settings.threads), deferred_interruptions() as is_interrupted:
        run = RunOnRanks(problem, ProgressOnRanks(problem, settings, callback, is_interrupted))
        stages = run.plan(methods, z, is_gathered=is_gathered)
        result: ResultOnRanks = run.result(run.follow_all(stages))
    return result


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
        halo, shows = problem.halo, settings.verbose and not problem.halo.rank
        super().__init__(problem, replace(settings, max_seconds=None, verbose=shows), callback)
        self.halo, self.timer = halo, Clock(settings.max_seconds)
        self.is_interrupted = is_interrupted
        self.is_watched = halo.anywhere(callback is not None) or settings.verbose

    def count(self, stage: Stage, step: Step) -> None:
        """Count a step, and decide with the other ranks whether a limit is reached."""
        super().count(stage, step)
        is_late = not self.timer.left
        late, interrupted = self.halo.all_largest(float(is_late), float(self.is_interrupted()))
        if interrupted:
            self.end = Status.INTERRUPTED
        elif late:
            self.end = Status.MAX_SECONDS
        else:
            self.limit()

    def report(self, *values: Any, **options: Any) -> bool:
        """Print a line on rank 0, and call back; return whether a callback of any rank returned True."""
        report = super().report
        return self.halo.anywhere(self.halo.together(lambda: report(*values, **options)))


class RunOnRanks(Run):
    """Run of an LCP whose rows are spread over ranks: it measures at geometric intervals."""

    progress: ProgressOnRanks

    def __init__(self, problem: RowsOnRanks, progress: ProgressOnRanks) -> None:
        super().__init__(progress)
        self.problem, self.data, self.next_check = problem, RowDataOnRanks(problem), 0

    def plan(self, methods: Any, z: Vector, *, is_gathered: bool) -> Iterator[Stage]:
        """Yield the methods one after the other, each from the best point; then the solve in one process."""
        for name, iterates in methods:
            points = iterates(self.problem, (z if self.best is None else self.best.z).copy())
            steps = (
                Step(point, work=work, iterations=int(k > 0 or work > 0.0))
                for k, (point, work) in enumerate(points)
            )
            yield Stage(Named(name), steps=steps)
        if is_gathered:
            start = z if self.best is None else self.best.z
            yield Stage(Named("one process"), steps=self._gathered(start))

    def _gathered(self, start: Vector) -> Iterator[Step]:
        """Yield the point, or the proof, that rank 0 finds for the whole problem."""
        problem, settings, halo = self.problem, self.settings, self.problem.halo
        parts, z0 = problem.gathered_problem(), problem.gathered(start)
        names = "tolerance", "absolute_tolerance", "threads"
        options = {name: getattr(settings, name) for name in names}
        options["max_seconds"] = self.progress.timer.left

        def solve() -> tuple[Any, ...]:
            z = None if z0 is None or not np.isfinite(z0).all() else z0
            solver = resolve_name(f"lcp_plugin.{CLASSES['LCP'].solver}")
            result = solver(parts, z0=z, **options)
            return result.certificate.z, result.work, result.iterations, result.proof

        z, work, iterations, proof = halo.from_first(solve)
        self.next_check = 0
        yield Step(z[halo.first : halo.last], work=work, iterations=iterations, proof=proof)

    def measure(self, stage: Stage, step: Step) -> Measured | None:
        """Return the measure of a step; None if no measurement is due."""
        progress, settings = self.progress, self.settings
        is_due = progress.iteration >= self.next_check or progress.end is not None
        is_costly = stage.algorithm.name in self.problem.methods  # a step of linear solves
        if not (is_due or is_costly or progress.is_watched):
            return None
        is_sweep = stage.algorithm.name != "multigrid"
        # Five steps of a hundred are measured
        self.next_check = math.ceil(progress.iteration * 1.05) + is_sweep
        absolute = settings.absolute_tolerance
        return self.data.measure(step.z, settings.tolerance, absolute=absolute)

    def end_of(self, stage: Stage, step: Step, measured: Measured) -> Status | None:
        """Return STALLED at rounding level, and if a residual is not finite."""
        if measured is None or (math.isfinite(measured.residual) and not measured.is_limited):
            return None
        return Status.STALLED

    def end_of_stage(self, stage: Stage, end: Status) -> Status:
        """Return the reason why the stage ended: the next method may do better at rounding level."""
        return end

    def result(self, end: Status) -> ResultOnRanks:
        """Return the result, the same on all ranks except z and w."""
        best, progress, data = self.best, self.progress, self.data
        common = self.common_fields(self.status(end))
        rows, worst = best.by_row, data.worst
        relative = worst(divide_nonnegative(rows.high, rows.reference))
        sizes = worst(rows.high), relative, worst(rows.componentwise)
        excluded = np.nan if common["status"] in PROVEN else 0.0
        return ResultOnRanks(
            z=read_only(best.z + excluded),
            w=read_only(best.rows.w + excluded),
            n=self.problem.n,
            certificate=CertificateOnRanks(best.z, best.rows.w, *sizes),
            algorithm=" → ".join(stage.algorithm.name for stage in progress.stages),
            work=progress.work,
            absolute_tolerance=self.settings.absolute_tolerance,
            infeasibility=self.proof,
            **{**common, "seconds": progress.halo.largest(common["seconds"])},
        )


def measured_on_ranks(
    problem: RowsOnRanks, x: Vector, tolerance: float
) -> tuple[bool, float, float, float, str]:
    """Return whether x passes the criterion, its largest violation, residual, tolerance and a reason.

    The reason of a failure is the bound that an entry of x violates on the lowest rank, or "".
    """
    halo, z = problem.halo, problem.own_part(x, "x")
    halo.require_same("tolerance", tolerance, "give the same on every rank", InvalidOption)
    measure, reason = RowDataOnRanks(problem).measure_at(z, None, tolerance), ""
    outside = np.flatnonzero((z < problem.lower) | (z > problem.upper))
    for i in outside[: not measure.passes].tolist():
        bound = problem.lower[i] if z[i] < problem.lower[i] else problem.upper[i]
        reason = outside_row(f"z[{halo.first + i}]", float(z[i]), float(bound)).text
    reason = next(filter(None, halo.comm.allgather(reason)), "")
    sizes = halo.largest(measure.rows.violation), halo.largest(measure.by_row.relative)
    return bool(measure.passes), *sizes, tolerance, reason
