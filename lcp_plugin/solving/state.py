"""What a run keeps: its clock, its incumbent, its ledger."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np

from ..algorithms import Step
from ..checks import FloatVector
from ..deadline import compilation
from ..peers.alone import Peers
from ..policy.stages import Stage
from .result import Sample, StageRecord


class Clock:
    """The seconds of a run. Pauses are not its own; against a time limit all count but those for compilation.

    Those are not counted in runs inside this one either. On several ranks these are the seconds of the slowest one, and
    Ctrl-C is heard on any of them.

    Attributes
    ----------
    elapsed : float
        Seconds that count against the limit, up to the last reading.
    hears : callable
        Tells whether this rank was asked to end by Ctrl-C.
    is_interrupted : bool
        Whether one of them was, before the last reading.
    """

    def __init__(self, peers: Peers) -> None:
        self._compilation = compilation()  # of the thread that runs; others may read
        self._began = time.perf_counter() - self._compilation.seconds
        self._paused = self.elapsed = 0.0
        self._peers, self.is_interrupted = peers, False
        self.hears: Callable[[], bool] = bool

    def read(self) -> float:
        """Return the seconds of the run up to now."""
        self.elapsed = time.perf_counter() - self._compilation.seconds - self._began
        seconds = self.elapsed - self._paused
        if not self._peers.is_alone:
            seconds, self.elapsed, wishes = self._peers.all_largest(seconds, self.elapsed, self.hears())
            self.is_interrupted = wishes > 0.0
        return seconds

    @contextmanager
    def paused(self) -> Iterator[None]:
        """Take off what happens inside a ``with`` statement: the algorithm did not need it."""
        own = self._compilation
        began = time.perf_counter() - own.seconds
        try:
            yield
        finally:
            self._paused += time.perf_counter() - own.seconds - began


class Incumbent:
    """The best iterate whose residual was measured, and the latest one that was not."""

    def __init__(self) -> None:
        self.z: FloatVector | None = None
        self.residual = math.inf
        self.unmeasured: FloatVector | None = None

    def offer(self, z: FloatVector, residual: float) -> None:
        """Keep a copy of z where its residual is smaller than the best; NaN counts as ∞."""
        self.unmeasured = None
        if self.z is None:
            self.z = z.copy()
            self.residual = math.inf if math.isnan(residual) else residual
        elif residual < self.residual:
            np.copyto(self.z, z)
            self.residual = residual


class Ledger:
    """What was done so far: stages, iterations, work, seconds, samples."""

    def __init__(self) -> None:
        self.stages: list[Stage] = []
        self.samples: list[Sample] = []
        self.iteration, self.work = -1, 0.0
        self.seconds = self.setup_seconds = 0.0
        self._is_first = True  # step of its stage

    def open(self, stage: Stage) -> None:
        """Begin a stage."""
        self.stages.append(stage)
        self._is_first = True

    def enter(self, step: Step, seconds: float) -> bool:
        """Count a step; return whether it is its stage's first, which a later stage begins where the last one ended."""
        stage, is_first = self.stages[-1], self._is_first
        self.seconds = seconds
        self.work += step.work
        stage.take(step.label, 0 if is_first else 1, step.work)
        stage.remark = step.remark or stage.remark
        stage.least_residual = max(stage.least_residual, step.least_residual)
        stage.settles = stage.settles or step.is_settling
        if not is_first:
            self.iteration += 1
        else:
            self._is_first = False
            self.iteration = max(self.iteration, 0)
            if self.iteration == 0:
                self.setup_seconds = seconds
        return is_first

    def records(self) -> tuple[StageRecord, ...]:
        """Return the stages, and their parts, as a result shows them."""
        return tuple(record for stage in self.stages for record in _records(stage))


def name_of(policy: str, stages: tuple[StageRecord, ...]) -> str:
    """Return what ran: the policy, and the chain of what it chose where that says more."""
    chain = [stage.name for stage in stages]
    return policy if "".join(chain) in ("", policy) else f"{policy}: {', '.join(chain)}"


def _records(stage: Stage) -> list[StageRecord]:
    parts = stage.parts or [(stage.algorithm.name, stage.iterations, stage.work)]
    reasons, remarks = [stage.because] + [""] * (len(parts) - 1), [""] * (len(parts) - 1) + [stage.remark]
    return [StageRecord(name, because, iterations, work, remark)
            for (name, iterations, work), because, remark in zip(parts, reasons, remarks, strict=True)]
