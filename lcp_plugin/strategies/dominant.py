"""Strategies for matrices known by the sums of their rows (Z, M, H₊) or by principal submatrices (P, not H)."""

from __future__ import annotations

from typing import Any

import numpy as np
from hypothesis import strategies as st

from .definite import definite_block
from .options import (
    ONE_FIRST,
    POSITIVE,
    SIGNS,
    Matrix,
    Numbers,
    Options,
    blocks,
    drawn_number,
    matrices,
    one_of,
    orders,
    reordered,
    skew_matrices,
    square,
    vectors,
)

PLUS = one_of(1)


@matrices("row_scale", "column_scale")
def h_plus_matrices(draw: st.DrawFn, n: int, options: Options) -> Matrix:
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
    >>> from hypothesis import Phase, find, settings
    >>> quick = settings(phases=[Phase.generate], derandomize=True, database=None)
    >>> find(h_plus_matrices(), lambda M: True, settings=quick)
    array([[1.]])
    """
    return _by_row_sums(draw, n, options, options.entries, POSITIVE)


@matrices("row_scale", "column_scale")
def m_matrices(draw: st.DrawFn, n: int, options: Options) -> Matrix:
    """Return a strategy for nonsingular M-matrices, as a rule not symmetric: m_ij ≤ 0 off the diagonal, M⁻¹ ≥ 0.

    Parameters
    ----------
    size, density, row_scale, column_scale, margin, dense
        As in :func:`h_plus_matrices`.

    Returns
    -------
    strategy of ndarray or csr_array, shape (size, size)

    Raises
    ------
    InvalidOption
        Where an option is out of its range.

    Examples
    --------
    >>> from hypothesis import Phase, find, settings
    >>> quick = settings(phases=[Phase.generate], derandomize=True, database=None)
    >>> shrunk = settings(quick, phases=[Phase.generate, Phase.shrink])
    >>> find(m_matrices(2), lambda M: M[0, 1] != 0, settings=shrunk)
    array([[ 2., -1.],
           [ 0.,  1.]])
    """
    return _by_row_sums(draw, n, options, options.entries.then(_not_positive), POSITIVE)


@matrices("row_scale", "column_scale")
def z_matrices(draw: st.DrawFn, n: int, options: Options) -> Matrix:
    """Return a strategy for Z-matrices: m_ij ≤ 0 off the diagonal; M-matrices, singular and indefinite ones among them.

    Parameters
    ----------
    size, density, row_scale, column_scale, dense
        As in :func:`h_plus_matrices`.
    margin : float
        A power of two in [2⁻³⁰, 1]: before scaling, the sum of a row is −9 to 9 margins. A small one gives matrices
        on both sides of the M-matrices' border.

    Returns
    -------
    strategy of ndarray or csr_array, shape (size, size)

    Raises
    ------
    InvalidOption
        Where an option is out of its range.

    Examples
    --------
    >>> from hypothesis import Phase, find, settings
    >>> quick = settings(phases=[Phase.generate], derandomize=True, database=None)
    >>> shrunk = settings(quick, phases=[Phase.generate, Phase.shrink])
    >>> find(z_matrices(), lambda M: M[0, 0] < 0, settings=shrunk)
    array([[-1.]])
    """
    return _by_row_sums(draw, n, options, options.entries.then(_not_positive), ONE_FIRST)


@matrices("row_scale")
def strictly_dominant_matrices(draw: st.DrawFn, n: int, options: Options, *, signed: bool = False) -> Matrix:
    """Return a strategy for matrices with |m_ii| > Σ_j≠i |m_ij| in every row.

    Parameters
    ----------
    size, density, row_scale, margin, dense
        As in :func:`h_plus_matrices`.
    signed : bool
        Draw diagonal entries of either sign; otherwise they are positive, and the matrices are H₊-matrices too.

    Returns
    -------
    strategy of ndarray or csr_array, shape (size, size)

    Raises
    ------
    InvalidOption
        Where an option is out of its range.

    Examples
    --------
    >>> from hypothesis import Phase, find, settings
    >>> quick = settings(phases=[Phase.generate], derandomize=True, database=None)
    >>> shrunk = settings(quick, phases=[Phase.generate, Phase.shrink])
    >>> find(strictly_dominant_matrices(2, signed=True), lambda M: M[0, 0] < 0, settings=shrunk)
    array([[-1.,  0.],
           [ 0.,  1.]])
    """
    return _by_row_sums(draw, n, options, options.entries, POSITIVE, SIGNS if signed else PLUS)


def _not_positive(values: Any) -> Any:
    return -abs(values)


def _by_row_sums(
    draw: st.DrawFn, n: int, options: Options, others: Numbers, surpluses: Numbers, diagonal_signs: Numbers = PLUS
) -> Matrix:
    surplus = options.margin * draw(vectors(n, surpluses))
    sides = draw(vectors(n, diagonal_signs))
    A = draw(square(n, others, "off"))
    np.fill_diagonal(A, sides * (abs(A).sum(axis=1) + surplus))
    return A


@matrices("row_scale", "column_scale")
def p_matrices(draw: st.DrawFn, n: int, options: Options) -> Matrix:
    """Return a strategy for P-matrices, all principal minors positive: exactly one solution for every q and all bounds.

    Parameters
    ----------
    size : int or strategy of int, optional
        Rows and columns, 1 to 8 by default.
    density : float
        Share of nonzeros of the parts, in [0, 1], roughly.
    row_scale, column_scale : int
        Rows and columns are multiplied by powers of two with exponents from −scale to scale, 0 to 400.
    margin : float
        A power of two in [2⁻³⁰, 1]: a small one gives nearly singular matrices.
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
    H₊-matrices, and in some order of the unknowns R [[A, X], [0, C]] S with A + Aᵀ and C + Cᵀ positive definite and X
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
        return _by_row_sums(draw, n, options, options.entries, POSITIVE)
    cut = draw(st.integers(0, n))
    order = draw(orders(n))
    A = definite_block(draw, n, options) + draw(skew_matrices(n, options.entries))
    if 0 < cut < n:
        A[cut:, :cut] = 0.0
        A[:cut, cut:] = draw(blocks(cut, n - cut, options.entries))
    return reordered(A, order)


