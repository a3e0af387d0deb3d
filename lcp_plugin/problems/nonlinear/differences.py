"""The derivative of a function by differences: columns that share no row are moved together.

References
----------
A. R. Curtis, M. J. D. Powell, J. K. Reid, *On the estimation of sparse Jacobian matrices*, IMA J. Appl. Math. 13
(1974), doi:10.1093/imamat/13.1.117.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import count
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from ...core.checks import FloatVector
from ...core.errors import InvalidProblem
from ...core.kernels.floats import EPSILON

DENSE_PATTERN_UP_TO = 1000  # unknowns; each costs one evaluation of F per derivative
STEP = float(np.sqrt(EPSILON))  # of max(|x_i|, 1): rounding and curvature take about as many digits


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
        of_entries = groups[self._columns]
        ends = np.cumsum(np.bincount(of_entries))[:-1]
        self._places = np.split(np.argsort(of_entries, kind="stable"), ends)

    @classmethod
    def on(cls, pattern: sp.csc_array | None, n: int) -> Differences:
        """Return the differences on a pattern; None means all entries.

        Raises
        ------
        InvalidProblem
            If the pattern is None and n > 1000.
        """
        if pattern is None:
            if n > DENSE_PATTERN_UP_TO:
                raise InvalidProblem(
                    f"differences on all {n}×{n} places take {n} evaluations of F a derivative, and are made up to "
                    f"n = {DENSE_PATTERN_UP_TO}; give a jacobian, or the pattern of its entries as a sparse array"
                )
            return cls(sp.csc_array(np.ones((n, n))), np.arange(n, dtype=np.int32))
        met: list[set[int]] = [set() for _ in range(n)]  # groups of the columns that meet a row
        groups = np.zeros(n, dtype=np.int32)
        for j in range(n):
            rows = pattern.indices[pattern.indptr[j] : pattern.indptr[j + 1]]
            taken = set().union(*(met[i] for i in rows))
            groups[j] = group = next(k for k in count() if k not in taken)
            for i in rows:
                met[i].add(group)
        return cls(pattern, groups)

    def at(
        self,
        F: Callable[[FloatVector], FloatVector],
        x: FloatVector,
        value: FloatVector,
        lower: FloatVector,
        upper: FloatVector,
    ) -> Any:
        """Return the derivative at x, dense if the pattern is full, given F(x), by steps within the bounds.

        If F is not defined on one side of x, the step goes to the other side. Entries that neither side gives are
        NaN.
        """
        pattern, columns = self.pattern, self._columns
        step, derivative = _steps(x, lower, upper), np.full(pattern.nnz, np.nan)
        for k, places in enumerate(self._places):
            for way in (step, -step):
                moved = np.where(self.groups == k, x + way, x)
                change = F(moved) - value
                found = change[pattern.indices[places]] / (moved - x)[columns[places]]
                known = derivative[places]
                derivative[places] = np.where(np.isfinite(known), known, found)
                if np.isfinite(derivative[places]).all():
                    break
        found = sp.csc_array((derivative, pattern.indices, pattern.indptr), shape=pattern.shape)
        is_full = pattern.nnz == math.prod(pattern.shape)
        return found.toarray() if is_full else sp.csr_array(found)


def _steps(x: FloatVector, lower: FloatVector, upper: FloatVector) -> FloatVector:
    """Return the step of each unknown: away from 0, or to the farther bound if a bound is close."""
    length = STEP * np.maximum(np.abs(x), 1.0)
    above, below = upper - x, x - lower
    sign = np.where(x < 0.0, -1.0, 1.0)
    ahead, behind = np.where(sign > 0.0, above, below), np.where(sign > 0.0, below, above)
    steps: FloatVector = np.where((ahead < length) & (behind > ahead), -sign, sign) * length
    return steps
