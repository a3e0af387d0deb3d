"""Full Newton steps on arrays: the first steps of the monotone search, without the bookkeeping of a run.

A small dense problem with a good start needs no others. They are the steps of
:class:`~lcp_plugin.problems.nonlinear.solving.JosephyNewton`, bit for bit, so that a run that is watched takes the
same ones. If another step is due, the run begins again, with F and F′ at the points of this try.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from ...core.checks import Vector
from ...core.kernels.floats import NEGLIGIBLE
from .data import SMALLEST_TOLERANCE, Linearization
from .steps import Target, is_small, moved, small_step

MOST_STEPS = 20  # a problem that needs more gains little by them


def take_full_steps(newton: Any, is_over: Callable[[], bool]) -> tuple[Linearization | None, int]:
    """Return the first point with a small residual, and its number of steps; None if another step is due.

    Parameters
    ----------
    newton : JosephyNewton
        At its start.
    is_over : callable
        Returns whether the time is over.
    """
    here, settings = newton.first, newton.settings
    is_suited = newton.linear == "auto" and is_small(here) and here.x.size
    if not is_suited or settings.absolute_tolerance:
        return None, 0
    problem, goal = here.problem, max(newton.tolerance, SMALLEST_TOLERANCE)
    lower, upper, unit, passed = problem.lower, problem.upper, here.scale, list[Linearization]()
    for count in range(min(MOST_STEPS, settings.max_iterations) + 1):
        newton.here = here
        x, w, M, scale = here.x, here.value, here.M, here.scale
        above, below, step = x - lower, x - upper, w / scale
        residual = np.abs(np.minimum(np.maximum(step, below), above))
        violation = np.maximum(np.where(above > 0.0, w, 0.0), np.where(below < 0.0, -w, 0.0))
        sizes = np.maximum(residual, violation / unit)
        if count == 0:
            least, negligible = sizes, NEGLIGIBLE * sizes
        elif not is_below(sizes, least, 0.95):
            latest = min(map(newton.progress, passed[-12:]))
            if not newton.progress(here) < 0.95 * latest and newton.is_at_floor():
                break
        passed.append(here)
        least = np.minimum(sizes, least)
        terms = np.abs(M) @ np.abs(x) + np.abs(here.q)
        if np.maximum.reduce(residual) <= goal * np.maximum.reduce(terms / scale):
            return here, count
        is_flat = not np.logical_and.reduce(sizes > negligible) and newton.is_flat()
        if is_flat or is_over() or count in (MOST_STEPS, settings.max_iterations):
            break
        if (change := small_step(M, w, -above, -below, scale)) is None:
            break
        point = here.at(moved(here, change))
        newton.passed[point.x.tobytes()] = newton.tried = point
        if not is_better(newton, point, residual) or not point.is_defined:
            break
        here = point
    return None, 0


def is_better(newton: Any, point: Linearization, residual: Vector) -> bool:
    """Return whether a search accepts the end of a full step, and does not move it to z°.

    The tests of single rows imply the tests by weighted norms, for any weights, and take less time.
    """
    here, lower, upper = newton.here, point.problem.lower, point.problem.upper
    there = np.maximum(point.value / here.scale, point.x - upper)
    there = np.abs(np.minimum(there, point.x - lower))
    if not is_below(there, residual, 0.5):
        phi = [np.abs(newton.phi(one)) for one in (point, here)]
        if not is_below(phi[0], phi[1], 0.9999):
            target, newton.recent = Target("Newton", point.x, (1.0,)), [here]
            if newton.full_step(target) is None and newton.search(target) is None:
                return False
    if newton.first is here.origin:
        return True
    near = 1e-4 * np.maximum.reduce(np.abs(newton.first.x - here.origin.x))
    is_far = (np.abs(point.x - here.origin.x) > near).all()
    return bool(is_far) or newton.snap(point) is point


def is_below(values: Vector, others: Vector, share: float) -> bool:
    """Return whether each value is 0 or below its share of the other one, so that weighted norms are."""
    return bool(np.logical_and.reduce((values < share * others) | (values == 0.0)))
