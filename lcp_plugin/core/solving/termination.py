"""Reasons why the steps of a run ended."""

from __future__ import annotations

from enum import Enum


class TerminationReason(Enum):
    """Why the steps of a run ended; the run derives the status from it and from the best z."""

    CONVERGED = "a point passed both tests of the criterion"
    NO_SOLUTION = "a step proved that there is no solution"
    AT_FLOOR = "the residual is no larger than rounding explains"
    STALLED = "the residual has stopped falling, or falls too slowly"
    DIVERGED = "the residual left every reasonable range"
    OVER_BUDGET = "another method takes over"
    NOTHING_LEFT = "the last algorithm had no further step"
    STEP_LIMIT = "max_iterations came first"
    TIME_LIMIT = "max_seconds came first"
    INTERRUPTED = "Ctrl-C or the callback came first"


FAILED = (
    TerminationReason.STALLED,
    TerminationReason.DIVERGED,
    TerminationReason.OVER_BUDGET,
    TerminationReason.NOTHING_LEFT,
)  # another algorithm may do better
