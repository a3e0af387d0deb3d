"""Complementary pivoting on 0 ≤ z ≤ u: compiled steps along the path of w = M z + q + t r; they know arrays only.

Exactly one of z_i, w_i is basic for every row i but the *driven* one; `side[i]` says where z_i stands: AT_LOWER
(w_i ≥ 0 basic), BETWEEN (z_i basic), AT_UPPER (w_i ≤ 0 basic). Variables are numbered z_i = i, w_i = n + i, t = 2n.
The basis matrix B has columns −M_i, e_i, −r; its inverse is kept dense, `inverse[j]` being its
column j. q is thought of as q + (ε, ε², …) for a tiny ε,
so that row p of B⁻¹ settles every tie in the ratio test and no basis can come twice (Eaves' lexicographic rule).

Every number carries an estimate of its rounding, and a pivot or a tie is judged against that, not against a
fixed tolerance: the entries of an exponential-pivot matrix span more than any fixed one.
"""

from __future__ import annotations

import numpy as np

from .compilation import compiled
from .desk import AT_LOWER, AT_UPPER, BETWEEN

GOING_ON, SOLVED, RAY, LOST, RETURNED = 0, 1, 2, 3, 4

NOISE = 2.0**-41  # rounding of a number, relative to the terms that made it, after a few dozen pivots
CANCELLED = 2.0**-44  # what is left of a difference of equals is taken for 0
TIE = 1e-10
DOUBTFUL = 1e-7  # a pivot so much smaller than its terms is taken with a new inverse only
OWN_BOUND, NO_ROW = -2, -1


@compiled
def apply_inverse(inverse, place, column, image, magnitude):  # type: ignore[no-untyped-def]
    """Write B⁻¹ a into `image` and |B⁻¹||a| into `magnitude`; return the entries touched.

    Where w_j is basic, in row place[j], column j of B⁻¹ is a unit vector.
    """
    n = column.size
    image[:] = 0.0
    magnitude[:] = 0.0
    touched = n
    for j in range(n):
        a = column[j]
        if a == 0.0:
            continue
        if place[j] >= 0:
            image[place[j]] += a
            magnitude[place[j]] += abs(a)
            continue
        for p in range(n):
            term = a * inverse[j, p]
            image[p] += term
            magnitude[p] += abs(term)
        touched += n
    return touched


@compiled
def replace_column(inverse, place, image, row):  # type: ignore[no-untyped-def]
    """Update B⁻¹ after the column whose image is given took the place of basis column `row`; return entries touched."""
    n = image.size
    touched = n
    for j in range(n):
        if place[j] >= 0 or inverse[j, row] == 0.0:
            continue
        factor = inverse[j, row] / image[row]
        for p in range(n):
            old = inverse[j, p]
            new = old - factor * image[p]
            inverse[j, p] = new if abs(new) > CANCELLED * abs(old) else 0.0
        inverse[j, row] = factor
        touched += n
    return touched


@compiled
def room(variable, value, is_falling, side, upper):  # type: ignore[no-untyped-def]
    """Return how far a basic variable can move in its direction before it reaches a bound."""
    n = upper.size
    if variable < n:
        return max(value, 0.0) if is_falling else max(upper[variable] - value, 0.0)
    if variable < 2 * n and side[variable - n] == AT_UPPER:
        return np.inf if is_falling else max(-value, 0.0)
    return max(value, 0.0) if is_falling else np.inf


@compiled
def lexicographic_minimum(inverse, slope, candidates, count):  # type: ignore[no-untyped-def]
    """Return the candidate row whose row of B⁻¹, divided by its slope, is lexicographically smallest.

    The bound of the driven variable itself takes part with a row of zeros.
    """
    n = slope.size
    scale = 0.0
    for c in range(count):
        p = candidates[c]
        if p >= 0:
            for j in range(n):
                scale = max(scale, abs(inverse[j, p] / slope[p]))
    for j in range(n):
        if count == 1:
            break
        smallest = np.inf
        for c in range(count):
            p = candidates[c]
            smallest = min(smallest, inverse[j, p] / slope[p] if p >= 0 else 0.0)
        kept = 0
        for c in range(count):
            p = candidates[c]
            if (inverse[j, p] / slope[p] if p >= 0 else 0.0) <= smallest + TIE * scale:
                candidates[kept] = p
                kept += 1
        count = kept
    best = candidates[0]
    for c in range(1, count):
        p = candidates[c]
        if best >= 0 and p >= 0 and abs(slope[p]) > abs(slope[best]):
            best = p
    return best


