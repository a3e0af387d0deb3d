"""Convex programs over cones, in the form of Clarabel."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import scipy.sparse as sp

from ...core.checks import FloatVector
from ...core.deadline import seconds_left
from .data import Blocks


def minimizers(problem: Blocks, z: FloatVector) -> Iterator[FloatVector]:
    """Yield the minimizers of convex programs, each with the terms that depend on z fixed at the last one."""
    M = sp.csc_array(problem.rows.csr)
    symmetric = sp.csc_array(0.5 * (M + M.T))
    rest, P, first = sp.csr_array(M - symmetric), sp.triu(symmetric), problem.starts[:-1]
    rows, limits, cones = conic_rows(problem)
    is_final = not (problem.has_friction or rest.count_nonzero())
    while True:
        q = problem.q + rest @ z
        if problem.has_friction:
            w = problem.slack(z)
            w[first] = 0.0
            q[first] += problem.slope * np.sqrt(np.add.reduceat(w * w, first))
        z = np.asarray(solve_conic(P, q, rows, limits, cones).x)
        if z.size != problem.n or not np.isfinite(z).all():
            return
        z = problem.project(z)
        yield z
        if is_final:  # another program would be the same
            return


def solve_conic(P: Any, c: FloatVector, A: Any, b: FloatVector, cones: list[Any]) -> Any:
    """Return Clarabel's solution of min ½ zᵀP z + cᵀz over b − A z ∈ cones."""
    import clarabel  # not for problems that other methods solve

    settings = clarabel.DefaultSettings()
    settings.verbose, settings.time_limit = False, seconds_left()
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = 1e-12
    P, A = sp.csc_matrix(P), sp.csc_matrix(A)
    return clarabel.DefaultSolver(P, c, A, b, cones, settings).solve()


def conic_rows(problem: Blocks) -> tuple[Any, FloatVector, list[Any]]:
    """Return A, b and cones such that z ∈ K is equivalent to b − A z ∈ cones."""
    import clarabel  # not for problems that other methods solve

    rows: list[Any] = []
    limits: list[FloatVector] = []
    cones: list[Any] = []
    identity, is_cone = sp.eye_array(problem.n, format="csr"), problem.sizes > 1
    first = problem.starts[:-1]
    single, slopes = first[~is_cone], np.ones(problem.n)
    for sign, bound in ((-1.0, problem.lower), (1.0, problem.upper)):
        has = single[np.isfinite(bound[single])]
        if has.size:
            rows.append(sign * identity[has])
            limits.append(sign * bound[has])
            cones.append(clarabel.NonnegativeConeT(has.size))
    slopes[first] = np.where(problem.slope > 0.0, problem.slope, 1.0)
    in_cones = np.flatnonzero(is_cone[problem.block_of_row])
    rows.append(-(sp.csr_array(sp.diags_array(slopes)))[in_cones])
    limits.append(np.zeros(in_cones.size))
    for size, slope in zip(problem.sizes[is_cone].tolist(), problem.slope[is_cone], strict=True):
        ray = [clarabel.NonnegativeConeT(1), clarabel.ZeroConeT(size - 1)]
        cones += [clarabel.SecondOrderConeT(size)] if slope > 0.0 else ray
    return sp.vstack(rows), np.concatenate(limits), cones
