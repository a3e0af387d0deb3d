"""Josephy–Newton: each step solves the LCP of the linearisation, which `solve` does as it does any other."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import ClassVar

import numpy as np
import scipy.sparse as sp

from ...auto import policy_for
from ...core.algorithm import Algorithm, Step, without_warnings
from ...core.certificates.criterion import CommonScaling, largest_of_components
from ...core.certificates.row_residuals import largest_ratio, scaled_residual
from ...core.checks import FloatVector
from ...core.deadline import Clock, is_over, seconds_left
from ...core.errors import UnsuitableMatrix, UnsuitableProblem
from ...core.lcp import LCP
from ...core.matrix.structure import connected_components
from ...core.policy.policy import Policy
from ...core.policy.stages import Choice, Stage
from ...core.settings import Settings
from ...core.solving.driver import fused
from ...core.solving.result import Result, Sample
from ...core.solving.run import Run
from ...methods.lemke import Lemke
from ...methods.newton.semismooth_newton import Linearised, fischer_burmeister, phi_jacobian
from .certificate import NonlinearCertificate, Reference
from .data import Linearisation, Linearisations

SUFFICIENT = 1e-4
SHORTER, SHORTER_OF_DESCENT = 16, 30  # times a step is shortened
HALVINGS, FAR = (
    4,
    1e3,
)  # after so many, where the merit is still so much larger than it should be, to a tenth
EXPLODED = 1e5  # times as much slack is no progress, whatever the merit says
MEMORY = 4  # the line search compares with the worst of so many points
SHIFTS = (
    1e-3,
    1e-1,
    10.0,
)  # of the residual scale: where the LCP has no solution, or its step does not help
FORCING = 0.01  # of the residual here, that a linearisation is solved to while far away
SMALLEST_TOLERANCE = 1e-14
ENOUGH = 0.1  # of what the run asks for: no linearisation need be solved to less
PATIENCE = 25  # steps without a residual clearly below those of the window before it
WINDOW, GAIN = 12, 0.95  # after a jump a long way back may begin
RESTARTS, SMALL = (
    6,
    1000,
)  # unknowns: beyond them a new start, and steps without progress, are too expensive
FACTORS = {"newton": 12}  # without half the residual, on a large linearisation
PATHS = 2  # of pivots


@dataclass(frozen=True, kw_only=True)
class JosephyNewton(Algorithm):
    """Josephy–Newton with a non-monotone line search: x⁺ solves the LCP of M = F′(x), q = F(x) − F′(x) x.

    Parameters
    ----------
    points : Linearisations
        Of the nonlinear problem.
    compared_with : Reference
        Of its residuals, to which the tolerance of the linearisations is tied.
    linear : str or Algorithm
        What solves them.
    tolerance : float
        The relative residual that the run asks for.

    Notes
    -----
    The merit is ‖Φ‖₂, Φ the Fischer–Burmeister function with F(x) for w, beside the largest entry of each row of F′
    here: a diagonal that vanishes with x, as that of a convex power does at 0, says nothing about a point far away.
    A step is shortened until F is defined and ‖Φ‖ falls below the worst of the last four points. Where that takes more
    than 16 trials, these are tried in turn: the LCP of F′(x) + μD, D the residual scale (proximal); the steepest
    descent of ‖Φ‖. Both must lower ‖Φ‖ at x, or they climb and descend in turn. Where nothing helps x is a stationary
    point of ‖Φ‖, and small problems start again elsewhere. A large linearisation is given up after 12 active sets
    without half the residual.

    References
    ----------
    N. H. Josephy, *Newton's method for generalized equations*, MRC report 1965, Wisconsin 1979.
    """

    name: ClassVar[str] = "josephy_newton"
    is_monotone: ClassVar[bool] = False

    points: Linearisations = field(repr=False)
    compared_with: Reference = field(repr=False)
    linear: str | Algorithm = "auto"
    tolerance: float = 0.0

    def iterates(self, problem: LCP, z0: FloatVector) -> Iterator[Step]:
        """Yield the start, then the point of each step, until nothing more can be done."""
        return without_warnings(self._steps(problem, z0))

    def _steps(self, problem: LCP, z0: FloatVector) -> Iterator[Step]:
        run = _NewtonRun(self, self.points.at(z0))
        yield run.step()
        for _ in range(RESTARTS if problem.n <= SMALL else 0):
            yield from run.steps()
            if not run.start_elsewhere(problem):
                return
            yield run.step()
        yield from run.steps()


class _NewtonRun:
    """Where a run is, the last points, and the work since the last step."""

    def __init__(self, options: JosephyNewton, start: Linearisation) -> None:
        self.options, self.first, self.here = options, start, start
        self.recent: deque[Linearisation] = deque([start], maxlen=MEMORY)
        self.work, self.starts = 1.0, 0
        self.weights = _weights(start, options.compared_with)
        self.tried = math.inf  # the merit of the last trial
        self.is_regularised = False  # since a linearisation was not solved
        self.random = np.random.default_rng(0)

    def step(self) -> Step:
        """Return the point here as a step, with the work since the last one."""
        work, self.work = self.work, 0.0
        return Step(self.here.x, work=work)

    def steps(self) -> Iterator[Step]:
        """Yield steps from here until none helps, or none has for long."""
        latest, since = deque([self._progress(self.here)], maxlen=WINDOW), 0
        while since < PATIENCE and (following := self._following()) is not None:
            self.here = following = self._reached(following)
            self.recent.append(following)
            self.options.points.keep(following)
            yield self.step()
            size = self._progress(following)
            since = 0 if size < GAIN * min(latest) else since + 1
            latest.append(size)
            if since and self._is_at_floor():
                return

    def _reached(self, point: Linearisation) -> Linearisation:
        """Return the point with x° in the components that are nearly there, where x° solves them."""
        x = self.options.compared_with.reached(point.lcp, point.x)
        there = point if np.array_equal(x, point.x) else self._at(x)
        return (
            there if there.is_defined and self._relative(there) <= self._relative(point) else point
        )

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
                self.here, self.is_regularised = point, False
                self.recent = deque([point], maxlen=MEMORY)
                self.options.points.keep(point)
                return True
        return False

    # --- one step ----------------------------------------------------------------------------------------

    def _following(self) -> Linearisation | None:
        """Return the next point, or None where nothing helps, time is over, or rounding explains what is left."""
        lcp = self.here.lcp
        if not self._residuals(self.here).any():
            return None
        here, worst = self._merit(self.here), max(self._merit(point) for point in self.recent)
        for find, least in (
            (self._newton, worst),
            (self._proximal, here),
            (self._descended, here),
        ):
            found = find(lcp, least)
            if found is not None or is_over() or self._is_at_floor():
                return found
        return None

    def _newton(self, lcp: LCP, worst: float) -> Linearisation | None:
        if self.is_regularised:
            target = self._proximal_point(lcp, min(SHIFTS[1], self._relative(self.here)))
        else:
            target = self._solution(lcp, self.here.value)
            self.is_regularised = target is None
        return None if target is None else self._searched(target, worst)

    def _along(self, direction: FloatVector, lcp: LCP, worst: float) -> Linearisation | None:
        """Return the first point in that direction, projected, that is accepted."""
        for k in range(SHORTER_OF_DESCENT):
            x = np.clip(self.here.x + 0.5**k * direction, lcp.lower, lcp.upper)
            if (found := self._accepted(x, worst, SUFFICIENT * 0.5**k)) is not None:
                return found
        return None

    def _proximal(self, lcp: LCP, worst: float) -> Linearisation | None:
        targets = (self._proximal_point(lcp, shift) for shift in SHIFTS)
        found = (self._searched(target, worst) for target in targets if target is not None)
        return next((point for point in found if point is not None), None)

    def _proximal_point(self, lcp: LCP, shift: float) -> FloatVector | None:
        """Return the solution of the LCP of F′(x) + shift D, which leaves F(x) as it is."""
        added = shift * lcp.residual_scale
        M = lcp.M + sp.diags_array(added) if sp.issparse(lcp.M) else lcp.M + np.diag(added)
        return self._solution(LCP(M, lcp.q, lower=lcp.lower, upper=lcp.upper), self.here.value)

    def _descended(self, lcp: LCP, worst: float) -> Linearisation | None:
        """Return a point along the steepest descent of Φ."""
        phi = self._phi(lcp, self.here)
        jacobian = phi_jacobian(lcp, phi, 0.0, lcp.matrix.row_largest)
        return self._along(-(jacobian.T @ (self.weights**2 * phi.value)), lcp, worst)

    def _searched(self, target: FloatVector, worst: float) -> Linearisation | None:
        """Return the first point on the way to the target that is accepted."""
        direction, length = target - self.here.x, 1.0
        for k in range(SHORTER):
            x = target if k == 0 else self.here.x + length * direction
            if (found := self._accepted(x, worst, length)) is not None:
                return found
            length *= 0.1 if k >= HALVINGS and self.tried > FAR * worst else 0.5
        return None

    def _accepted(self, x: FloatVector, worst: float, length: float) -> Linearisation | None:
        """Return x where F is defined there and the merit falls."""
        point = self._at(x)
        self.tried = math.inf if self._overshoots(point, worst) else self._merit(point)
        is_less = self.tried <= (1.0 - SUFFICIENT * length) * worst
        return (
            point if is_less and point.is_defined and not np.array_equal(x, self.here.x) else None
        )

    def _at(self, x: FloatVector) -> Linearisation:
        self.work += 1.0
        return Linearisation(self.options.points.problem, x)

    # --- what is measured ----------------------------------------------------------------------------------

    def _merit(self, point: Linearisation) -> float:
        """Return ‖Φ‖₂ beside the rows of the linearisation here, each component in its unit; ∞ where F is undefined."""
        if not np.isfinite(point.value).all():
            return math.inf
        return float(np.linalg.norm(self.weights * self._phi(self.here.lcp, point).value))

    @staticmethod
    def _phi(lcp: LCP, point: Linearisation) -> Linearised:
        return fischer_burmeister(lcp, point.x, point.value, lcp.matrix.row_largest)

    def _is_at_floor(self) -> bool:
        return NonlinearCertificate.at(self.here, self.options.compared_with).is_limited_by_rounding

    def _overshoots(self, point: Linearisation, worst: float) -> bool:
        """Return whether slack between the bounds, of which Φ sees no more than how far they are, has exploded."""
        lcp = self.here.lcp
        is_between = (lcp.lower < point.x) & (point.x < lcp.upper)
        there, here = (
            np.abs(self.weights * one.value / lcp.matrix.row_largest).max(
                initial=0.0, where=is_between
            )
            for one in (point, self.here)
        )
        return bool(there > EXPLODED * max(worst, here))

    @staticmethod
    def _residuals(point: Linearisation) -> FloatVector:
        """Return ‖r_P‖∞ of each component."""
        return largest_of_components(
            point.lcp, np.abs(scaled_residual(point.lcp, point.x, point.value))
        )

    def _relative(self, point: Linearisation) -> float:
        references = self.options.compared_with.ends(point.lcp, point.x, point.value)[1]
        return largest_ratio(self._residuals(point), references)

    def _progress(self, point: Linearisation) -> float:
        """Return what must fall: where x runs away its residual does so for ever, and rows' own terms tell."""
        size = self._relative(point)
        if size > max(self.options.tolerance, SMALLEST_TOLERANCE):
            return size
        return NonlinearCertificate.at(point, self.options.compared_with).relative_residual

    def _solution(self, lcp: LCP, w: FloatVector) -> FloatVector | None:
        """Return a solution of M (x⁺ − x) + w on the bounds, as sharp as the residual here deserves, or None.

        It is solved for x⁺ − x: the residual at x is then the reference, and of several solutions one near x is found.
        """
        x = self.here.x
        step = lcp.with_q(w, lower=lcp.lower - x, upper=lcp.upper - x)
        relative = self._relative(self.here)
        enough = (
            max(ENOUGH * self.options.tolerance / relative, SMALLEST_TOLERANCE)
            if relative > 0.0
            else FORCING
        )
        tolerance = min(max(relative, enough), FORCING)
        algorithm = self.options.linear
        try:
            result = solved_within(step, algorithm, tolerance)
        except (
            UnsuitableMatrix,
            UnsuitableProblem,
        ):  # by an algorithm that does not take this linearisation
            if algorithm == "auto":
                raise
            result = solved_within(step, "auto", tolerance)
        self.work += result.work
        if not (result.is_solved or result.residual <= 0.5):
            return None
        target = np.clip(x + result.z, lcp.lower, lcp.upper)
        target = np.where(
            result.z <= step.lower, lcp.lower, target
        )  # the sum may have missed the bound
        return np.where(result.z >= step.upper, lcp.upper, target)


