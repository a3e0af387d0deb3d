"""Compiled row sums with proved bounds of their rounding errors, for plain arrays.

`rounding` describes the method. For speed, a product is split by one fused multiply–add, loops have no branches,
and no sum meets a subnormal number where none was given.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from .compilation import (
    float64,
    helper,
    inline,
    kernel,
    lower_builtin,
    type_callable,
    uintp,
)
from .floats import EPSILON, TINY

MAY_UNDERFLOW = 2.0**-960  # the rounding error of a larger product is a double


def multiply_add(a: Any, b: Any, c: Any) -> Any:
    """Return a b + c, rounded once; only kernels call it."""
    raise NotImplementedError


@type_callable(multiply_add)
def _fused_type(context):  # type: ignore[no-untyped-def]
    return lambda a, b, c: float64


@lower_builtin(multiply_add, float64, float64, float64)  # type: ignore[no-untyped-call]
def _fused_code(context, builder, signature, arguments):  # type: ignore[no-untyped-def]
    """Emit one instruction, or a call of the C library."""
    return builder.fma(*arguments)


@inline
def split_sum(a, b):  # type: ignore[no-untyped-def]
    """Return (s, e): s is a + b rounded, and s + e = a + b exactly."""
    s = a + b
    t = s - a
    return s, (a - (s - t)) + (b - t)


@helper
def _underflow(indices, data, x, first, end):  # type: ignore[no-untyped-def]
    """Return a bound of the underflow errors in the products of a row and in their rounding errors."""
    lost = 0.0
    for k in range(first, end):
        a, b = data[k], x[uintp(indices[k])]
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
        one = uintp(1)
        for i in range(uintp(high.size)):
            first, end = uintp(indptr[i]), uintp(indptr[i + one])
            total, errors, lost, is_small = q[i], 0.0, 0.0, False
            for k in range(first, end):
                j = uintp(indices[k])
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
                radius[i] += _underflow(indices, data, x, first, end)

    return row_sums


row_sums = summing_rows(False)
