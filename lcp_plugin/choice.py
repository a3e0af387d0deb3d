"""The policy behind algorithm="auto": which algorithm comes next, decided on counted work and measured residuals.

| so far | next |
|---|---|
| nothing | npsor, relaxation 1.7, its guaranteed row scaling (converges for every H₊-matrix) |
| after 10 sweeps, and every 20 from then on: npsor will arrive within 20 sweeps at its own rate | npsor goes on |
| npsor is slower than that, or fails, and the diagonal is positive | psor with automatic relaxation |
| psor fails | npsor again, for good |

To fail is to diverge or to stall. psor is not sent back for a slow start: its trials are undone where they do not
pay, so that it converges wherever Gauss–Seidel does. No clock is asked: the same call gives the same answer bit
for bit.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

from .algorithms import Algorithm, create
from .algorithms.base import has_positive_diagonal
from .algorithms.projected_relaxation import PSOR
from .algorithms.projected_type import NPSOR
from .errors import InvalidOption, UnknownAlgorithm
from .problem import LCP

TRIAL_SWEEPS = 10
NEAR_ENOUGH = 20
KEPT_RESIDUALS = 512


@dataclass
class Stage:
    """What one algorithm of a chain has done so far; `residuals` holds (iteration of this stage, residual)."""

    algorithm: Algorithm
    iterations: int = 0
    work: float = 0.0
    residuals: list[tuple[int, float]] = field(default_factory=list)

    def note(self, residual: float) -> None:
        """Keep the residual of the present iteration: of the first 512 measured all, then the latest."""
        if len(self.residuals) >= KEPT_RESIDUALS:
            self.residuals.pop()
        self.residuals.append((self.iterations, residual))

    def rate(self) -> float:
        """Return the contraction of the residual a sweep, over the second half of the stage."""
        if len(self.residuals) < 2:
            return 1.0
        last_step, last = self.residuals[-1]
        first_step, first = next(
            (entry for entry in self.residuals if entry[0] >= last_step // 2), self.residuals[0]
        )
        if last_step == first_step or not first > 0.0 or not math.isfinite(last):
            return 1.0
        return float((last / first) ** (1.0 / (last_step - first_step)))


class Policy(Protocol):
    """Chooses the first algorithm, and after each step whether another one takes over."""

    name: str

    def first(self, problem: LCP) -> Algorithm:
        """Return the algorithm to begin with."""

    def next_step(self, problem: LCP, stages: Sequence[Stage], target: float, failed: bool) -> Algorithm | None:
        """Return the algorithm that takes over, or None to go on (where the present one failed: to end)."""


class Single:
    """The caller's choice: one algorithm to the end."""

    def __init__(self, algorithm: Algorithm) -> None:
        self.algorithm = algorithm
        self.name = algorithm.name

    def first(self, problem: LCP) -> Algorithm:
        """Return the caller's algorithm."""
        return self.algorithm

    def next_step(self, problem: LCP, stages: Sequence[Stage], target: float, failed: bool) -> Algorithm | None:
        """Return None: nothing takes over."""
        return None


class Auto:
    """The table of this module."""

    name = "auto"

    def first(self, problem: LCP) -> Algorithm:
        """Return NPSOR at the row scaling that is proved to converge for every H₊-matrix."""
        return NPSOR()

    def next_step(self, problem: LCP, stages: Sequence[Stage], target: float, failed: bool) -> Algorithm | None:
        """Return PSOR after a slow trial of NPSOR, NPSOR after PSOR failed, else None."""
        now = stages[-1]
        is_asked = now.iterations >= TRIAL_SWEEPS and (now.iterations - TRIAL_SWEEPS) % NEAR_ENOUGH == 0
        if len(stages) == 1 and (failed or is_asked):
            usable = bool(has_positive_diagonal(problem).all())
            return PSOR() if usable and (failed or _sweeps_to_go(now, target) > NEAR_ENOUGH) else None
        return stages[0].algorithm if len(stages) == 2 and failed else None


def _sweeps_to_go(stage: Stage, target: float) -> float:
    residual, rate = stage.residuals[-1][1], stage.rate()
    if residual <= target:
        return 0.0
    return math.log(target / residual) / math.log(rate) if 0.0 < rate < 1.0 and target > 0.0 else math.inf


def policy_for(algorithm: Any, options: dict[str, Any]) -> Policy:
    """Return the policy that the caller's `algorithm` and options mean.

    Raises
    ------
    UnknownAlgorithm, InvalidOption
        Where the name or an option does not exist.
    """
    if isinstance(algorithm, Algorithm):
        if options:
            raise InvalidOption(
                f"options {sorted(options)} were given beside an algorithm object; "
                f"set them in {type(algorithm).__name__}(…)"
            )
        return Single(algorithm)
    if algorithm == "auto":
        if options:
            raise InvalidOption(f'algorithm="auto" has no options, got {sorted(options)}; name an algorithm as well')
        return Auto()
    if isinstance(algorithm, type):
        name = algorithm.__name__
        raise UnknownAlgorithm(f"algorithm must be a name or an object, got the class {name}; write {name}()")
    if not isinstance(algorithm, str):
        raise UnknownAlgorithm(f"algorithm must be a name or an object such as PSOR(relaxation=1.5), got {algorithm!r}")
    return Single(create(algorithm, options))
