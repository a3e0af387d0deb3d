"""Clarabel: an interior point method over cones."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
import scipy.sparse as sp

from .engine import Engine, EngineAnswer, EngineStatus, ProgramData, SolverLimits

SAYS = {
    "Solved": EngineStatus.OPTIMAL,
    "AlmostSolved": EngineStatus.OPTIMAL,
    "PrimalInfeasible": EngineStatus.INFEASIBLE,
    "AlmostPrimalInfeasible": EngineStatus.INFEASIBLE,
    "DualInfeasible": EngineStatus.UNBOUNDED,
    "AlmostDualInfeasible": EngineStatus.UNBOUNDED,
    "MaxIterations": EngineStatus.STOPPED,
    "MaxTime": EngineStatus.STOPPED,
}


class Clarabel(Engine):
    """Clarabel: an interior point method on the homogeneous embedding of a program over cones.

    References
    ----------
    Goulart, Chen, *Clarabel: an interior-point solver for conic programs with quadratic objectives*, 2024,
    arXiv:2405.12762.
    """

    name: ClassVar[str] = "clarabel"
    solves: ClassVar[str] = "convex programs"
    cost: ClassVar[str] = "a factor of the KKT matrix a step, 10 to 50 steps"
    reference: ClassVar[str] = "Goulart, Chen 2024"
    obeys: ClassVar[str] = "max_seconds; verbose prints its own log; Ctrl-C waits for its end"
    defaults: ClassVar = {"tol_gap_abs": 1e-9, "tol_gap_rel": 1e-9, "tol_feas": 1e-9}

    def answer(self, program: ProgramData, limits: SolverLimits) -> EngineAnswer:
        """Return Clarabel's point: equalities in the zero cone, rows and finite bounds in the nonnegative cone."""
        import clarabel

        settings = clarabel.DefaultSettings()
        for name, value in {
            **self.settings,
            "verbose": limits.is_verbose,
            "time_limit": limits.seconds,
        }.items():
            setattr(settings, name, value)
        m, p, n = program.h.size, program.b.size, program.c.size
        below, above = (
            np.flatnonzero(np.isfinite(program.lower)),
            np.flatnonzero(np.isfinite(program.upper)),
        )
        rows, identity = np.flatnonzero(np.isfinite(program.h)), sp.eye_array(n, format="csr")
        parts = [program.A, sp.csr_array(program.G)[rows], -identity[below], identity[above]]
        right = np.concatenate(
            [program.b, program.h[rows], -program.lower[below], program.upper[above]]
        )
        kinds = [(clarabel.ZeroConeT, p), (clarabel.NonnegativeConeT, right.size - p)]
        found = clarabel.DefaultSolver(
            sp.csc_matrix(sp.triu(sp.csr_array(program.P))),
            program.c,
            sp.csc_matrix(sp.vstack([*map(sp.csr_array, parts)])),
            right,
            [cone(size) for cone, size in kinds if size],
            settings,
        ).solve()
        y, z = np.zeros(m + p), np.array(found.z)
        y[rows], y[m:] = z[p : p + rows.size], z[:p]
        says = SAYS.get(str(found.status), EngineStatus.GAVE_UP)
        return EngineAnswer(np.array(found.x), y, int(found.iterations), says)
