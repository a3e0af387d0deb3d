"""Primal active sets for dense symmetric monotone problems: one Cholesky factor, borders for the rows that change."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from ...checks import BoolVector, FloatVector
from ...kernels.floats import EPSILON

LARGEST_BORDER = 48  # changed rows beyond which a new factor is cheaper than a wider border
FIRST_SHIFT = 1e-13  # of the largest diagonal entry, where a block is not positive definite to working precision
LARGEST_SHIFT = 1e-4
SMALLEST_PIVOT = 1e-14  # of the largest, squared; below, a factor says nothing
REFINEMENTS = 20
ROUNDING = 4.0 * EPSILON


class NotConvex(ArithmeticError):
    """No small shift makes the block positive definite."""


class BorderedFactor:
    """Cholesky factor of a block of M, and of the bordered matrix where rows joined or left the block since.

    With B the columns of the border – M[block, j] for a row j that joined, a unit vector for one that left – and
    C = M[joined, joined] beside zeros, the border's own system is C − Bᵀ M_FF⁻¹ B.
    """

    def __init__(self, M: FloatVector, block: NDArray[np.intp]) -> None:
        from scipy.linalg import blas, lapack

        self._blas, self._lapack = blas, lapack
        self.M, self.block = M, block
        self.position = np.full(M.shape[0], -1)
        self.position[block] = np.arange(block.size)
        self.shift = 0.0
        self.work = 0.0
        largest = float(M.diagonal()[block].max(initial=0.0))
        while True:
            matrix = M.take(block, 0).take(block, 1) if block.size < M.shape[0] else M.copy()
            if self.shift:
                matrix.flat[:: block.size + 1] += self.shift
            # The transpose of a symmetric row-major array is what LAPACK calls column-major: no copy.
            self._factor, info = lapack.dpotrf(matrix.T, lower=1, overwrite_a=1, clean=0)
            self.work += block.size**3 / 6.0
            pivots = self._factor.diagonal()
            if info == 0 and (block.size == 0 or pivots.min() ** 2 >= SMALLEST_PIVOT * pivots.max() ** 2):
                break
            self.shift = max(100.0 * self.shift, FIRST_SHIFT * largest)
            if not 0.0 < self.shift <= LARGEST_SHIFT * largest:
                raise NotConvex
        self.rows: list[int] = []
        self._row_array = np.zeros(LARGEST_BORDER, dtype=np.intp)
        self._joined = np.zeros(LARGEST_BORDER, dtype=bool)
        self._columns = np.empty((block.size, LARGEST_BORDER), order="F")
        self._products = np.zeros((LARGEST_BORDER, LARGEST_BORDER))

    @property
    def is_full(self) -> bool:
        """True where the border has no room left."""
        return len(self.rows) >= LARGEST_BORDER

    def free(self, j: int) -> None:
        """Let row j join the block."""
        if j in self.rows:
            self._forget(j)
        else:
            self._extend(j, self.M[j, self.block], joined=True)

    def fix(self, j: int) -> None:
        """Let row j leave the block."""
        if j in self.rows:
            self._forget(j)
        else:
            unit = np.zeros(self.block.size)
            unit[self.position[j]] = 1.0
            self._extend(j, unit, joined=False)

    def solve(self, right: FloatVector) -> FloatVector:
        """Return d, shape (n,): M d = right on the present rows, d = 0 on the others."""
        k, trsv = len(self.rows), self._blas.dtrsv
        d = np.zeros(self.M.shape[0])
        half = right[self.block]
        if half.size:
            half = trsv(self._factor, half, lower=1, overwrite_x=1)
        self.work += self.block.size**2
        if k:
            V, joined, rows = self._columns[:, :k], self._joined[:k], self._row_array[:k]
            border = np.where(joined, right[rows], 0.0) - half @ V
            _, _, multiplier, info = self._lapack.dgesv(self._products[:k, :k], border)
            if info != 0:
                raise NotConvex
            half -= V @ multiplier
        if half.size:
            d[self.block] = trsv(self._factor, half, lower=1, trans=1, overwrite_x=1)
        if k:
            d[rows] = np.where(joined, multiplier, 0.0)
        return d

    def _extend(self, j: int, column: FloatVector, *, joined: bool) -> None:
        k = len(self.rows)
        if column.size:
            column = self._blas.dtrsv(self._factor, column, lower=1)
        self._columns[:, k] = column
        self.work += 0.5 * self.block.size**2
        self.rows.append(j)
        self._row_array[k], self._joined[k] = j, joined
        products = -(column @ self._columns[:, : k + 1])
        if joined:
            is_joined = self._joined[: k + 1]
            products[is_joined] += self.M[j, self._row_array[: k + 1][is_joined]]
            products[k] += self.shift
        self._products[k, : k + 1] = products
        self._products[: k + 1, k] = products

    def _forget(self, j: int) -> None:
        """Take row j out of the border; the last one takes its place."""
        at, last = self.rows.index(j), len(self.rows) - 1
        self._columns[:, at] = self._columns[:, last]
        self._products[at, : last + 1] = self._products[last, : last + 1]
        self._products[: last + 1, at] = self._products[: last + 1, last]
        self._products[at, at] = self._products[last, last]
        self.rows[at] = self._row_array[at] = self.rows[last]
        self._joined[at] = self._joined[last]
        self.rows.pop()


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
        self.M, self.q, self.lower, self.upper = M, q, lower, upper
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
        """Search until solved or `limit` rows were fixed; yield after each factor and each minimisation."""
        try:
            while not self.is_solved and limit > 0:
                factor = BorderedFactor(self.M, np.flatnonzero(self.is_free))
                counted = 0.0
                for _ in self._with(factor):
                    limit -= 1
                    self.work += factor.work - counted
                    counted = factor.work
                    if factor.is_full or limit <= 0:
                        break
                else:
                    self.work += factor.work - counted
                self._update_slack()
                yield
        except NotConvex:
            return

    def _with(self, factor: BorderedFactor) -> Iterator[None]:
        """Search with one factor; yield at every row that is fixed or set of rows that is freed."""
        last, refinements = np.inf, 0
        while True:
            d = factor.solve(np.where(self.is_free, -self.w, 0.0))
            if not np.isfinite(d).all():
                raise NotConvex
            length, row = self._first_bound(d)
            if length < 1.0:
                self.z += length * d
                self.z[row] = self.upper[row] if d[row] > 0.0 else self.lower[row]
                self.w[self.is_free] *= 1.0 - length
                self.is_free[row] = False
                factor.fix(row)
                yield
                continue
            self.z += d
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
                return
            self.is_free[wrong] = True
            if len(factor.rows) + wrong.size > LARGEST_BORDER:
                yield
                return
            for j in wrong:
                factor.free(int(j))
            yield

    def _first_bound(self, d: FloatVector) -> tuple[float, int]:
        """Return the largest step ≤ 1 within the bounds, and the row that stops it (−1 for none)."""
        after = self.z + d
        stops = np.flatnonzero(self.is_free & ((after < self.lower) | (after > self.upper)))
        if stops.size == 0:
            return 1.0, -1
        moves = d[stops]
        room = np.where(moves > 0.0, self.upper[stops], self.lower[stops]) - self.z[stops]
        lengths = room / moves
        first = int(np.argmin(lengths))
        return min(max(float(lengths[first]), 0.0), 1.0 - EPSILON), int(stops[first])

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
