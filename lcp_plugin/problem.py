"""The linear complementarity problem: checked, canonical, read-only data."""

from __future__ import annotations

import threading
from collections.abc import Callable
from functools import cached_property
from os import PathLike
from typing import Any, TypeVar

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike, NDArray

from .errors import InvalidProblem

FloatVector = NDArray[np.float64]
T = TypeVar("T")

DENSE_ABOVE_DENSITY = 0.25
DENSE_UP_TO_SIZE = 5000
NEGLIGIBLE_DIAGONAL = 1e-10


class LCP:
    """Find z with lower ≤ z ≤ upper and w = M z + q complementary to it.

    For every row i: w_i ≥ 0 where z_i = lower_i, w_i = 0 where lower_i < z_i < upper_i, and w_i ≤ 0
    where z_i = upper_i. With the default bounds this is the classical problem z ≥ 0, w ≥ 0, zᵀw = 0;
    a row with bounds (−∞, ∞) is an equation.

    Parameters
    ----------
    M : array or sparse array, shape (n, n)
        Real, finite. Integers, booleans and single precision become float64. A canonical CSR array
        (sorted, no duplicates, no stored zeros) is used without a copy, so leave its entries as they are
        while the problem lives; nothing given is ever modified.
    q : array, shape (n,)
        Real, finite.
    lower, upper : scalar or array, shape (n,)
        Bounds of z in the unit of z; −∞ and ∞ are allowed, lower ≤ upper.

    Raises
    ------
    InvalidProblem
        Where the data do not state such a problem.

    References
    ----------
    Cottle, Pang, Stone, *The Linear Complementarity Problem*, SIAM 2009, doi:10.1137/1.9780898719000.

    Examples
    --------
    >>> problem = LCP([[2, 1], [1, 2]], [-5, 1])
    >>> problem
    LCP(n=2, nonzeros=4, bounds 0 ≤ z)
    >>> problem.slack([2.5, 0])
    array([0. , 3.5])
    """

    def __init__(
        self, M: Any, q: ArrayLike, *, lower: ArrayLike = 0.0, upper: ArrayLike = np.inf
    ) -> None:
        self._csr, self._dense = _checked_matrix(M)
        self.n: int = self.M.shape[0]
        self._set_vectors(q, lower, upper)
        self._shared = _Shared()

    def _set_vectors(self, q: ArrayLike, lower: ArrayLike, upper: ArrayLike) -> None:
        self.q: FloatVector = _finite_vector(q, "q", self.n)
        self.lower: FloatVector = _checked_bound(lower, "lower", self.n)
        self.upper: FloatVector = _checked_bound(upper, "upper", self.n)
        _check_order(self.lower, self.upper)

    @property
    def M(self) -> Any:
        """The matrix as it is kept: a CSR array, or an ndarray where it is dense and small, shape (n, n)."""
        return self._csr if self._dense is None else self._dense

    @property
    def csr(self) -> sp.csr_array:
        """The matrix as canonical, read-only CSR, shape (n, n)."""
        if self._csr is None:
            self._csr = self.shared("csr", lambda: _frozen(sp.csr_array(self._dense)))
        return self._csr

    @property
    def nonzeros(self) -> int:
        """Number of nonzero entries of M."""
        return int(self.csr.nnz)

    @property
    def is_plain(self) -> bool:
        """True for the classical problem: lower = 0 and upper = ∞ on every row."""
        return not self.lower.any() and bool(np.all(self.upper == np.inf))

    @property
    def diagonal(self) -> FloatVector:
        """The diagonal of M, shape (n,)."""
        return self.shared("diagonal", lambda: _read_only(np.array(self.M.diagonal(), dtype=np.float64)))

    @property
    def residual_scale(self) -> FloatVector:
        """D of the scaled residual, shape (n,): the diagonal where it is not negligible, else the row's largest.

        d_i = m_ii where m_ii ≥ 1e-10 max_j |m_ij|, else max_j |m_ij|, and 1 for an empty row.
        """
        return self.shared("residual_scale", lambda: _read_only(_residual_scale(self.M, self.diagonal)))

    @cached_property
    def nearest_to_zero(self) -> FloatVector:
        """z°, the point of [lower, upper] nearest to 0, shape (n,)."""
        return _read_only(np.clip(0.0, self.lower, self.upper))

    def slack(self, z: ArrayLike) -> FloatVector:
        """Return w = M z + q, shape (n,)."""
        if not isinstance(z, np.ndarray) or z.dtype != np.float64 or z.shape != (self.n,):
            z = real_vector(z, "z", self.n)
        w: FloatVector = self.M @ z
        w += self.q
        return w

    def with_q(self, q: ArrayLike, *, lower: ArrayLike | None = None, upper: ArrayLike | None = None) -> LCP:
        """Return the problem with another q (and bounds) that shares all that depends on M alone.

        Parameters
        ----------
        q : array, shape (n,)
            Real, finite.
        lower, upper : scalar or array, shape (n,), optional
            The present bounds by default.

        Raises
        ------
        InvalidProblem
            As the constructor.
        """
        other = object.__new__(LCP)
        other._csr, other._dense, other._shared, other.n = self._csr, self._dense, self._shared, self.n
        other._set_vectors(
            q, self.lower if lower is None else lower, self.upper if upper is None else upper
        )
        return other

    def shared(self, key: str, compute: Callable[[], T]) -> T:
        """Return what `compute` gives, kept under `key` and shared by all problems with this M."""
        return self._shared.get(key, compute)

    def save(self, path: str | PathLike[str]) -> None:
        """Write the problem to ``path``: one ``.npz`` file, or a folder of Matrix Market files.

        A path ending in ``.npz`` gets the keys data, indices, indptr, shape, q, lower, upper; any other
        path becomes a folder with M.mtx, q.mtx, lower.mtx, upper.mtx. The file appears whole or not at all.
        """
        from .problem_files import save

        save(self, path)

    @classmethod
    def load(cls, path: str | PathLike[str]) -> LCP:
        """Read a problem written by :meth:`save`, or a folder or prefix with ``M.mtx`` and ``q.mtx``.

        A bound of 1e20 or more in absolute value means ∞. Pickled content is never read.

        Raises
        ------
        UnreadableFile
            Where the file is missing, damaged, or no linear complementarity problem.
        """
        from .problem_files import load

        return load(path)

    def __repr__(self) -> str:
        return f"LCP(n={self.n}, nonzeros={self.nonzeros}, bounds {_describe_bounds(self.lower, self.upper)})"

    def __getstate__(self) -> dict[str, Any]:
        """Leave behind what can be computed again, and the cache, which holds a lock."""
        state = {k: v for k, v in self.__dict__.items() if k not in ("_shared", "nearest_to_zero")}
        return state | ({} if self._dense is None else {"_csr": None})

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._shared = _Shared()
        # Unpickled arrays are writable again.
        for array in (self.q, self.lower, self.upper):
            array.flags.writeable = False
        if self._dense is not None:
            self._dense.flags.writeable = False
        if self._csr is not None:
            self._csr = _frozen(self._csr)


