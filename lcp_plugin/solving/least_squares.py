"""bounded_least_squares(): the stages of a run, and its judge on the caller's own data."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import islice
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike

from ..algorithms.base import Algorithm, Step
from ..algorithms.least_squares.face_steps import active_set_steps, block_pivot_steps, interior_steps
from ..algorithms.least_squares.faces import Faces, Point
from ..algorithms.least_squares.projected_steps import projected_steps
from ..certificates.least_squares import Enclosures, Optimality, duality_gap
from ..certificates.references import CommonUnits
from ..checks import FloatVector, read_only
from ..deadline import Clock
from ..policy.stages import Choice, Stage
from ..problem.least_squares import ALONE, LeastSquares
from ..settings import Settings, Status
from .judge import Judge
from .least_squares_result import LeastSquaresResult, point_nearer, result_of
from .run import Run

DENSE_PATIENCE = 0.05  # steps that AᵀA and its factors cost, ÷ the smaller dimension of A
SPARSE_PATIENCE = 300  # steps: an interior point takes ten sparse factors and more, of 20 – 40 steps each
SMALL = 20_000  # places of A up to which one compiled call is quicker than libraries called step by step
EXCHANGES = 10  # of a column of a small A at its bound for a free one, ÷ their number
ROUNDS = 20  # of active sets to refine an answer
NARROWER = 0.25  # what is aimed at, ÷ what was reached where that was not enough


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
    problem, clock = LeastSquares(A, b, lower, upper, weights, ridge), Clock(ALONE)
    settings = Settings(tolerance=tolerance, max_iterations=max_iterations, max_seconds=max_seconds)
    start = None if x0 is None else problem.checked_start(x0)
    if (result := _solved_at_once(problem, settings, clock)) is not None:
        return result
    with np.errstate(all="ignore"):
        stages, judge, unit = Stages(problem), LeastSquaresJudge(problem, settings), problem.unit
        run = Run(judge.units, stages, settings, None, clock, judge)
        start = unit.nearest_to_zero if start is None else np.clip(unit.from_caller(start), unit.lower, unit.upper)
        try:
            reason = run.drive(start, stages.first(unit))
        except KeyboardInterrupt:
            reason = Status.INTERRUPTED
        answer, status = run.ended(start, reason)
    judged, steps = cast(Any, answer), max(run.ledger.iteration, 0)
    return result_of(problem, settings, judged.x, judged.residual, judged.value, status, steps, clock.read())


def _solved_at_once(problem: LeastSquares, settings: Settings, clock: Clock) -> LeastSquaresResult | None:
    """Take the compiled way of small problems to its end; return the answer where that solves it."""
    if not (problem.has_entries and 0 < problem.shape[0] * problem.shape[1] <= SMALL):
        return None
    from ..kernels.least_squares import solve_small

    most = min(settings.max_iterations, EXCHANGES * problem.shape[1])
    weights = np.ones(problem.shape[0]) if problem.weights is None else problem.weights
    A = problem.A if problem.is_dense else read_only(problem.A.toarray())
    x, residual, optimality, faces = solve_small(
        A, problem.b, weights, problem.ridge, problem.lower, problem.upper, most
    )
    if not optimality <= settings.tolerance:
        return None
    return result_of(problem, settings, x, residual, optimality, Status.SOLVED, faces, clock.read())


@dataclass(slots=True)
class PointStep(Step):
    """A step with what is known of its point."""

    point: Any = None


@dataclass(frozen=True, kw_only=True)
class Steps(Algorithm):
    """Steps from point to point, with the factors that they take or others took before, if any."""

    take: Callable[[Point], Iterator[Point]]
    faces: Faces | None = None
    name = "least squares"

    def iterates(self, problem: Any, z0: FloatVector) -> Iterator[Step]:
        """Yield the start, then a step a point."""
        return (PointStep(point.x, point=point) for point in self.take(Point(problem, z0)))

    def finish(self, problem: Any, z: FloatVector) -> FloatVector:
        """Go on to the end of the active sets where there is a factor: a small gradient may leave much of the cost."""
        if self.faces is None:
            return z
        *_, refined = islice(active_set_steps(Point(problem, z), self.faces), ROUNDS)
        return refined.x


class Stages:
    """What is tried in turn, each from the best point so far."""

    name = chosen = "least squares"

    def __init__(self, problem: LeastSquares) -> None:
        self._left = self._stages(problem)

    def first(self, problem: Any) -> Choice:
        """Return the first stage."""
        return next(self._left)

    def next_step(self, problem: Any, stages: Sequence[Stage], target: float, failed: bool) -> Choice | None:
        """Return the next stage where one has come to its end."""
        return next(self._left, None) if failed else None

    def another_start(self, problem: Any, stages: Sequence[Stage]) -> None:
        """Return None: all minima are alike."""

    @staticmethod
    def _stages(problem: LeastSquares) -> Iterator[Choice]:
        faces = None
        if problem.has_entries:
            if not problem.is_cheap_to_copy:
                patience = SPARSE_PATIENCE if problem.is_sparse else math.ceil(DENSE_PATIENCE * min(problem.shape))
                yield Choice(Steps(take=lambda start: islice(projected_steps(start), patience)))
            if (faces := Faces.of(problem.unit)) is not None:
                yield Choice(Steps(take=lambda start: block_pivot_steps(start, faces), faces=faces))
                yield Choice(Steps(take=lambda start: interior_steps(start, faces), faces=faces))
        yield Choice(Steps(take=projected_steps, faces=faces))


class LeastSquaresJudge(Judge):
    """Measures by the points' own products, and certifies by :mod:`lcp_plugin.certificates.least_squares`.

    Attributes
    ----------
    best : Optimality or None
        The best of those that were certified.
    is_solved : bool
        Whether it is what was asked for.
    """

    def __init__(self, problem: LeastSquares, settings: Settings) -> None:
        self.asked: Any = problem
        self.settings, self.units = settings, CommonUnits(cast(Any, problem), cast(Any, problem.unit))
        self.enclosures = Enclosures(problem)
        self.reference = max(self.enclosures.reference)
        self.errors = self.proof = None
        self.best: Optimality | None = None
        self.is_solved, self._size, self._aim, self._iteration = False, np.inf, settings.tolerance, 0

    @cached_property
    def sharp(self) -> Enclosures | None:
        """Compensated sums, for what rounding leaves undecided where copies of A cost little."""
        return Enclosures(self.asked, is_sharp=True) if self.asked.is_cheap_to_copy else None

    def residual_of(self, step: Any) -> float:
        """Return the optimality of a step as its own residual says, rounding left aside."""
        self._size = step.point.optimality(self.enclosures.reference)
        return self._size

    def measure(self, z: FloatVector) -> float:
        """Return the same of any z."""
        return Point(self.asked.unit, z).optimality(self.enclosures.reference)

    def certified(self, z: FloatVector) -> float:
        """Return an upper bound of it; where a step before had not enough, not before this one has clearly more."""
        if self._size > self._aim:
            return self._size
        self._aim = NARROWER * self._size
        return self._kept(z).value

    def passes(self, z: FloatVector, residual: float, iteration: int) -> bool:
        """Return whether z, certified just now, is what was asked for."""
        self._iteration = iteration
        return self.is_solved

    def is_at_floor(self, z: FloatVector | None) -> bool:
        """Return whether z is as good as rounding allows."""
        return z is not None and Optimality.of(self.enclosures, self.asked.unit.to_caller(z)).is_at_rounding_level

    def is_limited_by_size(self, z: FloatVector | None) -> bool:
        """Return False."""
        return False

    def final(self, z: FloatVector, reason: Status, last: Algorithm | None) -> Any:
        """Return what is certified of the answer: z, the best before, or that one refined."""
        unit, best = self.asked.unit, self.best
        if not self.is_solved:
            return self._kept(z) and self.best
        if best is None or last is None or reason is not Status.SOLVED or best.is_at_rounding_level:
            return best
        z = np.clip(unit.from_caller(best.x), unit.lower, unit.upper)
        refined = last.finish(unit, z)
        judged = best if refined is z else self._judged(unit.to_caller(refined))
        return judged if judged.value <= self.settings.tolerance else best

    def verdict(self, certificate: Any, reason: Status, *, is_chain: bool) -> Status:
        """Return the status: what is certified, or else why the run ended."""
        if self.is_solved:
            return Status.SOLVED
        if certificate.is_at_rounding_level:
            return Status.PRECISION_LIMIT
        return Status.STALLED if reason is Status.DIVERGED else reason

    def _kept(self, z: FloatVector) -> Optimality:
        """Return how optimal z is, the best so far kept; take note of whether it is what was asked for."""
        judged = self._judged(self.asked.unit.to_caller(z))
        if self.best is None or judged.value < self.best.value:
            self.best = judged
        is_small = judged.value <= self.settings.tolerance
        self.is_solved = is_small and (self.asked.has_entries or self._has_small_gap(judged))
        return judged

    def _judged(self, x: FloatVector) -> Optimality:
        """Return how optimal x is on the caller's data, looked at sharply where rounding decides."""
        judged = Optimality.of(self.enclosures, x)
        if judged.value > self.settings.tolerance and judged.is_at_rounding_level and self.sharp is not None:
            sharply = Optimality.of(self.sharp, x)
            judged = sharply if sharply.value < judged.value else judged
        return judged

    def _has_small_gap(self, judged: Optimality) -> bool:
        """Return whether the gap of an operator's x, of which the gradient alone says little, is small as well."""
        problem, nearest = self.asked, self.asked.nearest_to_zero
        most = math.sqrt(self.settings.tolerance) * problem.cost(nearest, problem.product(nearest) - problem.b)
        if duality_gap(problem, judged.x) <= most:
            return True
        nearer = point_nearer(problem, judged.x, self._iteration)
        if duality_gap(problem, judged.x, nearer) <= most:
            return True
        is_unbounded = (problem.lower == -np.inf) & (problem.upper == np.inf)
        fall = problem.cost(judged.x, judged.residual) - problem.cost(nearer, problem.product(nearer) - problem.b)
        return bool(is_unbounded.any() and problem.ridge == 0.0 and fall <= most)
