"""What exact elimination proves of a matrix that is singular but for rounding: positive weights, a least eigenvalue."""

from __future__ import annotations

import math
from collections.abc import Sequence
from fractions import Fraction
from typing import Any

from .linear_systems import exact_comparison, has_positive_pivots, solve_exactly
from .rational import integers


def exact_weights(M: Any) -> list[Fraction] | None:
    """Return v with ⟨M⟩v = |diag(M)| in fractions, or None where ⟨M⟩ is singular.

    Examples
    --------
    >>> import scipy.sparse as sp
    >>> exact_weights(sp.csr_array([[2.0, -1.0], [1.0, 1.0]]))
    [Fraction(3, 1), Fraction(4, 1)]
    """
    rows = exact_comparison(M)
    return solve_exactly(rows, [row[i] for i, row in enumerate(rows)])


def eigenvalue_below(M: Any, exponents: Sequence[int]) -> float:
    """Return a double below the smallest eigenvalue of C (M + Mᵀ)/2 C, C = diag(2^exponents), by at most a quarter.

    Parameters
    ----------
    M : CSR array, shape (n, n)
        n ≤ EXACT_SIZE, its symmetric part positive definite.
    exponents : sequence of int, shape (n,)

    Examples
    --------
    >>> import scipy.sparse as sp
    >>> eigenvalue_below(sp.csr_array([[4.0, 2.0], [2.0, 4.0]]), [0, -1])  # of [[4, 1], [1, 1]] (5 − √13)/2 = 0.697…
    0.625
    """
    entries, exponent = integers(M.toarray().ravel())
    n, least = M.shape[0], 2 * min(exponents)
    part = [
        [(entries[i * n + j] + entries[j * n + i]) << (exponents[i] + exponents[j] - least) for j in range(n)]
        for i in range(n)
    ]

    def is_below(value: int, power: int) -> bool:
        above, shift = max(-power, 0), value << max(power, 0)
        return has_positive_pivots(
            [[(entry << above) - shift * (i == j) for j, entry in enumerate(row)] for i, row in enumerate(part)]
        )

    high, step = min(row[i] for i, row in enumerate(part)).bit_length(), 1  # no eigenvalue exceeds a diagonal entry
    while not is_below(1, high - step):
        step *= 2
    low = high - step
    high -= step // 2
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (middle, high) if is_below(1, middle) else (low, middle)
    value = next(value for value in (7, 6, 5, 4) if is_below(value, low - 2))
    return math.ldexp(value, low - 3 + exponent + least)
