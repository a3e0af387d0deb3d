"""Blocks of sparse matrices put together without triplets, which would take longer than a small program does."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp


def vertically(*blocks: sp.csr_array) -> sp.csr_array:
    """Return CSR arrays of the same width, one above the other.

    Examples
    --------
    >>> vertically(sp.csr_array([[1.0, 2.0]]), sp.csr_array([[0.0, 3.0]])).toarray()
    array([[1., 2.],
           [0., 3.]])
    """
    lengths = np.concatenate([[0], *(np.diff(block.indptr) for block in blocks)])
    indices, data = (np.concatenate([getattr(block, part) for block in blocks]) for part in ("indices", "data"))
    shape = (lengths.size - 1, blocks[0].shape[1])
    return sp.csr_array((data, indices, np.cumsum(lengths)), shape=shape)


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
