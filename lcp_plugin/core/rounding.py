"""Sums of products in twice the digits, with rigorous bounds of their rounding errors.

Every product is split without error into a rounded value and its rounding error, and the terms of a row into parts that
add up without error in any order and small rests (Rump, Ogita, Oishi). Only sums of the rests of rests are rounded, so
that the bound is of third order, and zero if the sum is exact.

References
----------
S. M. Rump, T. Ogita, S. Oishi, *Accurate floating-point summation I*, SIAM J. Sci. Comput. 31 (2008),
doi:10.1137/050645671.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np

from .checks import AnyMatrix, Array, Vector
from .errors import InvalidProblem
from .kernels.floats import MAY_UNDERFLOW, TINY, UNIT

# error of a computed number relative to its terms: two that differ by less are equal, a smaller one counts as 0
ROUNDING = 1e-12
ENTRIES_TOGETHER = 2**15  # entries whose temporary vectors stay in a processor's cache
Sums = tuple[Vector, Vector, Vector]


@lru_cache(256)
def gamma(terms: int) -> float:
    """Return an upper bound of k u/(1 − k u), u = 2⁻⁵³: the relative error of k rounded operations in a row.

    Examples
    --------
    >>> gamma(4) > 4 * UNIT
    True
    """
    if terms >= 2**52:
        return np.inf
    return float(np.nextafter(terms * UNIT / (1.0 - terms * UNIT), np.inf)) * (1.0 + 4.0 * UNIT)


def compensated_product(M: AnyMatrix, x: Vector, q: Vector | None = None) -> tuple[Vector, Vector]:
    """Return (value, radius) with |M x + q − value| ≤ radius, each of shape (m,).

    Parameters
    ----------
    M : CSR array, shape (m, n)
    x : array, shape (n,)
    q : array, shape (m,), optional

    Returns
    -------
    value, radius : arrays, shape (m,)
        `value` is M x + q rounded once or nearly so; `radius` is 0 if the value is exact, ∞ if the row overflows or is
        not finite.

    Raises
    ------
    InvalidProblem
        If the shapes do not fit.

    Examples
    --------
    >>> import scipy.sparse as sp
    >>> M = sp.csr_array(np.array([[1e16, 1.0, -1e16], [0.1, 0.2, 0.3]]))
    >>> value, radius = compensated_product(M, np.ones(3))
    >>> float(value[0]), float(radius[0])
    (1.0, 0.0)
    >>> bool(0.0 < radius[1] < 1e-16)
    True
    """
    return one_number(*compensated_pair(M, x, q))


def one_number(high: Vector, low: Vector, radius: Vector) -> tuple[Vector, Vector]:
    """Return (value, radius) of sums (high, low, radius), `low` added to the radius."""
    low = np.abs(low)
    return high, np.where(radius == 0.0, low, np.nextafter(low + radius, np.inf))


def add_pairs(a: Sums, b: Sums) -> Sums:
    """Return (high, low, radius) of the sum of two results of :func:`compensated_pair`."""
    high, error = split_sum(a[0], b[0])
    low, lost = split_sum(a[1], b[1])
    low, missed = split_sum(low, error)
    radius = a[2] + b[2] + np.abs(lost) + np.abs(missed)
    return *split_sum(high, low), radius * (1.0 + 8.0 * UNIT)


def compensated_pair(M: AnyMatrix, x: Vector, q: Vector | None = None) -> Sums:
    """Return (high, low, radius) with |M x + q − (high + low)| ≤ radius, the sum not evaluated.

    `high` is the rounded value and `low` its rounding error; the radius is of order u³. Parameters and errors as for
    :func:`compensated_product`.

    Examples
    --------
    >>> import scipy.sparse as sp
    >>> high, low, radius = compensated_pair(sp.csr_array(np.array([[1.0, 1.0]])), np.array([1.0, 1e-20]))
    >>> float(high[0]), float(low[0]), bool(radius[0] < 1e-48)
    (1.0, 1e-20, True)
    """
    rows, columns = M.shape
    offset = np.zeros(rows) if q is None else q
    if x.shape != (columns,) or offset.shape != (rows,):
        raise InvalidProblem(
            f"a product with a {rows}×{columns} matrix needs x of shape ({columns},) and q of shape ({rows},); "
            f"got {x.shape} and {offset.shape}"
        )
    sums, first = np.empty((3, rows)), 0
    while first < rows:  # so many rows that their entries stay in the cache
        end = int(np.searchsorted(M.indptr, M.indptr[first] + ENTRIES_TOGETHER, "right")) - 1
        end = min(max(end, first + 1), first + ENTRIES_TOGETHER)
        entries, part = slice(M.indptr[first], M.indptr[end]), slice(first, end)
        starts = M.indptr[first : end + 1] - M.indptr[first]
        with np.errstate(all="ignore"):
            sums[:, part] = _row_sums(M.data[entries], x[M.indices[entries]], starts, offset[part])
        first = end
    high, low, radius = sums
    return high, low, radius


def _row_sums(a: Vector, b: Vector, starts: Array, offset: Vector) -> Any:
    """Return (high, low, radius) of the sums of a_k b_k of each row with its offset; `starts` as in a CSR array."""
    # a_k b_k = h_k + e_k exactly, without underflow. With σ a power of two, σ ≥ (m + 2) max|t_k| for m terms t_k, all
    # p_k = (σ + t_k) − σ are multiples of u σ and their sums at most σ in size: Σ p_k is exact in any order, and so is
    # each t_k − p_k, of size u σ at most (Rump, Ogita, Oishi, Lemma 3.3). First the h_k are split, then the rests
    # together with the e_k. The rests of these, 2m terms r_k, are summed with an error of γ(2m) Σ|r_k| at most; the
    # computed Σ|r_k| is too small by the same factor at most, so that (4m + 8) u Σ|r_k| is a bound. The sums and the
    # offset are added with all rounding errors; two of these have no place in `low` and are in the radius.
    counts = np.diff(starts)
    filled = counts > 0
    counts, starts = counts[filled], starts[:-1][filled]
    first, second, third, size, lost = np.zeros((5, filled.size))
    if starts.size:
        product, error, underflow = _exact_products(a, b)
        first[filled], (remainder,) = _split(starts, counts, product)
        second[filled], remainders = _split(starts, counts, remainder, error)
        third[filled] = np.add.reduceat(remainders[0] + remainders[1], starts)
        sizes = np.add.reduceat(np.abs(remainders[0]) + np.abs(remainders[1]), starts)
        size[filled] = (4.0 * counts + 8.0) * UNIT * sizes
        if underflow is not None:
            lost[filled] = np.add.reduceat(underflow, starts)
    high, low = split_sum(first, offset)
    high, more = split_sum(high, second)
    low, second_error = split_sum(low, more)
    low, third_error = split_sum(low, third)
    high, low = split_sum(high, low)
    radius = size + np.abs(second_error) + np.abs(third_error) + lost
    radius = np.where(radius > 0.0, (1.0 + 8.0 * UNIT) * radius + 4.0 * TINY, 0.0)
    is_number = np.isfinite(high + low + radius)
    return high, np.where(is_number, low, 0.0), np.where(is_number, radius, np.inf)


def _split(starts: Array, counts: Array, *terms: Vector) -> tuple[Vector, list[Vector]]:
    """Return exact sums of leading parts of the terms of each row, and the rests of the terms."""
    top = np.maximum.reduceat(np.max(np.abs(terms), axis=0), starts)
    unit = np.ldexp(1.0, np.frexp(top)[1] + np.frexp(len(terms) * counts + 2.0)[1])
    unit = np.repeat(unit, counts)
    parts = [(unit + term) - unit for term in terms]
    remainders = [term - part for term, part in zip(terms, parts, strict=True)]
    return np.add.reduceat(sum(parts[1:], parts[0]), starts), remainders


def _exact_products(a: Vector, b: Vector) -> tuple[Vector, Vector, Any]:
    """Return a b rounded, its rounding errors, and bounds of the underflow in these, or None."""
    product, error = product_and_error(a, b)
    small = np.flatnonzero((np.abs(product) < MAY_UNDERFLOW) & (a != 0.0) & (b != 0.0))
    if not small.size:
        return product, error, None
    less, more = np.where(np.abs(a) < np.abs(b), (a, b), (b, a))[:, small]
    # the same product in another unit
    scaled, remainder = product_and_error(less / MAY_UNDERFLOW, more)
    remainder += scaled - product[small] / MAY_UNDERFLOW
    error[small] = remainder * MAY_UNDERFLOW
    lost = np.zeros(a.shape)
    lost[small] = np.where((remainder == 0.0) & (np.abs(scaled) > MAY_UNDERFLOW), 0.0, 4.0 * TINY)
    return product, error, lost


def product_and_error(a: Vector, b: Vector) -> tuple[Vector, Vector]:
    """Return a b rounded, and its rounding error (Dekker), if no product of halves underflows."""
    (a_high, a_low), (b_high, b_low) = _halves(a), _halves(b)
    product = a * b
    excess = ((product - a_high * b_high) - a_low * b_high) - a_high * b_low
    return product, a_low * b_low - excess


def _halves(a: Vector) -> tuple[Vector, Vector]:
    """Return two numbers of 26 digits whose sum is a."""
    bits = np.ascontiguousarray(a).view(np.int64)
    high = ((bits + 2**26) & -(2**27)).view(np.float64)
    return high, a - high


def split_sum(a: Vector, b: Vector) -> tuple[Vector, Vector]:
    """Return a + b rounded, and its rounding error (Knuth)."""
    s = a + b
    t = s - a
    return s, (a - (s - t)) + (b - t)


def lower_end(value: Vector, radius: Vector) -> Vector:
    """Return a lower bound of value − radius, exact where the radius is 0, and −∞ where either is not finite."""
    return -upper_end(-value, radius)


def upper_end(value: Vector, radius: Vector) -> Vector:
    """Return an upper bound of value + radius, exact where the radius is 0, and ∞ where either is not finite."""
    end = np.where(radius == 0.0, value, np.nextafter(value + radius, np.inf))
    return np.where(np.isfinite(radius) & np.isfinite(value), end, np.inf)
