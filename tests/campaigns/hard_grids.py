"""Grids that are hard for multigrid: long thin strips, half-spaces of another stiffness, couplings that jump at random.

Each instance is solved by multigrid alone and by auto. Wanted is multigrid's answer within so many cycles, or auto's
within so many times what auto needs for a smooth membrane of as many unknowns. Times are processor seconds, the best of
some runs on problems stated anew.

    python tests/campaigns/hard_grids.py --cases 200 --seed 0
"""

from __future__ import annotations

import argparse
import math
import statistics
import time
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from lcp_plugin import LCP, gallery, solve
from lcp_plugin.core.solving.result import Result
from lcp_plugin.evidence.measurement import fresh
from lcp_plugin.gallery.stencil import balanced_matrix, stiff_cells

CYCLES, TIMES = 60, 3.0
LONG, WIDEST = 2000, 20
SIZE = 150
REPEATS = 2


class Instance(NamedTuple):
    """What is drawn, and how it is told."""

    family: str
    told: str
    problem: LCP


# --- Instances ---------------------------------------------------------------------------------------------------


def membrane(across: np.ndarray, along: np.ndarray, generator: np.random.Generator) -> LCP:
    """Return a membrane whose edges, (size₀ + 1, size₁) and (size₀, size₁ + 1), have these stiffnesses, and a load."""
    shape = along.shape[0], across.shape[1]
    M = balanced_matrix(shape, ([-across[:-1], -along[:, :-1]], [-across[1:], -along[:, 1:]]))
    x, y = (
        np.broadcast_to(axis, shape)
        for axis in np.ix_(*((np.arange(size) + 0.5) / size for size in shape))
    )
    stiffness = M.diagonal()
    typical = float(np.exp(generator.uniform(np.log(stiffness.min()), np.log(stiffness.max()))))
    unit = typical * 10.0 ** generator.uniform(-1.0, 2.0) / max(shape) ** 2
    first, second = generator.integers(1, 6, 2) * np.pi
    force = (
        unit
        * (np.sin(first * x + generator.random()) * np.sin(second * y + generator.random())).ravel()
    )
    kind = generator.integers(5)
    if kind == 0:  # pulled from the ground
        return LCP(M, -force)
    weight = np.full(M.shape[0], unit)
    if kind == 1:  # lies on stones
        return LCP(M, weight, lower=-generator.random(M.shape[0]))
    if kind == 2:  # lies on posts
        posts = np.where(
            generator.random(M.shape[0]) < 0.01, -generator.random(M.shape[0]), -np.inf
        )
        return LCP(M, weight, lower=posts)
    bumps = (
        0.1
        * np.cos(generator.integers(1, 10) * np.pi * x)
        * np.cos(generator.integers(1, 10) * np.pi * y)
    )
    lower = (bumps + 0.1 - (generator.random() - x) ** 2 - (generator.random() - y) ** 2).ravel()
    if kind == 3:  # lies on bumps
        return LCP(M, weight, lower=lower)
    return LCP(M, -force, lower=lower, upper=lower + 0.3 * generator.random())


def strip(generator: np.random.Generator) -> Instance:
    """Held at both ends, and along none, one or both of its sides."""
    width = int(generator.integers(4, WIDEST + 1))
    across, along = np.ones((width + 1, LONG)), np.ones((width, LONG + 1))
    held = generator.integers(3)
    across[[0, -1][held:]] = 0.0
    if generator.random() < 0.5:
        across, along = across.T.copy(), along.T.copy()
        return Instance(
            "strip", f"{LONG} × {width}, {held} held", membrane(along, across, generator)
        )
    return Instance("strip", f"{width} × {LONG}, {held} held", membrane(across, along, generator))


def half_space(generator: np.random.Generator) -> Instance:
    """Two half-spaces, one stiffer than the other."""
    decades, angle = float(generator.choice([2, 4, 6])), math.pi * generator.random()
    axis = np.linspace(-0.5, 0.5, SIZE + 1)
    side = np.add.outer(math.cos(angle) * axis, math.sin(angle) * axis) > 0.3 * (
        generator.random() - 0.5
    )
    below, above = stiff_cells(10.0 ** (decades * side))
    across, along = edges(below, above)
    return Instance(
        "half-space",
        f"1e{decades:.0f}, {math.degrees(angle):.0f}°",
        membrane(across, along, generator),
    )


def blocks(generator: np.random.Generator) -> Instance:
    """Blocks of cells, the logarithm of their stiffness uniform."""
    decades, count = float(generator.uniform(2.0, 10.0)), int(generator.choice([5, 10, 30]))
    block = np.arange(SIZE + 1) * count // (SIZE + 1)
    cells = 10.0 ** (decades * generator.uniform(-0.5, 0.5, (count, count)))[np.ix_(block, block)]
    across, along = edges(*stiff_cells(cells))
    return Instance("blocks", f"1e{decades:.1f}, {count}²", membrane(across, along, generator))


