"""What sweeps and their theorems ask of the rows of M: scales, splits, sums over both triangles."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..checks import FloatVector, read_only
from ..exact.rounding import read_only_views
from .matrix import Matrix, fact

BLOCK = 16_384


@fact
def inverse_residual_scale(matrix: Matrix) -> FloatVector:
    """Return 1/d of the scaled residual, shape (n,), kept finite."""
    with np.errstate(over="ignore"):
        return read_only(np.minimum(1.0 / matrix.residual_scale, np.finfo(np.float64).max))


@fact
def has_positive_diagonal(matrix: Matrix) -> NDArray[np.bool_]:
    """Return where the diagonal is positive and not too small to invert, shape (own,)."""
    with np.errstate(over="ignore", divide="ignore"):
        return read_only((matrix.diagonal > 0.0) & np.isfinite(1.0 / matrix.diagonal))


@fact
def row_splits(matrix: Matrix, backward: bool) -> Any:
    """Return the row splits of a sweep direction, shape (own,)."""
    from ..kernels import splitting_sweeps as kernels

    return kernels.row_splits(matrix.csr_rows, backward=backward)


def triangle_sums(matrix: Matrix, v: FloatVector, part: Any = None) -> tuple[FloatVector, FloatVector]:
    """Return (|L|v, |U|v), each row divided by the scale of its residual, shapes (own,); one pass over M.

    On several ranks v has shape (width,), and what others hold is part of U: no sweep has updated it. With a CSR array
    `part`, shape (n, n), of its triangles instead of those of M.
    """
    from ..kernels.rows import triangle_sums as compiled

    lower, upper = np.empty(matrix.own), np.empty(matrix.own)
    M = matrix.csr_rows if part is None else part
    compiled(*read_only_views(M.indptr, M.indices, M.data, inverse_residual_scale(matrix), v), lower, upper)
    return lower, upper


@fact
def unit_triangle_sums(matrix: Matrix) -> tuple[FloatVector, FloatVector]:
    """Return the triangle sums of v = 1."""
    return triangle_sums(matrix, np.ones(matrix.width))


@fact
def longest_row(matrix: Matrix) -> int:
    """Return the largest number of entries in a row."""
    return int(np.diff(matrix.csr.indptr).max(initial=0))


def row_blocks(n: int) -> Iterator[slice]:
    """Yield blocks of rows whose temporary vectors stay in a processor's cache."""
    for first in range(0, n, BLOCK):
        yield slice(first, min(first + BLOCK, n))