def _weights(start: Linearisation, compared_with: Reference) -> FloatVector:
    """Return 1/(the reference of its component) for each row, shape (n,); where there is one component (1,) of 1."""
    several = connected_components(start.lcp.matrix)
    if several is None:
        return np.ones(1)
    unit = compared_with.ends(start.lcp, start.x, start.value)[1]
    weights: FloatVector = (
        1.0 / np.where((unit > 0.0) & np.isfinite(unit), unit, 1.0)[several.labels]
    )
    return weights


class LinearPolicy(Policy):
    """What solves a linearisation: the caller's policy without a look for proofs; pivots are its last resort."""

    def __init__(self, algorithm: str | Algorithm) -> None:
        self._policy = policy_for(algorithm, {}, prove_infeasibility=False)
        self.name, self.chosen = self._policy.name, self._policy.chosen

    def first(self, problem: LCP) -> Choice:
        """Return what the policy begins with."""
        return self._policy.first(problem)

    def next_step(
        self, problem: LCP, stages: Sequence[Stage], goal: float, failed: bool
    ) -> Choice | None:
        """Return the policy's next choice; pivots are the last, and nothing has two turns."""
        if isinstance(stages[-1].algorithm, Lemke):
            return None
        choice = self._policy.next_step(problem, stages, goal, failed)
        if choice is None or any(stage.algorithm == choice.algorithm for stage in stages):
            return None
        is_pivoting = isinstance(choice.algorithm, Lemke)
        return replace(choice, algorithm=Lemke(restarts=PATHS)) if is_pivoting else choice


