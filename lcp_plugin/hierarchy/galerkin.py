"""The matrix of the coarser grid, PᵀMP, and its truncation; compiled, arrays only.

Truncation to a set of free unknowns zeroes the rows of P of all others. A row of the coarse matrix then changes only
where it meets an unknown that became free or fixed, or a changed row of the finer matrix: only those rows are
computed again.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from ..kernels import compiled


@compiled
def transposed(columns, indptr, indices, data):  # type: ignore[no-untyped-def]
    """Return the transpose in CSR; its rows are sorted."""
    t_indptr = np.zeros(columns + 1, indptr.dtype)
    for k in range(indices.size):
        t_indptr[indices[k] + 1] += 1
    for j in range(columns):
        t_indptr[j + 1] += t_indptr[j]
    t_indices = np.empty_like(indices)
    t_data = np.empty_like(data)
    place = t_indptr[:-1].copy()
    for i in range(indptr.size - 1):
        for k in range(indptr[i], indptr[i + 1]):
            p = place[indices[k]]
            t_indices[p] = i
            t_data[p] = data[k]
            place[indices[k]] = p + 1
    return t_indptr, t_indices, t_data


@njit(inline="always")
def _sort_row(indices, data, begin, end):  # type: ignore[no-untyped-def]
    """Insertion sort: the rows are short."""
    for a in range(begin + 1, end):
        column, value = indices[a], data[a]
        b = a
        while b > begin and indices[b - 1] > column:
            indices[b] = indices[b - 1]
            data[b] = data[b - 1]
            b -= 1
        indices[b] = column
        data[b] = value


@compiled
def galerkin_product(  # type: ignore[no-untyped-def]
    indptr, indices, data, p_indptr, p_indices, p_data, r_indptr, r_indices, r_data
):
    """Return R M P in CSR with sorted rows and every diagonal entry stored, and the number of products it took."""
    n = r_indptr.size - 1
    room = indices.size + n
    c_indptr = np.empty(n + 1, indptr.dtype)
    c_indices = np.empty(room, indices.dtype)
    c_data = np.empty(room)
    where = np.full(n, -1, np.int64)
    size = 0
    products = 0
    for row in range(n):
        begin = size
        c_indptr[row] = begin
        if room - size < n and room - size < 65536:
            room *= 2
            larger_indices = np.empty(room, indices.dtype)
            larger_data = np.empty(room)
            larger_indices[:size] = c_indices[:size]
            larger_data[:size] = c_data[:size]
            c_indices, c_data = larger_indices, larger_data
        where[row] = size
        c_indices[size] = row
        c_data[size] = 0.0
        size += 1
        for a in range(r_indptr[row], r_indptr[row + 1]):
            i = r_indices[a]
            for b in range(indptr[i], indptr[i + 1]):
                k = indices[b]
                value = r_data[a] * data[b]
                products += p_indptr[k + 1] - p_indptr[k]
                for c in range(p_indptr[k], p_indptr[k + 1]):
                    column = p_indices[c]
                    place = where[column]
                    if place < begin:
                        where[column] = size
                        c_indices[size] = column
                        c_data[size] = value * p_data[c]
                        size += 1
                    else:
                        c_data[place] += value * p_data[c]
        _sort_row(c_indices, c_data, begin, size)
    c_indptr[n] = size
    return c_indptr, c_indices[:size].copy(), c_data[:size].copy(), products


@compiled
def mark_rows(indptr, indices, is_free_changed, is_row_changed, touched):  # type: ignore[no-untyped-def]
    """Mark the rows whose contribution to the coarse matrix changed."""
    for i in range(indptr.size - 1):
        touched[i] = is_free_changed[i] or is_row_changed[i]
        if not touched[i]:
            for k in range(indptr[i], indptr[i + 1]):
                if is_free_changed[indices[k]]:
                    touched[i] = True
                    break


@compiled
def update_product(  # type: ignore[no-untyped-def]
    indptr, indices, data, is_free, touched, p_indptr, p_indices, p_data, r_indptr, r_indices, r_data,
    c_indptr, c_indices, c_data, c_diagonal, c_inverse, c_is_free, c_free_changed, c_row_changed,
):
    """Compute the coarse rows again that meet a touched row; return the number of products it took.

    A coarse unknown all of whose fine ones are fixed, or whose pivot is not positive, is fixed itself.
    """
    n = r_indptr.size - 1
    where = np.empty(n, np.int64)
    products = 0
    for row in range(n):
        is_changed = False
        for a in range(r_indptr[row], r_indptr[row + 1]):
            if touched[r_indices[a]]:
                is_changed = True
                break
        c_free_changed[row] = False
        c_row_changed[row] = is_changed
        if not is_changed:
            continue
        for c in range(c_indptr[row], c_indptr[row + 1]):
            where[c_indices[c]] = c
            c_data[c] = 0.0
        for a in range(r_indptr[row], r_indptr[row + 1]):
            i = r_indices[a]
            if not is_free[i]:
                continue
            for b in range(indptr[i], indptr[i + 1]):
                k = indices[b]
                if not is_free[k]:
                    continue
                value = r_data[a] * data[b]
                products += p_indptr[k + 1] - p_indptr[k]
                for c in range(p_indptr[k], p_indptr[k + 1]):
                    c_data[where[p_indices[c]]] += value * p_data[c]
        pivot = c_data[c_diagonal[row]]
        free = pivot > 0.0
        c_inverse[row] = 1.0 / pivot if free else 0.0
        c_free_changed[row] = free != c_is_free[row]
        c_is_free[row] = free
    return products
