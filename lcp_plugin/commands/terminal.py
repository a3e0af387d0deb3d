"""The terminal: one moving line while something runs, from the second second on, and tables."""

from __future__ import annotations

import shutil
import sys
import textwrap
import time
from collections.abc import Iterable
from contextlib import suppress
from itertools import cycle
from threading import Event, Lock, Thread
from typing import TYPE_CHECKING, Any

from ..core.deadline import NEW_KERNELS

if TYPE_CHECKING:
    from ..core.checks import FloatVector
    from ..core.solving.result import Sample
    from ..problems.equilibria.branch_and_bound import BranchAndBound

QUIET_SECONDS = 1.0
BAR = 24  # characters


class MovingLine:
    """A line on stderr that says what runs, or that kernels are compiled; for a ``with`` statement."""

    def __init__(self) -> None:
        self._thread: Thread | None = None
        self._ended, self._writing, self._mark = Event(), Lock(), cycle("|/-\\")
        self._text, self._began, self._width = "", 0.0, 0

    def __enter__(self) -> MovingLine:
        if sys.stderr is not None and sys.stderr.isatty():
            self._text = ""
            self._ended.clear()
            self._thread = Thread(target=self._move, name="moving line", daemon=True)
            NEW_KERNELS.watchers.append(self._draw)
            self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._thread is not None:
            self._ended.set()
            NEW_KERNELS.watchers.remove(self._draw)
            self._thread.join()
            self._thread = None
            self._draw()

    @property
    def is_there(self) -> bool:
        """Whether anybody looks."""
        return self._thread is not None

    def say(self, text: str) -> None:
        """Show this text from now on, once it has run for a second; the empty one wipes the line."""
        if not self._text:
            self._began = time.perf_counter()
        self._text = text
        if not text and self.is_there:
            self._draw()

    def _move(self) -> None:
        while not self._ended.wait(0.2):
            self._draw()

    def _draw(self) -> None:
        with self._writing:
            text = "" if self._ended.is_set() else self._due()
            if text:
                self._width = shutil.get_terminal_size().columns - 1
                self._write("\r" + f"{next(self._mark)} {text}"[: self._width].ljust(self._width))
            elif self._width:
                self._write(
                    "\r" + " " * self._width + "\r"
                )  # what Ctrl-C leaves behind the text as well
                self._width = 0

    def _due(self) -> str:
        if NEW_KERNELS.is_under_way and NEW_KERNELS.seconds > QUIET_SECONDS:
            return f"compiling, once an installation: {NEW_KERNELS.seconds:.0f} s so far"
        return self._text if time.perf_counter() - self._began > QUIET_SECONDS else ""

    def _write(self, text: str) -> None:
        with suppress(OSError, ValueError):  # the terminal has gone
            sys.stderr.write(text)
            sys.stderr.flush()


LINE = MovingLine()


def show_step(sample: Sample, z: FloatVector) -> bool:
    """Show the step of a run; never stop the run."""
    if LINE.is_there:
        residual = "" if sample.residual is None else f", residual {sample.residual:.2e}"
        keys = "(Ctrl-C stops and keeps the best)"
        LINE.say(
            f"{sample.label}: iteration {sample.iteration}{residual}, {sample.seconds:.1f} s  {keys}"
        )
    return False


def show_search(search: BranchAndBound) -> bool:
    """Show the node of a branch and bound; never stop it."""
    if LINE.is_there:
        found = f"best {search.value:.6g}, bound {search.lower_bound:.6g}"
        keys = "(Ctrl-C stops and keeps the best)"
        LINE.say(
            f"branch and bound: node {search.nodes}, {found}, {search.clock.read():.1f} s  {keys}"
        )
    return False


class PartsLine:
    """How many parts of a report or a study are done, and what is under way: without a moving line, a line a part."""

    def __init__(self, what: str = "report") -> None:
        self._what, self._said = what, -1

    def __call__(self, done: int, total: int, label: str) -> None:
        """Show it; after the last part nothing."""
        if LINE.is_there:
            bar = "█" * (BAR * done // total) + "░" * (BAR - BAR * done // total)
            LINE.say(f"{self._what} {bar} {done} of {total}: {label}" if done < total else "")
        elif self._said < done < total:
            self._said = done
            sys.stderr.write(f"[{done + 1}/{total}] {label}\n")


def fitted(text: str) -> str:
    """Return a text in lines that fit the terminal; as it is where the output goes elsewhere."""
    if not sys.stdout.isatty():
        return text
    columns = shutil.get_terminal_size().columns
    return "\n".join(part for line in text.splitlines() for part in _parts(line, columns))


def _parts(line: str, columns: int) -> list[str]:
    """Return the parts of a line; what follows the first is indented by two more."""
    indent = " " * (len(line) - len(line.lstrip()) + 2)
    return textwrap.wrap(line, columns, subsequent_indent=indent) or [""]


def console(width: int) -> Any:
    """Return a console as wide as the terminal; where the output goes elsewhere, of the width given."""
    from rich.console import Console

    return Console(width=None if sys.stdout.isatty() else width, markup=False, highlight=False)


def table(
    title: str,
    headings: Iterable[str],
    rows: Iterable[Iterable[str]],
    *,
    is_of_numbers: bool = False,
    **look: Any,
) -> Any:
    """Return a table that breaks long words rather than cutting them, and names and numbers never."""
    from rich.box import SIMPLE_HEAD
    from rich.table import Table

    table = Table(title=title, title_justify="left", box=SIMPLE_HEAD, **look)
    for heading in headings:
        keeps = is_of_numbers or heading in {"name", "source"}
        right = is_of_numbers and heading not in ("algorithm", "method")
        table.add_column(
            heading, overflow="fold", no_wrap=keeps, justify="right" if right else "left"
        )
    for row in rows:
        table.add_row(*row)
    return table
