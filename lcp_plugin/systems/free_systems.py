"""Linear systems with the block M_FF of some rows and columns of M, and with its transpose.

The derivative at a solution: a linear system on the rows that are free, for one problem or for many in a row.

With z = P(z − w/d), w = M z + q, and R_z dz + R_w dw = 0 the generalized derivative of the natural map, a row is free
if R_w ≠ 0. For a complementarity problem, R_w is 1 on the rows between their bounds. For cones, R_w couples the rows of
a block. J = R_z + R_w M, h = dM z + dq, b the active bounds:

    dz_A = db_A,    J_FF dz_F = −(R_w (h + M db))_F

and for a function L of z and w with g = ∂L/∂z + Mᵀ ∂L/∂w: J_FFᵀ λ_F = g_F, λ_A = 0, ∂L/∂q = ∂L/∂w − R_wᵀ λ,
∂L/∂m_ij = (∂L/∂q)_i z_j, ∂L/∂b_A = (g + Mᵀ(∂L/∂q − ∂L/∂w))_A.

Inverses of many small blocks, pseudo-inverses if they are singular.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sp

from ..core.checks import AnyMatrix, Array, BoolVector, Vector
from ..core.entries import Exponents, max_norm, scale_matrix, times_power
from ..core.kernels.floats import DATA_ROUNDING
from ..core.matrix import Matrix, fact
from ..core.structure import is_nearly_symmetric
from ..core.tuning import DIRECT_UP_TO
from .equilibration import EQUILIBRATING_PASSES, equilibrating_exponents, unit_diagonal
from .factors import BANDED_UP_TO, Factor, factor_fits, factorize
from .graph import bandwidth
from .hierarchy.kernels import dot
from .hierarchy.levels import COARSEST, hierarchy_of
from .hierarchy.truncation import KrylovCorrection, Truncation


class LinearizedSystem:
    """The system at a solution, or at as many as there are rows: vectors have shape (n,) or (k, n) throughout."""

    _product: Any  # M x, or Mᵀx if `transposed`
    # the x with J_FF x = right_F, or of the transposed system, 0 in the other rows
    _solve_free: Any

    def _by_slack(self, x: Vector, *, transposed: bool = False) -> Any:
        """Return R_w x, or R_wᵀx; only the free rows are used."""
        return x

    @np.errstate(all="ignore")
    def tangent(self, h: Vector, held: Array = None, more: Array = 0.0) -> Any:
        """Return dz.

        Parameters
        ----------
        h : array
            dM z + dq.
        held : array, optional
            Changes of the active bounds, 0 in free rows; by default all 0.
        more : array
            Other changes of R, for example by friction.
        """
        if held is not None and held.any():
            return held + self._solve_free(-(self._by_slack(h + self._product(held)) + more))
        return self._solve_free(-(self._by_slack(h) + more))

    @np.errstate(all="ignore")
    def adjoint(self, g: Vector, by_w: Array) -> tuple[Any, Any, Any]:
        """Return ∂L/∂q, ∂L/∂b (valid at active bounds) and λ for a loss L with gradients g by z and by_w by w."""
        by_z = g + self._product(by_w, transposed=True) if by_w.any() else g
        multiplier = self._solve_free(by_z, transposed=True)
        change = self._by_slack(multiplier, transposed=True)
        return by_w - change, by_z - self._product(change, transposed=True), multiplier


ENTRIES = 2**16  # of blocks that are inverted together


def pseudo_inverses(blocks: AnyMatrix) -> tuple[Any, BoolVector]:
    """Return the Moore–Penrose inverses of square blocks, shape (k, f, f), and which of these are singular, shape (k,).

    Examples
    --------
    >>> inverses, is_singular = pseudo_inverses(np.array([[[2.0, 2.0], [2.0, 2.0]], [[4.0, 0.0], [0.0, 1.0]]]))
    >>> inverses.round(15).tolist(), is_singular
    ([[[0.125, 0.125], [0.125, 0.125]], [[0.25, 0.0], [0.0, 1.0]]], array([ True, False]))
    """
    left, sizes, right = np.linalg.svd(blocks)
    # 2⁻⁴³ of the largest singular value is the rounding error of a zero singular value.
    is_kept = sizes > 2.0**-43 * sizes[:, :1]
    reciprocal = np.divide(1.0, sizes, out=np.zeros_like(sizes), where=is_kept)
    right, left = np.swapaxes(right, 1, 2), np.swapaxes(left, 1, 2)
    return (right * reciprocal[:, np.newaxis]) @ left, np.any(~is_kept, axis=1)


def solved(blocks: AnyMatrix, right: Vector) -> Any:
    """Return the solutions of B X = right, shapes (k, f, f) and (k, f, r); NaN if a pivot is 0.

    Examples
    --------
    >>> solved(np.array([[[2.0]], [[0.0]]]), np.ones((2, 1, 1))).ravel()
    array([0.5, nan])
    """
    try:
        return np.linalg.solve(blocks, right)
    except np.linalg.LinAlgError:
        is_singular = np.linalg.slogdet(blocks)[0] == 0.0
        regular = np.where(is_singular[:, np.newaxis, np.newaxis], np.eye(blocks.shape[1]), blocks)
        x = np.linalg.solve(regular, right)
        x[is_singular] = np.nan
        return x


def matvecs(M: AnyMatrix, x: Vector) -> Any:
    """Return M_k x_k, shapes (k or 1, m, n) and (k, n)."""
    return np.matmul(M, x[:, :, np.newaxis])[:, :, 0]


class FreeBlocks:
    """Blocks J_FF of many matrices, grouped by size, each with its inverse.

    Parameters
    ----------
    J : array, shape (k, n, n), or (1, n, n) for all
    free : array of bool, shape (k, n)

    Attributes
    ----------
    is_regular : array of bool, shape (k,)
        True if fewer than half of the digits cancel in J_FF⁻¹ J_FF = I, independent of the scaling.
    is_singular : array of bool, shape (k,)
        True if J_FF has one unit and is singular to rounding error; its inverse is the Moore–Penrose inverse. A block
        that is neither regular nor singular is doubtful, and `solve` returns no solution for it.
    """

    def __init__(self, J: AnyMatrix, free: Array) -> None:
        self._groups = []
        self.is_regular = np.ones(len(free), np.bool_)
        self.is_singular = np.zeros(len(free), np.bool_)
        counts = free.sum(axis=1)
        for count in np.unique(counts[counts > 0]).tolist():
            alike, most = np.flatnonzero(counts == count), max(ENTRIES // count**2, 1)
            for items in np.split(alike, range(most, alike.size, most)):
                rows = np.nonzero(free[items])[1].reshape(-1, count)
                which = (items if len(J) > 1 else np.zeros_like(items))[:, np.newaxis, np.newaxis]
                blocks = J[which, rows[:, :, np.newaxis], rows[:, np.newaxis]]
                inverses = solved(blocks, np.broadcast_to(np.eye(count), blocks.shape))
                terms = np.abs(blocks * inverses.swapaxes(1, 2)).sum(axis=2)
                # At 2²⁶ half of the digits of a double cancel in the sum.
                self.is_regular[items] = is_regular = (terms <= 2.0**26).all(axis=1)
                if (left := np.flatnonzero(~is_regular)).size:
                    inverses[left], is_singular = pseudo_inverses(blocks[left])
                    self.is_singular[items[left]] = is_singular & have_one_unit(blocks[left])
                self._groups.append((items[:, np.newaxis], rows, inverses))

    def solve(self, right: Vector, *, transposed: bool = False) -> Any:
        """Return the solutions of J_FF x = right_F, or of the transposed, shape (k, n), 0 in other rows."""
        x = np.zeros(right.shape)
        for items, rows, inverses in self._groups:
            turned = inverses.swapaxes(1, 2) if transposed else inverses
            x[items, rows] = matvecs(turned, right[items, rows])
        return x


def have_one_unit(blocks: AnyMatrix) -> Any:
    """Return the mask of blocks whose diagonal, or the largest entries of all rows and columns, differ little."""
    sizes = np.abs(blocks)
    rows, sides = sizes.max(2), np.concatenate([sizes.max(2), sizes.max(1)], 1)
    is_diagonal_large = rows <= 2.0**4 * np.abs(np.diagonal(blocks, axis1=1, axis2=2))
    smallest = sides.min(1, initial=np.inf, where=sides > 0.0)
    # Such rows and columns are in one unit.
    return is_diagonal_large.all(1) | (sides.max(1) <= 2.0**10 * smallest)


REFINEMENTS = 3  # each takes some digits off the error
RIDGE = 1e-8  # of the residual scale, added to the diagonal of a singular block
CONSISTENT = 1e-10  # backward error below which a singular system counts as solved
LEAST_SQUARES_UP_TO = 500  # rows
KRYLOV_GOAL = 1e-13  # of ‖right‖₂ that steps leave; rounding leaves as much
# times its right-hand side: terms that cancel so much leave no digit of the solution
SINGULAR = 1e13


class FreeSystem:
    """M_FF x = b and M_FFᵀ x = b for one F, by factorization or by Krylov steps on the hierarchy truncated to F.

    It is one class because all solutions share the factorizations and scales that are computed on first use.

    Parameters
    ----------
    matrix : Matrix
    free : array of bool, shape (n,)
        F.
    by_factor : bool
        Use a dense, banded or sparse factorization even if the hierarchy is likely to be cheaper.

    Attributes
    ----------
    work : float
        Multiplications that factors have taken so far, and solutions by them.

    Notes
    -----
    Solutions are refined as long as a step halves their backward error. Factorizations and truncations are computed on
    first use and serve all right-hand sides. A block is called singular if its factorization fails, or if terms 10¹³
    times as large as their sum cancel in a solution. For a singular block, :meth:`solve_near` computes a ridge or
    least-squares solution near a point, and `pseudo_inverse` gives the solution of least norm.

    Examples
    --------
    >>> system = FreeSystem(Matrix([[2.0, 1.0, 0.0], [0.0, 4.0, 1.0], [1.0, 0.0, 1.0]]), np.array([True, True, False]))
    >>> system.solve(np.array([4.0, 8.0, 9.0])), system.solve(np.array([2.0, 9.0, 9.0]), transposed=True)
    (array([1., 2., 0.]), array([1., 2., 0.]))
    """

    def __init__(self, matrix: Matrix, free: BoolVector, *, by_factor: bool = False) -> None:
        self.matrix, self.free, self.by_factor = matrix, free, by_factor
        self.rows = np.flatnonzero(free)
        self.work = 0.0

    @cached_property
    def block(self) -> Any:
        """M_FF, dense or CSR."""
        M, rows = self.matrix.array, self.rows
        if rows.size == self.matrix.n:
            return M
        return M[rows][:, rows] if sp.issparse(M) else M[np.ix_(rows, rows)]

    @cached_property
    def principal(self) -> Matrix:
        """M_FF as a matrix with separate facts."""
        return self.matrix if self.rows.size == self.matrix.n else Matrix(self.block)

    def solve(
        self, right: Vector, *, transposed: bool = False, goal: float = KRYLOV_GOAL
    ) -> Vector | None:
        """Return x with M_FF x_F = right_F, or M_FFᵀ x_F = right_F, 0 elsewhere; None if the solver fails.

        It fails if the block is singular to working precision, or if Krylov steps fail on a block too large to factor.

        Parameters
        ----------
        right : array, shape (n,)
            Entries outside F are not read.
        goal : float
            Stopping criterion of an iterative solution: ‖residual‖₂ ≤ goal ‖right‖₂.
        """
        if not self._is_direct:
            x = self._iterated(np.where(self.free, right, 0.0), transposed, goal)
            if x is not None or not factor_fits(self.block):
                return x
        factor = self._factor
        if factor is None:
            return None
        x = self._refined(factor, right[self.rows], REFINEMENTS, transposed=transposed)
        return self._extended(x)

    def least_solution(self, right: Vector, *, transposed: bool = False) -> Vector | None:
        """Return x as `solve`, of least norm if the block is singular; None if no pseudo-inverse is available."""
        x = self.solve(right, transposed=transposed)
        if x is None and (inverse := self.pseudo_inverse) is not None:
            x = self._extended((inverse.T if transposed else inverse) @ right[self.rows])
        return x

    def solve_near(self, right: Vector, start: Vector) -> Vector | None:
        """Return x with the smallest residual in M_FF x_F = right_F, 0 elsewhere; None if no attempt is finite.

        If the block is singular, a ridge is added to its diagonal and taken out again by proximal steps from
        start. If the residual remains too large, the most accurate of all attempts is returned.

        Parameters
        ----------
        right, start : array, shape (n,)
            Entries outside F are not read.
        """
        right, start = right[self.rows], start[self.rows]
        if self._factor is not None:
            steps = REFINEMENTS if self._is_badly_scaled else 1
            return self._extended(self._refined(self._factor, right, steps, self._scale))
        attempts = []
        if self._ridge is not None:
            attempts.append(self._refined(self._ridge, right, 12, self._scale, start))
            size = self._sizes @ np.abs(attempts[0]) + np.abs(right)
            if _relative(right - self.block @ attempts[0], size) <= CONSISTENT:
                return self._extended(attempts[0])
        if self._doubtful_factor is not None:  # ill-conditioned is not singular
            attempts.append(self._refined(self._doubtful_factor, right, 1, self._scale))
        if (inverse := self.pseudo_inverse) is not None:
            attempts.append(start + inverse @ (right - self.block @ start))
        finite = [x for x in attempts if np.isfinite(x).all()]
        errors = [_relative(right - self.block @ x, self._scale) for x in finite]
        return self._extended(finite[np.argmin(errors)]) if finite else None

    @cached_property
    def _equilibrated_inverse(self) -> tuple[Any, Any, Exponents]:
        """The block with rows and columns near 1, its Moore–Penrose inverse, the exponents."""
        by = Exponents(*np.zeros((2, self.rows.size), np.int64))
        if self._is_badly_scaled:
            by = equilibrating_exponents(sp.csr_array(self.block), EQUILIBRATING_PASSES)
        dense = self.block.toarray() if sp.issparse(self.block) else self.block
        block = scale_matrix(dense, by)
        return block, pseudo_inverses(block[np.newaxis])[0][0], by

    @cached_property
    def pseudo_inverse(self) -> Any | None:
        """The Moore–Penrose inverse of the equilibrated block, unscaled; None for more than 500 rows."""
        if self.rows.size > LEAST_SQUARES_UP_TO:
            return None
        _, inverse, by = self._equilibrated_inverse
        return scale_matrix(inverse, Exponents(by.column, by.row))

    @cached_property
    def determined_slack(self) -> BoolVector | None:
        """Mask of the rows of M x that all solutions of M_FF x = b share, shape (n,); None if unknown."""
        if self.pseudo_inverse is None:
            return None
        share = self.pseudo_inverse @ self.block  # of a change of x_F: M x depends on it
        columns = self.matrix.array[:, self.rows]
        left = np.asarray(abs(columns - columns @ share).max(axis=1)).ravel()
        return left <= CONSISTENT * abs(columns).max()

    def _extended(self, x: Vector) -> Vector | None:
        if not np.isfinite(x).all():
            return None
        whole = np.zeros(self.free.size)
        whole[self.rows] = x
        return whole

    @property
    def is_singular(self) -> bool:
        """True if a factorization has shown the block to be singular to working precision; False for Krylov steps."""
        return self._is_direct and self._factor is None

    @cached_property
    def _is_direct(self) -> bool:
        """True if a factorization is the first choice: for small sets, narrow bands, and matrices without grids."""
        matrix = self.matrix
        if self.by_factor or matrix.is_dense or self.rows.size <= DIRECT_UP_TO:
            return True
        if (band := bandwidth(matrix)) is not None and sum(band) <= BANDED_UP_TO:
            return True
        return not (matrix.diagonal > 0.0).all() and factor_fits(self.block)

    @cached_property
    def _factor(self) -> Factor | None:
        """Factorization of the block; None if the block is singular to working precision."""
        factor = self._doubtful_factor
        return None if factor is None or self._cancels(factor) else factor

    @cached_property
    def _doubtful_factor(self) -> Factor | None:
        """Factorization of the block; None if a pivot is zero."""
        return self._even_factor(self.block)

    @cached_property
    def _ridge(self) -> Factor | None:
        """Factorization of the block with RIDGE on its diagonal."""
        shift = RIDGE * self._scale
        block = self.block + (sp.diags_array(shift) if sp.issparse(self.block) else np.diag(shift))
        return self._even_factor(sp.csr_array(block) if sp.issparse(block) else block)

    @cached_property
    def _scale(self) -> Vector:
        return self.matrix.residual_scale[self.rows]

    @property
    def _is_badly_scaled(self) -> bool:
        # Residual scales that differ by more are equilibrated before a factorization.
        return bool(self._scale.size and self._scale.max() > 1e4 * self._scale.min())

    @cached_property
    def _sizes(self) -> Any:
        """|M_FF|."""
        return abs(self.block)

    def _even_factor(self, block: AnyMatrix) -> Factor | None:
        """Return the factorization of a block like M_FF, equilibrated if M is badly scaled.

        Without equilibration, pivots that are large only by their unit would replace diagonal pivots and cause fill.
        """
        is_symmetric, band = is_nearly_symmetric(self.matrix), bandwidth(self.matrix)
        by = None
        if self._is_badly_scaled:
            by, is_symmetric = self._exponents(block)
        factor = factorize(scale_matrix(block, by), is_symmetric=is_symmetric, bandwidth=band)
        self.work += 0.0 if factor is None else factor.work
        if factor is None or by is None:
            return factor
        solve, solve_transposed = factor.solve, factor.solve_transposed
        return replace(
            factor,
            solve=lambda right: times_power(solve(times_power(right, by.row)), by.column),
            solve_transposed=lambda right: times_power(
                solve_transposed(times_power(right, by.column)), by.row
            ),
        )

    def _exponents(self, block: AnyMatrix) -> tuple[Exponents, bool]:
        """Return powers of two that bring entries near 1, and whether the scaled block is symmetric."""
        diagonal = block.diagonal()
        if is_nearly_symmetric(self.matrix) and bool((diagonal > 0.0).all()):
            return unit_diagonal(diagonal), True
        return equilibrating_exponents(sp.csr_array(block), EQUILIBRATING_PASSES), False

    def _cancels(self, factor: Factor) -> bool:
        """Return whether terms much larger than their sum cancel in a solution, as close to a singular block.

        Units of the unknowns that lie far apart can make a regular block look so, but not once they are equilibrated.
        """
        if not self.rows.size or not self._cancels_beside(self._scale, factor):
            return False
        rows = self._exponents(self.block)[0].row
        return self._cancels_beside(np.exp2(-rows.astype(np.float64)), factor)

    def _cancels_beside(self, scale: Vector, factor: Factor) -> bool:
        """Return whether terms cancel for a random right-hand side of this size, shape (|F|,)."""
        # a random vector is not in the range of a singular block
        x = factor.solve(np.random.default_rng(0).standard_normal(scale.size) * scale)
        self.work += factor.solve_work
        # decides most blocks without a product
        at_most, limit = self.matrix.row_largest[self.rows] * np.abs(x).sum(), SINGULAR * scale
        return not bool((at_most <= limit).all() or (self._sizes @ np.abs(x) <= limit).all())

    def _refined(
        self,
        factor: Factor,
        right: Vector,
        steps: int,
        scale: Array = None,
        x: Array = None,
        *,
        transposed: bool = False,
    ) -> Vector:
        """Return the best x of steps x ← x + A⁻¹(right − M_FF x) from x = A⁻¹ right, as long as each halves its error.

        The error is the largest residual relative to `scale`, or to |M_FF||x| + |right| without a scale, 0/0 = 0.
        """
        solve, block, sizes = factor.solve, self.block, self._sizes if scale is None else None
        if transposed:
            solve, block, sizes = factor.solve_transposed, block.T, self._sizes.T
        if x is None:
            self.work += factor.solve_work
            x = solve(right)
        entries = self.block.nnz if sp.issparse(self.block) else self.block.size
        best: Vector = x
        error = np.inf
        for step in range(steps + 1):
            left = right - block @ x
            size = sizes @ np.abs(x) + np.abs(right) if scale is None else scale
            now = _relative(left, size)
            self.work += (2.0 if scale is None else 1.0) * entries
            best, is_halved, error = x if now < error else best, now < 0.5 * error, min(now, error)
            if not is_halved or error == 0.0 or step == steps:
                break
            x = x + solve(left)
            self.work += factor.solve_work
        return best

    @cached_property
    def _truncation(self) -> Any:
        """The grids of M with all that is not free taken out."""
        truncation = Truncation(hierarchy_of(self.matrix, COARSEST))
        top = truncation.grids[0]
        top.is_free[:] = self.free
        top.free_changed[:] = ~self.free
        truncation.update()
        return truncation

    def _iterated(self, right: Vector, transposed: bool, goal: float) -> Vector | None:
        """Return the solution by Krylov steps, one V-cycle each, None if they do not converge."""
        matrix, is_symmetric = self.matrix, is_nearly_symmetric(self.matrix)
        if not (matrix.diagonal > 0.0).all():
            return None
        if transposed and not is_symmetric:
            return FreeSystem(_transposed(matrix), self.free)._iterated(right, False, goal)

        def size(vector: Vector) -> float:
            return float(np.sqrt(dot(vector, vector)))

        unit = 1.0 if is_symmetric else 1.0 / matrix.residual_scale
        x, left, begun = np.zeros(right.size), right, size(right * unit)
        for _ in range(REFINEMENTS):
            correction = KrylovCorrection(self._truncation, left.copy(), is_symmetric)
            steps, enough = 0, goal * begun / correction.unit
            while size(correction.residual * unit) > enough and steps < 60 and correction.step():
                steps += 1
            better = x + correction.solution
            # Computed again: the residual of the steps is rounded on the way.
            remainder = np.where(self.free, right - matrix.array @ better, 0.0)
            if not size(remainder * unit) < size(left * unit):
                break
            x, left = better, remainder
            if size(left * unit) <= 10.0 * goal * begun:
                return x
        terms = np.where(self.free, np.abs(right) + abs(matrix.array) @ np.abs(x), 0.0)
        # A larger residual is not convergence, unless it is at rounding level
        allowed = max(1e-9 * begun, size(DATA_ROUNDING * terms * unit))
        return x if size(left * unit) <= allowed else None


@fact
def _transposed(matrix: Matrix) -> Matrix:
    """Return Mᵀ with separate facts, as a hierarchy of grids."""
    return Matrix(matrix.array.T)


def _relative(left: Vector, size: Vector) -> float:
    """Return the largest |left_i|/size_i, 0/0 = 0."""
    shares = np.divide(left, size, out=np.zeros(left.size), where=left != 0.0)
    return max_norm(shares)
