"""Which equation goes with which free unknown: the diagonal that a splitting method divides by."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.sparse.csgraph import maximum_bipartite_matching, min_weight_full_bipartite_matching


def matching(block: sp.csr_array) -> NDArray[np.int64]:
    """Return for each equation the unknown it goes with: large entries on the diagonal where that is possible."""
    size = block.shape[0]
    rows = np.repeat(np.arange(size), np.diff(block.indptr))
    magnitude = np.abs(block.data)
    largest = np.zeros(size)
    np.maximum.at(largest, rows, magnitude)
    # Costs must be positive; a hint of the distance from the diagonal settles ties in natural order.
    cost = 1.0 + np.log(largest[rows] / magnitude) + 1e-9 * np.abs(rows - block.indices)
    index, pointer = block.indices.astype(np.int32), block.indptr.astype(np.int32)
    pattern = sp.csr_matrix((cost, index, pointer), shape=block.shape)
    try:
        return np.asarray(min_weight_full_bipartite_matching(pattern)[1], dtype=np.int64)
    except ValueError:  # no full matching: the diagonal will have gaps
        matched = np.asarray(maximum_bipartite_matching(pattern, perm_type="column"), dtype=np.int64)
        missing = np.flatnonzero(matched < 0)
        matched[missing] = np.setdiff1d(np.arange(size), matched[matched >= 0])
        return matched
