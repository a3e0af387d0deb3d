"""Sweeps and multigrid on rows over MPI ranks.

A sweep runs on all ranks at once, with the ghost values from before the sweep: a splitting with fewer entries of
L. NP sweeps converge so on H₊-matrices; projected relaxation does with ω ≤ 1, and on symmetric positive definite
matrices with the pivots of :func:`~lcp_plugin.ranks.hierarchy.pivot_weight`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any

import numpy as np

from ..core.checks import FloatVector
from ..core.errors import InvalidOption, UnknownAlgorithm, UnsuitableMatrix
from ..core.kernels.splitting_sweeps import relaxation_sweep, splitting_sweep
from ..core.matrix import split_rows
from ..core.rounding import read_only_views
from ..systems.hierarchy import kernels
from ..systems.hierarchy.kernels import prolong, restrict
from ..systems.hierarchy.truncation import KrylovCorrection
from .hierarchy import HierarchyOnRanks, TruncationOnRanks, build_hierarchy, pivot_weight

if TYPE_CHECKING:
    from .problem import RowsOnRanks

Iterates = Iterator[tuple[FloatVector, float]]  # z, shape (own,), and passes over M since the last
OUT_OF_HAND = 100.0  # times the least residual
SHRUNK = 0.9  # of the least residual: a cycle that gains less is idle
PATIENCE = 12  # idle cycles
SLOW, SETTLED = (
    0.1,
    1e-3,
)  # contraction of a cycle, and share of changed rows, at which Krylov steps pay
KRYLOV_STEPS, KRYLOV_GAIN = 24, 1e-2
COARSE_CYCLES, MOST_COARSE_CYCLES, COARSE_CHANGES = 2, 10, 5e-4  # of nested iteration
COARSEST_SWEEPS = 50


def sweep(problem: RowsOnRanks, z: FloatVector, relaxation: float = 1.0) -> Iterates:
    """Yield iterates of projected relaxation, z_i ← mid(l_i, u_i, z_i − ω w_i/d_i)."""
    halo, M = problem.halo, problem.rows
    pivots = _positive_diagonal(problem)
    if problem.is_symmetric and not halo.is_empty:
        pivots = pivots + pivot_weight(M, halo, relaxation)
    rows = np.column_stack([problem.q, problem.lower, problem.upper, 1.0 / pivots])
    split, x = split_rows(M), halo.whole(z)
    yield x[: problem.own], 0.0
    while True:
        halo.fetch(x)
        relaxation_sweep(M.indptr, split, M.indices, M.data, rows, relaxation, False, x)
        yield x[: problem.own], 1.0


def projected_type(problem: RowsOnRanks, z: FloatVector, alpha: float, beta: float) -> Iterates:
    """Yield iterates of NPAOR, (D/α + D + 2S⁻¹ − (β/α) L)(z⁺ − z) = −2 S⁻¹ r(z), with S = 1/d."""
    halo, M, d = problem.halo, problem.rows, problem.residual_scale
    step = 1.0 / d
    pivot = step * problem.diagonal * (1.0 / alpha + 1.0) + 2.0
    if not halo.everywhere(pivot > 0.0):
        raise UnsuitableMatrix("an NP sweep needs m_ii/(α d_i) + m_ii/d_i + 2 > 0 in every row")
    bounds = problem.lower, problem.upper
    rows = np.column_stack([problem.q, *bounds, step, step, 1.0 / pivot])
    split, x = split_rows(M), halo.whole(z)
    yield x[: problem.own], 0.0
    new = x.copy()
    while True:
        halo.fetch(x)
        new[problem.own :] = x[problem.own :]
        splitting_sweep(M.indptr, split, M.indices, M.data, rows, beta / alpha, True, False, x, new)
        x, new = new, x
        yield x[: problem.own], 1.0


def multigrid(problem: RowsOnRanks, z: FloatVector) -> Iterates:
    """Yield z after each sweep and correction: truncated V-cycles, or Krylov steps if those are slow.

    A cold start comes from the coarser grids (nested iteration). The run ends after idle cycles.
    """
    _positive_diagonal(problem)
    symmetric = problem.is_symmetric
    hierarchy = build_hierarchy(problem.rows, problem.halo, scales_rows=not symmetric)
    run = GridProblemOnRanks(hierarchy, problem.q, problem.lower, problem.upper, symmetric)
    whole = run.halo.whole(z)  # the hierarchy has a different order of the ghosts
    own = slice(problem.own)
    yield whole[own], 0.0
    if not hierarchy.transfers:
        return
    if problem.halo.everywhere(z == problem.nearest_to_zero):
        whole[:] = 0.0
        run.start_from_coarser(whole)
    least, before, idle = np.inf, np.inf, 0
    while True:
        run.sweep(whole)
        largest, changed = run.look(whole)
        yield whole[own], run.take_work()
        idle = 0 if largest < SHRUNK * least else idle + 1
        least = min(least, largest)
        if not largest <= OUT_OF_HAND * least or idle >= PATIENCE:
            return
        if largest > SLOW * before and changed <= max(SETTLED * problem.n, 1.0):
            run.add_krylov_steps(whole)
        else:
            run.add_cycle(whole)
        before = largest
        run.sweep(whole, backward=True)


class GridProblemOnRanks:
    """The LCP of a grid, with the coarser ones below: projected sweeps, and corrections of its free unknowns."""

    def __init__(
        self,
        hierarchy: HierarchyOnRanks,
        q: FloatVector,
        lower: FloatVector,
        upper: FloatVector,
        symmetric: bool,
    ) -> None:
        self.hierarchy, self.truncation, self.symmetric = (
            hierarchy,
            TruncationOnRanks(hierarchy),
            symmetric,
        )
        self.grid = grid = hierarchy.grids[0]
        self.halo, self.n, self.work = grid.halo, grid.n, 0.0
        self.vectors = tuple(read_only_views(grid.inverse, q, lower, upper))
        self.residual = np.zeros(grid.width)
        self.entries = max(self.halo.total(grid.matrix.data.size), 1.0)

    def take_work(self) -> float:
        """Return the passes over the matrix since the last call."""
        work = self.halo.total(self.work + self.truncation.work)
        self.work = self.truncation.work = 0.0
        return work / self.entries

    def start_from_coarser(self, z: FloatVector) -> None:
        """Add the solution of the coarser grid's LCP to z, within the bounds."""
        transfer = self.hierarchy.transfers[0]
        _, q, lower, upper = self.vectors
        coarse = HierarchyOnRanks(self.hierarchy.grids[1:], self.hierarchy.transfers[1:])
        restricted = np.empty(coarse.grids[0].n)
        restrict(transfer, self.halo.whole(q), restricted)
        bounds = [side[transfer.is_coarse] for side in (lower, upper)]
        below = GridProblemOnRanks(coarse, restricted, bounds[0], bounds[1], self.symmetric)
        answer = below.answer()
        below.halo.fetch(answer)
        everywhere = np.ones(z.size, np.bool_)
        prolong(transfer, answer, everywhere, lower, upper, z)
        self.work += below.work + below.truncation.work

    def answer(self) -> FloatVector:
        """Return an approximate solution with space for ghost values, shape (width,)."""
        z = np.zeros(self.grid.width)
        if not self.hierarchy.transfers:
            z[: self.n] = np.clip(0.0, *self.vectors[2:])
            for k in range(COARSEST_SWEEPS):
                self.sweep(z, backward=k % 2 == 1)
            return z
        self.start_from_coarser(z)
        few = COARSE_CHANGES * self.halo.total(self.n)
        for cycle in range(1, MOST_COARSE_CYCLES + 1):
            self.sweep(z)
            _, changed = self.look(z)
            self.add_cycle(z)
            self.sweep(z, backward=True)
            if cycle >= COARSE_CYCLES and changed <= few:
                break
        return z

    def sweep(self, z: FloatVector, *, backward: bool = False) -> None:
        """Overwrite z by one projected Gauss–Seidel sweep."""
        self.halo.fetch(z)
        rows = self.grid.rows
        kernels.projected_sweep(rows, self.grid.blocks, self.vectors, 1.0, backward, z)
        self.work += self.grid.matrix.data.size

    def look(self, z: FloatVector) -> tuple[float, float]:
        """Find the free rows and truncate to them; return the largest scaled residual and the rows changed."""
        top, residual = self.truncation.grids[0], self.residual[: self.n]
        self.halo.fetch(z)
        largest, changed = kernels.free_rows(
            self.grid.rows, self.vectors, z, top.is_free, top.free_changed, residual
        )
        changed_rows = self.halo.total(changed)
        if changed_rows:
            self.truncation.update()
        self.work += self.grid.matrix.data.size
        return self.halo.largest(largest), changed_rows

    def add_cycle(self, z: FloatVector) -> None:
        """Add one V-cycle's answer to the residual on the free rows, cut off at the bounds."""
        truncation, (_, _, lower, upper) = self.truncation, self.vectors
        top, below = truncation.grids[:2]
        truncation.restrict(0, self.residual)
        truncation.correct(1)
        below.fetch(below.x)
        prolong(truncation.transfers[0], below.x, top.is_interpolated, lower, upper, z)

    def add_krylov_steps(self, z: FloatVector) -> None:
        """Add Krylov steps' answer, cut off at the bounds."""
        residual = self.residual[: self.n].copy()
        correction = KrylovCorrection(self.truncation, residual, self.symmetric)
        begun, steps = correction.largest(), 0
        while steps < KRYLOV_STEPS and correction.largest() > KRYLOV_GAIN * begun:
            if not correction.step():
                break
            steps += 1
        own, (lower, upper) = z[: self.n], self.vectors[2:]
        correction.apply_within(own.copy(), lower, upper, own)
        correction.give_back()


