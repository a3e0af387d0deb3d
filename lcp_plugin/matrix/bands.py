"""The bands of a matrix whose entries lie near its diagonal."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..checks import FloatVector, read_only
from .equilibration import power_of_two
from .factors import LARGEST_FILL, LARGEST_OPERATIONS
from .matrix import Matrix, fact
from .structure import row_numbers


class Bands(NamedTuple):
    """A matrix by its diagonals.

    Attributes
    ----------
    entries : ndarray, shape (k, n)
        entries[k, i] = m_{i, i+k−below}; 0 outside of M.
    below : int
        The number of subdiagonals.
    weights : ndarray, shape (n,)
        Powers of two that bring the rows to size 1.
    is_tridiagonal_z : bool
        There is one diagonal on either side at the most, no positive entry on them, and only such on the main one.
    """

    entries: FloatVector
    below: int
    weights: FloatVector
    is_tridiagonal_z: bool


@fact
def bands(matrix: Matrix) -> Bands | None:
    """Return the bands of M, None where a factor of them would be too large."""
    M = matrix.csr
    rows = row_numbers(M)
    offsets = M.indices - rows
    below, above = max(0, -int(offsets.min(initial=0))), max(0, int(offsets.max(initial=0)))
    width = below + above + 1.0
    if matrix.n * width > LARGEST_FILL or matrix.n * width * below > LARGEST_OPERATIONS:
        return None
    if max(below, above) <= 1:
        below = above = 1
    entries = np.zeros((below + above + 1, matrix.n))
    entries[offsets + below, rows] = M.data
    is_z = below == above == 1 and not bool((entries[::2] > 0.0).any()) and bool((entries[1] > 0.0).all())
    return Bands(read_only(entries), below, read_only(1.0 / power_of_two(matrix.residual_scale, 1000)), is_z)
