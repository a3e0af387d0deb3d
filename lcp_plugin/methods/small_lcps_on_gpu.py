"""The kernels of :mod:`~lcp_plugin.core.kernels.small_lcps` on a GPU: their Python text, one thread per problem.

Each thread calls them for a batch of one problem. The arrays have the problems as fastest axis in memory, shapes
(B or 1, n, n) and (B, n), and scratch has it last: T of shape (n + 9, n + 1, B) and numbers of shape (2, 2n + 1, B), so
that neighboring threads read neighboring numbers.
"""

from __future__ import annotations

import math
from importlib import import_module
from typing import Any

from ..core.kernels import small_lcps
from ..judges import lcp

cuda: Any = import_module("numba.cuda")
_of_device = cuda.jit(device=True)
follow_paths = _of_device(small_lcps.follow_paths.py_func)
solve_active_sets = _of_device(small_lcps.solve_active_sets.py_func)
bound_residuals = _of_device(lcp.bound_residuals.py_func)


@cuda.jit
def solve_each(  # type: ignore[no-untyped-def]
    M, q, lower, upper, start, tilts, tolerance, T, numbers, sides, z, residual
):
    """Write the end of the path of each problem, and the bound of its relative residual, ∞ if in doubt."""
    k = cuda.grid(1)
    if k < q.shape[0]:
        m, e, table, whole = k % M.shape[0], k + 1, T[:, :, k], numbers[:, :, k]
        A, b, low, high = M[m : m + 1], q[k:e], lower[k:e], upper[k:e]
        follow_paths(A, b, low, high, tilts, -1, table, whole, sides[k:e])
        solve_active_sets(A, b, low, high, sides[k:e], table, whole[0], z[k:e])
        residual[k] = math.inf
        if not math.isnan(z[k, 0]):
            first = start[k:e]
            bound_residuals(A, b, low, high, first, tolerance, table, z[k:e], residual[k:e])


@cuda.jit
def solve_free_rows(M, q, zeros, sides, T, numbers, x):  # type: ignore[no-untyped-def]
    """Write x, 0 on all rows that are not free, with M x + q = 0 on the free rows; NaN if the system is singular."""
    k = cuda.grid(1)
    if k < q.shape[0]:
        m, e, zero = k % M.shape[0], k + 1, zeros[k : k + 1]
        table, whole = T[:, :, k], numbers[0, :, k]
        solve_active_sets(M[m : m + 1], q[k:e], zero, zero, sides[k:e], table, whole, x[k:e])
