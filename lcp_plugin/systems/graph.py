"""Graph of M: bandwidth, neighbors.

The comparison matrix ⟨M⟩ and its row sums: with a rigorous bound of the rounding error, and exact. Approximate
solutions of its equilibrated systems: none is rigorous, :mod:`lcp_plugin.proofs.verdicts` verifies them.
"""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
import scipy.sparse as sp

from ..core import entries
from ..core.checks import AnyMatrix, Vector, read_only
from ..core.entries import Exponents, IntVector, row_numbers, with_entries
from ..core.matrix import Matrix, fact
from ..core.rounding import compensated_product, lower_end, upper_end
from ..core.structure import ROUNDED, mismatch
from .equilibration import scaling_exponents
from .factors import dense_lu, diagonal_pivot_factor, factor_fits
from .hierarchy.levels import build_hierarchy
from .hierarchy.truncation import KrylovCorrection, Truncation

if TYPE_CHECKING:
    from .hierarchy.grids import Hierarchy


def comparison_of(M: AnyMatrix) -> sp.csr_array:
    """Return ⟨M⟩ for a CSR array, or for rows of an array whose first columns belong to these rows."""
    magnitudes = np.abs(M.data)
    return with_entries(M, np.where(row_numbers(M) == M.indices, magnitudes, -magnitudes))


def comparison_product(M: AnyMatrix, v: Vector) -> tuple[Vector, Vector]:
    """Return (value, radius) with |⟨M⟩v − value| ≤ radius; ⟨M⟩ has |m_ii| on, −|m_ij| off the diagonal.

    Parameters
    ----------
    M : CSR array, shape (n, n)
    v : array, shape (n,)

    Returns
    -------
    value, radius : arrays, shape (n,)
        As for :func:`compensated_product`.

    Raises
    ------
    InvalidProblem
        If the shapes do not fit.

    Examples
    --------
    >>> import numpy as np
    >>> import scipy.sparse as sp
    >>> value, radius = comparison_product(sp.csr_array(np.array([[2.0, 1.0], [-3.0, 3.0]])), np.ones(2))
    >>> value, radius
    (array([1., 0.]), array([0., 0.]))
    """
    return compensated_product(comparison_of(M), v)


def exact_comparison_row(M: AnyMatrix, v: Vector, row: int) -> Fraction:
    """Return (⟨M⟩v)_row without any rounding; M a CSR array, v finite."""
    total = Fraction(0)
    for k in range(M.indptr[row], M.indptr[row + 1]):
        column = int(M.indices[k])
        product = abs(Fraction(float(M.data[k]))) * Fraction(float(v[column]))
        total += product if column == row else -product
    return total


@np.errstate(all="ignore")
def outer_on_pattern(matrix: Matrix, left: Vector, right: Vector) -> sp.csr_array:
    """Return left_i right_j on the sparsity pattern of M.

    Parameters
    ----------
    left, right : array, shape (n,)

    Examples
    --------
    >>> outer_on_pattern(Matrix([[4.0, 1.0], [0.0, 4.0]]), np.array([2.0, 3.0]), np.array([1.0, 5.0])).toarray()
    array([[ 2., 10.],
           [ 0., 15.]])
    """
    return sum_of_outer(matrix.csr, left[np.newaxis], right[np.newaxis])


def sum_of_outer(A: sp.csr_array, left: Vector, right: Vector) -> sp.csr_array:
    """Return Σ_k left_ki right_kj on the sparsity pattern of A; shapes (k, m) and (k, n)."""
    return with_entries(A, np.einsum("kp,kp->p", left[:, row_numbers(A)], right[:, A.indices]))


def block_rows(labels: IntVector) -> list[IntVector]:
    """Return the row numbers of each block, in order of the labels."""
    order = np.argsort(labels, kind="stable")
    return np.split(order, np.cumsum(np.bincount(labels))[:-1])


