"""Friction pyramids in a matrix: its rows as contacts, and its entries for the unknowns of these alone.

Of n rows in any order, read are those of :mod:`lcp_plugin.problems.contact`: a row with a zero on the diagonal
holds a radius μ p less the impulses β of its edges, and its column lets a speed λ into theirs; both units may differ
from 1. Edges come as d, −d. Unknowns are the normal impulses p, those of rows without friction, too, and
f = β₊ − β₋ of each pair of edges. Arrays as in :mod:`.contact_systems`.
"""

from __future__ import annotations

import numpy as np

from ....core.kernels.compilation import compiled_into_others, compiled_part
from .contact_systems import CONE, FREELY, OF_CONES, ROW, SLOPE, SOLVED_FOR, STATUS, STEP
from .workspace import LOWER, UPPER, Q

ALIKE = 1e-9  # how far d and −d may differ, of the largest entry


@compiled_part
def read_pyramids(M, k, real, whole):  # type: ignore[no-untyped-def]
    """Note the contacts of a problem; return (unknowns, cones), 0 where M or the bounds are of another form."""
    n = M.shape[1]
    cones, edges = 0, 0
    for i in range(n):
        whole[STATUS, i] = -1
        if real[LOWER, i] != 0.0 or real[UPPER, i] != np.inf:
            return 0, 0
    for i in range(n):
        if M[k, i, i] != 0.0:
            continue
        radius, own, entering = -1, 0, 0
        for j in range(n):
            if M[k, i, j] > 0.0:
                if radius >= 0:
                    return 0, 0
                radius = j
            elif M[k, i, j] < 0.0:
                if not M[k, j, i] > 0.0 or whole[STATUS, j] >= 0 or M[k, j, j] == 0.0:
                    return 0, 0
                whole[STATUS, j] = cones
                own += 1
            entering += M[k, j, i] != 0.0
        if own == 0 or own % 2 or entering != own or real[Q, i] != 0.0:
            return 0, 0
        whole[OF_CONES, 2 * cones], whole[OF_CONES, 2 * cones + 1] = i, radius
        cones, edges = cones + 1, edges + own
    plain = n - edges - cones
    if cones == 0 or 2 * (plain + edges // 2) > n:
        return 0, 0
    return _numbered(M, k, real, whole, n, plain, cones), cones


@compiled_into_others
def _numbered(M, k, real, whole, n, plain, cones):  # type: ignore[no-untyped-def]
    """Give unknowns their places, normal impulses first, then pairs of edges; return how many, 0 where none fit."""
    count = 0
    for i in range(n):
        if whole[STATUS, i] < 0 and M[k, i, i] != 0.0:
            whole[SOLVED_FOR, i] = count
            whole[ROW, count], whole[CONE, count], real[SLOPE, count] = i, -1, 0.0
            count += 1
    if count != plain:
        return 0
    for c in range(cones):
        steepest, radius = whole[OF_CONES, 2 * c], whole[OF_CONES, 2 * c + 1]
        whole[OF_CONES, 2 * c + 1] = count
        if radius >= 0:
            if whole[STATUS, radius] >= 0:
                return 0
            normal = whole[SOLVED_FOR, radius]
            if whole[CONE, normal] >= 0:
                return 0
            whole[CONE, normal], real[SLOPE, normal] = c, M[k, steepest, radius]
        for i in range(n):
            if M[k, steepest, i] < 0.0 and whole[STATUS, i] == c:
                other = _opposite(M, k, real, whole, n, steepest, c, i)
                if other < 0:
                    return 0
                whole[STATUS, i] = whole[STATUS, other] = cones + 1  # taken
                whole[ROW, count], whole[ROW, n + 1 + count] = i, other
                real[SLOPE, count], real[STEP, count] = -1.0 / M[k, steepest, i], 1.0 / M[k, i, steepest]
                count += 1
    whole[OF_CONES, 2 * cones + 1] = count  # behind the last one
    return count


@compiled_into_others
def _opposite(M, k, real, whole, n, steepest, c, i):  # type: ignore[no-untyped-def]
    """Return the edge −d of edge i = d, by what both do in their own contact; −1 where there is none."""
    for j in range(i + 1, n):
        if whole[STATUS, j] != c or M[k, steepest, j] != M[k, steepest, i] or M[k, j, steepest] != M[k, i, steepest]:
            continue
        largest, difference = max(abs(M[k, i, i]), abs(M[k, j, j])), abs(real[Q, i] + real[Q, j])
        is_like = difference <= ALIKE * max(abs(real[Q, i]), abs(real[Q, j]))
        for other in (i, j):
            is_like &= abs(M[k, i, other] + M[k, j, other]) <= ALIKE * largest
            is_like &= abs(M[k, other, i] + M[k, other, j]) <= ALIKE * largest
        if is_like:
            return j
    return -1


@compiled_part
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
