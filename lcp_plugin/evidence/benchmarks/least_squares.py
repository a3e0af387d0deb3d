"""Bounded least squares beside accelerated gradients and scipy, and the patience that precedes a factor."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import islice
from typing import Any

import numpy as np
import scipy.sparse as sp

from ...algorithms.least_squares.faces import DenseFaces, SparseFaces
from ...algorithms.least_squares.point import Point
from ...algorithms.least_squares.projected_steps import projected_steps
from ...checks import FloatVector
from ...problem.least_squares import LeastSquares, UnitLeastSquares
from ...solving.least_squares import DENSE_PATIENCE, SPARSE_PATIENCE, bounded_least_squares
from .rivals import SEED
from .timing import medians, timed

STEPS = 30  # enough to time one


def planted(A: Any, seed: int = SEED) -> tuple[FloatVector, FloatVector]:
    """Return b and the x ≥ 0 that minimises ‖A x − b‖, A of full rank: half of it is 0, multipliers are in (0, 1)."""
    from scipy.sparse.linalg import lsmr

    rng = np.random.default_rng(seed)
    is_free = rng.random(A.shape[1]) < 0.5
    x = np.where(is_free, 0.1 + rng.random(is_free.size), 0.0)
    residual = lsmr(A.T, np.where(is_free, 0.0, rng.random(is_free.size)), atol=1e-15, btol=1e-15)[0]
    return A @ x - residual, x


def random_rows(m: int, n: int, per_row: int = 10, seed: int = SEED) -> sp.csr_array:
    """Return a sparse A with so many entries in (0, 1) a row."""
    rng = np.random.default_rng(seed)
    rows = np.repeat(np.arange(m), per_row)
    return sp.csr_array((rng.random(m * per_row), (rows, rng.integers(0, n, m * per_row))), shape=(m, n))


def accelerated_gradients(A: Any, b: FloatVector, tolerance: float) -> FloatVector:
    """Return x of FISTA with restarts, the rival, at that relative optimality."""
    back, reference, v = A.T, np.abs(A.T @ b).max(), np.ones(A.shape[1])
    for _ in range(10):
        v = back @ (A @ (v / np.linalg.norm(v)))
    length, t = 0.95 / np.linalg.norm(v), 1.0
    x = y = np.zeros(A.shape[1])
    Ax = Ay = A @ x
    while True:
        gradient = back @ (Ay - b)
        if np.abs(np.minimum(y, gradient)).max() <= tolerance * reference:
            return y
        after = np.maximum(y - length * gradient, 0.0)
        t = 1.0 if (y - after) @ (after - x) > 0.0 else t
        following = 0.5 * (1.0 + np.sqrt(1.0 + 4.0 * t * t))
        product, share = A @ after, (t - 1.0) / following
        y, Ay = after + share * (after - x), product + share * (product - Ax)
        x, Ax, t = after, product, following


def run(*, quick: bool = False) -> Iterator[str]:
    """Yield the speed on sparse, dense and small problems, and both patiences."""
    scale, repeats = (10, 1) if quick else (1, 5)
    for m, n in ((40_000 // scale, 8000 // scale), (200_000 // scale, 100_000 // scale)):
        A = random_rows(m, n)
        b, x = planted(A)
        yield from _sparse(A, b, x, repeats)
    yield from _small(100 if quick else 1000)
    yield _patience("DENSE_PATIENCE", DENSE_PATIENCE, _dense(600 // (scale // 5 or 1)))
    yield _patience("SPARSE_PATIENCE", SPARSE_PATIENCE, _chain(100_000 // scale))


def _sparse(A: Any, b: FloatVector, x: FloatVector, repeats: int) -> Iterator[str]:
    result = bounded_least_squares(A, b)
    calls: dict[str, Callable[[], Any]] = {
        "ours": lambda: bounded_least_squares(A, b), "rival": lambda: accelerated_gradients(A, b, 1e-6),
        "pair": lambda: A.T @ (A @ x),
    }
    seconds = medians(calls, repeats)
    yield (
        f"sparse NNLS {A.shape[0]} × {A.shape[1]}: {seconds['ours']:.3f} s to {result.optimality:.0e} in {result.nit} "
        f"steps, {seconds['ours'] / seconds['pair']:.0f} pairs of products, ÷ accelerated gradients to 1e-6 "
        f"{seconds['ours'] / seconds['rival']:.2f}; proved gap {result.gap / result.cost:.0e} of the cost"
    )


def _small(count: int) -> Iterator[str]:
    from scipy.optimize import nnls

    rng = np.random.default_rng(SEED)
    problems = [(rng.standard_normal((40, 20)), rng.standard_normal(40)) for _ in range(count)]
    farthest = max(float(np.abs(bounded_least_squares(A, b).x - nnls(A, b)[0]).max()) for A, b in problems)
    seconds = medians({
        "ours": lambda: [bounded_least_squares(A, b) for A, b in problems],
        "scipy": lambda: [nnls(A, b) for A, b in problems],
    }, 1)
    yield (
        f"{count} dense NNLS 40 × 20: {1e6 * seconds['ours'] / count:.0f} µs each, ÷ scipy.optimize.nnls "
        f"{seconds['ours'] / seconds['scipy']:.1f}; x differs by {farthest:.0e} at the most"
    )


def _dense(n: int) -> tuple[UnitLeastSquares, Callable[[UnitLeastSquares], Any], float]:
    rng = np.random.default_rng(SEED)
    problem = LeastSquares(rng.standard_normal((4 * n, n)), rng.standard_normal(4 * n), 0.0, np.inf, None, 0.0)
    return UnitLeastSquares(problem), DenseFaces.of, float(n)


def _chain(n: int) -> tuple[UnitLeastSquares, Callable[[UnitLeastSquares], Any], float]:
    A = sp.diags_array([np.ones(n), -np.ones(n - 1)], offsets=[0, -1]).tocsr()
    problem = LeastSquares(A, np.random.default_rng(SEED).standard_normal(n), 0.0, np.inf, None, 0.0)

    def solved_once(unit: UnitLeastSquares) -> Any:
        faces = SparseFaces.of(unit)
        return faces and faces.correction(Point(unit, unit.lower), np.ones(n, dtype=np.bool_))

    return UnitLeastSquares(problem), solved_once, 1.0


def _patience(name: str, value: float, case: tuple[UnitLeastSquares, Callable[[UnitLeastSquares], Any], float]) -> str:
    unit, by_factor, size = case
    factor = timed(lambda: by_factor(unit)).seconds
    steps = timed(lambda: list(islice(projected_steps(Point(unit, unit.lower)), STEPS))).seconds / STEPS
    return f"{name} = {value}: a face solved by a factor costs {factor / steps / size:.2g} steps of this unit"
