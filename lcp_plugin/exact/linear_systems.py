"""Exact solution of square integer systems: p-adic lifting from one inverse modulo a prime."""

from __future__ import annotations

import math
from collections.abc import Sequence
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..deadline import is_over

# Below 2^25, so that 2^13 products add up in 64 bits; a matrix singular modulo all three is taken for singular.
PRIMES = (33554393, 33554383, 33554371)
LIMB = 22

Integers = NDArray[np.int64]
IntegerRows = Sequence[Sequence[int]]


def modulo(A: IntegerRows, prime: int) -> Integers:
    """Return A modulo the prime, shape (m, k)."""
    return np.array([[a % prime for a in row] for row in A], dtype=np.int64).reshape(len(A), -1)


def rank_profile(A: IntegerRows) -> tuple[list[int], list[int]]:
    """Return row and column indices of a largest nonsingular square block, first rows first (modulo a prime).

    The block is nonsingular for certain; that no larger one exists is only as good as the prime.

    Examples
    --------
    >>> rank_profile([[0, 0, 2], [0, 0, 4], [1, 0, 0]])
    ([0, 2], [2, 0])
    """
    prime = PRIMES[0]
    work = modulo(A, prime)
    rows, columns = [], []
    for i in range(work.shape[0]):
        nonzero = np.flatnonzero(work[i])
        if not nonzero.size:
            continue
        j = int(nonzero[0])
        rows.append(i)
        columns.append(j)
        factors = work[i + 1 :, j] * pow(int(work[i, j]), -1, prime) % prime
        touched = np.flatnonzero(factors)
        below = work[i + 1 :]
        below[touched] = (below[touched] - factors[touched, None] * work[i]) % prime
    return rows, columns


def solve_exactly(A: IntegerRows, b: Sequence[int]) -> list[Fraction] | None:
    """Return the solution of A x = b in fractions, or None where A is singular (modulo three primes).

    None too where the time limit of a run passes meanwhile.

    Parameters
    ----------
    A : sequence of rows of integers, shape (k, k)
    b : sequence of integers, shape (k,)

    Notes
    -----
    One inverse modulo a prime p, then one digit of x in base p for two products with k × k matrices; what comes out is
    checked by A x = b before it is returned.

    References
    ----------
    J. D. Dixon, *Exact solution of linear equations using p-adic expansions*, Numer. Math. 40 (1982),
    doi:10.1007/BF01459082.

    Examples
    --------
    >>> solve_exactly([[2, 1], [1, 3]], [1, 0])
    [Fraction(3, 5), Fraction(-1, 5)]
    """
    if not A:
        return []
    for prime in PRIMES:
        inverse = _inverse(modulo(A, prime), prime)
        if inverse is not None:
            return _lifted(A, b, inverse, prime)
    return None


def _inverse(matrix: Integers, prime: int) -> Integers | None:
    k = len(matrix)
    work = np.hstack([matrix, np.eye(k, dtype=np.int64)])
    for i in range(k):
        nonzero = np.flatnonzero(work[i:, i])
        if not nonzero.size:
            return None
        work[[i, i + nonzero[0]]] = work[[i + nonzero[0], i]]
        work[i] = work[i] * pow(int(work[i, i]), -1, prime) % prime
        factors = work[:, i].copy()
        factors[i] = 0
        touched = np.flatnonzero(factors)
        work[touched] = (work[touched] - factors[touched, None] * work[i]) % prime
    return work[:, k:]


def _lifted(A: IntegerRows, b: Sequence[int], inverse: Integers, prime: int) -> list[Fraction] | None:
    limbs = _limbs(A)
    residual = np.array([int(value) for value in b], dtype=object)
    x = np.zeros(len(A), dtype=object)
    modulus, digits, next_try = 1, 0, 4
    while not is_over():
        digit = inverse @ (residual % prime).astype(np.int64) % prime
        residual = (residual - _product(limbs, digit)) // prime
        x += digit.astype(object) * modulus
        modulus *= prime
        digits += 1
        if digits == next_try:
            answer = _reconstructed(x, modulus)
            if answer is not None and _satisfies(A, b, *answer):
                numerators, denominator = answer
                return [Fraction(value, denominator) for value in numerators]
            next_try = digits + max(4, digits // 2)
    return None


def _limbs(A: IntegerRows) -> list[Integers]:
    """Return A in base 2^22, lowest first, so that products with digits below 2^25 add up in 64 bits."""
    longest = max((abs(a).bit_length() for row in A for a in row), default=0)
    mask = (1 << LIMB) - 1
    return [
        np.array([[(abs(a) >> shift & mask) * (1 if a >= 0 else -1) for a in row] for row in A], dtype=np.int64)
        for shift in range(0, max(longest, 1), LIMB)
    ]


def _product(limbs: list[Integers], digit: Integers) -> Any:
    total = (limbs[-1] @ digit).astype(object)
    for limb in reversed(limbs[:-1]):
        total = total * (1 << LIMB) + (limb @ digit)
    return total


def _reconstructed(x: Any, modulus: int) -> tuple[list[int], int] | None:
    """Return small numerators and one denominator that equal x modulo the modulus, if there are any."""
    bound = math.isqrt(modulus // 2)
    numerators: list[int] = []
    denominator = 1
    for value in x:
        rest = value * denominator % modulus
        rest = rest - modulus if 2 * rest > modulus else rest
        if abs(rest) > bound:
            rest, factor = _small_fraction(rest % modulus, modulus, bound)
            denominator *= factor
            if denominator > bound:
                return None
            numerators = [numerator * factor for numerator in numerators]
        numerators.append(rest)
    return numerators, denominator


def _small_fraction(value: int, modulus: int, bound: int) -> tuple[int, int]:
    """Return r, s with r ≡ s · value and |r| ≤ bound, by Euclid's algorithm stopped half-way."""
    r0, r1, s0, s1 = modulus, value, 0, 1
    while r1 > bound:
        quotient = r0 // r1
        r0, r1, s0, s1 = r1, r0 - quotient * r1, s1, s0 - quotient * s1
    return (r1, s1) if s1 > 0 else (-r1, -s1)


def _satisfies(A: IntegerRows, b: Sequence[int], numerators: list[int], denominator: int) -> bool:
    return all(
        sum(a * x for a, x in zip(row, numerators, strict=True) if a) == denominator * value
        for row, value in zip(A, b, strict=True)
    )
