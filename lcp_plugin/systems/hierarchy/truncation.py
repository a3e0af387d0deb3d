"""Hierarchy with fixed unknowns on the finest grid, and the V-cycle on the free unknowns; one object per run.

A V-cycle preconditions Krylov steps on the free rows.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

from ...core.checks import BoolVector, Vector
from ..equilibration import power_of_two
from ..factors import Factor, dense_lu, lapack
from . import kernels
from .grids import Grid, Transfer
from .kernels import dot, span

CLOSING_SWEEPS = 21  # forward and backward, on a large coarsest grid
# of a singular coarsest matrix, relative to its diagonal; 2⁻⁴⁰ takes models without a solution to z of 1e12, past any
# proof. A regular matrix has none: towers with masses of a ratio 1e6 converge too slowly with it, to a wrong point.
REGULARIZING, SINGULAR_PIVOT = 2.0**-26, 2.0**-40


class TruncatedGrid:
    """Values and vectors of one grid while some unknowns are fixed."""

    def __init__(self, grid: Grid, *, is_finest: bool) -> None:
        self.grid = grid
        n = grid.n
        # the finest grid shares the values of the matrix
        self.new_values = None if is_finest else grid.matrix.data.copy()
        self.values = grid.matrix.data if self.new_values is None else self.new_values.view()
        self.values.flags.writeable = False
        self.inverse = grid.inverse.copy()
        self.is_free = np.ones(grid.width, np.bool_)
        self.free_changed = np.zeros(grid.width, np.bool_)
        self.is_interpolated = self.is_free.copy()  # free, with enough couplings to free unknowns
        self.held = np.zeros(0, np.intp)
        self.row_changed = np.zeros(n, np.bool_)
        self.touched = np.zeros(grid.width, np.bool_)
        self.is_whole = True  # no unknown is fixed on this grid
        self.x, self.residual = np.zeros(grid.width), np.zeros(grid.width)
        self.b = np.zeros(n)
        self._factor: Factor | None = None
        self._is_factorized = False

    def factor(self) -> tuple[Factor | None, float]:
        """Return the factorization of the free block (identity elsewhere) and the work; None if singular or too large.

        If couplings jump, sweeps would converge slowly for blocks that are connected only by weak couplings.
        """
        n = self.grid.n
        # A factorization is as fast as sweeps over a few thousand entries; no rank has all rows.
        if self._is_factorized or n > 150 or self.grid.weight is not None:
            return self._factor, 0.0
        dense = self.grid.dense(self.values)
        is_fixed = self.inverse == 0.0
        dense[is_fixed, :] = dense[:, is_fixed] = 0.0
        dense[is_fixed, is_fixed] = 1.0
        # singular if two coarse unknowns have the same one free fine unknown left
        diagonal = dense.diagonal().copy()
        if n and (np.abs(lapack().dgetrf(dense)[0].diagonal()) <= SINGULAR_PIVOT * diagonal).any():
            np.fill_diagonal(dense, (1.0 + REGULARIZING) * diagonal)
        self._factor, self._is_factorized = dense_lu(dense), True
        return self._factor, n**3 / 3.0

    def forget_factor(self) -> None:
        """Drop the factorization, because values or free unknowns have changed."""
        self._factor, self._is_factorized = None, False

    def release(self) -> float:
        """Make all unknowns free; return the matrix entries touched."""
        if self.is_whole:
            return 0.0
        self.is_whole = True
        self.forget_factor()
        self.is_free[:] = self.is_interpolated[:] = True
        self.held = self.held[:0]
        self.inverse[:] = self.grid.inverse
        if self.new_values is not None:
            self.new_values[:] = self.grid.matrix.data
        self.free_changed[:] = self.row_changed[:] = False
        return float(self.values.size)

    @property
    def rows(self) -> tuple[Any, ...]:
        """The truncated matrix as sweeps take it."""
        matrix = self.grid.matrix
        return matrix.indptr, self.grid.split, matrix.indices, self.values

    def mark_rows(self, more: BoolVector) -> None:
        """Mark the rows in `more`, and those that meet an unknown in `free_changed`, as touched."""
        flags = (flag.view(np.uint8) for flag in (self.free_changed, more, self.touched))
        operands = *self.grid.matrix.arrays[:2], *flags
        kernels.shared(partial(kernels.mark_rows, *operands), operands[0].size - 1)

    def find_held(self, transfer: Transfer) -> None:
        """Find the held unknowns among the touched rows: they are free, but not interpolated."""
        flags = self.is_free, self.touched, self.is_interpolated, self.free_changed
        operands = self.grid.matrix.arrays, self.values, *flags, transfer.is_coarse
        if any(kernels.shared(partial(kernels.find_held, *operands), transfer.is_coarse.size)):
            local_rows = slice(self.grid.n)
            self.held = np.flatnonzero(self.is_free[local_rows] & ~self.is_interpolated[local_rows])

    def update_coarser(self, below: TruncatedGrid, transfer: Transfer) -> tuple[float, int]:
        """Compute the coarse rows again that meet a touched row; return the number of products and of changed rows."""
        values = (*self.grid.matrix.arrays[:2], self.values)
        flags = (self.is_interpolated, self.touched)
        coarse = *below.grid.matrix.arrays[:2], below.new_values, below.grid.split, below.inverse
        state = below.is_free, below.free_changed, below.row_changed
        operands = values, flags, transfer.prolongation.arrays, transfer.restriction.arrays
        return kernels.update_product(*operands, (*coarse, *state))

    def invert_weighted_pivots(self) -> None:
        """Invert the pivots of the present values, whose weights only ranks have."""
        if self.grid.weight is not None:
            pivot = self.values[self.grid.split] + self.grid.weight
            self.inverse[:] = np.where(self.is_free[: self.grid.n], 1.0 / pivot, 0.0)

    def add_pivot_weights(self, residual: Vector) -> None:
        """Add the weights of the pivots times x to the residual after the first sweep; only ranks have weights.

        All ranks sweep at once. The sweep adds a weight to the pivot of each row that is coupled to a ghost, because
        it might diverge otherwise; see :func:`lcp_plugin.ranks.methods.pivot_weight`.
        """
        if self.grid.weight is not None:
            x = self.x[: self.grid.n]
            residual += np.where(self.inverse != 0.0, self.grid.weight * x, 0.0)


class Truncation:
    """Hierarchy from one of its grids downwards, without the fixed unknowns of this grid."""

    def __init__(self, hierarchy: Any) -> None:
        self.transfers: tuple[Transfer, ...] = hierarchy.transfers
        self.grids = [TruncatedGrid(g, is_finest=not k) for k, g in enumerate(hierarchy.grids)]
        self.halo, self.top = self.grids[0].grid.halo, 0
        self.work = 0.0

    def take_work(self) -> float:
        """Return the matrix entries touched since the last call."""
        work, self.work = self.work, 0.0
        return work

    def start_at(self, top: int) -> None:
        """Use `top` as the finest grid, and make all unknowns of this grid and of coarser grids free."""
        self.top = top
        for level in self.grids[top:]:
            self.work += level.release()

    def update(self) -> None:
        """Propagate the changes of `is_free` on the top grid (marked in `free_changed`) to the coarser grids."""
        top = self.grids[self.top]
        top.is_whole = False
        top.forget_factor()
        np.multiply(top.grid.inverse, top.is_free[: top.grid.n], out=top.inverse)
        top.row_changed[:] = False
        for k in range(self.top, len(self.transfers)):
            level, below, transfer = self.grids[k], self.grids[k + 1], self.transfers[k]
            self.mark(level, transfer)
            products, changed = level.update_coarser(below, transfer)
            below.is_whole = False
            below.forget_factor()
            self.work += level.values.size + transfer.restriction.indices.size + products
            below.invert_weighted_pivots()
            if self.halo.total(changed) == 0:
                break

    def mark(self, level: TruncatedGrid, transfer: Transfer) -> None:
        """Find the held unknowns of a grid, and the rows whose part of the coarser matrix has changed."""
        halo = level.grid.halo
        halo.fetch_flags(level.is_free)
        halo.fetch_flags(level.free_changed)
        level.mark_rows(level.row_changed)
        level.find_held(transfer)
        halo.fetch_flags(level.is_interpolated)
        halo.fetch_flags(level.free_changed)
        if level.free_changed.any():
            level.mark_rows(level.touched)
        halo.fetch_flags(level.touched)
        if level.new_values is not None:
            halo.fetch_entries(level.new_values)

    def direction(self, b: Vector) -> tuple[Vector, Vector]:
        """Return p of a V-cycle for M p = b on the finest grid, and M p on its free rows; local values on ranks."""
        top = self.grids[0]
        top.b = b
        self.correct(0)
        top.grid.halo.fetch(top.x)
        p, product = top.x[: b.size].copy(), np.empty(b.size)
        kernels.free_product(top.rows, top.inverse, top.x, product)
        self.work += top.values.size
        return p, product

    def correct(self, k: int) -> None:
        """Write into x one V(1,1)-cycle for the truncated M x = b of grid k, from x = 0."""
        level = self.grids[k]
        grid, entries, vectors = level.grid, level.values.size, (level.inverse, level.b)
        if k == len(self.transfers) and self._solves_directly(level):
            return
        operands = level.rows, grid.blocks
        kernels.sweep(*operands, vectors, level.x, is_first=True)
        self.work += 0.5 * entries
        if k == len(self.transfers):
            for count in range(CLOSING_SWEEPS):
                grid.halo.fetch(level.x)
                kernels.sweep(*operands, vectors, level.x, backward=count % 2 == 0)
            self.work += CLOSING_SWEEPS * entries
            return
        grid.halo.fetch(level.x)
        residual = level.residual[: grid.n]
        kernels.residual_after_first_sweep(*operands, *vectors, level.x, residual)
        level.add_pivot_weights(residual)
        self.restrict(k, level.residual)
        self.correct(k + 1)
        below, transfer = self.grids[k + 1], self.transfers[k]
        below.grid.halo.fetch(below.x)
        kernels.prolong(transfer, below.x, level.is_interpolated, level.x)
        grid.halo.fetch(level.x)
        kernels.sweep(*operands, vectors, level.x, backward=True)
        self.work += 1.5 * entries + 2.0 * transfer.prolongation.data.size

    def restrict(self, k: int, residual: Vector) -> None:
        """Write the restricted residual into b of grid k + 1."""
        level, held = self.grids[k], self.grids[k].held
        kept = residual[held]
        residual[held] = 0.0
        level.grid.halo.fetch(residual)
        kernels.restrict(self.transfers[k], residual, self.grids[k + 1].b)
        residual[held] = kept

    def _solves_directly(self, level: TruncatedGrid) -> bool:
        """Solve the coarsest system by factorization; return whether the result is finite."""
        factor, work = level.factor()
        self.work += work
        if factor is None:
            return False
        right = np.where(level.inverse != 0.0, level.b, 0.0)
        x = factor.solve(right)
        self.work += factor.solve_work
        level.x[:] = x
        return bool(np.isfinite(x).all())


class KrylovCorrection:
    """An approximate c with (M c)_F = residual_F and c = 0 elsewhere, improved step by step.

    Conjugate gradients if M is symmetric, otherwise generalized conjugate residuals with all directions kept. The
    latter minimize the norm of the residual divided by the diagonal, which is independent of the scaling of rows.

    Parameters
    ----------
    truncation : Truncation
        Truncation whose top is the finest grid; its free rows are F.
    residual : ndarray, shape (n,)
        −w on the free rows, 0 elsewhere; overwritten by the remaining residual.
    is_symmetric : bool
    """

    def __init__(self, truncation: Truncation, residual: Vector, is_symmetric: bool) -> None:
        self.truncation, self.residual, self.is_symmetric = truncation, residual, is_symmetric
        # Squares of very large or small numbers leave the range of a double.
        self.unit: float = power_of_two(truncation.halo.largest(span(residual)))
        self.residual /= self.unit
        inverse = truncation.grids[0].inverse
        unit = truncation.halo.largest(span(inverse))
        self._weight = None if is_symmetric else (inverse / unit) ** 2
        self._sum = np.zeros(residual.size)
        self.directions: list[tuple[Vector, Vector, float]] = []

    @property
    def solution(self) -> Vector:
        """The approximate c, shape (n,)."""
        return self.unit * self._sum

    def largest(self) -> float:
        """Return the largest scaled remaining residual."""
        scaled = span(self.residual * self.truncation.grids[0].inverse)
        return float(self.unit * self.truncation.halo.largest(scaled))

    def step(self) -> bool:
        """Take one step; return False if the step fails for this matrix."""
        p, product = self.truncation.direction(self.residual)
        for old_p, old_product, old_scale in self.directions:
            share = self._dot(self._against(old_p, old_product), product) / old_scale
            p -= share * old_p
            product -= share * old_product
        against = self._against(p, product)
        scale = self._dot(against, product)
        length = self._dot(against, self.residual) / scale if scale > 0.0 else np.nan
        if not np.isfinite(length):
            return False
        self._sum += length * p
        self.residual -= length * product
        if self.is_symmetric:
            self.directions.clear()
        self.directions.append((p, product, scale))
        return True

    def _dot(self, x: Vector, y: Vector) -> float:
        return self.truncation.halo.total(dot(x, y))

    def _against(self, p: Vector, product: Vector) -> Vector:
        return p if self._weight is None else product * self._weight
