"""min ½ xᵀP x + cᵀx, lower ≤ x ≤ upper, P dense and semidefinite: sweeps guess the active set, descents correct it.

A descent minimises over the free unknowns with a Cholesky factor, stops at the first bound that is met, takes that row
out of the factor and goes on. Where none is met, the rows whose slope points inwards are freed, and sweeps follow. The
objective falls throughout, so that no active set comes back and a singular P needs no more than a small shift.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ...core.checks import BoolVector, FloatVector
from ...core.kernels.floats import EPSILON, TINY
from ...core.matrix.structure import IntVector
from ...systems.equilibration import power_of_two

SWEEPS, MOST_SWEEPS, SETTLED = (
    10,
    60,
    0.005,
)  # so many at once, until fewer of the rows change sides
SWEEPS_BETWEEN = 8
FACTORS = 40  # 2 to 20 as a rule
AT_ONCE = 5e7  # entries of a factor touched, about, before a run may end
FIRST_SHIFT, LARGEST_SHIFT = (
    1e-13,
    1e-4,
)  # of the largest diagonal entry, where a block is singular to rounding
SMALLEST_PIVOT = 1e-14  # of the largest: below, a factor says nothing
FEW = 0.25  # of the rows of a factor may join it
ROUNDING = 4.0 * EPSILON


class Descent:
    """The search for the minimum.

    Attributes
    ----------
    x, slope : array, shape (n,)
        A point within the bounds, and P x + c.
    work : float
        Entries of P touched so far.

    Examples
    --------
    >>> P, c = np.array([[2.0, 1.0], [1.0, 2.0]]), np.array([-5.0, 1.0])
    >>> search = Descent(P, c, np.zeros(2), np.full(2, np.inf))
    >>> for x in search.points(): pass
    >>> x
    array([2.5, 0. ])
    """

    def __init__(
        self, P: FloatVector, c: FloatVector, lower: FloatVector, upper: FloatVector
    ) -> None:
        self._unit = 1.0 / power_of_two(np.sqrt(np.maximum(P.diagonal(), 0.0)))
        self.P, self.c = self._unit[:, np.newaxis] * P * self._unit, c * self._unit
        self.lower, self.upper = lower / self._unit, upper / self._unit
        self._root = np.sqrt(np.maximum(self.P.diagonal(), 0.0))
        self.x = np.clip(np.zeros(c.size), self.lower, self.upper)
        self.work, self._shift, self._order, self._L = 0.0, 0.0, np.arange(0), np.zeros((0, 0))
        self._look()

    def points(self) -> Iterator[FloatVector]:
        """Yield a point for each factor; the last is the minimum, unless P is not semidefinite or it takes too long."""
        sweeps, changes, free = 0, self.x.size, np.zeros(self.x.size, np.bool_)
        while sweeps < MOST_SWEEPS and changes > SETTLED * self.x.size:
            before, free, sweeps = free, self._swept(SWEEPS), sweeps + SWEEPS
            changes = int(np.count_nonzero(before != free))
        for _ in range(FACTORS):
            free |= self._inwards()
            new = np.setdiff1d(np.flatnonzero(free), self._order)
            is_near = free[self._order].all() and new.size <= FEW * self._order.size
            if not (is_near and self._joined(new)) and not self._factorised(np.flatnonzero(free)):
                return
            is_lowest = self._descended(free)
            if is_lowest is None:
                return
            yield self.x * self._unit
            if is_lowest and not self._inwards().any():
                return
            free = self._swept(SWEEPS_BETWEEN)

    def _look(self) -> None:
        self.slope = self.P @ self.x + self.c
        self.work += self.P.size

    def _swept(self, count: int) -> BoolVector:
        """Sweep; return the rows that are at no bound."""
        from .kernels import sweep

        inverse = np.divide(1.0, self._root**2, out=np.zeros(self.x.size), where=self._root > 0.0)
        sweep(self.P, inverse, self.lower, self.upper, self.x, self.slope, count)
        self.work += (count - 1.0) * self.P.size
        self._look()
        return np.asarray((self.lower < self.x) & (self.x < self.upper))

    def _rounding(self) -> FloatVector:
        # |P||x| ≤ √p_ii Σ √p_jj |x_j| for a semidefinite matrix.
        rounding: FloatVector = ROUNDING * (
            self._root * float(self._root @ np.abs(self.x)) + np.abs(self.c)
        )
        return rounding

    def _inwards(self) -> BoolVector:
        """Return the rows at a bound whose slope points inwards by more than rounding."""
        at_lower, at_upper, rounding = self.x == self.lower, self.x == self.upper, self._rounding()
        return np.asarray(
            (at_lower & ~at_upper & (self.slope < -rounding))
            | (at_upper & ~at_lower & (self.slope > rounding))
        )

    def _factorised(self, rows: IntVector) -> bool:
        """Factorise these rows of P, with a small shift if need be; return False where none is enough."""
        block = self.P.take(rows, 0).take(rows, 1)
        largest, self._shift = float(block.diagonal().max(initial=0.0)), 0.0
        while self._shift <= LARGEST_SHIFT * largest:
            self.work += rows.size**3 / 6.0
            if (L := _cholesky(block, self._shift)) is not None:
                self._L, self._order = L, rows
                return True
            self._shift = max(100.0 * self._shift, FIRST_SHIFT * largest, TINY)
        return False

    def _joined(self, rows: IntVector) -> bool:
        """Let rows join the factor; return False where it is too near to a singular one."""
        from scipy.linalg import solve_triangular

        of_both = solve_triangular(
            self._L, self.P[np.ix_(self._order, rows)], lower=True, check_finite=False
        )
        self.work += 0.5 * rows.size * self._order.size**2
        L = _cholesky(self.P[np.ix_(rows, rows)] - of_both.T @ of_both, self._shift)
        if L is not None:
            self._L = np.block([[self._L, np.zeros(of_both.shape)], [of_both.T, L]])
            self._order = np.append(self._order, rows)
        return L is not None

    def _descended(self, free: BoolVector) -> bool | None:
        """Descend; return whether the minimum over the free rows is reached, None where there is none."""
        from .kernels import descend

        residual = np.inf
        while (size := self._order.size) > 0:
            least = size - 2 - int(AT_ONCE / size**2)
            left = descend(
                self._L, self._order, least, self.lower, self.upper, self.x, self.slope, free
            )
            self.work += (1.5 * (size - left) + 1.0) * size**2
            if left < 0:
                return None
            self._L, self._order = np.ascontiguousarray(self._L[:left, :left]), self._order[:left]
            self._look()
            if left <= least:
                return False
            before, residual = residual, float(np.abs(self.slope[self._order]).max(initial=0.0))
            if not (
                residual < 0.5 * before
                and (np.abs(self.slope) > self._rounding())[self._order].any()
            ):
                break
        return True


def _cholesky(block: FloatVector, shift: float) -> FloatVector | None:
    """Return the lower Cholesky factor of a symmetric block and a shift of its diagonal, None where it says nothing."""
    from scipy.linalg.lapack import dpotrf

    shifted = block.copy()
    shifted.flat[:: block.shape[0] + 1] += shift
    # The transpose of a symmetric array in C's order is what LAPACK takes without a copy.
    upper, failed = dpotrf(shifted.T, lower=0, overwrite_a=1, clean=1)
    pivots = upper.diagonal() ** 2
    is_clear = not failed and pivots.min(initial=np.inf) >= SMALLEST_PIVOT * block.diagonal().max(
        initial=0.0
    )
    return np.ascontiguousarray(upper.T) if is_clear else None
