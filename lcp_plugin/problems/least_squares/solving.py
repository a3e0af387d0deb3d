"""The run of a least-squares problem, and its result."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property
from itertools import chain
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...core.checks import FloatVector, read_only, restore_state
from ...core.deadline import Clock, OutOfTimeError, is_over, time_limit
from ...core.settings import Settings, Status
from ...core.solving.base_result import NEXT, BaseResult
from .certificate import Optimality, duality_gap
from .data import BoundedLeastSquares
from .enclosures import Enclosures
from .engines import engine_points, is_for_nnls, is_within_reach, nnls_point
from .steps import FacePoint, projected_steps

NARROWER = 0.05  # the steepness at which a point is certified next ÷ the last such steepness
PATIENCE = (
    0.05  # projected steps before PIQP on a large dense A ÷ its smaller dimension: as long as PIQP
)
SPARSE_PATIENCE = 300  # the same on a large sparse A
WINDOW = 200  # steps, or half of all earlier steps: a run ends if its steepness falls by less than 1 % in a window


def solve_least_squares(
    problem: BoundedLeastSquares,
    *,
    x0: ArrayLike | None = None,
    tolerance: float = 1e-8,
    max_iterations: int | None = None,
    max_seconds: float | None = None,
) -> LeastSquaresResult:
    """Minimize ½ Σ weights (A x − b)² + ½ ridge ‖x‖² + Σ l1 |x| over lower ≤ x ≤ upper.

    Parameters
    ----------
    problem : BoundedLeastSquares
    x0 : array, shape (n,), or a number for n = 1, optional
        Start, projected onto the bounds; by default the point of [lower, upper] nearest to 0. Only projected steps use
        it, but x0 is the result if it is optimal, and no point that costs more is SOLVED.
    tolerance : float
        SOLVED means that cost exceeds the minimum by at most tolerance · cost, apart from rounding of the data: see
        `optimality` of :class:`LeastSquaresResult`, also for a LinearOperator.
    max_iterations : int, default 100 000
    max_seconds : float, optional
        Wall-clock limit in seconds, obeyed at the end of the current step; a run of PIQP is one step.

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
    At most 10⁶ entries: scipy's lstsq without bounds, nnls with one bound per column, else PIQP on the dual (wide A) or
    on the normal equations. An orthogonal factorization of the free columns follows. More entries, and a
    LinearOperator: projected gradient and conjugate gradient steps, with one product with A and one with Aᵀ each. When
    the steps have cost about as much as PIQP, PIQP follows as above or, if A is sparse, on min ½‖r‖² with A x − r = b,
    polished. The steps continue for a LinearOperator, and if a factorization is predicted to take too long.

    Examples
    --------
    >>> result = solve_least_squares(BoundedLeastSquares([[1, 0], [1, 1], [0, 1]], [2, 1, -1]))
    >>> result.x, result.cost, result.active_mask, result.status.name
    (array([1.5, 0. ]), 0.75, array([ 0, -1]), 'SOLVED')
    """
    clock = Clock()
    settings = Settings(tolerance=tolerance, max_iterations=max_iterations, max_seconds=max_seconds)
    run = LeastSquaresRun(
        problem, settings, None if x0 is None else problem.checked_start(x0), clock
    )
    with np.errstate(all="ignore"):
        return run.result(run.status())


class LeastSquaresRun:
    """Run that counts steps and certifies promising points."""

    def __init__(
        self,
        problem: BoundedLeastSquares,
        settings: Settings,
        start: FloatVector | None,
        clock: Clock,
    ) -> None:
        self.problem, self.settings, self.clock = problem, settings, clock
        self.enclosures = Enclosures(problem)
        if start is not None:
            self.enclosures.known.append(start)
        self.start = start
        self.best: Optimality | None = None
        self.algorithm, self.steps = "start", 0
        self._smallest = np.inf

    @cached_property
    def nearest(self) -> FloatVector:
        """The scaled point that is best so far; at first the start."""
        scaled = self.problem.scaled
        begin = scaled.nearest_to_zero if self.start is None else scaled.from_caller(self.start)
        return np.clip(begin, scaled.lower, scaled.upper)

    def status(self) -> Status:
        """Take steps until the problem is solved, a limit is reached, or no step remains; return the reason."""
        limit = self.settings.max_seconds
        try:
            with time_limit(
                math.inf if limit is None else limit - self.clock.read(), is_enforced=True
            ):
                return self._status()
        except OutOfTimeError:
            return Status.MAX_SECONDS
        except KeyboardInterrupt:
            return Status.INTERRUPTED

    def _status(self) -> Status:
        if self._may_begin_with_nnls:
            self.steps, self.algorithm = 1, "nnls"
            if self._is_solution(nnls_point(self.problem)):
                return Status.SOLVED
            self.steps, self.algorithm = 0, "start"
        is_at_rest = not FacePoint(self.problem.scaled, self.nearest).natural_residual.any()
        if (self.start is not None or is_at_rest) and self._is_certified(self.nearest):
            return Status.SOLVED
        for point in chain.from_iterable(self._stages()):
            _require_time()
            if self._is_certified(point):
                return Status.SOLVED
        if self.steps >= self.settings.max_iterations:
            return Status.MAX_ITERATIONS
        is_at_rounding_level = self.best is not None and self.best.is_at_rounding_level
        return Status.PRECISION_LIMIT if is_at_rounding_level else Status.STALLED

    @property
    def _may_begin_with_nnls(self) -> bool:
        """Whether nnls may solve the unscaled problem: with weights, units of rows and columns must not matter."""
        is_plain = self.start is None and self.problem.weights is None
        return is_plain and self.settings.max_iterations > 0 and is_for_nnls(self.problem)

    def _stages(self) -> Iterator[Iterator[FloatVector]]:
        """Yield projected steps, as many as cost about as much as PIQP, and engines; only engines if A is small."""
        problem, most = self.problem, self.settings.max_iterations
        few = SPARSE_PATIENCE if problem.is_sparse else math.ceil(PATIENCE * min(problem.shape))
        if not problem.is_small:
            yield self._projected_points(few if problem.has_entries else most)
        if problem.has_entries:
            is_direct = is_within_reach(problem.scaled)
            yield self._engine_points() if is_direct else self._projected_points(most)

    def _engine_points(self) -> Iterator[FloatVector]:
        """Yield points by lstsq, nnls and PIQP; a point is a step."""
        points = engine_points(self.problem.scaled)
        while self.steps < self.settings.max_iterations:
            _require_time()
            if (found := next(points, None)) is None:
                return
            self.steps += 1
            self.algorithm, self.nearest = found
            yield self.nearest

    def _projected_points(self, most: int) -> Iterator[FloatVector]:
        """Yield possibly optimal points of the projected steps, the point closest to optimality at the end."""
        self.algorithm, aim = "projected gradients", self.settings.tolerance
        since, before = 0, np.inf
        start = FacePoint(self.problem.scaled, self.nearest)
        for point in projected_steps(start):
            _require_time()
            if self.steps >= min(most, self.settings.max_iterations):
                break
            self.steps += 1
            size = point.size_of_residual * point.problem.size
            size = size / self.enclosures.reference if size > 0.0 else 0.0
            if not self._smallest <= size:
                self.nearest, self._smallest = point.x, size
            if size <= aim:
                aim = NARROWER * size
                yield point.x
            if self.steps - since >= max(WINDOW, since // 2):
                if self._smallest >= 0.99 * before:
                    break
                since, before = self.steps, self._smallest
        yield self.nearest

    def _is_certified(self, x: FloatVector, tolerance: float | None = None) -> bool:
        """Certify a scaled x, and store the best x; return whether this x is SOLVED."""
        return self._is_solution(self.problem.scaled.to_caller(x), tolerance)

    def _is_solution(self, x: FloatVector, tolerance: float | None = None) -> bool:
        """Certify an x within the bounds, and store the best x; return whether this x is SOLVED."""
        goal = self.settings.tolerance
        judged = Optimality.of(
            self.enclosures, x, tolerance=goal if tolerance is None else tolerance
        )
        is_solved = judged.meets(goal)
        best = self.best
        if best is None or is_solved or (judged.value, judged.cost) < (best.value, best.cost):
            self.best = judged
        return is_solved

    def result(self, status: Status) -> LeastSquaresResult:
        """Return the result of the run with its best point."""
        if self.best is None or status in (Status.MAX_SECONDS, Status.INTERRUPTED):
            self._is_certified(self.nearest, np.inf)
        best: Any = self.best
        run = self.steps, self.algorithm, self.clock.read(), self.settings.tolerance
        return LeastSquaresResult.at(best, status, *run)


def _require_time() -> None:
    if is_over():
        raise OutOfTimeError


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
        help("lcp_plugin.problems.least_squares.certificate"). For a LinearOperator, an estimate of
        ‖x − mid(lower, upper, x − g)‖∞/‖Aᵀ W b‖∞, g = AᵀW(A x − b) + ridge x, W = diag(weights). The estimate is
        computed with columns of A scaled to about unit length.
    active_mask : ndarray of int, shape (n,)
        −1 at the lower bound, 1 at the upper one, 0 between them.
    status : Status
        SOLVED exactly if optimality ≤ tolerance.
    nit : int
        Number of steps: of about a product with A and one with Aᵀ, or a point of lstsq, nnls or PIQP.
    algorithm : str
        "lstsq", "nnls", "piqp", "projected gradients", or "start" if the start is optimal.
    seconds : float
        Wall-clock seconds of the run.
    tolerance : float
        Tolerance of the run.
    is_proved : bool
        Whether `optimality` and `gap` are upper bounds. For a LinearOperator, whose entries are unknown, they are
        estimates.
    problem : BoundedLeastSquares
        The data.
    """

    x: FloatVector
    cost: float
    fun: FloatVector = field(repr=False)
    optimality: float
    active_mask: NDArray[np.int_] = field(repr=False)
    status: Status
    nit: int
    algorithm: str
    seconds: float
    tolerance: float
    is_proved: bool
    problem: BoundedLeastSquares = field(repr=False)
    _dual: FloatVector = field(repr=False)

    __setstate__ = restore_state

    @classmethod
    def at(
        cls,
        judged: Optimality,
        status: Status,
        nit: int,
        algorithm: str,
        seconds: float,
        tolerance: float,
    ) -> LeastSquaresResult:
        """Return the result at a measured point."""
        problem, x = judged.enclosures.problem, judged.x
        mask = (x >= problem.upper).astype(np.int_)
        mask[x <= problem.lower] = -1
        residual = read_only(judged.sharp_residual)
        return cls(
            x=read_only(x),
            cost=float(problem.cost(x, residual)),
            fun=residual,
            optimality=judged.value,
            active_mask=read_only(mask),
            status=status,
            nit=nit,
            algorithm=algorithm,
            seconds=seconds,
            tolerance=tolerance,
            is_proved=problem.has_entries,
            problem=problem,
            _dual=judged.dual,
        )

    @cached_property
    def gap(self) -> float:
        """Upper bound of cost − minimum for the stored data, rounding included; computed at the first access.

        At worst it equals the cost. This happens if some column is unbounded without a multiplier of the correct sign,
        and A is not proved to have full rank; see help("lcp_plugin.problems.least_squares.certificate").
        """
        with np.errstate(all="ignore"):
            return duality_gap(self.problem, self.x, self._dual)

    @property
    def objective(self) -> float:
        """The cost."""
        return self.cost

    @property
    def iterations(self) -> int:
        """`nit`."""
        return self.nit

    @property
    def advice(self) -> str:
        """Meaning of the status, and after ``next:`` the next step for the user."""
        if not np.isfinite(self.fun).all():
            return "A x is not finite; next: let the operator's products be finite doubles"
        remark = "" if self.is_proved else OF_OPERATORS.get(self.status, "")
        happened, begins, to_do = ADVICE.get(self.status, self.status.value).partition(NEXT)
        return happened + remark + begins + to_do

    def _numbers(self) -> dict[str, float]:
        return {**super()._numbers(), "optimality": self.optimality, "tolerance": self.tolerance}

    def describe_accuracy(self) -> str:
        """Return the optimality and the tolerance, as text."""
        above = f", at most {self.gap:.1e} above the least" if self.is_solved else ""
        return f"optimality {self.optimality:.1e}, tolerance {self.tolerance:g}; cost {self.cost:.9g}{above}"


ADVICE = {
    Status.SOLVED: "the cost exceeds the minimum by at most tolerance · cost, rounding of the data excused",
    Status.PRECISION_LIMIT: (
        "the gradient is at rounding level, but no lower bound of the cost was found near it, as for a large sparse A "
        "that fits b exactly; next: accept x if result.gap is small compared with result.cost, or raise l1 or ridge"
    ),
    Status.STALLED: (
        "the gradient no longer falls: A is too ill-conditioned, or its rows or bounds differ too much in size; next: "
        "add a ridge > 0, or rescale rows and columns"
    ),
    Status.MAX_ITERATIONS: "iteration limit reached; next: raise max_iterations, or continue from x0=result.x",
    Status.MAX_SECONDS: "time limit reached; next: raise max_seconds, or continue from x0=result.x",
    Status.INTERRUPTED: "stopped by Ctrl-C; next: continue from x, the best point so far",
}
OF_OPERATORS = {
    Status.SOLVED: "; of an operator: the gradient is at most tolerance · ‖AᵀWb‖∞",
    Status.STALLED: "; or the operator's products are not to the 16 digits of doubles",
}
