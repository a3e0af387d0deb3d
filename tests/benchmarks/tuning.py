"""The constants of ``lcp_plugin.core.tuning`` beside what this machine says of each."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from functools import partial

import numpy as np
import scipy.sparse as sp

from lcp_plugin.api import solve
from lcp_plugin.core import tuning
from lcp_plugin.core.kernels.threads import share, threads_for
from lcp_plugin.core.lcp import LCP
from lcp_plugin.core.policy.stages import Stage
from lcp_plugin.core.splittings.projected_relaxation import PSOR
from lcp_plugin.core.splittings.projected_type import NPSOR
from lcp_plugin.evidence.measurement import fresh
from lcp_plugin.gallery import build
from lcp_plugin.proofs.bounds.error_bounds import error_bound
from lcp_plugin.proofs.no_solution.infeasibility import find_infeasibility
from lcp_plugin.systems.definiteness import is_semidefinite_to_rounding, symmetric_part
from lcp_plugin.systems.factors import factorise, positive_factor, sizes_of_factor, solver_of

from .small import friction
from .timing import medians


def run(*, quick: bool = False) -> Iterator[str]:
    """Yield a line a constant: its name, its value, and what was measured."""
    repeats = 3 if quick else 9
    for name, measure in MEASURED.items():
        yield f"{name:<24} {getattr(tuning, name):>9g}   measured {measure(repeats)}"


def _solved_afresh(problem: LCP, name: str) -> object:
    return solve(fresh(problem), name)


def _grid(size: int) -> LCP:
    return build("obstacle_2d", size=size).problem


def _dense(n: int) -> LCP:
    rng = np.random.default_rng(n)
    factor = rng.normal(size=(n, n))
    return LCP(factor @ factor.T / n + 0.1 * np.eye(n), rng.normal(size=n))


def _seconds_of_sweep(problem: LCP, name: str, repeats: int) -> float:
    """Return what a driven sweep takes."""
    sweeps = 400
    seconds = medians(
        {
            "sweeps": lambda: solve(problem, name, max_iterations=sweeps, tolerance=0.0),
            "none": lambda: solve(problem, name, max_iterations=0, tolerance=0.0),
        },
        repeats,
    )
    return max((seconds["sweeps"] - seconds["none"]) / sweeps, 1e-9)


def _passes(problem: LCP, name: str, repeats: int) -> str:
    """Return the work of a cold solve, as it is counted and as its seconds by those of an npsor sweep."""
    seconds = medians({"answer": lambda: solve(fresh(problem), name)}, repeats)
    sweep = _seconds_of_sweep(problem, "npsor", repeats)
    counted = solve(fresh(problem), name).work
    return f"{counted:.0f} passes counted, {seconds['answer'] / sweep:.0f} by the clock ({name}, n = {problem.n})"


def _direct(repeats: int) -> str:
    problem = _grid(30)
    return f"{_passes(problem, 'newton', repeats)}, of {problem.nonzeros / problem.n:.0f} entries a row"


def _direct_small(repeats: int) -> str:
    problem = LCP(_random_definite(150, 0.2), np.linspace(-1.0, 0.5, 150))
    return f"{_passes(problem, 'interior_point', repeats)}, {problem.nonzeros} entries"


def _calls_of_a_sweep(repeats: int) -> str:
    """Return what a driven sweep takes besides its entries, by two grids."""
    small, large = _grid(15), _grid(60)
    few, many = (1e6 * _seconds_of_sweep(problem, "psor", repeats) for problem in (small, large))
    entry = max((many - few) / (large.nonzeros - small.nonzeros), 1e-9)
    return f"{few / entry - small.nonzeros:.0f} entries (psor on grids of 15² and 60²)"


def _multigrid_small(repeats: int) -> str:
    problem = _grid(40)
    return f"{_passes(problem, 'multigrid', repeats)}, of {problem.n} rows"


def _small_band(repeats: int) -> str:
    return _passes(LCP(_grid(14).csr, np.linspace(-1.0, 0.5, 196)), "banded", repeats)


def _direct_dense(repeats: int) -> str:
    return _passes(_dense(300), "interior_point", repeats)


def _direct_in_rows(repeats: int) -> str:
    """Return the same where M is dense and not symmetric, of what moves farther to one side than to the other."""
    k = np.arange(300)
    jumps = np.exp(-0.02 * np.abs(k[:, None] - k)) * np.where(k[:, None] > k, 1.5, 0.5)
    problem = LCP(np.diag(1.001 * jumps.sum(1)) - jumps, np.where(k % 3 == 0, 1.0, -1.0))
    return "; ".join(f"{_passes(problem, name, repeats)}" for name in ("newton", "interior_point"))


def _multigrid(repeats: int) -> str:
    return _passes(_grid(150), "multigrid", repeats)


def _gain(repeats: int) -> str:
    """Return how many sweeps psor needs beside the root of those that npsor promises after ten, over some grids."""
    found = []
    for size in (10, 20, 40):
        trial = Stage(NPSOR(scaling="diagonal"))
        for sample in solve(_grid(size), trial.algorithm, max_iterations=10, record=True).history:
            trial.iterations = sample.iteration
            trial.note(sample.residual or 0.0)
        found.append(solve(_grid(size), PSOR()).iterations / trial.steps_to_go(1e-8) ** 0.5)
    return "on grids of 10², 20² and 40²: " + ", ".join(f"{one:.1f}" for one in found)


def _least(repeats: int) -> str:
    grid = _grid(30)
    problem = LCP(grid.csr + sp.diags_array(grid.diagonal), np.linspace(-1.0, 0.5, grid.n))
    npsor, psor = (solve(problem, one).iterations for one in (NPSOR(scaling="diagonal"), PSOR()))
    return f"{psor} sweeps where the rows are dominated and npsor takes {npsor}"


def _friction(contacts: int) -> LCP:
    case = friction(contacts)
    return LCP(case.M, case.q)


def _interior_steps(repeats: int) -> str:
    runs = (
        solve(_friction(contacts), "interior_point", prove_infeasibility=False)
        for contacts in (10, 40, 100)
    )
    steps = [int(run.stages[-1].remark.split()[2]) for run in runs]  # "piqp took 14 steps"
    return "on frictional contact with n = 60, 240 and 600: " + ", ".join(map(str, steps))


def _pivots_or_interior(repeats: int) -> str:
    names, last = ("lemke", "interior_point"), 0
    for contacts in (10, 20, 40, 70, 100, 150, 200):
        problem = _friction(contacts)
        seconds = medians({name: partial(_solved_afresh, problem, name) for name in names}, repeats)
        if seconds["lemke"] > seconds["interior_point"]:
            return (
                f"lemke, then interior_point is the faster one between {last} and {problem.n} rows"
            )
        last = problem.n
    return f"lemke is the faster one up to {last} rows"


def random_band(n: int, width: int, coupling: float) -> LCP:
    """Return a problem with full random diagonals that dominates its rows by little; the couplings have that sign."""
    rng = np.random.default_rng(n)
    sides = [k for k in range(-width, width + 1) if k]
    M = sp.diags_array(
        [coupling * rng.random(n - abs(k)) for k in sides], offsets=sides, shape=(n, n)
    )
    M = M + sp.diags_array(1.01 * np.asarray(abs(M).sum(axis=1)).ravel())
    return LCP(M, rng.normal(size=n), upper=rng.exponential(size=n))


def _rounds(width: int, coupling: float, repeats: int) -> str:
    counts = [
        solve(random_band(1000 + k, width, coupling), "banded").iterations for k in range(repeats)
    ]
    return f"{min(counts)} to {max(counts)} rounds in boxes, {width} diagonals on either side"


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


def _once(what: str, problem: LCP, work: Callable[[LCP], object]) -> str:
    seconds = medians({"once": lambda: work(fresh(problem))}, 1)["once"]
    return f"{seconds:.2f} s for {what} with n = {problem.n}"


def _program(repeats: int) -> str:
    return _once("the linear program of feasibility", _grid(70), find_infeasibility)


def _operations(repeats: int) -> str:
    """Return how long the largest factor takes, and what one operation of it takes beside an entry of a sweep."""
    ratios, seconds_of_largest = [], 0.0
    for size in (100, 300):
        problem = _grid(size)
        operations = sizes_of_factor(problem.matrix)[1]
        seconds = medians({"factor": partial(factorise, problem.M, is_symmetric=True)}, repeats)[
            "factor"
        ]
        ratios.append(
            seconds / operations * problem.nonzeros / _seconds_of_sweep(problem, "npgs", repeats)
        )
        seconds_of_largest = seconds / operations * tuning.FACTOR_OPERATIONS_UP_TO
    return f"{seconds_of_largest:.0f} s; an operation is {min(ratios):.2f} to {max(ratios):.2f} entries of a sweep"


def _speed(problem: LCP, operations: float, repeats: int) -> str:
    """Return how many operations a second a factorisation of M makes."""
    seconds = medians({"factor": partial(factorise, problem.M, is_symmetric=True)}, repeats)[
        "factor"
    ]
    return f"{operations / seconds:.1e} operations a second, n = {problem.n}"


def _dense_speed(repeats: int) -> str:
    return _speed(_dense(1000), 1000.0**3 / 3.0, repeats)


def _sparse_speed(repeats: int) -> str:
    problem = _grid(300)
    return _speed(problem, sizes_of_factor(problem.matrix)[1], repeats)


def _pivoted(repeats: int) -> str:
    return f"{8e-9 * tuning.PIVOTED_UP_TO**2:.1f} GB of inverse, by its size"


def _semidefiniteness(repeats: int) -> str:
    def look(problem: LCP) -> bool | None:
        return is_semidefinite_to_rounding(symmetric_part(problem.M))

    return _once("a factor of M + Mᵀ", _grid(141), look)


def _sweep_or_change(repeats: int) -> str:
    problem = _dense(tuning.SWEEPS_FIRST_UP_TO)
    solved = solver_of(problem.M, dense_up_to=problem.n) or np.copy
    seconds = medians(
        {"sweep": lambda: problem.M @ problem.q, "change": lambda: solved(problem.q)}, repeats
    )
    return f"a product with M costs {seconds['sweep'] / seconds['change']:.1f} solves with its factor, n = {problem.n}"


def _random_definite(n: int, share: float) -> sp.csr_array:
    """Return a definite matrix with about that share of entries, in no order that a factor could use."""
    rng = np.random.default_rng(n)
    factor = sp.random_array((n, n), density=np.sqrt(share / n), rng=rng, format="csr")
    product = sp.csr_array(factor @ factor.T)
    return sp.csr_array(symmetric_part(product) + sp.eye_array(n))


def _definite_band(n: int, share: float) -> sp.csr_array:
    """Return a definite matrix with that share of entries, whose factor has no others."""
    width = round(0.5 * share * n)
    sides = [k for k in range(-width, width + 1) if k]
    band = sp.diags_array(
        [2.0 * width + 1.0, *(-1.0 for _ in sides)], offsets=[0, *sides], shape=(n, n)
    )
    return sp.csr_array(band)


def _seconds_of_cholesky(P: sp.csr_array, repeats: int) -> dict[str, float]:
    ways = {
        "dense": lambda: positive_factor(P.toarray()),
        "sparse": lambda: positive_factor(sp.csc_array(P)),
    }
    return medians(ways, repeats)


def _cholesky(n: int, share: float, repeats: int) -> str:
    P = _random_definite(n, share)
    seconds, filled = _seconds_of_cholesky(P, repeats), P.nnz / n**2
    return f"dense takes {seconds['dense'] / seconds['sparse']:.2f} of sparse for n = {n}, {filled:.1%} of the entries"


def _largest_cholesky(n: int, share: float, repeats: int) -> str:
    """Return what is gained where all fills in, and what is lost where nothing does."""
    seconds = _seconds_of_cholesky(_definite_band(n, share), repeats)
    lost = seconds["dense"] - seconds["sparse"]
    return f"{_cholesky(n, share, repeats)} in no order; {lost:.2f} s more on a band"


def _compiled(make: Callable[[int], LCP], constant: str, repeats: int) -> str:
    """Return what the compiled road costs at its end, and a row beyond it."""
    n = getattr(tuning, constant)
    problems = {"compiled": make(n), "long": make(n + 1)}
    ways = {name: partial(_solved_afresh, problem, "auto") for name, problem in problems.items()}
    seconds = medians(ways, repeats)
    ratio = seconds["long"] / seconds["compiled"]
    return f"auto takes {ratio:.1f} times as long for n = {n + 1} as for {n}, {seconds['compiled']:.1e} s"


def _scattered(n: int) -> LCP:
    """Return a sparse H₊ problem without narrow bands."""
    rng = np.random.default_rng(n)
    places = sp.random_array((n, n), density=0.04, rng=rng)
    M = sp.csr_array(
        sp.diags_array(0.5 + np.asarray((places + places.T).sum(axis=1))) - (places + places.T)
    )
    return LCP(M, rng.normal(size=n))


def _sharp_bound(repeats: int) -> str:
    problem = _grid(316)
    z = solve(problem, "multigrid").z
    return _once("a sharp bound", problem, lambda problem: error_bound(problem, z))


def _hand_over(repeats: int) -> str:
    """Return what two threads that wait for each other once need beside what a pass over so many rows takes."""
    problem, together = build("obstacle_2d", size=256).problem, threading.Barrier(2)
    with threads_for(2):
        seconds = medians(
            {
                "hand-over": lambda: share(lambda first, end: together.wait(), 2, 1),
                "pass": lambda: problem.csr @ problem.q,
            },
            10 * repeats,
        )
    over, product = 1e6 * seconds["hand-over"], 1e6 * seconds["pass"]
    return f"a hand-over takes {over:.0f} µs, a product with a five-point M of {problem.n} rows {product:.0f} µs"


MEASURED: dict[str, Callable[[int], str]] = {
    "DIRECT_PASSES": _direct_dense,
    "DIRECT_ROWS": _direct_in_rows,
    "DIRECT_ENTRIES": _direct,
    "DIRECT_CUBE": _direct_small,
    "SWEEP_ENTRIES": _calls_of_a_sweep,
    "MULTIGRID_PASSES": _multigrid,
    "MULTIGRID_ROWS": _multigrid_small,
    "BANDED_PASSES": _small_band,
    "PSOR_GAIN": _gain,
    "PSOR_PASSES": _least,
    "INTERIOR_STEPS": _interior_steps,
    "PIVOTS_FIRST_UP_TO": _pivots_or_interior,
    "BANDED_ROUNDS": partial(_rounds, 2, 1.0),
    "BOXED_ROUNDS": partial(_rounds, 1, -1.0),
    "COMPILED_UP_TO": partial(_compiled, _dense, "COMPILED_UP_TO"),
    "COMPILED_SPARSE_UP_TO": partial(_compiled, _scattered, "COMPILED_SPARSE_UP_TO"),
    "DIRECT_UP_TO": _factor_or_multigrid,
    "LINEAR_PROGRAM_UP_TO": _program,
    "FACTOR_OPERATIONS_UP_TO": _operations,
    "DENSE_OPERATIONS": _dense_speed,
    "SPARSE_OPERATIONS": _sparse_speed,
    "PIVOTED_UP_TO": _pivoted,
    "SEMIDEFINITENESS_UP_TO": _semidefiniteness,
    "SWEEPS_FIRST_UP_TO": _sweep_or_change,
    "CHOLESKY_UP_TO": partial(_cholesky, tuning.CHOLESKY_UP_TO, 0.01),
    "FULL_CHOLESKY_UP_TO": partial(
        _largest_cholesky, tuning.FULL_CHOLESKY_UP_TO, tuning.FULL_CHOLESKY_FROM
    ),
    "FULL_CHOLESKY_FROM": partial(_cholesky, 500, tuning.FULL_CHOLESKY_FROM),
    "SHARP_SAMPLES_UP_TO": _sharp_bound,
    "SHARED_FROM": _hand_over,
}
