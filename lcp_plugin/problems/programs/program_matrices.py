"""Matrices of a quadratic program, and facts that depend on them only: shared by programs with other vectors.

The constraints of a quadratic program as one list of rows.

Convexity test of quadratic programs, and the error messages for nonconvex programs.

Program without rows of one variable, and the inverse transformation of solutions and proofs.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from ...core.checks import DENSE_ABOVE_DENSITY, DENSE_UP_TO_SIZE, Vector, freeze_csr, read_only
from ...core.entries import count_entries, largest_in_rows, largest_products
from ...core.matrix import Matrix
from ...core.rounding import compensated_product, upper_end
from ...engines import is_installed
from ...engines.solvers import EQUATION
from ...judges.program import BLUR, NOISE, Indices, ProgramTerms
from ...proofs.exact import Row, rational_rows
from ...proofs.farkas import LinearConstraints
from ...systems.definiteness import factorised, is_diagonal, is_semidefinite_to_rounding, scaled_to
from ...systems.minimum_degree import factor_sizes

FIT_TO = 1e-3  # of the right-hand side: enough for powers of two
ROUNDING_OF_ENTRIES = 2.0 ** np.arange(-48.0, -23.0, 4.0)  # from double to single precision
WITHIN_ROUNDING = (
    "within rounding: P has a negative eigenvalue, which rounding of its entries explains"
)
# Unknowns and rows of a program that dense arithmetic takes in place of sparse matrices
FULL_UP_TO = 3000
# Multiplications per entry. With up to 1 800 (2-D grids), PIQP takes .2 to .5 of Clarabel's time, with 4 700 (a 3-D
# grid) the same time; on programs without a geometry, with 3 700 to 30 000, it takes 1.4 to 10 times Clarabel's time.
# A factorization of 1 000 dense rows takes .2 s, which no limit in seconds notices; a count loads numba.
MOST_WORK, COUPLED_UP_TO = 4000.0, 1000


@dataclass(frozen=True, eq=False)
class ProgramMatrices:
    """P, G and A of a program, checked and read-only; each fact about them is computed once.

    Attributes
    ----------
    P, G, A : ndarray or canonical CSR array, shapes (n, n), (m, n), (p, n)
    """

    P: Any
    G: Any
    A: Any
    _of_rows: dict[bytes, ProgramMatrices] = field(default_factory=dict, repr=False)

    @cached_property
    def sizes(self) -> tuple[int, int, int, int]:
        """m, p, n, n: numbers of rows of G, of A, of lower and of upper bounds."""
        n = self.P.shape[0]
        return self.G.shape[0], self.A.shape[0], n, n

    @cached_property
    def is_equality(self) -> NDArray[np.bool_]:
        """Mask of the equality constraints."""
        (m, p, _, _), is_equality = self.sizes, np.zeros(sum(self.sizes), np.bool_)
        is_equality[m : m + p] = True
        return is_equality

    @cached_property
    def constraints(self) -> sp.csr_array:
        """[G; A; −I; I]."""
        identity = sp.eye_array(self.P.shape[0], format="csr")
        return sp.vstack([self.terms.rows, -identity, identity], format="csr")

    @cached_property
    def arrays(self) -> tuple[Any, Any, Any]:
        """P, G and A: all ndarrays if they are small, full or given so, else all CSR arrays."""
        given, (m, p, n, _) = (self.P, self.G, self.A), self.sizes
        are_given_so = all(isinstance(one, np.ndarray) for one in given)
        are_dense = are_given_so or self.is_small or is_full(n, m + p, self.entries)
        P, G, A = map(as_array if are_dense else as_csr, given)
        return P, G, A

    @cached_property
    def terms(self) -> ProgramTerms:
        """P and [G; A] with the facts that the criterion needs."""
        return ProgramTerms(*self.stacked, self.sizes[0])

    @cached_property
    def stacked(self) -> tuple[Any, Any]:
        """P and C = [G; A]: both dense or both CSR arrays."""
        P, G, A = self.arrays
        return P, (sp.vstack([G, A], "csr") if sp.issparse(P) else np.vstack([G, A]))

    @cached_property
    def of_daqp(self) -> tuple[Vector, Vector, Any] | None:
        """P and C in arrays that daqp may write to, and its kinds of bounds and rows; None if daqp is not the first."""
        if not (
            self.is_small and self.has_curvature and self.is_semidefinite and is_installed("daqp")
        ):
            return None
        (m, p, n, _), (P, C) = self.sizes, self.stacked
        sense = np.zeros(n + m + p, np.intc)
        sense[n + m :] = EQUATION
        return np.array(P, order="C"), np.array(C, order="C"), sense

    @cached_property
    def engine_units(self) -> tuple[Vector, Vector]:
        """Units of unknowns and of rows, from the fit, in which the largest entries of P, G and A are about 1."""
        return self._equilibrate(*self.fit, 3)

    @cached_property
    def largest_units(self) -> tuple[Vector, Vector]:
        """Units in which the largest entries are about 1, without a fit, so that tiny entries have no influence."""
        n, m = self.P.shape[0], sum(self.sizes[:2])
        return self._equilibrate(np.ones(n), np.ones(m), 10)

    def _equilibrate(self, units: Vector, rows: Vector, passes: int) -> tuple[Vector, Vector]:
        of_P, of_C, of_columns = self.terms.measured[2:]
        for _ in range(passes):
            most = units * np.maximum(
                largest_products(of_P, units), largest_products(of_columns, rows)
            )
            units, rows = units / _root(most), rows / _root(rows * largest_products(of_C, units))
        return units, rows

    @cached_property
    def fit(self) -> tuple[Vector, Vector]:
        """Units of unknowns and of rows, powers of two, that bring the entries of P, G and A to 1 (`fitted_units`)."""
        return fitted_units(*self.stacked)

    @property
    def counts(self) -> Indices:
        """Number of entries of each row of [G; A]."""
        return self.terms.counts

    @cached_property
    def is_small(self) -> bool:
        """True if a program with these matrices is small or dense: for daqp."""
        m, p, n, _ = self.sizes
        return may_be_small(n, m + p, (one.size for one in (self.P, self.G, self.A)))

    @cached_property
    def entries(self) -> tuple[int, int]:
        """Numbers of nonzeros of P and of [G; A]."""
        in_P, in_G, in_A = map(count_entries, (self.P, self.G, self.A))
        return in_P, in_G + in_A

    @property
    def has_curvature(self) -> bool:
        """True if P has a nonzero."""
        return self.entries[0] > 0

    @cached_property
    def singletons(self) -> tuple[Indices, Indices, Vector]:
        """Rows of [G; A] with one entry, their columns, and for all rows this entry, or 1."""
        C, counts = self.stacked[1], self.counts
        rows, coefficient = np.flatnonzero(counts == 1), np.ones(counts.size)
        if sp.issparse(C):
            places = C.indptr[rows]
            columns, coefficient[rows] = C.indices[places].astype(np.intp), C.data[places]
        else:
            columns = (C[rows] != 0.0) @ np.arange(C.shape[1])
            coefficient[rows] = C[rows, columns]
        return rows, columns, coefficient

    @cached_property
    def is_semidefinite(self) -> bool | None:
        """True if P is positive semidefinite to rounding; None if P is too large for the test."""
        return is_semidefinite_to_rounding(self.P)

    @property
    def is_nearly_semidefinite(self) -> bool:
        """True if P is semidefinite, perhaps with the rounding that `semidefinite_P` adds."""
        return self.semidefinite_P is not None

    @cached_property
    def semidefinite_P(self) -> Any:
        """P if it is semidefinite or too large to test, or else P + δ diag(P); None if δ = n 2⁻²⁴ does not suffice.

        δ is the least of `ROUNDING_OF_ENTRIES` that suffices. A diagonal entry that is 0, or negative by a rounding
        error of the largest entry of P, is replaced by the largest entry of its row.
        """
        P, d, n = self.P, self.P.diagonal(), self.P.shape[0]
        if self.is_semidefinite or d.min() < -BLUR * abs(P).max():
            return P if self.is_semidefinite else None
        diagonal: Any = sp.diags_array if sp.issparse(P) else np.diag
        least, d = np.minimum(d, 0.0), np.where(d > 0.0, d, largest_in_rows(P))
        unit = scaled_to(P - diagonal(least), 1.0 / np.sqrt(or_one(d)))
        if unit is None:
            return P
        shifts = n * ROUNDING_OF_ENTRIES
        if factorised(unit, shifts[-1]) is None:
            return None
        if self.is_semidefinite is None:
            return P
        shift = shifts[bisect_left(shifts, True, key=lambda one: factorised(unit, one) is not None)]
        found = P + diagonal(shift * d - least)
        return freeze_csr(found) if sp.issparse(P) else read_only(found)

    @cached_property
    def hessian(self) -> Matrix:
        """P, as the matrix of a complementarity problem."""
        return Matrix(self.P)

    @cached_property
    def kkt(self) -> Matrix:
        """Matrix [[P, Cᵀ], [−C, 0]] with C = [G; A]; an ndarray if it is small and full."""
        C, size = self.terms.rows, self.P.shape[0] + sum(self.sizes[:2])
        M = sp.block_array([[self.terms.sparse_P, C.T], [-C, None]], format="csr")
        is_full = M.nnz > DENSE_ABOVE_DENSITY * size * size
        return Matrix(M.toarray() if size <= DENSE_UP_TO_SIZE and is_full else M)

    @cached_property
    def fills_in(self) -> bool:
        """True if a factorization of a sparse `kkt` takes more than `MOST_WORK` per entry, by a count.

        False without a count, which is compiled, if the matrix has a narrow band in another order, or if few rows or
        few columns have two entries: the other ones are eliminated first.
        """
        from scipy.sparse.csgraph import reverse_cuthill_mckee  # slow to import

        P, C = self.stacked
        if not sp.issparse(P):
            return False
        of_column = np.bincount(np.append(P.indices, C.indices), minlength=P.shape[0])
        coupled = np.count_nonzero(of_column > 1)
        if is_diagonal(P):
            coupled = min(coupled, np.count_nonzero(self.counts > 1))
        most = MOST_WORK * float(sum(self.entries) + sum(C.shape))
        if coupled <= COUPLED_UP_TO or coupled**3 / 3.0 <= most:
            return False
        pattern = self.kkt.csr
        order = reverse_cuthill_mckee(pattern, symmetric_mode=True)
        band = sp.coo_array(pattern[order][:, order])
        width = float(np.abs(band.row - band.col).max(initial=0))
        if order.size * width * width <= most:
            return False
        return factor_sizes(pattern, np.inf, most)[1] == np.inf

    def of_rows(self, left: Indices) -> ProgramMatrices:
        """Return the matrices with these rows of [G; A] only."""
        m = self.sizes[0]
        if left.size == sum(self.sizes[:2]):
            return self
        found = self._of_rows.get(key := left.tobytes())
        if found is None:  # another thread may replace the entry at any time
            P, G, A = self.arrays
            found = ProgramMatrices(P, G[left[left < m]], A[left[left >= m] - m])
            self._of_rows.clear()
            self._of_rows[key] = found
        return found

    def __getstate__(self) -> dict[str, Any]:
        """Drop the cache, because its values can be computed again."""
        return {"P": self.P, "G": self.G, "A": self.A, "_of_rows": {}}


def fitted_units(P: Any, C: Any) -> tuple[Vector, Vector]:
    """Return u and v, powers of two: least squares of the logarithms of |p_jk| u_j u_k and |c_ij| v_i u_j.

    References
    ----------
    Curtis, Reid, *On the automatic scaling of matrices for Gaussian elimination*, IMA Journal of Applied Mathematics 10
    (1972), doi:10.1093/imamat/10.1.118.

    Examples
    --------
    >>> fitted_units(sp.csr_array([[4.0, 0.0], [0.0, 1.0]]), sp.csr_array([[1.0, 16.0]]))
    (array([0.5, 0.5]), array([0.5]))
    """
    (in_P, log_P), (in_C, log_C) = map(_pattern_and_logarithms, (P, C))
    pattern, n, ones = _bordered(in_P, in_C), P.shape[0], np.ones(sum(C.shape))
    counts = pattern(ones) + 1e-6  # the fit has null spaces: 2ᵗ of unknowns, 2⁻ᵗ of rows
    diagonal = counts + np.append(2.0 * in_P.diagonal(), np.zeros(C.shape[0]))
    sums = _bordered(log_P, log_C)(ones)
    units = _powers(_conjugate_gradients(lambda x: pattern(x) + counts * x, diagonal, -sums))
    return units[:n], units[n:]


def _bordered(P: Any, C: Any) -> Callable[[Vector], Vector]:
    """Return the function x ↦ [P + diag(P), Cᵀ; C, 0] x."""
    n, on, turned = P.shape[0], P.diagonal(), C.T
    return lambda x: np.concatenate([P @ x[:n] + on * x[:n] + turned @ x[n:], C @ x[:n]])


def _pattern_and_logarithms(M: Any) -> Any:
    """Return matrices with 1, and with log₂ |entry|, in the place of each entry."""
    if sp.issparse(M):
        values = np.ones(M.nnz), np.log2(np.abs(M.data))
        return [sp.csr_array((one, M.indices, M.indptr), M.shape) for one in values]
    is_entry = M != 0.0
    return is_entry.astype(np.float64), np.log2(np.abs(M), where=is_entry, out=np.zeros(M.shape))


def _conjugate_gradients(product: Callable[[Vector], Vector], diagonal: Any, b: Any) -> Vector:
    """Return about A⁻¹b from products with A; scipy's loop takes ten times as long for 100 to 1000 unknowns."""
    x, rest, inverse = np.zeros(b.size), b, 1.0 / diagonal
    direction = inverse * rest
    size = rest @ direction
    for _ in range(60):
        if not rest @ rest > (FIT_TO * FIT_TO) * (b @ b):
            break
        image = product(direction)
        step = size / (direction @ image)
        x, rest = x + step * direction, rest - step * image
        steepest = inverse * rest
        size, before = rest @ steepest, size
        direction = steepest + (size / before) * direction
    return x


