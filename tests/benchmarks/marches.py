"""Steps in time on grids in the plane: a march beside a solve from the last answer at every step.

An American put in Heston's model (cross derivative, nonsymmetric), one on a basket of two prices in the logarithms
(nine points), heat over an obstacle (symmetric), a viscous elastic block on which a load rolls (contact). Processor
seconds on one thread, the first step, which has all the set-up, apart. `change` is the largest difference of the
answers beside the largest entry. Then American puts in one price: the gradient of one price by all data, backwards
through the steps, beside the march; and 41 strikes at once beside one after the other. At last 500 strikes × 2000
prices × 500 steps beside what one would write for them with numpy, Brennan and Schwartz's loop over the prices with all
strikes in its inner operations (it is right for a put and judges nothing), and beside LAPACK's `solve_banded`, once a
step without bounds: wall-clock seconds, the processor's of one thread, and what each keeps in memory. The same loop
beside 500 puts with a volatility each, whose matrices differ: prices, and vegas by the derivative of each march.
"""

from __future__ import annotations

import statistics
import time
import tracemalloc
from collections.abc import Callable, Iterator
from typing import Any, cast

import marches
import numpy as np
import scipy.sparse as sp
from scipy.linalg import solve_banded

from lcp_plugin.api import solve
from lcp_plugin.core.checks import FloatVector
from lcp_plugin.core.lcp import LCP
from lcp_plugin.core.solving.result import Result
from lcp_plugin.problems.march import March
from lcp_plugin.problems.march.march_many import march
from lcp_plugin.problems.sensitivity import derivative

SCENES: dict[str, tuple[Callable[[], marches.Steps], Callable[[], marches.Steps]]] = {
    "Heston put 400 × 150": (lambda: marches.heston()[0], lambda: marches.heston(40, 15, 4)[0]),
    "basket put 250²": (marches.basket, lambda: marches.basket(30, 4)),
    "heat over an obstacle 512²": (marches.parabolic, lambda: marches.parabolic(32, 4)),
    "rolling contact": (marches.contact, lambda: marches.contact(24, 4)),
}


def run(*, quick: bool = False) -> Iterator[str]:
    """Yield a line a scene and way."""
    for name, (large, small) in SCENES.items():
        make = small if quick else large
        short = make()._replace(forcing=make().forcing[:3])
        _alone(short), _together(short)  # compile
        alone, by_solves = _alone(make())
        together, by_march = _together(make())
        change = np.abs(alone[-1].z - together[-1].z).max() / np.abs(alone[-1].z).max()
        n = make().problem.n
        yield _line(f"{name}, n = {n}, solve", alone, by_solves)
        ratio = statistics.mean(by_march[1:]) / statistics.mean(by_solves[1:])
        yield f"{_line(f'{name}, n = {n}, march', together, by_march)}   ÷ solve {ratio:.2f}, change {change:.0e}"
    yield from _puts(*((60, 20, 5) if quick else (1000, 500, 41)))
    yield from _strikes(*((60, 20, 20) if quick else (2000, 500, 500)))
    yield from _volatilities(*((60, 20, 20) if quick else (901, 150, 500)))


