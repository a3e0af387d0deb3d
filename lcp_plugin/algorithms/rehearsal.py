"""Compilation off the clock: every kernel of an algorithm runs once on a tiny problem before the first solve."""

from __future__ import annotations

import numpy as np

from ..locks import Lock
from ..problem import LCP
from .base import Algorithm

_rehearsed: set[tuple[type[Algorithm], str]] = set()
_lock = Lock()


def rehearse(algorithm: Algorithm, problem: LCP) -> None:
    """Run the algorithm once on a 1 × 1 problem of the same index width."""
    if not algorithm.is_compiled:
        return
    width = problem.index_width
    key = (type(algorithm), width)
    if key in _rehearsed:
        return
    with _lock.held():
        tiny = LCP([[1.0]], [-1.0])
        if width != tiny.index_width:
            return  # compiled on first use; such a matrix has two billion entries
        rehearsal = algorithm.rehearsal()
        steps = rehearsal.iterates(tiny, np.zeros(1))
        for _ in range(3):
            next(steps, None)
        rehearsal.finish(tiny, np.zeros(1))
        _rehearsed.add(key)
