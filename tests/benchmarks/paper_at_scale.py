"""The paper's Example 1 by NPSOR(1.7), end to end from (M, q): ours against honest scipy implementations.

The scipy programs use the residual form of the iteration too, factorise once in natural order, and take the format that
``spsolve_triangular`` is fastest with.
"""

from __future__ import annotations

import statistics
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import numpy as np
import scipy.sparse as sp
from paper_tables import TOLERANCE, iterated
from scipy.sparse.linalg import splu, spsolve_triangular

from lcp_plugin.algorithms import create, paper_options
from lcp_plugin.core.checks import Vector
from lcp_plugin.core.lcp import LCP
from lcp_plugin.gallery import build

from .timing import Calls, rounds

Prepare = Callable[[sp.csr_array], Callable[[Any], Any]]
RELAXATION = 1.7
TARGET = 8.0


def run(*, quick: bool = False) -> Iterator[str]:
    """Yield the times and ratios; all stop at the paper's Res < 1e-5 and return the same iterate."""
    scene = build("paper_example_1", n=10_000 if quick else 1_000_000)
    M, q, start = scene.problem.csr, np.array(scene.problem.q), np.array(scene.start)

    def ours() -> tuple[Vector, int]:
        algorithm = create("npsor", paper_options("npsor", RELAXATION))
        z, count, _, _ = iterated(LCP(M, q), start, algorithm)
        return z, count

    scipys: dict[str, Prepare] = {
        "splu": factorised,
        "splu, tuned": factorised_without_panels,
        "spsolve_triangular": substituted,
    }
    calls: Calls = {"lcp_plugin": ours} | {
        f"scipy {name}": partial(scipy_npsor, M, q, start, prepare)
        for name, prepare in scipys.items()
    }
    once = {name: call for name, call in calls.items() if "triangular" in name}
    often = {name: call for name, call in calls.items() if name not in once}
    rounds(often, 1)
    runs = rounds(often, 3 if quick else 5) | rounds(once, 1)
    seconds = {
        name: statistics.median(one.seconds for one in every) for name, every in runs.items()
    }
    yield f"Example 1, n = {q.size}, NPSOR({RELAXATION}) to Res < {TOLERANCE:g}, everything from (M, q) to the answer"
    for name, every in runs.items():
        z, iterations = every[0].answer
        difference = float(np.max(np.abs(z - runs["lcp_plugin"][0].answer[0])))
        yield f"{name:<26} {seconds[name]:8.3f} s   {iterations} iterations   |z − ours| ≤ {difference:.1e}"
    for name, value in seconds.items():
        if name != "lcp_plugin":
            target = f"   target ≥ {TARGET:g}" if name == "scipy splu" else ""
            yield f"{name} ÷ ours: {value / seconds['lcp_plugin']:.1f}{target}"


def scipy_npsor(M: sp.csr_array, q: Vector, start: Vector, prepare: Prepare) -> tuple[Vector, int]:
    """Return (z, iterations) of NPSOR written with scipy: the factor made once, work arrays reused where scipy can."""
    diagonal = M.diagonal()
    lower = sp.csr_array(sp.tril(M, -1) + sp.diags_array(diagonal / RELAXATION + diagonal + 2.0))
    apply_inverse = prepare(lower)
    z, residual = start.copy(), np.empty_like(start)
    iterations = 0
    while True:
        w = M @ z
        w += q
        np.minimum(z, w, out=residual)
        if np.linalg.norm(residual) < TOLERANCE:
            return z, iterations
        residual *= -2.0
        z += apply_inverse(residual)
        np.maximum(z, 0.0, out=z)
        iterations += 1


def factorised(lower: sp.csr_array, **panels: int) -> Callable[[Any], Any]:
    """Return a solve with SuperLU's factor of the triangular matrix: natural ordering, no pivoting, no fill."""
    factor = splu(sp.csc_array(lower), permc_spec="NATURAL", diag_pivot_thresh=0.0, **panels)
    solve_with: Callable[[Any], Any] = factor.solve
    return solve_with


# which halves the time of the factorization
factorised_without_panels = partial(factorised, relax=1, panel_size=1)


def substituted(lower: sp.csr_array) -> Callable[[Any], Any]:
    """Return a solve by scipy's spsolve_triangular, in the format that it is fastest with."""
    by_columns = sp.csc_array(lower)
    return lambda right_hand_side: spsolve_triangular(by_columns, right_hand_side, lower=True)
