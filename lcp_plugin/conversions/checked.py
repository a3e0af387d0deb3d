"""What conversions take from a caller, checked and read-only; and what they hand on, with its origin."""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse as sp

from ..checks import FloatVector, check_kind, frozen, in_doubles, read_only, real_array
from ..errors import InvalidProblem
from ..matrix.symmetry import mismatch
from ..problem.lcp import LCP

SYMMETRIC_TO = 1e-12


def checked_matrix(values: Any, name: str, rows: int | None, columns: int | None) -> Any:
    """Return the values as a read-only ndarray, or as canonical CSR where they are sparse.

    Parameters
    ----------
    values : array or sparse array, shape (rows, columns)
        Real, finite.
    name : str
        For the messages.
    rows, columns : int or None
        The shape that is needed; None where any number will do.

    Raises
    ------
    InvalidProblem
        For another shape, for numbers that are not real or not finite, for damaged sparse arrays.
    """
    need = f"{name} must be a real matrix of shape {_shape(rows, columns)}"
    matrix = _sparse_matrix(values, need) if sp.issparse(values) else real_array(values, need)
    _check_shape(matrix.shape, rows, columns, need)
    entries = matrix.data if sp.issparse(matrix) else matrix
    if not np.isfinite(entries).all():
        listed = sp.coo_array(matrix)
        at = int(np.flatnonzero(~np.isfinite(listed.data))[0])
        where = f"{name}[{listed.row[at]}, {listed.col[at]}]"
        raise InvalidProblem(f"{name} must be finite, but {where} = {listed.data[at]}; repair that entry")
    return frozen(matrix) if sp.issparse(matrix) else read_only(matrix.copy())


def checked_vector(
    values: Any, name: str, length: int | None, *, allow_plus_infinity: bool = False, allow_nan: bool = False
) -> FloatVector:
    """Return a read-only copy of a real, finite vector of that length (any length for None).

    Raises
    ------
    InvalidProblem
        For another shape, for numbers that are not real or not finite (+∞ and NaN pass where allowed).
    """
    need = f"{name} must be a vector of {'real numbers' if length is None else f'length {length}'}"
    vector = real_array(values, need)
    if vector.ndim != 1 or (length is not None and vector.size != length):
        raise InvalidProblem(f"{need}, got shape {vector.shape}")
    refused = ~np.isfinite(vector) & ~(allow_plus_infinity & (vector == np.inf)) & ~(allow_nan & np.isnan(vector))
    if refused.any():
        at = int(np.flatnonzero(refused)[0])
        finite = "finite or inf" if allow_plus_infinity else "finite"
        raise InvalidProblem(f"{name} must be {finite}, but {name}[{at}] = {vector[at]}; repair that entry")
    return read_only(vector.copy())


def checked_answer(answer: Any, n: int) -> FloatVector:
    """Return z, shape (n,), of a result, or of the array that was given in its place.

    Raises
    ------
    InvalidProblem
        Where it is no finite vector of that length.
    """
    return checked_vector(getattr(answer, "z", answer), "z", n)


def attach_origin(problem: LCP, origin: Any) -> LCP:
    """Return the fresh problem with its ``origin``, which knows the way back."""
    problem.origin = origin
    return problem


def _sparse_matrix(values: Any, need: str) -> sp.csr_array:
    check_kind(values.dtype, need)
    try:
        if hasattr(values, "check_format"):
            values.check_format(full_check=True)
        matrix = sp.csr_array(in_doubles(values), copy=True)
        matrix.sum_duplicates()
        matrix.eliminate_zeros()
    except (ValueError, IndexError, TypeError) as error:  # scipy's words for arrays that do not fit together
        raise InvalidProblem(f"{need}, got a damaged sparse array: {error}; build it again") from error
    return matrix


def _check_shape(shape: tuple[int, ...], rows: int | None, columns: int | None, need: str) -> None:
    if len(shape) == 2 and rows in (None, shape[0]) and columns in (None, shape[1]):
        return
    hint = "; write a single row as [[…]]" if len(shape) == 1 else ""
    raise InvalidProblem(f"{need}, got shape {shape}{hint}")


def _shape(rows: int | None, columns: int | None) -> str:
    return f"({'any' if rows is None else rows}, {'any' if columns is None else columns})"


def symmetric(P: Any) -> tuple[Any, float]:
    """Return P with rounding errors in its symmetry averaged away, and how large they were."""
    asymmetry, where = asymmetry_of(P)
    if where is not None:
        i, j = where
        raise InvalidProblem(
            f"P must be symmetric, but P[{i}, {j}] = {P[i, j]} and P[{j}, {i}] = {P[j, i]}; the objective only sees "
            "(P + P.T) / 2: give that, if it is what you mean"
        )
    return (P, 0.0) if asymmetry == 0.0 else (checked_matrix((P + P.T) * 0.5, "P", None, None), asymmetry)


def asymmetry_of(M: Any) -> tuple[float, tuple[int, int] | None]:
    """Return max |m_ij − m_ji|, and the worst i, j beside the largest entries of their rows if that is no rounding."""
    if M.shape[0] == 0:
        return 0.0, None
    largest = abs(M).max(axis=1)
    return mismatch(M, np.asarray(largest.toarray() if sp.issparse(largest) else largest).ravel(), SYMMETRIC_TO)