@matrices("row_scale", "column_scale", smallest=lambda p_matrix: 2 if p_matrix else 1)
def not_h_matrices(draw: st.DrawFn, n: int, options: Options, *, p_matrix: bool = False) -> Matrix:
    """Return a strategy for matrices that are no H-matrices: no scaling of rows and columns makes them dominant.

    Parameters
    ----------
    size : int or strategy of int, optional
        Rows and columns, at least 1 (where the only one is [0]), 2 for P-matrices; up to 8 by default.
    p_matrix : bool
        Draw only P-matrices, with positive definite symmetric part before scaling; otherwise anything.
    density : float
        Share of nonzeros of the parts, in [0, 1], roughly; what is planted comes on top.
    row_scale, column_scale : int
        Rows and columns are multiplied by powers of two with exponents from −scale to scale, 0 to 400.
    margin : float
        A power of two in [2⁻³⁰, 1]: a small one gives matrices that miss being H-matrices narrowly.
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
    diagonal. Its product of |m_ij|/|m_ii| is at least 1 in any scaling, so that ρ(D⁻¹|B|) ≥ 1. In P-matrices the
    cycle has length 2 and m_ij m_ji ≤ −m_ii m_jj.

    Examples
    --------
    >>> from hypothesis import Phase, find, settings
    >>> quick = settings(phases=[Phase.generate], derandomize=True, database=None)
    >>> shrunk = settings(quick, phases=[Phase.generate, Phase.shrink])
    >>> find(not_h_matrices(), lambda M: len(M) > 1, settings=shrunk)
    array([[1., 1.],
           [1., 1.]])
    >>> find(not_h_matrices(p_matrix=True), lambda M: True, settings=quick)
    array([[ 1.,  1.],
           [-1.,  1.]])
    """
    return (_rotating if p_matrix else _with_cycle)(draw, n, options)


def _with_cycle(draw: st.DrawFn, n: int, options: Options) -> Matrix:
    diagonal, order = draw(vectors(n, ONE_FIRST)), draw(orders(n))
    # 0, 1, … mean a cycle of length 2, 3, …, and the last a zero on the diagonal: shrinking prefers the former.
    length = draw(st.integers(0, n - 1))
    arrows = draw(vectors(n, SIGNS)), options.margin * draw(vectors(n, Numbers(0, 9)))
    A = draw(square(n, options.entries, "off"))
    np.fill_diagonal(A, diagonal)
    if length == n - 1:
        A[order[0], order[0]] = 0.0
    else:
        cycle = order[: length + 2]
        for i, j, sign, surplus in zip(cycle, np.roll(cycle, -1), *arrows, strict=False):
            A[i, j] = sign * (abs(A[i, i]) + surplus)
    return A


def _rotating(draw: st.DrawFn, n: int, options: Options) -> Matrix:
    i, j = draw(orders(n))[:2]
    sign, surplus = drawn_number(draw, SIGNS), options.margin * drawn_number(draw, Numbers(0, 9))
    S = definite_block(draw, n, options)
    K = draw(skew_matrices(n, options.entries))
    # (s + k)(s − k) = s² − k² ≤ −max(s_ii, s_jj)².
    K[i, j] = sign * (max(S[i, i], S[j, j]) + abs(S[i, j]) + surplus)
    K[j, i] = -K[i, j]
    return S + K
