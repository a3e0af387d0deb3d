"""Factors of square matrices: Cholesky and LU, dense and banded by LAPACK, sparse by SuperLU.

Use :func:`factorize` for any factorization, :func:`diagonal_pivot_factor` for pivots on the diagonal, as for
M-matrices, and :func:`positive_factor` for positive pivots, which prove a symmetric matrix definite.
:func:`factor_fits` predicts whether a factorization ends in reasonable time. No factorization is started if its
predicted end is after the time limit of the run. Ctrl-C acts after the current factorization. :func:`bands` returns the
diagonals of a matrix if a banded factorization is small.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, partial
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp

from ..core import deadline
from ..core.checks import DENSE_ABOVE_DENSITY, AnyMatrix, Vector, read_only
from ..core.entries import largest_in_rows, row_numbers, with_entries
from ..core.matrix import Matrix, fact
from ..core.tuning import DENSE_OPERATIONS, FACTOR_OPERATIONS_UP_TO, SPARSE_OPERATIONS
from .equilibration import power_of_two
from .minimum_degree import factor_sizes

BANDED_UP_TO = 64  # sub- plus superdiagonals up to which LAPACK's band is faster than SuperLU
# SuperLU keeps the diagonal pivot if it is at least this share of the column's largest
SYMMETRIC_PIVOT = 0.01

LARGEST_FILL = 2e8  # entries

IN_ONE_ORDER = {"permc_spec": "MMD_AT_PLUS_A", "options": {"SymmetricMode": True}}


@dataclass(frozen=True, eq=False)
class Factor:
    """Factorized matrix A.

    Attributes
    ----------
    solve, solve_transposed : callable
        right ↦ x with A x = right, or Aᵀx = right, shape (n,); not finite if A is singular.
    work : float
        Multiplications that the factorization took.
    solve_work : float
        Multiplications that one solve takes.
    """

    solve: Callable[[Any], Any]
    solve_transposed: Callable[[Any], Any]
    work: float
    solve_work: float


@dataclass(frozen=True, eq=False)
class PositiveFactor:
    """Factorization with positive pivots; `superlu` holds L and U of a sparse matrix, None of a dense one."""

    solve: Callable[[Any], Any]
    superlu: Any = None


def factorize(
    matrix: AnyMatrix, *, is_symmetric: bool = False, bandwidth: tuple[int, int] | None = None
) -> Factor | None:
    """Return a factor of a square matrix, or None if a pivot is exactly zero or the entries overflow.

    Parameters
    ----------
    matrix : ndarray or CSR array, shape (n, n)
        Not modified.
    is_symmetric : bool
        The matrix is symmetric up to rounding. If it is dense, Cholesky is tried first. If it is sparse, the order is
        computed from the pattern of A + Aᵀ, also used for unsymmetric matrices whose pattern is mostly symmetric.
    bandwidth : (int, int), optional
        Numbers of sub- and superdiagonals of a sparse matrix, if known.
    """
    if isinstance(matrix, np.ndarray):
        return _dense(matrix, is_symmetric)
    n = matrix.shape[0]
    is_dense = matrix.nnz > DENSE_ABOVE_DENSITY * n * n and n <= 3000
    # A sparse block this small is factorized as a dense block.
    if n <= 64 or is_dense:
        return _dense(matrix.toarray(), is_symmetric)
    if bandwidth is not None and sum(bandwidth) <= BANDED_UP_TO:
        return _banded_lu(matrix, *bandwidth)
    return _sparse_lu(matrix, is_symmetric)


def _dense(matrix: AnyMatrix, is_symmetric: bool) -> Factor | None:
    factor = None
    if is_symmetric and matrix.shape[0] and matrix.diagonal().min() > 0.0:
        factor = cholesky(matrix)
    return factor or dense_lu(matrix)


@cache
def lapack() -> Any:
    """Return scipy's module, cached because an import at each call takes longer than a small factorization."""
    from scipy.linalg import lapack as module

    return module


def positive_triangle(matrix: Vector) -> Vector | None:
    """Return the triangle of Cholesky's factor, as LAPACK has it; None if the matrix is not positive definite."""
    deadline.require_seconds(matrix.shape[0] ** 3 / 3.0 / DENSE_OPERATIONS)
    # A row-major upper triangle is LAPACK's lower triangle: no copy is transposed.
    factor, info = lapack().dpotrf(matrix.T, lower=1, clean=0)
    return factor if info == 0 else None


