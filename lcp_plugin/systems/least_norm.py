"""Inverses of many small blocks, pseudo-inverses if they are singular."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from ..core.checks import BoolVector

ALIKE, ENTRIES = (
    8,
    2**16,
)  # blocks with a smaller difference in size are inverted together, at most so many entries at a time


def pseudo_inverses(blocks: Any) -> tuple[Any, BoolVector]:
    """Return the Moore–Penrose inverses of square blocks, shape (k, f, f), and which of these are singular, shape (k,).

    Examples
    --------
    >>> inverses, is_singular = pseudo_inverses(np.array([[[2.0, 2.0], [2.0, 2.0]], [[4.0, 0.0], [0.0, 1.0]]]))
    >>> inverses.round(15).tolist(), is_singular
    ([[[0.125, 0.125], [0.125, 0.125]], [[0.25, 0.0], [0.0, 1.0]]], array([ True, False]))
    """
    left, sizes, right = np.linalg.svd(blocks)
    # 2⁻⁴³ of the largest singular value is the rounding error of a zero singular value.
    is_kept = sizes > 2.0**-43 * sizes[:, :1]
    reciprocal = np.divide(1.0, sizes, out=np.zeros_like(sizes), where=is_kept)
    right, left = np.swapaxes(right, 1, 2), np.swapaxes(left, 1, 2)
    return (right * reciprocal[:, np.newaxis]) @ left, np.any(~is_kept, axis=1)


def solved(blocks: Any, right: Any) -> Any:
    """Return the solutions of B X = right, shapes (k, f, f) and (k, f, r); NaN if a pivot is 0.

    Examples
    --------
    >>> solved(np.array([[[2.0]], [[0.0]]]), np.ones((2, 1, 1))).ravel()
    array([0.5, nan])
    """
    try:
        return np.linalg.solve(blocks, right)
    except np.linalg.LinAlgError:
        is_singular = np.linalg.slogdet(blocks)[0] == 0.0
        regular = np.where(is_singular[:, np.newaxis, np.newaxis], np.eye(blocks.shape[1]), blocks)
        x = np.linalg.solve(regular, right)
        x[is_singular] = np.nan
        return x


def products(M: Any, x: Any) -> Any:
    """Return M_k x_k, shapes (k or 1, m, n) and (k, n)."""
    return np.matmul(M, x[:, :, np.newaxis])[:, :, 0]


class FreeBlocks:
    """Blocks J_FF of many matrices, grouped by similar size, each with its inverse.

    Parameters
    ----------
    J : array, shape (k, n, n), or (1, n, n) for all
    free : array of bool, shape (k, n)

    Attributes
    ----------
    is_regular : array of bool, shape (k,)
        True if fewer than half of the digits cancel in J_FF⁻¹ J_FF = I, independent of the scaling.
    is_singular : array of bool, shape (k,)
        True if J_FF has one unit and is singular to rounding error; its inverse is the Moore–Penrose inverse. A block
        that is neither regular nor singular is doubtful, and `solve` returns no solution for it.
    """

    def __init__(self, J: Any, free: Any) -> None:
        self._groups = []
        self.is_regular, self.is_singular = (
            np.ones(len(free), np.bool_),
            np.zeros(len(free), np.bool_),
        )
        counts = np.minimum(-(-free.sum(axis=1) // ALIKE) * ALIKE, free.shape[1])
        for count, items in self._alike(counts):
            rows = np.argsort(~free[items], axis=1, kind="stable")[
                :, :count
            ]  # fixed rows of the block are rows of I
            own = free[items[:, np.newaxis], rows]
            which = (items if len(J) > 1 else np.zeros_like(items))[:, np.newaxis, np.newaxis]
            blocks = J[which, rows[:, :, np.newaxis], rows[:, np.newaxis]]
            blocks = np.where(own[:, :, np.newaxis] & own[:, np.newaxis], blocks, np.eye(count))
            inverses = solved(blocks, np.broadcast_to(np.eye(count), blocks.shape))
            terms = np.abs(blocks * inverses.swapaxes(1, 2)).sum(axis=2)
            # At 2²⁶ half of the digits of a double cancel in the sum.
            self.is_regular[items] = is_regular = (terms <= 2.0**26).all(axis=1)
            rest = np.flatnonzero(~is_regular)
            if rest.size:
                inverses[rest], is_singular = _least(blocks[rest], own[rest])
                self.is_singular[items[rest]] = is_singular
            self._groups.append((items[:, np.newaxis], rows, own, inverses))

    @staticmethod
    def _alike(counts: Any) -> Iterator[tuple[int, Any]]:
        """Yield a size, and items of that size whose blocks a cache holds."""
        for count in np.unique(counts[counts > 0]).tolist():
            items = np.flatnonzero(counts == count)
            most = max(ENTRIES // count**2, 1)
            yield from ((count, items[k : k + most]) for k in range(0, items.size, most))

    def solve(self, right: Any, *, transposed: bool = False) -> Any:
        """Return the solutions of J_FF x = right_F, or of the transposed, shape (k, n), 0 in other rows."""
        x = np.zeros(right.shape)
        for items, rows, own, inverses in self._groups:
            turned = inverses.swapaxes(1, 2) if transposed else inverses
            known = np.where(own, right[items, rows], 0.0)
            x[items, rows] = products(turned, known)
        return x


def _least(blocks: Any, own: Any) -> tuple[Any, BoolVector]:
    """Return pseudo-inverses of blocks, 0 in padding rows, and the mask of well-scaled singular blocks."""
    inverses, is_singular = np.zeros(blocks.shape), np.zeros(len(blocks), np.bool_)
    for count in np.unique(own.sum(axis=1)).tolist():  # free rows come first
        items = np.flatnonzero(own.sum(axis=1) == count)
        chosen = blocks[items, :count, :count]
        inverses[items, :count, :count], is_singular[items] = pseudo_inverses(chosen)
        is_singular[items] &= have_one_unit(chosen)
    return inverses, is_singular


def have_one_unit(blocks: Any) -> Any:
    """Return the mask of blocks whose diagonal, or the largest entries of all rows and columns, differ little."""
    sizes = np.abs(blocks)
    rows, sides = sizes.max(2), np.concatenate([sizes.max(2), sizes.max(1)], 1)
    is_diagonal_large = rows <= 2.0**4 * np.abs(np.diagonal(blocks, axis1=1, axis2=2))
    smallest = sides.min(1, initial=np.inf, where=sides > 0.0)
    # Such rows and columns are in one unit.
    return is_diagonal_large.all(1) | (sides.max(1) <= 2.0**10 * smallest)
