"""Check batches on a GPU against the CPU, then print a table of times: ``python .ci/on_a_gpu.py`` (about 3 minutes).

Needs a GPU of NVIDIA, numba-cuda and CuPy; PyTorch and JAX are checked if they are installed. With ``--simulated``,
numba's simulator and a replacement of CuPy run the same checks for n ≤ 6 without a GPU, and no times are printed.
"""

from __future__ import annotations

import os
import sys
import time
from pathlib import Path
from typing import Any

IS_SIMULATED = "--simulated" in sys.argv
if IS_SIMULATED:
    os.environ["NUMBA_ENABLE_CUDASIM"] = "1"  # before numba is imported
sys.path[:0] = [str(Path(__file__).parents[1]), str(Path(__file__).parents[1] / "tests")]

import numpy as np  # noqa: E402

from lcp_plugin import Status, derivative, solve_batch  # noqa: E402

INF = np.inf
SIZES = [(1, 5), (3, 12), (6, 12)] if IS_SIMULATED else [(1, 100), (8, 500), (30, 500), (70, 200)]


def definite(n: int, count: int) -> tuple[Any, ...]:
    """Return random positive definite problems with some bounds finite."""
    rng = np.random.default_rng(n)
    A, q = rng.normal(size=(count, n, n)), rng.normal(size=(count, n))
    lower = np.where(rng.random((count, n)) < 0.3, -INF, -rng.random((count, n)))
    upper = np.where(
        (rng.random((count, n)) < 0.5) & np.isfinite(lower), INF, rng.random((count, n))
    )
    return A @ A.swapaxes(1, 2) + np.eye(n), q, lower, upper


def awkward(n: int, count: int) -> tuple[Any, ...]:
    """Return problems of integers, with ties, free and fixed unknowns, NaN, crossed bounds and no solution."""
    rng = np.random.default_rng(n)
    A = rng.integers(-1, 2, (count, n, n))
    M, q = A @ A.swapaxes(1, 2) + np.eye(n), rng.integers(-2, 2, (count, n)).astype(float)
    lower, upper = np.zeros((count, n)), np.full((count, n), INF)
    lower[0], q[1, 0], upper[2, 0], lower[3, 0], upper[4, 0] = -INF, np.nan, 0.0, 1.0, -1.0
    upper[3, 0], M[0, 0], q[0, 0], lower[0, 0] = 0.5, 0.0, -1.0, 0.0
    return M, q, lower, upper


def libraries() -> dict[str, Any]:
    """Return a function per library that copies an array of numpy to the GPU."""
    if IS_SIMULATED:
        from tools.strict_cupy import module

        sys.modules["cupy"] = module()
        return {"stand-in": sys.modules["cupy"].asarray}
    import cupy

    found = {"cupy": cupy.asarray}
    try:
        import torch

        found["torch"] = lambda one: torch.as_tensor(one, device="cuda")
    except ImportError as error:
        print("without PyTorch:", error)
    try:
        import jax

        jax.config.update("jax_enable_x64", True)
        found["jax"] = lambda one: jax.device_put(one, jax.devices("gpu")[0])
    except (ImportError, RuntimeError) as error:
        print("without JAX:", error)
    return found


def on_host(array: Any) -> Any:
    """Return an array of any library as one of numpy."""
    if hasattr(array, "cpu"):
        array = array.cpu()
    return np.asarray(array.get() if hasattr(array, "get") else array, dtype=float)


def compare(put: Any, data: tuple[Any, ...]) -> int:
    """Solve on the GPU and on the CPU; return the number of problems that were solved on the GPU."""
    given = [put(one) for one in data]
    there, here = (
        solve_batch(M, q, lower=lower, upper=upper) for M, q, lower, upper in (given, data)
    )
    assert type(there.z) is type(given[1])
    assert there.status.tolist() == here.status.tolist()
    assert there.errors.keys() == here.errors.keys()
    z, w = on_host(there.z), on_host(there.w)
    np.testing.assert_allclose(z, here.z, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(w, here.w, rtol=1e-9, atol=1e-8)
    again = solve_batch(given[0], given[1], lower=given[2], upper=given[3])
    assert on_host(again.z).tobytes() == z.tobytes()
    g = np.random.default_rng(1).normal(size=z.shape)
    found, expected = derivative(there), derivative(here)
    by, of_cpu = found.vjp(put(g)), expected.vjp(g)
    for name in ("q", "lower", "upper", "M"):
        assert type(getattr(by, name)) is type(given[1])
        np.testing.assert_allclose(
            on_host(getattr(by, name)), getattr(of_cpu, name), rtol=1e-7, atol=1e-9, err_msg=name
        )
    assert found.errors.keys() == expected.errors.keys()
    for k in (0, len(there) - 1):
        if there.status[k] is Status.SOLVED:
            assert there[k].is_solved
            np.testing.assert_array_equal(there[k].z, z[k])
    return len(there) - len(there._others)


def check_all() -> None:
    """Compare all libraries on all families."""
    for name, put in libraries().items():
        for n, count in SIZES:
            for family in (definite, awkward):
                data = family(n, count)
                print(
                    f"{name}, {family.__name__}, n = {n}: {compare(put, data)} of {count} on the GPU"
                )
            M, *vectors = definite(n, count)
            print(f"{name}, one M, n = {n}: {compare(put, (M[0], *vectors))} of {count} on the GPU")


def seconds(work: Any) -> float:
    """Return the least time of three calls."""
    times = []
    for _ in range(3):
        began = time.perf_counter()
        work()
        times.append(time.perf_counter() - began)
    return min(times)


ROWS = (8, 65_536), (10, 65_536), (16, 4_096), (16, 65_536), (30, 4_096), (30, 65_536), (64, 4_096)


def row_of_times(put: Any, n: int, count: int) -> str:
    """Return a row of the table: milliseconds for a batch on the CPU and on the GPU, with gradients."""
    M, q, lower, upper = definite(n, count)
    own = [put(one) for one in (M, q, lower, upper)]
    answers = solve_batch(own[0], own[1], lower=own[2], upper=own[3])
    found = derivative(answers)
    on_host(found.vjp(own[1]).q)  # compiles
    times = (
        seconds(lambda: solve_batch(M, q, lower=lower, upper=upper)),
        seconds(lambda: solve_batch(own[0], own[1], lower=own[2], upper=own[3])),
        seconds(lambda: on_host(found.vjp(own[1]).q[:1])),
    )
    share = 1.0 - len(answers._others) / count
    return f"| {n} | {count} | {' | '.join(f'{1e3 * one:.2f}' for one in times)} | {share:.2%} |"


def missing() -> str:
    """Return the reason why no run on a GPU is possible here, or an empty text."""
    try:
        import cupy
        from numba import cuda
    except ImportError as error:
        return f"{error}: pip install 'lcp_plugin[gpu]'"
    if not cuda.is_available():
        return "numba finds no GPU"
    name = cupy.cuda.runtime.getDeviceProperties(0)["name"].decode()
    print(f"{name}, {len(os.sched_getaffinity(0))} processors, CuPy {cupy.__version__}")
    return ""


if __name__ == "__main__":
    if not IS_SIMULATED and (lack := missing()):
        sys.exit(f"no run on a GPU here: {lack}; python .ci/on_a_gpu.py --simulated runs without")
    check_all()
    if not IS_SIMULATED:
        print("| n | problems | CPU, ms | GPU, ms | gradient on the GPU, ms | solved on the GPU |")
        print("|---|---|---|---|---|---|")
        for size in ROWS:
            print(row_of_times(libraries()["cupy"], *size), flush=True)
