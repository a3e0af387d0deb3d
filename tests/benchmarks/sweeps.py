"""One compiled sweep against one scipy product with the same matrix, in turn and single-threaded."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from lcp_plugin.core.checks import FloatVector
from lcp_plugin.core.kernels import splitting_sweeps as kernels
from lcp_plugin.core.lcp import LCP
from lcp_plugin.core.matrix.row_sums import inverse_residual_scale, row_splits
from lcp_plugin.gallery import build
from lcp_plugin.methods.modulus.kernels.modulus_sweep import modulus_sweep

from .timing import medians

TARGETS = {"npgs": 2.2, "pgs": 1.8}


def run(*, quick: bool = False) -> Iterator[str]:
    """Yield the ratios sweep ÷ product on the five-point matrix of the paper's Example 1."""
    scene = build("paper_example_1", n=10_000 if quick else 1_000_000)
    problem, z = scene.problem, np.array(scene.start)
    calls: dict[str, Callable[[], object]] = {
        "product": lambda: problem.csr @ z,
        "npgs": npgs_sweep(problem, z, backward=False),
        "npgs backward": npgs_sweep(problem, z, backward=True),
        "pgs": pgs_sweep(problem, z, backward=False),
        "pgs backward": pgs_sweep(problem, z, backward=True),
        "mgs": mgs_sweep(problem, z),
    }
    seconds = medians(calls, repeats=5 if quick else 25)
    product = seconds.pop("product")
    yield f"n = {problem.n}, nonzeros = {problem.nonzeros}; one scipy CSR product: {1e3 * product:.2f} ms"
    for name, value in seconds.items():
        target = f"   target ≤ {TARGETS[name]}" if name in TARGETS else ""
        with_residual = (
            " with its residual" if "pgs" not in name.split()[0] or name.startswith("n") else ""
        )
        yield f"one {name} sweep{with_residual}: {1e3 * value:.2f} ms = {value / product:.2f} products{target}"


def npgs_sweep(problem: LCP, z: FloatVector, *, backward: bool) -> Callable[[], object]:
    """Return a call that does one NPGS sweep with its residual norm."""
    M, split, new = problem.csr, row_splits(problem.matrix, backward), np.empty(problem.n)
    rows = kernels.pack_vectors(
        problem.q,
        problem.lower,
        problem.upper,
        inverse_residual_scale(problem.matrix),
        np.ones(problem.n),
        1.0 / (2.0 * problem.diagonal + 2.0),
    )
    return lambda: kernels.splitting_sweep(
        M.indptr, split, M.indices, M.data, rows, 1.0, True, backward, z, new
    )


def pgs_sweep(problem: LCP, z: FloatVector, *, backward: bool) -> Callable[[], object]:
    """Return a call that does one projected Gauss–Seidel sweep in place, on a copy of z."""
    M, split, own = problem.csr, row_splits(problem.matrix, backward), z.copy()
    rows = kernels.pack_vectors(problem.q, problem.lower, problem.upper, 1.0 / problem.diagonal)
    return lambda: kernels.relaxation_sweep(
        M.indptr, split, M.indices, M.data, rows, 1.0, backward, own
    )


def mgs_sweep(problem: LCP, z: FloatVector) -> Callable[[], object]:
    """Return a call that does one modulus Gauss–Seidel sweep with its residual norm."""
    M, split = problem.csr, row_splits(problem.matrix, False)
    new, answer = np.empty(problem.n), np.empty(problem.n)
    rows = kernels.pack_vectors(
        problem.q,
        problem.lower,
        inverse_residual_scale(problem.matrix),
        problem.diagonal,
        1.0 / (2.0 * problem.diagonal),
    )
    return lambda: modulus_sweep(
        M.indptr, split, M.indices, M.data, rows, 1.0, 1.0, False, z, new, answer
    )
