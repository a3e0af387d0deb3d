"""What the benchmark `compilation` times, each in a process of its own: a first solve, or two kernels to compare with.

``python tests/benchmarks/first_solves.py NAME`` runs one and prints how many functions numba compiled and
the processor seconds of the process; of the two kernels the seconds that compiling them took.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable
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
    from lcp_plugin.problems.least_squares.solving import bounded_least_squares

    bounded_least_squares(_random(5 * SIZE, SIZE), np.arange(5.0 * SIZE))


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


def _dense_lu(A: Any, order: Any) -> None:
    """Factorise in place with row pivoting."""
    n = A.shape[0]
    for k in range(n):
        largest = k
        for i in range(k + 1, n):
            if abs(A[i, k]) > abs(A[largest, k]):
                largest = i
        order[k] = largest
        for j in range(n):
            A[k, j], A[largest, j] = A[largest, j], A[k, j]
        for i in range(k + 1, n):
            A[i, k] /= A[k, k]
            for j in range(k + 1, n):
                A[i, j] -= A[i, k] * A[k, j]


def _projected_gauss_seidel(
    data: Any, indices: Any, indptr: Any, q: Any, z: Any, sweeps: int
) -> float:
    """Sweep in place; return the largest change of the last sweep."""
    change = 0.0
    for _ in range(sweeps):
        change = 0.0
        for i in range(q.size):
            w, diagonal = q[i], 1.0
            for entry in range(indptr[i], indptr[i + 1]):
                w += data[entry] * z[indices[entry]]
                if indices[entry] == i:
                    diagonal = data[entry]
            new = max(z[i] - w / diagonal, 0.0)
            change, z[i] = max(change, abs(new - z[i])), new
    return change


def reference() -> dict[str, float]:
    """Return the seconds that numba takes to compile two plain kernels, nothing of which is kept."""
    from numba import njit

    began, processor = time.perf_counter(), time.process_time()
    njit(_dense_lu)(_definite(), np.empty(SIZE, np.int64))
    pointers = np.arange(SIZE + 1)
    njit(_projected_gauss_seidel)(
        np.ones(SIZE), pointers[:-1], pointers, _random(SIZE), np.zeros(SIZE), 2
    )
    return {"seconds": time.perf_counter() - began, "processor": time.process_time() - processor}


def first(name: str) -> dict[str, float]:
    """Run one of the first solves; return how much was compiled, and the processor seconds since the process began."""
    from numba.core import event

    with event.install_recorder("numba:compile") as recorder:
        SOLVES[name]()
    compilations = sum(each.is_start for _, each in recorder.buffer)
    return {"compilations": compilations, "processor": time.process_time()}


if __name__ == "__main__":
    print(json.dumps(reference() if sys.argv[1] == "reference" else first(sys.argv[1])))
