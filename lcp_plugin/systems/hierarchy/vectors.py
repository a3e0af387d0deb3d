"""Vector operations of Krylov steps, and transfers between two grids.

Sums are split into the same chunks for any number of threads.

`inverse` contains 1/diagonal, and 0 for a fixed unknown. A fine unknown is called held if seven eighths of its
couplings lead to fixed unknowns. A held unknown is not interpolated, because P would let it follow its free coarse
neighbors. If couplings jump, conjugate gradients took ten times as many steps with its row of P.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from ...core.checks import BoolVector, FloatVector, read_only
from ...core.kernels.compilation import kernel, uintp
from ...core.kernels.threads import share
from ...core.tuning import SHARED_FROM
from .sweeps import NO_BOUNDS, _plus_products, shared

if TYPE_CHECKING:
    from .grids import Transfer

T = TypeVar("T")
AT_ONCE = 8192  # terms that are summed in one piece, too few for BLAS to share; they stay in the fastest cache


def dot(one: FloatVector, other: FloatVector) -> float:
    """Return Σ one_i other_i."""
    sums = np.zeros(-(-one.size // AT_ONCE))

    def sum_pieces(first: int, end: int) -> None:
        for piece in range(first, end):
            part = slice(piece * AT_ONCE, (piece + 1) * AT_ONCE)
            sums[piece] = np.dot(one[part], other[part])

    share(sum_pieces, sums.size, 1)
    return float(sums.sum())


def add_both(
    factor: float,
    vector: FloatVector,
    to: FloatVector,
    other_factor: float,
    other: FloatVector,
    to_other: FloatVector,
) -> None:
    """Add factor · vector to the first target, and other_factor · other to the second target."""

    def add(part: slice) -> None:
        to[part] += factor * vector[part]
        to_other[part] += other_factor * other[part]

    _by_parts(add, vector.size)


def add_within(
    origin: FloatVector,
    factor: float,
    vector: FloatVector,
    lower: FloatVector,
    upper: FloatVector,
    z: FloatVector,
) -> None:
    """Overwrite z by mid(lower, upper, origin + factor · vector)."""

    def add(part: slice) -> None:
        np.clip(origin[part] + factor * vector[part], lower[part], upper[part], out=z[part])

    _by_parts(add, vector.size)


def largest_product(one: FloatVector, other: FloatVector) -> float:
    """Return the largest |one_i other_i|: NaN if a product is NaN, 0 for empty vectors."""
    return float(
        np.max(_by_parts(lambda part: span(one[part] * other[part]), one.size), initial=0.0)
    )


def _by_parts(work: Callable[[slice], T], size: int) -> list[T]:
    """Return the results of `work` for consecutive parts of a vector of that size."""

    def piece(first: int, end: int) -> list[T]:
        return [
            work(slice(begin, min(begin + AT_ONCE, end))) for begin in range(first, end, AT_ONCE)
        ]

    return [one for piece_of in share(piece, size, SHARED_FROM) for one in piece_of]


def span(vector: FloatVector) -> float:
    """Return the largest entry in absolute value; 0 of no entry."""
    return float(max(vector.max(initial=0.0), -vector.min(initial=0.0)))


HELD = (
    0.13  # share of its couplings; no simple fraction, which rounding would decide on regular grids
)
NO_FLAGS = np.zeros(0, np.bool_)


def restrict(transfer: Transfer, fine: FloatVector, coarse: FloatVector) -> None:
    """Coarse ← R fine."""
    operands = *transfer.restriction.arrays, read_only(fine), False, NO_FLAGS, *NO_BOUNDS, coarse
    shared(partial(_interpolate, *operands), coarse.size)


def prolong(
    transfer: Transfer,
    coarse: FloatVector,
    flags: BoolVector,
    lower: FloatVector,
    upper: FloatVector,
    z: FloatVector,
) -> int:
    """Overwrite z by mid(lower, upper, z + P coarse) in flagged rows; return the number of clipped values."""
    operands = *transfer.prolongation.arrays, read_only(coarse), True, flags, lower, upper, z
    return sum(shared(partial(_interpolate, *operands), lower.size))


def add_prolonged(
    transfer: Transfer, coarse: FloatVector, flags: BoolVector, x: FloatVector
) -> None:
    """Add P coarse to x in the rows with set `flags`, which cover at least the local rows."""
    operands = *transfer.prolongation.arrays, read_only(coarse), True, flags, *NO_BOUNDS, x
    shared(partial(_interpolate, *operands), transfer.is_coarse.size)


@kernel
def _interpolate(  # type: ignore[no-untyped-def]
    indptr, indices, data, source, adds, flags, lower, upper, to, first, end
):
    """Set to ← A source; if `adds`, add A source in the rows with set flags and clip at the bounds, if any.

    Return the number of clipped values.
    """
    one = uintp(1)
    cut, has_bounds = 0, lower.size > 0
    for i in range(uintp(first), uintp(end)):
        if adds and not flags[i]:
            continue
        change = _plus_products(
            0.0, uintp(indptr[i]), uintp(indptr[i + one]), indices, data, source
        )
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


def find_held(*operands: Any) -> int:
    """Find the held rows among the touched rows; same operands as `_find_held`, whose counts are summed."""
    return sum(share(partial(_find_held, *operands), operands[-1].size, SHARED_FROM))


@kernel
def _find_held(  # type: ignore[no-untyped-def]
    indptr,
    indices,
    whole,
    values,
    is_free,
    touched,
    is_interpolated,
    is_changed,
    is_coarse,
    first,
    end,
):
    """Set which touched rows are interpolated; return the number of rows that are held or change with neighbors.

    `is_changed` marks the fixed or freed rows on entry and the rows of P that change on return. `whole` contains the
    values of the matrix with all unknowns free.
    """
    one, found = uintp(1), 0
    for i in range(uintp(first), uintp(end)):
        became, is_changed[i] = is_changed[i], False
        if not touched[i]:
            continue
        is_held = False
        if is_free[i] and not is_coarse[i]:
            before, left, pivot_before, pivot = 0.0, 0.0, 0.0, 0.0
            for k in range(uintp(indptr[i]), uintp(indptr[i + one])):
                j = uintp(indices[k])
                if j == i or whole[k] > 0.0:
                    pivot_before += whole[k]
                else:
                    before -= whole[k]
                if j == i or values[k] > 0.0:
                    pivot += values[k]
                elif is_free[j]:
                    left -= values[k]
            is_held = (
                pivot > 0.0 and pivot_before > 0.0 and left / pivot < HELD * (before / pivot_before)
            )
        interpolates = is_free[i] and not is_held
        is_changed[i] = interpolates != is_interpolated[i] and not became
        found += is_held or is_changed[i]
        is_interpolated[i] = interpolates
    return found
