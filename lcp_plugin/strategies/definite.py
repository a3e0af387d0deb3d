"""Strategies for matrices known by the signs of xᵀM x: positive definite, semidefinite and indefinite ones."""

from __future__ import annotations

import numpy as np
from hypothesis import strategies as st

from .options import (
    ONE_FIRST,
    POSITIVE,
    Matrix,
    Options,
    drawn_number,
    matrices,
    one_of,
    orders,
    reordered,
    skew_matrices,
    square,
    vectors,
    whole_number,
)


@matrices("scale")
def positive_definite_matrices(draw: st.DrawFn, n: int, options: Options, *, symmetric: bool = True) -> Matrix:
    """Return a strategy for positive definite matrices, xᵀM x > 0 for x ≠ 0; as a rule they are no H₊-matrices.

    Parameters
    ----------
    size : int or strategy of int, optional
        Rows and columns, 1 to 8 by default.
    density : float
        Share of nonzeros of the factor B, in [0, 1], roughly.
    scale : int
        Row i and column i are multiplied by the same power of two, exponents from −scale to scale, 0 to 400.
    margin : float
        A power of two in [2⁻³⁰, 1]: before scaling, no eigenvalue of the symmetric part is smaller. A small one gives
        nearly singular matrices where B is singular or nearly so.
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
    M = S (B Bᵀ + margin E + K) S with B an integer matrix, E a diagonal of integers from 1 to 9, K = −Kᵀ (0 where
    `symmetric`), S of powers of two.

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
    A = definite_block(draw, n, options)
    return A if symmetric else A + draw(skew_matrices(n, options.entries))


def definite_block(draw: st.DrawFn, n: int, options: Options) -> Matrix:
    """Return B Bᵀ + margin E: symmetric positive definite, shape (n, n)."""
    E = options.margin * np.diag(draw(vectors(n, POSITIVE)))
    B = draw(square(n, options.entries))
    result: Matrix = B @ B.T + E
    return result


def _smallest(rank: int | None, symmetric: bool) -> int:
    return 0 if rank is None else whole_number(rank, "rank must be a whole number ≥ 0", 0)


@matrices("scale", smallest=_smallest)
def positive_semidefinite_matrices(
    draw: st.DrawFn, n: int, options: Options, *, rank: int | None = None, symmetric: bool = True
) -> Matrix:
    """Return a strategy for positive semidefinite matrices of an exact rank, xᵀM x ≥ 0.

    Parameters
    ----------
    size, density, scale, dense
        As in :func:`positive_definite_matrices`.
    rank : int, optional
        Rank of M and of its symmetric part, at most the size; by default any from 0 to the size.
    margin : float
        A power of two in [2⁻³⁰, 1]: a small one gives matrices near some of smaller rank.
    symmetric : bool
        False adds a skew-symmetric matrix of the same range, which changes no rank.

    Returns
    -------
    strategy of ndarray or csr_array, shape (size, size)

    Raises
    ------
    InvalidOption
        Where an option is out of its range; where the rank exceeds a drawn size, while drawing.

    Notes
    -----
    M = S L (W + K) Lᵀ S with L of shape (size, rank), in some order of its rows unit lower trapezoidal with integer
    entries, W a diagonal of ones and margins, K = −Kᵀ.

    Examples
    --------
    >>> from hypothesis import Phase, find, settings
    >>> quick = settings(phases=[Phase.generate], derandomize=True, database=None)
    >>> find(positive_semidefinite_matrices(), lambda M: True, settings=quick)
    array([[1.]])
    >>> shrunk = settings(quick, phases=[Phase.generate, Phase.shrink])
    >>> find(positive_semidefinite_matrices(2, rank=1), lambda M: M.all(), settings=shrunk)
    array([[1., 1.],
           [1., 1.]])
    """
    r = n - draw(st.integers(0, n)) if rank is None else int(rank)
    core = np.diag(draw(vectors(n, one_of(1.0, options.margin)))[:r])
    order = draw(orders(n))
    L = (draw(square(n, options.entries, "below")) + np.eye(n))[:, :r]
    if not symmetric:
        core = core + draw(skew_matrices(n, options.entries))[:r, :r]
    return reordered(L @ core @ L.T, order)


@matrices("scale", smallest=lambda symmetric: 2)
def indefinite_matrices(draw: st.DrawFn, n: int, options: Options, *, symmetric: bool = True) -> Matrix:
    """Return a strategy for indefinite matrices: xᵀM x takes both signs.

    Parameters
    ----------
    size : int or strategy of int, optional
        Rows and columns, at least 2; 2 to 8 by default.
    density, scale, dense
        As in :func:`positive_definite_matrices`.
    margin : float
        A power of two in [2⁻³⁰, 1]: a small one gives matrices that miss being semidefinite narrowly.
    symmetric : bool
        False adds a skew-symmetric matrix.

    Returns
    -------
    strategy of ndarray or csr_array, shape (size, size)

    Raises
    ------
    InvalidOption
        Where an option is out of its range; where a drawn size is below 2, while drawing.

    Notes
    -----
    M = S (L W Lᵀ + K) S with L unit lower triangular with integer entries, in some order of its rows, and W a diagonal
    of which one entry is 1 to 9 and one −1 to −9 margins: by Sylvester's law L W Lᵀ has eigenvalues of both signs.

    Examples
    --------
    >>> from hypothesis import Phase, find, settings
    >>> quick = settings(phases=[Phase.generate], derandomize=True, database=None)
    >>> find(indefinite_matrices(), lambda M: True, settings=quick)
    array([[ 1.,  0.],
           [ 0., -1.]])
    """
    core = draw(vectors(n, ONE_FIRST))
    core[:2] = drawn_number(draw, POSITIVE), -options.margin * drawn_number(draw, POSITIVE)
    order = draw(orders(n))
    L = draw(square(n, options.entries, "below")) + np.eye(n)
    A = reordered(L @ np.diag(core) @ L.T, order)
    return A if symmetric else A + draw(skew_matrices(n, options.entries))
