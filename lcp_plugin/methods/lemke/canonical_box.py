"""Any dense box or mixed problem as 0 ≤ z ≤ u with u > 0: fixed, free and flipped rows taken out, rows scaled."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...core.checks import FloatVector
from ...core.lcp import LCP
from ...core.matrix.structure import equation_signs
from ...systems.equilibration import power_of_two

FloatMatrix = NDArray[np.float64]
IndexVector = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class CanonicalBox:
    """Canonical problem (M, q, upper), and the inverse mapping z[rows] = offset[rows] + step z̄ with the elimination.

    Attributes
    ----------
    M : ndarray, shape (k, k)
        The largest entry of each row is about 1.
    q, upper : ndarray, shape (k,)
        max |q_i| is about 1; upper > 0.
    offset : ndarray, shape (n,)
    rows : ndarray, shape (k,)
        Variable of the problem for each canonical variable, up to shift, sign and scale; split variables appear twice.
    step : ndarray, shape (k,)
        Change of that variable per unit of the canonical variable; negative if the bounds are exchanged.
    eliminated : ndarray, shape (g,)
        Eliminated free variables.
    elimination : ndarray, shape (g, k)
        Change of each eliminated variable per unit of a canonical variable.
    """

    M: FloatMatrix
    q: FloatVector
    upper: FloatVector
    offset: FloatVector
    rows: IndexVector
    step: FloatVector
    eliminated: IndexVector
    elimination: FloatMatrix

    @property
    def work(self) -> float:
        """Entries that the elimination touched: a factorization and its solves."""
        g, k = self.eliminated.size, float(self.q.size)
        return g * (g * g / 3.0 + g * k + k * k)

    @property
    def is_finite(self) -> bool:
        """True if all arrays are finite."""
        return all(
            bool(np.isfinite(part).all())
            for part in (self.M, self.q, self.step, self.elimination, self.offset)
        )

    def recover(self, z: FloatVector) -> FloatVector:
        """Return the z of the problem, shape (n,), for one of the canonical problem, shape (k,)."""
        result = np.array(self.offset)
        np.add.at(result, self.rows, self.step * z)
        result[self.eliminated] += self.elimination @ z
        return result


def canonical_box(problem: LCP) -> CanonicalBox:
    """Return the problem in canonical form; M is made dense.

    Fixed rows (lower = upper) go into q. Rows with an upper bound only change sign. Free rows are eliminated
    if their block is well conditioned; otherwise each free variable becomes the difference of two nonnegative ones.
    """
    M = problem.matrix.toarray()
    row_scale = 1 - np.frexp(problem.matrix.row_largest)[1]
    is_free = (problem.lower == -np.inf) & (problem.upper == np.inf)
    sign = np.where((problem.lower == -np.inf) & ~is_free, -1.0, 1.0)
    base = np.where(is_free, 0.0, np.where(sign > 0.0, problem.lower, problem.upper))
    # The scale of a row may take its q to the exponent 1000.
    row_scale = np.minimum(row_scale, 1000 - np.frexp(problem.q)[1])
    M, column_scale, more = _equilibrated(np.ldexp(M, row_scale[:, None]))
    row_scale = row_scale + more
    is_void = (problem.q == 0.0) & ~M.any(axis=1)
    if is_void.any():
        # A zero row is always satisfied. With minus its column as row i, z_i acts like a multiplier of the other rows.
        M = np.where(is_void[:, None], -M.T, M)
    rows = sign * equation_signs(M, is_free)
    M = M * rows[:, None] * sign
    q = np.ldexp(problem.q, row_scale) * rows + M @ np.ldexp(base * sign, -column_scale)
    upper = np.where(is_free, np.inf, np.ldexp(problem.upper - problem.lower, -column_scale))
    unit = np.ldexp(sign, column_scale)
    keep = np.flatnonzero(problem.lower < problem.upper)
    if keep.size < problem.n:
        M = M[np.ix_(keep, keep)]
    return _without_free_rows(M, q[keep], upper[keep], unit, base, keep, is_free[keep])


def _equilibrated(M: FloatMatrix) -> tuple[FloatMatrix, IndexVector, IndexVector]:
    """Return M with columns and rows of size 1 and the exponents of both, which are 0 if the units are alike."""
    column, row = np.zeros((2, len(M)), np.intp)
    for _ in range(8):
        change = -np.frexp(np.abs(M).max(axis=0, initial=0.0))[1]
        # Columns whose sizes differ by less stay.
        if np.abs(change).max(initial=0) <= 10:
            break
        M, column = np.ldexp(M, change), column + change
        change = 1 - np.frexp(np.abs(M).max(axis=1, initial=0.0))[1]
        M, row = np.ldexp(M, change[:, None]), row + change
    return M, column, row


def _without_free_rows(
    M: FloatMatrix,
    q: FloatVector,
    upper: FloatVector,
    unit: FloatVector,
    base: FloatVector,
    keep: IndexVector,
    is_free: NDArray[np.bool_],
) -> CanonicalBox:
    free, stays = np.flatnonzero(is_free), np.flatnonzero(~is_free)
    eliminated = _solved(M, q, free, stays)
    offset, gone, elimination = base.copy(), free[:0], np.empty((0, keep.size))
    rows, step = keep, unit[keep]
    if eliminated is None:  # z_i = z_i⁺ − z_i⁻ on the free rows
        M = np.block([[M, -M[:, free]], [-M[free], M[np.ix_(free, free)]]])
        q, upper = np.concatenate([q, -q[free]]), np.concatenate([upper, upper[free]])
        rows, step = np.concatenate([rows, rows[free]]), np.concatenate([step, -step[free]])
        elimination = np.empty((0, q.size))
    elif free.size:
        gone, elimination = free, eliminated[:, :-1]
        offset[keep[free]] += eliminated[:, -1] * unit[keep[free]]
        to = M[np.ix_(stays, free)]
        M, q = M[np.ix_(stays, stays)] + to @ elimination, q[stays] + to @ eliminated[:, -1]
        upper, rows, step = upper[stays], rows[stays], step[stays]
    size = power_of_two(np.abs(q).max(initial=0.0))
    elimination = elimination * (unit[keep[gone]] * size)[:, None]
    return CanonicalBox(
        M, q / size, upper / size, offset, rows, step * size, keep[gone], elimination
    )


def _solved(
    M: FloatMatrix, q: FloatVector, free: IndexVector, stays: IndexVector
) -> FloatMatrix | None:
    """Return the free variables as −M_FF⁻¹ (M_FR, q_F), shape (f, r + 1); None if that block is ill-conditioned."""
    if not free.size:
        return np.empty((0, stays.size + 1))
    try:
        inverse = np.linalg.inv(M[np.ix_(free, free)])
    except np.linalg.LinAlgError:
        return None
    condition = np.linalg.norm(inverse, 1) * np.linalg.norm(M[np.ix_(free, free)], 1)
    if not condition < 1e8:
        return None
    right = np.column_stack([M[np.ix_(free, stays)], q[free]])
    return np.asarray(np.linalg.solve(M[np.ix_(free, free)], -right), dtype=np.float64)
