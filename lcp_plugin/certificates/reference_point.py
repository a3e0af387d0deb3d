"""A point so near the solution that its own bound is small: then |z − z*| ≤ |z − ẑ| + bound(ẑ) is sharp.

A bound by ⟨M⟩⁻¹|r| forgets all signs, and where ρ(D⁻¹|B|) is near 1 it exceeds |M⁻¹r| a thousand times. One step of
the active-set method keeps them: ẑ = z + δ with δ to the bound on the rows that seem active, and M_FF δ_F = −(w +
M δ)_F on the rest. Nothing has to be known about ẑ; a poor solve or a wrong guess only makes the bound larger. ẑ is
kept as a sum of two doubles, so that it can be nearer to z* than any double is.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp

from ..checks import BoolVector, FloatVector
from ..exact.upward import sum_above
from ..matrix import analyze
from ..matrix.comparison import LinearSystem, shared_comparison
from ..matrix.factors import factor_fits, solver_of
from ..problem.lcp import LCP
from .row_inequality import RowInequality, distance_above

DENSE_UP_TO = 400
SPARSE_FACTOR_UP_TO = 50_000
KRYLOV_STEPS = 60  # where there is no hierarchy
ITERATIVE_TOLERANCE = 1e-3  # with 1e-2 a sharp bound stays 3 to 12 % looser, and is no cheaper by more than 8 %

Solver = Callable[[FloatVector], FloatVector]


class NearPoint(NamedTuple):
    """A point ẑ = high + low near the solution, and a bound y of its own error; each of shape (n,)."""

    high: FloatVector
    low: FloatVector
    y: FloatVector

    def bound(self, z: FloatVector) -> FloatVector:
        """Return |z − ẑ| + y ≥ |z − z*|; ∞ where z is not finite."""
        with np.errstate(all="ignore"):
            bound = sum_above(distance_above(self.high, self.low, z), self.y)
        return np.where(np.isnan(bound), np.inf, bound)


class ActiveSetSteps:
    """Steps of the active-set method on one problem; a factorisation serves as long as the free set stays."""

    def __init__(self, problem: LCP, scale: FloatVector) -> None:
        self.problem = problem
        self.scale = scale
        self._free: BoolVector | None = None
        self._solver: Solver | None = None

    def next_point(self, at: RowInequality) -> RowInequality | None:
        """Return the inequality at the next point, or None where the step is not finite."""
        problem = self.problem
        w = 0.5 * (at.slack - at.negative_slack)
        target = at.high - self.scale * w
        on_lower = target <= problem.lower
        on_upper = (target >= problem.upper) & ~on_lower
        free = ~(on_lower | on_upper)
        bound = np.where(on_lower, problem.lower, problem.upper)
        delta = np.where(free, 0.0, (bound - at.high) - at.low)
        if free.any():
            rhs = -(w + problem.csr @ delta)[free]
            delta[free] = self._solve(free, rhs)
        if not np.isfinite(delta).all():
            return None
        high = at.high + delta
        part = high - at.high
        low = (at.high - (high - part)) + (delta - part) + at.low
        return RowInequality.at(problem, np.where(free, high, bound), np.where(free, low, 0.0))

    def _solve(self, free: BoolVector, rhs: FloatVector) -> FloatVector:
        if self._solver is None or self._free is None or not np.array_equal(free, self._free):
            self._free, self._solver = free, _solver(self.problem, free)
        return self._solver(rhs)


def _solver(problem: LCP, free: BoolVector) -> Solver:
    rows = np.flatnonzero(free)
    M = problem.M if rows.size <= SPARSE_FACTOR_UP_TO else problem.csr
    block = M if rows.size == problem.n else M[rows][:, rows]
    if rows.size <= SPARSE_FACTOR_UP_TO and (not sp.issparse(block) or factor_fits(block)):
        return solver_of(block, dense_up_to=DENSE_UP_TO) or (lambda rhs: np.full(rhs.shape, np.nan))
    return _multigrid_solver(problem, block) if analyze(problem).is_z_matrix else _krylov_solver(block)


def _multigrid_solver(problem: LCP, block: Any) -> Solver:
    """Return the solver of a large system with a Z-matrix; its hierarchy serves for several right-hand sides."""
    system = LinearSystem(block, shared_comparison(problem.matrix).is_symmetric)

    def solve(rhs: FloatVector) -> FloatVector:
        solution = system.iterated(rhs, ITERATIVE_TOLERANCE)
        return np.full(rhs.shape, np.nan) if solution is None else solution

    return solve


def _krylov_solver(block: Any) -> Solver:
    from scipy.sparse.linalg import bicgstab

    inverse = sp.diags_array(1.0 / block.diagonal())

    def solve(rhs: FloatVector) -> FloatVector:
        # What it has reached after these steps is as good as any other guess: the bound judges it.
        solution: FloatVector = bicgstab(block, rhs, rtol=ITERATIVE_TOLERANCE, maxiter=KRYLOV_STEPS, M=inverse)[0]
        return solution

    return solve
