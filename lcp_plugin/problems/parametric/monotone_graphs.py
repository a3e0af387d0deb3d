"""Parametric complementarity problem: monotone graphs with data affine in a parameter.

Let w = M z + q. The pair (z_i, w_i) of row i lies on a staircase that falls to the right: at z = p₀ any w ≥ v₁, w =
v₁ for p₀ ≤ z ≤ p₁, at p₁ any w from v₁ down to v₂, w = v₂ for p₁ ≤ z ≤ p₂, at p₂ any w ≤ v₂. Bounds are a staircase
with p₀ = lower, p₁ = upper, v₁ = 0. A penalty λ|z| within bounds is a staircase with p = (lower, 0, upper) and v =
(λ, −λ).

Step 2k of a staircase is its segment at z = p_k, and step 2k + 1 is its segment at w = v_{k+1}. A row is free on
odd steps.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from ...core.checks import FloatVector
from ...core.matrix.matrix import largest_in_rows
from ...core.matrix.structure import IntVector

FIXED_LEVELS = 4  # of w: +∞, two values, −∞
CORNERS = 3  # of z
ALIKE = 1e3  # rows and columns whose sizes differ by at most this ratio are not scaled
EQUILIBRATED = 8  # passes


class Columns:
    """The columns of M, computed on demand.

    Parameters
    ----------
    M : ndarray or sparse array, shape (n, n)

    Attributes
    ----------
    sizes : ndarray, shape (n,)
        The largest |m_ij| of each row.
    """

    def __init__(self, M: Any) -> None:
        self.n = M.shape[0]
        self._columns: Any = sp.csc_array(M) if sp.issparse(M) else np.ascontiguousarray(M.T)
        of_rows = largest_in_rows(sp.csr_array(M) if sp.issparse(M) else M)
        self.sizes: FloatVector = np.maximum(
            np.asarray(of_rows, dtype=np.float64), np.finfo(np.float64).tiny
        )

    def units(self) -> FloatVector:
        """Return powers of two d that equilibrate D M D; all 1 if M is equilibrated already."""
        size, units = abs(self._columns), np.ones(self.n)
        if not self.n or not _differ(_largest(size)):
            return units
        for _ in range(EQUILIBRATED):
            units /= np.sqrt(_largest(units[:, np.newaxis] * size * units))
        return _powers(units)

    def rescale(self, units: FloatVector) -> Columns:
        """Return the columns of D M D."""
        return Columns((units[:, np.newaxis] * self._columns * units).T)

    def many(self, numbers: Any) -> FloatVector:
        """Return some columns as rows of an array, shape (k, n)."""
        chosen = (
            self._columns[:, numbers].T.toarray()
            if sp.issparse(self._columns)
            else self._columns[numbers]
        )
        return np.asarray(chosen)


class GramColumns(Columns):
    """The columns of AᵀA + ridge I; the matrix itself is not computed.

    Parameters
    ----------
    A : ndarray or sparse array, shape (m, n)
    ridge : float or ndarray, shape (n,)
    """

    def __init__(self, A: Any, ridge: float | FloatVector) -> None:
        self.n, self._ridge = A.shape[1], np.broadcast_to(np.asarray(ridge), A.shape[1:])
        self._A = A
        self._transpose = sp.csr_array(A.T) if sp.issparse(A) else np.ascontiguousarray(A.T)
        squares = (
            np.asarray(abs(A).power(2).sum(axis=0)).ravel()
            if sp.issparse(A)
            else np.einsum("ij,ij->j", A, A)
        )
        self._lengths = np.sqrt(squares)
        sizes = self._lengths * self._lengths.max(initial=0.0) + self._ridge
        self.sizes = np.maximum(sizes, np.finfo(np.float64).tiny)

    def units(self) -> FloatVector:
        """Return powers of two d that make the diagonal of D M D about 1; 1 if balanced."""
        size = np.hypot(self._lengths, np.sqrt(self._ridge))
        size = np.where(size > 0.0, size, 1.0)
        return _powers(1.0 / size) if _differ(size) else np.ones(self.n)

    def rescale(self, units: FloatVector) -> Columns:
        """Return the columns of D M D."""
        A = (
            sp.csr_array(self._A @ sp.diags_array(units))
            if sp.issparse(self._A)
            else self._A * units
        )
        return GramColumns(A, self._ridge * units * units)

    def many(self, numbers: Any) -> FloatVector:
        """Return some columns as rows of an array, shape (k, n)."""
        chosen = self._transpose[numbers]
        made = (chosen @ self._A).toarray() if sp.issparse(chosen) else chosen @ self._A
        made[np.arange(len(numbers)), numbers] += self._ridge[numbers]
        return np.asarray(made)


@dataclass(frozen=True, eq=False)
class MonotoneGraphs:
    """The problem at parameter t: constants and slopes, along the first axis of each array.

    Attributes
    ----------
    columns : Columns
    q : ndarray, shape (2, n)
    corners : ndarray, shape (2, 3, n)
        Corners p of each row; ∞ if a row has fewer corners.
    levels : ndarray, shape (2, 4, n)
        +∞, v₁, v₂, −∞ of each row; v₂ = −∞ if a row has two corners.
    """

    columns: Columns
    q: FloatVector
    corners: FloatVector
    levels: FloatVector

    @classmethod
    def from_bounds(
        cls, columns: Columns, q: FloatVector, lower: FloatVector, upper: FloatVector
    ) -> MonotoneGraphs:
        """Return the monotone graphs of an LCP with q, lower and upper, shape (2, n) each."""
        n = columns.n
        corners, levels = np.zeros((2, CORNERS, n)), np.zeros((2, FIXED_LEVELS, n))
        corners[:, 0], corners[:, 1], corners[0, 2] = lower, upper, np.inf
        levels[0, 0], levels[0, 2:] = np.inf, -np.inf
        return cls(columns, q, corners, levels)

    @classmethod
    def from_penalty(
        cls,
        columns: Columns,
        q: FloatVector,
        lower: FloatVector,
        upper: FloatVector,
        penalty: FloatVector,
        has_kink: NDArray[np.bool_],
    ) -> MonotoneGraphs:
        """Return the monotone graphs of bounds and of penalty · |z| in rows with a kink at 0.

        Penalties of other rows are part of q.
        """
        made = cls.from_bounds(columns, q, lower, upper)
        corners, levels = made.corners, made.levels
        corners[:, 2, has_kink], corners[:, 1, has_kink] = upper[:, has_kink], 0.0
        levels[:, 1, has_kink], levels[:, 2, has_kink] = penalty[:, has_kink], -penalty[:, has_kink]
        return made

    def rescale(self, units: FloatVector) -> MonotoneGraphs:
        """Return the problem of z / d and d w, whose matrix is D M D."""
        if (units == 1.0).all():
            return self
        return MonotoneGraphs(
            self.columns.rescale(units), self.q * units, self.corners / units, self.levels * units
        )

    @property
    def n(self) -> int:
        """The number of rows."""
        return int(self.columns.n)

    def begun_at(self, start: float, toward: float) -> MonotoneGraphs:
        """Return the problem over t with θ = start + toward · t."""
        return MonotoneGraphs(
            self.columns,
            *(_change_parameter(one, start, toward) for one in (self.q, self.corners, self.levels)),
        )

    def at(self, t: float) -> tuple[FloatVector, FloatVector, FloatVector]:
        """Return q, corners and levels as values at t and slopes."""
        q, corners, levels = (
            _change_parameter(one, t, 1.0) for one in (self.q, self.corners, self.levels)
        )
        return q, corners, levels

    def steps_of(self, t: float, z: FloatVector, w: FloatVector) -> IntVector:
        """Return the step of each row closest to (z, w) at t; corners are on even steps."""
        (_, corners, levels), size = self.at(t), self.columns.sizes
        corners, levels, scaled = corners[0], levels[0] / size, w / size
        best, steps = np.full(self.n, np.inf), np.zeros(self.n, dtype=np.int64)
        for step in range(2 * CORNERS - 1):
            k = step // 2
            if step % 2 == 0:
                outside = np.maximum(np.maximum(levels[k + 1] - scaled, scaled - levels[k]), 0.0)
                miss = np.maximum(np.abs(z - corners[k]), outside)
            else:
                outside = np.maximum(np.maximum(corners[k] - z, z - corners[k + 1]), 0.0)
                miss = np.maximum(np.abs(scaled - levels[k + 1]), outside)
            miss = np.where(np.isfinite(miss), miss, np.inf)
            order = 1.0 if step % 2 == 0 else 1.0 + 1e-9
            is_better = order * miss < best
            steps[is_better], best[is_better] = step, miss[is_better]
        return steps


def _largest(size: Any) -> FloatVector:
    """Return the largest entry of row and column j, for each j; 1 where both are 0."""
    found = np.maximum(
        *(one.toarray().ravel() if sp.issparse(one) else one for one in (size.max(0), size.max(1)))
    )
    return np.where(found > 0.0, found, 1.0)


def _differ(sizes: FloatVector) -> bool:
    return bool(sizes.max(initial=1.0) > ALIKE * sizes.min(initial=1.0))


def _powers(units: FloatVector) -> FloatVector:
    """Return the nearest powers of two, which round nothing."""
    return np.exp2(np.rint(np.log2(units)))


def _change_parameter(parts: FloatVector, t: float, toward: float) -> FloatVector:
    """Return (constant, slope) of t' with t + toward · t' for the parameter."""
    return np.stack([parts[0] + t * parts[1], toward * parts[1]])
