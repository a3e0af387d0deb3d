"""Checked arrays: real, finite, of the right shape, canonical; everything else raises an error with a remedy."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from functools import cached_property, lru_cache, wraps
from typing import Any, Self, TypeVar

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike, NDArray

from .errors import Decorated, InvalidOption, InvalidProblem, did_you_mean

Vector = NDArray[np.float64]
Array = Any  # of numpy, of a stack of problems, or of JAX
AnyMatrix = Any  # ndarray or CSR array, for which scipy has no types
T = TypeVar("T")
BoolVector = NDArray[np.bool_]
FloatMatrix = NDArray[np.float64]
Indices = NDArray[np.intp]
Arrays = tuple[NDArray[Any], NDArray[Any], Vector]  # of a sparse matrix: indptr, indices, data

DOUBLE = np.dtype(np.float64)
# a denser matrix is an array: indices save little memory, and BLAS is fast
DENSE_ABOVE_DENSITY = 0.25
DENSE_UP_TO_SIZE = 5000  # rows: an array of .2 GB
SHARED_UP_TO = 1000  # entries of bounds that problems share
MAX_CROSSING = 4.0  # units in the last place by which equal bounds may cross
INFINITE_LIMIT = 1e20 * (1.0 - 1e-12)  # files may hold 9.999999999999999e19


class derived_property(cached_property[T]):  # noqa: N801 - a decorator
    """Cached property that is computed without NumPy's warnings: an overflow shows in its value."""

    def __init__(self, compute: Callable[[Any], T]) -> None:
        super().__init__(np.errstate(all="ignore")(compute))


def read_only(array: NDArray[Any]) -> NDArray[Any]:
    """Return a view that cannot be written to."""
    view = array.view()
    view.setflags(write=False)
    return view


def copy_without(thing: T, *computed: str) -> T:
    """Return a copy without these cached properties, if they were computed."""
    kept = {name: value for name, value in vars(thing).items() if name not in computed}
    return fill(object.__new__(type(thing)), **kept)


def fill(new: T, **data: Any) -> T:
    """Return an object that is under construction, with its data; nothing else writes to a frozen object."""
    vars(new).update(data)
    return new


def restore_state(thing: object, state: dict[str, Any]) -> None:
    """Restore the state of a copied or unpickled object, and make its arrays read-only again."""
    fill(thing, **state)
    for value in state.values():
        parts = (getattr(value, name, None) for name in ("data", "indices", "indptr"))
        for array in (value, *parts):
            if isinstance(array, np.ndarray):
                array.flags.writeable = False


class MadeOnAccess:
    """Object whose missing attributes `_make` computes, all at once, at the first access to one of them."""

    @classmethod
    def of_known(cls, make: Callable[[], Self] | None, **known: Any) -> Self:
        """Return an object with some attributes; `make` returns an object that has the others."""
        made = object.__new__(cls)
        vars(made).update(known, _make=make)  # a third of the time of `fill`
        return made

    def __getattr__(self, name: str) -> Any:
        """Return an attribute that is not computed yet."""
        attributes = vars(self)
        # Read once: another thread may set it to None
        if not name.startswith("_") and (make := attributes.get("_make")) is not None:
            attributes.update(vars(make()), _make=None)
        if name not in attributes:
            raise AttributeError(f"{type(self).__name__!r} object has no attribute {name!r}")
        return attributes[name]


def freeze_csr(matrix: sp.csr_array) -> sp.csr_array:
    """Make the arrays of a CSR array read-only, set its canonical flags, and return it."""
    index_type = np.int32 if max(matrix.nnz, *matrix.shape) < 2**31 else np.int64
    matrix.data = read_only(matrix.data)
    matrix.indices = read_only(matrix.indices.astype(index_type, copy=False))
    matrix.indptr = read_only(matrix.indptr.astype(index_type, copy=False))
    matrix.has_sorted_indices = True
    matrix.has_canonical_format = True
    return matrix


_EMPTY = sp.csr_array((1, 1))


def assemble_csr(data: Any, indices: Any, indptr: Any, shape: tuple[int, int]) -> sp.csr_array:
    """Return the canonical CSR array of these arrays, read-only, unchecked.

    scipy's own constructor would search the arrays for these facts, which takes longer than a product.
    """
    matrix = object.__new__(sp.csr_array)
    matrix.__dict__.update(_EMPTY.__dict__)
    matrix._shape, matrix.data, matrix.indices, matrix.indptr = shape, data, indices, indptr
    return freeze_csr(matrix)


