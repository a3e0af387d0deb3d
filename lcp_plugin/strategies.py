"""Hypothesis strategies: matrices whose class is certain, and problems whose answer is exact.

Everything drawn is made of small integers and powers of two, so that it is what it claims to be in exact
arithmetic, not up to rounding, and it is right by construction: nothing is drawn only to be thrown away. All
strategies shrink towards the 1 × 1 identity and small integers.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from fractions import Fraction
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp
from hypothesis import strategies as st
from numpy.typing import NDArray

from .errors import InvalidOption, InvalidProblem
from .problem import LCP, FloatVector

__all__ = ["h_plus_matrices", "positive_definite_matrices", "solved_lcps"]

LARGEST_ENTRY = 9
LARGEST_SIZE = 8
LARGEST_SCALE = 400
SMALLEST_MARGIN = 2.0**-30

Sizes = int | st.SearchStrategy[int] | None
Answer = tuple[Fraction, ...]


def h_plus_matrices(
    size: Sizes = None,
    *,
    density: float = 1.0,
    row_scale: int = 0,
    column_scale: int = 0,
    margin: float = 1.0,
    dense: bool = True,
) -> st.SearchStrategy[Any]:
    """Return a strategy for H₊-matrices: positive diagonal, and ⟨M⟩v > 0 for some v > 0.

    Parameters
    ----------
    size : int or strategy of int, optional
        Rows and columns, 1 to 8 by default.
    density : float
        Share of nonzeros off the diagonal, in [0, 1]; roughly, since hypothesis likes to repeat itself.
    row_scale, column_scale : int
        Rows and columns are multiplied by powers of two with exponents from −scale to scale, 0 to 400.
    margin : float
        A power of two in [2⁻³⁰, 1]: before scaling, the diagonal exceeds the sum of the absolute other entries of
        its row by 1 to 9 margins. A small one gives nearly singular matrices.
    dense : bool
        Draw arrays; otherwise CSR arrays.

    Returns
    -------
    strategy of ndarray or csr_array, shape (size, size)

    Raises
    ------
    InvalidOption
        Where an option is out of its range.

    Notes
    -----
    M = R A C with A an integer matrix of strictly dominant rows and R, C diagonal powers of two; v = C⁻¹1.

    Examples
    --------
    >>> from hypothesis import find
    >>> find(h_plus_matrices(), lambda M: True)
    array([[1.]])
    >>> find(h_plus_matrices(3, density=0.5), lambda M: abs(M).sum() > 20).shape
    (3, 3)
    """
    _check_scale("row_scale", row_scale)
    _check_scale("column_scale", column_scale)
    return _h_plus(_sizes(size), _entries(density), row_scale, column_scale, _checked_margin(margin), dense)


@st.composite
def _h_plus(
    draw: st.DrawFn,
    sizes: st.SearchStrategy[int],
    entries: st.SearchStrategy[int],
    row_scale: int,
    column_scale: int,
    margin: float,
    dense: bool,
) -> Any:
    n = draw(sizes)
    A = np.zeros((n, n))
    A[~np.eye(n, dtype=bool)] = draw(_vectors(n * (n - 1), entries))
    np.fill_diagonal(A, abs(A).sum(axis=1) + margin * draw(_surpluses(n)))
    return _delivered(_scaled(A, draw(_exponents(n, row_scale)), draw(_exponents(n, column_scale))), dense)


def positive_definite_matrices(
    size: Sizes = None, *, density: float = 1.0, scale: int = 0, margin: float = 1.0, dense: bool = True
) -> st.SearchStrategy[Any]:
    """Return a strategy for symmetric positive definite matrices; as a rule they are no H₊-matrices.

    Parameters
    ----------
    size : int or strategy of int, optional
        Rows and columns, 1 to 8 by default.
    density : float
        Share of nonzeros of the factor B, in [0, 1], roughly.
    scale : int
        Row i and column i are multiplied by the same power of two, exponents from −scale to scale, 0 to 400.
    margin : float
        A power of two in [2⁻³⁰, 1]: before scaling, no eigenvalue is smaller. A small one gives nearly singular
        matrices where B is singular or nearly so.
    dense : bool
        Draw arrays; otherwise CSR arrays.

    Returns
    -------
    strategy of ndarray or csr_array, shape (size, size)

    Raises
    ------
    InvalidOption
        Where an option is out of its range.

    Notes
    -----
    M = S (B Bᵀ + margin E) S with B an integer matrix, E a diagonal of integers from 1 to 9, S of powers of two.

    Examples
    --------
    >>> from hypothesis import find
    >>> find(positive_definite_matrices(), lambda M: True)
    array([[1.]])
    >>> find(positive_definite_matrices(dense=False), lambda M: M.shape == (2, 2)).toarray()
    array([[1., 0.],
           [0., 1.]])
    """
    _check_scale("scale", scale)
    return _positive_definite(_sizes(size), _entries(density), scale, _checked_margin(margin), dense)


@st.composite
def _positive_definite(
    draw: st.DrawFn,
    sizes: st.SearchStrategy[int],
    entries: st.SearchStrategy[int],
    scale: int,
    margin: float,
    dense: bool,
) -> Any:
    n = draw(sizes)
    B = draw(_vectors(n * n, entries)).reshape(n, n)
    exponents = draw(_exponents(n, scale))
    return _delivered(_scaled(B @ B.T + margin * np.diag(draw(_surpluses(n))), exponents, exponents), dense)


def solved_lcps(
    matrices: st.SearchStrategy[Any] | None = None,
    *,
    bounds: bool = False,
    row_scale: int = 0,
    column_scale: int = 0,
) -> st.SearchStrategy[tuple[LCP, Answer]]:
    """Return a strategy for pairs (problem, z) where z solves the problem exactly.

    Parameters
    ----------
    matrices : strategy of (n, n) matrices, optional
        By default H₊ or symmetric positive definite ones, so that z is the only solution. Entries must be short
        enough for M z + q to be free of rounding: within a row, integers times powers of two not far apart.
    bounds : bool
        Draw bounds too: one-sided below or above, boxed, fixed and free rows. Otherwise lower = 0, upper = ∞.
    row_scale, column_scale : int
        Rows of (M, q) are multiplied, and components of z are measured, in powers of two with exponents from −scale
        to scale, 0 to 400. Prefer these to scaled `matrices`: they keep the answer exact whatever the exponents.

    Returns
    -------
    strategy of (LCP, tuple of Fraction)
        The answer has one exact number a row; each is a double as well: ``np.array(z, dtype=float)`` is exact.

    Raises
    ------
    InvalidOption
        Where an option is out of its range.
    InvalidProblem
        While drawing, where q = w − M z is not free of rounding.

    Notes
    -----
    The answer comes first: z and w are drawn complementary, with inactive rows (z between its bounds, w = 0),
    active ones (z at a bound, w ≠ 0 of the right sign) and degenerate ones (z at a bound, w = 0).

    Examples
    --------
    >>> from hypothesis import find
    >>> problem, z = find(solved_lcps(), lambda drawn: True)
    >>> problem, problem.q, z
    (LCP(n=1, nonzeros=1, bounds 0 ≤ z), array([-1.]), (Fraction(1, 1),))
    >>> problem, z = find(solved_lcps(h_plus_matrices(1), bounds=True), lambda drawn: drawn[1][0] == drawn[0].upper[0])
    >>> bool(problem.slack(np.array(z, dtype=float))[0] <= 0)
    True
    """
    _check_scale("row_scale", row_scale)
    _check_scale("column_scale", column_scale)
    if matrices is None:
        matrices = h_plus_matrices() | positive_definite_matrices()
    return _solved(matrices, _bounded_rows() if bounds else _plain_rows(), row_scale, column_scale)


Row = tuple[float, float, float, float]


@st.composite
def _solved(
    draw: st.DrawFn, matrices: st.SearchStrategy[Any], rows: st.SearchStrategy[Row], row_scale: int, column_scale: int
) -> tuple[LCP, Answer]:
    given = draw(matrices)
    M = sp.csr_array(given)
    n = M.shape[0]
    z, slack, lower, upper = np.array(draw(st.lists(rows, min_size=n, max_size=n))).reshape(n, 4).T
    q = _exact_offset(M, z, slack)
    row, column = draw(_exponents(n, row_scale)), draw(_exponents(n, column_scale))
    problem = LCP(
        _delivered(_scaled(M.toarray(), row, column), not sp.issparse(given)),
        np.ldexp(q, row),
        lower=np.ldexp(lower, -column),
        upper=np.ldexp(upper, -column),
    )
    return problem, tuple(Fraction(float(value)) for value in np.ldexp(z, -column))


class _Kind(NamedTuple):
    """Which bounds a row touches, and the sign that its slack then has."""

    at_lower: bool
    at_upper: bool
    sign: int


BETWEEN = _Kind(False, False, 0)
AT_LOWER, DEGENERATE_LOWER = _Kind(True, False, 1), _Kind(True, False, 0)
AT_UPPER, DEGENERATE_UPPER = _Kind(False, True, -1), _Kind(False, True, 0)
FIXED, FIXED_FROM_ABOVE, DEGENERATE_FIXED = _Kind(True, True, 1), _Kind(True, True, -1), _Kind(True, True, 0)


def _plain_rows() -> st.SearchStrategy[Row]:
    """Return a strategy for complementary (z, w, 0, ∞)."""
    kinds = st.sampled_from((BETWEEN, AT_LOWER, DEGENERATE_LOWER))
    return st.builds(
        lambda kind, size: (0 if kind.at_lower else size, kind.sign * size, 0.0, math.inf), kinds, _positive()
    )


def _bounded_rows() -> st.SearchStrategy[Row]:
    """Return a strategy for complementary (z, w, lower, upper); a row between two infinite bounds is free."""

    def row(kind: _Kind, z: int, size: int, below: float, above: float) -> Row:
        return z, kind.sign * size, z - (0 if kind.at_lower else below), z + (0 if kind.at_upper else above)

    kinds = st.sampled_from(
        (BETWEEN, AT_LOWER, DEGENERATE_LOWER, AT_UPPER, DEGENERATE_UPPER, FIXED, FIXED_FROM_ABOVE, DEGENERATE_FIXED)
    )
    away = st.integers(1, 2 * LARGEST_ENTRY).map(lambda k: k if k <= LARGEST_ENTRY else math.inf)
    return st.builds(row, kinds, st.integers(-LARGEST_ENTRY, LARGEST_ENTRY), _positive(), away, away)


def _exact_offset(M: sp.csr_array, z: FloatVector, slack: FloatVector) -> FloatVector:
    """Return q = w − M z, shape (n,), or raise where a double cannot hold it.

    w_i is the small integer slack_i times the power of two just below row i's largest entry, so that it fits the row.
    """
    q = np.empty(M.shape[0])
    for i in range(q.size):
        entries = [Fraction(value) for value in M.data[M.indptr[i] : M.indptr[i + 1]]]
        columns = M.indices[M.indptr[i] : M.indptr[i + 1]]
        largest = max(map(abs, entries), default=Fraction(1))
        w = Fraction(slack[i]) * _power_of_two_below(largest)
        exact = w - sum(m * Fraction(z[j]) for m, j in zip(entries, columns, strict=True))
        try:
            q[i] = float(exact)
        except OverflowError:
            q[i] = math.nan
        if math.isnan(q[i]) or Fraction(q[i]) != exact:
            raise InvalidProblem(
                f"q = w − M z is not free of rounding in row {i} of M, whose entries lie between "
                f"{float(min(map(abs, entries))):g} and {float(largest):g} in size; draw short entries of similar size "
                f"and scale by row_scale and column_scale of solved_lcps"
            )
    return q


def _power_of_two_below(value: Fraction) -> Fraction:
    return Fraction(2) ** (math.frexp(value)[1] - 1) if value else Fraction(1)


def _scaled(A: NDArray[np.float64], row: NDArray[np.int64], column: NDArray[np.int64]) -> NDArray[np.float64]:
    scaled: NDArray[np.float64] = np.ldexp(A, row[:, None] + column)
    return scaled


def _delivered(matrix: NDArray[np.float64], dense: bool) -> Any:
    return matrix if dense else sp.csr_array(matrix)


def _positive() -> st.SearchStrategy[int]:
    return st.integers(1, LARGEST_ENTRY)


def _surpluses(n: int) -> st.SearchStrategy[FloatVector]:
    return _vectors(n, _positive())


def _exponents(n: int, scale: int) -> st.SearchStrategy[NDArray[np.int64]]:
    def as_integers(values: Sequence[int]) -> NDArray[np.int64]:
        return np.array(values, dtype=np.int64)

    return st.lists(st.integers(-scale, scale), min_size=n, max_size=n).map(as_integers)


def _vectors(length: int, entries: st.SearchStrategy[int]) -> st.SearchStrategy[FloatVector]:
    def as_floats(values: Sequence[int]) -> FloatVector:
        return np.array(values, dtype=np.float64)

    return st.lists(entries, min_size=length, max_size=length).map(as_floats)


def _entries(density: float) -> st.SearchStrategy[int]:
    """Return a strategy for integers up to 9 in absolute value of which the share `density` is nonzero."""
    if not 0.0 <= density <= 1.0:
        raise InvalidOption(f"density must lie in [0, 1], got {density!r}")
    values = 2 * LARGEST_ENTRY
    if density * 1e6 < values:
        return st.just(0)
    zeros = max(1, round(values * (1.0 - density) / density))
    # 1, 2, 3, 4 … mean 1, −1, 2, −2 …, and 0 with all below it means 0: simple entries come first.
    return st.integers(1 - zeros, values).map(lambda k: 0 if k <= 0 else (k + 1) // 2 if k % 2 else -k // 2)


def _sizes(size: Sizes) -> st.SearchStrategy[int]:
    if size is None:
        return st.integers(1, LARGEST_SIZE)
    if isinstance(size, st.SearchStrategy):
        return size
    if isinstance(size, bool) or not isinstance(size, (int, np.integer)) or size < 0:
        raise InvalidOption(f"size must be a whole number ≥ 0 or a strategy of such, got {size!r}")
    return st.just(int(size))


def _check_scale(option: str, value: int) -> None:
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or not 0 <= value <= LARGEST_SCALE:
        raise InvalidOption(f"{option} must be a whole number from 0 to {LARGEST_SCALE}, got {value!r}")


def _checked_margin(margin: float) -> float:
    if not SMALLEST_MARGIN <= margin <= 1.0 or math.frexp(margin)[0] != 0.5:
        raise InvalidOption(f"margin must be a power of two from 2**-30 to 1, got {margin!r}")
    return float(margin)
