"""A method that yields stated points, and a problem of two unknowns for it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from lcp_plugin import LCP
from lcp_plugin.algorithms import Algorithm, Step

TWO = LCP([[2.0, 1.0], [1.0, 2.0]], [-5.0, 1.0])  # solved by (2.5, 0)


@dataclass(frozen=True, kw_only=True)
class Scripted(Algorithm):
    """Yields the given iterates, then repeats the last one."""

    name: ClassVar[str] = "scripted"
    points: tuple[tuple[float, ...], ...]
    claimed_residual: float | None = None

    def iterates(self, problem: LCP, z0: np.ndarray) -> Iterator[Step]:
        for point in self.points:
            yield Step(np.array(point), self.claimed_residual)
        while True:
            yield Step(np.array(self.points[-1]), self.claimed_residual)
