"""The output of ``verbose=True``: the problem, a line per stage, lines at geometric intervals, the end of the run."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from typing import Any

from ..lcp import LCP
from ..matrix import Matrix
from .result import Result, Sample
from .stage import Stage

# the classes of M, and a remark on it, '' where there is none
Header = Callable[[Matrix], tuple[str, str]]


class RunLog:
    """Prints a run while it continues.

    Parameters
    ----------
    problem : LCP or NonlinearProblem
        The caller's.
    header : callable, optional
        Returns the classes of an LCP's M, and a remark.
    """

    def __init__(self, problem: Any, header: Header | None = None) -> None:
        self._next = 0
        classes, remark = (
            ("", "") if header is None or not isinstance(problem, LCP) else header(problem.matrix)
        )
        say(f"{problem}{classes and f'; M {classes}'}")
        if remark:
            say(remark)
        say(f"{'iteration':>12} {'work':>10} {'relative residual':>19} {'seconds':>9}")

    def begin(self, stage: Stage) -> None:
        """Print which algorithm begins, and why."""
        self._next = 0
        say(stage.algorithm.name + (stage.because and f": {stage.because}"))

    def is_due(self, stage: Stage) -> bool:
        """Return whether the present iteration of a stage has a line."""
        return stage.iterations >= self._next

    def step(self, stage: Stage, sample: Sample) -> None:
        """Print the line of an iteration."""
        self._next = max(stage.iterations + 1, math.ceil(stage.iterations * 1.5))
        residual = "–" if sample.residual is None else f"{sample.residual:.2e}"
        say(f"{sample.iteration:>12} {sample.work:>10.1f} {residual:>19} {sample.seconds:>9.3f}")

    def end(self, result: Result) -> None:
        """Print the status, the residual and the advice."""
        say(
            f"{result.status.name}: relative residual {result.residual:.2e} after {result.iterations} "
            f"iterations, the work of {result.work:.1f} products of M with a vector, {result.seconds:.3g} s; "
            f"{result.advice}"
        )


def say(line: str) -> None:
    """Print a line; characters that the terminal cannot show are replaced."""
    encoding = getattr(sys.stdout, "encoding", None) or "utf-8"
    print(line.encode(encoding, "replace").decode(encoding), flush=True)
