"""solve_nonlinear(): Josephy–Newton in the common loop, measured by the criterion of LCPs.

A run takes its steps (:mod:`lcp_plugin.problems.nonlinear.steps`) by two searches. The monotone search accepts steps
that reduce the merit ‖Φ‖₂. The nonmonotone search compares with the worst of four points, and takes a full Newton step
if its residual is at most ten times the least of these: on traffic networks the residual rises before it falls. Then
both begin again at other points of the bounds: the nearest ones to 1, 0, 10 and 0.1, and random ones.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator
from dataclasses import replace
from functools import lru_cache, partial
from typing import Any, ClassVar

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike

from ...core.algorithm import Algorithm, Step
from ...core.checks import Vector, read_only, vector_option
from ...core.deadline import is_over
from ...core.errors import InvalidOption, InvalidProblem
from ...core.kernels.floats import NEGLIGIBLE, NEGLIGIBLE_DIAGONAL
from ...core.kernels.threads import threads_for
from ...core.names import Names
from ...core.settings import DEFAULT, Settings, Status, whole_number
from ...judges.lcp import Measured, RowData, row_data
from ...methods.finishing import measure_finished
from ...methods.newton import fischer_burmeister
from ...solving.dispatch import method_of
from ...solving.result import Callback, Result
from ...solving.run import Progress, Run, Stage
from ..programs.no_minimum import proof_of_contradiction
from .data import DENSE_PATTERN_UP_TO, Evaluations, Linearization, NonlinearProblem
from .full_steps import take_full_steps
from .steps import Target, row_scale, targets

SEARCHES = {"monotone": 1, "nonmonotone": 4}  # points with whose worst merit a step is compared
TRIALS = 12  # points on a line where F is defined
RESTARTS = 10  # from other points, after the searches that stalled
NEAREST_TO = 1.0, 0.0, 10.0, 0.1  # the first other starts
RESTARTS_UP_TO = 1000  # unknowns; beyond, a new start is too expensive


class JosephyNewton(Algorithm):
    """Josephy–Newton with line searches on the merit ‖Φ‖₂, and restarts.

    It is one class because steps, searches and restarts share one point and its merit.

    Parameters
    ----------
    start : Linearization
    linear : str or Algorithm
        Algorithm for the linearizations.
    settings : Settings
        Of the run.
    searches : tuple of str
        The names of searches, in order.
    restarts : int
        Number of further starts.
    """

    name: ClassVar[str] = "josephy_newton"
    is_monotone: ClassVar[bool] = False

    def __init__(
        self,
        start: Linearization,
        linear: str | Algorithm,
        settings: Settings,
        searches: tuple[str, ...] = tuple(SEARCHES),
        restarts: int = RESTARTS,
    ) -> None:
        self.first = self.here = self.tried = start
        self.linear, self.settings, self.tolerance = linear, settings, settings.goal
        self.searches, self.restarts = searches, restarts
        self.limit: Any = np.inf  # of |x|: farther unknowns have grown without limit
        self.work, self.kind, self.length = 1.0, "start", 0.0
        self.recent: deque[Linearization] = deque([start], 1)
        self.passed: dict[bytes, Linearization] = {}  # points of full steps, to be taken again
        self._weights: Any = None

    @property
    def weights(self) -> Vector:
        """1/reference of the component of each row at the start; shape (1,) for one component."""
        if self._weights is None:
            self._weights = np.ones(1)
            if self.first.data.labels is not None:
                unit = self.first.data.references[1]
                is_usable = (unit > 0.0) & np.isfinite(unit)
                self._weights = 1.0 / np.where(is_usable, unit, 1.0)
        return self._weights

    def iterates(self, problem: Any, z0: Any) -> Iterator[Step]:
        """Yield the start, then the point of each step, until no step or restart helps."""
        yield self.step()
        for search in self.searches:
            yield from self.steps_from(self.first, search)
            if self.is_at_floor() or is_over():
                return
        random = np.random.default_rng(0)
        for k in range(self.restarts if self.first.x.size <= RESTARTS_UP_TO else 0):
            start = self.other_start(k, random)
            if start is None:
                continue
            for search in self.searches:
                self.here, self.kind, self.length = start, "restart", 0.0
                yield self.step()
                yield from self.steps_from(start, search)
                if self.is_at_floor() or is_over():
                    return

    def step(self) -> Step:
        """Return the point here as a step, with the work since the last one."""
        work, self.work, note = self.work, 0.0, ""
        if self.settings.verbose:
            problem, worst = self.here.problem, int(np.argmax(np.abs(self.here.steps)))
            F, slopes, _ = problem.counts
            note = f"  {self.kind}, length {self.length:.2g}; worst {problem.names.row(worst)}; F {F}, F′ {slopes}"
        return Step(self.here.x, work=work, measured=self.here, note=note)

    def steps_from(self, start: Linearization, search: str) -> Iterator[Step]:
        """Yield steps from a point until none helps, or none has for long."""
        self.here, self.recent = start, deque([start], SEARCHES[search])
        # A jump of the residual may start a long decrease
        latest, since, grown = deque([self.progress(start)], maxlen=12), 0, 0
        least, idle = latest[0], 0
        # 25 steps without a residual clearly below the residuals before it, or 50 without a new least residual
        while since < 25 and idle < 50 and (following := self._next_point()) is not None:
            self.here = following = self.snap(following)
            self.recent.append(following)
            yield self.step()
            size = self.progress(following)
            since = 0 if size < 0.95 * min(latest) else since + 1
            least, idle = (size, 0) if size < 0.95 * least else (least, idle + 1)
            latest.append(size)
            if since and self.is_at_floor():
                return
            grown = grown + 1 if following.is_endless(self.settings) else 0
            if grown == 3:  # points that would pass if no unknown moved on
                end = np.where(following.data.growing, np.abs(following.x), np.inf)
                self.limit = np.minimum(self.limit, end)
                return

    def snap(self, point: Linearization) -> Linearization:
        """Return the point with x° in the components that F(x°) solves, and that x has come near."""
        origin, data = point.origin, point.data
        left, way = (data.largest(np.abs(x - origin.x)) for x in (point.x, self.first.x))
        is_near = left <= 1e-4 * way
        if not np.logical_or.reduce(is_near):
            return point
        errors = np.abs(data.residual(origin.x, origin.value))
        x = np.where(is_near & (data.largest(errors) == 0.0), origin.x, point.x)
        there = point if np.array_equal(x, point.x) else self._at(x)
        return there if there.is_defined and there.residual <= point.residual else point

    def other_start(self, k: int, random: np.random.Generator) -> Linearization | None:
        """Return start number k other than x₀; None if F is not defined there.

        The first ones are the points of the bounds nearest to some numbers; every second one of the random others is
        log-uniform above the lower bounds.
        """
        x, lower, upper = self.first.x, self.first.problem.lower, self.first.problem.upper
        size, n = np.maximum(1.0, np.abs(x)), x.size
        drawn = np.full(n, ((1.0, 0.0, 10.0, 0.1))[min(k, 3)])
        if k > 3:
            drawn = x + size * random.standard_normal(n) * 0.5 * k
        if k > 3 and k % 2:
            common, own = random.uniform(-3.0, 0.0), random.uniform(-1.0, 1.0, n)
            above = lower + size * 10.0 ** (common + own)
            drawn = np.where(np.isfinite(lower), above, drawn)
        point = self.first.at(np.clip(drawn, lower, upper))
        return point if point.is_defined else None

    # --- one step ----------------------------------------------------------------------------------------

    def _next_point(self) -> Linearization | None:
        """Return the next point; None if no step helps, the time is over, or rounding explains the residual."""
        here = self.here
        if not here.steps.any():
            return None
        if here.is_small(self.settings):  # rows in the far field fail
            point = self._at(measure_finished(row_data(here.lcp), here.x, self.tolerance).z)
            if (
                point.is_defined
                and point.certificate.term_residual < here.certificate.term_residual
            ):
                self.kind = "finish"
                return point
        if self.is_flat():  # a root without slope
            sizes = np.abs(here.x)
            flushed = np.where(sizes <= NEGLIGIBLE_DIAGONAL * sizes.max(), here.origin.x, here.x)
            if (point := self._at(flushed)).is_defined and point.passes(self.settings):
                self.kind = "limit"
                return point
        for target in targets(self.here, self.linear, self.tolerance):
            self.kind, self.length = target.kind, 1.0
            found = self.full_step(target) or self.search(target)
            if found is not None or is_over() or (target.kind == "Newton" and self.is_at_floor()):
                return found
        return None

    def is_flat(self) -> bool:
        """Return whether the residual is negligible next to the first one."""
        return self.size_of(self.here) <= NEGLIGIBLE * self.size_of(self.first)

    def full_step(self, target: Target) -> Linearization | None:
        """Return the target if it has less than half of the residual here, in the scale here."""
        here, point = self.here, self._at(target.x)
        there = here.data.residual(point.x, point.value)
        sizes = [np.maximum.reduce(np.abs(self.weights * one)) for one in (there, here.steps)]
        return point if sizes[0] < 0.5 * sizes[1] and point.is_defined else None

    def search(self, target: Target) -> Linearization | None:
        """Return the first point on the way to the target that is better."""
        here, is_newton, tried = self.here, target.kind == "Newton", 0
        worst = target.share * max(map(self._merit, self.recent if is_newton else (here,)))
        for length in target.lengths:
            x = target.x if length == 1.0 else here.x + length * (target.x - here.x)
            if tried == TRIALS or (x == here.x).all():
                break
            point = self._at(x)
            if not np.logical_and.reduce(np.isfinite(point.value)):
                continue
            tried += 1
            # ∞ gains nothing on ∞
            is_better = self._merit(point) < (1.0 - 1e-4 * length) * worst
            is_lenient = is_newton and length == 1.0 and len(self.recent) > 1
            if not (is_better or is_lenient) or not point.is_defined:
                continue
            if is_better or point.residual <= 10.0 * min(one.residual for one in self.recent):
                self.length = length
                return point
        return None

    def _at(self, x: Vector) -> Linearization:
        """Return the linearization at x; its F is computed once if the next search begins there."""
        if not np.array_equal(x, self.tried.x):
            self.work += 1.0
            self.tried = self.passed.pop(x.tobytes(), None) or self.first.at(x)  # type: ignore[arg-type]
        return self.tried

    # --- what is measured ----------------------------------------------------------------------------------

    def _merit(self, point: Linearization) -> float:
        """Return ‖Φ‖₂ with the row scales of the linearization here; ∞ if F is undefined."""
        if not np.isfinite(point.value).all():
            return math.inf
        return float(np.linalg.norm(self.weights * self.phi(point)))

    def phi(self, point: Linearization) -> Vector:
        """Return Φ with the row scales of the linearization here."""
        return fischer_burmeister(point.problem, point.x, point.value, row_scale(self.here)).value

    def is_at_floor(self) -> bool:
        """Return whether only rounding in F keeps the point here from passing."""
        return self.here.is_limited(self.settings)

    def size_of(self, point: Linearization) -> float:
        """Return the largest residual or violation, in the units of the start.

        Next to a pole only the residual falls, because x_i approaches its bound; if F tends to 0 as x diverges, only
        the violation falls.
        """
        if point.size is None:
            problem, x, w = point.problem, point.x, point.value
            violation = np.maximum(w * (x > problem.lower), -w * (x < problem.upper))
            sizes = np.maximum(np.abs(point.steps), violation / self.first.data.scale)
            point.size = float(np.maximum.reduce(self.weights * sizes, initial=0.0))
        return point.size

    def progress(self, point: Linearization) -> float:
        """Return the measure that must fall: the size, and then the componentwise test."""
        size = self.size_of(point)
        if point.is_small(self.settings):
            size *= min(1.0, float(point.measure(self.settings).by_row.terms.max(initial=0.0)))
        return size


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
    settings = Settings(**options) if options else DEFAULT
    if algorithm != "auto":
        method_of(algorithm, {})
    if search not in (None, *SEARCHES):
        words = " or ".join([", ".join(f'"{name}"' for name in SEARCHES), "None"])
        raise InvalidOption(f"search must be {words}, got {search!r}")
    restarts = whole_number(restarts, "restarts", 0)
    start = _checked_start(problem, x0)
    problem = problem.counted(start.size)
    progress = Progress(problem, settings, callback)
    start = read_only(np.clip(start, problem.lower, problem.upper))
    with threads_for(settings.threads):
        first, begun = begin_at(Linearization(problem, start))
        searches = tuple(SEARCHES) if search is None else (search,)
        has_doubts, found = check_jacobian and problem.jacobian is not None, None
        make = partial(JosephyNewton, first, algorithm, settings, searches, restarts)
        run = NonlinearRun(make(), progress, has_doubts=has_doubts)
        try:
            if has_doubts:
                begun = "; ".join(filter(None, (begun, jacobian_warning(first))))
            if searches[0] == "monotone" and not progress.is_watched:
                found = run.leap(begun)
            if found is None:
                passed, run.newton = run.newton.passed, make()
                newton, run.newton.passed = run.newton, passed
                stage = Stage(newton, TANGENTS, steps=newton.iterates(problem, first.x))
                end = run.follow_all([stage])
        except KeyboardInterrupt:
            end = Status.INTERRUPTED
        return replace(run.result(end), begun=begun) if found is None else found


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

    def leap(self, begun: str) -> Result | None:
        """Return the result if a few Newton steps lead to a point that passes; its record is made on access."""
        newton, progress = self.newton, self.progress
        setup, limit = progress.clock.read(), self.settings.max_seconds
        point, count = take_full_steps(newton, lambda: progress.clock.read() >= limit)
        if point is None or not self._passes(point := self._snap(point)):
            return None
        stage = Stage(newton, TANGENTS, iterations=count, work=count + 1.0)
        progress.stages, progress.iteration, progress.work = [stage], count, stage.work
        self.best = Measured(point, 0.0, True)
        now: dict[str, Any] = {"begun": begun, "evaluations": Evaluations(*point.problem.counts)}
        now |= {"_asked": newton, "_advice": WORDS, "z": point.x, "status": Status.SOLVED}
        seconds = {"seconds": progress.clock.read(), "setup_seconds": setup}
        return Result.of_known(partial(self._record, now | seconds), **now)

    def _record(self, known: dict[str, Any]) -> Result:
        """Return the result of :meth:`leap` with all fields."""
        return replace(self.result(Status.SOLVED), **known)

    def measure(self, stage: Stage, step: Step) -> Measured:
        """Return the linearization at the point of a step; if its residual is small, at bounds that are near."""
        point: Linearization = step.measured
        if point.is_small(self.settings):
            point = self._snap(point)
        is_shown = self.progress.is_watched
        size = point.residual if is_shown else self.newton.size_of(point)
        return Measured(point, size, self._passes(point))

    def keep(self, found: Measured) -> None:
        """Keep a point that passes, or whose violation in the units of the start is the least."""
        point, scale = found.z, self.newton.first.data.scale
        violation = np.maximum(
            point.value * (point.x > point.problem.lower),
            -point.value * (point.x < point.problem.upper),
        )
        size = float(np.maximum.reduce(self.newton.weights * violation / scale, initial=0.0))
        super().keep(found._replace(residual=size))

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
        x = point.data.snap_to_bounds(point.x, point.value)
        if np.array_equal(x, point.x) or not (moved := point.at(x)).is_defined:
            return point
        meets = [one.passes(self.settings) for one in (point, moved)]
        is_no_worse = moved.residual <= point.residual if meets[0] == meets[1] else meets[1]
        return moved if is_no_worse else point

    def end_of(self, stage: Stage, step: Step, found: Measured) -> Status | None:
        """Return DIVERGED if a residual is not a number."""
        return Status.DIVERGED if math.isnan(self.newton.size_of(found.z)) else None

    def result(self, end: Status) -> Result:
        """Return the result: the best point, moved to near bounds unless Ctrl-C ended the run."""
        newton, is_interrupted = self.newton, end is Status.INTERRUPTED
        point: Linearization = newton.first if self.best is None else self.best.z
        passes = self.best is not None and self.best.passes
        if not (passes or is_interrupted):
            # Rounding in one row decides which point is best, and other rows may be better at the last one
            point = self._snap(newton.here if newton.is_at_floor() else point)
            passes = self._passes(point)
        is_open = not (passes or is_interrupted or self._is_far(point))
        is_limited = is_open and point.is_limited(self.settings)
        self.best = Measured(point, 0.0, passes, is_limited)
        status = self.status(end)
        words = {**WORDS, Status.STALLED: GROWING} if self._is_far(point) else WORDS
        named: dict[str, Any] = {"algorithm": newton.name, "_asked": newton, "_advice": words}
        named["evaluations"] = Evaluations(*newton.first.problem.counts)
        if status is Status.STALLED and (part := point.problem.affine_part) is not None:
            proof = proof_of_contradiction(part())
            status = status if proof is None else Status.INFEASIBLE
            named["infeasibility"] = proof
        return self.result_at(point.certificate, status, **named)


def with_trusted_derivative(point: Linearization) -> Linearization:
    """Return the linearization, by differences of F if they disagree with the jacobian."""
    problem = point.problem
    if problem.jacobian is None or not jacobian_warning(point):
        return point
    pattern = None if point.x.size <= DENSE_PATTERN_UP_TO else sp.csr_array(point.M)
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
    return at.data, at.x, at.value, problem.names


TANGENTS = (
    "each iteration replaces F by its tangent at x and solves the linear problem that this gives"
)


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
    x, problem = point.x, point.problem
    M = point.M
    shares, signs = _drawn(x.size)
    size = np.maximum(np.abs(x), 1.0) * shares
    direction = size * signs
    direction = np.where(x - problem.lower < CHECKED[1] * size, size, direction)
    direction = np.where(problem.upper - x < CHECKED[1] * size, -size, direction)
    slope, terms = M @ direction, abs(M) @ size
    there = [read_only(x + step * direction) for step in CHECKED]
    quotients = [
        (problem.evaluate(one) - point.value) / step
        for one, step in zip(there, CHECKED, strict=True)
    ]
    wrong = np.minimum(*(np.abs(one - slope) / (terms + np.abs(one)) for one in quotients))
    wrong = np.where(np.isfinite(wrong), wrong, 0.0)
    if not wrong.max(initial=0.0) > 0.1:
        return ""
    i = int(np.argmax(wrong))
    return (
        f"jacobian disagrees with F at the start: along one direction {problem.names.row(i)} of jacobian(x0) gives "
        f"{slope[i]:.6g}, and differences of F give {quotients[0][i]:.6g}; correct it, or leave it out"
    )
