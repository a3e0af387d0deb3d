"""Contacts with friction pyramids by their rows, and M for the unknowns of these alone.

The rows are those of :mod:`lcp_plugin.problems.contact`, in its order: normal impulses p of all k contacts, impulses β
of m edges contact by contact, the first half of them d, the second −d, and speeds λ of all, which alone have zeros on
the diagonal. Units may differ from 1. The unknowns are p and f = β₊ − β₋ of each pair of edges, half of the rows.
Arrays as in :mod:`.contact_systems`.
"""

from __future__ import annotations

import numpy as np

from ....core.kernels.compilation import helper, inlined
from .contact_systems import CONE, FREELY, OF_CONES, ROW, SLOPE, STATUS, STEP
from .workspace import LOWER, UPPER, Q

ALIKE = 1e-9  # how far d and −d may differ, of the largest entry


@helper
def read_contacts(M, k, real, whole):  # type: ignore[no-untyped-def]
    """Note the contacts of a problem; return (unknowns, contacts), 0 where M, q or the bounds are of another form."""
    n, contacts = M.shape[1], 0
    while contacts < n and M[k, n - 1 - contacts, n - 1 - contacts] == 0.0:
        contacts += 1
    half = n // (2 * contacts) - 1 if contacts > 0 else 0
    if half < 1 or contacts * (2 * half + 2) != n:
        return 0, 0
    for i in range(n):
        if real[LOWER, i] != 0.0 or real[UPPER, i] != np.inf or (M[k, i, i] == 0.0) != (i >= n - contacts):
            return 0, 0
    for c in range(contacts):
        first, speed = contacts + 2 * half * c, n - contacts + c
        slope = M[k, speed, c]
        if slope < 0.0 or real[Q, speed] != 0.0:
            return 0, 0
        for j in range(n):
            is_edge = first <= j < first + 2 * half
            if (M[k, j, speed] > 0.0) != is_edge or (M[k, speed, j] < 0.0) != is_edge:
                return 0, 0
            if not is_edge and (M[k, j, speed] != 0.0 or (M[k, speed, j] != 0.0 and j != c)):
                return 0, 0
        place = contacts + half * c
        whole[OF_CONES, 2 * c], whole[OF_CONES, 2 * c + 1] = speed, place
        whole[ROW, c], whole[CONE, c], real[SLOPE, c] = c, c if slope > 0.0 else -1, slope
        for i in range(first, first + half):
            if not _are_opposite(M, k, real, speed, i, i + half):
                return 0, 0
            whole[ROW, place], whole[ROW, n + 1 + place] = i, i + half
            whole[STATUS, place] = 0  # where there is no friction, no round says that it does not stick
            real[SLOPE, place], real[STEP, place] = -1.0 / M[k, speed, i], 1.0 / M[k, i, speed]
            place += 1
    whole[OF_CONES, 2 * contacts + 1] = n // 2  # behind the last one
    return n // 2, contacts


@inlined
def _are_opposite(M, k, real, speed, i, j):  # type: ignore[no-untyped-def]
    """Return whether edges i = d and j = −d are in one unit and opposite, by q and what both do to one another."""
    if M[k, speed, j] != M[k, speed, i] or M[k, j, speed] != M[k, i, speed]:
        return False
    largest, difference = max(abs(M[k, i, i]), abs(M[k, j, j])), abs(real[Q, i] + real[Q, j])
    is_like = difference <= ALIKE * max(abs(real[Q, i]), abs(real[Q, j]))
    for other in (i, j):
        is_like &= abs(M[k, i, other] + M[k, j, other]) <= ALIKE * largest
        is_like &= abs(M[k, other, i] + M[k, other, j]) <= ALIKE * largest
    return is_like


@helper
def condense(M, k, real, whole, matrix, unknowns, cones):  # type: ignore[no-untyped-def]
    """Write G, velocities by x, transposed, into the rows of `matrix` from `unknowns` on; FREELY and STEP."""
    plain = whole[OF_CONES, 1]
    for i in range(unknowns):
        row, unit = whole[ROW, i], real[STEP, i] if i >= plain else 1.0
        real[FREELY, i] = real[Q, row] * unit
        for j in range(plain):
            matrix[unknowns + j, i] = M[k, row, whole[ROW, j]] * unit
        for j in range(plain, unknowns):
            matrix[unknowns + j, i] = M[k, row, whole[ROW, j]] * real[SLOPE, j] * unit
    for i in range(plain):
        real[STEP, i] = 1.0 / matrix[unknowns + i, i]
    for c in range(cones):
        first, end = whole[OF_CONES, 2 * c + 1], whole[OF_CONES, 2 * c + 3]
        largest = 0.0
        for i in range(first, end):
            total = 0.0
            for j in range(first, end):
                total += abs(matrix[unknowns + j, i])
            largest = max(largest, total)
        for i in range(first, end):
            real[STEP, i] = 1.0 / largest
