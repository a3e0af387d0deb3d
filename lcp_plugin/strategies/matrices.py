"""Strategies for matrices of a certain class: by signs of xᵀM x, sums of rows, principal minors, or a planted cycle."""

from __future__ import annotations

from typing import Any

import numpy as np
from hypothesis import strategies as st

from .options import (
    ONE_FIRST,
    POSITIVE,
    SIGNS,
    Matrix,
    Numbers,
    Sizes,
    blocks,
    matrices,
    orders,
    reordered,
    skew_matrices,
    unit_lower,
    vectors,
)

UNITS = st.sampled_from([1, 2, 4])


def positive_definite_matrices(
    size: Sizes = None, *, density: float = 1.0, symmetric: bool = True, dense: bool = True
) -> st.SearchStrategy[Any]:
    """Return a strategy for positive definite matrices, xᵀM x > 0 for x ≠ 0; as a rule they are no H₊-matrices.

    Parameters
    ----------
    size : int or strategy of int, optional
        Rows and columns, 1 to 8 by default.
    density : float
        Share of nonzeros of the factor B, in [0, 1], roughly.
    symmetric : bool
        False adds a skew-symmetric matrix.
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
    M = B Bᵀ + E + K with B an integer matrix, E a diagonal of integers from 1 to 9, K = −Kᵀ (0 where `symmetric`).

    Examples
    --------
    >>> from hypothesis import Phase, find, settings
    >>> quick = settings(phases=[Phase.generate], derandomize=True, database=None)
    >>> find(positive_definite_matrices(), lambda M: True, settings=quick)
    array([[1.]])
    >>> find(positive_definite_matrices(2, dense=False), lambda M: True, settings=quick).toarray()
    array([[1., 0.],
           [0., 1.]])
    """
    return matrices(definite_block if symmetric else skewed_definite_block, size, density, dense)


def definite_block(draw: st.DrawFn, n: int, values: Numbers) -> Matrix:
    """Return B Bᵀ + E: symmetric positive definite, shape (n, n)."""
    E = np.diag(draw(vectors(n, POSITIVE)))
    B = draw(blocks(n, n, values))
    result: Matrix = B @ B.T + E
    return result


def skewed_definite_block(draw: st.DrawFn, n: int, values: Numbers) -> Matrix:
    """Return B Bᵀ + E + K: positive definite, shape (n, n)."""
    result: Matrix = definite_block(draw, n, values) + draw(skew_matrices(n, values))
    return result


def positive_semidefinite_matrices(
    size: Sizes = None, *, density: float = 1.0, dense: bool = True
) -> st.SearchStrategy[Any]:
    """Return a strategy for symmetric positive semidefinite matrices of every rank from 0 to their size.

    Parameters
    ----------
    size, density, dense
        As in :func:`positive_definite_matrices`.

    Returns
    -------
    strategy of ndarray or csr_array, shape (size, size)

    Raises
    ------
    InvalidOption
        Where an option is out of its range.

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

    def build(draw: st.DrawFn, n: int, values: Numbers) -> Matrix:
        rank = n - draw(st.integers(0, n))
        order, L = draw(orders(n)), draw(unit_lower(n, values))[:, :rank]
        return reordered(L @ L.T, order)

    return matrices(build, size, density, dense)


def indefinite_matrices(
    size: Sizes = None, *, density: float = 1.0, dense: bool = True
) -> st.SearchStrategy[Any]:
    """Return a strategy for symmetric indefinite matrices: xᵀM x takes both signs.

    Parameters
    ----------
    size : int or strategy of int, optional
        Rows and columns, at least 2; 2 to 8 by default.
    density, dense
        As in :func:`positive_definite_matrices`.

    Returns
    -------
    strategy of ndarray or csr_array, shape (size, size)

    Raises
    ------
    InvalidOption
        Where an option is out of its range; where a drawn size is below 2, while drawing.

    Notes
    -----
    M = L W Lᵀ with L unit lower triangular with integer entries, in some order of its rows, and W a diagonal
    of which one entry is 1 to 9 and one −1 to −9: by Sylvester's law it has eigenvalues of both signs.

    Examples
    --------
    >>> from hypothesis import Phase, find, settings
    >>> quick = settings(phases=[Phase.generate], derandomize=True, database=None)
    >>> find(indefinite_matrices(), lambda M: True, settings=quick)
    array([[ 1.,  0.],
           [ 0., -1.]])
    """

    def build(draw: st.DrawFn, n: int, values: Numbers) -> Matrix:
        core = draw(vectors(n, ONE_FIRST))
        core[:2] = draw(POSITIVE), -draw(POSITIVE)
        order, L = draw(orders(n)), draw(unit_lower(n, values))
        return reordered(L @ np.diag(core) @ L.T, order)

    return matrices(build, size, density, dense, smallest=2)


def h_plus_matrices(size: Sizes = None, *, density: float = 1.0, dense: bool = True) -> st.SearchStrategy[Any]:
    """Return a strategy for H₊-matrices: positive diagonal, and ⟨M⟩v > 0 for some v > 0.

    Parameters
    ----------
    size : int or strategy of int, optional
        Rows and columns, 1 to 8 by default.
    density : float
        Share of nonzeros off the diagonal, in [0, 1]; roughly, since hypothesis likes to repeat itself.
    dense : bool
        Draw arrays; otherwise CSR arrays.

    Returns
    -------
    strategy of ndarray or csr_array, shape (size, size)

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
    return matrices(_h_plus, size, density, dense)


