"""Strategies for matrices known by the sums of their rows: Z-, M-, H₊- and strictly dominant matrices."""

from __future__ import annotations

from typing import Any

import numpy as np
from hypothesis import strategies as st

from .options import (
    ONE_FIRST,
    POSITIVE,
    SIGNS,
    Numbers,
    Options,
    Sizes,
    checked_options,
    drawn_units,
    finished,
    one_of,
    square,
    vectors,
)

PLUS = one_of(1)


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
    >>> from hypothesis import Phase, find, settings
    >>> quick = settings(phases=[Phase.generate], derandomize=True, database=None)
    >>> find(h_plus_matrices(), lambda M: True, settings=quick)
    array([[1.]])
    """
    options = checked_options(size, density, row_scale, column_scale, margin, dense)
    return _by_row_sums(options, options.entries, POSITIVE)


def m_matrices(
    size: Sizes = None,
    *,
    density: float = 1.0,
    row_scale: int = 0,
    column_scale: int = 0,
    margin: float = 1.0,
    dense: bool = True,
) -> st.SearchStrategy[Any]:
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
    options = checked_options(size, density, row_scale, column_scale, margin, dense)
    return _by_row_sums(options, options.entries.then(_not_positive), POSITIVE)


def z_matrices(
    size: Sizes = None,
    *,
    density: float = 1.0,
    row_scale: int = 0,
    column_scale: int = 0,
    margin: float = 1.0,
    dense: bool = True,
) -> st.SearchStrategy[Any]:
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
    options = checked_options(size, density, row_scale, column_scale, margin, dense)
    return _by_row_sums(options, options.entries.then(_not_positive), ONE_FIRST)


def strictly_dominant_matrices(
    size: Sizes = None,
    *,
    density: float = 1.0,
    row_scale: int = 0,
    margin: float = 1.0,
    signed: bool = False,
    dense: bool = True,
) -> st.SearchStrategy[Any]:
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
    options = checked_options(size, density, row_scale, 0, margin, dense)
    return _by_row_sums(options, options.entries, POSITIVE, SIGNS if signed else PLUS)


def _not_positive(values: Any) -> Any:
    return -abs(values)


@st.composite
def _by_row_sums(
    draw: st.DrawFn, options: Options, others: Numbers, surpluses: Numbers, diagonal_signs: Numbers = PLUS
) -> Any:
    n = draw(options.sizes)
    surplus = options.margin * draw(vectors(n, surpluses))
    sides, units = draw(vectors(n, diagonal_signs)), drawn_units(draw, n, options)
    A = draw(square(n, others, "off"))
    np.fill_diagonal(A, sides * (abs(A).sum(axis=1) + surplus))
    return finished(A, units, options.dense)
