"""solve_nonlinear(): Josephy–Newton in the common loop, measured by the criterion of LCPs.

The searches of :mod:`lcp_plugin.problems.nonlinear.searches` propose the points.
"""

from __future__ import annotations

import math
from functools import lru_cache, partial
from types import SimpleNamespace
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike

from ...core.algorithm import Algorithm, Step
from ...core.checks import Vector, read_only, vector_option
from ...core.entries import clip, or_one
from ...core.errors import InvalidOption, InvalidProblem
from ...core.kernels.threads import threads_for
from ...core.names import Names
from ...core.settings import DEFAULT, Settings, Status, whole_number
from ...core.tuning import CHEAP_UP_TO
from ...judges.lcp import Measured, RowData
from ...solving.dispatch import method_of
from ...solving.result import Callback, Result
from ...solving.run import Budget, Named, Progress, Run, Stage
from ..programs.no_minimum import proof_of_contradiction
from .data import Evaluations, Linearization, NonlinearProblem
from .searches import RESTARTS, SEARCHES, JosephyNewton

CHECKED = 2.0**-20, 2.0**-10  # steps
ELSEWHERE = "F or its derivative is not finite at the start given, projected onto them"


@np.errstate(all="ignore")
def solve_nonlinear(
    problem: NonlinearProblem,
    x0: ArrayLike | None = None,
    algorithm: str | Algorithm = "auto",
    *,
    callback: Callback | None = None,
    check_jacobian: bool = True,
    search: str | None = None,
    restarts: int = RESTARTS,
    **options: Any,
) -> Result:
    """Return the solution of a nonlinear complementarity problem by Josephy–Newton, measured with F itself.

    Parameters
    ----------
    problem : NonlinearProblem
    x0 : array, shape (n,), or a number for n = 1, optional
        Start, projected onto the bounds; by default the point of the bounds nearest to 0. If F or its derivative is
        not finite at x0, the run starts at the point of the bounds nearest to 0, or else nearest to 1, and
        ``explain()`` reports this. F always receives an array.
    algorithm : str or Algorithm
        Algorithm for the linear complementarity problem of each step.
    tolerance : float
        SOLVED means that x passes the criterion of LCPs with this tolerance (:func:`lcp_plugin.solve`), for
        M = F′(x), q = F(x) − F′(x) x, with F(x) for w and without rescaling of F. Three clauses are added:
        ``help("lcp_plugin.problems.nonlinear.data")``.
    max_iterations : int, default 100 000
        Newton steps.
    max_seconds : float, optional
        Wall-clock limit in seconds, also checked inside a step, as :func:`lcp_plugin.solve` does.
    absolute_tolerance : float
        Absolute residual, in the unit of x, as for :func:`lcp_plugin.solve`. A row below it is not compared with its
        terms.
    callback : callable, optional
        Same as in :func:`lcp_plugin.solve`, with one sample per Newton step, also of `record`. Residuals above the
        tolerance are lower bounds, relative to the largest terms of a row, and residuals below it upper bounds.
    check_jacobian : bool
        Compare the `jacobian` with differences of F, near the start and where x passes. ``explain()`` names the row
        with the largest deviation at the start. If they differ, x is SOLVED only if it passes with differences also.
    search : str, optional
        "monotone" or "nonmonotone"; by default one after the other.
    restarts : int
        Number of further starts if the searches fail, for at most 1000 unknowns.
    threads : int, optional
        Number of threads, see :func:`lcp_plugin.solve`. F itself is called in the calling thread.
    verbose : bool
        Print the run, one line per Newton step at geometric intervals.
    **options
        The options above.

    Returns
    -------
    Result
        Contains z = x and w = F(x) for every status. INFEASIBLE is proved by affine rows alone, of a model or a
        variational inequality. STALLED: x is a stationary point of the merit, or steps no longer reduce the residual;
        another start may find a solution. PRECISION_LIMIT uses an estimate of the rounding error in F. Ctrl-C ends the
        run and the best x is returned, once F is computed at the start. ``derivative(result)`` takes a change of F as
        dq.

    Raises
    ------
    InvalidProblem
        If F or its derivative is finite at no start, or has another shape.
    InvalidOption, UnknownAlgorithm
        For a wrong option.

    Notes
    -----
    Each step solves the linear complementarity problem of F′(x), with a tolerance tied to the residual at x. A line
    search keeps ‖Φ‖ falling, Φ the Fischer–Burmeister function. The fallbacks of a failed line search are described in
    ``help("lcp_plugin.problems.nonlinear.searches")``.

    Examples
    --------
    >>> import numpy as np
    >>> problem = NonlinearProblem(lambda x: np.array([np.exp(x[0]) + x[1] - 3, x[1] - x[0] + 2]))
    >>> result = solve_nonlinear(problem, [0.0, 0.0], tolerance=1e-10)
    >>> result.status.name, result.z.round(4), result.w.round(4) + 0.0
    ('SOLVED', array([1.0986, 0.    ]), array([0.    , 0.9014]))
    """
    if not isinstance(problem, NonlinearProblem):
        raise InvalidOption(
            f"solve_nonlinear needs a NonlinearProblem, got {type(problem).__name__}; write NonlinearProblem(F)"
        )
    settings = Settings(**options) if options else DEFAULT
    if algorithm != "auto":
        method_of(algorithm, {})
    if search not in (None, *SEARCHES):
        words = " or ".join([", ".join(f'"{name}"' for name in SEARCHES), "None"])
        raise InvalidOption(f"search must be {words}, got {search!r}")
    restarts = whole_number(restarts, "restarts", 0)
    if x0 is None and problem.n is None:
        raise InvalidOption(
            "x0 is needed because the number of unknowns is not known; pass x0 (z0 in solve_batch)"
        )
    start = np.zeros(problem.n or 0)
    if x0 is not None:
        start = vector_option(x0, "x0", problem.n, may_be_number=True)
    problem = problem.counted(start.size)
    progress = Progress(problem, settings, callback)
    start = clip(start, problem.lower, problem.upper)
    with threads_for(settings.threads):
        first, begun = begin_at(Linearization(problem, start))
        searches = tuple(SEARCHES) if search is None else (search,)
        has_doubts = check_jacobian and problem.jacobian is not None
        newton = JosephyNewton(first, algorithm, settings, searches, restarts)
        run = NonlinearRun(newton, progress, has_doubts=has_doubts)
        try:
            if has_doubts:
                begun = "; ".join(filter(None, (begun, jacobian_warning(first))))
            end = run.follow_all([Stage(newton, TANGENTS, steps=newton.iterates(problem, first.x))])
        except KeyboardInterrupt:
            end = Status.INTERRUPTED
        return run.result(end, begun)