def _puts(n: int, steps: int, count: int) -> Iterator[str]:
    x = np.linspace(-1.5, 1.5, n)
    A = sp.diags_array([-1.0, 2.0, -1.0], offsets=[-1, 0, 1], shape=(n, n)) * (
        0.045 / (x[1] - x[0]) ** 2
    )
    problem = LCP(sp.csr_array(sp.eye_array(n) * (1.0 + 0.05 / steps) + A / steps), np.zeros(n))
    payoffs = np.maximum(np.linspace(0.8, 1.2, count)[:, None] - np.exp(x), 0.0)
    forcing, weights = np.zeros((steps, n)), np.eye(n)[n // 2]

    def alone() -> list[March]:
        return [
            march(problem.with_q(problem.q, lower=payoff), forcing, z0=payoff) for payoff in payoffs
        ]

    def together() -> list[March]:
        return march(problem, forcing, lower=payoffs, z0=payoffs)

    def taken(work: Callable[[], Any]) -> float:
        began = time.process_time()
        work()
        return time.process_time() - began

    one = alone()[0], together()[0]
    change = max(abs(a - b).max() for a, b in zip(one[0].z, one[1].z, strict=True))
    derivative(one[0]).vjp(weights)
    rounds = [
        (taken(alone), taken(together), taken(lambda: derivative(one[0]).vjp(weights)))
        for _ in range(3)
    ]
    by_one, by_all, by_gradient = (
        statistics.median(seconds) for seconds in zip(*rounds, strict=True)
    )
    ratio = by_gradient * count / by_one
    yield f"put, n = {n}, {steps} steps: march {by_one / count:.4f} s, its gradient ÷ march {ratio:.2f}"
    yield f"{count} strikes: one by one {by_one:.3f} s, at once ÷ one by one {by_all / by_one:.2f}, change {change:.0e}"


def _strikes(n: int, steps: int, count: int) -> Iterator[str]:
    x = np.linspace(-1.5, 1.5, n)
    dt, rate, half = 1.0 / steps, 0.05, 0.045
    h = x[1] - x[0]
    below, above = (-dt * (half / h**2 + sign * (half - rate) / (2.0 * h)) for sign in (1, -1))
    centre = 1.0 + rate * dt - below - above
    M = sp.diags_array([below, centre, above], offsets=[-1, 0, 1], shape=(n, n))
    problem, forcing = LCP(sp.csr_array(M), np.zeros(n)), np.broadcast_to(np.zeros(n), (steps, n))
    payoffs = np.maximum(np.linspace(0.8, 1.2, count)[:, None] - np.exp(x), 0.0)

    def by_numpy() -> FloatVector:
        pivots, floor, V = np.full(n, centre), np.ascontiguousarray(payoffs.T), payoffs.T.copy()
        for i in range(n - 2, -1, -1):
            pivots[i] -= above * below / pivots[i + 1]
        for _ in range(steps):
            for i in range(n - 2, -1, -1):
                V[i] -= above / pivots[i + 1] * V[i + 1]
            np.maximum(V[0] / pivots[0], floor[0], out=V[0])
            for i in range(1, n):
                np.maximum((V[i] - below * V[i - 1]) / pivots[i], floor[i], out=V[i])
        return V.T

    def by_lapack() -> FloatVector:
        bands, V = (
            np.array([np.full(n, above), np.full(n, centre), np.full(n, below)]),
            payoffs.T.copy(),
        )
        for _ in range(steps):
            V = np.maximum(
                solve_banded((1, 1), bands, V, overwrite_b=True, check_finite=False), payoffs.T
            )
        return V.T

    def by_march() -> list[March]:
        return cast("list[March]", march(problem, forcing, lower=payoffs, z0=payoffs))

    march(problem, forcing[:2], lower=payoffs[:2], z0=payoffs[:2])  # compile
    ways = {
        "numpy's loop": by_numpy,
        "solve_banded": by_lapack,
        "march": by_march,
    }
    slowest, answers = 0.0, {}
    for name, way in ways.items():
        began = time.perf_counter(), time.process_time()
        answers[name] = way()
        wall, taken = time.perf_counter() - began[0], time.process_time() - began[1]
        slowest = slowest or taken
        tracemalloc.start()
        memory = tracemalloc.get_traced_memory()[1] / 2**20 if way() is not None else 0.0
        tracemalloc.stop()
        yield (
            f"{count} strikes × {n} × {steps}, {name:<22} {wall:.2f} s, processor {taken:.2f} s, "
            f"numpy's loop ÷ this {slowest / taken:.1f}, {memory:.0f} MB"
        )
    one = answers["march"]
    change = max(
        abs(done.z[-1] - V).max() for done, V in zip(one, answers["numpy's loop"], strict=True)
    )
    solved = sum(status.name == "SOLVED" for done in one for status in done.status)
    yield f"{solved} of {count * steps} steps SOLVED, change {change:.0e}"


def _volatilities(n: int, steps: int, count: int) -> Iterator[str]:
    x, sigma = np.linspace(-1.5, 1.5, n), np.linspace(0.15, 0.45, count)
    dt, rate, h = 1.0 / steps, 0.05, x[1] - x[0]
    floor, forcing = np.maximum(1.0 - np.exp(x), 0.0), np.broadcast_to(np.zeros(n), (steps, n))
    below, above = (
        -dt * (sigma**2 / h**2 + sign * (sigma**2 / 2 - rate) / h) / 2 for sign in (1, -1)
    )
    by_sigma = [-dt * (2 * sigma / h**2 + sign * sigma / h) / 2 for sign in (1, -1)]
    centre = 1.0 + rate * dt - below - above

    def matrix(a: float, b: float, c: float) -> sp.csr_array:
        return sp.csr_array(sp.diags_array([a, b, c], offsets=[-1, 0, 1], shape=(n, n)))

    def by_numpy() -> FloatVector:
        pivots, bound = np.repeat(centre[None], n, axis=0), floor[:, None]
        V = np.repeat(bound, count, axis=1)
        for i in range(n - 2, -1, -1):
            pivots[i] -= above * below / pivots[i + 1]
        ratios, inverse = above / pivots, 1.0 / pivots
        for _ in range(steps):
            for i in range(n - 2, -1, -1):
                V[i] -= ratios[i + 1] * V[i + 1]
            np.maximum(V[0] * inverse[0], bound[0], out=V[0])
            for i in range(1, n):
                np.maximum((V[i] - below * V[i - 1]) * inverse[i], bound[i], out=V[i])
        return V.T

    def by_march() -> list[March]:
        each = zip(below, centre, above, strict=True)
        problems = [LCP(matrix(*one), np.zeros(n), lower=floor) for one in each]
        return cast("list[March]", march(problems, forcing, z0=floor))

    def vega(one: March, a: float, c: float) -> FloatVector:
        return derivative(one).jvp(dM=matrix(a, -a - c, c), only_last=True)

    march(
        [LCP(matrix(a, 3.0, c), np.zeros(n), lower=floor) for a, c in ((-0.9, -0.9), (-0.8, -0.8))],
        forcing[:2],
    )
    taken, answers = {}, {}
    for name, way in {
        "numpy's loop": by_numpy,
        "prices": by_march,
    }.items():
        began = time.process_time()
        answers[name] = way()
        taken[name] = time.process_time() - began
    vega(answers["kept"][0], 0.0, 0.0)  # compile
    began = time.process_time()
    for one, a, c in zip(answers["kept"], *by_sigma, strict=True):
        vega(one, a, c)
    both, by_loop = taken["kept"] + time.process_time() - began, taken["numpy's loop"]
    change = max(
        abs(one.z[-1] - V).max()
        for one, V in zip(answers["prices"], answers["numpy's loop"], strict=True)
    )
    yield (
        f"{count} volatilities × {n} × {steps}: numpy's loop {by_loop:.2f} s, prices ÷ it "
        f"{taken['prices'] / by_loop:.2f}, prices and vegas ÷ it {both / by_loop:.2f}, change {change:.0e}"
    )


def _line(what: str, results: list[Result], seconds: list[float]) -> str:
    solved = sum(result.is_solved for result in results)
    return (
        f"{what:<48} {solved} of {len(results)} SOLVED; first {seconds[0]:.3f} s, a step after it "
        f"{statistics.mean(seconds[1:]):.4f} s   {results[-1].algorithm}, {results[-1].iterations} iterations"
    )


def _fresh(steps: marches.Steps) -> LCP:
    return LCP(steps.problem.csr, steps.problem.q, lower=steps.problem.lower)


def _alone(steps: marches.Steps) -> tuple[list[Result], list[float]]:
    problem, state, results, seconds = _fresh(steps), steps.z0, [], []
    for force in steps.forcing:
        began = time.process_time()
        results.append(solve(problem.with_q(force + steps.propagator @ state), z0=state, threads=1))
        seconds.append(time.process_time() - began)
        state = results[-1].z
    return results, seconds


def _together(steps: marches.Steps) -> tuple[list[Result], list[float]]:
    """Tell steps apart by what the first one alone takes."""

    def taken(forcing: FloatVector) -> tuple[Any, float]:
        began = time.process_time()
        done = march(_fresh(steps), forcing, steps.propagator, z0=steps.z0, threads=1)
        return done, time.process_time() - began

    first, done = taken(steps.forcing[:1])[1], taken(steps.forcing)
    others = (done[1] - first) / max(len(steps.forcing) - 1, 1)
    return list(done[0]), [first] + [others] * (len(steps.forcing) - 1)