class _Shared:
    """What depends on M alone, computed once, whichever thread asks first."""

    def __init__(self) -> None:
        self._lock = threading.RLock()
        self._values: dict[str, Any] = {}

    def get(self, key: str, compute: Callable[[], T]) -> T:
        try:
            value: T = self._values[key]
        except KeyError:
            with self._lock:
                if key not in self._values:
                    self._values[key] = compute()
                value = self._values[key]
        return value


def _read_only(array: NDArray[Any]) -> NDArray[Any]:
    view = array.view()
    view.flags.writeable = False
    return view


def _frozen(matrix: sp.csr_array) -> sp.csr_array:
    """Return the CSR array on read-only views of its own arrays, canonical flags set."""
    index_type = np.int32 if max(matrix.nnz, *matrix.shape) < 2**31 else np.int64
    frozen = sp.csr_array(matrix.shape, dtype=np.float64)
    frozen.data = _read_only(matrix.data)
    frozen.indices = _read_only(matrix.indices.astype(index_type, copy=False))
    frozen.indptr = _read_only(matrix.indptr.astype(index_type, copy=False))
    frozen.has_sorted_indices = True
    frozen.has_canonical_format = True
    return frozen


def _checked_matrix(M: Any) -> tuple[sp.csr_array | None, NDArray[np.float64] | None]:
    """Return (CSR, None), or (None, ndarray) where the matrix is small and dense."""
    if sp.issparse(M):
        _check_kind(M.dtype, "M must hold real numbers")
        _check_square(M.shape)
        try:
            return _canonical(M), None
        except (ValueError, IndexError, TypeError) as error:  # scipy's words for arrays that do not fit together
            if isinstance(error, InvalidProblem):
                raise
            raise InvalidProblem(f"M is a damaged sparse array: {error}; build it again") from error
    dense = _real_array(M, "M must hold real numbers")
    _check_square(dense.shape)
    if not np.isfinite(dense).all():
        row, column = np.argwhere(~np.isfinite(dense))[0]
        raise InvalidProblem(f"M must be finite, but M[{row}, {column}] = {dense[row, column]}; repair that entry")
    n = dense.shape[0]
    if n <= DENSE_UP_TO_SIZE and np.count_nonzero(dense) > DENSE_ABOVE_DENSITY * n * n:
        return None, _read_only(np.ascontiguousarray(dense))
    return _frozen(sp.csr_array(dense)), None


