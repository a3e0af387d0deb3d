"""What one rank does on its own rows beside what a single process does; compiled, arrays only."""

from __future__ import annotations

from numba import uintp

from ..compilation import compiled


@compiled
def own_strong_couplings(indptr, indices, data, strength, own, is_strong, first):  # type: ignore[no-untyped-def]
    """Mark the entries i → j, j < own, where i depends strongly on j; count the dependents of j in first[j + 1].

    Strong is what is so among all couplings of the row, the foreign ones included.
    """
    one = uintp(1)
    for i in range(uintp(indptr.size - 1)):
        largest = 0.0
        for k in range(uintp(indptr[i]), uintp(indptr[i + one])):
            if -data[k] > largest and uintp(indices[k]) != i:
                largest = -data[k]
        for k in range(uintp(indptr[i]), uintp(indptr[i + one])):
            j = uintp(indices[k])
            is_strong[k] = j < uintp(own) and largest > 0.0 and j != i and -data[k] >= strength * largest
            if is_strong[k]:
                first[j + one] += 1
