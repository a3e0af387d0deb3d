"""Row and column scaling by exact powers of two."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp

from ..checks import BoolVector, FloatVector
from .structure import IntVector, row_numbers

SPREAD = 10  # log2 of the largest ratio of entries in one unit
BESIDE_DIAGONAL = (
    4  # log2 of the largest ratio of an entry in one unit to the diagonal entry of its row
)
FITTED, MOST_STEPS = 1e-6, 300  # relative residual of a fit; steps of conjugate gradients


class Exponents(NamedTuple):
    """One exponent per row and per column: the scaled matrix has entries m_ij 2^(row_i + column_j)."""

    row: IntVector
    column: IntVector


def are_well_scaled(matrices: Any) -> BoolVector:
    """Return the mask of dense matrices, shape (k, n, n), that need no scaling: shape (k,)."""
    sizes, pivots = np.abs(matrices), np.abs(np.diagonal(matrices, axis1=1, axis2=2))
    most = sizes.max(axis=(1, 2), initial=0.0) * 2.0**-SPREAD
    are: BoolVector = most <= pivots.min(axis=1, initial=np.inf)
    rest = np.flatnonzero(~are)
    if rest.size:
        left = sizes[rest] if rest.size < are.size else sizes
        rows, columns = left.max(axis=2), left.max(axis=1)
        shows_none = (rows * 2.0**-BESIDE_DIAGONAL <= pivots[rest]).all(axis=1)
        sides = np.concatenate([rows, columns], axis=1)
        are[rest] = shows_none | (
            most[rest] <= sides.min(axis=1, initial=np.inf, where=sides > 0.0)
        )
    return are


def scale_matrix(M: Any, exponents: Exponents | None) -> Any:
    """Return the array or CSR array with entries m_ij 2^(row_i + column_j)."""
    if exponents is None:
        return M
    row, column = (side.astype(np.int32) for side in exponents)
    if not sp.issparse(M):
        return times_power(M, row[:, None] + column)
    data = times_power(M.data, row[row_numbers(M)] + column[M.indices])
    return sp.csr_array((data, M.indices, M.indptr), shape=M.shape)


def times_power(x: FloatVector, exponent: IntVector | None) -> FloatVector:
    """Return x_i 2^exponent_i, of the shape of x."""
    with np.errstate(under="ignore", over="ignore"):
        return x if exponent is None else np.asarray(np.ldexp(x, exponent))


def fit_scaling(ratios: FloatVector, rows: IntVector, columns: IntVector, n: int) -> FloatVector:
    """Return s, shape (n,), for which ratio_k + s_column − s_row is about 0 in the least squares sense.

    By conjugate gradients, preconditioned with the diagonal, on the Laplacian of the graph of all k.
    """
    right: Any = np.bincount(rows, ratios, n) - np.bincount(columns, ratios, n)
    degree: Any = np.bincount(rows, minlength=n) + np.bincount(columns, minlength=n)
    weights, found = np.where(degree > 0, degree, 1).astype(np.float64), np.zeros(n)
    ends = np.concatenate([rows, columns]), np.concatenate([columns, rows])
    edges = sp.csr_array((np.ones(2 * rows.size), ends), shape=(n, n))
    residual, direction, before = right, np.zeros(n), 1.0
    least = FITTED * float(np.sqrt(right.dot(right)))
    for _ in range(MOST_STEPS):
        if np.sqrt(residual.dot(residual)) <= least:
            break
        ahead = residual / weights
        slope = float(residual.dot(ahead))
        direction = ahead + (slope / before) * direction
        image = degree * direction - edges @ direction
        length, before = slope / float(direction.dot(image)), slope
        found = found + length * direction
        residual = residual - length * image
    return found
