"""A square matrix in canonical, read-only form; the decorator `fact` caches its properties.

The matrix and its properties, each computed once, at first use.

Structure of a matrix: triangular form, connected components, and symmetry up to rounding.

The components are those of the graph of M: no entry couples two of them. Symmetry is relative to the size of the rows:
sweeps, factors and energies do not see a small entry in a row of large ones, and an assembly leaves rounding of these
where an entry ought to be 0.

The data of an iteration that convergence theorems require.

Row data for sweeps and their theorems: scales, splits, sums over both triangles, the row scaling of NP methods.

Row and column scaling by exact powers of two.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Hashable
from dataclasses import dataclass, field
from functools import cached_property, update_wrapper
from typing import Any, Generic, NamedTuple, TypeVar, TypeVarTuple

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from .checks import BoolVector, Vector, assemble_csr, checked_matrix, freeze_csr, read_only
from .kernels.floats import NEGLIGIBLE_DIAGONAL

T = TypeVar("T")
Ts = TypeVarTuple("Ts")


class fact(Generic[T, *Ts]):  # noqa: N801 - a decorator
    """Decorator of a function of a matrix or a problem (and hashable arguments): its value is cached in that object.

    Such a function may be in any module; the function itself is the key of the cache.

    Examples
    --------
    >>> @fact
    ... def trace(matrix: Matrix) -> float:
    ...     print("summed")
    ...     return float(matrix.diagonal.sum())
    >>> identity = Matrix([[1.0, 0.0], [0.0, 1.0]])
    >>> trace(identity), trace(identity)
    summed
    (2.0, 2.0)
    """

    def __init__(self, compute: Callable[[Any, *Ts], T]) -> None:
        self._compute = compute
        update_wrapper(self, compute)

    def __call__(self, matrix: Any, *args: *Ts) -> T:
        """Return the cached value; compute it at the first call."""
        key, facts = (self, *args), matrix._facts
        if key not in facts:
            owner = getattr(matrix, "matrix", matrix)  # of a problem
            with owner._lock:
                if key not in facts and owner._is_computing:  # another fact needs this one
                    facts[key] = self._compute(matrix, *args)
                elif key not in facts:
                    owner._is_computing = True
                    try:
                        with np.errstate(all="ignore"):  # an overflow shows in the value
                            facts[key] = self._compute(matrix, *args)
                    finally:
                        owner._is_computing = False
        value: T = facts[key]
        return value

    def is_known(self, matrix: Matrix, *args: Hashable) -> bool:
        """Return whether the value is cached."""
        return (self, *args) in matrix._facts


class Matrix:
    """A real, finite, square matrix as canonical CSR, or as an ndarray where it is small and dense.

    Parameters
    ----------
    M : array or sparse array, shape (n, n)
        Matrix as for :class:`lcp_plugin.LCP`.

    Attributes
    ----------
    array : csr_array or ndarray, shape (n, n)
        The stored matrix: an ndarray if it is dense and small.
    n : int
        Number of rows.
    is_dense : bool
        True if it is stored as an ndarray.
    nonzeros : int
        Number of nonzero entries.

    Raises
    ------
    InvalidProblem
        If M is not such a matrix.

    Examples
    --------
    >>> Matrix([[4, 1e-12], [1, 0]]).residual_scale
    array([4., 1.])
    """

    def __init__(self, M: Any) -> None:
        self.array, self.nonzeros = checked_matrix(M)
        self.n: int = self.array.shape[0]
        self.is_dense = isinstance(self.array, np.ndarray)
        self._facts: dict[Hashable, Any] = {}
        self._lock, self._is_computing = threading.RLock(), False

    @cached_property
    def csr(self) -> sp.csr_array:
        """The matrix as canonical, read-only CSR, shape (n, n)."""
        return csr_of_dense(self.array) if self.is_dense else self.array

    def toarray(self) -> Vector:
        """Return M as an ndarray, shape (n, n), not copied if it is stored as one."""
        return self.array if self.is_dense else self.array.toarray()

    @property
    @fact
    def diagonal(self) -> Vector:
        """The diagonal entries, shape (n,)."""
        return read_only(np.array(self.array.diagonal(), dtype=np.float64))

    @property
    @fact
    def residual_scale(self) -> Vector:
        """D of the scaled residual, shape (n,): the diagonal where it is not negligible, else the row's largest.

        d_i = m_ii where m_ii ≥ 2⁻²⁰ max_j |m_ij|, else max_j |m_ij|, and 1 for an empty row.
        """
        entries, diagonal = self.array if self.is_dense else self.array.data, self.diagonal
        least, most = (ends.reduce(entries, None, initial=0.0) for ends in (np.minimum, np.maximum))
        largest, smallest = max(most, -least), np.minimum.reduce(diagonal, initial=np.inf)
        if smallest > 0.0 and smallest >= NEGLIGIBLE_DIAGONAL * largest:
            return diagonal  # without a search in each row
        return read_only(residual_scales(diagonal, largest_in_rows(self.array)))

    @property
    @fact
    def row_largest(self) -> Vector:
        """max_j |m_ij| of each row, 1 for an empty one, shape (n,)."""
        row_largest = largest_in_rows(self.array)
        return read_only(np.where(row_largest == 0.0, 1.0, row_largest))

    def __reduce__(self) -> tuple[Any, ...]:
        """Return the matrix without cached values and without the lock; a copy is checked again."""
        return type(self), (self.array,)


def csr_of_dense(dense: Vector) -> sp.csr_array:
    """Return a dense matrix as CSR; its entries are used without a copy if none is zero."""
    n = len(dense)
    if np.count_nonzero(dense) < dense.size or not dense.flags.c_contiguous:
        return freeze_csr(sp.csr_array(dense))
    columns = np.tile(np.arange(n, dtype=np.int32), n)
    rows = np.arange(0, n * n + 1, n, dtype=np.int32) if n else np.zeros(1, np.int32)
    compressed = sp.csr_array((dense.reshape(-1), columns, rows), shape=dense.shape)
    compressed.has_sorted_indices = compressed.has_canonical_format = True
    return freeze_csr(compressed)


def largest_in_rows(M: Any, sizes: Vector | None = None) -> Vector:
    """Return the largest |entry| of each row, 0 for an empty row.

    `sizes`, shape (…, entries), replaces the |entries| of a CSR array.
    """
    if not sp.issparse(M):
        return np.asarray(np.abs(M).max(axis=1, initial=0.0), dtype=np.float64)
    sizes = np.abs(M.data) if sizes is None else sizes
    largest = np.zeros((*sizes.shape[:-1], M.shape[0]))
    filled = np.flatnonzero(np.diff(M.indptr))
    if filled.size:
        largest[..., filled] = np.maximum.reduceat(sizes, M.indptr[filled], axis=-1)
    return largest


def count_entries(matrix: Any) -> int:
    """Return the number of nonzeros of an ndarray or a CSR array."""
    return int(matrix.nnz if sp.issparse(matrix) else np.count_nonzero(matrix))


def largest_products(sizes: Any, x: Vector) -> Vector:
    """Return max_j |m_ij| x_j of each row, x ≥ 0; `sizes` is |M|, of one problem or, dense, of a stack."""
    if sp.issparse(sizes):
        return largest_in_rows(sizes, sizes.data * x[..., sizes.indices])
    return np.asarray((sizes * x[..., None, :]).max(-1, initial=0.0))


def residual_scales(diagonal: Vector, largest: Vector) -> Vector:
    """Return D of the scaled residual from the diagonal and the largest |entry| of each row, arrays of one shape."""
    # The product may underflow to 0, which no diagonal of 0 may pass.
    is_usable = (diagonal > 0.0) & (diagonal >= NEGLIGIBLE_DIAGONAL * largest)
    return np.where(largest == 0.0, 1.0, np.where(is_usable, diagonal, largest))


ROUNDED = 1e-13  # asymmetry relative to the size of the rows that rounding explains
IntVector = np.ndarray[Any, np.dtype[np.int64]]


def row_numbers(M: Any) -> IntVector:
    """Return the row number of each stored entry of a CSR array, shape (nnz,)."""
    return np.repeat(np.arange(M.shape[0], dtype=M.indices.dtype), np.diff(M.indptr))


@fact
def triangular_form(matrix: Matrix) -> str | None:
    """Return "diagonal", "lower", "upper", or None."""
    M = matrix.csr
    rows = row_numbers(M)
    if (rows == M.indices).all():
        return "diagonal"
    if (rows >= M.indices).all():
        return "lower"
    return "upper" if (rows <= M.indices).all() else None


@dataclass(frozen=True, eq=False)
class Components:
    """The connected components of a matrix that has several.

    Attributes
    ----------
    labels : array of int, shape (n,)
        Numbers of components, from 0 on.
    count : int
        Number of components.
    """

    labels: IntVector
    count: int


def entries_of_row(matrix: Any, i: int) -> tuple[list[int], list[float]]:
    """Return the columns and the values of the entries of row i of a CSR array."""
    part = slice(matrix.indptr[i], matrix.indptr[i + 1])
    return matrix.indices[part].tolist(), matrix.data[part].tolist()


@fact
def connected_components(matrix: Matrix) -> Components | None:
    """Return the connected components of the graph of M; None if there is only one.

    Examples
    --------
    >>> connected_components(Matrix([[2.0, 0.0, 1.0], [0.0, 3.0, 0.0], [0.0, 0.0, 2.0]])).labels
    array([0, 1, 0])
    >>> connected_components(Matrix([[2.0, 1.0], [0.0, 2.0]])) is None
    True
    """
    n, M = matrix.n, matrix.array
    # Rows are connected if each but the first has an entry left of its diagonal, in a dense M also one above it.
    if n < 2 or (matrix.is_dense and M[0].all()):
        return None
    if matrix.is_dense:
        is_filled = np.tril((M != 0.0) | (M.T != 0.0), -1).any(axis=1)[1:].all()
    else:
        starts, first = M.indptr, np.arange(1, n, dtype=M.indices.dtype)
        is_filled = (starts[2:] > starts[1:-1]).all() and (M.indices[starts[1:-1]] < first).all()
    if is_filled:
        return None
    from scipy.sparse.csgraph import connected_components as labeled

    count, labels = labeled(matrix.csr, directed=False)
    return Components(read_only(labels.astype(np.int64)), int(count)) if count > 1 else None


def mismatch(M: Any, size: Vector, tolerance: float) -> tuple[float, tuple[int, int] | None]:
    """Return max |m_ij − m_ji|, and the i, j where it exceeds tolerance √(size_i size_j) by most, if it does.

    With this measure, a block in a small unit is not compared with a block in a large unit.

    Parameters
    ----------
    M : ndarray or CSR array, shape (n, n)
    size : array, shape (n,)
        Not negative.
    tolerance : float

    Examples
    --------
    >>> M = np.array([[2.0, 1e-20], [0.0, 2.0]])
    >>> mismatch(M, M.diagonal(), ROUNDED)
    (1e-20, None)
    """
    root = np.sqrt(size)
    if isinstance(M, np.ndarray):
        if np.array_equal(M, M.T):
            return 0.0, None
        distance = np.abs(M - M.T)
        excess = distance - tolerance * np.outer(root, root)
        i, j = map(int, np.divmod(excess.argmax(), len(M)))
        return float(distance.max()), (i, j) if excess[i, j] > 0.0 else None
    rows, columns = M.tocsr(), M.tocsc()  # a faster test than the difference
    parts = ("indptr", "indices", "data")
    if all(np.array_equal(getattr(rows, part), getattr(columns, part)) for part in parts):
        return 0.0, None
    difference = sp.coo_array(M - M.T)
    if not difference.nnz:
        return 0.0, None
    rows, columns, distance = difference.row, difference.col, np.abs(difference.data)
    excess = distance - tolerance * root[rows] * root[columns]
    k = excess.argmax()
    return float(distance.max()), (int(rows[k]), int(columns[k])) if excess[k] > 0.0 else None


@fact
def is_nearly_symmetric(matrix: Matrix) -> bool:
    """Return whether M = Mᵀ up to rounding, relative to the size of its rows and columns.

    An incorrect result would cost speed, not correctness: every z is tested by its residual.
    """
    return mismatch(matrix.array, matrix.residual_scale, ROUNDED)[1] is None


def equation_signs(M: Any, is_equation: BoolVector) -> Vector:
    """Return −1 for each equation whose negative makes M + Mᵀ smaller, else 1; only equations with m_ii = 0 change.

    An unknown without bounds leaves w_i = 0, an equation, of which the sign has no meaning. In the conditions of a
    program, M + Mᵀ is semidefinite for one of both signs. The residual of the row is the same.

    Examples
    --------
    >>> equation_signs(np.array([[1.0, -2.0], [-2.0, 0.0]]), np.array([False, True]))
    array([ 1., -1.])
    """
    signs = np.ones(M.shape[0])
    if is_equation.any():
        products = (M.multiply(M.T) if sp.issparse(M) else M * M.T).sum(axis=1)
        signs[is_equation & (products > 0.0) & (M.diagonal() == 0.0)] = -1.0
    return signs


PROJECTED_TYPE = "projected type"
PROJECTED_SPLITTING = "projected splitting"
PROJECTED_RELAXATION = "projected relaxation"
MODULUS = "modulus"


@dataclass(frozen=True, eq=False, kw_only=True)
class IterationFacts:
    """The family and the parameters of an iteration, for convergence theorems.

    Attributes
    ----------
    family : str
        "projected type", "projected splitting", "projected relaxation" or "modulus".
    relaxation : float or None
        α (ω of a projected relaxation); None if it is found during the run.
    acceleration : float or None
        β.
    sweep : {"forward", "backward", "symmetric"}
    scaling : array, shape (n,), or None
        The diagonal of S of the projected-type families.
    omega : array, shape (n,), or None
        The diagonal of Ω of the modulus family.
    splitting : sparse array, shape (n, n), or None
        𝓜 of a projected splitting; `is_part_of_matrix` if each entry is 0 or the entry of M, with the full diagonal.
    has_momentum : bool
        Whether the iterates are extrapolated.
    """

    family: str
    relaxation: float | None = 1.0
    acceleration: float | None = 1.0
    sweep: str = "forward"
    scaling: Vector | None = field(default=None, repr=False)
    omega: Vector | None = field(default=None, repr=False)
    splitting: Any = field(default=None, repr=False)
    is_part_of_matrix: bool = False
    has_momentum: bool = False


BLOCK = 16_384  # rows whose temporary vectors stay in a processor's cache


@fact
def inverse_residual_scale(matrix: Matrix) -> Vector:
    """Return 1/d of the scaled residual, shape (n,), kept finite."""
    return read_only(np.minimum(1.0 / matrix.residual_scale, np.finfo(np.float64).max))


@fact
def has_positive_diagonal(matrix: Matrix) -> NDArray[np.bool_]:
    """Return the mask of diagonal entries that are positive and not too small to invert, shape (n,)."""
    return read_only((matrix.diagonal > 0.0) & np.isfinite(1.0 / matrix.diagonal))


@fact
def row_splits(matrix: Matrix, backward: bool) -> Any:
    """Return where the updated columns of each row end, for a sweep direction, shape (n,)."""
    return split_rows(matrix.csr, backward=backward)


def split_rows(M: sp.csr_array, *, backward: bool = False) -> Any:
    """Return the position of the first column ≥ i of each row i, or > i if backward, shape (n,)."""
    rows = row_numbers(M)
    is_before = M.indices <= rows if backward else M.indices < rows
    before = np.bincount(rows[is_before], minlength=M.shape[0])
    return read_only((M.indptr[:-1] + before).astype(M.indptr.dtype))


def triangle_sums(matrix: Matrix, v: Vector, part: Any = None) -> tuple[Vector, Vector]:
    """Return (|L|v, |U|v), each row divided by the scale of its residual, shapes (n,).

    If a CSR array `part`, shape (n, n), is given, its triangles replace the triangles of M.
    """
    M = matrix.csr if part is None else part
    rows = row_numbers(M)
    size = np.abs(M.data) * inverse_residual_scale(matrix)[rows]
    triangle = sp.csr_array((size * (M.indices < rows), M.indices, M.indptr), shape=M.shape)
    lower = triangle @ v
    triangle.data = size * (M.indices > rows)
    return lower, triangle @ v


@fact
def unit_triangle_sums(matrix: Matrix) -> tuple[Vector, Vector]:
    """Return the triangle sums of v = 1."""
    return triangle_sums(matrix, np.ones(matrix.n))


def automatic_factors(matrix: Matrix, coupling: float, sweep: str) -> Vector:
    """Return θ, shape (n,): up to 2 if every row of M is diagonally dominant, else 1 on all rows; one pass over M.

    Parameters
    ----------
    matrix : Matrix
    coupling : float
        g = β/α.
    sweep : str
        "forward", "backward" or "symmetric".

    Notes
    -----
    NP with S = θ_i/d_i, α > 0 and the coupling g = β/α in [0, 2] converges where, for some v > 0 with ⟨M⟩v > 0,

        θ_i ≤ 2   and   g θ_i ℓ_i < 1,      ℓ_i = (|L|v)_i/(d_i v_i) with L the part of M that the sweep has updated

    (θ_i ≤ 1 needs g ≤ 1 and nothing else). If all rows are dominant, d_i ≥ Σ|m_ij|, v may be taken as near to 1 as
    one likes: with ⟨M⟩y > 0 also ⟨M⟩(1 + εy) > 0. There one pass over M decides, and θ balances the two parts of the
    answer. On z* > 0 an iteration contracts by about 1 − 2θ(1 − ℓ − u)/p, on w* > 0 by 1 − 2/p, p = θ/α + θ + 2: equal
    for θ = 1/(1 − ℓ − u). On the gallery larger θ than 2 lost again where the rows are far from equal.
    """
    lower, upper = unit_triangle_sums(matrix)
    updated = (
        lower if sweep == "forward" else upper if sweep == "backward" else np.maximum(lower, upper)
    )
    return balanced_factors(matrix, abs(coupling), updated, (lower, upper))


def balanced_factors(
    matrix: Matrix, coupling: float, updated: Vector, sums: tuple[Vector, Vector]
) -> Vector:
    """Return θ of `automatic_factors`, from g, the sums ℓ over the updated columns, and the triangle sums of v = 1."""
    total = sums[0] + sums[1]
    is_scaled = np.array_equal(matrix.residual_scale, matrix.diagonal)
    if not (is_scaled and total.max(initial=0.0) <= 1.0 + ROUNDED):  # nor is a NaN
        return read_only(np.ones(matrix.n))
    quick = np.minimum(2.0, 1.0 / np.maximum(1.0 - total, 0.0))  # a factor is at most 2
    # g θ ℓ stays below 1.
    return read_only(np.minimum(quick, 0.9 / (coupling * updated)))


class Exponents(NamedTuple):
    """One exponent per row and per column: the scaled matrix has entries m_ij 2^(row_i + column_j)."""

    row: IntVector
    column: IntVector


def scale_matrix(M: Any, exponents: Exponents | None) -> Any:
    """Return the array or CSR array with entries m_ij 2^(row_i + column_j)."""
    if exponents is None:
        return M
    row, column = (side.astype(np.int32) for side in exponents)
    if not sp.issparse(M):
        return times_power(M, row[:, None] + column)
    data = times_power(M.data, row[row_numbers(M)] + column[M.indices])
    return sp.csr_array((data, M.indices, M.indptr), shape=M.shape)


def scale_by(A: Any, rows: Vector, columns: Vector) -> Any:
    """Return the array or CSR array with entries a_ij rows_i columns_j, multiplied in this order; A is canonical."""
    if not sp.issparse(A):
        return rows[:, np.newaxis] * A * columns
    data = A.data * rows[row_numbers(A)] * columns[A.indices]
    return assemble_csr(data, A.indices, A.indptr, A.shape)


def times_power(x: Vector, exponent: IntVector | None) -> Vector:
    """Return x_i 2^exponent_i, of the shape of x."""
    return x if exponent is None else np.asarray(np.ldexp(x, exponent))
