"""solve_nonlinear(): Josephy–Newton in the common loop, measured by the criterion of LCPs.

Josephy–Newton: each step solves the LCP of the linearization with the algorithms of `solve`.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator
from dataclasses import replace
from typing import Any, ClassVar

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike

from ...core.algorithm import Algorithm, Step
from ...core.checks import Vector, read_only, vector_option
from ...core.deadline import Clock, is_over, seconds_left
from ...core.errors import InvalidOption, InvalidProblem, UnsuitableMatrix, UnsuitableProblem
from ...core.kernels.threads import threads_for
from ...core.lcp import LCP
from ...core.names import Names
from ...core.settings import Settings, Status
from ...judges.lcp import Measured, RowData, row_data
from ...methods.lemke import Lemke
from ...methods.newton import Newton, fischer_burmeister
from ...methods.small import takes_rounds
from ...solving.dispatch import method_of
from ...solving.lcp_run import LCPRun
from ...solving.plan import plan
from ...solving.result import Callback, Result
from ...solving.run import Progress, Run, Stage
from ..programs.no_minimum import proof_of_contradiction
from .data import DENSE_PATTERN_UP_TO, Linearization, NonlinearProblem

MEMORY = 4  # the line search compares with the worst of so many points
SHIFTS = 0.0, 1e-3, 1e-1, 10.0  # of the residual scale: Newton, then proximal steps
FORCING = 0.01  # of the residual here: tolerance of a linearization far from a solution
SMALLEST_TOLERANCE = 1e-14  # relative residuals of linearizations are rounding below it
RESTARTS = 4  # from random points, after a run that stalled


class JosephyNewton(Algorithm):
    """Josephy–Newton with a non-monotone line search: x⁺ solves the LCP of M = F′(x), q = F(x) − F′(x) x.

    Parameters
    ----------
    start : Linearization
    linear : str or Algorithm
        Algorithm for the linearizations.
    tolerance : float
        The requested relative residual.

    Notes
    -----
    The merit is ‖Φ‖₂. Φ is the Fischer–Burmeister function with F(x) for w, scaled by the largest entry of each row of
    F′ at the current point. The diagonal is not used, because it may vanish with x: the diagonal of a convex power is
    zero at 0. A step is halved until F is defined and ‖Φ‖ falls below the worst of the last four
    points. A full Newton step is also taken if its residual is at most ten times the least residual of these points:
    on traffic networks the residual rises before it falls. If no step helps, the LCP of F′(x) + μD is solved for
    larger and larger μ, D the residual scale (proximal steps). After that, small problems are restarted from other
    points.

    References
    ----------
    N. H. Josephy, *Newton's method for generalized equations*, MRC report 1965, Wisconsin 1979.
    """

    name: ClassVar[str] = "josephy_newton"
    is_monotone: ClassVar[bool] = False

    def __init__(self, start: Linearization, linear: str | Algorithm, tolerance: float) -> None:
        self.first = self.here = start
        self.linear, self.tolerance = linear, tolerance
        self.limit: Any = np.inf  # of |x|: farther unknowns have grown without limit
        self.recent: deque[Linearization] = deque([start], maxlen=MEMORY)
        self.work, self.starts = 1.0, 0
        # of linearizations without a solution; steps until the next one is tried
        self.failures = self.waits = 0
        # 1/reference of the component of each row; shape (1,) for one component
        unit = row_data(start.lcp).references[1]
        is_usable = (unit.size > 1) & (unit > 0.0) & np.isfinite(unit)
        self.weights: Vector = 1.0 / np.where(is_usable, unit, 1.0)
        self.random = np.random.default_rng(0)

    def iterates(self, problem: LCP, z0: Vector) -> Iterator[Step]:
        """Yield the start, then the point of each step, until no step or restart helps."""
        yield self.step()
        # Beyond 1000 unknowns a new start is too expensive
        for _ in range(RESTARTS if self.first.x.size <= 1000 else 0):
            yield from self.steps()
            if self.is_at_floor() or not self.start_elsewhere():
                return
            yield self.step()
        yield from self.steps()

    def step(self) -> Step:
        """Return the point here as a step, with the work since the last one."""
        work, self.work = self.work, 0.0
        return Step(self.here.x, work=work, measured=self.here)

    def steps(self) -> Iterator[Step]:
        """Yield steps from here until none helps, or none has for long."""
        # A jump of the residual may start a long decrease
        latest, since, grown = deque([self._progress(self.here)], maxlen=12), 0, 0
        # 25 steps without a residual clearly below the residuals of the window before it
        while since < 25 and (following := self._next_point()) is not None:
            self.here = following = self._snap(following)
            self.recent.append(following)
            yield self.step()
            size = self._progress(following)
            # A jump of the residual may start a long decrease
            since = 0 if size < 0.95 * min(latest) else since + 1
            latest.append(size)
            if since and self.is_at_floor():
                return
            is_small = following.residual <= self.tolerance
            data: Any = following.certificate.criterion
            grown = grown + 1 if is_small and data.growing.any() else 0
            if grown == 3:  # steps with small residuals from which an unknown grows
                end = np.where(data.growing, np.abs(following.x), np.inf)
                self.limit = np.minimum(self.limit, end)
                return

    def _snap(self, point: Linearization) -> Linearization:
        """Return the point with x° in the components that F(x°) solves, and that x has come near."""
        origin, data = point.origin, row_data(point.lcp)
        errors = np.abs(data.residual(origin.x, origin.value))
        left, way = (data.largest(np.abs(x - origin.x)) for x in (point.x, self.first.x))
        is_reached = (data.largest(errors) == 0.0) & (left <= 1e-4 * way)
        x = np.where(is_reached, origin.x, point.x)
        there = point if np.array_equal(x, point.x) else self._at(x)
        return there if there.is_defined and there.residual <= point.residual else point

    def start_elsewhere(self) -> bool:
        """Go to another point of the bounds where F is defined; return whether there is one."""
        problem, size = self.first.problem, np.maximum(1.0, np.abs(self.first.x))
        for _ in range(RESTARTS):
            self.starts += 1
            if self.starts == 1:
                x = np.clip(1.0, problem.lower, problem.upper)
            else:
                x = self.first.x + size * self.random.standard_normal(size.size) * 0.5 * self.starts
            point = self._at(np.clip(x, problem.lower, problem.upper))
            if point.is_defined:
                self.here = point
                self.recent = deque([point], maxlen=MEMORY)
                return True
        return False

    # --- one step ----------------------------------------------------------------------------------------

    def _next_point(self) -> Linearization | None:
        """Return the next point; None if no step helps, the time is over, or rounding explains the residual."""
        if not self.here.certificate.by_row.high.any():
            return None
        self.waits -= 1
        for shift in SHIFTS[1:] if self.waits > 0 else SHIFTS:
            target = self._solution(shift)
            if shift == 0.0:
                self.failures = self.failures + 1 if target is None else 0
                self.waits = 2**self.failures - 1
            found = None if target is None else self._search(target, is_newton=shift == 0.0)
            if found is not None or is_over() or self.is_at_floor():
                return found
        return None

    def _search(self, target: Vector, *, is_newton: bool) -> Linearization | None:
        """Return the first point on the way to the target that is better."""
        here, allowed = self.here, 10.0 * min(point.residual for point in self.recent)
        worst = max(map(self._merit, self.recent)) if is_newton else self._merit(here)
        for k in range(30):
            x = target if k == 0 else here.x + 0.5**k * (target - here.x)
            point, least = self._at(x), (1.0 - 1e-4 * 0.5**k) * worst
            if np.array_equal(x, here.x) or not np.isfinite(point.value).all():
                continue
            is_better = self._merit(point) < least  # ∞ gains nothing on ∞
            if not (is_better or (is_newton and k == 0)) or not point.is_defined:
                continue
            if is_better or point.residual <= allowed < math.inf:
                return point
        return None

    def _at(self, x: Vector) -> Linearization:
        self.work += 1.0
        return self.first.at(x)

    # --- what is measured ----------------------------------------------------------------------------------

    def _merit(self, point: Linearization) -> float:
        """Return ‖Φ‖₂ with the row scales of the linearization here; ∞ if F is undefined."""
        if not np.isfinite(point.value).all():
            return math.inf
        lcp = self.here.lcp
        phi = fischer_burmeister(lcp, point.x, point.value, lcp.matrix.row_largest)
        return float(np.linalg.norm(self.weights * phi.value))

    def is_at_floor(self) -> bool:
        """Return whether only rounding in F keeps the point here from passing."""
        return self.here.is_limited(Settings(self.tolerance))

    def _progress(self, point: Linearization) -> float:
        """Return the measure that must fall: residuals and violations, and then the componentwise test.

        Next to a pole only the residual falls, because x_i approaches its bound; if F tends to 0 as x diverges, only
        the violation falls. Both are in the units of the start.
        """
        certificate, scale = point.certificate, self.first.lcp.residual_scale
        sizes = np.maximum(certificate.by_row.high, certificate.rows.violation / scale)
        size = float((self.weights * sizes).max(initial=0.0))
        is_small = point.residual <= max(self.tolerance, SMALLEST_TOLERANCE)
        return size * min(1.0, certificate.term_residual) if is_small else size

    def _solution(self, shift: float) -> Vector | None:
        """Return a solution of (M + shift D)(x⁺ − x) + F(x) on the bounds, or None.

        The tolerance is tied to the relative residual at x. The unknown is x⁺ − x, because the residual at x is
        then the reference, and of several solutions one near x is found.
        """
        lcp, w = self.here.lcp, self.here.value
        if shift:
            added = sp.diags_array(shift * lcp.residual_scale)
            M = lcp.M + (added if sp.issparse(lcp.M) else added.toarray())
            lcp = LCP(M, lcp.q, lower=lcp.lower, upper=lcp.upper)
        x = self.here.x
        step = lcp.with_q(w, lower=lcp.lower - x, upper=lcp.upper - x)
        relative = self.here.residual
        # A linearization needs no smaller residual than a tenth of the tolerance
        enough = FORCING
        if relative > 0.0:
            enough = max(0.1 * self.tolerance / relative, SMALLEST_TOLERANCE)
        tolerance = min(max(relative, enough), FORCING)
        try:
            result = solve_within(step, self.linear, tolerance)
        except (UnsuitableMatrix, UnsuitableProblem):  # the algorithm does not take this one
            if self.linear == "auto":
                raise
            result = solve_within(step, "auto", tolerance)
        self.work += result.work
        if not (result.is_solved or result.residual <= 0.5):
            return None
        target = np.clip(x + result.z, lcp.lower, lcp.upper)
        # the sum may have missed the bound
        target = np.where(result.z <= step.lower, lcp.lower, target)
        return np.where(result.z >= step.upper, lcp.upper, target)


def _stages_of_step(problem: LCP, method: Algorithm | None, goal: float) -> Iterator[Stage]:
    """Yield the stages of a linearization: no proofs, pivots last, and no method twice."""
    tried: list[Algorithm] = []
    has_bounds = np.isfinite(problem.lower).any() or np.isfinite(problem.upper).any()
    if method is None and not (has_bounds or takes_rounds(problem)):
        yield Stage(Newton(), "no bounds: a linear system")
    for stage in plan(problem, method, goal, prove_infeasibility=False):
        if stage.algorithm in tried:
            return
        if tried and isinstance(stage.algorithm, Lemke):
            stage.algorithm = Lemke(restarts=2)
        tried.append(stage.algorithm)
        yield stage
        if isinstance(stage.algorithm, Lemke):
            return


def solve_within(problem: LCP, algorithm: str | Algorithm, tolerance: float) -> Result:
    """Solve a linearization within the limits of the current run; Ctrl-C ends both runs.

    The start is the projected gradient step, so that the methods find a solution near it.
    """
    left, clock = seconds_left(), Clock()
    method = method_of(algorithm, {})
    limit = None if left == math.inf else left
    settings = Settings(tolerance, max_seconds=limit, polish=False)
    step = np.nan_to_num(-problem.q / problem.residual_scale)
    start = np.clip(step, problem.lower, problem.upper)
    run = LCPRun(problem, method, settings, None, clock, start)
    stages = _stages_of_step(problem, method, run.goal)
    return run.result(run.follow_all(stages))


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
        ``help("lcp_plugin.problems.nonlinear.data")``.
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
        Compare the `jacobian` with differences of F, near the start and where x passes. ``explain()`` names the row
        with the largest deviation at the start. If they differ, x is SOLVED only if it passes with differences also.
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
    ``help("lcp_plugin.problems.nonlinear.solving")``.

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
    settings = Settings(**options)
    method_of(algorithm, {})
    start = _checked_start(problem, x0)
    problem = problem.with_size(start.size)
    progress = Progress(problem, settings, callback)
    start = read_only(np.clip(start, problem.lower, problem.upper))
    with threads_for(settings.threads):
        first, begun = begin_at(Linearization(problem, start))
        newton = JosephyNewton(first, algorithm, settings.goal)
        has_doubts = check_jacobian and problem.jacobian is not None
        run = NonlinearRun(newton, progress, has_doubts=has_doubts)
        try:
            if has_doubts:
                begun = "; ".join(filter(None, (begun, jacobian_warning(first))))
            stage = Stage(newton, TANGENTS, steps=newton.iterates(first.lcp, first.x))
            end = run.follow_all([stage])
        except KeyboardInterrupt:
            end = Status.INTERRUPTED
        return replace(run.result(end), begun=begun)


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


def _checked_start(problem: NonlinearProblem, x0: ArrayLike | None) -> Vector:
    if x0 is None:
        if problem.n is None:
            raise InvalidOption(
                "x0 is needed because the number of unknowns is not known; pass x0 (z0 in solve_batch)"
            )
        return np.zeros(problem.n)
    return vector_option(x0, "x0", problem.n, may_be_number=True)


WORDS = {
    Status.SOLVED: "the residual is within the tolerance, as measured on F",
    Status.PRECISION_LIMIT: "rounding in F, as estimated, explains the residual; next: accept z, or scale F",
    Status.STALLED: (
        "no step reduces the residual: z may be a local minimum of the residual; next: try another start x0"
    ),
    Status.DIVERGED: "the residual left every reasonable range; next: try another start x0, or bounds near it",
    Status.MAX_ITERATIONS: "iteration limit reached; next: raise max_iterations, or continue from x0=result.z",
    Status.MAX_SECONDS: "time limit reached; next: raise max_seconds, or continue from x0=result.z",
    Status.INTERRUPTED: Status.INTERRUPTED.value,
}


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
        if point.residual <= self.settings.goal:
            point = self._snap(point)
        passes = self._passes(point)
        return Measured(point, point.residual, passes)

    def _is_far(self, point: Linearization) -> bool:
        """Return whether an unknown is as large as at a point from which it grew."""
        return bool((np.abs(point.x) >= self.newton.limit).any())

    def _passes(self, point: Linearization) -> bool:
        """Return whether a point passes, with differences also if they disagree with the jacobian."""
        if self._is_far(point) or not point.measure(self.settings).passes:
            return False
        there = with_trusted_derivative(point) if self.has_doubts else point
        return there is point or (there.is_defined and there.measure(self.settings).passes)

    def _snap(self, point: Linearization) -> Linearization:
        """Return the linearization after entries near bounds are moved there, unless only the point itself passes."""
        x = row_data(point.lcp).snap_to_bounds(point.x, point.value)
        if np.array_equal(x, point.x) or not (moved := point.at(x)).is_defined:
            return point
        meets = [bool(one.measure(self.settings).passes) for one in (point, moved)]
        is_no_worse = moved.residual <= point.residual if meets[0] == meets[1] else meets[1]
        return moved if is_no_worse else point

    def end_of(self, stage: Stage, step: Step, found: Measured) -> Status | None:
        """Return DIVERGED if a residual is not a number."""
        return Status.DIVERGED if math.isnan(found.residual) else None

    def result(self, end: Status) -> Result:
        """Return the result: the best point, moved to near bounds unless Ctrl-C ended the run."""
        newton, is_interrupted = self.newton, end is Status.INTERRUPTED
        point: Linearization = newton.first if self.best is None else self.best.z
        # Rounding in one row decides which point is best, and other rows may be better at the last one
        if not (self._passes(point) or is_interrupted) and newton.is_at_floor():
            point = newton.here
        if not is_interrupted:
            point = self._snap(point)
        certificate = point.certificate
        passes = self._passes(point)
        is_open = not (passes or is_interrupted or self._is_far(point))
        is_limited = is_open and point.is_limited(self.settings)
        self.best = Measured(point, point.residual, passes, is_limited)
        status = self.status(end)
        words = {**WORDS, Status.STALLED: GROWING} if self._is_far(point) else WORDS
        named: dict[str, Any] = {"algorithm": newton.name, "_asked": newton, "_advice": words}
        if status is Status.STALLED and (part := point.problem.affine_part) is not None:
            proof = proof_of_contradiction(part())
            status = status if proof is None else Status.INFEASIBLE
            named["infeasibility"] = proof
        return self.result_at(certificate, status, **named)


def with_trusted_derivative(point: Linearization) -> Linearization:
    """Return the linearization, by differences of F if they disagree with the jacobian."""
    problem = point.problem
    if problem.jacobian is None or not jacobian_warning(point):
        return point
    pattern = None if point.lcp.n <= DENSE_PATTERN_UP_TO else point.lcp.csr
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
    return at.certificate.criterion, at.x, at.value, problem.names


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
    if not wrong.max(initial=0.0) > 0.1:
        return ""
    i = int(np.argmax(wrong))
    return (
        f"jacobian disagrees with F at the start: along one direction {problem.names.row(i)} of jacobian(x0) gives "
        f"{slope[i]:.6g}, and differences of F give {quotients[0][i]:.6g}; correct it, or leave it out"
    )