def solved_within(problem: LCP, algorithm: str | Algorithm, tolerance: float) -> Result:
    """Return the result of a run within another one, whose limits hold for it and whose Ctrl-C ends both.

    From the projected gradient step: the methods see a start and look for a solution near it.
    """
    left, clock, scaling = seconds_left(), Clock(problem.matrix), CommonScaling.of(problem)
    policy = LinearPolicy(algorithm)
    settings = Settings(tolerance, max_seconds=None if left == math.inf else left)
    step = np.nan_to_num(-problem.q / problem.residual_scale)
    start, first = (
        scaling.inward(np.clip(step, problem.lower, problem.upper)),
        policy.first(scaling.problem),
    )
    if (result := fused(scaling, policy, first, settings, start, clock)) is not None:
        return result
    run = Run(scaling, policy, settings, _Patience() if problem.n > SMALL else None, clock)
    return run.judged(start, run.drive(start, first))


class _Patience:
    """Ends a run in which many factorisations have not halved the residual."""

    def __init__(self) -> None:
        self.lowest, self.idle, self.before = math.inf, 0, 0

    def __call__(self, sample: Sample, z: FloatVector) -> bool:
        """Return whether the run has had its time."""
        residual, steps = (
            math.inf if sample.residual is None else sample.residual,
            sample.iteration - self.before,
        )
        self.before = sample.iteration
        if residual <= 0.5 * self.lowest:
            self.lowest, self.idle = residual, 0
        elif sample.label in FACTORS:
            self.idle += steps
        return self.idle >= FACTORS.get(sample.label, math.inf)