@compiled
def ratio_test(  # type: ignore[no-untyped-def]
    basis, side, upper, values, noise, inverse, slope, magnitude, own_room, is_last, candidates
):
    """Return (row that blocks the driven variable, distance); the row is OWN_BOUND or NO_ROW where none does.

    A distance of NaN says that numbers have overflowed.
    """
    n = slope.size
    farthest = own_room
    for p in range(n):
        if abs(slope[p]) > NOISE * magnitude[p]:
            free = room(basis[p], values[p], slope[p] > 0.0, side, upper)
            farthest = min(farthest, (free + noise[p]) / abs(slope[p]))
    if farthest == np.inf:
        return NO_ROW, farthest
    if is_last and own_room <= farthest:
        return OWN_BOUND, own_room
    count = 0
    for p in range(n):
        if abs(slope[p]) > NOISE * magnitude[p]:
            free = room(basis[p], values[p], slope[p] > 0.0, side, upper)
            if free / abs(slope[p]) <= farthest:
                if basis[p] == 2 * n:  # t = 0 ends the path, whatever else happens there
                    return p, free / abs(slope[p])
                candidates[count] = p
                count += 1
    if own_room <= farthest:
        candidates[count] = OWN_BOUND
        count += 1
    if count == 0:  # NaN compares with nothing
        return NO_ROW, np.nan
    row = lexicographic_minimum(inverse, slope, candidates, count)
    if row == OWN_BOUND:
        return row, own_room
    return row, room(basis[row], values[row], slope[row] > 0.0, side, upper) / abs(slope[row])


@compiled
def next_driven(variable, is_falling, side, n):  # type: ignore[no-untyped-def]
    """Note that a variable left the basis; return its complement and the direction in which that one moves."""
    if variable >= n:  # w_i reached 0: z_i leaves the bound it stands at
        return variable - n, 1.0 if side[variable - n] == AT_LOWER else -1.0
    side[variable] = AT_LOWER if is_falling else AT_UPPER
    return n + variable, 1.0 if is_falling else -1.0


@compiled
def has_returned(driven, direction, side, start_side):  # type: ignore[no-untyped-def]
    """Return whether the cell just entered is the one where the path began."""
    n = side.size
    i = driven % n
    for j in range(n):
        if j != i and side[j] != start_side[j]:
            return False
    entered = BETWEEN if driven < n else AT_LOWER if direction > 0.0 else AT_UPPER
    return entered == start_side[i]


@compiled
def driven_column(columns, covering, driven, column):  # type: ignore[no-untyped-def]
    """Write the column of the driven variable in w − M z − t r = q."""
    n = covering.size
    if driven == 2 * n:
        column[:] = -covering
    elif driven < n:
        column[:] = -columns[driven]
    else:
        column[:] = 0.0
        column[driven - n] = 1.0


@compiled
def exchange(  # type: ignore[no-untyped-def]
    basis, place, side, upper, values, noise, inverse, row, driven, direction, distance, level
):
    """Put the driven variable into the basis in the given row, with the value that it has reached."""
    n = upper.size
    leaving = basis[row]
    basis[row] = driven
    if driven == 2 * n:
        values[row] = level - distance
    elif driven < n:
        values[row] = distance if direction > 0.0 else upper[driven] - distance
        side[driven] = BETWEEN
    else:
        i = driven - n
        values[row] = direction * distance
        place[i] = row
        inverse[i] = 0.0
        inverse[i, row] = 1.0
        side[i] = AT_LOWER if direction > 0.0 else AT_UPPER
    noise[row] = NOISE * abs(values[row])
    return leaving


@compiled
def pivots(  # type: ignore[no-untyped-def]
    columns, covering, upper, basis, place, side, start_side, values, noise, inverse, driven, direction, level,
    is_fresh, limit,
):
    """Make up to `limit` pivots; return (outcome, driven variable, its direction, pivots made, entries touched).

    `columns` holds the columns of M as rows, `level` the value of t while it is not basic; `is_fresh` says that B⁻¹
    has just been computed, and then a first pivot is taken however small it is.
    """
    n = upper.size
    column, slope, magnitude = np.zeros(n), np.zeros(n), np.zeros(n)
    candidates = np.empty(n + 1, dtype=np.int64)
    touched = 0
    for count in range(limit):
        own_room = level if driven == 2 * n else upper[driven] if driven < n else np.inf
        driven_column(columns, covering, driven, column)
        touched += apply_inverse(inverse, place, column, slope, magnitude)
        slope *= direction
        row, distance = ratio_test(
            basis, side, upper, values, noise, inverse, slope, magnitude, own_room, driven == 2 * n, candidates
        )
        if row == NO_ROW:
            return LOST if np.isnan(distance) else RAY, driven, direction, count, touched
        if row >= 0 and abs(slope[row]) < DOUBTFUL * magnitude[row] and not (is_fresh and count == 0):
            return LOST, driven, direction, count, touched
        for p in range(n):
            moved = distance * slope[p]
            noise[p] = max(noise[p], NOISE * max(abs(values[p]), abs(moved)))
            values[p] -= moved
        if row == OWN_BOUND:
            if driven == 2 * n:
                return SOLVED, driven, direction, count + 1, touched
            side[driven] = AT_UPPER if direction > 0.0 else AT_LOWER
            driven += n
            direction = -direction
            continue
        is_falling = slope[row] > 0.0
        slope *= direction
        if n <= basis[row] < 2 * n:
            place[basis[row] - n] = -1
        touched += replace_column(inverse, place, slope, row)
        leaving = exchange(
            basis, place, side, upper, values, noise, inverse, row, driven, direction, distance, level
        )
        if leaving == 2 * n:
            return SOLVED, driven, direction, count + 1, touched
        driven, direction = next_driven(leaving, is_falling, side, n)
        if has_returned(driven, direction, side, start_side):
            return RETURNED, driven, direction, count + 1, touched
    return GOING_ON, driven, direction, limit, touched
