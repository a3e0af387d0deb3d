"""Contacts with friction of many worlds, as stacked data."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...core.checks import read_only, real_array
from ...core.errors import InvalidProblem, LCPError
from ..contact import warn_of_much_friction
from .data import NEARLY_SYMMETRIC, FrictionalContact, dimension_of


class FrictionalContactBatch:
    """Worlds of at most k contacts each with Coulomb friction as it is: :class:`FrictionalContact`, one for each i.

    ``worlds[i]`` is the :class:`FrictionalContact` of number i, and raises what is wrong with it.

    Parameters
    ----------
    W : array, shape (B, d k, d k)
        As of :class:`FrictionalContact`, or (d k, d k), the same for all. Read where it lies if it is contiguous: leave
        its entries as they are while you use the batch.
    b : array, shape (B, d k) or (B, k, d), or (d k,)
    friction : number, or array, shape (k,) or (B, k)
    contacts : array of int, shape (B,), optional
        How many contacts a world has, the first of the k, all by default: what stands behind them is not looked at.
    dimension : int, optional
        d, 3 by default where the rows are a multiple of 3.

    Raises
    ------
    InvalidProblem
        Where shapes do not fit together.

    Examples
    --------
    A block that slides, and one that sticks:

    >>> from lcp_plugin import solve_batch
    >>> batch = solve_batch(FrictionalContactBatch(np.eye(3), [[-1.0, 3.0, 4.0], [-1.0, 0.3, 0.0]], 0.5))
    >>> (batch.z.round(6) + 0.0).tolist(), batch.motion.sticks.ravel().tolist()
    ([[1.0, -0.3, -0.4], [1.0, -0.3, 0.0]], [False, True])
    """

    def __init__(
        self, W: ArrayLike, b: ArrayLike, friction: ArrayLike, *, contacts: ArrayLike | None = None,
        dimension: int | None = None,
    ) -> None:
        need = "b must have shape (B, d k) or (B, k, d), d = 3 in space and 2 in the plane"
        offsets = real_array(b, need)
        if offsets.ndim not in (1, 2, 3):
            raise InvalidProblem(f"{need}, got shape {offsets.shape}")
        if offsets.ndim == 3:
            dimension, offsets = offsets.shape[2], offsets.reshape(len(offsets), -1)
        n, mu = offsets.shape[-1], real_array(friction, "friction must be a number, or have shape (k,) or (B, k)")
        self.dimension = d = dimension_of(dimension, mu if mu.ndim < 2 else mu[0], n)
        k = n // d
        matrices = real_array(W, f"W must have shape (B, {n}, {n}), {n} as b has")
        if matrices.ndim not in (2, 3) or matrices.shape[-2:] != (n, n):
            raise InvalidProblem(f"W must have shape (B, {n}, {n}), {n} as b has, got {matrices.shape}")
        if mu.ndim > 2 or (mu.ndim and mu.shape[-1] != k):
            raise InvalidProblem(f"friction must be a number, or have shape ({k},) or (B, {k}), got {mu.shape}")
        stacks = {"W": (matrices, 3), "b": (offsets, 2), "friction": (mu, 2)}
        lengths = {name: len(array) for name, (array, ndim) in stacks.items() if array.ndim == ndim}
        if contacts is not None and np.ndim(contacts) == 1:
            lengths["contacts"] = len(np.asarray(contacts))
        if len({*lengths.values()}) > 1:
            given = ", ".join(f"{name} {length}" for name, length in lengths.items())
            raise InvalidProblem(f"all arrays with an axis for the worlds must be equally long, got {given}")
        count = next(iter(lengths.values()), 1)
        self.contacts = _checked_counts(contacts, count, k)
        shapes = (count, n, n), (count, n), (count, k)
        own: Any = tuple(np.ascontiguousarray(np.broadcast_to(array, shape), np.float64)
                         for array, shape in zip((matrices, offsets, mu), shapes, strict=True))
        is_there = np.arange(k) < self.contacts[:, np.newaxis]
        if not is_there.all():
            own = _padded(own[0], own[1], own[2], is_there, d)
        self.W, self.b, self.friction = map(read_only, own)
        warn_of_much_friction(np.where(np.isfinite(self.friction), self.friction, 0.0), 3)
        with np.errstate(invalid="ignore", over="ignore"):
            difference = np.abs(self.W - self.W.swapaxes(1, 2)).max(axis=(1, 2), initial=0.0)
            largest = np.maximum(self.W.max(axis=(1, 2), initial=0.0), -self.W.min(axis=(1, 2), initial=0.0))
            self._is_stated = (
                (difference <= NEARLY_SYMMETRIC * largest) & (largest < np.inf) & np.isfinite(self.b).all(axis=1)
                & (self.friction >= 0.0).all(axis=1) & (self.friction < np.inf).all(axis=1)
            )

    @property
    def n(self) -> int:
        """Rows of each, d k."""
        return int(self.b.shape[1])

    @property
    def errors(self) -> dict[int, LCPError]:
        """What is wrong with world i, where something is."""
        found: dict[int, LCPError] = {}
        for i in np.flatnonzero(~self._is_stated).tolist():
            try:
                self[i]
            except LCPError as error:
                found[i] = error
        return found

    def __len__(self) -> int:
        return len(self.b)

    def __getitem__(self, i: int) -> FrictionalContact:
        if not -len(self) <= i < len(self):
            raise IndexError(f"there are {len(self)} worlds, and none has the number {i}")
        count = int(self.contacts[i])
        rows = self.dimension * count
        return FrictionalContact(
            self.W[i, :rows, :rows], self.b[i, :rows], self.friction[i, :count], dimension=self.dimension
        )

    def __iter__(self) -> Iterator[FrictionalContact]:
        return (self[i] for i in range(len(self)))

    def __repr__(self) -> str:
        where = "space" if self.dimension == 3 else "the plane"
        return f"FrictionalContactBatch({len(self)} worlds of up to {self.n // self.dimension} contacts in {where})"


def _checked_counts(contacts: ArrayLike | None, count: int, k: int) -> NDArray[np.int64]:
    if contacts is None:
        return np.full(count, k)
    counts = np.asarray(contacts)
    if counts.shape != (count,) or counts.dtype.kind not in "iu" or ((counts < 0) | (counts > k)).any():
        raise InvalidProblem(f"contacts must be {count} whole numbers from 0 to {k}, one a world, got {contacts!r}")
    return counts.astype(np.int64)


def _padded(W: Any, b: Any, mu: Any, is_there: NDArray[np.bool_], d: int) -> tuple[Any, Any, Any]:
    """Return copies in which contacts that are not there are open, each by itself."""
    W, b, mu = W.copy(), b.copy(), mu.copy()
    rows = np.repeat(is_there, d, axis=1)
    W[~(rows[:, :, np.newaxis] & rows[:, np.newaxis])] = 0.0
    world, row = np.nonzero(~rows)
    W[world, row, row], b[~rows], mu[~is_there] = 1.0, 1.0, 0.0
    return W, b, mu
