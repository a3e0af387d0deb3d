"""The dense linear system of a guessed active set, solved in place; arrays as in :mod:`.workspace`."""

from __future__ import annotations

import numpy as np

from ....core.kernels.compilation import helper, inlined
from .workspace import AT_UPPER, BETWEEN, FOUND, FREE, LOWER, SCALE, SIDE, UPPER, Q

CANCELLED = 2.0**-50  # a pivot so small beside what it was made from is rounding
LARGEST = 1e290


@helper
def solve_free(M, k, real, whole, matrix, is_symmetric):  # type: ignore[no-untyped-def]
    """Write FOUND with every variable at its bound where SIDE says so, and w_i = 0 on the other rows.

    Returns the number of those, or −1 where their block is singular to working precision: FOUND is what it was then.
    """
    n, free = M.shape[1], np.int64(0)
    for i in range(n):
        if whole[SIDE, i] == BETWEEN:
            whole[FREE, free] = i
            free += 1
    is_solved = False
    for attempt in range(0 if is_symmetric else 1, 2):
        if is_solved:
            break
        for p in range(free):  # a symmetric block stays as it is; rows of another are divided by their SCALE
            i = whole[FREE, p]
            unit, total = 1.0 if attempt == 0 else real[SCALE, i], -real[Q, i]
            for j in range(free):
                matrix[p, j] = M[k, i, whole[FREE, j]] / unit
            for j in range(n):
                bound = real[UPPER if whole[SIDE, j] == AT_UPPER else LOWER, j] if whole[SIDE, j] != BETWEEN else 0.0
                if bound != 0.0:
                    total -= M[k, i, j] * bound
            matrix[p, free] = total / unit
        is_solved = _eliminate_symmetric(matrix, n, free) if attempt == 0 else eliminate(matrix, n, free)
    if not is_solved:
        return -1
    substitute(matrix, free)
    for p in range(free):
        if not abs(matrix[p, free]) < LARGEST:
            return -1
    for i in range(n):
        real[FOUND, i] = real[UPPER if whole[SIDE, i] == AT_UPPER else LOWER, i]
    for p in range(free):
        real[FOUND, whole[FREE, p]] = matrix[p, free]
    return free


@helper
def substitute(matrix, free):  # type: ignore[no-untyped-def]
    """Solve with what elimination left on and above the diagonal; the right-hand side is column `free`."""
    for p in range(free - 1, -1, -1):
        total = matrix[p, free]
        for j in range(p + 1, free):
            total -= matrix[p, j] * matrix[j, free]
        matrix[p, free] = total / matrix[p, p]


@inlined
def _eliminate_symmetric(matrix, n, free):  # type: ignore[no-untyped-def]
    """Eliminate on and above the diagonal, without pivoting; return whether every pivot was clearly positive."""
    for p in range(free):
        if not matrix[p, p] > 0.0:
            return False
    for begin in range(0, free, 4):
        end = min(begin + 4, free)
        for p in range(begin, end):
            for i in range(p + 1, end):
                before, factor = matrix[i, i], matrix[p, i] / matrix[p, p]
                for j in range(i, free + 1):
                    matrix[i, j] -= factor * matrix[p, j]
                if not matrix[i, i] > CANCELLED * before:
                    return False
        if end == free:
            break
        for p in range(4):
            for j in range(end, free + 1):
                matrix[n + p, j] = matrix[begin + p, j]
        for i in range(end, free):
            before = matrix[i, i]
            a, b = matrix[n, i] / matrix[begin, begin], matrix[n + 1, i] / matrix[begin + 1, begin + 1]
            c, d = matrix[n + 2, i] / matrix[begin + 2, begin + 2], matrix[n + 3, i] / matrix[begin + 3, begin + 3]
            for j in range(i, free + 1):
                first = a * matrix[n, j] + b * matrix[n + 1, j]
                matrix[i, j] -= first + (c * matrix[n + 2, j] + d * matrix[n + 3, j])
            if not matrix[i, i] > CANCELLED * before:
                return False
    return True


@helper
def eliminate(matrix, n, free):  # type: ignore[no-untyped-def]
    """Eliminate below the diagonal with partial pivoting; return whether no column was all rounding.

    Four columns are eliminated at a time, their rows copied behind the others.
    """
    largest = 0.0
    for i in range(free):
        for j in range(free):
            largest = max(largest, abs(matrix[i, j]))
    for begin in range(0, free, 4):
        end = min(begin + 4, free)
        for p in range(begin, end):
            best = p
            for i in range(p + 1, free):
                best = i if abs(matrix[i, p]) > abs(matrix[best, p]) else best
            if not abs(matrix[best, p]) > CANCELLED * largest:
                return False
            if best != p:
                for j in range(free + 1):
                    matrix[p, j], matrix[best, j] = matrix[best, j], matrix[p, j]
            for i in range(p + 1, free):
                factor = matrix[i, p] / matrix[p, p]
                matrix[i, p] = factor
                for j in range(p + 1, end):
                    matrix[i, j] -= factor * matrix[p, j]
        for p in range(begin, end):
            for i in range(p + 1, end):
                for j in range(end, free + 1):
                    matrix[i, j] -= matrix[i, p] * matrix[p, j]
        if end == free:
            break
        for p in range(4):
            for j in range(end, free + 1):
                matrix[n + p, j] = matrix[begin + p, j]
        for i in range(end, free):
            a, b, c, d = matrix[i, begin], matrix[i, begin + 1], matrix[i, begin + 2], matrix[i, begin + 3]
            if a == 0.0 and b == 0.0 and c == 0.0 and d == 0.0:  # of another island
                continue
            for j in range(end, free + 1):
                first = a * matrix[n, j] + b * matrix[n + 1, j]
                matrix[i, j] -= first + (c * matrix[n + 2, j] + d * matrix[n + 3, j])
    return True
