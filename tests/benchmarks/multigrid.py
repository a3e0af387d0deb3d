"""Multigrid, everything from (M, q) to the verified result, against one product with M and against a linear solve.

Times are processor seconds of this process, in which one thread computes: on a busy machine they keep their ratios
better than elapsed ones. What all threads gain is told in elapsed seconds. Cycles are corrections and fall-back sweeps
on the finest level, failed ones included, and the sweep before the first; work counts matrix entries touched on all
levels, set-up and Galerkin updates included, divided by the nonzeros of M.
"""

from __future__ import annotations

import gc
import os
import resource
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from functools import partial
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from lcp_plugin.algorithms import REGISTRY
from lcp_plugin.api import solve
from lcp_plugin.core.certificates.residuals import Certificate
from lcp_plugin.core.checks import FloatVector
from lcp_plugin.core.errors import InvalidProblem, LCPError
from lcp_plugin.core.lcp import LCP
from lcp_plugin.core.settings import checked_threads
from lcp_plugin.core.solving.result import Result
from lcp_plugin.evidence.measurement import fresh
from lcp_plugin.gallery import Scene, build, parse
from lcp_plugin.problems.batches.batch import prepare

from . import timing
from .rivals import RIVALS, Answer, Case
from .timing import quickest

TOLERANCE = 1e-8
TRUE_ERROR = 1e-6
TIME_LIMIT = 60.0
ACTIVE_SET_STEPS = 30
GROWTH_RUNS = 6
CYCLES_TIMED = 10
COPIED = 10_000_000  # doubles: more than any cache holds
TICK = 0.01  # seconds that the operating system counts in
timed = partial(timing.timed, clock=time.process_time)
PRESETS = ("psor", "pgs", "paor", "npsor", "mgs")
FORWARD, BACKWARD = (("gauss_seidel", {"sweep": sweep}) for sweep in ("forward", "backward"))
# pyamg's own defaults, and what was quickest among its interpolations, smoothers, coarse sizes and coarse solvers on
# spheres and bumps of 10⁶ unknowns; Jacobi, PMIS and one smoother alone took much longer.
PYAMG: dict[str, dict[str, Any]] = {
    "classical": {"max_coarse": 50},
    "direct": {
        "max_coarse": 500,
        "coarse_solver": "splu",
        "interpolation": "direct",
        "presmoother": FORWARD,
        "postsmoother": BACKWARD,
    },
}


class Row(NamedTuple):
    """One scene of the table: what it is called, how it is written, and what is asked of it."""

    title: str
    scene: str
    quick: str
    target: str
    linear: bool = False  # compare with pyamg's solution of M x = −q
    exact: bool = False  # compare with the direct active-set answer


JUMPS = "coefficient_jumps:size={},contrast={}"
WIND = "convection_diffusion:size={},diffusion={}"
ROWS = [
    Row(
        "obstacle, sphere",
        "obstacle_2d:size=1024",
        "obstacle_2d:size=60",
        "≤ 0.42 linear, auto 0.38",
        True,
    ),
    Row(
        "obstacle, bumps",
        "obstacle_bumps:size=1024",
        "obstacle_bumps:size=60",
        "≤ 0.42 linear, auto 0.38",
        True,
    ),
    Row("obstacle 3-D", "obstacle_3d:size=100", "obstacle_3d:size=12", "≤ 1.2 linear", True),
    Row(
        "bearing 0.9",
        "journal_bearing:size=1000,eccentricity=0.9",
        "journal_bearing:size=50",
        "≤ 2 linear",
        True,
    ),
    Row(
        "bearing 0.99",
        "journal_bearing:size=1000,eccentricity=0.99",
        "journal_bearing:size=50,eccentricity=0.99",
        "≤ 2 linear",
        True,
    ),
    *(
        Row(f"wind, ε = {e}", WIND.format(500, e), WIND.format(50, e), "≤ 25 cycles", True, True)
        for e in ("1", "1e-2", "1e-3", "1e-5")
    ),
    Row(
        "anisotropy, 30°",
        "rotated_anisotropy:size=500",
        "rotated_anisotropy:size=50",
        "≤ 25 cycles",
        True,
        True,
    ),
    *(
        Row(f"jumps {c}", JUMPS.format(500, c), JUMPS.format(50, c), target, True, True)
        for c, target in (
            ("1e2", "≤ 20 cycles"),
            ("1e6", "≤ 60 cycles"),
            ("1e10", "≤ newton's time"),
        )
    ),
    Row(
        "Example 1, δ = 0",
        "paper_example_1:n=1000000,delta=0",
        "paper_example_1:n=2500,delta=0",
        "≤ 0.9 linear",
        True,
    ),
]

