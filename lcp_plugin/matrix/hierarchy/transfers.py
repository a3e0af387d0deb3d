"""The ways between two grids, and the products and sweeps with the transpose; compiled, arrays only.

`inverse` holds 1/diagonal, and 0 for an unknown that is fixed.
"""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from numba import uintp

from ...checks import BoolVector, FloatVector
from ...kernels.compilation import compiled
from .sweeps import NO_BOUNDS, _plus_products, shared

if TYPE_CHECKING:
    from .grids import Transfer

NO_FLAGS = np.zeros(0, np.bool_)


def restrict(transfer: Transfer, fine: FloatVector, unit: float, coarse: FloatVector) -> None:
    """Coarse ← R fine ÷ unit, a power of two."""
    matrix, factor = transfer.restriction.arrays, transfer.factor / unit
    unused = NO_FLAGS, *NO_BOUNDS[coarse.dtype]
    shared(partial(_interpolate, *matrix, fine, factor, False, *unused, coarse), coarse.size)


def prolong(
    transfer: Transfer, coarse: FloatVector, unit: float, is_free: BoolVector, lower: FloatVector, upper: FloatVector,
    z: FloatVector,
) -> int:
    """Overwrite z by mid(lower, upper, z + unit P coarse) on the free rows; return how many were cut at a bound."""
    operands = *transfer.prolongation.arrays, coarse, unit, True, is_free, lower, upper, z
    return sum(shared(partial(_interpolate, *operands), lower.size))


def add_prolonged(transfer: Transfer, coarse: FloatVector, unit: float, inverse: FloatVector, x: FloatVector) -> None:
    """Add unit P coarse to x on the free rows."""
    operands = *transfer.prolongation.arrays, coarse, unit, True, inverse != 0.0, *NO_BOUNDS[x.dtype], x
    shared(partial(_interpolate, *operands), inverse.size)


@compiled
def _interpolate(  # type: ignore[no-untyped-def]
    indptr, indices, data, source, factor, adds, is_free, lower, upper, to, first, end
):
    """To ← factor · A source; or, where it `adds`, add that on the free rows, cut off at the bounds if there are any.

    Return how many were cut.
    """
    one, zero = uintp(1), data.dtype.type(0.0)
    cut, has_bounds = 0, lower.size > 0
    for i in range(uintp(first), uintp(end)):
        if adds and not is_free[i]:
            continue
        change = factor * _plus_products(zero, uintp(indptr[i]), uintp(indptr[i + one]), indices, data, source)
        if not adds:
            to[i] = change
            continue
        value = to[i] + change
        if has_bounds and value < lower[i]:
            value = lower[i]
            cut += 1
        if has_bounds and value > upper[i]:
            value = upper[i]
            cut += 1
        to[i] = value
    return cut


@compiled
def transposed_sweep(indptr, indices, data, inverse, backward, residual, x):  # type: ignore[no-untyped-def]
    """Add to x one Gauss–Seidel sweep for Mᵀx = b by the rows of M, which are the columns of Mᵀ.

    `residual` is b − Mᵀx before and after; where an unknown is fixed it means nothing.
    """
    one, n = uintp(1), uintp(inverse.size)
    for step in range(n):
        i = n - one - step if backward else step
        if inverse[i] != 0.0:
            change = residual[i] * inverse[i]
            x[i] += change
            for k in range(uintp(indptr[i]), uintp(indptr[i + one])):
                residual[uintp(indices[k])] -= data[k] * change


@compiled
def add_transposed_product(indptr, indices, data, factor, x, to):  # type: ignore[no-untyped-def]
    """Add factor · Aᵀx to `to`, by the rows of A."""
    one = uintp(1)
    for i in range(uintp(x.size)):
        if x[i] != 0.0:
            for k in range(uintp(indptr[i]), uintp(indptr[i + one])):
                to[uintp(indices[k])] += factor * (data[k] * x[i])
