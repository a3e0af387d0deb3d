"""solve_nonlinear(): Josephy–Newton in the common loop, measured by the criterion of LCPs."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike

from ...auto import method_of
from ...core.algorithm import Algorithm, Step
from ...core.certificates.criterion import row_data
from ...core.certificates.measured import Measured
from ...core.checks import FloatVector, read_only, vector_option
from ...core.deadline import Clock
from ...core.errors import InvalidOption, InvalidProblem
from ...core.kernels.threads import threads_for
from ...core.settings import Settings, Status, checked_callback
from ...core.solving.progress import Callback, Progress
from ...core.solving.result import Result
from ...core.solving.run import Run
from ...core.solving.run_log import RunLog
from ...core.solving.stage import Stage
from ...core.solving.termination import TerminationReason
from .certificate import Linearization, Linearizations
from .data import NonlinearProblem
from .josephy_newton import JosephyNewton

CHECKED = 2.0**-20, 2.0**-10  # steps
WRONG = 0.1  # of the terms of a row, with both steps
ELSEWHERE = "F or its derivative is not finite at the start given, projected onto them"


@np.errstate(all="ignore")
def solve_nonlinear(
    problem: NonlinearProblem,
    x0: ArrayLike | None = None,
    algorithm: str | Algorithm = "auto",
    *,
    callback: Callback | None = None,
    check_jacobian: bool = True,
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
        M = F′(x), q = F(x) − F′(x) x, with F(x) for w and without rescaling of F. Two clauses are added:
        ``help("lcp_plugin.problems.nonlinear.certificate")``.
    max_iterations : int, default 100 000
        Newton steps.
    max_seconds : float, optional
        Wall-clock limit in seconds, also checked inside a step, as :func:`lcp_plugin.solve` does.
    absolute_tolerance : float
        Absolute residual, in the unit of x, as for :func:`lcp_plugin.solve`. A row below it is not compared with its
        terms.
    callback : callable, optional
        Same as in :func:`lcp_plugin.solve`, with one sample per Newton step, also of `record`.
    check_jacobian : bool
        Compare the `jacobian` with differences of F near the start. ``explain()`` names the row with the largest
        deviation.
    threads : int, optional
        Number of threads, see :func:`lcp_plugin.solve`. F itself is called in the calling thread.
    verbose : bool
        Print the run, one line per Newton step at geometric intervals.
    **options
        The options above.

    Returns
    -------
    Result
        Contains z = x and w = F(x) for every status. INFEASIBLE is never returned. STALLED: x is a stationary point of
        the merit, or steps no longer reduce the residual; another start may find a solution. PRECISION_LIMIT uses an
        estimate of the rounding error in F. Ctrl-C ends the run and the best x is returned, once F is computed at the
        start. ``derivative(result)`` takes a change of F as dq.

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
    ``help("lcp_plugin.problems.nonlinear.josephy_newton")``.

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
            f"solve_nonlinear needs a NonlinearProblem, got {type(problem).__name__}; write NonlinearProblem(F), or "
            "solve(problem) for an LCP"
        )
    settings = Settings(**options)
    method_of(algorithm, {})
    checked_callback(callback)
    start = _checked_start(problem, x0)
    problem = problem.with_size(start.size)
    clock = Clock()
    start = read_only(np.clip(start, problem.lower, problem.upper))
    with threads_for(settings.threads):
        points = Linearizations(problem)
        start, begun = begun_at(points, start)
        first = points.at(start)
        _check_start(first)
        newton = JosephyNewton(points=points, linear=algorithm, tolerance=settings.goal)
        with clock.pause():
            log = RunLog(problem) if settings.verbose else None
        run = NonlinearRun(points, newton, first, Progress(settings, callback, clock, log))
        try:
            if check_jacobian and problem.jacobian is not None:
                begun = "; ".join(filter(None, (begun, jacobian_warning(first))))
            end = run.follow_all([Stage(newton, TANGENTS, steps=newton.iterates(first.lcp, start))])
        except KeyboardInterrupt:
            end = TerminationReason.INTERRUPTED
        return replace(run.result(end), begun=begun)


def begun_at(points: Linearizations, start: FloatVector) -> tuple[FloatVector, str]:
    """Return the start and a note: x0, or the point nearest to 0 or 1 where F is defined.

    If F is defined at none of these points, x0 is returned and raises an error later.
    """
    lower, upper = points.problem.lower, points.problem.upper
    if points.at(start).is_defined:
        return start, ""
    for near in (0.0, 1.0):
        point = read_only(np.clip(np.full(start.size, near), lower, upper))
        if points.at(point).is_defined:
            return point, f"started at the point of the bounds nearest to {near:g}: {ELSEWHERE}"
    return start, ""


def _check_start(start: Linearization) -> None:
    """Raise InvalidProblem if F is not defined at the start."""
    i = int(np.argmin(np.isfinite(start.value))) if start.value.size else -1
    if i >= 0 and not np.isfinite(start.value[i]):
        raise InvalidProblem(
            f"F must be finite at the start, but F(x0)[{i}] = {start.value[i]} with x0[{i}] = {start.x[i]} after "
            "projection onto the bounds; start where F is defined, or tighten the bounds"
        )


def _checked_start(problem: NonlinearProblem, x0: ArrayLike | None) -> FloatVector:
    if x0 is None:
        if problem.n is None:
            raise InvalidOption(
                "x0 is needed because the number of unknowns is not known; pass x0 (z0 in solve_batch), or arrays "
                "as bounds"
            )
        return np.zeros(problem.n)
    return vector_option(x0, "x0", problem.n, may_be_number=True)


WORDS = {
    Status.SOLVED: "the residual is within the tolerance, as measured on F",
    Status.PRECISION_LIMIT: (
        "the residual is above the tolerance, but no larger than rounding in F explains, as far as F tells at "
        "points nearby; next: accept z, or scale F"
    ),
    Status.STALLED: (
        "no step reduces the residual further; z may be a local minimum of the residual, F may have no solution or no "
        "slope here, or its jacobian may be wrong; next: try another start x0"
    ),
    Status.DIVERGED: "the residual left every reasonable range; next: try another start x0, or bounds near it",
    Status.MAX_ITERATIONS: "iteration limit reached; next: raise max_iterations, or continue from x0=result.z",
    Status.MAX_SECONDS: "time limit reached; next: raise max_seconds, or continue from x0=result.z",
    Status.INTERRUPTED: Status.INTERRUPTED.value,
}


class NonlinearRun(Run):
    """Run of a nonlinear problem: its points are linearizations, measured by their certificates.

    Parameters
    ----------
    points : Linearizations
    newton : JosephyNewton
    first : Linearization
        At the start.
    progress : Progress
    """

    def __init__(
        self,
        points: Linearizations,
        newton: JosephyNewton,
        first: Linearization,
        progress: Progress,
    ) -> None:
        super().__init__(progress)
        self.points, self.newton, self.first = points, newton, first

    def measure(self, stage: Stage, step: Step) -> Measured:
        """Return the linearization at the point of a step; if its residual is small, at bounds that are near."""
        point = self.points.at(step.z)
        if point.residual <= self.settings.goal:
            point = self._snap(point)
        passes = point.certificate.meets(self.settings, power=1.0)  # the active set is known
        return Measured(point, point.residual, passes)

    def _snap(self, point: Linearization) -> Linearization:
        """Return the linearization after entries near bounds are moved there, unless only the point itself passes."""
        x = row_data(point.lcp).snap_to_bounds(point.x, point.value)
        if np.array_equal(x, point.x) or not (moved := self.points.at(x)).is_defined:
            return point
        meets = [one.certificate.meets(self.settings) for one in (point, moved)]
        is_no_worse = moved.residual <= point.residual if meets[0] == meets[1] else meets[1]
        return moved if is_no_worse else point

    def end_of(self, stage: Stage, step: Step, found: Measured) -> TerminationReason | None:
        """Return DIVERGED if a residual is not a number."""
        return TerminationReason.DIVERGED if math.isnan(found.residual) else None

    def end_of_stage(self, stage: Stage, end: TerminationReason) -> TerminationReason:
        """Return the reason."""
        return end

    def result(self, end: TerminationReason) -> Result:
        """Return the result: the best point, moved to near bounds unless Ctrl-C ended the run."""
        point: Linearization = self.first if self.best is None else self.best.z
        is_interrupted = end is TerminationReason.INTERRUPTED
        if not is_interrupted:
            point = self._snap(point)
        certificate = point.certificate
        passes = certificate.meets(self.settings)
        is_limited = not (passes or is_interrupted) and certificate.is_limited_by_rounding
        self.best = Measured(point, point.residual, passes, is_limited)
        status, newton = self.status(end), self.newton
        named: dict[str, Any] = {"algorithm": newton.name, "_asked": newton, "_advice": WORDS}
        return self.result_at(certificate, status, **named)


TANGENTS = (
    "each iteration replaces F by its tangent at x and solves the linear problem that this gives"
)


def jacobian_warning(point: Linearization) -> str:
    """Return a warning with the row in which differences and jacobian differ most, or "".

    Parameters
    ----------
    point : Linearization
        The start. F is evaluated at two points along one random direction that leads into the bounds.
    """
    x, problem = point.x, point.problem
    M = sp.csr_array(problem.call_jacobian(x, point.value)[0])
    random = np.random.default_rng(0)
    size = np.maximum(np.abs(x), 1.0) * random.uniform(0.5, 1.0, x.size)
    direction = np.where(random.random(x.size) < 0.5, -size, size)
    direction = np.where(x - problem.lower < CHECKED[1] * size, size, direction)
    direction = np.where(problem.upper - x < CHECKED[1] * size, -size, direction)
    slope, terms = M @ direction, abs(M) @ size
    quotients = [(problem.value(x + step * direction) - point.value) / step for step in CHECKED]
    wrong = np.minimum(*(np.abs(one - slope) / (terms + np.abs(one)) for one in quotients))
    wrong = np.where(np.isfinite(wrong), wrong, 0.0)
    if not wrong.max(initial=0.0) > WRONG:
        return ""
    i = int(np.argmax(wrong))
    return (
        f"jacobian disagrees with F at the start: along one direction row {i} of jacobian(x0) gives {slope[i]:.6g}, "
        f"and differences of F give {quotients[0][i]:.6g}; correct it, or leave it out"
    )