def _root(sizes: Vector) -> Vector:
    """Return powers of two near the square roots, 1 of 0."""
    return _powers(0.5 * np.log2(or_one(sizes)))


def _powers(exponents: Vector) -> Vector:
    """Return 2 to the rounded exponents, within the range of doubles; 1 for NaN."""
    known = np.where(np.isnan(exponents), 0.0, exponents)
    return np.ldexp(1.0, np.rint(np.minimum(np.maximum(known, -1000.0), 1000.0)).astype(np.intc))


def may_be_small(n: int, m: int, entries: Iterable[int]) -> bool:
    """Return whether a program with these counts of unknowns, rows and entries is small or dense: for daqp."""
    if not (0 < n <= 400 and m <= 1500):
        return False
    return n * n * (n + m) <= 1e7 or is_full(n, m, entries)


def is_full(n: int, m: int, entries: Iterable[int]) -> bool:
    """Return whether dense arithmetic is quicker on a program with these counts of unknowns, rows and entries."""
    # Sparse factors take more multiplications, of which fewer than .3 n² (n + m) are nonzero, more quickly
    return 0 < n + m <= FULL_UP_TO and sum(entries) >= 0.3 * n * (n + m)


def as_csr(matrix: Any) -> sp.csr_array:
    """Return an ndarray or a CSR array as a CSR array."""
    return matrix if sp.issparse(matrix) else sp.csr_array(matrix)


