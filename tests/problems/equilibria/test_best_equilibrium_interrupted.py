"""Ctrl-C in a search for the best of all solutions: whatever it hits, what is said afterwards holds."""

from __future__ import annotations

import math
import sys
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np
import pytest

from lcp_plugin import EquilibriumProgram, QuadraticProgram
from lcp_plugin.core.settings import Status
from lcp_plugin.problems.equilibria.branch_and_bound import minimize_over_solutions


def some_pairs() -> EquilibriumProgram:
    """Return a problem whose relaxation lies below its optimum."""
    rng = np.random.default_rng(3)
    k = 5
    program = QuadraticProgram(
        np.zeros((k + 2, k + 2)),
        rng.integers(-4, 5, k + 2),
        lower=[-1, -1] + [0] * k,
        upper=[1, 1] + [3] * k,
    )
    M, q = rng.integers(-3, 4, (k, k + 2)), rng.integers(-3, 4, k)
    return EquilibriumProgram.of_rows(program, np.arange(2, k + 2), M, q)


def interrupted(at: int) -> tuple[Any, int]:
    """Return the result of a search that Ctrl-C hits at a line of the tree's or the relaxations' code; the lines."""
    lines = 0

    def line(frame: FrameType, event: str, _: Any) -> Any:
        nonlocal lines
        lines += event == "line"
        if lines == at and event == "line":
            raise KeyboardInterrupt
        return line

    def call(frame: FrameType, event: str, _: Any) -> Any:
        is_search = frame.f_code.co_filename.endswith(("branch_and_bound.py", "relaxations.py"))
        is_begun = frame.f_code.co_name not in (
            "minimize_over_solutions",
            "__init__",
            "_result",
            "clock",
        )
        return line if is_search and is_begun and is_running(frame) else None

    before = sys.gettrace()
    sys.settrace(call)
    try:
        return minimize_over_solutions(some_pairs(), prove=True), lines
    finally:
        sys.settrace(before)


def is_running(frame: FrameType | None) -> bool:
    """Whether this is a call below the search itself."""
    places = []
    while frame is not None:
        places.append((Path(frame.f_code.co_filename).name, frame.f_code.co_name))
        frame = frame.f_back
    searching = "branch_and_bound.py"
    return (searching, "run") in places[1:] and (searching, "_result") not in places


@pytest.mark.full
def test_wherever_the_search_is_interrupted_its_bound_and_status_hold() -> None:
    """No bound lies above the optimum, nothing is called optimal that is not, and verify() agrees."""
    whole, lines = interrupted(-1)
    assert (whole.status, whole.verify(), whole.nodes > 1) == (Status.SOLVED, True, True)
    for at in range(1, lines + 1, 97):
        result, _ = interrupted(at)
        assert result.status is Status.INTERRUPTED or (result.status, result.value) == (
            Status.SOLVED,
            whole.value,
        ), at
        assert result.lower_bound <= whole.value, at
        assert result.verify() or result.bound_by == "SCIP", at
    first, _ = interrupted(1)
    assert (first.status, first.lower_bound, first.x) == (Status.INTERRUPTED, -math.inf, None)
