"""What a terminal shows while something runs; rich loads when there is something to show."""

from __future__ import annotations

import shutil
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from itertools import cycle
from threading import Event, Lock, Thread
from typing import TYPE_CHECKING, Any

from ..deadline import NEW_KERNELS

if TYPE_CHECKING:
    from ..checks import FloatVector
    from ..solving.result import Sample

QUIET_SECONDS = 1.0
REFRESH_SECONDS = 0.2

# Of the line that is on the terminal already, if there is one: shows a text in its place; its own again for None.
_present: list[Callable[[str | None], None]] = []


class CompilationLine:
    """A moving line on the terminal while kernels are compiled, from the second second on; silence otherwise.

    Where another line is there already, that one says it.
    """

    def __init__(self) -> None:
        self._ended, self._writing = Event(), Lock()
        self._mark, self._wipe = cycle("|/-\\"), ""
        self._speaker: Callable[[str | None], None] | None = None
        self._thread: Thread | None = None

    def __enter__(self) -> CompilationLine:
        if sys.stderr is not None and sys.stderr.isatty():
            self._thread = Thread(target=self._move, name="compilation line", daemon=True)
            NEW_KERNELS.watchers.append(self._draw)
            self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._thread is not None:
            self._ended.set()
            NEW_KERNELS.watchers.remove(self._draw)
            self._thread.join()
            self._draw()

    def _move(self) -> None:
        while not self._ended.wait(REFRESH_SECONDS):
            self._draw()

    def _draw(self) -> None:
        """Show the line as it is now, or wipe it."""
        with self._writing:
            is_due = NEW_KERNELS.is_under_way and NEW_KERNELS.seconds > QUIET_SECONDS and not self._ended.is_set()
            text = f"compiling, once an installation: {NEW_KERNELS.seconds:.0f} s so far"
            if is_due and _present:
                self._clear()
                self._speaker = _present[-1]
                self._speaker(text)
            elif is_due:
                width = shutil.get_terminal_size().columns - 1
                self._wipe = "\r" + " " * width + "\r"  # what Ctrl-C leaves behind the text as well
                self._write("\r" + f"{next(self._mark)} {text}"[:width])
            else:
                self._clear()

    def _clear(self) -> None:
        if self._wipe:
            self._write(self._wipe)
        if self._speaker in _present:
            self._speaker(None)
        self._wipe, self._speaker = "", None

    def _write(self, text: str) -> None:
        with suppress(OSError, ValueError):  # the terminal has gone
            sys.stderr.write(text)
            sys.stderr.flush()


class RunLine:
    """A line on the terminal for runs longer than a second; silence otherwise."""

    def __init__(self) -> None:
        self._began = self._shown = time.perf_counter()
        self._status: Any = None
        self._residual, self._text = float("nan"), ""
        self._wanted = sys.stderr.isatty()

    def __enter__(self) -> RunLine:
        return self

    def __exit__(self, *_: object) -> None:
        if self._status is not None:
            _present.remove(self._interrupt)
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
            _present.append(self._interrupt)
        self._text = text + "  (Ctrl-C stops and keeps the best)"
        self._status.update(self._text)

    def _interrupt(self, text: str | None) -> None:
        self._status.update(text or self._text)


class PartsBar:
    """A progress bar on a terminal; elsewhere one line a part."""

    def __init__(self, total: int) -> None:
        self._total = total
        self._progress: Any = None
        self._task: Any = None
        self._said, self._label = -1, ""

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
            _present.append(self._interrupt)
        return self

    def __exit__(self, *_: object) -> None:
        if self._progress is not None:
            _present.remove(self._interrupt)
            self._progress.stop()

    def _interrupt(self, text: str | None) -> None:
        self._progress.update(self._task, description=text or self._label)

    def __call__(self, done: int, total: int, label: str) -> None:
        """Show how many parts are done and what is under way."""
        self._label = label
        if self._progress is not None:
            self._progress.update(self._task, completed=done, description=label)
        elif done > self._said and done < total:
            self._said = done
            sys.stderr.write(f"[{done + 1}/{total}] {label}\n")
