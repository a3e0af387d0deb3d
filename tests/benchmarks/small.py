"""Small dense problems, one by one and in batches, next to the compiled Lemke of quantecon."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from importlib import import_module
from importlib.util import find_spec
from typing import Any

import numpy as np
from inputs.small_families import falling_bodies, spectrum

from lcp_plugin.api import solve
from lcp_plugin.core.lcp import LCP
from lcp_plugin.core.settings import Status
from lcp_plugin.problems.batches.batch import solve_batch

from .timing import medians

REPEATS = 9


def run(*, quick: bool = False) -> Iterator[str]:
    """Yield a line for each kind of problem: microseconds of a solve, and of a problem in a batch."""
    few, many = (2, 50) if quick else (20, 1000)
    for n in (10, 30) if quick else (10, 30, 100):
        yield _line(f"dense SPD n = {n}", partial(spectrum, n, 1e2, 0.4), few, many)
    for contacts in (2, 5, 10):
        yield _line(f"friction n = {6 * contacts}", partial(falling_bodies, contacts), few, many)


def _line(name: str, draw: Callable[[int], LCP], few: int, many: int) -> str:
    problems = [draw(k) for k in range(many)]
    M, q = (np.array([getattr(one, name) for one in problems]) for name in ("M", "q"))
    calls: dict[str, Callable[[], Any]] = {
        "solve": partial(_solved, problems[:few]),
        "batch": partial(solve_batch, M, q, threads=1),
        "batch, two threads": partial(solve_batch, M, q, threads=2),
    }
    if find_spec("quantecon") is not None:
        lemke = import_module("quantecon.optimize.lcp_lemke").lcp_lemke
        calls["compiled Lemke"] = lambda: [lemke(M[k], q[k]) for k in range(few)]
    statuses = solve_batch(M, q, threads=1).status
    unsolved = sum(status is not Status.SOLVED for status in statuses)
    told = ", ".join(
        f"{way} {1e6 * seconds / (many if way.startswith('batch') else few):.1f} µs"
        for way, seconds in medians(calls, REPEATS).items()
    )
    return f"{name}: {told} a problem; {unsolved} of {many} unsolved in the batch"


def _solved(problems: list[LCP]) -> None:
    for problem in problems:
        solve(problem)
