"""Any dense box or mixed problem as 0 ≤ z ≤ u with u > 0: fixed, free and flipped rows taken out, M scaled."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...core.checks import FloatVector
from ...core.deadline import is_over
from ...core.lcp import LCP
from ...core.matrix.matrix import Matrix
from ...core.matrix.scaling import Exponents, scaled, scaling_of
from ...core.matrix.structure import IntVector
from ...systems.equilibration import power_of_two

FloatMatrix = NDArray[np.float64]
IndexVector = NDArray[np.intp]

WELL_CONDITIONED = 1e8
SMALLEST_PIVOT = 1e-7
LARGEST_GROWTH = 1e6
LARGEST_OFFSET = 1000  # exponent up to which the scale of a row may take its q


@dataclass(frozen=True, eq=False)
class CanonicalBox:
    """M, q, upper of the canonical problem, and the way back: z[rows] = offset[rows] + step z̄, and what was eliminated.

    Attributes
    ----------
    M : ndarray, shape (k, k)
        In the scaling that M needs, the largest entry of each row about 1.
    q, upper : ndarray, shape (k,)
        max |q_i| is about 1; upper > 0.
    offset : ndarray, shape (n,)
    rows : ndarray, shape (k,)
        The variable of the problem that each canonical variable is, up to shift, sign and scale; one that was split is
        there twice.
    step : ndarray, shape (k,)
        By how much that variable changes when the canonical one grows by 1; negative where the bounds change places.
    eliminated : ndarray, shape (g,)
        The free variables that were eliminated.
    elimination : ndarray, shape (g, k)
        By how much each of them changes when a canonical variable grows by 1.
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
        """Entries that the elimination touched: a factor, and solutions with it."""
        g, k = self.eliminated.size, float(self.q.size)
        return g * (g * g / 3.0 + g * k + k * k)

    @property
    def is_finite(self) -> bool:
        """Whether nothing in it has left the range of doubles."""
        return all(
            bool(np.isfinite(part).all())
            for part in (self.M, self.q, self.step, self.elimination, self.offset)
        )

    def recover(self, z: FloatVector) -> FloatVector:
        """Return the z of the problem, shape (n,), for one of the canonical problem, shape (k,)."""
        return self.direction(z) + self.offset

    def direction(self, ray: FloatVector) -> FloatVector:
        """Return the direction in the problem's z, shape (n,), for one of the canonical problem, shape (k,)."""
        result = np.zeros(self.offset.size)
        np.add.at(result, self.rows, self.step * ray)
        result[self.eliminated] = self.elimination @ ray
        return result


def canonical_box(problem: LCP) -> CanonicalBox:
    """Return the problem in canonical form; M is made dense.

    Fixed rows (lower = upper) go into q. Rows with an upper bound only change sign. Free rows whose block can be
    inverted stably are eliminated; the others become the difference of two nonnegative variables.
    """
    M, row_scale, column_scale = _equilibrated(problem.matrix)
    is_free = (problem.lower == -np.inf) & (problem.upper == np.inf)
    sign = np.where((problem.lower == -np.inf) & ~is_free, -1.0, 1.0)
    base = np.where(is_free, 0.0, np.where(sign > 0.0, problem.lower, problem.upper))
    row_scale = np.minimum(row_scale, LARGEST_OFFSET - np.frexp(problem.q)[1])
    M = scaled(M, Exponents(row_scale, column_scale))
    is_void = (problem.q == 0.0) & ~M.any(axis=1)
    if is_void.any():
        # Such a row is always satisfied; minus its column asks z_i for what the other rows need, as a multiplier would.
        M = np.where(is_void[:, None], -M.T, M)
    M = M * sign[:, None] * sign
    start = np.ldexp(base, -column_scale) * sign
    q = np.ldexp(problem.q, row_scale) * sign + M @ start
    upper = np.where(is_free, np.inf, np.ldexp(problem.upper - problem.lower, -column_scale))
    unit = np.ldexp(sign, column_scale)
    keep = np.flatnonzero(problem.lower < problem.upper)
    if keep.size < problem.n:
        M = M[np.ix_(keep, keep)]
    return _without_free_rows(M, q[keep], upper[keep], unit, base, keep, is_free[keep])


