"""How large the numbers of programs are, in log2: compiled loops over entries and vectors; arrays only.

Exponents are those of floor(log2 |value|), whole numbers: sums of them are exact in any order.
"""

from __future__ import annotations

import math

import numpy as np

from ....core.kernels.compilation import inlined, kernel

LIMITS, COSTS, BOUNDS = 1, 2, 3  # who may say how large unknowns are, beside
ACTING = 0  # those limits and bounds that x = 0 violates
ROUNDING = -44.0  # log2: limits so small beside the largest one, or beside 1, are rounding
NOISE = 2.0**-30  # of the largest cost: smaller ones are rounding in the place of zeros
NEVER = 2000.0  # beyond any exponent


@kernel
def mean_exponents(indptr, indices, data, is_full, means, largest, columns):  # type: ignore[no-untyped-def]
    """Write the mean exponent of each row, NaN of an empty one, and its largest |entry|.

    To `columns`, zeros of shape (count, 2, n), is added what the exponents in each column are above the means of their
    rows, in sum, and how many they are. `data` has shape (count, entries); where the matrices are full, the columns of
    one row stand for those of all.
    """
    for k in range(data.shape[0]):
        for i in range(indptr.size - 1):
            begin, total, count, most = indptr[i], 0.0, 0.0, 0.0
            for e in range(begin, indptr[i + 1]):
                mantissa, exponent = math.frexp(data[k, e])
                if mantissa != 0.0:
                    total += exponent - 1.0
                    count += 1.0
                most = max(most, abs(data[k, e]))
            means[k, i], largest[k, i] = total / count if count > 0.0 else np.nan, most
            for e in range(begin, indptr[i + 1]):
                mantissa, exponent = math.frexp(data[k, e])
                if mantissa != 0.0:
                    j = indices[e - begin if is_full else e]
                    columns[k, 0, j] += exponent - 1.0 - means[k, i]
                    columns[k, 1, j] += 1.0


@inlined
def _part(place, k, m, n, of_rows, of_hessian, is_equality, limits, c, lower, upper):  # type: ignore[no-untyped-def]
    """Return what stands in this place of limits, costs and bounds: its size, NaN where it says nothing, and its kind.

    And whether it acts: x = 0 violates it.
    """
    if place < m:
        value, beside, kind = limits[k, place], of_rows[min(k, of_rows.shape[0] - 1), place], LIMITS
        acts = value < 0.0 or is_equality[place]
    elif place < m + n:
        value, beside, kind = c[k, place - m], of_hessian[min(k, of_hessian.shape[0] - 1), place - m], COSTS
        acts = False
    elif place < m + 2 * n:
        value, beside, kind = lower[k, place - m - n], 0.0, BOUNDS
        acts = value > 0.0
    else:
        value, beside, kind = upper[k, place - m - 2 * n], 0.0, BOUNDS
        acts = value < 0.0
    if value == 0.0 or not abs(value) < np.inf:
        return np.nan, kind, acts
    return math.frexp(value)[1] - 1.0 - beside, kind, acts


@kernel
def sizes_of_unknowns(  # type: ignore[no-untyped-def]
    of_rows, of_hessian, is_equality, limits, c, lower, upper, sizes, say
):
    """Write how large unknowns are, on average, ∞ where nothing says so, and which limits, costs, and bounds do.

    Equations do, and limits and bounds that x = 0 violates. Where there are none, minima of the rows of P, or what
    rows permit, or else bounds: whatever is smallest, as a bound of 1e9 is one that nobody reaches.

    Parameters
    ----------
    of_rows, of_hessian
        The mean exponent of each row of [G; A] and of P, shapes (1 or count, m) and (1 or count, n); NaN of an empty
        one.
    is_equality, limits, c, lower, upper
        Shapes (m,), (count, m), and (count, n).
    sizes, say
        Shapes (count,) and (count, m + 3n): written.
    """
    m, n = limits.shape[1], c.shape[1]
    sums, counts = np.empty(4), np.empty(4)
    for k in range(c.shape[0]):
        largest = 0.0
        for place in range(m + 3 * n):
            size, kind, _acts = _part(place, k, m, n, of_rows, of_hessian, is_equality, limits, c, lower, upper)
            if kind != COSTS and size > largest:
                largest = size
        sums[:] = 0.0
        counts[:] = 0.0
        for place in range(m + 3 * n):
            size, kind, acts = _part(place, k, m, n, of_rows, of_hessian, is_equality, limits, c, lower, upper)
            if size >= ROUNDING + largest:
                sums[kind] += size
                counts[kind] += 1.0
                if acts:
                    sums[ACTING] += size
                    counts[ACTING] += 1.0
        for kind in range(4):
            sums[kind] = sums[kind] / counts[kind] if counts[kind] > 0.0 else np.inf
        permitted = LIMITS if sums[LIMITS] < np.inf else BOUNDS
        chosen = ACTING if sums[ACTING] < np.inf else COSTS if sums[COSTS] <= sums[permitted] else permitted
        sizes[k] = sums[chosen]
        for place in range(m + 3 * n):
            size, kind, acts = _part(place, k, m, n, of_rows, of_hessian, is_equality, limits, c, lower, upper)
            say[k, place] = size >= ROUNDING + largest and (acts if chosen == ACTING else kind == chosen)


@inlined
def _mean_and_least(values, k):  # type: ignore[no-untyped-def]
    """Return the mean, rounded down, and the smallest exponent of a row, without noise; NEVER where all are 0."""
    largest = 0.0
    for j in range(values.shape[1]):
        largest = max(largest, abs(values[k, j]))
    total, count, least = 0.0, 0.0, NEVER
    for j in range(values.shape[1]):
        size = abs(values[k, j])
        if size > 0.0 and size >= NOISE * largest:
            exponent = math.frexp(size)[1] - 1.0
            total += exponent
            count += 1.0
            least = min(least, exponent)
    return np.floor(total / count) if count > 0.0 else NEVER, least


@kernel
def objective_exponents(c, diagonal, exponents):  # type: ignore[no-untyped-def]
    """Write what most |c_j| are near, or most p_jj if these are larger, and the smallest |c_j|; 0 where all are 0.

    `diagonal` has shape (1 or count, n).
    """
    for k in range(c.shape[0]):
        middle, least = _mean_and_least(c, k)
        of_P, least_of_P = _mean_and_least(diagonal, min(k, diagonal.shape[0] - 1))
        if middle == NEVER:
            middle, least = of_P, least_of_P
        elif of_P != NEVER:
            middle = max(middle, of_P)
        exponents[k, 0] = middle if middle != NEVER else 0.0
        exponents[k, 1] = least if least != NEVER else 0.0
