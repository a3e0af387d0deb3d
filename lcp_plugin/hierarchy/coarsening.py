"""Which unknowns go to the coarser grid, and how the others are interpolated from them; compiled, arrays only.

Unknown i depends strongly on j where −m_ij ≥ strength · max_k −m_ik. The coarse unknowns are chosen by the first
pass of Ruge and Stüben: take the unknown on which most others depend, interpolate those from it, and prefer from
then on what these depend on. Interpolation is direct: row i, scaled so that a constant is reproduced where the row
of M sums to zero; positive couplings are lumped into the diagonal, so that no weight is negative.

References
----------
J. W. Ruge, K. Stüben, *Algebraic multigrid*, in: Multigrid Methods, SIAM 1987, doi:10.1137/1.9781611971057.ch4.
"""

from __future__ import annotations

import numpy as np

from ..kernels import compiled

UNDECIDED, COARSE, FINE = 0, 1, 2


@compiled
def strong_couplings(indptr, indices, data, strength, is_strong, dependents):  # type: ignore[no-untyped-def]
    """Mark the entries i → j where i depends strongly on j, and count the dependents of j in dependents[j + 1]."""
    for i in range(indptr.size - 1):
        largest = 0.0
        for k in range(indptr[i], indptr[i + 1]):
            if indices[k] != i and -data[k] > largest:
                largest = -data[k]
        for k in range(indptr[i], indptr[i + 1]):
            is_strong[k] = largest > 0.0 and indices[k] != i and -data[k] >= strength * largest
            if is_strong[k]:
                dependents[indices[k] + 1] += 1


@compiled
def list_dependents(indptr, indices, is_strong, first, dependents):  # type: ignore[no-untyped-def]
    """Fill dependents[first[j]:first[j + 1]] with the unknowns that depend strongly on j."""
    place = first[:-1].copy()
    for i in range(indptr.size - 1):
        for k in range(indptr[i], indptr[i + 1]):
            if is_strong[k]:
                j = indices[k]
                dependents[place[j]] = i
                place[j] += 1


@compiled
def choose_coarse(indptr, indices, is_strong, first, dependents, kind):  # type: ignore[no-untyped-def]
    """Fill kind with COARSE and FINE; an unknown that no other one depends on is FINE.

    The weight of an unknown is the number of its undecided dependents, to which each dependent that became FINE adds
    once more. One list a weight holds the unknowns that had it at some time; an entry whose unknown has lost
    weight since goes to the list where it belongs when its turn comes.
    """
    n = indptr.size - 1
    weight = np.empty(n, np.int32)
    heaviest = 0
    for i in range(n):
        weight[i] = first[i + 1] - first[i]
        if weight[i] > heaviest:
            heaviest = weight[i]
    head = np.full(2 * heaviest + 2, -1, np.int32)
    entry = np.empty(2 * n + indices.size, np.int32)
    after = np.empty(2 * n + indices.size, np.int32)
    size = 0
    for i in range(n - 1, -1, -1):
        if weight[i] == 0:
            kind[i] = FINE
        else:
            entry[size], after[size] = i, head[weight[i]]
            head[weight[i]] = size
            size += 1
    while heaviest > 0:
        place = head[heaviest]
        if place < 0:
            heaviest -= 1
            continue
        head[heaviest] = after[place]
        i = entry[place]
        if kind[i] != UNDECIDED:
            continue
        if weight[i] < heaviest:
            if weight[i] == 0:
                kind[i] = FINE
            else:
                after[place] = head[weight[i]]
                head[weight[i]] = place
            continue
        kind[i] = COARSE
        for k in range(first[i], first[i + 1]):
            j = dependents[k]
            if kind[j] != UNDECIDED:
                continue
            kind[j] = FINE
            for m in range(indptr[j], indptr[j + 1]):
                p = indices[m]
                if is_strong[m] and kind[p] == UNDECIDED:
                    weight[p] += 1
                    entry[size], after[size] = p, head[weight[p]]
                    head[weight[p]] = size
                    size += 1
                    if weight[p] > heaviest:
                        heaviest = weight[p]
        for m in range(indptr[i], indptr[i + 1]):
            if is_strong[m] and kind[indices[m]] == UNDECIDED:
                weight[indices[m]] -= 1


@compiled
def direct_interpolation(  # type: ignore[no-untyped-def]
    indptr, indices, data, is_strong, kind, number, p_indptr, p_indices, p_data
):
    """Write the interpolation in CSR; return its number of entries. `number` numbers the coarse unknowns."""
    size = 0
    for i in range(indptr.size - 1):
        p_indptr[i] = size
        if kind[i] == COARSE:
            p_indices[size] = number[i]
            p_data[size] = 1.0
            size += 1
            continue
        diagonal = 0.0
        all_negative = 0.0
        interpolating = 0.0
        for k in range(indptr[i], indptr[i + 1]):
            if indices[k] == i or data[k] > 0.0:
                diagonal += data[k]
            else:
                all_negative += data[k]
                if is_strong[k] and kind[indices[k]] == COARSE:
                    interpolating += data[k]
        if interpolating == 0.0 or not diagonal > 0.0:
            continue
        factor = -(all_negative / interpolating) / diagonal
        for k in range(indptr[i], indptr[i + 1]):
            if is_strong[k] and kind[indices[k]] == COARSE:
                p_indices[size] = number[indices[k]]
                p_data[size] = factor * data[k]
                size += 1
    p_indptr[indptr.size - 1] = size
    return size
