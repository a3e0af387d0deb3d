"""Compiled sums of least squares: products with proved errors, and how optimal a point is.

Each is a kernel, and a part of the kernel of small problems, which does its work in arrays of its own.
"""

from __future__ import annotations

import math

import numpy as np

from ...core.kernels.compilation import compiled, compiled_into_others, compiled_part
from ...core.kernels.floats import EPSILON, TINY, UNIT

OUTWARD = 1.0 + 2.0**-30  # more than what rounds in a sum of 2²⁰ terms of one sign, or a few operations
LARGEST_EXPONENT = 500


def _along_rows(A, v, slip, sums):  # type: ignore[no-untyped-def]
    """Write the rows A v, |A||v|, |A| slip, and 1 where a term of them is not 0, underflow or not; A by rows."""
    m, n = A.shape
    last = n - n % 4
    for i in range(m):
        a = b = c = d = p = q = r = s = 0.0
        for j in range(0, last, 4):
            e, f, g, h = A[i, j] * v[j], A[i, j + 1] * v[j + 1], A[i, j + 2] * v[j + 2], A[i, j + 3] * v[j + 3]
            a, b, c, d = a + e, b + f, c + g, d + h
            p, q, r, s = p + abs(e), q + abs(f), r + abs(g), s + abs(h)
        for j in range(last, n):
            e = A[i, j] * v[j]
            a, p = a + e, p + abs(e)
        sums[2, i] = 0.0
        for j in range(slip.size):
            sums[2, i] += abs(A[i, j]) * slip[j]
        sums[0, i], sums[1, i] = (a + b) + (c + d), (p + q) + (r + s)
        sums[3, i] = sums[1, i] > 0.0 or _has_term(A[i], v, slip)


def _down_columns(A, v, slip, sums):  # type: ignore[no-untyped-def]
    """Write the same for Aᵀ, A by rows."""
    m, n = A.shape
    value, size, spread = sums[0], sums[1], sums[2]
    for j in range(n):
        value[j] = size[j] = spread[j] = 0.0
    for i in range(m):
        for j in range(n):
            term = A[i, j] * v[i]
            value[j] += term
            size[j] += abs(term)
    for i in range(slip.size):
        for j in range(n):
            spread[j] += abs(A[i, j]) * slip[i]
    for j in range(n):
        sums[3, j] = size[j] > 0.0 or _has_term(A[:, j], v, slip)


@compiled_into_others
def _has_term(row, v, slip):  # type: ignore[no-untyped-def]
    has_some = False
    for j in range(row.size):
        has_some |= row[j] != 0.0 and (v[j] != 0.0 or (slip.size > 0 and slip[j] != 0.0))
    return has_some


def _largest_residuals(gradient, radius, x, lower, upper, l1, scales, is_enclosed):  # type: ignore[no-untyped-def]
    """Return ‖x − mid(lower, upper, prox(x − g))‖∞, that in units of columns, and if all are at most twice the radius.

    prox moves by l1 towards 0, but not beyond. They are those of any g within the radius of the gradient, rounded
    upwards, where that encloses it.
    """
    plain = scaled = 0.0
    is_at_floor = True
    for j in range(x.size):
        below, above = x[j] - upper[j], x[j] - lower[j]
        left, right = gradient[j] - l1[j], gradient[j] + l1[j]
        one = abs(min(max(min(max(x[j], left), right), below), above))
        moved = min(max(x[j] * scales[j], left / scales[j]), right / scales[j])
        two = abs(min(max(moved, below * scales[j]), above * scales[j]))
        off = (radius[j] if is_enclosed else 0.0) + (np.nan if math.isnan(gradient[j]) else 0.0)
        of_plain, of_scaled = OUTWARD * (one + off), OUTWARD * (two + off / scales[j])
        plain = max(plain, of_plain) if of_plain < np.inf else np.inf  # what is not a number is no proof either
        scaled = max(scaled, of_scaled) if of_scaled < np.inf else np.inf
        is_at_floor = is_at_floor and max(one, two * scales[j]) <= 2.0 * radius[j]
    return plain, scaled, is_at_floor


