"""Row and column scaling by powers of two, which rounds nothing, for matrices whose units span many decades."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..core.checks import AnyMatrix, Vector
from ..core.entries import Exponents, row_numbers

EQUILIBRATING_PASSES = (0.5, 0.5, 0.5, 0.5, 1.0)  # as `equilibrating_exponents` takes them


def power_of_two(sizes: ArrayLike, most: int = 1022) -> Any:
    """Return the powers of two just above sizes ≥ 0, with exponents of at most so much; 1 for 0 and what is not finite.

    Examples
    --------
    >>> power_of_two([0.0, 3.0, 0.5, np.inf])
    array([1., 4., 1., 1.])
    >>> bool(power_of_two(1e-300, 500) == 2.0**-500)
    True
    """
    # np.clip takes twice as long for one number
    exponents = np.minimum(np.maximum(np.frexp(sizes)[1], -most), most)
    return np.ldexp(1.0, exponents * np.isfinite(sizes))


def scaling_exponents(M: AnyMatrix, is_symmetric: bool) -> Exponents | None:
    """Return powers of two that bring the diagonal near 1 and balance the rest, or None if M needs none.

    Parameters
    ----------
    M : CSR array, shape (n, n)
        Matrix with a nonzero diagonal.
    is_symmetric : bool
        If True, the scaled matrix is also symmetric.
    """
    pivots = np.abs(M.diagonal())
    diagonal: Vector = np.log2(pivots)
    ratios = np.log2(np.abs(M.data)) - diagonal[row_numbers(M)]
    # Exponents of 2: so small a spread of the diagonal and of |m_ij|/|m_ii| needs no scaling
    if np.ptp(diagonal) <= 20.0 and ratios.max() <= 10.0:
        return None
    if is_symmetric:
        return unit_diagonal(pivots)
    column = equilibrating_exponents(M, EQUILIBRATING_PASSES, 1000.0).column
    return Exponents(-column - np.rint(diagonal).astype(np.int64), column)


def unit_diagonal(diagonal: Vector) -> Exponents:
    """Return the powers of two, alike for rows and columns, that bring a positive diagonal near 1."""
    half = -np.rint(np.log2(diagonal) / 2.0).astype(np.int64)
    return Exponents(half, half)


def equilibrating_exponents(M: AnyMatrix, aims: Sequence[float], most: float = np.inf) -> Exponents:
    """Return powers of two that bring the entries of a CSR array near 1, rows and columns alternately.

    Parameters
    ----------
    M : CSR array, shape (m, n)
    aims : sequence of float
        For each pass what is brought to 1 of a row or column: 1 its largest entry, ½ the middle of largest and
        smallest.
    most : float
        No exponent is larger in size.
    """
    exponents, places = np.frexp(M.data)[1].astype(float), (row_numbers(M), M.indices)
    scales = [np.zeros(count) for count in M.shape]
    for share in aims:
        for axis, indices in enumerate(places):
            now = exponents + scales[0][places[0]] + scales[1][places[1]]
            largest, smallest = np.full(M.shape[axis], -np.inf), np.full(M.shape[axis], np.inf)
            np.maximum.at(largest, indices, now)
            np.minimum.at(smallest, indices, now)
            middle = share * largest + (1.0 - share) * smallest if share < 1.0 else largest
            scales[axis] -= np.where(np.isfinite(largest), np.rint(middle), 0.0)
    return Exponents(*(np.clip(scale, -most, most).astype(np.int64) for scale in scales))
