"""Adapters of the external solvers: DAQP, PIQP, Clarabel and HiGHS; a solver is imported by its first call."""

from __future__ import annotations

import math
import warnings
from typing import Any, ClassVar

import numpy as np
import scipy.sparse as sp

from ..core.checks import Array, Vector
from ..core.deadline import Clock
from .engine import Engine, EnginePoint, EngineStatus, ProgramData, SolverLimits
from .linear_program import highs

DAQP_STATUS = {
    1: EngineStatus.OPTIMAL,
    2: EngineStatus.OPTIMAL,
    -1: EngineStatus.INFEASIBLE,
    -3: EngineStatus.UNBOUNDED,
    -4: EngineStatus.STOPPED,
}


class DAQP(Engine):
    """DAQP: a dual active set method, which updates its factorization row by row.

    References
    ----------
    Arnström, Bemporad, Axehill, *A dual active-set solver for embedded quadratic programming using recursive LDLᵀ
    updates*, IEEE Transactions on Automatic Control 67 (2022), doi:10.1109/TAC.2022.3176430.
    """

    name: ClassVar[str] = "daqp"
    solves: ClassVar[str] = "dense convex programs of up to some hundred rows"
    cost: ClassVar[str] = "n² a step, n³ to begin with"
    reference: ClassVar[str] = "Arnström, Bemporad, Axehill 2022"
    obeys: ClassVar[str] = (
        "max_seconds; verbose prints nothing; Ctrl-C takes effect only when the solver returns"
    )
    steps: ClassVar[str] = "iter_limit"
    defaults: ClassVar = {"primal_tol": 1e-9, "iter_limit": 1000}

    def solve(self, program: ProgramData, limits: SolverLimits) -> EnginePoint:
        """Return daqp's point."""
        P, G, A = program.P, program.G, program.A
        if not isinstance(P, np.ndarray):
            P, G, A = P.toarray(), G.toarray(), A.toarray()
        m, n, p = program.h.size, program.c.size, program.b.size
        arrays = P.copy() if P.any() else None, np.concatenate((G, A)), kinds_of_rows(n, m, p)
        right = np.append(program.h, program.b)
        ends = ends_of_rows(right, m, program.lower, program.upper)
        limit = {} if limits.seconds == math.inf else {"time_limit": limits.seconds}
        return self.end_of(m, *arrays, program.c.copy(), *ends, self.settings | limit)

    @staticmethod
    def end_of(m: int, *call: Any) -> EnginePoint:
        """Return the end of daqp's run on arrays, as :func:`call_daqp` takes them, with m inequalities."""
        x, signed, flag, steps = call_daqp(*call)
        y = np.maximum(signed[x.size :], 0.0)
        y[m:] = signed[x.size + m :]
        return EnginePoint(x, y, steps, DAQP_STATUS.get(flag, EngineStatus.GAVE_UP))


def kinds_of_rows(n: int, m: int, p: int) -> Any:
    """Return daqp's `sense` of n bounds and m inequalities, 0, and of p equations, 5."""
    kinds = np.zeros(n + m + p, np.intc)
    kinds[n + m :] = 5
    return kinds


def ends_of_rows(d: Array, m: int, lower: Array, upper: Array) -> tuple[Array, Array]:
    """Return upper and lower ends of bounds and of rows, the first m of which are inequalities; or of a stack."""
    n, above = lower.shape[-1], np.concatenate((upper, d), axis=-1)
    below = np.concatenate((lower, d), axis=-1)
    below[..., n : n + m] = -math.inf
    return above, below


def call_daqp(
    P: Any, C: Array, kinds: Any, c: Array, above: Array, below: Array, settings: dict[str, Any]
) -> tuple[Vector, Vector, int, int]:
    """Return x, signed multipliers of bounds and rows, daqp's exit flag and its steps.

    NaN if daqp has no solution, because daqp then returns uninitialized arrays. P, None for zeros, and all other arrays
    are C-contiguous and can be written to, as daqp requires.
    """
    import daqp

    x, _, flag, info = daqp.solve(P, c, C, above, below, kinds, **settings)
    if flag <= 0:
        return np.full(c.size, np.nan), np.full(kinds.size, np.nan), flag, info["iterations"]
    return np.asarray(x), np.asarray(info["lam"]), flag, info["iterations"]