def checked_matrix(M: AnyMatrix) -> tuple[Any, int]:
    """Return the square matrix as a CSR array, or as an ndarray if it is small and dense; and its nonzero entries."""
    is_sparse = type(M) is not np.ndarray and sp.issparse(M)
    if is_sparse:
        check_kind(M.dtype, "M must hold real numbers")
    matrix = M if is_sparse else real_array(M, "M must hold real numbers")
    if len(matrix.shape) != 2 or matrix.shape[0] != matrix.shape[1]:
        hint = "" if len(matrix.shape) == 2 else "; the matrix comes first, then q"
        raise InvalidProblem(f"M must be a square matrix (n×n), got shape {matrix.shape}{hint}")
    if is_sparse:
        compressed = canonical_csr(matrix, "M")
        return compressed, int(compressed.nnz)
    require_finite(matrix, "M")
    n, nonzeros = matrix.shape[0], int(np.count_nonzero(matrix))
    if n <= DENSE_UP_TO_SIZE and nonzeros > DENSE_ABOVE_DENSITY * n * n:
        matrix = np.array(matrix, order="C")  # the caller may change the original
        matrix.setflags(write=False)
        return matrix, nonzeros
    return freeze_csr(sp.csr_array(matrix)), nonzeros


def rectangular_matrix(
    values: Any, name: str, rows: int | None, columns: int | None, *, is_copied: bool = True
) -> Any:
    """Return the values as a read-only ndarray, or as canonical CSR if they are sparse; a copy if `is_copied`.

    Parameters
    ----------
    values : array or sparse array, shape (rows, columns)
        Real, finite.
    name : str
        For the messages.
    rows, columns : int or None
        The shape that is needed; None if any number will do.

    Raises
    ------
    InvalidProblem
        For another shape, for numbers that are not real or not finite, for corrupt sparse arrays.
    """
    of = f" of shape ({rows}, {columns})"
    if rows is None or columns is None:
        sizes = (rows, "rows"), (columns, "columns")
        of = "".join(f" with {k} {what}" for k, what in sizes if k is not None)
    need = f"{name} must be a real matrix{of}"
    is_sparse = not isinstance(values, np.ndarray) and sp.issparse(values)
    if is_sparse:
        check_kind(values.dtype, need)
    matrix = values if is_sparse else real_array(values, need)
    shape = matrix.shape
    if len(shape) != 2 or rows not in (None, shape[0]) or columns not in (None, shape[1]):
        fits_turned = len(shape) == 2 and rows in (None, shape[1]) and columns in (None, shape[0])
        hint = "; write a single row as [[…]]" if matrix.ndim == 1 else ""
        hint = f"; did you mean {name}.T?" if fits_turned else hint
        raise InvalidProblem(f"{need}, got shape {shape}{hint}")
    if is_sparse:
        return canonical_csr(matrix, name, is_copied=is_copied)
    require_finite(matrix, name)
    return read_only(matrix.copy() if is_copied else matrix)


def require_finite(array: NDArray[np.float64], name: str) -> None:
    """Raise InvalidProblem that shows the first entry that is not finite, if there is one."""
    is_finite = np.isfinite(array)
    if not np.logical_and.reduce(is_finite, None):
        at = tuple(np.argwhere(~is_finite)[0].tolist())
        raise _not_finite(name, ", ".join(map(str, at)), array[at])


def _not_finite(name: str, place: object, value: object, need: str = "finite") -> InvalidProblem:
    return InvalidProblem(
        f"{name} must be {need}, but {name}{f'[{place}]' * (place != '')} = {value}; repair it"
    )


def canonical_csr(M: AnyMatrix, name: str, *, is_copied: bool = False) -> sp.csr_array:
    """Return M as canonical, checked CSR; without a copy if it is canonical already and none is required."""
    try:
        matrix = _canonical(M, is_copied)
    except (ValueError, IndexError, TypeError) as error:  # the arrays do not fit together
        raise InvalidProblem(f"{name} is a damaged sparse array: {error}; rebuild it") from error
    is_finite = np.isfinite(matrix.data)
    if not is_finite.all():
        where = int(np.argmin(is_finite))
        row = int(np.searchsorted(matrix.indptr, where, side="right")) - 1
        raise _not_finite(name, f"{row}, {matrix.indices[where]}", matrix.data[where])
    return matrix


