"""Models that cvxpy's users bring on their first day, each stated anew: QPSolver against Clarabel and OSQP.

Nine kinds at three sizes. Seconds of processor time from the modelling expressions to the value, compilation by cvxpy
included, the quickest of some rounds; a value that differs from the best by more than 1e-5 is marked †.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from functools import partial
from importlib.util import find_spec
from typing import Any

import numpy as np

from .timing import rounds

SEED = 5
DIFFERS = 1e-5
ROUNDS = 5
Model = Callable[[int, np.random.Generator], Any]
RIVALS = ("CLARABEL", "OSQP")


def lasso(k: int, rng: np.random.Generator) -> Any:
    """Return ½‖A x − b‖² + λ ‖x‖₁, k rows and 2k columns."""
    import cvxpy as cp

    A, b, x = rng.standard_normal((k, 2 * k)), rng.standard_normal(k), cp.Variable(2 * k)
    return cp.Minimize(
        0.5 * cp.sum_squares(A @ x - b) + 0.1 * np.abs(A.T @ b).max() * cp.norm1(x)
    ), []


def elastic_net(k: int, rng: np.random.Generator) -> Any:
    """Return the same with a quadratic penalty, twice as many rows as columns."""
    import cvxpy as cp

    A, b, x = rng.standard_normal((2 * k, k)), rng.standard_normal(2 * k), cp.Variable(k)
    return cp.Minimize(cp.sum_squares(A @ x - b) + cp.norm1(x) + 0.5 * cp.sum_squares(x)), []


def support_vectors(k: int, rng: np.random.Generator) -> Any:
    """Return ½‖a‖² + Σ (1 − y (X a + b))₊ for 5k points in k/5 dimensions."""
    import cvxpy as cp

    X = rng.standard_normal((5 * k, k // 5))
    y, a, b = np.sign(X[:, 0] + rng.standard_normal(5 * k)), cp.Variable(k // 5), cp.Variable()
    return cp.Minimize(0.5 * cp.sum_squares(a) + cp.sum(cp.pos(1 - cp.multiply(y, X @ a + b)))), []


def portfolio(k: int, rng: np.random.Generator) -> Any:
    """Return the portfolio of 5k assets in a model of k/5 factors, without short sales."""
    import cvxpy as cp

    F, d, mean = (
        rng.standard_normal((5 * k, max(k // 5, 2))),
        rng.random(5 * k),
        rng.standard_normal(5 * k),
    )
    x = cp.Variable(5 * k)
    risk = cp.sum_squares(F.T @ x) + cp.sum_squares(cp.multiply(np.sqrt(d), x))
    return cp.Maximize(mean @ x - risk), [cp.sum(x) == 1, x >= 0]


def huber(k: int, rng: np.random.Generator) -> Any:
    """Return Huber's regression of 5k points on k/5 columns."""
    import cvxpy as cp

    A, x = rng.standard_normal((5 * k, max(k // 5, 2))), cp.Variable(max(k // 5, 2))
    return cp.Minimize(cp.sum(cp.huber(A @ x - rng.standard_t(2, 5 * k)))), []


def transport(k: int, rng: np.random.Generator) -> Any:
    """Return the cheapest transport from k/2 to k/2 places."""
    import cvxpy as cp

    n = k // 2
    T = cp.Variable((n, n), nonneg=True)
    supply, demand = rng.dirichlet(np.ones(n)), rng.dirichlet(np.ones(n))
    return cp.Minimize(cp.sum(cp.multiply(rng.random((n, n)), T))), [
        cp.sum(T, 1) == supply,
        cp.sum(T, 0) == demand,
    ]


def control(k: int, rng: np.random.Generator) -> Any:
    """Return the plan of a controller with a horizon of k, 6 states and 2 inputs."""
    import cvxpy as cp

    F, B = np.eye(6) + 0.1 * rng.standard_normal((6, 6)), rng.standard_normal((6, 2))
    x, u = cp.Variable((6, k + 1)), cp.Variable((2, k))
    rules = [x[:, 1:] == F @ x[:, :-1] + B @ u, x[:, 0] == rng.standard_normal(6), cp.abs(u) <= 0.5]
    return cp.Minimize(cp.sum_squares(x) + 0.1 * cp.sum_squares(u)), rules


def nonnegative(k: int, rng: np.random.Generator) -> Any:
    """Return non-negative least squares, 4k rows and k columns."""
    import cvxpy as cp

    x = cp.Variable(k, nonneg=True)
    return cp.Minimize(
        cp.sum_squares(rng.standard_normal((4 * k, k)) @ x - rng.standard_normal(4 * k))
    ), []


def total_variation(k: int, rng: np.random.Generator) -> Any:
    """Return the sequence of few steps near a noisy one of 5k numbers."""
    import cvxpy as cp

    a, x = (
        np.repeat(rng.standard_normal(5), k) + 0.2 * rng.standard_normal(5 * k),
        cp.Variable(5 * k),
    )
    return cp.Minimize(0.5 * cp.sum_squares(x - a) + 2 * cp.tv(x)), []


MODELS: tuple[Model, ...] = (
    lasso,
    elastic_net,
    support_vectors,
    portfolio,
    huber,
    transport,
    control,
    nonnegative,
    total_variation,
)
SIZES = (20, 60, 200)


def run(*, quick: bool = False) -> Iterator[str]:
    """Yield a line a model: milliseconds of ours, and over those of each rival; then the geometric means."""
    present = [name for name in RIVALS if find_spec(name.lower()) is not None]
    ratios: dict[str, list[float]] = {name: [] for name in present}
    for k in SIZES[:1] if quick else SIZES:
        for model in MODELS:
            calls = {name: partial(_solved, model, k, name) for name in ("ours", *present)}
            for call in calls.values():
                call()
            every = rounds(calls, 1 if quick else ROUNDS, time.process_time)
            seconds = {name: min(one.seconds for one in runs) for name, runs in every.items()}
            values = {name: runs[0].answer for name, runs in every.items()}
            best = float(np.median(list(values.values())))
            shown = ""
            for name in present:
                ratios[name].append(seconds["ours"] / seconds[name])
                shown += f"   ÷ {name} {ratios[name][-1]:6.2f}{_mark(values[name], best)}"
            yield f"{model.__name__:<16} {k:>4} {1e3 * seconds['ours']:>8.1f} ms{_mark(values['ours'], best)}{shown}"
    for name, found in ratios.items():
        mean = float(np.exp(np.mean(np.log(found))))
        yield f"{len(found)} models: {mean:.2f} × {name}, geometric mean; {max(found):.2f} × at the worst"


def _mark(value: float, best: float) -> str:
    return " " if abs(value - best) <= DIFFERS * (1.0 + abs(best)) else "†"


def _solved(model: Model, k: int, solver: str) -> float:
    """Return the optimal value of a model that is stated anew."""
    import cvxpy as cp

    from lcp_plugin import QPSolver

    objective, rules = model(k, np.random.default_rng((SEED, k)))
    problem = cp.Problem(objective, rules)
    problem.solve(solver=QPSolver() if solver == "ours" else solver)
    return float(problem.value)
