"""Josephy–Newton: each step solves the LCP of the linearisation, which `solve` does as it does any other."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import ClassVar

import numpy as np
import scipy.sparse as sp

from ..algorithms import Algorithm, Step
from ..algorithms.active_sets.damped_newton import fischer_burmeister, phi_jacobian
from ..algorithms.base import without_warnings
from ..algorithms.pivots.lemke import Lemke
from ..algorithms.rehearsal import rehearse
from ..algorithms.search.stages import ExhaustiveSearch, FeasibilityCheck
from ..certificates.nonlinear import Reference
from ..certificates.residuals import reference_residual
from ..certificates.row_residuals import scaled_residual
from ..checks import FloatVector
from ..deadline import is_over, seconds_left
from ..matrix.factors import factor_fits, factorise
from ..policy.choice import Policy, policy_for
from ..policy.stages import Choice, Stage
from ..problem.lcp import LCP
from ..problem.nonlinear import Linearisation, Linearisations
from ..settings import Settings
from .driver import Run
from .result import Result
from .sprint import sprinted
from .state import Clock

SUFFICIENT = 1e-4
SHORTER, SHORTER_OF_DESCENT = 16, 30  # times a step is shortened
HALVINGS, FAR = 4, 1e3  # after so many, where the merit is still so much larger than it should be, to a tenth
EXPLODED = 1e5  # times as much slack is no progress, whatever the merit says
MEMORY = 4  # the line search compares with the worst of so many points
SHIFTS = (1e-3, 1e-1, 10.0)  # of the residual scale: where the LCP has no solution, or its step does not help
SHIFT_OF_PHI = 1e-3  # keeps the Jacobian of Φ regular
ON_PATH = (0.5, 0.125)
FORCING = 0.01  # of the residual here, that a linearisation is solved to while far away
SMALLEST_TOLERANCE = 1e-14
PATIENCE = 25  # steps without a residual clearly below those of the window before it
WINDOW, GAIN = 12, 0.95  # after a jump a long way back may begin
PATHS = 2  # of pivots, on a linearisation
RESTARTS, SMALL = 6, 1000  # unknowns: beyond them a new start is too expensive


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

    Notes
    -----
    The merit is ‖Φ‖₂, Φ the Fischer–Burmeister function with F(x) for w, in the scale of the linearisation at hand.
    A step is shortened until F is defined and ‖Φ‖ falls below the worst of the last four points. Where that takes more
    than 16 trials, these are tried in turn: points on the path of the linearisation, whose slack at x is given and
    taken back in part (Ralph); the LCP of F′(x) + μD, D the residual scale (proximal); Newton on Φ; its steepest
    descent. Where nothing helps x is a stationary point of ‖Φ‖, and small problems start again elsewhere.

    References
    ----------
    N. H. Josephy, *Newton's method for generalized equations*, MRC report 1965, Wisconsin 1979.
    D. Ralph, *Global convergence of damped Newton's method for nonsmooth equations via the path search*, Math. Oper.
    Res. 19 (1994), doi:10.1287/moor.19.2.352.
    """

    name: ClassVar[str] = "josephy_newton"
    assumption: ClassVar[str] = "F smooth"
    converges_on: ClassVar[str] = "near strongly regular solutions, quadratically"
    cost: ClassVar[str] = "1 LCP"
    reference: ClassVar[str] = "Josephy 1979, MRC report 1965"
    is_monotone: ClassVar[bool] = False

    points: Linearisations = field(repr=False)
    compared_with: Reference = field(repr=False)
    linear: str | Algorithm = "auto"

    def iterates(self, problem: LCP, z0: FloatVector) -> Iterator[Step]:
        """Yield the start, then the point of each step, until nothing more can be done."""
        return without_warnings(self._steps(problem, z0))

    def _steps(self, problem: LCP, z0: FloatVector) -> Iterator[Step]:
        run = _Newton(self, self.points.at(z0))
        yield run.step()
        for _ in range(RESTARTS if problem.n <= SMALL else 0):
            yield from run.steps()
            if not run.start_elsewhere(problem):
                return
            yield run.step()
        yield from run.steps()


