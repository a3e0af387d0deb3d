r"""Active sets whose faces are solved to the last digit of each row: for rows of very different size, or little cost.

On the free columns F the minimum and its dual point y satisfy A x − y = b, A_FᵀWy = 0 (−linear_F where a penalty l1 is
linear in this orthant), and both are kept: y_i of a row
that is 10⁶ times larger than others is 10¹² times smaller than what rounding of x leaves of (A x − b)_i. (x, y) are
refined by residuals with compensated sums, x in two doubles, and an orthogonal factor of √W A_F whose rounding is
small in each row: rows are pivots as well as columns (Powell and Reid), and an entry that is no more than rounding of
what it was made of becomes 0, so that dependent columns are seen row by row. A ridge is n rows more, √ridge I.

The set changes by one column at a time, as Lawson and Hanson do, Stark and Parker between two bounds. A column enters
where s_j = (AᵀWy)_j has the wrong sign and is not rounding of its own terms.

References
----------
M. J. D. Powell, J. K. Reid, *On applying Householder transformations to linear least squares problems*, IFIP 1968.
A. J. Cox, N. J. Higham, *Stability of Householder QR factorization for weighted least squares problems*, 1998.
Å. Björck, *Iterative refinement of linear least squares solutions*, BIT 7 (1967), doi:10.1007/BF01939321.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from ...core.checks import FloatVector
from ...core.deadline import is_over
from ...core.kernels.floats import EPSILON
from ...core.matrix.structure import IntVector
from .steps import FacePoint

CLEANED = 32.0 * EPSILON  # of the largest number that an entry was made of: less is rounding
REFINEMENTS = 8
SETTLED = 2.0 * EPSILON  # of each number: a smaller correction is the last one
UNSETTLED = 2.0**-10  # a number whose last correction is larger is nothing but rounding of others
ROUNDS = 6  # of the columns and a few
SPLITTER = 2.0**27 + 1.0
NOISE = 16.0 * EPSILON  # of the terms of s_j


def refined_steps(start: FacePoint) -> Iterator[FacePoint]:
    """Yield points with dual points from the start on; ends at the answer, or after many rounds."""
    yield start
    face = RefinedFaces(start)
    problem, x = start.problem.problem, start.problem.to_caller(start.x)
    lower, upper = start.problem.caller_bounds
    is_free, rejected = (lower < x) & (x < upper), np.zeros(x.size, np.bool_)
    entering, pull = -1, 0.0
    for _ in range(ROUNDS * x.size + 10):
        if is_over():
            return
        free = face.independent(np.flatnonzero(is_free))
        is_free = np.zeros(x.size, np.bool_)
        is_free[free] = True
        z, y = face.minimum(x, free)
        if not (np.isfinite(z).all() and np.isfinite(y).all()):
            return
        moved = z - x
        wrong_way = entering >= 0 and (not is_free[entering] or moved[entering] * pull < 0.0)
        if wrong_way:  # it was rounding that let it go
            rejected[entering], is_free[entering], entering = True, False, -1
            continue
        share, hits = _share(x, moved, lower, upper)
        if hits.size:
            x = np.clip(x + share * moved, lower, upper)
            x[hits] = np.where(moved[hits] > 0.0, upper[hits], lower[hits])
            is_free &= (lower < x) & (x < upper)
            entering, pull = -1, 0.0
            continue
        x = np.clip(z, lower, upper)
        yield FacePoint(
            start.problem,
            np.clip(start.problem.from_caller(x), start.problem.lower, start.problem.upper),
            dual=y[: problem.shape[0]],
        )
        slope, terms = face.slope(y)
        may_move = np.where(slope < 0.0, x < upper, x > lower)
        if entering >= 0:
            rejected[:] = False
        is_wrong = ~is_free & ~rejected & may_move & (np.abs(slope) > NOISE * terms)
        if not is_wrong.any():
            return
        entering = int(np.argmax(np.where(is_wrong, np.abs(slope) / problem.column_scales, -1.0)))
        is_free[entering], pull = True, -float(slope[entering])


def _share(
    x: FloatVector, moved: FloatVector, lower: FloatVector, upper: FloatVector
) -> tuple[float, IntVector]:
    """Return how far one may go, and the columns that are stopped there; none where one may go all the way."""
    slack = np.where(moved > 0.0, upper - x, lower - x)
    crossing = np.where(moved != 0.0, np.abs(moved) > np.abs(slack), False)
    if not crossing.any():
        return 1.0, np.empty(0, np.intp)
    shares = np.where(crossing, slack / np.where(crossing, moved, 1.0), np.inf)
    return float(shares.min()), np.flatnonzero(shares <= shares.min())


class RefinedFaces:
    """Minima on faces of the problem of a point, and how the cost rises from them.

    Parameters
    ----------
    point : FacePoint
    """

    def __init__(self, point: FacePoint) -> None:
        problem = point.problem.problem
        m, n = problem.shape
        ridge = np.full(n if problem.ridge > 0.0 else 0, problem.ridge)
        weights = np.ones(m) if problem.weights is None else problem.weights
        A = problem.A if problem.is_dense else problem.A.toarray()
        self.A = np.vstack([A, np.eye(n)[: ridge.size]])
        self.b, self.weights = (
            np.concatenate([problem.b, 0.0 * ridge]),
            np.concatenate([weights, ridge]),
        )
        self.root, self.scales = np.sqrt(self.weights), problem.column_scales
        self.linear = np.copysign(problem.l1, point.problem.linear)
        self.scaled = self.root[:, None] * self.A / self.scales
        self._factors: dict[bytes, OrthogonalFactor] = {}

    def _factor(self, free: IntVector) -> OrthogonalFactor:
        key = free.tobytes()
        if key not in self._factors:
            self._factors = {key: OrthogonalFactor(self.scaled[:, free])}
        return self._factors[key]

    def independent(self, free: IntVector) -> IntVector:
        """Return as many of these columns as are independent."""
        factor = self._factor(free)
        if factor.rank == free.size:
            return free
        return np.sort(free[factor.columns[: factor.rank]])

    def slope(self, y: FloatVector) -> tuple[FloatVector, FloatVector]:
        """Return AᵀWy + linear and the sums of the sizes of their terms."""
        weighted = self.weights * y
        sums = exact_products(self.A.T, weighted, self.linear[:, np.newaxis])
        return sums, np.abs(self.A).T @ np.abs(weighted) + np.abs(self.linear)

    def minimum(self, x: FloatVector, free: IntVector) -> tuple[FloatVector, FloatVector]:
        """Return the minimum over these columns, which are independent, the others as in x, and its dual point."""
        factor, scales = self._factor(free), self.scales[free]
        high, low, y = x.copy(), np.zeros(x.size), np.zeros(self.b.size)
        for _ in range(REFINEMENTS):
            off = exact_products(self.A, high, np.column_stack([self.A * low, -y, -self.b]))
            steep = self.slope(y)[0][free]
            d, v = factor.solve(-self.root * off, -steep / scales)
            dy = np.divide(v, self.root, out=-off.copy(), where=self.root > 0.0)
            dx = d / scales
            y = y + dy
            moved = low[free] + dx
            summed = high[free] + moved
            low[free], high[free] = (high[free] - summed) + moved, summed
            if (np.abs(dx) <= SETTLED * np.abs(high[free])).all() and (
                np.abs(dy) <= SETTLED * np.abs(y)
            ).all():
                return high, y
        y[np.abs(dy) > UNSETTLED * np.abs(y)] = 0.0
        high[free] = np.where(np.abs(dx) > UNSETTLED * np.abs(high[free]), 0.0, high[free])
        return high, y


def exact_products(A: FloatVector, x: FloatVector, others: FloatVector) -> FloatVector:
    """Return A x with the sums of these other terms, shape (rows, terms), each rounded once; NaN where one overflows.

    Products are split without error into their values and what rounding took from them (Dekker 1971).
    """
    values = A * x
    a, c = split(A), split(x)
    errors = ((a * c - values) + a * (x - c) + (A - a) * c) + (A - a) * (x - c)
    terms = np.hstack([values, errors, others])
    if not np.isfinite(terms).all():
        return np.full(A.shape[0], np.nan)
    return np.array([math.fsum(row) for row in terms.tolist()])


def split(values: FloatVector) -> FloatVector:
    """Return the first half of the digits of numbers (Veltkamp)."""
    larger = SPLITTER * values
    return np.asarray(larger - (larger - values))


class OrthogonalFactor:
    """B = Q R by reflections, columns and rows pivoted, what is rounding in an entry set to 0.

    Parameters
    ----------
    B : array, shape (m, k)

    Attributes
    ----------
    rank : int
    columns : array of int, shape (k,)
        The first `rank` of them are independent.
    """

    def __init__(self, B: FloatVector) -> None:
        m, k = B.shape
        self.rows, self.columns, self.rank = np.arange(m), np.arange(k), 0
        R, sizes = np.array(B), np.abs(B)
        mirrors = np.zeros((min(m, k), m))
        for p in range(min(m, k)):
            lengths = np.sqrt(np.square(R[p:, p:]).sum(axis=0))
            q = p + int(np.argmax(lengths))
            if not lengths[q - p] > 0.0:
                break
            for array in (R.T, sizes.T, self.columns):
                _swap(array, p, q)
            i = p + int(np.argmax(np.abs(R[p:, p])))
            for array in (R, sizes, self.rows, mirrors.T):
                _swap(array, p, i)
            length = float(np.linalg.norm(R[p:, p]))
            end = -np.copysign(length, R[p, p])
            mirror = mirrors[p]
            mirror[p:] = R[p:, p]
            mirror[p] -= end
            mirror /= np.sqrt(length * np.abs(mirror[p]))
            R[p, p], R[p + 1 :, p] = end, 0.0
            shift = np.outer(mirror[p:], mirror[p:] @ R[p:, p + 1 :])
            R[p:, p + 1 :] -= shift
            sizes[p:, p + 1 :] = np.maximum(sizes[p:, p + 1 :], np.abs(shift))
            block = R[p + 1 :, p + 1 :]
            block[np.abs(block) <= CLEANED * sizes[p + 1 :, p + 1 :]] = 0.0
            self.rank = p + 1
        self._mirrors = mirrors[: self.rank]
        self._R = R[: self.rank, : self.rank]

    def solve(self, h: FloatVector, g: FloatVector) -> tuple[FloatVector, FloatVector]:
        """Return (u, v) with B u − v = h and Bᵀv = g for the first columns, u = 0 for those that depend on them."""
        from scipy.linalg import solve_triangular

        u, v, chosen = np.zeros(self.columns.size), np.zeros(h.size), self.columns[: self.rank]
        if not self.rank:
            return u, -h
        turned = h[self.rows]
        for mirror in self._mirrors:
            turned = turned - mirror * (mirror @ turned)
        inner = solve_triangular(self._R, g[chosen], trans=1, check_finite=False)
        u[chosen] = solve_triangular(self._R, turned[: self.rank] + inner, check_finite=False)
        turned = np.concatenate([inner, -turned[self.rank :]])
        for mirror in self._mirrors[::-1]:
            turned = turned - mirror * (mirror @ turned)
        v[self.rows] = turned
        return u, v


def _swap(array: FloatVector | IntVector, i: int, j: int) -> None:
    if i != j:
        array[[i, j]] = array[[j, i]]
