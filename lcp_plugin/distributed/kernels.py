"""What one rank does on its own rows beside what a single process does; compiled, arrays only."""

from __future__ import annotations

import numpy as np
from numba import njit, uintp

from ..kernels.compilation import compiled
from ..matrix.hierarchy.coarsening import COARSE


@njit(inline="always")
def _least_strong(indptr, indices, data, strength, i):  # type: ignore[no-untyped-def]
    """Return the least −m_ij of a strong coupling of row i; ∞ where it has none."""
    largest = 0.0
    for k in range(uintp(indptr[i]), uintp(indptr[i + uintp(1)])):
        if -data[k] > largest and uintp(indices[k]) != i:
            largest = -data[k]
    return strength * largest if largest > 0.0 else np.inf


@compiled
def mend_seams(indptr, indices, data, strength, own, gives_way, kind):  # type: ignore[no-untyped-def]
    """Make own unknowns coarse that depend strongly on a foreign fine one without a strong coarse one for both.

    The second pass of Ruge and Stüben, where ranks meet. Of the two ranks the one gives way whose flag in `gives_way`,
    one a foreign unknown, is set. Behind the own rows stand those of foreign unknowns next to them.
    """
    one = uintp(1)
    n = uintp(own)
    rows = uintp(indptr.size - 1)
    mark = np.full(kind.size, -1, indptr.dtype)
    for i in range(n):
        begin, end = uintp(indptr[i]), uintp(indptr[i + one])
        if kind[i] == COARSE or begin == end or uintp(indices[end - one]) < n:
            continue
        least = _least_strong(indptr, indices, data, strength, i)
        for k in range(begin, end):
            if -data[k] >= least and kind[uintp(indices[k])] == COARSE:
                mark[uintp(indices[k])] = i
        for k in range(begin, end):
            j = uintp(indices[k])
            if j < n or j >= rows or -data[k] < least or kind[j] == COARSE or not gives_way[j - n]:
                continue
            has_common = False
            its_least = _least_strong(indptr, indices, data, strength, j)
            for m in range(uintp(indptr[j]), uintp(indptr[j + one])):
                if -data[m] >= its_least and mark[uintp(indices[m])] == i:
                    has_common = True
                    break
            if not has_common:
                kind[i] = COARSE
                break
