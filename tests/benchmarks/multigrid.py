"""Obstacle problems by multigrid and auto, from (M, q) to the verified result, against a linear solve by pyamg.

Times are processor seconds of one thread: on a busy machine they keep their ratios better than elapsed ones.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import pyamg
import scipy.sparse as sp
from inputs.membranes import parse

from lcp_plugin import Result, solve
from lcp_plugin.evidence.measurement import fresh
from lcp_plugin.gallery import Scene

from .timing import quickest

TOLERANCE = 1e-8
FORWARD, BACKWARD = (("gauss_seidel", {"sweep": sweep}) for sweep in ("forward", "backward"))
# pyamg's defaults, and the fastest of its interpolations, smoothers and coarse solvers on 10⁶ unknowns.
PYAMG: dict[str, dict[str, Any]] = {
    "classical": {"max_coarse": 50},
    "direct": {
        "max_coarse": 500,
        "coarse_solver": "splu",
        "interpolation": "direct",
        "presmoother": FORWARD,
        "postsmoother": BACKWARD,
    },
}
SCENES = {  # full size, quick size
    "obstacle_2d:size={}": (1024, 60),
    "obstacle_3d:size={}": (100, 12),
    "journal_bearing:size={},eccentricity=0.9": (1000, 50),
    "convection_diffusion:size={},diffusion=1e-3": (500, 50),
    "rotated_anisotropy:size={}": (500, 50),
    "coefficient_jumps:size={},contrast=1e6": (500, 50),
}


def run(*, quick: bool = False) -> Iterator[str]:
    """Yield a line for each test problem."""
    for text, sizes in SCENES.items():
        scene = parse(text.format(sizes[quick]))
        calls: dict[str, Callable[[], Any]] = {
            name: partial(from_scratch, scene, name) for name in ("multigrid", "auto")
        } | {name: partial(linear_solve, scene, name) for name in PYAMG}
        best = quickest(calls)
        linear = min((best[name] for name in PYAMG), key=lambda one: one.seconds)
        shown = "".join(
            f"   {name} {best[name].answer.status.name}, {best[name].answer.iterations} cycles, "
            f"{best[name].seconds:.3f} s = {best[name].seconds / linear.seconds:.2f} × linear"
            for name in ("multigrid", "auto")
        )
        yield f"{scene!r}, n = {scene.problem.n}:{shown}   ({linear.answer})"


def from_scratch(scene: Scene, algorithm: str) -> Result:
    """Return the result for a problem stated anew, so that nothing computed before is used."""
    return solve(fresh(scene.problem), algorithm, tolerance=TOLERANCE, threads=1)


def linear_solve(scene: Scene, hierarchy: str) -> str:
    """Solve M x = −q by a Ruge–Stüben hierarchy of pyamg's with CG (BiCGStab where M is not symmetric) to 1e-8."""
    problem, residuals = scene.problem, list[float]()
    built = pyamg.ruge_stuben_solver(sp.csr_matrix(problem.csr), **PYAMG[hierarchy])
    accelerator = "cg" if abs(problem.csr - problem.csr.T).nnz == 0 else "bicgstab"
    built.solve(-problem.q, tol=TOLERANCE, accel=accelerator, maxiter=200, residuals=residuals)
    return f"pyamg {hierarchy}, {accelerator}, {len(residuals) - 1} iterations"