def begin_at(first: Linearization) -> tuple[Linearization, str]:
    """Return the linearization at the start and a note: x0, or the point nearest to 0 or 1 where F is defined.

    Raises
    ------
    InvalidProblem
        If F is defined at none of these points.
    """
    start, lower, upper = first.x, first.problem.lower, first.problem.upper
    for near in () if first.is_defined else (0.0, 1.0):
        point = first.at(np.clip(np.full(start.size, near), lower, upper))
        if point.is_defined:
            return point, f"started at the point of the bounds nearest to {near:g}: {ELSEWHERE}"
    if not (is_finite := np.isfinite(first.value)).all():
        i = int(np.argmin(is_finite))
        raise InvalidProblem(
            f"F must be finite at the start, but F(x0)[{i}] = {first.value[i]} with x0[{i}] = {start[i]} in the bounds"
        )
    return first, ""


def planned(problem: NonlinearProblem) -> tuple[str, Any, list[Stage]]:
    """Return the derivative at the start and the stages of a nonlinear problem for `analyze`."""
    until = "25 steps gain nothing; then by nonmonotone searches, then from other starts"
    stages, n = [Stage(Named(JosephyNewton.name), TANGENTS, Budget(until))], problem.n
    point = None if n is None else begin_at(Linearization(problem, problem.nearest_to_zero))[0]
    return "F′ at the start", point and point.M, stages