def _canonical(M: AnyMatrix, is_copied: bool) -> sp.csr_array:
    """Return M as read-only CSR in double precision, sorted, without duplicates and zeros; a new object."""
    if M.format in ("csr", "csc", "bsr"):  # scipy's flags are stale if M.data was written to
        M = type(M)((M.data, M.indices, M.indptr), shape=M.shape)
        M.check_format(full_check=True)
        if (np.diff(M.indptr) < 0).any():  # scipy does not look at them if the last pointer is 0
            raise ValueError("index pointer values must form a non-decreasing sequence")
    elif M.format == "coo":
        M = sp.coo_array((M.data, (M.row, M.col)), shape=M.shape)
    elif M.format == "lil" and any(len(a) != len(b) for a, b in zip(M.rows, M.data, strict=True)):
        raise ValueError("each row must have as many values as columns")  # scipy reads beyond them
    with np.errstate(all="ignore"):  # entries beyond double precision become infinite
        matrix = sp.csr_array(M.astype(np.float64, copy=False), copy=is_copied)
    if not matrix.has_canonical_format:
        matrix = matrix.copy()
        matrix.sum_duplicates()
    if np.count_nonzero(matrix.data) != matrix.nnz:
        matrix = matrix.copy()
        matrix.eliminate_zeros()
    return freeze_csr(matrix)


def check_kind(dtype: np.dtype[Any], need: str) -> None:
    """Raise InvalidProblem, with the text `need`, unless the dtype holds real numbers."""
    if dtype.kind not in "fiub":
        what = dict(c="complex", O="object", U="text", S="bytes", M="dates", m="durations")
        raise InvalidProblem(
            f"{need}, got {what.get(dtype.kind, dtype.name)} entries (dtype {dtype}); convert them first"
        )


def is_plain(values: object, *shape: int) -> bool:
    """Return whether the values are an array of doubles of this shape."""
    return type(values) is np.ndarray and values.dtype == DOUBLE and values.shape == shape


def real_array(values: Any, need: str) -> NDArray[np.float64]:
    """Return the values as a float64 array; raise InvalidProblem, with the text `need`, if they are not real."""
    if type(values) is np.ndarray and values.dtype == DOUBLE:
        return values
    if isinstance(values, np.ma.MaskedArray):
        raise InvalidProblem(f"{need}, got a masked array; fill it first, as by .filled(0.0)")
    if sp.issparse(values):
        raise InvalidProblem(
            f"{need}, got a sparse array of shape {values.shape}; use .toarray(), and for a vector also .ravel()"
        )
    if values is None:
        raise InvalidProblem(f"{need}, got None")
    try:
        array = np.asarray(values)
    except (
        RuntimeError,
        TypeError,
    ) as error:  # a tensor with a gradient, or without values on the host
        raise InvalidProblem(f"{need}: {error}") from error
    except ValueError as error:
        raise InvalidProblem(
            f"{need}, got no rectangular array ({error}); check its rows"
        ) from error
    if array.dtype == np.object_ and hasattr(values, "iloc"):  # of pandas
        dtypes = values.dtypes.items() if values.ndim > 1 else [(values.name, values.dtype)]
        for column, dtype in dtypes:
            check_kind(dtype, need if column is None else f"{need}; column {column!r} has others")
        array = values.to_numpy(np.float64, na_value=np.nan)
    if array.dtype == np.float64:
        return array
    check_kind(array.dtype, need)
    with np.errstate(all="ignore"):  # an overflow becomes infinite, which is rejected
        return array.astype(np.float64)


def checked_vector(
    values: object,
    name: str,
    length: int | None,
    *,
    is_finite: bool = True,
    allow_plus_infinity: bool = False,
    allow_nan: bool = False,
    may_be_number: bool = False,
    need: str = "",
) -> Vector:
    """Return a read-only copy of a real vector of that length (any length for None).

    Parameters
    ----------
    values : array, shape (length,), or a number for a length of 1 where that may be
    name, need : str
        Texts for messages: the name, and the requirement if it exceeds a vector of that length.
    is_finite : bool
        False if NaN and infinities pass.

    Raises
    ------
    InvalidProblem
        If it is not an array of real numbers, for another shape, for numbers that are not finite (+∞ and NaN pass
        where allowed).
    """
    of_length = "real numbers" if length is None else f"length {length}"
    need = need or f"{name} must be a vector of {of_length}"
    vector = real_array(values, need)
    if may_be_number and vector.ndim == 0 and length in (None, 1):
        vector = vector.reshape(1)
    shape = vector.shape
    if len(shape) == 2 and 1 in shape:  # a column, or np.matrix
        vector = vector.reshape(-1)
    if vector.ndim != 1 or length not in (None, vector.size):
        raise InvalidProblem(f"{need}, got shape {shape}{_hint_at_vector(vector, name, length)}")
    is_valid = np.isfinite(vector)
    if is_finite and not np.logical_and.reduce(is_valid):
        is_valid |= (allow_plus_infinity & (vector == np.inf)) | (allow_nan & np.isnan(vector))
        if not is_valid.all():
            at = int(np.argmin(is_valid))
            need = "finite or inf" if allow_plus_infinity else "finite"
            raise _not_finite(name, at, vector[at], need)
    vector = vector.copy()
    vector.setflags(write=False)
    return vector


