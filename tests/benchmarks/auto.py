"""auto beside every named method, warm: the least of interleaved runs of each on the same problems."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
import scipy.sparse as sp
from applications import mechanics

from lcp_plugin.api import solve
from lcp_plugin.core.checks import FloatVector
from lcp_plugin.core.errors import UnsuitableMatrix, UnsuitableProblem
from lcp_plugin.core.lcp import LCP
from lcp_plugin.gallery import build

from .rivals import SEED, spectrum
from .small import rows as small_rows
from .timing import quickest
from .tuning import random_band

NAMED = ("npsor", "pgs", "psor", "newton", "lemke", "interior_point", "banded", "multigrid")
REPEATS = 9
FAR_BEHIND = 3.0  # times what auto takes: who takes longer in its first run is not the best method
TARGET = 1.5


@dataclass(frozen=True)
class Comparison:
    """Processor seconds of a warm solve: by auto, and by the named method that takes least."""

    auto: float
    best: str
    least: float

    @property
    def ratio(self) -> float:
        """How many times as long as the best named method auto takes."""
        return self.auto / self.least


def brick_wall(courses: int, width: int) -> LCP:
    """Return a wall of bricks in running bond at rest: semidefinite, two contacts where one lies on another."""
    wall = mechanics.brick_wall(courses, width)
    return LCP(wall.M, wall.q)


def lasso(samples: int, features: int) -> LCP:
    """Return min ½‖A (u − v) − b‖² + λ Σ (u + v) over u, v ≥ 0, a tenth of the features active in b."""
    rng = np.random.default_rng(SEED)
    A = rng.standard_normal((samples, features))
    x = np.where(rng.random(features) < 0.1, rng.standard_normal(features), 0.0)
    product = A.T @ (A @ x + 0.1 * rng.standard_normal(samples))
    weight = 0.1 * np.abs(product).max()
    return LCP(
        np.kron([[1.0, -1.0], [-1.0, 1.0]], A.T @ A), weight + np.concatenate([-product, product])
    )


def program(n: int, rows: int) -> LCP:
    """Return the optimality conditions of a sparse quadratic program, so many inequalities, a tenth equations."""
    rng = np.random.default_rng(SEED)
    half = sp.random_array((n, n), density=0.02, rng=rng, data_sampler=rng.standard_normal)
    P = sp.csr_array(half @ half.T + 0.01 * sp.eye_array(n))
    G, A = (
        sp.random_array((m, n), density=0.05, rng=rng, data_sampler=rng.standard_normal)
        for m in (rows, n // 10)
    )
    x: FloatVector = rng.standard_normal(n)
    slack = np.maximum(rng.standard_normal(rows), 0.0)
    return LCP.from_qp(P, rng.standard_normal(n), G, G @ x + slack, A, A @ x)


def bimatrix_game(m: int, n: int) -> LCP:
    """Return a random game of two players as M = [[0, K], [Lᵀ, 0]], all costs positive."""
    rng = np.random.default_rng(SEED)
    K, L = 1.0 + rng.random((m, n)), 1.0 + rng.random((m, n))
    return LCP(np.block([[np.zeros((m, m)), K], [L.T, np.zeros((n, n))]]), -np.ones(m + n))


SCENES = (
    ("obstacle_2d", 50),
    ("obstacle_2d", 200),
    ("obstacle_bumps", 60),
    ("convection_diffusion", 40),
    ("convection_diffusion", 100),
    ("optimal_stopping", 100),
    ("american_put", 1001),
    ("journal_bearing", 60),
    ("elastic_plastic_torsion", 60),
    ("coefficient_jumps", 60),
    ("rotated_anisotropy", 60),
)
OTHER_SCENES = (
    "half_active",
    "random_h_plus",
    "market_equilibrium",
)


def problems(*, quick: bool) -> Iterator[tuple[str, Sequence[LCP]]]:
    """Yield the rows of the table: a name, and the problems that are solved one after the other."""
    for row in small_rows(quick=quick):
        yield row.name, row.problems()
    for side in (3,) if quick else (12, 6):
        yield f"contact wall {side} × {side}", [brick_wall(side, side)]
    for n in (40,) if quick else (260, 400):
        case = spectrum(n, 1e2, 0.4)
        yield f"dense SPD n = {n}, κ = 1e2", [LCP(case.M, case.q)]
    yield "lasso", [lasso(10, 40) if quick else lasso(100, 400)]
    yield "KKT program", [program(30, 15) if quick else program(200, 80)]
    yield "bimatrix game", [bimatrix_game(10, 12) if quick else bimatrix_game(40, 45)]
    yield "random band", [random_band(300 if quick else 2000, 2, 1.0)]
    for name in OTHER_SCENES:
        yield name, [build(name).problem]
    for name, size in SCENES[:1] if quick else SCENES:
        yield f"{name} {size}", [build(name, size=10 if quick else size).problem]


def compared(chosen: Sequence[LCP], repeats: int) -> Comparison | None:
    """Return what auto and the best named method take, None where auto leaves a problem unsolved or all others do."""
    calls: dict[str, Callable[[], bool]] = {"auto": partial(_solved, chosen, "auto", None)}
    if not calls["auto"]():
        return None
    limit = FAR_BEHIND * quickest(calls)["auto"].seconds + 1e-3
    for name in NAMED:
        # The first run computes what M alone says, the quicker one of the others counts.
        in_time, at_ease = (
            partial(_solved, chosen, name, seconds) for seconds in (0.1 + 5.0 * limit, None)
        )
        if in_time() and quickest({name: at_ease})[name].seconds <= limit:
            calls[name] = at_ease
    least = {name: one.seconds for name, one in quickest(calls, repeats).items()}
    auto = least.pop("auto")
    return Comparison(auto, *min(least.items(), key=lambda one: one[1])) if least else None


def _solved(chosen: Sequence[LCP], name: str, max_seconds: float | None) -> bool:
    """Return whether the method solves all problems, each within the limit."""
    try:
        return all(solve(problem, name, max_seconds=max_seconds).is_solved for problem in chosen)
    except (UnsuitableMatrix, UnsuitableProblem):  # not for this matrix
        return False


def run(*, quick: bool = False) -> Iterator[str]:
    """Yield a line a row, and the rows beyond the target."""
    found = list[tuple[float, str]]()
    for name, chosen in problems(quick=quick):
        one = compared(chosen, 2 if quick else REPEATS)
        if one is None:
            yield f"{name:<32} no named method arrives in {FAR_BEHIND:g} × the time of auto"
            continue
        found.append((one.ratio, name))
        each = 1e6 / len(chosen)
        yield (
            f"{name:<32} auto {each * one.auto:9.1f} µs, best named {one.best} {each * one.least:9.1f} µs, "
            f"ratio {one.ratio:.2f}{' *' if one.ratio > TARGET else ''}"
        )
    beyond = [
        f"{name} {ratio:.2f} × " for ratio, name in sorted(found, reverse=True) if ratio > TARGET
    ]
    yield f"at most {max(found)[0]:.2f} × the best named method, target ≤ {TARGET}; beyond: {', '.join(beyond) or '–'}"
