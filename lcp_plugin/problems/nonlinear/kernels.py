"""Which columns of a pattern may be moved together: a colouring, compiled."""

from __future__ import annotations

import numpy as np

from ...core.kernels.compilation import kernel
from ...core.kernels.compiler import uintp


@kernel
def colour_columns(indptr, indices, row_indptr, row_indices, colours):  # type: ignore[no-untyped-def]
    """Give each column the first colour that no column has which meets one of its rows; colours begin as −1.

    The pattern comes by columns and by rows. Cost: the sum of the squared lengths of the rows.
    """
    one, n = uintp(1), uintp(colours.size)
    seen_by = np.full(colours.size + 1, -1, np.int64)  # which column has met this colour last
    for j in range(n):
        for k in range(uintp(indptr[j]), uintp(indptr[j + one])):
            i = uintp(indices[k])
            for m in range(uintp(row_indptr[i]), uintp(row_indptr[i + one])):
                colour = colours[uintp(row_indices[m])]
                if colour >= 0:
                    seen_by[uintp(colour)] = j
        first = 0
        while seen_by[uintp(first)] == j:
            first += 1
        colours[j] = first
