"""The solver for LCPs: a small problem is tried in one pass, any other follows a plan in a run."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..core.algorithm import Algorithm
from ..core.checks import checked_start, read_only
from ..core.deadline import Clock
from ..core.lcp import LCP
from ..core.settings import Settings
from ..methods.small import GUESSED, first_candidate, first_path_point, takes_rounds
from .dispatch import parse_call
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
    if is_bare(settings, callback):
        candidate = None
        if method is not None:
            if z0 is None and method.is_compiled_for(problem):
                candidate = first_path_point(problem, settings.tolerance)
        elif not problem.is_kkt and takes_rounds(problem):
            candidate = first_candidate(problem, start, settings.tolerance)
        if candidate is not None:
            z, rows, label, work = candidate
            reason = GUESSED if method is None else "" if work else NOTHING_TO_DO
            stage = StageRecord(label, reason, int(work > 0.0), work)
            return Result.at(problem, read_only(z), stage, settings, clock.read(), rows, method)
    from .lcp_run import run_on  # with all methods, which a small problem does without

    return run_on(problem, method, settings, start, clock, callback)


def is_bare(settings: Settings, callback: Any) -> bool:
    """Return whether nothing watches or limits a run, and the tolerance is relative."""
    is_watched = settings.record or settings.verbose or callback is not None
    is_limited = settings.max_seconds < math.inf or not settings.max_iterations
    return not (is_watched or is_limited or settings.absolute_tolerance)
