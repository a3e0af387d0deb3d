"""Operations on rows of dense arrays: loops where kernels are compiled, whole arrays at once where interpreted.

Indices without a sign need no look at whether they are negative, so that loops use vector instructions.
"""

from __future__ import annotations

from typing import Any

from ....core.kernels.compilation import compiled_for_rows
from ....core.kernels.enclosures import unsigned


def _add_row_at_once(matrix: Any, i: int, begin: int, end: int, times: Any, vectors: Any, row: int) -> None:
    vectors[row, begin:end] += matrix[i, begin:end] * times


@compiled_for_rows(_add_row_at_once)
def add_row(matrix, i, begin, end, times, vectors, row):  # type: ignore[no-untyped-def]
    """Add so many times matrix[i, j] to that row of `vectors`, begin ≤ j < end."""
    i, row = unsigned(i), unsigned(row)
    for j in range(unsigned(begin), unsigned(end)):
        vectors[row, j] += matrix[i, j] * times


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