def _positive_diagonal(problem: RowsOnRanks) -> FloatVector:
    if not problem.halo.everywhere(problem.diagonal > 0.0):
        raise UnsuitableMatrix('the algorithm needs a positive diagonal; try algorithm="npsor"')
    return problem.diagonal


METHODS: dict[str, Callable[..., Iterates]] = {
    "multigrid": multigrid,
    "pgs": sweep,
    "psor": lambda problem, z, relaxation=1.0: sweep(problem, z, relaxation),
    "npsor": lambda problem, z, relaxation=1.7: projected_type(problem, z, relaxation, relaxation),
    "npaor": lambda problem, z, relaxation=1.7, acceleration=1.0: projected_type(
        problem, z, relaxation, acceleration
    ),
    "npgs": lambda problem, z: projected_type(problem, z, 1.0, 1.0),
    "npj": lambda problem, z: projected_type(problem, z, 1.0, 0.0),
}


def chain(
    algorithm: str, options: dict[str, Any], *, is_positive: bool
) -> list[tuple[str, Callable[..., Iterates]]]:
    """Return the methods that a name means, in order: multigrid and then sweeps for "auto"."""
    if algorithm == "auto":
        if options:
            raise InvalidOption(f'algorithm="auto" has no options, got {sorted(options)}')
        names = ("multigrid", "pgs") if is_positive else ("npsor",)
        return [(name, METHODS[name]) for name in names]
    if not isinstance(algorithm, str) or algorithm not in METHODS:
        raise UnknownAlgorithm(
            f"{algorithm!r} does not run on several ranks; auto does, and {', '.join(METHODS)}"
        )
    method = METHODS[algorithm]

    def with_options(problem: RowsOnRanks, z: FloatVector) -> Iterates:
        try:
            return method(problem, z, **options)
        except TypeError:
            raise InvalidOption(f"{algorithm} has no such options: {sorted(options)}") from None

    return [(algorithm, with_options)]
