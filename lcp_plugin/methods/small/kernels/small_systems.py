"""The dense linear system of a guessed active set, solved in place; arrays as in :mod:`.workspace`."""

from __future__ import annotations

from ....core.kernels.compilation import helper

CANCELLED = 2.0**-50  # a pivot so small beside what it was made from is rounding
LARGEST = 1e290


@helper
def substitute(matrix, free):  # type: ignore[no-untyped-def]
    """Solve with what elimination left on and above the diagonal; the right-hand side is column `free`."""
    for p in range(free - 1, -1, -1):
        total = matrix[p, free]
        for j in range(p + 1, free):
            total -= matrix[p, j] * matrix[j, free]
        matrix[p, free] = total / matrix[p, p]


@helper
def eliminate(matrix, n, free, is_symmetric=False):  # type: ignore[no-untyped-def]
    """Eliminate below the diagonal with partial pivoting; return whether no column was all rounding.

    Without pivoting, and all on and above the diagonal, where it is symmetric: then whether every pivot was clearly
    positive. Four columns are eliminated at a time, their rows copied behind the others; the row behind these holds
    what a symmetric block's diagonal was before them.
    """
    largest = 0.0
    for i in range(free):
        if is_symmetric:
            matrix[n + 4, i] = 0.0
        for j in range(free):
            largest = max(largest, abs(matrix[i, j]))
    for begin in range(0, free, 4):
        end = min(begin + 4, free)
        if is_symmetric:
            for i in range(begin, free):
                if not matrix[i, i] > CANCELLED * matrix[n + 4, i]:
                    return False
                matrix[n + 4, i] = matrix[i, i]
                for p in range(begin, min(i, end)):
                    matrix[i, p] = matrix[p, i]
        for p in range(begin, end):
            best = p
            for i in range(free if is_symmetric else p + 1, free):
                best = i if abs(matrix[i, p]) > abs(matrix[best, p]) else best
            pivot = matrix[p, p] if is_symmetric else abs(matrix[best, p])
            if not pivot > CANCELLED * (matrix[n + 4, p] if is_symmetric else largest):
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
            a, b, c, d = (
                matrix[i, begin],
                matrix[i, begin + 1],
                matrix[i, begin + 2],
                matrix[i, begin + 3],
            )
            if abs(a) + abs(b) + abs(c) + abs(d) == 0.0:  # of another island
                continue
            for j in range(i if is_symmetric else end, free + 1):
                first = a * matrix[n, j] + b * matrix[n + 1, j]
                matrix[i, j] -= first + (c * matrix[n + 2, j] + d * matrix[n + 3, j])
    return True
