"""Operations on rows of dense arrays: loops where kernels are compiled, whole arrays at once where interpreted.

Indices without a sign need no look at whether they are negative, so that loops use vector instructions.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ....core.kernels.compilation import compiled_for_rows
from ....core.kernels.enclosures import unsigned


def _row_times_at_once(matrix: Any, i: int, begin: int, end: int, vectors: Any, row: int) -> Any:
    products, a, b, c, d = matrix[i, begin:end] * vectors[row, begin:end], *np.zeros(4)
    fours = end - begin - (end - begin) % 4
    if fours:  # sums of numbers in a row, one after the other
        a, b, c, d = np.cumsum(products[:fours].reshape(-1, 4), axis=0)[-1]
    for product_of_rest in products[fours:]:
        a += product_of_rest
    return (a + b) + (c + d)


def _add_row_at_once(matrix: Any, i: int, begin: int, end: int, times: Any, vectors: Any, row: int) -> None:
    vectors[row, begin:end] += matrix[i, begin:end] * times


def _subtract_four_at_once(matrix: Any, i: int, end: int, room: Any, e: Any, f: Any, g: Any, h: Any) -> None:
    a, b, c, d = room[:, i:end]
    matrix[i, i:end] -= (e * a + f * b) + (g * c + h * d)


@compiled_for_rows(_row_times_at_once)
def row_times(matrix, i, begin, end, vectors, row):  # type: ignore[no-untyped-def]
    """Return Σ matrix[i, j] v_j over begin ≤ j < end, v that row of `vectors`: four sums side by side."""
    a = b = c = d = 0.0
    i, row, fours, end = unsigned(i), unsigned(row), unsigned(end - (end - begin) % 4), unsigned(end)
    one, two, three = unsigned(1), unsigned(2), unsigned(3)
    for j in range(unsigned(begin), fours, unsigned(4)):
        a += matrix[i, j] * vectors[row, j]
        b += matrix[i, j + one] * vectors[row, j + one]
        c += matrix[i, j + two] * vectors[row, j + two]
        d += matrix[i, j + three] * vectors[row, j + three]
    for j in range(fours, end):
        a += matrix[i, j] * vectors[row, j]
    return (a + b) + (c + d)


@compiled_for_rows(_add_row_at_once)
def add_row(matrix, i, begin, end, times, vectors, row):  # type: ignore[no-untyped-def]
    """Add so many times matrix[i, j] to that row of `vectors`, begin ≤ j < end."""
    i, row = unsigned(i), unsigned(row)
    for j in range(unsigned(begin), unsigned(end)):
        vectors[row, j] += matrix[i, j] * times


@compiled_for_rows(_subtract_four_at_once)
def subtract_four(matrix, i, end, room, e, f, g, h):  # type: ignore[no-untyped-def]
    """Subtract so many times the four rows of `room` from row i, from the diagonal on: it is read and written once."""
    i = unsigned(i)
    for j in range(i, unsigned(end)):
        matrix[i, j] -= (e * room[0, j] + f * room[1, j]) + (g * room[2, j] + h * room[3, j])


def _copy_row_at_once(matrix: Any, i: int, begin: int, end: int, target: Any, row: int) -> None:
    target[row, begin:end] = matrix[i, begin:end]


@compiled_for_rows(_copy_row_at_once)
def copy_row(matrix, i, begin, end, target, row):  # type: ignore[no-untyped-def]
    """Copy matrix[i, j], begin ≤ j < end, to the same places of a row of another."""
    for j in range(begin, end):
        target[row, j] = matrix[i, j]


def _add_row_of_batch_at_once(matrix: Any, k: int, i: int, end: int, times: Any, vectors: Any, row: int) -> None:
    vectors[row, :end] += matrix[k, i, :end] * times


@compiled_for_rows(_add_row_of_batch_at_once)
def add_row_of_batch(matrix, k, i, end, times, vectors, row):  # type: ignore[no-untyped-def]
    """Add so many times matrix[k, i, j] to that row of `vectors`, j < end."""
    for j in range(end):
        vectors[row, j] += matrix[k, i, j] * times
