"""What ``verbose=True`` prints: the problem, a line a stage, lines at geometric intervals, and how the run ended."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from typing import Any

from ..deadline import NEW_KERNELS, compilation
from ..lcp import LCP
from ..matrix.matrix import Matrix
from ..policy.stages import Choice, Stage
from .result import Result, Sample

GROWTH = 1.5  # of a stage's iterations from one line to the next
NOTICEABLE = 0.5  # seconds of compilation
QUIET = 1.0  # seconds of it before a line says why nothing happens

Header = Callable[
    [Matrix], tuple[str, str]
]  # the classes of M, and a remark on it, '' where there is none


class RunLog:
    """Prints a run while it goes on.

    Parameters
    ----------
    problem : LCP or NonlinearProblem
        The caller's.
    header : callable, optional
        Tells the classes of an LCP's M, and a remark on it.
    """

    def __init__(self, problem: Any, header: Header | None = None) -> None:
        self._compilation, self._compiled = compilation(), compilation().seconds
        self._silent_until = NEW_KERNELS.seconds + QUIET
        self._next = 0
        classes, remark = (
            ("", "") if header is None or not isinstance(problem, LCP) else header(problem.matrix)
        )
        self._say(f"{problem}{classes and f'; M {classes}'}")
        if remark:
            self._say(remark)
        self._say(f"{'iteration':>12} {'work':>10} {'relative residual':>19} {'seconds':>9}")

    def hear_of_compilation(self) -> None:
        """Say it once where kernels are compiled for more than a second."""
        if NEW_KERNELS.is_under_way and NEW_KERNELS.seconds > self._silent_until:
            self._silent_until = math.inf
            self._write("(compiling, once an installation: some seconds more)")

    def begin(self, choice: Choice) -> None:
        """Print which algorithm begins, and why."""
        self._next = 0
        self._say(choice.algorithm.name + (choice.because and f": {choice.because}"))

    def is_due(self, stage: Stage) -> bool:
        """Return whether the present iteration of a stage has a line."""
        return stage.iterations >= self._next

    def step(self, stage: Stage, sample: Sample) -> None:
        """Print the line of an iteration."""
        self._next = max(stage.iterations + 1, math.ceil(stage.iterations * GROWTH))
        residual = math.nan if sample.residual is None else sample.residual
        self._say(
            f"{sample.iteration:>12} {sample.work:>10.1f} {residual:>19.2e} {sample.seconds:>9.3f}"
        )

    def end(self, result: Result) -> None:
        """Print what came out."""
        self._say(
            f"{result.status.name}: relative residual {result.residual:.2e} after {result.iterations} "
            f"iterations, the work of {result.work:.1f} products of M with a vector, {result.seconds:.3g} s; "
            f"{result.advice}"
        )

    def _say(self, line: str) -> None:
        compiled = self._compilation.seconds
        if compiled - self._compiled > NOTICEABLE:
            self._write(
                f"(compiling or loading kernels took {compiled - self._compiled:.1f} s, which are not counted)"
            )
            self._compiled = compiled
        self._write(line)

    def _write(self, line: str) -> None:
        say(line)


def say(line: str) -> None:
    """Print a line, whatever the terminal can show of it."""
    encoding = getattr(sys.stdout, "encoding", None) or "utf-8"
    print(line.encode(encoding, "replace").decode(encoding), flush=True)