def covered_box(problem: LCP, covering: FloatVector) -> tuple[CanonicalBox, FloatVector]:
    """Return a problem with z ≥ 0 in canonical form, row by row as it is, and its covering vector; M is made dense."""
    M, row_scale, column_scale = _equilibrated(problem.matrix)
    q, r = np.ldexp(problem.q, row_scale), np.ldexp(covering, row_scale)
    size, none = power_of_two(np.abs(q).max(initial=0.0)), np.empty(0, dtype=np.intp)
    box = CanonicalBox(
        scaled(M, Exponents(row_scale, column_scale)),
        q / size,
        problem.upper,
        np.zeros(problem.n),
        np.arange(problem.n),
        np.ldexp(1.0, column_scale) * size,
        none,
        np.empty((0, problem.n)),
    )
    return box, r / power_of_two(r.max(initial=0.0))


def _equilibrated(matrix: Matrix) -> tuple[FloatMatrix, IntVector, IntVector]:
    """Return M, dense, and the exponents that scale it, with the largest entry of each row near 1."""
    scaling = scaling_of(matrix)
    M: FloatMatrix = matrix.array if matrix.is_dense else matrix.csr.toarray()
    none = np.zeros(matrix.n, np.int64)
    row, column, rows = (
        (none, none, matrix) if scaling is None else (scaling.row, scaling.column, scaling.matrix)
    )
    return M, row + 1 - np.frexp(rows.row_largest)[1], column


def _without_free_rows(
    M: FloatMatrix,
    q: FloatVector,
    upper: FloatVector,
    unit: FloatVector,
    base: FloatVector,
    keep: IndexVector,
    is_free: NDArray[np.bool_],
) -> CanonicalBox:
    free = np.flatnonzero(is_free)
    if not free.size:
        size = power_of_two(np.abs(q).max(initial=0.0))
        none, nothing = np.empty(0, dtype=np.intp), np.empty((0, keep.size))
        return CanonicalBox(M, q / size, upper / size, base, keep, unit[keep] * size, none, nothing)
    gone_rows, gone = _pivot_rows_and_columns(M, free)
    # Free rows and free variables may be paired in any way, so those that remain are.
    kept, kept_rows = np.setdiff1d(free, gone), np.setdiff1d(free, gone_rows)
    stays = np.concatenate([np.flatnonzero(~is_free), kept])
    stays_rows = np.concatenate([np.flatnonzero(~is_free), kept_rows])
    split = np.arange(stays.size - kept.size, stays.size)
    reduced, constant, upper = M[np.ix_(stays_rows, stays)], q[stays_rows], upper[stays]
    offset, elimination = base.copy(), np.empty((0, stays.size))
    if gone.size:
        others = np.column_stack([M[np.ix_(gone_rows, stays)], q[gone_rows]])
        solved = np.linalg.solve(M[np.ix_(gone_rows, gone)], others)
        elimination = -solved[:, :-1]
        offset[keep[gone]] -= solved[:, -1] * unit[keep[gone]]
        reduced = reduced + M[np.ix_(stays_rows, gone)] @ elimination
        constant = constant - M[np.ix_(stays_rows, gone)] @ solved[:, -1]
    if split.size:
        reduced = np.block(
            [[reduced, -reduced[:, split]], [-reduced[split], reduced[np.ix_(split, split)]]]
        )
        constant = np.concatenate([constant, -constant[split]])
        elimination = np.hstack([elimination, -elimination[:, split]])
        upper = np.concatenate([upper, np.full(split.size, np.inf)])
    size = power_of_two(np.abs(constant).max(initial=0.0))
    rows = keep[np.concatenate([stays, stays[split]])]
    step = unit[rows] * size
    step[stays.size :] *= -1.0
    elimination = elimination * (unit[keep[gone]] * size)[:, None]
    return CanonicalBox(
        reduced, constant / size, upper / size, offset, rows, step, keep[gone], elimination
    )