def _hint_at_vector(array: Vector, name: str, length: int | None) -> str:
    """Return the next step for a number, or a vector of another length."""
    if length is None:
        return ""
    if array.ndim == 0:
        return f"; write np.full({length}, {name})"
    surplus = array.size - length
    if array.ndim > 1 or not surplus:
        return ""
    return f": {abs(surplus)} too {'many' if surplus > 0 else 'few'}"


def change_of_vector(
    values: ArrayLike | None, name: str, n: int, *, may_be_number: bool = False
) -> Vector:
    """Return the finite change of a vector: zeros for None, n equal entries for a number if that is allowed."""
    if values is None or (may_be_number and np.ndim(values) == 0):
        values = np.full(n, 0.0 if values is None else values)
    return checked_vector(values, name, n)


def change_of_slack(dM: AnyMatrix, dq: ArrayLike | None, z: Vector) -> Vector:
    """Return dM z + dq, the change of M z + q for changes of M and q."""
    change = change_of_vector(dq, "dq", z.size)
    return change if dM is None else change + rectangular_matrix(dM, "dM", z.size, z.size) @ z


def changes_by_name(jvp: Decorated) -> Decorated:
    """Decorate a method whose arguments are changes by name: other arguments raise InvalidOption."""
    known = [*(jvp.__kwdefaults__ or {})]

    @wraps(jvp)
    def checked(self: Any, *unnamed: Any, **changes: Any) -> Any:
        require_known_changes(unnamed, changes, known)
        return jvp(self, **changes)

    return checked  # type: ignore[return-value]


def require_known_changes(unnamed: Any, changes: Iterable[str], known: Sequence[str]) -> None:
    """Raise InvalidOption for a change without a name, or with another than the known ones."""
    if unnamed:
        raise InvalidOption(
            f"jvp takes changes of the data by name, got {type(unnamed[0]).__name__}; write jvp(name=…) with a "
            f"name of {', '.join(known)}"
        )
    vector = next((name for name in ("dforcing", "dc") if name in known), "")
    for name in changes:
        if name not in known:
            hint = f"; the change of q is {vector}" if name == "dq" and vector else ""
            raise InvalidOption(f"jvp has no option {name!r}{hint or did_you_mean(name, known)}")


def checked_answer(answer: object, n: int) -> Vector:
    """Return the best z, shape (n,), of a result, or of an array instead of a result.

    Raises
    ------
    InvalidProblem
        If it is not a finite vector of that length.
    """
    return checked_vector(getattr(getattr(answer, "certificate", answer), "z", answer), "z", n)


def checked_bound(values: object, name: str, n: int) -> Vector:
    """Return a bound as a vector of length n; a number stands for all, ±∞ for none, NaN is rejected."""
    if type(values) is float and n <= SHARED_UP_TO and abs(values) < INFINITE_LIMIT:
        return _equal_bounds(values, values, n)[0]
    need = f"{name} must be a number or a vector of length {n}"
    array = real_array(without_none(values, name), need)
    if array.shape in ((n, 1), (1, n)):
        array = array.reshape(n)
    if array.shape not in ((), (n,)):
        raise InvalidProblem(f"{need}, got shape {array.shape}{_hint_at_vector(array, name, n)}")
    is_nan = np.isnan(array)
    if is_nan.any():
        where = int(np.argmax(is_nan))
        raise InvalidProblem(
            f"{name} must not hold NaN, but {name}[{where}] = nan; use -inf or inf for no bound"
        )
    return read_only(np.full(n, array))


