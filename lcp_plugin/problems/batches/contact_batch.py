"""The run of many worlds with contact and friction: one compiled loop over arrays, one by one what that leaves open."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ...core.checks import read_only, real_array
from ...core.errors import InvalidOption
from ..cones.frictional_contact import FrictionalContactBatch
from ..cones.methods import SWEEPS_A_STEP
from ..cones.small import LARGEST, LoopAnswers, run_loop
from ..cones.solving import ConeResult
from ..contact import motion_of
from .batch_run import ComplementarityAnswers
from .mixed_batch import MixedRun


class ContactBatchRun(MixedRun):
    """The answers as they come, in tables with a row a world.

    Parameters
    ----------
    worlds : FrictionalContactBatch
    wishes, threads, limit
        As in `MixedRun`.
    z0 : array, shape (B, n) or (n,), optional
        Warm starts.
    """

    def __init__(
        self,
        worlds: FrictionalContactBatch,
        wishes: dict[str, Any],
        z0: ArrayLike | None,
        *,
        threads: int,
        limit: float,
    ) -> None:
        super().__init__(worlds, wishes, worlds.errors, threads=threads, limit=limit)  # type: ignore[arg-type]
        self.worlds, self.is_warm = worlds, z0 is not None
        self.start = np.zeros(worlds.b.shape) if z0 is None else _checked_starts(z0, worlds)
        self.z, self.iterations = self.start.copy(), np.zeros(len(worlds), np.int64)
        self.z[[*self.errors]] = np.nan

    def _answers(self) -> ContactBatchResult:
        return ContactBatchResult(self)

    def _loops(self) -> Iterator[tuple[Any, LoopAnswers]]:
        worlds = self.worlds
        if not (len(worlds) and 0 < worlds.n <= LARGEST):
            return
        starts = read_only(np.arange(0, worlds.n + 1, worlds.dimension, dtype=np.int64))
        none, origins = np.full(worlds.b.shape, np.inf), np.zeros(worlds.b.shape)
        arrays = (worlds.W, worlds.b, *map(read_only, (-none, none, origins)), worlds.friction)
        found = run_loop(
            starts,
            arrays,
            self.start.copy(),
            self.settings,
            self._in_chunks,
            has_friction=True,
            is_warm=self.is_warm,
        )
        items = np.flatnonzero(found.is_proved & self.is_open)
        self.z[items], self.residual[items] = found.z[items], found.residual[items]
        self.iterations[items] = found.made[items, 0] // SWEEPS_A_STEP + found.made[items, 1]
        yield np.arange(len(worlds)), found

    def _start(self, k: int) -> dict[str, Any]:
        return {"z0": self.start[k, : self.problems[k].n]} if self.is_warm else {}

    def _solve(self, k: int, wishes: dict[str, Any]) -> None:
        super()._solve(k, wishes)
        found: Any = self.results[k]
        self.z[k], self.z[k, : found.z.size] = 0.0, found.z
        self.residual[k], self.iterations[k] = found.certificate.relative_residual, found.iterations


def _checked_starts(z0: ArrayLike, worlds: FrictionalContactBatch) -> Any:
    """Return the starts, shape (B, n); contacts that are not there have 0."""
    need = f"z0 must have shape ({len(worlds)}, {worlds.n}) or ({worlds.n},)"
    given = real_array(z0, need)
    if given.shape not in (worlds.b.shape, (worlds.n,)) or not np.isfinite(given).all():
        raise InvalidOption(f"{need}, and be finite, got shape {given.shape}")
    starts = np.array(np.broadcast_to(given, worlds.b.shape))
    starts[np.arange(worlds.n) >= worlds.dimension * worlds.contacts[:, np.newaxis]] = 0.0
    return starts


class ContactBatchResult(ComplementarityAnswers[ConeResult]):
    """The answers to many worlds.

    Parameters
    ----------
    run : ContactBatchRun
        At its end.

    Attributes
    ----------
    z : array, shape (B, d k)
        Impulses, 0 where a world has no contact; NaN where it is no problem.
    status : array of Status, shape (B,)
        None where the world is no problem.
    relative_residual : array, shape (B,)
        Upper bounds; NaN where a world is no problem, or was not begun.
    iterations : array of int, shape (B,)
    seconds : float
        Seconds of the whole batch, compilation excluded.
    errors : dict
        What is wrong with world k, an InvalidProblem, where something is; ``batch[k]`` raises it.
    worlds : FrictionalContactBatch
        The problems.
    threads : int
        How many took part.

    Notes
    -----
    ``batch[k]`` is the result that :func:`lcp_plugin.solve` gives for world k, its `seconds` a share of the batch's.
    """

    ITEM = "world"

    def __init__(self, run: ContactBatchRun) -> None:
        super().__init__(run)
        self.worlds = run.worlds

    @cached_property
    def w(self) -> Any:
        """Velocities after the impulses, shape (B, d k); 1 where a world has no contact."""
        return np.einsum("bij,bj->bi", self.worlds.W, self.z) + self.worlds.b

    @property
    def motion(self) -> Any:
        """Impulses and velocities contact by contact, a ContactMotion with an axis in front."""
        shape = len(self), self.worlds.n // self.worlds.dimension, self.worlds.dimension
        return motion_of(self.z.reshape(shape), self.w.reshape(shape), self.worlds.b)
