"""Random nonlinear problems with a manufactured solution.

F(x) = s (M x + g(x) + q) by rows, M positive definite or a P-matrix of integers, some diagonals of 1e-6 … 1e-12, g of
increasing functions t³, exp t, −1/(t+1) or none, s scaling of rows, scaled unknowns, and x*, the only solution.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from lcp_plugin import NonlinearProblem

ILL_CONDITIONED = (
    1e-7  # of the terms of a row: no residual distinguishes the point from the solution
)


class Target(NamedTuple):
    """A problem with its solution, and functions of another point: relative error, condition, text."""

    problem: NonlinearProblem
    right: np.ndarray
    error: Callable[[np.ndarray], float]
    is_hopeless: Callable[[np.ndarray], bool]
    text: Callable[[np.ndarray], str]


def planted(rng: np.random.Generator) -> Target:
    """Return a problem with its answer, x ≥ 0."""
    n = int(rng.integers(1, 5))
    A, kind = (
        rng.integers(-3, 4, (n, n)).astype(float),
        str(rng.choice(["dominant", "definite", "skew", "triangular"])),
    )
    M = {
        "dominant": A + np.diag(abs(A).sum(axis=1) + 1 - A.diagonal()),
        "definite": A @ A.T + np.eye(n),
        "skew": A - A.T + np.diag(rng.choice([1.0, 1e-6, 1e-9, 1e-12], n)),
        "triangular": np.tril(A, -1) + np.diag(rng.choice([1.0, 1e-6, 1e-9], n)),
    }[kind]
    shapes = rng.integers(0, 4, n)
    state, rows, units = (
        rng.integers(0, 3, n),
        *(rng.choice([1.0, 1e-9, 1e-4, 1e6], n, p=[0.6, 0.15, 0.15, 0.1]) for _ in range(2)),
    )
    if rng.random() < 0.5:
        units = np.ones(n)
    far = np.where(rng.random(n) < 0.15, 1e6, 1.0) * (shapes != 2) + (shapes == 2)
    right = np.where(state == 0, rng.integers(1, 5, n), 0) * far
    w = np.where(state == 1, rng.integers(1, 5, n), 0.0)

    @np.errstate(all="ignore")
    def curve(t: np.ndarray) -> np.ndarray:
        return np.choose(shapes, [0.0 * t, t**3, np.exp(t), -1.0 / (t + 1.0)])

    @np.errstate(all="ignore")
    def slope(t: np.ndarray) -> np.ndarray:
        return np.choose(shapes, [0.0 * t, 3 * t**2, np.exp(t), (t + 1.0) ** -2.0])

    q = w - M @ right - curve(right)

    def F(x: np.ndarray) -> np.ndarray:
        t = x * units
        return rows * (M @ t + curve(t) + q)

    def jacobian(x: np.ndarray) -> np.ndarray:
        return rows[:, None] * (M + np.diag(slope(x * units))) * units

    problem = NonlinearProblem(F, jacobian, lower=np.zeros(n))
    answer = right / units

    def error(x: np.ndarray) -> float:
        wrong, size = abs(x * units - right).max(), abs(right).max()
        return float(wrong / size if size else wrong)

    def is_hopeless(x: np.ndarray) -> bool:
        t = x * units
        value, terms = M @ t + curve(t) + q, abs(M) @ t + abs(curve(t)) + abs(q)
        wrong = np.where(t > 0, abs(value), np.maximum(-value, 0.0))
        return bool((wrong <= ILL_CONDITIONED * terms).all())

    def text(x: np.ndarray) -> str:
        return (
            f"{kind}: M={M.tolist()}, q={q.tolist()}, shapes={shapes.tolist()}, rows={rows.tolist()}, "
            f"units={units.tolist()} at {x.tolist()}, right {answer.tolist()}"
        )

    return Target(problem, answer, error, is_hopeless, text)
