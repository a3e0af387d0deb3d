"""bounded_least_squares(): the run from the start to the answer, judged on the caller's own data."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cache, cached_property
from itertools import islice
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..algorithms.least_squares.active_set import active_set_steps
from ..algorithms.least_squares.faces import DenseFaces, Faces, SparseFaces
from ..algorithms.least_squares.interior_steps import interior_steps
from ..algorithms.least_squares.normal_equations import compiled_face, interior_points_of_gram
from ..algorithms.least_squares.point import Point
from ..algorithms.least_squares.projected_steps import projected_steps
from ..algorithms.rehearsal import rehearse
from ..algorithms.short_road import ShortRoad
from ..certificates.least_squares import Enclosures, Optimality, duality_gap
from ..checks import FloatVector, read_only, restored
from ..crossovers import COMPILED_UP_TO
from ..deadline import time_limit
from ..errors import NotConverged
from ..matrix.factors import LARGEST_DENSE
from ..peers.alone import Peers
from ..policy.pacing import Progress
from ..problem.lcp import LCP
from ..problem.least_squares import LeastSquares, UnitLeastSquares
from ..settings import Settings, Status
from .state import Clock

DENSE_PATIENCE = 0.2  # steps that an orthogonal factor of A costs, ÷ its smaller dimension: .15 – .3 measured
SPARSE_PATIENCE = 300  # steps: an interior point takes ten sparse factors and more, of 20 – 40 steps each
MOST_STEPS_FOR_GAP = 300
ROUNDS = 20  # of active sets for a small problem before an interior point is asked, or to refine an answer
NARROWER = 0.25  # what is aimed at, ÷ what was reached where rounding left that above the tolerance


@dataclass(frozen=True, eq=False)
class LeastSquaresResult:
    """The answer of a least squares run; names as in scipy, but for `status`.

    Attributes
    ----------
    x : ndarray, shape (n,)
        Within the bounds, exactly at a bound where `active_mask` says so.
    cost : float
        ½ Σ weights (A x − b)² + ½ ridge ‖x‖².
    fun : ndarray, shape (m,)
        The residual A x − b, without weights.
    optimality : float
        The larger of ‖mid(x − upper, x − lower, g)‖∞/‖Aᵀ W b‖∞, g = AᵀW(A x − b) + ridge x, W = diag(weights), and the
        same in units in which the columns of A have about unit length. With lower = 0 and upper = ∞ the numerator is
        ‖min(x, g)‖∞. Where AᵀW b = 0, g at the point of the box nearest to 0 stands for it; where that is 0 as well,
        that point is the answer.
    active_mask : ndarray of int, shape (n,)
        −1 at the lower bound, 1 at the upper one, 0 between them.
    status : Status
        SOLVED exactly where optimality ≤ tolerance.
    nit : int
        Steps, of about a product with A and one with Aᵀ each, or a face solved by a factor.
    seconds : float
        Wall-clock seconds of the run.
    tolerance : float
        As given.
    is_proved : bool
        Whether `optimality` and `gap` are upper bounds, rounding included. For a LinearOperator, whose entries nobody
        knows, they are estimates.
    problem : LeastSquares
        The data.
    """

    x: FloatVector
    cost: float
    fun: FloatVector = field(repr=False)
    optimality: float
    active_mask: NDArray[np.int_] = field(repr=False)
    status: Status
    nit: int
    seconds: float
    tolerance: float
    is_proved: bool
    problem: LeastSquares = field(repr=False)

    __setstate__ = restored

    @cached_property
    def gap(self) -> float:
        """An upper bound of cost − min cost, at most cost but for rounding; the first look computes it, as a run does.

        It is no more than cost where A is not proved to have full rank and some column without a bound on one side
        (or with none) allows no multiplier of the right sign; help("lcp_plugin.certificates.least_squares").
        """
        unit = UnitLeastSquares(self.problem)
        with np.errstate(all="ignore"):
            start = Point(unit, np.clip(unit.from_caller(self.x), unit.lower, unit.upper))
            steps = islice(projected_steps(start), min(2 * self.nit + 1, MOST_STEPS_FOR_GAP))
            nearer = min(steps, key=lambda point: float(np.abs(point.natural_residual).max(initial=0.0)))
            return duality_gap(self.problem, self.x, unit.to_caller(nearer.x))

    @property
    def is_solved(self) -> bool:
        """True where the status is SOLVED."""
        return self.status is Status.SOLVED

    @property
    def advice(self) -> str:
        """What the status means, in a sentence."""
        return ADVICE.get(self.status, self.status.value).replace("z0=result.z", "x0=result.x")

    def require_solved(self) -> LeastSquaresResult:
        """Return this result, or raise where it is not solved.

        Raises
        ------
        NotConverged
            With the status, the optimality reached and the advice.
        """
        if not self.is_solved:
            raise NotConverged(
                f"{self.status.name} after {self.nit} steps: optimality {self.optimality:.1e} "
                f"(tolerance {self.tolerance:.1e}); {self.advice}"
            )
        return self


ADVICE = {
    Status.PRECISION_LIMIT: (
        "the gradient is above the tolerance, but no larger than rounding in double precision explains; accept x, "
        "which result.gap bounds, or rescale the data"
    ),
    Status.STALLED: (
        "the gradient no longer falls: A is too ill-conditioned for steps, and its factor would fill in too much or "
        "cannot be had; a ridge > 0 helps"
    ),
    Status.MAX_ITERATIONS: "the iteration limit came first: raise max_iterations, or go on from x0=result.x",
    Status.MAX_SECONDS: "the time limit came first: raise max_seconds, or go on from x0=result.x",
    Status.INTERRUPTED: "stopped by Ctrl-C; x is the best point so far",
}


def bounded_least_squares(
    A: Any,
    b: ArrayLike,
    lower: ArrayLike = 0.0,
    upper: ArrayLike = np.inf,
    *,
    x0: ArrayLike | None = None,
    weights: ArrayLike | None = None,
    ridge: float = 0.0,
    tolerance: float = 1e-8,
    max_iterations: int | None = None,
    max_seconds: float | None = None,
) -> LeastSquaresResult:
    """Return the x that minimises ½ Σ weights (A x − b)² + ½ ridge ‖x‖² over lower ≤ x ≤ upper.

    With the default bounds it is nonnegative least squares (NNLS).

    Parameters
    ----------
    A : array, sparse array or scipy LinearOperator, shape (m, n)
        Real, finite, of any shape and rank; not copied where it holds doubles, unless it has fewer than 10⁶ places.
        AᵀA is formed for at most 256 columns, or where A is sparse and AᵀA has at most three times as many entries. A
        LinearOperator needs rmatvec.
    b : array, shape (m,)
    lower, upper : scalar or array, shape (n,)
        Bounds of x; −∞ and ∞ are allowed, lower ≤ upper.
    x0 : array, shape (n,), optional
        Where to begin, projected onto the bounds; by default the point of [lower, upper] nearest to 0.
    weights : array, shape (m,), optional
        ≥ 0, one a row: 0 leaves it out.
    ridge : float
        ≥ 0.
    tolerance : float
        SOLVED means that `optimality` is at most this.
    max_iterations : int, default 100 000
    max_seconds : float, optional
        Wall-clock limit in seconds, obeyed at the end of the step under way.

    Returns
    -------
    LeastSquaresResult
        Always, whatever the status, with the best point, also after Ctrl-C.

    Raises
    ------
    InvalidProblem, InvalidOption
        Where the data do not state such a problem.

    Notes
    -----
    Small problems: the compiled methods for LCPs guess the face, least squares on it are the answer. Others: projected
    gradient and conjugate gradient steps, about a product with A and one with Aᵀ each, until they have cost about as
    much as a factor would. Then interior points and active sets with an orthogonal factor (dense A of up to 3000
    columns), or with one of AᵀA (sparse A). Where neither can be had, and for a LinearOperator, the steps go on; an
    ill-conditioned problem may end STALLED there.

    Examples
    --------
    >>> result = bounded_least_squares([[1, 0], [1, 1], [0, 1]], [2, 1, -1])
    >>> result.x, result.cost, result.active_mask, result.status.name
    (array([1.5, 0. ]), 0.75, array([ 0, -1]), 'SOLVED')
    """
    problem = LeastSquares(A, b, lower, upper, weights, ridge)
    settings = Settings(tolerance=tolerance, max_iterations=max_iterations, max_seconds=max_seconds)
    run = _Run(problem, settings, problem.checked_start(x0))
    with np.errstate(all="ignore"), time_limit(settings.max_seconds):
        try:
            reason = run.drive()
        except KeyboardInterrupt:
            reason = Status.INTERRUPTED
        return run.result(reason)


class _Run:
    """One run: stages yield points, and the first reason to end ends it."""

    def __init__(self, problem: LeastSquares, settings: Settings, start: FloatVector) -> None:
        self._is_small = problem.is_cheap_to_copy and problem.shape[1] <= COMPILED_UP_TO
        if self._is_small:
            _compile()  # before the clock runs
        self.problem, self.settings, self.clock = problem, settings, Clock(Peers())
        self.enclosures, self.start = Enclosures(problem), start
        self.best: Point | None = None  # by what its own products say, `judged` by the caller's data
        self.best_size, self.aim, self.iteration = np.inf, settings.tolerance, 0
        self.judged: Optimality | None = None
        self.faces: Faces | None = None
        self.progress = Progress(problem.shape[1], settings.max_iterations)

    @cached_property
    def unit(self) -> UnitLeastSquares:
        """The problem in the units of the methods."""
        return UnitLeastSquares(self.problem)

    @cached_property
    def dense(self) -> DenseFaces | None:
        """Faces by orthogonal factors; None where time ended before."""
        return DenseFaces.of(self.unit)

    @cached_property
    def sharp(self) -> Enclosures | None:
        """Compensated sums, for what rounding leaves undecided where copies of A cost little."""
        return Enclosures(self.problem, is_sharp=True) if self.problem.is_cheap_to_copy else None

    def drive(self) -> Status:
        """Go through the stages; return why the run ended."""
        if max(self.enclosures.reference) == 0.0:
            self.start = self.problem.nearest_to_zero
            if self._is_solved_by(self.start):
                return Status.SOLVED
        if self._is_small and self._sprint():
            return Status.SOLVED
        for stage in self._stages():
            self.progress.restart(self.iteration, self.best_size)
            for k, point in enumerate(stage):
                self.iteration += k > 0
                if (reason := self._reason_to_end(point)) is not None:
                    if reason is Status.SOLVED:
                        self._refine(point)
                    return reason
            if self._is_at_floor():
                return Status.PRECISION_LIMIT
        return Status.STALLED

    def _stages(self) -> Iterator[Iterator[Point]]:
        """Yield what is tried in turn, each from the best point so far."""
        problem = self.problem
        if problem.has_entries:
            if not self._is_small:
                patience = SPARSE_PATIENCE if problem.is_sparse else math.ceil(DENSE_PATIENCE * min(problem.shape))
                yield islice(projected_steps(self._incumbent()), patience)
            if problem.is_dense or problem.is_cheap_to_copy:
                if problem.shape[1] <= LARGEST_DENSE and (dense := self.dense) is not None:
                    self.faces = dense
                    yield _in_turn(interior_steps(self._incumbent(), dense), dense)
            elif (sparse := SparseFaces.of(self.unit)) is not None:
                self.faces = sparse
                yield _in_turn(interior_points_of_gram(self._incumbent(), sparse), sparse)
        yield projected_steps(self._incumbent())

    def _sprint(self) -> bool:
        """Take active sets to their end, from the face the compiled methods find; return whether that solves it."""
        self.faces, most = self.dense, min(ROUNDS, self.settings.max_iterations)
        if self.faces is None or most == 0:
            return False
        start = self._incumbent()
        start, free = compiled_face(start, self.faces) or (start, None)
        points = list(islice(active_set_steps(start, self.faces, free), most + 1))
        self.best, self.iteration = points[-1], len(points) - 1
        if self._is_solved_by(self.unit.to_caller(self.best.x)):
            return True
        self.best_size = self._measured(self.best)
        return False

    def _refine(self, point: Point) -> None:
        """Go on to the end of the active sets where there is a factor: a small gradient may leave much of the cost."""
        if self.faces is None:
            return
        *_, refined = islice(active_set_steps(point, self.faces), ROUNDS)
        judged = self._judgement(self.unit.to_caller(refined.x))
        if judged.value <= self.settings.tolerance:
            self.judged = judged

    def _incumbent(self) -> Point:
        """Return the best point so far, its residual computed afresh."""
        x = self.unit.from_caller(self.start) if self.best is None else self.best.x
        return Point(self.unit, np.clip(x, self.unit.lower, self.unit.upper))

    def _reason_to_end(self, point: Point) -> Status | None:
        """Take note of a point; return the reason to end, if there is one."""
        size = self._measured(point)
        if size < self.best_size:
            self.best_size, self.best = size, point
        if size <= self.aim:
            if self._is_solved_by(self.unit.to_caller(point.x)):
                return Status.SOLVED
            self.aim = NARROWER * size
        self.clock.read()
        if self.iteration >= self.settings.max_iterations:
            return Status.MAX_ITERATIONS
        if self.clock.elapsed >= self.settings.max_seconds:
            return Status.MAX_SECONDS
        if self.progress.is_flat(self.iteration, self.best_size) and self._is_at_floor():
            return Status.PRECISION_LIMIT
        is_stalled = self.progress.is_stalled(self.iteration, self.best_size, self.settings.tolerance)
        return Status.STALLED if is_stalled else None

    def _measured(self, point: Point) -> float:
        """Return the optimality of a point as its own residual says, rounding left aside."""
        unit, columns = self.unit, self.unit.columns
        scaled = point.natural_residual
        below, above = (point.x - unit.upper) / columns, (point.x - unit.lower) / columns
        plain = np.clip(point.gradient * columns, below, above)
        sizes = (float(np.abs(residual).max(initial=0.0)) * unit.size for residual in (plain, scaled))
        return max(size / least if least > 0.0 else np.inf
                   for size, least in zip(sizes, self.enclosures.reference, strict=True))

    def _is_solved_by(self, x: FloatVector) -> bool:
        """Judge x on the caller's data, keep the better judgement; return whether x is what was asked for."""
        judged = self._judgement(x)
        if self.judged is None or judged.value < self.judged.value:
            self.judged = judged
        return bool(judged.value <= self.settings.tolerance)

    def _judgement(self, x: FloatVector) -> Optimality:
        """Return how optimal x is on the caller's data, looked at sharply where rounding decides."""
        judged = Optimality.of(self.enclosures, x)
        if judged.value > self.settings.tolerance and judged.is_at_rounding_level and self.sharp is not None:
            sharply = Optimality.of(self.sharp, x)
            judged = sharply if sharply.value < judged.value else judged
        return judged

    def _is_at_floor(self) -> bool:
        """Return whether the best point is as good as rounding allows."""
        if self.best is None:
            return False
        return Optimality.of(self.enclosures, self.unit.to_caller(self.best.x)).is_at_rounding_level

    def result(self, reason: Status) -> LeastSquaresResult:
        """Return the result: the judgement names the status."""
        problem, tolerance = self.problem, self.settings.tolerance
        if self.judged is None or self.judged.value > tolerance:
            self._is_solved_by(self.start if self.best is None else self.unit.to_caller(self.best.x))
        judged = cast(Optimality, self.judged)
        if judged.value <= tolerance:
            reason = Status.SOLVED
        elif judged.is_at_rounding_level:
            reason = Status.PRECISION_LIMIT
        x = judged.x
        mask = np.where(x <= problem.lower, -1, np.where(x >= problem.upper, 1, 0))
        return LeastSquaresResult(
            x=read_only(x), cost=problem.cost(x, judged.residual), fun=read_only(judged.residual),
            optimality=judged.value, active_mask=read_only(mask), status=reason, nit=self.iteration,
            seconds=self.clock.read(), tolerance=tolerance, is_proved=problem.has_entries, problem=problem,
        )


@cache
def _compile() -> None:
    """Compile what small problems call."""
    rehearse(ShortRoad(), LCP([[1.0]], [-1.0]))


def _in_turn(steps: Iterator[Point], faces: Faces) -> Iterator[Point]:
    """Yield these points, then active sets from where they end."""
    point: Point | None = None
    for point in steps:
        yield point
    if point is not None:
        yield from active_set_steps(point, faces)