def cholesky(matrix: Vector) -> Factor | None:
    """Return A = UᵀU of a dense matrix, whose upper triangle is read, or None if A is not positive definite."""
    factor, n = positive_triangle(matrix), matrix.shape[0]
    if factor is None:
        return None

    def solve(right: Vector) -> Any:
        return lapack().dpotrs(factor, right, lower=1)[0]

    return Factor(solve, solve, n**3 / 6.0, float(n * n))


def dense_lu(matrix: Vector) -> Factor | None:
    """Return the LU factor of a dense matrix with partial pivoting, or None if a pivot is zero.

    LAPACK factorizes Aᵀ, which needs no transposed copy. An empty matrix is regular, for example on the coarsest grid
    of a rank without rows. LAPACK would report an illegal value for it.
    """
    n = matrix.shape[0]
    if n == 0:
        return Factor(np.copy, np.copy, 0.0, 0.0)
    deadline.require_seconds(n**3 / 1.5 / DENSE_OPERATIONS)
    factor, pivots, info = lapack().dgetrf(matrix.T)
    if info != 0:
        return None

    def solver(trans: int) -> Callable[[Any], Any]:
        return lambda right: lapack().dgetrs(factor, pivots, right, trans=trans)[0]

    return Factor(solver(1), solver(0), n**3 / 3.0, float(n * n))


def _banded_lu(matrix: sp.csr_array, below: int, above: int) -> Factor | None:
    n = matrix.shape[0]
    band = np.zeros((2 * below + above + 1, n), order="F")
    band[below + above + row_numbers(matrix) - matrix.indices, matrix.indices] = matrix.data
    deadline.require_seconds(2.0 * n * below * (below + above + 1) / SPARSE_OPERATIONS)
    factor, pivots, info = lapack().dgbtrf(band, below, above, overwrite_ab=1)
    if info != 0:
        return None

    def solver(trans: int) -> Callable[[Any], Any]:
        return lambda right: lapack().dgbtrs(factor, below, above, right, pivots, trans=trans)[0]

    work = float(n * below * (below + above + 1))
    return Factor(solver(0), solver(1), work, float(n * (2 * below + above + 1)))


def _sparse_lu(matrix: sp.csr_array, is_symmetric: bool) -> Factor | None:
    if not np.isfinite(matrix.data).all():
        return None
    options: dict[str, Any] = {"permc_spec": "COLAMD"}
    if is_symmetric or _suits_one_order(matrix):
        options = {"diag_pivot_thresh": SYMMETRIC_PIVOT} | IN_ONE_ORDER
    try:
        # CSR of A is CSC of Aᵀ: factorize Aᵀ and solve with its transpose
        factor = sparse_lu(matrix.T, **options)
    except RuntimeError:
        return None

    # Each pivot multiplies its column of L with its row of U.
    columns_of_lower = np.diff(factor.L.indptr).astype(np.float64)
    rows_of_upper = np.bincount(factor.U.indices, minlength=factor.shape[0])
    work = float(columns_of_lower @ rows_of_upper)
    solvers = partial(factor.solve, trans="T"), partial(factor.solve, trans="N")
    return Factor(*solvers, work, float(factor.nnz))


def _suits_one_order(matrix: sp.csr_array) -> bool:
    """Return whether one order of rows and columns is best, as on grids with a wind: half the fill, or less.

    The diagonal entries are large enough for pivots, and most entries have a mirror entry.
    """
    if not bool((np.abs(matrix.diagonal()) >= SYMMETRIC_PIVOT * largest_in_rows(matrix)).all()):
        return False
    pattern = with_entries(matrix, np.ones(matrix.nnz))
    # If most entries have a mirror entry, A is ordered as A + Aᵀ.
    return bool(pattern.multiply(pattern.T).nnz >= 0.8 * matrix.nnz)


