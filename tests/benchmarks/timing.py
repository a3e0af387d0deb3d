"""Timing side by side: what is compared runs in turn, so that a drifting machine drifts for all."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

Calls = Mapping[str, Callable[[], Any]]


@dataclass(frozen=True)
class Timed:
    """What one call gave, and its seconds."""

    answer: Any
    seconds: float


def timed(call: Callable[[], Any], clock: Callable[[], float] = time.perf_counter) -> Timed:
    """Return the answer of the call and its seconds on the clock."""
    began = clock()
    answer = call()
    return Timed(answer, clock() - began)


def rounds(
    calls: Calls, repeats: int, clock: Callable[[], float] = time.perf_counter
) -> dict[str, list[Timed]]:
    """Return all runs of each call, in rounds of all of them in turn."""
    runs = [{name: timed(call, clock) for name, call in calls.items()} for _ in range(repeats)]
    return {name: [run[name] for run in runs] for name in calls}


def quickest(calls: Calls, repeats: int = 2) -> dict[str, Timed]:
    """Return the quickest of some runs of each call, in processor seconds, all treated alike and in turn."""
    every = rounds(calls, repeats, time.process_time)
    return {name: min(runs, key=lambda one: one.seconds) for name, runs in every.items()}
