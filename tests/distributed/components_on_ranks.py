"""Checks that test_components.py runs under MPI."""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse as sp
from checks import check, run_checks

from lcp_plugin import LCP, Certificate, Status, solve
from lcp_plugin.core.matrix.structure import connected_components

UNITS = (-12, 13)  # exponents of ten


def mixture(seed: int) -> tuple[LCP, Any, Any]:
    """Up to six uncoupled problems in units of their own, rows interleaved; a solution, and each row's component."""
    rng = np.random.default_rng(seed)
    sizes = rng.integers(1, 9, int(rng.integers(1, 7)))
    component = rng.permutation(np.repeat(np.arange(sizes.size), sizes))
    n = component.size
    entries = rng.integers(-2, 3, (n, n)) * (rng.random((n, n)) < 0.6)
    M = np.where(component[:, None] == component, entries, 0).astype(float)
    np.fill_diagonal(M, 0.0)
    np.fill_diagonal(M, np.abs(M).sum(axis=1) + np.abs(M).sum(axis=0) + 1.0)
    is_active = rng.random(n) < 0.4
    unit = 10.0 ** rng.integers(*UNITS, sizes.size)[component]
    z = np.where(is_active, 0.0, rng.integers(1, 9, n)) * unit
    w = np.where(is_active, rng.integers(0, 5, n), 0) * unit
    return LCP(sp.csr_array(M), w - M @ z), z, component


def joined(problem: LCP, z: Any) -> LCP:
    """The problem where rows of all ranks are coupled: a chain over it, and one row apart."""
    n = problem.n
    M = sp.csr_array(sp.diags_array([np.full(n - 1, -1.0), np.full(n, 3.0)], offsets=[-1, 0]))
    M = sp.csr_array(sp.block_diag([M[: n - 1, : n - 1], sp.csr_array([[2.0]])])) if n > 1 else M
    return LCP(M, np.where(z > 0, -(M @ z), 1.0))


@check(1, 2, 3, 4)
def components_are_those_of_the_whole(comm: Any) -> None:
    """The same rows belong together on any number of ranks, and each component's residual has its own reference."""
    for seed in range(60):
        whole, z, _ = mixture(seed)
        for one in (whole, joined(whole, z)):
            problem = LCP.from_problem(one, comm)
            alone, shared = connected_components(one.matrix), connected_components(problem.matrix)
            assert (alone is None) == (shared is None)
            total = 1 if alone is None else alone.total
            rng = np.random.default_rng([seed, 1])
            near = np.maximum(
                z * (1.0 + 10.0 ** rng.uniform(-12, 0, z.size) * rng.normal(size=z.size)), 0.0
            )
            judged = Certificate.of(problem, near[problem.own_rows])
            truth = Certificate.of(one, near)
            assert judged.components == truth.components == total
            assert np.isclose(
                judged.relative_residual, truth.relative_residual, rtol=1e-6, atol=1e-13
            )
            if alone is None or shared is None:
                continue
            assert shared.total == total
            values = rng.random(one.n)
            largest = shared.largest(values[problem.own_rows])[shared.labels]
            told = np.concatenate(comm.allgather(largest))
            assert np.array_equal(told, alone.largest(values)[alone.labels])


@check(1, 2, 3)
def every_component_is_solved_in_its_own_unit(comm: Any) -> None:
    """From nothing, and from a start right in some components: SOLVED is within tolerance of each reference."""
    for seed in range(20):
        whole, z, component = mixture(seed)
        problem = LCP.from_problem(whole, comm)
        rng = np.random.default_rng([seed, 2])
        is_right = rng.random(component.max() + 1) < 0.5
        starts = (None, np.where(is_right[component], z, 1.5 * z)[problem.own_rows])
        for algorithm in ("auto", "psor", "npsor", "multigrid"):
            for start in starts:
                result = solve(problem, algorithm, z0=start)
                assert result.status in (Status.SOLVED, Status.PRECISION_LIMIT), (
                    seed,
                    algorithm,
                    str(result),
                )
                found = np.concatenate(comm.allgather(np.asarray(result.z)))
                for k in range(component.max() + 1):
                    mine = component == k
                    size = max(np.abs(whole.q[mine]).max(), np.abs(z[mine]).max())
                    assert np.abs(found - z)[mine].max() <= 1e-6 * size, (seed, algorithm, k)


if __name__ == "__main__":
    run_checks()
