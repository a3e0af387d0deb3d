"""bounded_least_squares(): the run from the start to the answer, judged on the caller's own data."""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import cached_property
from itertools import islice
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike

from ..algorithms.least_squares.face_steps import active_set_steps, block_pivot_steps, interior_steps
from ..algorithms.least_squares.faces import Faces, Point
from ..algorithms.least_squares.projected_steps import projected_steps
from ..certificates.least_squares import Enclosures, Optimality, duality_gap
from ..checks import FloatVector, read_only
from ..deadline import Clock, OutOfTimeError, time_limit
from ..peers.alone import Peers
from ..policy.pacing import Progress
from ..problem.least_squares import LeastSquares
from ..settings import Settings, Status
from .least_squares_result import LeastSquaresResult, point_nearer, result_of

DENSE_PATIENCE = 0.05  # steps that AᵀA and its factors cost, ÷ the smaller dimension of A
SPARSE_PATIENCE = 300  # steps: an interior point takes ten sparse factors and more, of 20 – 40 steps each
SMALL = 20_000  # places of A up to which one compiled call is quicker than libraries called step by step
EXCHANGES = 10  # of a column of a small A at its bound for a free one, ÷ their number
ALONE = Peers()
ROUNDS = 20  # of active sets for a small problem before an interior point is asked, or to refine an answer
NARROWER = 0.25  # what is aimed at, ÷ what was reached where rounding left that above the tolerance


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
        AᵀA is formed for at most 3000 columns, or where A is sparse and AᵀA has at most three times as many entries. A
        LinearOperator needs rmatvec.
    b : array, shape (m,)
    lower, upper : scalar or array, shape (n,)
        Bounds of x; −∞ and ∞ are allowed, lower ≤ upper.
    x0 : array, shape (n,), or a number for n = 1, optional
        Where to begin, projected onto the bounds; by default the point of [lower, upper] nearest to 0.
    weights : array, shape (m,), optional
        ≥ 0, one a row: 0 leaves it out.
    ridge : float
        ≥ 0.
    tolerance : float
        SOLVED means that `optimality` is at most this, and see :class:`LeastSquaresResult` for a LinearOperator.
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
    Small dense problems: an active set that changes by one column at a time, compiled. Others: block pivots with a
    Cholesky factor of the free columns' part of AᵀA, corrected by conjugate gradients with A, or by an orthogonal
    factor where rounding leaves AᵀA too little; where they do not arrive, interior points and active sets with the same
    factor. That is for dense A of up to 3000 columns, and for sparse A where AᵀA is about as sparse. Large A come to it
    after projected gradient and conjugate gradient steps, about a product with A and one with Aᵀ each, that have cost
    about as much. Where no factor can be had, and for a LinearOperator, the steps go on; an ill-conditioned problem may
    end STALLED there.

    Examples
    --------
    >>> result = bounded_least_squares([[1, 0], [1, 1], [0, 1]], [2, 1, -1])
    >>> result.x, result.cost, result.active_mask, result.status.name
    (array([1.5, 0. ]), 0.75, array([ 0, -1]), 'SOLVED')
    """
    problem = LeastSquares(A, b, lower, upper, weights, ridge)
    settings = Settings(tolerance=tolerance, max_iterations=max_iterations, max_seconds=max_seconds)
    start = None if x0 is None else problem.checked_start(x0)
    if (result := _solved_at_once(problem, settings)) is not None:
        return result
    run = _Run(problem, settings, problem.nearest_to_zero if start is None else start)
    with np.errstate(all="ignore"):
        try:
            with time_limit(settings.max_seconds, is_enforced=True):
                reason = run.drive()
        except OutOfTimeError:
            reason = Status.MAX_SECONDS
        except KeyboardInterrupt:
            reason = Status.INTERRUPTED
        return run.result(reason)


def _solved_at_once(problem: LeastSquares, settings: Settings) -> LeastSquaresResult | None:
    """Take the compiled way of small problems to its end; return the answer where that solves it."""
    if not (problem.has_entries and 0 < problem.shape[0] * problem.shape[1] <= SMALL):
        return None
    from ..kernels.least_squares import solve_small

    clock, most = Clock(ALONE), min(settings.max_iterations, EXCHANGES * problem.shape[1])
    weights = np.ones(problem.shape[0]) if problem.weights is None else problem.weights
    A = problem.A if problem.is_dense else read_only(problem.A.toarray())
    x, residual, optimality, faces = solve_small(
        A, problem.b, weights, problem.ridge, problem.lower, problem.upper, most
    )
    if not optimality <= settings.tolerance:
        return None
    return result_of(problem, settings, x, residual, optimality, Status.SOLVED, faces, clock.read())


class _Run:
    """One run: stages yield points, and the first reason to end ends it."""

    def __init__(self, problem: LeastSquares, settings: Settings, start: FloatVector) -> None:
        self.problem, self.settings, self.clock = problem, settings, Clock(ALONE)
        self.enclosures, self.start = Enclosures(problem), start
        self.best: Point | None = None  # by what its own products say, `judged` by the caller's data
        self.best_size, self.aim, self.iteration = np.inf, settings.tolerance, 0
        self.judged: Optimality | None = None
        self.is_solved = False
        self.faces: Faces | None = None
        self.progress = Progress(problem.shape[1], settings.max_iterations)

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
            if not problem.is_cheap_to_copy:
                patience = SPARSE_PATIENCE if problem.is_sparse else math.ceil(DENSE_PATIENCE * min(problem.shape))
                yield islice(projected_steps(self._incumbent()), patience)
            if (faces := Faces.of(problem.unit)) is not None:
                self.faces = faces
                yield block_pivot_steps(self._incumbent(), faces)
                yield _in_turn(interior_steps(self._incumbent(), faces), faces)
        yield projected_steps(self._incumbent())

    def _refine(self, point: Point) -> None:
        """Go on to the end of the active sets where there is a factor: a small gradient may leave much of the cost."""
        if self.faces is None or (self.judged is not None and self.judged.is_at_rounding_level):
            return
        *_, refined = islice(active_set_steps(point, self.faces), ROUNDS)
        judged = self._judgement(self.problem.unit.to_caller(refined.x))
        if judged.value <= self.settings.tolerance:
            self.judged = judged

    def _incumbent(self) -> Point:
        """Return the best point so far, its residual computed afresh."""
        x = self.problem.unit.from_caller(self.start) if self.best is None else self.best.x
        return Point(self.problem.unit, np.clip(x, self.problem.unit.lower, self.problem.unit.upper))

    def _reason_to_end(self, point: Point) -> Status | None:
        """Take note of a point; return the reason to end, if there is one."""
        size = self._measured(point)
        if size < self.best_size:
            self.best_size, self.best = size, point
        if size <= self.aim:
            if self._is_solved_by(self.problem.unit.to_caller(point.x)):
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
        unit, columns = self.problem.unit, self.problem.unit.columns
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
        is_small = judged.value <= self.settings.tolerance
        self.is_solved = is_small and (self.problem.has_entries or self._has_small_gap(judged))
        return self.is_solved

    def _has_small_gap(self, judged: Optimality) -> bool:
        """Return whether the gap of an operator's x, of which the gradient alone says little, is small as well."""
        problem, nearest = self.problem, self.problem.nearest_to_zero
        most = math.sqrt(self.settings.tolerance) * problem.cost(nearest, problem.product(nearest) - problem.b)
        if duality_gap(problem, judged.x) <= most:
            return True
        nearer = point_nearer(problem, judged.x, self.iteration)
        if duality_gap(problem, judged.x, nearer) <= most:
            return True
        is_unbounded = (problem.lower == -np.inf) & (problem.upper == np.inf)
        fall = problem.cost(judged.x, judged.residual) - problem.cost(nearer, problem.product(nearer) - problem.b)
        return bool(is_unbounded.any() and problem.ridge == 0.0 and fall <= most)

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
        return Optimality.of(self.enclosures, self.problem.unit.to_caller(self.best.x)).is_at_rounding_level

    def result(self, reason: Status) -> LeastSquaresResult:
        """Return the result: the judgement names the status."""
        if not self.is_solved:
            self._is_solved_by(self.start if self.best is None else self.problem.unit.to_caller(self.best.x))
        judged = cast(Optimality, self.judged)
        if self.is_solved:
            reason = Status.SOLVED
        elif judged.is_at_rounding_level:
            reason = Status.PRECISION_LIMIT
        seconds = self.clock.read()
        return result_of(
            self.problem, self.settings, judged.x, judged.residual, judged.value, reason, self.iteration, seconds
        )


def _in_turn(steps: Iterator[Point], faces: Faces) -> Iterator[Point]:
    """Yield these points, then active sets from where they end."""
    point: Point | None = None
    for point in steps:
        yield point
    if point is not None:
        yield from active_set_steps(point, faces)
