"""Strategies for matrices of a certain class: by signs of xᵀM x, sums of rows, principal minors, or a planted cycle."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache, wraps
from typing import Any

import numpy as np
from hypothesis import strategies as st
from numpy.typing import NDArray

from ..core.checks import FloatVector
from ..core.errors import InvalidOption
from ..core.settings import whole_number

LARGEST_ENTRY = 9
LARGEST_SIZE = 8

Sizes = int | st.SearchStrategy[int] | None
Numbers = st.SearchStrategy[Any]
Matrix = NDArray[np.float64]


def sizes(size: Sizes, smallest: int = 0) -> st.SearchStrategy[int]:
    """Return a strategy for numbers of rows, none below `smallest`, or raise InvalidOption."""
    if size is None:
        return st.integers(max(1, smallest), LARGEST_SIZE)

    def checked(n: Any) -> int:
        return whole_number(n, "size", smallest, " or a strategy of such")

    return size.map(checked) if isinstance(size, st.SearchStrategy) else st.just(checked(size))


def entries(density: float) -> Numbers:
    """Return integers up to 9 in absolute value of which the share `density` is nonzero."""
    if not isinstance(density, (int, float, np.integer, np.floating)) or not 0.0 <= density <= 1.0:
        raise InvalidOption(f"density must lie in [0, 1], got {density!r}")
    values = 2 * LARGEST_ENTRY
    if density * 1e6 < values:
        return st.just(0)
    zeros = max(1, round(values * (1.0 - density) / density))
    # 1, −1, 2, −2 … for 1, 2, 3, 4 …, and 0 for 0 and all below it: simple entries come first.
    return st.integers(1 - zeros, values).map(
        lambda k: 0 if k <= 0 else (k + 1) // 2 if k % 2 else -(k // 2)
    )


POSITIVE = st.integers(1, LARGEST_ENTRY)
SIGNED = st.integers(-LARGEST_ENTRY, LARGEST_ENTRY)
ONE_FIRST = st.sampled_from([*range(1, LARGEST_ENTRY + 1), 0, *range(-1, -LARGEST_ENTRY - 1, -1)])
SIGNS = st.sampled_from([1, -1])
UNITS = st.sampled_from([1, 2, 4])


@lru_cache(maxsize=1000)
def rows(n: int, row: Numbers) -> st.SearchStrategy[list[Any]]:
    """Return a strategy for lists of n values.

    Up to 8 it always draws 8 and drops the last: shrinking can then lower n without a change of the later draws.
    """
    return st.tuples(*[row] * max(n, LARGEST_SIZE)).map(lambda drawn: list(drawn[:n]))


def vectors(n: int, values: Numbers) -> st.SearchStrategy[FloatVector]:
    """Return a strategy for arrays of shape (n,)."""
    return rows(n, values).map(lambda drawn: np.array(drawn, dtype=np.float64))


def orders(n: int) -> st.SearchStrategy[NDArray[np.intp]]:
    """Return a strategy for permutations of 0 … n − 1 that shrinks to the identity."""
    return vectors(n, st.integers(0, LARGEST_SIZE - 1)).map(
        lambda keys: np.argsort(keys, kind="stable")
    )


@lru_cache(maxsize=1000)
def blocks(height: int, width: int, values: Numbers) -> st.SearchStrategy[Matrix]:
    """Return a strategy for arrays of shape (height, width)."""
    entries = st.tuples(*[values] * (height * width))
    return entries.map(lambda drawn: np.array(drawn, dtype=np.float64).reshape(height, width))


# of a size, and of numbers of the requested density
Build = Callable[[st.DrawFn, int, Numbers], Matrix]


def matrices(smallest: int = 0) -> Callable[[Build], Callable[..., st.SearchStrategy[Any]]]:
    """Turn a function that draws a matrix of n ≥ `smallest` rows into a strategy with checked size and density."""

    def strategy_of(build: Build) -> Callable[..., st.SearchStrategy[Any]]:
        drawn = st.composite(lambda draw, rows, values: build(draw, draw(rows), values))

        @wraps(build)
        def strategy(size: Sizes = None, *, density: float = 1.0) -> st.SearchStrategy[Any]:
            return drawn(sizes(size, smallest), entries(density))

        del strategy.__wrapped__  # help and signature list size and density
        return strategy

    return strategy_of


@matrices()
def positive_definite_matrices(draw: st.DrawFn, n: int, values: Numbers) -> Matrix:
    """Return a strategy for positive definite matrices, xᵀM x > 0 for x ≠ 0; usually they are not H₊-matrices.

    Parameters
    ----------
    size : int or strategy of int, optional
        Rows and columns, 1 to 8 by default.
    density : float
        Share of nonzeros of the factor B, in [0, 1], roughly.

    Returns
    -------
    strategy of ndarray, shape (size, size)

    Raises
    ------
    InvalidOption
        If an option is out of its range.

    Notes
    -----
    M = B Bᵀ + E with B an integer matrix, E a diagonal of integers from 1 to 9.

    Examples
    --------
    >>> from hypothesis import Phase, find, settings
    >>> quick = settings(phases=[Phase.generate], derandomize=True, database=None)
    >>> find(positive_definite_matrices(), lambda M: True, settings=quick)
    array([[1.]])
    >>> find(positive_definite_matrices(2), lambda M: True, settings=quick)
    array([[1., 0.],
           [0., 1.]])
    """
    return _definite(draw, n, values)


@matrices()
def positive_semidefinite_matrices(draw: st.DrawFn, n: int, values: Numbers) -> Matrix:
    """Return a strategy for symmetric positive semidefinite matrices of every rank from 0 to their size.

    Parameters
    ----------
    size, density
        As in :func:`positive_definite_matrices`.

    Notes
    -----
    M = L Lᵀ with L in some order of its rows unit lower trapezoidal with integer entries.

    Examples
    --------
    >>> from hypothesis import Phase, find, settings
    >>> quick = settings(phases=[Phase.generate], derandomize=True, database=None)
    >>> find(positive_semidefinite_matrices(), lambda M: True, settings=quick)
    array([[1.]])
    """
    rank = n - draw(st.integers(0, n))
    order, A = draw(orders(n)), draw(blocks(n, n, values))
    L = (np.tril(A, -1) + np.eye(n))[order, :rank]
    return L @ L.T


@matrices()
def h_plus_matrices(draw: st.DrawFn, n: int, values: Numbers) -> Matrix:
    """Return a strategy for H₊-matrices: positive diagonal, and ⟨M⟩v > 0 for some v > 0.

    Parameters
    ----------
    size, density
        As in :func:`positive_definite_matrices`; the density is the share of nonzeros off the diagonal.

    Notes
    -----
    M = A C with A an integer matrix of strictly dominant rows and C a diagonal of 1, 2 and 4; v = C⁻¹1.

    Examples
    --------
    >>> from hypothesis import Phase, find, settings
    >>> quick = settings(phases=[Phase.generate], derandomize=True, database=None)
    >>> find(h_plus_matrices(), lambda M: True, settings=quick)
    array([[1.]])
    """
    return _h_plus(draw, n, values)


@matrices()
def m_matrices(draw: st.DrawFn, n: int, values: Numbers) -> Matrix:
    """Return a strategy for nonsingular M-matrices, usually not symmetric: m_ij ≤ 0 off the diagonal, M⁻¹ ≥ 0.

    Parameters
    ----------
    size, density
        As in :func:`h_plus_matrices`.

    Examples
    --------
    >>> from hypothesis import Phase, find, settings
    >>> quick = settings(phases=[Phase.generate], derandomize=True, database=None)
    >>> shrunk = settings(quick, phases=[Phase.generate, Phase.shrink])
    >>> find(m_matrices(2), lambda M: M[0, 1] != 0, settings=shrunk)
    array([[ 2., -1.],
           [ 0.,  1.]])
    """
    return _off_diagonal_negated(_h_plus(draw, n, values))


@matrices()
def z_matrices(draw: st.DrawFn, n: int, values: Numbers) -> Matrix:
    """Return a strategy for Z-matrices: m_ij ≤ 0 off the diagonal; M-matrices, singular and indefinite ones among them.

    Parameters
    ----------
    size, density
        As in :func:`h_plus_matrices`.

    Examples
    --------
    >>> from hypothesis import Phase, find, settings
    >>> quick = settings(phases=[Phase.generate], derandomize=True, database=None)
    >>> shrunk = settings(quick, phases=[Phase.generate, Phase.shrink])
    >>> find(z_matrices(1), lambda M: M[0, 0] < 0, settings=shrunk)
    array([[-1.]])
    """
    return _off_diagonal_negated(_by_row_sums(draw, n, values, ONE_FIRST))


@matrices()
def strictly_dominant_matrices(draw: st.DrawFn, n: int, values: Numbers) -> Matrix:
    """Return a strategy for matrices with m_ii > Σ_j≠i |m_ij| in every row.

    Parameters
    ----------
    size, density
        As in :func:`h_plus_matrices`.

    Examples
    --------
    >>> from hypothesis import Phase, find, settings
    >>> quick = settings(phases=[Phase.generate], derandomize=True, database=None)
    >>> shrunk = settings(quick, phases=[Phase.generate, Phase.shrink])
    >>> find(strictly_dominant_matrices(2), lambda M: M[0, 1] > 0, settings=shrunk)
    array([[2., 1.],
           [0., 1.]])
    """
    return _by_row_sums(draw, n, values)


@matrices()
def p_matrices(draw: st.DrawFn, n: int, values: Numbers) -> Matrix:
    """Return a strategy for P-matrices, all principal minors positive: exactly one solution for every q and all bounds.

    Parameters
    ----------
    size, density
        As in :func:`h_plus_matrices`; the density is the share of nonzeros of the parts.

    Notes
    -----
    H₊-matrices, and in some order of the unknowns [[A, X], [0, C]] with A + Aᵀ and C + Cᵀ positive definite and X
    anything: a principal minor is the product of one of A and one of C. Most of the larger ones are neither H-matrices
    nor positive definite.

    References
    ----------
    Cottle, Pang, Stone, *The Linear Complementarity Problem*, SIAM 2009, doi:10.1137/1.9780898719000, §3.3.

    Examples
    --------
    >>> from hypothesis import Phase, find, settings
    >>> quick = settings(phases=[Phase.generate], derandomize=True, database=None)
    >>> find(p_matrices(), lambda M: True, settings=quick)
    array([[1.]])
    """
    if not draw(st.booleans()):
        return _h_plus(draw, n, values)
    cut, order = draw(st.integers(0, n)), draw(orders(n))
    K = np.tril(draw(blocks(n, n, values)), -1)
    A = _definite(draw, n, values) + K.T - K
    A[cut:, :cut] = 0.0
    A[:cut, cut:] = draw(blocks(cut, n - cut, values))
    return A[np.ix_(order, order)]


@matrices(1)
def not_h_matrices(draw: st.DrawFn, n: int, values: Numbers) -> Matrix:
    """Return a strategy for matrices that are not H-matrices: no scaling of rows and columns makes them dominant.

    Parameters
    ----------
    size : int or strategy of int, optional
        Rows and columns, at least 1 (a 1 × 1 matrix is [0]); up to 8 by default.
    density : float
        Share of nonzeros of the parts, in [0, 1], roughly; the cycle is added.

    Raises
    ------
    InvalidOption
        If an option is out of its range; while drawing, if a drawn size is too small.

    Notes
    -----
    The construction has a cycle i₁ → i₂ → … → i₁ with |m_ij| ≥ |m_ii| on each arrow i → j, of length 1 a zero on the
    diagonal. Its product of |m_ij|/|m_ii| is at least 1 in any scaling, so that ρ(D⁻¹|B|) ≥ 1.

    Examples
    --------
    >>> from hypothesis import Phase, find, settings
    >>> quick = settings(phases=[Phase.generate], derandomize=True, database=None)
    >>> shrunk = settings(quick, phases=[Phase.generate, Phase.shrink])
    >>> find(not_h_matrices(), lambda M: len(M) > 1, settings=shrunk)
    array([[1., 1.],
           [1., 1.]])
    """
    diagonal, order = draw(vectors(n, ONE_FIRST)), draw(orders(n))
    # 0, 1, … mean a cycle of length 2, 3, …, and the last a zero on the diagonal: shrinking prefers the former.
    length = draw(st.integers(0, n - 1))
    signs, surpluses = draw(vectors(n, SIGNS)), draw(vectors(n, st.integers(0, 9)))
    A = draw(blocks(n, n, values))
    np.fill_diagonal(A, diagonal)
    if length == n - 1:
        A[order[0], order[0]] = 0.0
    else:
        cycle = order[: length + 2]
        for i, j, sign, surplus in zip(cycle, np.roll(cycle, -1), signs, surpluses, strict=False):
            A[i, j] = sign * (abs(A[i, i]) + surplus)
    return A


def _definite(draw: st.DrawFn, n: int, values: Numbers) -> Matrix:
    """Return B Bᵀ + E: symmetric positive definite."""
    E = np.diag(draw(vectors(n, POSITIVE)))
    B = draw(blocks(n, n, values))
    return np.asarray(B @ B.T + E)


def _by_row_sums(draw: st.DrawFn, n: int, values: Numbers, surpluses: Numbers = POSITIVE) -> Matrix:
    """Return a matrix whose diagonal entries exceed the sums of the others' sizes by the surpluses."""
    surplus = draw(vectors(n, surpluses))
    A = draw(blocks(n, n, values))
    np.fill_diagonal(A, 0.0)
    np.fill_diagonal(A, abs(A).sum(axis=1) + surplus)
    return A


def _off_diagonal_negated(A: Matrix) -> Matrix:
    return np.where(np.eye(len(A)) > 0.0, A, 0.0 - abs(A))


def _h_plus(draw: st.DrawFn, n: int, values: Numbers) -> Matrix:
    return np.asarray(_by_row_sums(draw, n, values) * draw(vectors(n, UNITS)))
