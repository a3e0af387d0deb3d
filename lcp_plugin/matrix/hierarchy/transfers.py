"""The ways between two grids, and the products and sweeps with the transpose; compiled, arrays only.

`inverse` holds 1/diagonal, and 0 for an unknown that is fixed.
"""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

from numba import uintp

from ...checks import BoolVector, FloatVector, read_only
from ...kernels.compilation import compiled
from .sweeps import NO_BOUNDS, _plus_products, shared

if TYPE_CHECKING:
    from .grids import Transfer


def restrict(transfer: Transfer, fine: FloatVector, unit: float, coarse: FloatVector) -> None:
    """Coarse ← R fine ÷ unit, a power of two."""
    operands = *transfer.restriction.arrays, read_only(fine), transfer.factor / unit, coarse
    shared(partial(_restrict, *operands), coarse.size)


def prolong(
    transfer: Transfer, coarse: FloatVector, unit: float, is_free: BoolVector, lower: FloatVector, upper: FloatVector,
    z: FloatVector,
) -> int:
    """Overwrite z by mid(lower, upper, z + unit P coarse) on the free rows; return how many were cut at a bound."""
    operands = *transfer.prolongation.arrays, coarse, unit, is_free, lower, upper, z
    return sum(shared(partial(_prolong, *operands), lower.size))


def add_prolonged(transfer: Transfer, coarse: FloatVector, unit: float, inverse: FloatVector, x: FloatVector) -> None:
    """Add unit P coarse to x on the free rows."""
    operands = *transfer.prolongation.arrays, coarse, unit, inverse != 0.0, *NO_BOUNDS[x.dtype], x
    shared(partial(_prolong, *operands), inverse.size)


@compiled
def _restrict(r_indptr, r_indices, r_data, fine, factor, coarse, first, end):  # type: ignore[no-untyped-def]
    one, zero = uintp(1), r_data.dtype.type(0.0)
    for row in range(uintp(first), uintp(end)):
        total = _plus_products(zero, uintp(r_indptr[row]), uintp(r_indptr[row + one]), r_indices, r_data, fine)
        coarse[row] = factor * total


@compiled
def _prolong(p_indptr, p_indices, p_data, coarse, unit, is_free, lower, upper, z, first, end):  # type: ignore[no-untyped-def]
    one, zero = uintp(1), p_data.dtype.type(0.0)
    cut, has_bounds = 0, lower.size > 0
    for i in range(uintp(first), uintp(end)):
        if is_free[i]:
            change = _plus_products(zero, uintp(p_indptr[i]), uintp(p_indptr[i + one]), p_indices, p_data, coarse)
            value = z[i] + unit * change
            if has_bounds and value < lower[i]:
                value = lower[i]
                cut += 1
            if has_bounds and value > upper[i]:
                value = upper[i]
                cut += 1
            z[i] = value
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
