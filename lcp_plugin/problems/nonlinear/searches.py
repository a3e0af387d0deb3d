"""Josephy–Newton with two searches and restarts.

The steps (:mod:`lcp_plugin.problems.nonlinear.steps`) are taken by two searches. The monotone search accepts steps
that reduce the merit ‖Φ‖₂. The nonmonotone search compares with the worst of four points, and takes a full Newton step
if its residual is at most ten times the least of these: on traffic networks the residual rises before it falls. Then
both begin again at other points of the bounds: the nearest points to 1, 0, 10 and 0.1, and random points.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from functools import cached_property
from itertools import chain
from typing import Any, ClassVar

import numpy as np

from ...core import deadline
from ...core.algorithm import Algorithm, Step
from ...core.checks import Vector
from ...core.entries import all_finite, max_norm
from ...core.kernels.floats import DATA_ROUNDING, NEGLIGIBLE, NEGLIGIBLE_DIAGONAL
from ...core.settings import Settings
from ...core.tuning import CHEAP_UP_TO
from ...methods.newton import fischer_burmeister
from .data import Linearization
from .steps import Aim, row_scale, targets

SEARCHES = {"monotone": 1, "nonmonotone": 4}  # points with whose worst merit a step is compared
TRIALS = 12  # points on a line where F is defined
RESTARTS = 10  # from other points, after the searches that stalled
NEAREST_TO = 1.0, 0.0, 10.0, 0.1  # the first other starts


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
    __setattr__ = object.__setattr__  # the state of one run; other algorithms are frozen

    def __init__(
        self,
        start: Linearization,
        linear: str | Algorithm,
        settings: Settings,
        searches: tuple[str, ...],
        restarts: int,
    ) -> None:
        self.first = self.current = self.tried = start
        self.linear, self.settings, self.tolerance = linear, settings, settings.goal
        self.searches, self.restarts = searches, restarts
        self.limit: Vector | float = np.inf  # of |x|: farther unknowns have grown without limit
        self.work, self.step_name, self.length = 1.0, "start", 0.0
        self.restarted = 0  # times
        self.recent: deque[Linearization] = deque([start], 1)

    @cached_property
    def weights(self) -> Vector:
        """1/reference of the component of each row at the start; shape (1,) for one component."""
        if self.first.labels is None:
            return np.ones(1)
        unit = self.first.residual_at_origin
        if not np.isfinite(unit).all():
            unit = self.first.references[1]
        return 1.0 / np.where((unit > 0.0) & np.isfinite(unit), unit, 1.0)

    def iterates(self, problem: Any, z0: Any) -> Iterator[Step]:
        """Yield the start, then the point of each step, until no step or restart helps."""
        yield self.step()
        for k, start in enumerate(chain([self.first], self.other_starts())):
            self.restarted = k
            for search in self.searches:
                if k > 0:
                    self.current, self.step_name, self.length = start, "restart", 0.0
                    yield self.step()
                yield from self.steps_from(start, search)
                if self.is_at_floor() or deadline.is_over():
                    return

    def step(self) -> Step:
        """Return the current point as a step, with the work since the last step."""
        work, self.work, note = self.work, 0.0, ""
        if self.settings.verbose and self.current.x.size:
            problem, worst = self.current.problem, int(np.argmax(np.abs(self.current.steps)))
            F, slopes, _ = problem.counts
            note = f"  {self.step_name}, length {self.length:.2g}; worst {problem.names.row(worst)}; F {F}, F′ {slopes}"
        return Step(self.current.x, work=work, measured=self.current, note=note)

    def steps_from(self, start: Linearization, search: str) -> Iterator[Step]:
        """Yield steps from a point until none helps, or none has for long."""
        self.current, self.recent = start, deque([start], SEARCHES[search])
        # A jump of the residual may start a long decrease
        latest, since, grown = deque([self.progress(start)], maxlen=12), 0, 0
        least, idle = latest[0], 0
        # 25 steps without a residual clearly below the residuals before it, or 50 without a new least residual
        while since < 25 and idle < 50 and (following := self._next_point()) is not None:
            self.current = following = self.snap(following)
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
                end = np.where(following.moves, np.abs(following.x), np.inf)
                self.limit = np.minimum(self.limit, end)
                return

    def snap(self, point: Linearization) -> Linearization:
        """Return the point with x° in the components that F(x°) solves, and that x has come near."""
        origin = point.at_origin
        if self.first is origin:  # the way has no length
            return point
        left, way = np.abs(point.x - origin.x), np.abs(self.first.x - origin.x)
        is_near = point.largest(left) <= 1e-4 * point.largest(way)
        if not np.logical_or.reduce(is_near):
            return point
        errors = np.abs(point.residual(origin.x, origin.value))
        x = np.where(is_near & (point.largest(errors) == 0.0), origin.x, point.x)
        there = point if np.array_equal(x, point.x) else self._at(x)
        return there if there.is_defined and there.relative <= point.relative else point

    def other_starts(self) -> Iterator[Linearization]:
        """Yield the starts other than x₀ at which F is defined.

        The first starts are the points of the bounds nearest to some numbers; every second random start is
        log-uniform above the lower bounds.
        """
        x, lower, upper = self.first.x, self.first.problem.lower, self.first.problem.upper
        size, n, random = np.maximum(1.0, np.abs(x)), x.size, np.random.default_rng(0)
        for k in range(self.restarts if n <= CHEAP_UP_TO else 0):
            drawn = np.full(n, NEAREST_TO[min(k, 3)])
            if k > 3:
                drawn = x + size * random.standard_normal(n) * 0.5 * k
            if k > 3 and k % 2:
                common, spread = random.uniform(-3.0, 0.0), random.uniform(-1.0, 1.0, n)
                above = lower + size * 10.0 ** (common + spread)
                drawn = np.where(np.isfinite(lower), above, drawn)
            point = self.first.at(np.clip(drawn, lower, upper))
            if point.is_defined:
                yield point

    # --- one step ----------------------------------------------------------------------------------------

    def _next_point(self) -> Linearization | None:
        """Return the next point; None if no step helps, the time is over, or rounding explains the residual."""
        current = self.current
        if current.largest_step == 0.0:
            return None
        if self.sizes_of(current)[0] <= NEGLIGIBLE * self.sizes_of(self.first)[0]:
            # a root without slope
            sizes = np.abs(current.x)
            is_zero = sizes <= NEGLIGIBLE_DIAGONAL * sizes.max()
            point = self._at(np.where(is_zero, current.origin, current.x))
            if point.is_defined and point.passes(self.settings):
                self.step_name = "limit"
                return point
        for target in targets(self.current, self.linear, self.tolerance):
            self.step_name, self.length = target.name, 1.0
            better = self.full_step(target) or self.search(target)
            is_last = better is not None or deadline.is_over()
            if is_last or (target.name == "Newton" and self.is_at_floor()):
                return better
        return None

    def full_step(self, target: Aim) -> Linearization | None:
        """Return the target if its residual is less than ¾ of the current residual, in the current scale."""
        current, point = self.current, self._at(target.x)
        size = max_norm(self.weights * current.steps_at(point))
        is_less = size < 0.75 * self.sizes_of(current)[2]
        return point if is_less and point.is_defined else None

    def search(self, target: Aim) -> Linearization | None:
        """Return the first point on the way to the target that is better."""
        current, is_newton, tried = self.current, target.name == "Newton", 0
        worst = target.share * max(map(self._merit, self.recent if is_newton else (current,)))
        for length in target.lengths:
            x = target.x if length == 1.0 else current.x + length * (target.x - current.x)
            if tried == TRIALS or (x == current.x).all():
                break
            point = self._at(x)
            if not all_finite(point.value):
                continue
            tried += 1
            # ∞ gains nothing on ∞
            is_better = self._merit(point) < (1.0 - 1e-4 * length) * worst
            # far from a source the last digits become right, and nothing falls
            if not is_better and current.relative <= DATA_ROUNDING:
                is_better = point.is_defined and point.passes(self.settings)
            is_lenient = is_newton and length == 1.0 and len(self.recent) > 1
            if not (is_better or is_lenient) or not point.is_defined:
                continue
            if is_better or point.relative <= 10.0 * min(one.relative for one in self.recent):
                self.length = length
                return point
        return None

    def _at(self, x: Vector) -> Linearization:
        """Return the linearization at x; its F is computed once if the next search begins there."""
        if not np.logical_and.reduce(x == self.tried.x):
            self.work += 1.0
            self.tried = self.first.at(x)
        return self.tried

    # --- what is measured ----------------------------------------------------------------------------------

    def _merit(self, point: Linearization) -> float:
        """Return ‖Φ‖₂ with the row scales of the current linearization."""
        return float(np.linalg.norm(self.weights * self.phi(point)))

    def phi(self, point: Linearization) -> Vector:
        """Return Φ with the row scales of the current linearization."""
        scale = row_scale(self.current)
        return fischer_burmeister(point.problem, point.x, point.value, scale).value

    def is_at_floor(self) -> bool:
        """Return whether only rounding in F keeps the current point from passing."""
        return self.current.is_limited(self.settings)

    def sizes_of(self, point: Linearization) -> tuple[float, float, float]:
        """Return the largest residual or violation, the violation, and the residual, in the units of the start.

        Next to a pole only the residual falls, because x_i approaches its bound; if F tends to 0 as x diverges, only
        the violation falls.
        """
        if point.run_sizes is None:
            violation = max_norm(self.weights * (point.violation / self.first.scale))
            residual = max_norm(self.weights * point.steps)
            point.run_sizes = max(residual, violation), violation, residual
        return point.run_sizes

    def progress(self, point: Linearization) -> float:
        """Return the measure that must fall: the size, and then the componentwise test."""
        size = self.sizes_of(point)[0]
        if point.is_small(self.settings):
            rows = point.measure_by(self.settings).by_row
            size *= 0.0 if rows is None else min(1.0, max_norm(rows.componentwise))
        return size
