"""Primal active sets for dense symmetric monotone problems: one Cholesky factor, updated for the rows that change."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from ...core.checks import BoolVector, FloatVector, read_only
from ...core.kernels.floats import EPSILON

CHANGES = 48  # beside half as many as there are rows: after so many a new factor takes the rounding away
WORK_A_STEP = 5e7  # entries touched beyond those of CHANGES, about: a run has to be able to end
FIRST_SHIFT = 1e-13  # of the largest diagonal entry, where a block is not positive definite to working precision
LARGEST_SHIFT = 1e-4
SMALLEST_PIVOT = 1e-14  # of the largest, squared; below, a factor says nothing
REFINEMENTS = 20
ROUNDING = 4.0 * EPSILON


class NotConvex(ArithmeticError):
    """No small shift makes the block positive definite."""


class UpdatedFactor:
    """Cholesky factor of the block of M that belongs to some rows, as they leave and join."""

    def __init__(self, M: FloatVector, rows: NDArray[np.intp]) -> None:
        from scipy.linalg import lapack

        self.M, self.size = M, rows.size
        self.shift = 0.0
        self.work = 0.0
        largest = float(M.diagonal()[rows].max(initial=0.0))
        while True:
            block = M.take(rows, 0).take(rows, 1) if rows.size < M.shape[0] else M.copy()
            if self.shift:
                block.flat[:: rows.size + 1] += self.shift
            # The transpose of a symmetric row-major array is what LAPACK calls column-major: no copy.
            upper, info = lapack.dpotrf(block.T, lower=0, overwrite_a=1, clean=0)
            self.work += rows.size**3 / 6.0
            pivots = upper.diagonal()
            if info == 0 and (rows.size == 0 or pivots.min() ** 2 >= SMALLEST_PIVOT * pivots.max() ** 2):
                break
            self.shift = max(100.0 * self.shift, FIRST_SHIFT * largest)
            if not 0.0 < self.shift <= LARGEST_SHIFT * largest:
                raise NotConvex
        capacity = min(M.shape[0], rows.size + rows.size // 4 + CHANGES)
        self._lower = np.empty((capacity, capacity))
        self._lower[: rows.size, : rows.size] = upper.T
        self._order = np.empty(capacity, dtype=np.intp)
        self._order[: rows.size] = rows

    def join(self, rows: NDArray[np.intp]) -> bool:
        """Let rows join; return False, and be of no more use, where the arrays are full or the block seems singular."""
        from .kernels import triangles

        if self.size + rows.size > self._order.size:
            return False
        self.work += 0.5 * rows.size * self.size**2
        self.size = triangles.join(self.M, self.shift, self._lower, self._order, self.size, rows)
        return self.size >= 0

    def minimise(self, search: PrimalActiveSet, limit: int) -> tuple[bool, int]:
        """Minimise over the free rows of the search, which are those of the factor; rows that meet a bound leave.

        Return whether the minimum was reached before `limit` rows left, and how many did.
        """
        from .kernels import triangles

        before = self.size
        outcome, self.size, fixed = triangles.minimise(
            self._lower, self._order, before, search.lower, search.upper, search.z, search.w, search.is_free, limit
        )
        self.work += (1.5 * fixed + 1.0) * before**2
        if outcome == triangles.SINGULAR:
            raise NotConvex
        return outcome == triangles.FREE, fixed


class PrimalActiveSet:
    """min ½ zᵀM z + qᵀz over lower ≤ z ≤ upper, M dense, symmetric, positive semidefinite up to rounding.

    From a point within the bounds: minimise over the free rows, stop at the first bound that is met and fix that row;
    where none is met, free all rows whose w has the wrong sign. The energy falls at every step.

    Attributes
    ----------
    z, w : ndarray, shape (n,)
    is_solved : bool
        No row's w has the wrong sign, and w = 0 on the free rows, to rounding.
    work : float
        Matrix entries touched.
    """

    def __init__(self, M: FloatVector, q: FloatVector, lower: FloatVector, upper: FloatVector) -> None:
        self.M, self.q, self.lower, self.upper = read_only(np.ascontiguousarray(M).view()), q, lower, upper
        self._root = np.sqrt(np.maximum(M.diagonal(), 0.0))
        self._is_fixed = lower == upper
        self.work = 0.0
        self.is_solved = False

    def start(self, z: FloatVector, is_free: BoolVector) -> None:
        """Begin at z, within the bounds; rows that are not free go to the nearer bound."""
        at_bound = np.where(self.upper - z < z - self.lower, self.upper, self.lower)
        self.is_free = is_free & ~self._is_fixed | ~np.isfinite(at_bound)
        self.z = np.where(self.is_free, z, at_bound)
        self._update_slack()
        self.is_free |= self._wrong()
        self.is_solved = False

    def steps(self, limit: int) -> Iterator[None]:
        """Search until solved or `limit` changes were made; yield after each factor."""
        try:
            while not self.is_solved and limit > 0:
                factor = UpdatedFactor(self.M, np.flatnonzero(self.is_free))
                affordable = int(WORK_A_STEP / (2.0 * factor.size**2 + 1.0))
                limit -= self._search_with(factor, min(limit, CHANGES + min(factor.size // 2, affordable)))
                self.work += factor.work
                self._update_slack()
                yield
        except NotConvex:
            return

    def _search_with(self, factor: UpdatedFactor, limit: int) -> int:
        """Search with one factor; return how many rows were fixed, and sets of rows freed."""
        made, last, refinements = 0, np.inf, 0
        while made < limit:
            is_lowest, fixed = factor.minimise(self, limit - made)
            made += fixed
            if not is_lowest:
                break
            self._update_slack()
            left = np.where(self.is_free, np.abs(self.w), 0.0)
            error = float(left.max(initial=0.0))
            if error < 0.5 * last and refinements < REFINEMENTS and np.any(left > self._rounding()):
                last, refinements = error, refinements + 1
                continue
            last, refinements = np.inf, 0
            wrong = np.flatnonzero(self._wrong())
            if wrong.size == 0:
                self.is_solved = True
                break
            self.is_free[wrong] = True
            made += 1
            if not factor.join(wrong):
                break
        return made

    def _wrong(self) -> BoolVector:
        """Return the rows at a bound whose w points inwards by more than rounding."""
        allowed = self._rounding()
        inwards = ((self.z == self.lower) & (self.w < -allowed)) | ((self.z == self.upper) & (self.w > allowed))
        wrong: BoolVector = inwards & ~self.is_free & ~self._is_fixed
        return wrong

    def _rounding(self) -> FloatVector:
        # |M||z| ≤ √m_ii Σ √m_jj |z_j| for a semidefinite matrix.
        size: FloatVector = self._root * float(self._root @ np.abs(self.z)) + np.abs(self.q)
        return ROUNDING * size

    def _update_slack(self) -> None:
        self.w = self.M @ self.z
        self.w += self.q
        self.work += self.M.size
