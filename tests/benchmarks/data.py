"""Least squares with x ≥ 0, lasso, its path and support vectors, next to scipy's nnls and scikit-learn."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from importlib import import_module
from importlib.util import find_spec
from typing import Any

import numpy as np
from scipy.optimize import nnls

from lcp_plugin import BoundedLeastSquares, QuadraticProgram, solve, solve_batch, trace

from .timing import quickest

REPEATS = 5


def run(*, quick: bool = False) -> Iterator[str]:
    """Yield a line per problem: milliseconds of both, their ratio, and the difference of their solutions."""
    rng = np.random.default_rng(0)
    for m, n in ((60, 30),) if quick else ((60, 30), (200, 100), (1000, 400)):
        yield _nonnegative(rng.random((m, n)), rng.random(m))
    for m, n in ((60, 20),) if quick else ((60, 20), (120, 60)):
        yield _batch(rng.random((m, n)), rng.random((500, m)))
    if find_spec("sklearn") is not None:
        m, n = (50, 80) if quick else (200, 400)
        A = rng.normal(size=(m, n))
        yield from _lasso(A, A[:, :10] @ np.full(10, 3.0) + 0.1 * rng.normal(size=m))
        for count in (100,) if quick else (500, 1500):
            X, noise = rng.normal(size=(count, 5)), 0.3 * rng.normal(size=count)
            yield _support_vectors(X, np.where(X[:, 0] * X[:, 1] + noise > 0, 1.0, -1.0))


def _nonnegative(A: Any, b: Any) -> str:
    return _line(
        f"x ≥ 0, {A.shape}",
        lambda: solve(BoundedLeastSquares(A, b)).x,
        lambda: nnls(A, b)[0],
        "nnls",
    )


def _batch(A: Any, B: Any) -> str:
    problem = BoundedLeastSquares(A, B[0])
    return _line(
        f"{len(B)} with x ≥ 0, {A.shape}",
        lambda: solve_batch(problem, B, threads=1).x,
        lambda: np.array([nnls(A, b)[0] for b in B]),
        "nnls in a loop",
    )


def _lasso(A: Any, b: Any) -> Iterator[str]:
    linear, m, most = import_module("sklearn.linear_model"), len(b), abs(A.T @ b).max()
    options = {"fit_intercept": False, "tol": 1e-10, "max_iter": 100_000}
    yield _line(
        f"lasso, {A.shape}",
        lambda: solve(BoundedLeastSquares(A, b, lower=-np.inf, l1=0.1 * most)).x,
        lambda: linear.Lasso(alpha=0.1 * most / m, **options).fit(A, b).coef_,
        "Lasso",
    )
    least = {"method": "lasso", "alpha_min": 0.01 * most / m}
    problem = BoundedLeastSquares(A, b, lower=-np.inf)
    yield _line(
        f"lasso path, {A.shape}",
        lambda: trace(problem, {"l1": 1}, most, 0.01 * most).at(0.01 * most).x,
        lambda: linear.lars_path(A, b, **least)[2][:, -1],
        "lars_path",
    )


def _support_vectors(X: Any, y: Any) -> str:
    n, machines = len(y), import_module("sklearn.svm")
    Q = np.outer(y, y) * np.exp(-0.2 * ((X[:, None] - X) ** 2).sum(axis=2))

    def weights() -> Any:
        machine, found = machines.SVC(C=1.0, gamma=0.2, tol=1e-6).fit(X, y), np.zeros(n)
        found[machine.support_] = abs(machine.dual_coef_[0])
        return found

    dual: Any = {"A": y[None], "b": [0.0], "lower": 0, "upper": 1}
    return _line(
        f"support vectors, {n}",
        lambda: solve(QuadraticProgram(Q, -np.ones(n), **dual)).x,
        weights,
        "SVC",
    )


def _line(name: str, ours: Callable[[], Any], theirs: Callable[[], Any], other: str) -> str:
    off = np.max(abs(ours() - theirs()))
    found = quickest({"ours": ours, "theirs": theirs}, REPEATS)
    one, two = (1e3 * found[way].seconds for way in ("ours", "theirs"))
    return (
        f"{name}: {one:.3g} ms, {other} {two:.3g} ms, ratio {one / two:.2g}, x differs by {off:.0e}"
    )
