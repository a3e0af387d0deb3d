"""Josephy–Newton: each step solves the LCP of the linearization with the algorithms of `solve`."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
import scipy.sparse as sp

from ...auto import method_of, plan
from ...core.algorithm import Algorithm, Step
from ...core.certificates.criterion import references_of_components, row_data
from ...core.checks import FloatVector
from ...core.deadline import Clock, is_over, seconds_left
from ...core.errors import UnsuitableMatrix, UnsuitableProblem
from ...core.lcp import LCP
from ...core.settings import Settings
from ...core.solving.lcp_run import LCPRun
from ...core.solving.result import Result
from ...core.solving.stage import Stage
from ...methods.lemke import Lemke
from ...methods.newton.semismooth_newton import fischer_burmeister
from .certificate import Linearization, Linearizations

SUFFICIENT = 1e-4
SHORTER = 30  # times a step is halved
GROWTH = 10.0  # of the residual, by which a full step may miss the least one
MEMORY = 4  # the line search compares with the worst of so many points
SHIFTS = 0.0, 1e-3, 1e-1, 10.0  # of the residual scale: Newton, then proximal steps
FORCING = 0.01  # of the residual here: tolerance of a linearization far from a solution
SMALLEST_TOLERANCE = 1e-14
ENOUGH = 0.1  # of the tolerance of the run: a linearization needs no smaller residual
PATIENCE = 25  # steps without a residual clearly below the residuals of the window before it
WINDOW, GAIN = 12, 0.95  # a jump of the residual may start a long decrease
RESTARTS, SMALL = 4, 1000  # starts; unknowns, beyond which a new start is too expensive
PATHS = 2  # of pivots
NEARLY_THERE = 1e-4  # of the way from the start to x°


@dataclass(frozen=True, kw_only=True)
class JosephyNewton(Algorithm):
    """Josephy–Newton with a non-monotone line search: x⁺ solves the LCP of M = F′(x), q = F(x) − F′(x) x.

    Parameters
    ----------
    points : Linearizations
        Linearizations of the nonlinear problem.
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

    points: Linearizations = field(repr=False)
    linear: str | Algorithm = "auto"
    tolerance: float = 0.0

    def iterates(self, problem: LCP, z0: FloatVector) -> Iterator[Step]:
        """Yield the start, then the point of each step, until no step or restart helps."""
        run = _NewtonRun(self, self.points.at(z0))
        yield run.step()
        for _ in range(RESTARTS if problem.n <= SMALL else 0):
            yield from run.steps()
            if not run.start_elsewhere(problem):
                return
            yield run.step()
        yield from run.steps()