class _Briefly:
    """A policy without its last resorts: whether a linearisation has a solution at all is not worth much work."""

    def __init__(self, policy: Policy) -> None:
        self._policy, self.name, self.chosen = policy, policy.name, policy.chosen

    def first(self, problem: LCP) -> Choice:
        """Return what the policy begins with."""
        return self._policy.first(problem)

    def next_step(self, problem: LCP, stages: Sequence[Stage], target: float, failed: bool) -> Choice | None:
        """Return the policy's next choice that asks for no proof; pivots are the last, and nothing has two turns."""
        if isinstance(stages[-1].algorithm, Lemke):
            return None
        choice = self._policy.next_step(problem, stages, target, failed)
        while choice is not None and isinstance(choice.algorithm, (FeasibilityCheck, ExhaustiveSearch)):
            choice = self._policy.next_step(problem, stages, target, True)
        if choice is None or any(stage.algorithm == choice.algorithm for stage in stages):
            return None
        is_pivoting = isinstance(choice.algorithm, Lemke)
        return replace(choice, algorithm=Lemke(restarts=PATHS)) if is_pivoting else choice


def _solved(problem: LCP, policy: Policy, start: FloatVector, tolerance: float) -> Result:
    """Return the result of a run within this one, whose limits hold for it and whose Ctrl-C ends both."""
    left, clock = seconds_left(), Clock(problem.peers)
    settings = Settings(tolerance, max_seconds=None if left == math.inf else left)
    rehearse(None, problem)
    first = policy.first(problem)
    if (arrived := sprinted(problem, policy, first, settings, start, clock)) is not None:
        return arrived
    run = Run(problem, policy, settings, None, clock)
    return run.judged(start, run.drive(start, first))


