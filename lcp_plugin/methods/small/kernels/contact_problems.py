"""Small problems of contact with friction pyramids, from data to enclosed answer in one compiled call."""

from __future__ import annotations

import numpy as np

from ....core.kernels.compilation import kernel
from .contact_rounds import solve_contacts
from .friction_pyramids import condense, read_contacts
from .small_problems import ROUND, TOTAL, USUAL, enclosed, ends, is_kept_dense, look_at, moved, take
from .workspace import FOUND, LOWER, UPPER, Q, Z


@kernel
def count_contacts(M, real, whole):  # type: ignore[no-untyped-def]
    """Return how many contacts M, shape (1, n, n), has rows of, 0 where it is of another form; q counts as 0."""
    for i in range(M.shape[1]):
        real[Q, i], real[LOWER, i], real[UPPER, i] = 0.0, 0.0, np.inf
    return read_contacts(M, 0, real, whole)[1]


@kernel
def solve_all_contacts(  # type: ignore[no-untyped-def]
    M, q, lower, upper, starts, tolerance, first, end, real, whole, matrix, z, residual, terms, made, work, needs_path,
):
    """Solve those problems first ≤ item < end of a batch that are of contacts; return how many are left.

    Arrays as in `small_problems.run_all`. Each takes one step, of all sweeps and rounds, or none; nothing is enclosed
    where the tolerance is below 0.
    """
    n, left = M.shape[1], 0
    for item in range(first, end):
        k = item if M.shape[0] > 1 else 0
        residual[item], terms[item], needs_path[item] = np.inf, np.inf, False
        for phase in range(3):
            made[item, phase], work[item, phase] = 0, 0.0
        work[item, TOTAL] = 0.0
        left += 1
        take(q, lower, upper, item, real, n)
        unknowns, contacts = read_contacts(M, k, real, whole)
        if contacts == 0:
            continue
        nonzeros, is_usual, _, _ = look_at(M, k, real)
        is_dense, least, most = is_kept_dense(nonzeros, n), 1.0, 1.0
        if is_usual and tolerance >= 0.0:
            least, most = ends(M, k, real, is_dense)
        if not (is_usual and (tolerance < 0.0 or (least > 0.0 and USUAL[0] < most < USUAL[1]))):
            continue
        is_cold, at = True, item if starts.shape[0] > 1 else 0
        for i in range(n):
            real[FOUND, i] = starts[at, i] if starts.shape[1] > 0 else 0.0
            is_cold &= real[FOUND, i] == 0.0
        if tolerance >= 0.0:
            size = moved(M, k, real, FOUND, False)
            residual[item], terms[item] = enclosed(M, k, real, size, least, most, is_dense, tolerance)
        work[item, ROUND] = n * n / nonzeros
        is_solved = residual[item] <= tolerance and terms[item] <= tolerance
        if not is_solved:
            condense(M, k, real, whole, matrix, unknowns, contacts)
            work[item, ROUND] += solve_contacts(real, whole, matrix, n, unknowns, not is_cold) / nonzeros
            made[item, ROUND] = 1
            size = moved(M, k, real, FOUND, False)
            residual[item], terms[item] = enclosed(M, k, real, size, least, most, is_dense, tolerance)
            is_solved = residual[item] <= tolerance and terms[item] <= tolerance
        if made[item, ROUND] > 0 and tolerance >= 0.0 and not is_solved:
            work[item, ROUND] -= n * n / nonzeros  # who goes on counts the start
        work[item, TOTAL] = work[item, ROUND]
        left -= is_solved
        for i in range(n):
            z[item, i] = real[Z, i]
    return left