def sparse_lu(matrix: AnyMatrix, **options: Any) -> Any:
    """Return SuperLU's factorization of a square sparse matrix, with the options of scipy's `splu`.

    Raises
    ------
    RuntimeError
        If a pivot is exactly zero (SuperLU's error), or if no order of the rows avoids a zero pivot, because SuperLU
        then reads and writes outside its arrays.

    Examples
    --------
    >>> sparse_lu(sp.csc_array([[0.0, 1.0], [2.0, 0.0]])).solve(np.array([3.0, 4.0]))
    array([2., 3.])
    >>> sparse_lu(sp.csc_array([[0.0, 1.0], [0.0, 2.0]]))
    Traceback (most recent call last):
    RuntimeError: no order of the rows puts a nonzero on each place of the diagonal
    """
    from scipy.sparse.linalg import splu

    matrix = sp.csc_array(matrix)
    if not (matrix.diagonal() != 0.0).all():
        from scipy.sparse.csgraph import structural_rank

        pattern = sp.csr_array(matrix, copy=True)  # zeros are taken out in place
        pattern.eliminate_zeros()
        if not np.diff(pattern.indptr).all() or structural_rank(pattern) < matrix.shape[0]:
            raise RuntimeError("no order of the rows puts a nonzero on each place of the diagonal")
    if deadline.enforced_left() < matrix.shape[0] ** 3 / SPARSE_OPERATIONS:
        deadline.require_seconds(factor_sizes(matrix, LARGEST_FILL, np.inf)[1] / SPARSE_OPERATIONS)
    return splu(matrix, **options)


def diagonal_pivot_factor(matrix: AnyMatrix) -> Any:
    """Return SuperLU's factorization with diagonal pivots, in one order for rows and columns; None if singular.

    That order is a preference: a pivot of 0 is exchanged; callers that need it compare `perm_r` with `perm_c`.
    """
    try:
        return sparse_lu(matrix, diag_pivot_thresh=0.0, **IN_ONE_ORDER)
    except RuntimeError:
        return None


def positive_factor(matrix: AnyMatrix) -> PositiveFactor | None:
    """Return the factor of a symmetric matrix if all pivots are positive and from the diagonal, else None.

    Parameters
    ----------
    matrix : ndarray or sparse array, shape (n, n)
    """
    if not sp.issparse(matrix):
        dense = cholesky(matrix)
        return None if dense is None else PositiveFactor(dense.solve)
    factor = diagonal_pivot_factor(matrix)
    is_on_diagonal = factor is not None and np.array_equal(factor.perm_r, factor.perm_c)
    if not (is_on_diagonal and (factor.U.diagonal() > 0.0).all()):
        return None
    return PositiveFactor(factor.solve, factor)


def factor_fits(matrix: AnyMatrix) -> bool:
    """Return whether a factorization of a CSR or CSC array ends in reasonable time, by the counts of its columns."""
    # On few rows any fill is cheap.
    limits = LARGEST_FILL, FACTOR_OPERATIONS_UP_TO
    return matrix.shape[0] <= 1_000 or factor_sizes(matrix, *limits)[0] < np.inf


@fact
def sizes_of_factor(matrix: Matrix) -> tuple[float, float]:
    """Return the entries of L and the operations Σ count² of a factorization of M; ∞ and ∞ if it is too large."""
    return factor_sizes(matrix.csr, LARGEST_FILL, FACTOR_OPERATIONS_UP_TO)


def factor_operations(matrix: Matrix, most: float) -> float:
    """Return the operations of a factorization of M; ∞ if a sparse M takes more than `most`, which ends the count."""
    if matrix.is_dense:
        return matrix.n**3 / 3.0
    return factor_sizes(matrix.csr, LARGEST_FILL, min(most, FACTOR_OPERATIONS_UP_TO))[1]


class Bands(NamedTuple):
    """Diagonals of a matrix.

    Attributes
    ----------
    entries : ndarray, shape (k, n)
        entries[k, i] = m_{i, i+k−below}; 0 outside of M.
    below : int
        The number of subdiagonals.
    weights : ndarray, shape (n,)
        Powers of two that bring the rows to size 1.
    is_tridiagonal_z : bool
        At most one diagonal on either side, without positive entries, and a positive main diagonal.
    """

    entries: Vector
    below: int
    weights: Vector
    is_tridiagonal_z: bool


@fact
def bands(matrix: Matrix) -> Bands | None:
    """Return the bands of M; None if a banded factorization would be too large."""
    M = matrix.csr
    rows = row_numbers(M)
    offsets = M.indices - rows
    below, above = max(0, -int(offsets.min(initial=0))), max(0, int(offsets.max(initial=0)))
    width = below + above + 1.0
    if matrix.n * width > LARGEST_FILL or matrix.n * width * below > FACTOR_OPERATIONS_UP_TO:
        return None
    if max(below, above) <= 1:
        below = above = 1
    entries = np.zeros((below + above + 1, matrix.n))
    entries[offsets + below, rows] = M.data
    is_z = below == above == 1 and (entries[::2] <= 0.0).all() and (entries[1] > 0.0).all()
    weights = read_only(1.0 / power_of_two(matrix.residual_scale, 1000))
    return Bands(read_only(entries), below, weights, bool(is_z))
