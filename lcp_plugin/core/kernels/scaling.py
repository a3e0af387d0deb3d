"""Compiled shortest paths and bounded balancing over the entries of a matrix; they know arrays only."""

from __future__ import annotations

from .compilation import kernel

PASSES = 50  # over all entries: what takes longer runs round a cycle, or drifts
LEAST = -2000  # beyond the range of doubles


@kernel
def shortest(indptr, indices, length, component, is_cut, distance, queue, is_waiting):  # type: ignore[no-untyped-def]
    """Overwrite the integers `distance` by the greatest d ≤ distance with d_j ≤ d_i + length_k, k the entry (i, j).

    Bellman and Ford's relaxation, first in first out. Where a cycle of negative length lets a component fall for ever,
    or a distance leaves the range of doubles, ``is_cut[component]`` is set. `queue` holds all rows and is as long.
    """
    n = distance.size
    head, waiting, left = 0, n, PASSES * (length.size + n)
    for i in range(n):
        queue[i], is_waiting[i] = i, True
    while waiting > 0:
        i = queue[head]
        head, waiting = (head + 1) % n, waiting - 1
        is_waiting[i] = False
        if is_cut[component[i]]:
            continue
        left -= indptr[i + 1] - indptr[i] + 1
        if left < 0 or distance[i] < LEAST:
            is_cut[component[i]] = True
            continue
        for k in range(indptr[i], indptr[i + 1]):
            j, reached = indices[k], distance[i] + length[k]
            if reached < distance[j]:
                distance[j] = reached
                if not is_waiting[j]:
                    is_waiting[j] = True
                    queue[(head + waiting) % n] = j
                    waiting += 1


@kernel
def balance_within(  # type: ignore[no-untyped-def]
    indptr,
    indices,
    size,
    mirror_indptr,
    mirror_indices,
    mirror_size,
    lower,
    upper,
    position,
    sweeps,
):
    """Overwrite s by sweeps that minimise Σ (size_k + s_j − s_i)² over the entries k = (i, j), lower ≤ s ≤ upper."""
    n = position.size
    for sweep in range(sweeps):
        for step in range(n):
            i = n - 1 - step if sweep % 2 else step
            total, count = 0.0, 0
            for k in range(indptr[i], indptr[i + 1]):
                total += size[k] + position[indices[k]]
                count += 1
            for k in range(mirror_indptr[i], mirror_indptr[i + 1]):
                total += position[mirror_indices[k]] - mirror_size[k]
                count += 1
            if count:
                position[i] = min(max(total / count, lower[i]), upper[i])
