"""Many problems with contact and friction as stacks."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ...core.checks import real_array
from ...core.errors import InvalidOption
from ..cones.frictional_contact import FrictionalContact, FrictionalContactBatch
from ..cones.solving import solve_cone_stack
from ..cones.stack import ConeStack, Pattern
from ..contact import motion_of
from .stated import CONES_UP_TO, Stacks

TOGETHER = 2048  # instances per stack: fewer cost more calls, more leave a second thread idle


def stack_of_worlds(W: Any, b: Any, friction: Any, dimension: int) -> ConeStack:
    """Return instances with the same number of contacts, shapes (B, n, n), (B, n) and (B, k), as a stack."""
    starts = np.arange(0, b.shape[1] + 1, dimension, dtype=np.int64)
    none = np.zeros((1, b.shape[1]))
    return ConeStack(Pattern(W, starts), b, friction, none, none, has_friction=True)


class Worlds:
    """Contact problems in arrays, and their starts.

    Parameters
    ----------
    contacts : FrictionalContactBatch
    z0 : array, shape (B, n) or (n,), optional
    """

    item, are_lcps = "world", False

    def __init__(self, contacts: FrictionalContactBatch, z0: ArrayLike | None) -> None:
        self.worlds, self.is_warm, self.errors = contacts, z0 is not None, contacts.errors
        shape, n = contacts.b.shape, contacts.n
        need = f"z0 must have shape ({len(contacts)}, {n}) or ({n},)"
        given = real_array(np.zeros(n) if z0 is None else z0, need)
        if given.shape not in (shape, (n,)) or not np.isfinite(given).all():
            raise InvalidOption(f"{need}, and be finite, got shape {given.shape}")
        is_there = np.arange(n) < contacts.dimension * contacts.contacts[:, np.newaxis]
        self.starts = np.where(is_there, given, 0.0)

    @property
    def points(self) -> Any:
        """The points at which the problems begin, shape (B, n)."""
        return self.starts.copy()

    def __len__(self) -> int:
        return len(self.worlds)

    def __getitem__(self, k: int) -> FrictionalContact:
        return self.worlds[k]

    def start(self, k: int) -> Any:
        """Return the start of instance k, or None."""
        size = self.worlds.dimension * int(self.worlds.contacts[k])
        return self.starts[k, :size] if self.is_warm else None

    def slacks(self, z: Any) -> Any:
        """Return velocities after the impulses, shape (B, n)."""
        return np.einsum("bij,bj->bi", self.worlds.W, z) + self.worlds.b

    def motion(self, z: Any, w: Any) -> Any:
        """Return impulses and velocities contact by contact."""
        shape = len(self), -1, self.worlds.dimension
        return motion_of(z.reshape(shape), w.reshape(shape), self.worlds.b)

    def stacks(self, tolerance: float, has_time: Callable[[], bool]) -> Stacks:
        """Yield stacks of small instances."""
        for first in range(0, len(self) if 0 < self.worlds.n <= CONES_UP_TO else 0, TOGETHER):
            own = slice(first, first + TOGETHER)
            yield np.arange(len(self))[own], partial(self._solve, own, tolerance, has_time)

    def _solve(self, own: slice, tolerance: float, has_time: Callable[[], bool]) -> Any:
        worlds = self.worlds
        stack = stack_of_worlds(
            worlds.W[own], worlds.b[own], worlds.friction[own], worlds.dimension
        )
        start = stack.pattern.wide(self.starts[own])
        z, *others = solve_cone_stack(stack, start, tolerance, has_time, is_warm=self.is_warm)
        return stack.pattern.flat(z), *others
