"""One link of a chain of algorithms: what was chosen and why, what it has done, and how far it has to go."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from ..algorithms import Algorithm, Step
from ..checks import FloatVector
from ..conversions.presolve import Presolved
from ..problem.lcp import LCP

STEADY = 0.05
KEPT_RESIDUALS = 512


@dataclass(frozen=True)
class Choice:
    """An algorithm, the reason for it, and the smaller problem it is to run on, if any.

    `may_wait` says that another one may have its turn before this one has come to its end; `from_start`, that it does
    not go on from the best point so far but begins where the run began.
    """

    algorithm: Algorithm
    because: str = ""
    presolved: Presolved | None = None
    may_wait: bool = False
    from_start: bool = False

    def iterates(self, problem: LCP, z0: FloatVector) -> Iterator[Step]:
        """Yield the steps of the algorithm in terms of the caller's problem."""
        if self.presolved is None or self.presolved.problem is problem:
            yield from self.algorithm.iterates(problem, z0)
            return
        smaller = self.presolved.problem
        start = np.clip(self.presolved.reduce(z0), smaller.lower, smaller.upper)
        share = smaller.nonzeros / max(problem.nonzeros, 1)
        for step in self.algorithm.iterates(smaller, start):
            z = np.clip(self.presolved.restore(step.z), problem.lower, problem.upper)
            yield replace(step, z=z, residual=None, euclidean=None, increment=None, work=share * step.work, proof=None)


@dataclass
class Stage:
    """What one algorithm of a chain has done so far.

    `residuals` holds (iteration of this stage, residual), `parts` (label, iterations, work) of an algorithm that has
    several; `from_start` says that it began where the run began; `least_residual` is that of its steps; `settles`, that
    steps have said their residuals may rise for a while.
    """

    algorithm: Algorithm
    because: str = ""
    from_start: bool = False
    iterations: int = 0
    work: float = 0.0
    remark: str = ""
    least_residual: float = 0.0
    settles: bool = False
    residuals: list[tuple[int, float]] = field(default_factory=list)
    parts: list[tuple[str, int, float]] = field(default_factory=list)

    def take(self, label: str, iterations: int, work: float) -> None:
        """Count iterations and work, for the part of that label where there is one."""
        self.iterations += iterations
        self.work += work
        if label and self.parts and self.parts[-1][0] == label:
            _, before, spent = self.parts.pop()
            self.parts.append((label, before + iterations, spent + work))
        elif label:
            self.parts.append((label, iterations, work))

    def note(self, residual: float) -> None:
        """Keep the residual of the present iteration: of the first 512 measured all, then the latest."""
        if len(self.residuals) >= KEPT_RESIDUALS:
            self.residuals.pop()
        self.residuals.append((self.iterations, residual))

    def rate(self) -> float:
        """Return the contraction of the residual a sweep, over the second half of the stage.

        Over all of it where steps settle, as those of psor do: each trial of a relaxation raises the residual.
        """
        if len(self.residuals) < 2:
            return 1.0
        last_step, last = self.residuals[-1]
        since = 0 if self.settles else last_step // 2
        first_step, first = next((entry for entry in self.residuals if entry[0] >= since), self.residuals[0])
        if last_step == first_step or not first > 0.0 or not math.isfinite(last):
            return 1.0
        return float((last / first) ** (1.0 / (last_step - first_step)))

    def is_steady(self) -> bool:
        """Return whether the last two contractions of the residual agree."""
        (_, first), (_, second), (_, third) = self.residuals[-3:]
        if not min(first, second, third) > 0.0:
            return False
        return abs(third / second - second / first) <= STEADY * second / first

    def steps_to_go(self, target: float) -> float:
        """Return how many more steps arrive at that residual, at the stage's own rate."""
        if not self.residuals:
            return math.inf
        residual, rate = self.residuals[-1][1], self.rate()
        if residual <= target:
            return 0.0
        return math.log(target / residual) / math.log(rate) if 0.0 < rate < 1.0 and target > 0.0 else math.inf