class _NewtonRun:
    """State of a run: the current point, the last points, and the work since the last step."""

    def __init__(self, options: JosephyNewton, start: Linearization) -> None:
        self.options, self.first, self.here = options, start, start
        self.recent: deque[Linearization] = deque([start], maxlen=MEMORY)
        self.work, self.starts = 1.0, 0
        self.failures = self.waits = (
            0  # of linearizations without a solution; steps until the next one is tried
        )
        self.weights = _weights(start.lcp)
        self.random = np.random.default_rng(0)

    def step(self) -> Step:
        """Return the point here as a step, with the work since the last one."""
        work, self.work = self.work, 0.0
        return Step(self.here.x, work=work)

    def steps(self) -> Iterator[Step]:
        """Yield steps from here until none helps, or none has for long."""
        latest, since = deque([self._progress(self.here)], maxlen=WINDOW), 0
        while since < PATIENCE and (following := self._next_point()) is not None:
            self.here = following = self._snap(following)
            self.recent.append(following)
            self.options.points.keep(following)
            yield self.step()
            size = self._progress(following)
            since = 0 if size < GAIN * min(latest) else since + 1
            latest.append(size)
            if since and self._is_at_floor():
                return

    def _snap(self, point: Linearization) -> Linearization:
        """Return the point with x° in the components that F(x°) solves, and that x has come near."""
        origin, data = self.options.points.origin, row_data(point.lcp)
        errors = np.abs(data.residual(origin.x, origin.value))
        left, way = (data.largest(np.abs(x - origin.x)) for x in (point.x, self.first.x))
        is_reached = (data.largest(errors) == 0.0) & (left <= NEARLY_THERE * way)
        x = np.where(is_reached, origin.x, point.x)
        there = point if np.array_equal(x, point.x) else self._at(x)
        return there if there.is_defined and there.residual <= point.residual else point

    def start_elsewhere(self, problem: LCP) -> bool:
        """Go to another point of the bounds where F is defined; return whether there is one."""
        size = np.maximum(1.0, np.abs(self.first.x))
        for _ in range(RESTARTS):
            self.starts += 1
            if self.starts == 1:
                x = np.clip(1.0, problem.lower, problem.upper)
            else:
                x = self.first.x + size * self.random.standard_normal(problem.n) * 0.5 * self.starts
            point = self._at(np.clip(x, problem.lower, problem.upper))
            if point.is_defined:
                self.here = point
                self.recent = deque([point], maxlen=MEMORY)
                self.options.points.keep(point)
                return True
        return False

    # --- one step ----------------------------------------------------------------------------------------

    def _next_point(self) -> Linearization | None:
        """Return the next point; None if no step helps, the time is over, or rounding explains the residual."""
        if not self.here.certificate.residual_ends[1].any():
            return None
        self.waits -= 1
        for shift in SHIFTS[1:] if self.waits > 0 else SHIFTS:
            target = self._solution(shift)
            if shift == 0.0:
                self.failures = self.failures + 1 if target is None else 0
                self.waits = 2**self.failures - 1
            found = None if target is None else self._search(target, is_newton=shift == 0.0)
            if found is not None or is_over() or self._is_at_floor():
                return found
        return None

    def _search(self, target: FloatVector, *, is_newton: bool) -> Linearization | None:
        """Return the first point on the way to the target that is better."""
        here, allowed = self.here, GROWTH * min(point.residual for point in self.recent)
        worst = max(map(self._merit, self.recent)) if is_newton else self._merit(here)
        for k in range(SHORTER):
            x = target if k == 0 else here.x + 0.5**k * (target - here.x)
            point, least = self._at(x), (1.0 - SUFFICIENT * 0.5**k) * worst
            if np.array_equal(x, here.x) or not np.isfinite(point.value).all():
                continue
            is_better = self._merit(point) < least  # ∞ gains nothing on ∞
            if not (is_better or (is_newton and k == 0)) or not point.is_defined:
                continue
            if is_better or point.residual <= allowed < math.inf:
                return point
        return None

    def _at(self, x: FloatVector) -> Linearization:
        self.work += 1.0
        return Linearization(self.options.points, x)

    # --- what is measured ----------------------------------------------------------------------------------

    def _merit(self, point: Linearization) -> float:
        """Return ‖Φ‖₂ with the row scales of the linearization here; ∞ if F is undefined."""
        if not np.isfinite(point.value).all():
            return math.inf
        lcp = self.here.lcp
        phi = fischer_burmeister(lcp, point.x, point.value, lcp.matrix.row_largest)
        return float(np.linalg.norm(self.weights * phi.value))

    def _is_at_floor(self) -> bool:
        return self.here.certificate.is_limited_by_rounding

    def _progress(self, point: Linearization) -> float:
        """Return the measure that must fall: residuals and violations, and then the componentwise test.

        Next to a pole only the residual falls, because x_i approaches its bound; if F tends to 0 as x diverges, only
        the violation falls. Both are in the units of the start.
        """
        certificate, scale = point.certificate, self.first.lcp.residual_scale
        sizes = np.maximum(certificate.residual_ends[1], certificate.violation / scale)
        size = float((self.weights * sizes).max(initial=0.0))
        is_small = point.residual <= max(self.options.tolerance, SMALLEST_TOLERANCE)
        return size * min(1.0, certificate.term_residual) if is_small else size

    def _solution(self, shift: float) -> FloatVector | None:
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
        enough = (
            max(ENOUGH * self.options.tolerance / relative, SMALLEST_TOLERANCE)
            if relative > 0.0
            else FORCING
        )
        tolerance = min(max(relative, enough), FORCING)
        algorithm = self.options.linear
        try:
            result = solve_within(step, algorithm, tolerance)
        except (UnsuitableMatrix, UnsuitableProblem):  # the algorithm does not take this one
            if algorithm == "auto":
                raise
            result = solve_within(step, "auto", tolerance)
        self.work += result.work
        if not (result.is_solved or result.residual <= 0.5):
            return None
        target = np.clip(x + result.z, lcp.lower, lcp.upper)
        # the sum may have missed the bound
        target = np.where(result.z <= step.lower, lcp.lower, target)
        return np.where(result.z >= step.upper, lcp.upper, target)


def _weights(problem: LCP) -> FloatVector:
    """Return 1/reference of each row's component, shape (n,), or shape (1,) for one component."""
    unit = references_of_components(problem)[1]
    if unit.size == 1:
        return np.ones(1)
    return 1.0 / np.where((unit > 0.0) & np.isfinite(unit), unit, 1.0)


def _stages_of_step(problem: LCP, method: Algorithm | None, goal: float) -> Iterator[Stage]:
    """Yield the stages of a linearization: no proofs, pivots last, and no method twice."""
    tried: list[Algorithm] = []
    for stage in plan(problem, method, goal, prove_infeasibility=False):
        if stage.algorithm in tried:
            return
        if tried and isinstance(stage.algorithm, Lemke):
            stage.algorithm = Lemke(restarts=PATHS)
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
    settings = Settings(tolerance, max_seconds=None if left == math.inf else left)
    step = np.nan_to_num(-problem.q / problem.residual_scale)
    start = np.clip(step, problem.lower, problem.upper)
    run = LCPRun(problem, method or "auto", settings, None, clock, start)
    stages = _stages_of_step(problem, method, run.test.goal)
    return run.result(run.follow_all(stages))
