"""Linear systems of small quadratic programs: (M + diag) z = r with M = [[P, Cᵀ], [−C, 0]], dense.

The multipliers with a large diagonal entry go first, and leave Σ c_i c_iᵀ ÷ entry among x; the others stay beside x.
LDLᵀ of that quasidefinite matrix, a little regularised, refined against the system itself. Rows of `vectors` are those
of :mod:`.interior_steps`, and three more.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ....core.kernels.compilation import compiled_for_rows, compiled_into_others, compiled_part
from ....methods.interior.kernels.interior_steps import DIAGONAL, FOUND, RIGHT, ROWS
from .row_operations import add_row, copy_row, row_times, subtract_four

# What is left to be solved for, what a solve adds, scale factors.
SPARE, MORE, UNIT, SYSTEM_ROWS = ROWS, ROWS + 1, ROWS + 2, ROWS + 3
REGULARISED, WEIGHTS, SYSTEM_FACTS = 9, 10, 14  # entries of `facts` behind those of the steps; four weights

RUIZ_PASSES = 6
REGULARISATION, LARGEST_REGULARISATION = 1e-9, 1e-5
KEPT_BELOW = 1e-4  # a multiplier with such a diagonal entry is no pivot
PINNED = 1e30  # a diagonal that leaves nothing of an unknown
PASSES = 5  # solves with one factor
LARGEST = 1e300


@compiled_part
def product(P, C, vectors, source, target):  # type: ignore[no-untyped-def]
    """Write M times one row of `vectors` into another, M = [[P, Cᵀ], [−C, 0]]."""
    m, n = C.shape
    for i in range(n):
        vectors[target, i] = row_times(P, i, 0, n, vectors, source)
    for i in range(m):
        vectors[target, n + i] = -row_times(C, i, 0, n, vectors, source)
        add_row(C, i, 0, n, vectors[source, n + i], vectors, target)


@compiled_part
def equilibrate(P, C, at_P, at_C, vectors, P_scaled, C_scaled):  # type: ignore[no-untyped-def]
    """Fill UNIT with powers of two that bring rows and columns of [[P, Cᵀ], [C, 0]] to even size; scale copies."""
    m, n = C_scaled.shape
    for i in range(n + m):
        vectors[UNIT, i] = 1.0
    for _ in range(RUIZ_PASSES):
        for i in range(n + m):
            vectors[SPARE, i] = 0.0
        for i in range(n):
            _enlarge(P, at_P, i, vectors[UNIT, i], vectors, i)
        for i in range(m):
            _enlarge(C, at_C, i, vectors[UNIT, n + i], vectors, n + i)
        largest = 0.0
        for i in range(n + m):
            size = vectors[SPARE, i]
            if size > 0.0:
                vectors[UNIT, i] /= np.sqrt(size)
                largest = max(largest, size, 1.0 / size)
        if largest < 2.0:
            break
    for i in range(n + m):
        vectors[UNIT, i] = 2.0 ** np.rint(np.log2(vectors[UNIT, i]))
    for i in range(n):
        _scale(P, at_P, i, vectors[UNIT, i], vectors, P_scaled)
    for i in range(m):
        _scale(C, at_C, i, vectors[UNIT, n + i], vectors, C_scaled)


def _scale_at_once(matrix: Any, k: int, i: int, factor: Any, vectors: Any, scaled: Any) -> None:
    scaled[i] = matrix[k, i] * (factor * vectors[UNIT, : scaled.shape[1]])


@compiled_for_rows(_scale_at_once)
def _scale(matrix, k, i, factor, vectors, scaled):  # type: ignore[no-untyped-def]
    """Fill row i of the scaled matrix."""
    for j in range(scaled.shape[1]):
        scaled[i, j] = matrix[k, i, j] * (factor * vectors[UNIT, j])


def _enlarge_at_once(matrix: Any, k: int, i: int, factor: Any, vectors: Any, row: int) -> None:
    n = matrix.shape[2]
    sizes = np.abs(matrix[k, i]) * factor * vectors[UNIT, :n]
    np.maximum(vectors[SPARE, :n], sizes, out=vectors[SPARE, :n])
    vectors[SPARE, row] = max(vectors[SPARE, row], sizes.max(initial=0.0))


@compiled_for_rows(_enlarge_at_once)
def _enlarge(matrix, k, i, factor, vectors, row):  # type: ignore[no-untyped-def]
    """Let SPARE be no less than the scaled entries of row i in their columns, and in place `row` than all of them."""
    largest = 0.0
    for j in range(matrix.shape[2]):
        size = abs(matrix[k, i, j]) * factor * vectors[UNIT, j]
        vectors[SPARE, j] = max(vectors[SPARE, j], size)
        largest = max(largest, size)
    vectors[SPARE, row] = max(vectors[SPARE, row], largest)


@compiled_part
def factorise(P, C, vectors, facts, matrix, room):  # type: ignore[no-untyped-def]
    """Factorise M + diag(DIAGONAL), regularised; return how many multipliers were kept, −1 where nothing helps."""
    facts[REGULARISED] = REGULARISATION
    while facts[REGULARISED] <= LARGEST_REGULARISATION:
        kept = _assemble(P, C, vectors, facts, matrix, room)
        if _eliminate(matrix, room, C.shape[1], C.shape[1] + kept):
            return kept
        facts[REGULARISED] *= 100.0
    return -1


@compiled_part
def _assemble(P, C, vectors, facts, matrix, room):  # type: ignore[no-untyped-def]
    """Fill the upper triangle of the system that is left without the multipliers that can go; return how many stay."""
    m, n = C.shape
    kept, going, regularisation = 0, 0, facts[REGULARISED]
    for i in range(n):
        copy_row(P, i, i, n, matrix, i)
        matrix[i, i] += vectors[DIAGONAL, i] + regularisation
    for i in range(m):
        pivot = vectors[DIAGONAL, n + i] + regularisation
        if pivot < KEPT_BELOW:
            for j in range(n + kept):
                matrix[j, n + kept] = C[i, j] if j < n else 0.0
            matrix[n + kept, n + kept] = -pivot
            kept += 1
        elif pivot < PINNED:
            facts[WEIGHTS + going] = 1.0 / pivot
            copy_row(C, i, 0, n, room, going)
            going += 1
            if going == 4:
                _add(n, facts, room, matrix)
                going = 0
    if going:
        for k in range(going, 4):
            facts[WEIGHTS + k] = 0.0
        _add(n, facts, room, matrix)
    return kept


@compiled_into_others
def _add(n, facts, room, matrix):  # type: ignore[no-untyped-def]
    """Add what four rows of C, in `room`, leave among x with their weights."""
    for i in range(n):
        e, f = facts[WEIGHTS] * room[0, i], facts[WEIGHTS + 1] * room[1, i]
        g, h = facts[WEIGHTS + 2] * room[2, i], facts[WEIGHTS + 3] * room[3, i]
        if e != 0.0 or f != 0.0 or g != 0.0 or h != 0.0:
            subtract_four(matrix, i, n, room, -e, -f, -g, -h)


@compiled_part
def _eliminate(matrix, room, positive, size):  # type: ignore[no-untyped-def]
    """Eliminate without pivoting, on and above the diagonal; return whether the pivots have the signs they should."""
    for start in range(0, size, 4):
        end = min(start + 4, size)
        for p in range(start, end):
            pivot = matrix[p, p]
            if not (pivot > 0.0 if p < positive else pivot < 0.0) or not abs(pivot) < LARGEST:
                return False
            for i in range(p + 1, end):
                add_row(matrix, p, i, size, -matrix[p, i] / pivot, matrix, i)
        if end < size:
            for k in range(4):
                copy_row(matrix, start + k, end, size, room, k)
            a, b = 1.0 / matrix[start, start], 1.0 / matrix[start + 1, start + 1]
            c, d = 1.0 / matrix[start + 2, start + 2], 1.0 / matrix[start + 3, start + 3]
            for i in range(end, size):
                subtract_four(matrix, i, size, room, a * room[0, i], b * room[1, i], c * room[2, i], d * room[3, i])
    return True


@compiled_part
def solve(P, C, vectors, facts, matrix, kept, refined):  # type: ignore[no-untyped-def]
    """Write the solution for RIGHT into FOUND, refined as long as that gains anything."""
    m, n = C.shape
    size, error = 0.0, np.inf
    for i in range(n + m):
        vectors[FOUND, i], vectors[SPARE, i] = 0.0, vectors[RIGHT, i]
        size = max(size, abs(vectors[RIGHT, i]))
    for _ in range(PASSES):
        _apply(C, vectors, facts[REGULARISED], matrix, n, m, n + kept)
        product(P, C, vectors, FOUND, SPARE)
        smaller = 0.0
        for i in range(n + m):
            left = vectors[RIGHT, i] - vectors[SPARE, i] - vectors[DIAGONAL, i] * vectors[FOUND, i]
            vectors[SPARE, i] = left
            smaller = max(smaller, abs(left))
        if smaller <= refined * size:
            return
        if not smaller < 0.5 * error:
            if smaller > error:  # the last correction did harm
                for i in range(n + m):
                    vectors[FOUND, i] -= vectors[MORE, i]
            return
        error = smaller


@compiled_part
def _apply(C, vectors, regularisation, matrix, n, m, size):  # type: ignore[no-untyped-def]
    """Add the factor's answer to SPARE to FOUND; MORE is what was added."""
    kept = 0
    for i in range(n):
        vectors[MORE, i] = vectors[SPARE, i]
    for i in range(m):
        pivot = vectors[DIAGONAL, n + i] + regularisation
        if pivot < KEPT_BELOW:
            vectors[MORE, n + kept] = -vectors[SPARE, n + i]
            kept += 1
        elif pivot < PINNED:
            share = vectors[SPARE, n + i] / pivot
            add_row(C, i, 0, n, -share, vectors, MORE)
    for p in range(size):
        share = vectors[MORE, p] / matrix[p, p]
        if share != 0.0:
            add_row(matrix, p, p + 1, size, -share, vectors, MORE)
    for p in range(size - 1, -1, -1):
        vectors[MORE, p] = (vectors[MORE, p] - row_times(matrix, p, p + 1, size, vectors, MORE)) / matrix[p, p]
    for i in range(m - 1, -1, -1):
        pivot = vectors[DIAGONAL, n + i] + regularisation
        if pivot < KEPT_BELOW:
            kept -= 1
            vectors[MORE, n + i] = vectors[MORE, n + kept]
        elif pivot < PINNED:
            vectors[MORE, n + i] = (vectors[SPARE, n + i] + row_times(C, i, 0, n, vectors, MORE)) / pivot
        else:
            vectors[MORE, n + i] = 0.0
    for i in range(n + m):
        vectors[FOUND, i] += vectors[MORE, i]