class _Newton:
    """Where a run is, the last points, and the work since the last step."""

    def __init__(self, options: JosephyNewton, start: Linearisation) -> None:
        self.options, self.first, self.here = options, start, start
        self.recent: deque[Linearisation] = deque([start], maxlen=MEMORY)
        self.work, self.starts = 1.0, 0
        self.tried = math.inf  # the merit of the last trial
        self.is_regularised = False  # since a linearisation was not solved
        self.random = np.random.default_rng(0)

    def step(self) -> Step:
        """Return the point here as a step, with the work since the last one."""
        work, self.work = self.work, 0.0
        return Step(self.here.x, work=work)

    def steps(self) -> Iterator[Step]:
        """Yield steps from here until none helps, or none has for long."""
        latest, since = deque([self._relative(self.here)], maxlen=WINDOW), 0
        while since < PATIENCE and (following := self._following()) is not None:
            self.here = following
            self.recent.append(following)
            self.options.points.keep(following)
            yield self.step()
            size = self._relative(following)
            since = 0 if size < GAIN * min(latest) else since + 1
            latest.append(size)

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
                self.recent.clear()
                self.recent.append(point)
                self.options.points.keep(point)
                return True
        return False

    # --- one step ----------------------------------------------------------------------------------------

    def _following(self) -> Linearisation | None:
        """Return the next point, or None where nothing helps or time is over."""
        lcp = self.here.lcp
        if self._residual(self.here) == 0.0:
            return None
        worst = max(self._merit(point) for point in self.recent)
        for find in (self._newton, self._on_path, self._proximal, self._descended):
            found = find(lcp, worst)
            if found is not None or is_over():
                return found
        return None

    def _newton(self, lcp: LCP, worst: float) -> Linearisation | None:
        if self.is_regularised:
            target = self._proximal_point(lcp, min(SHIFTS[1], self._relative(self.here)))
        else:
            target = self._solution(lcp)
            self.is_regularised = target is None
        return None if target is None else self._searched(target, worst)

    def _on_path(self, lcp: LCP, worst: float) -> Linearisation | None:
        """Return a point of the path: at its start, slack that x has and should not have is given; at its end none."""
        if self.is_regularised:
            return None
        x, w = self.here.x, self.here.value
        given = np.where(x <= lcp.lower, np.minimum(w, 0.0), np.where(x >= lcp.upper, np.maximum(w, 0.0), w))
        for length in ON_PATH:
            target = self._solution(lcp.with_q(lcp.q - (1.0 - length) * given))
            if target is not None and (found := self._accepted(target, worst, length)) is not None:
                return found
        return None

    def _proximal(self, lcp: LCP, worst: float) -> Linearisation | None:
        for shift in SHIFTS:
            target = self._proximal_point(lcp, shift)
            if target is not None and (found := self._searched(target, worst)) is not None:
                return found
        return None

    def _proximal_point(self, lcp: LCP, shift: float) -> FloatVector | None:
        """Return the solution of the LCP of F′(x) + shift D, which leaves F(x) as it is."""
        added = shift * lcp.residual_scale
        M = lcp.M + sp.diags_array(added) if sp.issparse(lcp.M) else lcp.M + np.diag(added)
        return self._solution(LCP(M, lcp.q - added * self.here.x, lower=lcp.lower, upper=lcp.upper))

    def _descended(self, lcp: LCP, worst: float) -> Linearisation | None:
        """Return a point along the Newton direction of Φ, or its steepest descent."""
        phi = fischer_burmeister(lcp, self.here.x, self.here.value)
        jacobian = phi_jacobian(lcp, phi, 0.0)
        gradient = jacobian.T @ phi.value
        shifted = phi_jacobian(lcp, phi, SHIFT_OF_PHI * min(1.0, phi.norm))
        factor = factorise(shifted) if lcp.is_dense or factor_fits(shifted) else None
        for direction in (None if factor is None else factor.solve(-phi.value), -gradient):
            if direction is None or not np.isfinite(direction).all():
                continue
            for k in range(SHORTER_OF_DESCENT):
                x = np.clip(self.here.x + 0.5**k * direction, lcp.lower, lcp.upper)
                if (found := self._accepted(x, phi.norm, SUFFICIENT * 0.5**k)) is not None:
                    return found
        return None

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
        return point if is_less and point.is_defined and not np.array_equal(x, self.here.x) else None

    def _at(self, x: FloatVector) -> Linearisation:
        self.work += 1.0
        return Linearisation(self.options.points.problem, x)

    # --- what is measured ----------------------------------------------------------------------------------

    def _merit(self, point: Linearisation) -> float:
        """Return ‖Φ‖₂ in the scale of the linearisation here; ∞ where F is not defined."""
        if not np.isfinite(point.value).all():
            return math.inf
        return fischer_burmeister(self.here.lcp, point.x, point.value).norm

    def _overshoots(self, point: Linearisation, worst: float) -> bool:
        """Return whether slack between the bounds, of which Φ sees no more than how far they are, has exploded."""
        lcp = self.here.lcp
        is_between = (lcp.lower < point.x) & (point.x < lcp.upper)
        there, here = (
            np.abs(one.value / lcp.residual_scale).max(initial=0.0, where=is_between) for one in (point, self.here)
        )
        return bool(there > EXPLODED * max(worst, here))

    @staticmethod
    def _residual(point: Linearisation) -> float:
        return float(np.abs(scaled_residual(point.lcp, point.x, point.value)).max(initial=0.0))

    def _relative(self, point: Linearisation) -> float:
        reference = self.options.compared_with.ends(point.lcp, point.x, point.value)[1]
        return self._residual(point) / reference if reference > 0.0 else math.inf

    def _solution(self, lcp: LCP) -> FloatVector | None:
        """Return a solution of a linearisation, as sharp as the residual here deserves; None where none was found."""
        residual, unit = self._residual(self.here), reference_residual(lcp)
        if unit == 0.0:
            return lcp.nearest_to_zero
        aim = min(FORCING, self._relative(self.here)) * residual / unit
        tolerance = min(max(aim, SMALLEST_TOLERANCE), FORCING)
        result = _solved(lcp, _Briefly(policy_for(self.options.linear, {})), self.here.x, tolerance)
        self.work += result.work
        is_near = result.residual * unit <= 0.5 * residual
        return result.z if result.is_solved or is_near else None


