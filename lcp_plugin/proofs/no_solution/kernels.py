"""Whether a row can not be satisfied, by the bounds of its unknowns alone; compiled."""

from __future__ import annotations

import numpy as np

from ...core.kernels.compilation import kernel


@kernel
def is_missed(indptr, indices, data, q, lower, upper, rows):  # type: ignore[no-untyped-def]
    """Return whether z within the bounds miss the sign that w has to have in one of the rows, to rounding."""
    for i in rows:
        lowest = highest = 0.0
        for k in range(indptr[i], indptr[i + 1]):
            if data[k] == 0.0:
                continue
            first, second = data[k] * lower[indices[k]], data[k] * upper[indices[k]]
            lowest, highest = lowest + min(first, second), highest + max(first, second)
        if (upper[i] == np.inf and highest + q[i] < 0.0) or (lower[i] == -np.inf and lowest + q[i] > 0.0):
            return True
    return False