def _canonical(M: Any) -> sp.csr_array:
    """Return M as canonical, checked CSR; without a copy where it is that already."""
    if M.format == "csr":
        # A fresh array: scipy's own flags may be stale when somebody wrote into M.data.
        matrix = sp.csr_array((M.data, M.indices, M.indptr), shape=M.shape, copy=False)
    else:
        _check_before_conversion(M)
        matrix = sp.csr_array(M)
    matrix.check_format(full_check=True)
    if (np.diff(matrix.indptr) < 0).any():
        raise ValueError("index pointer values must form a non-decreasing sequence")
    if matrix.dtype != np.float64:
        with np.errstate(over="ignore"):
            matrix = matrix.astype(np.float64)
    if not matrix.has_canonical_format:
        matrix = matrix.copy()
        matrix.sum_duplicates()
    if np.count_nonzero(matrix.data) != matrix.nnz:
        matrix = matrix.copy()
        matrix.eliminate_zeros()
    if not _all_finite(matrix.data):
        where = int(np.flatnonzero(~np.isfinite(matrix.data))[0])
        row = int(np.searchsorted(matrix.indptr, where, side="right")) - 1
        raise InvalidProblem(
            f"M must be finite, but M[{row}, {matrix.indices[where]}] = {matrix.data[where]}; repair that entry"
        )
    return _frozen(matrix)


def _check_before_conversion(M: Any) -> None:
    """Raise where scipy's conversion to CSR would read or write outside its arrays."""
    if M.format in ("csc", "bsr"):
        M.check_format(full_check=True)
        if (np.diff(M.indptr) < 0).any():
            raise ValueError("index pointer values must form a non-decreasing sequence")
    elif M.format == "coo":
        if not M.row.size == M.col.size == M.data.size:
            raise ValueError("row, column and data arrays must have the same length")
        for index in (M.row, M.col):
            if index.size and not 0 <= index.min() <= index.max() < M.shape[0]:
                raise ValueError(f"indices must lie in 0 … {M.shape[0] - 1}")
    elif M.format == "lil" and any(len(a) != len(b) for a, b in zip(M.rows, M.data, strict=True)):
        raise ValueError("each row must have as many values as columns")


def _all_finite(values: FloatVector) -> bool:
    """Return whether all are finite; one pass and no temporary in the usual case."""
    with np.errstate(over="ignore", invalid="ignore"):
        return bool(np.isfinite(values.sum())) or bool(np.isfinite(values).all())


def _check_kind(dtype: np.dtype[Any], need: str) -> None:
    if dtype.kind not in "fiub":
        what = {"c": "complex", "O": "object", "U": "text", "S": "bytes", "M": "dates", "m": "durations"}
        raise InvalidProblem(
            f"{need}, got {what.get(dtype.kind, dtype.name)} entries (dtype {dtype}); convert them first"
        )


def _check_square(shape: tuple[int, ...]) -> None:
    if len(shape) != 2 or shape[0] != shape[1]:
        raise InvalidProblem(f"M must be a square matrix (n×n), got shape {shape}")


