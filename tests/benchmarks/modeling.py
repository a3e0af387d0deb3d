"""What stating a problem in cvxpy costs, from the expressions to (M, q), against cvxpy's own compilation."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import numpy as np

from lcp_plugin.gallery import build

from .timing import medians, timed

TARGET_SECONDS = {10_000: 0.015, 1_000_000: 1.0}
TARGET_RATIO = 0.6
TARGET_NONLINEAR = {10_000: 1.0, 102_400: 3.0}


def run(*, quick: bool = False) -> Iterator[str]:
    """Yield the overhead at n = 10⁴ and 10⁶, the ratio to ``get_problem_data``, a re-solve at n = 10, and with exp."""
    from lcp_plugin.modeling.registration import build_from

    for n in (10_000,) if quick else (10_000, 1_000_000):
        scene = build("paper_example_1", n=n)
        M, q = scene.problem.csr.copy(), np.array(scene.problem.q)
        calls: dict[str, Callable[[], object]] = {
            "ours": partial(_declared, M, q),
            "cvxpy": partial(_compiled_by_cvxpy, M, q),
        }
        seconds = medians(calls, repeats=3 if n > 10_000 else 9)
        ratio = seconds["ours"] / seconds["cvxpy"]
        yield (
            f"n = {n}: expressions, extraction and LCP {seconds['ours']:.4f} s   target ≤ {TARGET_SECONDS[n]:g} s; "
            f"÷ cvxpy's get_problem_data {ratio:.2f}   target ≤ {TARGET_RATIO}"
        )
    problem = _small()
    build_from(problem)
    microseconds = 1e6 / 200 * timed(lambda: [build_from(problem) for _ in range(200)]).seconds
    yield f"n = 10: everything but the solve at a re-solve {microseconds:.0f} µs   target ≤ 1000 µs"
    for n in (10_000,) if quick else (10_000, 102_400):
        yield _nonlinear(n)


def _compiled_by_cvxpy(M: Any, q: Any) -> object:
    import cvxpy as cp

    return cp.Problem(cp.Minimize(0), [M @ cp.Variable(len(q)) + q == 0]).get_problem_data("OSQP")


def _declared(M: Any, q: Any) -> object:
    import cvxpy as cp

    from lcp_plugin.modeling.constraint import complements
    from lcp_plugin.modeling.registration import build as build_model

    x = cp.Variable(len(q))
    return build_model([complements(x >= 0, M @ x + q >= 0)])


def _nonlinear(n: int) -> str:
    """Return what a nonlinear model costs beside its solver, and what its derivative costs beside a product with M."""
    import cvxpy as cp

    from lcp_plugin.modeling.constraint import complements
    from lcp_plugin.modeling.registration import build_from

    scene = build("paper_example_1", n=n)
    M, q = scene.problem.csr.copy(), np.array(scene.problem.q)
    x = cp.Variable(n)
    problem = cp.Problem(cp.Minimize(0), [complements(x >= 0, M @ x + cp.exp(x) + q >= 0)])
    beside = []
    for _ in range(4):  # the first one compiles
        whole = timed(lambda: problem.solve(method="LCP", warm_start=False)).seconds
        beside.append(whole - problem.solver_stats.solve_time)
    stated: Any = build_from(problem).problem
    point = np.ones(n)
    seconds = medians(
        {"derivative": lambda: stated.jacobian(point), "product": lambda: M @ point}, repeats=9
    )
    return (
        f"n = {n}, with exp(x): all of problem.solve beside the solver {np.median(beside[1:]):.3f} s   target ≤ "
        f"{TARGET_NONLINEAR[n]:g} s; F′(x) ÷ product with M {seconds['derivative'] / seconds['product']:.1f}"
    )


def _small() -> object:
    import cvxpy as cp

    from lcp_plugin.modeling.constraint import complements

    x = cp.Variable(10)
    return cp.Problem(cp.Minimize(0), [complements(x >= 0, (3 * np.eye(10)) @ x - 1 >= 0)])
