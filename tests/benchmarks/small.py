"""Small problems in a loop, next to the solver that a user would call instead: processor time, ratio, goal."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from importlib import import_module
from importlib.util import find_spec
from typing import Any

import numpy as np
from inputs.small_families import spectrum
from scipy.optimize import linprog, nnls

from lcp_plugin.api import solve
from lcp_plugin.core.lcp import LCP
from lcp_plugin.problems.batches.batch import solve_batch
from lcp_plugin.problems.cones.frictional_contact import FrictionalContact
from lcp_plugin.problems.least_squares.data import BoundedLeastSquares
from lcp_plugin.problems.programs.program import QuadraticProgram

from .timing import rounds

Call = Callable[[], Any]
#: Name, goal as a ratio, our call, name of the rival, its call, problems in a call.
Row = tuple[str, float, Call, str, Call, int]
REPEATS, SECONDS = 7, 0.02  # of processor time in each repetition


def run(*, quick: bool = False) -> Iterator[str]:
    """Yield a line for each row: microseconds of ours and of the rival, the ratio and its goal."""
    yield f"{'problem':44} {'ours':>9} {'instead':>9} µs  ratio   goal"
    for name, goal, ours, rival, instead, count in _rows(quick):
        times = {}
        for key, call in (("ours", ours), ("instead", instead)):
            call()  # compiles and loads
            once = rounds({key: call}, 1 if quick else 3, _clock)[key]
            inner = max(1, int(SECONDS / max(min(one.seconds for one in once), 1e-6)))
            times[key] = partial(_repeated, call, 1 if quick else inner), 1 if quick else inner
        runs = rounds(
            {key: call for key, (call, _) in times.items()}, 1 if quick else REPEATS, _clock
        )
        least = {
            key: 1e6 * min(one.seconds for one in runs[key]) / (times[key][1] * count)
            for key in runs
        }
        ratio = least["ours"] / max(least["instead"], 1e-9)
        numbers = f"{least['ours']:9.1f} {least['instead']:9.1f}    {ratio:6.1f} {goal:6.1f}"
        yield f"{name:44} {numbers}  {rival}"


def _clock() -> float:
    from time import process_time

    return process_time()


def _repeated(call: Call, times: int) -> None:
    for _ in range(times):
        call()


def _rows(quick: bool) -> Iterator[Row]:
    """Yield the rows of the table whose rival is installed."""
    rng = np.random.default_rng(0)
    if find_spec("quantecon") is not None:
        lemke = import_module("quantecon.optimize.lcp_lemke").lcp_lemke
        for n in (10, 30, 100):
            one = spectrum(n, 1e2, 0.4, 0)
            M, q = np.array(one.M), np.array(one.q)
            rival = "quantecon.lcp_lemke", partial(lemke, M, q), 1
            named = partial(_solve_lcp, M, q, "lemke")
            yield f"LCP(M, q) and solve, lemke, n = {n}", 17.0, named, *rival
            yield f"LCP(M, q) and solve, auto, n = {n}", 37.0, partial(_solve_lcp, M, q), *rival
        M, q = np.array(spectrum(10, 1e2, 0.4, 0).M), np.array(spectrum(10, 1e2, 0.4, 0).q)
        single = partial(solve_batch, M[None], q[None], algorithm="lemke", threads=1)
        yield (
            "batch of one, lemke, n = 10",
            40.0,
            single,
            "quantecon.lcp_lemke",
            partial(lemke, M, q),
            1,
        )
        many = 50 if quick else 1000
        stack = [spectrum(10, 1e2, 0.4, k) for k in range(many)]
        Ms, qs = (np.array([getattr(one, name) for one in stack]) for name in ("M", "q"))
        together = partial(solve_batch, Ms, qs, algorithm="lemke", threads=1)
        loop = partial(_each, lemke, Ms, qs)
        yield f"batch of {many}, lemke, n = 10, per problem", 2.0, together, "in a loop", loop, many
    if find_spec("daqp") is not None:
        daqp = import_module("daqp")
        G, c = rng.normal(size=(11, 4)), rng.normal(size=4)
        program = partial(_solve_program, np.eye(4), c, G, np.ones(11))
        rows = np.ascontiguousarray(G), np.ones(11), np.full(11, -1e30), np.zeros(11, np.int32)
        yield (
            "QP, 4 unknowns, 11 rows",
            15.0,
            program,
            "daqp",
            partial(daqp.solve, np.eye(4), c, *rows),
            1,
        )
    A, b = rng.random((60, 30)), rng.random(60)
    fit = partial(_solve_fit, A, b)
    yield (
        "nonnegative least squares, 60 × 30",
        4.0,
        fit,
        "scipy.optimize.nnls",
        partial(nnls, A, b),
        1,
    )
    A, B = rng.random((50, 200)), rng.random((40, 50))
    pixels, loop = partial(_solve_pixels, A, B), partial(_each, nnls, [A] * 40, B)
    yield "40 pixels, 50 bands × 200 atoms, per pixel", 2.0, pixels, "scipy.optimize.nnls", loop, 40
    G, h, c = rng.normal(size=(22, 4)), np.ones(22), rng.normal(size=4)
    G[11:], h[:] = -G[:11], -1.0
    no = partial(_solve_program, np.zeros((4, 4)), c, G, h)
    yield (
        "infeasible LP, 4 unknowns, 22 rows",
        4.0,
        no,
        "HiGHS by linprog",
        partial(linprog, c, G, h, bounds=(None, None)),
        1,
    )
    J = rng.normal(size=(15, 6))
    W, v = J @ J.T + np.eye(15), rng.normal(size=15)
    step = partial(_solve_contact, W, v, np.full(5, 0.5))
    yield (
        "5 contacts, exact cones (a linear solve)",
        20.0,
        step,
        "numpy.linalg.solve",
        partial(np.linalg.solve, W, v),
        1,
    )
    if find_spec("piqp") is not None:
        S, ones = np.cov(rng.normal(size=(200, 50))), np.ones((1, 200))
        for name, lower in (("free", -np.inf), ("long only", 0.0)):
            ours = partial(_solve_portfolio, S, lower)
            rival = partial(_by_piqp, import_module("piqp"), S, ones, lower)
            yield f"minimum variance, 200 assets, 50 days, {name}", 3.0, ours, "PIQP", rival, 1


def _solve_lcp(M: Any, q: Any, algorithm: str = "auto") -> None:
    solve(LCP(M, q), algorithm)


def _solve_program(P: Any, c: Any, G: Any, h: Any) -> None:
    solve(QuadraticProgram(P, c, G, h))


def _solve_fit(A: Any, b: Any) -> None:
    solve(BoundedLeastSquares(A, b))


def _solve_pixels(A: Any, B: Any) -> None:
    solve_batch(BoundedLeastSquares(A, B[0]), B, threads=1)


def _solve_contact(W: Any, b: Any, friction: Any) -> None:
    solve(FrictionalContact(W, b, friction, dimension=3))


def _solve_portfolio(S: Any, lower: float) -> None:
    solve(QuadraticProgram(S, np.zeros(len(S)), A=np.ones((1, len(S))), b=[1.0], lower=lower))


def _by_piqp(piqp: Any, S: Any, ones: Any, lower: float) -> None:
    solver = piqp.DenseSolver()
    n = len(S)
    solver.setup(
        S, np.zeros(n), ones, np.ones(1), None, None, None, np.full(n, lower), np.full(n, np.inf)
    )
    solver.solve()


def _each(call: Any, first: Any, second: Any) -> None:
    for a, b in zip(first, second, strict=True):
        call(a, b)
