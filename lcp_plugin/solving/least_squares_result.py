"""The answer of a least squares run, and what can be said of it afterwards."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from ..algorithms.least_squares.faces import Point
from ..algorithms.least_squares.projected_steps import projected_steps
from ..certificates.least_squares import duality_gap
from ..checks import FloatVector, read_only, restored
from ..errors import NotConverged
from ..problem.least_squares import LeastSquares
from ..settings import Settings, Status

MOST_STEPS_FOR_GAP = 300


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
        SOLVED exactly where optimality ≤ tolerance; for a LinearOperator, whose optimality may hide much, where also
        the estimated gap is ≤ √tolerance times the cost at the point of the box nearest to 0. Where columns without
        any bound forbid an estimate, further steps must not gain more than that.
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
        with np.errstate(all="ignore"):
            nearer = point_nearer(self.problem, self.x, self.nit)
            return duality_gap(self.problem, self.x, nearer)

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


def result_of(
    problem: LeastSquares, settings: Settings, x: FloatVector, residual: FloatVector, optimality: float,
    status: Status, steps: int, seconds: float,
) -> LeastSquaresResult:
    """Return the result that these make."""
    mask = (x >= problem.upper).astype(np.int_)
    mask[x <= problem.lower] = -1
    return LeastSquaresResult(
        x=read_only(x), cost=problem.cost(x, residual), fun=read_only(residual), optimality=optimality,
        active_mask=read_only(mask), status=status, nit=steps, seconds=seconds, tolerance=settings.tolerance,
        is_proved=problem.has_entries, problem=problem,
    )


def point_nearer(problem: LeastSquares, x: FloatVector, steps: int) -> FloatVector:
    """Return a point nearer to the answer than x, which about as many steps led to."""
    unit = problem.unit
    start = Point(unit, np.clip(unit.from_caller(x), unit.lower, unit.upper))
    points = islice(projected_steps(start), min(2 * steps + 1, MOST_STEPS_FOR_GAP))
    return unit.to_caller(min(points, key=lambda point: float(np.abs(point.natural_residual).max(initial=0.0))).x)