@fact
def row_excess_signs(matrix: Matrix) -> IntVector:
    """Exact signs of |m_ii| − Σ_j≠i |m_ij|, shape (n,)."""
    M, ones = matrix.csr, np.ones(matrix.n)
    value, radius = comparison_product(M, ones)
    is_negative = upper_end(value, radius) < 0.0
    signs = (lower_end(value, radius) > 0.0).astype(np.int64) - is_negative
    for row in np.flatnonzero((signs == 0) & (radius > 0.0)):
        exact = exact_comparison_row(M, ones, int(row))
        signs[row] = (exact > 0) - (exact < 0)
    return read_only(signs)


@fact
def bandwidth(matrix: Matrix) -> tuple[int, int] | None:
    """Return the numbers of sub- and superdiagonals of a sparse M, None if M is kept dense."""
    M = matrix.array
    if not sp.issparse(M):
        return None
    offsets = M.indices.astype(np.int64) - row_numbers(M)
    return (max(0, -int(offsets.min())), max(0, int(offsets.max()))) if offsets.size else (0, 0)


BlockSolver = Callable[[Vector], Vector]


class ComparisonMatrix:
    """⟨M⟩ scaled by powers of two to a diagonal near 1 if M needs it, and approximate solutions of its systems.

    Parameters
    ----------
    M : CSR array, shape (n, n)
        Matrix with a nonzero diagonal.

    Attributes
    ----------
    matrix : CSR array, shape (n, n)
        ⟨M⟩ with entries scaled by 2^(row_i + column_j).
    exponents : Exponents or None
        None if nothing was scaled.
    diagonal : array, shape (n,)
        Diagonal of `matrix`, positive.
    """

    def __init__(self, M: AnyMatrix) -> None:
        self.is_symmetric = mismatch(M, np.abs(M.diagonal()), ROUNDED)[1] is None
        self.exponents: Exponents | None = scaling_exponents(M, self.is_symmetric)
        self.matrix = entries.scale_matrix(comparison_of(M), self.exponents)
        self.diagonal: Vector = self.matrix.diagonal()

    @cached_property
    def hierarchy(self) -> Hierarchy:
        """The grids of the matrix."""
        return build_hierarchy(self.matrix)

    @cached_property
    def direct_solver(self) -> BlockSolver | None:
        """Rhs ↦ matrix⁻¹ rhs by a factorization; None if the matrix is singular or too large."""
        if not factor_fits(self.matrix):
            return None
        # A dense LU of so few rows is faster than a sparse LU.
        is_small = self.matrix.shape[0] <= 300
        factor = dense_lu(self.matrix.toarray()) if is_small else diagonal_pivot_factor(self.matrix)
        return None if factor is None else factor.solve

    def solve(self, rhs: Vector, tolerance: float = 0.1) -> Vector | None:
        """Return an approximate solution, shape (n,), or None if no method applies.

        The matrix is then singular, or too large for a factorization if multigrid fails. `tolerance` bounds
        ‖residual‖₂/‖rhs‖₂ if the solution is iterative.
        """
        # Below, a sparse LU is as fast as a hierarchy.
        if rhs.size > 5_000:
            correction = KrylovCorrection(Truncation(self.hierarchy), rhs.copy(), self.is_symmetric)
            goal = tolerance * np.linalg.norm(correction.residual)
            for _ in range(60):
                if not np.linalg.norm(correction.residual) > goal or not correction.step():
                    break
            x = correction.solution
            if np.linalg.norm(correction.residual) <= goal and np.isfinite(x).all():
                return x
        if self.direct_solver is None:
            return None
        x = np.asarray(self.direct_solver(rhs))
        return x if np.isfinite(x).all() else None

    def to_caller(self, x: Vector) -> Vector:
        """Return the unscaled vector for a vector x of the scaled matrix, shape (n,)."""
        return entries.times_power(x, None if self.exponents is None else self.exponents.column)
