"""The constants of ``lcp_plugin.crossovers`` beside what this machine says of each."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial

import numpy as np

from ... import crossovers
from ...algorithms.splittings.projected_relaxation import PSOR
from ...algorithms.splittings.projected_type import NPSOR
from ...certificates.error_bounds import error_bound
from ...problem.lcp import LCP
from ...solving.driver import solve
from ..contestants import fresh
from ..gallery import build
from .timing import medians


def run(*, quick: bool = False) -> Iterator[str]:
    """Yield a line a constant: its name, its value, and what was measured."""
    repeats = 3 if quick else 9
    for name, measure in MEASURED.items():
        yield f"{name:<24} {getattr(crossovers, name):>9g}   measured {measure(repeats)}"


def _solved_afresh(problem: LCP, name: str) -> object:
    return solve(fresh(problem), name)


def _grid(size: int) -> LCP:
    return build("obstacle_2d", size=size).problem


def _dense(n: int) -> LCP:
    rng = np.random.default_rng(n)
    factor = rng.normal(size=(n, n))
    return LCP(factor @ factor.T / n + 0.1 * np.eye(n), rng.normal(size=n))


def _passes(problem: LCP, name: str, repeats: int) -> str:
    """Return the work of a cold solve, as it is counted and as its seconds by those of an npsor sweep."""
    sweeps = 400
    seconds = medians({
        "answer": lambda: solve(fresh(problem), name),
        "sweeps": lambda: solve(problem, "npsor", max_iterations=sweeps, tolerance=0.0),
        "none": lambda: solve(problem, "npsor", max_iterations=0, tolerance=0.0),
    }, repeats)
    sweep = max((seconds["sweeps"] - seconds["none"]) / sweeps, 1e-9)
    counted = solve(fresh(problem), name).work
    return f"{counted:.0f} passes counted, {seconds['answer'] / sweep:.0f} by the clock ({name}, n = {problem.n})"


def _direct(repeats: int) -> str:
    return _passes(_grid(30), "newton", repeats)


def _direct_dense(repeats: int) -> str:
    return _passes(_dense(300), "interior_point", repeats)


def _multigrid(repeats: int) -> str:
    return _passes(_grid(150), "multigrid", repeats)


def _gain(repeats: int) -> str:
    """Return how many sweeps of npsor one of psor is worth, over a range of grids."""
    found = []
    for size in (10, 20, 40):
        npsor, psor = (solve(_grid(size), one).iterations for one in (NPSOR(scaling="diagonal"), PSOR()))
        found.append(npsor / psor)
    return "on grids of 10², 20² and 40²: " + ", ".join(f"{one:.1f}" for one in found)


def _factor_or_multigrid(repeats: int) -> str:
    last = 0
    for size in (15, 22, 32, 45, 64, 90, 128):
        problem = _grid(size)
        ways = {name: partial(_solved_afresh, problem, name) for name in ("newton", "multigrid")}
        seconds = medians(ways, repeats)
        if seconds["newton"] > seconds["multigrid"]:
            return f"newton, then multigrid is the faster one between {last} and {problem.n} rows"
        last = problem.n
    return f"newton is the faster one up to {last} rows"


def _sharp_bound(repeats: int) -> str:
    problem = _grid(316)
    z = solve(problem, "multigrid").z
    seconds = medians({"bound": lambda: error_bound(fresh(problem), z)}, min(repeats, 3))["bound"]
    return f"{seconds:.2f} s for a sharp bound with n = {problem.n}"


MEASURED: dict[str, Callable[[int], str]] = {
    "DIRECT_PASSES": _direct, "DIRECT_PASSES_DENSE": _direct_dense, "MULTIGRID_PASSES": _multigrid, "PSOR_GAIN": _gain,
    "DIRECT_UP_TO": _factor_or_multigrid, "SHARP_SAMPLES_UP_TO": _sharp_bound,
}
