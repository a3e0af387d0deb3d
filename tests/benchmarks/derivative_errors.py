"""How far dz/dq · h is from the exact one, and a difference of two solves, after how much time, by tolerance."""

from __future__ import annotations

import statistics
import time
from collections.abc import Iterator

import numpy as np

from lcp_plugin.api import solve
from lcp_plugin.core.certificates.row_residuals import is_at_bound
from lcp_plugin.core.checks import FloatVector
from lcp_plugin.core.lcp import LCP
from lcp_plugin.evidence.measurement import fresh
from lcp_plugin.gallery import parse
from lcp_plugin.problems.sensitivity import derivative

SCENES = ("half_active:n=10000", "paper_example_2:n=10000")
QUICK_SCENES = ("half_active:n=2500",)
TOLERANCES = (1e-2, 1e-4, 1e-6, 1e-8, 1e-10)
WAYS = ("derivative", "difference")
REPEATS = 3


def run(*, quick: bool = False) -> Iterator[str]:
    """Yield a line a scene, tolerance and way: the relative error of dz on a planted direction, and median seconds."""
    for text in QUICK_SCENES if quick else SCENES:
        scene = parse(text)
        exact, h = _planted(scene.problem, np.asarray(scene.exact))
        for tolerance in TOLERANCES:
            for way in WAYS:
                error, seconds = _measured(way, scene.problem, exact, h, tolerance)
                yield f"{text:<24} {way:<11} tolerance {tolerance:.0e}   {seconds:.4f} s   error {error:.1e}"


def _measured(
    way: str, problem: LCP, exact: FloatVector, h: FloatVector, tolerance: float
) -> tuple[float, float]:
    seconds = []
    for _ in range(REPEATS + 1):  # the first one may compile
        stated_anew, began = fresh(problem), time.perf_counter()
        change = _change(way, stated_anew, h, tolerance)
        seconds.append(time.perf_counter() - began)
    return float(np.abs(change - exact).max() / np.abs(exact).max()), statistics.median(seconds[1:])


def _planted(problem: LCP, z: FloatVector) -> tuple[FloatVector, FloatVector]:
    """Return a random change of the exact z on its free rows, and a change of q that has it for its derivative.

    Rows at a bound stay there; where w = 0 as well, w grows to the side that holds them.
    """
    held, sizes = (
        is_at_bound(problem, z),
        np.random.default_rng(0).uniform(0.5, 1.5, (2, problem.n)),
    )
    dz = np.where(held, 0.0, sizes[0])
    dw = (
        np.where(held, np.where(z == problem.lower, sizes[1], -sizes[1]), 0.0)
        * problem.residual_scale
    )
    return dz, dw - problem.csr @ dz


def _change(way: str, problem: LCP, h: FloatVector, tolerance: float) -> FloatVector:
    """Return dz for dq = h."""
    result = solve(problem, tolerance=tolerance)
    if way == "derivative":
        return derivative(result).jvp(dq=h)
    step = np.sqrt(tolerance) * np.abs(problem.q).max() / np.abs(h).max()
    change: FloatVector = (
        solve(problem.with_q(problem.q + step * h), tolerance=tolerance).z - result.z
    ) / step
    return change