FIRST_RUN = """
import time
from lcp_plugin import gallery
from lcp_plugin.evidence.measurement import fresh
from lcp_plugin import solve
problem = gallery.parse("{}").problem
for _ in range(5):
    new = fresh(problem)
    began = time.perf_counter()
    solve(new, tolerance=1e-8)
    print(time.perf_counter() - began)
"""
LARGEST = Row("10⁷ unknowns", "obstacle_2d:size=3163", "obstacle_2d:size=100", "completes")


def run(*, quick: bool = False) -> Iterator[str]:
    """Yield the table, the growth with n, the march in time, and what others need."""
    warm_up = parse(
        ROWS[0].quick if quick else ROWS[0].scene
    )  # compiles, and touches the memory for the first time
    from_scratch(warm_up.problem)
    for hierarchy in PYAMG:
        linear_solve(warm_up, hierarchy)
    for row in ROWS:
        yield _line(row, quick)
    yield first_run(ROWS[0], quick)
    yield traffic(warm_up)
    yield from growth((40, 80, 160) if quick else (512, 1024, 2048))
    yield _line(LARGEST, quick)
    peak = 1e-6 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    yield f"{LARGEST.title}: {peak:.1f} GB at the peak of this process, libraries included"
    yield american_put(*(2000, 10) if quick else (100_000, 100))
    yield from sweeping(2500 if quick else 1_000_000)
    yield from others(
        parse("obstacle_2d:size=30" if quick else "obstacle_2d:size=316"),
        5.0 if quick else TIME_LIMIT,
    )


def product_seconds(problem: LCP) -> float:
    """Return the median processor seconds of one scipy product with M."""
    M, x = problem.csr, np.random.default_rng(0).random(problem.n)
    repeats = max(1, 2_000_000 // max(problem.nonzeros, 1))

    def products() -> None:
        for _ in range(repeats):
            M @ x

    products()
    return max(statistics.median(timed(products).seconds for _ in range(9)) / repeats, 1e-9)


def from_scratch(problem: LCP, algorithm: str = "multigrid", **options: Any) -> Result:
    """Return the result for a problem stated anew, so that nothing computed before is used; by one thread if unsaid."""
    return solve(fresh(problem), algorithm, tolerance=TOLERANCE, **{"threads": 1} | options)


def _line(row: Row, quick: bool) -> str:
    scene = parse(row.quick if quick else row.scene)
    problem = scene.problem
    gc.collect()
    product = product_seconds(problem)
    calls: dict[str, Callable[[], Any]] = {
        "pgs": partial(from_scratch, problem),
    }
    if row.linear:
        calls |= {name: partial(linear_solve, scene, name) for name in PYAMG}
    best = quickest(calls)
    ours = best["pgs"]
    rival = min(
        (name for name in PYAMG if name in best), key=lambda name: best[name].seconds, default=""
    )
    seconds, product = ours.seconds, statistics.median((product, product_seconds(problem)))
    result: Result = ours.answer
    parts = [
        f"{row.title:<22} n = {problem.n:<8}",
        f"{result.status.name} {result.iterations:3d} cycles",
        f"work {result.work:4.0f}",
        f"{seconds:7.3f} s = {seconds / product:5.0f} products",
    ]
    if rival:
        linear = best[rival]
        parts.append(f"÷ linear solve {seconds / linear.seconds:.2f} ({linear.answer})")
        parts.append(_on_all_threads(problem, {"linear": calls[rival]}))
    if row.exact:
        parts.append(f"true error {true_error(problem, result.z):.1e} (target {TRUE_ERROR:g})")
    if "newton" in row.target and "newton" in REGISTRY:
        parts.append(
            f"newton ÷ ours {timed(partial(from_scratch, problem, 'newton')).seconds / seconds:.1f}"
        )
    return "   ".join([*parts, f"target {row.target}"])


def _on_all_threads(problem: LCP, calls: dict[str, Callable[[], Any]]) -> str:
    """Return what auto and multigrid need on all threads and on one, beside the linear solve, in elapsed seconds."""
    threads = checked_threads(None)
    for name in ("auto", "multigrid"):
        calls |= {
            f"{name} on {count}": partial(from_scratch, problem, name, threads=count)
            for count in (1, threads)
        }
    elapsed = {
        name: min(one.seconds for one in runs) for name, runs in timing.rounds(calls, 2).items()
    }
    linear = elapsed.pop("linear")
    parts = [
        f"{name} {seconds:.2f} s ÷ linear {seconds / linear:.2f}"
        for name, seconds in elapsed.items()
    ]
    return ", ".join(["elapsed", *parts])


def first_run(row: Row, quick: bool) -> str:
    """Return what auto needs for the first time in a process, compiled kernels on disk, beside its best run there."""
    program = FIRST_RUN.format(row.quick if quick else row.scene)
    told = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    ).stdout.split()
    first, *others = map(float, told)
    return (
        f"first run in a process, {row.title}: {first:.2f} s elapsed on {checked_threads(None)} threads, "
        f"÷ the best of {len(others)} more {first / min(others):.2f}   target ≤ 1.3"
    )


