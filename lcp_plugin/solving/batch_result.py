"""What a batch gives back: arrays of all answers, and a Result of each on demand."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from functools import cached_property
from typing import Any

import numpy as np

from ..errors import LCPError
from ..settings import Status
from .batch_items import Items
from .result import Result, Results


class BatchResult(Results):
    """The answers to a batch of problems.

    Attributes
    ----------
    z : array, shape (B, n), or a list of arrays where the sizes differ
        NaN where the problem is none.
    status : array of Status, shape (B,)
        None where the problem is none.
    relative_residual : array, shape (B,)
        As in :class:`lcp_plugin.Certificate`; NaN where the problem is none, or was not begun.
    iterations : array of int, shape (B,)
    seconds : float
        Seconds of the whole batch, compilation excluded.
    items : Items
        The problems.
    result_of : callable
        Gives ``batch[k]``, for k ≥ 0 without error.
    threads : int
        How many took part, and will in its derivative.

    Notes
    -----
    ``batch[k]`` is the :class:`~lcp_plugin.Result` that :func:`lcp_plugin.solve` gives for problem k, its `seconds`
    a share of the batch's.
    """

    def __init__(
        self, z: Any, status: Any, relative_residual: Any, iterations: Any, seconds: float, items: Items,
        result_of: Callable[[int], Result], threads: int,
    ) -> None:
        self.z, self.status, self.relative_residual, self.iterations = z, status, relative_residual, iterations
        self.seconds, self.items, self.result_of, self.threads = seconds, items, result_of, threads

    @property
    def errors(self) -> dict[int, LCPError]:
        """What is wrong with problem k, an InvalidProblem, where something is; ``batch[k]`` raises it."""
        return self.items.errors

    @cached_property
    def w(self) -> Any:
        """M z + q of each problem, like z; computed when it is looked at."""
        rows = [np.full(len(z), np.nan) if k in self.errors else self.items.slack(k, z) for k, z in enumerate(self.z)]
        return np.array(rows).reshape(self.z.shape) if isinstance(self.z, np.ndarray) else rows

    @property
    def all_solved(self) -> bool:
        """Whether every status is SOLVED."""
        return all(status is Status.SOLVED for status in self.status)

    def __len__(self) -> int:
        return len(self.status)

    def at(self, k: int) -> Result:
        """Return result k, or raise what is wrong with its problem."""
        if k in self.errors:
            raise self.errors[k]
        return self.result_of(k)

    def __repr__(self) -> str:
        counts = Counter("no problem" if one is None else one.name for one in self.status)
        told = ", ".join(f"{count} {name}" for name, count in counts.most_common())
        return f"BatchResult({len(self)} problems: {told or 'none'}; {self.seconds:.3g} s)"
