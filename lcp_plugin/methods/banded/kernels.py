"""Contacts of a tridiagonal M with off-diagonal entries ≤ 0, bounded on one side: Cryer's pass, O(n).

The theory is due to Chandrasekaran, the order of the rows to Cryer. With all rows at their bounds, free a row whose w
is negative, then the next: z only rises, so that no free row returns to its bound. Take the rows from first to last,
with all later rows at their bounds. A row that becomes free raises its neighbors on both sides and joins the block of
free rows before it. If w becomes negative in the bound row before this block, that row also becomes free and joins the
next block. A block of free rows depends on the remaining rows only by the two values next to it, and z of its first and
last row is linear in these values. Two blocks and the row between them join by one division. Each row is joined once.
"""

from __future__ import annotations

import numpy as np

from ...core.kernels.compilation import helper, inline, kernel

NEGLIGIBLE_PIVOT = 1e-14  # relative to the diagonal entry; a smaller one makes the block singular
# The first row of no rows is the row to the right, the last row is the row to the left.
EMPTY = 0.0, 0.0, 1.0, 0.0, 1.0, 0.0


@inline
def _join(before, after, a, d, c, q):  # type: ignore[no-untyped-def]
    """Return the block that results from two blocks and the free row between them, and the pivot of this row.

    A block is z of its first and of its last row, each as constant, factor of the left z, and factor of the right z.
    """
    pivot = d - a * before[5] - c * after[1]
    own = (a * before[3] + c * after[0] - q) / pivot
    left, right = a * before[4] / pivot, c * after[2] / pivot
    first = before[0] + before[2] * own, before[1] + before[2] * left, before[2] * right
    last = after[3] + after[4] * own, after[4] * left, after[5] + after[4] * right
    return (first[0], first[1], first[2], last[0], last[1], last[2]), pivot


@helper
def _find_contacts(bands, q, sign, value, is_held, is_free, stops, blocks):  # type: ignore[no-untyped-def]
    """Fill is_free with the rows that are not at their bound in the least z ≥ value with w ≥ 0, complementary.

    Parameters
    ----------
    bands : array, shape (3, n)
        m_{i,i−1}, m_ii and m_{i,i+1}; 0 outside of M.
    q : array, shape (n,)
    sign : float
        1, or −1 for the problem of −z, with −q.
    value : array, shape (n,)
        The bound of each row, −∞ for none.
    is_held : array of flags, shape (n,)
        Rows that stay at their value for any w.
    is_free : array of flags, shape (n,)
    stops, blocks : arrays, shapes (n + 1,) of int64 and (n + 1, 7)
        Workspace: the rows at their bounds so far; the free rows before each, and its w.

    Returns
    -------
    bool
        False if a pivot is negligible or not positive: M is singular or not an M-matrix.
    """
    n = is_free.size
    top, left = 0, 0.0  # number of rows at bounds, and z of the last such row
    block = EMPTY  # the free rows behind it
    for i in range(n):
        a, d, c = -bands[0, i], bands[1, i], -bands[2, i]
        here, after = value[i], value[i + 1] if i + 1 < n else 0.0
        # w without the part of the next row
        w = d * here - a * (block[3] + block[4] * left + block[5] * here) + sign * q[i]
        is_free[i] = (not is_held[i]) and (here == -np.inf or w < c * after)
        if not is_free[i]:
            top += 1
            stops[top], blocks[top, 6], left = i, w, here
            blocks[top, 0], blocks[top, 1], blocks[top, 2] = block[0], block[1], block[2]
            blocks[top, 3], blocks[top, 4], blocks[top, 5] = block[3], block[4], block[5]
            block = EMPTY
            continue
        block, pivot = _join(block, EMPTY, a, d, c, sign * q[i])
        if not pivot > NEGLIGIBLE_PIVOT * d:
            return False
        # a row without bound becomes free next, and the test follows then
        while top > 0 and after > -np.inf:
            k = stops[top]
            a, d, c = -bands[0, k], bands[1, k], -bands[2, k]
            if is_held[k] or not blocks[top, 6] < c * (
                block[0] + block[1] * left + block[2] * after
            ):
                break
            is_free[k] = True
            kept = blocks[top]
            block, pivot = _join(
                (kept[0], kept[1], kept[2], kept[3], kept[4], kept[5]), block, a, d, c, sign * q[k]
            )
            if not pivot > NEGLIGIBLE_PIVOT * d:
                return False
            top -= 1
            left = value[stops[top]] if top > 0 else 0.0
    return True


@helper
def _substitute(bands, q, value, is_free, z, slope):  # type: ignore[no-untyped-def]
    """Fill z with `value` on the rows at their bounds and the solution of w = 0 on the free rows, without pivoting.

    On M-matrices that is backward stable in every entry (Higham, *Accuracy and stability*, SIAM 2002, theorem 9.12).
    """
    n = z.size
    here = factor = 0.0
    for i in range(n):
        if is_free[i]:
            a = -bands[0, i]
            pivot = bands[1, i] - a * factor
            here, factor = (a * here - q[i]) / pivot, -bands[2, i] / pivot
        else:
            here, factor = value[i], 0.0
        z[i], slope[i] = here, factor
    for i in range(n - 2, -1, -1):
        z[i] += slope[i] * z[i + 1]


@kernel
def solve_one_sided(bands, q, sign, value, is_held, is_free, z):  # type: ignore[no-untyped-def]
    """Fill z with the solution, and is_free with the free rows; return whether there is one.

    Parameters
    ----------
    bands : array, shape (3, n)
        m_{i,i−1}, m_ii and m_{i,i+1}; 0 outside of M.
    q : array, shape (n,)
    sign : float
        1 for z ≥ value and w ≥ 0; −1 for z ≤ value and w ≤ 0.
    value : array, shape (n,)
        The bound of each row, ±∞ for none.
    is_held : array of bool, shape (n,)
        Rows that stay at their value for any sign of w.
    is_free : array of bool, shape (n,)
    z : array, shape (n,)

    Returns
    -------
    bool
        False if a pivot is negligible or not positive: M is singular or not an M-matrix.
    """
    n = q.size
    stops, blocks = np.empty(n + 1, np.int64), np.empty((n + 1, 7))
    is_found = _find_contacts(bands, q, sign, sign * value, is_held, is_free, stops, blocks)
    if is_found:
        _substitute(bands, q, value, is_free, z, np.empty(n))
    return is_found