def as_array(matrix: Any) -> Vector:
    """Return a matrix as an ndarray."""
    return np.asarray(matrix.toarray() if sp.issparse(matrix) else matrix)


def or_one(sizes: Vector) -> Vector:
    """Return the sizes with 1 instead of 0."""
    return np.where(sizes > 0.0, sizes, 1.0)


def sums_and_terms(rows: sp.csr_array, y: Vector) -> tuple[Any, Any]:
    """Return yᵀM and |y|ᵀ|M| of a CSR array, which is not transposed.

    Examples
    --------
    >>> sums_and_terms(sp.csr_array([[1.0, -2.0], [0.0, 3.0]]), np.array([1.0, 1.0]))
    (array([1., 1.]), array([1., 5.]))
    """
    terms: Vector = np.repeat(y, np.diff(rows.indptr)) * rows.data
    both = terms, np.abs(terms)
    sums, sizes = (np.bincount(rows.indices, one, rows.shape[1]) + 0.0 for one in both)
    return sums, sizes


@dataclass(frozen=True, eq=False)
class Constraints:
    """Rows C x ≤ d, including equalities: G x ≤ h, A x = b, −x ≤ −lower, x ≤ upper; d_i = ∞ means no constraint.

    Attributes
    ----------
    matrices : ProgramMatrices
    limit : ndarray
        d.
    """

    matrices: ProgramMatrices
    limit: Vector

    @property
    def matrix(self) -> sp.csr_array:
        """C, shape (m + p + 2n, n)."""
        return self.matrices.constraints

    @property
    def is_equality(self) -> NDArray[np.bool_]:
        """Mask of the equality rows."""
        return self.matrices.is_equality

    @property
    def rows(self) -> int:
        """Number of rows of G and A."""
        return sum(self.matrices.sizes[:2])

    @property
    def right(self) -> Vector:
        """[h; b]: the limits of the rows of G and A."""
        return self.limit[: self.rows]

    @property
    def finite(self) -> Indices:
        """The rows that say something."""
        return np.flatnonzero(np.isfinite(self.limit))

    def split(self, values: Any) -> list[Any]:
        """Return the parts of values per row: of G, of A, of the lower and of the upper bounds."""
        ends = np.cumsum([0, *self.matrices.sizes]).tolist()
        return [values[begin:end] for begin, end in pairwise(ends)]

    @cached_property
    def own_sizes(self) -> Vector:
        """Size of each row: |right-hand side|, or 1e-5 of its smallest coefficient if larger.

        The largest right-hand side takes the place of coefficients in a row that has none. An inconsistency at rounding
        level, relative to all unscaled coefficients, is attributed to rounded data.
        """
        limits = np.where(np.isfinite(self.limit), np.abs(self.limit), 0.0)
        inverse = largest_in_rows(self.matrix, 1.0 / np.abs(self.matrix.data))
        has_entry, largest = inverse > 0.0, float(limits[: self.rows].max(initial=0.0))
        smallest = np.divide(1.0, inverse, where=has_entry, out=np.full(inverse.size, largest))
        return np.maximum(limits, NOISE * smallest)

    @property
    def coefficient_sizes(self) -> Vector:
        """Largest |coefficient| of each row and bound; 1 for a row without entries."""
        sizes = self.matrices.terms.row_sizes
        return np.append(sizes, np.ones(self.limit.size - sizes.size))

    @cached_property
    def unit(self) -> Vector:
        """Largest |coefficient| of each row plus its |right-hand side|: weight in searches for a certificate."""
        right = np.where(np.isfinite(self.limit), np.abs(self.limit), 0.0)
        return self.coefficient_sizes + right

    @cached_property
    def as_rows(self) -> LinearConstraints:
        """All constraints, including bounds, as rows of an unbounded x, with w = d − C x."""
        free, kept = np.full(self.matrix.shape[1], np.inf), np.zeros(self.matrix.shape[1])
        return self._conditions(self.matrix, -free, free, (kept, kept))

    @cached_property
    def within_bounds(self) -> LinearConstraints:
        """The rows of G and A within the bounds, with w = d − C x."""
        (below, above), units = self.split(self.limit)[2:], self.split(self.unit)[2:]
        return self._conditions(self.matrices.terms.rows, -below, above, tuple(units))

    def _conditions(self, C: sp.csr_array, *bounds: Any) -> LinearConstraints:
        """Return the first rows, which C are, as w = d − C x with these bounds of x and their units."""
        given: tuple[Any, ...] = (self.limit, self.is_equality, self.unit)
        limit, is_equality, unit = (one[: C.shape[0]] for one in given)
        lower, upper, units = bounds
        return LinearConstraints(
            -C, limit, np.isfinite(limit), is_equality, lower, upper, unit, units
        )

    @cached_property
    def exactly(self) -> list[Row]:
        """The rows of C in fractions."""
        return rational_rows(self.matrix)

    def excess(self, x: Vector) -> Vector:
        """Return proved upper bounds of the violation of each row: −∞ to 0 if satisfied, ∞ if a sum overflows."""
        is_finite = np.isfinite(self.limit)
        value, radius = compensated_product(self.matrix, x, np.where(is_finite, -self.limit, 0.0))
        above = upper_end(np.where(self.is_equality, np.abs(value), value), radius)
        return np.where(is_finite, above, -np.inf)