PIQP_STATUS = {
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
        "max_seconds, by the time of its first step; verbose prints its own log; "
        "Ctrl-C takes effect only when the solver returns"
    )
    defaults: ClassVar = {"eps_abs": 1e-9, "eps_rel": 1e-10, "max_iter": 250}

    def solve(self, program: ProgramData, limits: SolverLimits) -> EnginePoint:
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
        is_limit = program.h < 1e30  # limits of rows that PIQP leaves out, and prints that it does
        G, h = (G, program.h) if is_limit.all() else (G[is_limit], program.h[is_limit])
        rows = (_to_csc(G), None, h) if h.size else (None, None, None)
        solver.setup(columns, program.c, *equations, *rows, program.lower, program.upper)
        fit = math.inf
        if limits.seconds < math.inf:  # PIQP has no time limit: one step is timed
            steps, clock = solver.settings.max_iter, Clock()
            solver.settings.max_iter = 1
            solver.solve()
            fit = limits.seconds / clock.read() - 1.0
            solver.settings.max_iter = int(min(fit, steps))
        code = int(solver.solve()) if fit >= 1.0 else -1
        result = solver.result
        if code == -10:  # invalid settings
            # Of no step, for instance: the vectors of the result are uninitialized
            x = np.clip(0.0, program.lower, program.upper)
            return EnginePoint(x, np.zeros(m + p), 0, EngineStatus.GAVE_UP)
        reported = PIQP_STATUS.get(code, EngineStatus.GAVE_UP)
        y = np.zeros(m + p)
        y[:m][is_limit], y[m:] = result.z_u, result.y
        steps = 0 if reported is EngineStatus.GAVE_UP else int(result.info.iter)
        return EnginePoint(np.array(result.x), y, steps, reported)


def _to_csc(A: Array) -> Any:
    return sp.csc_matrix(A) if sp.issparse(A) else np.asfortranarray(A)


CLARABEL_STATUS = {
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
    obeys: ClassVar[str] = (
        "max_seconds; verbose prints its own log; Ctrl-C takes effect only when the solver returns"
    )
    defaults: ClassVar = {"tol_gap_abs": 1e-9, "tol_gap_rel": 1e-9, "tol_feas": 1e-9}

    def solve(self, program: ProgramData, limits: SolverLimits) -> EnginePoint:
        """Return Clarabel's point: equalities in the zero cone, rows and finite bounds in the nonnegative cone."""
        import clarabel

        settings = clarabel.DefaultSettings()
        overrides = {"verbose": limits.is_verbose, "time_limit": limits.seconds}
        for name, value in (self.settings | overrides).items():
            setattr(settings, name, value)
        m, p, n = program.h.size, program.b.size, program.c.size
        ends = program.lower, program.upper, program.h
        below, above, rows = (np.flatnonzero(np.isfinite(end)) for end in ends)
        identity = sp.eye_array(n, format="csr")
        parts = [program.A, sp.csr_array(program.G)[rows], -identity[below], identity[above]]
        right = np.concatenate(
            [program.b, program.h[rows], -program.lower[below], program.upper[above]]
        )
        kinds = [(clarabel.ZeroConeT, p), (clarabel.NonnegativeConeT, right.size - p)]
        solution = clarabel.DefaultSolver(
            sp.csc_matrix(sp.triu(sp.csr_array(program.P))),
            program.c,
            sp.csc_matrix(sp.vstack([*map(sp.csr_array, parts)])),
            right,
            [cone(size) for cone, size in kinds if size],
            settings,
        ).solve()
        y, z = np.zeros(m + p), np.array(solution.z)
        y[rows], y[m:] = z[p : p + rows.size], z[:p]
        reported = CLARABEL_STATUS.get(str(solution.status), EngineStatus.GAVE_UP)
        return EnginePoint(np.array(solution.x), y, int(solution.iterations), reported)


HIGHS_STATUS = {
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
    obeys: ClassVar[str] = (
        "max_seconds; verbose prints its own log; Ctrl-C takes effect only when the solver returns"
    )
    steps: ClassVar[str] = "maxiter"
    is_for_linear_alone: ClassVar[bool] = True
    defaults: ClassVar = {"primal_feasibility_tolerance": 1e-9, "dual_feasibility_tolerance": 1e-9}

    def solve(self, program: ProgramData, limits: SolverLimits) -> EnginePoint:
        """Return the vertex that HiGHS ends at."""
        from scipy.optimize import OptimizeWarning

        options = {**self.settings, "disp": limits.is_verbose}
        if np.isfinite(limits.seconds):
            options["time_limit"] = limits.seconds
        rows = np.isfinite(program.h)
        with warnings.catch_warnings():
            warnings.simplefilter("error", OptimizeWarning)  # of an unknown option
            result = highs(
                program.c,
                program.G[rows],
                program.h[rows],
                program.A,
                program.b,
                (program.lower, program.upper),
                **options,
            )
        y = np.zeros(program.h.size + program.b.size)
        reported = HIGHS_STATUS.get(result.status, EngineStatus.GAVE_UP)
        if result.x is None:
            return EnginePoint(np.zeros(program.c.size), y, int(result.nit), reported)
        y[: rows.size][rows], y[rows.size :] = -result.ineqlin.marginals, -result.eqlin.marginals
        return EnginePoint(result.x, y, int(result.nit), reported)
