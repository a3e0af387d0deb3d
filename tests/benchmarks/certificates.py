"""What a proof costs: of SOLVED beside a product, H₊ certificate and error bound beside one solution of the system."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import numpy as np
import scipy.sparse as sp

from lcp_plugin.api import solve
from lcp_plugin.core.certificates.residuals import Certificate
from lcp_plugin.core.checks import FloatVector
from lcp_plugin.evidence.measurement import fresh
from lcp_plugin.gallery import build
from lcp_plugin.proofs.bounds.error_bounds import error_bound
from lcp_plugin.proofs.verdicts import analyze

from .multigrid import require_pyamg
from .timing import Calls, rounds

TARGET_RATIO = 1.5
TARGET_SHARPNESS = 2.0
TARGET_PRODUCTS = 3.0
ROUNDS = 3
PRODUCTS = 30


def run(*, quick: bool = False) -> Iterator[str]:
    """Yield the ratios on plain Laplacians, and bound ÷ true error on the paper's Example 1."""
    yield f"SOLVED proved: bound of the residual ÷ one scipy product with M   target ≤ {TARGET_PRODUCTS:g}, n large"
    for size in (100,) if quick else (100, 300, 1000):
        yield _proof_of_solved(size)
    yield from _laplacian(50 if quick else 500)
    yield from _paper_example(10_000 if quick else 1_000_000)


def _proof_of_solved(size: int) -> str:
    problem = build("obstacle_2d", size=size).problem
    z = solve(problem, "multigrid").z
    proof = lambda: Certificate.of(problem, z).relative_residual  # noqa: E731
    return f"  n = {problem.n:<8} {_ratios({'product': partial(problem.M.dot, z), 'proof': proof}, PRODUCTS)['proof']}"


def _ratios(calls: Calls, repeats: int) -> dict[str, str]:
    """Return median and range of the seconds of each call but the first, over those of the first in the same round."""
    first, *others = rounds(calls, repeats).values()
    found = {}
    for name, runs in zip(list(calls)[1:], others, strict=True):
        ratios = [run.seconds / alone.seconds for run, alone in zip(runs, first, strict=True)]
        found[name] = f"{np.median(ratios):.2f} ×   ({min(ratios):.2f} … {max(ratios):.2f})"
    return found


def _laplacian(size: int) -> Iterator[str]:
    scene = build("obstacle_2d", size=size)
    problem = scene.problem
    near: FloatVector = solve(problem, tolerance=1e-6, max_iterations=200).z
    M, rhs = sp.csr_matrix(problem.csr), -np.ones(problem.n)

    pyamg = require_pyamg()

    def linear_solve() -> None:
        pyamg.ruge_stuben_solver(M).solve(rhs, tol=1e-8, accel="cg")

    def bounded(sharp: bool) -> None:
        stated_anew = fresh(problem)
        if not analyze(stated_anew).is_h_plus or not np.isfinite(
            error_bound(stated_anew, near, sharp=sharp).infinity
        ):
            raise RuntimeError("the plain Laplacian is an H₊-matrix, but no bound came back")

    bounds = {"v-certificate bound": partial(bounded, False), "sharp bound": partial(bounded, True)}
    rounds(bounds, 1)
    yield f"five-point Laplacian, n = {problem.n}: time ÷ one pyamg solve (set-up + CG to 1e-8), set-up included"
    for kind, ratio in _ratios({"linear": linear_solve} | bounds, ROUNDS).items():
        yield f"H₊ certified and {kind:<20} {ratio}   target ≤ {TARGET_RATIO:g}"


def _paper_example(n: int) -> Iterator[str]:
    scene = build("paper_example_1", n=n)
    exact = scene.exact
    if exact is None:
        raise RuntimeError("Example 1 knows its solution")
    yield f"Example 1, δ = 4, n = {n}: bound ÷ true error   target ≤ {TARGET_SHARPNESS:g}"
    for tolerance in (1e-3, 1e-8, 1e-12):
        result = solve(scene.problem, tolerance=tolerance)
        error = float(np.max(np.abs(result.z - exact)))
        for sharp in (False, True):
            ratio = error_bound(scene.problem, result.z, sharp=sharp).infinity / error
            yield f"  tolerance {tolerance:.0e}, {'sharp' if sharp else 'v-certificate':<14} {ratio:.4f} × the error"
