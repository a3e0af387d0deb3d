"""Programs that users bring on their first day, at shapes of every kind, against the better of OSQP and Clarabel.

Lasso, elastic net, support vectors, Huber's loss, portfolios with factors, transport, control, non-negative least
squares, total variation, isotonic regression: each with few and with many rows beside its columns, and as modelling
languages state it. Ours is :func:`solve`, everything included; a rival's is its own set-up and
solution of data in its own format, and counts where its x is feasible and minimal to 1e-6.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from importlib import import_module
from importlib.util import find_spec
from typing import Any

import numpy as np
import scipy.sparse as sp

from lcp_plugin.core.checks import FloatVector
from lcp_plugin.problems.programs.program import QuadraticProgram
from lcp_plugin.problems.programs.solving import solve_program

from .programs import (
    MOST_ROUNDS,
    OPTIMAL,
    SECONDS,
    SETUPS,
    Case,
    controller,
    portfolio,
    support_vectors,
)
from .rivals import SEED
from .timing import rounds, timed

BETTER_OF = ("osqp", "clarabel")
BESIDE = ("piqp",)
WARM = 8  # calls
LONG = 1.0  # seconds of processor time: a rival that takes longer is measured once
FREE = np.inf


def cases(*, quick: bool) -> Iterator[Case]:
    """Yield the programs of every family, each with data of its own."""
    for make, shapes in QUICK.items() if quick else FAMILIES.items():
        for shape in shapes:
            yield make(*shape, np.random.default_rng((SEED, *shape)))


def regression(m: int, n: int, rng: np.random.Generator) -> tuple[Any, FloatVector]:
    """Return A, shape (m, n), and b, noisy products with a vector that has few nonzeros."""
    A = rng.standard_normal((m, n))
    x = rng.standard_normal(n) * (rng.random(n) < 0.1)
    return A, A @ x + 0.1 * rng.standard_normal(m)


def lasso(m: int, n: int, rng: np.random.Generator) -> Case:
    """Return ½‖r‖² + λ Σ t, r = A x − b, −t ≤ x ≤ t, as cvxpy states it."""
    A, b = regression(m, n, rng)
    weight, identity = 0.1 * np.abs(A.T @ b).max(), sp.eye_array(n)
    P = sp.block_diag([sp.csr_array((2 * n, 2 * n)), sp.eye_array(m)])
    G = sp.block_array(
        [[identity, -identity, sp.csr_array((n, m))], [-identity, -identity, sp.csr_array((n, m))]]
    )
    equations = sp.block_array([[sp.csr_array(A), sp.csr_array((m, n)), -sp.eye_array(m)]])
    c = np.repeat([0.0, weight, 0.0], [n, n, m])
    return Case(f"lasso {m}×{n}", (P, c, G, np.zeros(2 * n), equations, b, -FREE, FREE))


def split_lasso(m: int, n: int, rng: np.random.Generator) -> Case:
    """Return ½‖A (x⁺ − x⁻) − b‖² + λ Σ (x⁺ + x⁻) with x⁺, x⁻ ≥ 0 only: P dense, of rank m at the most."""
    A, b = regression(m, n, rng)
    both = np.hstack([A, -A])
    c = 0.1 * np.abs(A.T @ b).max() - both.T @ b
    return Case(
        f"lasso, split {m}×{n}",
        (both.T @ both, c, None, None, None, None, 0.0, FREE),
        is_dense=True,
    )


def elastic_net(m: int, n: int, rng: np.random.Generator) -> Case:
    """Return the lasso with ½ ‖x‖² besides."""
    P, c, *rest = lasso(m, n, rng).data
    ridge = sp.diags_array(np.repeat([1.0, 0.0], [n, n + m]))
    return Case(f"elastic net {m}×{n}", (sp.csr_array(P + ridge), 0.5 * c, *rest))


def separator(points: int, features: int, rng: np.random.Generator) -> Case:
    """Return ½‖w‖² + Σ s, s ≥ 1 − y (X w + β), s ≥ 0: a linear support vector machine with slacks."""
    label = np.where(rng.random(points) < 0.5, -1.0, 1.0)
    X = rng.standard_normal((points, features)) + label[:, None] * (rng.random(features) < 0.2)
    P = sp.diags_array(np.repeat([1.0, 0.0], [features, points + 1]))
    G = sp.block_array(
        [[sp.csr_array(-label[:, None] * X), sp.csr_array(-label[:, None]), -sp.eye_array(points)]]
    )
    c = np.repeat([0.0, 1.0], [features + 1, points])
    lower = np.repeat([-FREE, 0.0], [features + 1, points])
    return Case(
        f"linear SVM {points}×{features}", (P, c, G, -np.ones(points), None, None, lower, FREE)
    )


def largest_margin(points: int, features: int, rng: np.random.Generator) -> Case:
    """Return max γ − Σ s, y (X w + β) ≥ γ − s, −1 ≤ w ≤ 1, s ≥ 0: a linear program."""
    label = np.where(rng.random(points) < 0.5, -1.0, 1.0)
    X = rng.standard_normal((points, features)) + label[:, None] * (rng.random(features) < 0.2)
    n = features + 2 + points
    G = sp.block_array(
        [
            [
                sp.csr_array(-label[:, None] * X),
                sp.csr_array(-label[:, None]),
                np.ones((points, 1)),
                -sp.eye_array(points),
            ]
        ]
    )
    c = np.repeat([0.0, -0.1 * points, 1.0], [features + 1, 1, points])
    lower = np.repeat([-1.0, -FREE, 0.0], [features, 2, points])
    upper = np.repeat([1.0, FREE, FREE], [features, 2, points])
    data = sp.csr_array((n, n)), c, G, np.zeros(points), None, None, lower, upper
    return Case(f"margin LP {points}×{features}", data)


def huber(m: int, n: int, rng: np.random.Generator) -> Case:
    """Return ½‖u‖² + Σ (s⁺ + s⁻), A x − b = u + s⁺ − s⁻: robust regression with a tenth of outliers."""
    A, b = regression(m, n, rng)
    b = b + 10.0 * rng.standard_normal(m) * (rng.random(m) < 0.1)
    identity = sp.eye_array(m)
    P = sp.diags_array(np.repeat([0.0, 1.0, 0.0], [n, m, 2 * m]))
    equations = sp.block_array([[sp.csr_array(A), -identity, -identity, identity]])
    c, lower = np.repeat([0.0, 1.0], [n + m, 2 * m]), np.repeat([-FREE, 0.0], [n + m, 2 * m])
    return Case(f"Huber {m}×{n}", (P, c, None, None, equations, b, lower, FREE))


def full_portfolio(assets: int, factors: int, rng: np.random.Generator) -> Case:
    """Return a portfolio whose every asset has a load on every factor."""
    loads = rng.standard_normal((factors, assets))
    P = sp.diags_array(np.append(rng.random(assets) * factors**0.5, np.ones(factors)))
    A = sp.block_array(
        [[sp.csr_array(loads), -sp.eye_array(factors)], [np.ones((1, assets)), None]]
    )
    c, b = (
        np.append(-rng.standard_normal(assets), np.zeros(factors)),
        np.append(np.zeros(factors), 1.0),
    )
    lower = np.append(np.zeros(assets), np.full(factors, -FREE))
    return Case(f"full portfolio {assets}, {factors}", (P, c, None, None, A, b, lower, FREE))


def transport(sources: int, sinks: int, rng: np.random.Generator) -> Case:
    """Return the linear program of least cost from sources to sinks, supplies met as equations."""
    places = rng.random((sources, 2)), rng.random((sinks, 2))
    cost = np.sqrt(((places[0][:, None] - places[1]) ** 2).sum(axis=2)).ravel()
    supply, demand = rng.random(sources) + 0.1, rng.random(sinks) + 0.1
    A = sp.vstack(
        [
            sp.kron(sp.eye_array(sources), np.ones((1, sinks))),
            sp.kron(np.ones((1, sources)), sp.eye_array(sinks)),
        ]
    )
    b = np.concatenate([supply / supply.sum(), demand / demand.sum()])
    n = cost.size
    return Case(
        f"transport {sources}×{sinks}",
        (sp.csr_array((n, n)), cost, None, None, sp.csr_array(A), b, 0.0, FREE),
    )


def control(horizon: int, rng: np.random.Generator) -> Case:
    """Return the plan of a controller over that horizon."""
    return controller(horizon, 1.0, rng)


def nonnegative(m: int, n: int, rng: np.random.Generator) -> Case:
    """Return ½‖r‖², r = A x − b, x ≥ 0."""
    A, b = regression(m, n, rng)
    P = sp.diags_array(np.repeat([0.0, 1.0], [n, m]))
    equations = sp.block_array([[sp.csr_array(A), -sp.eye_array(m)]])
    lower = np.repeat([0.0, -FREE], [n, m])
    return Case(f"NNLS {m}×{n}", (P, np.zeros(n + m), None, None, equations, b, lower, FREE))


def steps(n: int, rng: np.random.Generator) -> FloatVector:
    """Return noisy steps."""
    noisy: FloatVector = np.repeat(rng.standard_normal(10), -(-n // 10))[
        :n
    ] + 0.2 * rng.standard_normal(n)
    return noisy


def total_variation(n: int, rng: np.random.Generator) -> Case:
    """Return ½‖x − a‖² + 2 Σ t, −t ≤ D x ≤ t."""
    D, identity = (
        sp.diags_array([-np.ones(n), np.ones(n)], offsets=[0, 1], shape=(n - 1, n)),
        sp.eye_array(n - 1),
    )
    P = sp.diags_array(np.repeat([1.0, 0.0], [n, n - 1]))
    G = sp.block_array([[D, -identity], [-D, -identity]])
    c = np.append(-steps(n, rng), np.full(n - 1, 2.0))
    return Case(f"total variation {n}", (P, c, G, np.zeros(2 * n - 2), None, None, -FREE, FREE))


def isotonic(n: int, rng: np.random.Generator) -> Case:
    """Return the nondecreasing sequence nearest to a noisy one."""
    a = np.sort(rng.standard_normal(n)) + 0.3 * rng.standard_normal(n)
    G = sp.diags_array([np.ones(n), -np.ones(n)], offsets=[0, 1], shape=(n - 1, n))
    return Case(f"isotonic {n}", (sp.eye_array(n), -a, G, np.zeros(n - 1), None, None, -FREE, FREE))


def kernel(n: int, rng: np.random.Generator) -> Case:
    """Return the dual of a support vector machine with a Gaussian kernel."""
    return support_vectors(n, rng)


QUICK: dict[Callable[..., Case], Sequence[tuple[int, ...]]] = {
    lasso: [(10, 20)],
    separator: [(30, 4)],
    transport: [(4, 5)],
    nonnegative: [(20, 5)],
}
FAMILIES: dict[Callable[..., Case], Sequence[tuple[int, ...]]] = {
    lasso: [(50, 100), (300, 1600), (1600, 300), (100, 2000)],
    split_lasso: [(300, 100), (100, 300), (100, 1000)],
    elastic_net: [(50, 100), (300, 1000), (1000, 300)],
    separator: [(100, 10), (2000, 20), (60, 1000), (1000, 200)],
    kernel: [(50,), (200,), (800,)],
    largest_margin: [(100, 10), (1000, 20), (60, 500)],
    huber: [(100, 20), (2000, 50), (600, 200)],
    portfolio: [(500, 20), (2000, 50), (5000, 50)],
    full_portfolio: [(500, 20), (2000, 50), (5000, 50), (1000, 150)],
    transport: [(10, 10), (30, 30), (100, 100), (200, 200)],
    control: [(10,), (50,), (200,)],
    nonnegative: [(200, 50), (2000, 100), (100, 400), (600, 600)],
    total_variation: [(200,), (5000,)],
    isotonic: [(200,), (5000,)],
}


def ours(case: Case) -> FloatVector:
    """Return our x, as of a program that nobody has seen before."""
    return solve_program(case.program()).solution.x


def run(*, quick: bool = False) -> Iterator[str]:
    """Yield a line a program: seconds of ours, and over those of each rival; † where it is less accurate."""
    present = [name for name in (*BETTER_OF, *BESIDE) if find_spec(name) is not None]
    yield from (
        f"{name} is not installed and left out"
        for name in (*BETTER_OF, *BESIDE)
        if name not in present
    )
    ratios = []
    for case in cases(quick=quick):
        seconds, errors = measured(case, present, quick=quick)
        shown = "".join(
            f"   ÷ {name} {seconds['ours'] / seconds[name]:7.2f}{' ' if errors[name] <= OPTIMAL else '†'}"
            for name in present
        )
        valid = [seconds[name] for name in present if name in BETTER_OF and errors[name] <= OPTIMAL]
        better = seconds["ours"] / min(valid) if valid else float("nan")
        ratios += [better] if valid else []
        note = "" if errors["ours"] <= OPTIMAL else f"   not solved: {errors['ours']:.0e}"
        yield f"{case.name:<24} {case.size:>6} {seconds['ours']:>9.4f} s   ÷ better {better:7.2f}{shown}{note}"
    if ratios:
        mean = np.exp(np.mean(np.log(ratios)))
        yield f"{mean:.2f} × the better of {' and '.join(BETTER_OF)}, geometric mean; {max(ratios):.2f} × at the worst"


def measured(
    case: Case, present: Sequence[str], *, quick: bool
) -> tuple[dict[str, float], dict[str, float]]:
    """Return the quickest of some rounds of each solver, and the errors of their answers."""
    program = case.program()
    calls = {"ours": lambda: ours(case)} | {
        name: (SETUPS | {"osqp": _osqp})[name](program, case.is_dense) for name in present
    }
    for _ in range(1 if quick else WARM):  # kernels are interpreted until compiling them pays
        first = {"ours": timed(calls["ours"], time.process_time)}
        if first["ours"].seconds > LONG:
            break
    first |= {name: timed(calls[name], time.process_time) for name in present}
    repeats = 1 if quick else int(np.clip(SECONDS / first["ours"].seconds, 2, MOST_ROUNDS))
    again = {
        name: call for name, call in calls.items() if name == "ours" or first[name].seconds < LONG
    }
    every = {name: [first[name]] for name in calls} | rounds(again, repeats, time.process_time)
    points = {name: np.asarray(one.answer) for name, one in first.items()}
    infeasible = {name: infeasibility(program, x) for name, x in points.items()}
    feasible = [name for name in calls if infeasible[name] <= OPTIMAL]
    least = min((program.objective(points[name]) for name in feasible), default=np.inf)
    errors = {
        name: max(infeasible[name], (program.objective(x) - least) / (1.0 + abs(least)))
        for name, x in points.items()
    }
    return {name: min(one.seconds for one in runs) for name, runs in every.items()}, errors


def infeasibility(program: QuadraticProgram, x: FloatVector) -> float:
    """Return the largest violation of a constraint, beside the largest limit, or 1 where all are 0."""
    parts = [
        (program.G @ x - program.h, program.h),
        (abs(program.A @ x - program.b), program.b),
        (program.lower - x, program.lower),
        (x - program.upper, program.upper),
    ]
    largest = max(float(np.abs(limit[np.isfinite(limit)]).max(initial=0.0)) for _, limit in parts)
    worst = max(float(left.max(initial=0.0)) for left, _ in parts)
    return worst / (largest or 1.0) if np.isfinite(x).all() else np.inf


def _osqp(program: QuadraticProgram, is_dense: bool) -> Callable[[], Any]:
    """Return its set-up and solution to 1e-6, polished, of data in its own format."""
    osqp: Any = import_module("osqp")
    identity = sp.eye_array(program.n)
    bounded = np.flatnonzero(np.isfinite(program.lower) | np.isfinite(program.upper))
    rows = [sp.csr_array(program.G), sp.csr_array(program.A), sp.csr_array(identity)[bounded]]
    A = sp.csc_matrix(sp.vstack([part for part in rows if part.shape[0]]))
    P = sp.triu(sp.csc_matrix(program.P), format="csc")
    lower = np.concatenate([np.full(program.h.size, -np.inf), program.b, program.lower[bounded]])
    upper = np.concatenate([program.h, program.b, program.upper[bounded]])

    def call() -> Any:
        solver = osqp.OSQP()
        solver.setup(
            P,
            program.c,
            A,
            lower,
            upper,
            verbose=False,
            eps_abs=OPTIMAL,
            eps_rel=OPTIMAL,
            polishing=True,
            max_iter=100_000,
        )
        return solver.solve(raise_error=False).x

    return call
