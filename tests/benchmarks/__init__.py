"""Benchmarks: each yields lines of text with ratios measured in one run. ``python tests/benchmarks`` lists them."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from importlib import import_module
from pathlib import Path

sys.path.append(str(Path(__file__).parents[2] / "examples"))  # paper_tables is an example

BENCHMARKS = {
    "sweeps": "one sweep against one scipy product with M, n = 10⁶, single thread",
    "paper-at-scale": "the paper's Example 1 at n = 10⁶ by NPSOR(1.7) against scipy implementations, end to end",
    "multigrid": "projected multigrid on obstacle, bearing, wind, jumps … against a linear solve, up to n = 4·10⁶",
    "marches": "steps in time on grids in the plane: what march needs beside a solve from the last answer at each step",
    "compilation": "the first solve of an installation in a fresh process, nothing compiled; and the warm-up",
    "small": "small and medium problems, one by one and in batches, beside compiled rivals",
    "contact": "contact with friction: steps, trajectories, batches, beside Dantzig's pivots, PGS, Lemke",
    "cones": "contact with friction as it is, beside Siconos and pyramids: answers from scratch, warm steps in time",
    "piles": "a step of spheres poured into a box, beside MuJoCo, Drake and Siconos: its time and its residual",
    "auto": "auto beside the best named method, warm, on scenes and on problems of every kind",
    "rivals": "dense, contact and sparse problems against convex QP solvers, each at its cheapest setting",
    "shapes": "lasso, support vectors, portfolios, transport … at every shape, against OSQP and Clarabel",
    "programs": "quadratic programs against PIQP and Clarabel, to 2000 rows and above; control again against OSQP",
    "cvxpy-models": "27 models of cvxpy's users, each stated anew, against Clarabel and OSQP",
    "certificates": "what an H₊ proof and an error bound cost, against one multigrid solution of the linear system",
    "least-squares": "bounded least squares beside scipy on every kind of A, and what a factor costs in steps",
    "derivatives": "a gradient by all data against its solve, up to n = 10⁶, and against cvxpy's own backward",
    "proved-answers": "what certify proves of answers to convex programs, ours beside those of other solvers",
    "derivative-errors": "how exact a derivative of z is after how much time, beside a difference of two solves",
    "best-equilibria": "the best of all solutions on random leaders: nodes and time until the gap is proved",
    "tuning": "each constant of lcp_plugin.core.tuning beside what this machine says of it",
    "modeling": "the cost of stating a problem in cvxpy, against cvxpy's own compilation",
}


def load(name: str) -> Callable[..., Iterator[str]]:
    """Return the benchmark of that name: a callable with the keyword `quick` that yields lines."""
    run: Callable[..., Iterator[str]] = import_module(f"{__name__}.{name.replace('-', '_')}").run
    return run
