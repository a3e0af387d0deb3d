"""bounded_least_squares(): the answer, and what is said of it."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...core.checks import FloatVector, read_only, restored
from ...core.deadline import Clock
from ...core.kind import Kind
from ...core.settings import Settings, Status
from ...core.solving.answer import NEXT, Answer
from . import BOUNDED_LEAST_SQUARES
from .data import BoundedLeastSquares


def bounded_least_squares(
    A: Any,
    b: ArrayLike,
    lower: ArrayLike = 0.0,
    upper: ArrayLike = np.inf,
    *,
    x0: ArrayLike | None = None,
    weights: ArrayLike | None = None,
    ridge: float = 0.0,
    l1: ArrayLike = 0.0,
    tolerance: float = 1e-8,
    max_iterations: int | None = None,
    max_seconds: float | None = None,
) -> LeastSquaresResult:
    """Return the x that minimises ½ Σ weights (A x − b)² + ½ ridge ‖x‖² + Σ l1 |x| over lower ≤ x ≤ upper.

    With the default bounds it is nonnegative least squares (NNLS); with ``lower=-np.inf`` and an l1 the lasso.

    Parameters
    ----------
    A : array, sparse array or scipy LinearOperator, shape (m, n)
        Real, finite, of any shape and rank; not copied where it holds doubles, unless it has fewer than 10⁶ places.
        A LinearOperator needs rmatvec.
    b : array, shape (m,)
    lower, upper : scalar or array, shape (n,)
        Bounds of x; −∞ and ∞ are allowed, lower ≤ upper.
    x0 : array, shape (n,), or a number for n = 1, optional
        Where to begin, projected onto the bounds; by default the point of [lower, upper] nearest to 0.
    weights : array, shape (m,), optional
        ≥ 0, one a row: 0 leaves it out.
    ridge : float
        ≥ 0.
    l1 : number or array, shape (n,)
        ≥ 0: of a lasso without bounds say ``lower=-np.inf`` as well. An x_j that the penalty holds is exactly 0.
    tolerance : float
        SOLVED means that cost is above the least by at most this times cost, rounding of the data aside: see
        `optimality` of :class:`LeastSquaresResult`, where a LinearOperator is spoken of, too.
    max_iterations : int, default 100 000
    max_seconds : float, optional
        Wall-clock limit in seconds, obeyed at the end of the step under way; an engine's answer is one.

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
    Dense problems of up to 600 columns or rows: scipy's nnls, where bounds are on one side and there is no l1. Others
    of up to 1500: PIQP on the normal equations where boxes are, and on the dual, whose condition is that of A; then
    the face that it names is solved by an orthogonal factor. Where rounding leaves those too little, as for rows of
    very different size, an active set whose faces are refined to the last digit of each row, for at most 10⁶ places of
    A. Large A come to PIQP, sparse ones on the dual, after projected gradient and conjugate gradient steps, about a
    product with A and one with Aᵀ each, that have cost about as much. Where nothing else can be had, and for a
    LinearOperator, the steps go on; an ill-conditioned problem may end STALLED there. In the steps with an l1 each
    column is on one side of 0 at a time, where its penalty is linear. Whoever found x, the same certificate judges it.

    Examples
    --------
    >>> result = bounded_least_squares([[1, 0], [1, 1], [0, 1]], [2, 1, -1])
    >>> result.x, result.cost, result.active_mask, result.status.name
    (array([1.5, 0. ]), 0.75, array([ 0, -1]), 'SOLVED')
    """
    problem = BoundedLeastSquares(A, b, lower, upper, weights=weights, ridge=ridge, l1=l1)
    return solve_least_squares(
        problem, x0=x0, tolerance=tolerance, max_iterations=max_iterations, max_seconds=max_seconds
    )


@np.errstate(under="ignore")
def solve_least_squares(
    problem: BoundedLeastSquares,
    *,
    x0: ArrayLike | None = None,
    tolerance: float = 1e-8,
    max_iterations: int | None = None,
    max_seconds: float | None = None,
) -> LeastSquaresResult:
    """Return the answer to a problem that is stated already; see :func:`bounded_least_squares`."""
    clock = Clock()
    is_plain = x0 is max_iterations is max_seconds is None
    if is_plain and type(tolerance) is float and 0.0 < tolerance < 1.0:
        from .engine_points import nonnegative_as_given

        if (found := nonnegative_as_given(problem, tolerance)) is not None:
            x, residual, dual, value = found
            return _result_of(problem, tolerance, x, residual, dual, value, Status.SOLVED, 1, clock)
    settings = Settings(tolerance=tolerance, max_iterations=max_iterations, max_seconds=max_seconds)
    start = None if x0 is None else problem.checked_start(x0)
    if (units := problem.far_units) is not None:
        near = problem.in_units(*units)
        inside = solve_least_squares(
            near,
            x0=None if start is None else np.ldexp(start, units[1] - units[0]),
            tolerance=tolerance,
            max_iterations=max_iterations,
            max_seconds=max_seconds,
        )
        return inside.in_the_callers_units(problem, units)
    from .run import run_stages

    judged, status, steps = run_stages(problem, settings, start, clock)
    x, residual, value = judged.x, judged.sharp_residual, judged.value
    return _result_of(
        problem, settings.tolerance, x, residual, judged.dual, value, status, steps, clock
    )


@dataclass(frozen=True, eq=False, repr=False)
class LeastSquaresResult(Answer):
    """The answer to a least-squares problem; attributes are named as in scipy, except `status`.

    Attributes
    ----------
    x : ndarray, shape (n,)
        Within the bounds, exactly at a bound where `active_mask` says so.
    cost : float
        ½ Σ weights (A x − b)² + ½ ridge ‖x‖² + Σ l1 |x|.
    fun : ndarray, shape (m,)
        The residual A x − b, without weights.
    optimality : float
        An upper bound of (cost − least cost)/cost, rounding aside: for entries of A and b that differ from those given
        by no more than rounding relative to each. Units of rows and columns do not matter, and where each row's
        residual is rounding of its own terms it is 0; 1 where nothing is proved. The formula, and what it cannot see:
        help("lcp_plugin.problems.least_squares.certificate"). For a LinearOperator, an estimate of the larger of
        ‖mid(x − upper, x − lower, g)‖∞/‖Aᵀ W b‖∞, g = AᵀW(A x − b) + ridge x, W = diag(weights), and the same in units
        in which the columns of A have about unit length.
    active_mask : ndarray of int, shape (n,)
        −1 at the lower bound, 1 at the upper one, 0 between them.
    status : Status
        SOLVED exactly where optimality ≤ tolerance; for a LinearOperator, whose optimality may hide much, where also
        the estimated gap is ≤ √tolerance times the cost at the point of the box nearest to 0. Where columns without
        any bound forbid an estimate, further steps must not gain more than that.
    nit : int
        Steps, of about a product with A and one with Aᵀ each, or a face solved by a factor; an engine's answer is one.
    seconds : float
        Wall-clock seconds of the run.
    tolerance : float
        As given.
    is_proved : bool
        Whether `optimality` and `gap` are upper bounds. For a LinearOperator, whose entries nobody knows, they are
        estimates.
    problem : BoundedLeastSquares
        The data.
    """

    answered_kind: ClassVar[Kind] = BOUNDED_LEAST_SQUARES

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
    problem: BoundedLeastSquares = field(repr=False)
    _dual: FloatVector = field(repr=False)
    _inside: tuple[LeastSquaresResult, int] | None = field(repr=False, default=None)

    __setstate__ = restored

    @cached_property
    @np.errstate(over="ignore", under="ignore")
    def gap(self) -> float:
        """An upper bound of cost − min cost for the data as they are, rounding of x included; computed at a first look.

        It is at most cost but for rounding, and no less where A is not proved to have full rank and some column without
        a bound on one side (or with none) allows no multiplier of the right sign;
        help("lcp_plugin.problems.least_squares.certificate").
        """
        from .run import gap_of

        if self._inside is not None:
            inside, exponent = self._inside
            return math.nextafter(float(np.ldexp(inside.gap, exponent)), math.inf)
        return gap_of(self.problem, self.x, self._dual, self.nit)

    @np.errstate(
        over="ignore", under="ignore"
    )  # squares leave the range: that is why it was solved in others
    def in_the_callers_units(
        self, problem: BoundedLeastSquares, units: tuple[int, int]
    ) -> LeastSquaresResult:
        """Return the same answer to a problem of which this one is `problem.in_units(*units)`."""
        x = np.clip(np.ldexp(self.x, units[0] - units[1]), problem.lower, problem.upper)
        return replace(
            self,
            x=read_only(x),
            cost=float(np.ldexp(self.cost, -2 * units[1])),
            problem=problem,
            fun=read_only(np.ldexp(self.fun, -units[1])),
            _inside=(self, -2 * units[1]),
        )

    @property
    def objective(self) -> float:
        """The cost."""
        return self.cost

    @property
    def iterations(self) -> int:
        """`nit`."""
        return self.nit

    @property
    def algorithm(self) -> str:
        """What ran."""
        return "bounded least squares"

    @property
    def advice(self) -> str:
        """What the status means, and behind ``next:`` what to do."""
        if not np.isfinite(self.fun).all():
            return "A x is not finite; next: let the operator's products be finite doubles"
        remark = "" if self.is_proved else OF_OPERATORS.get(self.status, "")
        happened, begins, to_do = ADVICE.get(self.status, self.status.value).partition(NEXT)
        return happened + remark + begins + to_do

    def _numbers(self) -> dict[str, float]:
        return {**super()._numbers(), "optimality": self.optimality, "tolerance": self.tolerance}

    def reached(self) -> str:
        """Return the optimality beside what was asked for."""
        above = f", at most {self.gap:.1e} above the least" if self.is_solved else ""
        return f"optimality {self.optimality:.1e}, tolerance {self.tolerance:g}; cost {self.cost:.9g}{above}"


ADVICE = {
    Status.SOLVED: "the gradient at x within its bounds is 0 within the tolerance",
    Status.PRECISION_LIMIT: (
        "the gradient is no larger than rounding in double precision explains, but no lower bound of the cost was "
        "found near it, as for a large sparse A that fits b exactly; next: accept x, which result.gap bounds"
    ),
    Status.STALLED: (
        "the gradient no longer falls: A is too ill-conditioned for steps, and its factor would fill in too much or "
        "cannot be had; next: add a ridge > 0"
    ),
    Status.MAX_ITERATIONS: "the iteration limit came first; next: raise max_iterations, or go on from x0=result.x",
    Status.MAX_SECONDS: "the time limit came first; next: raise max_seconds, or go on from x0=result.x",
    Status.INTERRUPTED: "stopped by Ctrl-C; next: go on from x, the best point so far",
}
OF_OPERATORS = {
    Status.PRECISION_LIMIT: "; of an operator SOLVED asks for a gap below √tolerance · cost at the start, too",
    Status.STALLED: "; or the operator's products are not to the 16 digits of doubles",
}


def _result_of(
    problem: BoundedLeastSquares,
    tolerance: float,
    x: FloatVector,
    residual: FloatVector,
    dual: FloatVector,
    optimality: float,
    status: Status,
    steps: int,
    clock: Clock,
) -> LeastSquaresResult:
    """Return the result that these make."""
    mask = (x >= problem.upper).astype(np.int_)
    mask[x <= problem.lower] = -1
    return LeastSquaresResult(
        x=read_only(x),
        cost=problem.cost(x, residual),
        fun=read_only(residual),
        optimality=optimality,
        active_mask=read_only(mask),
        status=status,
        nit=steps,
        seconds=clock.read(),
        tolerance=tolerance,
        is_proved=problem.has_entries,
        problem=problem,
        _dual=dual,
    )
