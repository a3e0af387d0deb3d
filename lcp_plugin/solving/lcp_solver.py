"""The solver for LCPs: the first steps of a small problem, which a run takes over if none of their points passes."""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import partial
from itertools import chain, groupby
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..core.algorithm import Algorithm, Step
from ..core.checks import Vector, checked_start, read_only
from ..core.deadline import Clock
from ..core.lcp import LCP
from ..core.settings import DEFAULT, Settings, Status
from ..methods.small import GUESSED, Rounds, fails_surely, measure_small
from .dispatch import parse_call
from .result import NOTHING_TO_DO, Callback, Result, StageRecord

FIRST_METHOD = Rounds()


@np.errstate(all="ignore")
def solve_lcp(
    problem: LCP,
    algorithm: str | Algorithm = "auto",
    *,
    z0: ArrayLike | None = None,
    callback: Callback | None = None,
    **options: Any,
) -> Result:
    """Return the result of an LCP; :func:`lcp_plugin.solve` describes the parameters and the result.

    Parameters
    ----------
    **options
        The fields of :class:`~lcp_plugin.core.settings.Settings`, and the options of a named algorithm.

    Raises
    ------
    UnknownAlgorithm, InvalidOption, UnsuitableMatrix, UnsuitableProblem
        As :func:`lcp_plugin.solve`.
    """
    taken, known = list[Step](), None
    method, settings = parse_call(algorithm, options)
    clock = Clock(settings.max_seconds)
    start = checked_start(problem, z0)
    first = (method or FIRST_METHOD).first_points(problem, start, settings.tolerance)
    steps = iter(()) if first is None else measured_steps(problem, first, start, settings)
    while len(taken) < settings.max_iterations and clock.left:
        if (step := next(steps, None)) is None:
            break
        taken.append(step)
        if (point := step.measured).passes:
            make = partial(result_of, problem, taken, settings, clock.read(), method)
            fixed = {"status": Status.SOLVED, "absolute_tolerance": settings.absolute_tolerance}
            result = Result.of_known(make, z=read_only(point.z), **fixed, _asked=method)
            if not problem.matrix.is_dense:  # the caller may overwrite a sparse M
                result.certificate  # noqa: B018 - measured now
            if callback is None and not settings.is_watched:
                return result
            known = result, point.residual
            break
        if point.is_limited or not point.residual < math.inf:  # a run ends here
            break
    from .lcp_run import run_on  # with all methods, which a small problem does without

    begun = chain(taken, steps) if taken else None
    return run_on(problem, method, settings, start, clock, callback, begun, known)


def measured_steps(
    problem: LCP, steps: Iterator[Step], start: Vector, settings: Settings
) -> Iterator[Step]:
    """Yield the first steps with their measures; only the start if it passes.

    The start z° is measured only if the quick test does not accept the first point.
    """
    is_cold = start is problem.nearest_to_zero
    if not (is_cold or fails_surely(problem, start, settings)):
        measured = measure_small(problem, start, settings)
        if measured.passes:
            yield Step(measured.z, work=0.0, iterations=0, measured=measured)
            return
    for step in steps:
        point = step.measured = step.measured or measure_small(problem, step.z, settings)
        if is_cold and point.passes and (point.z == start).all():  # no iteration was needed
            step = Step(point.z, work=0.0, iterations=0, measured=point)  # noqa: PLW2901
        yield step


def result_of(
    problem: LCP, steps: list[Step], settings: Settings, seconds: float, method: Algorithm | None
) -> Result:
    """Return the result of first steps, of which the last one passes; steps in a row with one label have one record."""
    records = []
    for label, group in groupby(steps, lambda step: step.label):
        parts = [*group]
        iterations = sum(step.iterations != 0 for step in parts)
        work = sum(step.work for step in parts)
        records.append(StageRecord(label or (method or FIRST_METHOD).name, "", iterations, work))
    because = NOTHING_TO_DO if steps[-1].iterations == 0 else "" if method else GUESSED
    records[0] = records[0]._replace(because=because)
    return Result.of(problem, steps[-1].measured, records, settings, seconds, method)


def planned(problem: LCP) -> tuple[str, Any, Iterator[Any]]:
    """Return the matrix and the stages of an LCP for `analyze`."""
    from .plan import plan

    return "M", problem.matrix, plan(problem, None, DEFAULT.goal)
