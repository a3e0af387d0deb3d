"""Problems as their users bring them, and a table of what their answers cost and how wrong they are.

    python tests/applications                    measure the small sizes, rewrite the table, print what changed
    python tests/applications --full             the large sizes, in a table of their own
    python tests/applications heston block       only these
    python tests/applications --keep-worse       where a processor differs: the worse row of this one and of the table
    python tests/applications --against HEAD~3   print what changed since that commit; nothing is measured

An application is a function of a few lines that states M, q and bounds as a user assembles them, in the file of its
subject; `application` registers it with its small and its large sizes. `references` has the answers that ours are
compared with, `table` measures and compares. Work is counted, not timed: nothing here asks a clock.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from importlib import import_module
from typing import Any

import numpy as np

SUBJECTS = ("membranes", "flows", "mechanics", "finance", "economics", "learning")


@dataclass(frozen=True)
class Application:
    """A problem and what its answer is compared with.

    Attributes
    ----------
    M, q, lower, upper
        As for `lcp_plugin.LCP`.
    answer : array, or callable (problem, starts) -> array, or None
        z*, or how it is found, starts being answers that may tell the active set; None: by active sets.
    determined : callable, z -> sequence of arrays
        What all solutions share, each array compared in its own size.
    error : callable or None
        z -> number: measured directly instead, where solutions differ in everything.
    program : QuadraticProgram or None
        The same as a program, whose x are the first components of z.
    """

    M: Any
    q: Any
    lower: Any = 0.0
    upper: Any = np.inf
    answer: Any = None
    determined: Callable[[Any], Sequence[Any]] = field(default=lambda z: (z,))
    error: Callable[[Any], float] | None = None
    program: Any = None


@dataclass(frozen=True)
class Entry:
    """A registered function with its sizes."""

    build: Callable[..., Application]
    small: Sequence[Mapping[str, Any]]
    full: Sequence[Mapping[str, Any]]


ENTRIES: dict[str, Entry] = {}


def application(
    small: Any, full: Any
) -> Callable[[Callable[..., Application]], Callable[..., Application]]:
    """Register a function with the arguments of each of its small and large cases."""

    def register(build: Callable[..., Application]) -> Callable[..., Application]:
        ENTRIES[build.__name__] = Entry(
            build, *([c] if isinstance(c, dict) else c for c in (small, full))
        )
        return build

    return register


def entries() -> dict[str, Entry]:
    """Return all applications by name, one subject after the other, whichever was imported first."""
    modules = [import_module(f"{__name__}.{subject}").__name__ for subject in SUBJECTS]
    return dict(sorted(ENTRIES.items(), key=lambda entry: modules.index(entry[1].build.__module__)))
