"""PIQP: a proximal interior point method, dense or sparse."""

from __future__ import annotations

import math
import time
from typing import Any, ClassVar

import numpy as np
import scipy.sparse as sp

from .engine import Engine, EngineAnswer, EngineStatus, ProgramData, SolverLimits

INFINITE = 1e30  # limits of rows that PIQP leaves out, and prints that it does
INVALID_SETTINGS = -10  # status of PIQP
SAYS = {
    1: EngineStatus.OPTIMAL,
    -1: EngineStatus.STOPPED,
    -2: EngineStatus.INFEASIBLE,
    -3: EngineStatus.UNBOUNDED,
}


class PIQP(Engine):
    """PIQP: a proximal interior point method for convex quadratic programs.

    References
    ----------
    Schwan, Jiang, Kuhn, Jones, *PIQP: a proximal interior-point quadratic programming solver*, IEEE Conference on
    Decision and Control 2023, doi:10.1109/CDC49753.2023.10383915.
    """

    name: ClassVar[str] = "piqp"
    solves: ClassVar[str] = "convex programs, dense and sparse"
    cost: ClassVar[str] = "a factor of the KKT matrix a step, 10 to 30 steps"
    reference: ClassVar[str] = "Schwan, Jiang, Kuhn, Jones 2023"
    obeys: ClassVar[str] = (
        "max_seconds, by the time of its first step; verbose prints its own log; Ctrl-C waits for its end"
    )
    defaults: ClassVar = {"eps_abs": 1e-9, "eps_rel": 1e-10, "max_iter": 250}

    def answer(self, program: ProgramData, limits: SolverLimits) -> EngineAnswer:
        """Return PIQP's point."""
        import piqp

        P, G, A, m, p = program.P, program.G, program.A, program.h.size, program.b.size
        solver = piqp.SparseSolver() if sp.issparse(P) else piqp.DenseSolver()
        for name, value in self.settings.items():
            setattr(solver.settings, name, value)
        solver.settings.verbose = limits.is_verbose
        # Rows of a symmetric P are its columns; PIQP takes no arrays that are read-only.
        columns = (
            sp.csc_matrix((P.data, P.indices, P.indptr), P.shape, copy=True)
            if sp.issparse(P)
            else _to_csc(P)
        )
        equations = (_to_csc(A), program.b) if p else (None, None)
        is_limit = program.h < INFINITE
        G, h = (G, program.h) if is_limit.all() else (G[is_limit], program.h[is_limit])
        rows = (_to_csc(G), None, h) if h.size else (None, None, None)
        solver.setup(columns, program.c, *equations, *rows, program.lower, program.upper)
        if limits.seconds < math.inf:  # PIQP has no time limit: one step is timed
            steps, begun = solver.settings.max_iter, time.perf_counter()
            solver.settings.max_iter = 1
            solver.solve()
            fit = limits.seconds / (time.perf_counter() - begun) - 1.0
            solver.settings.max_iter = int(min(max(fit, 1.0), steps))
        code, found = int(solver.solve()), solver.result
        if (
            code == INVALID_SETTINGS
        ):  # of no step, for instance: the vectors of the result are uninitialized
            x = np.clip(0.0, program.lower, program.upper)
            return EngineAnswer(x, np.zeros(m + p), 0, EngineStatus.GAVE_UP)
        says = SAYS.get(code, EngineStatus.GAVE_UP)
        y = np.zeros(m + p)
        y[:m][is_limit], y[m:] = found.z_u, found.y
        steps = 0 if says is EngineStatus.GAVE_UP else int(found.info.iter)
        return EngineAnswer(np.array(found.x), y, steps, says)


def _to_csc(A: Any) -> Any:
    return sp.csc_matrix(A) if sp.issparse(A) else np.asfortranarray(A)
