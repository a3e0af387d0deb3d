"""Exact rational arithmetic on a few sparse rows: products, and the exact solution near an approximate one."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from fractions import Fraction
from typing import Any

import numpy as np
import scipy.sparse as sp

from ..checks import FloatVector
from .integers import common_denominator
from .linear_systems import rank_profile, solve_exactly

Row = dict[int, Fraction]
Vector = list[Fraction]

ZERO = Fraction(0)
FEW_ENTRIES = 120  # up to which plain elimination is quicker
MOST_UNKNOWNS = 600
MOST_ENTRIES = 4_000_000
MOST_BITS = 24_000  # digits of a block's determinant, about: some seconds


def rational(values: Iterable[float]) -> Vector:
    """Return finite doubles as the rationals that they are."""
    return [Fraction(float(value)) for value in values]


def rational_rows(matrix: Any) -> list[Row]:
    """Return the rows of an array or sparse array as dictionaries column → entry."""
    rows = sp.csr_array(matrix)
    columns, entries, pointer = rows.indices.tolist(), rows.data.tolist(), rows.indptr.tolist()
    return [
        {columns[k]: Fraction(entries[k]) for k in range(pointer[i], pointer[i + 1]) if entries[k]}
        for i in range(rows.shape[0])
    ]


def products(rows: Sequence[Row], vector: Sequence[Fraction]) -> Iterator[Fraction]:
    """Yield Σ_j row_j vector_j of each row; in integers, as fractions would look for common divisors at every term."""
    numerators, denominator = common_denominator(vector)
    for row in rows:
        used = [(entry, numerators[j]) for j, entry in row.items() if numerators[j]]
        common = math.lcm(*(entry.denominator for entry, _ in used))
        total = sum(entry.numerator * (common // entry.denominator) * factor for entry, factor in used)
        yield Fraction(total, common * denominator) if total else ZERO


def transposed_product(rows: list[Row], vector: Sequence[Fraction], columns: int) -> Vector:
    """Return rowsᵀ vector, of length `columns`."""
    numerators, denominator = common_denominator(vector)
    used = [(row, factor) for row, factor in zip(rows, numerators, strict=True) if factor]
    common = math.lcm(*{entry.denominator for row, _ in used for entry in row.values()})
    total = [0] * columns
    for row, factor in used:
        for j, entry in row.items():
            total[j] += factor * entry.numerator * (common // entry.denominator)
    return [Fraction(value, common * denominator) if value else ZERO for value in total]


def short(values: FloatVector, denominator: int = 1 << 30) -> Vector:
    """Return values near the given ones, exact and with few digits; zeros stay zeros."""
    largest = float(np.abs(values).max(initial=0.0))
    if largest == 0.0 or not np.isfinite(largest):
        return [ZERO] * values.size
    unit = Fraction(2) ** int(np.floor(np.log2(largest))) / denominator
    return [round(Fraction(value) / unit) * unit for value in values.tolist()]


def solved_nearby(rows: list[Row], right: Vector, guess: Vector, is_movable: Sequence[bool]) -> Vector | None:
    """Return an exact solution y of rows · y = right near the guess, changed only where it may and has to be.

    Parameters
    ----------
    rows, right
        The equations; redundant ones are welcome.
    guess : list of Fraction
        Near a solution.
    is_movable : sequence of bool
        Which entries may change at all.

    Returns
    -------
    list of Fraction or None
        None where the equations contradict one another, or are too many for exact arithmetic.

    Notes
    -----
    Small systems by Gaussian elimination in fractions, larger ones by p-adic lifting on a largest nonsingular block.
    """
    rest = [value - product for product, value in zip(products(rows, guess), right, strict=True)]
    if not any(rest):
        return list(guess)
    movable = [{j: entry for j, entry in row.items() if is_movable[j]} for row in rows]
    if any(value and not row for row, value in zip(movable, rest, strict=True)):
        return None
    used = [i for i, row in enumerate(movable) if row]
    system, missing = [movable[i] for i in used], [rest[i] for i in used]
    unknowns = sum(1 for row in system for _ in row)
    change = _eliminated(system, missing) if unknowns <= FEW_ENTRIES else _lifted(system, missing, guess)
    if change is None:
        return None
    solution = list(guess)
    for j, value in change.items():
        solution[j] += value
    return solution


def _eliminated(rows: list[Row], right: Vector) -> Row | None:
    """Return the entries of a solution that are not 0: elimination, short rows first, largest entries as pivots."""
    pivots: list[tuple[int, Row, Fraction]] = []
    where: dict[int, int] = {}
    for index in sorted(range(len(rows)), key=lambda i: len(rows[i])):
        row, value = dict(rows[index]), right[index]
        # Of the pivots in a row, the earliest goes first: it can only bring in later ones.
        while known := [where[j] for j in row if j in where]:
            column, pivot_row, pivot_value = pivots[min(known)]
            factor = row.pop(column)
            value -= factor * pivot_value
            for j, entry in pivot_row.items():
                changed = row.get(j, ZERO) - factor * entry
                if changed:
                    row[j] = changed
                else:
                    row.pop(j, None)
        if not row:
            if value:
                return None
            continue
        column = max(row, key=lambda j: (abs(row[j]), -j))
        pivot = row.pop(column)
        where[column] = len(pivots)
        pivots.append((column, {j: entry / pivot for j, entry in row.items()}, value / pivot))
    solution: Row = {}
    for column, row, value in reversed(pivots):
        solution[column] = value - sum((entry * solution[j] for j, entry in row.items() if j in solution), ZERO)
    return solution


def _lifted(rows: list[Row], right: Vector, guess: Vector) -> Row | None:
    """Return the entries of a solution that are not 0: the unknowns of one nonsingular block."""
    columns = sorted({j for row in rows for j in row}, key=lambda j: (-abs(guess[j]), j))
    if min(len(rows), len(columns)) > MOST_UNKNOWNS or len(rows) * len(columns) > MOST_ENTRIES:
        return None
    place = {j: k for k, j in enumerate(columns)}
    whole, common = [], math.lcm(*(value.denominator for value in right))
    scales = [math.lcm(*(entry.denominator for entry in row.values())) for row in rows]
    for row, scale in zip(rows, scales, strict=True):
        integers = [0] * len(columns)
        for j, entry in row.items():
            integers[place[j]] = int(entry * scale)
        whole.append(integers)
    at, chosen = rank_profile(whole)
    longest = max((abs(whole[i][k]).bit_length() for i in at for k in chosen), default=0)
    if len(at) * longest > MOST_BITS:
        return None
    block = [[whole[i][k] for k in chosen] for i in at]
    values = solve_exactly(block, [int(right[i] * scales[i] * common) for i in at])
    if values is None:
        return None
    solution = {columns[k]: value / common for k, value in zip(chosen, values, strict=True)}
    whole_vector = [solution.get(j, ZERO) for j in range(len(guess))]
    return solution if list(products(rows, whole_vector)) == right else None
