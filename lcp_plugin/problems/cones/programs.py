"""Convex programs over cones, in the form of Clarabel."""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse as sp

from ...core.checks import FloatVector
from ...core.deadline import seconds_left
from ...core.errors import UnsuitableProblem
from .data import Blocks


class ConvexProgram:
    """Convex programs of one problem over cones, in the form of Clarabel."""

    def __init__(self, problem: Blocks) -> None:
        try:
            import clarabel
        except ImportError as error:  # pragma: no cover - cvxpy installs it
            raise UnsuitableProblem(
                "fixed_point needs Clarabel; install it with: pip install clarabel"
            ) from error
        self.problem, self.clarabel = problem, clarabel
        M = sp.csc_array(problem.rows.csr)
        self.symmetric = sp.csc_array(0.5 * (M + M.T))
        self.rest = sp.csr_array(M - self.symmetric)
        rows, limits, cones = conic_rows(problem, clarabel)
        self.rows, self.limits, self.cones = sp.csc_array(rows), limits, cones
        self.upper_half = sp.csc_array(sp.triu(self.symmetric))

    @property
    def is_final(self) -> bool:
        """True if no data of the program depend on z, so that another program would be the same."""
        return not (self.problem.has_friction or self.rest.count_nonzero())

    def minimize(self, z: FloatVector) -> FloatVector | None:
        """Return the minimiser with terms that depend on z fixed; None if not found."""
        problem = self.problem
        q = problem.q + self.rest @ z
        if problem.has_friction:
            w = problem.slack(z)
            w[problem.starts[:-1]] = 0.0
            q[problem.starts[:-1]] += problem.slope * np.sqrt(
                np.add.reduceat(w * w, problem.starts[:-1])
            )
        found = self.solve(self.upper_half, q, self.rows, self.limits, self.cones)
        z = np.asarray(found.x)
        return problem.project(z) if z.size == problem.n and np.isfinite(z).all() else None

    def solve(self, P: Any, c: FloatVector, A: Any, b: FloatVector, cones: list[Any]) -> Any:
        """Return Clarabel's solution of min ½ zᵀP z + cᵀz over b − A z ∈ cones."""
        settings = self.clarabel.DefaultSettings()
        settings.verbose, settings.time_limit = False, seconds_left()
        settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = 1e-12
        return self.clarabel.DefaultSolver(
            sp.csc_matrix(P), c, sp.csc_matrix(A), b, cones, settings
        ).solve()


def conic_rows(problem: Blocks, clarabel: Any) -> tuple[Any, FloatVector, list[Any]]:
    """Return A, b and cones such that z ∈ K is equivalent to b − A z ∈ cones."""
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
