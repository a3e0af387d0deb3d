"""The terminal: a line that moves while something runs, and tables."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ..core.checks import FloatVector
    from ..core.solving.result import Sample

UPDATE_SECONDS = 0.1


@contextmanager
def moving_line(text: str) -> Iterator[Callable[[str], None] | None]:
    """Show a line on stderr while something runs, and yield the function that changes it; None without a terminal."""
    if not (sys.stderr and sys.stderr.isatty()):
        yield None
        return
    from rich.console import Console
    from rich.markup import escape

    with Console(stderr=True).status(escape(text)) as status:
        yield lambda text: status.update(escape(text))


def steps_on(say: Callable[[str], None]) -> Callable[[Sample, FloatVector], bool]:
    """Return a callback of `solve` that shows the progress of the run."""
    last = -UPDATE_SECONDS

    def show(sample: Sample, z: FloatVector) -> bool:
        nonlocal last
        if sample.seconds >= last + UPDATE_SECONDS:
            last = sample.seconds
            residual = "" if sample.residual is None else f", residual {sample.residual:.2e}"
            keys = "(Ctrl-C stops and keeps the best)"
            say(
                f"{sample.label}: iteration {sample.iteration}{residual}, {sample.seconds:.1f} s  {keys}"
            )
        return False

    return show


def console(width: int) -> Any:
    """Return a console as wide as the terminal; of the given width if the output goes elsewhere."""
    from rich.console import Console

    return Console(width=None if sys.stdout.isatty() else width, markup=False, highlight=False)


def table(title: str, headings: Iterable[str], rows: Iterable[Iterable[Any]]) -> Any:
    """Return a table of rich that breaks long words, except in the first column."""
    from rich.box import SIMPLE_HEAD
    from rich.table import Table

    found = Table(title=title, title_justify="left", box=SIMPLE_HEAD, pad_edge=False)
    for k, heading in enumerate(headings):
        found.add_column(heading, overflow="fold", no_wrap=k == 0)
    for row in rows:
        found.add_row(*map(str, row))
    return found
