"""Linear systems with the block M_FF of some rows and columns of M, and with its transpose."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sp

from ..checks import BoolVector, FloatVector
from ..crossovers import DIRECT_UP_TO
from .equilibration import evened, scaled, times_power, unit_diagonal
from .factors import BANDED_UP_TO, Factor, factor_fits, factorise
from .matrix import Matrix
from .structure import bandwidth
from .symmetry import has_symmetric_entries, is_nearly_symmetric

REFINEMENTS = 3
KRYLOV_GOAL = 1e-13  # of ‖right‖₂ that steps leave; rounding leaves as much
KRYLOV_STEPS = 60
CONVERGED = 1e-9  # beyond, what the steps have left says that they do not converge, unless it is rounding
ROUNDING = 2.0**-44  # of the terms of a row
SINGULAR = 1e13  # times its right-hand side: terms that cancel so much leave no digit of the solution
UNEVEN = 1e4  # residual scales that differ by more are evened out before a factor is made
EVENED_BY = (0.5, 0.5, 0.5, 0.5, 1.0)  # passes that bring a block's entries near 1, as `evened` takes them


class FreeSystem:
    """M_FF x = b and M_FFᵀ x = b for one F, by a factor or by Krylov steps on the hierarchy of M truncated to F.

    Parameters
    ----------
    matrix : Matrix
    free : array of bool, shape (own,)
        F; on several ranks the own part.

    Notes
    -----
    Solutions are refined until their backward error is that of rounding. Nothing is computed before it is asked for;
    a factor or a truncation serves for all right-hand sides.

    Examples
    --------
    >>> system = FreeSystem(Matrix([[2.0, 1.0, 0.0], [0.0, 4.0, 1.0], [1.0, 0.0, 1.0]]), np.array([True, True, False]))
    >>> system.solve(np.array([4.0, 8.0, 9.0])), system.solve(np.array([2.0, 9.0, 9.0]), transposed=True)
    (array([1., 2., 0.]), array([1., 2., 0.]))
    """

    def __init__(self, matrix: Matrix, free: BoolVector) -> None:
        self.matrix, self.free = matrix, free
        self.rows = np.flatnonzero(free)

    @cached_property
    def block(self) -> Any:
        """M_FF, dense or CSR."""
        M, rows = self.matrix.array, self.rows
        if rows.size == self.matrix.n:
            return M
        return M[rows][:, rows] if sp.issparse(M) else M[np.ix_(rows, rows)]

    @cached_property
    def principal(self) -> Matrix:
        """M_FF as a matrix with facts of its own."""
        return self.matrix if self.rows.size == self.matrix.n else Matrix(self.block)

    def solve(self, right: FloatVector, *, transposed: bool = False, goal: float = KRYLOV_GOAL) -> FloatVector | None:
        """Return x with M_FF x_F = right_F, or M_FFᵀ x_F = right_F, 0 elsewhere; None where none is to be had.

        The block is singular then, to working precision, or Krylov steps fail and it is too large for a factor.

        Parameters
        ----------
        right : array, shape (own,)
            Entries outside F are not read.
        goal : float
            Where the solution is iterative, ‖residual‖₂ ≤ goal ‖right‖₂ is enough.
        """
        if not self._is_direct:
            x = self._iterated(np.where(self.free, right, 0.0), transposed, goal)
            if x is not None or not self.matrix.peers.is_alone or not factor_fits(self.block):
                return x
        factor = self._factor
        if factor is None:
            return None
        x = np.zeros(right.size)
        x[self.rows] = self._refined(factor, right[self.rows], transposed)
        return x if np.isfinite(x).all() else None

    @property
    def is_singular(self) -> bool:
        """Whether a factor has shown that the block is singular to working precision; Krylov steps tell only later."""
        return self._is_direct and self._factor is None

    @cached_property
    def _is_direct(self) -> bool:
        """Whether a factor is the first choice: on small sets and narrow bands, and where there are no grids."""
        matrix = self.matrix
        if matrix.peers.is_alone:
            if matrix.is_dense or self.rows.size <= DIRECT_UP_TO:
                return True
            if (band := bandwidth(matrix)) is not None and sum(band) <= BANDED_UP_TO:
                return True
            if not (matrix.diagonal > 0.0).all():
                return factor_fits(self.block)
        return False

    @cached_property
    def _factor(self) -> Factor | None:
        """The factor of the block, None where it is singular to working precision."""
        matrix = self.matrix
        if not self.rows.size:
            return Factor("empty", np.copy, np.copy, 0.0, 0.0)
        factor = self._even_factor(is_nearly_symmetric(matrix))
        return None if factor is None or self._cancels(factor) else factor

    def _even_factor(self, is_symmetric: bool) -> Factor | None:
        """Return a factor of the block, with rows and columns of one size where those of M are not.

        Pivots that are large only by their unit would be preferred to those on the diagonal, and fill in.
        """
        band, scale = bandwidth(self.matrix), self.matrix.residual_scale[self.rows]
        if not scale.max() > UNEVEN * scale.min():
            return factorise(self.block, is_symmetric=is_symmetric, bandwidth=band)
        is_symmetric = is_symmetric and bool((self.block.diagonal() > 0.0).all())
        by = unit_diagonal(self.block.diagonal()) if is_symmetric else evened(sp.csr_array(self.block), EVENED_BY)
        even = factorise(scaled(self.block, by), is_symmetric=is_symmetric, bandwidth=band)
        if even is None:
            return None
        solve, solve_transposed = even.solve, even.solve_transposed
        return replace(
            even, solve=lambda right: times_power(solve(times_power(right, by.row)), by.column),
            solve_transposed=lambda right: times_power(solve_transposed(times_power(right, by.column)), by.row),
        )

    def _cancels(self, factor: Factor) -> bool:
        """Return whether terms much larger than their sum cancel in a solution: so they do beside a singular block.

        Units of the unknowns that lie far apart can make a regular block look so, but not once they are evened out.
        """
        scale = self.matrix.residual_scale[self.rows]
        if not self._cancels_beside(scale, factor):
            return False
        rows = evened(sp.csr_array(self.block), EVENED_BY).row
        return self._cancels_beside(np.exp2(-rows.astype(np.float64)), factor)

    def _cancels_beside(self, scale: FloatVector, factor: Factor) -> bool:
        """Return whether it is so where the right-hand side is this large, shape (|F|,)."""
        with np.errstate(all="ignore"):
            x = factor.solve(np.random.default_rng(0).standard_normal(scale.size) * scale)  # in no range by chance
            return not bool((abs(self.block) @ np.abs(x) <= SINGULAR * scale).all())

    @np.errstate(all="ignore")
    def _refined(self, factor: Factor, right: FloatVector, transposed: bool) -> FloatVector:
        """Return the solution by a factor, refined as long as that makes the backward error smaller."""
        solve, block = (factor.solve_transposed, self.block.T) if transposed else (factor.solve, self.block)
        x: FloatVector = solve(right)
        size, best = abs(block), np.inf
        for _ in range(REFINEMENTS):
            left = right - block @ x
            terms = size @ np.abs(x) + np.abs(right)
            error = float(np.divide(np.abs(left), terms, out=np.zeros(left.size), where=left != 0.0).max(initial=0.0))
            if not error < 0.5 * best:
                break
            best, x = error, x + solve(left)
        return x

    @cached_property
    def _truncation(self) -> Any:
        """The grids of M with all that is not free taken out."""
        from .hierarchy.levels import COARSEST, hierarchy_of
        from .hierarchy.truncation import Truncation

        truncation = Truncation(hierarchy_of(self.matrix, COARSEST))
        top = truncation.grids[0]
        top.is_free[: self.matrix.own] = self.free
        top.free_changed[: self.matrix.own] = ~self.free
        truncation.update()
        return truncation

    @np.errstate(all="ignore")
    def _iterated(self, right: FloatVector, transposed: bool, goal: float) -> FloatVector | None:
        """Return the solution by Krylov steps, one V-cycle each, None where they do not converge."""
        from .hierarchy.truncation import KrylovCorrection
        from .hierarchy.vectors import dot

        matrix, is_symmetric = self.matrix, has_symmetric_entries(self.matrix)
        if transposed and not is_symmetric and not matrix.peers.is_alone:
            return None  # the columns of M are spread over the ranks
        if not matrix.peers.everywhere(bool((matrix.diagonal > 0.0).all())):
            return None

        def size(vector: FloatVector) -> float:
            return float(np.sqrt(matrix.peers.total(dot(vector, vector))))

        unit = 1.0 if is_symmetric or transposed else 1.0 / matrix.residual_scale
        x, left, begun = np.zeros(right.size), right, size(right * unit)
        for _ in range(REFINEMENTS):
            correction = KrylovCorrection(self._truncation, left.copy(), is_symmetric, transposed=transposed)
            steps, enough = 0, goal * begun / correction.unit
            while size(correction.residual * unit) > enough and steps < KRYLOV_STEPS and correction.step():
                steps += 1
            better = np.empty(right.size)
            correction.apply_to(x, better)
            remainder = self._remainder(right, better, transposed)  # what steps keep of it on the way is not what it is
            if not size(remainder * unit) < size(left * unit):
                break
            x, left = better, remainder
            if size(left * unit) <= 10.0 * goal * begun:
                return x
        allowed = max(CONVERGED * begun, size(ROUNDING * self._terms(right, x, transposed) * unit))
        return x if size(left * unit) <= allowed else None

    def _remainder(self, right: FloatVector, x: FloatVector, transposed: bool) -> FloatVector:
        """Return right − M x, or right − Mᵀx, on the free rows, 0 elsewhere."""
        matrix = self.matrix
        product = matrix.rows.T @ x if transposed and matrix.peers.is_alone else matrix.rows @ matrix.whole(x)
        return np.where(self.free, right - product, 0.0)

    def _terms(self, right: FloatVector, x: FloatVector, transposed: bool) -> FloatVector:
        """Return |right| + |M||x|, or |right| + |Mᵀ||x|, on the free rows, 0 elsewhere."""
        matrix, rows = self.matrix, abs(self.matrix.rows)
        size = np.abs(matrix.whole(x))
        product = (rows.T if transposed and matrix.peers.is_alone else rows) @ size
        return np.where(self.free, np.abs(right) + product, 0.0)
