"""What a V-cycle and a nested iteration do on one grid; compiled, arrays only.

`inverse` holds 1/diagonal, and 0 for an unknown that is fixed: it keeps the value 0 and passes no residual on.
`runs` says which rows are equal (see there); a kernel takes those at once, and the others one by one.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...core.checks import BoolVector, FloatVector, read_only
from ...core.kernels.compilation import inlined, kernel
from ...core.kernels.compiler import uintp
from ...core.kernels.enclosures import fused
from ...core.kernels.rows import clamp
from ...core.kernels.threads import share
from ...core.tuning import SHARED_FROM
from .grids import LONGEST_REACH, EqualRows, RowBlocks, run_at

Matrix = tuple[NDArray[Any], NDArray[Any], NDArray[Any], FloatVector, EqualRows]  # in CSR, and where diagonals stand
NO_BOUNDS = (read_only(np.zeros(0)),) * 2
NO_FLAGS = (np.zeros(0, np.bool_),) * 2
NO_BITS = np.zeros(0, np.int64)


def first_sweep(rows: Matrix, blocks: RowBlocks, inverse: FloatVector, b: FloatVector, x: FloatVector) -> None:
    """Overwrite x by one forward Gauss–Seidel sweep for M x = b from x = 0.

    A pass over the lower triangle, and over all of the rows from which an odd block meets the even one behind it.
    """
    for edge in blocks.edges[2::2].tolist():
        x[edge - blocks.reach : edge] = 0.0
    vectors = read_only(inverse), read_only(b), *NO_BOUNDS
    _swept(rows, rows[1], blocks, vectors, -1.0, 1.0, True, False, x)


def residual_after_first_sweep(
    rows: Matrix, blocks: RowBlocks, inverse: FloatVector, weight: FloatVector, b: FloatVector, x: FloatVector,
    residual: FloatVector,
) -> None:
    """Write b − M x behind `first_sweep` into `residual`: row i held when it was left, then others changed.

    It held with the pivot m_ii + weight_i, where there are weights.
    """
    split, reach = rows[1], blocks.reach
    shared(_product_of(rows, split, 1, inverse, -1.0, b, False, x, residual), inverse.size)
    whole = _product_of(rows, rows[0], 0, inverse, -1.0, b, True, x, residual)
    for edge in blocks.edges[2:-1:2].tolist():  # here others had changed before
        whole(edge - reach, edge + reach)
    if weight.size:
        residual += np.where(inverse != 0.0, weight * x[: weight.size], 0.0)


def free_product(rows: Matrix, inverse: FloatVector, x: FloatVector, product: FloatVector) -> None:
    """Product ← M x on the free rows, 0 elsewhere."""
    shared(_product_of(rows, rows[0], 0, inverse, 1.0, inverse, False, x, product), inverse.size)


def _product_of(
    rows: Matrix, begins: Any, further: int, inverse: FloatVector, sign: float, b: FloatVector, adds: bool,
    x: FloatVector, product: FloatVector,
) -> Callable[[int, int], Any]:
    indptr, _, *rest = rows
    unused = False, False, *NO_BOUNDS, *NO_FLAGS
    operands = indptr, begins, further, *rest, read_only(inverse), sign, read_only(b), adds, x, product, *unused
    return lambda first, end: _products(*operands, np.empty(LONGEST_REACH), NO_BITS, first, end)


def sweep(
    rows: Matrix, blocks: RowBlocks, inverse: FloatVector, backward: bool, b: FloatVector, x: FloatVector
) -> None:
    """Overwrite x by one Gauss–Seidel sweep for M x = b."""
    vectors = read_only(inverse), read_only(b), *NO_BOUNDS
    _swept(rows, rows[0][1:], blocks, vectors, -1.0, 1.0, False, backward, x)


def projected_sweep(
    rows: Matrix, blocks: RowBlocks, vectors: tuple[FloatVector, ...], relaxation: float, backward: bool, z: FloatVector
) -> None:
    """Overwrite z row by row, z_i ← mid(l_i, u_i, z_i − relaxation inverse_i w_i) with w_i from the current z.

    `vectors` are the inverse pivots, q, lower and upper, read-only.
    """
    _swept(rows, rows[0][1:], blocks, vectors, 1.0, relaxation, False, backward, z)


def free_rows(
    rows: Matrix, vectors: tuple[FloatVector, ...], z: FloatVector, snaps: bool, is_free: BoolVector,
    is_changed: BoolVector, residual: FloatVector,
) -> tuple[float, int]:
    """Find the free rows of z: those strictly between their bounds, or pushed off the bound by w.

    With `snaps`, an unknown that a Gauss–Seidel step would put at a bound is put there: projected-type sweeps approach
    a bound without reaching it. Writes −w on the free rows and 0 elsewhere into `residual`; returns the largest scaled
    residual of the problem, and how many rows changed.
    """
    indptr, _, *rest = rows
    inverse, q, lower, upper = vectors
    operands = (
        indptr, indptr, 0, *rest, inverse, 1.0, q, False, z, residual, True, snaps, lower, upper, is_free, is_changed
    )

    def piece(first: int, end: int) -> tuple[float, int]:
        workspace = np.empty(2 * LONGEST_REACH)
        found: tuple[float, int] = _products(*operands, workspace, workspace.view(np.int64), first, end)
        return found

    # With `snaps` the next rows meet what is put at a bound.
    found = [piece(0, residual.size)] if snaps else shared(piece, residual.size)
    largest = np.max([one for one, _ in found])  # a NaN kept
    return float(largest), int(sum(changed for _, changed in found))


def shared(work: Callable[[int, int], Any], rows: int) -> list[Any]:
    """Call ``work(first, end)`` on parts of all rows, which may be taken in any order."""
    return share(work, rows, SHARED_FROM)


def _swept(
    rows: Matrix, ends: Any, blocks: RowBlocks, vectors: tuple[FloatVector, ...], sign: float, relaxation: float,
    is_first: bool, backward: bool, x: FloatVector,
) -> None:
    """Sweep the blocks of one colour and then those of the other; the entries of row i end before ends[i]."""
    indptr, *rest = rows
    operands, edges = (*rest, *vectors, sign, relaxation, is_first, backward, x), blocks.edges
    for colour in (1, 0) if backward else (0, 1):
        if count := blocks.count(colour):
            reach = blocks.reach if is_first and colour == 1 else 0
            share(partial(_swept_piece, indptr, ends, operands, x, edges, reach, colour), count, blocks.smallest_share)


def _swept_piece(
    indptr: Any, ends: Any, operands: tuple[Any, ...], x: FloatVector, edges: Any, reach: int, colour: int,
    first: int, last: int,
) -> None:
    """Sweep some blocks of a colour; so many rows at the end of each need all their entries in the first sweep."""
    sums, block_ends = np.empty(LONGEST_REACH), edges[1:]
    if reach == 0:
        _sweep(indptr, ends, *operands, sums, colour, edges, block_ends, first, last)
        return
    seams = read_only(block_ends - reach)
    _sweep(indptr, ends, *operands, sums, colour, edges, seams, first, last)
    _sweep(indptr, indptr[1:], *operands, sums, colour, seams, block_ends, first, last)


@inlined
def _plus_products(total, first, last, indices, data, x):  # type: ignore[no-untyped-def]
    """Return total + Σ data_k x_j over the entries first ≤ k < last of a row."""
    for k in range(first, last):
        total += data[k] * x[uintp(indices[k])]
    return total


@inlined
def _add_products(first, last, but, shift, indices, data, x, size, sums):  # type: ignore[no-untyped-def]
    """Add Σ data_k x_j, j = p + shift + the column of k, to sums[p], p < size; first ≤ k < last, k ≠ but.

    Two entries at a time: half the passes over the sums.
    """
    one, size = uintp(1), uintp(size)
    k = uintp(first)
    while k < last:
        after = k + one
        if k != but:
            after += one if after == but else uintp(0)
            at = uintp(shift + indices[k])
            if after < last:
                at_too = uintp(shift + indices[after])
                for p in range(size):
                    sums[p] += data[k] * x[at + p] + data[after] * x[at_too + p]
                after += one
            else:
                for p in range(size):
                    sums[p] += data[k] * x[at + p]
        k = after


@inlined
def _place(first, last, column, indices):  # type: ignore[no-untyped-def]
    """Return where that column stands among these entries, `last` where it does not."""
    for k in range(first, last):
        if indices[k] == column:
            return k
    return last


@kernel
def _sweep(  # type: ignore[no-untyped-def]
    indptr, ends, split, indices, data, runs, inverse, b, lower, upper, sign, relaxation, is_first, backward, x,
    sums, colour, begins, block_ends, first_block, last_block,
):
    """Overwrite x row by row, x_i ← mid(l_i, u_i, x_i − relaxation inverse_i r_i), r = M x + sign b from the current x.

    It does so in the blocks of one colour with these numbers. Where `lower` or `upper` is empty there is none. The
    entries of row i end before ends[i]. The first sweep takes x for 0. `sums` is work space, shape (LONGEST_REACH,).
    """
    # Two flags: with one, and both bounds at once, the loop below takes half as long again.
    has_lower, has_upper = lower.size > 0, upper.size > 0
    for counted in range(last_block - first_block):
        block = 2 * (last_block - 1 - counted if backward else first_block + counted) + colour
        begin, end = begins[block], block_ends[block]
        if begin == end:  # a rank may have no rows
            continue
        lowest, highest = run_at(begin, runs), run_at(end - 1, runs)
        for s in range(highest + 1 - lowest):
            at = highest - s if backward else lowest + s
            first, last, reach = max(begin, runs[at, 0]), min(end, runs[at, 1]), runs[at, 2]
            if reach == 0:
                for step in range(last - first):
                    i = uintp(last - 1 - step if backward else first + step)
                    value, pivot = 0.0 if is_first else x[i], relaxation * inverse[i]
                    if pivot != 0.0:
                        value -= pivot * _excess(sign * b[i], indptr[i], split[i], ends[i], backward, indices, data, x)
                    if has_lower:
                        value = lower[i] if lower[i] > value else value
                    if has_upper:
                        value = upper[i] if upper[i] < value else value
                    x[i] = value
                continue
            from_entry, to_entry = uintp(indptr[first]), uintp(ends[first])
            near = _place(from_entry, to_entry, first + 1 if backward else first - 1, indices)
            weight = relaxation * data[near] if near < to_entry else 0.0
            for done in range(0, last - first, reach):
                size = min(reach, last - first - done)
                i = last - done - size if backward else first + done
                start = uintp(i)
                for p in range(uintp(size)):
                    sums[p] = sign * b[start + p]
                _add_products(from_entry, to_entry, near, i - first, indices, data, x, size, sums)
                for p in range(uintp(size)):
                    before = 0.0 if is_first else x[start + p]
                    sums[p] = before - sums[p] * (relaxation * inverse[start + p])
                before = (x[i + size] if backward else x[i - 1]) if near < to_entry else 0.0
                for step in range(size):  # the only loop in which a row waits for the one before
                    place = uintp(size - 1 - step if backward else step)
                    p = start + place
                    before = fused(-(weight * inverse[p]), before, sums[place])
                    if has_lower:
                        before = lower[p] if lower[p] > before else before
                    if has_upper:
                        before = upper[p] if upper[p] < before else before
                    x[p] = before


@inlined
def _excess(total, first, diagonal, end, backward, indices, data, x):  # type: ignore[no-untyped-def]
    """Return total + (M x)_i, the neighbour that was swept last added last: the sum has waited for nothing else."""
    first, diagonal, end, one = uintp(first), uintp(diagonal), uintp(end), uintp(1)
    behind = diagonal + one
    total = _plus_products(total, first if backward else diagonal, behind if backward else end, indices, data, x)
    k, step = end - one if backward else first, uintp(-1) if backward else one
    for _ in range(end - behind if backward else diagonal - first):
        total += data[k] * x[uintp(indices[k])]
        k += step
    return total


@inlined
def _snap(begin, end, w, inverse, lower, upper, z):  # type: ignore[no-untyped-def]
    for p in range(begin, end):
        r, above, below = w[p] * inverse[p], z[p] - lower[p], z[p] - upper[p]
        if r >= above > 0.0:
            z[p] = lower[p]
        elif r <= below < 0.0:
            z[p] = upper[p]


@kernel
def _products(  # type: ignore[no-untyped-def]
    indptr, begins, further, indices, data, runs, inverse, sign, b, adds, x, product,
    looks, snaps, lower, upper, is_free, is_changed, workspace, bits, first_row, last_row,
):
    """Product ← sign · M x on the free rows, 0 elsewhere; the entries of row i begin at begins[i] + further.

    Where it `adds`, b is added; only these rows are looked at. Where it `looks`, w = M x + b says which rows are free,
    and product ← −w there: return the largest scaled residual, and how many rows changed. `workspace` has shape
    (2 LONGEST_REACH,), and `bits` the same memory as integers: of numbers ≥ 0 they have the same order, and NaN is the
    largest.
    """
    one, further = uintp(1), uintp(further)
    largest, changed, done = np.int64(0), 0, first_row
    i, s = first_row, run_at(first_row, runs)
    while i < last_row:
        first, end, reach = max(first_row, runs[s, 0]), min(last_row, runs[s, 1]), runs[s, 2]
        while i < end:
            size, start = min(reach if reach > 0 else LONGEST_REACH, end - i), uintp(i)
            if looks:
                for p in range(uintp(size)):
                    workspace[p] = b[start + p]
            else:
                for p in range(uintp(size)):
                    workspace[p] = 0.0
            if reach > 0:
                last = uintp(indptr[first + 1])
                _add_products(uintp(begins[first]) + further, last, last, i - first, indices, data, x, size, workspace)
            else:
                for p in range(uintp(size)):
                    row = start + p
                    begin = uintp(begins[row]) + further
                    workspace[p] = _plus_products(workspace[p], begin, uintp(indptr[row + one]), indices, data, x)
            i += size
            if not looks:
                for p in range(uintp(size)):
                    row = start + p
                    total = sign * workspace[p] + b[row] if adds else sign * workspace[p]
                    product[row] = total if inverse[row] != 0.0 else 0.0
                continue
            for p in range(uintp(size)):
                product[start + p] = workspace[p]
            if i - done < LONGEST_REACH and i < last_row:
                continue  # short runs are looked at together
            start, size, done = uintp(done), uintp(i - done), i
            if snaps:
                _snap(start, start + size, product, inverse, lower, upper, x)
            for k in range(size):
                row = start + k
                w, above, below = product[row], x[row] - lower[row], x[row] - upper[row]
                workspace[k] = abs(clamp(w * inverse[row], below, above))
                is_off = ((above > 0.0) | (w < 0.0)) & ((below < 0.0) | (w > 0.0))
                is_changed[row] = is_off != is_free[row]
                is_free[row] = is_off
                product[row] = -w if is_off else 0.0
            for k in range(size):
                changed += is_changed[start + k]
                largest = max(largest, np.int64(bits[k]))
        s += 1
    if looks:
        bits[0] = largest
    return workspace[0], changed
