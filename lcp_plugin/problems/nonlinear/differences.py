"""The derivative of a function by differences: columns that share no row are moved together.

References
----------
A. R. Curtis, M. J. D. Powell, J. K. Reid, *On the estimation of sparse Jacobian matrices*, IMA J. Appl. Math. 13
(1974), doi:10.1093/imamat/13.1.117.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from ...core.checks import BoolVector, FloatVector
from ...core.errors import InvalidProblem
from ...core.kernels.floats import EPSILON

DENSE_PATTERN_UP_TO = 1000  # unknowns, each of which costs an evaluation of F a derivative
STEP = float(np.sqrt(EPSILON))  # of |x_i|: rounding and curvature take about as many digits
SMALL = 1e-3  # beside a step that is made for unknowns of the size 1
ROUNDINGS, TOLD = 4.0, 1024.0  # of F: a difference is one, or none


class Differences:
    """Forward differences on one pattern.

    Parameters
    ----------
    pattern : csc_array, shape (n, n)
    groups : array of int, shape (n,)
        The number of the group with which each column is moved.
    """

    def __init__(self, pattern: sp.csc_array, groups: NDArray[np.int32]) -> None:
        self.pattern, self.groups = pattern, groups
        self._columns = np.repeat(np.arange(pattern.shape[1]), np.diff(pattern.indptr))

    @classmethod
    def on(cls, pattern: sp.csc_array | None, n: int) -> Differences:
        """Return the differences on a pattern, or where there is none on all places.

        Raises
        ------
        InvalidProblem
            Where all places would be too many.
        """
        if pattern is None:
            if n > DENSE_PATTERN_UP_TO:
                raise InvalidProblem(
                    f"differences on all {n}×{n} places take {n} evaluations of F a derivative, and are made up to "
                    f"n = {DENSE_PATTERN_UP_TO}; give a jacobian, or the pattern of its entries as a sparse array"
                )
            return cls(sp.csc_array(np.ones((n, n))), np.arange(n, dtype=np.int32))
        from .kernels import colour_columns

        rows = sp.csr_array(pattern)
        groups = np.full(n, -1, dtype=np.int32)
        colour_columns(
            pattern.indptr.astype(np.int64),
            pattern.indices.astype(np.int64),
            rows.indptr.astype(np.int64),
            rows.indices.astype(np.int64),
            groups,
        )
        return cls(pattern, groups)

    @np.errstate(all="ignore")
    def at(
        self,
        F: Callable[[FloatVector], FloatVector],
        x: FloatVector,
        value: FloatVector,
        lower: FloatVector,
        upper: FloatVector,
    ) -> sp.csr_array:
        """Return the derivative at x, where F has that value; steps stay within the bounds where these are apart.

        Where F is not defined at one side of x, the other one is asked; what remains is NaN. Where |x_j| ≪ 1 that may
        be its unit: a step of its size counts where it tells something else, and four times that step says the same.
        What rounding of the terms of F explains is 0.
        """
        step = _steps(np.maximum(np.abs(x), 1.0), x, lower, upper)
        small = np.where(np.abs(x) < SMALL, _steps(np.abs(x), x, lower, upper), 0.0)
        derivative, steps = np.empty(self.pattern.nnz), np.abs(step)[self._columns]
        for members, places in self._groups():
            found = self._quotients(F, x, value, np.where(members, step, 0.0), places)
            if not np.isfinite(found).all():
                found = np.where(
                    np.isfinite(found),
                    found,
                    self._quotients(F, x, value, np.where(members, -step, 0.0), places),
                )
            if (shorter := np.where(members, small, 0.0)).any():
                near = self._quotients(F, x, value, shorter, places)
                if not _agree(near, found).all():
                    other = self._quotients(F, x, value, 4.0 * shorter, places)
                    least = TOLD * EPSILON * np.abs(value)[self.pattern.indices[places]]
                    is_clear = _agree(near, other) & ~_agree(near, found)
                    is_clear &= np.abs(near * shorter[self._columns[places]]) > least
                    found = np.where(is_clear, near, found)
                    steps[places] = np.where(is_clear, np.inf, steps[places])
            derivative[places] = found
        derivative = self._without_rounding(derivative, x, value, steps)
        pattern = self.pattern
        return sp.csr_array(
            sp.csc_array((derivative, pattern.indices, pattern.indptr), shape=pattern.shape)
        )

    def _without_rounding(
        self, derivative: FloatVector, x: FloatVector, value: FloatVector, steps: FloatVector
    ) -> FloatVector:
        """Return the entries with 0 for those whose difference is no more than a few roundings of their row's terms."""
        rows, products = self.pattern.indices, derivative * x[self._columns]
        rest = value - np.bincount(rows, products, value.size)
        terms = np.abs(rest) + np.bincount(rows, np.abs(products), value.size)
        is_rounding = np.abs(derivative) * steps <= ROUNDINGS * EPSILON * terms[rows]
        return np.where(is_rounding, 0.0, derivative)

    def _groups(self) -> Iterator[tuple[NDArray[np.bool_], NDArray[Any]]]:
        """Yield the columns of each group, and the places of their entries."""
        of_entries = self.groups[self._columns]
        order = np.argsort(of_entries, kind="stable")
        ends = np.searchsorted(of_entries[order], np.arange(int(self.groups.max(initial=-1)) + 2))
        for k in range(ends.size - 1):
            yield self.groups == k, order[ends[k] : ends[k + 1]]

    def _quotients(
        self,
        F: Callable[[FloatVector], FloatVector],
        x: FloatVector,
        value: FloatVector,
        step: FloatVector,
        places: NDArray[Any],
    ) -> FloatVector:
        moved = x + step
        difference = F(moved) - value
        quotient: FloatVector = (
            difference[self.pattern.indices[places]] / (moved - x)[self._columns[places]]
        )
        return quotient


def _agree(one: FloatVector, other: FloatVector) -> BoolVector:
    """Return where two quotients differ by a hundredth at most; a NaN agrees with nothing."""
    agree: BoolVector = np.abs(one - other) <= 0.01 * np.maximum(np.abs(one), np.abs(other))
    return agree


def _steps(
    size: FloatVector, x: FloatVector, lower: FloatVector, upper: FloatVector
) -> FloatVector:
    """Return how far each unknown is moved: away from 0, but towards the bound that is farther where one is near."""
    length = STEP * size
    above, below = upper - x, x - lower
    sign = np.where(x < 0.0, -1.0, 1.0)
    ahead, behind = np.where(sign > 0.0, above, below), np.where(sign > 0.0, below, above)
    steps: FloatVector = np.where((ahead < length) & (behind > ahead), -sign, sign) * length
    return steps
