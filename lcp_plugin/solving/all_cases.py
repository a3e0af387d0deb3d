"""What one compiled pass over all cases excludes in a batch, in doubles: no proof, and none is wanted."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..algorithms.search import LARGEST_CHOICES, LARGEST_SIZE
from ..algorithms.search.outline import MOST_CASES
from ..algorithms.search.stages import FIRST_ENTRIES
from ..certificates.quotients import largest_ratio
from ..certificates.residuals import Certificate
from ..checks import FloatVector
from ..kernels.threads import in_chunks
from ..matrix.parts import IntVector
from .batch_items import Group
from .batch_units import block_diagonal, chosen


@dataclass(frozen=True, eq=False)
class Excluded:
    """Problems of a batch that no z solves, as doubles say; a run of each would end STALLED at its start.

    Attributes
    ----------
    items, iterations : arrays of int, shape (k,)
    z : array, shape (k, n)
        The starts.
    residual : array, shape (k,)
        Their relative residuals.
    """

    items: IntVector
    iterations: IntVector
    z: FloatVector
    residual: FloatVector


def excluded(group: Group, rows: IntVector, iterations: IntVector, tolerance: float, threads: int) -> Excluded:
    """Return those of these rows of a group, problems of one part, that have no solution within the tolerance.

    `iterations` is what each has taken by then.
    """
    from ..kernels import cases as kernels

    count, n = group.items.size, group.M.shape[1]
    start = group.starts if group.starts.size else np.zeros(1)
    lower, upper, starts = (np.broadcast_to(array, (count, n)) for array in (group.lower, group.upper, start))
    choices = np.count_nonzero((lower < upper) & ((lower > -np.inf) | (upper < np.inf)), axis=1)
    is_small = (choices[rows] <= LARGEST_CHOICES) & (n <= LARGEST_SIZE)
    rows, iterations = rows[is_small], iterations[is_small]
    found, cases = np.empty((2, rows.size), np.int64)
    spent, least, z = np.empty(rows.size), np.empty(rows.size), np.empty((rows.size, n))

    def look(first: int, end: int) -> None:
        some = slice(first, end)
        kernels.look_at_all(
            group.M, group.q, group.lower, group.upper, rows[some], FIRST_ENTRIES, MOST_CASES,
            found[some], cases[some], spent[some], least[some], z[some],
        )

    in_chunks(look, rows.size, threads)
    is_one = (found == kernels.EXCLUDED) & (least > tolerance)
    rows, iterations = rows[is_one], iterations[is_one]
    points = np.clip(starts, lower, upper)[rows]
    certificate = Certificate.of(block_diagonal(chosen(group, rows)), points.reshape(-1))
    largest, smallest = certificate.residuals_of_parts
    residual = np.array([largest_ratio(largest[k:k + 1], smallest[k:k + 1]) for k in range(rows.size)])
    kept = residual > tolerance
    return Excluded(group.items[rows[kept]], iterations[kept], points[kept], residual[kept])
