"""Complementary rows, z and w between bounds, and the q that makes them the answer, exactly."""

from __future__ import annotations

import math
from fractions import Fraction
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp
from hypothesis import strategies as st

from ..core.checks import FloatVector
from ..core.errors import InvalidOption, InvalidProblem
from ..core.lcp import LCP
from ..proofs.exact.exactly import exact_slack
from .options import (
    LARGEST_ENTRY,
    POSITIVE,
    SIGNED,
    IntVector,
    Numbers,
    by_share,
    checked_share,
    integer_vectors,
    vectors,
)

Rows = tuple[FloatVector, FloatVector, FloatVector, FloatVector]  # z, w, lower, upper
AWAY = np.array([*range(1, LARGEST_ENTRY + 1), *(math.inf,) * LARGEST_ENTRY])
DIGITS = 53


class RowKinds(NamedTuple):
    """What rows are drawn: the shares, checked, and the bounds of rows that get none (0 and ∞, or none at all)."""

    active: float
    degenerate: float
    bounds: float
    otherwise_free: bool = False


# Which bounds a row touches, lower and upper, and the sign that its slack then has.
BETWEEN = (0, 0, 0)
AT_LOWER, DEGENERATE_LOWER = (1, 0, 1), (1, 0, 0)
AT_UPPER, DEGENERATE_UPPER = (0, 1, -1), (0, 1, 0)
FIXED, FIXED_FROM_ABOVE, DEGENERATE_FIXED = (1, 1, 1), (1, 1, -1), (1, 1, 0)
BOUNDED_KINDS = np.array(  # one line for inactive, active and degenerate rows
    [
        (BETWEEN,) * 12,
        (AT_LOWER, AT_UPPER, FIXED, FIXED_FROM_ABOVE) * 3,
        (DEGENERATE_LOWER, DEGENERATE_UPPER, DEGENERATE_FIXED) * 4,
    ]
)

CHOICES = (12, AWAY.size, AWAY.size)


def checked_kinds(active: float, degenerate: float, bounds: float, *, otherwise_free: bool = False) -> RowKinds:
    """Return the shares, or raise InvalidOption where one is outside [0, 1] or active and degenerate exceed all."""
    kinds = RowKinds(
        checked_share("active", active), checked_share("degenerate", degenerate), checked_share("bounds", bounds),
        otherwise_free,
    )
    if kinds.active + kinds.degenerate > 1.0 + 1e-9:
        raise InvalidOption(f"active + degenerate must be at most 1, got {active!r} + {degenerate!r}")
    return kinds


def drawn_rows(draw: st.DrawFn, n: int, kinds: RowKinds) -> Rows:
    """Return complementary z, w, lower and upper, each of shape (n,): small integers."""
    group = draw(integer_vectors(n, by_share(1.0 - kinds.active - kinds.degenerate, kinds.active, kinds.degenerate)))
    size = draw(vectors(n, POSITIVE))
    zero, infinite = np.zeros(n), np.full(n, math.inf)
    plain: Rows = np.where(group == 0, size, 0.0), np.where(group == 1, size, 0.0), zero, infinite
    if not kinds.bounds and not kinds.otherwise_free:
        return plain
    z = draw(vectors(n, SIGNED))
    if kinds.otherwise_free:
        plain = z, zero, -infinite, infinite
    if not kinds.bounds:
        return plain
    # One number a row stands for three, so that there is less to draw and to shrink.
    which, *distances = np.unravel_index(draw(integer_vectors(n, Numbers(0, math.prod(CHOICES) - 1))), CHOICES)
    at_lower, at_upper, sign = BOUNDED_KINDS[group, which].T
    below, above = (
        np.where(touches, 0.0, AWAY[k]) for touches, k in zip((at_lower, at_upper), distances, strict=True)
    )
    is_bounded = draw(vectors(n, by_share(1.0 - kinds.bounds, kinds.bounds))) > 0
    bounded = z, sign * size, z - below, z + above
    first, second, third, fourth = (np.where(is_bounded, b, p) for b, p in zip(bounded, plain, strict=True))
    return first, second, third, fourth


def exact_offset(matrix: Any, z: FloatVector, slack: FloatVector, lift: IntVector) -> FloatVector:
    """Return q = w − M z, shape (n,), or raise InvalidProblem where a double cannot hold it.

    w_i is the small integer slack_i times the power of two just below row i's largest entry, so that it fits the row,
    times 2 to the power lift_i, as far as a double has room for that.
    """
    M, q = sp.csr_array(matrix), []
    for i, (product, unit) in enumerate(zip(exact_products(M, z), row_units(M), strict=True)):
        w = _lifted(Fraction(slack[i]) * Fraction(unit), product, int(lift[i]))
        sizes = abs(M.data[M.indptr[i] : M.indptr[i + 1]])
        q.append(exact_double(
            w - product,
            f"q = w − M z is not free of rounding in row {i} of M, whose entries lie between "
            f"{sizes.min(initial=np.inf):g} and {sizes.max(initial=0.0):g} in size; draw short entries of similar size "
            "and scale by row_scale and column_scale of the strategy for the problems",
        ))
    return np.array(q)


def row_units(M: Any) -> FloatVector:
    """Return the largest power of two that is at most the largest entry of each row in size, 1 for 0; shape (n,)."""
    largest = np.max(abs(M.toarray() if sp.issparse(M) else M), axis=1, initial=0.0)
    mantissa, exponent = np.frexp(largest)
    units: FloatVector = np.ldexp(1.0, np.where(mantissa == 0.0, 0, exponent - 1))
    return units


def exact_products(M: Any, z: FloatVector) -> list[Fraction]:
    """Return M z without rounding, shape (n,)."""
    return exact_slack(LCP(M, np.zeros(z.size)), z)


def _lifted(w: Fraction, product: Fraction, lift: int) -> Fraction:
    """Return w·2^lift, or less where w − product would then have more digits than a double."""
    if not w or not lift:
        return w
    ends = [_lowest_bit(value) for value in (w, product) if value]
    room = min(ends) + DIGITS - 2 - math.frexp(w)[1]
    return w * Fraction(2) ** max(0, min(lift, room))


def _lowest_bit(value: Fraction) -> int:
    return (value.numerator & -value.numerator).bit_length() - value.denominator.bit_length()


def exact_double(exact: Fraction, complaint: str) -> float:
    """Return the double that equals the fraction, or raise InvalidProblem with the complaint."""
    try:
        value = float(exact)
    except OverflowError:
        value = math.nan
    if math.isnan(value) or Fraction(value) != exact:
        raise InvalidProblem(complaint)
    return value


def fractions_of(values: Any) -> tuple[Fraction, ...]:
    """Return an array of doubles as exact numbers."""
    return tuple(Fraction(float(value)) for value in values)
