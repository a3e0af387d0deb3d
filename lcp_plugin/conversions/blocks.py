"""Blocks of sparse matrices put together without triplets, which would take longer than a small program does."""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse as sp


def as_csr(matrix: Any) -> sp.csr_array:
    """Return an ndarray as CSR, and a CSR array as it is.

    Examples
    --------
    >>> as_csr(np.array([[1.0, 0.0], [3.0, 4.0]])).indices
    array([0, 0, 1], dtype=int32)
    """
    if sp.issparse(matrix):
        return matrix if isinstance(matrix, sp.csr_array) else sp.csr_array(matrix)
    index_type = np.int32 if matrix.size < 2**31 else np.int64
    (m, n), is_entry = matrix.shape, matrix != 0.0
    if is_entry.all():
        starts, columns = n * np.arange(m + 1), np.tile(np.arange(n, dtype=index_type), m)
        return sp.csr_array((matrix.reshape(-1), columns, starts.astype(index_type)), shape=matrix.shape)
    starts = np.concatenate([[0], np.cumsum(is_entry.sum(axis=1))]).astype(index_type)
    columns = np.nonzero(is_entry)[1].astype(index_type)
    return sp.csr_array((matrix[is_entry], columns, starts), shape=matrix.shape)


def vertically(*blocks: sp.csr_array) -> sp.csr_array:
    """Return CSR arrays one above the other, as wide as the first; a narrower one has zeros on its right.

    Examples
    --------
    >>> vertically(sp.csr_array([[1.0, 2.0]]), sp.csr_array([[0.0, 3.0]])).toarray()
    array([[1., 2.],
           [0., 3.]])
    """
    filled = [block for block in blocks if block.shape[0]] or list(blocks[:1])
    if len(filled) == 1 and filled[0].shape[1] == blocks[0].shape[1]:
        return filled[0]
    ends = np.cumsum([0, *(block.nnz for block in filled)])
    starts = np.concatenate([block.indptr[:-1] + end for block, end in zip(filled, ends, strict=False)] + [ends[-1:]])
    indices, data = (np.concatenate([getattr(block, part) for block in filled]) for part in ("indices", "data"))
    return sp.csr_array((data, indices, starts), shape=(starts.size - 1, blocks[0].shape[1]))


def horizontally(left: sp.csr_array, right: sp.csr_array) -> sp.csr_array:
    """Return two CSR arrays of the same height, one beside the other.

    Examples
    --------
    >>> horizontally(sp.csr_array([[1.0], [0.0]]), sp.csr_array([[2.0], [3.0]])).toarray()
    array([[1., 2.],
           [0., 3.]])
    """
    starts = left.indptr.astype(np.int64) + right.indptr
    indices, data = np.empty(starts[-1], dtype=np.int64), np.empty(starts[-1])
    shifts = ((left, right.indptr[:-1], 0), (right, left.indptr[1:], left.shape[1]))
    for block, shift, first in shifts:
        places = np.arange(block.nnz) + np.repeat(shift, np.diff(block.indptr))
        indices[places], data[places] = block.indices + first, block.data
    return sp.csr_array((data, indices, starts), shape=(left.shape[0], left.shape[1] + right.shape[1]))


def multiple_of_identity(factor: float, n: int) -> sp.csr_array:
    """Return factor · I as CSR, shape (n, n).

    Examples
    --------
    >>> multiple_of_identity(-1.0, 2).toarray()
    array([[-1.,  0.],
           [ 0., -1.]])
    """
    return sp.csr_array((np.full(n, factor), np.arange(n), np.arange(n + 1)), shape=(n, n))