def is_well_conditioned(block: FloatMatrix) -> bool:
    """Return whether the inverse of the block can be trusted to about half of the digits."""
    try:
        inverse = np.linalg.inv(block)
    except np.linalg.LinAlgError:
        return False
    return bool(np.linalg.norm(inverse, 1) * np.linalg.norm(block, 1) < WELL_CONDITIONED)


def invertible_part(M: FloatMatrix, rows: IndexVector) -> IndexVector:
    """Return the given rows if their principal block is well conditioned, else a part of them found by pivoting."""
    if rows.size == 0 or is_well_conditioned(M[np.ix_(rows, rows)]):
        return rows
    chosen, _ = _principal_pivots(M[np.ix_(rows, rows)])
    return rows[chosen]


def _pivot_rows_and_columns(M: FloatMatrix, free: IndexVector) -> tuple[IndexVector, IndexVector]:
    """Return as many free rows and free columns as stable pivots can invert, principal ones first.

    A principal block keeps a positive semidefinite matrix so when it is eliminated; another need not.
    """
    if free.size == 0 or is_well_conditioned(M[np.ix_(free, free)]):
        return free, free
    chosen, remainder = _principal_pivots(M[np.ix_(free, free)])
    left = np.setdiff1d(np.arange(free.size), chosen)
    rows, columns = left.copy(), left.copy()
    more_rows: list[int] = []
    more_columns: list[int] = []
    while remainder.size and np.abs(remainder).max() > SMALLEST_PIVOT:
        i, j = np.unravel_index(int(np.abs(remainder).argmax()), remainder.shape)
        more_rows.append(int(rows[i]))
        more_columns.append(int(columns[j]))
        remainder = remainder - np.outer(remainder[:, j], remainder[i] / remainder[i, j])
        remainder = np.delete(np.delete(remainder, i, axis=0), j, axis=1)
        rows, columns = np.delete(rows, i), np.delete(columns, j)
    picked = [*chosen.tolist()]
    return free[np.array(picked + more_rows, dtype=np.intp)], free[
        np.array(picked + more_columns, dtype=np.intp)
    ]


def _principal_pivots(block: FloatMatrix) -> tuple[IndexVector, FloatMatrix]:
    """Return indices of a principal submatrix that stable 1 × 1 and 2 × 2 pivots can invert, and what they leave.

    The order is Bunch and Parlett's. Where a run's time ends, so does this: nobody will ask for the rest.
    """
    left = np.arange(block.shape[0])
    chosen: list[int] = []
    while left.size and not is_over():
        pivot = _largest_pivot(block)
        if pivot is None:
            break
        rest = np.setdiff1d(np.arange(left.size), pivot)
        block = block[np.ix_(rest, rest)] - block[np.ix_(rest, pivot)] @ np.linalg.solve(
            block[np.ix_(pivot, pivot)], block[np.ix_(pivot, rest)]
        )
        chosen.extend(left[pivot].tolist())
        left = left[rest]
    return np.array(sorted(chosen), dtype=np.intp), block


def _largest_pivot(block: FloatMatrix) -> IndexVector | None:
    """Return one or two indices with a large principal minor; None if there is none worth a pivot."""
    size = np.abs(block)
    largest = float(size.max())
    if not SMALLEST_PIVOT < largest < LARGEST_GROWTH:
        return None
    i = int(size.diagonal().argmax())
    paired = np.minimum(size, size.T)
    j, k = (int(index) for index in np.unravel_index(int(paired.argmax()), paired.shape))
    if j == k or size[i, i] >= 0.5 * paired[j, k]:
        return np.array([i]) if size[i, i] >= 1e-3 * largest else None
    square = block[np.ix_([j, k], [j, k])]
    determinant = square[0, 0] * square[1, 1] - square[0, 1] * square[1, 0]
    return np.array([j, k]) if abs(determinant) > 1e-3 * float(np.abs(square).max()) ** 2 else None
