"""Compilation off the clock: what an algorithm needs runs once on a tiny problem before the first one."""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import fields

import numpy as np

from ..certificates.residuals import Certificate
from ..deadline import compiling
from ..locks import Lock
from ..problem.lcp import LCP
from .base import Algorithm
from .short_road import is_short

_rehearsed: set[tuple[Hashable, str]] = set()
_lock = Lock()


def rehearse(algorithm: Algorithm | None, problem: LCP, *, in_one_call: bool = False) -> None:
    """Run the algorithm, where it is compiled, or the judge once on a 1 × 1 problem of the same index width.

    That is a run of single steps, or the call that takes all of them at once: most runs need one of the two. What takes
    the short road with 1 × 1 problems, but not with this one, has other kernels, compiled on first use.
    """
    width = problem.matrix.index_width
    key = (None if algorithm is None else (_kind(algorithm), in_one_call), width)
    takes_short_road = algorithm is not None and algorithm.short_plan() is not None
    if key in _rehearsed or (takes_short_road and not is_short(problem)):
        return
    with compiling(), _lock.held():
        tiny = LCP([[1.0]], [-1.0])
        if width != tiny.matrix.index_width:
            return  # compiled on first use; such a matrix has two billion entries
        if algorithm is None:
            Certificate.of(tiny, np.zeros(1)).measured("relative")
        elif algorithm.is_compiled and in_one_call:
            algorithm.rehearsal().sprint(tiny, np.zeros(1), 1e-8, 10)
        elif algorithm.is_compiled:
            rehearsal = algorithm.rehearsal()
            steps = rehearsal.iterates(tiny, np.zeros(1))
            for _ in range(3):
                next(steps, None)
            rehearsal.finish(tiny, np.zeros(1))
        _rehearsed.add(key)


def _kind(algorithm: Algorithm) -> Hashable:
    """Return what decides which kernels run: the class, and its options but for the values of numbers."""
    options = [getattr(algorithm, field.name) for field in fields(algorithm)]
    return type(algorithm), *(value if value is None or isinstance(value, str) else type(value) for value in options)
