"""Matrices of a quadratic program, and facts that depend on them only: shared by programs with other vectors."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from ...core import checks
from ...core.checks import AnyMatrix, Indices, Vector, freeze_csr, read_only
from ...core.entries import count_entries, largest_in_rows, largest_products, or_one
from ...core.kernels.floats import FEW_ROUNDINGS
from ...core.matrix import Matrix
from ...engines import is_installed
from ...engines.solvers import kinds_of_rows
from ...judges.program import ProgramTerms
from ...systems.definiteness import factorized, is_diagonal, is_semidefinite_to_rounding, scaled_to
from ...systems.minimum_degree import factor_sizes
from .fitted_units import fitted_units, roots

ROUNDING_OF_ENTRIES = 2.0 ** np.arange(-48.0, -23.0, 4.0)  # from double to single precision
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

    P: AnyMatrix
    G: AnyMatrix
    A: AnyMatrix
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
        """P, G and A: all ndarrays if they are small, full or the user's, else all CSR arrays."""
        matrices, (m, p, n, _) = (self.P, self.G, self.A), self.sizes
        if all(isinstance(matrix, np.ndarray) for matrix in matrices):
            return matrices
        are_dense = self.is_small or is_full(n, m + p, self.entries)
        P, G, A = map(as_array if are_dense else as_csr, matrices)
        return P, G, A

    @cached_property
    def terms(self) -> ProgramTerms:
        """P and [G; A] with the facts that the criterion needs."""
        return ProgramTerms(*self.stacked, self.sizes[0])

    @cached_property
    def stacked(self) -> tuple[Any, Any]:
        """P and C = [G; A]: both dense or both CSR arrays."""
        P, *both = self.arrays
        parts = [matrix for matrix in both if matrix.shape[0]] or both[:1]
        if len(parts) == 1:
            return P, parts[0]
        return P, (sp.vstack(parts, "csr") if sp.issparse(P) else np.concatenate(parts))

    @cached_property
    def of_daqp(self) -> tuple[Vector, Vector, Any] | None:
        """P and C in arrays that daqp may write to, and its kinds of bounds and rows; None if daqp is not the first."""
        is_suited = self.is_small and self.has_curvature and is_installed("daqp")
        if not (is_suited and self.is_semidefinite):
            return None
        (m, p, n, _), (P, C) = self.sizes, self.stacked
        return np.array(P, order="C"), np.array(C, order="C"), kinds_of_rows(n, m, p)

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
        of_P, of_C, of_columns = self.terms.entry_sizes[2:]
        for _ in range(passes):
            in_P, in_C = largest_products(of_P, units), largest_products(of_columns, rows)
            most = units * np.maximum(in_P, in_C)
            units, rows = units / roots(most), rows / roots(rows * largest_products(of_C, units))
        return units, rows

    @cached_property
    def fit(self) -> tuple[Vector, Vector]:
        """Units of unknowns and of rows, powers of two, that bring the entries of P, G and A to 1 (`fitted_units`)."""
        return fitted_units(*self.stacked)

    @cached_property
    def is_small(self) -> bool:
        """True if a program with these matrices is small or dense: for daqp."""
        m, p, n, _ = self.sizes
        return may_be_small(n, m + p, (self.P.size, self.G.size, self.A.size))

    @cached_property
    def entries(self) -> tuple[int, int]:
        """Numbers of nonzeros of P and of [G; A]."""
        in_P, in_G, in_A = map(count_entries, (self.P, self.G, self.A))
        return in_P, in_G + in_A

    @cached_property
    def has_curvature(self) -> bool:
        """True if P has a nonzero."""
        return count_entries(self.P) > 0

    @cached_property
    def singletons(self) -> tuple[Indices, Indices, Vector]:
        """Rows of [G; A] with one entry, their columns, and for all rows this entry, or 1."""
        C, counts = self.stacked[1], self.terms.counts
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
        if self.is_semidefinite or d.min() < -FEW_ROUNDINGS * abs(P).max():
            return P if self.is_semidefinite else None
        diagonal: Any = sp.diags_array if sp.issparse(P) else np.diag
        least, d = np.minimum(d, 0.0), np.where(d > 0.0, d, largest_in_rows(P))
        unit = scaled_to(P - diagonal(least), 1.0 / np.sqrt(or_one(d)))
        if unit is None:
            return P
        shifts = n * ROUNDING_OF_ENTRIES
        if factorized(unit, shifts[-1]) is None:
            return None
        if self.is_semidefinite is None:
            return P
        shift = shifts[
            bisect_left(shifts, True, key=lambda delta: factorized(unit, delta) is not None)
        ]
        shifted = P + diagonal(shift * d - least)
        return freeze_csr(shifted) if sp.issparse(P) else read_only(shifted)

    @cached_property
    def hessian(self) -> Matrix:
        """P, as the matrix of a complementarity problem."""
        return Matrix(self.P)

    @cached_property
    def kkt(self) -> Matrix:
        """Matrix [[P, Cᵀ], [−C, 0]] with C = [G; A]; an ndarray if it is small and full."""
        C, size = self.terms.rows, self.P.shape[0] + sum(self.sizes[:2])
        M = sp.block_array([[self.terms.sparse_P, C.T], [-C, None]], format="csr")
        is_full = M.nnz > checks.DENSE_ABOVE_DENSITY * size * size
        return Matrix(M.toarray() if size <= checks.DENSE_UP_TO_SIZE and is_full else M)

    @cached_property
    def fills_in(self) -> bool:
        """True if a factorization of a sparse `kkt` takes more than `MOST_WORK` per entry, by a count.

        False without a count, which is compiled, if the matrix has a narrow band in another order, or if few rows or
        few columns have two entries: the other rows and columns are eliminated first.
        """
        from scipy.sparse.csgraph import reverse_cuthill_mckee  # slow to import

        P, C = self.stacked
        if not sp.issparse(P):
            return False
        of_column = np.bincount(np.append(P.indices, C.indices), minlength=P.shape[0])
        coupled = np.count_nonzero(of_column > 1)
        if is_diagonal(P):
            coupled = min(coupled, np.count_nonzero(self.terms.counts > 1))
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
        matrices = self._of_rows.get(key := left.tobytes())
        if matrices is None:  # another thread may replace the entry at any time
            P, G, A = self.arrays
            matrices = ProgramMatrices(P, G[left[left < m]], A[left[left >= m] - m])
            self._of_rows.clear()
            self._of_rows[key] = matrices
        return matrices

    def __getstate__(self) -> dict[str, Any]:
        """Drop the cache, because its values can be computed again."""
        return {"P": self.P, "G": self.G, "A": self.A, "_of_rows": {}}


def may_be_small(n: int, m: int, entries: Iterable[int]) -> bool:
    """Return whether a program with these counts of unknowns, rows and entries is small or dense: for daqp."""
    if not (0 < n <= 400 and m <= 1500):
        return False
    return n * n * (n + m) <= 1e7 or is_full(n, m, entries)


def is_full(n: int, m: int, entries: Iterable[int]) -> bool:
    """Return whether dense arithmetic is quicker on a program with these counts of unknowns, rows and entries."""
    # Sparse factors take more multiplications, of which fewer than .3 n² (n + m) are nonzero, more quickly
    return 0 < n + m <= FULL_UP_TO and sum(entries) >= 0.3 * n * (n + m)


def as_csr(matrix: AnyMatrix) -> sp.csr_array:
    """Return an ndarray or a CSR array as a CSR array."""
    return matrix if sp.issparse(matrix) else sp.csr_array(matrix)


def as_array(matrix: AnyMatrix) -> Vector:
    """Return a matrix as an ndarray."""
    return np.asarray(matrix.toarray() if sp.issparse(matrix) else matrix)
