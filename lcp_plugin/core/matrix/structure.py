"""Structure of a matrix from its pattern of nonzeros: triangular form and connected components.

The components are those of the graph of M: no entry couples two of them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ..checks import read_only
from .matrix import Matrix, fact

IntVector = np.ndarray[Any, np.dtype[np.int64]]


def row_numbers(M: Any) -> IntVector:
    """Return the row number of each stored entry of a CSR array, shape (nnz,)."""
    return np.repeat(np.arange(M.shape[0], dtype=M.indices.dtype), np.diff(M.indptr))


@fact
def triangular_form(matrix: Matrix) -> str | None:
    """Return "diagonal", "lower", "upper", or None."""
    M = matrix.csr
    rows = row_numbers(M)
    if (rows == M.indices).all():
        return "diagonal"
    if (rows >= M.indices).all():
        return "lower"
    return "upper" if (rows <= M.indices).all() else None


@dataclass(frozen=True, eq=False)
class Components:
    """The connected components of a matrix that has several.

    Attributes
    ----------
    labels : array of int, shape (n,)
        Numbers of components, from 0 on.
    count : int
        Number of components.
    """

    labels: IntVector
    count: int


@fact
def connected_components(matrix: Matrix) -> Components | None:
    """Return the connected components of the graph of M; None if there is only one.

    Examples
    --------
    >>> connected_components(Matrix([[2.0, 0.0, 1.0], [0.0, 3.0, 0.0], [0.0, 0.0, 2.0]])).labels
    array([0, 1, 0])
    >>> connected_components(Matrix([[2.0, 1.0], [0.0, 2.0]])) is None
    True
    """
    if _is_seen_connected(matrix):
        return None
    from scipy.sparse.csgraph import connected_components as labeled

    count, labels = labeled(matrix.csr, directed=False)
    return Components(read_only(labels.astype(np.int64)), int(count)) if count > 1 else None


def _is_seen_connected(matrix: Matrix) -> bool:
    """Return whether each row except the first has an entry left of its diagonal: then all rows are connected."""
    if matrix.n < 2:
        return True
    if matrix.is_dense and bool(matrix.array[0].all()):
        return True
    if matrix.is_dense:  # entries left of the diagonal, or mirrored above it
        nonzero = matrix.array != 0.0
        return bool(np.tril(nonzero | nonzero.T, -1).any(axis=1)[1:].all())
    starts, indices = matrix.csr.indptr, matrix.csr.indices
    is_filled = bool((starts[2:] > starts[1:-1]).all())
    return is_filled and bool(
        (indices[starts[1:-1]] < np.arange(1, matrix.n, dtype=indices.dtype)).all()
    )
