"""HiGHS: the simplex and the interior point method for linear programs that scipy brings."""

from __future__ import annotations

import warnings
from typing import ClassVar

import numpy as np

from .engine import Engine, EngineAnswer, EngineStatus, ProgramData, SolverLimits

SAYS = {
    0: EngineStatus.OPTIMAL,
    1: EngineStatus.STOPPED,
    2: EngineStatus.INFEASIBLE,
    3: EngineStatus.UNBOUNDED,
}


class HiGHS(Engine):
    """HiGHS: dual simplex for linear programs, as `scipy.optimize.linprog` brings it.

    References
    ----------
    Huangfu, Hall, *Parallelizing the dual revised simplex method*, Mathematical Programming Computation 10 (2018),
    doi:10.1007/s12532-017-0130-5.
    """

    name: ClassVar[str] = "highs"
    solves: ClassVar[str] = "linear programs"
    cost: ClassVar[str] = "a sparse factor now and then, two triangular solves a step"
    reference: ClassVar[str] = "Huangfu, Hall 2018"
    obeys: ClassVar[str] = "max_seconds; verbose prints its own log; Ctrl-C waits for its end"
    steps: ClassVar[str] = "maxiter"
    ends_on_active_set: ClassVar[bool] = True
    is_for_linear_alone: ClassVar[bool] = True
    defaults: ClassVar = {"primal_feasibility_tolerance": 1e-9, "dual_feasibility_tolerance": 1e-9}

    def answer(self, program: ProgramData, limits: SolverLimits) -> EngineAnswer:
        """Return the vertex that HiGHS ends at."""
        from scipy.optimize import OptimizeWarning, linprog

        wishes = {**self.settings, "disp": limits.is_verbose}
        if np.isfinite(limits.seconds):
            wishes["time_limit"] = limits.seconds
        rows = np.isfinite(program.h)
        with warnings.catch_warnings():
            warnings.simplefilter("error", OptimizeWarning)  # of an unknown option
            found = linprog(
                program.c,
                program.G[rows] if rows.any() else None,
                program.h[rows] if rows.any() else None,
                program.A if program.b.size else None,
                program.b if program.b.size else None,
                np.column_stack([program.lower, program.upper]),
                method="highs",
                options=wishes,
            )
        y = np.zeros(program.h.size + program.b.size)
        says = SAYS.get(found.status, EngineStatus.GAVE_UP)
        if found.x is None:
            return EngineAnswer(np.zeros(program.c.size), y, int(found.nit), says)
        y[: rows.size][rows], y[rows.size :] = -found.ineqlin.marginals, -found.eqlin.marginals
        return EngineAnswer(found.x, y, int(found.nit), says)