def jumps(generator: np.random.Generator) -> Instance:
    """Every edge has its own stiffness, the logarithm uniform or one of two."""
    decades, kind = (
        float(generator.uniform(2.0, 10.0)),
        str(generator.choice(["all", "half", "tenth"])),
    )

    def stiffness(*shape: int) -> np.ndarray:
        share = generator.random(shape)
        return 10.0 ** (
            decades * {"all": share - 0.5, "half": share < 0.5, "tenth": share < 0.1}[kind]
        )

    across, along = stiffness(SIZE + 1, SIZE), stiffness(SIZE, SIZE + 1)
    return Instance("edges", f"1e{decades:.1f}, {kind}", membrane(across, along, generator))


def edges(below: list[np.ndarray], above: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Return the stiffness of the edges along both axes from the entries left and right of the diagonal."""
    across = -np.concatenate([below[0], above[0][-1:]])
    return across, -np.concatenate([below[1], above[1][:, -1:]], axis=1)


FAMILIES: tuple[Callable[[np.random.Generator], Instance], ...] = strip, half_space, blocks, jumps


def drawn(seed: int, case: int) -> Instance:
    """Return the instance with this number."""
    return FAMILIES[case % len(FAMILIES)](np.random.default_rng([seed, case]))


# --- Runs --------------------------------------------------------------------------------------------------------


def quickest(problem: LCP, algorithm: str, repeats: int, **options: object) -> tuple[Result, float]:
    """Return the result and the least processor seconds of some runs from nothing."""
    seconds = []
    for _ in range(repeats):
        again = fresh(problem)
        begun = time.process_time()
        result = solve(again, algorithm, threads=1, **options)
        seconds.append(time.process_time() - begun)
    return result, min(seconds)


def smooth_seconds(n: int, known: dict[int, float]) -> float:
    """Return what auto needs for a membrane over a sphere with about n unknowns."""
    size = round(math.sqrt(n))
    if size not in known:
        known[size] = quickest(gallery.build("obstacle_2d", size=size).problem, "auto", 5)[1]
    return known[size]


def main() -> int:
    """Print a line an instance that misses what is wanted, and a table of the families; 1 where one missed it."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--cases", type=int, default=200)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--all", action="store_true", help="print every instance")
    chosen = parser.parse_args()
    known: dict[int, float] = {}
    rows: dict[str, list[tuple[Result, float, Result, float, bool]]] = {}
    quickest(gallery.build("coefficient_jumps", size=40).problem, "auto", 1)  # compiles
    for case in range(chosen.first, chosen.first + chosen.cases):
        instance = drawn(chosen.seed, case)
        smooth = smooth_seconds(instance.problem.n, known)
        alone, seconds = quickest(instance.problem, "multigrid", 1, max_seconds=30.0)
        auto, auto_seconds = quickest(instance.problem, "auto", REPEATS, max_seconds=30.0)
        ratio = auto_seconds / smooth
        fits = (alone.is_solved and alone.iterations <= CYCLES) or (
            auto.is_solved and ratio <= TIMES
        )
        rows.setdefault(instance.family, []).append((alone, seconds / smooth, auto, ratio, fits))
        if chosen.all or not fits:
            print(
                f"{case:4d} {instance.family:<10} {instance.told:<22} n = {instance.problem.n:<6} "
                f"multigrid {alone.status.name} {alone.iterations} cycles {alone.certificate.relative_residual:.0e} "
                f"{seconds:.2f} s   {auto.algorithm} {auto.status.name} {auto_seconds:.2f} s, ÷ smooth {ratio:.1f}"
                f"{'' if fits else '   MISSED'}",
                flush=True,
            )
    for family, runs in rows.items():
        cycles = sorted(alone.iterations for alone, *_ in runs)
        print(
            f"{family:<10} {len(runs):4d} instances: multigrid SOLVED {sum(run[0].is_solved for run in runs)}, "
            f"within {CYCLES} {sum(run[0].is_solved and run[0].iterations <= CYCLES for run in runs)}, "
            f"cycles {statistics.median(cycles):.0f} (median) {cycles[-1]} (most); auto SOLVED "
            f"{sum(run[2].is_solved for run in runs)}, ÷ smooth {statistics.median(run[3] for run in runs):.1f} "
            f"(median) {max(run[3] for run in runs):.1f} (most); missed {sum(not run[4] for run in runs)}"
        )
    return int(any(not run[4] for runs in rows.values() for run in runs))


if __name__ == "__main__":
    raise SystemExit(main())