def _gap_beside_cost(  # type: ignore[no-untyped-def]
    residual, slip, y, slope, radius, x, lower, upper, l1, root, scales, ridge, convexity, rounding
):
    """Return the bound of `problems.least_squares.certificate` of a cost less the least, and the cost of y.

    In units, returned. l1 Σ|x| slants by ±l1 on the two sides of 0.

    Residual and slope are known up to slip and radius: those are added where `rounding` is 1, excused where it is −1.
    Without a convexity, shape (n,) or (0,), it is the ridge.
    """
    size = 0.0
    for i in range(y.size):
        size = max(size, root[i] * abs(y[i]), root[i] * abs(residual[i] - y[i]))
    for j in range(x.size):
        size = max(size, math.sqrt(ridge) * abs(x[j]), math.sqrt(l1[j]) * math.sqrt(abs(x[j])))
    size = power_above(size)
    gap = cost = 0.0
    for i in range(y.size):
        off, part = max(abs(residual[i] - y[i]) + rounding * slip[i], 0.0) * root[i] / size, root[i] * y[i] / size
        gap, cost = gap + 0.5 * off * off, cost + 0.5 * part * part
    for j in range(x.size):
        part, unit, share = math.sqrt(ridge) * x[j] / size, scales[j] * size, scales[j] / size
        cost += 0.5 * part * part + (l1[j] / unit) * (abs(x[j]) * share)
        curved = (convexity[j] if convexity.size > 0 else ridge) / scales[j] / scales[j]
        s, off = slope[j], rounding * radius[j]
        if l1[j] == 0.0:
            linear = _fall(s, x[j] - lower[j], off, unit, share) + _fall(-s, upper[j] - x[j], off, unit, share)
            least = abs(s)
        else:
            linear = 0.0
            for sign in (1.0, -1.0):  # the two sides of 0
                slant, at = s + sign * l1[j], max(sign * x[j], 0.0)
                near, far = (lower[j], upper[j]) if sign > 0.0 else (-upper[j], -lower[j])
                linear += _fall(sign * slant, at - max(near, 0.0), off, unit, share)
                linear += _fall(-sign * slant, max(far, 0.0) - at, off, unit, share)
            least = abs(s + math.copysign(l1[j], x[j])) if x[j] != 0.0 else max(abs(s) - l1[j], 0.0)
        steepest = (least + off) / unit
        if linear > 0.0 and curved > 0.0:
            linear = min(linear, steepest * steepest / (2.0 * curved) + TINY)
        gap += linear
    for j in range(x.size):
        gap += 0.0 * (slope[j] + radius[j])  # NaN where one is not finite
    return (OUTWARD * OUTWARD * gap if gap < np.inf else np.inf), cost, size


@compiled_into_others
def _fall(slant, slack, off, unit, share):  # type: ignore[no-untyped-def]
    """Return by how much the cost falls at the most over the slack, in units, at a slant known up to `off`."""
    steep = (slant + off) / unit
    return steep * (slack * share) + TINY if steep > 0.0 and slack > 0.0 else 0.0


@compiled_into_others
def power_above(size):  # type: ignore[no-untyped-def]
    """Return the power of two just above a size, within what can be multiplied by; 1 for 0."""
    if not size > 0.0:
        return 1.0
    return math.ldexp(1.0, min(max(math.frexp(size)[1], -LARGEST_EXPONENT), LARGEST_EXPONENT))


def _raise_to_largest(largest, A, root):  # type: ignore[no-untyped-def]
    """Raise `largest` to the largest entries of the columns of diag(root) A, A by rows."""
    for i in range(A.shape[0]):
        for j in range(A.shape[1]):
            largest[j] = max(largest[j], abs(A[i, j] * root[i]))


def _add_squares(squares, A, root, scales, inverse):  # type: ignore[no-untyped-def]
    """Add the squares of the columns of diag(root) A, by these scales, powers of two, A by rows; write the inverse."""
    for j in range(scales.size):
        inverse[j] = 1.0 / scales[j]
    for i in range(A.shape[0]):
        for j in range(A.shape[1]):
            part = A[i, j] * root[i] * inverse[j]
            squares[j] += part * part


def _radii(sums, terms, radius):  # type: ignore[no-untyped-def]
    """Write to `radius` by how much rounding, and slip, may have moved such sums of so many terms."""
    k = (2 * terms + 8) * UNIT
    for j in range(radius.size):
        rounding = k / (1.0 - k) * (1.0 + 8.0 * UNIT) * (sums[1, j] + sums[2, j])
        radius[j] = rounding + OUTWARD * sums[2, j] + (terms + 1) * TINY * (sums[3, j] > 0.0)


def _with_ridge(value, radius, ridge, x):  # type: ignore[no-untyped-def]
    """Add ridge x to a value, and what that rounds to its radius."""
    if ridge > 0.0:
        for j in range(x.size):
            value[j] += ridge * x[j]
            slip = 4.0 * EPSILON * (abs(value[j]) + ridge * abs(x[j])) + TINY * (x[j] != 0.0)
            radius[j] = OUTWARD * (radius[j] + slip)


along_rows, down_columns, largest_residuals, radii, with_ridge, raise_to_largest, add_squares = map(compiled, (
    _along_rows, _down_columns, _largest_residuals, _radii, _with_ridge, _raise_to_largest, _add_squares,
))
gap_beside_cost = compiled(_gap_beside_cost)
part_of_rows, part_of_columns, part_of_gap, part_of_radii, part_of_ridge, part_of_largest, part_of_squares = map(
    compiled_part,
    (_along_rows, _down_columns, _gap_beside_cost, _radii, _with_ridge, _raise_to_largest, _add_squares),
)
