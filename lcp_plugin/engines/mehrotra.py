"""Mehrotra's interior point method in numpy and scipy, which replaces external solvers that are not installed."""

from __future__ import annotations

import math
import time
from typing import Any, ClassVar

import numpy as np
import scipy.sparse as sp

from ..core.checks import Vector
from .engine import Engine, EngineAnswer, EngineStatus, ProgramData, SolverLimits
from .polish import shifted_solver

IDLE_STEPS = 20  # without a smaller residual, they end a run


class Mehrotra(Engine):
    """Mehrotra's predictor and corrector, with one factorization of the reduced KKT matrix per step.

    It accepts the options of the solver that it replaces, and uses none of them.

    References
    ----------
    Mehrotra, *On the implementation of a primal–dual interior point method*, SIAM Journal on Optimization 2 (1992),
    doi:10.1137/0802028.
    """

    name: ClassVar[str] = "mehrotra"
    solves: ClassVar[str] = "convex programs, in place of an external solver that is not installed"
    cost: ClassVar[str] = "a factorization per step, 10 to 40 steps"
    reference: ClassVar[str] = "Mehrotra 1992"
    obeys: ClassVar[str] = "max_seconds; verbose prints nothing"

    def answer(self, program: ProgramData, limits: SolverLimits) -> EngineAnswer:
        """Return the point of the least residual."""
        m, p, n = program.h.size, program.b.size, program.c.size
        above, below = np.isfinite(program.upper), np.isfinite(program.lower)
        rows, identity = np.isfinite(program.h), sp.eye_array(n, format="csr")
        C = sp.vstack([sp.csr_array(program.G)[rows], identity[above], -identity[below]], "csr")
        d = np.concatenate([program.h[rows], program.upper[above], -program.lower[below]])
        P, A = program.P, program.A
        if not sp.issparse(P):
            C = C.toarray()
        until = time.perf_counter() + limits.seconds
        x, y, z, steps, residual = _minimize(P, C, A, program.c, d, program.b, until)
        multipliers = np.zeros(m + p)
        multipliers[:m][rows], multipliers[m:] = z[: np.count_nonzero(rows)], y
        is_optimal = residual <= 1e-7  # the polish and the criterion of programs follow
        says = EngineStatus.OPTIMAL if is_optimal else EngineStatus.GAVE_UP
        return EngineAnswer(x, multipliers, steps, says)


def _minimize(
    P: Any, C: Any, A: Any, c: Vector, d: Vector, b: Vector, until: float
) -> tuple[Vector, Vector, Vector, int, float]:
    """Return x, y, z of min ½ xᵀP x + cᵀx, C x + s = d, A x = b, s ≥ 0, the steps, and the relative residual."""
    k, has_curvature = max(d.size, 1), bool(P.nnz if sp.issparse(P) else P.any())
    x, y = _solve_reduced(P, C, A, np.ones(d.size), C.T @ d - c, b)[0]
    gap = d - C @ x
    shift = max(float(np.max(-gap, initial=0.0)), float(np.max(gap, initial=0.0)) * 1e-3, 1.0)
    s, z = np.maximum(gap, shift), np.full(d.size, shift)
    sizes = [1.0 + float(np.abs(one).max(initial=0.0)) for one in (c, d, b)]
    best, idle, kept, count = math.inf, 0, (x, y, z), 0
    while count < 100 and idle <= IDLE_STEPS and time.perf_counter() <= until:
        dual, primal, equal = P @ x + c + C.T @ z + A.T @ y, C @ x + s - d, A @ x - b
        mu = float(s @ z) / k
        parts = zip((dual, primal, equal), sizes, strict=True)
        norms = [float(np.abs(residual).max(initial=0.0)) / size for residual, size in parts]
        error = max(mu * k / (1.0 + abs(float(c @ x))), *norms)
        if not math.isfinite(error):
            break
        idle = 0 if error < 0.9 * best else idle + 1
        if error < best:
            best, kept = error, (x, y, z)
        if best <= 1e-15:
            break
        count += 1
        ds, dz, target, solver = np.zeros(d.size), np.zeros(d.size), 0.0, None
        for _ in range(2):  # Mehrotra's predictor, then the corrector, towards s z = target
            to_target = target - ds * dz
            pushed = (to_target + z * primal) / s - z
            rights = -dual - C.T @ pushed, -equal
            (dx, dy), solver = _solve_reduced(P, C, A, z / s, *rights, solver)
            ds = -primal - C @ dx
            dz = (to_target - z * ds) / s - z
            # Of the step to the boundary
            steps = [min(1.0, 0.995 * _largest_step(*one)) for one in ((s, ds), (z, dz))]
            ahead = float((s + steps[0] * ds) @ (z + steps[1] * dz)) / k
            target = min(ahead / mu, 1.0) ** 3 * mu if mu > 0.0 else 0.0
        first, second = [min(steps)] * 2 if has_curvature else steps
        x, s, y, z = x + first * dx, s + first * ds, y + second * dy, z + second * dz
    return *kept, count, best


def _largest_step(v: Vector, dv: Vector) -> float:
    """Return the largest step for which v + step dv ≥ 0."""
    falls = dv < 0.0
    return float(np.min(-v[falls] / dv[falls], initial=math.inf))


def _solve_reduced(
    P: Any, C: Any, A: Any, weights: Vector, first: Vector, second: Vector, solver: Any = None
) -> tuple[tuple[Vector, Vector], Any]:
    """Return the solution of [P + Cᵀ W C, Aᵀ; A, 0], refined, and the solver of its shifted factorization."""
    # Relative to the row's largest entry; with it, the factorization exists
    solver = solver or shifted_solver(P + (C.T * weights) @ C, A, 2.0**-46)
    x, y = np.zeros(first.size), np.zeros(second.size)
    for _ in range(4):
        of_x = first - P @ x - C.T @ (weights * (C @ x)) - A.T @ y
        right = np.append(of_x, second - A @ x)
        change = solver(right) if solver else np.full(right.size, np.nan)
        x, y = x + change[: x.size], y + change[x.size :]
    return (x, y), solver