def m_matrices(size: Sizes = None, *, density: float = 1.0, dense: bool = True) -> st.SearchStrategy[Any]:
    """Return a strategy for nonsingular M-matrices, as a rule not symmetric: m_ij ≤ 0 off the diagonal, M⁻¹ ≥ 0.

    Parameters
    ----------
    size, density, dense
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
    return matrices(_m_matrix, size, density, dense)


def z_matrices(size: Sizes = None, *, density: float = 1.0, dense: bool = True) -> st.SearchStrategy[Any]:
    """Return a strategy for Z-matrices: m_ij ≤ 0 off the diagonal; M-matrices, singular and indefinite ones among them.

    Parameters
    ----------
    size, density, dense
        As in :func:`h_plus_matrices`.

    Examples
    --------
    >>> from hypothesis import Phase, find, settings
    >>> quick = settings(phases=[Phase.generate], derandomize=True, database=None)
    >>> shrunk = settings(quick, phases=[Phase.generate, Phase.shrink])
    >>> find(z_matrices(1), lambda M: M[0, 0] < 0, settings=shrunk)
    array([[-1.]])
    """
    return matrices(_z_matrix, size, density, dense)


def strictly_dominant_matrices(
    size: Sizes = None, *, density: float = 1.0, dense: bool = True
) -> st.SearchStrategy[Any]:
    """Return a strategy for matrices with m_ii > Σ_j≠i |m_ij| in every row.

    Parameters
    ----------
    size, density, dense
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
    return matrices(_by_row_sums, size, density, dense)


def p_matrices(size: Sizes = None, *, density: float = 1.0, dense: bool = True) -> st.SearchStrategy[Any]:
    """Return a strategy for P-matrices, all principal minors positive: exactly one solution for every q and all bounds.

    Parameters
    ----------
    size : int or strategy of int, optional
        Rows and columns, 1 to 8 by default.
    density : float
        Share of nonzeros of the parts, in [0, 1], roughly.
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
    return matrices(_p_matrix, size, density, dense)


def not_h_matrices(size: Sizes = None, *, density: float = 1.0, dense: bool = True) -> st.SearchStrategy[Any]:
    """Return a strategy for matrices that are no H-matrices: no scaling of rows and columns makes them dominant.

    Parameters
    ----------
    size : int or strategy of int, optional
        Rows and columns, at least 1 (where the only one is [0]); up to 8 by default.
    density : float
        Share of nonzeros of the parts, in [0, 1], roughly; what is planted comes on top.
    dense : bool
        Draw arrays; otherwise CSR arrays.

    Returns
    -------
    strategy of ndarray or csr_array, shape (size, size)

    Raises
    ------
    InvalidOption
        Where an option is out of its range; where a drawn size is too small, while drawing.

    Notes
    -----
    Planted is a cycle i₁ → i₂ → … → i₁ with |m_ij| ≥ |m_ii| on each of its arrows i → j, of length 1 a zero on the
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
    return matrices(_with_cycle, size, density, dense, smallest=1)


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
    result: Matrix = _by_row_sums(draw, n, values) * draw(vectors(n, UNITS))
    return result


def _m_matrix(draw: st.DrawFn, n: int, values: Numbers) -> Matrix:
    return _off_diagonal_negated(_h_plus(draw, n, values))


def _z_matrix(draw: st.DrawFn, n: int, values: Numbers) -> Matrix:
    return _off_diagonal_negated(_by_row_sums(draw, n, values, ONE_FIRST))


def _p_matrix(draw: st.DrawFn, n: int, values: Numbers) -> Matrix:
    if not draw(st.booleans()):
        return _h_plus(draw, n, values)
    cut, order = draw(st.integers(0, n)), draw(orders(n))
    A = skewed_definite_block(draw, n, values)
    A[cut:, :cut] = 0.0
    A[:cut, cut:] = draw(blocks(cut, n - cut, values))
    return reordered(A, order)


def _with_cycle(draw: st.DrawFn, n: int, values: Numbers) -> Matrix:
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
