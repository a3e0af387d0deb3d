"""Exact arithmetic on what is stored in double precision.

Integers with an exponent, fractions, products of sparse rows; signs of minors by elimination without fractions,
solutions by p-adic lifting; sums, products and quotients rounded upwards, element by element.

Doubles are dyadic numbers: a power of two makes a row integers and changes no sign of a principal minor. Elimination
without fractions (Bareiss) keeps them integers, each a minor of the matrix it began with.

References
----------
E. H. Bareiss, *Sylvester's identity and multistep integer-preserving Gaussian elimination*, Math. Comp. 22 (1968),
doi:10.1090/S0025-5718-1968-0226829-0.

An exact result stays exact, so that a bound can be 0. Overflow is safe: a sum or quotient of −∞
becomes the least float64, which is above the true value. NaN stays NaN.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from fractions import Fraction
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike, NDArray

from ..core import deadline
from ..core.checks import AnyMatrix, Array, BoolVector, Vector
from ..core.errors import InvalidProblem
from ..core.kernels.floats import EPSILON, LARGEST, TINY
from ..core.lcp import LCP
from ..core.matrix import Matrix, fact

Rational = int | float | Fraction
Row = dict[int, Fraction]
Fractions = list[Fraction]

ZERO = Fraction(0)


def integers(values: Vector) -> tuple[list[int], int]:
    """Return integers and one exponent e with values_i = integer_i · 2^e, exactly; the values are finite.

    Examples
    --------
    >>> integers(np.array([0.75, -2.0, 0.0]))
    ([3, -8, 0], -2)
    """
    mantissa, exponent = np.frexp(values)
    whole = (mantissa * 2.0**53).astype(np.int64)
    lowest_bit = np.frexp((whole & -whole).astype(np.float64))[1] - 1
    nonzero = whole != 0
    if not nonzero.any():
        return [0] * values.size, 0
    # Trailing zeros go to the exponent, which keeps the integers short.
    whole = np.where(nonzero, whole >> np.where(nonzero, lowest_bit, 0), 0)
    exponent = exponent - 53 + lowest_bit
    smallest = int(exponent[nonzero].min())
    shifts = np.where(nonzero, exponent - smallest, 0)
    return [m << s for m, s in zip(whole.tolist(), shifts.tolist(), strict=True)], smallest


def exact_power_of_two(exponent: int) -> Fraction:
    """Return 2^exponent, exactly."""
    return Fraction(1 << exponent) if exponent >= 0 else Fraction(1, 1 << -exponent)


class IntegerMatrix(NamedTuple):
    """Rows of a matrix, by their numbers: columns with integers, times 2^exponent."""

    rows: dict[int, list[tuple[int, int]]]
    exponent: int

    @classmethod
    def of(cls, csr: AnyMatrix, rows: Sequence[int] | None = None) -> IntegerMatrix:
        """Return a CSR array of finite doubles as integers, or only some of its rows."""
        kept, numbers = (csr, range(csr.shape[0])) if rows is None else (csr[rows], rows)
        whole, exponent = integers(np.asarray(kept.data))
        pairs = list(zip(kept.indices.tolist(), whole, strict=True))
        spans = zip(numbers, pairwise(kept.indptr.tolist()), strict=True)
        return cls({i: pairs[slice(*span)] for i, span in spans}, exponent)

    def combination(self, y: Mapping[int, int]) -> dict[int, int]:
        """Return the entries of Mᵀy / 2^exponent that are not 0, of integers y_i by row."""
        product: dict[int, int] = {}
        for i, factor in y.items():
            for column, entry in self.rows[i]:
                product[column] = product.get(column, 0) + entry * factor
        return {column: value for column, value in product.items() if value}


def common_denominator(values: Sequence[Rational]) -> tuple[list[int], int]:
    """Return integers and one positive denominator with values_i = integer_i / denominator."""
    fractions = [value if type(value) is Fraction else Fraction(value) for value in values]
    denominator = math.lcm(*(value.denominator for value in fractions))
    whole = [value.numerator * (denominator // value.denominator) for value in fractions]
    return whole, denominator


def like(values: Array, z: Array) -> Any:
    """Return floats unchanged, or as Fractions if z has Fractions."""
    if z.dtype != object:
        return values
    return np.array([Fraction(value) for value in values.tolist()], dtype=object)


def exact_vector(z: ArrayLike | Sequence[Rational], n: int) -> list[Fraction]:
    """Return the vector in fractions, shape (n,).

    Raises
    ------
    InvalidProblem
        If it has another length, or a number in it is not finite.
    """
    values: list[Any] = list(z)  # type: ignore[arg-type]
    if len(values) != n:
        raise InvalidProblem(f"z must have length {n}, got {len(values)}; give one number a row")
    try:
        return [Fraction(value) for value in values]
    except (TypeError, ValueError, OverflowError) as error:
        raise InvalidProblem(f"z must consist of finite numbers: {error}") from error


def rounded_down(value: Fraction | None) -> float:
    """Return the largest double that is not above the value; ∞ for None."""
    if value is None:
        return math.inf
    try:
        near = float(value)
    except OverflowError:
        return LARGEST if value > 0 else -math.inf
    return near if Fraction(near) <= value else math.nextafter(near, -math.inf)


def enclosures(values: Sequence[Fraction]) -> tuple[Vector, Vector]:
    """Return the nearest float64 numbers not above and not below the values, ∞ beyond the range.

    Examples
    --------
    >>> low, high = enclosures([Fraction(1, 2), Fraction(1, 3)])
    >>> (high - low).tolist()
    [0.0, 5.551115123125783e-17]
    """
    low = np.array([rounded_down(value) for value in values], dtype=np.float64)
    return low, np.array([-rounded_down(-value) for value in values], dtype=np.float64)


def rational(values: Iterable[float]) -> Fractions:
    """Return finite doubles as the rationals that they are."""
    return [Fraction(float(value)) for value in values]


def rational_rows(matrix: AnyMatrix) -> list[Row]:
    """Return the rows of an array or sparse array as dictionaries column → entry."""
    rows = sp.csr_array(matrix)
    columns, entries, pointer = rows.indices.tolist(), rows.data.tolist(), rows.indptr.tolist()
    spans = pairwise(pointer)
    return [{columns[k]: Fraction(entries[k]) for k in range(*s) if entries[k]} for s in spans]


def products(rows: Sequence[Row], vector: Sequence[Fraction]) -> Iterator[Fraction]:
    """Yield Σ_j row_j vector_j of each row; in integers, as fractions would look for common divisors at every term."""
    numerators, denominator = common_denominator(vector)
    for row in rows:
        terms = [(a, numerators[j]) for j, a in row.items() if numerators[j]]
        common = math.lcm(*(a.denominator for a, _ in terms))
        total = sum(a.numerator * (common // a.denominator) * x for a, x in terms)
        yield Fraction(total, common * denominator) if total else ZERO


def short(values: Vector, denominator: int = 1 << 30) -> Fractions:
    """Return rational numbers near the values, with few digits; zeros stay zeros."""
    largest = float(np.abs(values).max(initial=0.0))
    if largest == 0.0 or not np.isfinite(largest):
        return [ZERO] * values.size
    unit = Fraction(2) ** int(np.floor(np.log2(largest))) / denominator
    return [round(Fraction(value) / unit) * unit for value in values.tolist()]


@fact
def integer_matrix(matrix: Matrix) -> IntegerMatrix:
    """Return M in integers."""
    return IntegerMatrix.of(matrix.csr)


def exact_slack(problem: LCP, z: ArrayLike | Sequence[Rational]) -> list[Fraction]:
    """Return w = M z + q without rounding, shape (n,).

    Raises
    ------
    InvalidProblem
        If z is not a vector of n finite numbers.

    Examples
    --------
    >>> exact_slack(LCP([[3, 0], [0, 1]], [-1, 0]), [Fraction(1, 3), 0])
    [Fraction(0, 1), Fraction(0, 1)]
    """
    numerators, denominator = common_denominator(exact_vector(z, problem.n))
    matrix = integer_matrix(problem.matrix)
    unit = exact_power_of_two(matrix.exponent) / denominator
    sums = (sum(entry * numerators[j] for j, entry in row) for row in matrix.rows.values())
    return [Fraction(q) + unit * total for q, total in zip(problem.q.tolist(), sums, strict=True)]


def exact_residuals(problem: LCP, z: ArrayLike | Sequence[Rational]) -> list[Fraction]:
    """Return |z − mid(lower, upper, z − w/d)| of every row without any rounding, for a finite z."""
    exact, units = exact_vector(z, problem.n), problem.residual_scale.tolist()
    bounds = problem.lower.tolist(), problem.upper.tolist()
    # The comparison of a fraction with ±∞ is exact as well.
    rows = zip(exact, exact_slack(problem, exact), units, *bounds, strict=True)
    return [abs(x - Fraction(min(max(x - w / Fraction(d), l), u))) for x, w, d, l, u in rows]


def is_exact_solution(problem: LCP, z: ArrayLike | Sequence[Rational]) -> bool:
    """Return whether z solves the problem without any rounding.

    Raises
    ------
    InvalidProblem
        If z is not a vector of n finite numbers.

    Examples
    --------
    >>> is_exact_solution(LCP([[3]], [-1]), [Fraction(1, 3)]), is_exact_solution(LCP([[3]], [-1]), [1 / 3])
    (True, False)
    """
    return not any(exact_residuals(problem, z))


def slack_bounds(problem: LCP) -> tuple[Vector, Vector]:
    """Return the signs of w that the bounds of z permit, as bounds of w, each of shape (n,).

    0 ≤ w_i if z_i has no upper bound, w_i ≤ 0 if z_i has no lower bound; a box permits both signs.
    """
    lowest = np.where(problem.upper == np.inf, 0.0, -np.inf)
    return lowest, np.where(problem.lower == -np.inf, 0.0, np.inf)


EXACT_SIZE = 10  # rows; minors of doubles are long numbers
MOST_UNKNOWNS = 600  # of an exact elimination, whose numbers grow with each step
MOST_ENTRIES = 4_000_000  # of a dense matrix whose rank is computed: some seconds
# Below 2^25, so that 2^13 products add up in 64 bits; a matrix singular modulo it is taken for singular.
PRIME = 33554393
LIMB = 22  # bits: products with digits below 2²⁵ add up in 64 bits

Integers = NDArray[np.int64]
IntegerRows = Sequence[Sequence[int]]
Lists = list[list[int]]


# --- Signs of minors ----------------------------------------------------------------------


def exact_rows(M: AnyMatrix) -> Lists:
    """Return the entries of a CSR array as integers, each row times a power of two."""
    return [shortened(row) for row in _whole(M)]


def exact_symmetric_part(M: AnyMatrix) -> Lists:
    """Return M + Mᵀ as integers, each row times a power of two."""
    rows = _whole(M)
    return [shortened([a + rows[j][i] for j, a in enumerate(row)]) for i, row in enumerate(rows)]


def _whole(M: AnyMatrix) -> Lists:
    """Return the entries of a CSR array as integers, all of them times one power of two."""
    entries, _ = integers(M.toarray().ravel())
    width = max(M.shape[1], 1)
    return [entries[first : first + width] for first in range(0, len(entries), width)]


def shortened(row: Sequence[int]) -> list[int]:
    """Return integers divided by the largest power of two that divides all of them."""
    zeros = min(((entry & -entry).bit_length() - 1 for entry in row if entry), default=0)
    return [entry >> zeros for entry in row]


def has_nonnegative_pivots(matrix: Lists, *, is_strict: bool = False) -> bool:
    """Return whether a symmetric matrix is positive semidefinite; rows of zero pivots are zero.

    A strict test lets only positive pivots pass: of a definite matrix, or a Z-matrix that is a nonsingular M-matrix.
    """
    before = 1
    while matrix:
        pivot = matrix[0][0]
        if pivot < 0 or (pivot == 0 and (is_strict or any(matrix[0]))):
            return False
        matrix, before = (eliminated(matrix, before), pivot) if pivot else (_rest(matrix), before)
    return True


def has_positive_minors(matrix: Lists, before: int = 1) -> bool:
    """Return whether all principal minors are positive; `before` is the pivot eliminated last."""
    if not matrix:
        return True
    pivot = matrix[0][0]
    if pivot <= 0:
        return False
    is_first = has_positive_minors(_rest(matrix), before)
    return is_first and has_positive_minors(eliminated(matrix, before), pivot)


def eliminated(matrix: Lists, before: int) -> Lists:
    """Return the Schur complement of the first pivot times that pivot, all of it divided by the pivot before."""
    (pivot, *top), *rows = matrix
    return [
        [(pivot * entry - first * above) // before for entry, above in zip(row, top, strict=True)]
        for first, *row in rows
    ]


def _rest(matrix: Lists) -> Lists:
    return [row[1:] for row in matrix[1:]]


# --- Solutions ----------------------------------------------------------------------------


def modulo(A: IntegerRows) -> Integers:
    """Return A modulo the prime, shape (m, k)."""
    return np.array([[a % PRIME for a in row] for row in A], dtype=np.int64).reshape(len(A), -1)


def rank_profile(A: IntegerRows) -> tuple[list[int], list[int]]:
    """Return row and column indices of a largest nonsingular square block, first rows first (modulo a prime).

    The block is nonsingular for certain; that no larger block exists is only as good as the prime.

    Examples
    --------
    >>> rank_profile([[0, 0, 2], [0, 0, 4], [1, 0, 0]])
    ([0, 2], [2, 0])
    """
    work = modulo(A)
    return _reduce(work, work.shape[1])


def _reduce(work: Integers, k: int) -> tuple[list[int], list[int]]:
    """Reduce the rows in place by pivots in the first k columns; return the rows and the columns of the pivots."""
    rows, columns = [], []
    for i in range(work.shape[0]):
        nonzero = np.flatnonzero(work[i, :k])
        if not nonzero.size or deadline.is_over():
            continue
        j = int(nonzero[0])
        rows.append(i)
        columns.append(j)
        work[i] = work[i] * pow(int(work[i, j]), -1, PRIME) % PRIME
        factors = work[:, j].copy()
        factors[i] = 0
        touched = np.flatnonzero(factors)
        work[touched] = (work[touched] - factors[touched, None] * work[i]) % PRIME
    return rows, columns


def solve_exactly(A: IntegerRows, b: Sequence[int]) -> list[Fraction] | None:
    """Return the solution of A x = b in fractions, or None if A is singular (modulo a prime).

    The result is also None if the time limit of the run passes.

    Parameters
    ----------
    A : sequence of rows of integers, shape (k, k)
    b : sequence of integers, shape (k,)

    Notes
    -----
    One inverse modulo a prime p, then one digit of x in base p for two products with k × k matrices. The result is
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
    k = len(A)
    work = np.hstack([modulo(A), np.eye(k, dtype=np.int64)])
    _, columns = _reduce(work, k)
    return _lifted(A, b, work[np.argsort(columns), k:]) if len(columns) == k else None