ADVICE = {
    Status.SOLVED: "the residual is within the tolerance, as measured on F",
    Status.PRECISION_LIMIT: "rounding in F, as estimated, explains the residual; next: accept z, or scale F",
    Status.DIVERGED: "the residual left every reasonable range; next: try another start x0, or bounds near it",
    Status.MAX_ITERATIONS: "iteration limit reached; next: raise max_iterations, or continue from x0=result.z",
    Status.MAX_SECONDS: "time limit reached; next: raise max_seconds, or continue from x0=result.z",
}


TANGENTS = (
    "each iteration replaces F by its tangent at x and solves the linear problem that this gives"
)
TRAP = "no step reduces the residual (starts: {}): z may be a local minimum of the residual; next: try another start x0"
GROWING = "the unknowns grow without limit, and F tends to 0: has it a solution? next: try another start x0, or bounds"


class NonlinearRun(Run):
    """Run of a nonlinear problem: its points are linearizations, measured by their certificates.

    Parameters
    ----------
    newton : JosephyNewton
    progress : Progress
    has_doubts : bool
        Whether a jacobian is compared with differences where a point passes.
    """

    def __init__(self, newton: JosephyNewton, progress: Progress, *, has_doubts: bool) -> None:
        super().__init__(progress)
        self.newton, self.has_doubts = newton, has_doubts

    def measure(self, stage: Stage, step: Step) -> Measured:
        """Return the linearization at the point of a step; if its residual is small, at bounds that are near."""
        point: Linearization = step.measured
        if not (is_small := point.is_small(self.settings)):
            return Measured(point, point.least_residual, is_small)
        point = self._snap(point)
        return Measured(point, point.measure_by(self.settings).residual, self._passes(point))

    def keep(self, measured: Measured) -> None:
        """Keep a point that passes, or whose violation in the units of the start is the least."""
        violation = self.newton.sizes_of(measured.z)[1]
        super().keep(Measured(measured.z, violation, measured.passes))

    def _is_far(self, point: Linearization) -> bool:
        """Return whether an unknown is as large as at a point from which it grew."""
        return bool((np.abs(point.x) >= self.newton.limit).any())

    def _passes(self, point: Linearization) -> bool:
        """Return whether a point passes, with differences also if they disagree with the jacobian."""
        if not point.passes(self.settings):
            return False
        there = with_trusted_derivative(point) if self.has_doubts else point
        return there is point or (there.is_defined and there.passes(self.settings))

    def _snap(self, point: Linearization) -> Linearization:
        """Return the linearization after entries near bounds are moved there, unless only the point itself passes."""
        x = point.snap_to_bounds(point.x, point.value)
        if np.logical_and.reduce(x == point.x) or not (moved := point.at(x)).is_defined:
            return point
        meets = [place.passes(self.settings) for place in (point, moved)]
        is_no_worse = moved.relative <= point.relative if meets[0] == meets[1] else meets[1]
        return moved if is_no_worse else point

    def end_of(self, stage: Stage, step: Step, measured: Measured) -> Status | None:
        """Return DIVERGED if a residual is not a number."""
        return Status.DIVERGED if math.isnan(self.newton.sizes_of(measured.z)[0]) else None

    def result(self, end: Status, begun: str = "") -> Result:
        """Return the result: the best point, moved to near bounds unless Ctrl-C ended the run."""
        newton, is_interrupted = self.newton, end is Status.INTERRUPTED
        point: Linearization = newton.first if self.best is None else self.best.z
        passes = self.best is not None and self.best.passes
        if not (passes or is_interrupted):
            # Rounding in one row decides which point is best, and other rows may be better at the last point
            point = self._snap(newton.current if newton.is_at_floor() else point)
            passes = self._passes(point)
        is_open = not (passes or is_interrupted or self._is_far(point))
        is_limited = is_open and point.is_limited(self.settings)
        self.best = Measured(point, 0.0, passes, is_limited)
        status = self.status(end)
        words = ADVICE
        if status is Status.STALLED:
            stalled = GROWING if self._is_far(point) else TRAP.format(newton.restarted + 1)
            words = {status: stalled}
        named: dict[str, Any] = {"algorithm": newton.name, "_asked": newton, "_advice": words}
        named |= {"evaluations": Evaluations(*newton.first.problem.counts), "begun": begun}
        if status is Status.STALLED and (part := point.problem.affine_part) is not None:
            proof = proof_of_contradiction(part())
            status = status if proof is None else Status.INFEASIBLE
            named["infeasibility"] = proof
        if status is not Status.SOLVED or self.settings.verbose:
            return self.result_at(point.certificate, status, **named)
        fields = self.fields_at(point.x, status)
        return Result.of_known(partial(_certified, point), **fields, **named)


