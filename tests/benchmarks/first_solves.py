"""First solves, each in a new process: how many functions numba compiles, and the processor seconds of the process.

``python tests/benchmarks/first_solves.py NAME`` runs one.
"""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

SIZE = 10


def _random(*shape: int) -> Any:
    return np.random.default_rng(0).standard_normal(shape)


def _definite() -> Any:
    A = _random(SIZE, SIZE)
    return A @ A.T + np.eye(SIZE)


def _ten() -> None:
    from lcp_plugin import LCP, solve

    solve(LCP(_definite(), _random(SIZE))).require_solved()


def _string() -> None:
    import scipy.sparse as sp

    from lcp_plugin import LCP, solve

    n = 200
    M = sp.diags_array([-1.0, 2.0, -1.0], offsets=[-1, 0, 1], shape=(n, n), format="csr")
    solve(LCP(M, np.where(np.arange(n) < n // 2, -1e-3, 1e-3))).require_solved()


def _grid() -> None:
    from lcp_plugin import gallery, solve

    solve(gallery.build("obstacle_2d", size=200).problem).require_solved()


def _model() -> None:
    import cvxpy as cp

    from lcp_plugin import complements

    x = cp.Variable(SIZE)
    pairs = complements(x >= 0, _definite() @ x + _random(SIZE) >= 0)
    cp.Problem(cp.Minimize(0), [pairs]).solve(method="LCP")


def _program() -> None:
    import cvxpy as cp

    from lcp_plugin import QPSolver

    x = cp.Variable(SIZE)
    cost = cp.sum_squares(_random(2 * SIZE, SIZE) @ x - np.arange(2.0 * SIZE))
    cp.Problem(cp.Minimize(cost), [x >= 0, cp.sum(x) == 1]).solve(solver=QPSolver)


def _least_squares() -> None:
    from lcp_plugin import BoundedLeastSquares, solve

    solve(BoundedLeastSquares(_random(5 * SIZE, SIZE), np.arange(5.0 * SIZE)))


def _game() -> None:
    from lcp_plugin import LCP, solve

    solve(LCP.from_game(_random(3, 3), -_random(3, 3))).require_solved()


def _nonlinear() -> None:
    from lcp_plugin import NonlinearProblem
    from lcp_plugin.problems.nonlinear.solving import solve_nonlinear

    M = np.array([[2.0, 1.0], [1.0, 3.0]])
    solve_nonlinear(NonlinearProblem(lambda x: M @ x + x**3 - 1.0), [1.0, 1.0]).require_solved()


def _contact() -> None:
    from lcp_plugin import FrictionalContact, solve

    solve(FrictionalContact(np.eye(3), [-1.0, 3.0, 4.0], 0.5)).require_solved()


def _pile() -> None:
    from lcp_plugin import FrictionalContact, solve

    along = np.tile(np.eye(3), (10, 4))  # ten bodies of four contacts each, on the ground
    rows = np.kron(np.eye(10), along[:12, :3]).reshape(40, 3, 30)
    bodies = np.eye(30), rows[:, 2], rows[:, :2]
    velocities = np.tile([0.3, 0.0, -1.0], 10)
    solve(FrictionalContact(bodies, velocities, 0.5), z0=np.ones(120)).require_solved()


SOLVES: dict[str, Callable[[], None]] = {
    "ten": _ten,
    "string": _string,
    "grid": _grid,
    "model": _model,
    "program": _program,
    "least squares": _least_squares,
    "nonlinear": _nonlinear,
    "game": _game,
    "contact": _contact,
    "pile": _pile,
}


def first(name: str) -> dict[str, float]:
    """Run one of the first solves; return how much was compiled, and the processor seconds since the process began."""
    from numba.core import event

    with event.install_recorder("numba:compile") as recorder:
        SOLVES[name]()
    compilations = sum(each.is_start for _, each in recorder.buffer)
    return {"compilations": compilations, "processor": time.process_time()}


def run(*, quick: bool = False) -> Iterator[str]:
    """Yield a line for each first solve; kernels that are kept on disk are not compiled again."""
    for name in ("ten",) if quick else SOLVES:
        done = subprocess.run(
            [sys.executable, __file__, name], capture_output=True, text=True, check=True
        )
        told = json.loads(done.stdout)
        yield f"{name:<14} {told['compilations']:4.0f} functions compiled, {told['processor']:.2f} s of processor time"


if __name__ == "__main__":
    print(json.dumps(first(sys.argv[1])))
