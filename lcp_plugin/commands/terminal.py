"""What a terminal shows while something runs; rich loads when there is something to show."""

from __future__ import annotations

import sys
import time
from typing import Any

from ..checks import FloatVector
from ..solving.result import Sample

QUIET_SECONDS = 1.0
REFRESH_SECONDS = 0.2


class RunLine:
    """A line on the terminal for runs longer than a second; silence otherwise."""

    def __init__(self) -> None:
        self._began = self._shown = time.perf_counter()
        self._status: Any = None
        self._residual = float("nan")
        self._wanted = sys.stderr.isatty()

    def __enter__(self) -> RunLine:
        return self

    def __exit__(self, *_: object) -> None:
        if self._status is not None:
            self._status.stop()

    def __call__(self, sample: Sample, z: FloatVector) -> bool:
        """Take note of a step; never stop the run."""
        if sample.residual is not None:
            self._residual = sample.residual
        now = time.perf_counter()
        if self._wanted and now - self._began > QUIET_SECONDS and now - self._shown > REFRESH_SECONDS:
            self._shown = now
            count = f"{sample.label}: iteration {sample.iteration}"
            self._show(f"{count}, residual {self._residual:.2e}, {sample.seconds:.1f} s")
        return False

    def _show(self, text: str) -> None:
        if self._status is None:
            from rich.console import Console

            self._status = Console(stderr=True).status(text)
            self._status.start()
        self._status.update(text + "  (Ctrl-C stops and keeps the best)")


class PartsBar:
    """A progress bar on a terminal; elsewhere one line a part."""

    def __init__(self, total: int) -> None:
        self._total = total
        self._progress: Any = None
        self._task: Any = None
        self._said = -1

    def __enter__(self) -> PartsBar:
        if sys.stderr.isatty():
            from rich.console import Console
            from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

            self._progress = Progress(
                TextColumn("report"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(),
                TextColumn("{task.description}"), console=Console(stderr=True), transient=True,
            )
            self._progress.start()
            self._task = self._progress.add_task("", total=self._total)
        return self

    def __exit__(self, *_: object) -> None:
        if self._progress is not None:
            self._progress.stop()

    def __call__(self, done: int, total: int, label: str) -> None:
        """Show how many parts are done and what is under way."""
        if self._progress is not None:
            self._progress.update(self._task, completed=done, description=label)
        elif done > self._said and done < total:
            self._said = done
            sys.stderr.write(f"[{done + 1}/{total}] {label}\n")
