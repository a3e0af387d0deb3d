"""Predicted size of a sparse factorization: column counts in an order of minimum degree.

Eliminating an unknown joins its neighbors to each other. They are not written down: the eliminated ones stay as
*elements*, lists of their neighbors, and an element whose unknowns another element has is absorbed, so that the graph
never grows. Degrees are approximate, no smaller than the true ones; unknowns with the same neighbors are eliminated
together. The order therefore gives the counts, in a time close to the time for reading the pattern. SuperLU and QDLDL
use similar orders, so that their factorizations have about as many entries.

References
----------
Amestoy, Davis, Duff, An approximate minimum degree ordering algorithm, SIAM J. Matrix Anal. Appl. 17 (1996),
doi:10.1137/S0895479894278952.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

from ..core.checks import AnyMatrix
from ..core.kernels.compilation import kernel


def factor_sizes(
    matrix: AnyMatrix, most_entries: float = np.inf, most_operations: float = np.inf
) -> tuple[float, float]:
    """Return the entries of L, its diagonal included, and Σ count² over its columns, of a factor of A + Aᵀ.

    Parameters
    ----------
    matrix : CSR or CSC array, shape (n, n)
        Matrix; only its pattern is used.
    most_entries, most_operations : float
        Limits of the count. If the count exceeds a limit or takes too long, both results are ∞.

    Examples
    --------
    >>> chain = sp.diags_array([np.ones(99), np.ones(100), np.ones(99)], offsets=[-1, 0, 1], format="csr")
    >>> factor_sizes(chain)
    (199.0, 397.0)
    """
    n = matrix.shape[0]
    ones = np.ones(matrix.indices.size, np.int8)
    pattern = sp.csr_array((ones, matrix.indices, matrix.indptr), shape=(n, n))
    pattern = sp.csr_array(pattern + pattern.T)
    pattern.setdiag(0)
    pattern.eliminate_zeros()
    # Grids touch 2 to 10 times the entries; the count ends at this limit.
    most_touched, lengths = 6 * pattern.nnz + 10_000_000, np.diff(pattern.indptr)
    # Rows with more entries than `full` √n come last, for example a constraint that couples all unknowns. The second
    # number applies if counting takes too long with the first.
    for full in (10.0, 1.0):
        is_full = lengths > full * np.sqrt(n)
        others, last = np.flatnonzero(~is_full), int(np.count_nonzero(is_full))
        left = sp.csr_array(pattern[others][:, others]) if last else pattern
        begins, lists = left.indptr.astype(np.int64), left.indices.astype(np.int64)
        # Lists stay where they are; memory that no list reaches is never touched.
        workspace = np.empty(lists.size + min(most_touched + n, n * (n - 1) // 2), np.int64)
        workspace[: lists.size] = lists
        limits = most_entries, most_operations, most_touched
        counts = minimum_degree(begins, workspace, float(last), *limits)
        if counts[2] <= most_touched:
            ends = np.arange(1.0, last + 1.0)
            entries, work = counts[0] + float(ends.sum()), counts[1] + float(ends @ ends)
            if entries <= most_entries and work <= most_operations:
                return entries, work
            break
    return np.inf, np.inf


@kernel
def minimum_degree(begins, workspace, last, most_entries, most_operations, most_touched):  # type: ignore[no-untyped-def]
    """Return Σ count and Σ count² of the columns of L, ∞ and ∞ beyond the limits, and how much of lists was touched.

    Parameters
    ----------
    begins : array of int, shape (n + 1,)
        First index of each unknown's list of neighbors.
    workspace : array of int
        The lists, and behind them most_touched + n free entries, or n (n - 1)/2 if less; overwritten. Each step
        writes no more than it touches, and only unknowns that are left: below n, also in the step that ends the count.
    last : float
        Number of additional rows in every column.
    """
    n = begins.size - 1
    begin, size, elements = np.empty(n, np.int64), np.empty(n, np.int64), np.zeros(n, np.int64)
    weight, degree, is_gone = np.ones(n, np.int64), np.empty(n, np.int64), np.zeros(n, np.bool_)
    head, after, before = np.full(n + 1, -1), np.full(n, -1), np.full(n, -1)
    outside, mark, tag = np.zeros(n, np.int64), np.zeros(n, np.int64), 1
    held, key = np.empty(n, np.int64), np.empty(n, np.int64)
    bucket, chain = np.full(n, -1), np.full(n, -1)
    for i in range(n):
        begin[i], size[i] = begins[i], begins[i + 1] - begins[i]
        degree[i] = size[i]
        after[i] = head[degree[i]]
        if after[i] >= 0:
            before[after[i]] = i
        head[degree[i]] = i
    free, left, least, entries, operations, touched = begins[n], n, 0, 0.0, 0.0, 0
    while left > 0:
        while head[least] < 0:
            least += 1
        p = head[least]
        head[least] = after[p]
        if after[p] >= 0:
            before[after[p]] = -1
        # The neighbors of p make a new element of it.
        tag += 1
        together, reached, start = weight[p], 0, free
        weight[p] = 0
        for k in range(begin[p], begin[p] + size[p]):
            e = workspace[k]
            is_element = k < begin[p] + elements[p]
            if is_element and is_gone[e]:
                continue
            first, end = (begin[e], begin[e] + size[e]) if is_element else (k, k + 1)
            touched += end - first
            for m in range(first, end):
                i = workspace[m]
                if weight[i] > 0 and mark[i] != tag:
                    mark[i] = tag
                    workspace[free] = i
                    free += 1
                    reached += weight[i]
                    if before[i] >= 0:
                        after[before[i]] = after[i]
                    else:
                        head[degree[i]] = after[i]
                    if after[i] >= 0:
                        before[after[i]] = before[i]
            if is_element:
                is_gone[e] = True
        # How much of each element near them lies outside of the new element.
        base = tag * (2 * n + 2)
        for m in range(start, free):
            i = workspace[m]
            touched += size[i]
            for k in range(begin[i], begin[i] + elements[i]):
                e = workspace[k]
                if not is_gone[e]:
                    start_of = outside[e] if outside[e] >= base else base + degree[e]
                    outside[e] = start_of - weight[i]
        # Remove the members of the new element from the lists of its neighbors.
        for m in range(start, free):
            i = workspace[m]
            count, near, total, sum_of = 0, 0, 0, p
            for k in range(begin[i], begin[i] + elements[i]):
                e = workspace[k]
                if is_gone[e]:
                    continue
                if outside[e] == base:
                    is_gone[e] = True
                    continue
                held[count] = e
                count, total, sum_of = count + 1, total + outside[e] - base, sum_of + e
            near = count
            for k in range(begin[i] + elements[i], begin[i] + size[i]):
                j = workspace[k]
                if weight[j] > 0 and mark[j] != tag:
                    held[count] = j
                    count, total, sum_of = count + 1, total + weight[j], sum_of + j
            if count == 0:  # without other neighbors: eliminated with p
                together, reached = together + weight[i], reached - weight[i]
                weight[i] = 0
                continue
            workspace[begin[i]] = p
            for k in range(count):
                workspace[begin[i] + 1 + k] = held[k]
            size[i], elements[i] = count + 1, near + 1
            degree[i] = min(degree[i], total)
            key[i] = sum_of % n
            chain[i], bucket[key[i]] = bucket[key[i]], i
        # Unknowns with the same neighbors are merged.
        for m in range(start, free):
            i = workspace[m]
            if weight[i] == 0 or bucket[key[i]] < 0:
                continue
            i, bucket[key[i]] = bucket[key[i]], -1
            while i >= 0:
                if weight[i] > 0 and chain[i] >= 0:
                    tag += 1
                    for k in range(begin[i] + 1, begin[i] + size[i]):
                        mark[workspace[k]] = tag
                    j = chain[i]
                    while j >= 0:
                        is_same = weight[j] > 0 and size[j] == size[i]
                        if is_same and elements[j] == elements[i]:
                            for k in range(begin[j] + 1, begin[j] + size[j]):
                                if mark[workspace[k]] != tag:
                                    is_same = False
                                    break
                        if is_same:
                            weight[i] += weight[j]
                            weight[j] = 0
                        j = chain[j]
                i = chain[i]
        # The new element, and the degrees of its unknowns.
        begin[p], elements[p] = start, 0
        left -= together
        kept = start
        for m in range(start, free):
            i = workspace[m]
            if weight[i] == 0:
                continue
            degree[i] = max(min(degree[i] + reached - weight[i], left - weight[i]), 0)
            after[i], before[i] = head[degree[i]], -1
            if after[i] >= 0:
                before[after[i]] = i
            head[degree[i]] = i
            least = min(least, degree[i])
            workspace[kept] = i
            kept += 1
        free, size[p], degree[p] = kept, kept - start, reached
        if kept == start:
            is_gone[p] = True
        for k in range(together):
            height = reached + together - k + last
            entries, operations = entries + height, operations + height * height
        if entries > most_entries or operations > most_operations or touched > most_touched:
            return np.inf, np.inf, touched
    return entries, operations, touched
