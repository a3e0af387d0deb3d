"""One run of projected full multigrid: its grids' problems, its truncation, its safeguards."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np

from .. import kernels
from ..hierarchy import sweeps
from ..hierarchy.levels import Grid, Hierarchy, Truncation, build_hierarchy
from ..problem import LCP, FloatVector
from .base import Step

if TYPE_CHECKING:
    from .multigrid import Multigrid

COARSE_CYCLES = 2
COARSEST_SWEEPS = 50
SLOW = 0.2  # a contraction a cycle from which on Krylov steps pay
SETTLED = 1e-3  # share of the unknowns that may still change sides while they do
SHORT_KRYLOV, LONG_KRYLOV = 2, 8
KRYLOV_GAIN = 1e-2
PATIENCE = 12  # cycles without a new best residual
FALL_BACK_SWEEPS = 20
NOTEWORTHY_CUT = 1e-4  # share of the unknowns cut off at a bound from which on the energy is looked at
HALVINGS = 4


class GridProblem:
    """The complementarity problem of one grid, with its projected sweep."""

    def __init__(
        self, algorithm: Multigrid, grid: Grid, q: FloatVector, lower: FloatVector, upper: FloatVector
    ) -> None:
        self.grid, self.q, self.lower, self.upper = grid, q, lower, upper
        self.indptr, self.indices, self.data = grid.matrix.arrays
        self.rows = kernels.packed(q, lower, upper, grid.inverse)
        self.splits = {False: grid.split, True: grid.split + 1}  # every diagonal entry is stored
        self.residual = np.empty(q.size)
        self.relaxation = algorithm.relaxation
        self.smoother = algorithm.smoother
        self.snaps = self.smoother.startswith("np")
        if self.snaps:
            alpha = algorithm.relaxation if self.smoother == "npsor" else 1.0
            pivots = np.full(q.size, 1.0 / (1.0 / alpha + 1.0 + 2.0))
            self.np_rows = kernels.packed(q, lower, upper, grid.inverse, grid.inverse, pivots)
            self.new = np.empty(q.size)

    def sweep(self, z: FloatVector, backward: bool) -> None:
        """z ← one projected sweep."""
        arrays = self.indptr, self.splits[backward], self.indices, self.data
        if self.snaps:
            kernels.splitting_sweep(*arrays, self.np_rows, 1.0, True, backward, z, self.new)
            np.copyto(z, self.new)
        else:
            omega = self.relaxation if self.smoother == "psor" else 1.0
            kernels.relaxation_sweep(*arrays, self.rows, omega, backward, z)

    def gauss_seidel(self, z: FloatVector) -> None:
        """z ← one forward projected Gauss–Seidel sweep."""
        kernels.relaxation_sweep(
            self.indptr, self.splits[False], self.indices, self.data, self.rows, 1.0, False, z
        )


class MultigridRun:
    """The state of one run on one problem."""

    def __init__(self, algorithm: Multigrid, problem: LCP) -> None:
        self.algorithm, self.problem = algorithm, problem
        self.hierarchy, self.work = _hierarchy(problem)
        self.truncation = Truncation(self.hierarchy)
        self.entries = float(max(problem.csr.nnz, 1))
        finest = self.hierarchy.grids[0]
        self.problems = [GridProblem(algorithm, finest, problem.q, problem.lower, problem.upper)]
        self.is_symmetric = _seems_symmetric(problem)

    def iterates(self, z0: FloatVector) -> Iterator[Step]:
        """Yield the start, then the finest grid's iterates."""
        yield Step(z0, work=self._spent())
        z = z0
        if self.algorithm.is_nested(self.problem, z0) and len(self.hierarchy.grids) > 1:
            self._coarse_problems()
            z = self._nested_start()
        if len(self.hierarchy.grids) == 1:
            yield from self._sweeps_alone(z)
        else:
            yield from self._cycles(z)

    # --- nested iteration -------------------------------------------------------------------------------

    def _coarse_problems(self) -> None:
        for grid, coarser in zip(self.hierarchy.grids, self.hierarchy.grids[1:], strict=False):
            fine = self.problems[-1]
            assert grid.restriction is not None and grid.is_coarse is not None
            q = np.empty(coarser.n)
            sweeps.restrict(*grid.restriction.arrays, fine.q, q)
            self.work += grid.restriction.data.size
            lower, upper = fine.lower[grid.is_coarse], fine.upper[grid.is_coarse]
            self.problems.append(GridProblem(self.algorithm, coarser, q, lower, upper))

    def _nested_start(self) -> FloatVector:
        """Return the start on the finest grid that the coarser grids' answers give."""
        coarsest = self.problems[-1]
        z = np.clip(0.0, coarsest.lower, coarsest.upper)
        for k in range(COARSEST_SWEEPS):
            coarsest.sweep(z, backward=k % 2 == 1)
        self.work += COARSEST_SWEEPS * coarsest.data.size
        for k in range(len(self.problems) - 2, -1, -1):
            if k + 1 < len(self.problems) - 1:
                self.truncation.start_at(k + 1)
                for _ in range(COARSE_CYCLES):
                    self.problems[k + 1].sweep(z, backward=False)
                    self._look(k + 1, z)
                    self._correct(k + 1, z)
                    self.problems[k + 1].sweep(z, backward=True)
            z = self._interpolated(k, z)
        return z

    def _interpolated(self, k: int, coarse: FloatVector) -> FloatVector:
        fine, grid = self.problems[k], self.hierarchy.grids[k]
        assert grid.prolongation is not None
        z = np.zeros(grid.n)
        everywhere = np.ones(grid.n, np.bool_)
        sweeps.prolong(*grid.prolongation.arrays, coarse, everywhere, fine.lower, fine.upper, z)
        self.work += grid.prolongation.data.size
        return z

    # --- the finest grid --------------------------------------------------------------------------------

    def _sweeps_alone(self, z: FloatVector) -> Iterator[Step]:
        fine = self.problems[0]
        while True:
            fine.sweep(z, backward=False)
            fine.sweep(z, backward=True)
            self.work += 2.0 * self.entries
            yield Step(z, work=self._spent())

    def _cycles(self, z: FloatVector) -> Iterator[Step]:
        self.truncation.start_at(0)
        fine = self.problems[0]
        best, best_z, since, previous = np.inf, z.copy(), 0, np.inf
        cycles = 0
        while True:
            fine.sweep(z, backward=False)
            largest, changed = self._look(0, z)
            self.work += self.entries
            # What snaps to a bound is measured before it does.
            yield Step(z, residual=None if fine.snaps else largest, work=self._spent())
            since += 1
            if largest < best:
                best, since = largest, 0
                np.copyto(best_z, z)
            elif since >= PATIENCE:
                np.copyto(z, best_z)
                yield from self._fall_back(z)
                since, previous = 0, np.inf
                best = np.inf
                continue
            is_slow = cycles >= 2 and largest > SLOW * previous and changed <= max(SETTLED * z.size, 1)
            previous = largest
            cycles += 1
            if is_slow:
                yield from self._krylov(z, SHORT_KRYLOV if changed else LONG_KRYLOV)
            else:
                self._correct(0, z)
            fine.sweep(z, backward=True)
            self.work += self.entries

    def _look(self, k: int, z: FloatVector) -> tuple[float, int]:
        """Find the free rows of z and truncate to them; return the largest scaled residual and the rows changed."""
        top, own = self.truncation.grids[k], self.problems[k]
        largest, changed = sweeps.free_rows(
            own.indptr, own.indices, own.data, own.rows, z, own.snaps, top.is_free, top.free_changed, own.residual
        )
        self.work += own.data.size
        if changed:
            self.truncation.update()
        return largest, changed

    def _correct(self, k: int, z: FloatVector) -> None:
        """z ← z + P c, c one V-cycle's answer to the residual on the coarser grid, cut off at the bounds."""
        own, grid, below = self.problems[k], self.hierarchy.grids[k], self.truncation.grids[k + 1]
        assert grid.prolongation is not None and grid.restriction is not None
        sweeps.restrict(*grid.restriction.arrays, own.residual, below.b)
        self.truncation.correct(k + 1)
        before = z.copy() if k == 0 and self.is_symmetric else None
        cut = sweeps.prolong(
            *grid.prolongation.arrays, below.x, self.truncation.grids[k].is_free, own.lower, own.upper, z
        )
        self.work += 2.0 * grid.prolongation.data.size
        if before is not None and cut > NOTEWORTHY_CUT * z.size:
            self._shorten(own, before, z)

    def _shorten(self, own: GridProblem, before: FloatVector, z: FloatVector) -> None:
        """Halve the step from `before` to z until the energy does not rise; take it back where that does not help."""
        step = z - before
        slope = -float(step @ own.residual)  # w = −residual on the free rows; the others did not move
        curvature = float(step @ (self.problem.csr @ step))
        self.work += self.entries
        size = 1.0
        for _ in range(HALVINGS):
            if size * slope + 0.5 * size * size * curvature <= 0.0:
                break
            size *= 0.5
        else:
            size = 0.0
        if size < 1.0:
            np.copyto(z, before + size * step)

    def _krylov(self, z: FloatVector, most: int) -> Iterator[Step]:
        """z ← z + the correction on the free rows by a few preconditioned Krylov steps, one V-cycle each."""
        fine, top = self.problems[0], self.truncation.grids[0]
        residual = fine.residual
        begin = float(np.max(np.abs(residual * top.inverse), initial=0.0))
        origin = z.copy()
        total = np.zeros_like(z)
        directions: list[tuple[FloatVector, FloatVector, float]] = []
        for k in range(most):
            np.copyto(top.b, residual)
            self.truncation.correct(0)
            p = top.x.copy()
            product = np.empty_like(p)
            energy = sweeps.free_product(fine.indptr, fine.indices, fine.data, top.is_free, p, product)
            self.work += self.entries
            scale = energy if self.is_symmetric else float(product @ product)
            for old_p, old_product, old_scale in directions:
                share = float((old_p if self.is_symmetric else old_product) @ product) / old_scale
                p -= share * old_p
                product -= share * old_product
            scale = float((p if self.is_symmetric else product) @ product)
            if not scale > 0.0:
                break
            length = float((p if self.is_symmetric else product) @ residual) / scale
            total += length * p
            residual -= length * product
            directions.append((p, product, scale))
            if self.is_symmetric:
                del directions[:-1]
            np.clip(origin + total, fine.lower, fine.upper, out=z)
            left = float(np.max(np.abs(residual * top.inverse), initial=0.0))
            if left <= KRYLOV_GAIN * begin or k == most - 1:
                break
            yield Step(z, increment=left, work=self._spent())

    def _fall_back(self, z: FloatVector) -> Iterator[Step]:
        for _ in range(FALL_BACK_SWEEPS):
            self.problems[0].gauss_seidel(z)
            self.work += self.entries
            yield Step(z, work=self._spent())

    def _spent(self) -> float:
        """Return the passes over M since the last step."""
        work = self.work + self.truncation.take()
        self.work = 0.0
        return work / self.entries


def _hierarchy(problem: LCP) -> tuple[Hierarchy, float]:
    """Return the hierarchy of M, and the matrix entries touched to build it now (0 where it was there)."""
    built: list[float] = []

    def build() -> Hierarchy:
        hierarchy = build_hierarchy(problem.csr)
        built.append(hierarchy.work)
        return hierarchy

    hierarchy = problem.shared("hierarchy", build)
    return hierarchy, sum(built)


def _seems_symmetric(problem: LCP) -> bool:
    """Return whether xᵀ(M y) = yᵀ(M x) for one pair of vectors; it decides on the Krylov method only."""

    def compute() -> bool:
        n = problem.n
        x, y = np.cos(np.arange(n) * 1.7), np.sin(np.arange(n) * 0.9 + 0.3)
        M: Any = problem.csr
        one, other = float(x @ (M @ y)), float(y @ (M @ x))
        return bool(abs(one - other) <= 1e-10 * float(np.abs(M @ y) @ np.abs(x)))

    return problem.shared("seems_symmetric", compute)