def _certified(point: Linearization) -> Any:
    """Return the certificate of a point, which costs a quarter of a small run, as the field of a result."""
    return SimpleNamespace(certificate=point.certificate)


def with_trusted_derivative(point: Linearization) -> Linearization:
    """Return the linearization, by differences of F if they disagree with the jacobian."""
    problem = point.problem
    if problem.jacobian is None or not jacobian_warning(point):
        return point
    pattern = None if point.x.size <= CHEAP_UP_TO else sp.csr_array(point.M)
    twin = NonlinearProblem(problem.F, None, problem.lower, problem.upper, pattern)
    return Linearization(twin.with_size(point.x.size), point.x)


def criterion_at(problem: NonlinearProblem, x: Vector) -> tuple[RowData, Vector, Vector, Names]:
    """Return the data of the criterion at x, with x, F(x) and the names; the jacobian is checked as in a run.

    Raises
    ------
    InvalidProblem
        If F or its derivative is not finite at x; the message names the row.
    """
    problem = problem.with_size(x.size)
    at = Linearization(problem, x)
    if (wrong := np.flatnonzero(~np.isfinite(at.value))).size:
        row, value = problem.names.row(wrong[0]), at.value[wrong[0]]
        raise InvalidProblem(f"{row} is {value} at x; give a point at which F is defined")
    at = with_trusted_derivative(at)
    return at, at.x, at.value, problem.names


@lru_cache(maxsize=16)
def _drawn(n: int) -> tuple[Vector, Vector]:
    """Return the shares and signs of a random direction, shape (n,) each."""
    random = np.random.default_rng(0)
    return random.uniform(0.5, 1.0, n), np.where(random.random(n) < 0.5, -1.0, 1.0)


def jacobian_warning(point: Linearization) -> str:
    """Return a warning with the row in which differences and jacobian differ most, or "".

    Parameters
    ----------
    point : Linearization
        The start. F is evaluated at two points along one random direction that leads into the bounds.
    """
    x, M, problem, value = point.x, point.M, point.problem, point.value
    shares, signs = _drawn(x.size)
    wrong: Any = np.inf
    found, sizes = list[Any](), np.abs(x)
    # The unit of x_j is 1, then |x_j|
    for step, unit in zip(CHECKED, (np.maximum(sizes, 1.0), or_one(sizes)), strict=True):
        size = unit * shares
        direction = np.where(x - problem.lower < CHECKED[1] * size, size, size * signs)
        direction = np.where(problem.upper - x < CHECKED[1] * size, -size, direction)
        slope, terms = M @ direction, point.absolute @ size
        quotient = (problem.evaluate(read_only(x + step * direction)) - value) / step
        found.append((slope, quotient))
        apart, size = np.abs(quotient - slope), terms + np.abs(quotient)
        if not np.count_nonzero(apart > 0.1 * size):  # NaN does not deviate
            return ""
        is_single = (value == value.astype(np.float32)).all()  # the digits of F
        rounding = np.abs(value) * (2.0**-23 if is_single else 2.0**-52)
        error = apart / (size + rounding / step)
        wrong = np.minimum(wrong, np.where(np.isfinite(error), error, 0.0))
        if not (wrong > 0.1).any():
            return ""
    slope, quotient = found[0]
    i = int(np.argmax(wrong))
    return (
        f"jacobian disagrees with F at the start: along one direction {problem.names.row(i)} of jacobian(x0) gives "
        f"{slope[i]:.6g}, and differences of F give {quotient[i]:.6g}; correct it, or leave it out"
    )