def _real_array(values: Any, need: str) -> NDArray[np.float64]:
    """Return the values as float64; refuse what is not an array of real numbers, saying what is needed."""
    if isinstance(values, np.ma.MaskedArray):
        raise InvalidProblem(f"{need}, got a masked array; fill it first, for instance with .filled(0.0)")
    if sp.issparse(values):
        raise InvalidProblem(f"{need}, got a sparse array; use .toarray().ravel()")
    if values is None:
        raise InvalidProblem(f"{need}, got None")
    try:
        array = np.asarray(values)
    except ValueError as error:
        raise InvalidProblem(f"{need}, got no rectangular array ({error}); check its rows") from error
    _check_kind(array.dtype, need)
    with np.errstate(over="ignore"):  # what overflows becomes infinite, and is refused as such
        return array.astype(np.float64, copy=False)


def real_vector(values: Any, name: str, n: int) -> FloatVector:
    """Return a read-only copy of a real vector of length n; NaN and infinities pass.

    Raises
    ------
    InvalidProblem
        Where it is no array of real numbers, or has another shape.
    """
    need = f"{name} must be a finite vector of length {n} (M is {n}×{n})"
    array = _real_array(values, need)
    if array.shape != (n,):
        raise InvalidProblem(f"{need}, got shape {array.shape}")
    return _read_only(array.copy())


def _finite_vector(values: Any, name: str, n: int) -> FloatVector:
    array = real_vector(values, name, n)
    if not _all_finite(array):
        where = int(np.flatnonzero(~np.isfinite(array))[0])
        raise InvalidProblem(f"{name} must be a finite vector of length {n}, but {name}[{where}] = {array[where]}")
    return array


def _checked_bound(values: Any, name: str, n: int) -> FloatVector:
    need = f"{name} must be a number or a vector of length {n}"
    array = _real_array(values, need)
    if array.shape == ():
        array = np.full(n, float(array))
    if array.shape != (n,):
        raise InvalidProblem(f"{need}, got shape {array.shape}")
    if np.isnan(array).any():
        where = int(np.flatnonzero(np.isnan(array))[0])
        raise InvalidProblem(f"{name} must not hold NaN, but {name}[{where}] = nan; use -inf or inf for no bound")
    return _read_only(array.copy())


def _check_order(lower: FloatVector, upper: FloatVector) -> None:
    wrong = (lower > upper) | (lower == np.inf) | (upper == -np.inf)
    if wrong.any():
        i = int(np.flatnonzero(wrong)[0])
        raise InvalidProblem(
            f"bounds must satisfy lower ≤ upper and leave room for a number, "
            f"but lower[{i}] = {lower[i]} and upper[{i}] = {upper[i]}"
        )


def _residual_scale(M: Any, diagonal: FloatVector) -> FloatVector:
    entries = M.data if sp.issparse(M) else M
    if entries.size == 0:
        return np.ones(M.shape[0])
    largest = max(float(entries.max()), -float(entries.min()))
    if diagonal.min() > 0.0 and diagonal.min() >= NEGLIGIBLE_DIAGONAL * largest:
        return diagonal
    row_largest = np.asarray(abs(M).max(axis=1).toarray() if sp.issparse(M) else abs(M).max(axis=1)).ravel()
    # The product may underflow to 0, which no diagonal of 0 may pass.
    is_usable = (diagonal > 0.0) & (diagonal >= NEGLIGIBLE_DIAGONAL * row_largest)
    scale = np.where(is_usable, diagonal, row_largest)
    return np.where(row_largest == 0.0, 1.0, scale)


def _describe_bounds(lower: FloatVector, upper: FloatVector) -> str:
    if not lower.any() and np.all(upper == np.inf):
        return "0 ≤ z"
    free = int(np.count_nonzero((lower == -np.inf) & (upper == np.inf)))
    boxed = int(np.count_nonzero(np.isfinite(lower) & np.isfinite(upper)))
    one_sided = lower.size - free - boxed
    parts = [(one_sided, "one-sided"), (boxed, "boxed"), (free, "free")]
    return ", ".join(f"{count} {kind}" for count, kind in parts if count)
