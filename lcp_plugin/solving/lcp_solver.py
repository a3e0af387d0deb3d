"""The solver for LCPs: a small problem is tried in one pass, any other follows a plan in a run."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..core.algorithm import Algorithm
from ..core.certificates.criterion import row_data
from ..core.checks import checked_start, read_only
from ..core.deadline import Clock
from ..core.lcp import LCP
from ..methods.finishing import measure_finished
from ..methods.small import first_candidate, path_points
from .choice import GUESSED, parse_call, takes_rounds
from .result import NOTHING_TO_DO, Callback, Result, StageRecord


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
    clock = Clock()
    method, settings = parse_call(algorithm, options)
    start = problem.nearest_to_zero if z0 is None else checked_start(problem, z0)
    is_watched = settings.record or settings.verbose
    is_limited = settings.max_seconds < math.inf or not settings.max_iterations
    is_plain = not (is_watched or is_limited or settings.absolute_tolerance)
    is_plain = is_plain and callback is None
    if is_plain and z0 is None and method is not None and method.is_compiled_for(problem):
        for z, bound in path_points(problem, settings.tolerance):
            if bound == math.inf or problem.origin is not None:
                point = measure_finished(row_data(problem), z, settings.goal, power=1.0)
                if not point.passes:
                    continue
                z = read_only(point.z)
            is_start = np.array_equal(z, start)
            said = (NOTHING_TO_DO, 0, 0.0) if is_start else ("", 1, float(problem.n))
            stage = StageRecord(method.name, *said)
            return Result.at(problem, z, stage, settings, clock.read(), asked=method)
    is_plain = is_plain and method is None
    if is_plain and getattr(problem.origin, "form", "") != "kkt" and takes_rounds(problem):
        found = first_candidate(problem, start, settings.tolerance)
        if found is not None:
            point, label, work = found
            stage = StageRecord(label, GUESSED, 1, work)
            rows = point.rows if problem.matrix.is_dense else None  # of the stored M
            z = read_only(point.z)
            return Result.at(problem, z, stage, settings, clock.read(), rows)
    from .lcp_run import run_on  # with all methods, which a small problem does without

    return run_on(problem, method, settings, start, clock, callback)