def _lifted(A: IntegerRows, b: Sequence[int], inverse: Integers) -> Fractions | None:
    limbs = _limbs(A)
    residual = np.array([int(value) for value in b], dtype=object)
    x = np.zeros(len(A), dtype=object)
    modulus, digits, next_try = 1, 0, 4
    while not deadline.is_over():
        digit = inverse @ (residual % PRIME).astype(np.int64) % PRIME
        residual = (residual - _limb_product(limbs, digit)) // PRIME
        x += digit.astype(object) * modulus
        modulus *= PRIME
        digits += 1
        if digits == next_try:
            answer = _reconstructed(x, modulus)
            if answer is not None and all(
                sum(a * x for a, x in zip(row, answer[0], strict=True) if a) == answer[1] * value
                for row, value in zip(A, b, strict=True)
            ):
                return [Fraction(value, answer[1]) for value in answer[0]]
            next_try = digits + max(4, digits // 2)
    return None


def _limbs(A: IntegerRows) -> list[Integers]:
    """Return A in base 2^22, lowest first, so that products with digits below 2^25 add up in 64 bits."""
    longest = max((abs(a).bit_length() for row in A for a in row), default=0)
    shifts = range(0, max(longest, 1), LIMB)

    def limb(a: int, shift: int) -> int:
        return (abs(a) >> shift & (1 << LIMB) - 1) * (1 if a >= 0 else -1)

    return [np.array([[limb(a, shift) for a in row] for row in A], np.int64) for shift in shifts]


def _limb_product(limbs: list[Integers], digit: Integers) -> Any:
    total = (limbs[-1] @ digit).astype(object)
    for limb in reversed(limbs[:-1]):
        total = total * (1 << LIMB) + (limb @ digit)
    return total


def _reconstructed(x: Array, modulus: int) -> tuple[list[int], int] | None:
    """Return small numerators and one denominator that equal x modulo the modulus, if there are any."""
    bound = math.isqrt(modulus // 2)
    numerators: list[int] = []
    denominator = 1
    for value in x:
        residue = value * denominator % modulus
        residue = residue - modulus if 2 * residue > modulus else residue
        if abs(residue) > bound:
            residue, factor = _small_fraction(residue % modulus, modulus, bound)
            denominator *= factor
            if denominator > bound:
                return None
            numerators = [numerator * factor for numerator in numerators]
        numerators.append(residue)
    return numerators, denominator


def _small_fraction(value: int, modulus: int, bound: int) -> tuple[int, int]:
    """Return r, s with r ≡ s · value and |r| ≤ bound, by Euclid's algorithm stopped half-way."""
    r0, r1, s0, s1 = modulus, value, 0, 1
    while r1 > bound:
        quotient = r0 // r1
        r0, r1, s0, s1 = r1, r0 - quotient * r1, s1, s0 - quotient * s1
    return (r1, s1) if s1 > 0 else (-r1, -s1)


def solved_nearby(
    rows: list[Row], right: Fractions, guess: Fractions, is_movable: Sequence[bool]
) -> Fractions | None:
    """Return an exact solution y of rows · y = right near the guess; only movable entries change.

    Parameters
    ----------
    rows, right
        The equations; redundant ones are welcome.
    guess : list of Fraction
        Approximate solution.
    is_movable : sequence of bool
        Mask of the entries that may change.

    Returns
    -------
    list of Fraction or None
        None if the equations are inconsistent, or too many for exact arithmetic.

    Notes
    -----
    Equations that share no such entry are solved apart, each lot by p-adic lifting on a largest nonsingular block of
    the entries that may change, largest ones first.
    """
    gaps = [value - product for product, value in zip(products(rows, guess), right, strict=True)]
    if not any(gaps):
        return list(guess)
    movable = [{j: entry for j, entry in row.items() if is_movable[j]} for row in rows]
    if any(value and not row for row, value in zip(movable, gaps, strict=True)):
        return None
    solution = list(guess)
    for lot in independent_rows(movable):
        if any(gaps[i] for i in lot):
            change = _by_largest_block([movable[i] for i in lot], [gaps[i] for i in lot], guess)
            if change is None:
                return None
            for j, value in change.items():
                solution[j] += value
    return solution


def independent_rows(rows: list[Row]) -> list[list[int]]:
    """Return the numbers of the rows in lots that share no column with another; empty rows are in none.

    Examples
    --------
    >>> independent_rows([{0: 1}, {1: 1, 2: 1}, {}, {0: 2}])
    [[0, 3], [1]]
    """
    from scipy.sparse.csgraph import connected_components  # slow to import

    entry_rows = [i for i, row in enumerate(rows) for _ in row]
    columns = [len(rows) + j for row in rows for j in row]
    size = max([len(rows), *(j + 1 for j in columns)])
    graph = sp.coo_array((np.ones(len(entry_rows)), (entry_rows, columns)), shape=(size, size))
    labels = connected_components(graph, directed=False)[1]
    lots: dict[int, list[int]] = {}
    for i in dict.fromkeys(entry_rows):
        lots.setdefault(labels[i], []).append(i)
    return list(lots.values())


def integer_rows(rows: list[Row], place: Mapping[int, int]) -> tuple[Lists, list[int]]:
    """Return the rows as lists of integers, column j at its place, and their common denominators."""
    whole, denominators = [[0] * len(place) for _ in rows], list[int]()
    for entries, row in zip(whole, rows, strict=True):
        integral, denominator = common_denominator([*row.values()])
        denominators.append(denominator)
        for j, entry in zip(row, integral, strict=True):
            entries[place[j]] = entry
    return whole, denominators


def _by_largest_block(rows: list[Row], right: Fractions, guess: Fractions) -> Row | None:
    """Return the entries of a solution that are not 0: the unknowns of one nonsingular block."""
    columns = sorted({j for row in rows for j in row}, key=lambda j: (-abs(guess[j]), j))
    if min(len(rows), len(columns)) > MOST_UNKNOWNS or len(rows) * len(columns) > MOST_ENTRIES:
        return None
    place = {j: k for k, j in enumerate(columns)}
    common = math.lcm(*(value.denominator for value in right))
    whole, scales = integer_rows(rows, place)
    if deadline.is_over():
        return None
    at, chosen = rank_profile(whole)
    block = [[whole[i][k] for k in chosen] for i in at]
    longest = max((entry.bit_length() for row in block for entry in row), default=0)
    if len(at) * longest > 24_000:  # digits of a block's determinant, about: some seconds
        return None
    values = solve_exactly(block, [int(right[i] * scales[i] * common) for i in at])
    if values is None:
        return None
    solution = {columns[k]: value / common for k, value in zip(chosen, values, strict=True)}
    placed = [{place[j]: entry for j, entry in row.items()} for row in rows]
    sums = products(placed, [solution.get(j, ZERO) for j in columns])
    return solution if list(sums) == right else None


def sum_above(a: Array, b: Array) -> Vector:
    """Return a float64 ≥ a + b, equal to it if a + b is a float64."""
    total = np.add(a, b)
    part = total - a
    error = (a - (total - part)) + (b - part)  # NaN if something overflowed or was infinite
    return _choice(error <= 0.0, total, _above(total))


def product_above(a: Array, b: Array) -> Vector:
    """Return a float64 ≥ a b, and 0 if a or b is 0."""
    return _choice(np.equal(a, 0.0) | np.equal(b, 0.0), 0.0, _above(np.multiply(a, b)))


def quotient_above(a: Vector, b: Array) -> Vector:
    """Return a float64 ≥ a/b for b > 0, and 0 if a is 0."""
    return _choice(np.equal(a, 0.0), 0.0, _above(np.divide(a, b)))


def _above(value: Vector) -> Vector:
    """Return a float64 above the value, by one or two steps; the least finite number for −∞."""
    # In [1, 2) ulps; the product underflows only if TINY is the ulp.
    return _choice(value < -LARGEST, -LARGEST, value + np.maximum(np.abs(value) * EPSILON, TINY))


def _choice(condition: BoolVector, yes: Array, no: Vector) -> Vector:
    """Return ``numpy.where(condition, yes, no)``, a number of numbers."""
    return np.where(condition, yes, no)[()]