def require_pyamg() -> Any:
    """Return pyamg, or say how to install it."""
    try:
        import pyamg
    except ImportError as error:
        raise LCPError(
            "this benchmark needs pyamg; install it with: pip install -r tests/benchmarks/requirements.txt"
        ) from error
    return pyamg


def linear_solve(scene: Scene, hierarchy: str = "classical") -> str:
    """Solve M x = −q by a Ruge–Stüben hierarchy of pyamg's with CG (BiCGStab where M is not symmetric) to 1e-8."""
    import scipy.sparse as sp

    pyamg = require_pyamg()

    problem = scene.problem
    residuals: list[float] = []
    built = pyamg.ruge_stuben_solver(sp.csr_matrix(problem.csr), **PYAMG[hierarchy])
    accelerator = "cg" if scene.is_symmetric else "bicgstab"
    built.solve(-problem.q, tol=TOLERANCE, accel=accelerator, maxiter=200, residuals=residuals)
    return f"pyamg {hierarchy}, {accelerator}, {len(residuals) - 1} iterations"


def true_error(problem: LCP, z: FloatVector) -> float:
    """Return ‖z − z*‖∞/‖z*‖∞ with z* from direct active-set steps that begin at z; NaN where they do not settle."""
    from scipy.sparse.linalg import splu

    M, lower, upper, known, exact = problem.csr, problem.lower, problem.upper, None, z
    for _ in range(ACTIVE_SET_STEPS):
        step = exact - problem.slack(exact) / problem.diagonal
        sides = (step >= upper).astype(np.int8) - (step <= lower).astype(np.int8)
        if known is not None and np.array_equal(sides, known):
            return float(np.abs(z - exact).max() / np.abs(exact).max())
        known = sides
        exact = np.where(sides < 0, lower, np.where(sides > 0, upper, 0.0))
        free = np.flatnonzero(sides == 0)
        factor = splu(M[free][:, free].tocsc(), permc_spec="MMD_AT_PLUS_A")
        exact[free] = factor.solve(-problem.slack(exact)[free])
    return float("nan")


def traffic(scene: Scene) -> str:
    """Return what one V-cycle must move at least, each array once a pass, beside what the machine copies."""
    from lcp_plugin.systems.hierarchy.levels import COARSEST, hierarchy_of
    from lcp_plugin.systems.hierarchy.truncation import Truncation

    hierarchy = hierarchy_of(scene.problem.matrix, COARSEST)
    truncation = Truncation(hierarchy)
    from_here, to = np.ones(COPIED), np.empty(COPIED)
    best = quickest(
        {"cycle": partial(truncation.correct, 0), "copy": partial(np.copyto, to, from_here)},
        CYCLES_TIMED,
    )
    cycle, copy = (max(best[name].seconds, 1e-9) for name in ("cycle", "copy"))
    moved = _cycle_bytes(hierarchy)
    return (
        f"V-cycle, {scene!r}: {moved / scene.problem.n:.0f} bytes an unknown, {1e-9 * moved / cycle:.1f} GB/s; "
        f"the machine copies {1e-9 * 16 * COPIED / copy:.1f} GB/s"
    )


def _cycle_bytes(hierarchy: Any) -> float:
    """Two passes over each matrix; one over P and its transpose; 13 reads or writes a row."""
    moved = 0.0
    for grid, transfer in zip(hierarchy.grids, hierarchy.transfers, strict=False):
        moved += (
            2.0 * _entry_bytes(grid.matrix) * grid.matrix.data.size
            + 13.0 * grid.inverse.itemsize * grid.n
        )
        moved += sum(
            _entry_bytes(way) * way.data.size
            for way in (transfer.prolongation, transfer.restriction)
        )
    return moved


def _entry_bytes(matrix: Any) -> int:
    return int(matrix.data.itemsize + matrix.indices.itemsize)


