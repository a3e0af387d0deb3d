"""The run of a least-squares problem, and its result.

Many small problems with one A are solved as a stack, by the LCPs of their normal equations.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...core import deadline
from ...core.algorithm import Step
from ...core.checks import Array, BoolVector, Vector, checked_vector, derived_property, read_only
from ...core.entries import clip, max_norm
from ...core.kernels.floats import FREE, HIGH, LOW
from ...core.settings import DEFAULT, Settings, Status
from ...engines import has_piqp
from ...methods.small import SMALL_DENSE, active_set_points, solve_stack
from ...solving.result import BaseResult, Callback, StageRecord, end_at_once
from ...solving.run import CUT_SHORT, FAILED, Named, Progress, Run, Stage, say, with_samples
from . import engines
from .certificate import Optimality, exceeds, measure_stack, onto_bounds, worst_columns
from .data import BoundedLeastSquares, Enclosures, apply_to

NNLS = "nnls", "one bound per column"  # a stage and its reason
START = "start"  # instead of a method, if the start is optimal
# Columns or rows, whichever are fewer: a penalty leaves few columns free, which projected steps may reach
LASSO_COLUMNS = 400


@np.errstate(all="ignore")
def solve_least_squares(
    problem: BoundedLeastSquares,
    *,
    x0: ArrayLike | None = None,
    callback: Callback | None = None,
    **options: Any,
) -> LeastSquaresResult:
    """Minimize ½ Σ weights (A x − b)² + ½ ridge ‖x‖² + Σ l1 |x| over lower ≤ x ≤ upper.

    Parameters
    ----------
    problem : BoundedLeastSquares
    x0 : array, shape (n,), or a number for n = 1, optional
        Start, projected onto the bounds; by default the point of [lower, upper] nearest to 0. Only projected steps use
        it, but x0 is the result if it is optimal.
    tolerance : float
        SOLVED means that cost exceeds the minimum by at most tolerance · cost, apart from rounding of the data: see
        `optimality` of :class:`LeastSquaresResult`.
    max_iterations : int, default 100 000
    max_seconds : float, optional
        Wall-clock limit in seconds, obeyed at the end of the current step; a run of PIQP is one step.
    callback, **options
        Also record, threads, verbose: as for :func:`lcp_plugin.solve`; all loops run in BLAS or scipy, which `threads`
        does not change.

    Returns
    -------
    LeastSquaresResult
        The best point, for every status, also after Ctrl-C.

    Raises
    ------
    InvalidOption
        If x0 does not fit, or for an impossible limit.

    Notes
    -----
    At most 10⁶ entries: scipy's lstsq without bounds, or normal equations if there is a ridge; nnls with one bound per
    column, else PIQP on the dual (wide A) or on the normal equations. An orthogonal factorization of the free columns
    follows. A penalty on many columns begins with some projected steps. More entries: projected gradient and conjugate
    gradient steps, with one product with A and one with Aᵀ each. When the steps have cost about as much as PIQP, PIQP
    follows as above or, if A is sparse, on min ½‖r‖² with A x − r = b, polished. The steps continue if a factorization
    is predicted to take too long.

    Examples
    --------
    >>> result = solve_least_squares(BoundedLeastSquares([[1, 0], [1, 1], [0, 1]], [2, 1, -1]))
    >>> result.x, result.cost, result.active_mask, result.status.name
    (array([1.5, 0. ]), 0.75, array([ 0, -1]), 'SOLVED')
    """
    settings = Settings(**options) if options else DEFAULT
    clock = deadline.Clock(settings.max_seconds)
    start = None if x0 is None else problem.checked_start(x0)
    first = first_point(problem, start, settings.tolerance) if settings.has_steps else None
    if first is not None and first.passes:
        name, because = NNLS if first.x is not start else (START, "")
        steps = int(first.x is not start)
        run = {"iterations": steps, "seconds": clock.read(), "tolerance": settings.tolerance}
        run |= {"algorithm": name, "stages": (StageRecord(name, because, 1, 1.0),) * steps}
        make = partial(LeastSquaresResult.at, first, status=Status.SOLVED, **run)
        known = LeastSquaresResult.of_known(make, x=read_only(first.x), status=Status.SOLVED)
        begun = problem.nearest_to_zero if start is None else start, None
        result = with_samples(problem, known, settings, callback, begun, first.residual)
        if result is not None:
            return result
        callback = end_at_once
    progress = Progress(problem, settings, callback, clock)
    search = LeastSquaresRun(problem, progress, start, first)
    result = search.solve(search.plan())
    if settings.verbose:
        say(f"{result.status.name}: {result.advice}")
    return result


def first_point(
    problem: BoundedLeastSquares, start: Vector | None, tolerance: float
) -> Optimality | None:
    """Return the measured solution by nnls, or the start if it also passes; None if nnls does not suit the problem."""
    if not engines.is_for_nnls(problem):
        return None
    enclosures, points = Enclosures(problem), [engines.nnls_point(problem)]
    if start is not None:
        here, least = (problem.cost(x, problem.A @ x - problem.b) for x in (start, *points))
        if here <= (1.0 + 4.0 * tolerance) * least:  # a start that costs clearly more does not pass
            points.insert(0, start)
    for x in points:
        optimality = Optimality.of(enclosures, x, tolerance=tolerance)
        if optimality.passes:
            break
    return optimality


def planned(problem: BoundedLeastSquares) -> tuple[str, None, Iterator[Stage]]:
    """Return the stages of least squares for `analyze`."""
    return "", None, LeastSquaresRun(problem, Progress(problem, DEFAULT), None, None).plan()


class LeastSquaresRun(Run):
    """Run that certifies points of external solvers, and the projected steps that may be optimal.

    z of a step is the scaled x; it is not scaled at the start of the run, whose residual is ∞, and if the step is
    measured. The residual of a projected step is the measure of the step.
    """

    def __init__(
        self,
        problem: BoundedLeastSquares,
        progress: Progress,
        start: Array,
        first: Optimality | None,
    ) -> None:
        super().__init__(progress)
        self.problem, self.start, self.first = problem, start, first
        self.enclosures = Enclosures(problem)
        self.aim = self.settings.tolerance

    @derived_property
    def nearest(self) -> Vector:
        """The scaled point that is best so far; at first the start."""
        scaled = self.problem.scaled
        begin = scaled.nearest_to_zero if self.start is None else scaled.from_caller(self.start)
        return np.clip(begin, scaled.lower, scaled.upper)

    # --- the loop -----------------------------------------------------------------------------------------

    def steps_of(self, stage: Stage) -> Iterator[Step]:
        """Yield the start of the run without a measure, then the steps of the stage, while there is time."""
        if self.progress.iteration < 0:
            start = self.problem.nearest_to_zero if self.start is None else self.start
            yield Step(start, math.inf, work=0.0, iterations=0)
        for step in stage.steps:
            if deadline.is_over():
                raise deadline.OutOfTimeError
            yield step

    def measure(self, stage: Stage, step: Step) -> Optimality | None:
        """Return the certified point of a step; None for a projected step not much nearer than the last step."""
        if step.measured is not None:
            return step.measured
        if step.residual is None:
            self.nearest = step.z
        else:
            if not step.residual <= self.aim:
                return None
            # The next point is certified at a twentieth of the steepness
            self.aim = 0.05 * step.residual
        return self.certify(self.problem.scaled.to_caller(step.z))

    def certify(self, x: Vector, tolerance: float = 0.0) -> Optimality:
        """Return the certified point of an x within the bounds; dual points are tried until one meets the tolerance."""
        goal = self.settings.tolerance
        return Optimality.of(self.enclosures, x, tolerance=max(goal, tolerance), goal=goal)

    def keep(self, optimality: Optimality) -> None:
        """Keep a point that passes, or whose gap, then cost, is less than the best point has."""
        size, best = (optimality.residual, optimality.cost), self.best
        if optimality.passes or best is None or size < (best.residual, best.cost):
            self.best = optimality

    def end_of_stage(self, stage: Stage, end: Status) -> Status:
        """Return the reason; external solvers may improve a point at rounding level."""
        is_solved = end in FAILED and self.best is not None and self.best.passes
        return Status.SOLVED if is_solved else end

    def shown(self, step: Step) -> Vector:
        """Return the x of a step."""
        if step.measured is not None or step.residual == math.inf:
            return read_only(step.z)
        return read_only(self.problem.scaled.to_caller(step.z))

    def status(self, end: Status) -> Status:
        """Return the status; a limit precedes the rounding level, because further steps may improve the point."""
        if not self.best.passes and end in CUT_SHORT:
            return end
        return super().status(end)

    def result(self, end: Status) -> LeastSquaresResult:
        """Return the result of the run with its best point."""
        is_short = end in (Status.MAX_SECONDS, Status.INTERRUPTED)
        if self.best is None or (not self.best.passes and end in CUT_SHORT):
            x = self.problem.scaled.to_caller(self.nearest)
            self.keep(self.certify(x, math.inf if is_short else 0.0))
        common = self.common_fields(self.status(end))
        common["stages"] = tuple(stage for stage in common["stages"] if stage.iterations)
        name = ", ".join(dict.fromkeys(stage.name for stage in common["stages"])) or START
        return LeastSquaresResult.at(self.best, algorithm=name, **common)

    # --- the plan -----------------------------------------------------------------------------------------

    def plan(self) -> Iterator[Stage]:
        """Yield nnls for plain data; for a large A projected steps that cost about as much as PIQP; then engines."""
        problem = self.problem
        is_at_rest = not engines.FacePoint(problem.scaled, self.nearest).natural_residual.any()
        begin = Stage(Named(START), steps=[Step(self.nearest, work=0.0, iterations=0)])
        if self.start is not None:
            yield begin
        if engines.is_for_nnls(problem):
            yield Stage(Named(NNLS[0]), NNLS[1], steps=self._nnls_step())
        if self.start is None and is_at_rest:
            yield begin
        # PIQP takes as long as so many projected steps
        # The same on a large sparse A
        few = 300 if problem.is_sparse else math.ceil(0.05 * min(problem.shape))
        is_lasso = problem.is_dense and problem.l1.any() and min(problem.shape) >= LASSO_COLUMNS
        if is_lasso or not problem.is_small:
            yield self._projected(few)
        if engines.is_within_reach(problem.scaled):
            points = engines.engine_points(problem.scaled)
            steps = (Step(x, label=name, iterations=1) for name, x in points)
            yield Stage(Named("external solvers"), "A is factorized", steps=steps)
            if has_piqp():
                return
        yield self._projected(self.settings.max_iterations)

    def _nnls_step(self) -> Iterator[Step]:
        optimality = self.first or self.certify(engines.nnls_point(self.problem))
        yield Step(optimality.x, iterations=1, measured=optimality)

    def _size_at(self, point: engines.FacePoint) -> float:
        """Return the measure of a projected step, relative to the gradient of the data."""
        size = max(point.residual_in_orthant, point.pull_across) * point.problem.size
        reference = self.enclosures.reference  # 0 if the point nearest to 0 is a solution
        return size / reference if size > 0.0 and reference > 0.0 else size

    def residual_of(self, step: Step) -> float | None:
        """Return the measure of a step for a sample."""
        if step.residual == math.inf:  # of the start
            return self._size_at(engines.FacePoint(self.problem.scaled, self.nearest))
        return super().residual_of(step)

    def _projected(self, most: int) -> Stage:
        because = "products with A and Aᵀ"
        return Stage(Named("projected gradients"), because, steps=self._projected_steps(most))

    def _projected_steps(self, most: int) -> Iterator[Step]:
        """Yield projected steps while their measure falls, then the point closest to optimality."""
        since, before = 0, math.inf
        smallest = math.inf
        start = engines.FacePoint(self.problem.scaled, self.nearest)
        for k, point in enumerate(engines.projected_steps(start)):
            size = self._size_at(point)
            if not smallest <= size:
                self.nearest, smallest = point.x, size
            yield Step(point.x, size, work=2.0, iterations=min(k, 1))
            if k >= most:
                break
            # A run ends if its steepness falls by less than 1 % in so many steps
            if k - since >= max(200, since // 2):
                if smallest >= 0.99 * before:
                    break
                since, before = k, smallest
        yield Step(self.nearest, work=0.0, iterations=0)


ADVICE = {
    Status.SOLVED: "the cost exceeds the minimum by at most tolerance · cost, up to rounding errors in the data",
    Status.PRECISION_LIMIT: (
        "the gradient is at rounding level, but no lower bound of the cost was found near it, as for a large sparse A "
        "that fits b exactly; next: accept x if result.optimality is small enough, or raise l1 or ridge"
    ),
    Status.STALLED: (
        "the gradient no longer falls: A is too ill-conditioned, or its rows or bounds differ too much in size; next: "
        "add a ridge > 0, or rescale rows and columns"
    ),
    Status.MAX_ITERATIONS: "iteration limit reached; next: raise max_iterations, or continue from x0=result.x",
    Status.MAX_SECONDS: "time limit reached; next: raise max_seconds, or continue from x0=result.x",
    Status.INTERRUPTED: "stopped by Ctrl-C; next: continue from x, the best point so far",
}


@dataclass(frozen=True, eq=False, repr=False)
class LeastSquaresResult(BaseResult):
    """Result of a least-squares problem; attributes are named as in scipy, except `status`.

    Attributes
    ----------
    x : ndarray, shape (n,)
        Within the bounds, exactly at a bound if `active_mask` is nonzero.
    cost : float
        ½ Σ weights (A x − b)² + ½ ridge ‖x‖² + Σ l1 |x|.
    fun : ndarray, shape (m,)
        The residual A x − b, without weights.
    optimality : float
        Upper bound of (cost − minimum)/cost for entries of A and b that differ from the data at rounding level. It is 1
        if nothing is proved, or if a point of lower cost is known. The formula:
        help("lcp_plugin.problems.least_squares.certificate").
    active_mask : ndarray of int, shape (n,)
        −1 at the lower bound, 1 at the upper one, 0 between them.
    status : Status
        SOLVED exactly if optimality ≤ tolerance.
    nit : int
        Number of steps: of about a product with A and one with Aᵀ, or a point of lstsq, nnls or PIQP.
    algorithm : str
        The methods that ran, in order: "projected gradients", "normal equations", "lstsq", "nnls", "piqp"; "start" if
        the start is optimal.
    seconds : float
        Wall-clock seconds of the run.
    tolerance : float
        Tolerance of the run.
    problem : BoundedLeastSquares
        The data.
    history : tuple of Sample
        Samples of a run with ``record=True``.
    stages : tuple of StageRecord
        The methods that ran.
    """

    _advice = ADVICE

    x: Vector
    cost: float
    fun: Vector
    optimality: float
    active_mask: NDArray[np.int_]
    problem: BoundedLeastSquares

    @classmethod
    def at(cls, measured: Optimality, **run: Any) -> LeastSquaresResult:
        """Return the result at a measured point, with the fields of the run."""
        problem, x = measured.enclosures.problem, measured.x
        mask = (x >= problem.upper).astype(np.int_)
        mask[x <= problem.lower] = -1
        residual = read_only(measured.sharp_residual)
        return cls(
            x=read_only(x),
            cost=float(problem.cost(x, residual)),
            fun=residual,
            optimality=measured.residual,
            active_mask=read_only(mask),
            problem=problem,
            **run,
        )

    @property
    def objective(self) -> float:
        """The cost."""
        return self.cost

    @property
    def nit(self) -> int:
        """`iterations`."""
        return self.iterations

    def describe_accuracy(self) -> str:
        """Return the optimality and the tolerance, as text."""
        accuracy = f"optimality {self.optimality:.1e}, tolerance {self.tolerance:g}"
        return f"{accuracy}; cost {self.cost:.9g}"


@np.errstate(all="ignore")
def verdict_at(problem: BoundedLeastSquares, x: Array, tolerance: float) -> dict[str, Any]:
    """Return the fields of the verdict on x: proved if SOLVED, disproved if the point of a run costs less.

    An x_j beyond a bound counts as on it, up to the tolerance times the largest x_k, in units of columns of length 1.
    """
    x = checked_vector(getattr(x, "x", x), "x", problem.shape[1])
    near, beyond = onto_bounds(problem, x, tolerance)
    rows = partial(worst_columns, problem, x, tolerance)
    fields = {"claim": "optimal", "violation": max_norm(x - near), "rows": rows}
    at = Optimality.of(Enclosures(problem), near, tolerance=tolerance)
    if not (worst := rows(1)):
        reason = f"the cost exceeds the minimum by at most {at.residual:.2g} of it, up to rounding of the data"
        return fields | {"verdict": "proved", "reason": reason}
    found = solve_least_squares(problem, max_seconds=deadline.left())
    value, radius = at.misfit
    least = problem.cost(near, np.maximum(np.abs(value) - radius, 0.0))
    upper = float(at.enclosures.cost_above(found.x))
    is_worse, reason = exceeds(least, upper, tolerance), worst[0].text
    if is_worse and not beyond.size:
        reason = f"another point costs {upper:.9g}, and this one {at.cost:.9g}; {reason}"
    verdict = "disproved" if beyond.size or is_worse else "unproved"
    return fields | {"verdict": verdict, "reason": reason, "upper": upper}


def suits_stack(problem: BoundedLeastSquares) -> bool:
    """Return whether the normal equations of the problem are a small LCP; a penalty may not have a kink."""
    has_kink = (problem.l1 > 0.0) & (problem.lower < 0.0) & (problem.upper > 0.0)
    is_dense = problem.is_dense or problem.is_small
    return is_dense and 0 < problem.shape[1] <= SMALL_DENSE and not has_kink.any()


def length_of_stack(problem: BoundedLeastSquares) -> int:
    """Return the number of problems in a stack whose arrays stay in the cache."""
    m, n = problem.shape
    return int(max(1, 2**15 // max(m, n)))  # allocating larger arrays costs more than the sums


def solve_least_squares_stack(
    problem: BoundedLeastSquares, tolerance: float
) -> tuple[Vector, Vector, Any, BoolVector]:
    """Return points of a stack of problems, one step of refinement after the LCPs of their normal equations.

    The step solves the normal equations on the same active sets for the gradient AᵀW(A x − b) of the data. So the
    error of x grows with the condition of A, not with its square (Björck 1987, doi:10.1016/0024-3795(87)90101-7).

    Returns
    -------
    x : array, shape (B, n)
    value, iterations, is_solved : array, shape (B,)
        Relative gap; 0 if the point is the start, else 1; whether the certificate of these data proves the point.
    """
    columns, (A, gram) = problem.column_scales, problem.normal_equations
    lower, upper = problem.lower * columns, problem.upper * columns
    linear = np.where(problem.upper <= 0.0, -problem.l1, problem.l1) / columns
    b = problem.root_weights * problem.b
    q = linear - b @ A
    lower, upper = (np.broadcast_to(bound, q.shape) for bound in (lower, upper))
    z, _, iterations, _ = solve_stack(gram[None], q, lower, upper, tolerance=tolerance)
    side = np.where(z <= lower, LOW, np.where(z >= upper, HIGH, FREE))

    def newton_step(slope: Vector) -> Vector:
        gradient = slope / columns + linear
        to_bounds = lower - z, upper - z
        return active_set_points(gram[None], gradient, *to_bounds, side) / columns

    x = z / columns
    residual = apply_to(problem.A, x) - problem.b
    slope = apply_to(problem.A.T, problem.apply_weights(residual)) + problem.ridge * x
    x = clip(x + newton_step(slope), problem.lower, problem.upper)
    x = np.where(side == LOW, problem.lower, np.where(side == HIGH, problem.upper, x))
    value, is_solved = measure_stack(problem, x, tolerance, newton_step)
    return x, value, iterations, is_solved
