"""Compiled row sums with proved bounds of their rounding errors, for plain arrays.

`rounding` describes the method. For speed, a product is split by one fused multiply–add, loops have no branches,
and no sum meets a subnormal number where none was given.
"""

from __future__ import annotations

import math
from contextlib import suppress
from fractions import Fraction
from typing import Any

import numpy as np

from .compilation import (
    float64,
    helper,
    inline,
    kernel,
    lower_builtin,
    type_callable,
    types,
    uintp,
)
from .floats import EPSILON, LARGEST, TINY, UNIT
from .rows import clamp

MAY_UNDERFLOW = 2.0**-960  # the rounding error of a larger product is a double
ROUNDINGS = 2.0**-50  # of a few operations


def multiply_add(a: Any, b: Any, c: Any) -> Any:
    """Return a b + c, rounded once."""
    if math.isfinite(a) and math.isfinite(b) and not math.isinf(c):
        with suppress(OverflowError, ValueError):  # the latter where c is not a number
            exact = Fraction(float(a)) * Fraction(float(b)) + Fraction(float(c))
            return np.float64(exact) if exact != 0 else a * b + c
        return np.float64(np.inf if exact > 0 else -np.inf) if c == c else c
    return c if math.isfinite(a) and math.isfinite(b) else a * b + c


@type_callable(multiply_add)
def _fused_type(context):  # type: ignore[no-untyped-def]
    return lambda a, b, c: float64


@lower_builtin(multiply_add, float64, float64, float64)  # type: ignore[no-untyped-call]
def _fused_code(context, builder, signature, arguments):  # type: ignore[no-untyped-def]
    """Emit one instruction, or a call of the C library."""
    return builder.fma(*arguments)


def to_unsigned(value: Any) -> int:
    """Return an index that is known not to be negative: a Python integer where kernels are interpreted."""
    return int(value)


@type_callable(to_unsigned)
def _unsigned_type(context):  # type: ignore[no-untyped-def]
    return lambda value: uintp


@lower_builtin(to_unsigned, types.Integer)  # type: ignore[no-untyped-call]
def _unsigned_code(context, builder, signature, arguments):  # type: ignore[no-untyped-def]
    return context.cast(builder, arguments[0], signature.args[0], signature.return_type)


@inline
def split_sum(a, b):  # type: ignore[no-untyped-def]
    """Return (s, e): s is a + b rounded, and s + e = a + b exactly."""
    s = a + b
    t = s - a
    return s, (a - (s - t)) + (b - t)


@helper
def _underflow(indices, data, x, first, end, shift):  # type: ignore[no-untyped-def]
    """Return a bound of the underflow errors in the products of a row and in their rounding errors."""
    lost = 0.0
    for k in range(first, end):
        a, b = data[k], x[to_unsigned(indices[k - shift])]
        h = a * b
        if abs(h) < MAY_UNDERFLOW and a != 0.0 and b != 0.0:
            small, other = (a, b) if abs(a) < abs(b) else (b, a)
            small *= 2.0**960  # exactly, and large enough to show an error
            scaled = small * other
            is_exact = (
                scaled == h * 2.0**960
                and abs(scaled) > MAY_UNDERFLOW
                and multiply_add(small, other, -scaled) == 0.0
            )
            lost += 0.0 if is_exact else 4.0 * TINY
    return lost


def summing_rows(comparison: bool) -> Any:
    """Return the kernel that sums the rows of M x + q, or of ⟨M⟩x + q, as high + low ± radius."""

    @kernel
    def row_sums(indptr, indices, data, x, q, high, low, radius):  # type: ignore[no-untyped-def]
        """Sum the rounded terms, their rounding errors, and the loss of the second sum."""
        one = to_unsigned(1)
        for i in range(to_unsigned(high.size)):
            first, end = to_unsigned(indptr[i]), to_unsigned(indptr[i + one])
            total, errors, lost, is_small = q[i], 0.0, 0.0, False
            for k in range(first, end):
                j = to_unsigned(indices[k])
                a, b = data[k], x[j]
                if comparison:
                    a = abs(a) if i == j else -abs(a)
                h = a * b
                is_small |= (abs(h) < MAY_UNDERFLOW) & (b != 0.0)
                total, f = split_sum(total, h)
                s, t = split_sum(multiply_add(a, b, -h), f)
                errors, u = split_sum(errors, s)
                lost += abs(t) + abs(u)
            high[i], low[i] = split_sum(total, errors)
            # `lost` was itself rounded at most 2k times.
            radius[i] = lost * (1.0 + (4.0 * (end - first) + 8.0) * EPSILON)
            if not (abs(high[i]) < np.inf and abs(errors) < np.inf and lost < np.inf):
                low[i], radius[i] = 0.0, np.inf
            elif is_small:
                radius[i] += _underflow(indices, data, x, first, end, to_unsigned(0))

    return row_sums


row_sums = summing_rows(False)


@inline
def row_ends(slack, slip, scale, z, lower, upper):  # type: ignore[no-untyped-def]
    """Return bounds of |mid(z − upper, z − lower, w / scale)| for any w in slack ± slip.

    The rounding of the quotient, which cancellation may uncover, and its underflow are added to the slip. Differences
    never underflow: their error is one rounding, by which mid, monotone in each difference, is widened. Exact values
    remain exact. A quotient that overflows is ±∞, because no bound of a row is larger.
    """
    step, (below, lost_below), (above, lost_above) = (
        slack / scale,
        split_sum(z, -upper),
        split_sum(z, -lower),
    )
    is_exact = (
        (slip == 0.0)
        & (multiply_add(step, scale, -slack) == 0.0)
        & ((abs(slack) > MAY_UNDERFLOW) | (slack == 0.0))
    )
    size = abs(step) if abs(step) < LARGEST else LARGEST
    slip = 0.0 if is_exact else (slip / scale + size * UNIT) * (1.0 + ROUNDINGS) + 4.0 * TINY
    bottom, top = clamp(step - slip, below, above), clamp(step + slip, below, above)
    is_finite = (abs(slack) < np.inf) & (slip < np.inf) & (abs(z) < np.inf)
    least = bottom if bottom > -top else -top
    most = top if top > -bottom else -bottom
    is_rounded = (slip > 0.0) | (abs(lost_below) > 0.0) | (abs(lost_above) > 0.0)
    wider = ROUNDINGS if is_rounded else 0.0
    least = least * (1.0 - wider) if is_finite & (least > 0.0) else 0.0
    return least, abs(most) * (1.0 + wider) if is_finite else np.inf  # no −0