def growth(sizes: tuple[int, ...]) -> Iterator[str]:
    """Yield the time on the sphere and the bumps for meshes each twice as fine.

    Without the operating system's share as well: memory that nobody has touched yet costs a virtual machine up to four
    times what the program does with it.
    """
    for name in ("obstacle_2d", "obstacle_bumps"):
        problems = [build(name, size=size).problem for size in sizes]
        best = quickest(
            {str(p.n): partial(_user_seconds, p) for p in problems}, repeats=GROWTH_RUNS
        )
        yield f"growth {name}: n = {', '.join(best)}, cycles {[one.answer[0] for one in best.values()]}"
        for what, seconds in (
            ("all", [one.seconds for one in best.values()]),
            ("the program's", [one.answer[1] for one in best.values()]),
        ):
            factors = ", ".join(f"{b / max(a, TICK):.2f}" for a, b in pairwise(seconds))
            shown = ", ".join(f"{value:.3f}" for value in seconds)
            yield f"growth {name}: {shown} s ({what})   per 4 n: {factors}   target ≤ 4.3"


def _user_seconds(problem: LCP) -> tuple[int, float]:
    began = os.times().user
    return from_scratch(problem).iterations, os.times().user - began


def american_put(size: int, steps: int) -> str:
    """Return what a march costs with a prepared problem and warm starts; corrections are V-cycles on the finest."""
    scene = build("american_put_march", size=size, steps=steps)
    advance = scene.advance
    if advance is None:
        raise InvalidProblem(
            f"{scene!r} is no march: nothing tells the q of the next step; give it `advance`"
        )

    def march() -> tuple[int, int]:
        problem = prepare(LCP(scene.problem.csr, scene.problem.q, lower=scene.problem.lower))
        z, cycles, solved = np.array(problem.lower), 0, 0
        for _ in range(steps):
            result = solve(problem, "multigrid", z0=z, tolerance=TOLERANCE)
            z, cycles, solved = result.z, cycles + result.iterations - 1, solved + result.is_solved
            problem = problem.with_q(advance(z))
        return cycles, solved

    one = timed(march)
    cycles, solved = one.answer
    return (
        f"American put, n = {size}, {solved} of {steps} steps SOLVED by multigrid: {one.seconds:.2f} s, "
        f"{cycles / steps:.2f} corrections a step   target ≤ 10 s, ≤ 4"
    )


def sweeping(n: int) -> Iterator[str]:
    """Yield what auto, the presets and multigrid need where sweeps alone are good enough."""
    for text, target in (
        (f"random_h_plus:n={n}", "≤ 60 work"),
        (f"paper_example_1:n={n},delta=4", ""),
    ):
        problem = parse(text).problem
        names = ("auto", *PRESETS, "multigrid")
        best = quickest({name: partial(from_scratch, problem, name) for name in names}, repeats=5)
        least = min(best[name].seconds for name in names if name != "auto")
        wanted = "" if target else "   target ≤ 1.1"
        yield f"{text:<32} auto ÷ the best named: {best['auto'].seconds / least:.2f}{wanted}"
        for one in best.values():
            result: Result = one.answer
            yield (
                f"{text:<32} {result.algorithm}: {result.status.name} {result.iterations} iterations, "
                f"work {result.work:.0f}, {one.seconds:.3f} s   {'target ' + target if target else ''}"
            ).rstrip()


def others(scene: Scene, limit: float) -> Iterator[str]:
    """Yield what plain sweeps and convex solvers need for the obstacle problem, each within `limit` seconds."""
    problem = scene.problem
    case = Case(f"sphere n = {problem.n}", problem.csr, problem.q, problem.lower, problem.upper)
    calls: dict[str, Callable[[], str]] = {
        name: partial(_status, problem, name, limit) for name in ("multigrid", "psor", "npgs")
    }
    calls["OSQP"] = partial(_judged, problem, lambda: RIVALS["OSQP"].answer(case, TOLERANCE, limit))
    calls["PIQP"] = partial(
        _judged, problem, lambda: RIVALS["PIQP sparse"].answer(case, 0.1 * TOLERANCE, limit)
    )
    for name, call in calls.items():
        try:
            one = timed(call)
        except ImportError:
            yield f"{case.name}: {name} is not installed"
            continue
        yield f"{case.name}: {name:<10} {one.seconds:8.3f} s   {one.answer}"


def _status(problem: LCP, name: str, limit: float) -> str:
    result = from_scratch(problem, name, max_seconds=limit)
    return f"{result.status.name}, {result.iterations} iterations, residual {result.residual:.1e}"


def _judged(problem: LCP, solver: Callable[[], Answer]) -> str:
    z, status = solver()
    return f"{status}, relative residual {Certificate.of(problem, z).relative_residual:.1e}"
