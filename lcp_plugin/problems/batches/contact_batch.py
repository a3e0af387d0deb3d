"""The run of many problems with contact and friction: stacks of arrays, one by one what these leave open."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ...core.checks import real_array
from ...core.errors import InvalidOption
from ...core.settings import Status
from ..cones.frictional_contact import FrictionalContactBatch
from ..cones.solving import ConeResult
from ..cones.stack import ConeStack, Pattern
from ..contact import motion_of
from .batch_run import ComplementarityAnswers
from .mixed_batch import DENSE_UP_TO, MixedRun

TOGETHER = 2048  # worlds in one stack: fewer cost more calls, more fill no second thread


def stack_of_worlds(W: Any, b: Any, friction: Any, dimension: int) -> ConeStack:
    """Return worlds of the same number of contacts, shapes (B, n, n), (B, n) and (B, k), as a stack."""
    starts = np.arange(0, b.shape[1] + 1, dimension, dtype=np.int64)
    with np.errstate(all="ignore"):
        none = np.zeros((1, b.shape[1]))
        return ConeStack(Pattern(W, starts), b, friction, none, none, has_friction=True)


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
        self.is_kept = np.zeros(len(worlds), np.bool_)

    def _answers(self) -> ContactBatchResult:
        return ContactBatchResult(self)

    def _solve_compiled(self) -> None:
        worlds = self.worlds
        if not (self.is_plain and 0 < worlds.n <= DENSE_UP_TO):
            return

        def solve_blocks(first: int, end: int) -> None:
            for own in (slice(TOGETHER * k, TOGETHER * (k + 1)) for k in range(first, end)):
                arrays = worlds.W[own], worlds.b[own], worlds.friction[own]
                stack = stack_of_worlds(*arrays, worlds.dimension)
                start, items = stack.pattern.wide(self.start[own]), np.arange(len(worlds))[own]
                self._take(items, stack, start, is_warm=self.is_warm)

        self._in_chunks(solve_blocks, -(-len(worlds) // TOGETHER))
        self.is_open &= self.status != Status.SOLVED

    def _keep(self, items: Any, z: Any, iterations: Any) -> None:
        self.z[items], self.iterations[items], self.is_kept[items] = z, iterations, True

    def _kept(self, k: int) -> tuple[Any, int] | None:
        z = self.z[k, : self.problems[k].n]
        return (z, int(self.iterations[k])) if self.is_kept[k] else None

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