def without_none(values: object, name: str) -> Any:
    """Return the values of a bound, named lower… or upper…, with ∓∞ in place of None."""
    if isinstance(values, np.ndarray) and values.dtype != np.object_:
        return values
    with suppress(ValueError):  # no rectangular array
        array = np.asarray(values)
        if array.dtype == np.object_ and (is_none := (array == np.array(None))).any():
            none = -np.inf if name.startswith(("lower", "lb")) else np.inf
            return np.array(np.where(is_none, none, array).tolist())
    return values


def checked_right_side(values: object, name: str, length: int | None, **how: Any) -> Vector:
    """Return the right-hand side h of inequalities G x ≤ h; 1e20 and beyond becomes ∞: no constraint."""
    right = checked_vector(values, name, length, allow_plus_infinity=True, **how)
    says_something = right < INFINITE_LIMIT
    return right if says_something.all() else read_only(np.where(says_something, right, np.inf))


def normalize_bounds(lower: Vector, upper: Vector) -> tuple[Vector, Vector]:
    """Return bounds, of any shape, with −∞ for lower bounds of −1e20 or less, and ∞ for upper bounds of 1e20 or more.

    Bounds that cross by at most four units in the last place, as 0.1 · 3 and 0.3, are one value, the lower bound.
    """
    lower = np.where(lower <= -INFINITE_LIMIT, -np.inf, lower)
    upper = np.where(upper >= INFINITE_LIMIT, np.inf, upper)
    if (crosses := lower > upper).any():
        with np.errstate(all="ignore"):
            last_place = np.spacing(np.minimum(np.abs(lower), np.abs(upper)))
            upper = np.where(crosses & (lower - upper <= MAX_CROSSING * last_place), lower, upper)
    return read_only(lower), read_only(upper)


@lru_cache(16)
def _equal_bounds(lower: float, upper: float, n: int) -> tuple[Vector, Vector]:
    """Return bounds of n equal entries; problems share short ones."""
    below, above = (np.frombuffer(np.full(n, end).tobytes()) for end in (lower, upper))
    return below, above  # views of bytes stay read-only


def checked_bounds(
    lower: Array, upper: Array, n: int, *, names: tuple[str, str] = ("lower", "upper")
) -> tuple[Vector, Vector]:
    """Return bounds as vectors of length n; lower ≤ −1e20 and upper ≥ 1e20 mean no bound, as in files.

    Raises
    ------
    InvalidProblem
        Unless lower ≤ upper on every row, with a real number between them.
    """
    are_numbers = type(lower) is type(upper) is float
    if are_numbers and lower <= upper and lower < INFINITE_LIMIT and upper > -INFINITE_LIMIT:
        lower = lower if lower > -INFINITE_LIMIT else -math.inf
        upper = upper if upper < INFINITE_LIMIT else math.inf
        return (_equal_bounds if n <= SHARED_UP_TO else _equal_bounds.__wrapped__)(lower, upper, n)
    sides = zip((lower, upper), names, strict=True)
    below, above = normalize_bounds(*(checked_bound(*side, n) for side in sides))
    is_right = (below <= above) & (below < np.inf) & (above > -np.inf)
    if not is_right.all():
        i, remedy = int(np.argmin(is_right)), "use -inf for no lower and inf for no upper bound"
        remedy = "swap them" if above[i] < below[i] else remedy
        raise InvalidProblem(
            f"bounds must satisfy lower ≤ upper and admit a number, "
            f"but {names[0]}[{i}] = {below[i]} and {names[1]}[{i}] = {above[i]}; {remedy}"
        )
    return below, above


def vector_option(values: object, name: str, length: int | None, **how: Any) -> Vector:
    """Return a vector as :func:`checked_vector` does, but raise InvalidOption."""
    try:
        return checked_vector(values, name, length, **how)
    except InvalidProblem as error:
        raise InvalidOption(str(error)) from error


def is_number(value: object) -> bool:
    """Return whether the value is a real number that fits a double."""
    if isinstance(value, bool) or not isinstance(value, (int, float, np.integer, np.floating)):
        return False
    try:
        float(value)
    except OverflowError:
        return False
    return True


def checked_start(problem: Any, z0: ArrayLike | None) -> Vector:
    """Return the start within the bounds, shape (n,); InvalidOption if z0 is not a finite real vector of length n."""
    if z0 is None:
        return problem.nearest_to_zero
    n = problem.n
    need = f"z0 must be a finite vector of length {n} (M is {n}×{n})"
    start = vector_option(z0, "z0", n, may_be_number=n == 1, need=need)
    clipped: Vector = np.minimum(np.maximum(start, problem.lower), problem.upper)
    return clipped
